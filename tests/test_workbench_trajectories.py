"""Particles that move in made-up fields: closed forms, convergence, other integrators, walls, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import kstest
from support import FluidState, block_mesh, standing_wave

from materials import Registry
from workbench.acoustics import motion, rosenbrock
from workbench.acoustics.captures import Window, arrived_share, capture_statistics, light_curve, rise_time
from workbench.acoustics.curved_cells import of_order
from workbench.acoustics.forces import ParticleForces, particle_forces
from workbench.acoustics.interpolant import Interpolant
from workbench.acoustics.nodal import NodalMesh, interpolate
from workbench.acoustics.particle_velocity import particle_velocity, wall_mobilities
from workbench.acoustics.starts import draw_starts
from workbench.acoustics.trajectories import CONTACT, Fate, Trajectories, follow, record_times
from workbench.acoustics.traps import TrapReport, find_traps, focus_time
from workbench.acoustics.walls import walls_of
from workbench.files.errors import InputError
from workbench.model.particles import Particle, drag_coefficient, net_weight, particle_from

WATER = FluidState(density=997.0, sound_speed=1497.0, shear_viscosity=0.890e-3)
KAPPA = 3.0 * (1.0 - 0.35) / ((1.0 + 0.35) * 1050.0 * 2350.0**2)
RADIUS, HEIGHT = 4e-3, 0.72e-3


def bead(density: float = 1050.0, radius: float = 5e-6) -> Particle:
    return Particle(name="polystyrene", radius=radius, density=density, compressibility=KAPPA)


#: One that does not sink, for closed forms of the sound alone; its f2 is zero.
NEUTRAL = bead(997.0)


def block(across: int, up: int, order: int = 4) -> NodalMesh:
    r, z = np.linspace(0.0, RADIUS, across + 1), np.linspace(0.0, HEIGHT, up + 1)
    return block_mesh(r, z, order)


def half_wave(mesh: NodalMesh, *, radial: float = 0.0, p0: float = 1e5) -> Any:
    """What particle_forces reads of a Fields: p = p0 J0(k_r r) cos(pi z / h), a pressure node at mid-height."""
    return standing_wave(mesh, WATER, k_z=math.pi / HEIGHT, radial=radial, p0=p0)


def report_of(particle: Particle, *, across: int = 14, up: int = 6, **wave: float) -> TrapReport:
    return find_traps(particle_forces(half_wave(block(across, up), **wave), particle, fluid=WATER, region="cavity"))


def silent(particle: Particle) -> TrapReport:
    """A cavity without sound."""
    forces = report_of(particle, across=3, up=3).forces
    still = replace(forces, force=np.zeros_like(forces.force), potential=np.zeros_like(forces.potential))
    return TrapReport(forces=still, traps=())


def test_there_is_no_time_to_a_trap_that_a_bead_sinks_past() -> None:
    """At a tenth of the pressure a hundredth of the force: it leads down to the trap, and cannot hold the weight."""
    assert focus_time(report_of(bead(1050.0))) is not None
    weak = report_of(bead(1050.0), p0=1e4)
    assert weak.traps[0].lift < net_weight(bead(1050.0), WATER)  # type: ignore[operator]
    assert focus_time(weak) is None


# --- closed forms ----------------------------------------------------------------------------------------------------


def focusing_scale(forces: ParticleForces) -> float:
    """t* = 3 eta / (4 Phi (k a)^2 E), after which tan(k z) has fallen to 1/e (Barnkob et al., Lab Chip 10, 563)."""
    k = 2 * math.pi * forces.excitation.frequency / WATER.sound_speed
    return 3 * 0.890e-3 / (4 * forces.scattering.contrast_factor * (k * forces.particle.radius) ** 2
                           * forces.excitation.energy_density)


def test_the_tangent_of_the_phase_falls_exponentially_in_a_standing_wave() -> None:
    report = report_of(NEUTRAL, up=9)
    scale, k = focusing_scale(report.forces), math.pi / HEIGHT
    share = np.concatenate([np.linspace(0.02, 0.45, 12), np.linspace(0.55, 0.98, 12)])
    starts = np.stack([np.full(share.size, 1e-3), share * HEIGHT], axis=1)
    found = follow(report, scale * np.array([0.0, 0.5, 1.0, 2.0, 3.0]), particles=starts)
    tangent = np.tan(k * (found.positions[:, :, 1] - 0.5 * HEIGHT))
    # The interpolated force is good to 1e-5 of its peak; near the antinode it is a sixteenth of that.
    np.testing.assert_allclose(tangent / tangent[:, :1], np.broadcast_to(np.exp(-found.times / scale), tangent.shape),
                               rtol=1e-3)
    np.testing.assert_allclose(found.positions[:, :, 0], 1e-3, atol=1e-9)


def test_the_light_curve_of_a_window_about_the_antinodes() -> None:
    report = report_of(NEUTRAL, across=2, up=9)
    scale, count, alpha = focusing_scale(report.forces), 4000, 0.3
    margin = 5e-6 / HEIGHT  # no centre is nearer to a wall
    share = margin + (1 - 2 * margin) * (np.arange(count) + 0.5) / count
    found = follow(report, scale * np.linspace(0.0, 2.0, 9),
                   particles=np.stack([np.full(count, 1e-3), share * HEIGHT], axis=1))
    window = Window(bottom=0.5 * (1 - alpha) * HEIGHT, top=0.5 * (1 + alpha) * HEIGHT)
    inside = light_curve(found, window)
    # Particles that no start point stands for, those in the margins, are outside the window at these times.
    outside = 1 - inside * (1 - 2 * margin)
    expected = 1 - 2 / math.pi * np.arctan(math.tan(0.5 * math.pi * alpha) * np.exp(found.times / scale))
    # A count is exact to one particle on either side of the window: 2 / 4000.
    np.testing.assert_allclose(outside, expected, atol=1e-3)


def test_particles_gather_in_the_nodal_plane_of_a_bessel_wave() -> None:
    radial, p0 = 666.0, 4e5
    # One whose f2 is positive and that does not sink: the weight is taken out of the velocity by a flow.
    report = report_of(bead(), across=20, up=9, radial=radial, p0=p0)
    forces = report.forces
    drag = drag_coefficient(bead(), WATER)
    flow = np.zeros_like(forces.force)
    flow[:, 1] = net_weight(bead(), WATER) / drag
    speed = (math.pi / HEIGHT) * p0 / (2 * math.pi * forces.excitation.frequency * WATER.density)
    energy = WATER.density * speed**2 / 4  # in the plane all energy at the axis is kinetic
    folding = 3 * 0.890e-3 / (complex(forces.scattering.dipole).real * 25e-12 * radial**2 * energy)
    # J0 J1 is linear within (k_r r)^2 / 4 = 1e-4 here.
    start = np.array([[0.03e-3, 0.5 * HEIGHT]])
    found = follow(report, folding * np.array([0.0, 0.5, 1.0, 2.0]), particles=start, flow=flow)
    # The slope of the force at the axis is a derivative of a recovered gradient: 5e-4 on this mesh.
    np.testing.assert_allclose(np.log(found.positions[0, 1:, 0] / 0.03e-3), -found.times[1:] / folding, rtol=1e-3)
    np.testing.assert_allclose(found.positions[0, :, 1], 0.5 * HEIGHT, atol=1e-9)


@pytest.mark.parametrize("density", [2200.0, 700.0])
def test_a_particle_settles_at_stokes_speed_and_stops_where_it_touches(density: float) -> None:
    particle = bead(density)
    speed = 2 / 9 * (density - 997.0) * 9.80665 * 25e-12 / 0.890e-3  # downwards
    starts = np.array([[1e-3, 0.3e-3], [2e-3, 0.5e-3]])
    way = (starts[:, 1] - 5e-6) if speed > 0 else (HEIGHT - 5e-6 - starts[:, 1])
    found = follow(silent(particle), np.linspace(0.0, 1.2 * way.max() / abs(speed), 50), particles=starts)
    # The field is constant, so that steps are exact.
    np.testing.assert_allclose(found.stopped_at, way / abs(speed), rtol=1e-9)
    moving = found.times < found.stopped_at[:, None]
    expected = starts[:, None, 1] - speed * found.times
    np.testing.assert_allclose(found.positions[:, :, 1][moving], expected[moving], rtol=1e-9)
    end = 5e-6 if speed > 0 else HEIGHT - 5e-6
    np.testing.assert_allclose(found.positions[:, -1, 1], end, atol=1e-12)
    # A light one that lies under the lid is carried by it as a heavy one by the floor.
    assert (found.fate == Fate.SEDIMENTED).all()


def test_energy_density_times_time_is_the_clock() -> None:
    report = report_of(NEUTRAL, radial=666.0)
    times = focusing_scale(report.forces) * np.linspace(0.0, 5.0, 6)
    one = follow(report, times, particles=40, seed=2)
    fourfold = follow(report, times / 9.0, particles=40, seed=2, voltage_factor=3.0)
    # Rounding and the estimated error of a step, 15 nm; the steps themselves scale.
    np.testing.assert_allclose(one.positions, fourfold.positions, atol=1e-8)
    assert (one.fate == fourfold.fate).all()
    np.testing.assert_allclose(one.levitated_at, 9.0 * fourfold.levitated_at, rtol=1e-6)


def test_a_particle_that_starts_at_its_place_of_rest_stays_and_one_at_the_trap_sinks_a_little() -> None:
    report = report_of(bead(), radial=666.0, p0=4e5)
    (trap, *_) = report.traps
    first = follow(report, record_times(1800.0), particles=1)
    rest = first.rest[0]
    # The sag is the weight over the stiffness.
    assert trap.height - rest[1] == pytest.approx(net_weight(bead(), WATER) / trap.axial_stiffness, rel=1e-2)
    found = follow(report, record_times(1800.0), particles=np.array([rest, [trap.radius, trap.height]]))
    np.testing.assert_allclose(found.positions[0], np.broadcast_to(rest, found.positions[0].shape), atol=1e-9)
    np.testing.assert_allclose(found.positions[1, -1], rest, atol=1e-9)
    assert (found.fate == Fate.TRAPPED).all()
    assert found.trap.tolist() == [0, 0]
    assert found.trapped_at.tolist() == [0.0, 0.0]


def test_a_flow_carries_particles_around() -> None:
    # A rigid rotation keeps the distance from its middle, and comes round after its period.
    report = silent(NEUTRAL)
    middle, omega = np.array([2e-3, 0.5 * HEIGHT]), 2 * math.pi / 10.0
    apart = report.forces.mesh.points - middle
    flow = omega * np.stack([-apart[:, 1], apart[:, 0]], axis=1)
    starts = middle + np.array([[0.2e-3, 0.0], [0.0, -0.3e-3]])
    found = follow(report, np.array([0.0, 2.5, 10.0]), particles=starts, flow=flow, tolerance=1e-10)
    # Bounded by the number of steps, a few hundred, times the tolerance.
    np.testing.assert_allclose(found.positions[:, 2], starts, atol=2e-8)
    np.testing.assert_allclose(found.positions[0, 1], middle + np.array([0.0, 0.2e-3]), atol=2e-8)
    assert (found.fate == Fate.MOVING).all()


def test_nothing_pushes_a_particle_off_the_axis() -> None:
    # The recovered gradient of a real field is not quite zero there.
    report = report_of(NEUTRAL, radial=666.0)
    off = replace(report, forces=replace(report.forces, force=report.forces.force + 1e-14))
    found = follow(off, record_times(60.0), particles=np.array([[0.0, 0.6e-3]]))
    assert np.abs(found.positions[0, :, 0]).max() < 1e-12


def test_a_step_that_is_too_long_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(motion, "FIRST_STEP", 1e3)
    report = report_of(NEUTRAL, up=9)
    scale, k, start = focusing_scale(report.forces), math.pi / HEIGHT, 0.05 * HEIGHT
    found = follow(report, np.array([0.0, 3.0 * scale]), particles=np.array([[1e-3, start]]))
    expected = 0.5 * HEIGHT - math.atan(math.tan(k * (0.5 * HEIGHT - start)) * math.exp(-3.0)) / k
    # As above; a single step to the end would be off by a quarter.
    assert found.positions[0, -1, 1] == pytest.approx(expected, rel=1e-3)


# --- arrivals and fates ----------------------------------------------------------------------------------------------


def test_levitation_is_counted_from_the_start_to_a_tenth_of_a_quarter_wavelength() -> None:
    report = report_of(NEUTRAL, up=9)
    scale, k = focusing_scale(report.forces), math.pi / HEIGHT
    z = np.array([0.1, 0.2, 0.3]) * HEIGHT
    found = follow(report, record_times(20 * scale), particles=np.stack([np.full(3, 1e-3), z], axis=1))
    expected = scale * np.log(np.tan(k * (0.5 * HEIGHT - z)) / math.tan(0.1 * math.pi / 2))
    # The plane is found from the slope of the speed at the end of a step: tan(2 k z) / 2 k for z, and a cubic path.
    np.testing.assert_allclose(found.levitated_at, expected, rtol=2e-2)
    assert (found.fate == Fate.LEVITATED).all()


def test_a_flow_drives_particles_to_the_side_wall() -> None:
    report = silent(NEUTRAL)
    flow = np.zeros_like(report.forces.force)
    flow[:, 0] = 1e-3 * report.forces.mesh.points[:, 0]  # dr/dt = r / 1000 s
    found = follow(report, record_times(5000.0), particles=np.array([[1e-3, 0.3e-3], [0.0, 0.3e-3]]), flow=flow)
    assert found.fate.tolist() == [Fate.AT_WALL, Fate.MOVING]
    assert found.stopped_at[0] == pytest.approx(1000.0 * math.log((RADIUS - 5e-6) / 1e-3), rel=1e-4)
    assert found.positions[0, -1] == pytest.approx([RADIUS - 5e-6, 0.3e-3], abs=1e-9)
    # On the axis nothing pushes it off.
    assert found.positions[1, -1, 0] < 1e-15


def test_halved_tolerance_and_halved_mesh_keep_the_capture_fractions() -> None:
    times = record_times(1800.0)
    fractions = []
    for across, up, finer in ((14, 3, 1.0), (14, 3, 0.5), (28, 6, 1.0)):
        report = report_of(bead(), across=across, up=up, radial=666.0, p0=4e5)
        wavelength = WATER.sound_speed / report.excitation.frequency
        found = follow(report, times, particles=400, seed=1, tolerance=finer * 1e-5 * wavelength)
        fractions.append([float((found.fate == fate).mean()) for fate in Fate])
    np.testing.assert_allclose(fractions[1], fractions[0], atol=0.01)
    np.testing.assert_allclose(fractions[2], fractions[0], atol=0.01)
    # Sound, weight and walls all take their share, or the test is of nothing.
    assert fractions[0][Fate.SEDIMENTED] > 0.2
    assert fractions[0][Fate.TRAPPED] > 0.1


def test_an_oil_droplet_goes_to_the_antinode_and_a_cell_to_the_node() -> None:
    registry = Registry()
    starts = np.array([[1e-3, 0.4 * HEIGHT]])
    ends = {}
    for name in ("olive_oil", "mcf7_cell"):
        particle = particle_from(registry.load(name), 8e-6)
        report = report_of(particle, up=9, p0=4e5)
        found = follow(report, record_times(600.0), particles=starts)
        ends[name] = found.fate[0], found.positions[0, -1, 1]
    # Water is heavier than oil: the droplet rises to the lid even though it starts below the node, if sound allows.
    assert ends["olive_oil"][0] in (Fate.AT_WALL, Fate.SEDIMENTED)
    assert min(ends["olive_oil"][1], HEIGHT - ends["olive_oil"][1]) == pytest.approx(8e-6, abs=1e-9)
    assert ends["mcf7_cell"] == (Fate.LEVITATED, pytest.approx(0.5 * HEIGHT, abs=2e-5))


# --- other integrators, and the parts --------------------------------------------------------------------------------


def test_scipy_finds_the_same_trajectories() -> None:
    report = report_of(bead(), radial=666.0, p0=4e5)
    starts = np.array([[0.8e-3, 0.6e-3], [1.9e-3, 0.2e-3], [2.6e-3, 0.4e-3]])
    found = follow(report, np.array([0.0, 3.0, 30.0, 300.0]), particles=starts)
    velocity = particle_velocity(report.forces)
    for start, own in zip(starts, found.positions, strict=True):
        cell = velocity.cells_at(start[None])
        solved = solve_ivp(lambda _, x, at: velocity(x[None], at)[0][0], (0.0, 300.0), start, method="Radau",
                           t_eval=found.times, rtol=1e-9, atol=1e-11, args=(cell,))
        # Ours keeps each step within 15 nm.
        np.testing.assert_allclose(own, solved.y.T, atol=1e-7)


def test_a_rosenbrock_step_has_order_four_and_its_estimate_three() -> None:
    def right(x: np.ndarray) -> np.ndarray:
        return np.stack([x[:, 0] * x[:, 1] + np.sin(x[:, 1]), -x[:, 0] ** 2 - 3 * x[:, 1]], axis=1)

    def jacobian(x: np.ndarray) -> np.ndarray:
        return np.array([[[a[1], a[0] + math.cos(a[1])], [-2 * a[0], -3.0]] for a in x])

    exact = solve_ivp(lambda _, x: right(x[None])[0], (0.0, 2.0), [1.0, 0.5], rtol=1e-13, atol=1e-14).y[:, -1]
    errors, estimates = [], []
    for steps in (32, 64):
        x = np.array([[1.0, 0.5]])
        for number in range(steps):
            x, estimate = rosenbrock.rosenbrock_step(right, x, right(x), jacobian(x), np.array([2.0 / steps]))
            if number == 0:
                estimates.append(np.abs(estimate).max())
        errors.append(np.abs(x[0] - exact).max())
    assert math.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.4)
    # The local error of order 3.
    assert math.log2(estimates[0] / estimates[1]) == pytest.approx(4.0, abs=0.2)


def test_fast_motion_that_has_died_down_costs_no_steps() -> None:
    def attempts(factor: float) -> int:
        report = report_of(bead(), across=7, up=3, radial=666.0, p0=4e5)
        velocity = particle_velocity(report.forces, voltage_factor=factor)
        moved = motion.Motion(velocity, walls_of(report.forces.mesh), np.array([[0.8e-3, 0.6e-3]]),
                              np.array([0.0, 1800.0]), radius=5e-6, rest=np.empty((0, 2)), within=3e-5, tolerance=1e-8)
        moved.run(lambda *_: None)
        return moved.attempts

    # An explicit method would take a hundred times as many steps.
    assert attempts(10.0) < 2 * attempts(1.0) < 400


def bent(mesh: NodalMesh, kind: str) -> NodalMesh:
    """The cells of a grid as they are, or with curved sides: "moved", or "free" ones. Walls stay where they are."""
    if kind == "grid":
        return mesh
    points, cells = of_order(mesh.points, mesh.cells, mesh.order) if kind == "free" else (mesh.points, mesh.cells)
    r, z = points.T
    bulge = np.sin(math.pi * r / RADIUS) * np.sin(math.pi * z / HEIGHT)
    moved = points + np.stack([0.02 * RADIUS * bulge, 0.05 * HEIGHT * bulge], axis=1)
    if kind == "moved":
        return replace(mesh, points=moved, straight=points)
    return NodalMesh(moved, cells, np.zeros(len(cells), int), ("cavity",), free=True)


@pytest.mark.parametrize("kind", ["grid", "moved", "free"])
def test_an_interpolant_has_the_values_and_the_slopes_of_its_cells(kind: str) -> None:
    mesh, curved = bent(block(6, 4), kind), kind != "grid"
    r, z = mesh.points.T / 1e-3
    values = np.stack([r**2 * z - z**2, 1.0 + r * z], axis=1)
    random = np.random.default_rng(3)
    points = random.uniform([1e-5, 1e-5], [RADIUS - 1e-5, HEIGHT - 1e-5], (300, 2))
    interpolant = Interpolant(mesh, values)
    # Wherever the search begins.
    found, slopes, cell = interpolant(points, random.integers(0, len(mesh.cells), 300), slopes=True)
    assert (cell >= 0).all()
    np.testing.assert_allclose(found, interpolate(mesh, values, points, ["cavity"]), rtol=1e-9)
    r, z = points.T / 1e-3
    exact = 1e3 * np.stack([np.stack([2 * r * z, r**2 - 2 * z], axis=1), np.stack([z, r], axis=1)], axis=1)
    # A polynomial of r and z is one of the local coordinates in a rectangle only.
    np.testing.assert_allclose(slopes, exact, rtol=2e-4 if curved else 1e-9, atol=1.0 if curved else 1e-6)
    outside, _, cell = interpolant(np.array([[1e-3, -1e-3]]), interpolant.cells_at(np.array([[1e-3, 1e-6]])))
    assert cell[0] == -1
    np.testing.assert_allclose(outside, interpolate(mesh, values, np.array([[1e-3, 0.0]]), ["cavity"]), rtol=0.1)


def test_curved_cells_carry_particles_as_rectangles_do() -> None:
    mesh = block(14, 6)
    ends = []
    for each in (bent(mesh, kind) for kind in ("grid", "moved", "free")):
        forces = particle_forces(half_wave(each, radial=666.0, p0=4e5), bead(), fluid=WATER, region="cavity")
        found = follow(find_traps(forces), record_times(300.0), particles=np.array(
            [[0.5e-3, 0.6e-3], [1.5e-3, 0.1e-3], [3.4e-3, 0.3e-3]]))
        ends.append(found)
    # Free cells have no neighbours that make the gradient better.
    for curved in ends[1:]:
        np.testing.assert_allclose(curved.positions[:, -1], ends[0].positions[:, -1], atol=5e-6)
        assert curved.fate.tolist() == ends[0].fate.tolist()
    assert ends[0].fate[2] == Fate.SEDIMENTED


@pytest.mark.parametrize("kind", ["grid", "moved", "free"])
def test_the_distance_from_walls(kind: str) -> None:
    walls = walls_of(bent(block(6, 4), kind))
    distance, away = walls.nearest(np.array([[0.0, 0.1e-3], [1e-3, 0.7e-3], [3.95e-3, 0.3e-3]]))
    np.testing.assert_allclose(distance, [0.1e-3, 0.02e-3, 0.05e-3], rtol=1e-9)
    np.testing.assert_allclose(away, [[0.0, 1.0], [0.0, -1.0], [-1.0, 0.0]], atol=1e-9)
    if kind == "grid":
        assert len(walls.begin) == 3  # the axis is no wall


def test_starts_are_spread_evenly_over_the_volume() -> None:
    mesh = block(6, 4)
    walls = walls_of(mesh)
    starts, again = (draw_starts(mesh, walls, 2000, radius=5e-6, random=np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(starts, again)
    # The distribution of r^2 and of z is uniform: a fair draw fails one time in a hundred, and this seed does not.
    assert kstest(starts[:, 0] ** 2 / (RADIUS - 5e-6) ** 2, "uniform").pvalue > 0.01
    assert kstest((starts[:, 1] - 5e-6) / (HEIGHT - 1e-5), "uniform").pvalue > 0.01
    assert walls.nearest(starts)[0].min() > 5e-6


# --- statistics ------------------------------------------------------------------------------------------------------


def ended(fate: list[int], levitated_at: list[float], trapped_at: list[float]) -> Trajectories:
    """Trajectories with these ends, of particles that move outwards by 1 mm a second from the axis."""
    times = np.linspace(0.0, 4.0, 5)
    report = silent(NEUTRAL)
    count = len(fate)
    positions = np.stack(np.broadcast_arrays(1e-3 * times * np.linspace(0.2, 1.0, count)[:, None], 0.3e-3), axis=2)
    codes = np.array(fate)
    return Trajectories(
        report=report, velocity=particle_velocity(report.forces), voltage_factor=1.0, times=times, positions=positions,
        azimuths=np.zeros(count), fate=codes, trap=np.where(codes == Fate.TRAPPED, 0, -1),
        rest=np.array([[0.0, 0.3e-3]]), levitated_at=np.array(levitated_at), trapped_at=np.array(trapped_at),
        focused_at=np.full(count, np.nan), stopped_at=np.full(count, np.nan), within=3e-5)


def test_capture_fractions_and_focusing_times() -> None:
    nan = math.nan
    found = ended([Fate.TRAPPED] * 4 + [Fate.MOVING], [0.0, 1.0, 2.0, 3.0, nan], [1.0, 2.0, 3.0, 4.0, nan])
    rows = {row.name: row for row in capture_statistics(found)}
    trapped = rows["in trap 1, r 0.00 mm, z 0.30 mm"]
    assert (trapped.count, trapped.share) == (4, 0.8)
    assert trapped.share_spread == pytest.approx(math.sqrt(0.8 * 0.2 / 5))
    assert (trapped.ten, trapped.half, trapped.ninety) == pytest.approx((1.3, 2.5, 3.7))
    assert trapped.focusing_time == pytest.approx(2.4)
    assert 0.1 < trapped.focusing_spread < 1.5
    assert rows["came to levitate"].share == 0.8
    assert rows["still moving"].count == 1
    assert rows["still moving"].focusing_time is None
    assert arrived_share(found, found.levitated_at).tolist() == [0.2, 0.4, 0.6, 0.8, 0.8]


def test_a_light_curve_counts_and_rises() -> None:
    found = ended([Fate.MOVING] * 5, [math.nan] * 5, [math.nan] * 5)
    # Speeds 0.2, 0.4 ... 1 mm/s; within 1.1 mm after 0 to 4 s.
    curve = light_curve(found, Window(outer=1.1e-3))
    assert curve.tolist() == [1.0, 1.0, 0.4, 0.2, 0.2]
    # From 1 to 0.2: a tenth of it at 1 + 0.08 / 0.6, nine tenths at 2 + (0.72 - 0.6) / 0.2.
    assert rise_time(found.times, curve) == pytest.approx((2.0 + 0.12 / 0.2) - (1.0 + 0.08 / 0.6))
    assert rise_time(found.times, np.ones(5)) is None
    assert light_curve(found, Window(bottom=0.4e-3)).max() == 0.0
    with pytest.raises(ValueError, match="expected radii of 0 or more"):
        Window(inner=2e-3, outer=1e-3)


def test_azimuths_are_kept_and_drawn_once() -> None:
    found = follow(silent(NEUTRAL), np.array([0.0, 1.0]), particles=50, seed=7)
    again = follow(silent(NEUTRAL), np.array([0.0, 1.0]), particles=50, seed=7)
    np.testing.assert_array_equal(found.azimuths, again.azimuths)
    np.testing.assert_allclose(np.hypot(*np.moveaxis(found.spatial[:, :, :2], 2, 0)), found.positions[:, :, 0])
    assert np.ptp(found.azimuths) > math.pi
    assert "50 particles over 1 s: 50 still moving" in str(found)


# --- what is refused -------------------------------------------------------------------------------------------------


def test_bad_input_is_refused() -> None:
    report = silent(NEUTRAL)
    times = np.array([0.0, 1.0])
    for wrong, words in (([0.0], "two or more times"), ([0.0, 2.0, 1.0], "ascending from 0"), ([1.0, 2.0], "from 0")):
        with pytest.raises(InputError, match=words):
            follow(report, np.array(wrong))
    with pytest.raises(InputError, match="particles: received 0; expected at least one particle"):
        follow(report, times, particles=0)
    with pytest.raises(InputError, match=r"particles\[1\]: received 'r = 1 mm, z = 0.001 mm'; expected a place in the"):
        follow(report, times, particles=np.array([[1e-3, 0.3e-3], [1e-3, 1e-6]]))
    with pytest.raises(InputError, match=r"particles\[0\]: received 'r = 9 mm"):
        follow(report, times, particles=np.array([[9e-3, 0.3e-3]]))
    with pytest.raises(InputError, match=r"an array of shape \(3,\)"):
        follow(report, times, particles=np.ones(3))
    with pytest.raises(InputError, match=r"voltage_factor: received -1\.0; expected a positive number"):
        follow(report, times, voltage_factor=-1.0)
    with pytest.raises(ValueError, match=r"flow has shape \(3, 2\)"):
        follow(report, times, flow=np.zeros((3, 2)))
    large = replace(report, forces=replace(report.forces, particle=bead(997.0, 0.4e-3)))
    with pytest.raises(InputError, match="particle_radius: received '400 um'; expected a particle that fits into"):
        follow(large, times, particles=3)


# --- next to walls ---------------------------------------------------------------------------------------------------


def brenner(distance: float) -> float:
    """Drag towards a plane wall over Stokes drag, of a sphere whose middle is that many radii away (Brenner 1961)."""
    alpha, total = math.acosh(distance), 0.0
    for n in range(1, 400):
        half, whole = (n + 0.5) * alpha, (2 * n + 1) * alpha
        if whole > 600.0:
            break
        top = 2.0 * math.sinh(whole) + (2 * n + 1) * math.sinh(2.0 * alpha)
        bottom = 4.0 * math.sinh(half) ** 2 - (2 * n + 1) ** 2 * math.sinh(alpha) ** 2
        total += n * (n + 1) / ((2 * n - 1) * (2 * n + 3)) * (top / bottom - 1.0)
    return 4.0 / 3.0 * math.sinh(alpha) * total


def test_the_drag_towards_a_wall_is_brenners_and_along_it_faxens() -> None:
    distance = np.array([1.05, 1.2, 1.5, 2.0, 5.0, 20.0])
    (_, d_along), (towards, d_towards) = wall_mobilities(distance)
    np.testing.assert_allclose(towards, [1.0 / brenner(each) for each in distance], rtol=1e-2)
    # Exact values along a wall: Goldman, Cox and Brenner, Chem. Eng. Sci. 22, 637 (1967).
    exact = {10.0677: 1.0591, 3.7622: 1.1738, 2.3524: 1.3079, 1.5431: 1.5675}
    found = wall_mobilities(np.array(list(exact)))[0][0]
    np.testing.assert_allclose(found, [1.0 / each for each in exact.values()], rtol=1.2e-2)
    step = 1e-6
    for each, slope in ((0, d_along), (1, d_towards)):
        ahead, behind = (wall_mobilities(distance + side * step)[each][0] for side in (1.0, -1.0))
        np.testing.assert_allclose(slope, (ahead - behind) / (2.0 * step), rtol=1e-5)
    # At the wall it is not moved towards it; far away the drag is that of Stokes.
    assert wall_mobilities(np.array([1.0]))[1][0][0] == 0.0
    assert wall_mobilities(np.array([1e6]))[1][0][0] == pytest.approx(1.0, abs=2e-6)


def test_the_slopes_of_a_velocity_near_walls_are_its_derivatives() -> None:
    report = report_of(bead(radius=40e-6), radial=666.0, p0=4e5)
    velocity = particle_velocity(report.forces, walls=walls_of(report.forces.mesh), holds=0.01)
    # The last one is within reach of the floor, which holds it.
    places = np.array([[1e-3, 60e-6], [3.9e-3, 0.3e-3], [-2e-3, 0.65e-3], [3.5e-3, 40e-6 * 1.015]])
    step = 1e-9
    cell = velocity.cells_at(np.abs(places))
    slope = velocity(places, cell, slopes=True)[1]
    for axis in (0, 1):
        moved = np.zeros(2)
        moved[axis] = step
        difference = (velocity(places + moved, cell)[0] - velocity(places - moved, cell)[0]) / (2.0 * step)
        np.testing.assert_allclose(slope[:, :, axis], difference, rtol=1e-3, atol=1e-3 * np.abs(difference).max())


def test_a_bead_comes_to_the_floor_as_brenners_drag_lets_it() -> None:
    particle = bead(2200.0)
    speed = 2 / 9 * (2200.0 - 997.0) * 9.80665 * 25e-12 / 0.890e-3
    found = follow(silent(particle), np.linspace(0.0, 60.0, 4), particles=np.array([[1e-3, 50e-6]]), near_walls=True)
    way = np.linspace(50e-6, 5e-6 * (1.0 + CONTACT), 200001) / 5e-6
    expected = -np.trapezoid(1.0 / wall_mobilities(way)[1][0], way) * 5e-6 / speed
    # Bounded by the estimated error of the last steps, 10 nm.
    assert found.stopped_at[0] == pytest.approx(expected, rel=2e-3)
    assert found.positions[0, -1, 1] == pytest.approx(5e-6 * (1.0 + CONTACT), abs=1e-9)
    # Without that drag it would be there in two thirds of the time.
    assert expected > 1.5 * 45e-6 / speed


def test_beads_that_lie_on_the_floor_are_lifted_by_a_field_that_is_strong_enough() -> None:
    ends = {}
    for p0 in (1e4, 4e5):
        report = report_of(bead(), up=9, p0=p0)
        found = follow(report, record_times(600.0), particles=40, seed=2, near_walls=True, lying=True)
        np.testing.assert_allclose(found.positions[:, 0, 1], 5e-6 * (1.0 + 2.0 * CONTACT), rtol=1e-3)
        ends[p0] = found
    assert (ends[1e4].fate == Fate.SEDIMENTED).all()
    assert (ends[4e5].fate == Fate.LEVITATED).all()
    # What lies there slides: a flow along the floor carries it, more slowly than the liquid.
    report = silent(bead())
    flow = np.zeros_like(report.forces.force)
    flow[:, 0] = -1e-6 * report.forces.mesh.points[:, 0] / RADIUS
    slid = follow(report, record_times(600.0), particles=20, flow=flow, near_walls=True, lying=True)
    assert (slid.fate == Fate.SEDIMENTED).all()
    np.testing.assert_allclose(slid.positions[:, -1, 0] / slid.positions[:, 0, 0], math.exp(-600.0 * 1e-6 / RADIUS),
                               rtol=1e-3)
    # The wall holds them one gap away, to the estimated error of a step.
    np.testing.assert_allclose(slid.positions[:, -1, 1], 5e-6 * (1.0 + CONTACT), atol=1e-8)
    # A light one lies under the lid.
    light = follow(silent(bead(900.0)), record_times(1.0), particles=5, near_walls=True, lying=True)
    np.testing.assert_allclose(HEIGHT - light.positions[:, 0, 1], 5e-6 * (1.0 + 2.0 * CONTACT), rtol=1e-3)
