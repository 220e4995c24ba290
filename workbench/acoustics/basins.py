"""Local minima of a potential on a raster, and passes between them. Each minimum has its basin of attraction."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.acoustics.nodal import FloatArray, IntArray

_NEIGHBOURS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


def _around(values: NDArray[Any], outside: Any) -> NDArray[Any]:
    """The eight neighbours (8, n, m) of every point of a raster. Points outside it have the value `outside`."""
    rows, columns = values.shape
    padded = np.pad(values, 1, constant_values=outside)
    return np.stack([padded[1 + i:1 + i + rows, 1 + j:1 + j + columns] for i, j in _NEIGHBOURS])


def find_walls(inside: NDArray[np.bool_], *, mirrored: tuple[bool, bool]) -> NDArray[np.bool_]:
    """Mask (n, m) of the region's points that lack a neighbour. The region continues beyond the first and last column
    (along r) if `mirrored`."""
    whole, kept = _continued(inside, mirrored, 1)
    return (whole & ~_around(whole, outside=False).all(axis=0))[kept]


def _continued(
    inside: NDArray[np.bool_], mirrored: tuple[bool, bool], count: int
) -> tuple[NDArray[np.bool_], slice]:
    """A raster with mirror images beyond `mirrored` ends, and the original part. There are `count` mirrored places
    along r."""
    before, after = (count * each for each in mirrored)
    whole = np.pad(inside, ((before, after), (0, 0)), mode="reflect")
    return whole, slice(before, before + len(inside))


def find_basins(values: FloatArray) -> list[tuple[tuple[int, int], float]]:
    """Local minima, and upper levels (J) of their basins of attraction. The raster is (n, m).

    The raster is NaN outside the region. Every point belongs to the minimum at the end of its steepest descent. Passes
    join basins of attraction from the lowest up: at a pass the shallower one ends (persistence in topological data
    analysis). The deepest one ends at the highest potential.
    """
    flat = values.ravel()
    tree = _merged(values, _drained(values))
    highest = float(flat[np.isfinite(flat)].max())
    return [((each // values.shape[1], each % values.shape[1]), highest if into is None else into[1])
            for each, into in tree.items()]


def label_basins(values: FloatArray, *, least: float) -> IntArray:
    """The minimum (flat index) to which each point (n, m) drains. It is -1 outside the region. A basin of attraction no
    deeper than `least` (J) below its lowest pass belongs to the deeper one behind that pass."""
    label = _drained(values)
    tree, flat = _merged(values, label), values.ravel()
    goal = {each: each if into is None or into[1] - flat[each] > least else into[0] for each, into in tree.items()}
    renamed = np.full(values.size + 1, -1)
    for each in goal:
        end = each
        while goal[end] != end:
            end = goal[end]
        renamed[each] = end
    return np.asarray(np.where(np.isfinite(values), renamed[label], -1))


def lowest_pass(values: FloatArray, start: tuple[int, int], exits: NDArray[np.bool_]) -> float | None:
    """The lowest flood level (J) that joins `start` to an exit. The raster is (n, m). None if the region has no
    exit."""
    from scipy.ndimage import label

    inside = np.isfinite(values)
    levels = np.unique(values[inside & (values >= values[start])])

    def joined(level: float) -> bool:
        parts, _ = label(inside & (values <= level), structure=np.ones((3, 3)))
        return bool((exits & (parts == parts[start])).any())

    if not joined(levels[-1]):
        return None
    low, high = 0, len(levels) - 1
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if joined(levels[middle]) else (middle + 1, high)
    return float(levels[low])


def outward(inside: NDArray[np.bool_], *, mirrored: tuple[bool, bool]) -> FloatArray:
    """Unit vectors (n, m, 2) out of the region near walls. They are zero far from a wall.

    They are those of the mask averaged over 5 points in each direction, so that a slanted wall, a staircase on the
    raster, has its own direction. The region continues beyond `mirrored` ends along r.
    """
    from scipy.ndimage import uniform_filter

    whole, kept = _continued(inside, mirrored, min(len(inside) - 1, 5))
    smooth = uniform_filter(np.pad(whole, 3).astype(float), size=5)
    down = -np.stack(np.gradient(smooth), axis=-1)[3:-3, 3:-3]
    size = np.linalg.norm(down, axis=-1, keepdims=True)
    return np.asarray(np.where(size > 1e-9, down / np.maximum(size, 1e-9), 0.0)[kept])


def _drained(values: FloatArray) -> IntArray:
    """The local minimum (flat index) of the steepest descent from each point."""
    height = np.where(np.isfinite(values), values, np.inf)
    number = np.arange(height.size).reshape(height.shape)
    beside, numbers = _around(height, np.inf), _around(number, -1)
    steepest = beside.argmin(axis=0)[None]
    lower = np.take_along_axis(beside, steepest, axis=0)[0]
    goal = np.take_along_axis(numbers, steepest, axis=0)[0]
    # Of equal points, the one with the smaller number counts as lower.
    down = (lower < height) | ((lower == height) & (goal < number))
    basin = np.where(down & np.isfinite(height), goal, number).ravel()
    while True:
        further = basin[basin]
        if (further == basin).all():
            break
        basin = further
    return np.asarray(basin.reshape(height.shape))


def _merged(values: FloatArray, label: IntArray) -> dict[int, tuple[int, float] | None]:
    """Every local minimum, with its deeper neighbour and the pass (J). None for the deepest minimum, and for one
    without a pass."""
    height = np.where(np.isfinite(values), values, np.inf)
    basin, numbers = label.ravel(), _around(np.arange(height.size).reshape(height.shape), -1)
    passes: dict[tuple[int, int], float] = {}
    for other_height, other in zip(_around(height, np.inf), numbers, strict=True):
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

    tree: dict[int, tuple[int, float] | None] = dict.fromkeys(minima)
    for (one, two), at in sorted(passes.items(), key=lambda item: item[1]):
        deeper, shallower = sorted((bottom(one), bottom(two)), key=lambda each: (flat[each], each))
        if deeper != shallower:
            joined[shallower] = deeper
            tree[shallower] = deeper, at
    return tree
