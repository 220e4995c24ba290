"""Rectangles between the lines of one grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Two lines of a grid are one, and a point is on a line, within this part of the grid's extent: 3e-11 m of 26 mm.
TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class CellGrid:
    """The lines on which the cells of a mesh lie, and what is between them.

    ``r`` (n + 1,) and ``z`` (m + 1,) coordinates in metres, ascending; ``cell`` (n, m) number of the cell between two
    lines of each, -1 where there is none.
    """

    r: FloatArray
    z: FloatArray
    cell: IntArray

    def beside(self, values: NDArray[Any], axis: int, step: int) -> NDArray[Any]:
        """What `values` (n, m) are one `step` (1 or -1) on in direction `axis` (0 r, 1 z); -1 beyond the edge."""
        moved: NDArray[Any] = np.roll(np.pad(values, 1, constant_values=-1), -step, axis=axis)[1:-1, 1:-1]
        return moved


def cell_grid(low: FloatArray, high: FloatArray) -> CellGrid:
    """The grid of cells from `low` (M, 2) to `high` (M, 2) metres.

    Raises:
        ValueError: a cell is crossed by a line of another, or covers another.
    """
    lines, first = [], []
    for axis in (0, 1):
        ends = np.sort(np.concatenate([low[:, axis], high[:, axis]]))
        line = ends[np.concatenate([[True], np.diff(ends) > TOLERANCE * (ends[-1] - ends[0])])]
        begin, end = (np.abs(line[:, None] - side[:, axis]).argmin(axis=0) for side in (low, high))
        if (end != begin + 1).any():
            raise ValueError(f"cell {np.flatnonzero(end != begin + 1)[0]} is crossed by a line of other cells")
        lines.append(line)
        first.append(begin)
    cell = np.full((len(lines[0]) - 1, len(lines[1]) - 1), -1)
    cell[first[0], first[1]] = np.arange(len(low))
    covered = cell[first[0], first[1]] != np.arange(len(low))
    if covered.any():
        raise ValueError(f"cell {np.flatnonzero(covered)[0]} is covered by another")
    return CellGrid(lines[0], lines[1], cell)
