"""The slip of the boundary layers against closed forms, and against a viscous compressible liquid solved exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import j0, j1

from geometry.measure import ABOUT_AXIS, Measure, Straight
from geometry.quads import gauss_lobatto
from workbench.acoustics.nodal import NodalMesh, mesh_of
from workbench.acoustics.slip import WallFields, slip_velocity, stokes_drift, wall_edges, wall_fields

DENSITY, SPEED, FREQUENCY = 1000.0, 1500.0, 1e6
OMEGA = 2.0 * math.pi * FREQUENCY
K = OMEGA / SPEED

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


PLANE = Straight()


def slip_of(fields: WallFields, measure: Measure = PLANE) -> Real:
    return slip_velocity(fields, frequency=FREQUENCY, density=DENSITY, sound_speed=SPEED, measure=measure)


def over_a_floor(x: Real, v: Complex, slope: Complex, pressure: Complex) -> WallFields:
    """Fields along a flat floor at rest at places x (m,), from the velocity along it and its slope."""
    def vector(along: Complex, across: Complex | float = 0.0) -> Complex:
        return np.stack([along, across + 0.0 * along], axis=-1)[None]

    one = np.ones_like(x)
    nothing = np.zeros((1, x.size, 2), dtype=complex)
    return WallFields(vector(x, 0.0), vector(one, 0.0), vector(0.0 * one, 1.0), np.zeros((1, x.size)), pressure[None],
                      vector(v), vector(slope), nothing, nothing)


X = np.linspace(0.0, 2.0 * math.pi / K, 41)


def test_a_standing_wave_slips_by_three_eighths() -> None:
    """Rayleigh: towards the nodes of the velocity, 3/8 v0^2 / c."""
    v, slope = 0.7 * np.cos(K * X) + 0j, -0.7 * K * np.sin(K * X) + 0j
    found = slip_of(over_a_floor(X, v, slope, DENSITY * SPEED**2 * slope / (1j * OMEGA)))[0]
    np.testing.assert_allclose(found, 0.375 * 0.49 / SPEED * np.sin(2.0 * K * X), atol=1e-12)


def test_a_travelling_wave_slips_by_a_quarter() -> None:
    v = 0.7 * np.exp(1j * K * X)
    found = slip_of(over_a_floor(X, v, 1j * K * v, DENSITY * SPEED * v))[0]
    np.testing.assert_allclose(found, 0.25 * 0.49 / SPEED, rtol=1e-12)


def test_a_travelling_wave_drifts_by_a_half() -> None:
    v = np.stack([0.7 * np.exp(1j * K * X), 0j * X], axis=1)
    gradient = np.zeros((X.size, 2, 2), dtype=complex)
    gradient[:, 0] = 1j * K * v
    np.testing.assert_allclose(stokes_drift(v, gradient, FREQUENCY)[:, 0], 0.5 * 0.49 / SPEED, rtol=1e-12)
    standing = np.real(v) + 0j
    assert np.abs(stokes_drift(standing, np.real(gradient) + 0j, FREQUENCY)).max() == 0.0


def test_a_radial_standing_wave_slips_with_its_rings() -> None:
    """v = v0 J1(k r): -(1/4w) v v' - (1/2w) v (v' + v / r), on the axis too."""
    v, v_over_r = j1(K * X), np.where(X == 0.0, 0.5 * K, j1(K * X) / np.where(X == 0.0, 1.0, X))
    slope = K * j0(K * X) - v_over_r
    fields = over_a_floor(X, v + 0j, slope + 0j, DENSITY * SPEED**2 * (slope + v_over_r) / (1j * OMEGA))
    expected = -(0.25 * v * slope + 0.5 * v * (slope + v_over_r)) / OMEGA
    found = slip_of(fields, ABOUT_AXIS)[0]
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())
    # A plane wall of the same velocities has another slip: the rings matter.
    assert np.abs(slip_of(fields)[0] - expected).max() > 0.1 * np.abs(expected).max()


# A round body that shakes in liquid at rest: its frame is as good as the laboratory's ---------------------------------

RADIUS = 50e-6


def round_body(order: int = 6, pieces: int = 6) -> NodalMesh:
    """A half ring of liquid about a half ring of solid, in cells that are not straight, from pole to pole."""
    x = gauss_lobatto(order)
    points, cells, region = [], [], []
    for number, (inner, outer) in enumerate(((0.8 * RADIUS, RADIUS), (RADIUS, 1.3 * RADIUS))):
        along = np.unique(np.concatenate([(k + x) / pieces for k in range(pieces)]).round(13))
        turn, radius = np.meshgrid(0.5 * math.pi - math.pi * along, inner + (outer - inner) * x, indexing="ij")
        offset = number * turn.size
        points.append(np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=-1).reshape(-1, 2))
        where = offset + np.arange(turn.size).reshape(turn.shape)
        # From the upper pole clockwise along the first index, outwards along the second: anticlockwise cells.
        cells += [where[k * order:(k + 1) * order + 1] for k in range(pieces)]
        region += [1 - number] * pieces
    joined = np.concatenate(points)
    joined[np.abs(joined[:, 0]) < 1e-9 * RADIUS, 0] = 0.0
    return NodalMesh(joined, np.array(cells), np.array(region), ("cavity", "substrate"), free=True)


@pytest.mark.parametrize("axisymmetric", [False, True], ids=["cylinder", "sphere"])
@pytest.mark.parametrize(("body_speed", "liquid_speed"), [(0.0, 0.4), (0.4, 0.0), (0.3 + 0.1j, -0.2 + 0.5j)],
                         ids=["liquid shakes", "body shakes", "both, out of phase"])
def test_only_the_motion_of_a_body_against_the_liquid_counts(
    axisymmetric: bool, body_speed: complex, liquid_speed: complex
) -> None:
    """The liquid itself moves alike in all frames that shake: flow and drift together."""
    mesh = round_body()
    r, z = mesh.points.T
    radius = np.hypot(r, z)
    outward = mesh.points / radius[:, None]
    power, share = (3, 0.5) if axisymmetric else (2, 1.0)
    upwards = np.array([0.0, 1.0])  # along the axis of a sphere, across a cylinder
    # The flow of a dipole about a body that moves up against the liquid, and its gradient.
    scale = share * RADIUS**power
    along = outward @ upwards
    dipole = scale * (power * along[:, None] * outward - upwards) / radius[:, None]**power
    gradient = scale * power / radius[:, None, None]**(power + 1) * (
        upwards[None, None] * outward[:, :, None] + outward[:, None, :] * upwards[None, :, None]
        + along[:, None, None] * (np.eye(2) - (power + 2) * outward[:, :, None] * outward[:, None, :]))
    against = body_speed - liquid_speed
    velocity, gradient = against * dipole + liquid_speed * upwards, against * gradient
    (body,) = [each for each in wall_edges(mesh, "cavity") if each.neighbour == "substrate"]
    fields = wall_fields(mesh, body, pressure=0j * r, velocity=velocity, velocity_gradient=gradient,
                         wall=np.broadcast_to(body_speed * upwards + 0j, velocity.shape), order=6)
    drift = stokes_drift(velocity, gradient, FREQUENCY)[body.nodes]
    found = slip_of(fields, ABOUT_AXIS if axisymmetric else PLANE) + (fields.tangent * drift).sum(axis=2)
    # Along the wall the liquid moves at q sin(angle from the shake), relative to the body.
    place = fields.points / np.linalg.norm(fields.points, axis=2, keepdims=True)
    square = (1.0 + share)**2 * abs(against)**2
    sine, cosine = place[:, :, 0], place[:, :, 1]
    ways = np.sign(fields.tangent[:, :, 0] * cosine - fields.tangent[:, :, 1] * sine)  # of growing angle
    expected = -ways * square * sine * cosine / RADIUS * (1.25 if axisymmetric else 0.75) / OMEGA
    # Polynomials of order 6 through arcs of 30 degrees: observed 3e-6.
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def test_walls_are_found_with_the_nodes_beyond_them() -> None:
    low = np.array([(a, b) for a in (0.0, 1.0) for b in (0.0, 1.0, 2.0)])
    mesh = mesh_of(low, low + 1.0, np.array([1, 0, 3, 1, 2, 2]), ("cavity", "floor", "side", "lid"), order=3)
    found = {each.neighbour: each for each in wall_edges(mesh, "cavity")}
    assert set(found) == {"floor", "side", "lid"}  # the axis is no wall
    for name, edges in found.items():
        np.testing.assert_allclose(mesh.points[edges.nodes], mesh.points[edges.beyond], atol=1e-14)
        assert set(edges.beyond.ravel()) <= set(mesh.nodes_of([name]))


# A half space of viscous compressible liquid over a wall that moves --------------------------------------------------


class HalfSpace:
    """Sound in a viscous liquid over a wall that moves along and across itself, as exponentials that are exact.

    To first order each wave number q along the wall has a wave that comes in, one that goes out, and one of shear. Each
    pair of them makes a mean source of exponentials, for which the equations of second order are three linear ones.
    """

    def __init__(self, layer: float, *, moving: bool) -> None:
        random = np.random.default_rng(3)
        self.viscosity = 0.5 * DENSITY * OMEGA * layer**2
        self.bulk = 2.8 * self.viscosity
        compression = OMEGA**2 / (SPEED**2 - 1j * OMEGA * (4.0 / 3.0 * self.viscosity + self.bulk) / DENSITY)
        self.modes: list[tuple[float, complex, complex, complex, bool]] = []  # q, k across, v along and across, shear
        self.wall: list[tuple[float, complex, complex]] = []
        for q in np.array([0.35, -0.6, 1.3]) * K:
            out, shear = (root if root.imag > 0.0 else -root for root in
                          (np.sqrt(square - q**2 + 0j) for square in (compression, 1j * OMEGA * DENSITY /
                                                                      self.viscosity)))
            wall, strength = (random.normal(size=2) + 1j * random.normal(size=2) for _ in range(2))
            wall = 0.5 * wall if moving else 0.0 * wall
            incoming = strength[0] * (abs(q) < K) * np.array([q, -out]) / K
            a, b = np.linalg.solve(np.array([[q / K, 1.0], [out / K, -q / shear]]), wall - incoming)
            self.modes += [(q, -out, *incoming, False), (q, out, *(a * np.array([q, out]) / K), False),
                           (q, shear, b, -b * q / shear, True)]
            self.wall.append((q, *wall))

    def at_wall(self, *, shear: bool, along: int = 0, across: int = 0) -> Complex:
        """The velocity (m, 2) at the wall, or its derivatives; the waves of shear are left out unless `shear`."""
        return sum(((1j * q)**along * (1j * k)**across * np.exp(1j * q * X))[:, None] * np.array([u, v])
                   for q, k, u, v, sheared in self.modes if shear or not sheared)

    def wall_fields(self) -> WallFields:
        """The fields that the slip is made from."""
        v, slope = self.at_wall(shear=False), self.at_wall(shear=False, along=1)
        pressure = DENSITY * SPEED**2 * (slope[:, 0] + self.at_wall(shear=False, across=1)[:, 1]) / (1j * OMEGA)
        wall, wall_slope = (sum(((1j * q)**n * np.exp(1j * q * X))[:, None] * np.array([a, b])
                                for q, a, b in self.wall) for n in (0, 1))
        flat = over_a_floor(X, v[:, 0], slope[:, 0], pressure)
        return WallFields(flat.points, flat.tangent, flat.normal, flat.turning, flat.pressure, v[None], slope[None],
                          wall[None], wall_slope[None])

    def drift(self, *, shear: bool) -> Real:
        v = self.at_wall(shear=shear)
        slopes = np.stack([self.at_wall(shear=shear, along=1), self.at_wall(shear=shear, across=1)], axis=1)
        return stokes_drift(v, slopes, FREQUENCY)

    def outside(self) -> Real:
        """The steady velocity (m, 2) at the wall without the part that decays over the layer, exactly."""
        inside = np.zeros((X.size, 2))
        eta, second = self.viscosity, self.bulk + self.viscosity / 3.0
        for qa, ka, ua, va, sheared_a in self.modes:
            for qb, kb, ub, vb, sheared_b in self.modes:
                if not (sheared_a or sheared_b):
                    continue
                q, decay = qb - qa, -(np.conj(1j * ka) + 1j * kb)
                first, other = np.conj([ua, va]), np.array([ub, vb])
                momentum = 0.5 * np.outer(first, other)
                mass = 0.5 * np.conj(DENSITY * (qa * ua + ka * va) / OMEGA) * other
                out = -(1j * q * mass[0] - decay * mass[1]) / DENSITY
                square = decay**2 - q**2
                matrix = np.array([[eta * square, 0.0, -1j * q], [0.0, eta * square, decay], [1j * q, -decay, 0.0]])
                right = [DENSITY * (1j * q * momentum[0, i] - decay * momentum[1, i]) for i in range(2)]
                right = [right[0] - second * 1j * q * out, right[1] + second * decay * out, out]
                inside += np.real(np.exp(1j * q * X)[:, None] * np.linalg.solve(matrix, np.array(right))[:2])
        return -inside - self.drift(shear=True)


@pytest.mark.parametrize(("moving", "least", "order"), [(True, 0.011, 1), (False, 6e-5, 2)])
def test_the_slip_is_that_of_a_resolved_layer(moving: bool, least: float, order: int) -> None:
    errors = []
    for layer in (2e-6, 1e-6):
        space = HalfSpace(layer, moving=moving)
        exact, found = space.outside(), slip_of(space.wall_fields())[0]
        errors.append(np.abs(exact[:, 0] - found).max() / np.abs(found).max())
    # To leading order in layer over wavelength, 7e-4 here; over walls at rest the next order is zero.
    assert errors[1] < least
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.05)


def test_the_liquid_itself_does_not_cross_a_moving_wall() -> None:
    """The flow alone does, by most of the slip: the Stokes drift takes it back."""
    errors = []
    for layer in (2e-6, 1e-6):
        space = HalfSpace(layer, moving=True)
        flow, drift = space.outside()[:, 1], space.drift(shear=False)[:, 1]
        assert np.abs(flow).max() > 0.5 * np.abs(slip_of(space.wall_fields())).max()
        errors.append(np.abs(flow + drift).max() / np.abs(flow).max())
    assert errors[1] < 0.005
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.1)
