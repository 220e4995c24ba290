"""Cells of any shape: location of points, slopes of values, neighbours.

Cells have the nodes ``points[cells]``, with ``points`` (N, 2) r, z in metres and ``cells`` (M, p + 1, p + 1) node
numbers by both local coordinates. These are from 0 to 1, with one direction on a common side of neighbours.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from geometry.quads import gauss_lobatto, tabulated
from workbench.fem.elements import polynomials

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
NodalArray = NDArray[Any]

#: Most Newton steps to the local coordinates of a point; from the middle of a cell four or five suffice.
MOST_STEPS = 20
#: Step, as a share of the cell's size, after which one more step is exact to rounding.
LAST_STEP = 1e-7
#: Distance outside a cell, as a share of its size, at which a point counts as inside.
INSIDE_WITHIN = 1e-8
#: Distance outside a cell, in local coordinates, at which the search in it ends.
GIVEN_UP_AT = 0.5
#: Largest distance, as a share of the cell's size, by which its curved sides extend past its nodes.
BEYOND_NODES = 0.05
#: Largest distance between the middles of a common side, as a share of the whole mesh.
SAME_SIDE = 1e-9


def cells_at(points: FloatArray, cells: IntArray, places: FloatArray) -> tuple[IntArray, FloatArray]:
    """The cells (K,) of `places` (K, 2), and local coordinates (K, 2). It is the lowest number if several cells contain
    the place, -1 if none does."""
    found, local = np.full(len(places), -1), np.full((len(places), 2), np.nan)
    if not len(cells):
        return found, local
    order = np.argsort(places[:, 0], kind="stable")
    radii, heights = places[order, 0], places[order, 1]
    nodes = points[cells]
    low, high = nodes.min(axis=(1, 2)), nodes.max(axis=(1, 2))
    slack = BEYOND_NODES * (high - low)
    for number in range(len(cells) - 1, -1, -1):
        begin = np.searchsorted(radii, low[number, 0] - slack[number, 0], side="left")
        end = np.searchsorted(radii, high[number, 0] + slack[number, 0], side="right")
        near = heights[begin:end]
        chosen = order[begin:end][(near >= low[number, 1] - slack[number, 1])
                                  & (near <= high[number, 1] + slack[number, 1])]
        if chosen.size:
            there = _local(nodes[number], places[chosen])
            inside = (np.abs(there - 0.5) <= 0.5 + INSIDE_WITHIN).all(axis=1)
            found[chosen[inside]], local[chosen[inside]] = number, np.clip(there[inside], 0.0, 1.0)
    return found, local


def _local(nodes: FloatArray, places: FloatArray) -> FloatArray:
    """Local coordinates (K, 2) of `places` (K, 2) in one cell. `nodes` are (p + 1, p + 1, 2). The method is Newton's;
    NaN for places far from the cell."""
    order = nodes.shape[0] - 1
    size = np.ptp(nodes, axis=(0, 1)).max()
    # Most cells are parallelograms or close to one.
    ends = nodes[[0, 0, -1, -1], [0, -1, 0, -1]]
    edges = 0.5 * np.stack([ends[2] + ends[3] - ends[0] - ends[1], ends[1] + ends[3] - ends[0] - ends[2]])
    begin, x = ends.mean(axis=0) - 0.5 * edges.sum(axis=0), gauss_lobatto(order)
    at = (places - begin) @ np.linalg.inv(edges)
    if np.abs(begin + x[:, None, None] * edges[0] + x[None, :, None] * edges[1] - nodes).max() < 1e-13 * size:
        return np.asarray(at)
    at, miss = np.clip(at, -GIVEN_UP_AT, 1.0 + GIVEN_UP_AT), np.full(len(places), np.inf)
    left = np.arange(len(places))
    for _ in range(MOST_STEPS):
        (f, df), (g, dg) = (tabulated(order, at[left, axis]) for axis in (0, 1))
        half = np.tensordot(f, nodes, axes=(1, 0))  # (K, p + 1, 2)
        apart = places[left] - np.einsum("kj,kjx->kx", g, half)
        along = np.einsum("kj,kjx->kx", g, np.tensordot(df, nodes, axes=(1, 0)))
        across = np.einsum("kj,kjx->kx", dg, half)
        area = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.stack([apart[:, 0] * across[:, 1] - apart[:, 1] * across[:, 0],
                             along[:, 0] * apart[:, 1] - along[:, 1] * apart[:, 0]], axis=1) / area[:, None]
        # Far outside a cell its polynomials are meaningless.
        at[left] = np.clip(at[left] + np.nan_to_num(step), -GIVEN_UP_AT, 1.0 + GIVEN_UP_AT)
        miss[left] = np.abs(apart).max(axis=1)
        left = left[(miss[left] > LAST_STEP * size) & (np.abs(at[left] - 0.5) < 0.5 + GIVEN_UP_AT).all(axis=1)]
        if not left.size:
            break
    at[miss > LAST_STEP * size] = np.nan
    return at


def interpolated(cells: IntArray, values: NodalArray, cell: IntArray, local: FloatArray) -> NodalArray:
    """Interpolants (K, ...) of `values` (N, ...) in known cells. `cell` is (K,), `local` the local coordinates (K,
    2)."""
    result = np.empty((len(cell), *values.shape[1:]), dtype=values.dtype)
    order = np.argsort(cell, kind="stable")
    bounds = np.flatnonzero(np.diff(cell[order], prepend=-1, append=-1))
    f, g = (tabulated(cells.shape[1] - 1, local[:, axis])[0] for axis in (0, 1))
    for begin, end in pairwise(bounds):
        some = order[begin:end]
        own = values[cells[cell[some[0]]]]
        result[some] = np.einsum("kj,kj...->k...", g[some], np.tensordot(f[some], own, axes=(1, 0)))
    return result


def nodal_slopes(points: FloatArray, cells: IntArray, values: NodalArray) -> NodalArray:
    """Derivatives along r and z at the nodes of cells. `values` are (N, k). They are (M, p + 1, p + 1, 2, k), from
    every cell's own polynomial."""
    order = cells.shape[1] - 1
    matrix = tabulated(order, gauss_lobatto(order))[1]  # (at, of)
    own = [np.stack([np.einsum("ai,mijk->majk", matrix, each), np.einsum("bj,mijk->mibk", matrix, each)], axis=-2)
           for each in (points[cells], values[cells])]
    result: NodalArray = np.linalg.solve(own[0], own[1])
    return result


def beside(points: FloatArray, cells: IntArray) -> IntArray:
    """The neighbours (M, 4) at left, right, lower and upper sides. -1 means none."""
    corners = points[cells[:, [0, -1]][:, :, [0, -1]]]  # (M, 2, 2, 2)
    sides = np.stack([corners[:, 0].mean(axis=1), corners[:, 1].mean(axis=1),
                      corners[:, :, 0].mean(axis=1), corners[:, :, 1].mean(axis=1)], axis=1).reshape(-1, 2)
    near = cKDTree(sides).query_pairs(SAME_SIDE * np.ptp(points, axis=0).max(), output_type="ndarray")
    result = np.full(len(sides), -1)
    result[near[:, 0]], result[near[:, 1]] = near[:, 1] // 4, near[:, 0] // 4
    return result.reshape(-1, 4)


def of_order(points: FloatArray, cells: IntArray, order: int) -> tuple[FloatArray, IntArray]:
    """Cells with nodes of another order: points (N', 2) and node numbers. The numbers are (M, order + 1, order + 1)."""
    weights = polynomials(cells.shape[1] - 1, gauss_lobatto(order))
    places = np.einsum("ia,jb,mijx->mabx", weights, weights, points[cells], optimize=True)
    corners, numbers = np.unique(cells[:, [0, -1]][:, :, [0, -1]], return_inverse=True)
    numbers = numbers.reshape(-1, 2, 2)
    result = np.empty((len(cells), order + 1, order + 1), dtype=np.int64)
    result[:, [[0], [-1]], [0, -1]] = numbers
    inner, count = np.arange(order - 1), corners.size
    ends = [numbers[:, 0, :], numbers[:, 1, :], numbers[:, :, 0], numbers[:, :, 1]]
    pairs, edge = np.unique(np.concatenate(ends), axis=0, return_inverse=True)
    left, right, below, above = (count + edge.reshape(4, -1)[:, :, None] * (order - 1) + inner)
    result[:, 0, 1:-1], result[:, -1, 1:-1], result[:, 1:-1, 0], result[:, 1:-1, -1] = left, right, below, above
    count += len(pairs) * (order - 1)
    own = count + np.arange(len(cells) * (order - 1) ** 2).reshape(-1, order - 1, order - 1)
    result[:, 1:-1, 1:-1] = own
    found = np.empty((count + own.size, 2))
    found[result] = places
    return found, result
