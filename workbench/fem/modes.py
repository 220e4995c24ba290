"""Complex eigenfrequencies and mode shapes: the poles of the admittance.

The electrodes are short-circuited. The matrix A(w) of a model has any powers of w in it (fluids, boundary layers, laws
of loss), so its modes are solutions of a nonlinear eigenvalue problem A(w) x = 0. With its rows of the pressure times
w^2, the matrix of lossy solids and ideal fluids is linear in w^2, so block Arnoldi iterations with one factorisation at
a real frequency give all modes within a circle about it, all but for boundary layers and laws of loss. The problem
projected on these vectors is solved exactly by Newton's method, and the vectors are extended by residual inverse
iteration (Neumaier 1985, SIAM J. Numer. Anal. 22, 914) until the frequencies stay. Coefficients are continued from the
real axis to complex frequencies by Chebyshev polynomials. Circles are added until they cover the band.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.polynomial import Chebyshev
from numpy.typing import NDArray
from scipy.linalg.blas import zgemm

from workbench.fem.coefficients import Coefficients, Groups
from workbench.fem.forms import real_times
from workbench.fem.operators import FullOperators
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.solve import Factor, System, one_thread
from workbench.files.quantities import frequency_text
from workbench.physics.term import Values

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Angular frequencies (n,) in rad/s and states (size - 1, n) without voltage, or (r, n) on a basis.
Pairs = tuple[Complex, Complex]

#: Relative change of an eigenfrequency in a step at which it is converged, and after the last round; the error is of
#: that size, that of a shape its root. 1e-6 is a hundredth of a width at Q = 5000. Steps of 1e-9 are rounding where two
#: modes are near.
CONVERGED, TOLERANCE = 1e-8, 1e-6

#: Degree of the polynomials that continue the coefficients: their powers of w are then exact to 1e-12 over an octave.
DEGREE = 14

#: Vectors of a block of the Arnoldi iteration. Doubled, each vector takes three quarters of the time, and more of them
#: are necessary.
BLOCK = 8

#: Vectors of the iteration between tests, and most of them where a circle is wide enough. Doubled, there are fewer
#: factorisations and more memory.
CHECKED, DIRECTIONS = 32, 256

#: Relative residual of a start: the error of a frequency is about its square.
ROUGH = 1e-4

#: Number of unknowns up to which all modes are found at once.
DENSE = 400

#: Relative step of frequency over which the matrix is taken to be linear in w^2 for starting values.
STEP = 0.01

#: Most rounds of extensions of the basis, and most Newton steps of a mode, which converge quadratically.
ROUNDS, NEWTON = 8, 12

#: Relative difference of frequencies below which two searches may have found one mode. A tenth of it ends Newton's
#: method: the rounding of stiff modes limits those of low frequency.
SAME = 1e-8

#: Part of the states outside a basis that is left out: an eigenfrequency is off by its square.
DEPENDENT = 1e-5

#: Least share of a circle's radius that lies on the band for the modes that are wanted. Where it is less, more modes
#: are sought about that frequency.
COVERED = 0.5

#: Modes of a reduced model sought about a frequency.
NEAREST = 4

#: Largest half width of a circle over its frequency: coefficients are continued over an octave.
WIDEST = 0.3

#: Loss over frequency that is rounding.
ROUNDING = 1e-13

#: Smallest quality factor of the modes sought by default. Modes of less are no peaks of a spectrum.
LEAST_Q = 20.0


class ModesNotConverged(RuntimeError):
    """Eigenfrequencies (n,) in Hz that still changed in the last round."""

    def __init__(self, frequencies: Complex, changes: Real) -> None:
        worst = int(np.argmax(changes))
        super().__init__(f"the mode at {frequency_text(frequencies[worst].real)} still moves by {changes[worst]:.1e} "
                         f"(relative) after {ROUNDS} rounds, above {TOLERANCE:.0e}; narrow the band")
        self.frequencies, self.changes = frequencies, changes

    def __reduce__(self) -> tuple[type[ModesNotConverged], tuple[Complex, Real]]:
        return ModesNotConverged, (self.frequencies, self.changes)


@dataclass(frozen=True, eq=False)
class Eigenmodes:
    """Modes of a model, by frequency.

    ``omega`` (n,) rad/s is complex, e^{-i w t}. ``states`` (size, n) have no voltage and x^T (dA/dw) x = -2 w, that is
    x^T M x = 1 where A = K - w^2 M. ``changes`` (n,) is the relative change of each frequency in the last step.
    """

    operators: FullOperators
    omega: Complex
    states: Complex
    changes: Real

    @property
    def frequency(self) -> Real:
        """Real parts of the eigenfrequencies (n,) in Hz."""
        return np.asarray(self.omega.real / (2.0 * np.pi))

    @property
    def q(self) -> Real:
        """Quality factors (n,); infinite without loss."""
        return _quality(self.omega)


@dataclass(frozen=True, eq=False)
class ReducedModes:
    """Modes of a reduced model, by frequency, normalised as :class:`Eigenmodes`.

    ``omega`` (n,) rad/s, ``drive`` (n,) the electrode's row times the state: the charge at 1 V has the poles drive^2 /
    (omega^2 - w^2). ``states`` (r - 1, n) are coordinates.
    """

    omega: Complex
    drive: Complex
    states: Complex


def eigenmodes(system: System, band: tuple[float, float], *, least_q: float = LEAST_Q) -> Eigenmodes:
    """All modes of a model in a band, above a quality factor.

    Parameters
    ----------
    system : the model with its values.
    band : lowest and highest frequency (Hz).
    least_q : smallest quality factor.

    Raises
    ------
    NotConverged : the model is singular at a frequency of the band.
    ModesNotConverged : a mode still moves after the last round.
    """
    with one_thread():
        parts = list(_windows(system, band, least_q))
    omega = np.concatenate([part.omega for part in parts])
    order = np.argsort(omega.real)
    return Eigenmodes(system.operators, omega[order], np.hstack([part.states for part in parts])[:, order],
                      np.concatenate([part.changes for part in parts])[order])


def eigenfrequency_slopes(system: System, found: Eigenmodes, name: str) -> Complex:
    """Derivatives (n,) of angular eigenfrequencies by a parameter.

    A(w, theta) x = 0 and x^T A = 0 give dw = -x^T (dA/dtheta) x / (x^T (dA/dw) x). The coefficients are those at the
    real parts of the frequencies: the real part of a slope is off by 1 / Q^2.
    """
    coefficients, omega = system.operators.coefficients, found.omega
    slopes = coefficients.slopes(system.values, (name,))[0]
    forms = system.operators.combined_forms(found.states, np.array(list(slopes.values())))
    laws = np.array([law(omega.real, system.values) for law in slopes])
    return np.asarray(np.sum(laws.T * forms, axis=1) / (2.0 * omega))


def _windows(system: System, band: tuple[float, float], least_q: float) -> Iterator[Eigenmodes]:
    """Modes about several frequencies, each mode once, until they cover the band."""
    edge, high = band
    half = 0.25 * (high - edge)
    while edge < high:
        # Equal circles cover the rest of the band.
        wanted = min(0.5 * (high - edge) / math.ceil(0.5 * (high - edge) / half), WIDEST * edge)
        centre = edge + wanted
        factor, starts, reached = _starts(system, centre, wanted, least_q)
        half = min(reached, WIDEST * centre)
        if centre - half > edge:
            # It does not reach back: the next attempt is nearer.
            continue
        end = min(high, centre + half)
        model = _Continued.of(system, (np.pi * centre, 3.0 * np.pi * centre))
        yield _refined(model, factor, starts, (edge, end), least_q)
        edge = end


def _starts(system: System, frequency: float, wanted: float, least_q: float) -> tuple[Factor, Pairs, float]:
    """The model factorised at a frequency (Hz), and approximate modes about it.

    Returns also the half width (Hz) of the band in which these are all modes of the quality factor: `wanted` (Hz) or
    more, or less if that takes more than :data:`DIRECTIONS` vectors.
    """
    factor = system.factored(frequency)[1]
    inverse, growth = _shifted_inverse(system, factor, frequency), (1.0 + STEP) ** 2

    most = DIRECTIONS
    for found in _arnoldi(inverse, factor.scale.size):
        # The circle about w^2 within which all of them are converged, and one about w within it.
        squares = (1.0 - growth) / found.sizes
        within = float(np.abs(squares[found.errors > ROUGH]).min(initial=np.inf))
        radius = frequency * (math.sqrt(1.0 + within) - 1.0)
        half = math.sqrt(max(radius**2 - (0.5 * frequency / least_q) ** 2, 0.0))
        if half >= wanted:
            break
        if found.sizes.size >= most:
            if half >= COVERED * radius:
                break
            most *= 2
    inside = np.abs(squares) < within
    omegas = np.asarray(2.0 * np.pi * frequency * np.sqrt(1.0 + squares[inside]), dtype=np.complex128)
    return factor, (omegas, factor.scale[:, None] * (found.space @ found.inner[:, inside])), half


def _shifted_inverse(system: System, factor: Factor, frequency: float) -> Callable[[Complex], Complex]:
    """The operator whose largest eigenvalues are the nearest modes.

    It is A(w)^-1 times the change of A over a :data:`STEP`, with the rows of the pressure times w^2. It takes and
    returns scaled columns (size - 1, k). Its eigenvalues are (w^2 - w'^2) / (w_n^2 - w^2).
    """
    further = frequency * (1.0 + STEP)
    change, free, growth = system.change(frequency, further), factor.scale.size, (1.0 + STEP) ** 2
    rows = np.unique(system.operators.numbering["p"])
    rows = rows[rows >= 0]
    of_pressure = (growth - 1.0) * system.matrix(further)[rows][:, :free]
    scale = factor.scale[:, None]

    def inverse(right: Complex) -> Complex:
        state = np.zeros((free + 1, right.shape[1]), dtype=complex)
        state[:free] = scale * right
        image = change.times(state)[:free]
        image[rows] += of_pressure @ state[:free]
        return factor.solve_scaled(scale * image)

    return inverse


@dataclass(frozen=True, eq=False)
class _Ritz:
    """Approximate eigenvalues of an operator.

    They are ``sizes`` (n,) with relative ``errors`` (n,); the vectors are space @ inner.
    """

    sizes: Complex
    errors: Real
    space: Complex
    inner: Complex


def _arnoldi(operator: Callable[[Complex], Complex], size: int) -> Iterator[_Ritz]:
    """Eigenvalues of an operator in block Krylov spaces that grow.

    `operator` takes and returns columns (size, k). The last space is the whole one.
    """
    if size <= DENSE:
        sizes, whole = np.linalg.eig(operator(np.eye(size, dtype=complex)))
        moving = np.abs(sizes) > ROUNDING * np.abs(sizes).max()
        yield _Ritz(sizes[moving], np.zeros(int(moving.sum())), whole, np.eye(size, dtype=complex)[:, moving])
        return
    space = np.zeros((size, DIRECTIONS + BLOCK), dtype=complex, order="F")
    triangle = np.zeros((DIRECTIONS + BLOCK, DIRECTIONS + BLOCK), dtype=complex)
    start = operator(np.random.default_rng(0).standard_normal((size, BLOCK)).astype(complex))
    space[:, :BLOCK] = np.linalg.qr(start)[0]
    count = 0
    while count + 2 * BLOCK <= size:
        last = slice(count, count + BLOCK)
        count += BLOCK
        if count + BLOCK > space.shape[1]:
            space = np.asfortranarray(np.pad(space, ((0, 0), (0, count))))
            triangle = np.pad(triangle, (0, count))
        found = np.asfortranarray(operator(space[:, last]))
        known = space[:, :count]
        # Columns shrink by a tenth at most, so that once is enough.
        triangle[:count, last] = zgemm(1.0, known, found, trans_a=2)
        found = zgemm(-1.0, known, triangle[:count, last], 1.0, found, overwrite_c=True)
        space[:, count : count + BLOCK], triangle[count : count + BLOCK, last] = np.linalg.qr(found)
        if count % CHECKED == 0:
            sizes, inner = np.linalg.eig(triangle[:count, :count])
            outside = np.linalg.norm(triangle[count : count + BLOCK, last] @ inner[last], axis=0)
            yield _Ritz(sizes, outside / np.abs(sizes), known, inner)


def _refined(
    model: _Continued, factor: Factor, starts: Pairs, band: tuple[float, float], least_q: float
) -> Eigenmodes:
    """The modes in a `band` (Hz) that are reached from approximate ones."""
    scale = factor.scale[:, None]
    omegas, full = starts
    nearby = _inside(omegas, band, 0.5 * least_q, margin=0.2)
    omegas, full = omegas[nearby], full[:, nearby]
    basis = _orthonormal(_parts(full / scale), np.zeros((scale.size, 0)))
    parts = [(omegas[:0], full[:, :0], np.zeros(0))]
    projected = None
    for limit in (*(CONVERGED for _ in range(ROUNDS - 1)), TOLERANCE):
        if not omegas.size:
            break
        projected = model.on(np.vstack([scale * basis, np.zeros(basis.shape[1])]), projected)
        coordinates = real_times(basis.T[None], full / scale)[0]
        modes = [projected.mode_near(*pair) for pair in zip(omegas, coordinates.T, strict=True)]
        omegas, states = projected.distinct(modes)
        # A mode at the edge may yet move into the band.
        moving = _inside(omegas, band, 0.99 * least_q, margin=1e-3)
        omegas, full = omegas[moving], scale * real_times(basis[None], states[:, moving])[0]
        if not omegas.size:
            break
        residuals = scale * model.images(omegas, full)
        steps = factor.solve_scaled(residuals)
        # w^2 changes by r^T A^-1 r / (x^T M x) for the residual r = A x; the factor stands for A.
        change = -0.5 * np.sum(residuals * steps, axis=0) / omegas
        changes = np.abs(change / omegas)
        done = changes <= limit
        parts.append(((omegas + change)[done], (full - scale * steps)[:, done], changes[done]))
        omegas, full, steps, changes = omegas[~done], full[:, ~done], steps[:, ~done], changes[~done]
        if omegas.size:
            basis = np.hstack([basis, _orthonormal(_parts(steps), basis)])
    if omegas.size:
        raise ModesNotConverged(omegas / (2.0 * np.pi), changes)
    found, full, changes = (np.concatenate(each, axis=-1) for each in zip(*parts, strict=True))
    inside = _inside(found, band, least_q)
    states = np.vstack([full[:, inside], np.zeros(int(inside.sum()))])
    return Eigenmodes(model.system.operators, found[inside], states, changes[inside])


def _inside(omegas: Complex, band: tuple[float, float], least_q: float, margin: float = 0.0) -> NDArray[np.bool_]:
    """Mask (n,) of the modes in a band, above a quality factor.

    The `band` (Hz) is widened by the share `margin` of its width.
    """
    low, high = (2.0 * np.pi * each for each in band)
    wider = margin * (high - low)
    return (omegas.real >= low - wider) & (omegas.real < high + wider) & (_quality(omegas) >= least_q)


def reduced_modes(operators: ReducedOperators, values: Values, frequencies: Iterable[float]) -> ReducedModes:
    """The modes of a reduced model nearest to some `frequencies` (Hz).

    All directions but the last one have no voltage.
    """
    found = dict[complex, tuple[Complex, complex]]()
    for frequency in frequencies:
        omega = 2.0 * np.pi * frequency
        laws, groups = _continued(operators.coefficients, values, (0.5 * omega, 1.5 * omega))
        whole = operators.combinations(np.array([constants for _, constants in groups]))
        projected = _Projected(laws, whole[:, :-1, :-1])
        # A + d dA/dw is singular at the distance d to a mode.
        sizes, vectors = np.linalg.eig(np.linalg.solve(*projected.at(omega)))
        nearest = np.argsort(-np.abs(sizes))[:NEAREST]
        omegas, states = projected.distinct([projected.mode_near(omega - 1.0 / sizes[k], vectors[:, k])
                                             for k in nearest])
        for one, state in zip(omegas.tolist(), states.T, strict=True):
            if one.real > 0.0 and not any(abs(one / other - 1.0) < SAME for other in found):
                drive = sum(law(one) * matrix[-1, :-1] for law, matrix in zip(laws, whole, strict=True)) @ state
                found[one] = state, complex(drive)
    ordered = sorted(found, key=lambda one: one.real)
    return ReducedModes(np.array(ordered, dtype=complex), np.array([found[one][1] for one in ordered], dtype=complex),
                        np.array([found[one][0] for one in ordered], dtype=complex).reshape(
                            len(found), operators.size - 1).T)


def _continued(coefficients: Coefficients, values: Values, band: tuple[float, float]) -> tuple[list[Chebyshev], Groups]:
    """Polynomials h_g(w) of all groups that continue them from a `band` (rad/s)."""
    nodes = 0.5 * (band[0] + band[1]) + 0.5 * (band[1] - band[0]) * np.cos(
        np.pi * (np.arange(2 * DEGREE) + 0.5) / (2 * DEGREE))
    groups = coefficients.groups(nodes, values)
    return [Chebyshev.fit(nodes, law, DEGREE, domain=list(band)) for law, _ in groups], groups


@dataclass(frozen=True, eq=False)
class _Continued:
    """The full model at complex frequencies: sum_g h_g(w) B_g with polynomials h_g."""

    system: System
    laws: list[Chebyshev]
    groups: Groups

    @classmethod
    def of(cls, system: System, band: tuple[float, float]) -> _Continued:
        """A model continued from the frequencies of a `band` (rad/s)."""
        return cls(system, *_continued(system.operators.coefficients, system.values, band))

    def images(self, omegas: Complex, states: Complex) -> Complex:
        """The products A(w_k) x_k (size - 1, n).

        `states` (size - 1, n) are columns without voltage.
        """
        states = np.vstack([states, np.zeros(omegas.size)])
        result = np.zeros(states.shape, dtype=complex)
        for law, matrix in zip(self.laws, self.system.groups, strict=True):
            result += law(omegas) * matrix.times(states)
        return result[:-1]

    def on(self, basis: Real, known: _Projected | None = None) -> _Projected:
        """The model on a basis (size, r).

        `known` is the model on its first columns.
        """
        matrices = np.zeros((len(self.laws), basis.shape[1], basis.shape[1]), dtype=complex)
        count = 0
        if known is not None:
            count = known.matrices.shape[1]
            matrices[:, :count, :count] = known.matrices
        for matrix, group in zip(matrices, self.system.groups, strict=True):
            for turn, part in group.parts:
                rows = np.flatnonzero(np.diff(part.whole.indptr))
                matrix[:, count:] += turn * (basis[rows].T @ (part.whole[rows] @ basis[:, count:]))
            matrix[count:, :count] = matrix[:count, count:].T
        return _Projected(self.laws, matrices)


def _normed(state: Complex) -> Complex:
    """A state (r,) of unit length."""
    return np.asarray(state / np.linalg.norm(state), dtype=np.complex128)


@dataclass(frozen=True, eq=False)
class _Projected:
    """A model on a small basis at complex frequencies.

    ``matrices`` has the shape (groups, r, r).
    """

    laws: list[Chebyshev]
    matrices: Complex

    def at(self, omega: complex) -> tuple[Complex, Complex]:
        """The matrix (r, r) and its derivative by w, at complex w."""
        factors = np.array([[law(omega) for law in laws] for laws in (self.laws, self._slopes)])
        matrix, slope = np.tensordot(factors, self.matrices, axes=1)
        return matrix, slope

    @cached_property
    def _slopes(self) -> list[Chebyshev]:
        return [law.deriv() for law in self.laws]

    def mode_near(self, omega: complex, state: Complex) -> tuple[complex, Complex] | None:
        """The mode that Newton's method reaches from a `state` (r,)."""
        for _ in range(NEWTON):
            matrix, slope = self.at(omega)
            left = slope @ state
            try:
                step = np.linalg.solve(matrix, left)
            except np.linalg.LinAlgError:
                # An exact eigenfrequency: the mode is the part of the state that the matrix takes to zero.
                space = scipy.linalg.null_space(matrix)
                return omega, _normed(np.asarray(space @ (space.conj().T @ state), dtype=np.complex128))
            change = -complex(left @ state) / complex(left @ step)
            state = _normed(np.asarray(step, dtype=np.complex128))
            omega += change
            if abs(change) <= 0.1 * SAME * abs(omega):
                return omega, state
        return None

    def distinct(self, modes: Iterable[tuple[complex, Complex] | None]) -> Pairs:
        """The distinct ones of some modes, normalised as in :class:`Eigenmodes`."""
        found: list[tuple[complex, Complex]] = []
        for mode in modes:
            if mode is None:
                continue
            slope = self.at(mode[0])[1]
            state = mode[1] * np.sqrt(-2.0 * mode[0] / complex(mode[1] @ slope @ mode[1]))
            # Two modes may have one frequency; their states are then orthogonal.
            if not any(abs(mode[0] / omega - 1.0) < SAME and abs(state @ slope @ other) > abs(mode[0])
                       for omega, other in found):
                found.append((mode[0], state))
        states = np.array([state for _, state in found], dtype=complex).reshape(len(found), self.matrices.shape[1])
        return np.array([omega for omega, _ in found], dtype=complex), states.T


def _quality(omega: NDArray[np.complexfloating] | complex) -> Real:
    """Quality factors of complex angular frequencies, e^{-i w t}; infinite without loss."""
    omega = np.asarray(omega)
    loss = -2.0 * omega.imag
    return np.divide(omega.real, loss, out=np.full(loss.shape, np.inf), where=loss > ROUNDING * np.abs(omega.real))


def _parts(states: Complex) -> Real:
    """Real and imaginary parts (m, 2 n) of states (m, n), normalised.

    The phase of each state makes its real part largest.
    """
    turned: Complex = states / np.linalg.norm(states, axis=0)
    turned = np.asarray(turned * np.exp(-0.5j * np.angle(np.sum(turned**2, axis=0))))
    return np.asarray(np.hstack([turned.real, turned.imag]))


def _orthonormal(vectors: Real, basis: Real) -> Real:
    """Orthonormal directions (m, k) of `vectors` outside a `basis`.

    Those smaller than :data:`DEPENDENT` are left out.
    """
    for _ in range(2):
        vectors = vectors - basis @ (basis.T @ vectors)
        squares, turn = np.linalg.eigh(vectors.T @ vectors)
        large = squares > DEPENDENT**2
        vectors = vectors @ (turn[:, large] / np.sqrt(squares[large]))
    return np.asarray(vectors)
