"""The search of a diagnosis: from a model and recordings to explanations.

The null hypothesis is searched for first, on coarse meshes, at low data weight, then refitted at full weight. The
scores at its optimum select the hypotheses to refit. If none of these explains a fitted state, a scan of sizes about
the prior proposes others. Effects are added as long as a further one promises to explain a part of the residual.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.campaign.campaign import Campaign
from workbench.catalogue.effect import Effect
from workbench.diagnosis.conclusion import evidence, priors
from workbench.diagnosis.decision import Evidence, Priors
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
    most_likely,
    of_catalogue,
)
from workbench.diagnosis.levels import LEVELS, STAGE
from workbench.diagnosis.likelihood import Hypothesis, LaplaceApproximation
from workbench.diagnosis.local_models import LocalModels
from workbench.diagnosis.odds import CLOSE, Criteria
from workbench.diagnosis.profile_scan import corners, scan_profiles
from workbench.diagnosis.ranking import Score, Tangents, groups_of, ranked_at_level, ranked_beside, start
from workbench.diagnosis.refit import refit_candidate, with_surroundings
from workbench.diagnosis.tasks import EXPECTED, Refusal, SearchTask
from workbench.fitting.search import NO_END
from workbench.jobs.progress import Progress, no_progress
from workbench.jobs.workers import Workers
from workbench.model.discretisation import Discretisation

Real = NDArray[np.float64]

#: Hypotheses whose predicted log evidence is within this of the largest are all refitted: odds of 1100. If scores are
#: too large to be predictions, at most so many are refitted, each with at least such a share of the largest score.
WITHIN, PROMISING, SHARE = 7.0, 3, 0.3

#: Most hypotheses of a scan of sizes that are searched for, and their largest cost over the least one: the known
#: parameters follow to first order only.
SCANNED, COSTLIER = 4, 4.0

#: Most explanations that a further effect is added to, the best one included, and most effects of an explanation.
ALIKE, MOST_EFFECTS = 2, 3

#: Local optima of the null hypothesis that descents continue from.
LOCAL_OPTIMA = 4

#: Pairs of starts drawn from the prior if its mean leads to no fit. Further starts lie so many uncertainties along each
#: multimodal parameter, which is fixed at first: the farther ones only if none of the nearer fits.
PAIRS, STEPS = 1, ((-1.25, 1.25), (-2.5, 2.5))

#: Relative cost by which a larger hypothesis may fit worse: descents end within it.
WORSE = 0.01

#: Most searched hypotheses that are refitted, if they are near the best (`odds.CLOSE`).
CONTINUED = 3


@dataclass(eq=False)
class DiagnosisSearch:
    """A search and its state; :meth:`run` performs all of it.

    Each worker has its own. It ends early, with its results so far, if interrupted or at `until` of its `clock` (s).
    """

    model: Model
    progress: Progress = no_progress
    trace: Callable[[str], None] | None = None
    until: float | None = None
    clock: Callable[[], float] = time.perf_counter
    criteria: Criteria = field(default_factory=Criteria)
    started: float = field(default_factory=time.perf_counter)
    interrupted: bool = False
    undone: list[str] = field(default_factory=list)
    not_tried: list[NotTried] = field(default_factory=list)
    candidates: list[Candidate] = field(default_factory=list)
    groups: tuple[tuple[str, ...], ...] = ()
    parts: Real | None = None
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

    @property
    def priors(self) -> Priors:
        """The prior probabilities of all hypotheses, grouped at the null hypothesis."""
        return priors(self.model, self.groups, self.criteria)

    @property
    def least_evidence(self) -> float:
        """Log evidence below which a hypothesis is omitted for its small odds."""
        return math.log(self.criteria.looked_at) - self.priors.log_odds((self.model.effects[0].name,))

    def log_odds(self, refitted: Refitted) -> float:
        """Posterior log odds of an explanation, up to a constant of all."""
        return refitted.total + self.priors.log_odds([each.name for each in refitted.hypothesis.effects])

    @property
    def is_over(self) -> bool:
        """Whether the search has to end."""
        return self.interrupted or (self.until is not None and self.clock() > self.until)

    def run(self, workers: Workers | None = None) -> Found:
        """The explanations of the recordings.

        Raises:
            NotEnriched, NotConverged, MeshError, InputError: the device as it is stated cannot be predicted.
        """
        self._workers = workers or Workers()
        self.progress("nothing wrong", 0.1)
        ends, null = self.initial_optima()
        base, = self.run_tasks([SearchTask.of("nothing", self.refit, null, None, not null.fits)], must=1)
        if base.explanation.rms > self.models.stated_rms:
            # A search that moves away from the stated values has failed: the optimum near these is as good.
            stated = Candidate.at(Hypothesis(), self.model.stated, base.explanation.errors)
            base = most_likely([base, *self.run_tasks([
                SearchTask.of("nothing, as stated", self.refit, stated)], must=1)])
        base, null = self.null_elsewhere(base, ends, null)
        tangents = self.run_tasks([
            SearchTask.of("scores of the hypotheses", self.tangents, base.explanation.likeliest)])[0]
        refits = self.with_alternatives(base, tangents)
        base = refits[0]
        self.parts = (base.every or base.explanation).local.parts
        self.groups = tuple(tuple(each.effect.name for each in group) for group in groups_of(base.scores))
        self.progress("single hypotheses", 0.3)
        if not null.fits:
            # A score that promises little of a large residual leads elsewhere.
            least = SHARE * base.explanation.gain_of_full_explanation
            refits += self.refitted_beside(base, [each for each in base.scores if each.evidence > least])
        else:
            refits += self.refitted_beside(base, base.scores)
            if tangents is not None and not self.is_explained(refits):
                refits += self.refitted_beside(base, ranked_beside(self.model, tangents, base.explanation, alone=True),
                                               refits)
        # The sizes of a hundred hypotheses are expensive: they are scanned where no score leads to an explanation.
        if self.best_evidence(refits).leaves_fitted:
            if self.is_over:
                self.undone.append("hypotheses of any size")
            else:
                self.progress("hypotheses of any size", 0.5)
                refits += self.refit_best(null, self.by_size(tangents), refits)
        if not null.fits and not self.is_explained(refits) and not self.is_over:
            # Without an explanation, the report describes the residual of the null hypothesis.
            refits = self.with_base_refitted(null, tangents, refits)
        self.progress("further effects", 0.7)
        refits = self.nested(self.with_further_effects(refits))
        best = of_catalogue(refits)[0]
        if best.hypothesis.effects:
            completed = self.run_tasks([SearchTask.of(best.hypothesis.name, self.with_own_inhomogeneity, best)])[0]
            refits = [completed if each.hypothesis.name == best.hypothesis.name and completed else each
                      for each in refits]
        final = alike_weighted(refits)
        base = next(each for each in final if each.hypothesis.name == Hypothesis().name)
        return Found(base, tuple(final), self.models.stated, self.groups, (null, *self.candidates),
                     tuple(self.undone), tuple(dict.fromkeys(self.not_tried)), self.interrupted)

    def with_base_refitted(self, null: Candidate, tangents: Tangents | None, refits: Sequence[Refitted]
                           ) -> list[Refitted]:
        """Explanations with the null hypothesis refitted to convergence, with its alternatives."""
        base = self.run_tasks([SearchTask.of("nothing, to its end", self.refit, null)])[0]
        if base is None or base.explanation.rms > refits[0].explanation.rms:
            return list(refits)
        base, *outside = self.with_alternatives(base, tangents)
        return [base, *refits[1:], *outside]

    def with_alternatives(self, base: Refitted, tangents: Tangents | None) -> list[Refitted]:
        """An explanation with its scores and the alternatives outside the catalogue."""
        base = self.scored(base, tangents)
        return [base, *map(base.beside, base.alternatives)]

    # ----------------------------------------------------------------------------------------------------------------
    # The null hypothesis

    def initial_optima(self) -> tuple[list[InitialOptimum], Candidate]:
        """The initial optima of the null hypothesis, best first, and its candidate.

        They are searched for from the mean of the prior at low data weight, then from :attr:`further_starts` until one
        fits.
        """
        ends, null = self.initial_optima_from([(self.models.prior.x, ())], [])
        while not null.fits and (starts := next(self.further_starts, None)):
            ends, null = self.initial_optima_from(starts, ends)
        return ends, null

    @cached_property
    def further_starts(self) -> Iterator[list[tuple[Real, tuple[int, ...]]]]:
        """Groups of further starts of the null hypothesis, made on request. They are draws of the prior and places
        along multimodal parameters, the farther ones last."""
        prior = self.models.prior
        for number, steps in enumerate(STEPS):
            starts: list[tuple[Real, tuple[int, ...]]] = [] if number else [(x, ()) for x in prior.draws(PAIRS, 0)]
            yield starts + [(place, (i,)) for i in self.models.multimodal for place in prior.profile_points(i, steps)]

    def null_elsewhere(
        self, base: Refitted, ends: Sequence[InitialOptimum], null: Candidate
    ) -> tuple[Refitted, Candidate]:
        """The null hypothesis refitted from further starts, and its candidate. This is done if it fits at low weight
        but does not explain at full weight: another local optimum may explain the recordings."""
        if not null.fits or self.is_explained([base]) or self.is_over:
            return base, null
        if (starts := next(self.further_starts, None)) is None:
            return base, null
        candidate = self.initial_optima_from(starts, ends)[1]
        if candidate.log_evidence <= null.log_evidence + CLOSE and len(candidate.ends) == 1:
            return base, null
        other = self.run_tasks([SearchTask.of("nothing, from another start", self.refit, candidate)])[0]
        return (base, null) if other is None else (most_likely([base, other]), candidate)

    def initial_optima_from(
        self, starts: Sequence[tuple[Real, tuple[int, ...]]], known: Sequence[InitialOptimum]
    ) -> tuple[list[InitialOptimum], Candidate]:
        """:meth:`initial_optima` from some `starts` (p,), merged with the optima `known`. Each start has indices of
        parameters that are fixed at first."""
        optima = self.run_tasks([
            SearchTask.of("a start where nothing is wrong", self.initial_optimum_near, *at) for at in starts], must=1)
        ends = distinct_ends(self.model, [*known, *(each for each in optima if each is not None)],
                             lambda each: each.cost)
        ends = [each for each in ends if each.cost < ends[0].cost + CLOSE][:LOCAL_OPTIMA]
        self.say("begun", [round(each.cost, 1) for each in optima if each], [round(each.cost, 1) for each in ends])
        further = [each for each in self.run_tasks([
            SearchTask.of("an optimum where nothing is wrong", self.continue_null, each) for each in ends], must=1)
            if each is not None]
        self.say("nothing", [(round(w.log_evidence, 1), *(round(x, 2) for x in w[3:]))
                             for w in sorted(further, key=lambda each: -each.log_evidence)])
        if not further:
            further = [self.models.over_prior.laplace(Hypothesis(), ends[0].x, LEVELS[1])]
        null = Candidate.of(self.model, Hypothesis(), further)
        assert null is not None
        return ends, null

    def initial_optimum_near(self, x: Real, held: tuple[int, ...] = ()) -> InitialOptimum | None:
        """The optimum of the null hypothesis near x (p,), or None. The data have low weight."""
        try:
            return initial_optimum(self.models, x, held)
        except NO_END:
            return None

    def continue_null(self, optimum: InitialOptimum) -> LaplaceApproximation | None:
        """The null optimum at more weight, from an initial one, or None."""
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
        """The scores of largest predicted gain, of those above the criteria. A further effect must be accepted beside
        the others."""
        least = self.least_evidence + (math.log(self.criteria.accepted) if is_further else 0.0)
        return [each for rank, each in enumerate(scores) if each.evidence > least and (
            each.evidence > scores[0].evidence - WITHIN
            or (rank < PROMISING and each.evidence > SHARE * scores[0].evidence))]

    def refitted_beside(
        self, best: Refitted, scores: Sequence[Score], done: Sequence[Refitted] = ()
    ) -> list[Refitted]:
        """An explanation refitted together with each effect of largest predicted gain. Those already `done` are
        skipped."""
        present, known = best.explanation, {each.hypothesis.name for each in done}
        tasks = []
        for score in self.promising(scores, is_further=bool(present.hypothesis.effects)):
            begin, errors = start(self.model, score.effect, present.x, score), present.errors.copy()
            for name, error in zip(score.effect.names, score.error, strict=True):
                i = self.model.index(name)
                errors[i] = max(abs(begin[i] - present.x[i]), error if np.isfinite(error) else 0.0)
            both = Hypothesis((*present.hypothesis.effects, score.effect))
            if both.name in known:
                continue
            tasks.append(SearchTask.of(both.name, self.refit, Candidate.at(both, begin, errors), self.parts))
        return [each for each in self.run_tasks(tasks) if each is not None]

    def by_size(self, tangents: Tangents | None) -> list[Candidate]:
        """The best hypotheses of a profile scan about the prior, searched for.

        Only the worst-fitted state is scanned. By the `tangents`, hypotheses that cannot change the recordings by as
        much as the residual are skipped.
        """
        if tangents is None:
            return []
        x = self.models.prior.x
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
        ranked = sorted(((each, effect) for each, effect in zip(scans, effects, strict=True) if each),
                        key=lambda both: both[0][0].cost)[:SCANNED]
        best = [(each, effect) for each, effect in ranked if each[0].cost < COSTLIER * ranked[0][0][0].cost]
        for each, effect in best:
            self.say("   swept", effect.name, [(round(e.cost, 1), e.x[[*map(self.model.index, effect.names)]])
                                               for e in each])
        return self.searched([(effect, [at.x for at in each]) for each, effect in best])

    def scan_effect(self, name: str, state: str) -> list[InitialOptimum]:
        """The sizes of an effect of least cost in one state. The other parameters are at the mean of the prior."""
        effect, x = self.model.effect(name), self.models.prior.x
        likelihood = self.models.towards(Hypothesis((effect,)), corners(self.model, effect, x), only=state)
        return scan_profiles(likelihood, effect, x)

    def searched(self, starts: Iterable[tuple[Effect, Sequence[Real]]]) -> list[Candidate]:
        """Hypotheses searched for from some starts (p,)."""
        tasks = [SearchTask.of(effect.name, self.candidate, effect.name, own) for effect, own in starts]
        candidates = [each for each in self.run_tasks(tasks) if each is not None]
        self.candidates += candidates
        return candidates

    def candidate(self, name: str, starts: Sequence[Real]) -> Candidate:
        """A hypothesis searched for from some `starts` (p,); see `descent.candidate_from`."""
        candidate = candidate_from(self.models, Hypothesis((self.model.effect(name),)), starts)
        self.say("   more", name, candidate.log_evidence, *candidate.ends[0][3:],
                 [float(candidate.x[self.model.index(each)]) for each in candidate.hypothesis.names])
        return candidate

    def refit_best(
        self, null: Candidate, candidates: Sequence[Candidate], refits: Sequence[Refitted]
    ) -> list[Refitted]:
        """The leading candidates refitted at full weight, those that were not yet."""
        done = {each.hypothesis.name for each in refits}
        leading = leading_of([null, *candidates], CONTINUED + 1, lambda each: each.log_evidence)
        return [each for each in self.run_tasks([
            SearchTask.of(each.hypothesis.name, self.refit, each, self.parts) for each in leading
            if each.hypothesis.name not in done]) if each is not None]

    def refit(self, candidate: Candidate, parts: Real | None = None, is_rough: bool = False) -> Refitted:
        """A candidate refitted at full weight; see `refit.refit_candidate`."""
        refitted = refit_candidate(self.models, candidate, parts=parts, is_rough=is_rough)
        own = refitted.explanation
        self.say("settled", own.hypothesis.name, f"{100.0 * own.rms:.3f} % left, evidence {own.log_evidence:.1f}, held "
                 f"out {refitted.held_out:.1f}, error {own.error_estimate:.1g}, noise "
                 f"{own.local.noise.round(2)}, correlation lengths "
                 f"{[round(noise.correlation, 1) for noise in own.weighting.noises]}, inhomogeneity "
                 f"{own.scales.inhomogeneity:.2g},",
                 [(round(each.gains, 1), each.hypothesis.name) for each in refitted.alternatives[:3]],
                 [float(own.x[self.model.index(each)]) for each in own.hypothesis.names])
        return refitted

    def with_own_inhomogeneity(self, refitted: Refitted) -> Refitted:
        """An explanation with the inhomogeneity of its own place; see `refit.with_surroundings`."""
        return with_surroundings(self.models, refitted)

    def with_further_effects(self, refits: list[Refitted]) -> list[Refitted]:
        """Explanations with effects added, as long as the best one changes."""
        done = {Hypothesis().name}
        while True:
            best, *others = leading_of(of_catalogue(refits), ALIKE, self.log_odds)
            leading = [each for each in (best, *others) if each.hypothesis.name not in done
                       and len(each.hypothesis.effects) < MOST_EFFECTS]
            if best not in leading:
                break
            if self.is_over:
                self.undone.append("further effects")
                break
            done |= {each.hypothesis.name for each in leading}
            tangents = self.run_tasks([
                SearchTask.of("scores of further effects", self.tangents, each.explanation.likeliest)
                for each in leading])
            for each, at in zip(leading, tangents, strict=True):
                scored = self.scored(each, at)
                refits = [scored if other.hypothesis.name == scored.hypothesis.name else other for other in refits]
                refits += self.refitted_beside(scored, scored.scores, refits)
        return refits

    def nested(self, refits: Sequence[Refitted]) -> list[Refitted]:
        """Explanations with failed searches repeated. A search failed if its hypothesis fits worse than one with fewer
        effects; it is then refitted from the optimum of that one."""
        result = list(refits)
        for index, each in enumerate(result):
            least = most_likely(result)
            own = [other.weighted(least) for other in result
                   if set(other.hypothesis.effects) < set(each.hypothesis.effects) and not other.hypothesis.is_outside]
            best = min(own, key=lambda other: other.explanation.cost, default=None)
            if each.hypothesis.is_outside or best is None or (
                    each.weighted(best).explanation.cost <= (1.0 + WORSE) * best.explanation.cost):
                continue
            start = Candidate.at(each.hypothesis, best.explanation.x, each.explanation.errors)
            again = self.run_tasks([SearchTask.of(each.hypothesis.name, self.refit, start, self.parts)])[0]
            if again is not None and again.weighted(best).explanation.cost < each.weighted(best).explanation.cost:
                result[index] = replace(again, scores=each.scores)
        return result

    def best_evidence(self, refits: Sequence[Refitted]) -> Evidence:
        """The evidence of the best catalogue explanation."""
        return evidence(self.model, of_catalogue(refits)[0], self.models.stated, self.criteria)

    def is_explained(self, refits: Sequence[Refitted]) -> bool:
        """Whether the best catalogue explanation explains every state. States held out are included."""
        return not self.best_evidence(refits).leaves

    # ----------------------------------------------------------------------------------------------------------------
    # Tasks

    def run_tasks(self, tasks: Sequence[SearchTask], *, must: int = 0) -> list[Any]:
        """Results of the tasks in their order. None for a task that failed, or had no time.

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
            # The workers' results are no longer needed.
            self.interrupted, self._workers = True, Workers()
        self.undone += [task.name for index, task in enumerate(tasks) if index not in results]
        for index, result in results.items():
            if isinstance(result, Refusal):
                if index < must:
                    raise result.error
                self.say("NOT TRIED", tasks[index].name, result.reason)
                self.not_tried.append(NotTried(tasks[index].name, result.reason))
        return [None if isinstance(result := results.get(index), Refusal) else result for index in range(len(tasks))]

    def attempt(self, task: SearchTask) -> Any:
        """The result of a task, or the refusal that ended it."""
        try:
            return task.method(self, *task.arguments)
        except EXPECTED as error:
            return Refusal(error)
