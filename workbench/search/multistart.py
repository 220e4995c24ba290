"""Descents from several starts; each end may change the starts that follow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from workbench.jobs.progress import Progress, no_progress

Real = NDArray[np.float64]
End = TypeVar("End")


@dataclass(frozen=True, eq=False)
class StartPoint:
    """A start ``x`` (p,) of a descent, and its first ``stage``. The stage is one of a continuation schedule."""

    label: str
    x: Real
    stage: int = 0


@dataclass(frozen=True, eq=False)
class Trial(Generic[End]):
    """A start and the end of its descent, or the error instead."""

    start: StartPoint
    end: End | None
    error: Exception | None = None

    @property
    def reason(self) -> str:
        """The error in words; empty without one."""
        return "" if self.error is None else f"{type(self.error).__name__}: {self.error}"


def multistart(
    starts: Iterable[StartPoint],
    descend: Callable[[StartPoint], End],
    *,
    refused: tuple[type[Exception], ...],
    tries: int | None = None,
    following: Callable[[Trial[End], list[StartPoint]], Sequence[StartPoint]] = lambda _trial, waiting: waiting,
    progress: Progress = no_progress,
) -> list[Trial[End]]:
    """Descend from each of `starts`, at most `tries` times; return all trials.

    An exception of a type in `refused` ends one descent without an end. `following` is called after each trial with the
    starts that wait, and returns those that follow: none to stop. `progress` is called before each descent.
    """
    waiting, trials = list(starts), list[Trial[End]]()
    while waiting and (tries is None or len(trials) < tries):
        start = waiting.pop(0)
        all_told = len(trials) + 1 + len(waiting)
        progress(start.label, len(trials) / (all_told if tries is None else min(tries, all_told)))
        try:
            trial = Trial(start, descend(start))
        except refused as error:
            trial = Trial(start, None, error)
        trials.append(trial)
        waiting = list(following(trial, waiting))
    return trials
