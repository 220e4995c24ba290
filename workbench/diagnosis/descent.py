"""The one search: from places that the prior allows, with the weight of the data raised in a few steps.

Spectra have many optima, one for every way to lay the overtones of the model on those of the recording. Where points
weigh little (:data:`LEVELS`), and admittances are smoothed at first, there are few. The ends that differ are kept on
the way, as long as they are not far behind the best.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.evidence import WrongEvidence
from workbench.diagnosis.likelihood import Hypothesis, Likelihood, Weighed
from workbench.diagnosis.odds import CLOSE
from workbench.fitting.search import NO_END, FitSearch, Optimum

Real = NDArray[np.float64]


class Placed(Protocol):
    """What has a place x (p,)."""

    @property
    def x(self) -> Real: ...


End = TypeVar("End", bound=Placed)

#: Further deviations of the points, from little weight of the data to more.
LEVELS = (0.05, 0.01)

#: Half width of the smoothing that a descent begins with, relative to the middle of the band. There are few ways to lay
#: what is left of the overtones on a recording.
SMOOTHED = 0.01

#: What begins does so no closer to the ends of its range than this share of it.
INSIDE = 1e-4

#: Steps of a descent.
DESCENT = 8

#: Of the ends of one hypothesis so many are followed, if they are not far behind (`odds.CLOSE`).
KEPT = 3

#: Chi-square relative to noise from which on other basins are looked at.
EXCESS = 1.5

#: What ends one start of several.
REFUSED: tuple[type[Exception], ...] = (*NO_END, WrongEvidence)

#: Two optima are one where their parameters differ by less than so many uncertainties.
ALIKE = 0.3


def smoothed(likelihood: Likelihood, search: FitSearch, x: Real, held: tuple[int, ...] = ()) -> Optimum:
    """The optimum at little weight that smoothed admittances lead to from x (p,).

    Parameters of the indices `held` move only after the others.
    """
    end = likelihood.tempered(search, x, LEVELS[0], smoothing=SMOOTHED, fixed=held)
    return likelihood.tempered(search, end.x, LEVELS[0])


def inside(values: Real, low: Real | float, high: Real | float) -> Real:
    """Values no closer to the ends of their range than :data:`INSIDE` of it."""
    margin = INSIDE * (high - low)
    return np.clip(values, low + margin, high - margin)


def distinct(likelihood: Likelihood, ends: Sequence[End], cost: Callable[[End], float]) -> list[End]:
    """Ends that differ, of least cost first."""
    known = slice(likelihood.model.known)
    scale = np.array([p.prior or np.inf for p in likelihood.model.parameters[known]])
    kept: list[End] = []
    for end in sorted(ends, key=cost):
        if all(np.abs((end.x[known] - other.x[known]) / scale).max() > ALIKE for other in kept):
            kept.append(end)
    return kept


@dataclass(frozen=True, eq=False)
class Candidate:
    """A hypothesis where it leads with the data weighing little.

    ``ends`` those that are left, best first.
    """

    hypothesis: Hypothesis
    ends: tuple[Weighed, ...]

    @classmethod
    def of(cls, hypothesis: Hypothesis, ends: Sequence[Weighed]) -> Candidate | None:
        """Of the ends that differ, those that are not far behind the best; None of none."""
        kept: list[Weighed] = []
        for end in sorted(ends, key=lambda each: -each.log_evidence):
            if not any(end.is_at(other) for other in kept):
                kept.append(end)
        kept = [end for end in kept if end.log_evidence > kept[0].log_evidence - CLOSE][:KEPT]
        return cls(hypothesis, tuple(kept)) if kept else None

    @property
    def weighed(self) -> Weighed:
        return self.ends[0]

    @property
    def x(self) -> Real:
        return self.weighed.x

    @property
    def log_evidence(self) -> float:
        return self.weighed.log_evidence

    @property
    def fits(self) -> bool:
        """Whether it leaves little more than noise and an accuracy that models have."""
        return self.weighed.left < EXCESS


def followed(likelihood: Likelihood, hypothesis: Hypothesis, starts: Sequence[Real], level: float) -> Candidate:
    """The ends (:data:`KEPT`) that the `starts` (p,) lead to where points have a further deviation of `level`.

    Raises:
        NotConverged, NotEnriched, MeshError, InputError, ValueError, ArithmeticError: no start leads anywhere; the
            reason is that of the last one.
    """
    search = likelihood.search(hypothesis)
    for i in (likelihood.model.index(name) for effect in hypothesis.effects for name in effect.names):
        # What is admissible may be a million times what is there.
        moved = max(abs(float(start[i]) - search.centre[i]) for start in starts)
        search.scale[i] = moved or search.scale[i]
    ends: list[Weighed] = []
    refused: Exception | None = None
    for start in starts:
        try:
            ends.append(likelihood.descended(hypothesis, search, start, level, DESCENT))
        except REFUSED as error:
            refused = error
    found = Candidate.of(hypothesis, ends)
    if found is None:
        raise refused or ValueError(f"{hypothesis.name}: no place to start from")
    return found
