"""Nodal values on cells of any order: gradient, integral, interpolation.

A :class:`NodalMesh` has the data of a finite-element mesh for post-processing and pictures. Each node belongs to one
region, so a stress that jumps at an interface is single valued. Lengths are metres, (r, z) axisymmetric, or (x, z) in a
straight section.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.measure import ABOUT_AXIS, Measure
from workbench.acoustics import curved_cells
from workbench.acoustics.grid import SAME_LINE, CellGrid, cell_grid
from workbench.acoustics.mirrors import Mirrors, mirrors_of
from workbench.fem.elements import gauss_lobatto, lobatto_weights, polynomials
from workbench.results.brief import Brief

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
#: Real or complex values at the nodes.
NodalArray = NDArray[Any]

#: The sides of a cell, left, right, below and above: direction (0 r, 1 z) and sign.
SIDES = ((0, -1), (0, 1), (1, -1), (1, 1))
#: Largest size ratio of two cells whose nodes share a polynomial. On the reference chip, order 4: between 1.5 and 2.5
#: the stress does not change by a tenth of its error; at 4 that of the thin bond is 30 times as large, and at 20,
#: beside the smallest cells of a corner, 1000 times.
SIMILAR_SIZES = 2.0
#: Number of a neighbour's nodes used at the other end of a cell. Two make the derivative there 2.5 times as accurate
#: and three times as sensitive to noise, at any order; all of them would make it 3000 times as sensitive at order 8.
NEIGHBOUR_NODES = 2
#: Largest difference of the displacements of two cells' points, per length, at which the cells count as displaced
#: equally.
SMOOTH = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class NodalMesh(Brief):
    """Cells with Gauss-Lobatto nodes that regions do not share.

    ``points`` (N, 2) r, z in metres; ``cells`` (M, p + 1, p + 1) node numbers of every cell, the first index along r
    and the second along z, for fields of order p; ``region`` (M,) index into ``regions``. ``straight`` (N, 2) are the
    points before displacement, in rectangles between the lines of one grid; None without displacement. ``free`` cells
    have any shape and layout. ``measure`` is that of the section.

    Raises:
        ValueError: wrong shapes, an order below two, node or region numbers out of range, a clockwise cell or misplaced
            nodes, cells that overlap or that other lines cross, a node in two regions or in none.
    """

    points: FloatArray
    cells: IntArray
    region: IntArray
    regions: tuple[str, ...]
    straight: FloatArray | None = None
    free: bool = False
    measure: Measure = ABOUT_AXIS

    def __post_init__(self) -> None:
        points, cells, region = self.flat, self.cells, self.region
        if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
            raise ValueError(f"points has shape {points.shape}; expected finite (N, 2)")
        if cells.ndim != 3 or not 3 <= cells.shape[1] == cells.shape[2] or region.shape != (len(cells),):
            raise ValueError(f"cells has shape {cells.shape} and region {region.shape}; expected (M, p + 1, p + 1) for "
                             "an order p of 2 or more, and (M,)")
        if not len(cells):
            raise ValueError("there are no cells")
        if not (cells.min() >= 0 and cells.max() < len(points)):
            raise ValueError(f"cells names nodes {cells.min()} to {cells.max()}; there are {len(points)} points")
        if not (region.min() >= 0 and region.max() < len(self.regions)):
            raise ValueError(f"region holds {region.min()} to {region.max()}; there are {len(self.regions)} regions")
        owner = np.full(len(points), -1)
        owner[cells] = region[:, None, None]
        wrong = owner[cells] != region[:, None, None]
        if wrong.any():
            raise ValueError(f"node {cells[wrong][0]} belongs to two regions; duplicate it")
        if (owner < 0).any():
            raise ValueError(f"node {np.flatnonzero(owner < 0)[0]} belongs to no cell")
        if self.free:
            return
        low, high = self.boxes
        folded = (high <= low).any(axis=1)
        if folded.any():
            raise ValueError(f"cell {np.flatnonzero(folded)[0]} is clockwise or folded")
        miss = np.abs(points[cells] - grid_nodes(low, high, self.order)).max(axis=(1, 2, 3))
        off = miss > 1e-6 * (high - low).max(axis=1)
        if off.any():
            raise ValueError(f"cell {np.flatnonzero(off)[0]} is no rectangle with nodes at the Gauss-Lobatto points")
        _ = self.grid

    @property
    def order(self) -> int:
        """Polynomial order of the fields in a cell."""
        return self.cells.shape[1] - 1

    @property
    def is_grid(self) -> bool:
        """Whether the cells are rectangles between the lines of one grid."""
        return self.straight is None and not self.free

    @property
    def flat(self) -> FloatArray:
        """The points (N, 2) before displacement, in rectangles."""
        return self.points if self.straight is None else self.straight

    @property
    def shift(self) -> FloatArray | None:
        """The displacements (N, 2) from the rectangles; None without."""
        return None if self.straight is None else self.points - self.straight

    @property
    def boxes(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper r, z (M, 2) of cells as rectangles."""
        return self.flat[self.cells[:, 0, 0]], self.flat[self.cells[:, -1, -1]]

    @cached_property
    def mirrors(self) -> Mirrors:
        """The mirror lines of the mesh."""
        return mirrors_of(self.measure, self.points[:, 0])

    @property
    def _extent(self) -> tuple[FloatArray, FloatArray]:
        return self.points.min(axis=0), self.points.max(axis=0)

    @property
    def lines(self) -> tuple[FloatArray, FloatArray]:
        """Radii (n,) and heights (m,), ascending, spaced like the lines of cells."""
        if self.is_grid:
            return self.grid.r, self.grid.z
        if self.free:
            steps = max(2, math.ceil(math.sqrt(len(self.cells))))
            r, z = (np.linspace(a, b, steps) for a, b in zip(*self._extent, strict=True))
            return r, z
        return tuple(a + (line - line[0]) * ((b - a) / (line[-1] - line[0]))
                     for line, a, b in zip((self.grid.r, self.grid.z), *self._extent, strict=True))

    @cached_property
    def neighbours(self) -> IntArray:
        """Neighbours (M, 4) of free cells; see `curved_cells.beside`."""
        return curved_cells.beside(self.points, self.cells)

    @cached_property
    def grid(self) -> CellGrid:
        """The lines of the cells.

        Raises:
            ValueError: a cell is crossed by a line of another, or covers another.
        """
        return cell_grid(*self.boxes)

    def cells_of(self, regions: Sequence[str]) -> IntArray:
        """Numbers of the cells of the named regions, shape (m,), ascending.

        Raises:
            ValueError: a name that is not a region of this mesh.
        """
        unknown = [name for name in regions if name not in self.regions]
        if unknown:
            raise ValueError(f"unknown region {unknown[0]!r}; this mesh has {', '.join(self.regions)}")
        return np.flatnonzero(np.isin(self.region, [self.regions.index(name) for name in regions]))

    def nodes_of(self, regions: Sequence[str]) -> IntArray:
        """Numbers of the nodes of the named regions, shape (n,), ascending."""
        return np.unique(self.cells[self.cells_of(regions)])


def mesh_of(
    low: FloatArray, high: FloatArray, region: IntArray, regions: tuple[str, ...], *, order: int,
    measure: Measure = ABOUT_AXIS,
) -> NodalMesh:
    """The mesh of rectangles between `low` and `high` corners. Both are (M, 2) in metres.

    `region` numbers their regions, `order` is that of the nodes.

    Raises:
        ValueError: see :class:`NodalMesh`.
    """
    grid = cell_grid(low, high)
    place = np.empty((len(low), 2), dtype=np.int64)
    there = np.nonzero(grid.cell >= 0)
    place[grid.cell[there]] = np.stack(there, axis=1)
    along = np.arange(order + 1)
    number_r = place[:, 0, None, None] * order + along[:, None]
    number_z = place[:, 1, None, None] * order + along
    lines_r, lines_z = (count * order + 1 for count in grid.cell.shape)
    keys = (region[:, None, None] * lines_r + number_r) * lines_z + number_z
    _, first, cells = np.unique(keys, return_index=True, return_inverse=True)
    points = grid_nodes(low, high, order).reshape(-1, 2)[first]
    return NodalMesh(points, cells.reshape(keys.shape), region, regions, measure=measure)


def raised(mesh: NodalMesh, order: int, region: str) -> NodalMesh:
    """The cells of one region as a separate mesh with another `order`. Products of two fields are polynomials of twice
    their order, and nodes of that order represent them exactly."""
    chosen = mesh.cells_of([region])
    if mesh.free:
        points, cells = curved_cells.of_order(mesh.points, mesh.cells[chosen], order)
        return NodalMesh(points, cells, np.zeros(len(chosen), dtype=np.int64), (region,), free=True,
                         measure=mesh.measure)
    low, high = (side[chosen] for side in mesh.boxes)
    flat = mesh_of(low, high, np.zeros(len(chosen), dtype=np.int64), (region,), order=order, measure=mesh.measure)
    return flat if mesh.straight is None else replace(flat, points=transfer(mesh, mesh.points, flat),
                                                      straight=flat.points)


def transfer(mesh: NodalMesh, values: NodalArray, finer: NodalMesh) -> NodalArray:
    """Values (N', ...) at the nodes of `finer`, made by :func:`raised`. `values` (N, ...) are those of `mesh`."""
    weights = polynomials(mesh.order, gauss_lobatto(finer.order))
    (region,) = finer.regions
    inside = values[mesh.cells[mesh.cells_of([region])]]
    result = np.empty((len(finer.points), *values.shape[1:]), dtype=values.dtype)
    result[finer.cells] = np.einsum("ia,jb,mij...->mab...", weights, weights, inside, optimize=True)
    return result


def gradient(mesh: NodalMesh, values: NodalArray, regions: Sequence[str]) -> NodalArray:
    """Gradient (N, 2, ...) per metre of nodal `values` (N, ...).

    The derivatives are d/dr, then d/dz; NaN elsewhere. The derivative of a cell's polynomial is least accurate at the
    edges, where most of its nodes are. Therefore a polynomial through more nodes is differentiated, separately in each
    direction. For a node in the half of its cell towards a neighbour, it uses the nodes of both cells. For a node in a
    half without neighbour, it uses those of the cell and the next :data:`NEIGHBOUR_NODES` on its other side, since
    further ones would amplify noise there. This is polynomial-preserving recovery (Zhang & Naga, SIAM J. Sci. Comput.
    26, 1192, 2005) with interpolation instead of the least-squares fit. Cells of other regions, and those larger or
    smaller by more than :data:`SIMILAR_SIZES`, are not neighbours; free cells have none. At a node of several cells the
    gradient is their mean.

    Raises:
        ValueError: a name that is not a region of the mesh.
    """
    chosen = mesh.cells_of(regions)
    flat = values.reshape(len(mesh.points), -1)
    if mesh.free:
        result = _averaged(mesh, chosen, curved_cells.nodal_slopes(mesh.points, mesh.cells[chosen], flat))
        return result.reshape(len(mesh.points), 2, *values.shape[1:])
    result = _recovered(mesh, flat, chosen)
    if mesh.straight is not None:
        # The chain rule, with the slopes of the displacement map.
        there = np.unique(mesh.cells[chosen])
        slopes = _recovered(mesh, mesh.points, chosen)[there]
        result[there] = np.linalg.solve(slopes, result[there])
    return result.reshape(len(mesh.points), 2, *values.shape[1:])


def _recovered(mesh: NodalMesh, values: NodalArray, chosen: IntArray) -> NodalArray:
    """Derivatives (N, 2, k) along the rectangles of `values` (N, k). They are at the nodes of the cells `chosen`; NaN
    elsewhere."""
    both = [_slopes(mesh, values, chosen, axis) for axis in (0, 1)]
    return _averaged(mesh, chosen, np.stack(both, axis=-2))


def _averaged(mesh: NodalMesh, chosen: IntArray, slopes: NodalArray) -> NodalArray:
    """Nodal derivatives (N, 2, k) as means over the cells `chosen`. `slopes` are (m, p + 1, p + 1, 2, k); NaN
    elsewhere."""
    nodes = mesh.cells[chosen]
    shares = np.bincount(nodes.ravel(), minlength=len(mesh.points))
    result = np.zeros((len(mesh.points), *slopes.shape[3:]), dtype=slopes.dtype)
    np.add.at(result, nodes, slopes)
    result[shares == 0] = np.nan
    result /= np.maximum(shares, 1)[:, None, None]
    return result


def _slopes(mesh: NodalMesh, values: NodalArray, chosen: IntArray, axis: int) -> NodalArray:
    """Derivative along `axis` of `values` (N, k) in the cells `chosen`. It is (m, p + 1, p + 1, k) at their nodes."""
    order = mesh.order
    lines = mesh.cells if axis == 1 else mesh.cells.swapaxes(1, 2)  # (M, across, along)
    before, after = (_alike(mesh, axis, step)[chosen] for step in (-1, 1))
    # The half of each node; a middle node is in both by half.
    first_half = 0.5 - 0.5 * np.sign(np.round(gauss_lobatto(order) - 0.5, 9))
    result = np.zeros((len(chosen), order + 1, order + 1, values.shape[1]), dtype=np.result_type(values.dtype, float))

    def add(members: IntArray, half: FloatArray, parts: Sequence[IntArray]) -> None:
        """Add the derivative through `parts` to one half of the nodes. The first part is the cell itself."""
        windows = np.concatenate(parts, axis=2)
        matrix = half[:, None] * _differentiation(mesh.flat[windows[:, 0], axis])[:, :order + 1]
        result[members] += np.einsum("mij,mcjk->mcik", matrix, values[windows], optimize=True)

    own = lines[chosen]
    for half, towards, away, next_to, far_from in (
        (first_half, before, after, slice(0, -1), slice(1, 1 + NEIGHBOUR_NODES)),
        (1.0 - first_half, after, before, slice(1, None), slice(-1 - NEIGHBOUR_NODES, -1)),
    ):
        near = np.flatnonzero(towards >= 0)
        add(near, half, [own[near], lines[towards[near]][:, :, next_to]])
        far = np.flatnonzero((towards < 0) & (away >= 0))
        add(far, half, [own[far], lines[away[far]][:, :, far_from]])
        alone = np.flatnonzero((towards < 0) & (away < 0))
        add(alone, half, [own[alone]])
    return result if axis == 1 else result.swapaxes(1, 2)


def _alike(mesh: NodalMesh, axis: int, step: int) -> IntArray:
    """The similar neighbour (M,) of every cell along `axis`; -1 for none. It has the same region and about the same
    size."""
    there = mesh.grid.cell >= 0
    beside = np.full(len(mesh.cells), -1)
    beside[mesh.grid.cell[there]] = mesh.grid.beside(mesh.grid.cell, axis, step)[there]
    low, high = mesh.boxes
    size = (high - low)[:, axis]
    ratio = size[beside] / size
    fit = (mesh.region[beside] == mesh.region) & (ratio < SIMILAR_SIZES) & (ratio > 1.0 / SIMILAR_SIZES)
    if mesh.shift is not None:
        # A cell with another displacement is not a neighbour: on the rectangles, the field has a kink there.
        lines = np.moveaxis(mesh.shift[mesh.cells], 1 + axis, 1)
        matrix = _differentiation(gauss_lobatto(mesh.order)[None])[0]
        ends = np.einsum("ek,mkjx->emjx", matrix[[0, -1]], lines) / size[:, None, None]
        own, other = (ends[1], ends[0]) if step > 0 else (ends[0], ends[1])
        fit &= np.abs(own - other[beside]).max(axis=(1, 2)) < SMOOTH
    return np.where(fit, beside, -1)


def _differentiation(nodes: FloatArray) -> FloatArray:
    """Differentiation matrices (P, n, n) of polynomials through `nodes` (P, n). They use barycentric weights."""
    count = nodes.shape[1]
    diagonal = np.arange(count)
    apart = nodes[:, :, None] - nodes[:, None, :]
    # The products are scaled by the total length, since products of metres would underflow.
    length = np.ptp(nodes, axis=1, keepdims=True)[:, :, None]
    scaled = apart / length
    scaled[:, diagonal, diagonal] = 1.0
    weight = 1.0 / scaled.prod(axis=2)
    matrix: FloatArray = weight[:, None, :] / weight[:, :, None] / (scaled * length)
    matrix[:, diagonal, diagonal] = 0.0
    matrix[:, diagonal, diagonal] = -matrix.sum(axis=2)
    return matrix


def integrate(mesh: NodalMesh, values: NodalArray, regions: Sequence[str]) -> NodalArray:
    """Integral (...) of nodal `values` (N, ...) over `regions` by the measure. The rule is the Gauss-Lobatto rule of
    the nodes, exact for the interpolant."""
    chosen = mesh.cells_of(regions)
    weights = lobatto_weights(mesh.order)
    nodes = mesh.cells[chosen]
    if mesh.is_grid:
        low, high = (side[chosen] for side in mesh.boxes)
        area = (high - low).prod(axis=1)[:, None, None] * np.outer(weights, weights)
    else:
        slope = _differentiation(gauss_lobatto(mesh.order)[None])[0]
        along, across = (np.einsum(form, slope, mesh.points[nodes]) for form in ("ai,mijx->majx", "bj,mijx->mibx"))
        area = (along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]) * np.outer(weights, weights)
    weights = mesh.measure.depth(mesh.points[nodes, 0]) * area
    return np.tensordot(weights.ravel(), values[nodes.ravel()], axes=(0, 0))


def interpolate(mesh: NodalMesh, values: NodalArray, points: FloatArray, regions: Sequence[str]) -> NodalArray:
    """Interpolant (K, ...) of nodal `values` (N, ...) at `points` (K, 2). Points are r, z in metres; NaN outside. At a
    point where two of `regions` touch, the cell with the lower number gives the value."""
    cell, local = locate(mesh, points, regions)
    found = cell >= 0
    result = np.full((len(points), *values.shape[1:]), np.nan, dtype=np.result_type(values.dtype, float))
    result[found] = curved_cells.interpolated(mesh.cells, values, cell[found], local[found])
    return result


def locate(mesh: NodalMesh, points: FloatArray, regions: Sequence[str]) -> tuple[IntArray, FloatArray]:
    """The cells (K,) of `points` (K, 2), and local coordinates (K, 2). The cells are those of `regions`, -1 for none;
    local coordinates are 0 to 1."""
    if not mesh.is_grid:
        cells = mesh.cells_of(regions)
        found, local = curved_cells.cells_at(mesh.points, mesh.cells[cells], points)
        return np.where(found >= 0, cells[found] if cells.size else -1, -1), local
    grid = mesh.grid
    chosen = np.zeros(len(mesh.cells) + 1, dtype=bool)
    chosen[mesh.cells_of(regions)] = True
    # A point on a line, within rounding, may be in the cell on either side.
    sides = []
    for lines, place in ((grid.r, points[:, 0]), (grid.z, points[:, 1])):
        slack = SAME_LINE * (lines[-1] - lines[0])
        slots = np.stack([np.searchsorted(lines, place - slack, side="right"),
                          np.searchsorted(lines, place + slack, side="right")]) - 1
        sides.append(np.where((slots >= 0) & (slots < len(lines) - 1), slots, -1))
    found = np.full(len(points), len(mesh.cells))
    for i in sides[0]:
        for j in sides[1]:
            candidate = np.where((i >= 0) & (j >= 0), grid.cell[i, j], -1)
            found = np.where(chosen[candidate], np.minimum(found, candidate), found)
    found[found == len(mesh.cells)] = -1
    low, high = (side[found] for side in mesh.boxes)
    local = np.where(found[:, None] >= 0, (points - low) / (high - low), np.nan)
    return found, local


def raster(
    mesh: NodalMesh, values: NodalArray, r: FloatArray, z: FloatArray, regions: Sequence[str]
) -> NodalArray:
    """Interpolant (n, m) of nodal `values` at a raster.

    `r` (n,) and `z` (m,) in metres ascend. NaN outside `regions`, and at nodes that are NaN. The result is that of
    :func:`interpolate`, in a fraction of its time.
    """
    result = np.full((len(r), len(z)), np.nan, dtype=np.result_type(values.dtype, float))
    if not mesh.is_grid:
        return interpolate(mesh, values, _pairs(r, z), regions).reshape(result.shape)
    grid = mesh.grid
    columns, rows = (_within(lines, place, mesh.order) for lines, place in ((grid.r, r), (grid.z, z)))
    chosen = np.isin(np.arange(len(mesh.cells)), mesh.cells_of(regions))
    # The lowest cell number comes last: its values remain at points of several cells.
    for cell, i, j in sorted(((int(grid.cell[i, j]), i, j) for i, j in zip(*np.nonzero(grid.cell >= 0), strict=True)),
                             reverse=True):
        (across, weights_r), (up, weights_z) = columns[i], rows[j]
        if chosen[cell] and weights_r.size and weights_z.size:
            result[across, up] = weights_r.T @ values[mesh.cells[cell]] @ weights_z
    return result


def cell_raster(mesh: NodalMesh, values: NodalArray, r: FloatArray, z: FloatArray) -> NodalArray:
    """Cell values (n, m) at a raster. `values` (M,) are one per cell; NaN outside all cells."""
    if not mesh.is_grid:
        cell, _ = locate(mesh, _pairs(r, z), mesh.regions)
        return np.where(cell >= 0, values[cell], np.nan).reshape(len(r), len(z))
    lines = mesh.grid
    i, j = (np.searchsorted(line, place, side="right") - 1 for line, place in ((lines.r, r), (lines.z, z)))
    table = np.pad(lines.cell, 1, constant_values=-1)
    cell = table[i[:, None] + 1, j[None, :] + 1]
    return np.where(cell >= 0, values[cell], np.nan)


def _pairs(r: FloatArray, z: FloatArray) -> FloatArray:
    """All pairs (n m, 2) of r (n,) and z (m,)."""
    return np.stack(np.meshgrid(r, z, indexing="ij"), axis=-1).reshape(-1, 2)


def borders(mesh: NodalMesh, label: IntArray) -> list[tuple[int, IntArray]]:
    """Cells (L,) whose neighbour has another `label` (M,), for each of :data:`SIDES`. Missing neighbours and cells with
    the label -1 count too; mirror lines are left out."""
    if mesh.free:
        across = np.where(mesh.neighbours >= 0, label[mesh.neighbours], -1)
        apart = (label[:, None] >= 0) & (across != label[:, None])
        at_mirror, every = mesh.mirrors.on(mesh.points[:, 0]), np.arange(len(mesh.cells))
        return [(side, np.flatnonzero(apart[:, side] & ~at_mirror[edge_nodes(mesh, side, every)].all(axis=1)))
                for side in range(4)]
    grid = mesh.grid
    there = grid.cell >= 0
    labels = np.where(there, label[grid.cell], -1)
    found = []
    for side, (axis, step) in enumerate(SIDES):
        edge = (labels >= 0) & (grid.beside(labels, axis, step) != labels)
        if axis == 0:
            edge[mesh.mirrors.on(grid.r[:-1] if step < 0 else grid.r[1:])] = False
        found.append((side, grid.cell[edge]))
    return found


def edge_nodes(mesh: NodalMesh, side: int, cells: IntArray) -> IntArray:
    """Nodes (L, p + 1) on one side of cells. `side` is an index of :data:`SIDES`. They ascend along r or z."""
    axis, step = SIDES[side]
    return np.take(mesh.cells[cells], 0 if step < 0 else -1, axis=1 + axis)


def border_lines(mesh: NodalMesh, label: IntArray) -> IntArray:
    """Nodes (n, 2) at the ends of the lines of :func:`borders`. Lines are whole sides of rectangles, and from node to
    node along the sides of other cells."""
    found = []
    for side, cells in borders(mesh, label):
        nodes = edge_nodes(mesh, side, cells)
        nodes = nodes[:, [0, -1]] if mesh.is_grid else nodes
        found.append(np.stack([nodes[:, :-1], nodes[:, 1:]], axis=2).reshape(-1, 2))
    return np.concatenate(found)


def _within(lines: FloatArray, place: FloatArray, order: int) -> list[tuple[slice, FloatArray]]:
    """The part of `place` in every interval, with nodal weights. `place` ascends; `lines` limit the intervals. Ends are
    included; the weights are (order + 1, count)."""
    slack = SAME_LINE * (lines[-1] - lines[0])
    first = np.searchsorted(place, lines[:-1] - slack, side="left")
    last = np.searchsorted(place, lines[1:] + slack, side="right")
    parts = []
    for begin, end, low, high in zip(first, last, lines[:-1], lines[1:], strict=True):
        parts.append((slice(begin, end), polynomials(order, (place[begin:end] - low) / (high - low))))
    return parts


def grid_nodes(low: FloatArray, high: FloatArray, order: int) -> FloatArray:
    """Gauss-Lobatto nodes (M, order + 1, order + 1, 2) of rectangles. The rectangles are from `low` (M, 2) to `high`
    (M, 2)."""
    local = np.stack(np.meshgrid(gauss_lobatto(order), gauss_lobatto(order), indexing="ij"), axis=-1)
    nodes: FloatArray = low[:, None, None] + local * (high - low)[:, None, None]
    return nodes
