"""Profile scans: the cost of an effect by its size.

The tangents at the null hypothesis do not show a large effect. At the end of a search without it, known parameters have
moved to compensate a part of it. A scan starts from the prior instead: every hypothesis is tried in several sizes, and
the known parameters follow to first order. The sizes are coarse at first; steps are halved beside the best one and at
every local optimum, since an effect may have several (the thickness of a gel whose film carries waves).
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
MODELLED = (0.1, 0.3, 0.6)

#: Approximate number of points of a recording in a scan.
SCAN_POINTS = 41

#: Relative error of Z by truncation of the models of a scan, where points deviate by `levels.LEVELS`.
TRUNCATED = 1e-3

#: Times that steps about a size are halved.
HALVINGS = 3

#: Most sizes that a scan returns, of its lowest local optima and of the coarse sizes.
RETURNED = 2


def search_directions(model: Model, effect: Effect) -> Iterator[Real]:
    """Directions (k,) to the bounds of each parameter, and of all together."""
    own = [model.index(name) for name in effect.names]
    stated = model.stated[own]
    for bound in model.bounds(own):
        whole = bound - stated
        moved = np.flatnonzero(whole)
        yield from (np.where(np.arange(whole.size) == k, whole, 0.0) for k in moved)
        if moved.size > 1:
            yield whole


def corners(model: Model, effect: Effect, x: Real) -> list[Real]:
    """Points (p,) that models of an effect of any size must cover."""
    return [_sized(model, effect, x, direction, size)
            for direction in search_directions(model, effect) for size in MODELLED]


def scan_profiles(likelihood: Likelihood, effect: Effect, x: Real) -> list[InitialOptimum]:
    """The sizes of an effect of least cost, best first.

    Raises:
        NotConverged, NotEnriched, MeshError, InputError, ValueError: nothing can be predicted, or is admissible, at any
            size; the reason is that of the first one.
    """
    model, refused = likelihood.model, list[Exception]()
    own = [model.index(name) for name in effect.names]
    search = likelihood.search(Hypothesis((effect,)))
    steps = [each.step(SCAN_POINTS) for each in likelihood.objective.recordings]
    points = [x, *corners(model, effect, x)]
    thin = search.with_objective(search.objective.thinned(SCAN_POINTS).truncated(points, TRUNCATED))
    spreads = likelihood.point_deviations(LEVELS[0], steps)
    free = np.setdiff1d(search.free, own)

    def tried(direction: Real, size: float) -> InitialOptimum:
        """The place of a size with its cost; infinite without a prediction."""
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
    optima = [_lowest(profile, size, partial(tried, direction)) for direction, profile in profiles
              for size in SIZES if profile[size] is coarse[0] or _is_local_optimum(profile, size)]
    others = (each for each in coarse if not any(each is other for other in optima))
    return sorted([*optima, *others], key=lambda each: each.cost)[:RETURNED]


def _is_local_optimum(profile: Mapping[float, InitialOptimum], size: float) -> bool:
    """Whether both neighbouring sizes cost more, if there is a larger one."""
    at = SIZES.index(size)
    beside = [profile[other].cost for other in (*SIZES[max(at - 1, 0):at], *SIZES[at + 1:at + 2])]
    return at > 0 and all(profile[size].cost < cost for cost in beside)


def _lowest(
    profile: Mapping[float, InitialOptimum], size: float, tried: Callable[[float], InitialOptimum]
) -> InitialOptimum:
    """The optimum of least cost near a size, by halved steps."""
    at = SIZES.index(size)
    near = {other: profile[other] for other in SIZES[max(at - 1, 0):at + 2]}
    low = SIZES[at - 1] if at else 0.0
    for _ in range(HALVINGS):
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
