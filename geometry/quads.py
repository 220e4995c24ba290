"""Quadrilaterals of any layout: local coordinates that neighbours agree on, and nodes on curved sides.

A mesh of a stack of discs runs along r and along z by itself. Elsewhere the two coordinates of a cell are chosen so
that cells on both sides of an edge run along it in one direction: the sides opposite to each other run alike, from cell
to cell on a strip of them, and a strip in the plane has two ends or closes on itself, never turned over (Agelek,
Anderson, Bangerth and Barth 2017, ACM Trans. Math. Softw. 44, 5: On orienting edges of unstructured two- and
three-dimensional meshes).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Integers = NDArray[np.int64]

#: The sides of a cell: its corners from the lower to the upper end of the coordinate that runs along them, in pairs of
#: opposite ones.
BOTTOM, RIGHT, TOP, LEFT = (0, 1), (1, 2), (3, 2), (0, 3)


def oriented(cells: Integers) -> Integers:
    """Anticlockwise cells (4, m) with their corners rolled so that neighbours run along their common side alike.

    Raises:
        ValueError: there is no way, as on a strip that is turned over.
    """
    count = cells.shape[1]
    ends = np.stack([np.sort(cells[list(side)], axis=0) for side in (BOTTOM, RIGHT, TOP, LEFT)], axis=1)  # (2, 4, m)
    forwards = np.stack([cells[a] < cells[b] for a, b in (BOTTOM, RIGHT, TOP, LEFT)])
    _, edge = np.unique(ends.reshape(2, -1), axis=1, return_inverse=True)
    edge = edge.reshape(4, count)
    # From edge to the edge across a cell, and whether both run from the smaller node to the larger one if one does.
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
    # The corner that both coordinates begin at.
    begin = np.where(along, np.where(across, 0, 3), np.where(across, 1, 2))
    return np.take_along_axis(cells, (np.arange(4)[:, None] + begin) % 4, axis=0)


def curved(points: Real, cells: Integers, nodes: Real, sides: Mapping[tuple[int, int], Real]) -> Real:
    """Coordinates (2, m, k, k) of the nodes of cells (4, m), by their numbers along both coordinates.

    Args:
        points: (2, n) metres.
        nodes: (k,) of [0, 1], ends included, symmetric about the middle.
        sides: (2, k) metres of the nodes of those sides that are curved, by the numbers of their two points.

    What is inside follows from the sides by transfinite interpolation (Gordon and Hall 1973, Int. J. Numer. Methods
    Eng. 7, 461).
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
