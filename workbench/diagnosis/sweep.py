"""What an effect of any size would leave, with the known numbers where they are believed to be.

Where an effect is large, no tangent at nothing says so, and where nothing being wrong ends, the known numbers have been
pulled to where they make up for some of it. From where they are believed to be instead, every hypothesis is looked at
in several sizes, the known numbers making up for what they can to first order. It is the profile of the cost along each
of its numbers, coarse at first.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.descent import LEVELS, inside
from workbench.diagnosis.device import Model
from workbench.diagnosis.findings import InitialOptimum
from workbench.diagnosis.hypothesis import Effect
from workbench.diagnosis.likelihood import Hypothesis, Likelihood
from workbench.diagnosis.starts import replaced
from workbench.fitting.search import NO_END

Real = NDArray[np.float64]

#: Sizes that are looked at, in shares of the way to what a number may be at most, or at least.
SIZES = (0.01, 0.03, 0.1, 0.3, 0.6, 0.95)

#: The sizes that models hold for: the span of what they change serves beyond, and between.
HELD = (0.1, 0.3, 0.6)

#: A recording is looked at in about so many of its points.
LOOKED_AT = 41

#: Between the sizes beside the best one, so many times, others are looked at.
HALVED = 2

#: So many of the places are left.
LEFT = 3


def ways(model: Model, effect: Effect) -> Iterator[Real]:
    """From nothing to all that each of the numbers (k,) of an effect may be, of all together too."""
    own = [model.index(name) for name in effect.names]
    stated = np.array([model.parameters[i].start for i in own])
    for bound in model.bounds(own):
        whole = bound - stated
        moved = np.flatnonzero(whole)
        yield from (np.where(np.arange(whole.size) == k, whole, 0.0) for k in moved)
        if moved.size > 1:
            yield whole


def corners(model: Model, effect: Effect, x: Real) -> list[Real]:
    """Places (p,) about which models have to hold for an effect of any size at x (p,)."""
    return [_sized(model, effect, x, way, size) for way in ways(model, effect) for size in HELD]


def swept(likelihood: Likelihood, effect: Effect, x: Real) -> list[InitialOptimum]:
    """The sizes of an effect at x (p,) that leave least where the data weigh little, best first.

    Raises:
        NotConverged, NotEnriched, MeshError, InputError, ValueError: nothing can be predicted, or is admissible, at any
            size; the reason is that of the first one.
    """
    model, found = likelihood.model, dict[tuple[int, float], InitialOptimum]()
    hypothesis = Hypothesis((effect,))
    own = [model.index(name) for name in effect.names]
    search, every = likelihood.search(hypothesis), [each.step(LOOKED_AT) for each in likelihood.objective.recordings]
    thin, spreads = search.on(search.objective.thinned(LOOKED_AT)), likelihood.spreads(LEVELS[0], every)
    free = np.setdiff1d(search.free, own)
    directions = list(ways(model, effect))
    refused: list[Exception] = []

    def look(way: int, sizes: Sequence[float]) -> None:
        for size in sizes:
            place = _sized(model, effect, x, directions[way], size)
            try:
                seen = thin.evaluate(place, spreads, free=frozenset(map(int, free)))
            except NO_END as error:
                refused.append(error)
                continue
            step = np.linalg.lstsq(seen.jacobian[:, free], -seen.vector, rcond=None)[0]
            cost = 0.5 * float(np.sum((seen.vector + seen.jacobian[:, free] @ step) ** 2))
            found[way, size] = InitialOptimum(place, cost, np.zeros(place.size))

    for way in range(len(directions)):
        look(way, SIZES)
    for _ in range(HALVED):
        if not found and refused:
            raise refused[0]
        if not found:
            return []
        way, size = min(found, key=lambda each: found[each].cost)
        known = sorted({0.0, *(other for number, other in found if number == way)})
        at = known.index(size)
        beside = [*known[at - 1:at], *known[at + 1:at + 2]]
        look(way, [0.5 * (size + other) for other in beside])
    return sorted(found.values(), key=lambda each: each.cost)[:LEFT]


def _sized(model: Model, effect: Effect, x: Real, way: Real, size: float) -> Real:
    """x (p,) with an effect of some size."""
    own = [model.index(name) for name in effect.names]
    low, high = model.bounds(own)
    stated = np.array([model.parameters[i].start for i in own])
    return replaced(x, own, inside(stated + size * way, low, high))
