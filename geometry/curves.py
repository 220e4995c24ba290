"""Curves in the half plane (r, z): rational B-splines.

They represent lines, arcs, parabolas and splines exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

Real = NDArray[np.float64]

#: Number of points per knot interval at which a curve is sampled. Doubled, crossings twice as close are found.
SAMPLES_BETWEEN_KNOTS = 9

#: Points and weights of a quadrature between two knots, exact for polynomials of degree 15.
GAUSS, WEIGHTS = np.polynomial.legendre.leggauss(8)

#: Largest distance (m) of the points of a line from its chord.
STRAIGHT = 1e-10


@dataclass(frozen=True)
class Curve:
    """A curve from t = 0 to 1: a rational B-spline. ``poles`` are (r w, z w, w) with r, z in metres and weights w."""

    degree: int
    knots: tuple[float, ...]
    poles: tuple[tuple[float, float, float], ...]

    @classmethod
    def line(cls, start: tuple[float, float], end: tuple[float, float]) -> Curve:
        """The straight line between two points (m)."""
        return cls(1, (0.0, 0.0, 1.0, 1.0), ((*start, 1.0), (*end, 1.0)))

    @classmethod
    def parabola(cls, start: tuple[float, float], middle: tuple[float, float], end: tuple[float, float]) -> Curve:
        """The parabola through three points (m). The second is at t = 1/2."""
        inner = tuple(2.0 * m - 0.5 * (a + b) for a, m, b in zip(start, middle, end, strict=True))
        return cls(2, (0.0, 0.0, 0.0, 1.0, 1.0, 1.0), ((*start, 1.0), (inner[0], inner[1], 1.0), (*end, 1.0)))

    @cached_property
    def _spline(self) -> BSpline:
        return BSpline(np.array(self.knots), np.array(self.poles), self.degree)

    @cached_property
    def is_line(self) -> bool:
        """Whether it is a line with constant speed."""
        return self.degree == 1 and len(self.poles) == 2 and self.poles[0][2] == self.poles[1][2] == 1.0

    def at(self, t: Real) -> Real:
        """Points (2, ...) in metres at `t` (...)."""
        if self.is_line:
            low, high = self.knots[1], self.knots[2]
            share = (np.asarray(t, dtype=float) - low) / (high - low)
            (r0, z0, _), (r1, z1, _) = self.poles
            return np.stack([r0 * (1.0 - share) + r1 * share, z0 * (1.0 - share) + z1 * share])
        found = self._spline(t)
        return np.moveaxis(found[..., :2] / found[..., 2:], -1, 0)

    def slope(self, t: Real) -> Real:
        """Derivatives (2, ...) of the points by t."""
        found, slopes = self._spline(t), self._spline(t, 1)
        weight = found[..., 2:]
        return np.moveaxis((slopes[..., :2] - found[..., :2] * slopes[..., 2:] / weight) / weight, -1, 0)

    def samples(self, start: float, end: float) -> Real:
        """Values of t (n,) from `start` to `end`. There are several between two knots."""
        low, high = min(start, end), max(start, end)
        inner = sorted({low, high, *(knot for knot in self.knots if low < knot < high)})
        parts = [np.linspace(a, b, SAMPLES_BETWEEN_KNOTS)[:-1] for a, b in pairwise(inner)]
        found = np.concatenate([*parts, [high]])
        return found if start <= end else found[::-1]


@dataclass(frozen=True)
class Arc:
    """The part of a curve from t = ``start`` to ``end``."""

    curve: Curve
    start: float = 0.0
    end: float = 1.0

    def at(self, share: Real) -> Real:
        """Points (2, ...) in metres at shares (...) of the parameter range."""
        return self.curve.at(self.start + np.asarray(share) * (self.end - self.start))

    @cached_property
    def back(self) -> Arc:
        """The arc in the other direction."""
        return Arc(self.curve, self.end, self.start)

    @cached_property
    def ends(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The points (m) at its start and its end."""
        (r0, r1), (z0, z1) = self.at(np.array([0.0, 1.0])).tolist()
        return (r0, z0), (r1, z1)

    def direction(self, share: float) -> Real:
        """Unit tangent (2,) at a share of the way."""
        t = self.start + share * (self.end - self.start)
        slope = self.curve.slope(np.array(t)) * math.copysign(1.0, self.end - self.start)
        length = float(np.hypot(*slope))
        if length == 0.0:  # a pole that is doubled
            (r0, z0), (r1, z1) = self.part(*((share, min(share + 1e-4, 1.0)) if share < 0.5 else (share - 1e-4, share)
                                            )).ends
            slope = np.array([r1 - r0, z1 - z0])
            length = float(np.hypot(*slope))
        return np.asarray(slope / length)

    def part(self, start: float, end: float) -> Arc:
        """The part between two shares of the way."""
        width = self.end - self.start
        return Arc(self.curve, self.start + start * width, self.end if end == 1.0 else self.start + end * width)

    @cached_property
    def polyline(self) -> Real:
        """Points (2, n) on it (m), ends included."""
        return self.curve.at(self.curve.samples(self.start, self.end))

    @cached_property
    def length(self) -> float:
        """Its length (m)."""
        return abs(self._integral(lambda point, slope: np.hypot(*slope)))

    @cached_property
    def turning(self) -> float:
        """The total angle (rad) by which its tangent turns."""
        steps = np.column_stack([self.direction(0.0), np.diff(self.polyline, axis=1), self.direction(1.0)])
        steps = steps[:, np.hypot(*steps) > 0.0]
        angles = np.arctan2(steps[1], steps[0])
        return float(np.abs((np.diff(angles) + np.pi) % (2.0 * np.pi) - np.pi).sum())

    @cached_property
    def is_straight(self) -> bool:
        """Whether it is a straight line."""
        (r0, z0), (r1, z1) = self.ends
        chord = np.array([r1 - r0, z1 - z0]) / math.hypot(r1 - r0, z1 - z0)
        r, z = self.polyline
        return bool(np.abs((r - r0) * chord[1] - (z - z0) * chord[0]).max() < STRAIGHT)

    @property
    def area(self) -> float:
        """Contribution to the area (m^2) of an anticlockwise loop. It is the integral of r dz."""
        return self._integral(lambda point, slope: point[0] * slope[1])

    @property
    def moment(self) -> float:
        """Contribution to a loop's first moment (m^3) about r = 0. It is the integral of r^2 / 2 dz."""
        return self._integral(lambda point, slope: 0.5 * point[0] ** 2 * slope[1])

    def share_of(self, axis: int, value: float) -> float | None:
        """The first share where a coordinate (0 r, 1 z) equals `value`. The value is in metres. None if there is none
        between the ends."""
        if self.curve.is_line:
            begin, end = (point[axis] for point in self.ends)
            return (value - begin) / (end - begin) if min(begin, end) < value < max(begin, end) else None
        shares = (self.curve.samples(self.start, self.end) - self.start) / (self.end - self.start)
        apart = self.at(shares)[axis] - value
        for k in np.flatnonzero(np.sign(apart[:-1]) * np.sign(apart[1:]) < 0.0):
            low, high, sign = float(shares[k]), float(shares[k + 1]), math.copysign(1.0, apart[k])
            for _ in range(80):
                middle = 0.5 * (low + high)
                if sign * (float(self.at(np.array(middle))[axis]) - value) > 0.0:
                    low = middle
                else:
                    high = middle
            return 0.5 * (low + high)
        inside = np.flatnonzero(apart[1:-1] == 0.0)
        return float(shares[1 + inside[0]]) if inside.size else None

    def _integral(self, integrand: Callable[[Real, Real], Real]) -> float:
        knots = self.curve.samples(self.start, self.end)
        width = np.diff(knots)[:, None]
        t = knots[:-1, None] + 0.5 * width * (1.0 + GAUSS)
        values = integrand(self.curve.at(t), self.curve.slope(t))
        return float(np.sum(0.5 * width * WEIGHTS * values))
