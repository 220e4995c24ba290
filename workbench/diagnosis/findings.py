"""What a search finds: where it begins, explanations at their own places, and all of them together."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.descent import Candidate
from workbench.diagnosis.inaccuracy import Patterns
from workbench.diagnosis.likelihood import Explanation, Hypothesis
from workbench.diagnosis.odds import CLOSE
from workbench.diagnosis.ranking import Score

T = TypeVar("T")

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class InitialOptimum:
    """An optimum ``x`` (p,) of that ``cost`` where the data weigh little, with the standard ``errors`` (p,) there, zero
    where they are not known."""

    x: Real
    cost: float
    errors: Real


@dataclass(frozen=True, eq=False)
class Settled:
    """An explanation at its own place, what else would be worth adding, and how well it predicts what was held out.

    ``scores`` of what moves nothing that it does, best first; ``beside`` what is outside the catalogue beside it, with
    its log evidence; ``held_out`` the log of the density of the states held out, given the others, up to what all
    hypotheses share, and ``seen`` their impedances (n,) ohm as predicted from the others alone. ``columns`` (m, k) and
    ``anything`` as of its likelihood.
    """

    explanation: Explanation
    scores: tuple[Score, ...]
    beside: tuple[tuple[Hypothesis, float], ...]
    held_out: float
    seen: tuple[NDArray[np.complex128], ...]
    columns: Real
    anything: Patterns


@dataclass(frozen=True)
class NotTried:
    """What of a search could not be done, by its ``name``, and the ``reason``."""

    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class Found:
    """What a search found.

    ``base`` that nothing is wrong; ``final`` all explanations at their own places, best first, the base among them;
    ``candidates`` how far the others came; ``undone`` what there was no time for, ``not_tried`` what could not be done;
    ``interrupted`` whether somebody stopped it.
    """

    base: Settled
    final: tuple[Settled, ...]
    candidates: tuple[Candidate, ...]
    undone: tuple[str, ...] = ()
    not_tried: tuple[NotTried, ...] = ()
    interrupted: bool = False


def promise(candidate: Candidate) -> float:
    """The log evidence of a candidate: the larger, the better."""
    return candidate.log_evidence


def weakness(settled: Settled) -> float:
    """Minus the log evidence of an explanation: the smaller, the better."""
    return -settled.explanation.log_evidence


def leading_of(found: Iterable[T], most: int, worth: Callable[[T], float]) -> list[T]:
    """At most so many, best first, of a worth within `odds.CLOSE` of the best."""
    ordered = sorted(found, key=lambda each: -worth(each))
    return [each for each in ordered if worth(each) > worth(ordered[0]) - CLOSE][:most]
