"""Quadratic forms and sums of stacks of dense matrices."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Number of state entries per block of forms, to fit the processor's cache.
AT_ONCE = 40_000


def bilinear(matrices: NDArray[np.inexact], left: Complex, right: Complex) -> Complex:
    """Forms left^T A right (n, k) of symmetric `matrices` A. The matrices are (k, r, r). `left` and `right` are columns
    (r, n)."""
    rank, points = right.shape
    result = np.empty((points, len(matrices)), dtype=complex)
    at_once = max(1, AT_ONCE // max(rank, 1))
    for start in range(0, points, at_once):
        some = slice(start, start + at_once)
        np.einsum("kin,in->nk", real_times(matrices, right[:, some]), left[:, some], out=result[some])
    return result


def real_times(matrices: NDArray[np.inexact], columns: Complex) -> Complex:
    """Products (k, r, n) of `matrices` (k, r, r) and `columns`. The columns are (r, n). A real matrix multiplies real
    and imaginary parts in one real product."""
    count, rows, rank = matrices.shape
    flat, columns = matrices.reshape(count * rows, rank), np.ascontiguousarray(columns)
    images = flat @ columns if np.iscomplexobj(flat) else (flat @ columns.view(np.float64)).view(np.complex128)
    return np.asarray(images.reshape(count, rows, columns.shape[1]))


def combined_matrices(constants: Complex, matrices: Real) -> Complex:
    """The sum over q of constants_q matrices_q. `constants` are (..., integrals), the real `matrices` (integrals,
    ...)."""
    flat = matrices.reshape(len(matrices), math.prod(matrices.shape[1:]))
    result = np.asarray(constants.real @ flat, dtype=complex)
    if constants.imag.any():
        result += 1j * (constants.imag @ flat)
    return result.reshape(*constants.shape[:-1], *matrices.shape[1:])
