"""Results of a search: initial optima, explanations at their own optima, and all of them together."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.descent import Candidate
from workbench.diagnosis.discrepancy import DiscrepancyModes
from workbench.diagnosis.likelihood import Explanation, Hypothesis
from workbench.diagnosis.odds import CLOSE
from workbench.diagnosis.ranking import Score

T = TypeVar("T")

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class InitialOptimum:
    """An optimum ``x`` (p,) of that ``cost`` at little weight of the data, with the standard ``errors`` (p,) there,
    zero where they are not known."""

    x: Real
    cost: float
    errors: Real


@dataclass(frozen=True, eq=False)
class Refitted:
    """An explanation refitted at full weight, with the scores of further effects, its alternatives, and its prediction
    of the states held out.

    ``scores`` of effects on other parameters, best first; ``alternatives`` are hypotheses outside the catalogue added
    to it, with their log evidences; ``held_out`` the log of the density of the states held out, given the others, up to
    a constant of all hypotheses, and ``held_out_impedances`` (n,) ohm as predicted from the others alone. ``columns``
    (m, k) and ``region_discrepancy`` are those of its likelihood.
    """

    explanation: Explanation
    scores: tuple[Score, ...]
    alternatives: tuple[tuple[Hypothesis, float], ...]
    held_out: float
    held_out_impedances: tuple[NDArray[np.complex128], ...]
    columns: Real
    region_discrepancy: DiscrepancyModes


@dataclass(frozen=True)
class NotTried:
    """A step of a search that failed, by its ``name``, and the ``reason``."""

    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class Found:
    """The results of a search.

    ``base`` is the null hypothesis; ``final`` all refitted explanations, best first, the base among them;
    ``candidates`` the others, at the last stage that each reached; ``undone`` steps there was no time for,
    ``not_tried`` steps that failed; ``interrupted`` whether somebody stopped the search.
    """

    base: Refitted
    final: tuple[Refitted, ...]
    candidates: tuple[Candidate, ...]
    undone: tuple[str, ...] = ()
    not_tried: tuple[NotTried, ...] = ()
    interrupted: bool = False


def candidate_evidence(candidate: Candidate) -> float:
    """The log evidence of a candidate: the larger, the better."""
    return candidate.log_evidence


def negative_evidence(refit: Refitted) -> float:
    """Minus the log evidence of an explanation: the smaller, the better."""
    return -refit.explanation.log_evidence


def leading_of(found: Iterable[T], most: int, worth: Callable[[T], float]) -> list[T]:
    """At most `most` of `found`, best first, of a worth within `odds.CLOSE` of the best."""
    ordered = sorted(found, key=lambda each: -worth(each))
    return [each for each in ordered if worth(each) > worth(ordered[0]) - CLOSE][:most]
