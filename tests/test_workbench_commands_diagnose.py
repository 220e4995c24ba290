"""`workbench diagnose` of one recording and a chip file, without a campaign file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from workbench.campaign.campaign import Campaign, read_campaign
from workbench.cli import main
from workbench.readers import read_recording

SMALL = Path(__file__).parent.parent / "geometry" / "chips" / "small_campaign"
CHIP, EMPTY, FILLED = (str(SMALL / name) for name in ("chip.toml", "empty.csv", "filled.csv"))


@pytest.fixture
def diagnosed(monkeypatch: pytest.MonkeyPatch) -> list[Campaign]:
    """The campaigns that the command begins to diagnose; it ends there, status 1."""
    found: list[Campaign] = []

    def ended(campaign: Campaign, **_options: object) -> None:
        found.append(campaign)
        raise RuntimeError("far enough")

    monkeypatch.setattr("workbench.commands.diagnose.diagnose", ended)
    return found


def test_one_recording_is_a_campaign_of_one_state(diagnosed: list[Campaign], tmp_path: Path) -> None:
    assert main(["diagnose", FILLED, "--chip", CHIP, "--noise", "0.5 %", "-o", str(tmp_path / "out")]) == 1
    (campaign,) = diagnosed
    (state,) = campaign.states
    (tmp_path / "campaign.toml").write_text(
        f'[states.filled]\nchip = "{CHIP}"\nstate = "filled"\nrecording = "{FILLED}"\nnoise = "0.5 %"\n')
    same = read_campaign(tmp_path / "campaign.toml")
    assert (campaign.name, state.name, state.device.state.name) == ("small chip", "filled", "filled")
    assert state.stated
    assert np.array_equal(state.noise, same.states[0].noise)
    assert np.array_equal(state.measured.frequency, same.states[0].measured.frequency)
    assert state.measured.origin.source == FILLED
    # The water's own uncertainty, and what benches do.
    assert [each.name for each in campaign.uncertain] == [each.name for each in same.uncertain] == [
        "water/iapws_2011.density", "water/iapws_2011.sound_speed", "bench.gain", "bench.series_resistance",
        "bench.clock"]
    assert campaign.is_exact


def test_the_options_of_the_one_recording(diagnosed: list[Campaign], tmp_path: Path) -> None:
    chip = tmp_path / "chip.toml"
    chip.write_text(Path(CHIP).read_text(encoding="utf-8").replace(
        'thickness = "20 um"', 'thickness = { value = "20 um", tolerance = "3 um" }'), encoding="utf-8")
    spectrum = read_recording(EMPTY).spectrum
    (tmp_path / "table.txt").write_text("first;second;third\n" + "".join(
        f"{f!r};{-z.real!r};{-z.imag!r}\n" for f, z in zip(
            spectrum.frequency.tolist(), spectrum.impedance.tolist(), strict=True)), encoding="utf-8")
    (tmp_path / "map.toml").write_text(
        'frequency = 1\nfirst = 2\nsecond = 3\ndelimiter = ";"\n'
        'quantity = { kind = "impedance", form = "rectangular", unit = "ohm" }\n', encoding="utf-8")
    assert main(["diagnose", str(tmp_path / "table.txt"), "--chip", str(chip), "--state", "empty", "--from", "0.97 MHz",
                 "--columns", str(tmp_path / "map.toml"), "--correction", "negate", "-o", str(tmp_path / "out")]) == 1
    (campaign,) = diagnosed
    (state,) = campaign.states
    assert (state.name, state.fluid, state.stated) == ("empty", None, False)
    inside = spectrum.restricted(0.97e6, 1.08e6)
    assert np.array_equal(state.measured.frequency, inside.frequency)
    assert np.array_equal(state.measured.impedance, inside.impedance)
    assert campaign.known["couplant.thickness"] == pytest.approx(3e-6 / 3.0**0.5)
    assert not campaign.is_exact


def test_a_recording_of_the_chip_as_stated_is_diagnosed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["diagnose", EMPTY, "--chip", CHIP, "--state", "empty", "--noise", "0.5 %", "--to", "1.02 MHz",
                 "--accuracy", "1 %", "--jobs", "1", "-o", str(out)]) == 0
    found = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert found["verdict"] == "no_mismatch"
    (state,) = found["after"].values()
    assert state["reduced_chi_square"] < 1.3
    said, lossless = found["findings"]
    assert lossless.startswith("pic255/plutho states no loss")
    assert said.startswith("All lengths and solids count as exact")
    assert said in " ".join(capsys.readouterr().out.split())
    assert "count as exact, since no file states" in (out / "report.html").read_text(encoding="utf-8")
