"""The one probability model of a campaign, for any hypothesis about it.

With r = ln(Z_model / Z_measured) of all recordings stacked, real parts and imaginary parts,

    r ~ Normal(0, V + R),    theta ~ N(stated, prior),    phi ~ uniform(low, high),

V is diagonal (`weighting`): the noise, scaled to the residual of the best explanation with its deviations. R holds
correlated deviations: the inhomogeneity of all parts, and those of a hypothesis: changes of any size within one region,
missing modes, and the error of its own term, whose parameter is right to :data:`~workbench.diagnosis.odds.TERM` at any
one frequency. Cosine modes in the transducer are amplitudes a ~ Normal(0, s^2) beside theta, since its resonances are
too sharp for linear deviations. The problem is linearised about their likeliest values; in evidences they are
deviations of R. A search ends at the optimum of least squares with V alone, so that nothing is fitted by R; evidences
and intervals are about the optimum with all deviations (:meth:`Likelihood.whitened`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workbench.campaign.state import DeviceState, data_rows, reduced_chi_square, rms_of_impedance
from workbench.catalogue.effect import Effect
from workbench.diagnosis.device import Model, inhomogeneities
from workbench.diagnosis.local_problem import LocalProblem, Scales
from workbench.diagnosis.modes import Mode, columns
from workbench.diagnosis.odds import TERM
from workbench.diagnosis.weighting import Weighting
from workbench.fitting.covariance import Covariance
from workbench.fitting.objective import Objective, Residual
from workbench.fitting.parameter import Parameter
from workbench.fitting.search import FitSearch, Optimum
from workbench.results.spectrum import Spectrum
from workbench.search.continuation import ContinuationStage

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Cosines along the band that the error of a term is a sum of.
COSINES = 5

#: Points of a recording that a search uses, about.
SEARCHED = 121

#: A relative fall of chi-square that ends a fit, its most steps, and the updates of its weights.
ENOUGH, STEPS, REWEIGHTED = 1e-3, 25, 4

#: Least relative reduction of the prior variance of a parameter that the data inform. Doubled, nothing changes: such a
#: parameter stays within a fiftieth of its uncertainty.
INFORMED = 1e-3

#: Most repetitions of the optimum with all deviations, each with updated sizes of these.
WHITENED = 3

#: First step of a parameter without a prior, in its standard deviations, and its least share of the range: the
#: admissible range may be a million times the standard deviation.
FIRST_STEP, SMALLEST_STEP = 10.0, 1e-9


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A hypothesis: ``effects`` of the catalogue, changes in a ``region``, or ``modes``. The modes are missing in the
    model. The null hypothesis has none of these."""

    effects: tuple[Effect, ...] = ()
    region: str = ""
    modes: tuple[Mode, ...] = ()

    @property
    def name(self) -> str:
        parts = [effect.name for effect in self.effects]
        parts += [f"something in the {self.region}"] if self.region else []
        parts += ["modes that the model does not have"] if self.modes else []
        return " and ".join(parts) or "nothing"

    @property
    def is_outside(self) -> bool:
        """Whether it is outside the catalogue."""
        return bool(self.region or self.modes)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that its effects move, each once."""
        return tuple(dict.fromkeys(name for effect in self.effects for name in effect.names))


class LaplaceApproximation(NamedTuple):
    """Laplace's approximation of a posterior at ``x`` (p,), for further searches. ``errors`` (p,) are standard
    deviations, ``reduced_chi_square`` is with the deviations of the points, and the ``error_estimate`` of Z is
    relative."""

    x: Real
    log_evidence: float
    errors: Real
    reduced_chi_square: float
    error_estimate: float


@dataclass(frozen=True, eq=False)
class Explanation:
    """A hypothesis at its optimum.

    ``x`` (p,) all parameters, with the residual there; ``free`` the indices of those that move; ``local`` the problem
    linearised at ``likeliest`` (p,), the optimum with the correlated deviations; ``weighting`` the weights of its
    evidence: its own at first, and then those of the best explanation. ``x`` and ``likeliest`` are equal unless the
    residual of the second is clearly larger than that of least squares.
    """

    hypothesis: Hypothesis
    x: Real
    likeliest: Real
    free: tuple[int, ...]
    local: LocalProblem
    weighting: Weighting
    log_ratio: tuple[Complex, ...]
    impedances: tuple[Complex, ...]
    error_estimate: float
    unconverged: tuple[str, ...] = ()

    def weighted(self, weighting: Weighting) -> Explanation:
        """A copy with other weights of the points."""
        return replace(self, weighting=weighting, local=self.local.informed(weighting))

    def not_converged(self, loop: str) -> Explanation:
        """A copy with a further loop that ended at its limit."""
        return replace(self, unconverged=tuple(dict.fromkeys((*self.unconverged, loop))))

    @property
    def log_evidence(self) -> float:
        """The log evidence. It is up to a constant of all hypotheses with these weights."""
        return self.local.best[0] - sum(mode.cost for mode in self.hypothesis.modes)

    @property
    def gain_of_full_explanation(self) -> float:
        """The gain in log evidence of a residual at the stated noise."""
        return float(self.local.problem.counts @ np.log(self.local.best[2].noise))

    @property
    def scales(self) -> Scales:
        """The scales of the deviations, of the largest evidence."""
        return self.local.best[1]

    @property
    def covariance(self) -> Real:
        """Covariance (k, k) of the free parameters."""
        return self.local.best[2].covariance if self.x is self.likeliest else self.local.covariance(self.scales)

    @property
    def cost(self) -> float:
        """Half the sum of squares that least squares minimises, priors included."""
        return 0.5 * (self.weighting.chi_square(self.log_ratio) + self.prior_square)

    @property
    def prior_square(self) -> float:
        """The sum of squares of the rows of the priors at x."""
        offset = self.local.offset + (self.x - self.likeliest)[list(self.free)]
        return float(np.sum((self.local.prior_rows @ offset) ** 2))

    def pull(self, index: int, parameter: Parameter) -> float:
        """The deviation of a known parameter from its stated value, normalised.

        The estimate differs from the stated value by N(0, prior^2 - posterior^2). 0 if the data do not narrow the
        prior.
        """
        assert parameter.prior is not None
        place = self.free.index(index)
        narrowed = parameter.prior**2 - float(self.local.best[2].covariance[place, place])
        if narrowed <= INFORMED * parameter.prior**2:
            return 0.0
        return float(self.likeliest[index] - parameter.start) / math.sqrt(narrowed)

    @property
    def remainder(self) -> list[Complex]:
        """The residual (n,) of every recording after parameters and deviations."""
        parts, whole = [], self.local.remainder
        for state, rows in zip(self.weighting.states, data_rows(self.weighting.states), strict=True):
            real, imaginary = np.split(whole[rows], 2)
            parts.append(np.asarray(state.noise * (real + 1j * imaginary), dtype=np.complex128))
        return parts

    @property
    def reduced_chi_squares(self) -> list[float]:
        """The reduced chi-square of every recording's residual after the parameters.

        Its covariance is that of the stated noise and of the likeliest inhomogeneity, r^T (1 + D D^T)^-1 r, so that its
        expectation is 1 for an uneven device too. If it is that of no usual device, the covariance is that of the noise
        alone (:attr:`LocalProblem.is_unusually_uneven`).
        """
        local, states = self.local, self.weighting.states
        if local.is_unusually_uneven:
            return [reduced_chi_square(log, state.noise, state.data)
                    for log, state in zip(self.log_ratio, states, strict=True)]
        residual = local.residual + local.tangents @ local.best[2].step
        deviations = local.inhomogeneous(self.scales.inhomogeneity)
        white = [Covariance.of(deviations[rows]).whitened(residual[rows]) for rows in data_rows(states)]
        return [float(each @ each) / (state.data * state.noise.size) for each, state in zip(white, states, strict=True)]

    @property
    def rms(self) -> float:
        """The rms of ln(Z_model / Z_measured) over all points."""
        return rms_of_impedance(self.weighting.states, self.log_ratio)

    @property
    def chi_square(self) -> float:
        """The sum of squares of the residual at x. It is in units of the stated noise."""
        return Weighting.stated(self.weighting.states).chi_square(self.log_ratio)

    def error(self, index: int) -> float:
        """Standard deviation of the parameter of that index."""
        return float(self.errors[index])

    @cached_property
    def errors(self) -> Real:
        """Standard deviations of all parameters (p,), zero if fixed."""
        deviations = np.zeros(self.x.size)
        deviations[list(self.free)] = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return deviations


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The recordings of an objective, with models valid within some ranges."""

    model: Model
    objective: Objective

    def with_objective(self, objective: Objective) -> Likelihood:
        """A copy with the predictions of another objective."""
        return replace(self, objective=objective)

    @cached_property
    def states(self) -> tuple[DeviceState, ...]:
        """The states of the recordings."""
        of = {state.name: state for state in self.model.campaign.recorded}
        return tuple(of[recording.name] for recording in self.objective.recordings)

    @cached_property
    def noise(self) -> Real:
        """Standard deviation of every datum (m,)."""
        return np.concatenate([np.tile(state.noise, 2) for state in self.states])

    @cached_property
    def measured(self) -> list[Spectrum]:
        """The recordings."""
        return [recording.measured for recording in self.objective.recordings]

    @cached_property
    def places(self) -> list[slice]:
        """The rows of each recording among the data."""
        return data_rows(self.states)

    def point_deviations(self, level: float = 0.0, every: Sequence[int] | None = None) -> list[Real]:
        """Deviations (n,) of every recording's points: stated noise and `level`."""
        steps = every or [1] * len(self.objective.recordings)
        return [np.sqrt(state.noise[::step] ** 2 + level**2)
                for state, step in zip(self.states, steps, strict=True)]

    def search(self, hypothesis: Hypothesis, *, with_cosines: bool = False) -> FitSearch:
        """The least-squares problem of a hypothesis, with cosine amplitudes `with_cosines`."""
        free, without_prior = self.model.free(hypothesis.effects)
        free += [*self.model.uneven] if with_cosines else []
        return FitSearch(self.objective, free=free, without_prior=without_prior, refusals=self.model.refusals,
                         correlation=self.model.correlation)

    def solve(self, search: FitSearch, stage: ContinuationStage, x: Real) -> Optimum:
        """The optimum of a stage from x (p,), with few points."""
        every = [own.step(SEARCHED) for own in search.objective.recordings]
        thin = search.with_objective(search.objective.thinned(SEARCHED))
        return thin.solve(stage, x, self.point_deviations(stage.deviation, every))

    def data(self, hypothesis: Hypothesis, x: Real) -> Residual:
        """The data at x (p,), with derivatives by a hypothesis' parameters. They are in units of the stated noise."""
        free = frozenset([*self.model.free(hypothesis.effects)[0], *self.model.uneven])
        return self.objective(x, deviation=self.point_deviations(), free=free)

    def impedances(self, x: Real) -> list[Complex]:
        """Impedance (n,) ohm of every recording as predicted at x (p,)."""
        return [self.objective.predict(x, index, ())[0] for index in range(len(self.objective.recordings))]

    def linearised(self, hypothesis: Hypothesis, search: FitSearch, x: Real, data: Residual) -> LocalProblem:
        """The problem linearised at x (p,), weighted by the stated noise. `data` are those at x."""
        free = search.free
        parameters = [self.model.parameters[i] for i in free]
        cosines = list(self.model.uneven)
        return LocalProblem(
            data.jacobian[:, free], data.vector - data.jacobian[:, cosines] @ x[cosines],
            data.jacobian[:, cosines] * self._unit_cosines, np.zeros((self.noise.size, 0)), self._outside(hypothesis),
            self._term_errors(hypothesis, data, x), inhomogeneities(self.model.campaign),
            np.ones(self.noise.size), search.prior_rows[np.ix_(free, free)], (x - search.centre)[free],
            np.array([np.nan if search.prior_rows[i, i] > 0.0 else p.high - p.low
                      for i, p in zip(free, parameters, strict=True)]),
            np.array([x[i] - p.low for i, p in zip(free, parameters, strict=True)]),
            np.array([p.high - x[i] for i, p in zip(free, parameters, strict=True)]))

    @cached_property
    def _unit_cosines(self) -> Real:
        """Amplitude deviations (w,) of the cosine modes of unit inhomogeneity."""
        largest = inhomogeneities(self.model.campaign)[-1]
        return np.array([self.model.parameters[i].scale / largest for i in self.model.uneven])

    def _outside(self, hypothesis: Hypothesis) -> Real:
        """The change of the data (m, k) by missing modes. It is in units of the noise."""
        return columns(self.measured, self.places, hypothesis.modes, self.noise.size) / self.noise[:, None]

    def _term_errors(self, hypothesis: Hypothesis, data: Residual, x: Real) -> Real:
        """The change of the data (m, k) by errors of terms. There is one per parameter, cosine along the band, and
        state.

        A hypothesis that only moves parameters of the model brings no term, and no error of one.
        """
        own = [self.model.index(name) for effect in hypothesis.effects if effect.terms for name in effect.names]
        if not own:
            return np.zeros((self.noise.size, 0))
        moved = x[own] - self.model.stated[own]
        whole, columns = data.jacobian[:, own] @ moved, []
        for state, rows in zip(self.states, self.places, strict=True):
            for wave in range(COSINES):
                column = np.zeros(whole.size)
                along = np.cos(np.pi * wave * np.linspace(0.0, 1.0, state.noise.size))
                column[rows] = whole[rows] * np.tile(along, 2) * (math.sqrt(2.0) if wave else 1.0)
                columns.append(column * TERM / math.sqrt(COSINES))
        return np.stack(columns, axis=1)

    def laplace(self, hypothesis: Hypothesis, x: Real, level: float) -> LaplaceApproximation:
        """The Laplace approximation at x (p,), with a point deviation `level`."""
        search, data = self.search(hypothesis), self.data(hypothesis, x)
        local = self.linearised(hypothesis, search, x, data)
        share = self.noise**2 / (self.noise**2 + level**2)
        local = replace(local, information=share)
        worth, _, average = local.best
        errors = np.zeros(x.size)
        errors[search.free] = np.sqrt(np.maximum(np.diag(average.covariance), 0.0))
        return LaplaceApproximation(x, worth, errors, average.chi_square / self.noise.size, data.error)

    def refit(self, hypothesis: Hypothesis, x: Real, *, limit: int = STEPS) -> Explanation:
        """The optimum near x (p,), with every recording weighted by its residual.

        Raises:
            NotConverged, NotEnriched, MeshError, InputError, ValueError: nothing near x can be predicted, or is
                admissible.
        """
        search = self.search(hypothesis)
        weighting, unconverged = self._scaled(search, hypothesis, x), ["the weights of least squares"]
        for _ in range(REWEIGHTED):
            end = search.minimise(x, weighting.deviations(), limit=limit, tolerance=ENOUGH)
            x, before, data = end.x, weighting, self.data(hypothesis, end.x)
            weighting = Weighting.left(self.states, data.log_ratio)
            if weighting.is_near(before):
                unconverged = []
                break
        unconverged += [] if end.converged else [f"least squares: {end.reason}"]
        explanation = replace(self.explanation(hypothesis, x, data), unconverged=tuple(unconverged))
        return explanation.weighted(weighting)

    def explanation(self, hypothesis: Hypothesis, x: Real, data: Residual | None = None) -> Explanation:
        """A hypothesis at x (p,), with the weights of the stated noise."""
        search, data = self.search(hypothesis), self.data(hypothesis, x) if data is None else data
        return Explanation(hypothesis, x, x, tuple(map(int, search.free)), self.linearised(hypothesis, search, x, data),
                           Weighting.stated(self.states), data.log_ratio, data.impedance, data.error)

    def whitened(self, explanation: Explanation) -> tuple[Explanation, Residual]:
        """An explanation at its optimum with all deviations, and the data there.

        Cosine modes in the transducer are parameters there, with the prior of an inhomogeneity of the likeliest size.
        The weights are those of the residual after parameters and deviations.

        Raises:
            NotConverged, NotEnriched, MeshError, InputError, ValueError: nothing near it can be predicted.
        """
        plain, search = (self.search(explanation.hypothesis, with_cosines=acting) for acting in (False, True))
        cosines, parts = list(self.model.uneven), explanation.local.parts
        for _ in range(WHITENED):
            search.scale[cosines] = explanation.scales.inhomogeneity * self._unit_cosines
            search.prior_rows[cosines, cosines] = 1.0 / search.scale[cosines]
            spreads = [np.asarray(state.noise / explanation.local.root[rows][:state.noise.size])
                       for state, rows in zip(self.states, self.places, strict=True)]
            under = search.with_covariance(explanation.local.without_cosines.deviating(explanation.scales))
            end = under.minimise(explanation.likeliest, spreads, limit=STEPS, tolerance=ENOUGH)
            x, data = end.x, self.data(explanation.hypothesis, end.x)
            local = replace(self.linearised(explanation.hypothesis, plain, x, data), parts=parts)
            there = replace(explanation, likeliest=x, local=local.informed(explanation.weighting))
            before, explanation = explanation, there.weighted(Weighting.left(self.states, there.remainder))
            if explanation.scales == before.scales and explanation.weighting.is_near(before.weighting):
                break
        else:
            explanation = explanation.not_converged("the sizes of the deviations")
        if not end.converged:
            explanation = explanation.not_converged(f"the optimum with deviations: {end.reason}")
        return explanation, data

    def _scaled(self, search: FitSearch, hypothesis: Hypothesis, x: Real) -> Weighting:
        """The weights at x (p,) that scale steps of parameters without prior."""
        data = self.data(hypothesis, x)
        weighting = Weighting.left(self.states, data.log_ratio)
        local = self.linearised(hypothesis, search, x, data)
        errors = np.sqrt(np.diag(replace(local, information=1.0 / weighting.variances()).best[2].covariance))
        for i, error in zip(search.free, errors, strict=True):
            if self.model.parameters[i].name in hypothesis.names:
                width = search.high[i] - search.low[i]
                search.scale[i] = float(np.clip(FIRST_STEP * error, SMALLEST_STEP * width, width))
        return weighting
