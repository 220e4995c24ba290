"""The spectrum of a problem, and its exact derivatives, at one set of parameters after the other.

A fit asks for the same spectrum hundreds of times while its parameters wander. The reduced model answers; where its
own estimate says that it is not good enough for the present parameters, full solves are added there, so the basis
grows along the path of the fit and serves every later one.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from geometry.chip import SAME_LENGTH, Chip
from geometry.mesh import MeshError, SectionMesh
from geometry.stretch import stretch
from inputs import InputError
from workbench.operators import FullOperators, assemble, coefficients, combined, frequency_groups
from workbench.physics.term import Integral
from workbench.problem import Problem
from workbench.reduce import ReducedModel, narrowed, projected, reduce, reduce_around
from workbench.solve import Solution, dependence, reduced_tangents, solve_full

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Integers = NDArray[np.int64]

#: Reach, relative, of the quadratic expansion of the reduced matrices in a dimension: what it leaves out is the cube.
REACH = 5e-3

#: So many times as far it serves where bases are not enriched on the way: what it leaves out there is small beside
#: what the basis does.
FAR = 4.0

#: Step, in reaches, of a derivative by a dimension where that is all there is: its own error is as small.
SHORT = 0.02

#: Vectors from each factorisation: for the first model, and when it is enriched, where less is new.
FIRST_DEPTH, DEPTH = 12, 6

#: Directions of the basis that no state within reach of the fit needs more than this are dropped; relative, and per
#: tolerance of the impedance, whose error is of second order in that of the states.
UNNEEDED = 1e-2

#: The same, but relative only, at the end of a fit, where the states wanted are all close to each other.
NEGLIGIBLE = 1e-8

#: How far, relative, a parameter is expected to move before the basis is made again.
MOVED = 0.1

#: Lengths whose operators are kept.
ASSEMBLED = 4

#: A basis of more columns is narrowed: the dense algebra grows with their cube.
WIDE = 200


@dataclass(frozen=True, eq=False)
class Prediction:
    """A predicted spectrum and what it would do if parameters moved.

    ``impedance`` (n,) ohm, e^{+j w t}; ``model`` the reduced one it is of, perhaps of some integrals only (see
    `Predictor`); ``values`` complex parameters, e^{-i w t}; ``dimensions`` lengths in metres; ``part``
    of an expansion it was made with; ``slopes`` holds what :meth:`logarithmic_slope` found.
    """

    solution: Solution
    model: ReducedModel
    values: Mapping[str, complex]
    dimensions: Mapping[str, float]
    part: _Part
    slopes: dict[str, Complex] = field(default_factory=dict)

    @property
    def impedance(self) -> Complex:
        return np.conj(self.solution.impedance)

    @cached_property
    def error(self) -> Real:
        """Estimated relative error (n,) of the impedance."""
        return self.model.error(self.solution)

    def logarithmic_gradient(self, names: tuple[str, ...]) -> Complex:
        """d ln Z / d theta (n, len(names)) by complex parameters, e^{-i w t} on both sides.

        For ln Z of a spectrum take the conjugate: by the real part of theta conj(d), by its imaginary part conj(i d).
        Zero by what nothing here depends on.
        """
        depending = dependence(self.solution.operators.integrals)
        known = [column for column, name in enumerate(names) if name in depending]
        result = np.zeros((self.solution.omega.size, len(names)), dtype=complex)
        gradient = self.solution.parameter_gradient(self.values, tuple(names[column] for column in known))
        result[:, known] = gradient / self.solution.impedance[:, None]
        return result

    def logarithmic_slope(self, dimension: str) -> Complex:
        """d ln Z / d dimension (n,), 1/m, e^{-i w t}."""
        if dimension not in self.slopes:
            states, operators = self.solution.states, self.solution.operators
            groups = frequency_groups(operators.integrals, self.solution.omega, self.values)
            lengths = np.array(list(self.dimensions.values()))
            integrals, matrices = self.part.slope(list(self.dimensions).index(dimension), lengths)
            change = sum(factors * np.einsum("in,in->n", states, combined(constants[integrals], matrices) @ states)
                         for factors, constants in groups)
            # ln Z = -ln Q + const, dQ = -x^T (dA) x
            self.slopes[dimension] = np.asarray(change / self.solution.charge)
        return self.slopes[dimension]


class _Expansion:
    """A reduced model and how its matrices and sketch change with dimensions about `centre`.

    To first or to `second` order; the derivatives of an integral's are taken when they are first needed.
    """

    def __init__(self, model: ReducedModel, centre: Real, mesh: Callable[[Real], SectionMesh], *, second: bool) -> None:
        self.model, self.centre, self.second = model, centre, second
        self._mesh = mesh
        #: Of an integral, what it changes with and how.
        self._changes: dict[int, _Change] = {}
        self._latest: tuple[Integers, Integers, _Part] | None = None

    @cached_property
    def parabola(self) -> _Expansion:
        """The same to second order."""
        return _Expansion(self.model, self.centre, self._mesh, second=True)

    def part(self, integrals: Integers, moving: Integers) -> _Part:
        """The integrals of these indices (k,), of which those of indices `moving` change with dimensions.

        The matrices of the others stay those of the centre.
        """
        if not self.centre.size:
            moving = moving[:0]
        known = self._latest
        if known is None or not (np.array_equal(known[0], integrals) and np.array_equal(known[1], moving)):
            missing = np.array([q for q in moving if q not in self._changes], dtype=int)
            if missing.size:
                self._changes.update(self._derivatives(missing))
            whole = integrals.size == len(self.model.operators.integrals)
            model = self.model if whole else self.model.of(integrals)
            changes = tuple((int(np.searchsorted(integrals, q)), self._changes[q]) for q in moving)
            part = _Part(model, self.centre, self.terms, changes)
            known = self._latest = integrals, moving, part
        return known[2]

    def _derivatives(self, integrals: Integers) -> dict[int, _Change]:
        """How some integrals (k,) change."""
        def change(among: Sequence[int], *steps: tuple[int, float]) -> dict[int, Real]:
            lengths = self.centre.copy()
            for index, step in steps:
                lengths[index] += step
            model = self.model.of(np.array(among, dtype=int))
            changed, by = model.full.project_change(self._mesh(lengths), model.basis, model.test)
            return {among[q]: each for q, each in zip(changed, by, strict=True)}

        every = [int(q) for q in integrals]
        place = {term: index for index, term in enumerate(self.terms)}
        found: dict[int, dict[int, Real]] = {q: {} for q in every}  # of an integral, the derivatives by some terms
        if not self.second:
            for i, step in enumerate(SHORT * self.reach):
                for q, by in change(every, (i, step)).items():
                    found[q][place[i,]] = by / step
        else:
            steps = self.reach
            plus = [change(every, (i, step)) for i, step in enumerate(steps)]
            for i, step in enumerate(steps):
                minus = change(every, (i, -step))
                for q in {**plus[i], **minus}:
                    ahead, behind = plus[i].get(q, 0.0), minus.get(q, 0.0)
                    found[q][place[i,]] = (ahead - behind) / (2.0 * step)
                    found[q][place[i, i]] = (ahead + behind) / step**2
            for i, j in itertools.combinations(range(steps.size), 2):
                if shared := [q for q in plus[i] if q in plus[j]]:
                    for q, both in change(shared, (i, steps[i]), (j, steps[j])).items():
                        found[q][place[i, j]] = (both - plus[i][q] - plus[j][q]) / (steps[i] * steps[j])
        rank = self.model.operators.size
        nothing = np.zeros((0, rank + self.model.sketch.shape[1], rank))
        return {q: _Change(np.array(list(by), dtype=int), np.stack(list(by.values())) if by else nothing)
                for q, by in found.items()}

    @cached_property
    def reach(self) -> Real:
        """How far (d,) the quadratic expansion serves in each dimension: :data:`REACH`, or less where breaks are close.

        At :data:`FAR` times as much, half of what lies between two breaks is left; what they bound changes as one over
        that. So no expansion serves where breaks have changed places, though two radii move.
        """
        def open_to(i: int, step: float) -> bool:
            lengths = self.centre.copy()
            lengths[i] += step
            try:
                self._mesh(lengths)
            except (InputError, MeshError):
                return False
            return True

        reach = REACH * self.centre
        for i in range(reach.size):
            while not all(open_to(i, side * 2.0 * FAR * reach[i]) for side in (-1.0, 1.0)):
                reach[i] *= 0.8
        return reach

    @property
    def terms(self) -> list[tuple[int, ...]]:
        """The dimensions that each derivative is by."""
        count = self.centre.size
        first: list[tuple[int, ...]] = [(i,) for i in range(count)]
        return first + [(i, j) for i in range(count) for j in range(i, count)] * self.second

    def narrowed(self, states: Complex, tolerance: float) -> _Expansion:
        """The same on the part of the basis that reduced `states` (rank, n) need."""
        model, within = narrowed(self.model, states, tolerance)
        rank = len(within)
        result = _Expansion(model, self.centre, self._mesh, second=self.second)
        result._changes = {q: _Change(known.terms, np.concatenate(
            [within.T @ known.rows[:, :rank] @ within, known.rows[:, rank:] @ within], axis=1))
            for q, known in self._changes.items()}
        return result


@dataclass(frozen=True, eq=False)
class _Change:
    """What an integral changes with: indices ``terms`` (k,) of an expansion, ``rows`` (k, r + PROJECTIONS, r) by these.

    Most change with few of the dimensions. The rows are derivatives of its matrix and, below, of its sketch.
    """

    terms: Integers
    rows: Real


@dataclass(frozen=True, eq=False)
class _Part:
    """Some integrals of an expansion, and what those ``changes`` that move with dimensions: their indices here.

    ``centre`` and ``terms`` of the expansion, which holds its latest part: one that held it would keep both for long.
    """

    model: ReducedModel
    centre: Real
    terms: list[tuple[int, ...]]
    changes: tuple[tuple[int, _Change], ...]

    def at(self, lengths: Real) -> ReducedModel:
        """The model at other lengths (metres)."""
        step = lengths - self.centre
        if not step.any() or not self.changes:
            return self.model
        factors = np.array([np.prod(step[list(term)]) * (0.5 if len(term) == 2 and term[0] == term[1] else 1.0)
                            for term in self.terms])
        matrices, sketch = self.model.operators.matrices.copy(), self.model.sketch.copy()
        for q, by in self._summed(factors):
            matrices[q] += by[:len(by.T)]
            sketch[q] += by[len(by.T):]
        return replace(self.model, operators=replace(self.model.operators, matrices=matrices), sketch=sketch)

    def slope(self, index: int, lengths: Real) -> tuple[Integers, Real]:
        """The integrals whose matrices one dimension changes (k,), and d matrices / d length (k, r, r), 1/m."""
        step = lengths - self.centre
        factors = np.zeros(len(self.terms))
        for position, term in enumerate(self.terms):
            if term == (index,):
                factors[position] = 1.0
            elif index in term:
                factors[position] = step[term[0] if index == term[1] else term[1]]
        found = [(q, by[:len(by.T)]) for q, by in self._summed(factors)]
        rank = self.model.operators.size
        matrices = np.stack([by for _, by in found]) if found else np.zeros((0, rank, rank))
        return np.array([q for q, _ in found], dtype=int), matrices

    def _summed(self, factors: Real) -> Iterator[tuple[int, Real]]:
        """The indices of the integrals that `factors` of all terms move, and the rows of each so weighted."""
        for q, change in self.changes:
            weights = factors[change.terms]
            if weights.any():  # most change with few dimensions
                yield q, np.tensordot(weights, change.rows, axes=1)


class Predictor:
    """Spectra of one problem at fixed frequencies (n,) Hz, for any values of its parameters and free `dimensions`.

    ``tangents`` are the parameters about to be moved: the basis prepares for them. ``tolerance`` bounds the relative
    error of the impedance; infinite, a basis made by :meth:`surround` is never added to. ``solves`` counts the full
    solves spent. A dimension
    moves together with all radii of the same length, whose edges coincide (see `geometry.stretch`).
    """

    def __init__(
        self,
        problem: Problem,
        frequencies: Real,
        *,
        chip: Chip | None = None,
        dimensions: tuple[str, ...] = (),
        tangents: tuple[str, ...] = (),
        tolerance: float = 1e-4,
    ) -> None:
        if dimensions and chip is None:
            raise ValueError("dimensions can only be free where the chip of the problem is given")
        self.problem, self.chip, self.frequencies = problem, chip, np.asarray(frequencies, dtype=float)
        self.names, self.tangents, self.tolerance = dimensions, tangents, tolerance
        self.solves = 0
        self._expansion: _Expansion | None = None
        self._latest: Prediction | None = None
        self._assembled: dict[tuple[float, ...], FullOperators] = {}
        # Expansions hold it: a method of this would keep their matrices for as long as the collector likes.
        self._mesh = partial(_stretched, problem.mesh, chip, dimensions)

    def __call__(
        self, values: Mapping[str, complex], dimensions: Mapping[str, float] | None = None,
        wanted: Sequence[str] | None = None,
    ) -> Prediction:
        """The spectrum at these parameters (those not given keep the problem's own values), enriched if need be.

        Where only the derivatives by the coefficients `wanted` will be asked for, what neither the spectrum nor these
        depend on is left out.

        Raises:
            NotEnriched: the reduced model did not reach the tolerance.
            InputError, MeshError: dimensions that make no chip.
        """
        values = {**self.problem.values, **values}
        lengths = self._lengths(dimensions or {})
        expansion = self._expansion
        expansion = self._enriched(None, values, lengths) if expansion is None else self._reaching(expansion, lengths)
        prediction = self._predict(expansion, values, lengths, wanted)
        if self.enriching and prediction.error.max() > self.tolerance and not np.array_equal(lengths, expansion.centre):
            # States of lengths nearby are close; another centre takes many more matrices.
            expansion = self._enriched(expansion, values, expansion.centre)
            prediction = self._predict(expansion, values, lengths, wanted)
        if self.enriching and prediction.error.max() > self.tolerance:
            expansion = self._enriched(expansion, values, lengths)
            prediction = self._predict(expansion, values, lengths, wanted)
        self._expansion, self._latest = expansion, prediction
        return prediction

    @property
    def enriching(self) -> bool:
        """Whether the basis is added to where it does not reach the tolerance."""
        return math.isfinite(self.tolerance)

    def at(self, frequencies: Real) -> Predictor:
        """The same at other frequencies (n,) Hz, beginning with the basis there is now."""
        other = copy.copy(self)
        other.frequencies, other._latest = np.asarray(frequencies, dtype=float), None
        return other

    def elsewhere(
        self, frequencies: Real, tolerance: float, values: Mapping[str, complex], dimensions: Mapping[str, float]
    ) -> Prediction:
        """A prediction at other frequencies (n,) Hz and to another tolerance; what it takes is kept."""
        other = self.at(frequencies)
        other.tolerance = tolerance
        prediction = other(values, dimensions)
        self._expansion, self.solves = other._expansion, other.solves
        return prediction

    def surround(
        self, values: Mapping[str, complex], dimensions: Mapping[str, float], moves: Mapping[str, float],
        unneeded: float, corners: Sequence[Mapping[str, complex]] = (),
    ) -> None:
        """Make the basis anew for the neighbourhood of these parameters in which each of `moves` changes by so much.

        What that needs less than `unneeded` of, relative to the states, is left out; `corners` are further values that
        the basis must hold the states of (`reduce.reduce_around`).
        """
        lengths = self._lengths(dimensions)
        around = {**self.problem.values, **values}
        model = reduce_around(self._operators(lengths), self.frequencies, around, moves, unneeded=unneeded, depth=DEPTH,
                              corners=[{**around, **corner} for corner in corners],
                              like=None if self._expansion is None else self._expansion.model)
        self.solves += model.solves
        self._expansion, self._latest = _Expansion(model, lengths, self._mesh, second=False), None

    def settle(self, settings: Sequence[tuple[Mapping[str, complex], Mapping[str, float]]]) -> None:
        """Narrow the basis to what the spectra at these (values, dimensions) need: a neighbourhood to be searched.

        Elsewhere the estimated error rises, and the basis is enriched again.
        """
        if self._expansion is None:
            return
        every = np.arange(len(self._expansion.model.operators.integrals))
        states = []
        for values, dimensions in settings:
            model = self._expansion.part(every, every).at(self._lengths(dimensions))
            states.append(model.solve(self.frequencies, {**self.problem.values, **values}).states)
        first, others = states[0], [other - states[0] for other in states[1:]]
        self._expansion = self._expansion.narrowed(np.concatenate([first, *others], axis=1), NEGLIGIBLE)

    def expanded(self, prediction: Prediction) -> tuple[FullOperators, Complex]:
        """The full operators, and the states (size, n) that a prediction on the present basis stands for."""
        assert self._expansion is not None
        return self._expansion.model.full, self._expansion.model.expand(prediction.solution)

    def full(self, values: Mapping[str, complex], dimensions: Mapping[str, float] | None, at: Real) -> Complex:
        """The impedance (e^{+j w t}) by full solves at the frequencies `at`, to check the reduced model with."""
        operators = self._operators(self._lengths(dimensions or {}))
        self.solves += len(at)
        return np.conj(solve_full(operators, at, {**self.problem.values, **values}).impedance)

    def _predict(
        self, expansion: _Expansion, values: Mapping[str, complex], lengths: Real, wanted: Sequence[str] | None
    ) -> Prediction:
        omega = 2.0 * np.pi * self.frequencies
        g = coefficients(expansion.model.operators.integrals, omega, values)
        # Only what acts follows the dimensions; derivatives by what does not stay about as they are at the centre.
        moving = np.flatnonzero(g.any(axis=0))
        integrals = self._needed(expansion.model.operators.integrals, moving, values, wanted)
        part = expansion.part(integrals, moving)
        known = self._latest
        # Another state of a device, or a step of what does not act here: the same coefficients, the same solution.
        if (known is not None and part is known.part and list(known.dimensions.values()) == list(lengths)
                and known.solution.frequency is self.frequencies
                and np.array_equal(g[:, integrals], known.solution.coefficients)):
            return replace(known, values=values)
        model = part.at(lengths)
        solution = model.solve(self.frequencies, values)
        return Prediction(solution, model, values, dict(zip(self.names, lengths, strict=True)), part)

    def _needed(
        self, integrals: tuple[Integral, ...], moving: Integers, values: Mapping[str, complex],
        wanted: Sequence[str] | None,
    ) -> Integers:
        """Indices of the integrals that act (`moving`), or that the derivatives by `wanted` depend on."""
        if wanted is None:
            return np.arange(len(integrals))
        omega = 2.0 * np.pi * self.frequencies[[0, -1]]  # a coefficient that is nothing at both is nothing between
        needed, depending = set(map(int, moving)), dependence(integrals)
        for name in wanted:
            needed.update(q for q in depending[name] if q not in needed
                          and integrals[q].coefficient.derivative(omega, values, name).any())
        return np.array(sorted(needed))

    def _reaching(self, expansion: _Expansion, lengths: Real) -> _Expansion:
        """An expansion, on the same basis, that serves these lengths."""
        farthest = float((np.abs(lengths - expansion.centre) / expansion.reach).max(initial=0.0))
        serves = FAR if expansion.second and not self.enriching else 1.0
        if farthest <= serves:
            return expansion
        if farthest <= FAR and not self.enriching:
            return expansion.parabola
        there = projected(expansion.model, self._operators(lengths))
        return _Expansion(there, lengths, self._mesh, second=self.enriching)

    def _enriched(self, expansion: _Expansion | None, values: Mapping[str, complex], lengths: Real) -> _Expansion:
        start = None
        if expansion is not None:
            start = expansion.model
            if not np.array_equal(lengths, expansion.centre):
                start = projected(start, self._operators(lengths))
        operators = self._operators(lengths) if start is None else start.full
        before = 0 if start is None else start.solves
        model = reduce(operators, self.frequencies, values, tolerance=0.5 * self.tolerance, tangents=self.tangents,
                       start=start, depth=DEPTH if start is not None else FIRST_DEPTH, confirmed=False)
        self.solves += model.solves - before
        if model.basis.shape[1] > WIDE:
            model, _ = narrowed(model, self._states_around(model, values), UNNEEDED * self.tolerance)
        return _Expansion(model, lengths, self._mesh, second=True)

    def _states_around(self, model: ReducedModel, values: Mapping[str, complex]) -> Complex:
        """Reduced states at these parameters, and what each parameter about to be moved changes them by."""
        solution = model.solve(self.frequencies, values)
        tangents = reduced_tangents(solution, values, self.tangents)
        changes = [MOVED * abs(values[name]) * each for name, each in zip(self.tangents, tangents, strict=True)]
        return np.concatenate([solution.states, *changes], axis=1)

    def _lengths(self, dimensions: Mapping[str, float]) -> Real:
        if self.chip is None:
            return np.zeros(0)
        known = self.chip.dimensions()
        return np.array([dimensions.get(name, known[name].value) for name in self.names])

    def _operators(self, lengths: Real) -> FullOperators:
        key = tuple(map(float, lengths))
        if key not in self._assembled:
            while len(self._assembled) >= ASSEMBLED:
                self._assembled.pop(next(iter(self._assembled)))
            self._assembled[key] = assemble(self._mesh(lengths), self.problem.terms)
        return self._assembled[key]


def _stretched(mesh: SectionMesh, chip: Chip | None, names: tuple[str, ...], lengths: Real) -> SectionMesh:
    return mesh if chip is None or not names else stretch(mesh, moved_chip(chip, names, lengths))


def moved_chip(chip: Chip, names: tuple[str, ...], lengths: Real) -> Chip:
    """`chip` with its dimensions `names` at `lengths` (metres), and with them all radii that were as long."""
    known = chip.dimensions()
    wanted = dict(zip(names, map(float, lengths), strict=True))
    for name, length in zip(names, lengths, strict=True):
        if name.endswith("radius"):
            for other, dimension in known.items():
                if other.endswith("radius") and abs(dimension.value - known[name].value) < SAME_LENGTH:
                    wanted.setdefault(other, float(length))
    return chip.with_dimensions(wanted)
