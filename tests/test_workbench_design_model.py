"""Figures of reduced and of full models: against `simulate`, against their own differences, against each other."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geometry.chip import Chip, State, read_chip
from materials.registry import Registry
from workbench.acoustics.traps import focus_time
from workbench.design.bases import OF_PRESSURE, NotConfirmed
from workbench.design.evaluation import Evaluation, Operation
from workbench.design.figures import FIGURES
from workbench.design.model import DesignModel, design_model, full_evaluation, load_design_model, of_range_model
from workbench.files.errors import InputError
from workbench.model.drive import GeneratorDrive, PowerDrive
from workbench.model.numbers import real_part
from workbench.reduced.ranges import OutOfRange
from workbench.simulation.run import simulate

#: The published losses of the disc are rounded.
pytestmark = pytest.mark.filterwarnings("ignore::materials.PassivityWarning")

PMMA, WATER = "pmma/acevedo_2026", "water/iapws_2011"
ROOT = Path(__file__).resolve().parent.parent
CHIP, REFERENCE = ROOT / "examples" / "small_study" / "chip.toml", ROOT / "geometry" / "chips" / "reference_chip.toml"
COARSE = 5e-3
LOSS = f"{PMMA}.shear_modulus.loss"
#: All figures of the catalogue and two shares of the losses.
ALL = (*FIGURES, "loss.substrate", "loss.transducer")
WARM = Operation(frequency="f0", thermal_resistance={"substrate": 3.0, "": 1.0})
TOLERANCE = 1e-3


@pytest.fixture(scope="module")
def chip() -> Chip:
    found = read_chip(CHIP)
    return replace(found, states=(State("empty", "vacuum"), *found.states))


@pytest.fixture(scope="module")
def model(chip: Chip) -> DesignModel:
    own = Registry().load(PMMA).parameters()["shear_modulus"].imag
    ranges = {"sidewall.thickness": (0.71e-3, 0.73e-3), "cavity.radius": (2.45e-3, 2.55e-3),
              LOSS: (1.05 * own, 0.95 * own)}
    return design_model(chip, "filled", ranges, figures=ALL, operation=WARM, points=81, relative_error=TOLERANCE,
                        accuracy=COARSE)


def full(chip: Chip, values: dict[str, float], **options: object) -> Evaluation:
    return full_evaluation(chip, "filled", values, figures=ALL, operation=WARM, points=81,
                           accuracy=COARSE, **options)


def test_figures_of_a_full_evaluation_are_those_of_a_simulation() -> None:
    chip = read_chip(REFERENCE)
    chip = replace(chip, states=(replace(chip.state("filled"), particle="polystyrene", particle_radius=5e-6),))
    found = full(chip, {}).figures
    run = simulate(chip, "filled", accuracy=COARSE, at="f0")
    trap, excitation = run.traps.traps[0], run.traps.excitation
    # On the model, or on points of its spectrum: its interpolant is good to 1e-5.
    assert found["f0"] == pytest.approx(run.figures.f0, rel=1e-7)
    peak = run.operating.peaks[0]
    assert found["peak_frequency"] == pytest.approx(peak.frequency, rel=1e-7)
    assert found["peak_q"] == pytest.approx(peak.q, rel=1e-3)
    assert (found["z_min"], found["q"]) == pytest.approx((run.figures.z_min, run.figures.q), rel=2e-4)
    assert found["power"] == pytest.approx(run.fields.power, rel=1e-4)
    # One polynomial, or gradients recovered on a coarse mesh: both leave some tenths of a per cent.
    assert found["p0"] == pytest.approx(excitation.pressure_amplitude, rel=5e-3)
    assert found["e_ac"] == pytest.approx(excitation.energy_density, rel=1e-2)
    assert found["mean_e_ac"] == pytest.approx(excitation.mean_energy_density, rel=1e-2)
    floor = chip.holes[0].z_bottom
    assert found["trap_height"] == pytest.approx(trap.height - floor, abs=1e-6)
    assert found["trap_radius"] == pytest.approx(trap.radius, abs=5e-6)
    assert found["trap_depth"] == pytest.approx(trap.depth, rel=2e-2)
    assert found["axial_stiffness"] == pytest.approx(trap.axial_stiffness, rel=3e-2)
    assert found["focus_time"] == pytest.approx(focus_time(run.traps), rel=2e-2)
    shares = {place: power / sum(run.losses.values()) for place, power in run.losses.items()}
    assert found["loss.substrate"] == pytest.approx(shares["substrate"], rel=1e-4)
    warm = sum(power * (3.0 if place == "substrate" else 1.0) for place, power in run.losses.items())
    assert found["heating"] == pytest.approx(warm, rel=1e-3)


def test_a_design_model_gives_the_figures_of_full_solves(chip: Chip, model: DesignModel) -> None:
    assert model.bases.error <= TOLERANCE
    assert model.bases.pressure_error <= OF_PRESSURE * TOLERANCE
    values = {"sidewall.thickness": 0.713e-3, "cavity.radius": 2.53e-3}
    small, exact = model(values), full(chip, values)
    for name in ("f0", "z_min", "q", "power", "heating", "loss.substrate"):
        # The mesh is another one: what it leaves comes in.
        assert small.figures[name] == pytest.approx(exact.figures[name], rel=3e-3), name
    for name in ("p0", "e_ac", "mean_e_ac", "trap_depth", "axial_stiffness", "focus_time"):
        assert small.figures[name] == pytest.approx(exact.figures[name], rel=2e-2), name
    assert small.figures["trap_height"] == pytest.approx(exact.figures["trap_height"], abs=1e-6)
    assert small.frequency == small.figures["f0"]
    assert not small.missing


def test_a_quotient_is_that_of_its_parts_whether_they_are_asked_for_or_not(model: DesignModel) -> None:
    whole = model({}).figures
    assert whole["depth_per_kelvin"] == pytest.approx(whole["trap_depth"] / whole["heating"], rel=1e-12)
    alone = replace(model, figures=("depth_per_kelvin",))({})
    assert alone.figures == {"depth_per_kelvin": pytest.approx(whole["depth_per_kelvin"], rel=1e-12)}
    cold = replace(model, figures=("depth_per_kelvin",), operation=replace(model.operation, thermal_resistance={}))({})
    assert cold.missing == {"depth_per_kelvin": "no thermal resistance is stated"}


def differences(of: object, point: dict[str, float], step: float) -> dict[str, np.ndarray]:
    """Derivatives by central differences of fourth order."""
    found: dict[str, list[float]] = {name: [] for name in ALL}
    for name, value in point.items():
        ends = [of({**point, name: value * (1.0 + k * step)}).figures for k in (-2, -1, 1, 2)]
        for each in ALL:
            a, b, c, d = (end[each] for end in ends)
            found[each].append((a - 8.0 * b + 8.0 * c - d) / (12.0 * step * value))
    return {name: np.array(slopes) for name, slopes in found.items()}


def test_gradients_are_exact(model: DesignModel) -> None:
    point = {name: real_part(model.values, name) for name in model.names}
    found = model(point, gradient=True)
    slopes = differences(model, point, 1e-4)
    for name in ALL:
        # By how much a figure changes over the step: what roots and rounding leave of that is 1e-5.
        scale = np.abs(found.gradient[name] * np.array(list(point.values()))).max()
        off = np.abs((found.gradient[name] - slopes[name]) * np.array(list(point.values()))).max()
        assert off <= 2e-5 * scale + 1e-9 * abs(found.figures[name]), name


@pytest.mark.parametrize("drive", [GeneratorDrive(10.0), PowerDrive(0.5)])
def test_gradients_follow_the_drive_and_a_stated_frequency(model: DesignModel, drive: object) -> None:
    point = {name: real_part(model.values, name) for name in model.names}
    f0 = model(point).figures["f0"]
    for frequency in ("energy", "f0", f0 + 500.0):
        driven = replace(model, operation=replace(WARM, drive=drive, frequency=frequency))
        found = driven(point, gradient=True)
        expected = {"energy": found.figures["peak_frequency"], "f0": f0}.get(frequency, f0 + 500.0)
        assert found.frequency == pytest.approx(expected, rel=1e-9)
        slopes = differences(driven, point, 1e-4)
        for name in ("peak_frequency", "peak_q", "voltage", "power", "mean_e_ac", "focus_time", "heating"):
            scale = np.abs(found.gradient[name] * np.array(list(point.values()))).max()
            off = np.abs((found.gradient[name] - slopes[name]) * np.array(list(point.values()))).max()
            assert off <= 2e-5 * scale + 1e-9 * abs(found.figures[name]), (name, frequency)
    if isinstance(drive, PowerDrive):
        assert driven(point).figures["power"] == pytest.approx(0.5, rel=1e-9)


def test_gradients_of_a_full_evaluation_are_those_of_the_reduced_model(chip: Chip, model: DesignModel) -> None:
    point = {name: real_part(model.values, name) for name in model.names}
    exact, small = full(chip, point, gradient=True), model(point, gradient=True)
    for name in ("f0", "z_min", "q", "mean_e_ac", "loss.substrate"):
        scale = np.abs(exact.gradient[name] * np.array(list(point.values()))).max()
        off = np.abs((exact.gradient[name] - small.gradient[name]) * np.array(list(point.values()))).max()
        # The states' derivatives are of first order in what the basis leaves out.
        assert off <= 2e-2 * scale, name


def test_the_fluid_counts_where_it_moves(chip: Chip) -> None:
    # Density and sound speed come into energy, potential and force besides the pressure.
    sound = Registry().load(WATER, temperature=293.15).sound_speed
    tiny = design_model(chip, "filled", {f"{WATER}.sound_speed": (0.999 * sound, 1.001 * sound)}, figures=ALL,
                        operation=WARM, points=81, accuracy=COARSE)
    found = tiny({}, gradient=True)
    slopes = differences(tiny, {f"{WATER}.sound_speed": sound}, 1e-4)
    for name in ("mean_e_ac", "e_ac", "trap_depth", "axial_stiffness", "focus_time"):
        assert found.gradient[name] == pytest.approx(slopes[name], rel=1e-4), name


def test_a_model_goes_to_another_process(model: DesignModel) -> None:
    there = pickle.loads(pickle.dumps(model))
    assert there.range_model is None
    assert there({}).figures == model({}).figures
    with pytest.raises(ValueError, match="sent to another process"):
        there.spectrum()
    assert model.spectrum().frequency.size == 81


def test_a_model_is_kept_and_read_for_its_own_chip_only(chip: Chip, model: DesignModel, tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    model.save(path)
    asked = {"figures": model.figures, "operation": model.operation, "registry": Registry(), "accuracy": COARSE}
    again = load_design_model(path, chip, "filled", model.ranges, **asked)
    ends = {name: high for name, (_, high) in model.ranges.items()}
    for point in ({}, ends):
        kept, made = again(point, gradient=True), model(point, gradient=True)
        assert kept.figures == made.figures
        assert (kept.missing, kept.frequency, kept.error) == (made.missing, made.frequency, made.error)
        assert all(np.array_equal(kept.gradient[name], made.gradient[name], equal_nan=True) for name in made.figures)
    assert (again.names, again.error) == (model.names, model.error)
    with pytest.raises(InputError, match=r"chip: received .*expected the chip, state, materials and mesh"):
        load_design_model(path, chip.with_dimensions({"substrate.radius": 4.99e-3}), "filled", model.ranges, **asked)
    with pytest.raises(ValueError, match="cannot be saved"):
        again.save(path)
    path.write_bytes(pickle.dumps(again))
    with pytest.raises(InputError, match=r"model\.npz: content: received 'no digest at its end'"):
        load_design_model(path, chip, "filled", model.ranges, **asked)


def test_what_is_missing_says_why(chip: Chip, model: DesignModel) -> None:
    made = model.range_model
    empty = design_model(chip, "empty", {"cavity.radius": (2.49e-3, 2.51e-3)}, figures=("f0", "p0", "heating"),
                         points=41, accuracy=COARSE)
    found = empty({})
    assert np.isnan(found.figures["p0"])
    assert "no fluid" in found.missing["p0"]
    assert "no thermal resistance" in found.missing["heating"]
    assert np.isfinite(found.figures["f0"])
    bare = replace(chip, states=tuple(replace(s, particle=None, particle_radius=None) for s in chip.states))
    without = of_range_model(made, bare, "filled", figures=("p0", "trap_height"))({})
    assert "names no particle" in without.missing["trap_height"]
    assert np.isfinite(without.figures["p0"])
    # At the edge of the band there is no resonance, and so no frequency to drive at.
    aside = full_evaluation(chip, "filled", {}, figures=("f0", "p0"), band=(0.95e6, 0.97e6), points=21,
                            accuracy=COARSE)
    assert np.isnan(aside.frequency)
    assert "edge of the band" in aside.missing["p0"]


def test_bad_questions(chip: Chip, model: DesignModel) -> None:
    with pytest.raises(InputError, match="did you mean 'e_ac'"):
        full_evaluation(chip, "filled", {}, figures=("e_acc",))
    with pytest.raises(InputError, match="every figure once"):
        full_evaluation(chip, "filled", {}, figures=("f0", "f0"))
    with pytest.raises(InputError, match=r"sidewall\.thickness"):
        full_evaluation(chip, "filled", {"sidewal.thickness": 1e-3}, figures=("f0",))
    with pytest.raises(InputError, match="did you mean"):
        full_evaluation(chip, "filled", {f"{PMMA}.sheer_modulus": 1e9}, figures=("f0",), accuracy=COARSE)
    with pytest.raises(OutOfRange, match="the range of the model is"):
        model({"cavity.radius": 5e-3})
    with pytest.raises(KeyError, match="no range for"):
        model({"cavity.height": 3e-3})


def test_a_band_without_a_resonance_is_named(chip: Chip) -> None:
    with pytest.raises(InputError, match="band: received '5 to 10 kHz'; expected a band in which the chip"):
        design_model(chip, "filled", {"substrate.thickness": (0.98e-3, 1.02e-3)}, figures=("f0",), band=(5e3, 10e3),
                     accuracy=COARSE)


def test_a_model_that_full_solves_refute_is_refused(model: DesignModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("workbench.design.bases.ROUNDS", 1)
    with pytest.raises(NotConfirmed, match="narrow the ranges") as refusal:
        of_range_model(model.range_model, model.chip, "filled", figures=("f0", "p0"), relative_error=1e-7)
    assert pickle.loads(pickle.dumps(refusal.value)).error == refusal.value.error
