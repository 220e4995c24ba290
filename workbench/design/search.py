"""Multi-start search, its distinct optima, and fronts between two objectives.

Each start evaluates its own evenly spread points (Sobol) and descends from the best of them, independently of the other
starts. So the share of starts that end at the best optimum shows how reliable it is within the ranges.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from workbench.design.descent import DesignDescent, descend
from workbench.design.goal import DesignObjective, SearchOptions
from workbench.design.nonlinear_programme import NonlinearProgramme, ProgrammePoint
from workbench.design.requirement import Bound
from workbench.jobs.workers import Workers, itself
from workbench.search.optimum import distinct, is_same_optimum

Real = NDArray[np.float64]

#: Points closer than this in every unknown usually lead to the same end: only one of them starts a descent.
BESIDE = 0.1


@dataclass(frozen=True, eq=False)
class Optimum:
    """An optimum that one or more starts found.

    ``descent`` is the best one that ends there, ``starts`` are the numbers of the starts.
    """

    descent: DesignDescent
    starts: tuple[int, ...]

    @property
    def point(self) -> ProgrammePoint:
        return self.descent.point


@dataclass(frozen=True, eq=False)
class Attempt:
    """One start: its number, and its descents, best first."""

    number: int
    descents: tuple[DesignDescent, ...]

    @property
    def best(self) -> DesignDescent:
        return self.descents[0]


def attempt(
    programme: NonlinearProgramme, search: SearchOptions, number: int, present: Real | None = None,
    stock: Mapping[str, float] = MappingProxyType({}),
) -> Attempt:
    """Run the start of that number, with the `stock` lengths (m) fixed.

    With `present` (n,) a descent also begins at that point.
    """
    free = [each.name not in stock for each in programme.variables]
    programme = programme.holding(stock)
    size = len(programme.variables)
    # Sobol points are even in powers of two; surplus points are not evaluated.
    drawn = qmc.Sobol(size, seed=np.random.default_rng([search.seed, number])).random_base2(
        math.ceil(math.log2(search.looked_at)))[: search.looked_at] if size else ()
    looked_at = sorted((programme(x, gradient=False) for x in drawn), key=lambda each: each.rank)
    starts = [] if present is None else [present[free]]
    for point in looked_at:
        if len(starts) < search.descended and not any(np.all(np.abs(point.x - x) < BESIDE) for x in starts):
            starts.append(point.x)
    found = [descend(programme, x, evaluations=search.evaluations) for x in starts]
    return Attempt(number, tuple(sorted(found, key=lambda each: each.point.rank)))


def search_all(
    programme: NonlinearProgramme, search: SearchOptions, present: Real, *, workers: Workers,
    finished: Callable[[Attempt, float], None] | None = None, stock: Sequence[Mapping[str, float]] = (),
) -> list[Attempt]:
    """Run all starts, and return them in the order of their numbers.

    With `stock` lengths (m) there is one start for each choice of them. `finished` is called with each start as it
    ends, in any order, and the share that has ended.
    """
    starts = [partial(attempt, search=search, number=number, present=present if number == 0 or stock else None,
                      stock=each) for number, each in enumerate(stock or [{}] * search.starts)]
    attempts: list[Attempt] = []
    workers.share(itself, programme)
    for _, done in workers.completed(enumerate(starts)):
        attempts.append(done.result())
        if finished is not None:
            finished(attempts[-1], len(attempts) / len(starts))
    return sorted(attempts, key=lambda each: each.number)


def optima(attempts: Sequence[Attempt]) -> list[Optimum]:
    """The distinct optima, best first.

    Ends that are not stationary are compared like the others. Each start is assigned to the optimum that its best
    descent reached.
    """
    ends = [(each, start.number) for start in attempts for each in start.descents]
    groups = distinct(ends, lambda end, best: _same(end[0].point, best[0].point), lambda end: end[0].point.rank)
    best = {start.number: start.best for start in attempts}
    return [Optimum(group[0][0], tuple(sorted(number for end, number in group if end is best[number])))
            for group in groups]


def _same(one: ProgrammePoint, other: ProgrammePoint) -> bool:
    """Whether two points with figures are one optimum.

    The scale of an unknown is its range.
    """
    return one.exists and other.exists and is_same_optimum(one.x, other.x, np.zeros(one.x.size), 1.0)


def front(
    programme: NonlinearProgramme, objectives: Sequence[DesignObjective], search: SearchOptions, present: Real,
    points: int, *, workers: Workers, say: Callable[[float], None] = lambda share: None,
) -> list[tuple[NonlinearProgramme, DesignDescent]]:
    """The Pareto front between two objectives, as `points` descents.

    The descents run from the optimum of the first objective to that of the second, each with its programme. One
    objective is optimised with a bound on the other (epsilon-constraint method); the bound moves in equal steps of its
    logarithm. The front is empty if a figure does not exist.
    """
    one, other = (programme.under(each) for each in objectives)
    first, last = (attempt(each, search, 0, present).best for each in (one, other))
    if not (first.point.exists and last.point.exists):
        return []
    second = objectives[1]
    begin, end = other(first.point.x, gradient=False).objective, last.point.objective
    tasks, bounds = [], []
    for share in np.linspace(0.0, 1.0, points)[1:]:
        level = begin + (end - begin) * share
        limit = math.exp(-level if second.maximise else level)
        bounds.append(Bound({second.figure: 1.0}, limit, second.maximise, limit,
                            f"{second.figure} {'>=' if second.maximise else '<='} {limit:.6g}"))
        tasks.append(partial(_descended, bound=bounds[-1], evaluations=search.evaluations,
                             start=first.point.x + share * (last.point.x - first.point.x)))
    found = [(one, first)] * points
    workers.share(itself, one)
    for count, (index, done) in enumerate(workers.completed(enumerate(tasks)), 1):
        found[index + 1] = _bounded(one, bounds[index]), done.result()
        say(count / len(tasks))
    return found


def _bounded(programme: NonlinearProgramme, bound: Bound) -> NonlinearProgramme:
    """The programme with one more bound."""
    return replace(programme, bounds=(*programme.bounds, bound))


def _descended(programme: NonlinearProgramme, *, bound: Bound, start: Real, evaluations: int) -> DesignDescent:
    return descend(_bounded(programme, bound), start, evaluations=evaluations)
