"""Mirror lines that end a section: axis or symmetry planes.

Quantities of second order in the sound (potential, force, flow) are even about all of them, planes of odd symmetry
included.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.measure import Measure
from geometry.names import AXIS, PLANE_LEFT, PLANE_RIGHT
from workbench.acoustics.grid import SAME_LINE, FloatArray


@dataclass(frozen=True)
class Mirrors:
    """Places (m) of the mirror lines at the left and right end. An end without a mirror line is None. ``slack`` (m) is
    the largest distance of a place on one."""

    left: float | None
    right: float | None
    slack: float

    @property
    def places(self) -> tuple[float, ...]:
        """The places (m) of all mirror lines."""
        return tuple(each for each in (self.left, self.right) if each is not None)

    @property
    def there(self) -> tuple[bool, bool]:
        """True at each end that has a mirror line."""
        return self.left is not None, self.right is not None

    def on(self, r: FloatArray) -> NDArray[np.bool_]:
        """Mask of the places `r` (m) on a mirror line."""
        result = np.zeros(np.shape(r), dtype=bool)
        for place in self.places:
            result |= np.abs(r - place) <= self.slack
        return result

    def snapped(self, r: float) -> float:
        """A place (m), moved onto a mirror line within the slack."""
        return next((place for place in self.places if abs(r - place) <= self.slack), r)

    def folded(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (K, 2) folded into the section, and their sense (K,) across. Points are r, z in m. The sense is -1 for
        points beyond a mirror line, otherwise 1."""
        r, sense = points[:, 0], np.ones(len(points))
        for place, side in ((self.left, -1.0), (self.right, 1.0)):
            if place is not None:
                beyond = side * (r - place) > 0.0
                r, sense = np.where(beyond, 2.0 * place - r, r), np.where(beyond, -1.0, sense)
        return np.stack([r, points[:, 1]], axis=1), sense


def mirrors_of(measure: Measure, r: FloatArray) -> Mirrors:
    """The mirror lines of a section with points at `r` (m) across."""
    low, high = float(r.min()), float(r.max())
    slack = SAME_LINE * max(abs(low), abs(high))
    ends = measure.ends((0.0 if abs(low) <= slack else low, high))
    return Mirrors(ends.get(AXIS, ends.get(PLANE_LEFT)), ends.get(PLANE_RIGHT), slack)
