"""Hypotheses tried where the data weigh little, so that a strong effect does not strain the known parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.basins import (
    CLOSER,
    PROMISING,
    RIGHT,
    rebuilt_in_another_basin,
    truncated_minimum,
    weak_deviations,
)
from workbench.diagnosis.device import Model
from workbench.diagnosis.hypothesis import Effect
from workbench.diagnosis.locate import Place, located
from workbench.diagnosis.refit import (
    ENOUGH,
    STEPS,
    UNNEEDED,
    Refit,
    initial_point,
    known_reach,
    leaves_less,
    projected,
    rebuild_and_refine,
    refit_at,
    replaced,
    search_under,
    unpredicted,
)
from workbench.diagnosis.score import Score, Tangents, confusion, promising, scores_at
from workbench.fitting.search import NO_END, Optimum, Search

Real = NDArray[np.float64]

#: A strong effect bends away from its tangent: asked with this relative deviation of the data, it is held at so many
#: times what the score test asks for, or of the errors that gives where these are larger. So many hypotheses are, and
#: those whose tangents have this cosine with that of the best.
ROUGH, HELD, STRONG, TWIN = 0.15, (0.5, 2.0, 8.0), 8, 0.95

#: Of the hypotheses that promise much, so many are followed where the data weigh little; at most the second number of
#: them, all about as good, to the end.
FOLLOWED, KEPT = 6, 2

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


def tempered_search(model: Model, base: Refit, x: Real, alone: Real | None) -> tuple[tuple[Place, ...], list[Refit]]:
    """Location and the best single hypotheses where the data weigh little, about x (p,), the end of the descent.

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
        model.fitted.cover(alone, known_reach(model, (), alone), UNNEEDED)
        scores = scores_at(model, search, alone, search.evaluate(alone, weak_deviations(search.objective, ROUGH)))
        held = promising(scores, STRONG)
        ends += _at_strengths(model, alone, held)
        ends += _at_strengths(model, alone, _twins(ends, held, scores))
    if pulled.size:
        # What is missing may be imitated by a known parameter far from what is known of it: asked without that too.
        back, scores = _weakly(model, search, replaced(x, pulled, search.centre[pulled]), tuple(map(int, pulled)))
        ends += _glances(model, back, scores)
    least = min((end.cost for _, _, end in ends), default=0.0)
    found: list[Refit] = []
    for effect, search, end in sorted(ends, key=lambda each: each[2].cost):
        if RIGHT * end.cost > least or len(found) == KEPT:
            break
        if any(effect in fit.effects for fit in found):
            continue
        led = _continuation(model, effect, search, end)
        if led is None:
            continue
        fit, near = led
        if alone is not None and not fit.good:
            other = _sampled_descent(model, effect, search, near, alone)
            if other.cost < RIGHT * near.cost and (led := _continuation(model, effect, search, other)) is not None:
                fit, near = min((fit, near), led, key=lambda each: each[0].evidence)
        if leaves_less(fit, base, ROUGHLY):
            fit = rebuild_and_refine(model, fit)
            fit = fit if fit.good else rebuilt_in_another_basin(model, fit, near.x)
        found.append(fit)
    return location, found


def _weakly(model: Model, search: Search, x: Real, fixed: tuple[int, ...] = ()) -> tuple[Real, list[Score]]:
    """The least cost near x (p,) with the data weighing little, on bases made there, and the scores at that.

    The parameters of the indices `fixed` stay where they are.
    """
    model.fitted.cover(x, known_reach(model, (), x), UNNEEDED)
    x = truncated_minimum(search.thinned(), x, fixed).x
    return x, scores_at(model, search, x, search.evaluate(x, weak_deviations(search.objective)))


def _located(model: Model, search: Search, x: Real) -> tuple[Place, ...]:
    """The location near x (p,), where the data weigh little, with the data weighing enough to tell places apart."""
    deviation = weak_deviations(search.objective, CLOSER)
    x = truncated_minimum(search.thinned(), x, deviation=CLOSER).x
    here = search.evaluate(x, deviation)
    return located(model, x, deviation, Tangents.at(search, here), scores_at(model, search, x, here))


def _glances(model: Model, x: Real, scores: Sequence[Score]) -> list[tuple[Effect, Search, Optimum]]:
    """Where the hypotheses that promise most lead from x (p,) with the data weighing little."""
    ends = []
    for scored in promising(scores, FOLLOWED):
        try:
            search, begin = initial_point(model, (scored.effect,), x, [scored], weak_deviations(model.fitted))
            ends.append((scored.effect, search, _bare(truncated_minimum(search.thinned(), begin))))
        except NO_END:
            continue
    return ends


def _at_strengths(model: Model, x: Real, scores: Sequence[Score]) -> list[tuple[Effect, Search, Optimum]]:
    """Where the hypotheses of `scores` lead from x (p,), each held at several strengths first, as :func:`_glances`."""
    ends: list[tuple[Effect, Search, Optimum]] = []
    for scored in scores:
        search, own = search_under(model, (scored.effect,), x, [scored])
        asked = np.where(np.abs(scored.amplitude) < scored.error, scored.error, scored.amplitude)
        asked[~np.isfinite(asked)] = 0.0
        places = [replaced(x, own, projected(search, own, x[own] + times * asked)) for times in HELD]
        model.fitted.cover(x, known_reach(model, (), x), UNNEEDED, places)
        thin = search.thinned()
        for place in places:
            try:
                held = truncated_minimum(thin, place, tuple(map(int, own)))
                if held.cost < PROMISING * min((end.cost for _, _, end in ends), default=np.inf):
                    ends.append((scored.effect, search, _bare(truncated_minimum(thin, held.x))))
            except NO_END:
                continue
    return ends


def _bare(end: Optimum) -> Optimum:
    """An end without the predictions there (:func:`unpredicted`)."""
    return replace(end, residual=unpredicted(end.residual))


def _twins(
    ends: Sequence[tuple[Effect, Search, Optimum]], held: Sequence[Score], scores: Sequence[Score]
) -> list[Score]:
    """Of the `scores` those that are hardly told from that of the best of `ends`, and were not among the `held`."""
    best = min(ends, key=lambda each: each[2].cost)[0] if ends else None
    return [other for one in held if one.effect is best for other in scores
            if other not in held and confusion(one, other) > TWIN][:KEPT]


def _continuation(model: Model, effect: Effect, search: Search, end: Optimum) -> tuple[Refit, Optimum] | None:
    """The refit of a hypothesis that the end of its way leads to where the data weigh in full; and that end, followed.

    None where nothing can be predicted.
    """
    try:
        end = _followed(model, effect, search, end)
        full = search.minimise(end.x, model.deviations(), limit=STEPS, tolerance=ENOUGH)
    except NO_END:
        return None
    return refit_at(model, (effect,), search, full.x), end


def _sampled_descent(model: Model, effect: Effect, search: Search, end: Optimum, about: Real) -> Optimum:
    """The best end of ways from starts drawn about a place (p,) with the data weighing little; `end` if none is better.

    They begin with as much of the effect as there is in the `end`: also with the right one there are several basins,
    and no single parameter leads from one to another.
    """
    known = slice(model.known)
    centre = replaced(end.x, known, about[known])
    model.fitted.cover(centre, known_reach(model, (effect,), centre), UNNEEDED)
    thin, random = search.thinned(), np.random.default_rng(0)
    moved = np.flatnonzero(search.precision[known] > 0.0)
    ends = [end]
    for _ in range(DRAWN):
        offset = ABOUT / search.precision[moved] * random.standard_normal(moved.size)
        try:
            ends.append(truncated_minimum(thin, replaced(centre, moved, centre[moved] + offset)))
        except NO_END:
            continue
    return min(ends, key=lambda each: each.cost)


def _followed(model: Model, effect: Effect, search: Search, end: Optimum) -> Optimum:
    """The end of the way of a hypothesis where the data weigh little, on bases made anew as long as it leads on."""
    for _ in range(ROUNDS):
        model.fitted.cover(end.x, known_reach(model, (effect,), end.x), UNNEEDED)
        before, end = end.cost, truncated_minimum(search.thinned(), end.x)
        if end.cost > ONWARD * before:
            break
    return end
