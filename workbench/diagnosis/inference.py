"""From a model and its recordings to the explanations that are left: one search for every hypothesis.

Every hypothesis, that nothing is wrong among them, goes the same way: from the basins of the prior with the data
weighing little, through more weight, to the full one on models of its own place. After each stage those go on whose
evidence there is not far behind the best.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.descent import (
    LEVELS,
    Candidate,
    basins,
    followed,
    multimodal,
    within_knowledge,
    within_range,
)
from workbench.diagnosis.device import Model
from workbench.diagnosis.hypothesis import Effect
from workbench.diagnosis.likelihood import Explanation, Hypothesis, Likelihood
from workbench.diagnosis.ranking import Score, ranked
from workbench.fitting.objective import Objective
from workbench.fitting.search import NO_END, Optimum

T = TypeVar("T")

Real = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Error of Z that the first models are made for, within so many uncertainties of what is known, and those about an
#: optimum, within so many of its standard deviations.
WIDE, FAR = 3e-4, 1.5
FINE, NEAR = 3e-5, 2.0

#: Of the hypotheses that promise most at any place, so many are tried, if they promise this share of what the best
#: does, and more than the logarithm of these odds.
TRIED, SHARE, WORTH = 3, 0.3, 1.0

#: Descents begin in so many basins.
BASINS = 4

#: Of the hypotheses at one stage so many go on to the next, of log evidences within this of the best: odds of 200000.
GO_ON, CLOSE = (8, 4), 12.0

#: A further effect is looked for where the best explanation leaves a score of more than this (log odds), and so many
#: are tried beside it.
MORE, PAIRED = 3.0, 3

#: What nothing being wrong leaves at more weight, relative to noise, from which on other basins are looked at.
EXCESS = 1.5

#: Rounds and steps of a fit that is far behind.
HURRIED = {"rounds": 1, "limit": 8}

#: An optimum is looked for on models made again about it, at most so many times, until their estimated error there is
#: below the second number (ten to a hundred times the true one); where the data weigh little, below the third.
PLACES, TRUSTED, DOUBTED = 3, 0.05, 1.0

#: A hypothesis begins no closer to the ends of its range than this share of it.
INSIDE = 1e-4


@dataclass(frozen=True, eq=False)
class Settled:
    """An explanation at its own place with the likelihood there, and how well it predicts what was held out.

    ``held_out`` the log of the predictive density of the states held out, up to what all hypotheses share; ``seen``
    their impedances (n,) ohm.
    """

    explanation: Explanation
    likelihood: Likelihood
    held_out: float
    seen: tuple[NDArray[np.complex128], ...]


@dataclass(frozen=True, eq=False)
class Found:
    """What a search found.

    ``base`` that nothing is wrong; ``final`` all explanations at their own places, best first, the base among them;
    ``candidates`` how far the others came; ``scores`` at the base; ``undone`` what there was no time for.
    """

    base: Settled
    final: tuple[Settled, ...]
    candidates: tuple[Candidate, ...]
    scores: tuple[Score, ...]
    undone: tuple[str, ...] = ()


@dataclass(eq=False)
class Search:
    """A search as it goes on; :meth:`run` is all of it."""

    model: Model
    progress: Progress
    trace: bool = False
    started: float = field(default_factory=time.perf_counter)

    def say(self, *words: object) -> None:
        if self.trace:
            print(f"{time.perf_counter() - self.started:6.1f}", *words, flush=True)

    @cached_property
    def centre(self) -> Real:
        """What is stated (p,)."""
        return np.array([p.start for p in self.model.parameters])

    @cached_property
    def known_reach(self) -> dict[str, float]:
        return {p.name: FAR * p.prior for p in self.model.parameters[:self.model.known] if p.prior}

    @cached_property
    def wide(self) -> Objective:
        """The recordings predicted all over what is known."""
        return self.model.fitted.near(self.centre, self.known_reach, WIDE, only=range(self.model.known))

    def run(self) -> Found:
        nothing, model = Hypothesis(), self.model
        bare = Likelihood.bare(model, self.wide)
        self.say("wide", [p.model.basis.shape[1] for p in dict.fromkeys(self.wide.predictors) if p.model])
        search = bare.search(nothing)
        first = bare.tempered(search, self.centre, LEVELS[0])
        second = bare.tempered(search, first.x, LEVELS[1])
        likelihood = bare.with_patterns(second.x)
        worth, errors = likelihood.weighed(nothing, second.x, LEVELS[1])
        plain = Candidate(nothing, (second.x,), worth, errors, second.residual.data.error)
        self.say("levels", first.cost, second.cost, worth, self.excess(second))
        base, scores = None, list[Score]()
        if self.excess(second) < EXCESS:
            base = self.settled(plain)
            scores = self.further(base)
            if scores[0].evidence < WORTH and base.explanation.accuracy < 4e-3:
                return Found(base, (base,), (), tuple(scores))
        along = multimodal(bare, first.x)
        ends = basins(bare, search, first, {i: within_knowledge(model.parameters[i]) for i in along})[:BASINS]
        self.say("basins", [model.parameters[i].name for i in along], [round(e.cost, 1) for e in ends])
        if len(ends) > 1:
            again = self.onward(likelihood, followed(likelihood, nothing, [e.x for e in ends], LEVELS[1]), LEVELS[1])
            if again is not None and again.log_evidence > plain.log_evidence + 1.0:
                plain, base = again, None
                likelihood = bare.with_patterns(plain.x)
        places = [(end.x, ranked(bare, end.x, LEVELS[0])) for end in ends]
        seen = [*(scored for _, scored in places), ranked(bare, plain.x, LEVELS[1])]
        chosen = self.chosen([*seen, scores] if scores else seen, along)
        self.say("chosen", [effect.name for effect in chosen])
        little = []
        for effect in chosen:
            starts = [self.start(effect, x, next(s for s in scored if s.effect is effect)) for x, scored in places]
            own = [i for i in along if model.parameters[i].name in effect.names]
            found = self.explain(likelihood, Hypothesis((effect,)), starts, own, ends[0])
            if found is not None:
                little.append(found)
                self.say("   little", found[1].hypothesis.name, found[1].log_evidence, found[1].doubt)
        more = [plain]
        for wider, candidate in _best(little, GO_ON[0], lambda each: each[1].log_evidence):
            found_ = self.onward(wider, candidate, LEVELS[1])
            if found_ is not None:
                more.append(found_)
                self.say("   more", found_.hypothesis.name, found_.log_evidence - plain.log_evidence, found_.doubt)
        more += self.outside(likelihood, plain)
        leading = _best(more, GO_ON[1], lambda each: each.log_evidence)
        if base is None:
            base = self.settled(plain, hurried=plain not in leading)
        final = [base, *(self.settled(candidate) for candidate in leading if candidate is not plain)]
        final.sort(key=lambda each: -each.explanation.log_evidence)
        final += self.pairs(final)
        final.sort(key=lambda each: -each.explanation.log_evidence)
        return Found(base, tuple(final), tuple(more), tuple(scores))

    # ----------------------------------------------------------------------------------------------------------------

    def excess(self, end: Optimum) -> float:
        """What an end leaves where the data weigh more, relative to what noise would leave there."""
        noise = np.concatenate([np.tile(state.noise, 2) for state in self.model.campaign.fitted])
        expected = 0.5 * float(np.sum(noise**2 / (noise**2 + LEVELS[1] ** 2)))
        return end.cost / expected * noise.size / (2 * sum(len(log) for log in end.residual.data.log_ratio))

    def chosen(self, scores: Sequence[Sequence[Score]], along: Sequence[int]) -> list[Effect]:
        """The hypotheses that promise most anywhere, and those about a multimodal parameter."""
        found: dict[str, Effect] = {}
        for scored in scores:
            self.say("   ", [(round(s.evidence, 1), s.effect.name) for s in scored[:4]])
            for each in scored[:TRIED]:
                if each.evidence > max(WORTH, SHARE * scored[0].evidence):
                    found.setdefault(each.effect.name, each.effect)
        names = {self.model.parameters[i].name for i in along}
        return [*found.values(), *(effect for effect in self.model.effects
                                   if names & set(effect.names) and effect.name not in found)]

    def start(self, effect: Effect, x: Real, score: Score) -> Real:
        """Where a hypothesis begins at x (p,): with what its score asks for, or its error where that is larger."""
        model = self.model
        own = np.array([model.index(name) for name in effect.names])
        low, high = (np.array([getattr(model.parameters[i], side) for i in own]) for side in ("low", "high"))
        least = np.where(np.isfinite(score.error), np.minimum(score.error, 0.1 * (high - low)), 0.0)
        sign = np.where(score.amplitude < 0.0, -1.0, 1.0)
        asked = np.where(np.abs(score.amplitude) < least, sign * least, score.amplitude)
        y = x.copy()
        y[own] = np.clip(x[own] + asked, low + INSIDE * (high - low), high - INSIDE * (high - low))
        return y

    def explain(
        self, likelihood: Likelihood, hypothesis: Hypothesis, starts: Sequence[Real], along: Sequence[int], end: Optimum
    ) -> tuple[Likelihood, Candidate] | None:
        """Where a hypothesis leads from some starts (p,), and from the optima along some of its own parameters."""
        model, centre = self.model, self.centre
        own = [model.index(name) for effect in hypothesis.effects for name in effect.names]
        scans = {i: within_range(model.parameters[i]) for i in along}
        largest = max(starts, key=lambda y: float(np.abs(y[own] - centre[own]).sum()))
        corners = [_replaced(centre, own, largest[own]),
                   *(_replaced(centre, [i], value) for i, values in scans.items() for value in values[::3])]
        wider = likelihood.on(self.wide.widened(centre, corners, WIDE, only=self.moving(hypothesis)))
        if scans:
            found = basins(wider, wider.search(hypothesis), end, scans)
            self.say("   scanned", [(round(e.cost, 1), float(e.x[own[0]])) for e in found[:6]])
            starts = [*starts, *(each.x for each in found[:BASINS])]
        candidate = followed(wider, hypothesis, starts, LEVELS[0])
        return None if candidate is None else (wider, candidate)

    def onward(self, likelihood: Likelihood, candidate: Candidate | None, level: float) -> Candidate | None:
        """Where a candidate leads with the data weighing more, on models made again where these are in doubt."""
        if candidate is None:
            return None
        for _ in range(PLACES):
            if candidate.doubt < DOUBTED:
                break
            likelihood = self.about(likelihood, candidate)
            again = followed(likelihood, candidate.hypothesis, candidate.places[:1], LEVELS[0])
            if again is None:
                return None
            self.say("      renewed", candidate.hypothesis.name, candidate.doubt, again.doubt, again.log_evidence)
            candidate = again
        return followed(likelihood, candidate.hypothesis, candidate.places, level)

    def moving(self, hypothesis: Hypothesis) -> list[int]:
        """Indices of what moves under a hypothesis."""
        return self.model.free(hypothesis.effects)[0]

    def about(self, likelihood: Likelihood, candidate: Candidate) -> Likelihood:
        """The likelihood on models for all that is known about where a candidate is."""
        reach = dict(self.known_reach)
        for effect in candidate.hypothesis.effects:
            for name in effect.names:
                i = self.model.index(name)
                reach[name] = 0.3 * abs(float(candidate.x[i]) - self.centre[i])
        return likelihood.on(self.model.fitted.near(candidate.x, reach, WIDE, only=self.moving(candidate.hypothesis)))

    def outside(self, likelihood: Likelihood, plain: Candidate) -> list[Candidate]:
        """What is outside the catalogue, at the end of nothing being wrong: something in a region, or modes."""
        regions = dict.fromkeys(likelihood.anything.regions) if likelihood.anything is not None else {}
        every = [Hypothesis((), region) for region in regions]
        modes = likelihood.strongest_modes(plain.x, 1e-3)
        if modes:
            every.append(Hypothesis(modes=modes))
        found = []
        data = likelihood.data(plain.hypothesis, plain.x, LEVELS[1])
        for hypothesis in every:
            worth, errors = likelihood.weighed(hypothesis, plain.x, LEVELS[1], data)
            found.append(Candidate(hypothesis, plain.places, worth, errors, plain.doubt))
            self.say("   more", hypothesis.name, worth - plain.log_evidence)
        return found

    def settled(self, candidate: Candidate, *, hurried: bool = False) -> Settled:
        """The explanation that a candidate leads to, on models and with patterns of its own place.

        One that is far behind others is `hurried`: how far is all the same.
        """
        x, errors = candidate.x, candidate.errors
        fitted, held = ([state.name for state in states]
                        for states in (self.model.campaign.fitted, self.model.campaign.held_out))
        for _ in range(1 if hurried else PLACES):
            reach = {p.name: NEAR * float(error)
                     for p, error in zip(self.model.parameters, errors, strict=True) if error > 0.0}
            whole = self.model.whole.near(x, reach, FINE, only=self.moving(candidate.hypothesis))
            likelihood = Likelihood.bare(self.model, whole.of(fitted)).with_patterns(x)
            try:
                found = likelihood.settled(candidate.hypothesis, x, **(HURRIED if hurried else {}))
            except NO_END:
                self.say("   NO END", candidate.hypothesis.name)
                raise
            if found.doubt < TRUSTED:
                break
            x, errors = found.x, found.spread(x.size)
        e = found
        self.say("settled", e.hypothesis.name, e.log_evidence, "accuracy", e.accuracy, "size", e.size, "chi",
                 float(np.mean(e.residual.vector**2)), "doubt", e.doubt)
        density, seen = likelihood.predictive(found, whole.of(held)) if held else (0.0, ())
        return Settled(found, likelihood, density, seen)

    def further(self, settled: Settled) -> list[Score]:
        """The scores at an explanation of the effects that move nothing which its own do."""
        found = settled.explanation
        scores = ranked(settled.likelihood, found.x, 0.0, found)
        self.say("   further", found.hypothesis.name, [(round(s.evidence, 1), s.effect.name) for s in scores[:4]])
        return scores

    def pairs(self, final: Sequence[Settled]) -> list[Settled]:
        """The best explanation by one effect together with what promises most beside it."""
        singles = [each for each in final if len(each.explanation.hypothesis.effects) == 1]
        if not singles:
            return []
        best = singles[0]
        found = []
        for score in self.further(best)[:PAIRED]:
            if score.evidence > MORE:
                effects = (*best.explanation.hypothesis.effects, score.effect)
                begin = self.start(score.effect, best.explanation.x, score)
                errors = best.explanation.spread(begin.size)
                for name, error in zip(score.effect.names, score.error, strict=True):
                    i = self.model.index(name)
                    errors[i] = max(abs(begin[i] - best.explanation.x[i]), error if np.isfinite(error) else 0.0)
                try:
                    found.append(self.settled(Candidate(Hypothesis(effects), (begin,), 0.0, errors, 0.0)))
                except NO_END:
                    continue
        return found


def _best(found: Iterable[T], most: int, worth: Callable[[T], float]) -> list[T]:
    """At most so many, best first, of a worth within :data:`CLOSE` of the best."""
    ordered = sorted(found, key=lambda each: -worth(each))
    return [each for each in ordered if worth(each) > worth(ordered[0]) - CLOSE][:most]


def _replaced(x: Real, where: Sequence[int], values: float | Real) -> Real:
    y = x.copy()
    y[list(where)] = values
    return y
