"""Dense systems at many frequencies, for sweeps of the reduced model.

A reduced model is sum_g h_g(w) B_g with few dense complex-symmetric matrices, solved at hundreds of frequencies. If the
frequency dependence is that of stiffness, mass and perhaps fluids, the pencil is diagonalised once, instead of one
factorisation per frequency. A large system is first projected on Krylov spaces of a few factorisations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Largest relative residual of a sweep by eigenvectors; above it, every frequency is factorised. The error of the
#: charge is its square times the amplification at resonances.
PENCIL_RESIDUAL = 1e-9

#: Least numbers of unknowns and frequencies for a projection before the sweep.
LARGE, MANY = 80, 60

#: Settings of the projection: number of first and of added frequencies, vectors from each, relative change of the
#: charge at which it ends. The charge error is of second order and smaller than the last change. The first three
#: numbers affect only the speed.
FIRST_NODES, ADDED_NODES, KRYLOV_VECTORS, CHARGE_CHANGE = 3, 2, 10, 1e-5

#: Upper bound of the ratio of charge error to squared residual; 0.01 to 40 in bands of chips and discs.
AMPLIFIED = 100.0

#: Number of matrix entries solved at once to fit the processor's cache; it affects only the speed.
ENTRIES = 500_000


@dataclass(frozen=True, eq=False)
class Span:
    """States as combinations of few vectors. ``basis`` (r, k) and ``coordinates`` (k, n) are complex."""

    basis: Complex
    coordinates: Complex


@dataclass(frozen=True, eq=False)
class DenseSweep:
    """A dense system solved at n frequencies at unit electrode voltage. ``states`` (r, n), last entry 1; ``charge``
    (n,), -x^T A x; ``residual`` (n,) relative to the load; ``span`` of the states, if the system was projected."""

    states: Complex
    charge: Complex
    residual: Real
    span: Span | None


def solve_dense(factors: Complex, matrices: Complex) -> DenseSweep:
    """Solve sum_g factors_g(w) matrices_g at n frequencies. `factors` are (g, n), the symmetric `matrices` (g, r, r).
    The last unknown is the electrode voltage, fixed at one."""
    loads = -np.ascontiguousarray(matrices[:, :-1, -1])
    inner = np.ascontiguousarray(matrices[:, :-1, :-1])
    rank, count = inner.shape[1], factors.shape[1]
    right = loads.T @ factors
    electrode = matrices[:, -1, -1]
    projected = _projected(factors, inner, loads, electrode) if rank >= LARGE and count >= MANY else None
    span = None
    if projected is None:
        x, remainder = _solved(factors, inner, loads, right)
    else:
        vectors, images, small = projected
        x, remainder = vectors @ small, right - _product(factors, images, small)
        # The electrode's voltage is one more vector of the span, with coordinate one.
        basis = np.zeros((rank + 1, vectors.shape[1] + 1), dtype=complex)
        basis[:-1, :-1], basis[-1, -1] = vectors, 1.0
        span = Span(basis, np.vstack([small, np.ones(count)]))
    norm = np.linalg.norm(right, axis=0)
    residual = np.linalg.norm(remainder, axis=0) / np.where(norm > 0.0, norm, 1.0)
    # x^T A x = x^T (A x) + 2 x^T a + a_ee with A x = -a - remainder.
    charge = np.sum(x * (right + remainder), axis=0) - electrode @ factors
    return DenseSweep(np.vstack([x, np.ones(count)]), charge, residual, span)


def _solved(factors: Complex, matrices: Complex, loads: Complex, right: Complex) -> tuple[Complex, Complex]:
    """Solutions x (r, n) and remainders, for right-hand sides `right` (r, n). `right` is the sum of `factors` times
    `loads` (g, r)."""
    x = _swept(factors, matrices, loads)
    remainder = right - _product(factors, matrices, x)
    if (np.linalg.norm(remainder, axis=0) > PENCIL_RESIDUAL * np.linalg.norm(right, axis=0)).any():
        x = solve_each(factors, matrices, right)
        remainder = right - _product(factors, matrices, x)
    return x, remainder


def _product(factors: Complex, matrices: Complex, x: Complex) -> Complex:
    """The sum (r, n) of factors_g matrices_g x. The factors are (g, n), the matrices (g, r, k) and x (k, n)."""
    return np.asarray(sum((each @ x) * h for h, each in zip(factors, matrices, strict=True)))


def _projected(
    factors: Complex, matrices: Complex, loads: Complex, electrode: Complex
) -> tuple[Complex, Complex, Complex] | None:
    """States in the Krylov spaces of few factorisations, or None.

    None means that the spaces would fill most of the system. With A_0 factorised at one frequency and dA the change to
    the next one, nearby states lie close to the Krylov space of A_0^-1 dA started at the state there (see
    `solve.System.krylov`). Frequencies are added where the residual is largest, until the charge changes by less than
    :data:`CHARGE_CHANGE`. `electrode` (g,) belongs to the last unknown as `loads` (g, r) do to the others.

    Returns:
        vectors (r, k), their images (g, r, k) by the matrices, and the coordinates (k, n) of the states.
    """
    count, rank = factors.shape[1], matrices.shape[1]
    watched = np.unique(np.linspace(0, count - 1, min(count, 2 * MANY)).astype(int))
    some, right = factors[:, watched], loads.T @ factors[:, watched]
    norm = np.linalg.norm(right, axis=0)
    wanted = list(chebyshev(watched.size, FIRST_NODES))
    basis = np.zeros((rank, 0), dtype=complex)
    images = np.zeros((len(matrices), rank, 0), dtype=complex)
    done: list[int] = []
    charge = np.zeros(watched.size, dtype=complex)
    while wanted and basis.shape[1] + KRYLOV_VECTORS * len(wanted) < rank // 2:
        new = np.zeros((rank, 0), dtype=complex)
        for index in map(int, wanted):
            near = index + 1 if index + 1 < watched.size else index - 1
            whole = np.tensordot(some[:, index], matrices, axes=1)
            change = np.tensordot(some[:, near] - some[:, index], matrices, axes=1)
            new = np.column_stack([new, _krylov(whole, change, right[:, index], KRYLOV_VECTORS)])
            done.append(index)
        for _ in range(2):
            new = new - basis @ (basis.conj().T @ new)
        new, triangle, _ = scipy.linalg.qr(new, mode="economic", pivoting=True, check_finite=False)
        new = new[:, np.abs(np.diag(triangle)) > 1e-10]
        basis, images = np.column_stack([basis, new]), np.concatenate([images, matrices @ new], axis=2)
        inner, projected_loads = basis.T @ images, loads @ basis
        small = _swept(some, inner, projected_loads)
        before, charge = charge, np.sum(small * (projected_loads.T @ some), axis=0) - electrode @ some
        residual = np.linalg.norm(right - _product(some, images, small), axis=0) / norm
        # The error of the charge is the square of the residual, times the amplification at resonances.
        is_enough = AMPLIFIED * residual.max() ** 2 <= CHARGE_CHANGE
        if is_enough or (np.abs(charge - before) <= CHARGE_CHANGE * np.abs(charge)).all():
            return basis, images, _swept(factors, inner, projected_loads)
        worst = [int(k) for k in np.argsort(-residual) if int(k) not in done]
        wanted = [k for i, k in enumerate(worst[: 4 * ADDED_NODES])
                  if all(abs(k - other) > watched.size // (2 * FIRST_NODES) for other in worst[:i])][:ADDED_NODES]
    return None


def _swept(factors: Complex, matrices: Complex, loads: Complex) -> Complex:
    """Solutions (k, n) of a small system for `loads` (g, k)."""
    pencil = Pencil.of(factors, matrices) if factors.shape[1] > 1 else None
    return solve_each(factors, matrices, loads.T @ factors) if pencil is None else pencil.solve(factors, loads.T)


def _krylov(whole: Complex, change: Complex, right: Complex, depth: int) -> Complex:
    """Orthonormal vectors (r, depth) of a Krylov space. The space is that of whole^-1 change, started at x = whole^-1
    right."""
    factor = scipy.linalg.lu_factor(whole, check_finite=False)
    found = np.zeros((right.size, depth), dtype=complex)
    vector = right
    for k in range(depth):
        vector = scipy.linalg.lu_solve(factor, vector if k == 0 else change @ found[:, k - 1], check_finite=False)
        for _ in range(2):
            vector = vector - found[:, :k] @ (found[:, :k].conj().T @ vector)
        found[:, k] = vector / np.linalg.norm(vector)
    return found


def directions_outside(vectors: Complex | Real, basis: Real, smallest: float) -> Real:
    """Orthonormal real directions of complex vectors outside a basis.

    Parts of a vector below the share `smallest` of it are left out.
    """
    vectors = vectors / np.linalg.norm(vectors, axis=0)
    parts = np.hstack([vectors.real, vectors.imag])
    for _ in range(2):
        parts = parts - basis @ (basis.T @ parts)
    columns, sizes, _ = np.linalg.svd(parts, full_matrices=False)
    return np.asarray(columns[:, sizes > smallest])


def chebyshev(count: int, nodes: int) -> NDArray[np.int64]:
    """Indices of the frequencies next to Chebyshev nodes, without repetition."""
    angles = np.pi * (np.arange(nodes) + 0.5) / nodes
    return np.unique(np.round(0.5 * (count - 1) * (1.0 - np.cos(angles))).astype(int))


def solve_each(factors: Complex, matrices: Complex, right: Complex) -> Complex:
    """Solve sum_g factors_g(w) matrices_g x = right at n frequencies. `matrices` are (groups, r, r); x and `right` are
    (..., r, n)."""
    count, rank = len(matrices), matrices.shape[1]
    if rank == 0:
        return np.zeros(right.shape, dtype=complex)
    flat = matrices.reshape(count, rank**2)
    columns = right.reshape(-1, rank, right.shape[-1]).transpose(2, 1, 0)
    result = np.empty(columns.shape, dtype=complex)
    at_once = max(1, ENTRIES // rank**2)
    for start in range(0, len(result), at_once):
        some = slice(start, start + at_once)
        whole = (factors[:, some].T @ flat).reshape(-1, rank, rank)
        result[some] = np.linalg.solve(whole, columns[some])
    return result.transpose(2, 1, 0).reshape(right.shape)


class Pencil:
    """A pencil of two or three matrices, diagonalised once.

    The pencil h (B_0 + t B_1 + t^2 B_2) is solved at n values t. The matrices are stiffness, mass and terms of a fluid.
    With t = t0 (1 + s) it is P_0 + s P_1 + s^2 P_2; with y = s x its inverse follows from that of 1 + s S, S = [[P_0^-1
    P_1, P_0^-1 P_2], [-1, 0]] = V L V^-1, or S = P_0^-1 P_1 without P_2, diagonalised once.
    """

    def __init__(self, scale: Complex, ratio: Complex, parts: Sequence[Complex]) -> None:
        """Diagonalise for `scale` h, `ratio` t and two or three matrices. h and t are (n,), the matrices (r, r)."""
        self._scale = scale
        middle = np.median(ratio.real)
        self._shift = ratio / middle - 1.0
        first, second = parts[0] + middle * parts[1], middle * parts[1]
        if len(parts) == 3:
            last = middle**2 * parts[2]
            first, second = first + last, np.hstack([second + 2.0 * last, last])
        self._factor = scipy.linalg.lu_factor(first, check_finite=False)
        size = len(first)
        whole = np.vstack([scipy.linalg.lu_solve(self._factor, second, check_finite=False),
                           -np.eye(size * (len(parts) - 2), size * (len(parts) - 1))])
        roots, self._vectors = np.linalg.eig(whole)
        self._back = np.linalg.inv(self._vectors)[:, :size]
        self._vectors = self._vectors[:size]
        self._damped = 1.0 / (1.0 + np.outer(roots, self._shift))

    @classmethod
    def of(cls, factors: Complex, matrices: Complex) -> Pencil | None:
        """A sum of factors_g (n,) matrices_g as a pencil, or None. The matrices are (groups, r, r)."""
        if len(matrices) == 2:
            return cls(factors[0], factors[1] / factors[0], list(matrices))
        if len(matrices) != 3:
            return None
        for a, b, c in ((0, 1, 2), (1, 0, 2), (0, 2, 1)):
            constant = factors[b] ** 2 / (factors[a] * factors[c])
            if np.ptp(constant.real) + np.ptp(constant.imag) < 1e-12 * np.abs(constant).max():
                parts = [matrices[a], matrices[b], matrices[c] / constant[0]]
                return cls(factors[a], factors[b] / factors[a], parts)
        return None

    def solve(self, factors: Complex, loads: Complex) -> Complex:
        """Solve for x (r, n). The right-hand side is `loads` (r, g) times `factors` (g, n)."""
        inside = self._back @ scipy.linalg.lu_solve(self._factor, loads, check_finite=False) @ factors
        return np.asarray(self._vectors @ (self._damped * (inside / self._scale)))
