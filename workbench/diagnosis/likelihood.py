"""The one probability model of a campaign, for any hypothesis about it.

With r = ln(Z_model / Z_measured) of all recordings stacked, real parts and imaginary parts,

    r ~ Normal(0, V + R),    theta ~ the prior of the known numbers,    phi ~ anywhere within its range,

V is diagonal (`weighting`): noise, as much larger as the best explanation leaves with its deviations. R holds
correlated deviations: the inhomogeneity of all parts, and those of a hypothesis: changes of any size within one region,
modes that the model does not have, and the error of its own term, whose parameter is right to
:data:`~workbench.diagnosis.odds.TERM` at any one frequency. Waves in the transducer, whose resonances are too sharp for
deviations that are linear, are amplitudes a ~ Normal(0, s^2) beside theta, about whose likeliest values the problem is
linearised; in evidences they are deviations of R. A search ends at the optimum of least squares with V alone, so that
nothing is fitted by R; evidences and intervals are about the optimum with all deviations (:meth:`Likelihood.whitened`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workbench.campaign.state import DeviceState, data_rows, rms_of_impedance
from workbench.catalogue.effect import Effect
from workbench.diagnosis.device import Model, inhomogeneities
from workbench.diagnosis.evidence import Average, LinearisedProblem, averaged_over_blocks, over_scales
from workbench.diagnosis.modes import Mode, columns
from workbench.diagnosis.odds import REGION_SIZES, TERM
from workbench.diagnosis.weighting import Weighting
from workbench.fitting.covariance import Covariance
from workbench.fitting.objective import Objective, Residual
from workbench.fitting.search import FitSearch, Optimum
from workbench.results.spectrum import Spectrum
from workbench.search.continuation import ContinuationStage

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Cosines along the band that the error of a term is a sum of.
WAVES = 5

#: Points of a recording that a search uses, about.
SEARCHED = 121

#: A relative fall of chi-square that ends a fit, its most steps, and how often its weights are found anew.
ENOUGH, STEPS, REWEIGHTED = 1e-3, 25, 4

#: Times, at most, that the optimum with all deviations is looked for with sizes of these found anew.
WHITENED = 3

#: Step of a parameter without a prior at first, in its standard deviations, and the least share of its range: what is
#: admissible may be a million times what the data determine.
FIRST_STEP, SMALLEST_STEP = 10.0, 1e-9


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

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that its effects move, each once."""
        return tuple(dict.fromkeys(name for effect in self.effects for name in effect.names))


class Scales(NamedTuple):
    """Sizes of the deviations beside the noise: the ``inhomogeneity`` of all parts, the ``size`` of changes outside the
    catalogue, and whether the ``term`` of a hypothesis is right to :data:`TERM` only (1), or exact (0)."""

    inhomogeneity: float
    size: float
    term: float


@dataclass(frozen=True, eq=False)
class LocalProblem:
    """A problem linearised at x: rows in units of the stated noise, which weights may be given to afterwards.

    ``tangents`` (m, p) by the free parameters and the ``residual`` (m,) there; ``parts`` (m, k), ``outside`` (m, l) and
    ``term`` (m, q) deviations of unit size, ``waves`` (m, w) those of waves in the transducer, without which the
    residual is; ``inhomogeneities`` the sizes of both that are averaged over;
    ``information`` (m,) of each row, one over its variance and the rows that carry what one does; the rest as of
    `evidence.LinearisedProblem`.
    """

    tangents: Real
    residual: Real
    waves: Real
    parts: Real
    outside: Real
    term: Real
    inhomogeneities: tuple[float, ...]
    information: Real
    precision: Real
    offset: Real
    widths: Real
    below: Real
    above: Real

    @cached_property
    def settings(self) -> tuple[Scales, ...]:
        """The scales that are averaged over."""
        every = itertools.product(self.inhomogeneities if self.parts.size or self.waves.size else (0.0,),
                                  REGION_SIZES.tolist() if self.outside.size else (0.0,),
                                  (0.0, 1.0) if self.term.size else (0.0,))
        return tuple(itertools.starmap(Scales, every))

    @property
    def without_waves(self) -> LocalProblem:
        """A copy without waves in the transducer."""
        return replace(self, waves=self.waves[:, :0])

    @property
    def without_inhomogeneity(self) -> LocalProblem:
        """A copy whose parts are homogeneous."""
        return replace(self.without_waves, parts=self.parts[:, :0])

    @cached_property
    def problem(self) -> LinearisedProblem:
        """The problem in units of what each row may deviate by."""
        return self._problem(np.zeros((self.residual.size, 0)))

    def _problem(self, further: Real) -> LinearisedProblem:
        deviations = np.column_stack([self._beside, further])
        return LinearisedProblem.of(
            self.tangents * self.root[:, None], self.residual * self.root, deviations * self.root[:, None],
            precision=np.diag(self.precision**2), offset=self.offset, widths=self.widths, below=self.below,
            above=self.above)

    @cached_property
    def root(self) -> Real:
        """One over what each row (m,) may deviate by."""
        return np.sqrt(self.information)

    @cached_property
    def _beside(self) -> Real:
        """The deviations (m, k) of unit size beside the noise."""
        return np.column_stack([self.waves, self.parts, self.outside, self.term])

    @property
    def unit_deviations(self) -> Real:
        """The deviations (m, k) of unit size beside the noise, in units of what each row may deviate by."""
        return self._beside * self.root[:, None]

    def expanded(self, scales: Scales, further: int = 0) -> Real:
        """The scale of every deviation, zero of `further` ones."""
        return np.repeat([*scales, 0.0], [*self._counts, further])

    @property
    def _counts(self) -> tuple[int, int, int]:
        return self.waves.shape[1] + self.parts.shape[1], self.outside.shape[1], self.term.shape[1]

    def deviations(self, scales: Scales) -> Real:
        """The deviations (m, k) beside the noise at their `scales`, in units of what each row may deviate by."""
        every = self._beside * self.expanded(scales)
        return every[:, every.any(axis=0)] * self.root[:, None]

    def deviating(self, scales: Scales) -> Covariance:
        """The covariance of the rows with the deviations beside the noise at their `scales`."""
        return Covariance.of(self.deviations(scales))

    def covariance(self, scales: Scales) -> Real:
        """Covariance (p, p) of the estimate by least squares where the deviations beside the noise are so large.

        H^-1 (H + J^T R J) H^-1, H the information of the data and the prior. A parameter without a prior that is at an
        end of its range does not move.
        """
        least = replace(self.without_inhomogeneity, outside=self.outside[:, :0], term=self.term[:, :0])
        plain = least.best[2].covariance
        along = plain @ (self.tangents * self.root[:, None]).T @ self.deviations(scales)
        return np.asarray(plain + along @ along.T)

    @property
    def remainder(self) -> Real:
        """The part of the residual (m,), in units of the noise, that neither parameters nor deviations take where these
        are likeliest, at the scales of the largest evidence."""
        _, scales, average = self.best
        whole = self.residual + self.tangents @ average.step
        return whole - self.deviating(scales).expected(whole * self.root) / self.root

    def averaged(self, scales: Scales) -> Average:
        """Over the parameters."""
        return self.problem.averaged(self.expanded(scales))

    @cached_property
    def best(self) -> tuple[float, Scales, Average]:
        """ln of the mean evidence over all settings, the best of these and the average at it."""
        worth, best, average = over_scales(self.problem, [self.expanded(each) for each in self.settings])
        return worth, self.settings[best], average

    def with_each(self, blocks: Sequence[Real]) -> Real:
        """ln of the mean evidence over all settings with each of some blocks of further deviations (m, k), averaged
        over their sizes: (blocks,)."""
        further = np.column_stack(blocks)
        problem, start = self._problem(further), sum(self._counts)
        ends = start + np.cumsum([0, *(each.shape[1] for each in blocks)])
        return averaged_over_blocks(problem, [self.expanded(each, further.shape[1]) for each in self.settings],
                                    [np.arange(low, high) for low, high in pairwise(ends.tolist())], REGION_SIZES)

    def informed(self, weighting: Weighting) -> LocalProblem:
        """A copy with other weights of the points."""
        return replace(self, information=1.0 / (weighting.variances() * weighting.counts))


class LaplaceApproximation(NamedTuple):
    """Laplace's approximation of a posterior at ``x`` (p,), where a search goes on from: ``log_evidence``, standard
    deviations ``errors`` (p,), ``reduced_chi_square`` with the deviations that points were given, and the
    ``error_estimate`` of Z (relative)."""

    x: Real
    log_evidence: float
    errors: Real
    reduced_chi_square: float
    error_estimate: float


@dataclass(frozen=True, eq=False)
class Explanation:
    """A hypothesis at its optimum.

    ``x`` (p,) all parameters, and what is left there; ``free`` the indices of those that move; ``local`` the problem
    linearised at ``likeliest`` (p,), the optimum with the correlated deviations, and with the ``weighting`` that its
    evidence is by: its own at first, and then that of the best explanation. The two are one point where that optimum
    leaves hardly more than least squares; where it leaves more, x is that of least squares.
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

    def weighted(self, weighting: Weighting) -> Explanation:
        """A copy with other weights of the points."""
        return replace(self, weighting=weighting, local=self.local.informed(weighting))

    @property
    def log_evidence(self) -> float:
        """The log evidence, up to a constant of all hypotheses with these weights."""
        return self.local.best[0] - sum(mode.cost for mode in self.hypothesis.modes)

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
        """Half the sum of squares that least squares with these weights makes least, with the rows of the priors."""
        offset = self.local.offset + (self.x - self.likeliest)[list(self.free)]
        return 0.5 * (self.weighting.chi_square(self.log_ratio) + float(np.sum((offset * self.local.precision) ** 2)))

    @property
    def remainder(self) -> list[Complex]:
        """The part of every recording (n,) that neither parameters nor deviations take, as :attr:`log_ratio`."""
        found, whole = [], self.local.remainder
        for state, rows in zip(self.weighting.states, data_rows(self.weighting.states), strict=True):
            real, imaginary = np.split(whole[rows], 2)
            found.append(np.asarray(state.noise * (real + 1j * imaginary), dtype=np.complex128))
        return found

    @property
    def rms(self) -> float:
        """The rms of ln(Z_model / Z_measured) over all points."""
        return rms_of_impedance(self.weighting.states, self.log_ratio)

    @property
    def chi_square(self) -> float:
        """The sum of squares of what is left at x, in units of the stated noise."""
        return Weighting.stated(self.weighting.states).chi_square(self.log_ratio)

    @property
    def inflation(self) -> float:
        """The largest inflation of the noise of a recording by what this explanation leaves with its deviations."""
        return Weighting.left(self.weighting.states, self.remainder).largest

    @property
    def misfit(self) -> float:
        """The largest inflation of the noise of a recording by what its numbers alone leave."""
        return Weighting.left(self.weighting.states, self.log_ratio).largest

    def error(self, index: int) -> float:
        """Standard deviation of the parameter of that index."""
        return float(self.errors[index])

    @cached_property
    def errors(self) -> Real:
        """Standard deviations of all parameters (p,), zero of those that do not move."""
        found = np.zeros(self.x.size)
        found[list(self.free)] = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return found


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The recordings of an objective, and the models that predict them within some ranges."""

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
        """Deviations (n,) of every recording's points, of the stated noise and a further deviation `level`."""
        steps = every or [1] * len(self.objective.recordings)
        return [np.sqrt(state.noise[::step] ** 2 + level**2)
                for state, step in zip(self.states, steps, strict=True)]

    def search(self, hypothesis: Hypothesis, *, with_waves: bool = False) -> FitSearch:
        """The least-squares problem under a hypothesis, with the amplitudes of waves in the transducer if wanted."""
        free, released = self.model.free(hypothesis.effects)
        free += [*self.model.uneven] if with_waves else []
        return FitSearch(self.objective, free=free, released=released, refusals=self.model.refusals)

    def solve(self, search: FitSearch, stage: ContinuationStage, x: Real) -> Optimum:
        """The optimum of a stage from x (p,), on few of the points."""
        every = [own.step(SEARCHED) for own in search.objective.recordings]
        thin = search.with_objective(search.objective.thinned(SEARCHED))
        return thin.solve(stage, x, self.point_deviations(stage.deviation, every))

    def data(self, hypothesis: Hypothesis, x: Real) -> Residual:
        """The data at x (p,), in units of the stated noise, with their derivatives by the parameters of a hypothesis.
        """
        free = frozenset([*self.model.free(hypothesis.effects)[0], *self.model.uneven])
        return self.objective(x, deviation=self.point_deviations(), free=free)

    def impedances(self, x: Real) -> list[Complex]:
        """Impedance (n,) ohm of every recording as predicted at x (p,)."""
        return [self.objective.predict(x, index, ())[0] for index in range(len(self.objective.recordings))]

    def linearised(self, hypothesis: Hypothesis, search: FitSearch, x: Real, data: Residual) -> LocalProblem:
        """The problem linearised at x (p,), where the `data` are, with the weights of the stated noise."""
        free = search.free
        parameters = [self.model.parameters[i] for i in free]
        waves = list(self.model.uneven)
        return LocalProblem(
            data.jacobian[:, free], data.vector - data.jacobian[:, waves] @ x[waves],
            data.jacobian[:, waves] * self._unit_waves, np.zeros((self.noise.size, 0)), self._outside(hypothesis),
            self._term_errors(hypothesis, data, x), inhomogeneities(self.model.campaign),
            np.ones(self.noise.size), search.precision[free], (x - search.centre)[free],
            np.array([np.nan if search.precision[i] > 0.0 else p.high - p.low
                      for i, p in zip(free, parameters, strict=True)]),
            np.array([x[i] - p.low for i, p in zip(free, parameters, strict=True)]),
            np.array([p.high - x[i] for i, p in zip(free, parameters, strict=True)]))

    @cached_property
    def _unit_waves(self) -> Real:
        """Deviations (w,) of the amplitudes of the waves in an inhomogeneity of a relative size of one."""
        largest = inhomogeneities(self.model.campaign)[-1]
        return np.array([self.model.parameters[i].scale / largest for i in self.model.uneven])

    def _outside(self, hypothesis: Hypothesis) -> Real:
        """The change of the data (m, k), in units of the noise, by modes that the model does not have."""
        return columns(self.measured, self.places, hypothesis.modes, self.noise.size) / self.noise[:, None]

    def _term_errors(self, hypothesis: Hypothesis, data: Residual, x: Real) -> Real:
        """The change of the data (m, k) by errors of a hypothesis' own terms: of each parameter, along the band, state
        by state.

        A hypothesis that only moves numbers of the model brings no term, and no error of one.
        """
        own = [self.model.index(name) for effect in hypothesis.effects if effect.terms for name in effect.names]
        if not own:
            return np.zeros((self.noise.size, 0))
        moved = x[own] - self.model.stated[own]
        whole, found = data.jacobian[:, own] @ moved, []
        for state, rows in zip(self.states, self.places, strict=True):
            for wave in range(WAVES):
                column = np.zeros(whole.size)
                along = np.cos(np.pi * wave * np.linspace(0.0, 1.0, state.noise.size))
                column[rows] = whole[rows] * np.tile(along, 2) * (math.sqrt(2.0) if wave else 1.0)
                found.append(column * TERM / math.sqrt(WAVES))
        return np.stack(found, axis=1)

    def laplace(self, hypothesis: Hypothesis, x: Real, level: float) -> LaplaceApproximation:
        """The Laplace approximation at x (p,), with points of a further deviation `level`."""
        search, data = self.search(hypothesis), self.data(hypothesis, x)
        local = self.linearised(hypothesis, search, x, data)
        share = self.noise**2 / (self.noise**2 + level**2)
        local = replace(local, information=share)
        worth, _, average = local.best
        errors = np.zeros(x.size)
        errors[search.free] = np.sqrt(np.maximum(np.diag(average.covariance), 0.0))
        return LaplaceApproximation(x, worth, errors, average.chi_square / self.noise.size, data.error)

    def refit(self, hypothesis: Hypothesis, x: Real, *, limit: int = STEPS) -> Explanation:
        """The optimum near x (p,), where every recording is weighted by what its own residual shows.

        Raises:
            NotConverged, NotEnriched, MeshError, InputError, ValueError: nothing near x can be predicted, or is
                admissible.
        """
        search = self.search(hypothesis)
        weighting = self._scaled(search, hypothesis, x)
        for _ in range(REWEIGHTED):
            x = search.minimise(x, weighting.deviations(), limit=limit, tolerance=ENOUGH).x
            before, data = weighting, self.data(hypothesis, x)
            weighting = Weighting.left(self.states, data.log_ratio)
            if weighting.is_near(before):
                break
        return self.explanation(hypothesis, x, data).weighted(weighting)

    def explanation(self, hypothesis: Hypothesis, x: Real, data: Residual | None = None) -> Explanation:
        """A hypothesis at x (p,), with the weights of the stated noise."""
        search, data = self.search(hypothesis), self.data(hypothesis, x) if data is None else data
        return Explanation(hypothesis, x, x, tuple(map(int, search.free)), self.linearised(hypothesis, search, x, data),
                           Weighting.stated(self.states), data.log_ratio, data.impedance, data.error)

    def whitened(self, found: Explanation) -> tuple[Explanation, Residual]:
        """An explanation with its problem at the optimum with all its deviations, and the data there.

        Waves in the transducer act there as parameters, with the prior of an inhomogeneity of the likeliest size. The
        weights are those of what parameters and deviations leave together.

        Raises:
            NotConverged, NotEnriched, MeshError, InputError, ValueError: nothing near it can be predicted.
        """
        plain, search = (self.search(found.hypothesis, with_waves=acting) for acting in (False, True))
        waves, parts = list(self.model.uneven), found.local.parts
        for _ in range(WHITENED):
            search.scale[waves] = found.scales.inhomogeneity * self._unit_waves
            search.precision[waves] = 1.0 / search.scale[waves]
            spreads = [np.sqrt(points) * each for points, each in zip(
                found.weighting.points, found.weighting.deviations(), strict=True)]
            under = search.with_covariance(found.local.without_waves.deviating(found.scales))
            x = under.minimise(found.likeliest, spreads, limit=STEPS, tolerance=ENOUGH).x
            data = self.data(found.hypothesis, x)
            local = self.linearised(found.hypothesis, plain, x, data)
            there = replace(found, likeliest=x, local=replace(local, parts=parts, information=found.local.information))
            before, found = found, there.weighted(Weighting.left(self.states, there.remainder))
            if found.scales == before.scales and found.weighting.is_near(before.weighting):
                break
        return found, data

    def _scaled(self, search: FitSearch, hypothesis: Hypothesis, x: Real) -> Weighting:
        """The weights at x (p,), by which the steps of parameters without a prior are scaled."""
        data = self.data(hypothesis, x)
        weighting = Weighting.left(self.states, data.log_ratio)
        local = self.linearised(hypothesis, search, x, data)
        errors = np.sqrt(np.diag(replace(local, information=1.0 / weighting.variances()).best[2].covariance))
        for i, error in zip(search.free, errors, strict=True):
            if self.model.parameters[i].name in hypothesis.names:
                width = search.high[i] - search.low[i]
                search.scale[i] = float(np.clip(FIRST_STEP * error, SMALLEST_STEP * width, width))
        return weighting
