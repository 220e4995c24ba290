"""Quadratic forms and sums of stacks of dense matrices."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Entries of the states, at several frequencies together, that forms are made from at once: what that takes stays in
#: the processor's cache.
AT_ONCE = 40_000


def bilinear(matrices: NDArray[np.inexact], left: Complex, right: Complex) -> Complex:
    """left^T A right (n, k) for columns of `left` and `right` (r, n) and symmetric `matrices` A (k, r, r)."""
    rank, points = right.shape
    result = np.empty((points, len(matrices)), dtype=complex)
    at_once = max(1, AT_ONCE // max(rank, 1))
    for start in range(0, points, at_once):
        some = slice(start, start + at_once)
        np.einsum("kin,in->nk", real_times(matrices, right[:, some]), left[:, some], out=result[some])
    return result


def real_times(matrices: NDArray[np.inexact], columns: Complex) -> Complex:
    """`matrices` (k, r, r) times `columns` (r, n): (k, r, n). Real ones take one real product for both parts."""
    count, rows, rank = matrices.shape
    flat, columns = matrices.reshape(count * rows, rank), np.ascontiguousarray(columns)
    images = flat @ columns if np.iscomplexobj(flat) else (flat @ columns.view(np.float64)).view(np.complex128)
    return np.asarray(images.reshape(count, rows, columns.shape[1]))


def combined_matrices(constants: Complex, matrices: Real) -> Complex:
    """sum_q constants_q matrices_q, `constants` (..., integrals), for real `matrices` (integrals, ...)."""
    flat = matrices.reshape(len(matrices), math.prod(matrices.shape[1:]))
    result = np.asarray(constants.real @ flat, dtype=complex)
    if constants.imag.any():
        result += 1j * (constants.imag @ flat)
    return result.reshape(*constants.shape[:-1], *matrices.shape[1:])
