"""Local minima of a potential on a raster, and how high their basins reach."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.nodal import FloatArray

_NEIGHBOURS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


def _around(values: NDArray[Any], outside: Any) -> NDArray[Any]:
    """The eight neighbours (8, n, m) of every point of a raster (n, m), those beyond its edge `outside`."""
    rows, columns = values.shape
    padded = np.pad(values, 1, constant_values=outside)
    return np.stack([padded[1 + i:1 + i + rows, 1 + j:1 + j + columns] for i, j in _NEIGHBOURS])


def find_walls(inside: NDArray[np.bool_], *, on_axis: bool) -> NDArray[np.bool_]:
    """Which points (n, m) of a region on a raster have no neighbour on some side; the field goes on behind the axis."""
    if on_axis:
        return find_walls(np.concatenate([inside[1::-1], inside[1:]]), on_axis=False)[1:]
    return inside & ~_around(inside, outside=False).all(axis=0)


def find_basins(values: FloatArray) -> list[tuple[tuple[int, int], float]]:
    """Every local minimum of a raster (n, m), NaN outside the region, and how high its basin reaches (J).

    Every point belongs to the minimum to which the steepest way down leads. From the lowest up, the passes between
    basins join them: at a pass the shallower one ends (the persistence of topological data analysis). The deepest never
    ends; it reaches up to the highest potential.
    """
    height = np.where(np.isfinite(values), values, np.inf)
    number = np.arange(height.size).reshape(height.shape)
    beside, numbers = _around(height, np.inf), _around(number, -1)
    steepest = beside.argmin(axis=0)[None]
    lower = np.take_along_axis(beside, steepest, axis=0)[0]
    goal = np.take_along_axis(numbers, steepest, axis=0)[0]
    # Of equal points the one with the smaller number is the lower.
    down = (lower < height) | ((lower == height) & (goal < number))
    basin = np.where(down & np.isfinite(height), goal, number).ravel()
    while True:
        further = basin[basin]
        if (further == basin).all():
            break
        basin = further
    label = basin.reshape(height.shape)
    passes: dict[tuple[int, int], float] = {}
    for other_height, other in zip(beside, numbers, strict=True):
        meet = np.isfinite(height) & np.isfinite(other_height)
        meet[meet] = label[meet] < basin[other[meet]]
        for one, two, at in zip(label[meet].tolist(), basin[other[meet]].tolist(),
                                np.maximum(height, other_height)[meet].tolist(), strict=True):
            passes[one, two] = min(at, passes.get((one, two), math.inf))
    flat = height.ravel()
    minima = [int(each) for each in np.unique(label[np.isfinite(height)])]
    joined = {each: each for each in minima}

    def bottom(each: int) -> int:
        while joined[each] != each:
            each = joined[each]
        return each

    reach = dict.fromkeys(minima, float(flat[np.isfinite(flat)].max()))
    for (one, two), at in sorted(passes.items(), key=lambda item: item[1]):
        deeper, shallower = sorted((bottom(one), bottom(two)), key=lambda each: (flat[each], each))
        if deeper != shallower:
            joined[shallower] = deeper
            reach[shallower] = at
    return [((each // height.shape[1], each % height.shape[1]), high) for each, high in reach.items()]
