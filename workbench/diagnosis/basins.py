"""Other basins of a fit: further optima that parameters with several of them lead to, where the data weigh little."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.device import Model
from workbench.diagnosis.refit import (
    ENOUGH,
    GLANCE,
    STEPS,
    UNNEEDED,
    Refit,
    known_reach,
    rebuild_and_refine,
    refit_at,
    replaced,
)
from workbench.fitting.objective import Objective
from workbench.fitting.search import EXPLORATION, NO_END, Optimum, Search

Real = NDArray[np.float64]

#: A parameter known no better than the first number, relative, whose uncertainty changes Z by more than the second, may
#: have several optima: a thin layer may be too thick or too thin. A fit that is not good is begun again with it at so
#: many of its uncertainties.
LEVER, SHIFTING, HOPS = 0.05, 0.03, (-0.5, 0.5, -1.0, 1.0, -1.5, 1.5, -2.0, 2.0)

#: Bases for that hold the states with a lever at so many of its uncertainties. Where nothing within those helps, the
#: fit is begun again at places all over what it may be, apart by no more than the second number, a factor, with bases
#: for every other one.
CORNERS, FAR = (-1.7, 1.7), 1.5

#: With the lever held, so many times the cost of the best end is no reason to let it go there; an end that costs less
#: than this share of another is in another basin, the right one.
PROMISING, RIGHT = 4.0, 0.75

#: Ends that cost no more than so many times the best one, and lie so many uncertainties of a lever apart, are compared
#: where the data weigh more, with this relative deviation; at most so many of them.
LIKELY, APART, CLOSER, COMPARED = 1.5, 0.25, 0.01, 3


def weak_deviations(objective: Objective, deviation: float = EXPLORATION) -> list[float]:
    """Deviations with which the data weigh little against what is known."""
    return [deviation] * len(objective.recordings)


def truncated_minimum(search: Search, x: Real, fixed: tuple[int, ...] = (), deviation: float = EXPLORATION) -> Optimum:
    """Few steps from x (p,), with the data weighing little."""
    return search.minimise(x, weak_deviations(search.objective, deviation), limit=GLANCE, tolerance=0.01, fixed=fixed)


def _multimodal(search: Search, known: int, x: Real) -> list[int]:
    """Indices of the known parameters that may have several optima, with what they do at x (p,)."""
    here = search.evaluate(x, weak_deviations(search.objective))
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


def other_basin(model: Model, fit: Refit, x: Real, *, far: bool = False) -> tuple[Refit, Real]:
    """`fit` and x (p,), the end of the descent; or a better fit from another basin about x, and where that ended.

    A wrong basin strains the known parameters. Where the data weigh little against these (`search.EXPLORATION`), it
    costs more than the right one, and few steps lead from one to the other. With `far` the basins are looked for in all
    that the parameters may be, one parameter after the other, else within what is known of them.
    """
    multimodal = _multimodal(fit.search, model.known, x)
    for together in [[i] for i in multimodal] if far else [multimodal]:
        fit, x = _other_basin(model, fit, x, together, far)
    return fit, x


def _other_basin(model: Model, fit: Refit, x: Real, multimodal: Sequence[int], far: bool) -> tuple[Refit, Real]:
    """:func:`other_basin`, in basins that the parameters `multimodal` lead to, on bases for all of these at once."""
    search = fit.search
    places = [(i, value) for i in multimodal for value in _places(search, i, far)]
    if not places:
        return fit, x
    known = slice(model.known)
    centre = replaced(x, known, search.centre[known])
    around = [(i, search.centre[i] + side * search.scale[i]) for i in multimodal for side in CORNERS]
    model.fitted.cover(centre, known_reach(model, fit.effects, x), UNNEEDED,
                       [replaced(centre, i, value) for i, value in (places[::2] if far else around)])
    thin = search.thinned()
    own = best = truncated_minimum(thin, x)
    ends = [own]
    for i, value in places:
        try:
            held = truncated_minimum(thin, replaced(centre if far else best.x, i, value), fixed=(i,))
            if held.cost < PROMISING * best.cost:
                ends.append(truncated_minimum(thin, held.x))
        except NO_END:
            continue
        best = min(ends, key=lambda end: end.cost)
        if best.cost < RIGHT * own.cost and not far:
            break
    best, near = _compared(thin, ends, multimodal)
    if best is own:
        return fit, x
    found = search.minimise(near, model.deviations(), limit=STEPS, tolerance=ENOUGH)
    ended = refit_at(model, fit.effects, search, found.x)
    return (ended, best.x) if ended.chi_square < fit.chi_square - fit.worth else (fit, x)


def _places(search: Search, i: int, far: bool) -> Sequence[float]:
    """Where to hold parameter i, a lever, in all that it may be (far), or within what is known of it."""
    low, high = float(search.low[i]), float(search.high[i])
    if far and low * high > 0.0:
        parts = math.ceil(abs(math.log(high / low)) / math.log(FAR))
        return np.geomspace(low, high, parts + 1)[1:-1].tolist()
    return [search.centre[i] + hop * search.scale[i] for hop in HOPS]


def _compared(search: Search, ends: Sequence[Optimum], multimodal: Sequence[int]) -> tuple[Optimum, Real]:
    """The best of several ends where the data weigh little, and where it leads (p,) as they weigh more.

    Basins that cost about the same are told apart by that: with little weight, what is known says more than the data.
    """
    least = min(end.cost for end in ends)
    likely: list[Optimum] = []
    for end in sorted(ends, key=lambda end: end.cost):
        apart = all(np.abs((end.x - other.x) / search.scale)[multimodal].max() > APART for other in likely)
        if end.cost < LIKELY * least and apart and len(likely) < COMPARED:
            likely.append(end)
    if len(likely) == 1:
        return likely[0], likely[0].x
    closer = [(end, truncated_minimum(search, end.x, deviation=CLOSER)) for end in likely]
    end, there = min(closer, key=lambda each: each[1].cost)
    return end, there.x


def rebuilt_in_another_basin(model: Model, fit: Refit, x: Real) -> Refit:
    """`fit`, or a better one from another basin about x (p,) on bases of its own (:func:`other_basin`)."""
    other, _ = other_basin(model, fit, x)
    return fit if other is fit else rebuild_and_refine(model, other)
