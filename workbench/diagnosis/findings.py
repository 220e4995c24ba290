"""Results of a search: initial optima, explanations, and all of them together."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from workbench.campaign.state import DeviceState, StateFit
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
    """An optimum ``x`` (p,) at low data weight: ``cost`` and ``errors`` (p,)."""

    x: Real
    cost: float
    errors: Real


#: An optimum x (p,) with its standard errors (p,), zero of parameters that did not move.
End = TypeVar("End", InitialOptimum, LaplaceApproximation)


def distinct_ends(model: Model, ends: Iterable[End], rank: Callable[[End], float]) -> list[End]:
    """The best end of every distinct optimum, of least `rank` first."""
    known = np.array([parameter.prior or 0.0 for parameter in model.parameters])
    return [best for best, *_ in distinct(
        ends, lambda end, best: is_same_optimum(end.x, best.x, best.errors, known), rank)]


@dataclass(frozen=True, eq=False)
class Candidate:
    """A hypothesis with its distinct optima (``ends``) at low data weight."""

    hypothesis: Hypothesis
    ends: tuple[LaplaceApproximation, ...]

    @classmethod
    def of(cls, model: Model, hypothesis: Hypothesis, ends: Iterable[LaplaceApproximation]) -> Candidate | None:
        """A hypothesis with its best distinct optima; None without `ends`."""
        kept = distinct_ends(model, ends, lambda each: -each.log_evidence)
        kept = [end for end in kept if end.log_evidence > kept[0].log_evidence - CLOSE][:KEPT]
        return cls(hypothesis, tuple(kept)) if kept else None

    @classmethod
    def at(cls, hypothesis: Hypothesis, x: Real, errors: Real) -> Candidate:
        """A hypothesis to refit from x (p,), not yet evaluated there."""
        return cls(hypothesis, (LaplaceApproximation(x, -np.inf, errors, np.inf, np.inf),))

    @property
    def x(self) -> Real:
        return self.ends[0].x

    @property
    def log_evidence(self) -> float:
        return self.ends[0].log_evidence

    @property
    def fits(self) -> bool:
        """Whether the residual is near the deviation given to the points."""
        return self.ends[0].reduced_chi_square < EXCESS


@dataclass(frozen=True, eq=False)
class Alternative:
    """A hypothesis outside the catalogue: the log evidence that it ``gains``. ``columns`` (m, k) are its deviations of
    all recordings in units of the noise, those held out last."""

    hypothesis: Hypothesis
    gains: float
    columns: Real

    @property
    def record(self) -> dict[str, Any]:
        """The suspected place, and its log evidence, also in sigmas."""
        modes = [f"{m.frequency / 1e6:.4f} MHz, Q about {m.quality:.0f}" for m in self.hypothesis.modes]
        return {"region": self.hypothesis.region or "mode", "kind": "mode" if modes else "anything",
                "sigmas": math.sqrt(2.0 * max(self.gains, 0.0)), "modes": modes, "evidence": self.gains}


@dataclass(frozen=True, eq=False)
class StatePrediction:
    """A state held out as others predict it: ``impedance`` (n,) ohm. The ``reduced`` chi-square counts the noise and
    the uncertainty of the parameters."""

    state: DeviceState
    impedance: Complex
    reduced: float


@dataclass(frozen=True, eq=False)
class Refitted:
    """An explanation refitted at full weight.

    ``every`` is the explanation where the states held out are data too, None without any; ``predicted`` are these
    states as the others predict them, with the parameters that act in them alone fitted; ``scores`` of further effects
    and ``alternatives``, best first.
    """

    explanation: Explanation
    every: Explanation | None = None
    predicted: tuple[StatePrediction, ...] = ()
    scores: tuple[Score, ...] = ()
    alternatives: tuple[Alternative, ...] = ()

    @property
    def hypothesis(self) -> Hypothesis:
        return self.explanation.hypothesis

    @property
    def held_out(self) -> float:
        """The log predictive density of the states held out. It is up to a constant of all hypotheses."""
        return 0.0 if self.every is None else self.every.log_evidence - self.explanation.log_evidence

    @property
    def total(self) -> float:
        """The log evidence of all recordings."""
        return (self.explanation if self.every is None else self.every).log_evidence

    def weighted(self, other: Refitted) -> Refitted:
        """A copy with the weights of another explanation."""
        every = self.every and other.every and self.every.weighted(other.every.weighting)
        return replace(self, explanation=self.explanation.weighted(other.explanation.weighting), every=every)

    def beside(self, alternative: Alternative) -> Refitted:
        """A hypothesis outside the catalogue at the optimum of this one."""
        def deviating(beside: Explanation) -> Explanation:
            outside = alternative.columns[:beside.local.residual.size]
            return replace(beside, hypothesis=alternative.hypothesis, local=replace(beside.local, outside=outside))

        return Refitted(deviating(self.explanation), self.every and deviating(self.every), self.predicted)


@dataclass(frozen=True)
class NotTried:
    """A failed step of a search: its ``name`` and the ``reason``."""

    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class Found:
    """The results of a search.

    ``base`` is the null hypothesis; ``final`` all refitted explanations, best first, the base among them, with the
    weights of the one of the largest likelihood; ``candidates`` the others, at the last stage of each. ``stated`` are
    all states as stated, those held out last; ``groups`` the names of effects that the recordings cannot tell apart;
    ``undone`` the steps without time, ``not_tried`` those that failed; ``interrupted`` whether by a user.
    """

    base: Refitted
    final: tuple[Refitted, ...]
    stated: tuple[StateFit, ...] = ()
    groups: tuple[tuple[str, ...], ...] = ()
    candidates: tuple[Candidate, ...] = ()
    undone: tuple[str, ...] = ()
    not_tried: tuple[NotTried, ...] = ()
    interrupted: bool = False


    def refit(self, name: str) -> Refitted:
        """The refitted explanation by the hypothesis of that name."""
        return next(each for each in self.final if each.hypothesis.name == name)


def alike_weighted(explanations: Sequence[Refitted]) -> list[Refitted]:
    """Explanations by the weights of :func:`most_likely`, best first."""
    best = most_likely(explanations)
    return sorted((each.weighted(best) for each in explanations), key=lambda each: -each.total)


def of_catalogue(explanations: Sequence[Refitted]) -> list[Refitted]:
    """:func:`alike_weighted` of the explanations by the catalogue; evidences outside it are expensive."""
    return alike_weighted([each for each in explanations if not each.hypothesis.is_outside])


def most_likely(explanations: Sequence[Refitted]) -> Refitted:
    """The catalogue explanation with the largest likelihood, by its own weights."""
    return max((each for each in explanations if not each.hypothesis.is_outside),
               key=lambda each: each.explanation.weighting.log_likelihood(each.explanation.remainder))


def leading_of(items: Iterable[T], most: int, worth: Callable[[T], float]) -> list[T]:
    """At most `most` items, best first, with a `worth` near the best."""
    ordered = sorted(items, key=lambda each: -worth(each))
    return [each for each in ordered if worth(each) > worth(ordered[0]) - CLOSE][:most]
