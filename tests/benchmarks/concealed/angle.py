"""Periodic cubic splines around the axis.

Round operators are circulant over the equal cells: the fields that a discrete order m has there, sums of splines with
the weights cos(m j h) and sin(m j h) on the knots j h, do not couple. In a section such fields have m' in the place of
the order of cosines and q in the place of its square:

    m' = int (s_m)' c_m / int c_m^2,        q = int (s_m')^2 / int s_m^2 .
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.interpolate import BSpline

Real = NDArray[np.float64]

_SPLINE = BSpline.basis_element(np.arange(-2.0, 3.0), extrapolate=False)

#: Gauss points in a cell: exact for products of splines.
POINTS = 5


@dataclass(frozen=True)
class Angle:
    """An odd number of ``cells`` around the axis; the discrete orders are 0 to (cells - 1) / 2."""

    cells: int

    @property
    def width(self) -> float:
        """Width h (rad) of a cell."""
        return 2.0 * np.pi / self.cells

    @property
    def orders(self) -> Real:
        """The discrete orders (n,)."""
        return np.arange((self.cells + 1) // 2, dtype=float)

    @cached_property
    def factors(self) -> tuple[Real, Real, Real]:
        """Mean square of c_m over that of a cosine, m' and q, (n,) each."""
        nodes, weights = leggauss(POINTS)
        x = (np.arange(-2.0, 2.0)[:, None] + 0.5 + 0.5 * nodes).ravel()
        weight, shifts = np.tile(0.5 * weights, 4), np.arange(-3, 4)
        value, slope = _SPLINE(x), _SPLINE.derivative()(x)
        moved, moved_slope = (np.nan_to_num(each(x - shifts[:, None])) for each in (_SPLINE, _SPLINE.derivative()))
        turn = np.outer(self.orders * self.width, shifts)
        square = np.cos(turn) @ (moved @ (weight * value))
        first = np.sin(turn) @ (moved_slope @ (weight * value)) / (self.width * square)
        second = np.cos(turn) @ (moved_slope @ (weight * slope)) / (self.width**2 * square)
        return square, first, second

    def within(self, half: float) -> Real:
        """Integrals (3, n) of c_m, c_m cos t and s_m sin t over angles t from -half to half (rad)."""
        nodes, weights = leggauss(POINTS)
        knots = np.append(np.arange(0.0, half, self.width), half)
        t = (knots[:-1, None] + 0.5 * np.diff(knots)[:, None] * (1.0 + nodes)).ravel()
        weight = (np.diff(knots)[:, None] * weights).ravel()
        near = np.floor(t / self.width) + np.arange(-1.0, 3.0)[:, None]
        spline = np.nan_to_num(_SPLINE(t / self.width - near))
        turn = self.orders[:, None, None] * self.width * near
        even, odd = (spline * np.cos(turn)).sum(axis=1), (spline * np.sin(turn)).sum(axis=1)
        return np.array([even @ weight, even @ (weight * np.cos(t)), odd @ (weight * np.sin(t))])
