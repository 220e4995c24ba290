"""Legendre's polynomials and their derivatives."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import legder
from numpy.typing import NDArray
from scipy.special import eval_legendre

Real = NDArray[np.float64]


@lru_cache(maxsize=64)
def _differentiation(count: int, order: int) -> Real:
    """The derivatives of some order of P_0 ... P_(count - 1) in P_0 ... : (count - order, count)."""
    return np.asarray(legder(np.eye(count), order))


def derivatives(x: Real, count: int, order: int) -> Real:
    """The derivatives of some `order` of P_0 ... P_(count - 1) at x (n,): (n, count)."""
    if order >= count:
        return np.zeros((x.size, count))
    values = eval_legendre(np.arange(count - order), x[:, None])
    return np.asarray(values @ _differentiation(count, order) if order else values)


def legendre_polynomials(x: Real, count: int) -> Real:
    """P_0 ... P_(count - 1) at x (n,) with their first three derivatives: (4, n, count)."""
    values = derivatives(x, count, 0)
    return np.stack([values, *(values[:, : count - order] @ _differentiation(count, order) for order in (1, 2, 3))])
