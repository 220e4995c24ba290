"""A whole diagnosis of recordings in which an effect is concealed, made once by the generator of tests/benchmarks.

It is trial 0000 of `tests/benchmarks/trials.py make FOLDER`: a ceramic that softens with the drive (147 standard
deviations). More take minutes each: the benchmark runs them.
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from workbench.cli import main

TRIAL = Path(__file__).parent / "data" / "trials" / "0000"

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("tables_fit")]


def without(campaign: Path, *states: str) -> None:
    """Take some states out of a campaign's file."""
    text = campaign.read_text(encoding="utf-8")
    for state in states:
        text = re.sub(rf"\[states\.{state}\].*?(?=\[)", "", text, flags=re.DOTALL)
    campaign.write_text(text, encoding="utf-8")


def test_a_ceramic_that_softens_is_found_and_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    shutil.copytree(TRIAL, tmp_path / "trial")
    campaign = tmp_path / "trial" / "campaign.toml"
    # The empty chip takes a third of the time and knows nothing of the drive; two drives tell what three do.
    without(campaign, "empty", "filled_low")
    assert main(["diagnose", str(campaign), "-o", str(tmp_path / "out")]) == 0
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    truth = json.loads((TRIAL / "truth.json").read_text(encoding="utf-8"))
    assert found["verdict"] == "missing_physics"
    (effect,) = found["effects"]
    assert (effect["name"], effect["region"], effect["admissible"]) == ("softening with the drive", "transducer", True)
    # Told per squared 8 V peak to peak, found per squared volt of amplitude.
    (told,) = truth["effects"]
    for name, key in (("softening", "softening.stiffness"), ("drive_loss", "softening.loss")):
        interval = effect["parameters"][f"pzt/trial.{name}"]
        expected = told["parameters"][key] / 4.0**2
        # A 95 % interval misses one in twenty: here it need only come within twice its half width.
        half = 0.5 * (interval["high"] - interval["low"])
        assert abs(interval["value"] - expected) < 2.0 * half < 0.5 * expected
    # What is left is noise to a per cent of its square; of 0.035^2 that is less than a hundredth of the mismatch.
    assert effect["share"] > 0.97
    assert found["headline"].startswith("Softening with the drive: softening 0.00027")
    assert found["scores"][0]["effect"] == "softening with the drive"
    for name, state in found["after"].items():
        assert state["reduced_chi_square"] < 1.3, name
        assert state["reduced_chi_square"] <= found["known_parameters_only"][name]["reduced_chi_square"] + 0.1
    (held,) = found["held_out"].values()
    assert held["after"]["reduced_chi_square"] < 1.3
    for state in (*found["before"].values(), *found["after"].values()):
        assert set(state) >= {"f0", "z_min", "q", "mape_percent", "rms_log_residual", "reduced_chi_square"}
    assert set(found) >= {"verdict", "effects", "moved_parameters", "rivals", "location", "before", "after", "held_out",
                          "next_measurement", "detection_limits"}
    # Boundary layers are on, and what they do is said: here next to nothing.
    known = {(row["effect"], row["state"]): row["rms_log_change"] for row in found["known_physics"]}
    assert {effect for effect, _ in known} == {"viscous boundary layer", "thermal boundary layer",
                                               "absorption of the fluid"}
    assert 0.0 < known["viscous boundary layer", "filled"] < 0.1
    assert known["thermal boundary layer", "filled"] < known["viscous boundary layer", "filled"]
    assert {p.name for p in (tmp_path / "out").glob("*.png")} == {"states.png", "shares.png", "where.png"}
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "softening with the drive" in report
    assert report.count("data:image/png") == 3
    assert "10^" in report  # odds
    assert all(unit in report for unit in ("GPa", "mm", "kg/m^3"))
