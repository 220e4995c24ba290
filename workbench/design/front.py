"""The front between two objectives by the epsilon-constraint method: one is optimised, the other one is bounded."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from workbench.design.descent import DesignDescent, descend
from workbench.design.goal import DesignObjective, SearchOptions
from workbench.design.nonlinear_programme import NonlinearProgramme
from workbench.design.requirement import Bound
from workbench.design.search import attempt
from workbench.jobs.workers import Workers, itself

Real = NDArray[np.float64]


def front(
    programme: NonlinearProgramme, objectives: Sequence[DesignObjective], search: SearchOptions, present: Real,
    points: int, *, workers: Workers, say: Callable[[float], None] = lambda share: None,
) -> list[tuple[NonlinearProgramme, DesignDescent]]:
    """Descents to `points` points from the optimum of the first objective to that of the second, with their programmes.

    The bound of the second objective falls in equal steps of its logarithm. No point if a figure does not exist.
    """
    one, other = (programme.under(each) for each in objectives)
    first, last = (attempt(each, search, 0, present).best for each in (one, other))
    if not (first.point.exists and last.point.exists):
        return []
    second = objectives[1]
    ends = other(first.point.x, gradient=False).objective, last.point.objective
    shares, bounded = np.linspace(0.0, 1.0, points)[1:], list[NonlinearProgramme]()
    for level in ends[0] + (ends[1] - ends[0]) * shares:
        limit = math.exp(-level if second.maximise else level)
        bound = Bound({second.figure: 1.0}, limit, second.maximise, limit,
                      f"{second.figure} {'>=' if second.maximise else '<='} {limit:.6g}")
        bounded.append(replace(one, bounds=(*one.bounds, bound)))
    starts = [first.point.x + share * (last.point.x - first.point.x) for share in shares]
    workers.share(itself, search.evaluations)
    tasks = [partial(_descended, programme=each, start=start) for each, start in zip(bounded, starts, strict=True)]
    descents = [first] * len(tasks)
    for count, (index, done) in enumerate(workers.completed(enumerate(tasks)), 1):
        descents[index] = done.result()
        say(count / len(tasks))
    return list(zip((one, *bounded), (first, *descents), strict=True))


def _descended(evaluations: int, *, programme: NonlinearProgramme, start: Real) -> DesignDescent:
    return descend(programme, start, evaluations=evaluations)
