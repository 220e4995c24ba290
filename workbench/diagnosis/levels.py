"""The stages of a search, from low data weight and smoothed admittances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from workbench.search.continuation import ContinuationStage, Schedule

Real = NDArray[np.float64]

#: Further deviations of the points, from little weight of the data to more.
LEVELS = (0.05, 0.01)

#: A stage at little weight.
STAGE = ContinuationStage(LEVELS[0], limit=20, tolerance=0.01)

#: The first stages of every search: smoothed admittances have few ways to match overtones to a recording.
SCHEDULE = Schedule((replace(STAGE, smoothing=0.01), STAGE))

#: Descents begin no closer to the ends of a range than this share of it.
INSIDE = 1e-4


def inside(values: Real, low: Real | float, high: Real | float) -> Real:
    """Values clipped to at least :data:`INSIDE` of their range from its ends."""
    margin = INSIDE * (high - low)
    return np.clip(values, low + margin, high - margin)


def replaced(x: Real, where: list[int], values: float | Real) -> Real:
    """x (p,) with other values at some indices."""
    y = x.copy()
    y[where] = values
    return y
