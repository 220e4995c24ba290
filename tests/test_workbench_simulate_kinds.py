"""Runs of `simulate` that ended in nothing: a model nearly good enough, one state of two, branches that are none."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import workbench as wb
from geometry.chip import read_chip
from workbench.cli import main
from workbench.files.writing import write_json
from workbench.reduced.at_point import NotEnriched, reduced
from workbench.results.circuit import BranchCircuit
from workbench.results.resonances import listed
from workbench.results.spectrum import Origin, Spectrum
from workbench.simulation import run as simulation
from workbench.simulation import solved_spectrum

ROOT = Path(__file__).resolve().parent.parent
SMALL_CHIP = ROOT / "geometry" / "chips" / "small_campaign" / "chip.toml"
ROUGH = ("--points", "41", "--accuracy", "2 %", "--no-cad", "--no-pictures")


def nearly(estimate: float) -> object:
    """`reduced`, which gives up at that error with a rough model."""
    def gives_up(*arguments: object, **named: object) -> object:
        rough = {**named, "tolerance": 0.1, "first": 3, "confirmed": False}
        raise NotEnriched(estimate, 1e-4, 40, reduced(*arguments, **rough))  # type: ignore[arg-type]

    return gives_up


def test_a_model_that_nearly_reached_its_tolerance_is_used_and_said(monkeypatch: pytest.MonkeyPatch) -> None:
    chip = read_chip(SMALL_CHIP)
    monkeypatch.setattr(solved_spectrum, "reduced", nearly(1.2e-4))
    found = wb.simulate(chip, "filled", points=41, accuracy=2e-2)
    assert found.error > 1e-4
    assert f"{found.error:.1e}, above the requested 1e-04" in found.findings[0]
    monkeypatch.setattr(solved_spectrum, "reduced", nearly(2e-3))
    with pytest.raises(NotEnriched):
        wb.simulate(chip, "filled", points=41, accuracy=2e-2)


def test_a_state_that_fails_takes_no_finished_one_with_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    actual = simulation.simulate

    def fails(chip: wb.Chip, state: str | None = None, **named: object) -> wb.Simulation:
        if state == "empty":
            raise NotEnriched(1.0, 1e-4, 40)
        return actual(chip, state, **named)  # type: ignore[arg-type]

    monkeypatch.setattr("workbench.commands.states.simulate_state", fails)
    out = tmp_path / "out"
    assert main(["simulate", str(SMALL_CHIP), "-o", str(out), *ROUGH]) == 1
    assert "state empty: the reduced model is at an estimated relative error of 1" in capsys.readouterr().err
    record = json.loads((out / "merit.json").read_text())
    assert list(record["states"]) == ["filled"]
    assert (out / "report.html").exists()
    assert (out / "INCOMPLETE.txt").exists()


def test_a_resistor_in_parallel_and_a_branch_beyond_the_band_are_no_resonances() -> None:
    frequency = np.linspace(0.9e6, 1.1e6, 41)
    spectrum = Spectrum(frequency, -1j / (2.0 * np.pi * frequency * 1e-9), origin=Origin("simulated", "test"))
    # f, Q: a resonance, a resistor with a huge capacitance, a branch above the band, one of infinite frequency.
    branches = np.array([[math.log(f), math.log(q), math.log(50e-12), 0.0] for f, q in (
        (1e6, 80.0), (1.0429e6, 2e-12), (5.2e6, 50.0), (1e300, 50.0))])
    assert listed(BranchCircuit(spectrum, branches, np.array([math.log(1e-9), 0.0, 0.0]))) == [0]


def test_a_number_that_json_has_not_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"a\.json: states\.filled\.q\[1\] is inf"):
        write_json(tmp_path / "a.json", {"states": {"filled": {"q": [1.0, float("inf")]}}})
    assert not (tmp_path / "a.json").exists()
