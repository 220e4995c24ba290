"""Descents of the diagnosis: from points of the prior, with the weight of the data raised in a few stages.

Where points weigh little (:data:`LEVELS`), and admittances are smoothed at first, there are few optima. The distinct
ones are kept from stage to stage, as long as they are not far behind the best.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.device import Model
from workbench.diagnosis.evidence import WrongEvidence
from workbench.diagnosis.likelihood import Hypothesis, LaplaceApproximation, Likelihood
from workbench.diagnosis.odds import CLOSE
from workbench.fitting.search import NO_END, FitSearch, Optimum
from workbench.search.continuation import ContinuationStage, Schedule, tempered
from workbench.search.multistart import StartPoint, multistart
from workbench.search.optimum import distinct, is_same_optimum

Real = NDArray[np.float64]


#: Further deviations of the points, from little weight of the data to more.
LEVELS = (0.05, 0.01)

#: A stage at little weight.
STAGE = ContinuationStage(LEVELS[0], limit=8, tolerance=0.01)

#: The stages that every search begins with: smoothed admittances leave few ways to lay overtones on a recording.
SCHEDULE = Schedule((replace(STAGE, smoothing=0.01), STAGE))

#: Descents begin no closer to the ends of a range than this share of it.
INSIDE = 1e-4

#: Optima of one hypothesis that go on to the next stage, at most, if they are not far behind (`odds.CLOSE`).
KEPT = 3

#: Chi-square relative to noise from which on other basins are looked at.
EXCESS = 1.5

#: Errors that end one start of several.
REFUSED: tuple[type[Exception], ...] = (*NO_END, WrongEvidence)


def initial_optimum(likelihood: Likelihood, search: FitSearch, x: Real, held: tuple[int, ...] = ()) -> Optimum:
    """The optimum at little weight that a search through smoothed admittances reaches from x (p,).

    Parameters of the indices `held` move only after the others.
    """
    return tempered(SCHEDULE.holding(held), lambda stage, x: likelihood.solve(search, stage, x), x)


def inside(values: Real, low: Real | float, high: Real | float) -> Real:
    """Values no closer to the ends of their range than :data:`INSIDE` of it."""
    margin = INSIDE * (high - low)
    return np.clip(values, low + margin, high - margin)


class OptimumFound(Protocol):
    """An end at x (p,), and the standard errors (p,) there, zero of parameters that did not move."""

    @property
    def x(self) -> Real: ...

    @property
    def errors(self) -> Real: ...


End = TypeVar("End", bound=OptimumFound)


def distinct_ends(model: Model, ends: Iterable[End], rank: Callable[[End], float]) -> list[End]:
    """The best end of every distinct optimum, of least `rank` first; the priors give the scale of each parameter."""
    known = np.array([parameter.prior or 0.0 for parameter in model.parameters])
    return [best for best, *_ in distinct(
        ends, lambda end, best: is_same_optimum(end.x, best.x, best.errors, known), rank)]


@dataclass(frozen=True, eq=False)
class Candidate:
    """A hypothesis with its optima at little weight of the data.

    ``ends`` are the distinct optima that are left, best first, each by its Laplace approximation.
    """

    hypothesis: Hypothesis
    ends: tuple[LaplaceApproximation, ...]

    @classmethod
    def of(cls, model: Model, hypothesis: Hypothesis, ends: Iterable[LaplaceApproximation]) -> Candidate | None:
        """The best ends of the distinct optima that are not far behind the best one; None without ends."""
        kept = distinct_ends(model, ends, lambda each: -each.log_evidence)
        kept = [end for end in kept if end.log_evidence > kept[0].log_evidence - CLOSE][:KEPT]
        return cls(hypothesis, tuple(kept)) if kept else None

    @property
    def laplace(self) -> LaplaceApproximation:
        return self.ends[0]

    @property
    def x(self) -> Real:
        return self.laplace.x

    @property
    def log_evidence(self) -> float:
        return self.laplace.log_evidence

    @property
    def fits(self) -> bool:
        """Whether little more is left than noise and a usual inaccuracy of the model."""
        return self.laplace.reduced_chi_square < EXCESS


def refit_from(likelihood: Likelihood, hypothesis: Hypothesis, starts: Sequence[Real], level: float) -> Candidate:
    """The optima (at most :data:`KEPT`) of a hypothesis from `starts` (p,), with points of a further deviation `level`.

    Raises:
        NotConverged, NotEnriched, MeshError, InputError, ValueError, ArithmeticError: no start leads anywhere; the
            reason is that of the last one.
    """
    search = likelihood.search(hypothesis)
    for i in (likelihood.model.index(name) for effect in hypothesis.effects for name in effect.names):
        # The admissible range may be a million times the value.
        moved = max(abs(float(start[i]) - search.centre[i]) for start in starts)
        search.scale[i] = moved or search.scale[i]
    stage = replace(STAGE, deviation=level)
    trials = multistart([StartPoint(hypothesis.name, start) for start in starts],
                        lambda start: likelihood.stage_optimum(hypothesis, search, start.x, stage), refused=REFUSED)
    found = Candidate.of(likelihood.model, hypothesis, (trial.end for trial in trials if trial.end is not None))
    if found is None:
        refused = next((trial.error for trial in reversed(trials) if trial.error is not None), None)
        raise refused or ValueError(f"{hypothesis.name}: no place to start from")
    return found
