"""Legendre's polynomials and their derivatives."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import legder, legvander
from numpy.typing import NDArray

Real = NDArray[np.float64]


@lru_cache(maxsize=64)
def _differentiation(count: int, order: int) -> Real:
    """The derivatives of some order of P_0 ... P_(count - 1) in P_0 ... : (count - order, count)."""
    return np.asarray(legder(np.eye(count), order))


def derivatives(x: Real, count: int, order: int) -> Real:
    """The derivatives of some `order` of P_0 ... P_(count - 1) at x (n,): (n, count)."""
    if order == 0:
        return np.asarray(legvander(x, count - 1))
    if order >= count:
        return np.zeros((x.size, count))
    return np.asarray(legvander(x, count - 1 - order) @ _differentiation(count, order))


def derived(x: float, count: int) -> Real:
    """P_0 ... P_(count - 1) at one x with their first three derivatives: (4, count)."""
    return np.concatenate([derivatives(np.array([x]), count, order) for order in range(4)])
