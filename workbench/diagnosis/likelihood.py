"""The one probability model of a campaign, for any hypothesis about it.

With r = ln(Z_measured / Z_model) of all recordings stacked, real parts and imaginary parts,

    r ~ Normal(0, W + tau^2 K K^T + R),    theta ~ what is known of it,    phi ~ anywhere within its range,

W is the noise of the points, K the discrepancy modes (`discrepancy`) and tau the accuracy of the model, stated or
averaged over; R holds the deviations of a hypothesis: changes of any size within one region, and the error of its own
term, whose parameter is right to :data:`~workbench.diagnosis.odds.TERM` at any one frequency.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from workbench.diagnosis.device import Model
from workbench.diagnosis.discrepancy import DiscrepancyModes, discrepancy_modes
from workbench.diagnosis.evidence import Average, LinearisedProblem, checked, over_scales
from workbench.diagnosis.hypothesis import Effect
from workbench.diagnosis.modes import Mode, columns, strongest
from workbench.diagnosis.odds import ACCURACIES, INACCURATE, REGION_SIZES, TERM
from workbench.diagnosis.state import DeviceState
from workbench.fitting.covariance import NEGLIGIBLE, Covariance, principal
from workbench.fitting.objective import Objective, Residual
from workbench.fitting.search import FitSearch, Optimum
from workbench.fitting.uncertainty import correlation_length
from workbench.results.spectrum import Spectrum
from workbench.search.continuation import ContinuationStage

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

T = TypeVar("T")

#: Cosines along the band that the error of a term is a sum of.
WAVES = 5

#: Points of a recording that a search uses at little weight, about.
SEARCHED = 121

#: Rounds of a fit: the accuracy of the model is that of the largest evidence at the last optimum, and then this share
#: of it, as long as that finds a better one.
ROUNDS, STRICTER = 6, 0.3

#: Log evidences that differ by less are alike.
ALIKE = 0.5

#: A relative fall of chi-square that ends a fit, and its most steps.
ENOUGH, STEPS = 1e-3, 25


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A hypothesis: some ``effects`` of the catalogue, a ``region`` with changes of any kind, or ``modes`` that the
    model does not have. The null hypothesis has none of these."""

    effects: tuple[Effect, ...] = ()
    region: str = ""
    modes: tuple[Mode, ...] = ()

    @property
    def name(self) -> str:
        found = [effect.name for effect in self.effects]
        found += [f"something in the {self.region}"] if self.region else []
        found += ["modes that the model does not have"] if self.modes else []
        return " and ".join(found) or "nothing"

    @property
    def is_outside(self) -> bool:
        """Whether it is outside the catalogue."""
        return bool(self.region or self.modes)


class Scales(NamedTuple):
    """Sizes of the deviations beside the noise: the ``accuracy`` of the model, the ``size`` of changes outside the
    catalogue, and whether the ``term`` of a hypothesis is right to :data:`TERM` only (1), or exact (0)."""

    accuracy: float
    size: float
    term: float


@dataclass(frozen=True, eq=False)
class LocalProblem:
    """A problem linearised at a point: its ``data`` there, the ``settings`` of the scales that are averaged over, and
    the ``counts`` of columns of the deviations: of the parts, outside the catalogue, of the term, and further ones."""

    problem: LinearisedProblem
    settings: tuple[Scales, ...]
    counts: tuple[int, ...]
    data: Residual

    def _expanded(self, scales: Scales) -> Real:
        return np.repeat([*scales, 0.0], self.counts)

    def averaged(self, scales: Scales) -> Average:
        """Over the parameters."""
        return self.problem.averaged(self._expanded(scales))

    def over_scales(self) -> tuple[float, Scales, Average]:
        """ln of the mean evidence over all settings, the best of these and the average at it."""
        worth, best, average = over_scales(self.problem, [self._expanded(each) for each in self.settings])
        return worth, self.settings[best], average

    def over_blocks(self, blocks: Sequence[NDArray[np.int64]], sizes: Real) -> Real:
        """ln of the mean evidence over all settings with each of some blocks of the further columns, averaged over
        their `sizes`: (blocks,)."""
        every = []
        for each in self.settings:
            scales = self._expanded(each)
            every.append(self.problem.averaged(scales).log_evidence + self.problem.added(scales, blocks, sizes))
        whole = np.stack(every)
        found = np.asarray(logsumexp(whole, axis=(0, 2)) - math.log(whole.shape[0] * whole.shape[2]))
        # No likelihood is above that of data without a residual, and deviations lower it.
        return np.array([checked(float(each), 0.0, float(np.abs(whole).max())) for each in found])


class LaplaceApproximation(NamedTuple):
    """Laplace's approximation of a posterior at ``x`` (p,), where a search goes on from: ``log_evidence``, standard
    deviations ``errors`` (p,), ``accuracy`` of the model there, ``reduced_chi_square`` at an accuracy of
    :data:`INACCURATE` at most, and the ``error_estimate`` of Z (relative)."""

    x: Real
    log_evidence: float
    errors: Real
    accuracy: float
    reduced_chi_square: float
    error_estimate: float


@dataclass(frozen=True, eq=False)
class Explanation:
    """A hypothesis at its optimum.

    ``x`` (p,) all parameters; ``free`` the indices of those that move and ``covariance`` of them; ``log_evidence`` up
    to a constant of all hypotheses; ``scales`` of the deviations, of the largest evidence; ``residual`` the data there,
    in units of the noise; ``occam`` the part of the evidence that the ranges of its parameters cost; ``error_estimate``
    of Z, relative.
    """

    hypothesis: Hypothesis
    x: Real
    free: tuple[int, ...]
    covariance: Real
    log_evidence: float
    scales: Scales
    occam: float
    residual: Residual
    error_estimate: float
    correlation: float = 1.0

    @property
    def accuracy(self) -> float:
        """Accuracy of the model, relative."""
        return self.scales.accuracy

    def error(self, index: int) -> float:
        """Standard deviation of the parameter of that index."""
        return float(self.errors[index])

    @property
    def errors(self) -> Real:
        """Standard deviations of all parameters (p,), zero of those that do not move."""
        found = np.zeros(self.x.size)
        found[list(self.free)] = np.sqrt(self.correlation * np.maximum(np.diag(self.covariance), 0.0))
        return found

    @property
    def laplace(self) -> LaplaceApproximation:
        """The Laplace approximation there, for a search that goes on from it."""
        return LaplaceApproximation(self.x, self.log_evidence, self.errors, self.accuracy, 1.0, self.error_estimate)


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The recordings, the models that predict them within some ranges, and the discrepancy of these models.

    ``columns`` (m, k) are changes of ln Z by the fields within all parts, of covariance equal to that of
    ``discrepancy`` at a relative size of one; ``region_discrepancy`` holds the modes of each region by itself, with
    losses of any size, for hypotheses of a region.
    """

    model: Model
    objective: Objective
    columns: Real
    region_discrepancy: DiscrepancyModes | None = None
    discrepancy: DiscrepancyModes | None = None

    @classmethod
    def noise_only(cls, model: Model, objective: Objective) -> Likelihood:
        """A likelihood without discrepancy."""
        return cls(model, objective, np.zeros((sum(2 * r.measured.frequency.size for r in objective.recordings), 0)))

    def with_objective(self, objective: Objective) -> Likelihood:
        """A copy with the predictions of another objective."""
        return replace(self, objective=objective)

    def with_discrepancy(self, x: Real) -> Likelihood:
        """A copy with the discrepancy of the model at x (p,)."""
        return self._with_modes(*discrepancy_modes(self.objective, x))

    def _with_modes(self, discrepancy: DiscrepancyModes, region_discrepancy: DiscrepancyModes) -> Likelihood:
        sizes = self.noise[:, None] / ACCURACIES[-1]
        directions, lengths = principal(discrepancy.columns / sizes, NEGLIGIBLE)
        return replace(self, columns=directions * lengths * sizes, region_discrepancy=region_discrepancy,
                       discrepancy=discrepancy)

    def joined(self, other: Likelihood) -> Likelihood:
        """The likelihood of these recordings and others, both with their discrepancies."""
        assert self.discrepancy is not None
        assert self.region_discrepancy is not None
        assert other.discrepancy is not None
        assert other.region_discrepancy is not None
        both = Likelihood.noise_only(self.model, self.objective.joined(other.objective))
        return both._with_modes(self.discrepancy.stacked(other.discrepancy),
                                self.region_discrepancy.stacked(other.region_discrepancy))

    @cached_property
    def states(self) -> tuple[DeviceState, ...]:
        """The states of the recordings."""
        of = {state.name: state for state in self.model.campaign.states}
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
        ends = np.cumsum([0, *(2 * each.frequency.size for each in self.measured)]).tolist()
        return [slice(low, high) for low, high in pairwise(ends)]

    def strongest_modes(self, hypothesis: Hypothesis, x: Real, accuracy: float) -> tuple[Mode, ...]:
        """The modes that the model seems to lack under a hypothesis at x (p,), one at most for every body recorded."""
        search = self.search(hypothesis)
        data = self.data(hypothesis, x)
        whiten = Covariance.of(self.columns / self.noise[:, None] * accuracy).whitened
        precision = np.diag(search.precision[search.free])
        # A parameter that nothing is known of may be anything.
        nuisances, _ = np.linalg.qr(np.vstack([whiten(data.jacobian[:, search.free]), precision]))

        def project(columns: Real) -> Real:
            """Whitened, and without what known parameters imitate; the rows of the priors are nothing to a mode."""
            whole = np.vstack([whiten(columns), np.zeros((len(precision), columns.shape[1]))])
            return np.asarray(whole - nuisances @ (nuisances.T @ whole))

        residual = np.concatenate([whiten(data.vector), (x - search.centre)[search.free] * np.diag(precision)])
        residual = residual - nuisances @ (nuisances.T @ residual)
        bodies: dict[object, list[int]] = {}
        for index, predictor in enumerate(self.objective.predictors):
            bodies.setdefault(predictor, []).append(index)
        return strongest(self.measured, self.places, list(bodies.values()), self.noise, project, residual,
                         REGION_SIZES)

    def point_deviations(self, level: float = 0.0, every: Sequence[int] | None = None) -> list[Real]:
        """Deviations (n,) of every recording's points with a further deviation `level`."""
        steps = every or [1] * len(self.objective.recordings)
        return [np.sqrt(state.noise[::step] ** 2 + level**2)
                for state, step in zip(self.states, steps, strict=True)]

    def search(self, hypothesis: Hypothesis) -> FitSearch:
        """The least-squares problem under a hypothesis, without discrepancy."""
        free, released = self.model.free(hypothesis.effects)
        return FitSearch(self.objective, free=free, released=released, refusals=self.model.refusals)

    def solve(self, search: FitSearch, stage: ContinuationStage, x: Real, *, accuracy: float = 0.0) -> Optimum:
        """The optimum of a stage from x (p,), on few of the points; `accuracy` is that of the model."""
        every = [own.step(SEARCHED) for own in search.objective.recordings]
        spreads = self.point_deviations(stage.deviation, every)
        thin = search.with_objective(search.objective.thinned(SEARCHED))
        if accuracy > 0.0 and self.columns.size:
            rows = np.concatenate([np.concatenate([np.arange(place.start, middle, step),
                                                   np.arange(middle, place.stop, step)])
                                   for place, step in zip(self.places, every, strict=True)
                                   for middle in [(place.start + place.stop) // 2]])
            deviation = np.concatenate([np.tile(each, 2) for each in spreads])
            thin = thin.with_covariance(Covariance.of(self.columns[rows] / deviation[:, None] * accuracy))
        return thin.solve(stage, x, spreads)

    def stage_optimum(
        self, hypothesis: Hypothesis, search: FitSearch, x: Real, stage: ContinuationStage
    ) -> LaplaceApproximation:
        """The optimum of a stage near x (p,), with the accuracy of the model of largest evidence there."""
        level = stage.deviation

        def again(best: LaplaceApproximation, strictness: float) -> LaplaceApproximation:
            end = self.solve(search, stage, best.x, accuracy=strictness * best.accuracy)
            return self.laplace(hypothesis, end.x, level)

        return _improved(self.laplace(hypothesis, x, level), again, lambda each: each.log_evidence, ROUNDS,
                         lambda each: each.accuracy > level)

    def linearised(
        self, hypothesis: Hypothesis, search: FitSearch, x: Real, level: float = 0.0, further: Real | None = None
    ) -> LocalProblem:
        """The problem linearised at x (p,), with `further` columns (m, k) of deviations of scale zero."""
        free = search.free
        data = self.data(hypothesis, x, level)
        parameters = [self.model.parameters[i] for i in free]
        deviations = list(self.deviations(hypothesis, data, x, level))
        deviations += [np.zeros((self.noise.size, 0)) if further is None else further]
        problem = LinearisedProblem.of(
            data.jacobian[:, free], data.vector, np.column_stack(deviations),
            precision=np.diag(search.precision[free] ** 2), offset=(x - search.centre)[free],
            widths=np.array([np.nan if search.precision[i] > 0.0 else p.high - p.low
                             for i, p in zip(free, parameters, strict=True)]),
            below=np.array([x[i] - p.low for i, p in zip(free, parameters, strict=True)]),
            above=np.array([p.high - x[i] for i, p in zip(free, parameters, strict=True)]))
        stated = self.model.campaign.inhomogeneity
        counts = tuple(each.shape[1] for each in deviations)
        settings = itertools.product(
            ACCURACIES if stated is None else (stated,), REGION_SIZES if hypothesis.is_outside else (0.0,),
            (0.0, 1.0) if counts[2] else (0.0,))
        return LocalProblem(problem, tuple(Scales(*map(float, each)) for each in settings), counts, data)

    def _term_errors(self, hypothesis: Hypothesis, tangents: Real, x: Real) -> Real:
        """The change of the data (m, k) by errors of a hypothesis' own terms: of each parameter, along the band, state
        by state.

        A hypothesis that only moves numbers of the model brings no term, and no error of one.
        """
        own = [self.model.index(name) for effect in hypothesis.effects if effect.terms for name in effect.names]
        if not own:
            return np.zeros((self.noise.size, 0))
        moved = x[own] - np.array([self.model.parameters[i].start for i in own])
        whole, columns, start = tangents[:, own] @ moved, [], 0
        for state in self.states:
            count = state.noise.size
            rows = slice(start, start + 2 * count)
            for wave in range(WAVES):
                column = np.zeros(whole.size)
                along = np.cos(np.pi * wave * np.linspace(0.0, 1.0, count))
                column[rows] = whole[rows] * np.tile(along, 2) * (math.sqrt(2.0) if wave else 1.0)
                columns.append(column * TERM / math.sqrt(WAVES))
            start += 2 * count
        return np.stack(columns, axis=1)

    def whitening(self, explanation: Explanation) -> Covariance:
        """The covariance of the deviations beside the noise at the optimum of an explanation."""
        hypothesis, x = explanation.hypothesis, explanation.x
        return self._covariance(self.deviations(hypothesis, self.data(hypothesis, x), x), explanation.scales)

    @staticmethod
    def _covariance(deviations: Sequence[Real], scales: Scales) -> Covariance:
        return Covariance.of(np.column_stack([part * size for part, size in zip(deviations, scales, strict=True)]))

    def refit(self, hypothesis: Hypothesis, x: Real, *, rounds: int = ROUNDS, limit: int = STEPS) -> Explanation:
        """The optimum of the posterior near x (p,), with all data at full weight, and the evidence there.

        Raises:
            NotConverged, NotEnriched, MeshError, InputError, ValueError: nothing near x can be predicted, or is
                admissible.
        """
        search = self.search(hypothesis)
        own = [self.model.index(name) for effect in hypothesis.effects for name in effect.names]

        def at(x: Real) -> tuple[Real, LocalProblem, float, Scales, Average]:
            local = self.linearised(hypothesis, search, x)
            return x, local, *local.over_scales()

        def again(
            best: tuple[Real, LocalProblem, float, Scales, Average], strictness: float
        ) -> tuple[Real, LocalProblem, float, Scales, Average]:
            x, local, _, scales, average = best
            for i, deviation in zip(search.free, np.sqrt(np.diag(average.covariance)), strict=True):
                if i in own:
                    # The admissible range may be a million times the one that the data determine.
                    width = search.high[i] - search.low[i]
                    search.scale[i] = float(np.clip(10.0 * deviation, 1e-9 * width, width))
            deviations = self.deviations(hypothesis, local.data, x)
            covariance = self._covariance(deviations, scales._replace(accuracy=strictness * scales.accuracy))
            whitened = search.with_covariance(covariance)
            return at(whitened.minimise(x, self.point_deviations(), limit=limit, tolerance=ENOUGH).x)

        x, local, worth, scales, average = _improved(at(x), again, lambda each: each[2], rounds)
        worth -= sum(mode.cost for mode in hypothesis.modes)
        covariance = self._covariance(self.deviations(hypothesis, local.data, x), scales)
        return Explanation(hypothesis, x, tuple(map(int, search.free)), average.covariance, worth, scales,
                           average.occam, replace(local.data, predictions=()), local.data.error,
                           self._correlation(covariance.whitened(covariance.whitened(local.data.vector))))

    def _correlation(self, noise: Real) -> float:
        """The number of neighbouring points that carry the information of one, for a residual of `noise` (m,)."""
        parts = [np.split(noise[place], 2) for place in self.places]
        lengths = [correlation_length(real + 1j * imaginary) for real, imaginary in parts]
        return float(np.average(lengths, weights=[real.size for real, _ in parts]))

    def deviations(
        self, hypothesis: Hypothesis, data: Residual, x: Real, level: float = 0.0
    ) -> tuple[Real, Real, Real]:
        """Columns (m, k) of the deviations beside the noise, of size one: within all parts, within one region, and of
        the term."""
        noise = np.sqrt(self.noise**2 + level**2)[:, None]
        outside = np.zeros((self.noise.size, 0))
        if hypothesis.region and self.region_discrepancy is not None:
            outside = compressed_columns(self.region_discrepancy.of_region(hypothesis.region) / noise, REGION_SIZES[-1])
        elif hypothesis.modes:
            outside = columns(self.measured, self.places, hypothesis.modes, self.noise.size) / noise
        return self.columns / noise, outside, self._term_errors(hypothesis, data.jacobian, x)

    def data(self, hypothesis: Hypothesis, x: Real, level: float = 0.0) -> Residual:
        """The data at x (p,) with their derivatives by the parameters of a hypothesis."""
        free = frozenset(self.model.free(hypothesis.effects)[0])
        return self.objective(x, deviation=self.point_deviations(level), free=free)

    def impedances(self, x: Real) -> list[Complex]:
        """Impedance (n,) ohm of every recording as predicted at x (p,)."""
        return [self.objective.predict(x, index, ())[0] for index in range(len(self.objective.recordings))]

    def laplace(self, hypothesis: Hypothesis, x: Real, level: float) -> LaplaceApproximation:
        """The Laplace approximation at x (p,), with points of a further deviation `level`."""
        search = self.search(hypothesis)
        local = self.linearised(hypothesis, search, x, level)
        worth, best, average = local.over_scales()
        errors = np.zeros(x.size)
        errors[search.free] = np.sqrt(np.maximum(np.diag(average.covariance), 0.0))
        if self.model.campaign.inhomogeneity is None and best.accuracy > INACCURATE:
            average = local.averaged(best._replace(accuracy=INACCURATE))
        expected = float(np.sum(self.noise**2 / (self.noise**2 + level**2)))
        return LaplaceApproximation(x, worth - sum(mode.cost for mode in hypothesis.modes), errors, best.accuracy,
                                    average.chi_square / expected, local.data.error)

    def alternatives(
        self, hypothesis: Hypothesis, x: Real, level: float, accuracy: float
    ) -> list[tuple[Hypothesis, float]]:
        """Hypotheses outside the catalogue added to a hypothesis at x (p,), with their log evidences, best first.

        They are a change in each region, and the modes that a model of that `accuracy` seems to lack.
        """
        assert self.region_discrepancy is not None
        noise = np.sqrt(self.noise**2 + level**2)[:, None]
        free = self.region_discrepancy
        found = {replace(hypothesis, region=each): compressed_columns(free.of_region(each) / noise, REGION_SIZES[-1])
                 for each in dict.fromkeys(free.regions)}
        if modes := self.strongest_modes(hypothesis, x, accuracy):
            found[replace(hypothesis, modes=modes)] = columns(
                self.measured, self.places, modes, self.noise.size) / noise
        local = self.linearised(hypothesis, self.search(hypothesis), x, level, np.column_stack(list(found.values())))
        ends = np.cumsum([sum(local.counts[:-1]), *(part.shape[1] for part in found.values())]).tolist()
        worth = local.over_blocks([np.arange(low, high) for low, high in pairwise(ends)], REGION_SIZES)
        worth -= [sum(mode.cost for mode in each.modes) for each in found]
        return sorted(zip(found, worth.tolist(), strict=True), key=lambda each: -each[1])


def _improved(
    best: T, again: Callable[[T, float], T], worth: Callable[[T], float], rounds: int,
    is_lenient: Callable[[T], bool] = lambda _best: True,
) -> T:
    """The best of at most `rounds` rounds that each begin `again` from it, with a factor on the accuracy of the model.

    The factor is one as long as that helps, and then :data:`STRICTER` if the best one `is_lenient`: an inaccurate model
    leaves much that it could explain. The worth of the start does not count: it is no optimum, and far from one the
    tangents predict too large a gain.
    """
    strictness = 1.0
    best = again(best, strictness) if rounds else best
    for _ in range(rounds - 1):
        found = again(best, strictness)
        if worth(found) > worth(best) + ALIKE:
            best = found
        elif strictness < 1.0 or not is_lenient(best):
            break
        else:
            strictness = STRICTER
    return best


def compressed_columns(columns: Real, size: float) -> Real:
    """Fewer columns (m, k) of equal covariance, up to negligible parts at that size."""
    directions, lengths = principal(columns * size, NEGLIGIBLE)
    return np.asarray(directions * lengths / size)
