"""A hypothesis taken seriously: its parameters and the known ones refitted together, and what that is worth.

The evidence of a hypothesis is the likelihood of the recordings averaged over what its parameters may be (Laplace's
approximation; MacKay 2003, Information Theory, Inference, and Learning Algorithms, chapter 28): a fit that needs its
parameter at one of a thousand admissible places is worth less than one that would have done anywhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.device import Model
from workbench.diagnosis.hypothesis import Effect
from workbench.diagnosis.score import Score, Tangents, columns, occam_factor
from workbench.diagnosis.state import StateFit as StateFit
from workbench.diagnosis.state import state_fit
from workbench.fitting.parameter import shown_factor, shown_unit
from workbench.fitting.search import NO_END, Search, Weighted
from workbench.fitting.uncertainty import DEVIATIONS

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: A relative fall of chi-square that ends a refit; of a thousand points, one tenth of a unit.
ENOUGH = 1e-4

#: The first bases serve while the known parameters move by so many of their uncertainties.
MOVES = 1.5

#: Bases are made again about each optimum, at most so many times, until that finds no chi-square better by this, or by
#: this share of what noise does not explain.
CENTRED, SAME, SHARE = 3, 2.0, 0.02

#: What these moves bring into a basis is left out where an error of Z of this, relative, does not need it.
UNNEEDED = 1e-5

#: They serve while parameters move by so many of their standard errors there, and need not be made again where the
#: estimated relative error of Z, which is ten to a hundred times the true one, is below the second number; no step is
#: taken to where it is above the third, or so many times that of the optimum they were made about.
ERRORS, TRUSTED, DOUBTED, TIMES = 3.0, 0.03, 0.3, 3.0

#: Steps of a refit, and of a look at another basin.
STEPS, GLANCE = 25, 8

#: A term describes its effect to about this share of it, whatever the noise: what resolved computations find of most of
#: them, see the tests of `workbench.physics`.
MODELLED = 0.02

#: Reduced chi-square of a fit that leaves nothing: three standard deviations above one for a thousand numbers, and
#: what the model's own error adds; of all states, and of one.
GOOD, GOOD_STATE = 1.15, 1.3

#: A refit searches so many times what the score test asks for, or the standard errors it gives.
WIDEST = 30.0

#: It begins with the best of these shares of what the score test asks for.
SHARES = (1.0, 0.1, 0.0)

#: It begins no closer to the end of its range than this share of it.
AT_END = 1e-4


@dataclass(frozen=True, eq=False)
class Refit:
    """The optimum of the known parameters together with those of some hypotheses (none: the base model).

    ``x`` (p,) all parameters; ``here`` the residuals there, without the predictions behind them; ``doubt`` the largest
    estimated relative error of these; ``chi_square`` of the data and the prior; ``estimate`` and ``error`` of the
    hypotheses' own parameters by name, of noise and of the terms themselves (:data:`MODELLED`); ``occam_factor``
    what their ranges cost (twice the logarithm of the Occam factor); ``shifts`` known parameters in units of their
    prior; ``states`` one for each fitted state.
    """

    effects: tuple[Effect, ...]
    search: Search
    x: Real
    here: Weighted
    doubt: float
    chi_square: float
    points: int
    estimate: dict[str, float]
    error: dict[str, float]
    occam_factor: float
    shifts: dict[str, float]
    states: tuple[StateFit, ...]

    @property
    def evidence(self) -> float:
        """Minus twice the logarithm of the evidence, up to a constant shared by all hypotheses: smaller is better."""
        return self.chi_square + self.occam_factor

    @property
    def reduced(self) -> float:
        """Reduced chi-square of all data and priors: as many priors as known parameters."""
        return self.chi_square / (2.0 * self.points - len(self.estimate))

    @property
    def name(self) -> str:
        return " and ".join(e.name for e in self.effects)

    @property
    def correlation(self) -> float:
        """The number of neighbouring points that carry the information of one, on average over the states."""
        return float(np.mean([state.correlation for state in self.states]))

    @property
    def good(self) -> bool:
        """Whether it leaves nothing but noise."""
        return self.reduced < GOOD and all(s.reduced < GOOD_STATE for s in self.states)

    @property
    def prior_pull(self) -> float:
        """How far the known parameters are from what is known of them, in its units (rms)."""
        return float(np.sqrt(np.mean(np.square(list(self.shifts.values()))))) if self.shifts else 0.0

    @property
    def worth(self) -> float:
        """A fall of chi-square that is worth a further step."""
        return SAME + SHARE * max(self.chi_square - 2.0 * self.points, 0.0)

    @property
    def at_bounds(self) -> list[str]:
        """Parameters that ended at a bound of what they may be."""
        allowed = [(self.search.parameters[i], float(self.x[i])) for i in self.search.free]
        return [p.name for p, value in allowed if min(value - p.low, p.high - value) < AT_END * (p.high - p.low)]

    def tangents(self) -> Tangents:
        return Tangents.at(self.search, self.here)

    def interval(self, name: str) -> tuple[float, float]:
        """The 95 % interval of a parameter, within its bounds."""
        index = next(i for i, p in enumerate(self.search.parameters) if p.name == name)
        value, error = self.estimate[name], self.error[name]
        known = self.search.parameters[index]
        return (float(max(value - DEVIATIONS * error, known.low)), float(min(value + DEVIATIONS * error, known.high)))

    def in_words(self) -> str:
        """The parameters with their 95 % intervals, in the units they are shown in."""
        units = {p.name: p.unit for p in self.search.parameters}
        said = []
        for name, estimate in self.estimate.items():
            unit = units[name]
            value, low, high = shown_factor(unit) * np.array([estimate, *self.interval(name)])
            said.append(f"{name} = {value:.4g} {shown_unit(unit)}".rstrip() + f" ({low:.4g} to {high:.4g})")
        return "; ".join(said)


def base_fit(model: Model) -> tuple[tuple[StateFit, ...], Refit, Real]:
    """The states as stated, the known parameters alone fitted from there, and the end (p,) of the descent to that.

    The descent leads through smoothed spectra (`Search.descend`).
    """
    free, released = model.free(())
    search = Search(model.fitted, free=free, released=released)
    deviation = model.deviations()
    model.fitted.cover(search.centre, known_reach(model, (), search.centre), UNNEEDED)
    stated = model.fitted(search.centre, deviation=deviation)
    nominal = tuple(state_fit(s.name, log, z, s.noise) for s, log, z in zip(
        model.campaign.fitted, stated.log_ratio, stated.impedance, strict=True))
    x = search.thinned().descend(search.centre, lambda: None).x
    return nominal, refit_at(model, (), search, search.minimise(x, deviation, limit=STEPS, tolerance=ENOUGH).x), x


def leaves_less(fit: Refit, base: Refit, share: float) -> bool:
    """Whether a fit leaves less than a share of what the base leaves and noise does not explain."""
    return fit.reduced - 1.0 < share * (base.reduced - 1.0)


def known_reach(model: Model, effects: Sequence[Effect], x: Real) -> dict[str, float]:
    """How far known parameters may move, and those of `effects`: as far as they have come at x (p,)."""
    reach = {p.name: MOVES * p.prior for p in model.parameters[:model.known] if p.prior}
    for name in (name for effect in effects for name in effect.names):
        i = model.index(name)
        reach[name] = max(reach.get(name, 0.0), abs(float(x[i] - model.parameters[i].start)))
    return reach


def rebuild_and_refine(model: Model, fit: Refit, scores: Sequence[Score] = ()) -> Refit:
    """A fit once more, with bases made for its own neighbourhood and that of the hypotheses in `scores`."""
    deviation = model.deviations()
    before = np.inf
    for _ in range(CENTRED):
        free = fit.search.free
        jacobian = fit.here.jacobian[:, free] * fit.search.scale[free]
        spread = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian))) * fit.search.scale[free]
        reach = {model.parameters[i].name: ERRORS * float(error) for i, error in zip(free, spread, strict=True)}
        for scored in scores:
            for name, amplitude, error in zip(scored.effect.names, scored.amplitude, scored.error, strict=True):
                if np.isfinite(error):
                    reach[name] = max(reach.get(name, 0.0), abs(float(amplitude)) + ERRORS * float(error))
        # Where next to nothing is left of a layer, the search begins with more, which is another matter.
        begin = fit.search.inside(fit.x)
        model.fitted.cover(begin, reach, UNNEEDED)
        centre = fit.search.evaluate(begin, deviation)
        found = fit.search.minimise(begin, deviation, limit=STEPS, tolerance=ENOUGH, radius=0.3,
                                    trusted=max(DOUBTED, TIMES * centre.data.error))
        fit = refit_at(model, fit.effects, fit.search, found.x)
        # The first bases were made for another place, and so was the chi-square they gave here.
        if fit.doubt < TRUSTED or min(float(centre.vector @ centre.vector), before) - fit.chi_square < fit.worth:
            break
        before = fit.chi_square
    return fit


def refit(model: Model, effects: Sequence[Effect], start: Real, scores: Sequence[Score]) -> Refit | None:
    """The optimum under `effects` together, from x (p,) with their parameters where `scores` put them.

    None where nothing can be predicted, or no admissible point lies near.
    """
    deviation = model.deviations()
    try:
        search, begin = initial_point(model, effects, start, scores, deviation)
        found = search.minimise(begin, deviation, limit=STEPS, tolerance=ENOUGH)
    except NO_END:
        return None
    return refit_at(model, tuple(effects), search, found.x)


def without(model: Model, base: Refit, fit: Refit) -> Refit:
    """The known parameters alone from where `fit` has them, as the `base` with what is known of them; else the base.

    What an effect brings in may be no more than a way out of the basin that the base is in.
    """
    own = np.array([model.index(name) for effect in fit.effects for name in effect.names])
    added = own[own >= model.known]
    x = replaced(fit.x, added, base.search.centre[added])
    try:
        found = base.search.minimise(x, model.deviations(), limit=STEPS, tolerance=ENOUGH)
    except NO_END:
        return base
    return min(base, refit_at(model, (), base.search, found.x), key=lambda each: each.evidence)


def initial_point(
    model: Model, effects: Sequence[Effect], start: Real, scores: Sequence[Score], deviation: Sequence[Real | float]
) -> tuple[Search, Real]:
    """The search under `effects`, with ranges that `scores` give their parameters, and where it had best begin (p,)."""
    search, own = search_under(model, effects, start, scores)
    new = [model.index(name) for scored in scores for name in scored.effect.names]
    asked = np.zeros(start.size)
    asked[new] = [amplitude for scored in scores for amplitude in scored.amplitude]
    begins = [replaced(start, own, projected(search, own, (start + share * asked)[own])) for share in SHARES]
    # What is asked for goes with moves of the known parameters, without which less of it may be closer.
    moved = frozenset(map(int, search.free))
    costs = [0.5 * float(np.sum(search.evaluate(begin, deviation, free=moved).vector ** 2)) for begin in begins]
    best = int(np.argmin(costs))
    if best > 0:
        # Where there is next to nothing of it, what else it brings in goes astray.
        try:
            led = search.minimise(begins[0], deviation, limit=GLANCE, tolerance=0.01, fixed=tuple(new))
        except NO_END:
            return search, begins[best]
        if led.cost < costs[best]:
            return search, led.x
    return search, begins[best]


def search_under(
    model: Model, effects: Sequence[Effect], start: Real, scores: Sequence[Score]
) -> tuple[Search, NDArray[np.int64]]:
    """The search under `effects`, with ranges about `start` (p,) that `scores` give, and the indices of their own."""
    free, released = model.free(effects)
    search = Search(model.fitted, free=free, released=released)
    for scored in scores:
        for name, amplitude, error in zip(scored.effect.names, scored.amplitude, scored.error, strict=True):
            i = model.index(name)
            if np.isfinite(error):
                # What is admissible may be a million times what the data see: the search needs a range of its own.
                search.scale[i] = min(max(abs(amplitude), 3.0 * error), search.high[i] - search.low[i])
                search.low[i] = max(search.low[i], start[i] - WIDEST * search.scale[i])
                search.high[i] = min(search.high[i], start[i] + WIDEST * search.scale[i])
    return search, np.array([model.index(name) for effect in effects for name in effect.names])


def projected(search: Search, own: NDArray[np.int64], values: Real) -> Real:
    """Values (k,) of the parameters `own`, no closer to the ends of their ranges than :data:`AT_END`."""
    margin = AT_END * (search.high - search.low)[own]
    return np.asarray(np.clip(values, search.low[own] + margin, search.high[own] - margin))


def refit_at(model: Model, effects: tuple[Effect, ...], search: Search, x: Real) -> Refit:
    """What a minimum x (p,) of the known parameters and those of `effects` together says."""
    full = search.evaluate(x, model.deviations())
    estimate: dict[str, float] = {}
    error: dict[str, float] = {}
    cost = 0.0
    if effects:
        without = [i for i in search.free if model.parameters[i].name not in {n for e in effects for n in e.names}]
        jacobian = full.jacobian[:, without] * search.scale[without]
        basis, _ = np.linalg.qr(jacobian)
        own = np.hstack([columns(model, full, effect) for effect in effects])
        names = [name for effect in effects for name in effect.names]
        unique = list(dict.fromkeys(names))
        own = own[:, [names.index(name) for name in unique]]
        left = own - basis @ (basis.T @ own)
        size = np.linalg.norm(left, axis=0)
        size[size == 0.0] = 1e-300
        information = (left / size).T @ (left / size)
        covariance = np.linalg.pinv(information, rcond=1e-10) / np.outer(size, size)
        for k, name in enumerate(unique):
            i = model.index(name)
            width = model.parameters[i].high - model.parameters[i].low
            estimate[name] = float(x[i])
            error[name] = float(min(np.sqrt(max(covariance[k, k], 0.0)), width))
        ranges = [model.parameters[model.index(n)] for n in unique]
        cost = occam_factor(covariance, np.array([p.high - p.low for p in ranges]))
    shifts = {p.name: float((x[i] - p.start) / p.prior) for i, p in enumerate(model.parameters[:model.known])
              if p.prior is not None}
    states = []
    for log, impedance, state in zip(full.data.log_ratio, full.data.impedance, model.campaign.fitted, strict=True):
        states.append(state_fit(state.name, log, impedance, state.noise))
    points = sum(log.size for log in full.data.log_ratio)
    found = Refit(effects, search, x, unpredicted(full), full.data.error, float(full.vector @ full.vector), points,
                  estimate, error, cost, shifts, tuple(states))
    # Points that go together count as one, and what is left beyond noise as noise.
    wider = math.sqrt(found.correlation * max(1.0, found.reduced))
    moved = {name: estimate[name] - model.parameters[model.index(name)].start for name in estimate}
    return replace(found, error={name: math.hypot(wider * value, MODELLED * moved[name])
                                 for name, value in error.items()})


def checked(model: Model, fit: Refit) -> tuple[float, float]:
    """The reduced chi-square of a fit on bases made at its own place, and how far Z was off, relative, where most."""
    model.fitted.cover(fit.x, {}, UNNEEDED)
    there = refit_at(model, fit.effects, fit.search, fit.x)
    off = max(float(np.abs(was.impedance / now.impedance - 1.0).max())
              for was, now in zip(fit.states, there.states, strict=True))
    return there.reduced, off


def predicted(model: Model, fit: Refit) -> tuple[StateFit, ...]:
    """The states held out, as a refit predicts them."""
    if model.held_out is None:
        return ()
    deviation = [s.noise for s in model.campaign.held_out]
    shared = set(model.held_out.predictors) <= set(model.fitted.predictors)
    found = model.held_out(fit.x, deviation=deviation) if shared else None
    if found is None or not found.error < TRUSTED:
        apart = model.held_out.apart()
        apart.cover(fit.x, {}, UNNEEDED)
        found = apart(fit.x, deviation=deviation)
    return tuple(state_fit(s.name, log, z, s.noise) for s, log, z in zip(
        model.campaign.held_out, found.log_ratio, found.impedance, strict=True))


def replaced(x: Real, where: int | slice | NDArray[np.int64], values: float | Real) -> Real:
    """x (p,) with some parameters replaced."""
    there = x.copy()
    there[where] = values
    return there


def unpredicted(here: Weighted) -> Weighted:
    """Residuals without the predictions behind them, which hold the bases they were made on."""
    return replace(here, data=replace(here.data, predictions=()))
