"""Steady slip of a liquid at vibrating walls, from the first-order fields.

A wall drags the liquid along in a layer of thickness delta = sqrt(2 eta / (rho w)). The product of the motions in the
layer has a mean, which drives a steady flow outside. That flow sees the layer as a velocity along the wall, the slip
(Bach and Bruus, J. Acoust. Soc. Am. 144, 766, 2018). Time factor e^{-i w t}; v is the acoustic velocity just outside
the layer, V that of the wall, d = V - v, which lies along the wall, and t, n are the unit vectors along and across it:

    slip = -1/(2w) Re{ d* t.D(d/2 - i V) - i t.(V*.grad) v + [ (2 - i)/2 div d* + i (div V* - d_n v_n*) ] d }

D is the derivative along the wall. The steps of the derivation, to leading order in delta:

- In the layer the first-order velocity is v + d e^{ikx}, k = (1 + i)/delta, x the distance from the wall. By continuity
  its normal part is V_n + x d_n v_n - (i/k) div d (1 - e^{ikx}).
- Its mean momentum flux drives the part of the steady flow that decays over the layer: eta u'' = rho t.div <v v>. Twice
  integrated from outside, a product f* g e^{ikx} in div <v v> gives i/(2w) Re{f* g}, x f* g ik e^{ikx} gives
  1/w Re{-i f* g}, and f* g e^{-2x/delta} gives 1/(4w) Re{f* g} at the wall.
- The wall carries the liquid with it: steady flow plus Stokes drift <s.grad v>, s = i V/w, vanish at its rest position.
  Terms with V_n d_n(d e^{ikx}), which are larger by 1/delta, cancel between drift and momentum, curvature included.

Everything is taken along the wall: the normal part of v is V_n up to delta, d_n v_n = div v - t.Dv - v_r / r with
div v = i w p / (rho c^2), and t.d_n v = n.Dv, because v has no curl. In axisymmetry the divergence of a tangential d is
D d + d t_r / r, that of the wall's motion t.DV + V_r / r.

A particle drifts with the liquid: its mean velocity is the steady flow plus the Stokes drift of v. This sum, and not
the steady flow alone, has no divergence and no part across the walls, to leading order in delta (the flow alone carries
the mass rho v2 + <rho1 v>, and <s.grad v> - <rho1 v>/rho has no divergence). In a standing wave the drift is zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.measure import ABOUT_AXIS, Measure
from geometry.quads import gauss_lobatto, tabulated
from workbench.acoustics.nodal import SIDES, FloatArray, IntArray, NodalArray, NodalMesh, borders, edge_nodes
from workbench.fem.elements import polynomials
from workbench.results.brief import Brief

#: Largest distance between the nodes of both sides of an interface, as a share of the edge's length.
SAME_PLACE = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class WallEdges(Brief):
    """The edges of one region's cells at one neighbour.

    ``neighbour`` is its name, "" if there is none. ``cells`` (L,) are cells of the whole mesh with their ``sides`` (L,)
    (:data:`~workbench.acoustics.nodal.SIDES`), ``nodes`` (L, k + 1) the nodes of the region there, and ``beyond`` (L, k
    + 1) those of the neighbour at the same places, empty without neighbour.
    """

    neighbour: str
    cells: IntArray
    sides: IntArray
    nodes: IntArray
    beyond: IntArray


def wall_edges(mesh: NodalMesh, region: str) -> tuple[WallEdges, ...]:
    """The border of `region` by neighbour, without mirror lines.

    Raises:
        ValueError: unknown region.
    """
    inside = np.zeros(len(mesh.cells), dtype=bool)
    inside[mesh.cells_of([region])] = True
    by_side = borders(mesh, np.where(inside, 0, -1))
    cell = np.concatenate([cells for _, cells in by_side])
    side = np.concatenate([np.full(len(cells), number) for number, cells in by_side])
    nodes = np.concatenate([edge_nodes(mesh, number, cells) for number, cells in by_side])
    other = _neighbours(mesh, cell, side)
    owner = np.where(other >= 0, mesh.region[other], -1)
    found: list[WallEdges] = []
    for number in np.unique(owner):
        own = np.flatnonzero(owner == number)
        beyond = np.empty((len(own), 0), dtype=np.int64) if number < 0 else _matched(mesh, nodes[own], other[own])
        found.append(WallEdges("" if number < 0 else mesh.regions[number], cell[own], side[own], nodes[own], beyond))
    return tuple(found)


def _neighbours(mesh: NodalMesh, cell: IntArray, side: IntArray) -> IntArray:
    """The cell (L,) beyond each side (L,); -1 for none."""
    if mesh.free:
        return mesh.neighbours[cell, side]
    result = np.full(len(cell), -1)
    there = mesh.grid.cell >= 0
    for number, (axis, step) in enumerate(SIDES):
        beside = np.full(len(mesh.cells), -1)
        beside[mesh.grid.cell[there]] = mesh.grid.beside(mesh.grid.cell, axis, step)[there]
        result[side == number] = beside[cell[side == number]]
    return result


def _matched(mesh: NodalMesh, nodes: IntArray, cells: IntArray) -> IntArray:
    """The nodes of `cells` at the places of `nodes`. Both are (L, k + 1)."""
    candidates = mesh.cells[cells].reshape(len(cells), -1)
    apart = np.linalg.norm(mesh.points[nodes][:, :, None] - mesh.points[candidates][:, None], axis=3)
    nearest = apart.argmin(axis=2)
    ends = mesh.points[nodes[:, [0, -1]]]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    if (apart.min(axis=2) > SAME_PLACE * length[:, None]).any():
        raise ValueError("the nodes of both sides of an interface are not at the same places")
    return np.take_along_axis(candidates, nearest, axis=1)


@dataclass(frozen=True, eq=False, repr=False)
class WallFields(Brief):
    """First-order fields along edges, at m points of each. They are (L, m) or (L, m, 2).

    Vectors are r, z; the time factor is e^{-i w t}. ``points`` m, ``tangent`` and ``normal`` unit vectors, ``turning``
    1/m the derivative of the tangent along the wall times the normal. ``pressure`` Pa, ``velocity`` of the liquid just
    outside the layer and ``wall`` of the wall in m/s, ``velocity_slope`` and ``wall_slope`` their derivatives along the
    wall in 1/s.
    """

    points: FloatArray
    tangent: FloatArray
    normal: FloatArray
    turning: FloatArray
    pressure: NodalArray
    velocity: NodalArray
    velocity_slope: NodalArray
    wall: NodalArray
    wall_slope: NodalArray


def wall_fields(
    mesh: NodalMesh, edges: WallEdges, *, pressure: NodalArray, velocity: NodalArray, velocity_gradient: NodalArray,
    wall: NodalArray, order: int,
) -> WallFields:
    """Fields along `edges` at the Gauss-Lobatto points of `order`.

    The nodal values are those on `mesh`. `velocity_gradient` (N, 2, 2) has the direction before the component. The
    motion `wall` (N, 2) m/s of the walls is differentiated along the wall cell by cell: at the corner of a cavity it
    has a kink.
    """
    matrix = tabulated(mesh.order, gauss_lobatto(mesh.order))[1]
    weights = polynomials(mesh.order, gauss_lobatto(order))  # (k + 1, m)

    def finer(values: NodalArray) -> NodalArray:
        return np.einsum("am,la...->lm...", weights, values)

    def along(values: NodalArray) -> NodalArray:
        return np.einsum("ba,la...->lb...", matrix, values)

    shape = mesh.points[edges.nodes]
    first = along(shape)
    slope, bend, points = finer(first), finer(along(first)), finer(shape)
    length = np.linalg.norm(slope, axis=2)
    tangent = slope / length[:, :, None]
    normal = np.stack([-tangent[:, :, 1], tangent[:, :, 0]], axis=2)
    turning = (slope[:, :, 0] * bend[:, :, 1] - slope[:, :, 1] * bend[:, :, 0]) / length**3
    moved = wall[edges.beyond]
    gradient = finer(velocity_gradient[edges.nodes])
    return WallFields(
        points, tangent, normal, turning, finer(pressure[edges.nodes]), finer(velocity[edges.nodes]),
        np.einsum("lmj,lmji->lmi", tangent, gradient), finer(moved), finer(along(moved)) / length[:, :, None])


def slip_velocity(
    fields: WallFields, *, frequency: float, density: float, sound_speed: float, measure: Measure = ABOUT_AXIS
) -> FloatArray:
    """Slip (L, m) in m/s along the tangent. The formula is that of the module. `frequency` is in Hz, `measure` is that
    of the section."""
    omega = 2.0 * np.pi * frequency
    t, n = fields.tangent, fields.normal

    def dot(one: NodalArray, other: NodalArray) -> NodalArray:
        return np.einsum("lmi,lmi->lm", one, other)

    wall_t, wall_n = dot(t, fields.wall), dot(n, fields.wall)
    wall_slope_t, wall_slope_n = dot(t, fields.wall_slope), dot(n, fields.wall_slope)
    slope_t = dot(t, fields.velocity_slope)
    apart = wall_t - dot(t, fields.velocity)
    apart_slope = wall_slope_t - slope_t
    # The liquid outside has the wall's normal velocity, and its tangential velocity minus `apart`.
    slope_n = wall_slope_n - apart * fields.turning
    divergence = 1j * omega * fields.pressure / (density * sound_speed**2)
    apart_hoop, wall_hoop, liquid_hoop = (measure.hoop(across, slope, fields.points[:, :, 0]) for across, slope in (
        (apart * t[:, :, 0], apart_slope), (fields.wall[:, :, 0], wall_slope_t), (fields.velocity[:, :, 0], slope_t)))
    across = divergence - slope_t - liquid_hoop
    bracket = (1.0 - 0.5j) * np.conj(apart_slope + apart_hoop) + 1j * np.conj(wall_slope_t + wall_hoop - across)
    total = (np.conj(apart) * (0.5 * apart_slope - 1j * wall_slope_t)
             - 1j * (np.conj(wall_t) * slope_t + np.conj(wall_n) * slope_n) + bracket * apart)
    return np.asarray(-total.real / (2.0 * omega))


def stokes_drift(velocity: NodalArray, velocity_gradient: NodalArray, frequency: float) -> FloatArray:
    """Stokes drift (..., 2) in m/s of a first-order `velocity` (..., 2).

    Its gradient is (..., 2, 2), direction first:

        <s.grad v> = 1/(2w) Im{ (v*.grad) v }        s = i v / w

    It is zero in a standing wave and k |v|^2 / (2w) along a plane travelling one.
    """
    convected = np.einsum("...j,...ji->...i", np.conj(velocity), velocity_gradient)
    return np.asarray(convected.imag / (4.0 * np.pi * frequency))
