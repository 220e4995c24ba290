"""The six steps, and what they come to: which physics, where, how sure, and what else it could be."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.diagnose.campaign import Campaign
from workbench.diagnose.catalogue import Effect
from workbench.diagnose.device import Model
from workbench.diagnose.refit import (
    GOOD_STATE,
    Refit,
    StateFit,
    base_fit,
    elsewhere,
    gather,
    predicted,
    refit,
)
from workbench.diagnose.score import Score, confusion, ranked, score

Real = NDArray[np.float64]
Progress = Callable[[str, float], None]

VERDICTS = ("no_mismatch", "parameters_explain", "missing_physics", "ambiguous", "unexplained", "below_detection")

#: A hypothesis is accepted where its evidence is better than that of the base model by this much (twice a logarithm):
#: odds of 150 to 1, so that fifty hypotheses together raise a false alarm in few campaigns.
ACCEPTED = 10.0

#: A refit is made again on bases about its own optimum from this share of that: those of the base model err by less.
NEAR = 0.7

#: Evidence this close to the best leaves a hypothesis in the race: odds of 20 to 1.
RIVAL = 6.0

#: A known parameter that left what was known of it by more than this many uncertainties is a finding of its own.
STRAYED = 3.5

#: A hint: a score above this is mentioned though it is not accepted.
HINT = 3.5

#: Hypotheses refitted alone, how many of the best are paired, and pairs refitted.
SINGLES, PAIRED, PAIRS = 8, 3, 4

#: A hypothesis that promises less than this share of what the best one promises is not refitted.
WORTH = 0.3

#: Detection needs this many standard deviations.
DETECTED = 5.0


@dataclass(frozen=True, eq=False)
class Rival:
    """An explanation that the data cannot rule out: its evidence beside the best one's, in the same units."""

    refit: Refit
    behind: float


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What was found.

    ``nominal`` the states as stated, ``base`` after the known parameters were fitted, ``best`` with the accepted
    effects (the base itself if none); ``scores`` of all hypotheses at the base; ``singles`` and ``pairs`` refitted;
    ``location`` (region, kind, sigmas) ranked; ``held_out`` before and after; ``known_physics`` what the effects with
    known constants change, as rms of ln Z by state; ``next_measurement`` in words; ``findings`` plain statements.
    """

    campaign: Campaign
    model: Model
    verdict: str
    nominal: tuple[StateFit, ...]
    base: Refit
    best: Refit
    scores: tuple[Score, ...]
    singles: tuple[Refit, ...]
    pairs: tuple[Refit, ...]
    rivals: tuple[Rival, ...]
    location: tuple[tuple[str, str, float], ...]
    held_before: tuple[StateFit, ...]
    held_after: tuple[StateFit, ...]
    strayed: tuple[tuple[str, float], ...]
    admissible: bool
    next_measurement: str
    findings: tuple[str, ...]
    seconds: float
    full_solves: int

    @property
    def effects(self) -> tuple[Effect, ...]:
        return self.best.effects


def diagnose(model: Model, *, progress: Progress = lambda _text, _share: None) -> Diagnosis:
    """Locate the mismatch of a campaign, name what explains it, or say that nothing does.

    Raises:
        NotEnriched, MeshError: the device as it is stated cannot be predicted.
    """
    started = time.perf_counter()
    campaign = model.campaign
    progress("known parameters", 0.0)
    nominal, base, end = base_fit(model)
    progress("neighbourhood", 0.2)
    base = gather(model, base, _scores(model, base)[:SINGLES])
    scores = _scores(model, base)
    singles = _singles(model, base, scores, progress)
    if not any(fit.good for fit in (base, *singles)):
        progress("other basins", 0.6)
        other = elsewhere(model, base, end)
        # The bases are elsewhere now: they are made again about the base, whichever it is.
        moved = other is not base
        base = gather(model, other, (_scores(model, other) if moved else scores)[:SINGLES])
        if moved:
            scores = _scores(model, base)
            singles = _singles(model, base, scores, progress)
    best = min([base, *singles], key=lambda f: f.evidence)
    pairs: list[Refit] = []
    if best.effects and not best.good:
        pairs = _pairs(model, singles, progress)
        best = min([best, *pairs], key=lambda f: f.evidence)
    progress("verdict", 0.95)
    best = gather(model, best) if base.evidence - best.evidence > NEAR * ACCEPTED else base
    held_before = predicted(model, base)
    held_after = held_before if best is base else predicted(model, best)
    return _judged(campaign, model, nominal, base, best, scores, singles, pairs, held_before, held_after,
                   time.perf_counter() - started)


def _scores(model: Model, fit: Refit, effects: Sequence[Effect] | None = None) -> list[Score]:
    """The scores of the hypotheses (all, or those given) at a fit, best first."""
    tangents = fit.tangents()
    return ranked([score(model, fit.x, fit.here, tangents, e) for e in (model.effects if effects is None else effects)])


def _singles(model: Model, base: Refit, scores: Sequence[Score], progress: Progress) -> list[Refit]:
    """Refits of the hypotheses that the score test leaves in the race, best first."""
    found = []
    wanted = [s for s in scores[:SINGLES] if s.gain > max(ACCEPTED, WORTH * scores[0].gain)]
    for number, scored in enumerate(wanted):
        progress(f"trying {scored.effect.name}", 0.4 + 0.35 * number / len(wanted))
        result = refit(model, (scored.effect,), base.x, [scored])
        if result is not None:
            found.append(result)
    return sorted(found, key=lambda f: f.evidence)


def _pairs(model: Model, singles: Sequence[Refit], progress: Progress) -> list[Refit]:
    """Refits of pairs: for the best single hypotheses, what the score test at their own optimum would add."""
    tried: dict[frozenset[str], tuple[Refit, Score]] = {}
    for single in singles[:PAIRED]:
        (own,) = single.effects
        others = [e for e in model.effects if not set(e.names) & set(own.names)]
        for scored in _scores(model, single, others)[:PAIRS]:
            tried.setdefault(frozenset((own.name, scored.effect.name)), (single, scored))
    chosen = sorted(tried.values(), key=lambda pair: pair[0].chi_square - pair[1].gain)[:PAIRS]
    found = []
    for number, (single, scored) in enumerate(chosen):
        progress(f"trying {single.name} and {scored.effect.name}", 0.75 + 0.2 * number / len(chosen))
        result = refit(model, (*single.effects, scored.effect), single.x, [scored])
        if result is not None:
            found.append(result)
    return sorted(found, key=lambda f: f.evidence)


def _judged(
    campaign: Campaign, model: Model, nominal: tuple[StateFit, ...], base: Refit, best: Refit,
    scores: Sequence[Score], singles: Sequence[Refit], pairs: Sequence[Refit], held_before: tuple[StateFit, ...],
    held_after: tuple[StateFit, ...], seconds: float,
) -> Diagnosis:
    gained = base.evidence - best.evidence
    strayed = tuple((name, shift) for name, shift in sorted(base.shifts.items(), key=lambda item: -abs(item[1]))
                    if abs(shift) > STRAYED)
    findings: list[str] = []
    accepted = bool(best.effects) and gained > ACCEPTED
    if accepted and held_after:
        worse = sum(s.reduced for s in held_after) > 1.05 * sum(s.reduced for s in held_before)
        if worse:
            findings.append(f"{best.name} fits what it was fitted to and predicts the states held out worse than the "
                            "known parameters alone: not accepted.")
            accepted = False
    chosen = best if accepted else base
    rivals: tuple[Rival, ...] = ()
    if accepted:
        rivals = tuple(Rival(f, f.evidence - best.evidence) for f in sorted([*singles, *pairs],
                                                                            key=lambda f: f.evidence)
                       if f.name != best.name and f.evidence - best.evidence < RIVAL and _simplest(f, best))
    admissible = all(_inside(best, name) for name in best.estimate) if accepted else True
    if accepted and not chosen.good:
        verdict = "unexplained"
    elif accepted:
        verdict = "ambiguous" if rivals else "missing_physics"
    elif not base.good:
        verdict = "unexplained"
    elif scores and scores[0].sigmas > HINT:
        verdict = "below_detection"
    elif any(s.reduced > GOOD_STATE for s in nominal):
        verdict = "parameters_explain"
    else:
        verdict = "no_mismatch"
    location = _location(scores)
    findings += _statements(verdict, base, chosen, rivals, strayed, admissible, location)
    after = held_after if accepted else held_before
    return Diagnosis(campaign, model, verdict, nominal, base, chosen, tuple(scores), tuple(singles), tuple(pairs),
                     rivals, location, held_before, after, strayed, admissible,
                     _next(model, chosen, rivals, scores), tuple(findings), seconds, model.fitted.solves)


def _simplest(other: Refit, best: Refit) -> bool:
    """A pair that holds the best explanation and more is no rival of it."""
    return not {e.name for e in best.effects} < {e.name for e in other.effects}


def _inside(fit: Refit, name: str) -> bool:
    for effect in fit.effects:
        if name in effect.admissible:
            limit = effect.admissible[name]
            return limit.lowest <= fit.estimate[name] <= limit.highest
    return True


def _location(scores: Sequence[Score]) -> tuple[tuple[str, str, float], ...]:
    """Regions and kinds, ranked by the most that one hypothesis there explains."""
    best: dict[tuple[str, str], float] = {}
    for scored in scores:
        key = (scored.effect.region, scored.effect.kind)
        best[key] = max(best.get(key, 0.0), scored.sigmas)
    return tuple((region, kind, sigmas) for (region, kind), sigmas in sorted(best.items(), key=lambda i: -i[1]))


def _statements(
    verdict: str, base: Refit, best: Refit, rivals: Sequence[Rival], strayed: Sequence[tuple[str, float]],
    admissible: bool, location: Sequence[tuple[str, str, float]],
) -> list[str]:
    """What the verdict means, in sentences with figures."""
    result = [f"The known parameters alone leave a reduced chi-square of {base.reduced:.3g}."]
    if best.effects:
        numbers = "; ".join(f"{name} = {value:.4g} ({best.interval(name)[0]:.4g} to {best.interval(name)[1]:.4g})"
                            for name, value in best.estimate.items())
        result.append(f"{best.name} brings it to {best.reduced:.3g}, an evidence of "
                      f"{base.evidence - best.evidence:.1f} (twice the logarithm of the odds): {numbers}.")
        if not admissible:
            result.append("Its parameter lies outside what is admissible: the sign of another cause.")
    for rival in rivals:
        result.append(f"The data cannot rule out {rival.refit.name} ({rival.behind:.1f} behind).")
    for name, shift in strayed:
        result.append(f"{name} would have to lie {shift:+.1f} standard uncertainties from what is known of it.")
    if verdict == "unexplained" and location:
        region, kind, sigmas = location[0]
        result.append(f"Nothing of the catalogue explains what is left; most of it looks like {kind} in {region} "
                      f"({sigmas:.1f} sigmas).")
    if verdict == "below_detection":
        result.append("There is a hint, and not enough to name a cause.")
    return result


def _next(model: Model, best: Refit, rivals: Sequence[Rival], scores: Sequence[Score]) -> str:
    """Which state would separate the surviving rivals best, from what each predicts there."""
    if not rivals:
        return ""
    names, separation = [], []
    other = rivals[0].refit
    for objective, states in ((model.fitted, model.campaign.fitted), (model.held_out, model.campaign.held_out)):
        if objective is None:
            continue
        for index, state in enumerate(states):
            one, two = (objective.predict(fit.x, index)[0] for fit in (best, other))
            names.append(state.name)
            separation.append(float(np.sum(np.abs(np.log(one / two) / state.noise) ** 2)))
    most = int(np.argmax(separation))
    least = min(confusion(a, b) for a, b in itertools.pairwise(
        [s for s in scores if s.effect in (*best.effects[:1], *other.effects[:1])])) if len(
            {e.name for e in (*best.effects[:1], *other.effects[:1])}) > 1 else 1.0
    times = max(1.0, 2.0 * RIVAL / max(separation[most], 1e-9))
    return (f"Record {names[most]} again: {best.name} and {other.name} differ most there, by a chi-square of "
            f"{separation[most]:.1f}; {times:.0f} times the recordings tell them apart (their tangents have a cosine "
            f"of {least:.3f}).")


def detection_limits(diagnosis: Diagnosis) -> dict[str, float]:
    """The smallest value (SI, from its start) of every hypothesis' first parameter that this campaign would detect."""
    return {s.effect.name: float(DETECTED * s.error[0]) for s in diagnosis.scores
            if s.error.size and np.isfinite(s.error[0])}


def intervals(fit: Refit) -> dict[str, tuple[float, float, float]]:
    """Estimate, low and high end of the 95 % interval of every parameter of a refit's effects, SI."""
    return {name: (value, *fit.interval(name)) for name, value in fit.estimate.items()}


