"""The search of a diagnosis: every hypothesis by the same stages, from the model and its recordings to explanations.

The stages of every hypothesis, the null hypothesis included: the basins of the prior at little weight of the data, then
more weight, then full weight on models of its own optimum. After each stage those go on whose evidence there is not far
behind the best.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.campaign import Campaign
from workbench.diagnosis.conclusion import explained_share
from workbench.diagnosis.descent import LEVELS, STAGE, Candidate, distinct_ends, initial_optimum, refit_from
from workbench.diagnosis.device import Model, device_model
from workbench.diagnosis.findings import (
    Found,
    InitialOptimum,
    NotTried,
    Refitted,
    candidate_evidence,
    leading_of,
    negative_evidence,
)
from workbench.diagnosis.hypothesis import Effect
from workbench.diagnosis.likelihood import Explanation, Hypothesis, LaplaceApproximation, Likelihood
from workbench.diagnosis.local_models import PLACES, ROUGH, LocalModels
from workbench.diagnosis.odds import CLOSE, INACCURATE, INCONSPICUOUS, Criteria
from workbench.diagnosis.profile_scan import corners, scan_profiles
from workbench.diagnosis.ranking import Score, ranked
from workbench.diagnosis.refusal import EXPECTED, Refusal
from workbench.diagnosis.starts import start, starts_of
from workbench.diagnosis.tasks import SearchTask
from workbench.fitting.search import NO_END
from workbench.jobs.progress import Progress, no_progress
from workbench.jobs.workers import Workers
from workbench.model.discretisation import Discretisation

Real = NDArray[np.float64]

#: Hypotheses of largest predicted gain at any point that are refitted, if theirs is this share of the largest.
PROMISING, SHARE = 3, 0.3

#: Hypotheses of least cost in any size that are refitted.
SCANNED = 4

#: Single hypotheses not far behind the best that are refitted with a second effect.
ALIKE = 2

#: Basins of the null hypothesis that descents go on in.
BASINS = 4

#: Pairs of starts that are drawn from the prior. Further starts lie so many uncertainties along each multimodal number,
#: which is held at first: the farther ones where none of the nearer fits.
PAIRS, STEPS = 1, ((-1.25, 1.25), (-2.5, 2.5))

#: Hypotheses of one stage that go on to the next, at most, if they are not far behind (`odds.CLOSE`).
CONTINUED = (8, 4)

#: Rounds and steps of a refit of a hypothesis that is far behind.
SHORT_REFIT = {"rounds": 2, "limit": 8}


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
    _workers: Workers = field(default_factory=Workers)

    @classmethod
    def of_campaign(cls, campaign: Campaign, accuracy: float | Discretisation) -> DiagnosisSearch:
        """A search for a worker, with its first models."""
        made = cls(device_model(campaign, accuracy=accuracy))
        _ = made.models.over_prior
        return made

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
        predictors = dict.fromkeys(self.models.over_prior_and_places.predictors)
        self.say("wide", [each.model.basis.shape[1] for each in predictors if each.model])
        self.progress("nothing wrong", 0.1)
        ends, null = self.initial_optima()
        refits = dict[Candidate, Refitted]()
        if null.fits:
            refits[null] = self.refit(null)
            if refits[null].explanation.accuracy <= INCONSPICUOUS:
                return self.concluded(null, refits, [null])
        self.progress("what is outside the catalogue", 0.2)
        outside = self.run_tasks([SearchTask.of("what is outside the catalogue", self.outside_catalogue, null)])[0]
        found: list[Candidate] = [*(outside or ())]
        searches = [("hypotheses by their scores", lambda: self.by_score(null, ends, refits)),
                    ("hypotheses of any size", lambda: self.by_size(null))]
        # No tangent counts where more is left than the points were allowed to deviate by.
        if ends[0].cost > 0.5 * sum(2 * state.noise.size for state in self.model.campaign.fitted):
            searches.reverse()
        for number, (name, search) in enumerate(searches):
            if number and self.is_explained(refits[null], refits.values()):
                break
            if number and self.is_over:
                self.undone.append(name)
                break
            self.progress("single hypotheses", 0.3 + 0.3 * number)
            found += search()
            self.progress("the best of them", 0.45 + 0.3 * number)
            self.refit_best(null, found, refits)
        best: dict[str, Candidate] = {}
        for each in sorted(found, key=lambda each: -each.log_evidence):
            best.setdefault(each.hypothesis.name, each)
        return self.concluded(null, refits, [null, *best.values()])

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
        nothing = Hypothesis()
        found = self.run_tasks([
            SearchTask.of("a start where nothing is wrong", self.initial_optimum_near, *at) for at in starts], must=1)
        ends = distinct_ends(self.model, [*known, *(each for each in found if each is not None)],
                             lambda each: each.cost)
        ends = [each for each in ends if each.cost < ends[0].cost + CLOSE][:BASINS]
        self.say("begun", [round(each.cost, 1) for each in found if each], [round(each.cost, 1) for each in ends])
        narrow = Likelihood.noise_only(self.model, self.models.over_prior)
        self.models.places = tuple(
            each.x for each in ends
            if self.models.are_inaccurate(narrow.data(nothing, each.x, LEVELS[0]).error, LEVELS[1]))
        further = [each for each in self.run_tasks([
            SearchTask.of("a basin where nothing is wrong", self.continue_null, each) for each in ends], must=1)
            if each is not None]
        self.say("nothing", [(round(w.log_evidence, 1), w.accuracy, *(round(x, 2) for x in w[4:]))
                             for w in sorted(further, key=lambda each: -each.log_evidence)])
        if not further:
            further = [self.models.likelihood(ends[0].x).laplace(nothing, ends[0].x, LEVELS[1])]
        null = Candidate.of(self.model, nothing, further)
        assert null is not None
        return ends, null

    def initial_optimum_near(self, x: Real, held: tuple[int, ...] = ()) -> InitialOptimum | None:
        """The optimum of the null hypothesis at little weight reached from x (p,); None if there is none.

        Parameters of the indices `held` move only after the others.
        """
        simple = self.models.noise_only()
        if held:
            simple = simple.with_objective(self.models.around(x, self.models.prior, self.model.fitted))
        search = simple.search(Hypothesis())
        try:
            end = initial_optimum(simple, search, x, held)
        except NO_END:
            return None
        return InitialOptimum(end.x, end.cost, search.errors(end))

    def continue_null(self, optimum: InitialOptimum) -> LaplaceApproximation | None:
        """The next continuation stage of the null hypothesis from an initial optimum, on models made about it."""
        nothing, likelihood = Hypothesis(), self.models.noise_only()
        end = likelihood.laplace(nothing, optimum.x, LEVELS[0])
        try:
            for _ in range(PLACES):
                if not self.models.are_inaccurate(end.error_estimate, LEVELS[1]):
                    break
                likelihood = likelihood.with_objective(self.models.near(nothing, end.x, end.errors, ROUGH))
                x = likelihood.solve(likelihood.search(nothing), STAGE, end.x).x
                end = likelihood.laplace(nothing, x, LEVELS[0])
            return refit_from(likelihood.with_discrepancy(end.x), nothing, [end.x], LEVELS[1]).laplace
        except NO_END:
            return None

    def by_score(
        self, null: Candidate, ends: Sequence[InitialOptimum], refits: Mapping[Candidate, Refitted]
    ) -> list[Candidate]:
        """The hypotheses of largest predicted gain at the ends of the null hypothesis, refitted at more weight."""
        *places, last = self.run_tasks([
            *(SearchTask.of("scores of the hypotheses", self.scored, end.x, LEVELS[0]) for end in ends),
            SearchTask.of("scores of the hypotheses", self.scored, null.x, LEVELS[1])])
        scores = [each for each in (*places, last, *(base.scores for base in refits.values())) if each]
        return self.refit_hypotheses(null, null.x, [
            (effect, starts_of(self.model, effect, ends, places)) for effect in self.most_promising(scores)])

    def by_size(self, null: Candidate) -> list[Candidate]:
        """The hypotheses of least cost in a profile scan about the mean of the prior, refitted at more weight.

        A hypothesis is left out if none of its numbers can change the recordings by as much as the residual there.
        """
        x = self.models.prior.x
        scores = self.run_tasks([SearchTask.of("scores of the hypotheses", self.scored, x, LEVELS[0])])[0] or []
        simple = self.models.noise_only()
        residual = math.sqrt(2.0 * simple.solve(simple.search(Hypothesis()), STAGE, x).cost)
        effects = [each.effect for each in scores if each.most > residual]
        self.say("   swept", len(effects), "of", len(scores), "left", residual)
        scans = self.run_tasks([
            SearchTask.of(f"{effect.name} of any size", self.scan_effect, effect.name) for effect in effects])
        best = sorted(((each, effect) for each, effect in zip(scans, effects, strict=True) if each),
                      key=lambda both: both[0][0].cost)[:SCANNED]
        for each, effect in best:
            self.say("   swept", effect.name, [(round(e.cost, 1), e.x[[*map(self.model.index, effect.names)]])
                                               for e in each])
        return self.refit_hypotheses(null, x, [(effect, [at.x for at in each]) for each, effect in best])

    def scan_effect(self, name: str) -> list[InitialOptimum]:
        """The sizes of an effect of least cost about the mean of the prior."""
        effect, x = self.effect(name), self.models.prior.x
        wider = self.models.coarsely_towards(Hypothesis((effect,)), corners(self.model, effect, x))
        return scan_profiles(self.models.noise_only().with_objective(wider), effect, x)

    def effect(self, name: str) -> Effect:
        """The hypothesis of that name."""
        return next(each for each in self.model.effects if each.name == name)

    def refit_hypotheses(self, null: Candidate, at: Real,
                         starts: Sequence[tuple[Effect, Sequence[Real]]]) -> list[Candidate]:
        """Hypotheses refitted from some starts (p,) at little weight, and at more weight those that are not far behind
        the others; the discrepancy of the model is that `at` a point (p,)."""
        little = [each for each in self.run_tasks([
            SearchTask.of(effect.name, self.refit_hypothesis, effect.name, at, own)
            for effect, own in starts if len(own)]) if each is not None]
        further = [each for each in self.run_tasks([
            SearchTask.of(f"{each.hypothesis.name}, further", self.continue_candidate, each, at)
            for each in leading_of(little, CONTINUED[0], candidate_evidence)]) if each is not None]
        for candidate in further:
            self.say("   more", candidate.hypothesis.name, candidate.log_evidence - null.log_evidence,
                     *candidate.laplace[3:])
        return further

    def refit_best(self, null: Candidate, found: Sequence[Candidate], refits: dict[Candidate, Refitted]) -> None:
        """Refit the leading candidates and the null hypothesis at full weight, each on own models, into `refits`."""
        # A hypothesis outside the catalogue follows the recordings at once; one of the catalogue needs a refit first.
        inside = [null, *(each for each in found if not each.hypothesis.is_outside)]
        leading = leading_of(inside, CONTINUED[1], candidate_evidence)
        leading += leading_of([each for each in found if each.hypothesis.is_outside and each.log_evidence
                          > leading[0].log_evidence - CLOSE], 1, candidate_evidence)
        new = [each for each in dict.fromkeys([leading[0], null, *leading]) if each not in refits]
        # Every verdict needs the null hypothesis, whatever the time.
        new.sort(key=lambda each: each is not null)
        done = self.run_tasks([
            SearchTask.of(each.hypothesis.name, self.refit, each, each not in leading) for each in new],
            must=0 if null in refits else 1)
        refits |= {each: own for each, own in zip(new, done, strict=True) if own is not None}

    def is_explained(self, base: Refitted, refits: Iterable[Refitted]) -> bool:
        """Whether the best explanation of the catalogue leaves no more than models are inaccurate by, or a trace."""
        best = min((each for each in refits if not each.explanation.hypothesis.is_outside), key=negative_evidence)
        return best.explanation.accuracy <= INACCURATE or self.takes_most(base, best)

    def leaves_a_trace(self, base: Refitted, best: Refitted) -> bool:
        """Whether an explanation leaves more than the inaccuracy of models, but little of the remainder of the `base`.
        A further effect cannot be told then: evidences that rest on such an accuracy mean little."""
        return best.explanation.accuracy > self.criteria.inaccurate and self.takes_most(base, best)

    def takes_most(self, base: Refitted, best: Refitted) -> bool:
        """Whether an explanation takes away all but a trace of the remainder of the `base`."""
        return explained_share(self.model, base.explanation, best.explanation) >= self.criteria.most

    def concluded(self, null: Candidate, refits: dict[Candidate, Refitted], candidates: Sequence[Candidate]) -> Found:
        """The results of the search, with second effects added to the best explanation of one effect."""
        base, found = refits[null], dict[str, Refitted]()
        for each in sorted(refits.values(), key=negative_evidence):
            found.setdefault(each.explanation.hypothesis.name, each)
        best: Refitted | None = None
        while best is not (leader := min(found.values(), key=negative_evidence)):
            best = leader
            hypothesis = best.explanation.hypothesis
            if len(hypothesis.effects) > 1 or hypothesis.is_outside or self.leaves_a_trace(base, best):
                break
            # Where the best alone leaves more than noise, its evidence rests on an inaccuracy: another one that is not
            # far behind may be better with a second effect.
            alike = [each for each in found.values() if best.explanation.accuracy > INCONSPICUOUS
                     and len(each.explanation.hypothesis.effects) == 1 and not each.explanation.hypothesis.is_outside
                     and negative_evidence(each) < negative_evidence(best) + CLOSE]
            tasks = {task.name: task for each in dict.fromkeys([best, *alike[:ALIKE]])
                     for task in self.second_effects(each)}
            for each in self.run_tasks([task for name, task in tasks.items() if name not in found]):
                if each is not None:
                    found[each.explanation.hypothesis.name] = each
        return Found(base, tuple(sorted(found.values(), key=negative_evidence)), tuple(candidates), tuple(self.undone),
                     tuple(dict.fromkeys(self.not_tried)), self.interrupted)

    def run_tasks(self, tasks: Sequence[SearchTask], *, must: int = 0) -> list[Any]:
        """Results of the tasks in their order; None for one that there was no time for, or that failed.

        The first `must` of them are done in any case.

        Raises:
            NotEnriched, NotConverged, MeshError, InputError, ValueError, ArithmeticError: one of these failed.
        """
        results: dict[int, Any] = {}
        waiting = ((index, replace(task, places=self.models.places)) for index, task in enumerate(tasks)
                   if index < must or not self.is_over)
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
        """The result of a task on models that cover its places, or the refusal that ended it."""
        self.models.places = task.places
        try:
            return task.method(self, *task.arguments)
        except EXPECTED as error:
            return Refusal(error)

    def scored(self, x: Real, level: float) -> list[Score]:
        """The scores of all hypotheses at x (p,)."""
        return ranked(self.models.noise_only(), x, level)

    def most_promising(self, scores: Sequence[Sequence[Score]]) -> list[Effect]:
        """The hypotheses of largest predicted gain at any point."""
        found: dict[str, Effect] = {}
        for scored in scores:
            self.say("   ", [(round(s.evidence, 1), s.effect.name) for s in scored[:4]])
            for each in scored[:PROMISING]:
                if each.evidence > max(self.least_evidence, SHARE * scored[0].evidence):
                    found.setdefault(each.effect.name, each.effect)
        self.say("chosen", list(found))
        return list(found.values())

    def refit_hypothesis(self, name: str, at: Real, starts: Sequence[Real]) -> Candidate:
        """A hypothesis refitted from some `starts` (p,) at little weight; the discrepancy of the model is that `at` a
        point (p,)."""
        hypothesis = Hypothesis((self.effect(name),))
        own = [self.model.index(each) for each in hypothesis.effects[0].names]
        largest = max(starts, key=lambda y: float(np.abs(y[own] - self.models.centre[own]).sum()))
        likelihood = self.models.likelihood(at).with_objective(self.models.towards(hypothesis, [largest]))
        candidate = refit_from(likelihood, hypothesis, starts, LEVELS[0])
        self.say("   little", name, candidate.log_evidence, candidate.laplace.error_estimate,
                 [float(candidate.x[i]) for i in own])
        return candidate

    def continue_candidate(self, candidate: Candidate, at: Real) -> Candidate:
        """The next continuation stage of a candidate, on models made again where their error estimate is too large; the
        discrepancy of the model is that `at` a point (p,)."""
        hypothesis, likelihood = candidate.hypothesis, self.models.likelihood(at)
        if not self.models.are_inaccurate(candidate.laplace.error_estimate, LEVELS[0]):
            likelihood = likelihood.with_objective(self.models.towards(hypothesis, [candidate.x]))
        likelihood, little = self.refit_on_new_models(likelihood, candidate, LEVELS[0])
        found = refit_from(likelihood, hypothesis, [end.x for end in little.ends], LEVELS[1])
        return self.refit_on_new_models(likelihood, found, LEVELS[1])[1]

    def refit_on_new_models(self, likelihood: Likelihood, candidate: Candidate,
                            level: float) -> tuple[Likelihood, Candidate]:
        """A candidate refitted on models made about it while their error estimate is too large; the last likelihood."""
        for _ in range(PLACES):
            if not self.models.are_inaccurate(candidate.laplace.error_estimate, level):
                break
            self.say("      renewed", candidate.hypothesis.name, candidate.log_evidence, candidate.laplace[-1])
            likelihood = self.models.about_candidate(likelihood, candidate)
            candidate = refit_from(likelihood, candidate.hypothesis, [candidate.x], level)
        return likelihood, candidate

    def outside_catalogue(self, null: Candidate) -> list[Candidate]:
        """Hypotheses outside the catalogue, at the optimum of the null hypothesis: a change in a region, or modes."""
        every = self.models.likelihood(null.x).alternatives(null.hypothesis, null.x, LEVELS[1], null.laplace.accuracy)
        self.say("   outside", [(round(worth - null.log_evidence, 1), each.name) for each, worth in every[:4]])
        return [Candidate(each, (null.laplace._replace(log_evidence=worth, reduced_chi_square=math.inf),))
                for each, worth in every]

    def refit(self, candidate: Candidate, far_behind: bool = False) -> Refitted:
        """A candidate refitted at full weight, on models and with the discrepancy at its own optimum.

        One `far_behind` the others is refitted roughly: the size of its distance does not matter.
        """
        hypothesis, likelihood = candidate.hypothesis, self.models.noise_only()
        if hypothesis.effects:
            likelihood = likelihood.with_objective(self.models.towards(hypothesis, [candidate.x]))
        # Of several ends full weight tells on a model of its own which it is.
        limits = SHORT_REFIT if far_behind or len(candidate.ends) > 1 else {}
        optima = [self.refit_optimum(likelihood, hypothesis, end, limits) for end in candidate.ends]
        likelihood, found = max(optima, key=lambda each: each[1].log_evidence)
        for _ in range(0 if far_behind else PLACES - 1):
            if not (limits or self.models.are_inaccurate(found.error_estimate, found.accuracy)
                    or self.needs_other_meshes(likelihood, hypothesis, found.x)):
                break
            limits = {}
            likelihood, found = self.refit_optimum(likelihood, hypothesis, found.laplace, limits)
        self.say("settled", hypothesis.name, found.log_evidence, *found.scales, "chi",
                 float(np.mean(found.residual.vector**2)), "doubt", found.error_estimate)
        density, predicted = 0.0, list[NDArray[np.complex128]]()
        if self.model.held_out is not None:
            rounds = 0 if far_behind or found.accuracy > INACCURATE else 1
            limit = SHORT_REFIT["limit"]
            density, predicted = self.models.predict_held_out(likelihood, found, rounds=rounds, limit=limit)
            self.say("   with all", density)
        scores = tuple(ranked(likelihood, found.x, 0.0, found)) if len(hypothesis.effects) < 2 else ()
        self.say("   beside", hypothesis.name, [(round(s.evidence, 1), s.effect.name) for s in scores[:4]])
        alternatives = () if hypothesis.is_outside else tuple(
            likelihood.alternatives(hypothesis, found.x, 0.0, found.accuracy))
        assert likelihood.region_discrepancy is not None
        return Refitted(found, scores, alternatives, density, tuple(predicted), likelihood.columns,
                     likelihood.region_discrepancy)

    def refit_optimum(
        self, likelihood: Likelihood, hypothesis: Hypothesis, end: LaplaceApproximation, limits: Mapping[str, int]
    ) -> tuple[Likelihood, Explanation]:
        """The optimum at full weight near an end, on models made about it where the error estimate of the likelihood's
        is too large."""
        # An inaccurate explanation needs no accurate models.
        if self.needs_other_meshes(likelihood, hypothesis, end.x) or self.models.are_inaccurate(
                likelihood.data(hypothesis, end.x).error, end.accuracy if limits else 0.0):
            likelihood = likelihood.with_objective(self.models.near(hypothesis, end.x, end.errors))
        likelihood = likelihood.with_discrepancy(end.x)
        try:
            return likelihood, likelihood.refit(hypothesis, end.x, **limits)
        except NO_END:
            self.say("   NO END", hypothesis.name)
            raise

    def needs_other_meshes(self, likelihood: Likelihood, hypothesis: Hypothesis, x: Real) -> bool:
        """Whether a hypothesis at x (p,) has other meshes than those of a likelihood."""
        own = self.model.about(hypothesis.effects, x).fitted.recordings[0].problem.mesh
        return likelihood.objective.recordings[0].problem.mesh is not own

    def second_effects(self, refit: Refitted) -> list[SearchTask]:
        """Tasks that refit an explanation together with each of the effects of largest predicted gain."""
        best, tasks = refit.explanation, list[SearchTask]()
        for score in refit.scores[:PROMISING]:
            if score.evidence > self.least_evidence:
                begin, errors = start(self.model, score.effect, best.x, score), best.errors
                for name, error in zip(score.effect.names, score.error, strict=True):
                    i = self.model.index(name)
                    errors[i] = max(abs(begin[i] - best.x[i]), error if np.isfinite(error) else 0.0)
                both = Hypothesis((*best.hypothesis.effects, score.effect))
                place = best.laplace._replace(x=begin, errors=errors)
                tasks.append(SearchTask.of(both.name, self.refit, Candidate(both, (place,))))
        if not best.hypothesis.effects:
            tasks += [SearchTask.of(each.name, self.refit, Candidate(each, (best.laplace,)))
                      for each, worth in refit.alternatives[:PROMISING]
                      if worth - best.log_evidence > self.least_evidence]
        return tasks
