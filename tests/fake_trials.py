"""What stands for the diagnosis of a trial: a module of its own, which a process loads at once."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

SAID: dict[str, Any] = {"verdict": "below_detection", "effects": [], "rivals": [], "location": [{"region": "couplant"}],
                        "held_out": {"again": {"after": {"reduced_chi_square": 1.0}}},
                        "scores": [{"effect": "fluid absorption"}]}


def stands_in(trial: Path) -> dict[str, Any]:
    """By the number of the trial: an answer, an error, none."""
    if trial.name.endswith("1"):
        raise ValueError("a radius came too close to another")
    if trial.name.endswith("2"):
        time.sleep(600.0)
    return SAID


def late(marks: Path, trial: Path) -> dict[str, Any]:
    """An answer, after a while in which it may be ended; a file in `marks` has the number of its process."""
    (marks / str(os.getpid())).touch()
    time.sleep(2.0)
    return SAID
