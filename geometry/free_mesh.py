"""Meshes of sections of any shape: quadrilaterals whose sides follow the curves.

Faces with four sides get rows and columns, like the rectangles of a stack of discs. gmsh fills the others with
triangles and quadrilaterals of twice the size, which are then cut into quadrilaterals; the sides of such faces are
divided twice as often.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import skfem
from numpy.typing import NDArray

from geometry.free_faces import freely
from geometry.free_section import Directed, FreeSection
from geometry.layout import SectionLayout, divisions, laid_out, numbers_along, under_electrodes
from geometry.mesh import MeshError, SectionMesh
from geometry.mesh_size import MeshSize
from geometry.quads import curved, gauss_lobatto, numbering, oriented, rolled

Real = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Plan:
    """The division of a section's faces, for sections of other sizes.

    ``layout`` has its edges, ``divided`` the shares at which each is divided, ``filled`` the inner points (2, n) and
    cells (4, m) of every face that gmsh filled, for the mesh ``size``.
    """

    layout: SectionLayout
    divided: Sequence[Real]
    filled: Mapping[int, tuple[Real, Integers]]
    size: MeshSize


def mesh_free(section: FreeSection, size: MeshSize) -> SectionMesh:
    """The mesh of a section of any shape.

    Raises:
        InputError: a region of the section has no speed.
        MeshError: a face cannot be meshed, or the mesh differs from the section.
    """
    layout = laid_out(section, size)
    divided = divisions(layout, section, size)
    on_edges, along = _on_edges(layout, divided)
    free = [face for face in range(len(layout.loops)) if face not in layout.sides]
    inside = dict(zip(free, freely(layout, free, along, on_edges, size), strict=True))
    return _named(Plan(layout, divided, inside, size), layout, section)


def moved_free(mesh: SectionMesh, section: FreeSection) -> SectionMesh:
    """The cells of `mesh` on a section that differs only in sizes.

    Divisions of edges stay. Inner points of a face that gmsh filled move by the mean of their neighbours' shifts, so a
    small change of a size is a small change of the mesh.

    Raises:
        MeshError: the section has other edges or faces, or a cell is folded.
    """
    plan = mesh.plan
    if not isinstance(plan, Plan):
        raise MeshError("only the mesh of a section of any shape is moved to another one")
    layout = laid_out(section, plan.size, plan.layout)
    if (layout.ends, layout.loops, layout.sides, layout.regions) != (
            plan.layout.ends, plan.layout.loops, plan.layout.sides, plan.layout.regions):
        raise MeshError("the section is divided into other faces at these sizes: its mesh cannot be moved there")
    return _named(plan, layout, section)


# --------------------------------------------------------------------------------------------------------------------
# Cells


@dataclass(frozen=True)
class _Made:
    """The points and cells of a mesh before it has names. ``points`` (2, n), ``cells`` (4, m), ``face`` (m,), ``nodes``
    (2, m, k, k) of every cell along both coordinates, and the points ``along`` every edge."""

    points: Real
    cells: Integers
    face: Integers
    nodes: Real
    along: list[Integers]


def _on_edges(layout: SectionLayout, divided: Sequence[Real]) -> tuple[Real, list[Integers]]:
    """The points on the edges (2, n), and their numbers by edge. The ends of edges come first."""
    points = [np.array(layout.points).T]
    count = points[0].shape[1]
    along: list[Integers] = []
    for edge, shares in enumerate(divided):
        begin, end = layout.ends[edge]
        inner = np.arange(count, count + shares.size - 2)
        along.append(np.concatenate([[begin], inner, [end]]))
        points.append(layout.edges[edge].at(shares[1:-1]))
        count += inner.size
    return np.concatenate(points, axis=1), along


def _placed(plan: Plan, layout: SectionLayout) -> _Made:
    """The cells of a plan on a layout."""
    local, divided = gauss_lobatto(plan.size.order), plan.divided
    on_edges, along = _on_edges(layout, divided)
    sides: dict[tuple[int, int], Real] = {}
    for edge, shares in enumerate(divided):
        if not layout.edges[edge].curve.is_line:
            for k, (low, high) in enumerate(pairwise(shares)):
                sides[int(along[edge][k]), int(along[edge][k + 1])] = layout.edges[edge].at(low + local * (high - low))
    points, count = [on_edges], on_edges.shape[1]
    cells, faces, nodes = [], [], []
    before = _on_edges(plan.layout, divided)[0] if plan.layout is not layout else on_edges
    for face, (inner, numbers) in plan.filled.items():
        inner = inner if before is on_edges else inner + _followed(on_edges - before, inner, numbers, count)
        points.append(inner)
        count += inner.shape[1]
        cells.append(numbers)
        nodes.append(curved(np.concatenate(points, axis=1), numbers, local, sides))
        faces.append(np.full(numbers.shape[1], face))
    for face in layout.sides:
        own, numbers, there = _block(layout, face, divided, along, local, count)
        points.append(own)
        count += own.shape[1]
        cells.append(numbers)
        nodes.append(there)
        faces.append(np.full(numbers.shape[1], face))
    return _Made(np.concatenate(points, axis=1), np.concatenate(cells, axis=1), np.concatenate(faces),
                 np.concatenate(nodes, axis=1), along)


def _followed(moved: Real, inner: Real, cells: Integers, count: int) -> Real:
    """Shifts (2, n) of inner points that follow the edge points. Those of the edge points are `moved` (2, m). Each
    shift is the mean of those of the neighbours in the cells (4, k). Inner points are numbered from `count` on."""
    pairs = np.unique(np.sort(np.concatenate([cells[[a, b]] for a, b in ((0, 1), (1, 2), (2, 3), (3, 0))], axis=1),
                              axis=0), axis=1)
    own = [np.concatenate([pairs[0], pairs[1]]), np.concatenate([pairs[1], pairs[0]])]
    from_inside = own[0] >= count
    row, other = own[0][from_inside] - count, own[1][from_inside]
    matrix, right = np.zeros((inner.shape[1], inner.shape[1])), np.zeros((inner.shape[1], 2))
    np.add.at(matrix, (row, row), 1.0)
    inside = other >= count
    np.add.at(matrix, (row[inside], other[inside] - count), -1.0)
    np.add.at(right, row[~inside], moved[:, other[~inside]].T)
    return np.asarray(np.linalg.solve(matrix, right).T)


def _block(
    layout: SectionLayout, face: int, divided: Sequence[Real], along: Sequence[Integers], local: Real, count: int
) -> tuple[Real, Integers, Real]:
    """The inner points, cells and nodes of a four-sided face. Their shapes are (2, n), (4, m) and (2, m, k, k). All
    nodes follow from the sides by transfinite interpolation. Inner points are numbered from `count` on."""
    order = local.size - 1
    bottom, right, top, left = (_sampled(layout, side, divided, local) for side in layout.sides[face])
    numbers = [numbers_along(side, along) for side in layout.sides[face]]
    x, y = (0.5 * (_position(a) + _position(b)) for a, b in ((bottom, top), (left, right)))
    u, v = x[None, :, None], y[None, None, :]
    grid = (bottom[:, :, None] * (1.0 - v) + top[:, :, None] * v + left[:, None, :] * (1.0 - u) + right[:, None, :] * u
            - bottom[:, :1, None] * (1.0 - u) * (1.0 - v) - bottom[:, -1:, None] * u * (1.0 - v)
            - top[:, :1, None] * (1.0 - u) * v - top[:, -1:, None] * u * v)
    columns, rows = numbers[0].size, numbers[1].size
    table = np.empty((columns, rows), dtype=np.int64)
    table[1:-1, 1:-1] = count + np.arange((columns - 2) * (rows - 2)).reshape(columns - 2, rows - 2)
    table[:, 0], table[-1], table[:, -1], table[0] = numbers[0], numbers[1], numbers[2], numbers[3]
    cells = np.stack([table[:-1, :-1], table[1:, :-1], table[1:, 1:], table[:-1, 1:]]).reshape(4, -1)
    coarse = grid[:, ::order, ::order]
    first, second = (np.arange(n - 1)[:, None] * order + np.arange(order + 1) for n in (columns, rows))
    nodes = grid[:, first[:, None, :, None], second[None, :, None, :]].reshape(2, -1, order + 1, order + 1)
    return coarse[:, 1:-1, 1:-1].reshape(2, -1), cells, nodes


def _sampled(layout: SectionLayout, side: Sequence[Directed], divided: Sequence[Real], local: Real) -> Real:
    """The nodes (2, n) of all elements along a side."""
    parts = []
    for number, forwards in side:
        shares = divided[number] if forwards else 1.0 - divided[number][::-1]
        fine = (shares[:-1, None] + np.diff(shares)[:, None] * local[:-1]).ravel()
        parts.append(layout.arc((number, forwards)).at(fine))
    return np.concatenate([*parts, np.array(layout.arc(side[-1]).ends[1])[:, None]], axis=1)


def _position(line: Real) -> Real:
    """Positions of a side's points (2, n) along its chord, as shares."""
    chord = line[:, -1] - line[:, 0]
    return np.asarray(chord @ (line - line[:, :1]) / (chord @ chord))


# --------------------------------------------------------------------------------------------------------------------
# Names


def _named(plan: Plan, layout: SectionLayout, section: FreeSection) -> SectionMesh:
    made, order = _placed(plan, layout), plan.size.order
    cells = oriented(made.cells)
    nodes = rolled(made.nodes, made.cells, cells)
    mesh = skfem.MeshQuad(made.points, cells)
    of_cell = np.array(layout.regions)[made.face]
    regions = {region: np.flatnonzero(of_cell == region) for region in section.regions}
    facets = _facets(layout, section, made, mesh)
    along, across = np.array(numbering(order)).T
    return SectionMesh(mesh.with_subdomains(regions).with_boundaries(facets), order, section,
                       np.ascontiguousarray(nodes[:, :, along, across].transpose(0, 2, 1)), plan)


def _facets(layout: SectionLayout, section: FreeSection, made: _Made, mesh: skfem.MeshQuad) -> dict[str, Integers]:
    """The facets of every boundary."""
    number = {(int(a), int(b)): k for k, (a, b) in enumerate(np.sort(mesh.facets, axis=0).T)}
    names = _edge_names(layout, section)
    found: dict[str, list[int]] = {name: [] for each in names for name in each}
    for edge, each in enumerate(names):
        chain = made.along[edge].tolist()
        for a, b in pairwise(chain):
            for name in each:
                found[name].append(number[min(a, b), max(a, b)])
    return {name: np.unique(each) for name, each in found.items()}


def _edge_names(layout: SectionLayout, section: FreeSection) -> list[list[str]]:
    """The boundary names of every edge, electrodes included."""
    beside, electrodes = layout.beside(), under_electrodes(layout, section)
    result = []
    for edge, arc in enumerate(layout.edges):
        name = section.name_of([layout.regions[face] for face in beside[edge]], arc)
        result.append([each for each in (name, *electrodes.get(edge, ())) if each is not None])
    return result
