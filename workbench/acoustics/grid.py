"""Rectangles between the lines of one grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Largest distance between two coincident lines, or of a point on a line, as a share of the grid's extent: 3e-11 m of
#: 26 mm.
SAME_LINE = 1e-9


@dataclass(frozen=True, eq=False)
class CellGrid:
    """The lines of a grid, and the cells between them. ``r`` (n + 1,) and ``z`` (m + 1,) coordinates in metres,
    ascending; ``cell`` (n, m) number of the cell between two lines of each, -1 for none."""

    r: FloatArray
    z: FloatArray
    cell: IntArray

    def beside(self, values: NDArray[Any], axis: int, step: int) -> NDArray[Any]:
        """Elements of `values` (n, m) shifted by one `step` along `axis`. `step` is 1 or -1, `axis` 0 for r and 1 for
        z; -1 enters at the edge."""
        moved: NDArray[Any] = np.roll(np.pad(values, 1, constant_values=-1), -step, axis=axis)[1:-1, 1:-1]
        return moved


def cell_grid(low: FloatArray, high: FloatArray) -> CellGrid:
    """The grid of cells between `low` and `high` corners. Both are (M, 2) in metres.

    Raises:
        ValueError: a line of another cell crosses a cell, or two cells overlap.
    """
    lines, first = [], []
    for axis in (0, 1):
        ends = np.sort(np.concatenate([low[:, axis], high[:, axis]]))
        line = ends[np.concatenate([[True], np.diff(ends) > SAME_LINE * (ends[-1] - ends[0])])]
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
