"""Figures under their names: kt, kp and k_eff; f0 and Q of weak resonances; losses in parallel; C0 of a band."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from support import DISC, STACK

import workbench as wb
from geometry.dimension import Dimension
from geometry.parts import ElectrodeDisc, Electrodes
from materials.registry import Registry
from workbench.cli import main
from workbench.model.problem import FilledChip, fill
from workbench.reduced.at_point import NotEnriched, reduced
from workbench.report.figures import figures_record, figures_rows, figures_table
from workbench.report.resonances import misfit, resonances_record, resonances_table
from workbench.results.circuit import BranchCircuit, CircuitFit, FittedNumber
from workbench.results.coupling import Plate, planar_coupling, planar_root, plate_of, thickness_coupling
from workbench.results.merit import named
from workbench.simulation import solved_spectrum

#: A soft disc of 35 x 2 mm, as a chip file.
WIDE = """
[chip]
name = "wide disc"
band = ["40 kHz", "130 kHz"]

[[layers]]
role = "transducer"
material = "pzt5a/erturk_2011"
thickness = "2 mm"
radius = "17.5 mm"
"""


def weak(q: float, k: float, *, tangent: float = 0.0, frequency: Any = None, fs: float = 1e6) -> wb.Spectrum:
    """A branch beside 2 nF, whose loss `tangent` is a loss in parallel."""
    f = np.linspace(0.875e6, 1.125e6, 801) if frequency is None else frequency
    u, c0 = f / fs, 2e-9
    return wb.Spectrum(f, 1.0 / (2j * np.pi * f * c0 * (1.0 - 1j * tangent + k * k / (1.0 - k * k) / (
        1.0 - u**2 + 1j * u / q))))


def chip_of(text: str, folder: Path) -> wb.Chip:
    path = folder / "chip.toml"
    path.write_text(text)
    return wb.read_chip(path)


def plate(chip: wb.Chip) -> Plate | None:
    return plate_of(chip, fill(chip, None, Registry()).materials)


# ---- coupling factors


def test_the_planar_coupling_factor_solves_the_resonance_equation_of_a_thin_disc() -> None:
    """x1 of nu = 0.31 is 2.055 (IEEE Std 176). The usual approximation kp^2 = 2.51 d - d^2 with d = (fp - fs) / fp is
    within 1.5 % of kp; the ratio of the mode that the equation itself has is recovered to rounding."""
    assert planar_root(0.31) == pytest.approx(2.0551, rel=1e-4)
    for apart in (0.05, 0.1, 0.154, 0.2):
        assert planar_coupling(1.0 - apart, 1.0, 0.31) == pytest.approx(math.sqrt(2.51 * apart - apart**2), rel=0.015)
    assert planar_coupling(0.999999, 1.0, 0.31) == pytest.approx(0.0, abs=2e-3)


def test_a_wide_disc_has_kp_in_its_radial_mode_and_kt_in_its_thickness_mode(tmp_path: Path) -> None:
    """Of the material kp is 0.60 (data sheet) and kt sqrt(e33^2 / (c33D eps33S)) = 0.485: within 2 %."""
    chip = chip_of(WIDE, tmp_path)
    radial = wb.simulate(chip, accuracy=2e-2, points=121).figures
    through = wb.simulate(chip, accuracy=2e-2, points=241, band=(0.9e6, 1.2e6)).figures
    assert radial is not None
    assert radial.antiresonance is not None
    assert through is not None
    assert through.antiresonance is not None
    assert math.isnan(radial.antiresonance.kt)
    assert radial.antiresonance.kp == pytest.approx(0.60, rel=0.02)
    assert radial.antiresonance.k_effective == pytest.approx(0.533, rel=0.01)
    assert through.antiresonance.kt == pytest.approx(0.485, rel=0.02)
    assert math.isnan(through.antiresonance.kp)
    table = figures_table(figures_rows("a", radial) + figures_rows("b", through))
    assert table.columns == ("", "f0 (MHz)", "Z_min (ohm)", "Q", "k_eff", "kt", "kp")
    assert [row[5:] for row in table.rows] == [("", "0.605"), ("0.492", "")]
    assert ("kt" in figures_record(radial, ""), "kp" in figures_record(radial, "")) == (False, True)
    assert figures_table(figures_rows("a", None)).columns[-1] == "k_eff"


def test_nothing_else_has_kt_or_kp(tmp_path: Path) -> None:
    wide = chip_of(WIDE, tmp_path)
    assert plate(wide) is not None
    assert plate(chip_of(STACK, tmp_path)) is None
    assert plate(chip_of(DISC, tmp_path)) is None, "3 mm of radius at 2 mm of thickness"
    small = ElectrodeDisc(radius=Dimension(8e-3))
    assert plate(replace(wide, electrodes=Electrodes(live_disc=small))) is None
    ring = ElectrodeDisc(inner_radius=Dimension(2e-3))
    assert plate(replace(wide, electrodes=Electrodes(ground_disc=ring))) is None
    bored = replace(wide, layers=(replace(wide.layers[0], bore=Dimension(2e-3)),))
    assert plate(bored) is None


def test_a_mode_beside_those_of_the_plate_has_no_name() -> None:
    of = Plate((0.97e6, 1.08e6), 57e3, 0.35)
    for fs, k in ((0.97e6, 0.45), (57e3, 0.53), (0.4e6, 0.3), (1.3e6, 0.2)):
        f = np.linspace(0.8 * fs, 1.4 * fs, 2001)
        merit = named(wb.figures(weak(300.0, k, frequency=f, fs=fs)), of)
        assert merit is not None
        assert merit.antiresonance is not None
        assert math.isfinite(merit.antiresonance.kt) == (fs == 0.97e6)
        assert math.isfinite(merit.antiresonance.kp) == (fs == 57e3)


def test_a_straight_plate_has_kt_and_no_kp(tmp_path: Path) -> None:
    straight = WIDE.replace('name = "wide disc"', 'name = "plate"\ngeometry = "straight"\nlength = "35 mm"').replace(
        'radius = "17.5 mm"', 'half_width = "17.5 mm"')
    found = plate(chip_of(straight, tmp_path))
    assert found is not None
    assert found.planar_mode is None
    assert math.isnan(found.planar_coupling(57e3, 67e3))
    assert found.thickness_coupling(*found.thickness_mode) == pytest.approx(0.485, rel=0.01)
    assert found.thickness_coupling(*found.thickness_mode) == thickness_coupling(*found.thickness_mode)


# ---- weak resonances


@pytest.mark.parametrize(("q", "k"), [(30.0, 0.3), (30.0, 0.2), (60.0, 0.15), (30.0, 0.15), (60.0, 0.1), (200.0, 0.05)])
def test_the_conductance_has_the_frequency_and_q_of_a_weak_resonance(q: float, k: float) -> None:
    """A parabola over three points of a 32nd of the step: 1e-6 of f, 1e-4 of Q. k_eff by the largest Re Z: 1 %."""
    found = wb.figures(weak(q, k))
    assert found.is_weak
    assert found.conductance is not None
    assert found.antiresonance is not None
    assert found.conductance.frequency == pytest.approx(1e6, rel=1e-6)
    assert found.conductance.q == pytest.approx(q, rel=1e-4)
    assert found.conductance.merit == pytest.approx(q * k * k / (1.0 - k * k), rel=1e-4)
    assert found.antiresonance.k_effective == pytest.approx(k, rel=0.02)
    assert found.q < 0.9 * q
    first, second = figures_rows("disc", found)
    assert first[0][:1] == ("disc, by the conductance",)
    assert (first[0][1], float(first[0][3])) == ("1.0000", pytest.approx(q, rel=1e-3))
    assert second[0][0] == "disc, dip of |Z|"
    assert f"these are 1.0000 MHz and {q:g}, by the conductance Re Y" in found.weakness
    record = figures_record(found, "")
    assert record["is_weak"] is True
    assert record["conductance"]["q"] == pytest.approx(q, rel=1e-4)


def test_a_strong_resonance_is_that_of_the_dip() -> None:
    found = wb.figures(weak(60.0, 0.45))
    assert not found.is_weak
    assert found.weakness == ""
    assert found.q == pytest.approx(60.0, rel=0.01)
    assert [row[0] for row, _ in figures_rows("disc", found)] == ["disc"]


def test_overlapping_resonances_are_not_called_weak() -> None:
    """Im Y between the peaks of a split mode is that of its halves: M would be 2.5 at the peak, and is above 10."""
    f = np.linspace(0.93e6, 1.2e6, 1201)
    split = sum(0.03 / (1.0 - (f / at)**2 + 1j * f / at / 200.0) for at in (1.0e6, 1.006e6))
    found = wb.figures(wb.Spectrum(f, 1.0 / (2j * np.pi * f * 2e-9 * (1.0 + 0.06 / (
        1.0 - (f / 0.995e6)**2 + 1j * f / 0.995e6 / 150.0) + split))))
    assert found.conductance is not None
    assert found.conductance.merit > 10.0
    assert not found.is_weak


def test_a_loss_in_parallel_hides_no_q() -> None:
    """A tangent of 0.004 is 0.7 % of the peak of Re Y at M = 0.6, and widens it by as much."""
    found = wb.figures(weak(60.0, 0.1, tangent=0.004)).conductance
    assert found is not None
    assert found.q == pytest.approx(60.0, rel=0.01)


def test_a_conductance_without_half_width_says_that_the_branch_has_it() -> None:
    """The half width of Re Y ends at 1.0167 MHz, that of the dip at 1.0090."""
    found = wb.figures(weak(30.0, 0.3, frequency=np.linspace(0.9e6, 1.012e6, 401)))
    assert found.is_weak
    assert found.conductance is not None
    assert math.isnan(found.conductance.q)
    assert found.weakness.endswith("the fitted branch of the circuit has these")
    assert len(figures_rows("disc", found)) == 1
    assert figures_record(found, "")["conductance"]["q"] is None


def test_a_comparison_of_weak_resonances_begins_with_what_is_right() -> None:
    found = wb.compare(weak(80.0, 0.1), weak(70.0, 0.1))
    assert [row.metric for row in found.rows] == [
        "fs (Hz), by the conductance", "Q, by the conductance", "f0 (Hz)", "Z_min (ohm)", "Q factor"]
    assert (found.rows[1].measured, found.rows[1].simulated) == pytest.approx((80.0, 70.0), rel=1e-3)


def test_compare_says_that_a_recording_is_weak(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    chip, recording, out = tmp_path / "disc.toml", tmp_path / "weak.csv", tmp_path / "out"
    chip.write_text(WIDE.replace("17.5 mm", "7 mm").replace('"40 kHz", "130 kHz"', '"0.9 MHz", "1.1 MHz"'))
    wb.write_spectrum(weak(60.0, 0.1), recording)
    assert main(["compare", str(recording), str(chip), "--accuracy", "5 %", "-o", str(out)]) == 0
    shown = capsys.readouterr()
    assert "the recording: the resonance at 1.0000 MHz is weak" in " ".join(shown.err.split())
    measured = json.loads((out / "merit.json").read_text())["measured"]
    assert measured["is_weak"] is True
    assert measured["conductance"]["q"] == pytest.approx(60.0, rel=1e-3)
    assert "kt" not in measured
    assert "kt" not in shown.out


# ---- circuits


#: Modes (Hz, Q, k beside 1.2 nF) of a device, of which a band holds some.
MODES = ((0.55e6, 200.0, 0.2), (0.96e6, 300.0, 0.2), (1.04e6, 300.0, 0.25), (1.11e6, 300.0, 0.15), (1.19e6, 300.0, 0.1),
         (1.7e6, 200.0, 0.3), (3.0e6, 100.0, 0.35))


def device(low: float, high: float) -> wb.Spectrum:
    f = np.arange(low, high, 500.0)
    capacitance = 1.0 - 0.003j + sum(
        k * k / (1.0 - k * k) / (1.0 - (f / at)**2 + 1j * f / at / q) for at, q, k in MODES)
    return wb.Spectrum(f, 1.0 / (2j * np.pi * f * 1.2e-9 * capacitance))


def test_the_intervals_of_k_eff_in_different_bands_overlap() -> None:
    intervals = []
    for band in ((0.9e6, 1.15e6), (0.92e6, 1.15e6), (0.9e6, 1.08e6), (0.9e6, 1.25e6), (1.0e6, 1.15e6)):
        found = wb.fit_resonances(device(*band))
        (one,) = [each for each in found.resonances if abs(each.frequency.value - 1.04e6) < 2e3]
        intervals.append(one.k_eff.interval())
        # 1 % of it moves k_eff by less than 0.5 %: the rest is the background's.
        assert one.capacitance.value == pytest.approx(1.2e-9 * 0.25**2 / (1.0 - 0.25**2), rel=0.01)
        assert one.k_eff.standard_error < 0.15 * one.k_eff.value
    assert max(low for low, _ in intervals) < min(high for _, high in intervals)


def test_a_loss_in_parallel_is_the_shunt_and_no_resonance() -> None:
    found = wb.fit_resonances(weak(300.0, 0.2, tangent=0.02))
    assert len(found.resonances) == 1
    assert found.loss_tangent.value == pytest.approx(0.02, rel=1e-3)
    assert found.static_capacitance.value == pytest.approx(2e-9, rel=1e-4)
    assert "beside a shunt of 2000 ± " in misfit(found)
    assert "with a loss tangent of 0.02," in misfit(found)


def test_the_background_holds_whatever_is_not_listed() -> None:
    """A resistor as a branch of huge C and tiny Q: of no effect on the capacitance, Q w C of loss."""
    f = np.linspace(0.9e6, 1.1e6, 41)
    branches = np.array([[math.log(1e6), math.log(80.0), math.log(50e-12), 0.0],
                         [math.log(1e6), math.log(1e-12), math.log(10.0), 0.0]])
    made = BranchCircuit(wb.Spectrum(f, np.ones(41)), branches, np.array([math.log(1e-9), 0.0, 0.0]), squares=0.0,
                         covariance=np.zeros((11, 11)))
    found = made.fit([0])
    assert found.static_capacitance.value == pytest.approx(1e-9, rel=1e-9)
    assert found.loss_tangent.value == pytest.approx(1e-2, rel=1e-9)
    (one,) = found.resonances
    assert one.k_eff.value**2 == pytest.approx(50.0 / 1050.0, rel=1e-9)
    assert one.merit == pytest.approx(80.0 * 0.05, rel=1e-9)


def test_a_coupling_that_is_not_determined_is_said_and_is_json() -> None:
    """A background that is inductive at the resonance has no capacitance to couple with."""
    f = np.linspace(0.9e6, 1.1e6, 41)
    branches = np.array([[math.log(1e6), math.log(80.0), math.log(50e-12), 0.0],
                         [math.log(0.8e6), math.log(50.0), math.log(1e-9), 0.0]])
    made = BranchCircuit(wb.Spectrum(f, np.ones(41)), branches, np.array([math.log(1e-12), 0.0, 0.0]), squares=0.0,
                         covariance=np.zeros((11, 11)))
    found = made.fit([0])
    record = resonances_record(found)["resonances"][0]
    assert record["k_effective"] == [None, None]
    assert record["figure_of_merit"] is None
    json.dumps(record, allow_nan=False)
    (row,) = resonances_table({"a": found}).rows
    assert row[3:5] == ("not determined", "")


@pytest.mark.parametrize(("rms", "chi", "words"), [
    (0.01, None, "leaves 1 % of Z (rms), which is good: circuits that describe a spectrum leave less than 3 %"),
    (0.067, None, "leaves 6.7 % of Z (rms), which is poor: circuits that describe a spectrum leave less than 3 %"),
    (0.067, 1.21, "leaves 6.7 % of Z (rms), which is good: 1.1 times the stated noise"),
    (0.01, 9.0, "leaves 1 % of Z (rms), which is good: circuits")])
def test_a_misfit_is_good_or_poor(rms: float, chi: float | None, words: str) -> None:
    number = FittedNumber(1e-9, 1e-11)
    fit = CircuitFit((), number, FittedNumber(0.01, 0.0), FittedNumber(0.0, 0.0), weak(60.0, 0.1), rms, chi)
    assert words in misfit(fit)
    assert ("further off than their standard errors say" in misfit(fit)) == ("poor" in words)
    active = misfit(replace(fit, loss_tangent=FittedNumber(-0.28, 0.05)))
    assert "passive: the shunt (loss tangent -0.28 ± 0.05) would supply power" in active
    assert "good" not in active
    assert ("poor" in active) == ("poor" in words)
    assert "passive" not in misfit(replace(fit, loss_tangent=FittedNumber(-0.28, 0.2)))


def test_a_branch_of_negative_resistance_is_active() -> None:
    fit = wb.fit_resonances(weak(60.0, 0.3))
    assert fit.active == ()
    (one,) = fit.resonances
    fit = replace(fit, resonances=(replace(one, phase=FittedNumber(4.44, 0.13)),))
    (text,) = fit.active
    assert re.fullmatch(r"the branch at .* MHz \(phase 254 ± 7 degrees\)", text)
    assert replace(fit, resonances=(replace(one, phase=FittedNumber(1.6, 0.13)),)).active == ()


# ---- a model that is not good enough


def test_a_model_that_failed_names_its_state_and_the_remedies(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def gives_up(*arguments: Any, **given: Any) -> object:
        rough: Mapping[str, Any] = {**given, "tolerance": 0.1, "first": 3, "confirmed": False}
        raise NotEnriched(1.5e-3, 1e-4, 40, reduced(*arguments, **rough))

    monkeypatch.setattr(solved_spectrum, "reduced", gives_up)
    with pytest.raises(NotEnriched, match=r"for state default, --relative-error \"0.2 %\" \(in Python "
                                          r"relative_error=2e-03\).*--full.*--from and --to") as caught:
        wb.simulate(chip_of(WIDE, tmp_path), points=41, accuracy=2e-2)
    assert "vacuum" not in str(caught.value)
    gas = cast(FilledChip, SimpleNamespace(state=SimpleNamespace(name="empty", cavity="air"),
                                           materials={"cavity": Registry().load("air")}))
    assert 'cavity = "vacuum" in place of "air"' in solved_spectrum._remedy(gas, 1.2e-4)
    assert '--relative-error "0.02 %"' in solved_spectrum._remedy(gas, 1.2e-4)


def test_a_relative_error_is_read_in_per_cent_and_plain(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "chip.toml"
    path.write_text(WIDE)
    for text in ("0.02 %", "0.0002"):
        assert main(["simulate", str(path), "--relative-error", text, "--points", "21", "--accuracy", "5 %",
                     "--no-cad", "--no-pictures", "-o", str(tmp_path / "out")]) == 0
    assert main(["simulate", str(path), "--relative-error", "two", "-o", str(tmp_path / "out")]) != 0
    assert "--relative-error: received 'two'" in capsys.readouterr().err
