"""Progress of a piece of work, reported to its caller."""

from __future__ import annotations

import time
from collections.abc import Callable

#: Called with the present activity and the share of the work that is done, from 0 to 1. It may raise to stop the work.
Progress = Callable[[str, float], None]

#: Called with one of several parts of a work, its present activity, and the share of that.
PartProgress = Callable[[str, str, float], None]


def no_progress(_text: str, _share: float) -> None:
    """A :data:`Progress` that shows nothing."""


def by_part(progress: Progress) -> PartProgress:
    """Reports every part to `progress` as "part: activity"."""
    return lambda part, activity, share: progress(f"{part}: {activity}", share)


class Laps:
    """Seconds spent on one step after the other, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._started = time.perf_counter()

    def __call__(self, name: str) -> None:
        """End the step called `name` now."""
        now = time.perf_counter()
        self.seconds[name], self._started = now - self._started, now
