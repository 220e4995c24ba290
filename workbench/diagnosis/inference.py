"""From a model and its recordings to the explanations that are left: one search for every hypothesis."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

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
from workbench.fitting.search import Optimum

Real = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Error of Z that the first models are made for, within so many uncertainties of what is known, and those about an
#: optimum, within so many of its standard deviations.
WIDE, FAR = 3e-4, 1.5
FINE, NEAR = 3e-5, 2.0

#: Of the hypotheses that promise most at any place, so many are tried, if they promise this share of what the best
#: does, and more than the logarithm of these odds.
TRIED, SHARE, WORTH = 3, 0.3, -1.0

#: Descents begin in so many basins.
BASINS = 4

#: Explanations whose log odds lie within this of the best are worked out at their own place.
CLOSE = 12.0

#: An optimum is looked for on models made again about it, at most so many times, until their estimated error there is
#: below the second number (ten to a hundred times the true one).
PLACES, TRUSTED = 3, 0.03

#: A hypothesis begins no closer to the ends of its range than this share of it.
INSIDE = 1e-4


@dataclass(frozen=True, eq=False)
class Found:
    """What a search found: the explanations at their own places, best first, all others as far as they were followed,
    the scores at the best place of nothing being wrong, and what was left undone."""

    base: Explanation
    final: tuple[Explanation, ...]
    tried: tuple[Explanation, ...]
    scores: tuple[Score, ...]
    likelihood: Likelihood
    undone: tuple[str, ...] = ()


@dataclass(eq=False)
class Search:
    """The search as it goes on."""

    model: Model
    progress: Progress
    wide: Objective = field(init=False)
    likelihood: Likelihood = field(init=False)
    started: float = field(default_factory=time.perf_counter)
    trace: bool = False

    def say(self, *words: object) -> None:
        if self.trace:
            print(f"{time.perf_counter() - self.started:6.1f}", *words, flush=True)

    def run(self) -> Found:
        model = self.model
        nothing = Hypothesis()
        centre = np.array([p.start for p in model.parameters])
        reach = {p.name: FAR * p.prior for p in model.parameters[:model.known] if p.prior}
        self.wide = model.fitted.near(centre, reach, WIDE)
        self.say("wide", [p.model.basis.shape[1] for p in dict.fromkeys(self.wide.predictors) if p.model])
        bare = Likelihood.bare(model, self.wide)
        search = bare.search(nothing)
        first = bare.tempered(search, centre, LEVELS[0])
        second = bare.tempered(search, first.x, LEVELS[1])
        self.likelihood = bare.with_patterns(second.x)
        worth, errors = self.likelihood.weighed(nothing, second.x, LEVELS[1])
        none = Candidate(nothing, second.x, worth, errors)
        self.say("levels", first.cost, second.cost, worth)
        base, own = self.settled(none)
        scores = ranked(own, base.x, accuracy=base.accuracy)
        self.say("base", base.log_evidence, base.accuracy, float(np.mean(base.residual.vector**2)), base.residual.error,
                 [(round(s.evidence, 1), s.effect.name) for s in scores[:4]])
        if scores[0].evidence < WORTH and base.accuracy < 4e-3:
            return Found(base, (base,), (), tuple(scores), own)
        along = multimodal(bare, first.x)
        ends = basins(bare, search, first, {i: within_knowledge(model.parameters[i]) for i in along})[:BASINS]
        self.say("basins", [model.parameters[i].name for i in along], [round(e.cost, 1) for e in ends])
        places = [(end.x, ranked(bare, end.x, level=LEVELS[0])) for end in ends]
        seen = [*places, (second.x, ranked(bare, second.x, level=LEVELS[1])), (base.x, scores)]
        chosen: dict[str, Effect] = {}
        for _, scored in seen:
            self.say("    ", [(round(s.evidence, 1), s.effect.name) for s in scored[:4]])
            for each in scored[:TRIED]:
                if each.evidence > max(WORTH, SHARE * scored[0].evidence):
                    chosen.setdefault(each.effect.name, each.effect)
        for i in along:
            for effect in model.effects:
                if model.parameters[i].name in effect.names:
                    chosen.setdefault(effect.name, effect)
        self.say("candidates", list(chosen))
        candidates = [none]
        if len(ends) > 1:
            again = followed(self.likelihood, nothing, [end.x for end in ends])
            candidates += [again] if again is not None else []
        plain = max(candidates, key=lambda c: c.log_evidence)
        for effect in chosen.values():
            starts = [self.start(effect, x, next(s for s in scored if s.effect is effect)) for x, scored in places]
            found = self.explain(Hypothesis((effect,)), centre, starts, [i for i in along if model.parameters[i].name in effect.names], ends[0])
            if found is not None:
                candidates.append(found)
                self.say("  ", found.hypothesis.name, found.log_evidence - worth)
        for region in dict.fromkeys(self.likelihood.anything.regions if self.likelihood.anything else ()):
            hypothesis = Hypothesis((), region)
            candidates.append(Candidate(hypothesis, plain.x, *self.likelihood.weighed(hypothesis, plain.x, LEVELS[1])))
            self.say("  ", hypothesis.name, candidates[-1].log_evidence - worth)
        candidates.sort(key=lambda c: -c.log_evidence)
        final = []
        for leading in candidates[:4]:
            if candidates[0].log_evidence - leading.log_evidence < CLOSE and leading is not none:
                made, own = self.settled(leading)
                self.say("settled", made.hypothesis.name, made.log_evidence, made.accuracy, made.size,
                         float(np.mean(made.residual.vector**2)), made.residual.error)
                final.append(made)
        final = [base, *final]
        return Found(final[0], tuple(sorted(final, key=lambda e: -e.log_evidence)), (), tuple(scores), own)

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
        self, hypothesis: Hypothesis, centre: Real, starts: Sequence[Real], along: Sequence[int], end: Optimum
    ) -> Candidate | None:
        """Where a hypothesis leads from some starts (p,), and from the optima along some of its own parameters."""
        model = self.model
        own = [model.index(n) for effect in hypothesis.effects for n in effect.names]
        corner = centre.copy()
        corner[own] = max(starts, key=lambda y: float(np.abs(y[own] - centre[own]).sum()))[own]
        corners = [corner]
        scans = {i: within_range(model.parameters[i]) for i in along}
        for i, values in scans.items():
            for value in values[::3]:
                corner = centre.copy()
                corner[i] = value
                corners.append(corner)
        likelihood = self.likelihood.on(self.wide.widened(centre, corners, WIDE))
        self.say("   widened", [p.model.basis.shape[1] for p in dict.fromkeys(likelihood.objective.predictors) if p.model])
        if scans:
            found = basins(likelihood, likelihood.search(hypothesis), end, scans)
            self.say("   scanned", [(round(e.cost, 1), float(e.x[own[0]])) for e in found[:6]])
            starts = [*starts, *(each.x for each in found[:BASINS])]
        return followed(likelihood, hypothesis, starts)

    def settled(self, candidate: Candidate) -> tuple[Explanation, Likelihood]:
        """The explanation that a candidate leads to, on models and with patterns of its own place."""
        x, errors = candidate.x, candidate.errors
        for _ in range(PLACES):
            reach = {p.name: NEAR * float(error) for p, error in zip(self.model.parameters, errors, strict=True) if error}
            local = self.model.fitted.near(x, reach, FINE)
            likelihood = Likelihood.bare(self.model, local).with_patterns(x)
            found = likelihood.settled(candidate.hypothesis, x)
            if found.residual.error < TRUSTED:
                break
            x = found.x
            errors = np.zeros(x.size)
            errors[list(found.free)] = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
        return found, likelihood
