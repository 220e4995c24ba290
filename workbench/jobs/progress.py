"""Progress of a piece of work, as it is told to whoever asked for it."""

from __future__ import annotations

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
