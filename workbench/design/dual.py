"""A real number with its derivatives, so that a formula is written once: forward differentiation of first order."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.fem.linearised import DIFFERENCE_PLACES, DIFFERENCE_STEP, FIRST_WEIGHTS

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Dual:
    """``value`` and ``gradient`` (k,) by k parameters; arithmetic follows the rules of differentiation."""

    value: float
    gradient: Real

    def __add__(self, other: Dual | float) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.gradient + other.gradient)
        return Dual(self.value + other, self.gradient)

    def __sub__(self, other: Dual | float) -> Dual:
        return self + other * -1.0

    def __mul__(self, other: Dual | float) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value * other.value, self.value * other.gradient + other.value * self.gradient)
        return Dual(self.value * other, self.gradient * other)

    def __truediv__(self, other: Dual | float) -> Dual:
        return self * (other**-1.0)

    def __pow__(self, power: float) -> Dual:
        return Dual(self.value**power, power * self.value ** (power - 1.0) * self.gradient)

    def sqrt(self) -> Dual:
        root = math.sqrt(self.value)
        return Dual(root, 0.5 / root * self.gradient)


def dual_derivative(function: Callable[[float], Real], at: float) -> Real:
    """The derivative (...) of a closed formula (...) of a scalar, to rounding (`workbench.fem.linearised`)."""
    step = DIFFERENCE_STEP * abs(at)
    values = np.stack([function(at + step * place) for place in DIFFERENCE_PLACES])
    return np.tensordot(FIRST_WEIGHTS, values, axes=1) / step
