"""Time to focus of a particle near a trap.

It moves from 90 to 10 % of a distance, by the net force against drag.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from geometry.measure import Measure
from workbench.acoustics.nodal import FloatArray
from workbench.fem.dual import Dual

T = TypeVar("T", float, Dual)

#: Limits of a time to focus, as shares of a quarter wavelength or of the distance to a side wall. Half of the last one
#: makes the time longer by ln 2 of the e-folding time.
FROM, TO = 0.9, 0.1


def travel_time(drag: T, way: T, net: Any, weights: FloatArray) -> T:
    """Time (s) along a `way` (m) against a `drag` coefficient (N s/m).

    Inertia is negligible (a 10 um bead in water forgets its speed in microseconds), so the speed is the `net` force
    (n,) N along the way, an array or a Dual, over the drag. The time is the integral of its inverse, by a rule whose
    `weights` (n,) sum to one. It diverges logarithmically towards the trap itself.
    """
    time: T = drag * way * (weights @ net**-1.0)
    return time


def along_stiffest(measure: Measure, stiffness: Sequence[float], time_along: Callable[[int], T]) -> T:
    """The time along the stiffest direction in which particles reach the trap.

    Args:
        stiffness: N/m across and up.
        time_along: the time (s) along a direction, 0 across and 1 up. It raises ValueError if they do not reach it.

    Raises:
        ValueError: that of the stiffest direction, if particles reach the trap in none.
    """
    failures = []
    for axis in sorted(measure.focusing, key=lambda axis: -stiffness[axis]):
        try:
            return time_along(axis)
        except ValueError as error:
            failures.append(error)
    raise failures[0]
