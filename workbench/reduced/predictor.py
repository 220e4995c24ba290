"""The spectrum of a problem and its exact derivatives, for fits.

A fit computes the same spectrum hundreds of times for other parameters, lengths among them, by a reduced model. Models
and predictors are values: if the error estimate exceeds the tolerance, an enriched model is made whose basis begins
with the same vectors. Every prediction has its model; :meth:`Predictor.holding` returns a predictor with that model.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from workbench.fem.coefficients import Groups
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import Solution, solve_full, solve_groups
from workbench.model.problem import Problem
from workbench.reduced.about_point import LocalBasis
from workbench.reduced.at_point import reduced
from workbench.reduced.growth import DEPTH, ENRICHING_DEPTH
from workbench.reduced.model import ReducedModel

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Expected relative move of a parameter before the next enrichment.
MOVED = 0.1

#: Error of Z of a truncation to the states at given values: for quantities of these states alone, and as a share of the
#: tolerance if a search continues about them.
UNSEEN, UNSEEN_SHARE = 1e-9, 1e-3

#: Number of vectors above which a basis is truncated to the present states before its enrichment, to this share of the
#: tolerance: dense solves cost the cube of the rank.
WIDE, TRUNCATION_SHARE = 200, 0.1


@dataclass(frozen=True, eq=False)
class Prediction:
    """A predicted spectrum with its derivatives by parameters. ``impedance`` (n,) in ohm, e^{+j w t}; ``model`` is its
    reduced model; ``values`` are the complex parameters, e^{-i w t}, lengths in metres."""

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
        """The full operators, and the states (size, n) of the prediction."""
        return self.model.full, self.model.expand(self.solution)

    def logarithmic_gradient(self, names: tuple[str, ...]) -> Complex:
        """Derivatives d ln Z / d theta by complex parameters. They are (n, len(names)), e^{-i w t} throughout.

        For ln Z of a spectrum take the conjugate: by the real part of theta conj(d), by its imaginary part conj(i d).
        It is zero for parameters of no coefficient.
        """
        depending = self.solution.operators.coefficients.parameters
        known = [column for column, name in enumerate(names) if name in depending]
        result = np.zeros((self.solution.omega.size, len(names)), dtype=complex)
        gradient = self.solution.parameter_gradient(self.values, tuple(names[column] for column in known))
        result[:, known] = gradient / self.solution.impedance[:, None]
        return result


@dataclass(frozen=True, eq=False)
class Predictor:
    """Spectra of one problem at fixed ``frequencies`` (n,) in Hz.

    ``tangents`` are the parameters that will move. ``tolerance`` bounds the relative error of the impedance: if the
    estimate exceeds it, the model is enriched; if infinite, the given ``model`` is used. ``local`` is the model's local
    basis, if any; ``solves`` counts full solves; ``every`` are all operators of the problem, and ``operators`` those in
    use.
    """

    problem: Problem
    frequencies: Real
    _: KW_ONLY
    tangents: tuple[str, ...] = ()
    tolerance: float = 1e-4
    model: ReducedModel | None = None
    local: LocalBasis | None = None
    solves: int = 0
    every: FullOperators = field(default=None)  # type: ignore[assignment]  # set below
    operators: FullOperators = field(default=None)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        object.__setattr__(self, "frequencies", np.asarray(self.frequencies, dtype=float))
        if self.every is None:
            object.__setattr__(self, "every", assemble(self.problem.mesh, self.problem.terms))
        if self.operators is None:
            object.__setattr__(self, "operators", self.every)

    def __call__(
        self, values: Mapping[str, complex], clock: float = 0.0, known: Prediction | None = None
    ) -> Prediction:
        """The spectrum at parameter `values`, by default the problem's own.

        The model is enriched if necessary. `clock` is the relative frequency error of a generator. A prediction `known`
        is reused for values with the same system.

        Raises:
            NotEnriched: the reduced model did not reach the tolerance.
        """
        values = {**self.problem.values, **values}
        if self.model is None:
            return self._enriched(values, None, clock)
        frequencies, operators = self.frequencies * (1.0 + clock), self.model.operators
        groups = operators.coefficients.groups(2.0 * np.pi * frequencies, values)
        if known is not None and known.model is self.model and _alike(known.solution.groups, groups):
            # Another state of a device, or a step in a parameter without effect here.
            return replace(known, values=values)
        prediction = Prediction(solve_groups(operators, frequencies, groups), self.model, values)
        if math.isfinite(self.tolerance) and prediction.error.max() > self.tolerance:
            return self._enriched(values, float(self.frequencies[np.argmax(prediction.error)]), clock)
        return prediction

    def holding(self, model: ReducedModel) -> Predictor:
        """The predictor with the `model` of one of its predictions."""
        if model is self.model:
            return self
        return replace(self, model=model, solves=self.solves + model.solves - (self.model.solves if self.model else 0))

    def at(self, frequencies: Real, tolerance: float | None = None) -> Predictor:
        """A predictor at other frequencies (n,) in Hz, with its own count. `tolerance` replaces the tolerance if
        given."""
        return replace(self, frequencies=frequencies, solves=0,
                       tolerance=self.tolerance if tolerance is None else tolerance)

    def on_basis(self, local: LocalBasis) -> Predictor:
        """A predictor on a local basis, without enrichment."""
        return replace(self, local=local, model=local.model, solves=local.model.solves, tolerance=math.inf)

    def restricted(
        self, values: Mapping[str, complex], moved: Mapping[str, complex], named: Collection[str] = ()
    ) -> Predictor:
        """A predictor restricted to relevant integrals. Their coefficient is nonzero at `values` or at `moved`, or
        depends on one of `named`."""
        here = {**self.problem.values, **values}
        omega = 2.0 * np.pi * self.frequencies[[0, -1]]
        acting = [self.every.coefficients(omega, each).any(axis=0) for each in (here, {**here, **moved})]
        names = set(named)
        depends = np.array([not names.isdisjoint(each.coefficient.parameters) for each in self.every.integrals])
        operators = self.every.of(np.flatnonzero(acting[0] | acting[1] | depends))
        if self.local is not None:
            return replace(self, operators=operators).on_basis(self.local.of(operators))
        return replace(self, operators=operators, model=None)

    def with_every(self, settings: Sequence[Mapping[str, complex]]) -> Predictor:
        """A predictor of all integrals relevant at these values. Their coefficient or its derivative is nonzero there.
        The basis is truncated to the spectra there."""
        assert self.model is not None
        every = [{**self.problem.values, **each} for each in settings]
        acting = [self.every.coefficients.acting(each) for each in every]
        operators = self.every.of(np.flatnonzero(np.any(acting, axis=0)))
        states = np.concatenate([self.model.states(self.frequencies, each) for each in every], axis=1)
        return replace(self, operators=operators, local=None, tolerance=math.inf,
                       model=self.model.truncated(states, UNSEEN).of(operators))

    def truncated(self, settings: Sequence[Mapping[str, complex]], error: float | None = None) -> Predictor:
        """A predictor whose basis is truncated to the spectra at these values.

        The other settings are about the first. The truncation adds a relative `error` of Z, by default a share of the
        tolerance. The count of solves restarts.
        """
        if self.model is None:
            return self.at(self.frequencies)
        every = [self.model.states(self.frequencies, {**self.problem.values, **each}) for each in settings]
        states = np.concatenate([every[0], *(each - every[0] for each in every[1:])], axis=1)
        if error is None:
            error = UNSEEN_SHARE * self.tolerance if math.isfinite(self.tolerance) else UNSEEN
        return replace(self, model=self.model.truncated(states, error), solves=0)

    def full(self, values: Mapping[str, complex], at: Real) -> Complex:
        """The impedance (e^{+j w t}) by full solves at `at` (Hz)."""
        return np.conj(solve_full(self.operators, at, {**self.problem.values, **values}).impedance)

    def _enriched(self, values: Mapping[str, complex], worst: float | None, clock: float) -> Prediction:
        """The prediction of an enriched model. `worst` is the frequency (Hz) with the largest error estimate."""
        start, tolerance = self.model, 0.5 * self.tolerance if math.isfinite(self.tolerance) else 1e-3
        if start is not None and start.basis.shape[1] > WIDE:
            start = start.truncated(start.states(self.frequencies, values), TRUNCATION_SHARE * tolerance)
        moves = {name: MOVED * abs(values[name]) for name in self.tangents}
        model, solution = reduced(self.operators, self.frequencies, values, tolerance=tolerance, tangents=moves,
                                  start=start, depth=DEPTH if start is None else ENRICHING_DEPTH, confirmed=False,
                                  worst=worst)
        # The model is made, and its error estimated, at the nominal frequencies: a clock error is far below the width
        # of a resonance.
        return Prediction(solution if clock == 0.0 else model.solve(self.frequencies * (1.0 + clock), values), model,
                          values)


def _alike(one: Groups, other: Groups) -> bool:
    """Whether two models are the same at every frequency."""
    return len(one) == len(other) and all(
        np.array_equal(h, g) and np.array_equal(a, b) for (h, a), (g, b) in zip(one, other, strict=True))
