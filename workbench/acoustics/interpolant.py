"""Values and slopes of nodal fields at many points, for moving particles.

:func:`workbench.acoustics.nodal.interpolate` is for one set of points. An :class:`Interpolant` is called thousands of
times with few points each: it caches its tables, starts at the last cell of each point, and gives slopes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geometry.quads import tabulated
from workbench.acoustics.curved_cells import BEYOND_NODES, GIVEN_UP_AT, INSIDE_WITHIN, LAST_STEP, MOST_STEPS
from workbench.acoustics.nodal import FloatArray, IntArray, NodalMesh
from workbench.results.brief import Brief

#: Number of buckets of the bounding grid per cell of a mesh that is not a grid. Doubled, a bucket has fewer cells, and
#: takes twice the memory.
BUCKETS_PER_CELL = 4


@dataclass(frozen=True, eq=False, repr=False)
class Interpolant(Brief):
    """The polynomials of the cells of `mesh` through nodal `values` (N, k)."""

    mesh: NodalMesh
    values: FloatArray

    def __call__(
        self, points: FloatArray, cell: IntArray, *, slopes: bool = False
    ) -> tuple[FloatArray, FloatArray, IntArray]:
        """Values (K, k) at `points` (K, 2), their slopes and cells (K,).

        Points are r, z in m; slopes (K, k, 2) are along r and z per m, empty (K, k, 0) unless `slopes`. The search for
        each point starts in `cell` (K,). A point outside the mesh gets the values at the nearest local coordinates of
        that cell, so that a field continues over the edge, and its cell is -1.
        """
        found, local = self._located(points, cell)
        at = np.where(found >= 0, found, cell)
        order, wide = self.mesh.order, self.values.shape[1]
        (f, df), (g, dg) = (tabulated(order, local[:, axis]) for axis in (0, 1))
        own = self._own[at]  # (K, p + 1, (p + 1) k)
        half = (f[:, None] @ own).reshape(len(points), order + 1, wide)
        values = (g[:, None] @ half)[:, 0]
        if not slopes:
            return values, np.empty((len(points), wide, 0)), found
        along = (g[:, None] @ (df[:, None] @ own).reshape(len(points), order + 1, wide))[:, 0]
        both = np.stack([along, (dg[:, None] @ half)[:, 0]], axis=2)
        if self.mesh.is_grid:
            return values, both / self._size[at][:, None], found
        return values, both @ np.linalg.inv(self._stretch(at, local)[1]), found

    def cells_at(self, points: FloatArray, cell: IntArray | None = None) -> IntArray:
        """The cells (K,) of `points` (K, 2), -1 outside the mesh. The search starts in `cell` (K,)."""
        return self._located(points, np.zeros(len(points), dtype=np.int64) if cell is None else cell)[0]

    @cached_property
    def _own(self) -> FloatArray:
        count = self.mesh.order + 1
        return np.asarray(self.values[self.mesh.cells].reshape(len(self.mesh.cells), count, -1))

    @cached_property
    def _size(self) -> FloatArray:
        low, high = self.mesh.boxes
        return high - low

    @cached_property
    def _nodes(self) -> FloatArray:
        """Node coordinates of every cell: (M, nodes along, 2 nodes across)."""
        count = self.mesh.order + 1
        return np.asarray(self.mesh.points[self.mesh.cells].reshape(len(self.mesh.cells), count, -1))

    def _stretch(self, cell: IntArray, local: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places (K, 2) of local coordinates, and derivatives (K, 2, 2)."""
        order = self.mesh.order
        (f, df), (g, dg) = (tabulated(order, local[:, axis]) for axis in (0, 1))
        own = self._nodes[cell]
        half, slope = ((each[:, None] @ own).reshape(len(cell), order + 1, 2) for each in (f, df))
        return (g[:, None] @ half)[:, 0], np.stack([(g[:, None] @ slope)[:, 0], (dg[:, None] @ half)[:, 0]], axis=2)

    def _located(self, points: FloatArray, cell: IntArray) -> tuple[IntArray, FloatArray]:
        """The cells (K,) of points, and local coordinates (K, 2). A cell is -1 outside. Outside, they are those of the
        nearest place in `cell` (K,)."""
        return self._in_grid(points, cell) if self.mesh.is_grid else self._in_curved(points, cell)

    def _in_grid(self, points: FloatArray, cell: IntArray) -> tuple[IntArray, FloatArray]:
        grid = self.mesh.grid
        found = np.full(len(points), -1)
        inside = np.ones(len(points), dtype=bool)
        slots = []
        for axis, lines in enumerate((grid.r, grid.z)):
            place = points[:, axis]
            inside &= (place >= lines[0]) & (place <= lines[-1])
            slots.append(np.clip(np.searchsorted(lines, place, side="right") - 1, 0, len(lines) - 2))
        found[inside] = grid.cell[slots[0][inside], slots[1][inside]]
        at = np.where(found >= 0, found, cell)
        return found, np.clip((points - self.mesh.boxes[0][at]) / self._size[at], 0.0, 1.0)

    def _in_curved(self, points: FloatArray, cell: IntArray) -> tuple[IntArray, FloatArray]:
        local, inside = self._newton(points, cell)
        found = np.where(inside, cell, -1)
        buckets = self._buckets
        left = np.flatnonzero(~inside)
        if left.size:
            slot = buckets.slot(points[left])
            begin, count = buckets.first[slot], buckets.first[slot + 1] - buckets.first[slot]
            for rank in range(int(count.max())):
                open_ = np.flatnonzero((rank < count) & (found[left] < 0))
                if not open_.size:
                    break
                candidate = buckets.cells[begin[open_] + rank]
                there, within = self._newton(points[left[open_]], candidate)
                taken = left[open_[within]]
                found[taken], local[taken] = candidate[within], there[within]
        return found, np.clip(local, 0.0, 1.0)

    @cached_property
    def _edges(self) -> tuple[FloatArray, FloatArray]:
        """The parallelograms of cells: corners (M, 2), inverse edges (M, 2, 2)."""
        corners = self.mesh.points[self.mesh.cells[:, [0, 0, -1, -1], [0, -1, 0, -1]]]  # (M, 4, 2)
        low_low, low_high, high_low, high_high = corners.swapaxes(0, 1)
        edges = 0.5 * np.stack([high_low + high_high - low_low - low_high,
                                low_high + high_high - low_low - high_low], axis=1)
        return np.asarray(corners.mean(axis=1) - 0.5 * edges.sum(axis=1)), np.asarray(np.linalg.inv(edges))

    @cached_property
    def _extent(self) -> FloatArray:
        """The size (M,) of every cell."""
        nodes = self.mesh.points[self.mesh.cells]
        return np.asarray(np.ptp(nodes, axis=(1, 2)).max(axis=1))

    def _newton(self, points: FloatArray, cell: IntArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Local coordinates (K, 2) of points, and whether they are inside."""
        begin, inverse = self._edges
        local = ((points - begin[cell])[:, None] @ inverse[cell])[:, 0]
        # Far outside a cell its polynomials are meaningless.
        local = np.clip(local, -GIVEN_UP_AT, 1.0 + GIVEN_UP_AT)
        close = np.zeros(len(points), dtype=bool)
        left = np.arange(len(points))
        for _ in range(MOST_STEPS):
            place, stretch = self._stretch(cell[left], local[left])
            apart = points[left] - place
            area = stretch[:, 0, 0] * stretch[:, 1, 1] - stretch[:, 0, 1] * stretch[:, 1, 0]
            with np.errstate(divide="ignore", invalid="ignore"):
                step = np.stack([
                    stretch[:, 1, 1] * apart[:, 0] - stretch[:, 0, 1] * apart[:, 1],
                    stretch[:, 0, 0] * apart[:, 1] - stretch[:, 1, 0] * apart[:, 0]], axis=1) / area[:, None]
            local[left] = np.clip(local[left] + np.nan_to_num(step), -GIVEN_UP_AT, 1.0 + GIVEN_UP_AT)
            done = np.abs(apart).max(axis=1) <= LAST_STEP * self._extent[cell[left]]
            close[left[done]] = True
            left = left[~done & (np.abs(local[left] - 0.5) < 0.5 + GIVEN_UP_AT).all(axis=1)]
            if not left.size:
                break
        return local, close & (np.abs(local - 0.5) <= 0.5 + INSIDE_WITHIN).all(axis=1)

    @cached_property
    def _buckets(self) -> _Buckets:
        return _Buckets.of(self.mesh)


@dataclass(frozen=True, eq=False)
class _Buckets:
    """A grid over a mesh, with the possible cells of points. They are ``cells[first[slot]:first[slot + 1]]``."""

    low: FloatArray
    size: FloatArray
    shape: tuple[int, int]
    first: IntArray
    cells: IntArray

    def slot(self, points: FloatArray) -> IntArray:
        """The bucket (K,) of each point, the nearest one outside the grid."""
        i, j = np.clip(((points - self.low) / self.size).astype(np.int64), 0, np.array(self.shape) - 1).T
        return np.asarray(i * self.shape[1] + j)

    @classmethod
    def of(cls, mesh: NodalMesh) -> _Buckets:
        nodes = mesh.points[mesh.cells]
        low, high = nodes.min(axis=(1, 2)), nodes.max(axis=(1, 2))
        slack = BEYOND_NODES * (high - low)
        low, high = low - slack, high + slack
        origin, extent = low.min(axis=0), np.ptp(np.concatenate([low, high]), axis=0)
        spacing = np.sqrt(extent.prod() / (BUCKETS_PER_CELL * len(nodes)))
        shape = np.maximum(1, np.ceil(extent / spacing)).astype(np.int64)
        size = extent / shape
        first, last = (np.clip(((end - origin) / size).astype(np.int64), 0, shape - 1) for end in (low, high))
        slots, numbers = [], []
        for number, (begin, end) in enumerate(zip(first, last, strict=True)):
            i, j = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(begin, end, strict=True)), indexing="ij")
            slots.append((i * shape[1] + j).ravel())
            numbers.append(np.full(i.size, number))
        slot, cells = np.concatenate(slots), np.concatenate(numbers)
        order = np.argsort(slot, kind="stable")
        counts = np.bincount(slot, minlength=int(shape.prod()))
        return cls(origin, size, (int(shape[0]), int(shape[1])), np.concatenate([[0], np.cumsum(counts)]),
                   cells[order])
