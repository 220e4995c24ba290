"""The stages of a search: points weigh little at first, and admittances are smoothed, so that there are few optima."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from workbench.search.continuation import ContinuationStage, Schedule

Real = NDArray[np.float64]

#: Further deviations of the points, from little weight of the data to more.
LEVELS = (0.05, 0.01)

#: A stage at little weight.
STAGE = ContinuationStage(LEVELS[0], limit=8, tolerance=0.01)

#: The stages that every search begins with: smoothed admittances leave few ways to lay overtones on a recording.
SCHEDULE = Schedule((replace(STAGE, smoothing=0.01), STAGE))

#: Descents begin no closer to the ends of a range than this share of it.
INSIDE = 1e-4


def inside(values: Real, low: Real | float, high: Real | float) -> Real:
    """Values no closer to the ends of their range than :data:`INSIDE` of it."""
    margin = INSIDE * (high - low)
    return np.clip(values, low + margin, high - margin)


def replaced(x: Real, where: list[int], values: float | Real) -> Real:
    """x (p,) with other values at some indices."""
    y = x.copy()
    y[where] = values
    return y
