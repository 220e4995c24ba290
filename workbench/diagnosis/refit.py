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
from workbench.diagnosis.locate import Place, located
from workbench.diagnosis.score import Score, Tangents, columns, confusion, cost_of_freedom, scores_at
from workbench.fitting.objective import Objective
from workbench.fitting.parameter import shown_factor, shown_unit
from workbench.fitting.search import EXPLORATION, NO_END, Optimum, Search, Weighted
from workbench.fitting.uncertainty import DEVIATIONS, correlation_length

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

#: A parameter known no better than the first number, relative, whose uncertainty changes Z by more than the second, may
#: have several optima: a thin layer may be too thick or too thin. A fit that is not good is begun again with it at so
#: many of its uncertainties.
LEVER, SHIFTING, HOPS = 0.05, 0.03, (-0.5, 0.5, -1.0, 1.0, -1.5, 1.5, -2.0, 2.0)

#: Bases for that hold the states with a lever at so many of its uncertainties. Where nothing within those helps, the
#: fit is begun again at places all over what it may be, apart by no more than the second number, a factor, with bases
#: for every other one.
CORNERS, FAR = (-1.7, 1.7), 1.5

#: A refit searches so many times what the score test asks for, or the standard errors it gives.
WIDEST = 30.0

#: It begins with the best of these shares of what the score test asks for.
SHARES = (1.0, 0.1, 0.0)

#: A strong effect bends away from its tangent: asked with this relative deviation of the data, it is held at so many
#: times what the score test asks for, or of the errors that gives where these are larger. So many hypotheses are, and
#: those whose tangents have this cosine with that of the best.
ROUGH, HELD, STRONG, TWIN = 0.15, (0.5, 2.0, 8.0), 8, 0.95

#: It begins no closer to the end of its range than this share of it.
AT_END = 1e-4

#: Of the hypotheses that promise more than the second number of what any does, so many are followed where the data
#: weigh little; at most the third number of them, all about as good, to the end.
FOLLOWED, WORTH, KEPT = 6, 0.3, 2

#: They are asked for once more with the known parameters, that have gone so many uncertainties even there, held back.
PULLED = 3.0

#: Where a hypothesis that was followed leaves more than noise, so many starts are drawn, by this share of what is known
#: of the known parameters.
DRAWN, ABOUT = 12, 0.5

#: Such a way is followed on new bases while that takes the cost below this share, at most so many times.
ONWARD, ROUNDS = 0.9, 12

#: One that leaves less than this share of what the known parameters alone leave is worth bases of its own, and may, if
#: it leaves more than noise, have ended in a wrong basin.
ROUGHLY = 0.3

#: With the lever held, so many times the cost of the best end is no reason to let it go there; an end that costs less
#: than this share of another is in another basin, the right one.
PROMISING, RIGHT = 4.0, 0.75

#: Ends that cost no more than so many times the best one, and lie so many uncertainties of a lever apart, are compared
#: where the data weigh more, with this relative deviation; at most so many of them.
LIKELY, APART, CLOSER, COMPARED = 1.5, 0.25, 0.01, 3


@dataclass(frozen=True, eq=False)
class StateFit:
    """One state under one hypothesis: reduced chi-square, rms of ln(Z / Z_measured), and how far residuals correlate.

    ``correlation`` is the number of neighbouring points that carry the information of one; ``impedance`` (n,) ohm.
    """

    name: str
    reduced: float
    rms: float
    correlation: float
    impedance: Complex


@dataclass(frozen=True, eq=False)
class Refit:
    """The optimum of the known parameters together with those of some hypotheses (none: the base model).

    ``x`` (p,) all parameters; ``here`` the residuals there, without the predictions behind them; ``doubt`` the largest
    estimated relative error of these; ``chi_square`` of the data and the prior; ``estimate`` and ``error`` of the
    hypotheses' own parameters by name, of noise and of the terms themselves (:data:`MODELLED`); ``cost_of_freedom``
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
    cost_of_freedom: float
    shifts: dict[str, float]
    states: tuple[StateFit, ...]

    @property
    def evidence(self) -> float:
        """Minus twice the logarithm of the evidence, up to a constant shared by all hypotheses: smaller is better."""
        return self.chi_square + self.cost_of_freedom

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
    def strain(self) -> float:
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
    """The states as stated, the known parameters alone fitted from there, and the end (p,) of the way down to that.

    The way leads through smoothed spectra (`Search.descend`).
    """
    free, lifted = model.free(())
    search = Search(model.fitted, free=free, lifted=lifted)
    deviation = model.deviations()
    model.fitted.cover(search.centre, _moves(model, (), search.centre), UNNEEDED)
    stated = model.fitted(search.centre, deviation=deviation)
    nominal = tuple(state_fit(s.name, log, z, s.noise) for s, log, z in zip(
        model.campaign.fitted, stated.log_ratio, stated.impedance, strict=True))
    x = search.thinned().descend(search.centre, lambda: None).x
    return nominal, _judged(model, (), search, search.minimise(x, deviation, limit=STEPS, tolerance=ENOUGH).x), x


def afar(model: Model, base: Refit, x: Real, alone: Real | None) -> tuple[tuple[Place, ...], list[Refit]]:
    """Location and the best single hypotheses where the data weigh little, about x (p,), the end of the way down.

    A strong effect strains the known parameters while it is missing: where the data weigh in full, hypotheses are asked
    what is left of it there, and the way back is long. With little weight (`search.EXPLORATION`) those stay near what
    is known, and the best hypotheses are followed from there. Even there the known parameters imitate what is missing
    as well as they can: hypotheses are also asked at `alone` (p,), what states that lack parts of the device say of it.

    Returns:
        the location where they weigh more, and refits with full weight, those that leave little on bases of their own.
    """
    search = base.search
    x, scores = _weakly(model, search, x)
    location = _located(model, search, x)
    ends = _glances(model, x, scores)
    pulled = np.flatnonzero(np.abs((x - search.centre) * search.precision) > PULLED)
    if alone is not None:
        model.fitted.cover(alone, _moves(model, (), alone), UNNEEDED)
        scores = scores_at(model, search, alone, search.evaluate(alone, _weak(search.objective, ROUGH)))
        held = promising(scores, STRONG)
        ends += _at_strengths(model, alone, held)
        ends += _at_strengths(model, alone, _twins(ends, held, scores))
    if pulled.size:
        # What is missing may be imitated by a known parameter far from what is known of it: asked without that too.
        back, scores = _weakly(model, search, _replaced(x, pulled, search.centre[pulled]), tuple(map(int, pulled)))
        ends += _glances(model, back, scores)
    least = min((end.cost for _, _, end in ends), default=0.0)
    found: list[Refit] = []
    for effect, search, end in sorted(ends, key=lambda each: each[2].cost):
        if RIGHT * end.cost > least or len(found) == KEPT:
            break
        if any(effect in fit.effects for fit in found):
            continue
        led = _led(model, effect, search, end)
        if led is None:
            continue
        fit, near = led
        if alone is not None and not fit.good:
            other = _drawn(model, effect, search, near, alone)
            if other.cost < RIGHT * near.cost and (led := _led(model, effect, search, other)) is not None:
                fit, near = min((fit, near), led, key=lambda each: each[0].evidence)
        if leaves_less(fit, base, ROUGHLY):
            fit = gather(model, fit)
            fit = fit if fit.good else gathered_elsewhere(model, fit, near.x)
        found.append(fit)
    return location, found


def _weakly(model: Model, search: Search, x: Real, fixed: tuple[int, ...] = ()) -> tuple[Real, list[Score]]:
    """The least cost near x (p,) with the data weighing little, on bases made there, and the scores at that.

    The parameters of the indices `fixed` stay where they are.
    """
    model.fitted.cover(x, _moves(model, (), x), UNNEEDED)
    x = _glance(search.thinned(), x, fixed).x
    return x, scores_at(model, search, x, search.evaluate(x, _weak(search.objective)))


def _located(model: Model, search: Search, x: Real) -> tuple[Place, ...]:
    """The location near x (p,), where the data weigh little, with the data weighing enough to tell places apart."""
    deviation = _weak(search.objective, CLOSER)
    x = _glance(search.thinned(), x, deviation=CLOSER).x
    here = search.evaluate(x, deviation)
    return located(model, x, deviation, Tangents.at(search, here), scores_at(model, search, x, here))


def _glances(model: Model, x: Real, scores: Sequence[Score]) -> list[tuple[Effect, Search, Optimum]]:
    """Where the hypotheses that promise most lead from x (p,) with the data weighing little."""
    ends = []
    for scored in promising(scores, FOLLOWED):
        try:
            search, begin = _begun(model, (scored.effect,), x, [scored], _weak(model.fitted))
            ends.append((scored.effect, search, _bare(_glance(search.thinned(), begin))))
        except NO_END:
            continue
    return ends


def _at_strengths(model: Model, x: Real, scores: Sequence[Score]) -> list[tuple[Effect, Search, Optimum]]:
    """Where the hypotheses of `scores` lead from x (p,), each held at several strengths first, as :func:`_glances`."""
    ends: list[tuple[Effect, Search, Optimum]] = []
    for scored in scores:
        search, own = _searched(model, (scored.effect,), x, [scored])
        asked = np.where(np.abs(scored.amplitude) < scored.error, scored.error, scored.amplitude)
        asked[~np.isfinite(asked)] = 0.0
        places = [_replaced(x, own, _within(search, own, x[own] + times * asked)) for times in HELD]
        model.fitted.cover(x, _moves(model, (), x), UNNEEDED, places)
        thin = search.thinned()
        for place in places:
            try:
                held = _glance(thin, place, tuple(map(int, own)))
                if held.cost < PROMISING * min((end.cost for _, _, end in ends), default=np.inf):
                    ends.append((scored.effect, search, _bare(_glance(thin, held.x))))
            except NO_END:
                continue
    return ends


def _bare(end: Optimum) -> Optimum:
    """An end without the predictions there (:func:`_unpredicted`)."""
    return replace(end, residual=_unpredicted(end.residual))


def _unpredicted(here: Weighted) -> Weighted:
    """Residuals without the predictions behind them, which hold the bases they were made on."""
    return replace(here, data=replace(here.data, predictions=()))


def _twins(
    ends: Sequence[tuple[Effect, Search, Optimum]], held: Sequence[Score], scores: Sequence[Score]
) -> list[Score]:
    """Of the `scores` those that are hardly told from that of the best of `ends`, and were not among the `held`."""
    best = min(ends, key=lambda each: each[2].cost)[0] if ends else None
    return [other for one in held if one.effect is best for other in scores
            if other not in held and confusion(one, other) > TWIN][:KEPT]


def promising(scores: Sequence[Score], count: int, least: float = 0.0) -> list[Score]:
    """The first `count` of those that promise a fall of chi-square above `least`, and much of what any does."""
    enough = max(least, WORTH * max((scored.gain for scored in scores), default=0.0))
    return [scored for scored in scores if scored.gain > enough][:count]


def _led(model: Model, effect: Effect, search: Search, end: Optimum) -> tuple[Refit, Optimum] | None:
    """The refit of a hypothesis that the end of its way leads to where the data weigh in full; and that end, followed.

    None where nothing can be predicted.
    """
    try:
        end = _followed(model, effect, search, end)
        full = search.minimise(end.x, model.deviations(), limit=STEPS, tolerance=ENOUGH)
    except NO_END:
        return None
    return _judged(model, (effect,), search, full.x), end


def _drawn(model: Model, effect: Effect, search: Search, end: Optimum, about: Real) -> Optimum:
    """The best end of ways from starts drawn about a place (p,) with the data weighing little; `end` if none is better.

    They begin with as much of the effect as there is in the `end`: also with the right one there are several basins,
    and no single parameter leads from one to another.
    """
    known = slice(model.known)
    centre = _replaced(end.x, known, about[known])
    model.fitted.cover(centre, _moves(model, (effect,), centre), UNNEEDED)
    thin, random = search.thinned(), np.random.default_rng(0)
    moved = np.flatnonzero(search.precision[known] > 0.0)
    ends = [end]
    for _ in range(DRAWN):
        offset = ABOUT / search.precision[moved] * random.standard_normal(moved.size)
        try:
            ends.append(_glance(thin, _replaced(centre, moved, centre[moved] + offset)))
        except NO_END:
            continue
    return min(ends, key=lambda each: each.cost)


def _followed(model: Model, effect: Effect, search: Search, end: Optimum) -> Optimum:
    """The end of the way of a hypothesis where the data weigh little, on bases made anew as long as it leads on."""
    for _ in range(ROUNDS):
        model.fitted.cover(end.x, _moves(model, (effect,), end.x), UNNEEDED)
        before, end = end.cost, _glance(search.thinned(), end.x)
        if end.cost > ONWARD * before:
            break
    return end


def leaves_less(fit: Refit, base: Refit, share: float) -> bool:
    """Whether a fit leaves less than a share of what the base leaves and noise does not explain."""
    return fit.reduced - 1.0 < share * (base.reduced - 1.0)


def _moves(model: Model, effects: Sequence[Effect], x: Real) -> dict[str, float]:
    """How far known parameters may move, and those of `effects`: as far as they have come at x (p,)."""
    reach = {p.name: MOVES * p.prior for p in model.parameters[:model.known] if p.prior}
    for name in (name for effect in effects for name in effect.names):
        i = model.index(name)
        reach[name] = max(reach.get(name, 0.0), abs(float(x[i] - model.parameters[i].start)))
    return reach


def _weak(objective: Objective, deviation: float = EXPLORATION) -> list[float]:
    """Deviations with which the data weigh little against what is known."""
    return [deviation] * len(objective.recordings)


def _glance(search: Search, x: Real, fixed: tuple[int, ...] = (), deviation: float = EXPLORATION) -> Optimum:
    """Few steps from x (p,), with the data weighing little."""
    return search.minimise(x, _weak(search.objective, deviation), limit=GLANCE, tolerance=0.01, fixed=fixed)


def _levers(search: Search, known: int, x: Real) -> list[int]:
    """Indices of the known parameters that may have several optima, with what they do at x (p,)."""
    here = search.evaluate(x, _weak(search.objective))
    points = sum(log.size for log in here.data.log_ratio)
    found = []
    for i, p in enumerate(search.parameters[:known]):
        if p.prior is not None and not p.is_loss and p.prior > LEVER * abs(p.start) > 0.0:
            # Of a layer that is twice as thick, twice as much does the same.
            step = p.prior * abs(float(x[i]) / p.start)
            change = EXPLORATION * step * float(np.linalg.norm(here.data.jacobian[:, i])) / np.sqrt(points)
            if change > SHIFTING:
                found.append(i)
    return found


def elsewhere(model: Model, fit: Refit, x: Real, *, far: bool = False) -> tuple[Refit, Real]:
    """`fit` and x (p,), the end of the way down; or a better fit from another basin about x, and the end of that way.

    A wrong basin strains the known parameters. Where the data weigh little against these (`search.EXPLORATION`), it
    costs more than the right one, and few steps lead from one to the other. With `far` the basins are looked for in all
    that the parameters may be, one parameter after the other, else within what is known of them.
    """
    levers = _levers(fit.search, model.known, x)
    for together in [[i] for i in levers] if far else [levers]:
        fit, x = _elsewhere(model, fit, x, together, far)
    return fit, x


def _elsewhere(model: Model, fit: Refit, x: Real, levers: Sequence[int], far: bool) -> tuple[Refit, Real]:
    """:func:`elsewhere`, in basins that some `levers` lead to, on bases for all of these at once."""
    search = fit.search
    places = [(i, value) for i in levers for value in _places(search, i, far)]
    if not places:
        return fit, x
    known = slice(model.known)
    centre = _replaced(x, known, search.centre[known])
    around = [(i, search.centre[i] + side * search.scale[i]) for i in levers for side in CORNERS]
    model.fitted.cover(centre, _moves(model, fit.effects, x), UNNEEDED,
                          [_replaced(centre, i, value) for i, value in (places[::2] if far else around)])
    thin = search.thinned()
    own = best = _glance(thin, x)
    ends = [own]
    for i, value in places:
        try:
            held = _glance(thin, _replaced(centre if far else best.x, i, value), fixed=(i,))
            if held.cost < PROMISING * best.cost:
                ends.append(_glance(thin, held.x))
        except NO_END:
            continue
        best = min(ends, key=lambda end: end.cost)
        if best.cost < RIGHT * own.cost and not far:
            break
    best, near = _compared(thin, ends, levers)
    if best is own:
        return fit, x
    found = search.minimise(near, model.deviations(), limit=STEPS, tolerance=ENOUGH)
    ended = _judged(model, fit.effects, search, found.x)
    return (ended, best.x) if ended.chi_square < fit.chi_square - fit.worth else (fit, x)


def _places(search: Search, i: int, far: bool) -> Sequence[float]:
    """Where to hold parameter i, a lever, in all that it may be (far), or within what is known of it."""
    low, high = float(search.low[i]), float(search.high[i])
    if far and low * high > 0.0:
        parts = math.ceil(abs(math.log(high / low)) / math.log(FAR))
        return np.geomspace(low, high, parts + 1)[1:-1].tolist()
    return [search.centre[i] + hop * search.scale[i] for hop in HOPS]


def _replaced(x: Real, where: int | slice | NDArray[np.int64], values: float | Real) -> Real:
    """x (p,) with some parameters replaced."""
    there = x.copy()
    there[where] = values
    return there


def _compared(search: Search, ends: Sequence[Optimum], levers: Sequence[int]) -> tuple[Optimum, Real]:
    """The best of several ends where the data weigh little, and where it leads (p,) as they weigh more.

    Basins that cost about the same are told apart by that: with little weight, what is known says more than the data.
    """
    least = min(end.cost for end in ends)
    likely: list[Optimum] = []
    for end in sorted(ends, key=lambda end: end.cost):
        apart = all(np.abs((end.x - other.x) / search.scale)[levers].max() > APART for other in likely)
        if end.cost < LIKELY * least and apart and len(likely) < COMPARED:
            likely.append(end)
    if len(likely) == 1:
        return likely[0], likely[0].x
    closer = [(end, _glance(search, end.x, deviation=CLOSER)) for end in likely]
    end, there = min(closer, key=lambda each: each[1].cost)
    return end, there.x


def gathered_elsewhere(model: Model, fit: Refit, x: Real) -> Refit:
    """`fit`, or a better one from another basin about x (p,) on bases of its own (:func:`elsewhere`)."""
    other, _ = elsewhere(model, fit, x)
    return fit if other is fit else gather(model, other)


def gather(model: Model, fit: Refit, scores: Sequence[Score] = ()) -> Refit:
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
        fit = _judged(model, fit.effects, fit.search, found.x)
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
        search, begin = _begun(model, effects, start, scores, deviation)
        found = search.minimise(begin, deviation, limit=STEPS, tolerance=ENOUGH)
    except NO_END:
        return None
    return _judged(model, tuple(effects), search, found.x)


def without(model: Model, base: Refit, fit: Refit) -> Refit:
    """The known parameters alone from where `fit` has them, as the `base` with what is known of them; else the base.

    What an effect brings in may be no more than a way out of the basin that the base is in.
    """
    own = np.array([model.index(name) for effect in fit.effects for name in effect.names])
    added = own[own >= model.known]
    x = _replaced(fit.x, added, base.search.centre[added])
    try:
        found = base.search.minimise(x, model.deviations(), limit=STEPS, tolerance=ENOUGH)
    except NO_END:
        return base
    return min(base, _judged(model, (), base.search, found.x), key=lambda each: each.evidence)


def _begun(
    model: Model, effects: Sequence[Effect], start: Real, scores: Sequence[Score], deviation: Sequence[Real | float]
) -> tuple[Search, Real]:
    """The search under `effects`, with ranges that `scores` give their parameters, and where it had best begin (p,)."""
    search, own = _searched(model, effects, start, scores)
    new = [model.index(name) for scored in scores for name in scored.effect.names]
    asked = np.zeros(start.size)
    asked[new] = [amplitude for scored in scores for amplitude in scored.amplitude]
    begins = [_replaced(start, own, _within(search, own, (start + share * asked)[own])) for share in SHARES]
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


def _searched(
    model: Model, effects: Sequence[Effect], start: Real, scores: Sequence[Score]
) -> tuple[Search, NDArray[np.int64]]:
    """The search under `effects`, with ranges about `start` (p,) that `scores` give, and the indices of their own."""
    free, lifted = model.free(effects)
    search = Search(model.fitted, free=free, lifted=lifted)
    for scored in scores:
        for name, amplitude, error in zip(scored.effect.names, scored.amplitude, scored.error, strict=True):
            i = model.index(name)
            if np.isfinite(error):
                # What is admissible may be a million times what the data see: the search needs a range of its own.
                search.scale[i] = min(max(abs(amplitude), 3.0 * error), search.high[i] - search.low[i])
                search.low[i] = max(search.low[i], start[i] - WIDEST * search.scale[i])
                search.high[i] = min(search.high[i], start[i] + WIDEST * search.scale[i])
    return search, np.array([model.index(name) for effect in effects for name in effect.names])


def _within(search: Search, own: NDArray[np.int64], values: Real) -> Real:
    """Values (k,) of the parameters `own`, no closer to the ends of their ranges than :data:`AT_END`."""
    margin = AT_END * (search.high - search.low)[own]
    return np.asarray(np.clip(values, search.low[own] + margin, search.high[own] - margin))


def _judged(model: Model, effects: tuple[Effect, ...], search: Search, x: Real) -> Refit:
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
        cost = cost_of_freedom(covariance, np.array([p.high - p.low for p in ranges]))
    shifts = {p.name: float((x[i] - p.start) / p.prior) for i, p in enumerate(model.parameters[:model.known])
              if p.prior is not None}
    states = []
    for log, impedance, state in zip(full.data.log_ratio, full.data.impedance, model.campaign.fitted, strict=True):
        states.append(state_fit(state.name, log, impedance, state.noise))
    points = sum(log.size for log in full.data.log_ratio)
    found = Refit(effects, search, x, _unpredicted(full), full.data.error, float(full.vector @ full.vector), points,
                  estimate, error, cost, shifts, tuple(states))
    # Points that go together count as one, and what is left beyond noise as noise.
    wider = math.sqrt(found.correlation * max(1.0, found.reduced))
    moved = {name: estimate[name] - model.parameters[model.index(name)].start for name in estimate}
    return replace(found, error={name: math.hypot(wider * value, MODELLED * moved[name])
                                 for name, value in error.items()})


def checked(model: Model, fit: Refit) -> tuple[float, float]:
    """The reduced chi-square of a fit on bases made at its own place, and how far Z was off, relative, where most."""
    model.fitted.cover(fit.x, {}, UNNEEDED)
    there = _judged(model, fit.effects, fit.search, fit.x)
    off = max(float(np.abs(was.impedance / now.impedance - 1.0).max())
              for was, now in zip(fit.states, there.states, strict=True))
    return there.reduced, off


def state_fit(name: str, log: Complex, impedance: Complex, noise: Real) -> StateFit:
    return StateFit(name, float(np.mean(np.abs(log / noise) ** 2) / 2.0), float(np.sqrt(np.mean(np.abs(log) ** 2))),
                    correlation_length(log / noise), impedance)


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
