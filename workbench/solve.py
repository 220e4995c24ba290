"""Solving the full model at given frequencies, and what follows from a solution by quadratic forms alone.

A solution is taken at unit voltage of the live electrode. Because A is symmetric and the drive is the electrode
voltage, the electrode charge is Q = -x^T A x, and its derivative with respect to any coefficient is one more quadratic
form of the same x: dQ = -x^T (dA) x. No adjoint solve, no finite difference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from threading import Lock
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy import sparse
from threadpoolctl import ThreadpoolController

from workbench.factorisation import Factorisation, SuperLU
from workbench.operators import FullOperators, Operators, ReducedOperators, frequency_groups
from workbench.physics.term import Coefficient, Formula, Integral, Monomial, Times, Values

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Largest scaled residual of an accepted solve. Refined solves reach 1e-13; a matrix close to singular does not.
RESIDUAL_LIMIT = 1e-10

#: Largest scaled residual of a reduced model solved by its eigenvectors; above, every frequency is factorised.
PENCIL_RESIDUAL = 1e-11

#: Unknowns and frequencies from which on a reduced model is narrowed before it is solved at all frequencies, the first
#: frequencies and the vectors from each, and the largest residual that leaves; Z has its square.
LARGE, MANY, NODES, DEPTH, NARROWED = 200, 60, 6, 6, 1e-5

#: Entries of the reduced systems that are solved at once: what that takes stays in the processor's cache.
ENTRIES = 500_000


class NotConverged(RuntimeError):
    """A linear solve whose residual stayed above the limit. Carries the frequency, the residual and the iterate."""

    def __init__(self, frequency: float, residual: float, iterate: Complex) -> None:
        super().__init__(
            f"the solve at {frequency:.6g} Hz left a scaled residual of {residual:.2e}, above {RESIDUAL_LIMIT:.0e}; "
            "the model may be singular there (an undamped resonance, a region that is not held by anything)"
        )
        self.frequency, self.residual, self.iterate = frequency, residual, iterate

    def __reduce__(self) -> tuple[Any, ...]:
        return (NotConverged, (self.frequency, self.residual, self.iterate))


#: The model as few matrices as its frequency dependence allows: h(w) (n,) and constants (integrals,) of each.
Groups = tuple[tuple[Complex, Complex], ...]


@dataclass(frozen=True, eq=False)
class Solution:
    """States at unit electrode voltage, e^{-i w t}.

    ``frequency`` (n,) in Hz, ``states`` (size, n) with the electrode voltage last, ``groups`` the model at these
    frequencies (`operators.frequency_groups`), ``charge`` (n,) C of the live electrode, -x^T A x, ``residual`` (n,)
    scaled residual of each solve.
    """

    operators: Operators
    frequency: Real
    groups: Groups
    states: Complex
    charge: Complex
    residual: Real

    @property
    def omega(self) -> Real:
        return 2.0 * np.pi * self.frequency

    @cached_property
    def coefficients(self) -> Complex:
        """g_q(w) (n, integrals)."""
        result = np.zeros((self.frequency.size, len(self.operators.integrals)), dtype=complex)
        for h, constants in self.groups:
            result += np.outer(h, constants)
        return result

    @cached_property
    def forms(self) -> Complex:
        """x^T A_q x (n, integrals): all that follows from a solution without its conjugate."""
        return self.operators.quadratic(self.states, self.states)

    @property
    def admittance(self) -> Complex:
        """Y = -i w Q (n,), siemens, e^{-i w t}."""
        return -1j * self.omega * self.charge

    @property
    def impedance(self) -> Complex:
        """Z (n,), ohm, e^{-i w t}: a capacitor has a *positive* imaginary part. Spectra hold the conjugate."""
        return 1.0 / self.admittance

    def impedance_gradient(self) -> Complex:
        """dZ/dg_q (n, integrals) with respect to every complex coefficient g_q, e^{-i w t}."""
        # Z = i / (w Q), dQ = -x^T A_q x dg.
        return (1j / (self.omega * self.charge**2))[:, None] * self.forms

    def parameter_gradient(self, values: Values, names: tuple[str, ...]) -> Complex:
        """dZ/dtheta (n, len(names)) with respect to complex parameters, e^{-i w t}.

        For a spectrum (the conjugate), the derivative by the real part of theta is conj(dZ), by the imaginary part
        conj(i dZ).

        Raises:
            KeyError: a name no coefficient depends on.
        """
        integrals, depending = self.operators.integrals, dependence(self.operators.integrals)
        rows: list[tuple[int, Complex, Complex]] = []  # (column, factor (n,), constants over the integrals)
        for column, name in enumerate(names):
            if name not in depending:
                raise KeyError(f"no coefficient depends on {name!r}; known: {', '.join(sorted(depending))}")
            powers: dict[float, Complex] = {}
            for q in depending[name]:
                for power, constant, factor in slopes_of(integrals[q].coefficient, self.omega, values, name):
                    if factor is None:
                        powers.setdefault(power, np.zeros(len(integrals), dtype=complex))[q] += constant
                    elif constant != 0.0 and factor.any():
                        alone = np.zeros(len(integrals), dtype=complex)
                        alone[q] = constant
                        rows.append((column, factor, alone))
            rows += [(column, np.asarray(self.omega**power, dtype=complex), constants)
                     for power, constants in powers.items() if constants.any()]
        result = np.zeros((self.frequency.size, len(names)), dtype=complex)
        if rows:
            forms = self.operators.combined_forms(self.states, np.array([constants for _, _, constants in rows]))
            for (column, factor, _), form in zip(rows, forms.T, strict=True):
                result[:, column] += factor * form
        return np.asarray((1j / (self.omega * self.charge**2))[:, None] * result)

    def dissipation(self) -> Real:
        """Time-averaged power (W) lost in each integral at 1 V amplitude: (n, integrals).

        -w/2 Im(g_q) x^H A_q x. Their sum is the electrical input power w/2 Im Q (Acevedo-Espinosa et al. (RP-UEIS),
        eq. A.4 integrated over the volume).
        """
        forms = self.operators.quadratic(np.conj(self.states), self.states).real
        return -0.5 * self.omega[:, None] * self.coefficients.imag * forms

    def input_power(self) -> Real:
        """Electrical input power (W) at 1 V amplitude from charge and voltage alone: (n,)."""
        return 0.5 * self.admittance.real


def slopes_of(
    coefficient: Coefficient, omega: Real, values: Values, name: str
) -> Iterator[tuple[float, complex, Complex | None]]:
    """The derivative of a coefficient by a complex parameter as a sum of constant * w^power, or of constant * factor.

    Yields:
        the power, the constant, and the factor (n,), None where the power is all of it.
    """
    first, constants = coefficient, []
    while isinstance(first, Times):
        constants.append(first.second)
        first = first.first
    whole = complex(np.prod([each.constant(values) for each in constants]))
    slope = 0.0 + 0.0j
    for k, each in enumerate(constants):
        if name in each.parameters:
            others = [other.constant(values) for j, other in enumerate(constants) if j != k]
            slope += each.constant_derivative(values, name) * complex(np.prod(others))
    if isinstance(first, Monomial | Formula):
        own = first.constant_derivative(values, name) if name in first.parameters else 0.0
        yield first.omega_power, complex(own * whole + (first.constant(values) * slope if slope != 0.0 else 0.0)), None
        return
    if name in first.parameters:
        yield 0.0, complex(whole), first.derivative(omega, values, name)
    if slope != 0.0:
        yield 0.0, complex(slope), first(omega, values)


#: What :func:`dependence` found, by the identity of the integrals, which it keeps alive.
_DEPENDENCE: dict[int, tuple[tuple[Integral, ...], dict[str, list[int]]]] = {}


def dependence(integrals: tuple[Integral, ...]) -> dict[str, list[int]]:
    """The indices of the integrals whose coefficients depend on a parameter, by its name."""
    known = _DEPENDENCE.get(id(integrals))
    if known is not None and known[0] is integrals:
        return known[1]
    found: dict[str, list[int]] = {}
    for q, integral in enumerate(integrals):
        for name in integral.coefficient.parameters:
            found.setdefault(name, []).append(q)
    while len(_DEPENDENCE) >= 32:
        _DEPENDENCE.pop(next(iter(_DEPENDENCE)))
    _DEPENDENCE[id(integrals)] = (integrals, found)
    return found


@cache
def _threads() -> ThreadpoolController:
    """The BLAS libraries in use; looking for them takes a hundred times as long as limiting them."""
    return ThreadpoolController()


@dataclass
class _Limit:
    """The limit of BLAS threads in force, and by how many it is asked for: threads of ours come and go."""

    lock: Lock
    asked: int = 0
    limiter: Any = None


_LIMIT = _Limit(Lock())


@contextmanager
def one_thread() -> Iterator[None]:
    """One BLAS thread: two made sparse factorisations up to 300 times slower on a busy two-core machine."""
    with _LIMIT.lock:
        if _LIMIT.asked == 0:
            _LIMIT.limiter = _threads().limit(limits=1, user_api="blas")
        _LIMIT.asked += 1
    try:
        yield
    finally:
        with _LIMIT.lock:
            _LIMIT.asked -= 1
            if _LIMIT.asked == 0:
                _LIMIT.limiter.restore_original_limits()


@dataclass(frozen=True, eq=False)
class Factor:
    """A factorised, symmetrically scaled system at one frequency, and what is needed to refine a solve."""

    frequency: float
    matrix: sparse.csr_matrix
    scale: Real
    solve_scaled: Callable[[Complex], Complex]

    def solve(self, right: Complex) -> tuple[Complex, float]:
        """x with matrix x = right (size - 1,), and its scaled residual, after iterative refinement.

        Raises:
            NotConverged: the scaled residual stays above :data:`RESIDUAL_LIMIT`.
        """
        scaled = self.scale * right
        norm = float(np.linalg.norm(scaled))
        x = self.solve_scaled(scaled)
        residual = np.inf
        for _ in range(4):
            remainder = scaled - self.matrix @ x
            previous, residual = residual, float(np.linalg.norm(remainder)) / norm
            if residual < 1e-14 or residual > 0.5 * previous:
                break
            x = x + self.solve_scaled(remainder)
        if not residual <= RESIDUAL_LIMIT:
            raise NotConverged(self.frequency, residual, self.scale * x)
        return self.scale * x, residual


class System:
    """The full model with its parameter values in place, ready to be factorised at any frequency.

    Matrices of equal frequency dependence are summed once (see `operators.frequency_groups`).
    """

    def __init__(self, operators: FullOperators, values: Values) -> None:
        self.operators, self.values = operators, values
        groups = frequency_groups(operators.integrals, np.ones(1), values)
        self._entries = np.stack([operators.matrix(constants) for _, constants in groups])

    def factors(self, frequencies: Real) -> Complex:
        """h_g(w) of every group of equal frequency dependence: (number of groups, n)."""
        groups = frequency_groups(self.operators.integrals, 2.0 * np.pi * frequencies, self.values)
        return np.stack([h for h, _ in groups])

    def group_matrices(self) -> list[sparse.csr_matrix]:
        """B_g (size, size) of every group: A(w) = sum_g h_g(w) B_g."""
        return [self._stored(entries) for entries in self._entries]

    def matrix(self, frequency: float) -> sparse.csr_matrix:
        """A(w) (size, size), complex symmetric, electrode included."""
        return self._stored(self._at(frequency))

    def charge(self, frequency: float, state: Complex) -> complex:
        """The charge -x^T A x of a state (size,)."""
        return -complex(state @ (self.matrix(frequency) @ state))

    def _at(self, frequency: float) -> Complex:
        """The stored entries of A(w)."""
        return np.asarray(self.factors(np.array([frequency]))[:, 0] @ self._entries)

    def _stored(self, entries: Complex) -> sparse.csr_matrix:
        # By rows or by columns is one for a symmetric matrix; by rows it is multiplied with faster.
        pattern = self.operators.pattern
        return sparse.csr_matrix((entries, pattern.indices, pattern.indptr), shape=pattern.shape)

    def solve(self, frequency: float) -> tuple[Complex, float]:
        """The state (size,) at unit electrode voltage, and its scaled residual."""
        states, residual = self.krylov(frequency, 1)
        return states[:, 0], residual

    def krylov(
        self, frequency: float, count: int, *, step: float = 0.01, tangents: tuple[str, ...] = ()
    ) -> tuple[Complex, float]:
        """The state at `frequency`, `count` - 1 further vectors that make up its neighbours, and `tangents`.

        With A_0 = A(w) factorised once, A(w') x = b is (1 + A_0^-1 (A(w') - A_0)) x = x_0, so the states nearby lie
        close to the Krylov space of A_0^-1 (A(w (1 + step)) - A_0) started at x_0: one factorisation serves a whole
        neighbourhood, whatever the coefficients' dependence on frequency. The same factorisation gives the derivative
        of the state by a parameter, -A_0^-1 (dA) x_0, for every name in `tangents`.

        Returns:
            (size, count + len(tangents)) the state first, and the scaled residual of the state itself.
        """
        entries = self._at(frequency)
        whole = self._stored(entries)
        free, inner = whole.shape[0] - 1, self.operators.free
        held = sparse.csr_matrix((entries[inner.entries], inner.pattern.indices, inner.pattern.indptr),
                                 shape=inner.pattern.shape)
        factor = factorise(held, frequency, inner.factorisation)
        electrode = (whole @ np.append(np.zeros(free), 1.0))[:free]
        x, residual = factor.solve(-electrode)
        states = np.zeros((free + 1, count + len(tangents)), dtype=complex)
        states[:, 0] = np.append(x, 1.0)
        if count > 1:
            change = self._stored(self._at(frequency * (1.0 + step)) - entries)
            vector = states[:, 0]
            directions = np.zeros((free, 0), dtype=complex)
            for k in range(1, count):
                found = factor.solve_scaled(factor.scale * (change @ vector)[:free])
                for _ in range(2):
                    found = found - directions @ (directions.conj().T @ found)
                found = found / np.linalg.norm(found)
                directions = np.column_stack([directions, found])
                vector = np.append(factor.scale * found, 0.0)
                states[:, k] = vector
        if tangents:
            changes = self._changes(frequency, states[:, 0], tangents)[:free]
            states[:free, count:] = -factor.scale[:, None] * factor.solve_scaled(factor.scale[:, None] * changes)
        return states, residual

    def _changes(self, frequency: float, state: Complex, names: tuple[str, ...]) -> Complex:
        """(dA / dtheta) x (size, len(names)) for complex parameters."""
        omega = np.array([2.0 * np.pi * frequency])
        integrals = self.operators.integrals
        depending = dependence(integrals)
        slopes = np.zeros((len(integrals), len(names)), dtype=complex)
        for column, name in enumerate(names):
            for q in depending.get(name, ()):
                slopes[q, column] = integrals[q].coefficient.derivative(omega, self.values, name)[0]
        return self.operators.images(state, slopes)


def factorise(
    matrix: sparse.csc_matrix | sparse.csr_matrix, frequency: float, factorisation: Factorisation | None = None
) -> Factor:
    """Scale a symmetric matrix (n, n) to unit diagonal and factorise it, with what knows its pattern if there is one.

    The diagonal scaling brings displacement, potential and pressure to one size; without it energy does not close.

    Raises:
        NotConverged: the matrix is singular.
    """
    diagonal = np.abs(matrix.diagonal())
    if not (diagonal > 0.0).all():
        raise NotConverged(frequency, np.inf, np.zeros(diagonal.size, dtype=complex))
    scale = 1.0 / np.sqrt(diagonal)
    data = matrix.data * (scale[matrix.indices] * np.repeat(scale, np.diff(matrix.indptr)))
    scaled = sparse.csr_matrix((data, matrix.indices, matrix.indptr), shape=matrix.shape)
    try:
        with one_thread():
            solve = (SuperLU(matrix) if factorisation is None else factorisation)(data)
    except RuntimeError as error:
        raise NotConverged(frequency, np.inf, np.zeros(diagonal.size, dtype=complex)) from error
    return Factor(frequency, scaled, scale, solve)


def sweep(operators: FullOperators, frequencies: Real, values: Values) -> Iterator[Solution]:
    """The full model at one frequency after the other, each as soon as it is solved, so that a stop loses nothing."""
    system = System(operators, values)
    for frequency in np.asarray(frequencies, dtype=float):
        with one_thread():
            state, residual = system.solve(float(frequency))
        groups = frequency_groups(operators.integrals, np.array([2.0 * np.pi * frequency]), values)
        charge = np.array([system.charge(float(frequency), state)])
        yield Solution(operators, np.array([frequency]), groups, state[:, None], charge, np.array([residual]))


def solve_full(operators: FullOperators, frequencies: Real, values: Values) -> Solution:
    """The full model at every frequency with all states kept: for a few frequencies. Long spectra: :func:`sweep`."""
    parts = list(sweep(operators, frequencies, values))
    frequency = np.concatenate([p.frequency for p in parts])
    return Solution(operators, frequency, frequency_groups(operators.integrals, 2.0 * np.pi * frequency, values),
                    np.concatenate([p.states for p in parts], axis=1), np.concatenate([p.charge for p in parts]),
                    np.concatenate([p.residual for p in parts]))


def solve_reduced(operators: ReducedOperators, frequencies: Real, values: Values) -> Solution:
    """The reduced model at every frequency: batched dense solves."""
    frequencies = np.asarray(frequencies, dtype=float)
    groups = frequency_groups(operators.integrals, 2.0 * np.pi * frequencies, values)
    return solve_groups(operators, frequencies, groups)


def solve_groups(operators: ReducedOperators, frequencies: Real, groups: Groups) -> Solution:
    """The reduced model at every frequency, of which `groups` is all that depends on values."""
    summed = operators.combinations(np.array([constants for _, constants in groups]))
    factors = np.stack([h for h, _ in groups])
    states, residual = solve_dense(factors, summed)
    charge = -np.asarray(sum(h * np.sum(states * (each @ states), axis=0)
                             for h, each in zip(factors, summed, strict=True)))
    return Solution(operators, frequencies, groups, states, charge, residual)


def solve_dense(factors: Complex, matrices: Complex) -> tuple[Complex, Real]:
    """States (r, n), last entry 1, of sum_g factors_g(w) matrices_g (groups, r, r) for n frequencies, and residuals.

    Where the groups make a :class:`Pencil` it is diagonalised once for all frequencies, which at 160 unknowns and 481
    frequencies is seven times faster than factorising at each. A large system is solved at a few of the frequencies
    first. Each factorisation gives the state there and the next vectors of its Krylov space, which its neighbours lie
    in (see `System.krylov`); on what these span all others are solved, until the residual of the large system is below
    :data:`NARROWED` everywhere.
    """
    with one_thread():
        right = -np.einsum("gn,gi->in", factors, matrices[:, :-1, -1])
        inner = np.ascontiguousarray(matrices[:, :-1, :-1])
        norm = np.linalg.norm(right, axis=0)
        rank, count = inner.shape[1], factors.shape[1]
        if rank >= LARGE and count >= MANY:
            x = _solve_narrowed(factors, inner, right)
        else:
            pencil = Pencil.of(factors, inner) if count > 1 else None
            if pencil is not None:
                x = pencil.solve(right)
                x = x + pencil.solve(right - pencil.product(x))
                residual = np.linalg.norm(right - pencil.product(x), axis=0) / norm
                if residual.max() <= PENCIL_RESIDUAL:
                    return np.vstack([x, np.ones(x.shape[1])]), residual
            x = solve_each(factors, inner, right)
        remainder = sum(h * (each @ x) for h, each in zip(factors, inner, strict=True)) - right
    return np.vstack([x, np.ones(x.shape[1])]), np.linalg.norm(remainder, axis=0) / norm


def _solve_narrowed(factors: Complex, matrices: Complex, right: Complex) -> Complex:
    """See :func:`solve_dense`: x (r, n)."""
    count, rank = factors.shape[1], matrices.shape[1]
    flat = matrices.reshape(len(matrices), rank**2)
    norm = np.linalg.norm(right, axis=0)
    wanted = chebyshev(count, NODES)
    basis = np.zeros((rank, 0))
    done: set[int] = set()
    while True:
        found = []
        for index in wanted:
            done.add(int(index))
            near = min(index + 1, count - 1) if index + 1 < count else index - 1
            whole = (factors[:, index] @ flat).reshape(rank, rank)
            change = ((factors[:, near] - factors[:, index]) @ flat).reshape(rank, rank)
            factor = scipy.linalg.lu_factor(whole, check_finite=False)
            vector = scipy.linalg.lu_solve(factor, right[:, index], check_finite=False)
            found.append(vector / np.linalg.norm(vector))
            for _ in range(DEPTH - 1):
                vector = scipy.linalg.lu_solve(factor, change @ found[-1], check_finite=False)
                for _ in range(2):
                    vector = vector - sum(other * (other.conj() @ vector) for other in found[-DEPTH:])
                found.append(vector / np.linalg.norm(vector))
        new = np.array(found).T
        new = np.column_stack([new.real, new.imag])
        for _ in range(2):
            new = new - basis @ (basis.T @ new)
        new, triangle, _ = scipy.linalg.qr(new, mode="economic", pivoting=True, check_finite=False)
        basis = np.column_stack([basis, new[:, np.abs(np.diag(triangle)) > 1e-10]])
        if 2 * basis.shape[1] > rank:
            return solve_each(factors, matrices, right)
        images = [each @ basis for each in matrices]
        small = solve_each(factors, np.stack([basis.T @ each for each in images]), basis.T @ right)
        remainder = sum(h * (each @ small) for h, each in zip(factors, images, strict=True)) - right
        residual = np.linalg.norm(remainder, axis=0) / norm
        if residual.max() <= NARROWED:
            return np.asarray(basis @ small)
        worst = [int(k) for k in np.argsort(-residual)[: 4 * NODES] if int(k) not in done]
        apart = [k for i, k in enumerate(worst) if all(abs(k - other) > count // (4 * NODES) for other in worst[:i])]
        wanted = np.array(apart[:2], dtype=int)
        if not wanted.size:
            return solve_each(factors, matrices, right)


def chebyshev(count: int, nodes: int) -> NDArray[np.int64]:
    """Indices of `count` frequencies next to Chebyshev's nodes, as many as those fall on."""
    angles = np.pi * (np.arange(nodes) + 0.5) / nodes
    return np.unique(np.round(0.5 * (count - 1) * (1.0 - np.cos(angles))).astype(int))


def solve_each(factors: Complex, matrices: Complex, right: Complex) -> Complex:
    """x (..., r, n) with sum_g factors_g(w) matrices_g (groups, r, r) times x = right (..., r, n), at n frequencies."""
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
    """h(w) (B_0 + t B_1 + t^2 B_2) at n values of t: stiffness and mass, and what a fluid adds, with t = w^2.

    With t = t0 (1 + s) it is P_0 + s P_1 + s^2 P_2; with y = s x its inverse follows from that of 1 + s S,
    S = [[P_0^-1 P_1, P_0^-1 P_2], [-1, 0]] = V L V^-1, or S = P_0^-1 P_1 where there is no P_2, diagonalised once.
    """

    def __init__(self, scale: Complex, ratio: Complex, parts: Sequence[Complex]) -> None:
        """`scale` h (n,), `ratio` t (n,) and two or three matrices B (r, r)."""
        self._scale, self._parts = scale, parts
        self._powers = [np.ones(ratio.size), ratio, ratio**2][: len(parts)]
        middle = np.median(ratio.real)
        self._shift = ratio / middle - 1.0
        first, second = parts[0] + middle * parts[1], middle * parts[1]
        if len(parts) == 3:
            last = middle**2 * parts[2]
            first, second = first + last, np.hstack([second + 2.0 * last, last])
        self._factor = scipy.linalg.lu_factor(first)
        size = len(first)
        whole = np.vstack([scipy.linalg.lu_solve(self._factor, second),
                           -np.eye(size * (len(parts) - 2), size * (len(parts) - 1))])
        roots, self._vectors = np.linalg.eig(whole)
        self._back = np.linalg.inv(self._vectors)[:, :size]
        self._vectors = self._vectors[:size]
        self._damped = 1.0 / (1.0 + np.outer(roots, self._shift))

    @classmethod
    def of(cls, factors: Complex, matrices: Complex) -> Pencil | None:
        """The pencil that sum_g factors_g (groups, n) matrices_g (groups, r, r) is; None if it is none."""
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

    def solve(self, right: Complex) -> Complex:
        """x (r, n) with the pencil times x = right (r, n)."""
        loads = scipy.linalg.lu_solve(self._factor, right / self._scale)
        return np.asarray(self._vectors @ (self._damped * (self._back @ loads)))

    def product(self, x: Complex) -> Complex:
        """The pencil times x (r, n)."""
        return np.asarray(self._scale * sum(
            (part @ x) * power for part, power in zip(self._parts, self._powers, strict=True)))
