"""Tempered search: a sequence of problems, each begun at the last end.

Spectra have an optimum for every match of a model's overtones to those of a recording. There are few if admittances are
smoothed, or if points weigh little.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.jobs.progress import Progress, no_progress
from workbench.search.constrained import Minimum, Residuals

Real = NDArray[np.float64]


@dataclass(frozen=True)
class ContinuationStage:
    """One problem of a tempered search.

    ``deviation`` is the relative deviation that points are given beside their noise, and ``smoothing`` the half width
    of the Lorentzian that admittances are smoothed with, relative to the middle of the band. The stage ends after
    ``limit`` steps, or where no step promises to lower the cost by the share ``tolerance``. Parameters of the indices
    ``held`` do not move.
    """

    deviation: float
    smoothing: float = 0.0
    limit: int = 20
    tolerance: float = 1e-4
    held: tuple[int, ...] = ()


@dataclass(frozen=True)
class Schedule:
    """The stages of a tempered search, easiest problem first."""

    stages: tuple[ContinuationStage, ...]

    def resolved(self, spacing: float) -> Schedule:
        """The unsmoothed stages, and those resolved by a relative `spacing` of points."""
        return Schedule(tuple(each for each in self.stages if each.smoothing == 0.0 or each.smoothing > spacing))

    def holding(self, indices: tuple[int, ...]) -> Schedule:
        """A copy whose first stage holds the parameters of these `indices`."""
        first, *rest = self.stages
        return Schedule((replace(first, held=indices), *rest))


@dataclass(frozen=True, eq=False)
class TemperedMinimum(Minimum[Residuals]):
    """The end of a tempered search.

    ``begin`` (p,) is where it began. ``costs`` holds the cost at the end of every stage, by the stage's number, as far
    as the search went; ``ended`` is whether it went through all stages; ``iterations`` and ``refusals`` are those of
    all stages, the rest is that of the last one.
    """

    begin: Real
    costs: Mapping[int, float]
    ended: bool

#: Solves one stage from a point (p,).
SolveStage = Callable[[ContinuationStage, Real], Minimum[Residuals]]


def tempered(
    schedule: Schedule,
    solve: SolveStage[Residuals],
    begin: Real,
    *,
    first: int = 0,
    rival: TemperedMinimum[Residuals] | None = None,
    worse: float = np.inf,
    progress: Progress = no_progress,
) -> TemperedMinimum[Residuals]:
    """Solve the stages of `schedule`, each from the end of the last.

    The first one solved, number `first` or the last, starts from `begin` (p,). The search ends once a stage but the
    last costs more than `worse` times the cost of `rival`. `progress` is called after each stage.
    """
    x, iterations, refusals, costs = begin, 0, list[str](), dict[int, float]()
    last = len(schedule.stages) - 1
    for number in range(min(first, last), last + 1):
        found = solve(schedule.stages[number], x)
        x, iterations = found.x, iterations + found.iterations
        refusals += found.refusals
        costs[number] = found.cost
        progress("searching", (number + 1) / (last + 1))
        if rival is not None and found.cost > worse * rival.costs.get(number, np.inf):
            break
    return TemperedMinimum(x, found.residual, found.cost, found.converged, iterations, found.reason, tuple(refusals),
                           begin, costs, number == last)
