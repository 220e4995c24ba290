"""The reduced model: the affine operators projected on full solutions at a few frequencies.

The basis is real (real and imaginary parts of the states), so the projected A_q stay real and symmetric and the
reduced model is again affine in the same coefficients. Because the charge is a quadratic form of the state, its error
is second order in the residual,

    Q - Q_r = e^T A e = r^T A^{-1} r .

A^{-1} is not at hand, but that of the energy is: R, the sum of elastic, kinetic, dielectric and acoustic energy, each
counted positive. The basis holds what resonates in the band, and of all other motions |A^{-1}| is about R^{-1}, so that

    |Q - Q_r| < SAFETY r^H R^{-1} r ,

in units of charge, at any frequency and parameter values: there is no factor to be learned. Terms of either sign cancel
in Q - Q_r, not in the bound, which is often some ten times larger. The norm is that of a few random projections of the
residual, which cost next to nothing for any parameter values (Balabanov and Nouy 2019, Adv. Comput. Math. 45, 2969:
randomised linear algebra for model order reduction, part I; Smetana, Zahm and Patera 2019, SIAM J. Sci. Comput. 41,
A900: randomized residual-based error estimators for parametrized equations).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from workbench.fem.dense import chebyshev
from workbench.fem.forms import combined_matrices
from workbench.fem.operators import FullOperators
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.solve import NotConverged, Solution, System, one_thread, solve_reduced
from workbench.physics.term import Values
from workbench.reduced.basis import DEPENDENT, joined, needed, new_directions
from workbench.reduced.energy_norm import energy_matrix, estimated_error, random_probes
from workbench.results.brief import Brief

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Vectors taken from each factorisation (`System.krylov`): a back substitution costs a thirtieth of a factorisation.
DEPTH = 12

#: The same at other parameter values.
CORNER_DEPTH = 3

#: Frequencies that the first solves are made at, and how many of those asked for are looked at while a basis grows; all
#: of no more than the last number.
FIRST, WATCHED, FEW = 7, 97, 256

#: Where the full model is solved in place of a frequency at which that does not converge, relative to it: within a line
#: of a quality factor of 5000. Doubled, the basis holds a little less of such a resonance.
BESIDE = 1.0 + 1e-4

#: What is left out of a basis has at most this times the root of the error that Z may have, in the root of energy
#: over charge: the error of the charge is at most the energy of what is left out of the state.
UNNEEDED, TIGHTER = 1.0, 0.3

#: No parameter is about to move.
NO_TANGENTS: Mapping[str, float] = MappingProxyType({})


class NotEnriched(RuntimeError):
    """The reduced model did not reach its tolerance. Carries the estimate reached."""

    def __init__(self, estimate: float, tolerance: float, solves: int) -> None:
        super().__init__(f"the reduced model is at an estimated relative error of {estimate:.1e} after {solves} full "
                         f"solves, above the tolerance of {tolerance:.0e}; solve the full model, or narrow the band")
        self.estimate, self.tolerance, self.solves = estimate, tolerance, solves

    def __reduce__(self) -> tuple[Any, ...]:
        return (NotEnriched, (self.estimate, self.tolerance, self.solves))


@dataclass(frozen=True, eq=False, repr=False)
class ReducedModel(Brief):
    """A reduced model with what it takes to judge and to improve it.

    ``basis`` (size, r), last column with unit electrode voltage and the others with none; ``weights`` (size,) the unit
    of every unknown in its norm; ``test`` (size, PROJECTIONS) the vectors that residuals are projected on and
    ``sketch`` (forms, PROJECTIONS, r) the projections of A basis; ``energy`` (size - 1, size - 1) the matrix R;
    ``solves`` full solves spent, ``residual`` the largest scaled residual among them.
    """

    full: FullOperators
    operators: ReducedOperators
    basis: Real
    weights: Real
    test: Real
    sketch: Real
    energy: sparse.csr_matrix
    solves: int
    residual: float

    def solve(self, frequencies: Real, values: Values) -> Solution:
        """Reduced states at every frequency; see :meth:`error` for how far to trust them."""
        return solve_reduced(self.operators, frequencies, values)

    def error(self, solution: Solution) -> Real:
        """Estimated relative error (n,) of the impedance of a reduced solution of this model, any parameter values.

        Rounding, some 1e-12, is not in it.
        """
        return sketched_error(self.operators, self.sketch, solution)

    def worst(self, frequencies: Real, values: Values) -> tuple[Solution, float, int]:
        """The reduced solution, its largest estimated error, and the index of the frequency of that."""
        solution = self.solve(frequencies, values)
        estimate = self.error(solution)
        index = int(np.argmax(estimate))
        return solution, float(estimate[index]), index

    def extended(self, states: Complex, changes: Complex | None = None, unneeded: float = DEPENDENT) -> ReducedModel:
        """The model that also spans `states` (size, n) of the full one, or vectors of the like, electrode included.

        Of `changes` (size, m), what a move of parameters changes states by over the root of their charge, those
        directions are taken too that are larger than `unneeded` (:func:`smallest_part`). The basis goes on as it is:
        what this model says at any parameters the new one says at least as well.
        """
        basis = joined(self.basis, new_directions(self.basis, states, self.weights))
        if changes is not None and changes.size:
            parts = np.column_stack([changes.real, changes.imag])
            inside = self.weights[:, None] ** 2 * basis[:, :-1]
            parts = parts - basis[:, :-1] @ (inside.T @ parts)
            sizes, vectors = np.linalg.eigh(parts[:-1].T @ (self.energy @ parts[:-1]))
            kept = sizes > unneeded**2
            basis = joined(basis, new_directions(basis, (parts @ vectors[:, kept]).astype(complex), self.weights))
        matrices, sketch = projected_on(self.full, basis, self.test, self)
        return replace(self, operators=replace(self.operators, matrices=matrices), basis=basis, sketch=sketch)

    def grown(
        self, states: Complex, changes: Complex | None, needed_at: Sequence[tuple[Real, Values]], unneeded: float,
        tolerance: float = np.inf,
    ) -> ReducedModel:
        """:meth:`extended` by no more than is needed.

        Of the new directions those are kept that `changes`, or the states at some frequencies (Hz) and parameter
        values over the root of their charge, have more of than `unneeded` (:func:`smallest_part`). Where all of them
        together bring the estimated errors there within a `tolerance`, so many are kept that it stays so: a resonance
        magnifies what is left out.
        """
        wide = self.extended(states, changes, unneeded)
        old = self.basis.shape[1] - 1
        wanted, enough = [], np.isfinite(tolerance)
        for frequencies, values in needed_at:
            found = wide.solve(frequencies, values)
            wanted.append(found.states[:-1] / np.sqrt(np.abs(found.charge)))
            enough = enough and bool(wide.error(found).max() <= tolerance)
        if changes is not None and changes.size:
            wanted.append((wide.weights[:, None] ** 2 * wide.basis[:, :-1]).T @ changes)
        whole = np.concatenate(wanted, axis=1)[old:]
        new = wide.basis[:-1, old:-1]
        root = np.linalg.cholesky(new.T @ (wide.energy @ new)).T
        every, sizes, _ = np.linalg.svd(root @ np.column_stack([whole.real, whole.imag]), full_matrices=False)
        while True:
            kept = sizes > unneeded
            directions, _ = np.linalg.qr(np.linalg.solve(root, every[:, kept]))
            result = wide.trimmed(old, directions)
            if not enough or kept.all() or all(result.worst(*each)[1] <= tolerance for each in needed_at):
                return result
            unneeded *= TIGHTER

    def trimmed(self, old: int, directions: Real) -> ReducedModel:
        """The model on its first `old` vectors, on combinations (r - 1 - old, k) of the others, and on its lift."""
        whole, last = self.operators.matrices, self.basis.shape[1] - 1
        size = old + directions.shape[1] + 1
        stay, there = np.r_[:old, last], np.r_[:old, size - 1]
        matrices = np.empty((len(whole), size, size))
        matrices[:, there[:, None], there] = whole[:, stay[:, None], stay]
        cross = whole[:, stay, old:last] @ directions
        matrices[:, there, old:-1], matrices[:, old:-1, there] = cross, cross.transpose(0, 2, 1)
        matrices[:, old:-1, old:-1] = directions.T @ (whole[:, old:last, old:last] @ directions)

        def on(columns: Real) -> Real:
            return np.concatenate([columns[..., :old], columns[..., old:last] @ directions, columns[..., last:]], -1)

        return replace(self, operators=replace(self.operators, matrices=matrices), basis=on(self.basis),
                       sketch=on(self.sketch))

    def on(self, basis: Real) -> ReducedModel:
        """The model on another basis (size, r) of the full one, its lift last."""
        matrices, sketch = projected_on(self.full, basis, self.test, None)
        return replace(self, operators=replace(self.operators, matrices=matrices), basis=basis, sketch=sketch)

    def within(self, part: Real) -> ReducedModel:
        """The model on a part (r, k) of its basis, given in that."""
        matrices = part.T @ self.operators.matrices @ part
        return replace(self, operators=replace(self.operators, matrices=matrices), basis=self.basis @ part,
                       sketch=self.sketch @ part)

    def of(self, integrals: NDArray[np.int64]) -> ReducedModel:
        """The same with some of the integrals (k,) only."""
        full = self.full.of(integrals)
        operators = ReducedOperators(full.integrals, full.coefficients, self.operators.matrices,
                                     self.operators.forms[integrals])
        return replace(self, full=full, operators=operators)

    def expand(self, solution: Solution) -> Complex:
        """The states (size, n) of the full model that a reduced solution stands for."""
        return self.basis @ solution.states


def sketched_error(operators: ReducedOperators, sketch: Real, solution: Solution) -> Real:
    """Estimated relative error (n,) of the impedance of a `solution` of `operators`, see :class:`ReducedModel`."""
    constants = np.array([constants for _, constants in solution.groups])
    sketches = combined_matrices(operators.by_form(constants), sketch)
    residual = sum(h * (each @ solution.states) for (h, _), each in zip(solution.groups, sketches, strict=True))
    return estimated_error(np.asarray(residual), solution.charge)


def reduce(
    operators: FullOperators,
    frequencies: Real,
    values: Values,
    *,
    tolerance: float = 1e-5,
    tangents: Mapping[str, float] = NO_TANGENTS,
    start: ReducedModel | None = None,
    first: int = FIRST,
    limit: int = 40,
    depth: int = DEPTH,
    confirmed: bool = True,
    progress: Callable[[float], None] | None = None,
) -> ReducedModel:
    """The model of :func:`reduced`, whose arguments these are."""
    return reduced(operators, frequencies, values, tolerance=tolerance, tangents=tangents, start=start, first=first,
                   limit=limit, depth=depth, confirmed=confirmed, progress=progress)[0]


def reduced(
    operators: FullOperators,
    frequencies: Real,
    values: Values,
    *,
    tolerance: float,
    tangents: Mapping[str, float] = NO_TANGENTS,
    start: ReducedModel | None = None,
    first: int = FIRST,
    limit: int = 40,
    depth: int = DEPTH,
    confirmed: bool = True,
    worst: float | None = None,
    skip_singular: bool = False,
    progress: Callable[[float], None] | None = None,
) -> tuple[ReducedModel, Solution]:
    """A reduced model whose impedance is within `tolerance` (relative) of the full one at all `frequencies`.

    Full solves are added where the estimate is largest, until it is within the tolerance everywhere. A full solve at
    the worst frequency then confirms it, unless `confirmed` is unset: the estimate is believed. With `start`, a model
    made for other parameter values is extended for these. The basis also holds what the parameters in `tangents` change
    the states by when they move by so much. Each factorisation gives `depth` vectors, tangents apart. `worst` is the
    frequency (Hz) at which `start` is off most, if that is known. With `skip_singular` a frequency is left out at which
    a full solve does not converge but does beside it, or at which reduced and full model keep apart.

    Returns:
        the model, and what it gives at all frequencies but those left out.

    Raises:
        NotEnriched: `limit` full solves were not enough.
        NotConverged: a full solve that failed, or an unknown without any energy.
    """
    frequencies = np.asarray(frequencies, dtype=float)
    looked_at, wanted = watched(frequencies), np.zeros(0) if worst is None else np.array([worst])
    if start is None:
        wanted = frequencies[chebyshev(frequencies.size, first)[: max(limit - 1, 1)]]
    model, spent, unneeded, tried = start, 0, smallest_part(tolerance), set[float]()

    def report() -> None:
        if progress is not None:
            progress(1.0 - 0.7**spent)  # most models are done after six or seven solves

    with one_thread():
        system = System(operators, values)
        while True:
            if wanted.size:
                solved = _Solves(model, frequencies)
                for frequency in map(float, wanted):
                    if solved.add(system, frequency, depth, tangents) != frequency and skip_singular:
                        frequencies = frequencies[frequencies != frequency]
                    tried.add(frequency)
                    spent += 1
                    report()
                looked_at = watched(frequencies)
                model = solved.grown([(looked_at, values)], unneeded, tolerance)
                # Where the new directions were not enough, too much may have been left out before them.
                unneeded *= TIGHTER
            assert model is not None
            solution, estimate, index = model.worst(looked_at, values)
            if estimate <= tolerance and looked_at.size < frequencies.size:
                # All of them, once the fewer are within.
                solution, estimate, index = model.worst(frequencies, values)
            worst = float(solution.frequency[index])
            believed = estimate <= tolerance
            if believed and not confirmed:
                break
            if spent >= limit:
                raise NotEnriched(estimate, tolerance, model.solves)
            if believed:
                spent += 1
                report()
                model, off = _confirmed(model, system, solution, index, skip_singular)
                if off <= tolerance:
                    break
                if skip_singular and (worst in tried or np.isinf(off)):
                    frequencies, wanted = frequencies[frequencies != worst], np.zeros(0)
                    looked_at = watched(frequencies)
                    continue
            wanted = np.array([worst])
    return model, solution


def _confirmed(
    model: ReducedModel, system: System, solution: Solution, index: int, skip_singular: bool
) -> tuple[ReducedModel, float]:
    """The model with one more full solve counted, and how far (relative) it is off that solve's charge.

    Infinite where the full solve does not converge and that is to be skipped.
    """
    frequency = float(solution.frequency[index])
    try:
        states, residual = system.krylov(frequency, 1)
    except NotConverged:
        if not skip_singular:
            raise
        return model, np.inf
    return counted(model, residual), float(abs(solution.charge[index] / system.charge(frequency, states[:, 0]) - 1.0))


def smallest_part(tolerance: float) -> float:
    """The smallest part of a state over the root of its charge, in the root of its energy, that an error of Z needs."""
    return UNNEEDED * float(np.sqrt(tolerance))


def begun(system: System, frequencies: Real, state: Complex) -> ReducedModel:
    """The smallest model: of the real part of one full `state` (size,) alone, measured as suits these frequencies (Hz).

    Raises:
        NotConverged: an unknown has no energy.
    """
    middle = float(np.median(frequencies))
    weights, energy = np.sqrt(np.abs(system.matrix(middle).diagonal())), energy_matrix(system, middle)
    test, basis = random_probes(energy, middle), state.real[:, None].copy()
    matrices, sketch = projected_on(system.operators, basis, test)
    full = system.operators
    inner = ReducedOperators(full.integrals, full.coefficients, matrices, full.forms)
    return ReducedModel(full, inner, basis, weights, test, sketch, energy, 0, 0.0)


def projected_on(
    operators: FullOperators, basis: Real, test: Real, known: ReducedModel | None = None
) -> tuple[Real, Real]:
    """Matrices (forms, r, r) of the operators on `basis` (size, r), and sketch (forms, PROJECTIONS, r) on `test`.

    Of the basis of `known`, with which `basis` begins but for the lift at the end, they are taken over.
    """
    rank = basis.shape[1]
    old = np.zeros(0, dtype=int) if known is None else np.append(np.arange(known.basis.shape[1] - 1), rank - 1)
    new = np.setdiff1d(np.arange(rank), old)
    images = operators.project(basis[:, new], np.column_stack([basis[:, old], test]))
    own, cross, seen = np.split(images, [new.size, rank], axis=1)
    matrices = np.zeros((len(images), rank, rank))
    sketch = np.zeros((len(images), test.shape[1], rank))
    if known is not None:
        matrices[:, old[:, None], old], sketch[:, :, old] = known.operators.matrices, known.sketch
    matrices[:, new[:, None], new], sketch[:, :, new] = own, seen
    matrices[:, old[:, None], new], matrices[:, new[:, None], old] = cross, cross.transpose(0, 2, 1)
    return matrices, sketch


def narrowed(model: ReducedModel, states: Complex, tolerance: float) -> ReducedModel:
    """`model` on the part of its basis that reduced `states` (rank, n) need, to `tolerance` relative to the largest."""
    return model.within(needed(states, tolerance))


@dataclass(eq=False)
class _Solves:
    """Full solves that a model is about to grow by.

    ``model`` is the one there is, which counts them; ``states`` each (size, depth), and ``changes`` (size, tangents)
    what moves of parameters change the states by, over the root of their charge.
    """

    model: ReducedModel | None
    frequencies: Real
    states: list[Complex] = field(default_factory=list)
    changes: list[Complex] = field(default_factory=list)

    def add(self, system: System, frequency: float, depth: int, moves: Mapping[str, float] = NO_TANGENTS) -> float:
        """One more, with its neighbours in frequency, for parameters that move by so much; the frequency that it is of.

        Where the solve does not converge, it is made beside: at an undamped resonance any state nearby is that of the
        resonance.
        """
        try:
            found, residual = system.krylov(frequency, depth, tangents=tuple(moves))
        except NotConverged:
            frequency *= BESIDE
            found, residual = system.krylov(frequency, depth, tangents=tuple(moves))
        if self.model is None:
            self.model = begun(system, self.frequencies, found[:, 0])
        self.model = counted(self.model, residual)
        self.states.append(found[:, :depth])
        size = np.sqrt(abs(system.charge(frequency, found[:, 0])))
        self.changes.append(found[:, depth:] * np.array(list(moves.values())) / size)
        return frequency

    def grown(
        self, needed_at: Sequence[tuple[Real, Values]], unneeded: float, tolerance: float
    ) -> ReducedModel:
        """See :meth:`ReducedModel.grown`."""
        assert self.model is not None
        return self.model.grown(np.concatenate(self.states, axis=1), np.concatenate(self.changes, axis=1), needed_at,
                                unneeded, tolerance)


def counted(model: ReducedModel, residual: float) -> ReducedModel:
    """`model` with one more full solve, which left that residual."""
    return replace(model, solves=model.solves + 1, residual=max(model.residual, residual))


def covering(
    operators: FullOperators,
    frequencies: Real,
    values: Values,
    moves: Mapping[str, float],
    *,
    tolerance: float,
    start: ReducedModel | None = None,
    corners: Sequence[Values] = (),
    nodes: int = 5,
    depth: int = DEPTH,
) -> ReducedModel:
    """A reduced model, or one that begins as `start` does, for parameters that move by about so much each.

    From `nodes` full solves at Chebyshev's frequencies, the states and their neighbours in frequency, and what the
    `moves` change them by; likewise the states at other values, `corners`, where a parameter moves so far that its
    derivative does not tell where to. What an error of Z of `tolerance` (relative) does not need is left out. Whether
    that is enough, :meth:`ReducedModel.error` says.
    """
    frequencies = np.asarray(frequencies, dtype=float)
    at, looked_at = frequencies[chebyshev(frequencies.size, nodes)], watched(frequencies)
    solved = _Solves(start, frequencies)
    with one_thread():
        system = System(operators, values)
        for frequency in at:
            solved.add(system, float(frequency), depth, moves)
        for values_there in corners:
            there = System(operators, values_there)
            for frequency in at:
                solved.add(there, float(frequency), CORNER_DEPTH)
        return solved.grown([(looked_at, each) for each in (values, *corners)], smallest_part(tolerance), tolerance)


def watched(frequencies: Real) -> Real:
    """Frequencies (Hz) that a basis is looked at while it grows: all of a few, or so many spread evenly."""
    if frequencies.size <= FEW:
        return frequencies
    return frequencies[np.unique(np.linspace(0, frequencies.size - 1, WATCHED).astype(int))]
