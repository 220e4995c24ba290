"""The reduced model: the affine operators projected on full solutions at a few frequencies.

The basis is real (real and imaginary parts of the states), so the projected A_q stay real and symmetric and the
reduced model is again affine in the same coefficients. Because the charge is a quadratic form of the state, its error
is second order in the residual,

    Q - Q_r = -e^T A e = -r^T A^{-1} r ,

so that the squared norm of the residual, times a constant found where a full solve is at hand, estimates it. The norm
is taken of a few random projections of the residual, which cost next to nothing for any parameter values (Balabanov
and Nouy 2019, Adv. Comput. Math. 45, 2969: randomised linear algebra for model order reduction, part I).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from workbench.operators import FullOperators, ReducedOperators
from workbench.physics.term import Values
from workbench.solve import Solution, System, one_thread, solve_dense, solve_reduced

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Random projections of the residual. Ten estimate a norm within a factor of two with a probability above 99 %.
PROJECTIONS = 12

#: Vectors taken from each factorisation (`System.krylov`): a back substitution costs a thirtieth of a factorisation.
DEPTH = 12

#: A new vector whose part outside the basis is smaller than this (relative) adds nothing but rounding.
DEPENDENT = 1e-9

#: Directions of the basis that the response at all frequencies uses less than this (relative) are dropped at the end.
UNUSED = 1e-9

#: A relative error of the charge, or a residual against the load, at which rounding and not the basis is what is seen.
ROUNDING = 1e-10

#: The estimate is this many times the largest ratio of true error to squared residual seen.
SAFETY = 4.0


class NotEnriched(RuntimeError):
    """The reduced model did not reach its tolerance. Carries the estimate reached."""

    def __init__(self, estimate: float, tolerance: float, solves: int) -> None:
        super().__init__(f"the reduced model is at an estimated relative error of {estimate:.1e} after {solves} full "
                         f"solves, above the tolerance of {tolerance:.0e}; solve the full model, or narrow the band")
        self.estimate, self.tolerance, self.solves = estimate, tolerance, solves

    def __reduce__(self) -> tuple[Any, ...]:
        return (NotEnriched, (self.estimate, self.tolerance, self.solves))


@dataclass(frozen=True, eq=False)
class ReducedModel:
    """A reduced model with what it takes to judge and to improve it.

    ``basis`` (size, r), last column with unit electrode voltage and the others with none; ``sketch`` (integrals,
    PROJECTIONS, r) random projections of A_q basis; ``effectivity`` charge error per squared projected residual;
    ``solves`` full solves spent, ``residual`` the largest scaled residual among them.
    """

    full: FullOperators
    operators: ReducedOperators
    basis: Real
    sketch: Real
    weights: Real
    effectivity: float
    tolerance: float
    solves: int
    residual: float

    def solve(self, frequencies: Real, values: Values) -> Solution:
        """Reduced states at every frequency; see :meth:`error` for how far to trust them."""
        return solve_reduced(self.operators, frequencies, values)

    def error(self, solution: Solution) -> Real:
        """Estimated relative error (n,) of the impedance of a reduced solution of this model, any parameter values."""
        return self.effectivity * _squared_residual(self.sketch, solution) / np.abs(solution.charge)

    def expand(self, solution: Solution) -> Complex:
        """The states (size, n) of the full model that a reduced solution stands for."""
        return self.basis @ solution.states


def reduce(
    operators: FullOperators,
    frequencies: Real,
    values: Values,
    *,
    tolerance: float = 1e-5,
    tangents: tuple[str, ...] = (),
    start: ReducedModel | None = None,
    first: int = 4,
    limit: int = 40,
    depth: int = DEPTH,
    confirmed: bool = True,
    progress: Callable[[float], None] | None = None,
) -> ReducedModel:
    """A reduced model whose impedance is within `tolerance` (relative) of the full one at all `frequencies`.

    Full solves are added where the estimate is largest, until the full solve at the worst frequency confirms the
    tolerance. With `start`, a model made for other parameter values is enriched for these. The basis holds the
    derivatives of the states by the parameters named in `tangents` too, so that it keeps serving when these change.
    Each factorisation gives `depth` vectors, tangents apart. Unless `confirmed`, the estimate is believed once a full
    solve for these parameter values has calibrated it, and the last one is saved.

    Raises:
        NotEnriched: `limit` full solves were not enough.
    """
    frequencies = np.asarray(frequencies, dtype=float)
    # The given frequencies next to Chebyshev's nodes.
    angles = np.pi * (np.arange(min(first, limit - 1)) + 0.5) / first
    nodes = np.unique(np.round(0.5 * (frequencies.size - 1) * (1.0 - np.cos(angles))).astype(int))
    if start is not None:
        nodes = nodes[:0]
    effectivity = 0.0 if start is None else start.effectivity
    largest = 0.0 if start is None else start.residual
    solves = 0 if start is None else start.solves

    def report() -> None:
        # How many solves it takes is not known beforehand; most models are done after six or seven.
        if progress is not None:
            progress(1.0 - 0.7**solves)

    with one_thread():
        growing = _Growing(operators, values, frequencies, start)
        for step in itertools.count():
            report()
            index = int(nodes[step]) if step < nodes.size else -1
            error = np.inf
            if growing.basis.shape[1]:
                charge, squared, floor = growing.respond()
                spread = squared / np.abs(charge)
                index = index if index >= 0 else int(np.argmax(spread))
                if not confirmed and step > nodes.size and effectivity * spread[index] <= tolerance:
                    break
            states, residual = growing.system.krylov(float(frequencies[index]), depth, tangents=tangents)
            if growing.basis.shape[1]:
                error = abs(charge[index] / growing.charge(states[:, 0], index) - 1.0)
                # The first nodes say what to expect of a basis that is still poor; later ones are the better judges.
                if error > ROUNDING and squared[index] > floor[index]:
                    learned = SAFETY * error / spread[index]
                    effectivity = learned if step < nodes.size else max(effectivity, learned)
            solves, largest = solves + 1, max(largest, residual)
            # What the last solve tells is always taken into the basis, also when it was only a confirmation.
            growing.add(states)
            if step >= nodes.size and error <= tolerance and effectivity * spread[index] <= SAFETY * tolerance:
                break
            if solves - (0 if start is None else start.solves) >= limit:
                raise NotEnriched(error, tolerance, solves)
        if effectivity == 0.0:
            effectivity = growing.effectivity_of_less(states[:, 0], index)
        # Directions for other parameter values are there to be used later.
        if tangents:
            basis = growing.basis
            matrices, sketch = _extended(operators, basis, growing.test, start)
        else:
            basis = growing.compressed()
            matrices, sketch = _extended(operators, basis, growing.test, None)
    reduced = ReducedOperators(operators.integrals, matrices)
    return ReducedModel(operators, reduced, basis, sketch, growing.weights, effectivity, tolerance, solves, largest)


def _extended(
    operators: FullOperators, basis: Real, test: Real, known: ReducedModel | None
) -> tuple[Real, Real]:
    """Matrices (integrals, r, r) and sketch (integrals, PROJECTIONS, r) on `basis`.

    Of the basis of `known`, with which `basis` begins but for the lift at the end, they are taken over.
    """
    rank = basis.shape[1]
    old = np.zeros(0, dtype=int) if known is None else np.append(np.arange(known.basis.shape[1] - 1), rank - 1)
    new = np.setdiff1d(np.arange(rank), old)
    images = operators.project(basis[:, new], np.column_stack([basis, test]))
    matrices = np.zeros((len(operators.integrals), rank, rank))
    sketch = np.zeros((len(operators.integrals), test.shape[1], rank))
    if known is not None:
        matrices[:, old[:, None], old], sketch[:, :, old] = known.operators.matrices, known.sketch
    matrices[:, :, new], sketch[:, :, new] = images[:, :rank], images[:, rank:]
    matrices[:, new] = images[:, :rank].transpose(0, 2, 1)
    return matrices, sketch


class _Growing:
    """A basis that grows, projected on for one set of parameter values only, which is far cheaper than for all.

    ``basis`` (size, r): columns orthonormal in the norm of ``weights``, then the lift, with unit electrode voltage.
    ``projected`` (groups, r, r) and ``sketch`` (groups, PROJECTIONS, r) belong to the matrices of equal frequency
    dependence (see `solve.System`); they are extended, never made again.
    """

    def __init__(self, operators: FullOperators, values: Values, frequencies: Real, start: ReducedModel | None) -> None:
        self.system, self.frequencies = System(operators, values), frequencies
        self.factors = self.system.factors(frequencies)
        self.matrices = self.system.group_matrices()
        size, groups = operators.size, len(self.matrices)
        middle = float(np.median(frequencies))
        self.weights = np.sqrt(np.abs(self.system.matrix(middle).diagonal())) if start is None else start.weights
        self.test = test_vectors(self.weights)
        self.basis = np.zeros((size, 0))
        self.projected = np.zeros((groups, 0, 0), dtype=complex)
        self.sketch = np.zeros((groups, PROJECTIONS, 0), dtype=complex)
        if start is not None:
            self.basis = start.basis
            constants = np.stack(self.system.constants)
            self.projected = np.tensordot(constants, start.operators.matrices, axes=1)
            self.sketch = np.tensordot(constants, start.sketch, axes=1)

    def add(self, states: Complex) -> None:
        """Take the real and imaginary parts of `states` (size, n), the first at unit voltage, into the basis."""
        if self.basis.shape[1] == 0:
            self._extend(states[:, 0].real[:, None])
        self._extend(new_directions(self.basis, states, self.weights))

    def _extend(self, new: Real) -> None:
        """Add columns before the last one (the lift), or the lift itself to an empty basis."""
        old = self.basis
        self.basis = np.column_stack([old[:, :-1], new, old[:, -1:]]) if old.shape[1] else new
        order = np.concatenate([np.arange(old.shape[1] - 1), old.shape[1] + np.arange(new.shape[1]),
                                [old.shape[1] - 1]]).astype(int) if old.shape[1] else np.arange(new.shape[1])
        projected, sketch = [], []
        for matrix, known, seen in zip(self.matrices, self.projected, self.sketch, strict=True):
            image = matrix @ new
            cross = old.T @ image
            block = np.block([[known, cross], [cross.T, new.T @ image]])
            projected.append(block[np.ix_(order, order)])
            sketch.append(np.column_stack([seen, self.test.T @ image])[:, order])
        self.projected, self.sketch = np.stack(projected), np.stack(sketch)

    def respond(self, *, columns: int = -1) -> tuple[Complex, Real, Real]:
        """Charge (n,) for 1 V, mean squared projected residual (n,) and what of it rounding may be, everywhere.

        With `columns`, of a poorer basis: the lift and so many of the first columns only.
        """
        rank = self.basis.shape[1]
        kept = np.append(np.arange(rank - 1 if columns < 0 else columns), rank - 1)
        projected, sketch = self.projected[:, kept[:, None], kept], self.sketch[:, :, kept]
        states, _ = solve_dense(self.factors, projected)
        whole = np.einsum("gn,gij,jn->in", self.factors, projected, states, optimize=True)
        residual = np.einsum("gn,gkj,jn->kn", self.factors, sketch, states, optimize=True)
        load = np.einsum("gn,gk->kn", self.factors, sketch[:, :, -1])
        floor = np.mean(np.abs(ROUNDING * load) ** 2, axis=0)
        return -np.sum(states * whole, axis=0), np.mean(np.abs(residual) ** 2, axis=0), floor

    def effectivity_of_less(self, state: Complex, index: int) -> float:
        """SAFETY times charge error per squared residual of the richest poorer basis that is not exact to rounding."""
        exact = self.charge(state, index)
        for columns in range(self.basis.shape[1] - 2, 0, -1):
            charge, squared, floor = self.respond(columns=columns)
            error = abs(charge[index] - exact)
            if error > ROUNDING * abs(exact) and squared[index] > floor[index]:
                return SAFETY * error / float(squared[index])
        raise RuntimeError("even a basis of one column is exact: nothing can be said of the error of this model")

    def charge(self, state: Complex, index: int) -> complex:
        """Charge of a full state at the frequency of that index."""
        image = sum(h * (matrix @ state) for h, matrix in zip(self.factors[:, index], self.matrices, strict=True))
        return -complex(state @ image)

    def compressed(self) -> Real:
        """The basis without the directions the response does not use anywhere in the band, lift last."""
        band = np.linspace(self.frequencies.min(), self.frequencies.max(), max(241, self.frequencies.size))
        states, _ = solve_dense(self.system.factors(band), self.projected)
        return np.asarray(self.basis @ needed(states, UNUSED))


def new_directions(basis: Real, states: Complex, weights: Real) -> Real:
    """What `states` (size, n), the first at unit voltage, add to a basis (size, r) with its lift last: (size, k).

    Their real and imaginary parts, orthonormal in the norm of `weights` (size,).
    """
    lift = basis[:, -1]
    parts = [states[:, 0].real - lift, states[:, 0].imag, states[:, 1:].real, states[:, 1:].imag]
    new = weights[:, None] * np.column_stack(parts)
    length = np.linalg.norm(new, axis=0)
    new = new[:, length > 0.0] / length[length > 0.0]
    scaled = weights[:, None] * basis[:, :-1]
    for _ in range(2):
        new = new - scaled @ (scaled.T @ new)
    new, triangle, _ = scipy.linalg.qr(new, mode="economic", pivoting=True)
    return np.asarray(new[:, np.abs(np.diag(triangle)) > DEPENDENT] / weights[:, None])


def spanned(states: Complex, tolerance: float) -> tuple[Real, Real]:
    """Directions (r - 1, k) that reduced `states` (r, n) lie in, their lift apart, and their sizes (k,).

    Those below `tolerance`, relative to the largest, are left out.
    """
    coordinates = np.column_stack([states[:-1].real, states[:-1].imag])
    directions, singular, _ = np.linalg.svd(coordinates, full_matrices=False)
    kept = singular > tolerance * singular[0]
    return directions[:, kept], singular[kept]


def needed(states: Complex, tolerance: float) -> Real:
    """The part of a basis that reduced `states` (r, n) need, in that basis: (r, k), its lift last."""
    directions, _ = spanned(states, tolerance)
    result = np.zeros((len(states), directions.shape[1] + 1))
    result[:-1, :-1], result[-1, -1] = directions, 1.0
    return result


def test_vectors(weights: Real) -> Real:
    """The random vectors (size, PROJECTIONS) that residuals are projected on: the same for equal `weights`."""
    test = np.random.default_rng(0).standard_normal((weights.size, PROJECTIONS)) / weights[:, None]
    test[-1] = 0.0  # the row of the electrode is not an equation
    return np.asarray(test)


def projected(model: ReducedModel, operators: FullOperators, basis: Real | None = None) -> ReducedModel:
    """`model` on other full operators of the same unknowns (a stretched mesh), or on another `basis`, or both."""
    basis = model.basis if basis is None else basis
    matrices, sketch = _extended(operators, basis, test_vectors(model.weights), None)
    return replace(model, full=operators, operators=ReducedOperators(operators.integrals, matrices), basis=basis,
                   sketch=sketch)


def narrowed(model: ReducedModel, states: Complex, tolerance: float) -> tuple[ReducedModel, Real]:
    """`model` on the part of its basis that reduced `states` (rank, n) need, to `tolerance` relative to the largest.

    Returns:
        the model, and its basis in the old one (old rank, rank).
    """
    within = needed(states, tolerance)
    matrices = within.T @ model.operators.matrices @ within
    model = replace(model, operators=replace(model.operators, matrices=matrices), basis=model.basis @ within,
                    sketch=model.sketch @ within)
    return model, within


def _squared_residual(sketch: Real, solution: Solution) -> Real:
    """Mean square (n,) of the random projections of the full residual of a reduced solution."""
    applied = np.tensordot(sketch, solution.states, axes=(2, 0))  # (integrals, projections, n)
    projected = np.einsum("nq,qkn->kn", solution.coefficients, applied, optimize=True)
    return np.mean(np.abs(projected) ** 2, axis=0)
