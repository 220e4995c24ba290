"""The sound around the axis of a chip with features."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from scipy.special import jv, jvp
from support import CELL, FluidState, block_mesh, chip_from

from workbench.acoustics.forces import ParticleForces, particle_forces
from workbench.fem.operators import FullOperators
from workbench.fem.patch import Patch
from workbench.files.errors import InputError
from workbench.model.drive import VoltageDrive, parse_drive
from workbench.model.particles import Particle
from workbench.render.pattern import draw_pattern
from workbench.simulation.features import RigidPart, charge_change, compliance_of, driven_displacements
from workbench.simulation.pattern import CavityPattern, cavity_pattern
from workbench.simulation.run import Snapshot, simulate, snapshot

PART = RigidPart(Patch("transducer", False, 1.5e-3, 1.2e-3), 0.0, mass=1e-6)
WATER = FluidState(density=997.0, sound_speed=1497.0, shear_viscosity=0.890e-3)
RADIUS, HEIGHT, WAVES = 1.5e-3, 0.72e-3, 6.0
ANGLES = np.array([0.2, 1.1, 2.9])


@cache
def shot() -> Snapshot:
    return snapshot(chip_from(CELL, "cell.toml"), "filled", 1e6, accuracy=5e-2)


def pattern_of(*parts: RigidPart, peak_to_peak: float = 10.0) -> CavityPattern:
    return cavity_pattern(shot().problem, shot().solution, parts, VoltageDrive(peak_to_peak))


def places() -> np.ndarray:
    """Some places of the cavity."""
    points = shot().fields.mesh.points[shot().fields.mesh.nodes_of(["cavity"])]
    return np.array([[0.3, 0.4], [0.8, 0.5], [0.5, 0.9]]) * np.ptp(points, axis=0) + points.min(axis=0)


@pytest.fixture(scope="module")
def one() -> CavityPattern:
    return pattern_of(PART)


def test_a_part_without_mass_leaves_the_field_of_the_section() -> None:
    pattern, traps = pattern_of(replace(PART, mass=0.0)), shot().traps
    assert traps is not None
    assert pattern.orders == 1
    assert pattern.unevenness == 0.0
    nodes = shot().fields.mesh.nodes_of(["cavity"])
    assert pattern.cosines[nodes, 0] == pytest.approx(shot().fields.pressure[nodes], rel=1e-9)
    own = particle_forces(shot().fields, traps.forces.particle, fluid=traps.forces.fluid, region="cavity")
    found = replace(pattern, forces=own).potential(own.mesh.points, ANGLES)
    # The nodes on edges of cells, where the recovered gradient is a mean of both.
    assert found == pytest.approx(np.repeat(own.potential[:, None], 3, axis=1), abs=1e-5 * np.ptp(own.potential))
    # The traps of the section beside its axis are rings.
    found = replace(pattern, forces=own).traps
    assert all((trap.angle is None) == (trap.radius > 0.0) for trap in found)
    rings = [trap for trap in traps.traps if trap.radius > 0.1e-3 and not trap.on_wall]
    assert len([trap for trap in found if trap.radius > 0.1e-3]) == len(rings)


def test_the_field_turns_with_its_part(one: CavityPattern) -> None:
    turned = pattern_of(replace(PART, angle=0.5))
    expected = one.pressure(places(), ANGLES - 0.5)
    assert turned.pressure(places(), ANGLES) == pytest.approx(expected, rel=1e-9)
    assert one.orders > 2
    assert np.ptp(np.abs(expected), axis=1).max() > 1e-3 * np.abs(expected).max()


def test_a_field_is_mirrored_with_its_parts() -> None:
    """Two unlike parts move along the circumference too; the mirror image has the other angles."""
    parts = (replace(PART, angle=0.2), replace(PART, angle=1.9, mass=2e-6))
    pattern, mirrored = pattern_of(*parts), pattern_of(*(replace(each, angle=-each.angle) for each in parts))
    assert pattern.pressure(places(), ANGLES) == pytest.approx(mirrored.pressure(places(), -ANGLES), rel=1e-9)


def test_halves_at_one_place_are_one_part(one: CavityPattern) -> None:
    half = replace(PART, mass=0.5 * PART.mass)
    two = pattern_of(half, replace(half, angle=1e-5))
    expected = one.pressure(places(), ANGLES)
    # The angle between them, and the last orders of the compliance.
    assert two.pressure(places(), ANGLES) == pytest.approx(expected, abs=1e-3 * np.abs(expected).max())


def test_opposite_parts_move_even_orders_alone() -> None:
    pattern = pattern_of(PART, replace(PART, angle=math.pi))
    sizes = np.nanmax(np.abs(pattern.cosines), axis=0)
    assert sizes[1::2].max() < 1e-9 * sizes[2::2].max()


def test_a_drive_scales_the_pressure(one: CavityPattern) -> None:
    double = pattern_of(PART, peak_to_peak=20.0)
    assert double.pressure(places(), ANGLES) == pytest.approx(2.0 * one.pressure(places(), ANGLES), rel=1e-12)


def test_a_power_is_that_of_the_chip_with_its_parts(one: CavityPattern) -> None:
    """The voltage at a power follows from the charge of both, which 1 mg changes by more than 1e-3."""
    solution, power = shot().solution, parse_drive("0.1 W")
    operators = shot().solution.operators
    assert isinstance(operators, FullOperators)
    between = compliance_of(shot().problem, [PART.patch], np.zeros(1), solution.frequency)
    change = charge_change([PART], solution.frequency, driven_displacements(operators, [PART], solution.states),
                           between.total)
    assert abs(change[0] / solution.charge[0]) > 1e-3
    voltage = power.amplitude(solution.impedance * solution.charge / (solution.charge + change))[0]
    found = cavity_pattern(shot().problem, solution, [PART], power).pressure(places(), ANGLES)
    assert found == pytest.approx(voltage / 5.0 * one.pressure(places(), ANGLES), rel=1e-9)


# --------------------------------------------------------------------------------------------------------------------
# A known field: p = J_0(k r) cos(q z) + e J_3(k r) cos(3 t) cos(q z)


def known(share: float, order: int = 3) -> CavityPattern:
    mesh = block_mesh(np.linspace(0.0, RADIUS, 9), np.linspace(0.0, HEIGHT, 5), 4)
    across, up = WAVES / RADIUS, math.pi / HEIGHT
    r, z = mesh.points.T
    cosines = np.zeros((r.size, order + 1), dtype=complex)
    cosines[:, 0] = 1e5 * jv(0, across * r) * np.cos(up * z)
    cosines[:, order] = 1e5 * share * jv(order, across * r) * np.cos(up * z)
    frequency = math.hypot(across, up) * WATER.sound_speed / (2.0 * math.pi)
    return CavityPattern(mesh, frequency, WATER.density, WATER.sound_speed, cosines, 0.0 * cosines, forces_of_bead())


def test_the_velocity_is_that_of_the_pressure() -> None:
    pattern = known(0.5)
    at, across, up = np.array([[0.4e-3, 0.2e-3], [1.1e-3, 0.5e-3]]), WAVES / RADIUS, math.pi / HEIGHT
    r, z = at[:, :1], at[:, 1:]
    j0, j3, wave = jv(0, across * r), jv(3, across * r), np.cos(3.0 * ANGLES)
    slopes = 1e5 * np.stack([
        across * (jvp(0, across * r) + 0.5 * jvp(3, across * r) * wave) * np.cos(up * z),
        -1.5 * j3 / r * np.sin(3.0 * ANGLES) * np.cos(up * z),
        -up * (j0 + 0.5 * j3 * wave) * np.sin(up * z)], axis=2)
    expected = slopes / (2j * math.pi * pattern.frequency * WATER.density)
    # Cells of order 4, a fifth of a period of the radial wave each.
    assert pattern.velocity(at, ANGLES) == pytest.approx(expected, abs=1e-3 * np.abs(expected).max())


def test_the_velocity_on_the_axis_does_not_depend_on_the_angle() -> None:
    """Order 1 moves the liquid on the axis across it: the same by any angle."""
    velocity = known(0.5, order=1).velocity(np.array([[0.0, 0.2e-3]]), ANGLES)[0]
    sideways = velocity[:, 0] * np.cos(ANGLES) - velocity[:, 1] * np.sin(ANGLES)
    assert np.abs(sideways) == pytest.approx(np.full(3, np.abs(sideways[0])), rel=1e-3)
    assert np.abs(sideways[0]) > 0.0


def test_the_traps_of_an_order_are_equal_and_equally_far_apart() -> None:
    """Where J_3 is largest, at 4.2 / k, in the node of the pressure along z, six times around."""
    pattern = known(100.0)
    assert pattern.traps is pattern.traps
    beside = [trap for trap in pattern.traps if trap.radius > 0.0]
    assert np.sort([trap.angle or 0.0 for trap in beside]) == pytest.approx(np.arange(6) * math.pi / 3.0, abs=0.1)
    for trap in beside:
        assert (trap.radius, trap.height) == pytest.approx((4.2 / WAVES * RADIUS, 0.5 * HEIGHT), abs=0.05e-3)
        assert trap.potential == pytest.approx(beside[0].potential, rel=2e-2)


def test_a_liquid_without_particles_has_no_traps(tmp_path: Path) -> None:
    pattern = replace(known(0.5), forces=None)
    assert pattern.traps == ()
    with pytest.raises(InputError, match="particle: missing"):
        pattern.potential(np.zeros((1, 2)), ANGLES)
    picture = matplotlib.image.imread(draw_pattern(pattern, tmp_path / "pattern.png"))
    assert picture.shape[1] < 1.5 * picture.shape[0]


def test_the_trap_on_the_axis_is_found() -> None:
    traps = known(0.01).traps
    assert traps[0].radius == 0.0
    # The node of the pressure.
    assert traps[0].height == pytest.approx(0.5 * HEIGHT, abs=HEIGHT / 20.0)


def forces_of_bead() -> ParticleForces:
    traps = shot().traps
    assert traps is not None
    bead = Particle(name="polystyrene", radius=5e-6, density=1050.0, compressibility=2.5e-10)
    return replace(traps.forces, particle=bead)


def test_simulate_reports_the_pattern(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    solder = '[[features]]\nkind = "mass"\nface = "bottom"\ndistance = "1.5 mm"\ndiameter = "2.4 mm"\nmass = "1 mg"\n'
    chip = chip_from(CELL + solder, "cell.toml")
    # Tests of features have the spectrum.
    monkeypatch.setattr("workbench.simulation.run.spectrum_with", lambda *given: (given[3], ()))
    run = simulate(chip, "filled", points=5, accuracy=5e-2, at=1e6)
    assert run.pattern is not None
    assert any(f"{run.pattern.orders} orders around the axis" in finding for finding in run.findings)
    expected = pattern_of(PART).pressure(places(), ANGLES)
    # Its mesh has lines at the edges of the patch.
    assert run.pattern.pressure(places(), ANGLES) == pytest.approx(expected, abs=2e-2 * np.abs(expected).max())
    picture = matplotlib.image.imread(draw_pattern(run.pattern, tmp_path / "pattern.png"))
    assert picture.shape[1] > 1.5 * picture.shape[0]
