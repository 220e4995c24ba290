"""Vectors of the basis of a reduced model: what states add to it, and what part of it they need.

The last vector is the lift: the only one with a voltage at the electrode, 1 V.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: A new vector whose part outside the basis is smaller than this (relative) adds nothing but rounding.
DEPENDENT = 1e-9


def new_directions(basis: Real, states: Complex, weights: Real, unneeded: float = DEPENDENT) -> Real:
    """What `states` (size, n) add to a basis (size, r) with its lift last: (size, k).

    Their real and imaginary parts without their share of the lift, orthonormal in the norm of `weights` (size,).
    """
    apart = states - np.outer(basis[:, -1], states[-1])
    new = weights[:, None] * np.column_stack([apart.real, apart.imag])
    length = np.linalg.norm(new, axis=0)
    new = new[:, length > 0.0] / length[length > 0.0]
    scaled = weights[:, None] * basis[:, :-1]
    for _ in range(2):
        new = new - scaled @ (scaled.T @ new)
    new, triangle, _ = scipy.linalg.qr(new, mode="economic", pivoting=True)
    new = new[:, np.abs(np.diag(triangle)) > unneeded]
    new[-1] = 0.0
    return np.asarray(new / weights[:, None])


def needed(states: Complex, tolerance: float) -> Real:
    """The part of a basis that reduced `states` (r, n) need, in that basis: (r, k), its lift last.

    Directions below `tolerance`, relative to the largest, are left out.
    """
    coordinates = np.column_stack([states[:-1].real, states[:-1].imag])
    directions, sizes, _ = np.linalg.svd(coordinates, full_matrices=False)
    directions = directions[:, sizes > tolerance * sizes[0]]
    result = np.zeros((len(states), directions.shape[1] + 1))
    result[:-1, :-1], result[-1, -1] = directions, 1.0
    return result


def joined(basis: Real, new: Real) -> Real:
    """`basis` with further columns before its last one, the lift."""
    return np.column_stack([basis[:, :-1], new, basis[:, -1:]])
