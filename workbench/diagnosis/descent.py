"""The one search: from places that the prior allows, with the weight of the data raised in a few steps.

Spectra have many optima, one for every way to lay the overtones of the model on those of the recording. Where points
weigh little (:data:`LEVELS`), and admittances are smoothed at first, there are few. A hypothesis that frees a parameter
which shifts overtones by more than they are apart (`belief.multimodal`) has more of them: along that one the cost is
looked at over its whole range, and every optimum on the way begins a descent (:func:`basins`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.likelihood import Hypothesis, Likelihood, Weighed
from workbench.fitting.parameter import Parameter
from workbench.fitting.search import NO_END, Optimum, Search

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

#: The ratio of neighbouring places where the cost is looked at over all that a length may be, and how many places where
#: a range begins at nothing.
RATIO, SCANNED = 1.3, 9

#: What begins does so no closer to the ends of its range than this share of it.
INSIDE = 1e-4

#: Steps of a look at one place of the scan, and of the descent from an optimum of it.
LOOK, DESCENT = 3, 8

#: Of the ends of one hypothesis so many are followed, of a cost within this of the best: odds of 3000.
KEPT, WINDOW = 3, 8.0

#: Chi-square relative to noise from which on other basins are looked at.
EXCESS = 1.5

#: Two optima are one where their parameters differ by less than so many uncertainties.
ALIKE = 0.3


def smoothed(likelihood: Likelihood, search: Search, x: Real, held: tuple[int, ...] = ()) -> Optimum:
    """The optimum at little weight that smoothed admittances lead to from x (p,).

    Parameters of the indices `held` move only after the others.
    """
    end = likelihood.tempered(search, x, LEVELS[0], smoothing=SMOOTHED, fixed=held)
    return likelihood.tempered(search, end.x, LEVELS[0])


def basins(likelihood: Likelihood, hypothesis: Hypothesis, x: Real, along: Mapping[int, Real]) -> list[Optimum]:
    """The optima at little weight near x (p,) and on the way along some parameters from there, best first.

    Args:
        along: places (k,), rising, at which the parameter of each index is held.
    """
    search, level = likelihood.search(hypothesis), LEVELS[0]
    end = likelihood.tempered(search, x, level)
    found = [end]
    for i, places in along.items():
        costs, ends = np.full(places.size, np.inf), [end.x] * places.size
        nearest = int(np.argmin(np.abs(places - end.x[i])))
        # From where the end is to either side, each place from the optimum of its neighbour.
        for order in (range(nearest, places.size), range(nearest - 1, -1, -1)):
            y = end.x
            for k in order:
                y = y.copy()
                y[i] = places[k]
                try:
                    held = likelihood.tempered(search, y, level, limit=LOOK, fixed=(i,))
                except NO_END:
                    break
                costs[k], ends[k], y = held.cost, held.x, held.x
        lowest = [k for k in range(places.size)
                  if np.isfinite(costs[k]) and costs[k] <= min(costs[max(k - 1, 0):k + 2])]
        for k in lowest:
            try:
                found.append(likelihood.tempered(search, ends[k], level, limit=DESCENT))
            except NO_END:
                continue
    return distinct(likelihood, found, lambda each: each.cost)


def within_range(parameter: Parameter) -> Real:
    """Where along a parameter to look for optima within all that it may be, (k,)."""
    low, high = parameter.low, parameter.high
    if low > 0.0:
        return _inside(parameter, np.geomspace(low, high, 2 + int(np.log(high / low) / np.log(RATIO))))
    return _inside(parameter, np.linspace(low, high, SCANNED))


def _inside(parameter: Parameter, values: Real) -> Real:
    return np.unique(inside(values, parameter.low, parameter.high))


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
        kept = [end for end in kept if end.log_evidence > kept[0].log_evidence - WINDOW][:KEPT]
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


def followed(likelihood: Likelihood, hypothesis: Hypothesis, starts: Sequence[Real], level: float) -> Candidate | None:
    """The ends (:data:`KEPT`) that the `starts` (p,) lead to where points have a further deviation of `level`.

    None if nothing can be predicted.
    """
    search = likelihood.search(hypothesis)
    for i in (likelihood.model.index(name) for effect in hypothesis.effects for name in effect.names):
        # What is admissible may be a million times what is there.
        moved = max(abs(float(start[i]) - search.centre[i]) for start in starts)
        search.scale[i] = moved or search.scale[i]
    ends = []
    for start in starts:
        try:
            ends.append(likelihood.descended(hypothesis, search, start, level, DESCENT))
        except NO_END:
            continue
    return Candidate.of(hypothesis, ends)
