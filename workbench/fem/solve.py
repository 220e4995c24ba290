"""Solutions at given frequencies, and quantities that are their quadratic forms.

A solution has unit voltage of the live electrode. Because A is symmetric and the drive is the electrode voltage, the
electrode charge is Q = -x^T A x, and its derivative by any coefficient is a quadratic form of the same x: dQ = -x^T
(dA) x. Neither adjoint solve nor finite difference is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from threadpoolctl import ThreadpoolController

from workbench.fem.coefficients import Groups, summed
from workbench.fem.dense import Span, solve_dense
from workbench.fem.factorisation import Factorisation, SuperLU
from workbench.fem.operators import FullOperators, Operators
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.sparsity import SplitMatrix, both_triangles, diagonal
from workbench.files.quantities import frequency_text
from workbench.jobs.memory import is_shortage, reserve_buffers
from workbench.physics.term import Values
from workbench.results.brief import Brief

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Largest scaled residual of an accepted solve. Refined solves reach 1e-13, almost singular matrices do not.
RESIDUAL_LIMIT = 1e-10

#: Scaled residual at which refinement stops: rounding gives 1e-15 to 9e-14 in a first solve.
ROUNDING = 1e-13


#: Relative step of a difference quotient by frequency. The functions have no resonance: with the step doubled, the
#: quotient is still exact to seven digits.
NEIGHBOURING = 1e-4


class NotConverged(RuntimeError):
    """A linear solve whose residual stayed above the limit. It has the frequency (Hz), the residual and the last
    iterate."""

    def __init__(self, frequency: float, residual: float, iterate: Complex, limit: float = RESIDUAL_LIMIT) -> None:
        super().__init__(
            f"the solve at {frequency_text(frequency)} has a scaled residual of {residual:.2e}, above {limit:.0e}; "
            "the model may be singular there (an undamped resonance, or a region without any support)"
        )
        self.frequency, self.residual, self.iterate, self.limit = frequency, residual, iterate, limit

    def __reduce__(self) -> tuple[Any, ...]:
        return (NotConverged, (self.frequency, self.residual, self.iterate, self.limit))


@dataclass(frozen=True, eq=False, repr=False)
class Solution(Brief):
    """States at unit electrode voltage, e^{-i w t}.

    ``frequency`` (n,) in Hz, ``states`` (size, n) with the electrode voltage last, ``groups`` the model at these
    frequencies (`coefficients.Coefficients.groups`), ``charge`` (n,) in C, -x^T A x, ``residual`` (n,) scaled, ``span``
    of the states of a reduced model, if known.
    """

    operators: Operators
    frequency: Real
    groups: Groups
    states: Complex
    charge: Complex
    residual: Real
    span: Span | None = None

    @property
    def omega(self) -> Real:
        return 2.0 * np.pi * self.frequency

    @cached_property
    def coefficients(self) -> Complex:
        """Coefficients g_q(w) (n, integrals)."""
        return summed(self.groups, self.frequency.size, self.operators.coefficients.count)

    @cached_property
    def forms(self) -> Complex:
        """Forms x^T A_q x (n, integrals) of all quantities without a conjugate."""
        return self.operators.quadratic(self.states, self.states)

    @property
    def admittance(self) -> Complex:
        """Admittance Y = -i w Q (n,), siemens, e^{-i w t}."""
        return -1j * self.omega * self.charge

    @property
    def impedance(self) -> Complex:
        """Impedance Z (n,) in ohm, e^{-i w t}. A capacitor has a *positive* imaginary part. Spectra contain the
        conjugate."""
        return 1.0 / self.admittance

    def parameter_gradient(self, values: Values, names: tuple[str, ...]) -> Complex:
        """Derivatives dZ/dtheta (n, len(names)) by complex parameters, e^{-i w t}.

        For a spectrum (the conjugate), the derivative by the real part of theta is conj(dZ), by the imaginary part
        conj(i dZ).

        Raises:
            KeyError: a name no coefficient depends on.
        """
        coefficients = self.operators.coefficients
        unknown = sorted(set(names) - coefficients.parameters)
        if unknown:
            raise KeyError(f"no coefficient depends on {unknown[0]!r}; known: "
                           f"{', '.join(sorted(coefficients.parameters))}")
        # By column and shape over frequency: constants of the integrals.
        rows = {(column, shape): constants for column, slopes in enumerate(coefficients.slopes(values, names))
                for shape, constants in slopes.items()}
        result = np.zeros((self.frequency.size, len(names)), dtype=complex)
        shapes = {shape: shape(self.omega, values) for _, shape in rows}
        kept = [key for key in rows if shapes[key[1]].any()]
        if kept:
            constants = np.array([rows[key] for key in kept])
            forms = self.operators.combined_forms(self.states, constants, self.span)
            for (column, shape), form in zip(kept, forms.T, strict=True):
                result[:, column] += shapes[shape] * form
        return np.asarray((1j / (self.omega * self.charge**2))[:, None] * result)

    def frequency_gradient(self, values: Values) -> Complex:
        """Derivative dZ/dw (n,) by the angular frequency, e^{-i w t}.

        Z = i / (w Q) and dQ = -x^T dA x. Coefficients are smooth functions of frequency; their difference quotient over
        :data:`NEIGHBOURING` is exact to eight digits.
        """
        coefficients, omega = self.operators.coefficients, self.omega
        after, before = (coefficients.groups(omega * (1.0 + sign * NEIGHBOURING), values) for sign in (1.0, -1.0))
        forms = self.operators.combined_forms(self.states, np.array([each for _, each in after]), self.span)
        changes = np.array([(a - b) for (a, _), (b, _) in zip(after, before, strict=True)]).T
        stiffening = (changes * forms).sum(axis=1) / (2.0 * NEIGHBOURING * omega)
        return np.asarray(-self.impedance / omega + 1j * stiffening / (omega * self.charge**2))

    def dissipation(self) -> Real:
        """Mean power (W) lost in each integral at 1 V amplitude. It is (n, integrals).

        It is -w/2 Im(g_q) x^H A_q x. The sum is the electrical input power w/2 Im Q (Acevedo-Espinosa et al. (RP-UEIS),
        eq. A.4 integrated over the volume).
        """
        forms = self.operators.quadratic(np.conj(self.states), self.states).real
        return -0.5 * self.omega[:, None] * self.coefficients.imag * forms

    def input_power(self) -> Real:
        """Electrical input power (W) at 1 V amplitude: (n,). It is that of charge and voltage."""
        return 0.5 * self.admittance.real


@cache
def _threads() -> ThreadpoolController:
    """The BLAS libraries in use, cached because the search is slow.

    Raises:
        MemoryError: a limited address space has no room for their buffers.
    """
    reserve_buffers()
    return ThreadpoolController()


@dataclass
class _Limit:
    """The limit of BLAS threads in force, and its number of users."""

    lock: Lock
    users: int = 0
    limiter: Any = None


_LIMIT = _Limit(Lock())


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit BLAS to one thread. Two threads made sparse factorisations up to 300 times slower on a busy two-core
    machine."""
    with _LIMIT.lock:
        if _LIMIT.users == 0:
            _LIMIT.limiter = _threads().limit(limits=1, user_api="blas")
        _LIMIT.users += 1
    try:
        yield
    finally:
        with _LIMIT.lock:
            _LIMIT.users -= 1
            if _LIMIT.users == 0:
                _LIMIT.limiter.restore_original_limits()


@dataclass(frozen=True, eq=False)
class Factor:
    """A factorised, symmetrically scaled system at one frequency. The upper ``triangle`` serves the refinement of a
    solve."""

    frequency: float
    triangle: sparse.csc_array
    scale: Real
    solve_scaled: Callable[[Complex], Complex]

    def solve(self, right: Complex, limit: float | None = None) -> tuple[Complex, float]:
        """The refined solution x of matrix x = right (size - 1,).

        Returns:
            x and its scaled residual.

        Raises:
            NotConverged: the scaled residual stays above the `limit`, :data:`RESIDUAL_LIMIT` if None.
        """
        scaled = self.scale * right
        norm = float(np.linalg.norm(scaled))
        x = self.solve_scaled(scaled)
        residual = np.inf
        for _ in range(4):
            remainder = scaled - _symmetric_product(self.triangle, x)
            previous, residual = residual, float(np.linalg.norm(remainder)) / norm
            if residual < ROUNDING or residual > 0.5 * previous:
                break
            x = x + self.solve_scaled(remainder)
        limit = RESIDUAL_LIMIT if limit is None else limit
        if not residual <= limit:
            raise NotConverged(self.frequency, residual, self.scale * x, limit)
        return self.scale * x, residual


class System:
    """The full model with parameter values. Matrices of equal frequency dependence are summed once (see
    `coefficients.Coefficients.groups`)."""

    def __init__(self, operators: FullOperators, values: Values) -> None:
        self.operators, self.values = operators, values
        self._constants = [constants for _, constants in operators.coefficients.groups(np.ones(1), values)]
        #: Matrices B_g (size, size) of every group: A(w) = sum_g h_g(w) B_g.
        self.groups = [operators.split(constants) for constants in self._constants]
        self._latest: tuple[float, Complex] = (np.nan, np.zeros(0, dtype=complex))

    def factors(self, frequencies: Real) -> Complex:
        """Factors h_g(w) (groups, n) of equal frequency dependence."""
        groups = self.operators.coefficients.groups(2.0 * np.pi * frequencies, self.values)
        return np.stack([h for h, _ in groups])

    def matrix(self, frequency: float) -> sparse.csr_array:
        """The matrix A(w) (size, size), complex symmetric, electrode included."""
        return both_triangles(self.operators.sparsity.triangle(self.entries(frequency)))

    def charge(self, frequency: float, state: Complex) -> complex:
        """The charge -x^T A x of a state (size,)."""
        triangle = self.operators.sparsity.triangle(self.entries(frequency))
        # Large terms cancel within a row: the form of one triangle would keep their rounding.
        return -complex(state @ _symmetric_product(triangle, state))

    def entries(self, frequency: float) -> Complex:
        """The upper entries (upper,) of A(w), cached for one frequency."""
        if self._latest[0] != frequency:
            real, imaginary = np.zeros((2, self.operators.sparsity.keys.size))
            for factor, group in zip(self.factors(np.array([frequency]))[:, 0], self.groups, strict=True):
                group.add_to(real, imaginary, factor)
            found = np.empty(real.size, dtype=complex)
            found.real, found.imag = real, imaginary
            self._latest = frequency, found
        return self._latest[1]

    def change(self, frequency: float, other: float) -> SplitMatrix:
        """The change of A(w) from a frequency (Hz) to another one."""
        here, there = self.factors(np.array([frequency, other])).T
        moved = zip(there - here, self._constants, strict=True)
        return self.operators.split(np.asarray(sum(factor * constants for factor, constants in moved if factor)))

    def factored(self, frequency: float) -> tuple[Complex, Factor]:
        """The electrode's column (size,) of A(w), and a factorisation.

        It is that of the free unknowns.

        Raises:
            NotConverged: the matrix is singular.
        """
        entries, pattern, last = self.entries(frequency), self.operators.sparsity, self.operators.size - 1
        electrode = np.zeros(pattern.size, dtype=complex)
        electrode[pattern.rows[pattern.starts[last]:]] = entries[pattern.starts[last]:]
        free = pattern.triangle(entries, self.operators.free)
        return electrode, factorise(free, frequency, self.operators.factorisation)

    def solve(self, frequency: float) -> tuple[Complex, float]:
        """The state (size,) at unit electrode voltage, and its scaled residual."""
        _, states, residual = self.neighbours(frequency, 1)
        return states[:, 0], residual

    def sweep(
        self, frequencies: Real, *, failed: Callable[[NotConverged], None] | None = None
    ) -> Iterator[Solution]:
        """Solve at one frequency after the other, and yield each solution.

        If a solve does not converge, `failed` is called and the frequency is omitted.

        Raises:
            NotConverged: a solve does not converge, and `failed` is None.
        """
        for frequency in np.asarray(frequencies, dtype=float):
            try:
                with one_thread():
                    state, residual = self.solve(float(frequency))
            except NotConverged as error:
                if failed is None:
                    raise
                failed(error)
                continue
            groups = self.operators.coefficients.groups(np.array([2.0 * np.pi * frequency]), self.values)
            charge = np.array([self.charge(float(frequency), state)])
            yield Solution(self.operators, np.array([frequency]), groups, state[:, None], charge, np.array([residual]))

    def solutions(self, frequencies: Real) -> Solution:
        """Solve at a few frequencies. For long spectra see :meth:`sweep`."""
        parts = list(self.sweep(frequencies))
        frequency = np.concatenate([p.frequency for p in parts])
        return Solution(self.operators, frequency,
                        self.operators.coefficients.groups(2.0 * np.pi * frequency, self.values),
                        np.concatenate([p.states for p in parts], axis=1), np.concatenate([p.charge for p in parts]),
                        np.concatenate([p.residual for p in parts]))

    def neighbours(
        self, frequency: float, count: int, *, step: float = 0.01, tangents: tuple[str, ...] = (),
        moves: Real | None = None,
    ) -> tuple[Factor, Complex, float]:
        """The state at `frequency`, further vectors that span nearby states, and tangents.

        With A_0 = A(w) factorised, A(w') x = b is (1 + A_0^-1 (A(w') - A_0)) x = x_0, so nearby states lie close to the
        Krylov space of A_0^-1 (A(w (1 + step)) - A_0) started at x_0, for any frequency dependence. The factorisation
        also gives the derivative of the state by a parameter, -A_0^-1 (dA) x_0, for every name in `tangents`, or along
        the directions `moves` (len(tangents), k) of these parameters. There are `count` - 1 further vectors.

        Returns:
            the factorisation, the vectors (size, count + k) with the state first, and the scaled residual of the state.
        """
        electrode, factor = self.factored(frequency)
        free = electrode.size - 1
        x, residual = factor.solve(-electrode[:-1])
        along = np.eye(len(tangents)) if moves is None else moves
        states = np.zeros((free + 1, count + along.shape[1]), dtype=complex, order="F")
        states[:free, 0], states[-1, 0] = x, 1.0
        if count > 1:
            change = self.change(frequency, frequency * (1.0 + step))
            states[:free, 1:count] = krylov(factor, change, states[:, 0], count - 1)
        if tangents:
            changes = self._changes(frequency, states[:, 0], tangents, along)[:free]
            states[:free, count:] = -factor.scale[:, None] * factor.solve_scaled(factor.scale[:, None] * changes)
        return factor, states, residual

    def _changes(self, frequency: float, state: Complex, names: tuple[str, ...], moves: Real) -> Complex:
        """Products (dA / dtheta) x (size, k) along parameter directions `moves`. The directions are (len(names), k)."""
        omega = np.array([2.0 * np.pi * frequency])
        coefficients = self.operators.coefficients
        slopes = np.zeros((coefficients.count, len(names)), dtype=complex)
        for column, by_shape in enumerate(coefficients.slopes(self.values, names)):
            for shape, constants in by_shape.items():
                slopes[:, column] += shape(omega, self.values)[0] * constants
        return self.operators.images(state, np.asarray(slopes @ moves, dtype=complex))


def krylov(factor: Factor, change: SplitMatrix, start: Complex, count: int) -> Complex:
    """Vectors (free, count) of a Krylov space, without its first.

    The space is that of A_0^-1 `change`. A_0 is the factorised matrix, `start` (size,) the first vector. The others are
    orthonormal in the scaled unknowns.
    """
    free = factor.scale.size
    directions = np.empty((free, count), dtype=complex, order="F")
    vector = start
    for k in range(count):
        found, before = factor.solve_scaled(factor.scale * change.times(vector)[:free]), directions[:, :k]
        for _ in range(2):
            found = found - before @ (before.conj().T @ found)
        directions[:, k] = found / np.linalg.norm(found)
        vector = np.append(factor.scale * directions[:, k], np.zeros(start.size - free))
    return np.asarray(factor.scale[:, None] * directions)


def factorise(triangle: sparse.csc_array, frequency: float, factorisation: Factorisation | None = None) -> Factor:
    """Scale a symmetric matrix (n, n) to unit diagonal and factorise it.

    `triangle` is its upper triangle, `factorisation` that of the pattern. The scaling brings displacement, potential
    and pressure to one size; without it the energy balance is not exact.

    Raises:
        NotConverged: the matrix is singular.
        RuntimeError, MemoryError: not enough memory.
    """
    size = np.abs(diagonal(triangle))
    if not (size > 0.0).all():
        raise NotConverged(frequency, np.inf, np.zeros(size.size, dtype=complex))
    scale = 1.0 / np.sqrt(size)
    data = triangle.data * (scale[triangle.indices] * np.repeat(scale, np.diff(triangle.indptr)))
    scaled = sparse.csc_array((data, triangle.indices, triangle.indptr), shape=triangle.shape)
    try:
        with one_thread():
            solve = (SuperLU(triangle) if factorisation is None else factorisation)(data)
    except RuntimeError as error:
        if is_shortage(error):
            raise
        raise NotConverged(frequency, np.inf, np.zeros(size.size, dtype=complex)) from error
    return Factor(frequency, scaled, scale, solve)


def _symmetric_product(triangle: sparse.csc_array, x: Complex) -> Complex:
    """The product (n,) of the symmetric matrix and x (n,)."""
    return np.asarray(triangle @ x + triangle.T @ x - diagonal(triangle) * x)


def sweep(
    operators: FullOperators, frequencies: Real, values: Values, *,
    failed: Callable[[NotConverged], None] | None = None,
) -> Iterator[Solution]:
    """Solve the full model at one frequency after the other; see :meth:`System.sweep`."""
    return System(operators, values).sweep(frequencies, failed=failed)


def solve_full(operators: FullOperators, frequencies: Real, values: Values) -> Solution:
    """Solve the full model at a few frequencies; see :meth:`System.solutions`."""
    return System(operators, values).solutions(frequencies)


def solve_reduced(operators: ReducedOperators, frequencies: Real, values: Values) -> Solution:
    """Solve the reduced model at every frequency: batched dense solves."""
    frequencies = np.asarray(frequencies, dtype=float)
    groups = operators.coefficients.groups(2.0 * np.pi * frequencies, values)
    return solve_groups(operators, frequencies, groups)


def solve_groups(operators: ReducedOperators, frequencies: Real, groups: Groups) -> Solution:
    """Solve the reduced model; only `groups` depend on parameter values."""
    summed = operators.combinations(np.array([constants for _, constants in groups]))
    with one_thread():
        found = solve_dense(np.stack([h for h, _ in groups]), summed)
    return Solution(operators, frequencies, groups, found.states, found.charge, found.residual, found.span)
