"""The one probability model of a campaign, for any hypothesis about it.

With r = ln(Z_measured / Z_model) of all recordings stacked, real parts and imaginary parts,

    r ~ Normal(0, W + tau^2 K K^T + R),    theta ~ what is known of it,    phi ~ anywhere within its range,

W is the noise of the points, K what smooth changes within the parts do (`inaccuracy`) and tau the accuracy of the
model, stated or averaged over; R what a hypothesis allows besides: changes of any size within one region, and the error
of its own term, whose parameter is right to :data:`~workbench.diagnosis.criteria.TERM` at any one frequency.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.criteria import ACCURACIES, REGION_SIZES, TERM
from workbench.diagnosis.device import Model
from workbench.diagnosis.evidence import Average, Linearised, over_scales
from workbench.diagnosis.hypothesis import Effect
from workbench.diagnosis.inaccuracy import Patterns, patterns
from workbench.diagnosis.modes import Mode, columns, strongest
from workbench.fitting.covariance import Covariance, principal
from workbench.fitting.objective import Objective, Residual
from workbench.fitting.search import Optimum, Search
from workbench.spectrum import Spectrum

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Cosines along the band that the error of a term is a sum of.
WAVES = 5

#: A recording is searched on about so many of its points while the data weigh little.
SEARCHED = 121

#: Rounds of a fit: the accuracy of the model is that of the largest evidence at the last optimum.
ROUNDS = 3

#: A relative fall of chi-square that ends a fit, and its most steps.
ENOUGH, STEPS = 1e-3, 25


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """What may be wrong: some ``effects`` of the catalogue, a ``region`` with anything in it, or ``modes`` that the
    model does not have; none of these, if nothing is."""

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
        """Whether it says that the catalogue does not have it."""
        return bool(self.region or self.modes)


@dataclass(frozen=True, eq=False)
class Explanation:
    """A hypothesis at its optimum.

    ``x`` (p,) all parameters; ``free`` the indices of those that move and ``covariance`` of them; ``log_evidence`` up
    to what all hypotheses share; ``accuracy`` of the model and ``size`` of the changes in its region, both of the
    largest evidence; ``residual`` the data there, in units of the noise; ``occam`` what the ranges of its parameters
    cost of the evidence; ``doubt`` the estimated relative error of Z.
    """

    hypothesis: Hypothesis
    x: Real
    free: tuple[int, ...]
    covariance: Real
    log_evidence: float
    accuracy: float
    size: float
    occam: float
    residual: Residual
    doubt: float

    def error(self, index: int) -> float:
        """Standard deviation of the parameter of that index."""
        at = self.free.index(index)
        return float(math.sqrt(max(self.covariance[at, at], 0.0)))

    def spread(self, size: int) -> Real:
        """Standard deviations of all of so many parameters, zero of those that do not move."""
        found = np.zeros(size)
        found[list(self.free)] = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return found


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The recordings, the models that predict them in some neighbourhood, and what these do not get right.

    ``columns`` (m, k) what the smooth changes within all parts do to ln Z at a relative size of one; ``anything`` the
    same of every region, with losses of any size, for hypotheses of a region.
    """

    model: Model
    objective: Objective
    columns: Real
    anything: Patterns | None = None

    @classmethod
    def bare(cls, model: Model, objective: Objective) -> Likelihood:
        """Of noise alone."""
        return cls(model, objective, np.zeros((sum(2 * s.noise.size for s in model.campaign.fitted), 0)))

    def on(self, objective: Objective) -> Likelihood:
        """The same, predicted by other models."""
        return replace(self, objective=objective)

    def with_patterns(self, x: Real) -> Likelihood:
        """The same with what the model does not get right at x (p,)."""
        whole = patterns(self.objective, x)
        sizes = self.noise[:, None] / ACCURACIES[-1]
        directions, lengths = principal(whole.columns / sizes, NEGLIGIBLE)
        return replace(self, columns=directions * lengths * sizes,
                       anything=patterns(self.objective, x, absolute_loss=True))

    @cached_property
    def noise(self) -> Real:
        """Standard deviation of every datum (m,)."""
        return np.concatenate([np.tile(state.noise, 2) for state in self.model.campaign.fitted])

    @cached_property
    def measured(self) -> list[Spectrum]:
        """The recordings."""
        return [recording.measured for recording in self.objective.recordings]

    @cached_property
    def places(self) -> list[slice]:
        """Where each recording is among the data."""
        ends = np.cumsum([0, *(2 * each.frequency.size for each in self.measured)]).tolist()
        return [slice(low, high) for low, high in pairwise(ends)]

    def strongest_modes(self, x: Real, accuracy: float) -> tuple[Mode, ...]:
        """The modes that the model seems to lack at x (p,), one at most in every body that was recorded."""
        search = self.search(Hypothesis())
        data = self.objective(x, deviation=self.spreads(), free=frozenset(map(int, search.free)))
        whiten = Covariance.of(self.columns / self.noise[:, None] * accuracy).whitened
        precision = np.diag(search.precision[search.free])
        nuisances, _ = np.linalg.qr(np.vstack([whiten(data.jacobian[:, search.free]), precision]))
        # Whitened, and without what known parameters imitate; the rows of the priors are nothing to a mode.
        basis = whiten(np.eye(self.noise.size))
        projected = np.vstack([basis, np.zeros((precision.shape[0], basis.shape[1]))])
        projected = projected - nuisances @ (nuisances[: self.noise.size].T @ basis)
        residual = np.concatenate([whiten(data.vector), (x - search.centre)[search.free] * np.diag(precision)])
        residual = residual - nuisances @ (nuisances.T @ residual)
        bodies: dict[object, list[int]] = {}
        for index, predictor in enumerate(self.objective.predictors):
            bodies.setdefault(predictor, []).append(index)
        return strongest(self.measured, self.places, list(bodies.values()), self.noise, projected.T, residual,
                         REGION_SIZES)

    def spreads(self, level: float = 0.0, every: Sequence[int] | None = None) -> list[Real]:
        """Deviations (n,) of every recording's points that weigh less by a further deviation `level`."""
        steps = every or [1] * len(self.objective.recordings)
        return [np.sqrt(state.noise[::step] ** 2 + level**2)
                for state, step in zip(self.model.campaign.fitted, steps, strict=True)]

    def search(self, hypothesis: Hypothesis) -> Search:
        """The least-squares problem under a hypothesis, with noise alone."""
        free, released = self.model.free(hypothesis.effects)
        return Search(self.objective, free=free, released=released)

    def search_of_all(self) -> Search:
        """The least-squares problem in which everything is free."""
        return Search(self.objective, free=range(len(self.model.parameters)))

    def tempered(
        self, search: Search, x: Real, level: float, *, limit: int = 8, fixed: tuple[int, ...] = ()
    ) -> Optimum:
        """The least cost near x (p,) where points weigh less, by a further deviation `level`, on few of them."""
        thin = search.objective.thinned(SEARCHED)
        every = [max(1, round(own.measured.frequency.size / SEARCHED)) for own in search.objective.recordings]
        return search.on(thin).minimise(x, self.spreads(level, every), limit=limit, tolerance=0.01, fixed=fixed)

    def linearised(
        self, hypothesis: Hypothesis, search: Search, x: Real, level: float = 0.0, data: Residual | None = None
    ) -> tuple[Linearised, list[Real], Residual]:
        """The problem at x (p,), the settings of the scales that are averaged over, and the `data` there."""
        free = search.free
        if data is None:
            data = self.data(hypothesis, x, level)
        parameters = [self.model.parameters[i] for i in free]
        general, region, term = self._deviations(hypothesis, data, x, level)
        problem = Linearised.of(
            data.jacobian[:, free], data.vector, np.column_stack([general, region, term]),
            precision=np.diag(search.precision[free] ** 2), offset=(x - search.centre)[free],
            widths=np.array([np.nan if search.precision[i] > 0.0 else p.high - p.low
                             for i, p in zip(free, parameters, strict=True)]),
            below=np.array([x[i] - p.low for i, p in zip(free, parameters, strict=True)]),
            above=np.array([p.high - x[i] for i, p in zip(free, parameters, strict=True)]))
        stated = self.model.campaign.model_accuracy
        taus = ACCURACIES if stated is None else np.array([stated])
        sizes = REGION_SIZES if hypothesis.is_outside else np.zeros(1)
        settings = [np.concatenate([np.full(general.shape[1], tau), np.full(region.shape[1], size),
                                    np.ones(term.shape[1])]) for tau in taus for size in sizes]
        return problem, settings, data

    def _term(self, hypothesis: Hypothesis, tangents: Real, x: Real) -> Real:
        """What an error of a hypothesis' own terms does (m, k): of each parameter, along the band, state by state.

        What only moves a number that the model has already brings no term, and no error of one.
        """
        own = [self.model.index(name) for effect in hypothesis.effects if effect.terms for name in effect.names]
        if not own:
            return np.zeros((self.noise.size, 0))
        moved = x[own] - np.array([self.model.parameters[i].start for i in own])
        whole, columns, start = tangents[:, own] @ moved, [], 0
        for state in self.model.campaign.fitted:
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
        """What deviates beside the noise where an explanation ended."""
        hypothesis, x = explanation.hypothesis, explanation.x
        general, outside, term = self._deviations(hypothesis, self.data(hypothesis, x), x)
        return Covariance.of(np.column_stack([general * explanation.accuracy, outside * explanation.size, term]))

    def settled(self, hypothesis: Hypothesis, x: Real, *, rounds: int = ROUNDS, limit: int = STEPS) -> Explanation:
        """The optimum of the posterior near x (p,), with all data in full, and the evidence there.

        Raises:
            NotConverged, NotEnriched, MeshError, InputError, ValueError: nothing near x can be predicted, or is
                admissible.
        """
        search = self.search(hypothesis)
        own = [self.model.index(name) for effect in hypothesis.effects for name in effect.names]
        chosen = -1
        for _ in range(rounds):
            problem, settings, data = self.linearised(hypothesis, search, x)
            worth, best, average = over_scales(problem, settings)
            if best == chosen:
                break
            chosen = best
            for i, deviation in zip(search.free, np.sqrt(np.diag(average.covariance)), strict=True):
                if i in own:
                    # What is admissible may be a million times what the data see.
                    width = search.high[i] - search.low[i]
                    search.scale[i] = float(np.clip(10.0 * deviation, 1e-9 * width, width))
            scales = settings[best]
            columns = np.column_stack(self._deviations(hypothesis, data, x)) * scales
            under = search.under(Covariance.of(columns))
            x = under.minimise(x, self.spreads(), limit=limit, tolerance=ENOUGH).x
        else:
            problem, settings, data = self.linearised(hypothesis, search, x)
            worth, best, average = over_scales(problem, settings)
        return self._explanation(hypothesis, search, x, data, worth, settings[best], average)

    def _deviations(
        self, hypothesis: Hypothesis, data: Residual, x: Real, level: float = 0.0
    ) -> tuple[Real, Real, Real]:
        """What deviates beside the noise (m, k), at a size of one: within all parts, within one, and of the term."""
        noise = np.sqrt(self.noise**2 + level**2)[:, None]
        outside = np.zeros((self.noise.size, 0))
        if hypothesis.region and self.anything is not None:
            outside = reduced(self.anything.within(hypothesis.region) / noise, REGION_SIZES[-1])
        elif hypothesis.modes:
            outside = columns(self.measured, self.places, hypothesis.modes, self.noise.size) / noise
        return self.columns / noise, outside, self._term(hypothesis, data.jacobian, x)

    def data(self, hypothesis: Hypothesis, x: Real, level: float = 0.0) -> Residual:
        """The data at x (p,) and what all that moves under a hypothesis does to them."""
        return self.objective(x, deviation=self.spreads(level), free=frozenset(self.model.free(hypothesis.effects)[0]))

    def weighed(
        self, hypothesis: Hypothesis, x: Real, level: float, data: Residual | None = None
    ) -> tuple[float, Real]:
        """The log evidence at x (p,) with points that weigh less, and the standard deviations (p,) there."""
        search = self.search(hypothesis)
        problem, settings, _ = self.linearised(hypothesis, search, x, level, data)
        worth, _, average = over_scales(problem, settings)
        worth -= sum(mode.cost for mode in hypothesis.modes)
        errors = np.zeros(x.size)
        errors[search.free] = np.sqrt(np.maximum(np.diag(average.covariance), 0.0))
        return worth, errors

    def _explanation(
        self, hypothesis: Hypothesis, search: Search, x: Real, data: Residual, worth: float, scales: Real,
        average: Average
    ) -> Explanation:
        count = self.columns.shape[1]
        size = float(scales[count]) if hypothesis.is_outside and scales.size > count else 0.0
        worth -= sum(mode.cost for mode in hypothesis.modes)
        return Explanation(hypothesis, x, tuple(map(int, search.free)), average.covariance, worth,
                           float(scales[0]) if count else 0.0, size, average.occam,
                           replace(data, predictions=()), data.error)

    def predictive(self, explanation: Explanation, held: Objective) -> tuple[float, tuple[Complex, ...]]:
        """The log density of states held out as an explanation predicts them, and their impedances (n,) ohm.

        With the uncertainty of its parameters and the inaccuracy of the model; up to what all hypotheses share.
        """
        states = self.model.campaign.held_out
        noise = np.concatenate([np.tile(state.noise, 2) for state in states])
        data = held(explanation.x, deviation=[state.noise for state in states], free=explanation.free)
        tangents = data.jacobian[:, list(explanation.free)]
        values, vectors = np.linalg.eigh(explanation.covariance)
        uncertain = tangents @ (vectors * np.sqrt(np.maximum(values, 0.0)))
        smooth = patterns(held, explanation.x).columns / noise[:, None] * explanation.accuracy
        covariance = Covariance.of(np.column_stack([uncertain, smooth]))
        left = covariance.whitened(data.vector)
        return -0.5 * (float(left @ left) + covariance.log_determinant), data.impedance


#: Directions that deviate by less than this share of the noise even at the largest size are left out.
NEGLIGIBLE = 0.03


def reduced(columns: Real, size: float) -> Real:
    """Fewer columns (m, k) of the same covariance, but for what is negligible at that size."""
    directions, lengths = principal(columns * size, NEGLIGIBLE)
    return np.asarray(directions * lengths / size)
