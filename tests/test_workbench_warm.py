"""A chip that its drive warms up: temperature and field as one fixed point, and the words for it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import workbench as wb
from geometry.chip import Chip, read_chip
from materials.registry import Registry
from workbench.acoustics.sound_energy import SoundEnergy
from workbench.cli import main
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import Solution, System
from workbench.files.errors import InputError
from workbench.model.drive import GeneratorDrive, PowerDrive, VoltageDrive, drive_up_to
from workbench.model.problem import Problem, build, fill
from workbench.model.temperature import law_of, warmer_problem, warmer_values
from workbench.simulation import fixed_point
from workbench.simulation.fixed_point import HeatPaths, Warmed, warmed
from workbench.simulation.gathering import gathering
from workbench.simulation.run import IN_STILL_AIR
from workbench.simulation.warm import WarmState, WarmUp

CHIPS = Path(__file__).resolve().parent.parent / "geometry" / "chips"
SILICON, GLASS, ROUND = (CHIPS / f"{name}.toml" for name in (
    "silicon_glass_channel", "glass_channel", "acevedo_2026_chip"))
#: The mesh of the table: that of an accuracy of 0.5 %.
ACCURACY = 5e-3


@cache
def model(path: Path, frequency: float) -> tuple[Problem, Solution]:
    """A chip at its stated temperature, and its full solution."""
    problem = build(fill(read_chip(path), "filled", Registry(assumed_losses=True)), accuracy=ACCURACY)
    return problem, System(assemble(problem.mesh, problem.terms), problem.values).solutions(np.array([frequency]))


@cache
def warm(path: Path, frequency: float, drive: str, up: WarmUp = IN_STILL_AIR) -> Warmed:
    return warmed(*model(path, frequency), wb.parse_drive(drive), up, registry=Registry())



def energy_density(solution: Solution, values: Mapping[str, complex]) -> NDArray[np.float64]:
    """The mean energy density (n,) J/m^3 in the cavity of full solutions at 1 V."""
    assert isinstance(solution.operators, FullOperators)
    return SoundEnergy.of(solution.operators).density(solution.frequency, solution.states, values)


def state_of(found: Warmed) -> WarmState:
    assert found.state is not None, found.reason
    return found.state


def test_the_numbers_of_a_warmer_liquid_are_those_of_its_entry() -> None:
    problem, _ = model(SILICON, 1.94e6)
    liquid = problem.materials["cavity"]
    law = law_of(liquid, Registry())
    assert law is not None
    assert law.highest == pytest.approx(25.0, abs=0.05)  # the bulk viscosity of water ends at 50 degC
    for rise in (0.7, 6.3, 23.9):
        values = warmer_values(problem, (law,), {liquid.name: rise})
        there = Registry().load(liquid.name, temperature=liquid.temperature + rise)
        for name, number in there.parameters().items():
            # A cubic through the law every 3 K.
            assert values[f"{liquid.name}.{name}"] == pytest.approx(number, rel=1e-5)
        made = warmer_problem(problem, (law,), {liquid.name: rise})
        assert made.materials["cavity"].temperature == pytest.approx(298.15 + rise)
        assert made.values == values
        assert made.materials["substrate"] is problem.materials["substrate"]


#: Vpp, rise (K) and mean E_ac (J/m^3) by full solves of the chip at one stated temperature after the other.
TABLE = [(1.0, 0.75, 14.8), (2.0, 2.4, 29.6), (4.0, 6.3, 34.2), (6.0, 11.0, 31.9)]


@pytest.mark.parametrize(("voltage", "rise", "energy"), TABLE)
def test_a_channel_leaves_its_resonance_as_full_solves_have_it(voltage: float, rise: float, energy: float) -> None:
    found = warm(SILICON, 1.94e6, f"{voltage} Vpp")
    state = state_of(found)
    assert state.here is not None
    assert state.matters
    assert state.here.rise == pytest.approx(rise, rel=0.03)
    assert state.here.energy_density == pytest.approx(energy, rel=0.03)
    # The reported point is a full solve, and its own losses keep it at its temperature.
    assert found.problem is not None
    assert found.solution is not None
    assert isinstance(found.solution.operators, FullOperators)
    full = float(energy_density(found.solution, found.problem.values)[0]) * (0.5 * voltage) ** 2
    assert full == pytest.approx(state.here.energy_density, rel=5e-3)
    heat = HeatPaths.of(found.problem, found.solution, WarmUp())
    losses = found.solution.dissipation()[0] * (0.5 * voltage) ** 2
    kept = sum(heat.resistances.get(each.place, 0.0) * loss for each, loss in zip(
        found.solution.operators.integrals, losses, strict=True))
    assert kept == pytest.approx(state.here.rise, rel=0.01)


def test_the_slope_is_that_of_states_of_another_temperature() -> None:
    problem, solution = model(SILICON, 1.94e6)
    state = state_of(warm(SILICON, 1.94e6, "1 Vpp"))
    law = law_of(problem.materials["cavity"], Registry())
    assert law is not None
    assert isinstance(solution.operators, FullOperators)
    values = warmer_values(problem, (law,), {law.material.name: 1.0})
    there = System(solution.operators, values).solutions(np.array([1.94e6]))
    ratio = energy_density(there, values)[0] / energy_density(solution, problem.values)[0]
    assert state.energy_per_kelvin == pytest.approx(ratio - 1.0, rel=1e-2)
    # Water alone would move by 3.5 kHz per K; solids share this mode.
    assert state.peak_per_kelvin == pytest.approx(1.63e3, rel=0.02)
    assert "changes E_ac by -23 %" in str(state)
    assert "moves by +1.6 kHz per K" in str(state)


def test_a_drive_that_follows_stays_on_the_peak() -> None:
    fixed, found = warm(SILICON, 1.94e6, "2 Vpp"), warm(SILICON, 1.94e6, "2 Vpp", WarmUp(follow=True))
    state, at_fixed = state_of(found), state_of(fixed)
    assert state.here is not None
    assert at_fixed.here is not None
    assert state.here.energy_density > 1.3 * at_fixed.here.energy_density
    assert state.is_followed
    # The frequency is the peak of the warm chip by full solves, on either side of which there is less.
    assert found.problem is not None
    assert isinstance(found.solution, Solution)
    assert isinstance(found.solution.operators, FullOperators)
    system = System(found.solution.operators, found.problem.values)
    beside = system.solutions(state.here.frequency * np.array([1.0 - 5e-4, 1.0, 1.0 + 5e-4]))
    energy = energy_density(beside, found.problem.values)
    assert energy[1] > max(energy[0], energy[2])
    assert "the drive follows the peak of the energy from 1.9400 to 1.9437 MHz" in str(state)


def test_a_drive_above_the_peak_is_bistable_and_every_state_is_found() -> None:
    state = state_of(warm(GLASS, 1.908e6, "7 Vpp"))
    assert [point.stable for point in state.points] == [True, False, True]
    cold, _, hot = state.points
    assert hot.energy_density > 5.0 * cold.energy_density
    # The peak rises with the temperature: a sweep up takes it along.
    assert "A sweep of the frequency up takes the peak along and leads to the warmest state" in str(state)
    # Harder, only the warm state is left; the curve over the drive says where.
    strong = state_of(warm(GLASS, 1.908e6, "9 Vpp"))
    assert len(strong.points) == 1
    factor = state.curve.factor[(state.curve.rise > 0.1) & (state.curve.rise < hot.rise)]
    assert np.nanmax(factor) < 9.0 / 7.0


def test_a_drive_beyond_the_law_has_no_steady_state_and_the_largest_one_is_named() -> None:
    found = warm(ROUND, 1.03e6, "10 Vpp")
    state = state_of(found)
    assert state.points == ()
    assert not state.matters
    assert found.problem is None
    assert "has no steady temperature up to the 50 degC where its law ends" in str(state)
    assert state.highest_drive == "5.3 Vpp at the electrodes"
    # Up to there it has one.
    assert state_of(warm(ROUND, 1.03e6, "5.3 Vpp")).points


def test_a_plate_that_hardly_minds_its_liquid_keeps_the_fields_of_its_stated_temperature() -> None:
    found = warm(ROUND, 1.03e6, "2 Vpp")
    state = state_of(found)
    assert state.here is not None
    assert state.here.rise > 5.0
    assert abs(state.energy_per_kelvin) < 0.01
    assert not state.matters
    assert found.problem is None
    assert "the fields are those at 20 degC" in str(state)


@pytest.mark.parametrize(("drive", "scaled"), [
    (VoltageDrive(4.0), VoltageDrive(5.0)), (GeneratorDrive(10.0), GeneratorDrive(12.0)),
    (PowerDrive(0.1), PowerDrive(0.15)),
])
def test_the_largest_drive_is_rounded_down(drive: object, scaled: object) -> None:
    assert drive_up_to(drive, 1.2599) == scaled  # type: ignore[arg-type]


@pytest.mark.parametrize(("drive", "kept"), [("10 Vpp @ 50 ohm", None), ("0.05 W", "power")])
def test_generators_and_powers_have_a_fixed_point_too(drive: str, kept: str | None) -> None:
    state = state_of(warm(SILICON, 1.94e6, drive))
    assert state.here is not None
    assert 2.0 < state.here.rise < 24.0
    if kept is None:
        # Less of the generator's voltage is left where the chip takes less power.
        assert state.here.voltage != pytest.approx(state.cold.voltage, rel=1e-3)
    else:
        assert state.here.power == pytest.approx(state.cold.power)
        # All of the power is heat, wherever it arises: silicon spreads it.
        assert state.here.rise == pytest.approx(state.cold.rise, rel=0.01)


def test_a_holder_takes_the_heat_away() -> None:
    held = state_of(warm(SILICON, 1.94e6, "4 Vpp", WarmUp(holder="transducer|outside")))
    assert held.here is not None
    assert held.here.rise < 0.05 * state_of(warm(SILICON, 1.94e6, "4 Vpp")).here.rise  # type: ignore[union-attr]
    assert held.here.energy_density > 0.9 * held.cold.energy_density
    problem, solution = model(SILICON, 1.94e6)
    cooled = warmed(problem, solution, VoltageDrive(1.0), WarmUp(holder={"transducer|outside": -5.0}),
                    registry=Registry())
    assert cooled.state is not None
    assert cooled.state.here is not None
    assert cooled.state.here.rise == pytest.approx(-5.0, abs=0.2)


def test_what_is_not_known_is_said_instead_of_an_error() -> None:
    problem, solution = model(SILICON, 1.94e6)
    glue = replace(problem.materials["bond"], thermal_conductivity=None)
    bare = replace(problem, materials={**problem.materials, "bond": glue})
    found = warmed(bare, solution, VoltageDrive(4.0), WarmUp(), registry=Registry())
    assert found.state is None
    assert "thermal_conductivity: missing" in found.reason
    assert "the temperature under the drive, and the change of the field with it, are not known" in found.reason
    lawless = replace(problem.materials["cavity"], name="water/mine")
    own = replace(problem, materials={**problem.materials, "cavity": lawless})
    found = warmed(own, solution, VoltageDrive(4.0), WarmUp(), registry=Registry())
    assert found.state is None
    assert "water/mine has no law of temperature in its entry" in found.reason


def test_a_drive_beside_every_peak_has_none_to_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fixed_point._Chip, "peak", lambda _self, _rise, _near: None)
    problem, solution = model(SILICON, 1.94e6)
    with pytest.raises(InputError, match=r"warm up: follow: received '1\.94 MHz'; expected a frequency beside a peak"):
        warmed(problem, solution, VoltageDrive(2.0), WarmUp(follow=True), registry=Registry())


@pytest.fixture(scope="module")
def chip() -> Chip:
    return read_chip(SILICON)


def test_a_snapshot_is_cold_unless_it_is_asked_to_be_warm(chip: Chip) -> None:
    drive = wb.parse_drive("4 Vpp")
    cold = wb.snapshot(chip, "filled", 1.94e6, drive=drive, accuracy=ACCURACY)
    assert cold.warm is None
    assert wb.channel_figures(cold).energy_density == pytest.approx(279.0, rel=0.01)
    assert "The first kelvin changes E_ac by -23 %" in " ".join(wb.heating(cold).notes)
    found = wb.snapshot(chip, "filled", 1.94e6, drive=drive, accuracy=ACCURACY, warm=wb.WarmUp())
    assert found.warm is not None
    assert wb.channel_figures(found).energy_density == pytest.approx(34.2, rel=0.03)
    heat = wb.heating(found)
    assert heat.parts["cavity"].mean == pytest.approx(found.liquid_rise, rel=0.01)
    assert found.warm.slopes.rstrip(".") in heat.notes
    warming = wb.liquid_warming(found, heat)
    # Slopes are those of the stated temperature, whatever the fields are.
    assert warming.speed_slope == pytest.approx(2.7, rel=0.02)
    assert found.traps is not None
    assert found.problem.materials["cavity"].temperature == pytest.approx(298.15 + found.liquid_rise)
    moving = wb.liquid_motion(found)
    assert moving.streaming is not None
    # The flow goes with the energy: 292 um/s in the cold chip.
    assert moving.streaming.largest_speed == pytest.approx(34.7e-6, rel=0.05)
    answer = gathering(found)
    assert answer is not None
    assert "square of the voltage" not in str(answer)


def test_the_flow_by_heat_is_left_out_where_a_part_has_no_conductivity(chip: Chip) -> None:
    shot = wb.snapshot(chip, "filled", 1.94e6, drive=wb.parse_drive("1 Vpp"), accuracy=ACCURACY)
    glue = replace(shot.problem.materials["bond"], thermal_conductivity=None)
    bare = replace(shot, problem=replace(shot.problem, materials={**shot.problem.materials, "bond": glue}))
    moving = wb.liquid_motion(bare)
    assert moving.heat is None
    assert moving.streaming is not None
    assert any("The flow by heat is left out" in note and "thermal_conductivity" in note for note in moving.notes)


def test_simulate_reports_the_warm_chip_before_it_says_where_particles_gather(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["simulate", str(SILICON), "--state", "filled", "--at", "1.94 MHz", "--drive", "4 Vpp", "--accuracy",
               "0.5 %", "--from", "1.9 MHz", "--to", "1.98 MHz", "--points", "41", "--no-cad", "--no-pictures"]
    assert main([*command, "-o", str(tmp_path / "warm")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert said.index("K warmer than its 25 degC") < said.index("focus across the channel")
    assert "Up to 10 Vpp at the electrodes the warmest place of the liquid stays within its law" in said
    record = json.loads((tmp_path / "warm" / "merit.json").read_text())["states"]["filled"]
    assert record["warm"]["steady"][0]["rise_k"] == pytest.approx(6.3, rel=0.03)
    assert record["channel"]["mean_energy_density_j_m3"] == pytest.approx(34.2, rel=0.03)
    assert (tmp_path / "warm" / "warmth.png").is_file()
    assert "How warm does it get?" in (tmp_path / "warm" / "report.html").read_text()
    assert main([*command, "--cold", "-o", str(tmp_path / "cold")]) == 0
    record = json.loads((tmp_path / "cold" / "merit.json").read_text())["states"]["filled"]
    assert "warm" not in record
    assert record["channel"]["mean_energy_density_j_m3"] == pytest.approx(279.0, rel=0.01)


@pytest.mark.parametrize(("options", "words"), [
    (["--cold", "--follow"], "one of both"), (["--holder", "lid|outside"], "--holder"),
    (["--convection", "-1 W/(m^2 K)"], "a heat transfer coefficient above zero"),
])
def test_ways_for_the_heat_to_leave_are_checked_before_anything_is_solved(
    options: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", str(SILICON), *options, "-o", str(tmp_path / "out")]) == 2
    assert words in " ".join(capsys.readouterr().err.split())
