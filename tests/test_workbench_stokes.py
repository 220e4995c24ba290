"""Stokes flow against closed forms, with orders of convergence."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import j1, jn_zeros

from geometry.measure import ABOUT_AXIS, Measure, Parity, Straight
from materials.kinds import Fluid
from workbench.acoustics.flow_forces import TemperatureSlopes, absorption_force, thermoacoustic_force
from workbench.acoustics.flow_walls import flow_border
from workbench.acoustics.nodal import NodalMesh, edge_nodes, interpolate, mesh_of
from workbench.acoustics.slip import wall_edges
from workbench.acoustics.stokes import FlowConditions, StokesFlow, StokesSolver

Real = NDArray[np.float64]
VISCOSITY = 0.89e-3
PLANE = Straight()


def grid(width: float, height: float, across: int, up: int, order: int, measure: Measure = PLANE) -> NodalMesh:
    """A rectangle from the origin in equal cells."""
    step = np.array([width / across, height / up])
    place = np.stack(np.meshgrid(np.arange(across), np.arange(up), indexing="ij"), axis=-1).reshape(-1, 2)
    return mesh_of(place * step, (place + 1) * step, np.zeros(len(place), dtype=np.int64), ("cavity",), order=order,
                   measure=measure)


def solved(mesh: NodalMesh, velocity: Real, **load: Real) -> StokesFlow:
    """The flow with the components of `velocity` that are not NaN held."""
    conditions = FlowConditions(np.isfinite(velocity), np.full_like(velocity, np.nan))
    return StokesSolver(mesh, conditions).solve(VISCOSITY, velocity=velocity, **load)


def between_plates(ratio: float, cells: int, order: int, *, side_walls: bool = False) -> tuple[float, StokesFlow]:
    """Velocity at (w/4, h/2), per slip, of a channel w = 1 wide whose floor and lid slip by sin(2 pi x / w)."""
    width = 1.0 if side_walls else 0.5
    mesh = grid(width, ratio, (2 if side_walls else 1) * cells, cells, order)
    x, z = mesh.points.T
    velocity = np.full((len(x), 2), np.nan)
    sides, walls = (np.minimum(x, width - x) < 1e-12), (np.minimum(z, ratio - z) < 1e-12)
    velocity[sides, 0] = 0.0
    if side_walls:
        velocity[sides, 1] = 0.0
    velocity[walls] = np.stack([np.sin(2.0 * math.pi * x[walls]), 0.0 * x[walls]], axis=1)
    flow = solved(mesh, velocity)
    return float(interpolate(mesh, flow.velocity, np.array([[0.25, 0.5 * ratio]]), ["cavity"])[0, 0]), flow


def middle(ratio: float) -> float:
    """Closed form of the velocity half way between plates, per slip."""
    x = math.pi * ratio
    return (1.0 - x / math.tanh(x)) / (math.cosh(x) - x / math.sinh(x))


@pytest.mark.parametrize(("ratio", "expected"), [(160 / 380, -0.41938), (1.0, -0.19023), (1e-2, -0.49995)])
def test_parallel_plates(ratio: float, expected: float) -> None:
    found, flow = between_plates(ratio, 8, 4)
    assert middle(ratio) == pytest.approx(expected, abs=1e-5)
    # Observed 4e-8, and 6e-5 in cells 50 times as long as high; a thin gap tends to the parabola of -1/2.
    assert found == pytest.approx(middle(ratio), abs=1e-6 if ratio > 0.1 else 1e-4)
    assert flow.net_flux < 1e-10


def test_a_rectangle_with_side_walls() -> None:
    found, flow = between_plates(160 / 380, 8, 4, side_walls=True)
    assert found == pytest.approx(-0.41169, abs=1e-5)
    assert flow.net_flux < 1e-10


def plate_flow(x: Real, z: Real, ratio: float) -> Real:
    """Closed form of the flow (n, 2) between plates at z = 0 and `ratio` that slip by sin(2 pi x)."""
    k, half = 2.0 * math.pi, math.pi * ratio
    y = k * z - half
    shift = -half / math.tanh(half)
    size = math.cosh(half) + half * math.sinh(half) + shift * math.cosh(half)
    along = (np.cosh(y) + y * np.sinh(y) + shift * np.cosh(y)) / size
    up = -(y * np.cosh(y) + shift * np.sinh(y)) / size
    return np.stack([np.sin(k * x) * along, np.cos(k * x) * up], axis=1)


@pytest.mark.parametrize("order", [2, 3, 4])
def test_the_order_of_convergence(order: int) -> None:
    """The error of the velocity falls with the power k + 1 of the cells' size (Taylor-Hood)."""
    ratio, errors = 160 / 380, []
    places = np.random.default_rng(0).uniform(size=(500, 2)) * [0.5, ratio]
    for cells in (4, 8):
        mesh = grid(0.5, ratio, cells, cells, order)
        _, flow = between_plates(ratio, cells, order)
        exact = plate_flow(places[:, 0], places[:, 1], ratio)
        difference = interpolate(mesh, flow.velocity, places, ["cavity"]) - exact
        errors.append(float(np.sqrt((difference**2).mean())))
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order + 1, abs=0.4)


def test_rings_between_plates() -> None:
    """A slip of J1(k r) makes the flow of the plane one, J1 in place of the sine: the axis and the rings are right."""
    ratio = 160 / 380
    k = jn_zeros(1, 1)[0]  # the radius is 1
    height = ratio * 2.0 * math.pi / k
    mesh = grid(1.0, height, 6, 4, 4, ABOUT_AXIS)
    r, z = mesh.points.T
    velocity = np.full((len(r), 2), np.nan)
    velocity[(r == 0.0) | (r == 1.0), 0] = 0.0
    walls = np.minimum(z, height - z) < 1e-12
    velocity[walls] = np.stack([j1(k * r[walls]), 0.0 * r[walls]], axis=1)
    flow = solved(mesh, velocity)
    places = np.stack([np.linspace(0.0, 1.0, 21), np.full(21, 0.5 * height)], axis=1)
    found = interpolate(mesh, flow.velocity, places, ["cavity"])
    # Observed 3e-6.
    np.testing.assert_allclose(found[:, 0], middle(ratio) * j1(k * places[:, 0]), atol=1e-5)
    np.testing.assert_allclose(found[:, 1], 0.0, atol=1e-5)
    assert flow.net_flux < 1e-10


def test_a_strained_velocity_only_changes_the_stress() -> None:
    """eta lap (u - s) = grad p with s of the kind of a flow makes u = s, if the walls move so."""
    mesh = grid(1.0, 0.5, 3, 3, 4, ABOUT_AXIS)
    r, z = mesh.points.T
    swirl = np.stack([-4.0 * r * z**3, 2.0 * z**4], axis=1)  # no divergence, and a stress that no pressure balances
    held = np.where((np.minimum(np.minimum(z, 0.5 - z), 1.0 - r) < 1e-12)[:, None], swirl, np.nan)
    held[r == 0.0, 0] = 0.0
    flow = solved(mesh, held, strained=swirl)
    np.testing.assert_allclose(flow.velocity, swirl, atol=1e-12)


def test_thermoacoustic_flow_between_plates() -> None:
    """u = a [cos(2 pi z/h) - 1 + 6 z (h - z)/h^2], a = f0 h^2/(8 pi^2 eta), f0 = -E g kappa'/kappa."""
    water = Fluid(name="water", density=997.0, sound_speed=1497.0, shear_viscosity=VISCOSITY)
    slopes = TemperatureSlopes(density=-0.257, sound_speed=2.68)
    height, slope, energy = 160e-6, 1e3, 100.0
    mesh = grid(6.0 * height, height, 12, 6, 4)
    x, z = mesh.points.T
    pressure = math.sqrt(4.0 * energy * water.density) * water.sound_speed * np.cos(math.pi * z / height) + 0j
    force = thermoacoustic_force(water, slopes, pressure=pressure, velocity=np.zeros((len(x), 2), dtype=complex),
                                 temperature=slope * x, temperature_gradient=np.tile([slope, 0.0], (len(x), 1)),
                                 gravity=0.0)
    walls = np.minimum(np.minimum(x, 6.0 * height - x), np.minimum(z, height - z)) < 1e-12
    flow = solved(mesh, np.where(walls[:, None], np.zeros((len(x), 2)), np.nan), force=force)
    up = np.linspace(0.0, height, 41)
    found = interpolate(mesh, flow.velocity, np.stack([np.full(41, 3.0 * height), up], axis=1), ["cavity"])
    relative = -(slopes.density / water.density + 2.0 * slopes.sound_speed / water.sound_speed)  # kappa'/kappa
    strength = -energy * slope * relative * height**2 / (8.0 * math.pi**2 * VISCOSITY)
    expected = strength * (np.cos(2.0 * math.pi * up / height) - 1.0 + 6.0 * up * (height - up) / height**2)
    assert strength > 0.0  # the warm side pulls, for sound is faster there
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-3 * np.abs(expected).max())
    assert flow.net_flux < 1e-10


def test_warm_liquid_rises_and_a_wave_pushes() -> None:
    water = Fluid(name="water", density=997.0, sound_speed=1497.0, shear_viscosity=VISCOSITY, bulk_viscosity=2.5e-3)
    slopes = TemperatureSlopes(density=-0.257, sound_speed=2.68)
    still = np.zeros(1, dtype=complex), np.zeros((1, 2), dtype=complex)
    force = thermoacoustic_force(water, slopes, pressure=still[0], velocity=still[1], temperature=np.array([2.0]),
                                 temperature_gradient=np.zeros((1, 2)))
    np.testing.assert_allclose(force, [[0.0, 2.0 * 0.257 * 9.80665]], rtol=1e-12)
    # A plane wave of amplitude p: 2 alpha I / c, alpha = w^2 D / (2 c^3), I = p^2 / (2 rho c).
    diffusivity, frequency, amplitude = 3.7e-6, 1e6, 1e5
    assert water.diffusivity_of_sound == pytest.approx(diffusivity, rel=0.01)
    wave = np.array([amplitude + 0j]), np.array([[amplitude / (997.0 * 1497.0), 0j]])
    alpha = (2.0 * math.pi * frequency)**2 * diffusivity / (2.0 * 1497.0**3)
    force = absorption_force(water, diffusivity, frequency, pressure=wave[0], velocity=wave[1])
    assert force[0, 0] == pytest.approx(2.0 * alpha * amplitude**2 / (2.0 * 997.0 * 1497.0) / 1497.0, rel=1e-12)


# The border ----------------------------------------------------------------------------------------------------------


def oblique(order: int = 4) -> NodalMesh:
    """A ring whose upper side rises with r, in free cells."""
    flat = grid(1.0, 1.0, 4, 4, order)
    r, z = flat.points.T
    return NodalMesh(np.stack([r, z * (0.6 + 0.3 * r)], axis=1), flat.cells, flat.region, flat.regions, free=True)


def sides_of(mesh: NodalMesh) -> dict[int, NDArray[np.int64]]:
    (edges,) = wall_edges(mesh, "cavity")
    return {side: np.concatenate([edge_nodes(mesh, side, edges.cells[edges.sides == side])]) for side in (1, 2, 3)}


def test_the_border_has_corners_normals_and_no_net_flux() -> None:
    mesh = oblique()
    side = sides_of(mesh)
    border = flow_border(mesh, [side[1], side[2], side[3]], [])
    assert sorted(map(tuple, mesh.points[border.corner].round(9).tolist())) == [(1.0, 0.0), (1.0, 0.9)]
    top = np.setdiff1d(side[3], np.flatnonzero(border.corner))
    np.testing.assert_allclose(border.normal[top], np.tile([-0.3, 1.0] / np.hypot(0.3, 1.0), (top.size, 1)), atol=1e-9)
    wild = np.random.default_rng(1).normal(size=mesh.points.shape)
    slip = border.along_walls(wild)
    assert np.abs(slip[border.corner | border.axis]).max() == 0.0
    flow = StokesSolver(mesh, border.conditions()).solve(VISCOSITY, velocity=slip)
    assert flow.net_flux < 1e-10


def test_an_open_surface_slides_without_friction() -> None:
    """A liquid that slips over a wall below and is free above moves as a whole where its depth is even."""
    mesh = grid(6.0, 1.0, 12, 2, 4, Straight(1.0, Parity.EVEN))
    (edges,) = wall_edges(mesh, "cavity")
    floor, lid, outer = (edges.nodes[edges.sides == side] for side in (2, 3, 1))
    border = flow_border(mesh, [floor, outer], [lid])
    along = np.where(border.on_wall[:, None], [1.0, 0.0], 0.0) * mesh.points[:, :1]
    flow = StokesSolver(mesh, border.conditions()).solve(VISCOSITY, velocity=border.along_walls(
        np.where((mesh.points[:, 1] == 0.0)[:, None], along / np.maximum(mesh.points[:, :1], 1e-9), 0.0)))
    # Far from the ends: u = 1 - 3 z + 3 z^2 / 2 has no net flux and no stress at z = 1.
    z = np.linspace(0.0, 1.0, 11)
    found = interpolate(mesh, flow.velocity, np.stack([np.full(11, 3.0), z], axis=1), ["cavity"])
    np.testing.assert_allclose(found[:, 0], 1.0 - 3.0 * z + 1.5 * z**2, atol=2e-3)
    top = mesh.points[:, 1] == 1.0
    np.testing.assert_allclose(flow.velocity[top, 1], 0.0, atol=1e-14)
    assert flow.net_flux < 1e-10
