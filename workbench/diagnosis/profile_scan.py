"""Profile scans: the cost that an effect leaves by its size, about the prior means of the known numbers.

The tangents at the null hypothesis do not show a large effect, and at the end of a search without it, known numbers
have moved to make up for a part of it. A scan starts from the prior instead: every hypothesis is tried in several
sizes, and the known numbers follow to first order. The sizes are coarse at first; steps are halved beside the best one
and in every basin, since a number may have several (the thickness of a gel whose film carries waves).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from workbench.catalogue.effect import Effect
from workbench.diagnosis.device import Model
from workbench.diagnosis.findings import InitialOptimum
from workbench.diagnosis.levels import LEVELS, inside, replaced
from workbench.diagnosis.likelihood import Hypothesis, Likelihood
from workbench.fitting.search import NO_END

Real = NDArray[np.float64]

#: Sizes of the scan, as shares of a search direction.
SIZES = (0.01, 0.03, 0.1, 0.3, 0.6, 0.95)

#: Sizes that models are made for; the span of their states serves between and beyond.
HELD = (0.1, 0.3, 0.6)

#: Points of a recording that a scan uses, about.
LOOKED_AT = 41

#: Times that steps about a size are halved.
HALVED = 3

#: Sizes that a scan returns, at most, of the lowest of its basins and of the coarse ones.
LEFT = 2


def search_directions(model: Model, effect: Effect) -> Iterator[Real]:
    """Directions (k,) from nothing to the bounds of each number of an effect, and to those of all together."""
    own = [model.index(name) for name in effect.names]
    stated = model.stated[own]
    for bound in model.bounds(own):
        whole = bound - stated
        moved = np.flatnonzero(whole)
        yield from (np.where(np.arange(whole.size) == k, whole, 0.0) for k in moved)
        if moved.size > 1:
            yield whole


def corners(model: Model, effect: Effect, x: Real) -> list[Real]:
    """Points (p,) that models of an effect of any size at x (p,) are made for."""
    return [_sized(model, effect, x, direction, size)
            for direction in search_directions(model, effect) for size in HELD]


def scan_profiles(likelihood: Likelihood, effect: Effect, x: Real) -> list[InitialOptimum]:
    """The sizes of an effect at x (p,) of least cost where the data weigh little, best first.

    Raises:
        NotConverged, NotEnriched, MeshError, InputError, ValueError: nothing can be predicted, or is admissible, at any
            size; the reason is that of the first one.
    """
    model, refused = likelihood.model, list[Exception]()
    own = [model.index(name) for name in effect.names]
    search = likelihood.search(Hypothesis((effect,)))
    steps = [each.step(LOOKED_AT) for each in likelihood.objective.recordings]
    thin = search.with_objective(search.objective.thinned(LOOKED_AT))
    spreads = likelihood.point_deviations(LEVELS[0], steps)
    free = np.setdiff1d(search.free, own)

    def tried(direction: Real, size: float) -> InitialOptimum:
        """The place of a size with the cost that it leaves; infinite where nothing can be predicted."""
        place = _sized(model, effect, x, direction, size)
        cost = math.inf
        try:
            weighted = thin.evaluate(place, spreads, free=frozenset(map(int, free)))
            step = np.linalg.lstsq(weighted.jacobian[:, free], -weighted.vector, rcond=None)[0]
            cost = 0.5 * float(np.sum((weighted.vector + weighted.jacobian[:, free] @ step) ** 2))
        except NO_END as error:
            refused.append(error)
        return InitialOptimum(place, cost, np.zeros(place.size))

    profiles = [(direction, {size: tried(direction, size) for size in SIZES})
                for direction in search_directions(model, effect)]
    coarse = sorted((each for _, profile in profiles for each in profile.values() if each.cost < math.inf),
                    key=lambda each: each.cost)
    if not coarse:
        if refused:
            raise refused[0]
        return []
    found = [_lowest(profile, size, partial(tried, direction)) for direction, profile in profiles
             for size in SIZES if profile[size] is coarse[0] or _is_basin(profile, size)]
    others = (each for each in coarse if not any(each is other for other in found))
    return sorted([*found, *others], key=lambda each: each.cost)[:LEFT]


def _is_basin(profile: Mapping[float, InitialOptimum], size: float) -> bool:
    """Whether both a smaller and a larger size cost more, if there is a larger one."""
    at = SIZES.index(size)
    beside = [profile[other].cost for other in (*SIZES[max(at - 1, 0):at], *SIZES[at + 1:at + 2])]
    return at > 0 and all(profile[size].cost < cost for cost in beside)


def _lowest(
    profile: Mapping[float, InitialOptimum], size: float, tried: Callable[[float], InitialOptimum]
) -> InitialOptimum:
    """The optimum of least cost near a size of a profile, by halving the steps beside it."""
    at = SIZES.index(size)
    near = {other: profile[other] for other in SIZES[max(at - 1, 0):at + 2]}
    low = SIZES[at - 1] if at else 0.0
    for _ in range(HALVED):
        best = min(near, key=lambda each: near[each].cost)
        sizes = sorted({low, *near})
        place = sizes.index(best)
        for other in (*sizes[max(place - 1, 0):place], *sizes[place + 1:place + 2]):
            between = 0.5 * (best + other)
            near[between] = tried(between)
    return min(near.values(), key=lambda each: each.cost)


def _sized(model: Model, effect: Effect, x: Real, direction: Real, size: float) -> Real:
    """x (p,) with an effect of that share of a search direction."""
    own = [model.index(name) for name in effect.names]
    low, high = model.bounds(own)
    stated = model.stated[own]
    return replaced(x, own, inside(stated + size * direction, low, high))
