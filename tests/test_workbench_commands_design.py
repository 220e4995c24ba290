"""``workbench design``: what it leaves, what it says, and that an interruption keeps the best chip so far."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import CAVITY_LAYERS, DISC, chip_from, visible

from geometry.chip import Chip, read_chip
from geometry.chip_file import write_chip
from workbench.cli import main
from workbench.design import optimisation
from workbench.design.evaluation import Evaluation
from workbench.design.modelling import ChipSolver
from workbench.files.output import begin
from workbench.files.ownership import Outputs
from workbench.results.spectrum import Spectrum
from workbench.simulation.run import snapshot

CHIPS = Path(__file__).parents[1] / "geometry" / "chips"
GOAL = """
[goal]
chip = "chip.toml"
frequency = "f0"
maximise = "e_ac"
constraints = ["f0 >= 1 MHz"]
[variables]
substrate.thickness = { from = "0.76 mm", to = "0.94 mm", step = "20 um" }
sidewall.thickness = { from = "0.65 mm", to = "0.80 mm" }
[search]
starts = 3
looked_at = 4
"""
pytestmark = pytest.mark.filterwarnings("ignore::materials.PassivityWarning")


class Parabola:
    """ln e_ac falls with the square of both lengths' distance from 0.83 and 0.74 mm; f0 with the substrate."""

    names = ("substrate.thickness", "sidewall.thickness")
    figures = ("f0", "e_ac")

    def __call__(self, values: Mapping[str, float], *, gradient: bool = False) -> Evaluation:
        off = np.array([(values[name] - top) / 1e-4 for name, top in zip(self.names, (0.83e-3, 0.74e-3), strict=True)])
        e_ac, f0 = 100.0 * float(np.exp(-off @ off)), 850.0 / values["substrate.thickness"]
        slopes = {"e_ac": -2.0 * e_ac * off / 1e-4, "f0": np.array([-f0 / values["substrate.thickness"], 0.0])}
        return Evaluation(dict(values), {"f0": f0, "e_ac": e_ac}, {}, f0, 0.0, slopes if gradient else None)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Models and full solves of a made-up chip in place of real ones."""
    monkeypatch.setattr(ChipSolver, "model", lambda self, chip, ranges, progress: Parabola())
    monkeypatch.setattr(ChipSolver, "full", lambda self, chip: Parabola()(
        {name: chip.dimensions()[name].value for name in Parabola.names}))
    monkeypatch.setattr(ChipSolver, "snapshot", lambda self, chip, frequency: None)
    band = np.linspace(0.9e6, 1.1e6, 11)
    monkeypatch.setattr(ChipSolver, "spectrum", lambda self, chip: Spectrum(band, np.full(11, 10.0 - 5.0j)))


def written(folder: Path, text: str = GOAL) -> str:
    write_chip(read_chip(CHIPS / "reference_chip.toml"), folder / "chip.toml")
    (folder / "goal.toml").write_text(text, encoding="utf-8")
    return str(folder / "goal.toml")


def test_a_goal_leaves_chip_report_and_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["design", written(tmp_path), "-o", str(out), "--jobs", "1", "--no-cad"]) == 0
    assert set(visible(out)) == {"best.toml", "design.json", "report.html", "impedance.png",
                                                     "convergence.png"}
    best = read_chip(out / "best.toml")
    # The nearer step to 0.83 mm of the two that keep f0 above 1 MHz.
    assert best.layer("substrate").thickness.value == pytest.approx(0.84e-3, abs=1e-12) or \
        best.layer("substrate").thickness.value == pytest.approx(0.82e-3, abs=1e-12)
    record = json.loads((out / "design.json").read_text(encoding="utf-8"))
    assert record["confirmed"] is True
    assert record["choices"][0]["starts_at_best"] == 3
    assert record["after"]["figures"]["e_ac"] == pytest.approx(100.0 * np.exp(-0.01), rel=1e-4)
    said = capsys.readouterr().out
    assert "3 of 3 starts ended at the best optimum" in said
    assert "confirmed by a full solve" in said
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Active bounds" in page


def test_the_field_before_and_after_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chip = chip_from(DISC + CAVITY_LAYERS + '[states.filled]\ncavity = "water"\n', "cell.toml")
    shot = snapshot(chip, "filled", 400e3, accuracy=5e-2)
    monkeypatch.setattr(ChipSolver, "snapshot", lambda self, chip, frequency: shot)
    out = tmp_path / "out"
    assert main(["design", written(tmp_path), "-o", str(out), "--jobs", "1", "--no-cad"]) == 0
    assert {path.name for path in (out / "before").iterdir()} == {"pressure_filled.png"}
    assert (out / "after" / "pressure_filled.png").exists()
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.index("before, filled: pressure") < page.index("after, filled: pressure")


def test_what_is_not_confirmed_leaves_no_chip(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    with begin(out, Outputs("design", ("best.toml",)), source="x", field="y"):
        write_chip(read_chip(CHIPS / "reference_chip.toml"), out / "best.toml")

    def off(_solver: ChipSolver, chip: Chip) -> Evaluation:
        found = Parabola()({name: chip.dimensions()[name].value for name in Parabola.names})
        return replace(found, figures={**found.figures, "e_ac": 1.03 * found.figures["e_ac"]})

    monkeypatch.setattr(ChipSolver, "full", off)
    assert main(["design", written(tmp_path), "-o", str(out), "--jobs", "1", "--no-cad"]) == 1
    # Not even that of an earlier run.
    assert not (out / "best.toml").exists()
    assert "rejected: the full solve and the model differ by 2.9 % in e_ac" in capsys.readouterr().out
    assert json.loads((out / "design.json").read_text(encoding="utf-8"))["after"] is None


def test_an_interruption_keeps_the_best_so_far(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> Evaluation:
        raise KeyboardInterrupt

    monkeypatch.setattr(optimisation, "confirmed", interrupted)
    out = tmp_path / "out"
    assert main(["design", written(tmp_path), "-o", str(out), "--jobs", "1", "--no-cad"]) == 130
    kept = read_chip(out / "best_so_far.toml")
    assert kept.layer("sidewall").thickness.value == pytest.approx(0.74e-3, abs=1e-6)
    assert "not confirmed" in kept.layer("sidewall").thickness.note


def test_a_front_leaves_a_chip_for_each_of_its_points(tmp_path: Path) -> None:
    text = GOAL.replace('maximise = "e_ac"', 'maximise = ["e_ac", "f0"]').replace(
        "starts = 3", "starts = 3\nevolutionary = true\npopulation = 8\ngenerations = 5")
    out = tmp_path / "out"
    assert main(["design", written(tmp_path, text), "-o", str(out), "--jobs", "1", "--no-cad"]) == 0
    record = json.loads((out / "design.json").read_text(encoding="utf-8"))
    chips = sorted((out / "front").iterdir())
    assert len(chips) == len(record["front"]) > 1
    assert read_chip(chips[0]).layer("substrate").thickness.value == pytest.approx(
        record["front"][0]["lengths_m"]["substrate.thickness"], abs=1e-12)
    assert (out / "front.png").stat().st_size > 1000


def test_stock_on_one_model_is_one_start_for_each_size(tmp_path: Path) -> None:
    text = GOAL.replace("[search]", 'superstrate.thickness = { values = ["0.5 mm", "1 mm"] }\n[search]').replace(
        "starts = 3", "evolutionary = true")
    out = tmp_path / "out"
    assert main(["design", written(tmp_path, text), "-o", str(out), "--jobs", "1", "--no-cad"]) == 0
    (choice,) = json.loads((out / "design.json").read_text(encoding="utf-8"))["choices"]
    assert choice["starts"] == 2
    assert sorted(each["lengths_m"]["superstrate.thickness"] for each in choice["optima"]) == pytest.approx(
        [0.5e-3, 1e-3])
    assert read_chip(out / "best.toml").layer("sidewall").thickness.value == pytest.approx(0.74e-3, abs=1e-6)


@pytest.mark.parametrize(("options", "words"), [
    (["--jobs", "0"], "--jobs: received 0; expected a whole number, one or more"), (["--accuracy", "7"], "--accuracy")])
def test_mistakes_in_options_are_named(
    options: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["design", written(tmp_path), "-o", str(tmp_path / "out"), *options]) == 2
    assert words in capsys.readouterr().err
