"""The spectrum of a problem, and its exact derivatives, at one set of parameters after the other.

A fit asks for the same spectrum hundreds of times while its parameters wander, lengths among them. A reduced model
answers. A model is a value: where its own estimate says that it is not good enough for the present parameters, a larger
one is made that begins with the same basis; every prediction holds the model it was made with.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from workbench.fem.coefficients import Groups
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.solve import Solution, solve_full, solve_groups
from workbench.model.problem import Problem
from workbench.reduced.basis import needed
from workbench.reduced.neighbourhood import Neighbourhood
from workbench.reduced.reduction import ReducedModel, covering, narrowed, projected_on, reduced

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Vectors from each factorisation: for the first model, and when it is enriched, where less is new.
FIRST_DEPTH, DEPTH = 12, 6

#: How far, relative, a parameter is expected to move before the basis grows again.
MOVED = 0.1

#: Directions that no state in a neighbourhood needs more of than this, relative, are left out of a model for it.
NEGLIGIBLE = 1e-6

#: Vectors from which on a basis forgets where it has been, and how small directions it then leaves out, relative.
#: Above the second number a basis that is made for a whole neighbourhood is begun anew: all of it is solved for there.
WIDE, LEFT_BEHIND = 200, 1e-4
OLD = 100


@dataclass(frozen=True, eq=False)
class Prediction:
    """A predicted spectrum and what it would do if parameters moved.

    ``impedance`` (n,) ohm, e^{+j w t}; ``model`` the reduced one it is of; ``values`` complex parameters, e^{-i w t},
    lengths in metres.
    """

    solution: Solution
    model: ReducedModel
    values: Mapping[str, complex]

    @property
    def impedance(self) -> Complex:
        return np.conj(self.solution.impedance)

    @cached_property
    def frequency_slope(self) -> Complex:
        """d ln Z / d ln f (n,), e^{+j w t}."""
        solution = self.solution
        return np.conj(solution.omega / solution.impedance * solution.frequency_gradient(self.values))

    @cached_property
    def error(self) -> Real:
        """Estimated relative error (n,) of the impedance."""
        return self.model.error(self.solution)

    @property
    def full(self) -> tuple[FullOperators, Complex]:
        """The full operators, and their states (size, n) that this stands for."""
        return self.model.full, self.model.expand(self.solution)

    def logarithmic_gradient(self, names: tuple[str, ...]) -> Complex:
        """d ln Z / d theta (n, len(names)) by complex parameters, e^{-i w t} on both sides.

        For ln Z of a spectrum take the conjugate: by the real part of theta conj(d), by its imaginary part conj(i d).
        Zero by what nothing here depends on.
        """
        depending = self.solution.operators.coefficients.parameters
        known = [column for column, name in enumerate(names) if name in depending]
        result = np.zeros((self.solution.omega.size, len(names)), dtype=complex)
        gradient = self.solution.parameter_gradient(self.values, tuple(names[column] for column in known))
        result[:, known] = gradient / self.solution.impedance[:, None]
        return result


class Predictor:
    """Spectra of one problem at fixed frequencies (n,) Hz, for any values of its parameters.

    ``tangents`` are the parameters about to be moved: the basis prepares for them. ``tolerance`` bounds the relative
    error of the impedance: where the estimate is above, the model grows; infinite, it grows by :meth:`cover` only.
    ``model`` is the present one. ``solves`` counts the full solves spent.
    """

    def __init__(
        self, problem: Problem, frequencies: Real, *, tangents: tuple[str, ...] = (), tolerance: float = 1e-4
    ) -> None:
        self.problem, self.frequencies = problem, np.asarray(frequencies, dtype=float)
        self.tangents, self.tolerance = tangents, tolerance
        #: All that the problem holds, and what of it the model does.
        self.every = assemble(problem.mesh, problem.terms)
        self.operators = self.every
        self.solves = 0
        self.model: ReducedModel | None = None
        #: Where the model is for, if it was made for one neighbourhood.
        self.place: Neighbourhood | None = None
        self._latest: Prediction | None = None

    def __call__(self, values: Mapping[str, complex], clock: float = 0.0) -> Prediction:
        """The spectrum at these parameters, of a larger model if need be; those not given are the problem's own.

        It is that at the frequencies of a generator whose `clock` is off by so much, relative.

        Raises:
            NotEnriched: the reduced model did not reach the tolerance.
        """
        values = {**self.problem.values, **values}
        known, frequencies = self._latest, self.frequencies * (1.0 + clock)
        if self.model is None:
            prediction = self._grow(values, None, clock)
        else:
            operators = self.model.operators
            groups = operators.coefficients.groups(2.0 * np.pi * frequencies, values)
            if known is not None and known.model is self.model and _alike(known.solution.groups, groups):
                # Another state of a device, or a step of what does not act here.
                return replace(known, values=values)
            prediction = Prediction(solve_groups(operators, frequencies, groups), self.model, values)
            if math.isfinite(self.tolerance) and prediction.error.max() > self.tolerance:
                prediction = self._grow(values, float(self.frequencies[np.argmax(prediction.error)]), clock)
        self._latest = prediction
        return prediction

    def at(self, frequencies: Real, tolerance: float | None = None) -> Predictor:
        """The same at other frequencies (n,) Hz and perhaps to another tolerance, beginning with the present model."""
        other = copy.copy(self)
        other.frequencies, other._latest, other.solves = np.asarray(frequencies, dtype=float), None, 0
        other.tolerance = self.tolerance if tolerance is None else tolerance
        return other

    def placed(self, place: Neighbourhood) -> Predictor:
        """The same on the model of a neighbourhood, which stays as it is."""
        other = copy.copy(self)
        other.place, other.model, other.solves = place, place.model, place.model.solves
        other.tolerance, other._latest = math.inf, None
        return other

    def of_acting(
        self, values: Mapping[str, complex], moved: Mapping[str, complex], named: Collection[str] = ()
    ) -> Predictor:
        """The same of those integrals alone that are something at these values, or where those `moved` are others, or
        that depend on a value that is `named`."""
        here = {**self.problem.values, **values}
        omega = 2.0 * np.pi * self.frequencies[[0, -1]]
        acting = [self.every.coefficients(omega, each).any(axis=0) for each in (here, {**here, **moved})]
        names = set(named)
        depends = np.array([not names.isdisjoint(each.coefficient.parameters) for each in self.every.integrals])
        other = copy.copy(self)
        other.operators = self.every.of(np.flatnonzero(acting[0] | acting[1] | depends))
        if self.place is not None:
            return other.placed(self.place.of(other.operators))
        other.model = other._latest = None
        return other

    def with_every(self, settings: Sequence[Mapping[str, complex]]) -> Predictor:
        """The same of all integrals that act at these values or begin to, on no more of the basis than spectra there
        need."""
        assert self.model is not None
        states = np.concatenate([self.model.solve(self.frequencies, {**self.problem.values, **each}).states
                                 for each in settings], axis=1)
        part = needed(states, NEGLIGIBLE)
        basis = self.model.basis @ part
        acting = [self.every.coefficients.acting({**self.problem.values, **each}) for each in settings]
        operators = self.every.of(np.flatnonzero(np.any(acting, axis=0)))
        matrices, sketch = projected_on(operators, basis, self.model.test)
        inner = ReducedOperators(operators.integrals, operators.coefficients, matrices, operators.forms)
        other = copy.copy(self)
        other.operators, other.place, other._latest, other.tolerance = operators, None, None, math.inf
        other.model = replace(self.model, full=operators, operators=inner, basis=basis, sketch=sketch)
        return other

    def elsewhere(self, frequencies: Real, tolerance: float, values: Mapping[str, complex]) -> Prediction:
        """A prediction at other frequencies (n,) Hz and to another tolerance; the model it takes is kept."""
        other = self.at(frequencies, tolerance)
        prediction = other(values)
        self.model, self.solves = other.model, self.solves + other.solves
        return prediction

    def narrowed(self, settings: Sequence[Mapping[str, complex]]) -> Predictor:
        """The same, beginning with no more of the basis than the spectra at these values need.

        The first are the values that the others lie about.
        """
        other = self.at(self.frequencies)
        if self.model is not None:
            every = [self.model.solve(self.frequencies, {**self.problem.values, **each}).states for each in settings]
            states = np.concatenate([every[0], *(each - every[0] for each in every[1:])], axis=1)
            other.model = narrowed(self.model, states, NEGLIGIBLE)
        return other

    def cover(
        self, values: Mapping[str, complex], moves: Mapping[str, float], tolerance: float,
        corners: Sequence[Mapping[str, complex]] = (),
    ) -> None:
        """Let the model grow for parameters about `values` of which each of `moves` changes by so much.

        What an error of Z of `tolerance` does not need is left out; `corners` are further values that the basis must
        hold the states of (`reduction.covering`). A model of a rank above :data:`OLD` is left to the predictions that
        hold it, and a new one begun: dense solves cost the cube of the rank.
        """
        around = {**self.problem.values, **values}
        start = self.model if self.model is not None and self.model.operators.size <= OLD else None
        before = 0 if start is None else start.solves
        self.model = covering(self.operators, self.frequencies, around, moves, tolerance=tolerance, depth=DEPTH,
                              corners=[{**around, **corner} for corner in corners], start=start)
        self.solves += self.model.solves - before

    def full(self, values: Mapping[str, complex], at: Real) -> Complex:
        """The impedance (e^{+j w t}) by full solves at the frequencies `at`, to check the reduced model with."""
        self.solves += len(at)
        return np.conj(solve_full(self.operators, at, {**self.problem.values, **values}).impedance)

    def _grow(self, values: Mapping[str, complex], worst: float | None, clock: float) -> Prediction:
        """The prediction of a model that is large enough; `worst` is the frequency (Hz) where the last one was least
        so."""
        start = self.model
        if start is not None and self._latest is not None and start.basis.shape[1] > WIDE:
            # Of a long way what was needed at its last place: dense solves cost the cube of the rank.
            start = narrowed(start, start.solve(self.frequencies, self._latest.values).states, LEFT_BEHIND)
        moves = {name: MOVED * abs(values[name]) for name in self.tangents}
        tolerance = 0.5 * self.tolerance if math.isfinite(self.tolerance) else 1e-3
        model, solution = reduced(self.operators, self.frequencies, values, tolerance=tolerance, tangents=moves,
                                  start=start, depth=DEPTH if start is not None else FIRST_DEPTH, confirmed=False,
                                  worst=worst)
        self.solves += model.solves - (0 if start is None else start.solves)
        self.model = model
        # The model is made, and its error estimated, at the frequencies themselves: a clock is off by far less than
        # the width of a resonance.
        return Prediction(solution if clock == 0.0 else model.solve(self.frequencies * (1.0 + clock), values), model,
                          values)


def _alike(one: Groups, other: Groups) -> bool:
    """Whether two models are the same at every frequency."""
    return len(one) == len(other) and all(
        np.array_equal(h, g) and np.array_equal(a, b) for (h, a), (g, b) in zip(one, other, strict=True))
