"""Boundary conditions of a steady flow: slip at walls, corners, open surfaces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skfem.quadrature import get_quadrature
from skfem.refdom import RefLine

from geometry.quads import tabulated
from workbench.acoustics.nodal import FloatArray, IntArray, NodalMesh, edge_nodes
from workbench.acoustics.slip import WallEdges
from workbench.acoustics.stokes import FlowConditions
from workbench.results.brief import Brief

#: Angle (rad) between two walls above which they meet in a corner, where the velocity is zero. Polynomials along a
#: smooth wall are below a thousandth; doubled, a corner of 10 degrees counts as smooth.
CORNER = 0.1


@dataclass(frozen=True, eq=False, repr=False)
class WallSlip(Brief):
    """Slip along one wall of a region: ``solid`` names the region beyond.

    ``nodes`` (L, m + 1) of the mesh of the flow along every edge of a cell, ``points`` (L, m + 1, 2) their r, z in m,
    ``tangent`` (L, m + 1, 2) unit vectors, ``speed`` (L, m + 1) m/s along them.
    """

    solid: str
    nodes: IntArray
    points: FloatArray
    tangent: FloatArray
    speed: FloatArray

    @property
    def largest(self) -> float:
        """The largest |slip| in m/s."""
        return float(np.abs(self.speed).max())


def raised_edges(mesh: NodalMesh, finer: NodalMesh, edges: WallEdges) -> IntArray:
    """Nodes (L, m + 1) of `finer` along `edges`. `finer` is a region of `mesh` raised by `nodal.raised`."""
    (region,) = finer.regions
    place = np.searchsorted(mesh.cells_of([region]), edges.cells)
    result = np.empty((len(place), finer.order + 1), dtype=np.int64)
    for side in np.unique(edges.sides):
        own = edges.sides == side
        result[own] = edge_nodes(finer, int(side), place[own])
    return result


@dataclass(frozen=True, eq=False, repr=False)
class FlowBorder(Brief):
    """Nodes (N,) of a mesh by their condition.

    The conditions are ``on_wall`` and ``on_open`` surfaces, at a ``corner`` of them, and on the ``axis`` or a plane of
    symmetry; ``normal`` (N, 2) is out of the liquid, NaN inside and at corners. The normals are those of all edges at a
    node, weighted by its function, so that velocities across them have no net flux out of the region (Engelman, Sani
    and Gresho, Int. J. Numer. Meth. Fluids 2, 225, 1982).
    """

    on_wall: NDArray[np.bool_]
    on_open: NDArray[np.bool_]
    corner: NDArray[np.bool_]
    axis: NDArray[np.bool_]
    normal: FloatArray

    def conditions(self) -> FlowConditions:
        """Conditions on the velocity at all nodes. All of it is prescribed on walls, u_r on the axis or a plane of
        symmetry, and the normal part on an open surface."""
        rests = self.on_wall | self.corner | (self.axis & self.on_open)
        prescribed = np.stack([rests | self.axis, rests], axis=1)
        slides = self.on_open & ~rests
        tangent = np.stack([-self.normal[:, 1], self.normal[:, 0]], axis=1)
        return FlowConditions(prescribed, np.where(slides[:, None], tangent, np.nan))

    def along_walls(self, velocity: FloatArray) -> FloatArray:
        """The part of `velocity` (N, 2) along walls. It is zero elsewhere and at corners."""
        moves = self.on_wall & ~self.corner & ~self.axis
        normal = np.where(moves[:, None], self.normal, 0.0)
        across = (normal * velocity).sum(axis=1)
        result: FloatArray = np.where(moves[:, None], velocity - across[:, None] * normal, 0.0)
        return result


def flow_border(mesh: NodalMesh, walls: Sequence[IntArray], open_surfaces: Sequence[IntArray]) -> FlowBorder:
    """The border of a `mesh` of one region. It has walls and open surfaces. Both are nodes (L, m + 1) along edges."""
    count = len(mesh.points)
    edges = np.concatenate([*walls, *open_surfaces])
    weighted, ends = _outward(mesh, edges)
    on_wall, on_open = np.zeros((2, count), dtype=bool)
    for kind, some in ((on_wall, walls), (on_open, open_surfaces)):
        for nodes in some:
            kind[nodes] = True
    total, unit, times = np.zeros((count, 2)), np.zeros((count, 2)), np.zeros(count)
    np.add.at(total, edges, weighted)
    np.add.at(unit, edges[:, [0, -1]], ends)
    np.add.at(times, edges[:, [0, -1]], 1.0)
    # The mean of two unit vectors has the length of the cosine of half their angle.
    corner = (times > 0.0) & (np.linalg.norm(unit, axis=1) < math.cos(0.5 * CORNER) * times)
    # On the axis the weights vanish, and the mean of the normals replaces them.
    axis = mesh.mirrors.on(mesh.points[:, 0])
    chosen = np.where(axis[:, None], unit, total)
    size = np.linalg.norm(chosen, axis=1)
    known = (size > 0.0) & ~corner
    normal = np.full((count, 2), np.nan)
    normal[known] = chosen[known] / size[known, None]
    return FlowBorder(on_wall, on_open, corner, axis, normal)


def _outward(mesh: NodalMesh, edges: IntArray) -> tuple[FloatArray, FloatArray]:
    """Outward normals of edges, weighted and at their ends. The shapes are (L, m + 1, 2) and (L, 2, 2). The first are
    integrated over every edge with the function of each of its nodes."""
    order = mesh.order
    (along,), weights = get_quadrature(RefLine, 3 * order)
    value, slope = tabulated(order, along)
    place = mesh.points[edges]
    inward = _inward(mesh, edges)
    turned = np.einsum("qa,lax->lqx", slope, place)[:, :, ::-1] * [1.0, -1.0]
    measure = weights * mesh.measure.depth(np.einsum("qa,la->lq", value, place[:, :, 0]))
    sign = -np.sign(np.einsum("lqx,lx->l", turned, inward))
    weighted = np.einsum("lq,qa,lqx->lax", np.broadcast_to(measure, turned.shape[:2]), value, turned)
    at_ends = np.einsum("qa,lax->lqx", tabulated(order, np.array([0.0, 1.0]))[1], place)[:, :, ::-1] * [1.0, -1.0]
    at_ends /= np.linalg.norm(at_ends, axis=2, keepdims=True)
    return sign[:, None, None] * weighted, sign[:, None, None] * at_ends


def _inward(mesh: NodalMesh, edges: IntArray) -> FloatArray:
    """Vectors (L, 2) from every edge's middle to its cell's middle."""
    ends = {tuple(sorted(pair)): k for k, pair in enumerate(edges[:, [0, -1]].tolist())}
    result = np.empty((len(edges), 2))
    corners = mesh.cells[:, [0, -1]][:, :, [0, -1]]
    middle = mesh.points[corners].mean(axis=(1, 2))
    for cell, ((a, c), (b, d)) in enumerate(corners.tolist()):
        for pair in ((a, c), (b, d), (a, b), (c, d)):
            number = ends.get(tuple(sorted(pair)))
            if number is not None:
                result[number] = middle[cell] - mesh.points[edges[number][[0, -1]]].mean(axis=0)
    return result
