"""Results of a search: optima on the way, explanations at their own optima, and all of them together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.device import Model
from workbench.diagnosis.likelihood import Explanation, Hypothesis, LaplaceApproximation
from workbench.diagnosis.odds import CLOSE
from workbench.diagnosis.ranking import Score
from workbench.search.optimum import distinct, is_same_optimum

T = TypeVar("T")

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Optima of one hypothesis that go on to the next stage, at most, if they are not far behind (`odds.CLOSE`).
KEPT = 3

#: Reduced chi-square at little weight from which on a hypothesis does not fit: tangents are not right for so much.
EXCESS = 1.5


@dataclass(frozen=True, eq=False)
class InitialOptimum:
    """An optimum ``x`` (p,) of that ``cost`` at little weight of the data, with the standard ``errors`` (p,) there,
    zero where they are not known."""

    x: Real
    cost: float
    errors: Real


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

    @classmethod
    def at(cls, hypothesis: Hypothesis, x: Real, errors: Real) -> Candidate:
        """A hypothesis to be refitted from x (p,), where nothing was evaluated yet."""
        return cls(hypothesis, (LaplaceApproximation(x, -np.inf, errors, np.inf, np.inf),))

    @property
    def x(self) -> Real:
        return self.ends[0].x

    @property
    def log_evidence(self) -> float:
        return self.ends[0].log_evidence

    @property
    def fits(self) -> bool:
        """Whether little more is left than the deviation that the points were given."""
        return self.ends[0].reduced_chi_square < EXCESS


@dataclass(frozen=True, eq=False)
class Alternative:
    """A hypothesis outside the catalogue beside an explanation: the log evidence that it ``gains``, and its deviations
    ``columns`` (m, k), in units of the noise, of all recordings, those held out last."""

    hypothesis: Hypothesis
    gains: float
    columns: Real


@dataclass(frozen=True, eq=False)
class Refitted:
    """An explanation refitted at full weight, with the scores of further effects, its alternatives, and its prediction
    of the states held out.

    ``every`` is the explanation where the states held out are data too, None without any, and ``held_out_impedances``
    (n,) ohm their prediction from the others alone; ``scores`` of effects on other parameters, best first.
    """

    explanation: Explanation
    every: Explanation | None = None
    held_out_impedances: tuple[Complex, ...] = ()
    scores: tuple[Score, ...] = ()
    alternatives: tuple[Alternative, ...] = ()

    @property
    def hypothesis(self) -> Hypothesis:
        return self.explanation.hypothesis

    @property
    def held_out(self) -> float:
        """The log of the density of the states held out, given the others, up to a constant of all hypotheses."""
        return 0.0 if self.every is None else self.every.log_evidence - self.explanation.log_evidence

    @property
    def total(self) -> float:
        """The log evidence of all recordings."""
        return (self.explanation if self.every is None else self.every).log_evidence

    def weighted(self, other: Refitted) -> Refitted:
        """A copy with the weights of another explanation."""
        every = None if self.every is None or other.every is None else self.every.weighted(other.every.weighting)
        return replace(self, explanation=self.explanation.weighted(other.explanation.weighting), every=every)

    def beside(self, alternative: Alternative) -> Refitted:
        """A hypothesis outside the catalogue at the optimum of this one."""
        def deviating(found: Explanation) -> Explanation:
            outside = alternative.columns[:found.local.residual.size]
            return replace(found, hypothesis=alternative.hypothesis, local=replace(found.local, outside=outside))

        return replace(self, explanation=deviating(self.explanation), alternatives=(), scores=(),
                       every=None if self.every is None else deviating(self.every))


@dataclass(frozen=True)
class NotTried:
    """A step of a search that failed, by its ``name``, and the ``reason``."""

    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class Found:
    """The results of a search.

    ``base`` is the null hypothesis; ``final`` all refitted explanations, best first, the base among them, all with the
    weights of the one that leaves least; ``candidates`` the others, at the last stage that each reached; ``undone``
    steps there was no time for, ``not_tried`` steps that failed; ``interrupted`` whether somebody stopped the search.
    """

    base: Refitted
    final: tuple[Refitted, ...]
    candidates: tuple[Candidate, ...] = ()
    undone: tuple[str, ...] = ()
    not_tried: tuple[NotTried, ...] = ()
    interrupted: bool = False


def alike_weighted(found: Sequence[Refitted]) -> list[Refitted]:
    """Explanations by the weights of the one of the catalogue that leaves least, best first."""
    best = leaving_least(found)
    return sorted((each.weighted(best) for each in found), key=lambda each: -each.total)


def of_catalogue(found: Sequence[Refitted]) -> list[Refitted]:
    """:func:`alike_weighted` of the explanations by the catalogue; evidences outside it are dear, and not asked for."""
    return alike_weighted([each for each in found if not each.hypothesis.is_outside])


def leaving_least(found: Sequence[Refitted]) -> Refitted:
    """The explanation of the catalogue that leaves least, by its own weights."""
    return max((each for each in found if not each.hypothesis.is_outside),
               key=lambda each: each.explanation.weighting.log_likelihood(each.explanation.remainder))


def leading_of(found: Iterable[T], most: int, worth: Callable[[T], float]) -> list[T]:
    """At most `most` of `found`, best first, of a worth within `odds.CLOSE` of the best."""
    ordered = sorted(found, key=lambda each: -worth(each))
    return [each for each in ordered if worth(each) > worth(ordered[0]) - CLOSE][:most]
