"""Progress of a piece of work, as it is told to whoever asked for it."""

from __future__ import annotations

import time
from collections.abc import Callable

#: Called with what is being done and the share of it that is done, from 0 to 1. It may raise to stop the work.
Progress = Callable[[str, float], None]

#: Called with the part of a work that goes on beside others, what is being done for it, and the share of that.
PartProgress = Callable[[str, str, float], None]


def no_progress(_text: str, _share: float) -> None:
    """A :data:`Progress` that shows nothing."""


def by_part(progress: Progress) -> PartProgress:
    """Tells `progress` of every part as "part: what is done"."""
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
