"""Values at the nodes of biquadratic cells: their gradient, their integral and their value at any point.

A :class:`NodalMesh` is what post-processing and pictures need of a finite-element mesh and no more. Each node belongs
to one region, so that a stress that jumps at an interface is still single valued. Lengths are metres, (r, z)
axisymmetric.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
#: Real or complex values at the nodes.
NodalArray = NDArray[Any]

#: Local coordinates of the nine nodes, in VTK's order for a biquadratic quadrilateral.
NODES = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (0, -1), (1, 0), (0, 1), (-1, 0), (0, 0)], dtype=float)

_GAUSS_POINTS, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(3)
#: Two corners of a cell count as the same coordinate, and a point as inside a cell, within this part of the size.
_TOLERANCE = 1e-7


@dataclass(frozen=True, eq=False)
class NodalMesh:
    """Nine-node, straight-sided quadrilaterals whose nodes are not shared between regions.

    ``points`` (N, 2) r, z in metres; ``cells`` (M, 9) node numbers in VTK's biquadratic-quad order (corners
    counter-clockwise, middles of bottom, right, top, left, centre); ``region`` (M,) index into ``regions``.

    Raises:
        ValueError: wrong shapes, node or region numbers out of range, a cell that is clockwise, folded or curved, a
            node in two regions or in none.
    """

    points: FloatArray
    cells: IntArray
    region: IntArray
    regions: tuple[str, ...]

    def __post_init__(self) -> None:
        points, cells, region = self.points, self.cells, self.region
        if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
            raise ValueError(f"points has shape {points.shape}; expected finite (N, 2)")
        if cells.ndim != 2 or cells.shape[1] != 9 or region.shape != (len(cells),):
            raise ValueError(f"cells has shape {cells.shape} and region {region.shape}; expected (M, 9) and (M,)")
        if len(cells) and not (cells.min() >= 0 and cells.max() < len(points)):
            raise ValueError(f"cells names nodes {cells.min()} to {cells.max()}; there are {len(points)} points")
        if len(cells) and not (region.min() >= 0 and region.max() < len(self.regions)):
            raise ValueError(f"region holds {region.min()} to {region.max()}; there are {len(self.regions)} regions")
        owner = np.full(len(points), -1)
        owner[cells] = region[:, None]
        if (owner[cells] != region[:, None]).any():
            raise ValueError(f"node {cells[owner[cells] != region[:, None]][0]} belongs to two regions; duplicate it")
        if (owner < 0).any():
            raise ValueError(f"node {np.flatnonzero(owner < 0)[0]} belongs to no cell")
        corners = points[cells[:, :4]]
        expected = np.einsum("nc,mcd->mnd", _bilinear(NODES), corners)
        size = np.ptp(corners, axis=1).max(axis=1)
        off = np.abs(points[cells] - expected).max(axis=(1, 2)) > 1e-6 * size
        if off.any():
            raise ValueError(f"cell {np.flatnonzero(off)[0]} is not straight sided with its nodes midway")
        folded = (np.linalg.det(_jacobian(corners, NODES[:4])) <= 0.0).any(axis=1)
        if folded.any():
            raise ValueError(f"cell {np.flatnonzero(folded)[0]} is clockwise or folded")

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


def shapes(local: FloatArray) -> FloatArray:
    """The nine biquadratic shape functions at `local` (..., 2) in [-1, 1]^2: shape (..., 9)."""
    x, y = _quadratics(local[..., 0]), _quadratics(local[..., 1])
    return np.stack([x[int(i) + 1] * y[int(j) + 1] for i, j in NODES], axis=-1)


def gradient(mesh: NodalMesh, values: NodalArray, regions: Sequence[str]) -> NodalArray:
    """Gradient at the nodes of `regions` of `values` (N, ...) per metre: (N, 2, ...), d/dr then d/dz; NaN elsewhere.

    The derivative of the biquadratic interpolant is only second order at the nodes: at ten cells a wavelength it is 3 %
    off at the corners. So the derivative is taken of the polynomial through all nodes of the (usually two by two)
    cells around a corner, where those nodes form a rectangular grid, which is fourth order; each node takes the patch
    in which it lies most centrally. This is polynomial-preserving recovery (Zhang & Naga, SIAM J. Sci. Comput. 26,
    1192, 2005) with interpolation in place of the least-squares fit. Nodes without such a patch (general
    quadrilaterals) take the average of the gradients in their cells, weighted by area. Regions never mix.
    """
    flat = values.reshape(len(mesh.points), -1)
    operators = gradient_operators(mesh, regions)
    # NaN outside the regions must not meet the zeros of the sparse product.
    inside = np.zeros(len(mesh.points), dtype=bool)
    inside[mesh.nodes_of(regions)] = True
    known = np.where(inside[:, None], flat, 0.0)
    result = np.stack([operator @ known for operator in operators], axis=1)
    result[~inside] = np.nan
    return result.reshape(len(mesh.points), 2, *values.shape[1:])


def gradient_operators(mesh: NodalMesh, regions: Sequence[str]) -> tuple[csr_array, csr_array]:
    """The (N, N) matrices d/dr and d/dz that :func:`gradient` applies; their rows outside `regions` are empty.

    Build them once where many fields of one mesh are differentiated.
    """
    chosen = mesh.cells_of(regions)
    # Regions share no node, so no patch reaches from one into another.
    patches = _patches(mesh, chosen)
    count = len(mesh.points)
    # Best patch first: the one with most nodes, then the one in whose middle the node lies.
    best = np.full(count, -np.inf)
    for patch in patches:
        np.maximum.at(best, patch.nodes, patch.rank[None, :])
    shares = np.zeros(count)
    for patch in patches:
        np.add.at(shares, patch.nodes, (patch.rank == best[patch.nodes]).astype(float))

    entries: list[tuple[IntArray, IntArray, FloatArray, FloatArray]] = []
    for patch in patches:
        which, row = np.nonzero(patch.rank == best[patch.nodes])
        node = patch.nodes[which, row]
        columns = patch.nodes[which]
        weight = 1.0 / shares[node][:, None]
        width = columns.shape[1]
        entries.append((np.repeat(node, width), columns.ravel(), (weight * patch.along_r[which, row]).ravel(),
                        (weight * patch.along_z[which, row]).ravel()))
    bare = np.flatnonzero(np.isin(np.arange(count), mesh.cells[chosen]) & ~np.isfinite(best))
    if len(bare):
        entries.append(_averaged(mesh, chosen, bare))
    rows, columns, along_r, along_z = (np.concatenate(part) for part in zip(*entries, strict=True))
    shape = (count, count)
    return (coo_array((along_r, (rows, columns)), shape=shape).tocsr(),
            coo_array((along_z, (rows, columns)), shape=shape).tocsr())


def integrate(mesh: NodalMesh, values: NodalArray, regions: Sequence[str]) -> NodalArray:
    """Integral over the revolved volume of `regions`, weight 2 pi r, of nodal `values` (N, ...): shape (...).

    Three Gauss points a direction: exact for the biquadratic interpolant on rectangles.
    """
    cells = mesh.cells[mesh.cells_of(regions)]
    local = np.stack(np.meshgrid(_GAUSS_POINTS, _GAUSS_POINTS, indexing="ij"), axis=-1).reshape(-1, 2)
    weights = np.outer(_GAUSS_WEIGHTS, _GAUSS_WEIGHTS).ravel()
    corners = mesh.points[cells[:, :4]]
    radius = corners[..., 0] @ _bilinear(local).T
    measure = 2.0 * np.pi * radius * np.linalg.det(_jacobian(corners, local)) * weights
    nodal_weights = (measure @ shapes(local)).ravel()
    return np.tensordot(nodal_weights, values[cells.ravel()], axes=(0, 0))


def sample(mesh: NodalMesh, values: NodalArray, points: FloatArray, regions: Sequence[str]) -> NodalArray:
    """Biquadratic interpolant of nodal `values` (N, ...) at `points` (K, 2) r, z in metres: (K, ...); NaN outside.

    Where two of `regions` touch at a point, the cell with the lower number gives the value.
    """
    cell, local = locate(mesh, points, regions)
    found = cell >= 0
    result = np.full((len(points), *values.shape[1:]), np.nan, dtype=np.result_type(values.dtype, float))
    weights = shapes(local[found])
    result[found] = np.einsum("kn,kn...->k...", weights, values[mesh.cells[cell[found]]])
    return result


def locate(mesh: NodalMesh, points: FloatArray, regions: Sequence[str]) -> tuple[IntArray, FloatArray]:
    """Cell (K,) of `regions` that holds each of `points` (K, 2), -1 where none, and local coordinates (K, 2).

    A grid of bins lists the few cells whose bounding box touches each bin; only those are tried.
    """
    chosen = mesh.cells_of(regions)
    corners = mesh.points[mesh.cells[chosen][:, :4]]
    found = np.full(len(points), -1)
    local = np.full((len(points), 2), np.nan)
    if not len(chosen) or not len(points):
        return found, local
    low, high = corners.min(axis=1), corners.max(axis=1)
    origin, extent = low.min(axis=0), np.ptp(corners.reshape(-1, 2), axis=0)
    aspect = float(np.clip(extent[0] / extent[1], 1e-2, 1e2))
    bins = np.maximum(1, np.sqrt(2.0 * len(chosen) * np.array([aspect, 1.0 / aspect]))).astype(int)

    def bin_of(place: FloatArray) -> IntArray:
        slot: IntArray = np.clip(((place - origin) / extent * bins).astype(int), 0, bins - 1)
        return slot

    # Every (bin, cell) pair, sorted by bin: a cell covers a block of bins, so list offsets within the block.
    slack = _TOLERANCE * (high - low)
    first, last = bin_of(low - slack), bin_of(high + slack)
    span = last - first + 1
    covered = span.prod(axis=1)
    owner = np.repeat(np.arange(len(chosen)), covered)
    offset = np.arange(covered.sum()) - np.repeat(np.cumsum(covered) - covered, covered)
    bin_r = first[owner, 0] + offset // span[owner, 1]
    bin_z = first[owner, 1] + offset % span[owner, 1]
    number = bin_r * bins[1] + bin_z
    order = np.argsort(number, kind="stable")
    owner, starts = owner[order], np.searchsorted(number[order], np.arange(bins.prod() + 1))

    inside_box = ((points >= origin - _TOLERANCE * extent) & (points <= origin + (1 + _TOLERANCE) * extent)).all(axis=1)
    waiting = np.flatnonzero(inside_box)
    place = bin_of(points[waiting])
    home = place[:, 0] * bins[1] + place[:, 1]
    attempt = 0
    while len(waiting):
        remaining = starts[home] + attempt < starts[home + 1]
        waiting, home = waiting[remaining], home[remaining]
        candidate = owner[starts[home] + attempt]
        coordinate, hit = _invert(corners[candidate], points[waiting])
        found[waiting[hit]] = chosen[candidate[hit]]
        local[waiting[hit]] = coordinate[hit]
        waiting, home = waiting[~hit], home[~hit]
        attempt += 1
    return found, local


def _quadratics(x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Quadratic Lagrange polynomials of the nodes -1, 0, 1."""
    return x * (x - 1.0) / 2.0, 1.0 - x * x, x * (x + 1.0) / 2.0


def _slopes(local: FloatArray) -> FloatArray:
    """Derivatives (..., 9, 2) of the biquadratic shape functions with respect to the local coordinates."""
    x, y = local[..., 0], local[..., 1]
    shape_x, shape_y = _quadratics(x), _quadratics(y)
    slope_x, slope_y = (x - 0.5, -2.0 * x, x + 0.5), (y - 0.5, -2.0 * y, y + 0.5)
    pairs = [(int(i) + 1, int(j) + 1) for i, j in NODES]
    return np.stack([np.stack([slope_x[i] * shape_y[j], shape_x[i] * slope_y[j]], axis=-1) for i, j in pairs], axis=-2)


def _bilinear(local: FloatArray) -> FloatArray:
    """The four bilinear corner functions at `local` (K, 2): (K, 4)."""
    value: FloatArray = (1.0 + local[:, None, 0] * NODES[:4, 0]) * (1.0 + local[:, None, 1] * NODES[:4, 1]) / 4.0
    return value


def _jacobian(corners: FloatArray, local: FloatArray) -> FloatArray:
    """d(r, z)/d(local) of cells with `corners` (M, 4, 2) at `local` (K, 2): (M, K, 2, 2), local direction last."""
    slope = np.stack([NODES[:4, 0] * (1.0 + local[:, None, 1] * NODES[:4, 1]),
                      NODES[:4, 1] * (1.0 + local[:, None, 0] * NODES[:4, 0])], axis=-1) / 4.0
    jacobian: FloatArray = np.einsum("mcd,kce->mkde", corners, slope)
    return jacobian


def _invert(corners: FloatArray, points: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Local coordinates (K, 2) of `points` in cells with `corners` (K, 4, 2), and whether they lie inside.

    Newton on the bilinear map: one step on a parallelogram. Twenty are plenty for any convex cell; a point for which
    they are not enough lies far outside.
    """
    local = np.zeros_like(points)
    signs_r, signs_z = NODES[:4, 0], NODES[:4, 1]
    for _ in range(20):
        along_r, along_z = 1.0 + local[:, :1] * signs_r, 1.0 + local[:, 1:] * signs_z
        miss = points - np.einsum("kc,kcd->kd", along_r * along_z / 4.0, corners)
        first = np.einsum("kc,kcd->kd", signs_r * along_z / 4.0, corners)
        second = np.einsum("kc,kcd->kd", signs_z * along_r / 4.0, corners)
        area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        area = np.where(np.abs(area) > 0.0, area, 1.0)
        step = np.stack([miss[:, 0] * second[:, 1] - miss[:, 1] * second[:, 0],
                         miss[:, 1] * first[:, 0] - miss[:, 0] * first[:, 1]], axis=1) / area[:, None]
        local = np.clip(local + step, -3.0, 3.0)
        if np.abs(step).max(initial=0.0) < 1e-12:
            break
    inside: NDArray[np.bool_] = np.all((np.abs(local) <= 1.0 + _TOLERANCE) & (np.abs(step) < 1e-9), axis=1)
    return local, inside


@dataclass(frozen=True, eq=False)
class _Patches:
    """P rectangular patches of the same K nodes each: their nodes (P, K), the derivative in each node as weights of the
    others (P, K, K), and how well a patch serves its k-th node (K,), higher being better."""

    nodes: IntArray
    along_r: FloatArray
    along_z: FloatArray
    rank: FloatArray


def _patches(mesh: NodalMesh, cells: IntArray) -> list[_Patches]:
    """The cells around each corner node, where their nodes form a full rectangular grid, grouped by grid size."""
    corner = mesh.cells[cells][:, :4].ravel()
    owner = np.repeat(cells, 4)
    order = np.argsort(corner, kind="stable")
    _, starts, counts = np.unique(corner[order], return_index=True, return_counts=True)
    owner = owner[order]
    result: list[_Patches] = []
    for members in np.unique(counts):
        start = starts[counts == members]
        nodes = np.sort(mesh.cells[owner[start[:, None] + np.arange(members)]].reshape(len(start), -1), axis=1)
        fresh = np.concatenate([np.ones((len(nodes), 1), bool), np.diff(nodes, axis=1) > 0], axis=1)
        size = fresh.sum(axis=1)
        for width in np.unique(size):
            same = size == width
            result += _rectangular(mesh, nodes[same][fresh[same]].reshape(-1, width))
    return result


def _rectangular(mesh: NodalMesh, nodes: IntArray) -> list[_Patches]:
    """Those of the node sets `nodes` (P, K) that are full rectangular grids, grouped by their numbers of lines."""
    level_r, lines_r = _levels(mesh.points[nodes, 0])
    level_z, lines_z = _levels(mesh.points[nodes, 1])
    width = nodes.shape[1]
    full = (lines_r * lines_z == width) & (lines_r <= 5) & (lines_z <= 5)
    key = level_r * lines_z[:, None] + level_z
    order = np.argsort(key, axis=1, kind="stable")
    full &= (np.take_along_axis(key, order, axis=1) == np.arange(width)).all(axis=1)
    result: list[_Patches] = []
    for count_r in np.unique(lines_r[full]):
        group = full & (lines_r == count_r)
        count_z = width // int(count_r)
        ordered = np.take_along_axis(nodes[group], order[group], axis=1)
        grid = mesh.points[ordered].reshape(-1, int(count_r), count_z, 2)
        slope_r, slope_z = _differentiation(grid[:, :, 0, 0]), _differentiation(grid[:, 0, :, 1])
        along_r = np.einsum("pik,jl->pijkl", slope_r, np.eye(count_z)).reshape(-1, width, width)
        along_z = np.einsum("ik,pjl->pijkl", np.eye(int(count_r)), slope_z).reshape(-1, width, width)
        off_r, off_z = (np.abs(np.arange(count) - (count - 1) / 2) for count in (int(count_r), count_z))
        result.append(_Patches(ordered, along_r, along_z, 100.0 * width - np.add.outer(off_r, off_z).ravel()))
    return result


def _levels(coordinate: FloatArray) -> tuple[IntArray, IntArray]:
    """For each row of `coordinate` (P, K): on which of its distinct values each entry lies, and how many there are."""
    order = np.argsort(coordinate, axis=1, kind="stable")
    ascending = np.take_along_axis(coordinate, order, axis=1)
    jump = np.diff(ascending, axis=1) > 1e-6 * np.ptp(coordinate, axis=1, keepdims=True)
    rank = np.concatenate([np.zeros((len(coordinate), 1), int), np.cumsum(jump, axis=1)], axis=1)
    level = np.empty_like(rank)
    np.put_along_axis(level, order, rank, axis=1)
    return level, rank[:, -1] + 1


def _differentiation(nodes: FloatArray) -> FloatArray:
    """Differentiation matrices (P, n, n) of the polynomials through `nodes` (P, n), by barycentric weights."""
    count = nodes.shape[1]
    apart = nodes[:, :, None] - nodes[:, None, :] + np.eye(count)
    weight = 1.0 / apart.prod(axis=2)
    matrix: FloatArray = weight[:, None, :] / weight[:, :, None] / apart
    matrix[:, np.arange(count), np.arange(count)] = 0.0
    matrix[:, np.arange(count), np.arange(count)] = -matrix.sum(axis=2)
    return matrix


def _averaged(mesh: NodalMesh, cells: IntArray, nodes: IntArray) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Rows, columns and d/dr, d/dz weights of the area-weighted mean of the cells' own gradients, at `nodes`."""
    members = mesh.cells[cells]
    corners = mesh.points[members[:, :4]]
    inverse = np.linalg.inv(_jacobian(corners, NODES))
    slope = np.einsum("kne,mked->mknd", _slopes(NODES), inverse)
    area = np.linalg.det(_jacobian(corners, np.zeros((1, 2))))[:, 0]
    total = np.zeros(len(mesh.points))
    np.add.at(total, members, area[:, None])
    weighted = slope * (area[:, None] / total[members])[:, :, None, None]
    cell, local = np.nonzero(np.isin(members, nodes))
    rows = np.repeat(members[cell, local], 9)
    picked = weighted[cell, local]
    return rows, members[cell].ravel(), picked[..., 0].ravel(), picked[..., 1].ravel()
