"""Figures of straight chips: closed forms of a channel's field, derivatives, studies, tolerances, design."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support import half_wave_focus_time, quadratic, with_fields
from test_geometry_straight import CHIP, chip
from test_workbench_design_cavity import BEAD, WATER, lines

from geometry.measure import Measure, Parity, Straight
from workbench.acoustics.nodal import integrate
from workbench.acoustics.traps import focus_time
from workbench.design.cavity import OF_FLUID, Cavity, CavityField, cavity_field
from workbench.design.evaluation import Evaluation, Operation
from workbench.design.goal import read_goal
from workbench.design.model import DesignModel, design_model, full_evaluation
from workbench.design.optimisation import optimise
from workbench.design.parts import ReducedModels, numbers_by_name, parts_of
from workbench.design.plan import read_study
from workbench.design.tolerance import tolerance
from workbench.design.trapping import find_trap, largest_square, trap_focus_time
from workbench.fem.dual import Dual
from workbench.jobs.progress import no_progress
from workbench.model.drive import Drive, PowerDrive, VoltageDrive
from workbench.model.particles import viscous_scattering
from workbench.simulation.run import snapshot

Real = NDArray[np.float64]

COARSE = quadratic(3.0)
BAND = (1.75e6, 2.2e6)
FIGURES = ("f0", "z_min", "q", "power", "p0", "e_ac", "mean_e_ac", "loss.cavity", "heating")
#: One watt, and one volt of amplitude.
WATT, VOLT = PowerDrive(1.0), VoltageDrive(2.0)
WARM = {"": 2.0}

# --------------------------------------------------------------------------------------------------------------------
# Closed forms

WIDTH, HEIGHT, AMPLITUDE = 380e-6, 160e-6, 1e5
WAVE = math.pi / WIDTH
FREQUENCY = WAVE * WATER.sound_speed / (2.0 * math.pi)
ENERGY = AMPLITUDE**2 / (4.0 * WATER.density * WATER.sound_speed**2)


def standing(
    measure: Measure, shape: Callable[[Real], Real], frequency: float = FREQUENCY, width: float = WIDTH
) -> CavityField:
    """A wave across a channel, in its right half or in the whole; the width of the device is a parameter."""
    begin = 0.0 if measure.mirror else -0.5 * width
    x, z = begin + lines(0.5 * width - begin, 4), lines(HEIGHT, 2)
    cavity = Cavity(np.zeros((x.size, z.size), dtype=np.int64), Dual(x, (x / width)[None]),
                    Dual(z, np.zeros((1, z.size))), WATER, BEAD, ("cavity.width",), np.array([width]), WAVE, measure)
    pressure = AMPLITUDE * np.outer(shape(math.pi / width * x), np.ones(z.size)).astype(complex)
    nothing = np.zeros(1)
    around = {"frequency": Dual(frequency, nothing), "width": Dual(width, np.ones(1)), "height": Dual(HEIGHT, nothing),
              **{name: Dual(getattr(WATER, name), nothing) for name in OF_FLUID}}
    return cavity_field(cavity, pressure, np.zeros((*pressure.shape, 1)), around, np.zeros(1), np.eye(1))


@pytest.mark.parametrize("parity", [Parity.ODD, Parity.NONE])
def test_half_a_wave_across_a_channel_has_its_energy_and_its_trap_in_the_middle(parity: Parity) -> None:
    found = standing(Straight(1.0, parity), np.sin)
    # Elements of order 4 hold a half wave to 1e-6.
    assert found.unfitted < 1e-6
    assert found.mean_energy_density.value == pytest.approx(ENERGY, rel=1e-6)
    assert largest_square(found).value == pytest.approx(AMPLITUDE**2, rel=1e-6)
    trap = find_trap(found)
    assert abs(trap.radius.value) < 1e-6 * WIDTH
    contrast = viscous_scattering(BEAD, WATER, FREQUENCY).contrast_factor
    assert trap.radial.value == pytest.approx(8.0 * math.pi * BEAD.radius**3 * WAVE**2 * ENERGY * contrast, rel=1e-5)
    expected = half_wave_focus_time(BEAD, WATER, contrast, energy_density=ENERGY, wavenumber=WAVE, start=0.45 * WIDTH,
                                    stop=0.05 * WIDTH)
    assert trap_focus_time(trap, Dual(1.0, np.zeros(1))).value == pytest.approx(expected, rel=1e-5)
    # The pressure stays, the velocity goes with 1 / W: both are half of the energy at one frequency.
    assert found.mean_energy_density.gradient[0] == pytest.approx(-ENERGY / WIDTH, rel=1e-5)


@pytest.mark.parametrize("parity", [Parity.EVEN, Parity.NONE])
def test_a_whole_wave_across_a_channel_has_traps_a_quarter_of_its_width_from_the_middle(parity: Parity) -> None:
    found = standing(Straight(1.0, parity), lambda phase: np.cos(2.0 * phase), 2.0 * FREQUENCY)
    assert found.mean_energy_density.value == pytest.approx(ENERGY, rel=1e-4)
    trap = find_trap(found)
    # Four elements of order 4 on a wave leave 1e-5 of it; of the two traps a half has the right one.
    assert abs(trap.radius.value) == pytest.approx(0.25 * WIDTH, rel=1e-4)
    assert trap.radius.value > 0.0 or parity is Parity.NONE
    assert trap.radius.gradient[0] == pytest.approx(trap.radius.value / WIDTH, rel=1e-4)


@pytest.mark.parametrize(("parity", "frequency"), [(Parity.NONE, 0.9 * FREQUENCY), (Parity.ODD, 1.2 * FREQUENCY)])
def test_a_bead_comes_from_the_side_wall_or_from_a_quarter_wave_beside_the_trap(
    parity: Parity, frequency: float
) -> None:
    """The time has the derivative of its differences by the width, over which the wave is stretched."""
    def time(width: float) -> Dual:
        found = standing(Straight(1.0, parity), np.sin, frequency, width)
        return trap_focus_time(find_trap(found), Dual(1.0, np.zeros(1)))

    step = 1e-4 * WIDTH
    expected = (time(WIDTH + step).value - time(WIDTH - step).value) / (2.0 * step)
    assert time(WIDTH).gradient[0] == pytest.approx(expected, rel=1e-5)


# --------------------------------------------------------------------------------------------------------------------
# Figures of a chip


def of_symmetry(name: str) -> str:
    split = CHIP.replace('live = "bottom"', 'live = "bottom", live_inner_half_width = "0.3 mm"')
    return split.replace('symmetry = "even"', f'symmetry = "{name}"')


def full(
    text: str, values: dict[str, float] | None = None, *, drive: Drive = VOLT, gradient: bool = False,
    frequency: str = "f0", figures: tuple[str, ...] = FIGURES,
) -> Evaluation:
    return full_evaluation(chip(text), "filled", values or {}, figures=figures, band=BAND, points=81, gradient=gradient,
                           operation=Operation(drive, frequency, WARM), accuracy=COARSE)


@pytest.mark.parametrize("symmetry", ["even", "odd"])
def test_figures_are_those_of_the_fields_by_the_measure(symmetry: str) -> None:
    text = of_symmetry(symmetry)
    found = full(text).figures
    shot = snapshot(chip(text), "filled", found["f0"], band=BAND, drive=VOLT, accuracy=COARSE)
    mesh = shot.fields.mesh
    inside = mesh.nodes_of(["cavity"])
    largest = np.abs(shot.fields.pressure[inside]).max()
    energy = integrate(mesh, shot.fields.energy_density, ["cavity"]) / (380e-6 * 160e-6 * 0.02)
    print(f"{symmetry}: f0 {found['f0']:.6g} Hz, {found['e_ac']:.4g} J/m^3 at 1 V, mean {found['mean_e_ac']:.4g} and "
          f"{energy:.4g}, p0 {found['p0']:.5g} and {largest:.5g}")
    # One polynomial, or gradients recovered on a coarse mesh.
    assert found["mean_e_ac"] == pytest.approx(energy, rel=2e-2)
    assert found["p0"] == pytest.approx(largest, rel=1e-2)
    assert found["power"] == pytest.approx(shot.fields.power, rel=1e-4)
    total = sum(shot.losses.values())
    assert found["heating"] == pytest.approx(2.0 * total, rel=1e-4)
    # Energies of a linear chip go with the square of the voltage, hence with the power.
    at_one_watt = full(text, drive=WATT).figures
    assert at_one_watt["power"] == pytest.approx(1.0, rel=1e-6)
    for name in ("e_ac", "mean_e_ac"):
        assert at_one_watt[name] == pytest.approx(found[name] / found["power"], rel=1e-6)


def test_a_half_and_the_whole_have_the_same_figures() -> None:
    half, whole = (full(of_symmetry(name)).figures for name in ("even", "none"))
    # The whole section has other columns of cells about its middle, and both meshes are coarse.
    assert half == pytest.approx(whole, rel=1e-3)


RANGES = {"cavity.half_width": (1.8e-4, 2.0e-4), "superstrate.thickness": (0.47e-3, 0.53e-3)}


@cache
def modelled(symmetry: str) -> DesignModel:
    return design_model(chip(of_symmetry(symmetry)), "filled", RANGES, figures=FIGURES, band=BAND, points=41,
                        accuracy=COARSE, operation=Operation(drive=WATT, thermal_resistance=WARM))


@pytest.fixture(params=["even", "odd"])
def model(request: pytest.FixtureRequest) -> tuple[str, DesignModel]:
    return of_symmetry(request.param), modelled(request.param)


def test_a_model_has_the_figures_of_full_solves(model: tuple[str, DesignModel]) -> None:
    text, made = model
    values = {"cavity.half_width": 1.93e-4, "superstrate.thickness": 0.515e-3}
    found, expected = made(values).figures, full(text, values, drive=WATT, frequency="energy").figures
    off = {name: abs(found[name] / expected[name] - 1.0) for name in FIGURES}
    print(f"model of rank {made.bases.operating.size}: off by {max(off.values()):.1e} in {max(off, key=off.get)}")
    # Full solves are on a mesh of their own, made for the new lengths; both are coarse.
    assert off["f0"] < 1e-4
    assert max(off.values()) < 2e-2


def test_beads_are_timed_across_the_channel_as_in_the_field_itself() -> None:
    text = of_symmetry("odd").replace('cavity = "water"', 'cavity = "water"\nparticle = "polystyrene"\n'
                                      'particle_radius = "2.5 um"')
    made = design_model(chip(text), "filled", RANGES, figures=("focus_time",), band=BAND, points=41, accuracy=COARSE,
                        operation=Operation(drive=VOLT, frequency=1.95e6))
    here = {"cavity.half_width": 1.9e-4, "superstrate.thickness": 0.5e-3}
    found = made(here, gradient=True)
    shot = snapshot(chip(text), "filled", 1.95e6, band=BAND, drive=VOLT, accuracy=COARSE)
    assert shot.traps is not None
    # Gradients are recovered on a coarse mesh.
    assert found.figures["focus_time"] == pytest.approx(focus_time(shot.traps), rel=3e-2)
    for column, (name, value) in enumerate(here.items()):
        ends = [made({**here, name: value * (1.0 + sign * 1e-4)}).figures["focus_time"] for sign in (1.0, -1.0)]
        expected = (ends[0] - ends[1]) / (2e-4 * value)
        assert found.gradient["focus_time"][column] == pytest.approx(expected, rel=1e-3)


def test_figures_have_the_derivatives_of_their_differences(model: tuple[str, DesignModel]) -> None:
    _, made = model
    here = {"cavity.half_width": 1.9e-4, "superstrate.thickness": 0.5e-3}
    found = made(here, gradient=True)
    for column, (name, value) in enumerate(here.items()):
        step = 1e-4 * value
        both = [made({**here, name: value + sign * step}).figures for sign in (1.0, -1.0)]
        for figure in FIGURES:
            expected = (both[0][figure] - both[1][figure]) / (2.0 * step) * value
            # The square of the step, times the change of a figure by the width of its resonance.
            assert found.gradient[figure][column] * value == pytest.approx(
                expected, rel=1e-3, abs=1e-4 * abs(found.figures[figure])), (figure, name)


def test_full_solves_have_the_gradient_of_their_differences() -> None:
    there, here, figures = of_symmetry("odd"), {"cavity.half_width": 1.9e-4}, ("peak_frequency", "peak_q", *FIGURES)
    asked = {"drive": WATT, "frequency": "energy", "figures": figures}
    found = full(there, here, gradient=True, **asked)
    both = [full(there, {"cavity.half_width": factor * 1.9e-4}, **asked).figures for factor in (1.0002, 0.9998)]
    for figure in figures:
        expected = (both[0][figure] - both[1][figure]) / 0.0004
        # Each on a mesh of its own, stretched alike; the square of the step, by the width of the peak, leaves 1e-3.
        assert found.gradient[figure][0] * 1.9e-4 == pytest.approx(
            expected, rel=3e-3, abs=1e-6 * abs(found.figures[figure])), figure


# --------------------------------------------------------------------------------------------------------------------
# Verbs

GOAL = """
[goal]
chip = "chip.toml"
state = "filled"
drive = "1 W"
maximise = "e_ac"
band = ["1.75 MHz", "2.2 MHz"]
constraints = ["superstrate.half_width - cavity.half_width >= 1.2 mm"]

[variables]
cavity.half_width = { from = "180 um", to = "195 um" }
superstrate.thickness = { from = "0.48 mm", to = "0.52 mm", step = "10 um" }

[search]
looked_at = 32
starts = 1
relative_error = "0.5 %"
"""


def in_folder(folder: Path, **files: str) -> Path:
    for name, text in files.items():
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    return folder


def test_the_width_of_a_channel_and_its_lid_are_designed_for_energy_per_watt(tmp_path: Path) -> None:
    goal = read_goal(in_folder(tmp_path, chip=CHIP, goal=GOAL) / "goal.toml")
    found = optimise(goal, accuracy=quadratic(2.0))
    assert found.best is not None, found.why_not
    before, best = found.before.figures["e_ac"], found.best
    off = max(abs(each) for each in best.differences.values())
    print(f"{before:.4g} to {best.after.figures['e_ac']:.4g} J/m^3 at 1 W by "
          f"{ {n: f'{1e6 * v:.4g} um' for n, v in best.candidate.lengths.items()} }; models off by {100 * off:.2g} %; "
          f"{found.seconds}")
    assert best.after.figures["e_ac"] > 1.05 * before
    assert off < 1e-2
    assert best.candidate.chip.measure == goal.chip.measure


STUDY = """
[study]
chip = "chip.toml"
figures = ["f0", "mean_e_ac", "e_ac"]
drive = "1 W"
accuracy = "5 %"
relative_error = "1 %"
confirm = 1
band = ["1.75 MHz", "2.2 MHz"]

[sample]
method = "sobol"
points = 16
seed = 1

[vary]
"cavity.half_width" = { from = "185 um", to = "195 um" }
"superstrate.thickness" = { tolerance = "10 um" }
"soda_lime_glass.shear_modulus" = { tolerance = "2 %" }
"""


def test_a_study_of_a_straight_chip_is_confirmed(tmp_path: Path) -> None:
    plan = with_fields(read_study(in_folder(tmp_path, chip=CHIP, study=STUDY) / "study.toml"), accuracy=quadratic(2.0))
    (part,), models = parts_of(plan), ReducedModels()
    made = models.model(plan, part, tmp_path / "0.npz", no_progress)
    points = [made(numbers_by_name(plan, point)).figures for point in part.points]
    assert len(points) == 16
    assert np.isfinite([list(each.values()) for each in points]).all()
    full = models.confirmed(plan, part, part.points[5]).figures
    off = {name: points[5][name] / full[name] - 1.0 for name in full}
    print(f"model off by {off}")
    # The full solve is on a mesh of its own, and both are coarse.
    assert max(map(abs, off.values())) < 2e-2


def test_tolerances_of_half_widths_give_sensitivities_and_a_yield() -> None:
    text = CHIP.replace('cavity_width = "380 um"', 'cavity_width = { value = "380 um", tolerance = "4 um" }')
    found = tolerance(chip(text), "filled", ["f0 within 40 kHz of 2.09 MHz", "mean_e_ac >= 1 J/m^3 at 1 W"],
                      band=BAND, samples=64, accuracy=quadratic(2.0))
    assert set(found.sensitivities.names) >= {"cavity.half_width", "transducer.half_width"}
    assert found.yields is not None
    print(found.yields.together.sampled, found.model)
    assert found.yields.together.sampled.samples == 64
    assert found.findings


def test_half_widths_of_a_whole_section_vary_as_those_of_its_half() -> None:
    values = {"cavity.half_width": 1.93e-4, "superstrate.thickness": 0.515e-3}
    half, whole = (modelled(each)(values, gradient=True) for each in ("even", "none"))
    # The whole section has other columns of cells about its middle, and both meshes are coarse.
    assert whole.figures == pytest.approx(half.figures, rel=1e-3)
    for name in ("f0", "mean_e_ac", "p0"):
        assert whole.gradient[name] == pytest.approx(half.gradient[name], rel=2e-2)
