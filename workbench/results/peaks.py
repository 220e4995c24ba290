"""Peaks of a sampled curve, with prominences and widths.

Definitions are those of `scipy.signal.find_peaks` and `peak_widths`, whose import takes a tenth of a simulation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Indices = NDArray[np.int64]


def find_peaks(values: Real, prominence: float) -> tuple[Indices, Real]:
    """Indices (k,) of the local maxima of `values` (n,) with at least that `prominence`, and their prominences (k,).

    The prominence is the drop to the higher one of the two minima between the peak and the next higher values, or the
    ends. A flat top counts once, in its middle. No end is a peak.
    """
    starts = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
    level, stops = values[starts], np.append(starts[1:] - 1, values.size - 1)
    inner = np.flatnonzero((level[1:-1] > level[:-2]) & (level[1:-1] > level[2:])) + 1
    places = (starts[inner] + stops[inner]) // 2
    found = np.array([_prominence(values, int(place)) for place in places], dtype=float)
    kept = found >= prominence
    return places[kept], found[kept]


def half_widths(values: Real, places: Indices) -> Real:
    """Widths (k,), in samples, of the peaks of `values` (n,) at `places` (k,), at half of their prominences."""
    widths = []
    for place in map(int, places):
        height = values[place] - 0.5 * _prominence(values, place)
        low, high = place, place
        while low > 0 and values[low] > height:
            low -= 1
        while high < values.size - 1 and values[high] > height:
            high += 1
        left, right = float(low), float(high)
        if values[low] < height:
            left += (height - values[low]) / (values[low + 1] - values[low])
        if values[high] < height:
            right -= (height - values[high]) / (values[high - 1] - values[high])
        widths.append(right - left)
    return np.array(widths, dtype=float)


def _prominence(values: Real, place: int) -> float:
    higher = np.flatnonzero(values > values[place])
    before, after = higher[higher < place], higher[higher > place]
    low = values[before[-1] + 1 if before.size else 0:place + 1].min()
    high = values[place:after[0] if after.size else values.size].min()
    return float(values[place] - max(low, high))
