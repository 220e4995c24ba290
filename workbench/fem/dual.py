"""Numbers with derivatives: forward differentiation of first order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.fem.linearised import DIFFERENCE_PLACES, DIFFERENCE_STEP, FIRST_WEIGHTS

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Dual:
    """A number or an array with its gradient by k parameters.

    ``value`` has any shape (...), ``gradient`` the shape (k, ...).

    Arithmetic follows the rules of differentiation, with the broadcasting of numpy. Other operands are constants.
    """

    value: Any
    gradient: Real

    # Numpy leaves `array @ dual` to this class.
    __array_ufunc__ = None

    def _pair(self, other: Any) -> tuple[Any, Real, Any, Real]:
        """Values and gradients of both operands, the gradients with equally many axes."""
        if not isinstance(other, Dual):
            other = Dual(other, np.zeros((len(self.gradient), *np.shape(other))))
        count = max(np.ndim(self.value), np.ndim(other.value))
        first, second = (each.gradient.reshape(len(each.gradient), *(1,) * (count - np.ndim(each.value)),
                                               *each.gradient.shape[1:]) for each in (self, other))
        return self.value, first, other.value, second

    def __add__(self, other: Any) -> Dual:
        a, by_a, b, by_b = self._pair(other)
        return Dual(a + b, by_a + by_b)

    def __sub__(self, other: Any) -> Dual:
        a, by_a, b, by_b = self._pair(other)
        return Dual(a - b, by_a - by_b)

    def __mul__(self, other: Any) -> Dual:
        a, by_a, b, by_b = self._pair(other)
        return Dual(a * b, a * by_b + b * by_a)

    def __truediv__(self, other: Any) -> Dual:
        a, by_a, b, by_b = self._pair(other)
        return Dual(a / b, (by_a - a / b * by_b) / b)

    def __pow__(self, power: float) -> Dual:
        return Dual(self.value**power, power * self.value ** (power - 1.0) * self.gradient)

    def __matmul__(self, other: Any) -> Dual:
        if not isinstance(other, Dual):
            return Dual(self.value @ other, self.gradient @ other)
        # A vector on the right needs a second axis beside that of the parameters.
        by_other = (self.value @ other.gradient if np.ndim(other.value) > 1
                    else (self.value @ other.gradient[..., None])[..., 0])
        return Dual(self.value @ other.value, self.gradient @ other.value + by_other)

    def __rmatmul__(self, other: Real) -> Dual:
        return Dual(other, np.zeros((len(self.gradient), *other.shape))) @ self

    def __getitem__(self, key: Any) -> Dual:
        return Dual(self.value[key], self.gradient[(slice(None), *(key if isinstance(key, tuple) else (key,)))])

    @property
    def T(self) -> Dual:
        """The matrix transposed."""
        return Dual(self.value.T, self.gradient.swapaxes(-1, -2))


def dual_derivative(function: Callable[[float], Real], at: float) -> Real:
    """The derivative of a closed formula of a scalar, to rounding.

    See `workbench.fem.linearised`.
    """
    step = DIFFERENCE_STEP * abs(at)
    values = np.stack([function(at + step * place) for place in DIFFERENCE_PLACES])
    return np.tensordot(FIRST_WEIGHTS, values, axes=1) / step
