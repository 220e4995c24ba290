"""From a model and its recordings to the explanations that are left: one search for every hypothesis.

Every hypothesis, that nothing is wrong among them, goes the same way: from the basins of the prior with the data
weighing little, through more weight, to the full one on models of its own place. After each stage those go on whose
evidence there is not far behind the best.
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
from workbench.diagnosis.findings import Found, InitialOptimum, NotTried, Settled, leading_of, promise, weakness
from workbench.diagnosis.hypothesis import Effect
from workbench.diagnosis.likelihood import Explanation, Hypothesis, Likelihood, Weighed
from workbench.diagnosis.neighbourhoods import PLACES, ROUGH, Neighbourhoods
from workbench.diagnosis.odds import CLOSE, INACCURATE, INCONSPICUOUS, Criteria
from workbench.diagnosis.profile_scan import corners, scan_profiles
from workbench.diagnosis.ranking import Score, ranked
from workbench.diagnosis.refusal import EXPECTED, Refusal
from workbench.diagnosis.starts import start, starts_of
from workbench.diagnosis.tasks import SearchTask
from workbench.fitting.search import NO_END
from workbench.jobs.workers import Workers
from workbench.model.discretisation import Discretisation
from workbench.search.continuation import Progress

Real = NDArray[np.float64]

#: Of the hypotheses that promise most at any place, so many are tried, if they promise this share of what the best
#: does.
TRIED, SHARE = 3, 0.3

#: Of all hypotheses in any size, so many are tried.
SWEPT = 4

#: Of the single hypotheses that are not far behind the best, so many are looked at with a second effect.
ALIKE = 2

#: Descents begin in so many basins.
BASINS = 4

#: So many starts are drawn from what is believed, each with its opposite; others lie so many uncertainties along what
#: is multimodal, which is held at first: the further ones where none of the nearer fits.
PAIRS, STEPS = 1, ((-1.25, 1.25), (-2.5, 2.5))

#: Of the hypotheses at one stage so many go on to the next, if they are not far behind (`odds.CLOSE`).
GO_ON = (8, 4)

#: Rounds and steps of a fit that is far behind.
HURRIED = {"rounds": 2, "limit": 8}


@dataclass(eq=False)
class DiagnosisSearch:
    """A search as it goes on; :meth:`run` is all of it, with workers that each have one of their own.

    It ends early, with what it has by then, where it is interrupted, or `until` (of `time.perf_counter`) has passed.
    """

    model: Model
    progress: Progress = lambda _text, _share: None
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
        _ = made.models.narrow
        return made

    def say(self, *words: object) -> None:
        if self.trace is not None:
            self.trace(" ".join([f"{time.perf_counter() - self.started:6.1f}", *map(str, words)]))

    @cached_property
    def models(self) -> Neighbourhoods:
        """What predicts the recordings."""
        return Neighbourhoods(self.model)

    @cached_property
    def least(self) -> float:
        """Log evidence below which a hypothesis is not worth a look: its odds of being true would be too small."""
        return math.log(self.criteria.looked_at * self.model.hypotheses)

    @property
    def is_over(self) -> bool:
        """Whether there is no time for anything but an end."""
        return self.interrupted or (self.until is not None and time.perf_counter() > self.until)

    def run(self, workers: Workers | None = None) -> Found:
        """The explanations of the recordings.

        Raises:
            NotEnriched, NotConverged, MeshError, InputError: the device as it is stated cannot be predicted.
        """
        self._workers = workers or Workers()
        self.say("wide", [p.model.basis.shape[1] for p in dict.fromkeys(self.models.wide.predictors) if p.model])
        self.progress("nothing wrong", 0.1)
        ends, plain = self.begun()
        settled = dict[Candidate, Settled]()
        if plain.fits:
            settled[plain] = self.settled(plain)
            if settled[plain].explanation.accuracy <= INCONSPICUOUS:
                return self.concluded(plain, settled, [plain])
        self.progress("what is outside the catalogue", 0.2)
        outside = self.work([SearchTask.of("what is outside the catalogue", self.outside, plain)])[0]
        found: list[Candidate] = [*(outside or ())]
        searches = [("hypotheses by their scores", lambda: self.by_score(plain, ends, settled)),
                    ("hypotheses of any size", lambda: self.by_size(plain))]
        # No tangent counts where more is left than the points were allowed to deviate by.
        if ends[0].cost > 0.5 * sum(2 * state.noise.size for state in self.model.campaign.fitted):
            searches.reverse()
        for number, (name, search) in enumerate(searches):
            if number and self.explained(settled[plain], settled.values()):
                break
            if number and self.is_over:
                self.undone.append(name)
                break
            self.progress("single hypotheses", 0.3 + 0.3 * number)
            found += search()
            self.progress("the best of them", 0.45 + 0.3 * number)
            self.settle(plain, found, settled)
        best: dict[str, Candidate] = {}
        for each in sorted(found, key=lambda each: -each.log_evidence):
            best.setdefault(each.hypothesis.name, each)
        return self.concluded(plain, settled, [plain, *best.values()])

    def begun(self) -> tuple[list[InitialOptimum], Candidate]:
        """The optima where nothing is wrong with the data weighing little, best first, and where these lead with more
        weight.

        From where the known numbers are believed to be, and from draws of that.
        """
        belief, ends, plain = self.models.belief, list[InitialOptimum](), None
        starts: list[tuple[Real, tuple[int, ...]]] = [(place, ()) for place in (belief.x, *belief.places(PAIRS, 0))]
        for steps in STEPS:
            starts += [(place, (i,)) for i in self.models.multimodal for place in belief.along(i, steps)]
            if plain is not None and (plain.fits or not starts):
                break
            ends, plain = self.led(starts, ends)
            starts = []
        assert plain is not None
        return ends, plain

    def led(self, starts: Sequence[tuple[Real, tuple[int, ...]]], known: Sequence[InitialOptimum]) -> tuple[
            list[InitialOptimum], Candidate]:
        """As :meth:`begun`, from some `starts` (p,), parameters of the indices beside them held at first, and ends that
        are `known`."""
        nothing = Hypothesis()
        found = self.work([
            SearchTask.of("a start where nothing is wrong", self.descended, *start) for start in starts], must=1)
        ends = distinct_ends(self.model, [*known, *(each for each in found if each is not None)],
                             lambda each: each.cost)
        ends = [each for each in ends if each.cost < ends[0].cost + CLOSE][:BASINS]
        self.say("begun", [round(each.cost, 1) for each in found if each], [round(each.cost, 1) for each in ends])
        narrow = Likelihood.bare(self.model, self.models.narrow)
        self.models.places = tuple(
            each.x for each in ends if self.models.doubts(narrow.data(nothing, each.x, LEVELS[0]).error, LEVELS[1]))
        further = [each for each in self.work([
            SearchTask.of("a basin where nothing is wrong", self.furthered, each) for each in ends], must=1)
            if each is not None]
        self.say("nothing", [(round(w.log_evidence, 1), w.accuracy, round(w.left, 2), round(w.doubt, 2))
                             for w in sorted(further, key=lambda each: -each.log_evidence)])
        if not further:
            further = [self.models.likelihood(ends[0].x).weighed(nothing, ends[0].x, LEVELS[1])]
        plain = Candidate.of(self.model, nothing, further)
        assert plain is not None
        return ends, plain

    def descended(self, x: Real, held: tuple[int, ...] = ()) -> InitialOptimum | None:
        """Where nothing being wrong leads from x (p,) with the data weighing little; None if to nothing.

        Parameters of the indices `held` move only after the others.
        """
        bare = self.models.bare()
        if held:
            bare = bare.on(self.models.around(x, self.models.belief, self.model.fitted))
        search = bare.search(Hypothesis())
        try:
            end = initial_optimum(bare, search, x, held)
        except NO_END:
            return None
        return InitialOptimum(end.x, end.cost, search.errors(end))

    def furthered(self, begun: InitialOptimum) -> Weighed | None:
        """Where nothing being wrong leads with the data weighing more, on models of that place."""
        nothing, likelihood = Hypothesis(), self.models.bare()
        end = likelihood.weighed(nothing, begun.x, LEVELS[0])
        try:
            for _ in range(PLACES):
                if not self.models.doubts(end.doubt, LEVELS[1]):
                    break
                likelihood = likelihood.on(self.models.near(nothing, end.x, end.errors, ROUGH))
                x = likelihood.solve(likelihood.search(nothing), STAGE, end.x).x
                end = likelihood.weighed(nothing, x, LEVELS[0])
            return refit_from(likelihood.with_patterns(end.x), nothing, [end.x], LEVELS[1]).weighed
        except NO_END:
            return None

    def by_score(
        self, plain: Candidate, ends: Sequence[InitialOptimum], settled: Mapping[Candidate, Settled]
    ) -> list[Candidate]:
        """Where the hypotheses lead that promise most, from where nothing being wrong ends."""
        *places, last = self.work([
            *(SearchTask.of("scores of the hypotheses", self.scored, end.x, LEVELS[0]) for end in ends),
            SearchTask.of("scores of the hypotheses", self.scored, plain.x, LEVELS[1])])
        chosen = self.chosen([each for each in (*places, last, *(base.scores for base in settled.values())) if each])
        return self.tried(plain, plain.x, [(effect, starts_of(self.model, effect, ends, places)) for effect in chosen])

    def by_size(self, plain: Candidate) -> list[Candidate]:
        """Where the hypotheses lead that leave least in any size, from where the known numbers are believed to be.

        A hypothesis of which no number can change the recordings by as much as is left there does not explain them.
        """
        x = self.models.belief.x
        scores = self.work([SearchTask.of("scores of the hypotheses", self.scored, x, LEVELS[0])])[0] or []
        bare = self.models.bare()
        left = math.sqrt(2.0 * bare.solve(bare.search(Hypothesis()), STAGE, x).cost)
        effects = [each.effect for each in scores if each.most > left]
        self.say("   swept", len(effects), "of", len(scores), "left", left)
        swept = self.work([SearchTask.of(f"{effect.name} of any size", self.swept, effect.name) for effect in effects])
        best = sorted(((each, effect) for each, effect in zip(swept, effects, strict=True) if each),
                      key=lambda both: both[0][0].cost)[:SWEPT]
        for each, effect in best:
            self.say("   swept", effect.name, [(round(e.cost, 1), e.x[[*map(self.model.index, effect.names)]])
                                               for e in each])
        return self.tried(plain, self.models.belief.x, [(effect, [at.x for at in each]) for each, effect in best])

    def swept(self, name: str) -> list[InitialOptimum]:
        """The sizes of an effect that leave least where the known numbers are believed to be."""
        effect, x = self.effect(name), self.models.belief.x
        wider = self.models.coarsely_wider(Hypothesis((effect,)), corners(self.model, effect, x))
        return scan_profiles(self.models.bare().on(wider), effect, x)

    def effect(self, name: str) -> Effect:
        """The hypothesis of that name."""
        return next(each for each in self.model.effects if each.name == name)

    def tried(self, plain: Candidate, at: Real, starts: Sequence[tuple[Effect, Sequence[Real]]]) -> list[Candidate]:
        """Where hypotheses lead from some starts (p,) with the data weighing little, and with more those that are not
        far behind the others; the model's inaccuracy is that `at` a place (p,)."""
        little = [each for each in self.work([
            SearchTask.of(effect.name, self.explain, effect.name, at, own) for effect, own in starts if len(own)])
            if each is not None]
        further = [each for each in self.work([
            SearchTask.of(f"{each.hypothesis.name}, further", self.onward, each, at)
            for each in leading_of(little, GO_ON[0], promise)])
            if each is not None]
        for candidate in further:
            self.say("   more", candidate.hypothesis.name, candidate.log_evidence - plain.log_evidence,
                     candidate.weighed.accuracy, candidate.weighed.left, candidate.weighed.doubt)
        return further

    def settle(self, plain: Candidate, found: Sequence[Candidate], settled: dict[Candidate, Settled]) -> None:
        """Add the best of what was found at its own place to what is settled, and nothing being wrong."""
        # What may be anything follows the recordings at once; the catalogue has to find its place first.
        leading = leading_of([plain, *(each for each in found if not each.hypothesis.is_outside)], GO_ON[1], promise)
        leading += leading_of([each for each in found if each.hypothesis.is_outside and each.log_evidence
                          > leading[0].log_evidence - CLOSE], 1, promise)
        new = [each for each in dict.fromkeys([leading[0], plain, *leading]) if each not in settled]
        # What is said needs nothing being wrong, whatever the time.
        new.sort(key=lambda each: each is not plain)
        done = self.work([SearchTask.of(each.hypothesis.name, self.settled, each, each not in leading) for each in new],
                         must=0 if plain in settled else 1)
        settled |= {each: own for each, own in zip(new, done, strict=True) if own is not None}

    def explained(self, base: Settled, settled: Iterable[Settled]) -> bool:
        """Whether the best explanation that the catalogue has leaves no more than an accuracy that models have, or a
        trace."""
        best = min((each for each in settled if not each.explanation.hypothesis.is_outside), key=weakness)
        return best.explanation.accuracy <= INACCURATE or self.takes_most(base, best)

    def leaves_a_trace(self, base: Settled, best: Settled) -> bool:
        """Whether an explanation leaves more than models are inaccurate by, but little of what the `base` leaves: what
        else there is cannot be told then, since evidences that rest on such an accuracy mean little."""
        return best.explanation.accuracy > self.criteria.inaccurate and self.takes_most(base, best)

    def takes_most(self, base: Settled, best: Settled) -> bool:
        """Whether an explanation takes away all but a trace of what the `base` leaves."""
        return explained_share(self.model, base.explanation, best.explanation) >= self.criteria.most

    def concluded(self, plain: Candidate, settled: dict[Candidate, Settled], candidates: Sequence[Candidate]) -> Found:
        """What was found, with what promises most beside the best that is one effect."""
        base, found = settled[plain], dict[str, Settled]()
        for each in sorted(settled.values(), key=weakness):
            found.setdefault(each.explanation.hypothesis.name, each)
        best: Settled | None = None
        while best is not (leader := min(found.values(), key=weakness)):
            best = leader
            hypothesis = best.explanation.hypothesis
            if len(hypothesis.effects) > 1 or hypothesis.is_outside or self.leaves_a_trace(base, best):
                break
            # Where the best alone leaves more than noise, its evidence rests on an inaccuracy: another one that is not
            # far behind may be better with a second effect.
            alike = [each for each in found.values() if best.explanation.accuracy > INCONSPICUOUS
                     and len(each.explanation.hypothesis.effects) == 1 and not each.explanation.hypothesis.is_outside
                     and weakness(each) < weakness(best) + CLOSE]
            tasks = {task.name: task for each in dict.fromkeys([best, *alike[:ALIKE]]) for task in self.further(each)}
            for each in self.work([task for name, task in tasks.items() if name not in found]):
                if each is not None:
                    found[each.explanation.hypothesis.name] = each
        return Found(base, tuple(sorted(found.values(), key=weakness)), tuple(candidates), tuple(self.undone),
                     tuple(dict.fromkeys(self.not_tried)), self.interrupted)

    def work(self, tasks: Sequence[SearchTask], *, must: int = 0) -> list[Any]:
        """Results of the tasks in their order; None for one that there was no time for, or that cannot be done.

        So many of the first are done in any case.

        Raises:
            NotEnriched, NotConverged, MeshError, InputError, ValueError, ArithmeticError: one of these cannot be done.
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
            # Nobody waits any more for what the workers do.
            self.interrupted, self._workers = True, Workers()
        self.undone += [task.name for index, task in enumerate(tasks) if index not in results]
        for index, result in results.items():
            if isinstance(result, Refusal):
                if index < must:
                    raise result.error
                self.say("NOT TRIED", tasks[index].name, result.reason)
                self.not_tried.append(NotTried(tasks[index].name, result.reason))
        return [None if isinstance(found := results.get(index), Refusal) else found for index in range(len(tasks))]

    def attempted(self, task: SearchTask) -> Any:
        """The result of a task on models that reach its places, or why it has none."""
        self.models.places = task.places
        try:
            return task.method(self, *task.given)
        except EXPECTED as error:
            return Refusal(error)

    def scored(self, x: Real, level: float) -> list[Score]:
        """The scores of all hypotheses at x (p,)."""
        return ranked(self.models.bare(), x, level)

    def chosen(self, scores: Sequence[Sequence[Score]]) -> list[Effect]:
        """The hypotheses that promise most anywhere."""
        found: dict[str, Effect] = {}
        for scored in scores:
            self.say("   ", [(round(s.evidence, 1), s.effect.name) for s in scored[:4]])
            for each in scored[:TRIED]:
                if each.evidence > max(self.least, SHARE * scored[0].evidence):
                    found.setdefault(each.effect.name, each.effect)
        self.say("chosen", list(found))
        return list(found.values())

    def explain(self, name: str, at: Real, starts: Sequence[Real]) -> Candidate:
        """Where a hypothesis leads from some `starts` (p,); the model's inaccuracy is that `at` a place (p,)."""
        hypothesis = Hypothesis((self.effect(name),))
        own = [self.model.index(each) for each in hypothesis.effects[0].names]
        largest = max(starts, key=lambda y: float(np.abs(y[own] - self.models.centre[own]).sum()))
        likelihood = self.models.likelihood(at).on(self.models.wider(hypothesis, [largest]))
        candidate = refit_from(likelihood, hypothesis, starts, LEVELS[0])
        self.say("   little", name, candidate.log_evidence, candidate.weighed.doubt,
                 [float(candidate.x[i]) for i in own])
        return candidate

    def onward(self, candidate: Candidate, at: Real) -> Candidate:
        """Where an effect leads with the data weighing more, on models made again where these are in doubt.

        The model's inaccuracy is that `at` a place (p,).
        """
        hypothesis, likelihood = candidate.hypothesis, self.models.likelihood(at)
        if not self.models.doubts(candidate.weighed.doubt, LEVELS[0]):
            likelihood = likelihood.on(self.models.wider(hypothesis, [candidate.x]))
        likelihood, little = self.renewed(likelihood, candidate, LEVELS[0])
        found = refit_from(likelihood, hypothesis, [end.x for end in little.ends], LEVELS[1])
        return self.renewed(likelihood, found, LEVELS[1])[1]

    def renewed(
        self, likelihood: Likelihood, candidate: Candidate, level: float
    ) -> tuple[Likelihood, Candidate]:
        """A candidate followed on models made again about it, as long as these are in doubt, and the last of them."""
        for _ in range(PLACES):
            if not self.models.doubts(candidate.weighed.doubt, level):
                break
            self.say("      renewed", candidate.hypothesis.name, candidate.log_evidence, candidate.weighed.doubt)
            likelihood = self.models.about(likelihood, candidate)
            candidate = refit_from(likelihood, candidate.hypothesis, [candidate.x], level)
        return likelihood, candidate

    def outside(self, plain: Candidate) -> list[Candidate]:
        """What is outside the catalogue, at the end of nothing being wrong: something in a region, or modes."""
        every = self.models.likelihood(plain.x).beside(plain.hypothesis, plain.x, LEVELS[1], plain.weighed.accuracy)
        self.say("   outside", [(round(worth - plain.log_evidence, 1), each.name) for each, worth in every[:4]])
        return [Candidate(each, (plain.weighed._replace(log_evidence=worth, left=math.inf),))
                for each, worth in every]

    def settled(self, candidate: Candidate, hurried: bool = False) -> Settled:
        """The explanation that a candidate leads to, on models and with patterns of its own place.

        One that is far behind others is `hurried`: how far is all the same.
        """
        hypothesis, likelihood = candidate.hypothesis, self.models.bare()
        if hypothesis.effects:
            likelihood = likelihood.on(self.models.wider(hypothesis, [candidate.x]))
        # Of several ends full weight tells on a model of its own which it is.
        hurry = HURRIED if hurried or len(candidate.ends) > 1 else {}
        placed = [self.placed(likelihood, hypothesis, end, hurry) for end in candidate.ends]
        likelihood, found = max(placed, key=lambda each: each[1].log_evidence)
        for _ in range(0 if hurried else PLACES - 1):
            if not (hurry or self.models.doubts(found.doubt, found.accuracy)
                    or self.is_elsewhere(likelihood, hypothesis, found.x)):
                break
            hurry = {}
            likelihood, found = self.placed(likelihood, hypothesis, found.weighed, hurry)
        self.say("settled", hypothesis.name, found.log_evidence, *found.scales, "chi",
                 float(np.mean(found.residual.vector**2)), "doubt", found.doubt)
        density, seen = 0.0, list[NDArray[np.complex128]]()
        if self.model.held_out is not None:
            rounds = 0 if hurried or found.accuracy > INACCURATE else 1
            density, seen = self.models.predicted(likelihood, found, rounds=rounds, limit=HURRIED["limit"])
            self.say("   with all", density)
        scores = tuple(ranked(likelihood, found.x, 0.0, found)) if len(hypothesis.effects) < 2 else ()
        self.say("   beside", hypothesis.name, [(round(s.evidence, 1), s.effect.name) for s in scores[:4]])
        beside = () if hypothesis.is_outside else tuple(likelihood.beside(hypothesis, found.x, 0.0, found.accuracy))
        assert likelihood.anything is not None
        return Settled(found, scores, beside, density, tuple(seen), likelihood.columns, likelihood.anything)

    def placed(
        self, likelihood: Likelihood, hypothesis: Hypothesis, end: Weighed, hurry: Mapping[str, int]
    ) -> tuple[Likelihood, Explanation]:
        """The optimum at full weight near an end, on models about it where those of the likelihood are in doubt."""
        # What is inaccurate may be so for its models.
        if self.is_elsewhere(likelihood, hypothesis, end.x) or self.models.doubts(
                likelihood.data(hypothesis, end.x).error, end.accuracy if hurry else 0.0):
            likelihood = likelihood.on(self.models.near(hypothesis, end.x, end.errors))
        likelihood = likelihood.with_patterns(end.x)
        try:
            return likelihood, likelihood.settled(hypothesis, end.x, **hurry)
        except NO_END:
            self.say("   NO END", hypothesis.name)
            raise

    def is_elsewhere(self, likelihood: Likelihood, hypothesis: Hypothesis, x: Real) -> bool:
        """Whether the meshes of a likelihood are not those for a hypothesis at x (p,)."""
        own = self.model.about(hypothesis.effects, x).fitted.recordings[0].problem.mesh
        return likelihood.objective.recordings[0].problem.mesh is not own

    def further(self, settled: Settled) -> list[SearchTask]:
        """To settle: an explanation together with what promises most beside it."""
        best, tasks = settled.explanation, list[SearchTask]()
        for score in settled.scores[:TRIED]:
            if score.evidence > self.least:
                begin, errors = start(self.model, score.effect, best.x, score), best.errors
                for name, error in zip(score.effect.names, score.error, strict=True):
                    i = self.model.index(name)
                    errors[i] = max(abs(begin[i] - best.x[i]), error if np.isfinite(error) else 0.0)
                both = Hypothesis((*best.hypothesis.effects, score.effect))
                place = best.weighed._replace(x=begin, errors=errors)
                tasks.append(SearchTask.of(both.name, self.settled, Candidate(both, (place,))))
        if not best.hypothesis.effects:
            tasks += [SearchTask.of(each.name, self.settled, Candidate(each, (best.weighed,)))
                      for each, worth in settled.beside[:TRIED] if worth - best.log_evidence > self.least]
        return tasks
