"""Peaks of a sampled curve, with prominences and widths.

Definitions are as in `scipy.signal.find_peaks` and `peak_widths`. Importing those takes a tenth of the time of a
simulation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Indices = NDArray[np.int64]


def find_peaks(values: Real, prominence: float) -> tuple[Indices, Real]:
    """Indices (k,) of local maxima of `values` (n,), and their prominences (k,).

    Peaks below `prominence` are left out. The prominence is the drop to the higher one of the two minima between the
    peak and the next higher values, or the ends. A flat top counts once, in its middle. The ends are no peaks.
    """
    starts = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
    level, stops = values[starts], np.append(starts[1:] - 1, values.size - 1)
    inner = np.flatnonzero((level[1:-1] > level[:-2]) & (level[1:-1] > level[2:])) + 1
    places = (starts[inner] + stops[inner]) // 2
    found = np.array([_prominence(values, int(place)) for place in places], dtype=float)
    kept = found >= prominence
    return places[kept], found[kept]


def half_widths(values: Real, places: Indices) -> Real:
    """Widths (k,), in samples, of peaks of `values` (n,) at half prominence. `places` (k,) are the indices of the
    peaks."""
    widths = []
    for place in map(int, places):
        height = values[place] - 0.5 * _prominence(values, place)
        low, high = place, place
        while low > 0 and values[low] > height:
            low -= 1
        while high < values.size - 1 and values[high] > height:
            high += 1
        lower, upper = float(low), float(high)
        if values[low] < height:
            lower += (height - values[low]) / (values[low + 1] - values[low])
        if values[high] < height:
            upper -= (height - values[high]) / (values[high - 1] - values[high])
        widths.append(upper - lower)
    return np.array(widths, dtype=float)


def _prominence(values: Real, place: int) -> float:
    higher = np.flatnonzero(values > values[place])
    before, after = higher[higher < place], higher[higher > place]
    low = values[before[-1] + 1 if before.size else 0:place + 1].min()
    high = values[place:after[0] if after.size else values.size].min()
    return float(values[place] - max(low, high))
