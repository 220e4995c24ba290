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
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.campaign import Campaign
from workbench.diagnosis.descent import (
    LEVELS,
    Candidate,
    basins,
    followed,
    multimodal,
    within_knowledge,
    within_range,
)
from workbench.diagnosis.device import Model, model
from workbench.diagnosis.hypothesis import Effect
from workbench.diagnosis.likelihood import Explanation, Hypothesis, Likelihood
from workbench.diagnosis.ranking import Score, ranked
from workbench.diagnosis.workers import Task, Workers
from workbench.discretisation import Discretisation
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
    """An explanation at its own place, what else would be worth adding, and how well it predicts what was held out.

    ``scores`` of what moves nothing that it does, best first; ``held_out`` the log of the predictive density of the
    states held out, up to what all hypotheses share; ``seen`` their impedances (n,) ohm.
    """

    explanation: Explanation
    scores: tuple[Score, ...]
    held_out: float
    seen: tuple[NDArray[np.complex128], ...]


@dataclass(frozen=True, eq=False)
class Found:
    """What a search found.

    ``base`` that nothing is wrong; ``final`` all explanations at their own places, best first, the base among them;
    ``candidates`` how far the others came; ``undone`` what there was no time for.
    """

    base: Settled
    final: tuple[Settled, ...]
    candidates: tuple[Candidate, ...]
    undone: tuple[str, ...] = ()


@dataclass(eq=False)
class Search:
    """A search as it goes on; :meth:`run` is all of it, with `workers` that each have one of their own."""

    model: Model
    progress: Progress = lambda _text, _share: None
    trace: Callable[[str], None] | None = None
    started: float = field(default_factory=time.perf_counter)

    @classmethod
    def of_campaign(cls, campaign: Campaign, accuracy: float | Discretisation, cache: Path | None) -> Search:
        """A search for a worker, with its first models."""
        made = cls(model(campaign, accuracy=accuracy, cache=cache))
        _ = made.wide
        return made

    def say(self, *words: object) -> None:
        if self.trace is not None:
            self.trace(" ".join([f"{time.perf_counter() - self.started:6.1f}", *map(str, words)]))

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

    def bare(self) -> Likelihood:
        """Of noise alone, all over what is known."""
        return Likelihood.bare(self.model, self.wide)

    def likelihood(self, x: Real) -> Likelihood:
        """All over what is known, with what the model does not get right at x (p,)."""
        key = x.tobytes()
        if key not in self._likelihoods:
            self._likelihoods = {key: self.bare().with_patterns(x)}
        return self._likelihoods[key]

    _likelihoods: dict[bytes, Likelihood] = field(default_factory=dict)

    def run(self, workers: Workers | None = None) -> Found:
        """The explanations of the recordings.

        Raises:
            NotEnriched, MeshError: the device as it is stated cannot be predicted.
        """
        def work(tasks: Sequence[Task]) -> list[Any]:
            if workers is None:
                return [getattr(self, name)(*given) for name, given in tasks]
            return workers.map(self, tasks)

        nothing, model = Hypothesis(), self.model
        bare = self.bare()
        self.say("wide", [p.model.basis.shape[1] for p in dict.fromkeys(self.wide.predictors) if p.model])
        search = bare.search(nothing)
        first = bare.tempered(search, self.centre, LEVELS[0])
        second = bare.tempered(search, first.x, LEVELS[1])
        worth, errors = self.likelihood(second.x).weighed(nothing, second.x, LEVELS[1])
        plain = Candidate(nothing, (second.x,), worth, errors, second.residual.data.error)
        self.say("levels", first.cost, second.cost, worth, self.excess(second))
        base = None
        if self.excess(second) < EXCESS:
            base = self.settled(plain, False, True)
            if base.scores[0].evidence < WORTH and base.explanation.accuracy < 4e-3:
                return Found(base, (base,), ())
        along = multimodal(bare, first.x)
        ends = basins(bare, nothing, first.x, {i: within_knowledge(model.parameters[i]) for i in along})[:BASINS]
        self.say("basins", [model.parameters[i].name for i in along], [round(e.cost, 1) for e in ends])
        if len(ends) > 1:
            again = self.onward(followed(self.likelihood(plain.x), nothing, [e.x for e in ends], LEVELS[1]), plain.x)
            if again is not None and again.log_evidence > plain.log_evidence + 1.0:
                plain, base = again, None
        at = plain.x
        *places, last = work([*(("scored", (end.x, LEVELS[0])) for end in ends), ("scored", (at, LEVELS[1]))])
        chosen = self.chosen([*places, last, *([base.scores] if base else [])], along)
        self.say("chosen", [effect.name for effect in chosen])
        little = work([("explain", (effect.name, at, first.x, along, [
            self.start(effect, end.x, next(s for s in scored if s.effect.name == effect.name))
            for end, scored in zip(ends, places, strict=True)])) for effect in chosen])
        promising = _best([found for found in little if found is not None], GO_ON[0], lambda each: each.log_evidence)
        more = [plain, *(found for found in work([("onward", (candidate, at)) for candidate in promising])
                         if found is not None)]
        for candidate in more:
            self.say("   more", candidate.hypothesis.name, candidate.log_evidence - plain.log_evidence, candidate.doubt)
        more += self.outside(plain)
        leading = _best(more, GO_ON[1], lambda each: each.log_evidence)
        asked = [("settled", (candidate, False, candidate is leading[0])) for candidate in leading
                 if base is None or candidate is not plain]
        if base is None and plain not in leading:
            asked.append(("settled", (plain, True, False)))
        final = work(asked)
        base = base or next(each for each in final if each.explanation.hypothesis.name == nothing.name)
        final = sorted({id(each): each for each in (base, *final)}.values(), key=_worth)
        final = sorted([*final, *work(self.pairs(final))], key=_worth)
        return Found(base, tuple(final), tuple(more))

    def scored(self, x: Real, level: float) -> list[Score]:
        """The scores of all hypotheses at x (p,)."""
        return ranked(self.bare(), x, level)

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
        self, name: str, at: Real, x: Real, along: Sequence[int], starts: Sequence[Real]
    ) -> Candidate | None:
        """Where a hypothesis leads from some `starts` (p,), and from optima along those of its own parameters that are
        multimodal; the model's inaccuracy is that `at` a place (p,), and x (p,) the end without the hypothesis."""
        model = self.model
        effect = next(each for each in model.effects if each.name == name)
        hypothesis = Hypothesis((effect,))
        own = [model.index(each) for each in effect.names]
        scans = {i: within_range(model.parameters[i]) for i in along if i in own}
        largest = max(starts, key=lambda y: float(np.abs(y[own] - self.centre[own]).sum()))
        on_the_way = [_replaced(self.centre, [i], value) for i, values in scans.items() for value in values[::3]]
        wider = self.likelihood(at).on(self.wider(hypothesis, [largest, *on_the_way]))
        if scans:
            found = basins(wider, hypothesis, x, scans)
            self.say("   scanned", [(round(e.cost, 1), float(e.x[own[0]])) for e in found[:6]])
            starts = [*starts, *(each.x for each in found[:BASINS])]
        candidate = followed(wider, hypothesis, starts, LEVELS[0])
        if candidate is not None:
            self.say("   little", hypothesis.name, candidate.log_evidence, candidate.doubt)
        return candidate

    def onward(self, candidate: Candidate | None, at: Real) -> Candidate | None:
        """Where a candidate leads with the data weighing more, on models made again where these are in doubt.

        The model's inaccuracy is that `at` a place (p,).
        """
        if candidate is None:
            return None
        hypothesis, likelihood = candidate.hypothesis, self.likelihood(at)
        if hypothesis.effects and candidate.doubt < DOUBTED:
            likelihood = likelihood.on(self.wider(hypothesis, [candidate.x]))
        for _ in range(PLACES):
            if candidate.doubt < DOUBTED:
                break
            likelihood = self.about(likelihood, candidate)
            again = followed(likelihood, hypothesis, candidate.places[:1], LEVELS[0])
            if again is None:
                return None
            self.say("      renewed", hypothesis.name, candidate.doubt, again.doubt, again.log_evidence)
            candidate = again
        return followed(likelihood, hypothesis, candidate.places, LEVELS[1])

    def wider(self, hypothesis: Hypothesis, places: Sequence[Real]) -> Objective:
        """The recordings predicted all over what is known, and on the way to a hypothesis as it is at `places` (p,)."""
        own = [self.model.index(name) for effect in hypothesis.effects for name in effect.names]
        corners = [_replaced(self.centre, own, place[own]) for place in places]
        return self.wide.widened(self.centre, corners, WIDE, only=self.moving(hypothesis))

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

    def outside(self, plain: Candidate) -> list[Candidate]:
        """What is outside the catalogue, at the end of nothing being wrong: something in a region, or modes."""
        likelihood = self.likelihood(plain.x)
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

    def settled(self, candidate: Candidate, hurried: bool = False, scored: bool = False) -> Settled:
        """The explanation that a candidate leads to, on models and with patterns of its own place.

        One that is far behind others is `hurried`: how far is all the same. What may be added to it is `scored`.
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
        scores = tuple(ranked(likelihood, found.x, 0.0, found)) if scored else ()
        self.say("   beside", e.hypothesis.name, [(round(s.evidence, 1), s.effect.name) for s in scores[:4]])
        return Settled(found, scores, density, seen)

    def pairs(self, final: Sequence[Settled]) -> list[Task]:
        """To settle: the best explanation by one effect together with what promises most beside it."""
        singles = [each for each in final if len(each.explanation.hypothesis.effects) == 1]
        if not singles:
            return []
        best = singles[0].explanation
        tasks: list[Task] = []
        for score in singles[0].scores[:PAIRED]:
            if score.evidence > MORE:
                begin, errors = self.start(score.effect, best.x, score), best.spread(best.x.size)
                for name, error in zip(score.effect.names, score.error, strict=True):
                    i = self.model.index(name)
                    errors[i] = max(abs(begin[i] - best.x[i]), error if np.isfinite(error) else 0.0)
                effects = (*best.hypothesis.effects, score.effect)
                tasks.append(("settled", (Candidate(Hypothesis(effects), (begin,), 0.0, errors, 0.0),)))
        return tasks


def _worth(settled: Settled) -> float:
    return -settled.explanation.log_evidence


def _best(found: Iterable[T], most: int, worth: Callable[[T], float]) -> list[T]:
    """At most so many, best first, of a worth within :data:`CLOSE` of the best."""
    ordered = sorted(found, key=lambda each: -worth(each))
    return [each for each in ordered if worth(each) > worth(ordered[0]) - CLOSE][:most]


def _replaced(x: Real, where: Sequence[int], values: float | Real) -> Real:
    y = x.copy()
    y[list(where)] = values
    return y
