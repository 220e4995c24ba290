"""Goals, studies and campaigns made in Python are those of the files, with the same checks."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import workbench as wb
from geometry.chip import Chip

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
SMALL = EXAMPLES.parent / "geometry" / "chips" / "small_campaign"
FREQUENCY = np.linspace(0.95e6, 1.08e6, 131)


@pytest.fixture(scope="module")
def chip() -> Chip:
    return wb.read_chip(SMALL / "chip.toml")


def recording(size: float = 1.0) -> wb.Spectrum:
    """A made-up recording of any device."""
    omega = 2.0 * np.pi * FREQUENCY
    motion = 20.0 + 1j * (1e-3 * omega - 1e-3 * (2.0 * np.pi * 1e6) ** 2 / omega)
    return wb.Spectrum(FREQUENCY, size / (1j * omega * 2e-10 + 1.0 / motion))


def same(one: object, other: object, *but: str) -> None:
    """Every field of two values is equal but for some."""
    for name, value in vars(one).items():
        assert name in but or getattr(other, name) == value, name


def test_a_goal_from_values_is_that_of_the_file() -> None:
    read = wb.read_goal(EXAMPLES / "design" / "half_wave_chip.toml")
    made = wb.Goal(
        wb.read_chip(EXAMPLES / "design" / "printed_chip.toml"),
        {"substrate.thickness": {"from": 0.82e-3, "to": 0.98e-3, "step": 20e-6},
         "sidewall.thickness": {"from": "0.68 mm", "to": "0.82 mm", "step": "20 um"},
         "superstrate.thickness": {"from": np.float64(0.54e-3), "to": 0.66e-3, "step": 20e-6}},
        maximise="e_ac", drive=wb.parse_drive("10 Vpp"),
        constraints=("trap_offset within 50 um of 0 um", "f0 within [0.95 MHz, 1.1 MHz]",
                     "substrate.radius - cavity.radius >= 0.8 mm"))
    assert made.variables[0].low == pytest.approx(read.variables[0].low)
    same(read, made, "source", "variables")
    assert made.source == "Goal"


def test_a_goal_of_stock_and_heat_from_values(chip: Chip) -> None:
    made = wb.Goal(chip, {"superstrate.thickness": {"values": np.array([1e-3, 0.5e-3])}}, minimise=["f0"],
                   thermal={"all": 12}, band=(0.9e6, 1.1e6), robust={"quantile": 0.1}, search={"relative_error": 0.01},
                   constraints=["heating <= 5 K"])
    assert made.stock[0].values == (0.5e-3, 1e-3)
    assert made.operation.thermal_resistance == {"": 12.0}
    assert (made.band, made.robust.quantile, made.search.relative_error) == ((0.9e6, 1.1e6), 0.1, 0.01)


@pytest.mark.parametrize(("variables", "more", "message"), [
    ({}, {}, "Goal: variables: .*at least one"),
    ({"substrat.thickness": {"from": 1e-3, "to": 2e-3}}, {}, "Goal: variables.substrat.thickness: .*did you mean"),
    ({"substrate.thickness": {"from": 2e-3, "to": 1e-3}}, {}, r"Goal: variables.substrate.thickness.to: .*2 mm"),
    ({"substrate.thickness": {"from": 0.9, "to": 1.1}}, {}, "Goal: variables.substrate.thickness: .*900 mm"),
    ({"substrate.thickness": {"from": "1", "to": 2e-3}}, {}, "Goal: variables.substrate.thickness.from: .*length"),
    ({"substrate.thickness": {"from": 1e-3, "to": float("nan")}}, {}, "finite"),
    ({"substrate.thickness": 1e-3}, {}, "Goal: variables.substrate.thickness: .*from"),
    ({"substrate.thickness": {"from": 1e-3, "to": 2e-3}}, {"maximise": "eac"}, "Goal: goal.maximise: .*did you mean"),
    ({"substrate.thickness": {"from": 1e-3, "to": 2e-3}}, {"state": "fillet"}, "Goal: goal.state: .*filled"),
    ({"substrate.thickness": {"from": 1e-3, "to": 2e-3}}, {"search": {"start": 3}}, "Goal: search.start: .*starts"),
    ({"substrate.thickness": {"from": 1e-3, "to": 2e-3}}, {"band": (1e6,)}, "Goal: goal.band: .*two frequencies"),
    ({"substrate.thickness": {"from": 1e-3, "to": 2e-3}}, {"band": (1, 2)}, "Goal: goal.band: .*'1 to 2 MHz'"),
])
def test_a_mistake_in_a_goal_is_said(chip: Chip, variables: dict, more: dict, message: str) -> None:
    with pytest.raises(wb.InputError, match=message):
        wb.Goal(chip, variables, **{"maximise": "f0", **more})


def test_a_number_without_unit_is_still_refused_in_a_file(tmp_path: Path) -> None:
    for name in ("half_wave_chip.toml", "printed_chip.toml"):
        text = (EXAMPLES / "design" / name).read_text(encoding="utf-8")
        (tmp_path / name).write_text(text.replace('from = "0.82 mm"', "from = 0.00082"), encoding="utf-8")
    with pytest.raises(wb.InputError, match="with its unit"):
        wb.read_goal(tmp_path / "half_wave_chip.toml")


def test_a_study_from_values_is_that_of_the_file() -> None:
    path = EXAMPLES / "small_study" / "study.toml"
    read = wb.read_study(path)
    made = wb.Study(
        wb.read_chip(path.parent / "chip.toml"),
        {"sidewall.thickness": {"tolerance": 30e-6}, "substrate.thickness": {"tolerance": "20 um"},
         "superstrate.material": {"materials": ("soda_lime_glass", "borosilicate_glass")}},
        figures=["f0", "q", "mean_e_ac"], sample={"method": "sobol", "points": 64, "seed": 1},
        accuracy=0.01, relative_error="1 %", confirm=2)
    assert np.array_equal(made.sample, read.sample)
    same(read, made, "name", "file", "axes", "sample")
    assert (made.name, made.file) == (made.chip.name, "Study")


@pytest.mark.parametrize(("vary", "more", "message"), [
    ({}, {}, "Study: vary: "),
    ({"substrate.thickness": {"from": 0.8e-3, "to": 0.9e-3}}, {}, "Study: vary.substrate.thickness.points"),
    ({"substrate.thickness": {"values": [1e-3]}}, {}, "two different values"),
    ({"substrate.thickness": {"values": [1e-3, 2e-3]}}, {"figures": ["f00"]}, "Study: study.figures: .*did you mean"),
    ({"substrate.thickness": {"values": [1e-3, 2e-3]}}, {"band": (1, 2)}, "Study: study.band: .*'1 to 2 MHz'"),
    ({"substrate.thickness": {"values": [1e-3, 2e-3]}}, {"frequency": 5e6}, "Study: study.frequency: .*the band"),
    ({"substrate.thickness": {"values": [1e-3, 2e-3]}}, {"relative_error": 2.0}, "Study: study.relative_error"),
])
def test_a_mistake_in_a_study_is_said(chip: Chip, vary: dict, more: dict, message: str) -> None:
    with pytest.raises(wb.InputError, match=message):
        wb.Study(chip, vary, **{"figures": ["f0"], **more})


@pytest.mark.parametrize("jobs", [0, "2", 1.5])
def test_jobs_are_a_whole_number(chip: Chip, jobs: Any) -> None:
    goal = wb.Goal(chip, {"substrate.thickness": {"from": 0.8e-3, "to": 0.9e-3}}, maximise="f0")
    calls: list[Callable[[], object]] = [
        lambda: wb.optimise(goal, jobs=jobs), lambda: wb.tolerance(chip, "filled", [], jobs=jobs),
        # Refused before the campaign is looked at.
        lambda: wb.diagnose(cast(wb.Campaign, None), jobs=jobs)]
    for call in calls:
        with pytest.raises(wb.InputError, match=f"jobs: received {jobs!r}; expected a whole number, one or more"):
            call()


def test_a_campaign_from_values_is_that_of_a_file(chip: Chip, tmp_path: Path) -> None:
    (tmp_path / "campaign.toml").write_text(
        (SMALL / "campaign.toml").read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "chip.toml").write_text(
        (SMALL / "chip.toml").read_text(encoding="utf-8"), encoding="utf-8")
    empty, filled = recording(), recording(1.1)
    assert wb.write_spectrum(empty, str(tmp_path / "empty.csv")) == tmp_path / "empty.csv"
    wb.write_spectrum(filled, tmp_path / "filled.csv")
    read = wb.read_campaign(tmp_path / "campaign.toml")
    made = wb.Campaign(
        {"empty": {"chip": chip, "state": "empty", "recording": empty, "noise": 0.005},
         "filled": {"chip": chip, "state": "filled", "recording": wb.read_recording(tmp_path / "filled.csv"),
                    "noise": "0.5 %"}},
        known={"couplant.thickness": 1e-6, "pla.shear_modulus": "1 %", "pla.bulk_modulus": "1 %",
               "bench.series_resistance": 0.05}, name="small chip")
    assert made.known == pytest.approx(read.known)
    assert made.offsets == pytest.approx(read.offsets)
    same(read, made, "states", "known", "offsets", "uncertain", "file")
    for one, other in zip(made.states, read.states, strict=True):
        assert (one.name, one.device.state, one.stated) == (other.name, other.device.state, other.stated)
        assert np.array_equal(one.measured.impedance, other.measured.impedance)
        assert np.array_equal(one.noise, other.noise)


@pytest.mark.parametrize(("state", "more", "message"), [
    ({"recording": 3.0}, {}, "Campaign: states.empty.recording: received 3.0; .*a Spectrum or the path"),
    ({"recording": None}, {}, "Campaign: states.empty.recording: .*a Spectrum or the path of its recording"),
    ({"chip": 3}, {}, "Campaign: states.empty.chip: received 3; expected a Chip or the path of its file"),
    ({"chip": "nothing.toml"}, {}, "nothing.toml"),
    ({"nois": 0.01}, {}, "Campaign: states.empty.nois: .*noise"),
    ({"noise": 0.5}, {}, "Campaign: states.empty.noise: .*cleaner"),
    ({"held_out": True}, {}, "Campaign: states: .*not held out"),
    ({"band": (2e6, 3e6)}, {}, "states.empty.recording: frequency: .*2 points or more"),
    ({}, {"known": {"pla.share_modulus": 1e7}}, "Campaign: known.pla.share_modulus: .*did you mean"),
    ({}, {"fixed": ["nothing.here"]}, "Campaign: fixed.names: "),
    ({}, {"inhomogeneity": 2.0}, "Campaign: model.inhomogeneity: "),
])
def test_a_mistake_in_a_campaign_is_said(chip: Chip, state: dict, more: dict, message: str) -> None:
    with pytest.raises(wb.InputError, match=message):
        wb.Campaign({"empty": {"chip": chip, "state": "empty", "recording": recording(), "noise": 0.005} | state},
                    **more)


@pytest.mark.parametrize(("call", "message"), [
    (lambda: wb.Goal("chip.toml", {}), r"Goal: chip: .*'chip.toml'.* a Chip; read one with wb.read_chip \(.* a str\)"),
    (lambda: wb.Study("chip.toml", {}, figures=["f0"]), "Study: chip: .*a Chip; read one with wb.read_chip"),
    (lambda: wb.simulate("chip.toml"), "simulate: chip: .*a Chip; read one with wb.read_chip"),
    (lambda: wb.snapshot(Path("chip.toml"), None, 1e6), "snapshot: chip: .*a Chip; "),
    (lambda: wb.tolerance("chip.toml", None), "tolerance: chip: .*a Chip; read one with wb.read_chip"),
    (lambda: wb.study("study.toml", "folder"), "study: plan: .*a Study; read one with wb.read_study"),
    (lambda: wb.optimise("goal.toml"), "optimise: goal: .*a Goal; read one with wb.read_goal"),
    (lambda: wb.diagnose("campaign.toml"), "diagnose: campaign: .*a Campaign; read one with wb.read_campaign"),
])
def test_the_path_of_a_file_in_place_of_its_value_is_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(wb.InputError, match=message):
        call()


def test_a_value_of_another_kind_is_refused_in_few_words(chip: Chip, tmp_path: Path) -> None:
    with pytest.raises(wb.InputError, match=r"a Study; read one with wb.read_study \(this is a Chip\)") as caught:
        wb.study(chip, tmp_path / "study")
    assert len(str(caught.value)) < 350
    assert not (tmp_path / "study").exists()


def test_a_received_value_that_is_long_is_cut() -> None:
    short, long = (str(wb.InputError("Goal", "band", value, "two"))
                   for value in ("x" * 198, np.linspace(0.0, 1.0, 900)))
    assert f"received {'x' * 198!r};" in short
    assert len(long) < 270
    assert "\n" not in long
    assert re.search(r"\.\.\. \(\d+ characters\); expected two$", long)


@pytest.mark.parametrize(("path", "message"), [
    (None, r"write_spectrum: path: missing; expected the path of a file to write"),
    (EXAMPLES, r"write_spectrum: path: received '.*examples'; expected the path of a file .*spectrum\.csv.*a folder"),
])
def test_a_spectrum_is_written_to_a_file_only(path: object, message: str) -> None:
    with pytest.raises(wb.InputError, match=message):
        wb.write_spectrum(recording(), path)
