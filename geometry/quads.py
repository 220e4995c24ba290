"""Orientation of quadrilaterals, and nodes on their curved sides.

In a mesh of a stack of discs, local coordinates run along r and z. In other meshes they are chosen so that the cells on
both sides of an edge have one direction along it. Opposite sides of a cell have one direction, from cell to cell along
a strip; in the plane, a strip has two ends or closes without a twist (Agelek, Anderson, Bangerth and Barth 2017, ACM
Trans. Math. Softw. 44, 5: On orienting edges of unstructured two- and three-dimensional meshes).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

Real = NDArray[np.float64]
Integers = NDArray[np.int64]

#: The sides of a cell as pairs of corners, in the direction of the coordinate along them. The first is opposite to the
#: third, the second to the fourth.
BOTTOM, RIGHT, TOP, LEFT = (0, 1), (1, 2), (3, 2), (0, 3)


@cache
def gauss_lobatto(order: int) -> Real:
    """The order + 1 Gauss-Lobatto nodes of [0, 1]."""
    inner = legendre.legroots(legendre.legder([0.0] * order + [1.0])).real
    return np.asarray(0.5 * (1.0 + np.concatenate([[-1.0], np.sort(inner), [1.0]])))


def numbering(order: int) -> list[tuple[int, int]]:
    """Node numbers along both coordinates: corners, edges bottom, right, top, left, inside."""
    inner = range(1, order)
    return [(0, 0), (order, 0), (order, order), (0, order),
            *((k, 0) for k in inner), *((order, k) for k in inner),
            *((k, order) for k in inner), *((0, k) for k in inner),
            *((i, j) for j in inner for i in inner)]


def oriented(cells: Integers) -> Integers:
    """Anticlockwise cells (4, m) rolled so that neighbours agree in direction.

    Raises:
        ValueError: it is impossible, as on a twisted strip.
    """
    count = cells.shape[1]
    ends = np.stack([np.sort(cells[list(side)], axis=0) for side in (BOTTOM, RIGHT, TOP, LEFT)], axis=1)  # (2, 4, m)
    forwards = np.stack([cells[a] < cells[b] for a, b in (BOTTOM, RIGHT, TOP, LEFT)])
    _, edge = np.unique(ends.reshape(2, -1), axis=1, return_inverse=True)
    edge = edge.reshape(4, count)
    # From each edge to the opposite edge of a cell, and whether both have one direction relative to their node numbers.
    beside: dict[int, list[tuple[int, bool]]] = {}
    for one, other in ((0, 2), (1, 3)):
        same = forwards[one] == forwards[other]
        for a, b, alike in zip(edge[one].tolist(), edge[other].tolist(), same.tolist(), strict=True):
            beside.setdefault(a, []).append((b, alike))
            beside.setdefault(b, []).append((a, alike))
    runs: dict[int, bool] = {}
    for first in beside:
        if first in runs:
            continue
        runs[first], waiting = True, [first]
        while waiting:
            at = waiting.pop()
            for other, alike in beside[at]:
                wanted = runs[at] == alike
                if other not in runs:
                    runs[other] = wanted
                    waiting.append(other)
                elif runs[other] != wanted:
                    raise ValueError(f"the strip of cells through edge {first} is turned over")
    direction = np.array([runs[k] for k in range(len(runs))])
    along, across = (direction[edge[side]] == forwards[side] for side in (0, 1))
    # The corner at which both coordinates are zero.
    begin = np.where(along, np.where(across, 0, 3), np.where(across, 1, 2))
    return np.take_along_axis(cells, (np.arange(4)[:, None] + begin) % 4, axis=0)


def rolled(nodes: Real, cells: Integers, other: Integers) -> Real:
    """The `nodes` (2, m, k, k) of `cells` in another corner order. `cells` and `other` (4, m) are equal cells whose
    corners begin elsewhere. Both are (4, m) with equal cells whose corners begin elsewhere."""
    begin = np.argmax(cells == other[0], axis=0)
    result = np.empty_like(nodes)
    for corner, turn in enumerate((lambda x: x, lambda x: x[:, :, ::-1].swapaxes(2, 3), lambda x: x[:, :, ::-1, ::-1],
                                   lambda x: x[:, :, :, ::-1].swapaxes(2, 3))):
        chosen = begin == corner
        result[:, chosen] = turn(nodes[:, chosen])
    return result


def measures(nodes: Real) -> tuple[Real, Real, Real]:
    """Area, first moment about r = 0, and least Jacobian of cells. Each is (m,). The cells have nodes (2, m, k, k). The
    Jacobian determinant is relative to its mean. The quadrature is exact."""
    order = nodes.shape[2] - 1
    x, weights = legendre.leggauss(2 * order + 1)
    points = 0.5 * (1.0 + x)
    value, slope = tabulated(order, points)
    fields = [np.einsum("ai,bj,xmij->xmab", one, other, nodes, optimize=True)
              for one, other in ((value, value), (slope, value), (value, slope))]
    (r, _), (r_along, z_along), (r_across, z_across) = fields
    area = r_along * z_across - z_along * r_across
    weight = 0.25 * np.outer(weights, weights)
    whole = np.einsum("mab,ab->m", area, weight)
    return whole, np.einsum("mab,mab,ab->m", r, area, weight), area.min(axis=(1, 2)) / whole


def tabulated(order: int, points: Real) -> tuple[Real, Real]:
    """Values and slopes (n, order + 1) of the Lagrange polynomials. The nodes of the polynomials are Gauss-Lobatto
    points."""
    values, slopes = _coefficients(order)
    legendres = legendre.legvander(2.0 * points - 1.0, order)
    return legendres @ values, legendres[:, :-1] @ slopes


@cache
def _coefficients(order: int) -> tuple[Real, Real]:
    """Legendre coefficients of the Lagrange polynomials and of their slopes. The shapes are (order + 1, order + 1) and
    (order, order + 1)."""
    values = np.asarray(np.linalg.inv(legendre.legvander(2.0 * gauss_lobatto(order) - 1.0, order)), dtype=float)
    return values, np.asarray(2.0 * legendre.legder(values, axis=0))


def curved(points: Real, cells: Integers, nodes: Real, sides: Mapping[tuple[int, int], Real]) -> Real:
    """Node coordinates (2, m, k, k) of cells with curved sides.

    Args:
        points: (2, n) in metres.
        nodes: (k,) in [0, 1], ends included, symmetric about the middle.
        sides: node coordinates (2, k) in metres of curved sides, by the numbers of their two points.

    Inner nodes follow from the sides by transfinite interpolation (Gordon and Hall 1973, Int. J. Numer. Methods Eng. 7,
    461).
    """
    corners = points[:, cells]  # (2, 4, m)
    x = nodes

    def side(a: int, b: int) -> Real:
        straight = corners[:, a, :, None] * (1.0 - x) + corners[:, b, :, None] * x
        for cell, ends in enumerate(zip(cells[a].tolist(), cells[b].tolist(), strict=True)):
            found = sides.get(ends)
            if found is None and (back := sides.get(ends[::-1])) is not None:
                found = back[:, ::-1]
            if found is not None:
                straight[:, cell] = found
        return straight  # (2, m, k)

    bottom, right, top, left = (side(*each) for each in (BOTTOM, RIGHT, TOP, LEFT))
    up, along = x[None, None, None, :], x[None, None, :, None]
    blended = (bottom[..., None] * (1.0 - up) + top[..., None] * up
               + left[:, :, None, :] * (1.0 - along) + right[:, :, None, :] * along)
    bilinear = sum(corners[:, c, :, None, None] * u * v for c, u, v in (
        (0, 1.0 - along, 1.0 - up), (1, along, 1.0 - up), (2, along, up), (3, 1.0 - along, up)))
    return np.asarray(blended - bilinear)
