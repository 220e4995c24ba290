"""The search of a diagnosis: every hypothesis by the same stages, from the model and its recordings to explanations.

The null hypothesis is searched for first, on coarse meshes, with the data at little weight. Where it fits there, the
scores at its optimum at full weight say which hypotheses are refitted. Where it does not, it is not followed further:
hypotheses are searched for as it was, by their scores, and then in all sizes about the prior. Effects are added as long
as something is left that a further one promises to explain.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.campaign.campaign import Campaign
from workbench.catalogue.effect import Effect
from workbench.diagnosis.conclusion import explained_share
from workbench.diagnosis.descent import candidate_from, descend_in_stages, initial_optimum
from workbench.diagnosis.device import Model, device_model
from workbench.diagnosis.findings import (
    Candidate,
    Found,
    InitialOptimum,
    NotTried,
    Refitted,
    alike_weighted,
    distinct_ends,
    leading_of,
    leaving_least,
    of_catalogue,
)
from workbench.diagnosis.levels import LEVELS, STAGE
from workbench.diagnosis.likelihood import Hypothesis, LaplaceApproximation
from workbench.diagnosis.local_models import LocalModels
from workbench.diagnosis.odds import CLOSE, Criteria
from workbench.diagnosis.profile_scan import corners, scan_profiles
from workbench.diagnosis.ranking import Score, Tangents, ranked_at_level, ranked_beside, start
from workbench.diagnosis.refit import refit_candidate
from workbench.diagnosis.refusal import EXPECTED, Refusal
from workbench.diagnosis.tasks import SearchTask
from workbench.fitting.search import NO_END
from workbench.jobs.progress import Progress, no_progress
from workbench.jobs.workers import Workers
from workbench.model.discretisation import Discretisation

Real = NDArray[np.float64]

#: Hypotheses of largest predicted gain at a point that are refitted, if theirs is this share of the largest.
PROMISING, SHARE = 3, 0.3

#: Hypotheses of least cost in any size that are refitted.
SCANNED = 4

#: Explanations not far behind the best that a further effect is added to, the best among them, and effects at most.
ALIKE, MOST_EFFECTS = 2, 3

#: Basins of the null hypothesis that descents go on in.
BASINS = 4

#: Pairs of starts that are drawn from the prior. Further starts lie so many uncertainties along each multimodal number,
#: which is held at first: the farther ones where none of the nearer fits.
PAIRS, STEPS = 1, ((-1.25, 1.25), (-2.5, 2.5))

#: Share of its cost that a larger hypothesis may seem to fit worse by: descents end within it.
WORSE = 0.01

#: Hypotheses that are refitted of those that were searched for, at most, if they are not far behind (`odds.CLOSE`).
CONTINUED = 3


@dataclass(eq=False)
class DiagnosisSearch:
    """A search as it goes on; :meth:`run` is the whole of it, with workers that each have a search of their own.

    It ends early, with its results so far, where it is interrupted, or `until` (of `time.perf_counter`) has passed.
    """

    model: Model
    progress: Progress = no_progress
    trace: Callable[[str], None] | None = None
    until: float | None = None
    criteria: Criteria = field(default_factory=Criteria)
    started: float = field(default_factory=time.perf_counter)
    interrupted: bool = False
    undone: list[str] = field(default_factory=list)
    not_tried: list[NotTried] = field(default_factory=list)
    candidates: list[Candidate] = field(default_factory=list)
    _workers: Workers = field(default_factory=Workers)

    @classmethod
    def of_campaign(cls, campaign: Campaign, accuracy: float | Discretisation) -> DiagnosisSearch:
        """A search for a worker."""
        return cls(device_model(campaign, accuracy=accuracy))

    def say(self, *words: object) -> None:
        if self.trace is not None:
            self.trace(" ".join([f"{time.perf_counter() - self.started:6.1f}", *map(str, words)]))

    @cached_property
    def models(self) -> LocalModels:
        """The models that predict the recordings."""
        return LocalModels(self.model)

    @cached_property
    def least_evidence(self) -> float:
        """Log evidence below which a hypothesis is left out: its odds would be too small."""
        return math.log(self.criteria.looked_at * self.model.hypotheses)

    def log_odds(self, found: Refitted) -> float:
        """Posterior log odds of an explanation, up to a constant of all."""
        return found.total + self.criteria.log_prior(self.model.hypotheses) * len(found.hypothesis.effects)

    @property
    def is_over(self) -> bool:
        """Whether the search has to end."""
        return self.interrupted or (self.until is not None and time.perf_counter() > self.until)

    def run(self, workers: Workers | None = None) -> Found:
        """The explanations of the recordings.

        Raises:
            NotEnriched, NotConverged, MeshError, InputError: the device as it is stated cannot be predicted.
        """
        self._workers = workers or Workers()
        self.progress("nothing wrong", 0.1)
        ends, null = self.initial_optima()
        base, tangents = self.run_tasks([
            SearchTask.of("nothing", self.refit, null, not null.fits),
            SearchTask.of("scores of the hypotheses", self.tangents, null.x)], must=1)
        if base.explanation.rms > self.models.stated_rms:
            # A search that leads away from what is stated has failed: the optimum beside that is as good.
            stated = Candidate.at(Hypothesis(), self.model.stated, base.explanation.errors)
            base = min([base, *self.run_tasks([SearchTask.of("nothing, as stated", self.refit, stated)], must=1)],
                       key=lambda each: each.explanation.rms)
        found = self.with_alternatives(base, tangents)
        base = found[0]
        if null.fits:
            self.progress("single hypotheses", 0.3)
            found += self.refitted_beside(base)
            if tangents is not None and not self.is_explained(found):
                found += self.refitted_beside(base, ranked_beside(self.model, tangents, base.explanation, alone=True),
                                              found)
        searches: list[tuple[str, Callable[[], list[Candidate]]]] = [
            ("hypotheses by their scores", partial(self.by_score, ends, tangents)),
            ("hypotheses of any size", self.by_size)]
        # No tangent counts where more is left than the points were allowed to deviate by.
        if ends[0].cost > sum(state.noise.size for state in self.model.campaign.fitted):
            searches.reverse()
        for name, search in searches:
            if self.is_explained(found):
                break
            if self.is_over:
                self.undone.append(name)
                break
            self.progress(name, 0.5)
            found += self.refit_best(null, search(), found)
        if not null.fits and not self.is_explained(found) and not self.is_over:
            # Nothing explains: what is left, and where, is then told of the null hypothesis.
            found = self.with_base_refitted(null, tangents, found)
        self.progress("further effects", 0.7)
        found = self.nested(self.with_further_effects(found))
        final = alike_weighted(found)
        base = next(each for each in final if each.hypothesis.name == Hypothesis().name)
        return Found(base, tuple(final), (null, *self.candidates), tuple(self.undone),
                     tuple(dict.fromkeys(self.not_tried)), self.interrupted)

    def with_base_refitted(self, null: Candidate, tangents: Tangents | None, found: Sequence[Refitted]
                           ) -> list[Refitted]:
        """Explanations with the null hypothesis refitted to its end, and what is outside the catalogue beside it."""
        base = self.run_tasks([SearchTask.of("nothing, to its end", self.refit, null)])[0]
        if base is None or base.explanation.rms > found[0].explanation.rms:
            return list(found)
        base, *outside = self.with_alternatives(base, tangents)
        return [base, *found[1:], *outside]

    def with_alternatives(self, base: Refitted, tangents: Tangents | None) -> list[Refitted]:
        """An explanation with its scores, and what is outside the catalogue beside it."""
        base = self.scored(base, tangents)
        return [base, *map(base.beside, base.alternatives)]

    # ----------------------------------------------------------------------------------------------------------------
    # The null hypothesis

    def initial_optima(self) -> tuple[list[InitialOptimum], Candidate]:
        """The initial optima of the null hypothesis at little weight, best first, and its candidate at more weight.

        They are searched for from the mean of the prior, and from draws of it.
        """
        prior, ends, null = self.models.prior, list[InitialOptimum](), None
        starts: list[tuple[Real, tuple[int, ...]]] = [(place, ()) for place in (prior.x, *prior.draws(PAIRS, 0))]
        for steps in STEPS:
            starts += [(place, (i,)) for i in self.models.multimodal for place in prior.profile_points(i, steps)]
            if null is not None and (null.fits or not starts):
                break
            ends, null = self.initial_optima_from(starts, ends)
            starts = []
        assert null is not None
        return ends, null

    def initial_optima_from(
        self, starts: Sequence[tuple[Real, tuple[int, ...]]], known: Sequence[InitialOptimum]
    ) -> tuple[list[InitialOptimum], Candidate]:
        """:meth:`initial_optima` from some `starts` (p,), each with indices of parameters that are held at first,
        merged with the optima `known` already."""
        found = self.run_tasks([
            SearchTask.of("a start where nothing is wrong", self.initial_optimum_near, *at) for at in starts], must=1)
        ends = distinct_ends(self.model, [*known, *(each for each in found if each is not None)],
                             lambda each: each.cost)
        ends = [each for each in ends if each.cost < ends[0].cost + CLOSE][:BASINS]
        self.say("begun", [round(each.cost, 1) for each in found if each], [round(each.cost, 1) for each in ends])
        further = [each for each in self.run_tasks([
            SearchTask.of("a basin where nothing is wrong", self.continue_null, each) for each in ends], must=1)
            if each is not None]
        self.say("nothing", [(round(w.log_evidence, 1), *(round(x, 2) for x in w[3:]))
                             for w in sorted(further, key=lambda each: -each.log_evidence)])
        if not further:
            further = [self.models.over_prior.laplace(Hypothesis(), ends[0].x, LEVELS[1])]
        null = Candidate.of(self.model, Hypothesis(), further)
        assert null is not None
        return ends, null

    def initial_optimum_near(self, x: Real, held: tuple[int, ...] = ()) -> InitialOptimum | None:
        """The optimum of the null hypothesis at little weight reached from x (p,); None if there is none."""
        try:
            return initial_optimum(self.models, x, held)
        except NO_END:
            return None

    def continue_null(self, optimum: InitialOptimum) -> LaplaceApproximation | None:
        """The optimum of the null hypothesis at more weight reached from an initial one; None if there is none."""
        try:
            return descend_in_stages(self.models, Hypothesis(), optimum.x, optimum.errors,
                                     likelihood=self.models.over_prior, levels=LEVELS[1:])
        except NO_END:
            return None

    # ----------------------------------------------------------------------------------------------------------------
    # Hypotheses

    def tangents(self, x: Real) -> Tangents:
        """The derivatives of the data by all parameters at x (p,)."""
        return self.models.tangents(x)

    def scored(self, refitted: Refitted, tangents: Tangents | None) -> Refitted:
        """An explanation with the scores of further effects."""
        if tangents is None:
            return refitted
        scores = ranked_beside(self.model, tangents, refitted.explanation)
        self.say("   beside", refitted.hypothesis.name, [(round(s.evidence, 1), s.effect.name) for s in scores[:4]])
        return replace(refitted, scores=tuple(scores))

    def promising(self, scores: Sequence[Score], *, is_further: bool = False) -> list[Score]:
        """The scores of largest predicted gain, of those that would be looked at; a further effect has to be accepted
        beside the others."""
        least = self.least_evidence + (math.log(self.criteria.accepted) if is_further else 0.0)
        return [each for each in scores[:PROMISING] if each.evidence > max(least, SHARE * scores[0].evidence)]

    def refitted_beside(
        self, best: Refitted, scores: Sequence[Score] = (), done: Sequence[Refitted] = ()
    ) -> list[Refitted]:
        """An explanation refitted together with each of the effects of largest predicted gain by its scores, or others,
        that are not `done`."""
        found, known = best.explanation, {each.hypothesis.name for each in done}
        tasks = []
        for score in self.promising(scores or best.scores, is_further=bool(found.hypothesis.effects)):
            begin, errors = start(self.model, score.effect, found.x, score), found.errors.copy()
            for name, error in zip(score.effect.names, score.error, strict=True):
                i = self.model.index(name)
                errors[i] = max(abs(begin[i] - found.x[i]), error if np.isfinite(error) else 0.0)
            both = Hypothesis((*found.hypothesis.effects, score.effect))
            if both.name in known:
                continue
            tasks.append(SearchTask.of(both.name, self.refit, Candidate.at(both, begin, errors)))
        return [each for each in self.run_tasks(tasks) if each is not None]

    def by_score(self, ends: Sequence[InitialOptimum], tangents: Tangents | None) -> list[Candidate]:
        """The hypotheses of largest predicted gain where the null hypothesis ends at either level, searched for."""
        states = self.model.campaign.fitted
        there = self.run_tasks([SearchTask.of("scores of the hypotheses", self.tangents, ends[0].x)])
        starts: dict[str, list[Real]] = {}
        for at, level in ((tangents, LEVELS[1]), (there[0], LEVELS[0])):
            if at is None:
                continue
            scores = ranked_at_level(self.model, at, states, level)
            self.say("   ", [(round(s.evidence, 1), s.effect.name) for s in scores[:4]])
            for each in self.promising(scores):
                starts.setdefault(each.effect.name, []).append(start(self.model, each.effect, at.x, each))
        return self.searched([(self.model.effect(name), own) for name, own in starts.items()])

    def by_size(self) -> list[Candidate]:
        """The hypotheses of least cost in a profile scan about the mean of the prior, searched for.

        The scan is of the state that is left most of: each has to explain that. A hypothesis is left out if none of its
        numbers can change the recordings by as much as the residual there.
        """
        x = self.models.prior.x
        tangents = self.run_tasks([SearchTask.of("scores of the hypotheses", self.tangents, x)])[0]
        if tangents is None:
            return []
        over_prior = self.models.over_prior
        end = over_prior.solve(over_prior.search(Hypothesis()), STAGE, x)
        residual = math.sqrt(2.0 * end.cost)
        left = [float(np.mean(np.abs(log) ** 2)) if state.observation is None else 0.0
                for state, log in zip(over_prior.states, end.residual.data.log_ratio, strict=True)]
        worst = over_prior.states[int(np.argmax(left))].name
        effects = [each.effect for each in ranked_at_level(self.model, tangents, self.model.campaign.fitted, LEVELS[0])
                   if each.most > residual]
        self.say("   swept", len(effects), "of", len(self.model.effects), "left", residual)
        scans = self.run_tasks([
            SearchTask.of(f"{effect.name} of any size", self.scan_effect, effect.name, worst)
            for effect in effects])
        best = sorted(((each, effect) for each, effect in zip(scans, effects, strict=True) if each),
                      key=lambda both: both[0][0].cost)[:SCANNED]
        for each, effect in best:
            self.say("   swept", effect.name, [(round(e.cost, 1), e.x[[*map(self.model.index, effect.names)]])
                                               for e in each])
        return self.searched([(effect, [at.x for at in each]) for each, effect in best], held=True)

    def scan_effect(self, name: str, state: str) -> list[InitialOptimum]:
        """The sizes of an effect of least cost about the mean of the prior, in the one state that shows most."""
        effect, x = self.model.effect(name), self.models.prior.x
        likelihood = self.models.towards(Hypothesis((effect,)), corners(self.model, effect, x), only=state)
        return scan_profiles(likelihood, effect, x)

    def searched(self, starts: Iterable[tuple[Effect, Sequence[Real]]], *, held: bool = False) -> list[Candidate]:
        """Hypotheses searched for from some starts (p,), in each of which they may be `held` at first."""
        tasks = [SearchTask.of(effect.name, self.candidate, effect.name, own, held) for effect, own in starts]
        found = [each for each in self.run_tasks(tasks) if each is not None]
        self.candidates += found
        return found

    def candidate(self, name: str, starts: Sequence[Real], held: bool = False) -> Candidate:
        """A hypothesis searched for from some `starts` (p,); see `descent.candidate_from`."""
        found = candidate_from(self.models, Hypothesis((self.model.effect(name),)), starts, held=held)
        self.say("   more", name, found.log_evidence, *found.ends[0][3:],
                 [float(found.x[self.model.index(each)]) for each in found.hypothesis.names])
        return found

    def refit_best(self, null: Candidate, candidates: Sequence[Candidate], found: Sequence[Refitted]) -> list[Refitted]:
        """The leading candidates refitted at full weight, those that were not yet."""
        done = {each.hypothesis.name for each in found}
        leading = leading_of([null, *candidates], CONTINUED + 1, lambda each: each.log_evidence)
        return [each for each in self.run_tasks([
            SearchTask.of(each.hypothesis.name, self.refit, each) for each in leading
            if each.hypothesis.name not in done]) if each is not None]

    def refit(self, candidate: Candidate, is_behind: bool = False) -> Refitted:
        """A candidate refitted at full weight; see `refit.refit_candidate`."""
        found = refit_candidate(self.models, candidate, is_behind=is_behind)
        own = found.explanation
        self.say("settled", own.hypothesis.name, f"{100.0 * own.rms:.3f} % left, evidence {own.log_evidence:.1f}, held "
                 f"out {found.held_out:.1f}, error {own.error_estimate:.1g}, inflation "
                 f"{own.weighting.inflation.round(2)}, points {own.weighting.points.round(1)}, inhomogeneity "
                 f"{own.scales.inhomogeneity:.2g},",
                 [(round(each.gains, 1), each.hypothesis.name) for each in found.alternatives[:3]],
                 [float(own.x[self.model.index(each)]) for each in own.hypothesis.names])
        return found

    def with_further_effects(self, found: list[Refitted]) -> list[Refitted]:
        """Explanations with effects added to the best ones, as long as the best one changes."""
        done = {Hypothesis().name}
        while True:
            best, *others = leading_of(of_catalogue(found), ALIKE, self.log_odds)
            leading = [each for each in (best, *others) if each.hypothesis.name not in done
                       and len(each.hypothesis.effects) < MOST_EFFECTS]
            if best not in leading:
                break
            if self.is_over:
                self.undone.append("further effects")
                break
            done |= {each.hypothesis.name for each in leading}
            tangents = self.run_tasks([
                SearchTask.of("scores of further effects", self.tangents, each.explanation.x) for each in leading])
            for each, at in zip(leading, tangents, strict=True):
                scored = self.scored(each, at)
                found = [scored if other.hypothesis.name == scored.hypothesis.name else other for other in found]
                found += self.refitted_beside(scored, done=found)
        return found

    def nested(self, found: Sequence[Refitted]) -> list[Refitted]:
        """Explanations of which none fits worse than one that has fewer effects: where one does, its search failed, and
        it is refitted from the other's optimum."""
        result = list(found)
        for index, each in enumerate(result):
            least = leaving_least(result)
            own = [other.weighted(least) for other in result
                   if set(other.hypothesis.effects) < set(each.hypothesis.effects) and not other.hypothesis.is_outside]
            best = min(own, key=lambda other: other.explanation.cost, default=None)
            if each.hypothesis.is_outside or best is None or (
                    each.weighted(best).explanation.cost <= (1.0 + WORSE) * best.explanation.cost):
                continue
            start = Candidate.at(each.hypothesis, best.explanation.x, each.explanation.errors)
            again = self.run_tasks([SearchTask.of(each.hypothesis.name, self.refit, start)])[0]
            if again is not None and again.weighted(best).explanation.cost < each.weighted(best).explanation.cost:
                result[index] = replace(again, scores=each.scores)
        return result

    def is_explained(self, found: Sequence[Refitted]) -> bool:
        """Whether the best explanation of the catalogue leaves little more than noise, or a trace of what the null
        hypothesis leaves."""
        best, *others = of_catalogue(found)
        base = next(each for each in (best, *others) if each.hypothesis.name == Hypothesis().name)
        return best.explanation.weighting.largest <= self.criteria.inflated or explained_share(
            self.model, base.explanation, best.explanation) >= self.criteria.most

    # ----------------------------------------------------------------------------------------------------------------
    # Tasks

    def run_tasks(self, tasks: Sequence[SearchTask], *, must: int = 0) -> list[Any]:
        """Results of the tasks in their order; None for one that there was no time for, or that failed.

        The first `must` of them are done in any case.

        Raises:
            NotEnriched, NotConverged, MeshError, InputError, ValueError, ArithmeticError: one of these failed.
        """
        results: dict[int, Any] = {}
        waiting = ((index, task) for index, task in enumerate(tasks) if index < must or not self.is_over)
        try:
            for index, done in self._workers.completed(waiting, own=self):
                results[index] = done.result()
        except KeyboardInterrupt:
            if self.interrupted or any(index not in results for index in range(min(must, len(tasks)))):
                raise
            # Nobody waits any more for the workers' results.
            self.interrupted, self._workers = True, Workers()
        self.undone += [task.name for index, task in enumerate(tasks) if index not in results]
        for index, result in results.items():
            if isinstance(result, Refusal):
                if index < must:
                    raise result.error
                self.say("NOT TRIED", tasks[index].name, result.reason)
                self.not_tried.append(NotTried(tasks[index].name, result.reason))
        return [None if isinstance(found := results.get(index), Refusal) else found for index in range(len(tasks))]

    def attempt(self, task: SearchTask) -> Any:
        """The result of a task, or the refusal that ended it."""
        try:
            return task.method(self, *task.arguments)
        except EXPECTED as error:
            return Refusal(error)
