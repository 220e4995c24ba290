"""The six steps, and what they come to: which physics, where, how sure, and what else it could be."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from workbench.diagnosis.basins import elsewhere, gathered_elsewhere
from workbench.diagnosis.belong import check_assignment, cleared, each_alone
from workbench.diagnosis.campaign import Campaign
from workbench.diagnosis.device import Model
from workbench.diagnosis.hypothesis import Effect
from workbench.diagnosis.locate import MODE, Place, located
from workbench.diagnosis.refit import (
    GOOD_STATE,
    TRUSTED,
    UNNEEDED,
    Refit,
    StateFit,
    base_fit,
    checked,
    gather,
    leaves_less,
    predicted,
    refit,
    without,
)
from workbench.diagnosis.score import Score, confusion, promising, scores_at
from workbench.diagnosis.tempering import afar
from workbench.fitting.joint import refused_steps
from workbench.solve import one_thread
from workbench.spectrum import Spectrum

Real = NDArray[np.float64]
Weighed = tuple[Refit, tuple[StateFit, ...]]
Progress = Callable[[str, float], None]

#: A hypothesis is accepted where its evidence is better than that of the base model by this much (twice a logarithm):
#: odds of 150 to 1, so that fifty hypotheses together raise a false alarm in few campaigns.
ACCEPTED = 10.0

#: And where noise alone gives its parameters what they gain as hardly as so many sigmas to one number: for a narrow
#: range evidence asks less, and the model's own error is no noise.
CLEAR = 4.0

#: A refit is made again on bases about its own optimum from this share of that: those of the base model err by less.
NEAR = 0.7

#: Evidence this close to the best leaves a hypothesis in the race: odds of 20 to 1.
RIVAL = 6.0

#: Fits that close to the best are asked for the states held out.
CLOSE = 3.0 * RIVAL

#: An explanation is whole where no further hypothesis takes more than this of chi-square from what it leaves: of fifty,
#: one in two thousand would by chance.
LEFT = 20.0

#: Effects with known constants, and the constant of the cavity's fluid without which there is none.
KNOWN_PHYSICS = {"viscous boundary layer": "shear_viscosity", "thermal boundary layer": "thermal_conductivity",
                 "absorption of the fluid": "diffusivity_of_sound"}

#: Noise is called white up to this many neighbouring points that go together.
CORRELATED = 2.0

#: A strong effect is explained where no more than this share of what the known parameters leave is left: a ring whose
#: edge lies between two of the catalogue's is described to a few per cent of what it does. Neither must any further
#: hypothesis take more than this share of what it explains, nor may the known parameters have left what is known of
#: them by more than the second number of uncertainties (rms), or this share of what the base strained them by: in the
#: right place they need not.
REMNANT, STRAY = 0.1, 2.0

#: Known parameters that leave less than this share of what the base leaves, from where an effect has led them: the base
#: is in another basin.
HALF = 0.5

#: A known parameter that left what was known of it by more than this many uncertainties is a finding of its own.
STRAYED = 3.5

#: A hint: a score above this is mentioned though it is not accepted.
HINT = 3.5

#: Hypotheses refitted alone, how many of the best are paired, and pairs refitted.
SINGLES, PAIRED, PAIRS = 8, 3, 4

#: A base fit above this reduced chi-square has strained the known parameters to make up for a strong effect.
STRAINED = 2.0

#: Detection needs this many standard deviations.
DETECTED = 5.0


@dataclass(frozen=True, eq=False)
class Rival:
    """An explanation that the data cannot rule out: how far its evidence is behind the best one's, in the same units.

    ``fits_as_well``: what it loses, it loses by the ranges of its parameters alone.
    """

    refit: Refit
    behind: float
    fits_as_well: bool


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What was found.

    ``nominal`` the states as stated, ``base`` after the known parameters were fitted, ``best`` with the accepted
    effects (the base itself if none); ``scores`` of all hypotheses at the base; ``singles`` and ``pairs`` refitted;
    ``location`` ranked, where much is missing with regions last that the known parameters explain alone
    (`belong.cleared`); ``held_before`` and ``held_after`` the states held out, by the base and by ``best``;
    ``next_measurement`` in words; ``findings`` plain statements.
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
    location: tuple[Place, ...]
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


@one_thread()
def diagnose(model: Model, *, progress: Progress = lambda _text, _share: None) -> Diagnosis:
    """Locate the mismatch of a campaign, name what explains it, or say that nothing does.

    On one thread: where a strained fit ends depends on rounding, and rounding on the number of threads.

    Raises:
        InputError: recordings seem to be exchanged between states.
        NotEnriched, MeshError: the device as it is stated cannot be predicted.
    """
    started = time.perf_counter()
    progress("known parameters", 0.0)
    nominal, base, end = base_fit(model)
    check_assignment(model.campaign, nominal)
    if not _quiet(base, _scores(model, base)):
        # Also what leaves next to nothing may be a wrong basin, in which something hints at what is not there.
        progress("other basins", 0.1)
        base, end = elsewhere(model, base, end)
    base, scores, location, singles = _asked(model, base, end, progress)
    if _strained(base) and not any(_explains(base, fit) for fit in singles):
        progress("basins far off", 0.6)
        other, end = elsewhere(model, base, end, far=True)
        if other is not base:
            base, scores, location, singles = _asked(model, other, end, progress)
        elif singles:
            # The bases are those of the places that were looked at: those of the best fit again.
            singles = _settled(model, singles)
    singles = _hopped(model, base, singles, progress)
    best = _best(base, singles)
    if _in_question(base, best):
        other = without(model, base, best)
        if gain(base, other) > ACCEPTED and leaves_less(other, base, HALF):
            progress("another basin", 0.65)
            base, scores, location, singles = _asked(model, gather(model, other), other.x, progress)
            singles = _hopped(model, base, singles, progress)
    pairs: list[Refit] = []
    held_before = predicted(model, base)
    weighed = [(base, held_before)]
    best = _best(base, singles)
    if _in_question(base, best):
        if not _complete(base, best, _left(best, _further(model, best))):
            pairs = _pairs(model, singles, progress)
            both = min([best, *pairs], key=lambda f: f.evidence + RIVAL * len(f.effects))
            if both is not best:
                best = gather(model, both)
                pairs = _with(pairs, both, best)
        progress("verdict", 0.9)
        close = [f for f in (*singles, *pairs) if _simplest(f, best)
                 and (f.evidence - best.evidence < CLOSE or _fits_as_well(f, best))]
        weighed = _weighed(model, close)
        if weighed[0][0] is not best:
            best = gather(model, weighed[0][0])
            weighed[0] = (best, predicted(model, best))
    return _judged(model, nominal, base, weighed, scores, location, singles, pairs, held_before, started)


def _asked(
    model: Model, base: Refit, end: Real, progress: Progress
) -> tuple[Refit, list[Score], tuple[Place, ...], list[Refit]]:
    """The base, scores and location there, and refits of the hypotheses left in the race.

    `end` (p,) is the end of the way down to the base, where the data weigh little (:func:`afar`).
    """
    location: tuple[Place, ...] = ()
    singles: list[Refit] = []
    if _strained(base):
        progress("strong effects", 0.2)
        clear, alone = cleared(model)
        location, singles = afar(model, base, end, alone)
        location = tuple(sorted(location, key=lambda place: place.region in clear))
    if any(_explains(base, fit) for fit in singles):
        return base, _scores(model, base), location, singles
    base, scores, near, more = _near(model, base, progress)
    # Where the known parameters are strained, what is left no longer tells where from.
    return base, scores, location or near, [*singles, *more]


def _strained(base: Refit) -> bool:
    """Whether the known parameters make up for a strong effect, as far as they can."""
    return base.reduced > STRAINED or base.strain > STRAY


def gain(base: Refit, fit: Refit) -> float:
    """How much better the evidence of a fit is than that of the base, in twice a logarithm.

    Points whose residuals under that fit go together count as one: what no hypothesis removes is noise that is not
    white.
    """
    return _fall(base, fit) - fit.cost_of_freedom + base.cost_of_freedom


def _best(base: Refit, fits: Sequence[Refit]) -> Refit:
    """The fit of the best evidence, which the base may be."""
    return min([base, *fits], key=lambda f: f.evidence)


def _in_question(base: Refit, fit: Refit) -> bool:
    """Whether the evidence of a fit comes near to what an effect is accepted for (:data:`NEAR`)."""
    return gain(base, fit) > NEAR * ACCEPTED


def _fall(base: Refit, fit: Refit) -> float:
    """By how much the chi-square of a fit is below that of the base, for points that are independent."""
    return (base.chi_square - fit.chi_square) / fit.correlation


def _further(model: Model, fit: Refit) -> list[Score]:
    """The scores at a fit of the hypotheses that move nothing which its own do, best first."""
    own = {name for effect in fit.effects for name in effect.names}
    return _scores(model, fit, [e for e in model.effects if not own & set(e.names)])


def _left(fit: Refit, further: Sequence[Score], pairs: Sequence[Refit] = ()) -> float:
    """The most that any further hypothesis (:func:`_further`) takes of what a fit leaves; it promises what it scores.

    Where it was refitted together with the fit's own (`pairs`), that is what it does take. Of several numbers less what
    these take more by chance than one does: it is compared with :data:`LEFT`.
    """
    rare = chi2.sf(LEFT, 1)
    taken = []
    for scored in further:
        together = {*fit.effects, scored.effect}
        fell = [fit.chi_square - pair.chi_square for pair in pairs if set(pair.effects) == together]
        more = LEFT - float(chi2.isf(rare, max(scored.numbers, 1)))
        taken.append(min([scored.gain, *fell]) / fit.correlation + more)
    return max(taken)


def _explains(base: Refit, fit: Refit) -> bool:
    """Whether a fit leaves nothing but noise, or next to nothing of what the base leaves, with the known as known."""
    return fit.good or (leaves_less(fit, base, REMNANT) and fit.strain < max(STRAY, REMNANT * base.strain))


def _besides(base: Refit, fit: Refit, location: Sequence[Place]) -> bool:
    """Whether the evidence for a mode that the model does not have is the best there is, and better than a fit's.

    Of residuals that go together under that fit so many points count as one for both.
    """
    return any(place.kind == MODE and place.sigmas**2 / fit.correlation > gain(base, fit) + RIVAL
               for place in location[:1])


def _complete(base: Refit, fit: Refit, left: float) -> bool:
    """Whether a fit explains, and no further hypothesis takes much (`left`, :func:`_left`) of what it leaves."""
    return _explains(base, fit) and left < (LEFT if fit.good else max(LEFT, REMNANT * gain(base, fit)))


def _hints(scored: Score, correlation: float) -> bool:
    """Whether noise alone, of which so many points count as one, hardly gives a hypothesis what it gains.

    As hardly as :data:`HINT` sigmas of one number: a hypothesis of six gains more by chance than one of one.
    """
    return _rare(scored.gain / correlation, scored.numbers, HINT)


def _rare(gain: float, numbers: int, sigmas: float) -> bool:
    """Whether noise alone gives so many numbers a gain of chi-square as hardly as so many sigmas to one number."""
    return bool(chi2.sf(gain, max(numbers, 1)) < chi2.sf(sigmas**2, 1))


def _quiet(fit: Refit, scores: Sequence[Score]) -> bool:
    """Whether a fit leaves nothing but noise, to its chi-square and to every one of the hypotheses scored there.

    A wrong basin may leave next to nothing of chi-square, and is still a cause that none of the hypotheses is.
    """
    return fit.good and not any(_hints(scored, fit.correlation) for scored in scores)


def _with(fits: Sequence[Refit], old: Refit, new: Refit) -> list[Refit]:
    """`fits` with one replaced, best first."""
    return sorted([new if f is old else f for f in fits], key=lambda f: f.evidence)


def _hopped(model: Model, base: Refit, singles: Sequence[Refit], progress: Progress) -> list[Refit]:
    """`singles`, best first; the best from another basin where it explains and yet leaves a hint at something more."""
    singles = sorted(singles, key=lambda f: f.evidence)
    best = _best(base, singles)
    if not (_in_question(base, best) and _explains(base, best)) or _quiet(best, _further(model, best)):
        return singles
    progress("other basins", 0.65)
    # The bases are those of the basins that were looked at: those of the best fit again.
    return _settled(model, _with(singles, best, gathered_elsewhere(model, best, best.x)))


def _settled(model: Model, fits: Sequence[Refit]) -> list[Refit]:
    """`fits` with the best one made again on bases of its own, best first.

    Whatever else is asked of it, also whether that is all, is asked there.
    """
    best = min(fits, key=lambda f: f.evidence)
    return _with(fits, best, gather(model, best, _further(model, best)[:PAIRS]))


def _weighed(model: Model, fits: Sequence[Refit]) -> list[Weighed]:
    """Fits with the states held out as they predict these, which decide between fits that come close; best first."""
    found = [(fit, predicted(model, fit)) for fit in fits]
    return sorted(found, key=lambda each: each[0].evidence + _held(model, each[1]))


def _held(model: Model, held: Sequence[StateFit]) -> float:
    """Chi-square of the states held out."""
    return sum(2.0 * state.noise.size * fit.reduced for state, fit in zip(model.campaign.held_out, held, strict=True))


def _scores(model: Model, fit: Refit, effects: Sequence[Effect] | None = None) -> list[Score]:
    """The scores of the hypotheses (all, or those given) at a fit, best first."""
    return scores_at(model, fit.search, fit.x, fit.here, effects)


def _near(
    model: Model, base: Refit, progress: Progress
) -> tuple[Refit, list[Score], tuple[Place, ...], list[Refit]]:
    """The base on bases of its own, scores and location there, and refits of the hypotheses left in the race.

    The best of them on bases of its own too.
    """
    progress("neighbourhood", 0.3)
    scores = _scores(model, base)
    base = gather(model, base, [*scores[:SINGLES], *promising(scores, SINGLES)])
    scores = _scores(model, base)
    location = located(model, base.x, model.deviations(), base.tangents(), scores)
    found = []
    # Those of several parameters stand far down, and may yet be what the data cannot rule out.
    wanted = promising(scores, SINGLES, ACCEPTED)
    for number, scored in enumerate(wanted):
        progress(f"trying {scored.effect.name}", 0.4 + 0.2 * number / len(wanted))
        result = refit(model, (scored.effect,), base.x, [scored])
        if result is not None:
            found.append(result)
    best = _best(base, found)
    if _in_question(base, best):
        progress(f"neighbourhood of {best.name}", 0.6)
        found = _settled(model, found)
    return base, scores, location, found


def _pairs(model: Model, singles: Sequence[Refit], progress: Progress) -> list[Refit]:
    """Refits of pairs: for the best single hypotheses, what the score test at their own optimum would add."""
    tried: dict[frozenset[str], tuple[Refit, Score]] = {}
    for single in singles[:PAIRED]:
        for scored in _further(model, single)[:PAIRS]:
            tried.setdefault(frozenset((single.name, scored.effect.name)), (single, scored))
    chosen = sorted(tried.values(), key=lambda pair: pair[0].evidence - pair[1].evidence)[:PAIRS]
    found = []
    for number, (single, scored) in enumerate(chosen):
        progress(f"trying {single.name} and {scored.effect.name}", 0.75 + 0.2 * number / len(chosen))
        result = refit(model, (*single.effects, scored.effect), single.x, [scored])
        if result is not None:
            found.append(result)
    return sorted(found, key=lambda f: f.evidence)


def _judged(
    model: Model, nominal: tuple[StateFit, ...], base: Refit, weighed: Sequence[Weighed], scores: Sequence[Score],
    location: tuple[Place, ...], singles: Sequence[Refit], pairs: Sequence[Refit],
    held_before: tuple[StateFit, ...], started: float,
) -> Diagnosis:
    best, held_after = weighed[0]
    gained = gain(base, best)
    found = best is not base and gained > ACCEPTED and _rare(_fall(base, best), len(best.estimate), CLEAR)
    left = _left(best, _further(model, best), pairs) if found else 0.0
    complete = _complete(base, best, left)
    held = _held(model, held_after)
    worse = held - _held(model, held_before)
    outdone = found and _besides(base, best, location)
    accepted = found and complete and worse < RIVAL and not outdone
    findings = [f"The known parameters alone leave a reduced chi-square of {base.reduced:.3g}.",
                *(f"{name} stands for {' and '.join(others)} too, which are as long."
                  for name, others in model.campaign.tied.items() if name in model.campaign.known),
                *refused_steps(model.fitted.refusals)]
    if found:
        findings.append(_closest(base, best, gained, held_before, held_after))
        if complete and not best.good:
            share = (best.reduced - 1.0) / (base.reduced - 1.0)
            findings.append(f"It describes the effect roughly: {100 * share:.2g} % of what the known parameters left, "
                            "and noise does not explain, is left by it too.")
        if not complete:
            findings.append(_lacking(base, best, left))
        if worse >= RIVAL:
            findings.append(f"It predicts the states held out worse than the known parameters alone, by a chi-square "
                            f"of {worse:.1f}: it is not accepted.")
        if outdone:
            findings.append("A resonance of the transducer that the model does not have explains more: it is not "
                            "accepted.")
    chosen = best if accepted else base
    strayed = tuple((name, shift) for name, shift in sorted(chosen.shifts.items(), key=lambda item: -abs(item[1]))
                    if abs(shift) > STRAYED)
    rivals: tuple[Rival, ...] = ()
    if accepted:
        others = [(fit, _held(model, states) - held) for fit, states in weighed[1:]]
        behind = [Rival(fit, fit.evidence - best.evidence + more, _fits_as_well(fit, best, more))
                  for fit, more in others]
        rivals = tuple(rival for rival in behind if rival.behind < RIVAL or rival.fits_as_well)
    if accepted:
        verdict = "ambiguous" if rivals else "missing_physics"
    elif found or not base.good:
        verdict = "unexplained"
    elif not _quiet(base, scores):
        verdict = "below_detection"
    elif any(s.reduced > GOOD_STATE for s in nominal):
        verdict = "parameters_explain"
    else:
        verdict = "no_mismatch"
    findings += _statements(verdict, chosen, rivals, strayed, location)
    if verdict == "unexplained" and (said := each_alone(model, base)):
        findings.append(said)
    following = _next(model, chosen, rivals, scores)
    findings += [_inexact(model, fit) for fit in dict.fromkeys((best if found else chosen, chosen))
                 if not fit.doubt < TRUSTED]
    return Diagnosis(model.campaign, model, verdict, nominal, base, chosen, tuple(scores), tuple(singles), tuple(pairs),
                     rivals, location, held_before, held_after if accepted else held_before, strayed,
                     all(_inside(chosen, name) for name in chosen.estimate), following,
                     tuple(findings), time.perf_counter() - started, model.fitted.solves)


def _simplest(other: Refit, best: Refit) -> bool:
    """A pair that holds the best explanation and more is no rival of it."""
    return not {e.name for e in best.effects} < {e.name for e in other.effects}


def _fits_as_well(other: Refit, best: Refit, held: float = 0.0) -> bool:
    """Whether an explanation of no more effects fits as well, beyond what its further parameters are worth by chance.

    `held` is by how much its chi-square of the states held out is larger. Evidence depends on how wide the ranges of
    the parameters are, which is a choice: what loses by that alone is not ruled out. Two of chi-square for a parameter
    (Akaike 1974, IEEE Trans. Automatic Control 19, 716), and as much as evidence may be behind; nothing for what has
    all the parameters of the best and more.
    """
    further = len(other.estimate) - len(best.estimate)
    margin = 0.0 if set(best.estimate) < set(other.estimate) else RIVAL
    return (len(other.effects) <= len(best.effects)
            and other.chi_square + held + 2.0 * further < best.chi_square + margin)


def _inside(fit: Refit, name: str) -> bool:
    for effect in fit.effects:
        if name in effect.admissible:
            limit = effect.admissible[name]
            return limit.lowest <= fit.estimate[name] <= limit.highest
    return True


def _lacking(base: Refit, best: Refit, left: float) -> str:
    """Why the best fit, of which a further hypothesis would take `left`, is not :func:`_complete`."""
    if _explains(base, best):
        why = (f"of the reduced chi-square of {best.reduced:.3g} that it leaves, a further hypothesis would take "
               f"{left:.1f}")
    elif leaves_less(best, base, REMNANT):
        why = (f"with it the known parameters still lie {best.strain:.2g} standard uncertainties (rms) from what is "
               "known of them")
    else:
        why = (f"it leaves a reduced chi-square of {best.reduced:.3g}, more than noise and than "
               f"{100 * REMNANT:.0f} % of what the known parameters left")
    return f"That is not all: {why}. It is not accepted."


def _closest(
    base: Refit, best: Refit, gained: float, held_before: Sequence[StateFit], held_after: Sequence[StateFit]
) -> str:
    """What the best hypothesis does, with figures."""
    held = "; ".join(f"{after.name}, held out, from {before.reduced:.3g} to {after.reduced:.3g}"
                     for before, after in zip(held_before, held_after, strict=True))
    return (f"{best.name} brings it from {base.reduced:.3g} to {best.reduced:.3g}{', ' if held else ''}{held}, an "
            f"evidence of {gained:.1f} (twice the logarithm of the odds): {best.in_words()}.")


def _inexact(model: Model, fit: Refit) -> str:
    """What the reduced model did to the figures of a fit that ended where its bases were not made for."""
    reduced, off = checked(model, fit)
    return (f"Where the fit of {fit.name or 'the known parameters alone'} ended, the reduced model was off by up to "
            f"{100.0 * off:.2g} % of Z: made again there, it leaves a reduced chi-square of {reduced:.3g}, not "
            f"{fit.reduced:.3g}.")


def _statements(
    verdict: str, best: Refit, rivals: Sequence[Rival], strayed: Sequence[tuple[str, float]],
    location: Sequence[Place],
) -> list[str]:
    """What the verdict means, in sentences with figures."""
    result = []
    if not all(_inside(best, name) for name in best.estimate):
        result.append("Its parameter lies outside what is admissible: the sign of another cause.")
    for rival in rivals:
        result.append(f"The data cannot rule out {rival.refit.name} ({rival.behind:.1f} behind"
                      + (", though it fits as well)." if rival.fits_as_well else ")."))
    for name, shift in strayed:
        result.append(f"{name} would have to lie {shift:+.1f} standard uncertainties from what is known of it.")
    if ended := best.at_bounds:
        result.append(f"At a bound of what it may be, with a value and an error of little worth: {', '.join(ended)}.")
    if verdict == "unexplained" and location:
        place = location[0]
        where = f", {'; '.join(place.modes)}" if place.modes else ""
        result.append(f"Nothing of the catalogue explains all that is left; most of it looks like {place.kind} in "
                      f"{place.region} ({place.sigmas:.1f} sigmas{where}).")
    if verdict == "below_detection":
        result.append("There is a hint, and not enough to name a cause.")
    correlated = [f"{s.name} ({s.correlation:.1f})" for s in best.states if s.correlation > CORRELATED]
    if correlated:
        result.append("What is left is no white noise; so many neighbouring points go together: "
                      + ", ".join(correlated) + ".")
    return result


def _next(model: Model, best: Refit, rivals: Sequence[Rival], scores: Sequence[Score]) -> str:
    """Which state would separate the surviving rivals best, from what each predicts there."""
    if not rivals:
        return ""
    other = rivals[0].refit
    separation: dict[str, float] = {}
    for objective, states in ((model.fitted, model.campaign.fitted), (model.held_out, model.campaign.held_out)):
        if objective is None:
            continue
        for index, state in enumerate(states):
            one, two = (objective.predict(fit.x, index)[0] for fit in (best, other))
            separation[state.name] = float(np.sum(np.abs(np.log(one / two) / state.noise) ** 2))
    most = max(separation, key=lambda name: separation[name])
    times = max(1.0, 2.0 * RIVAL / max(separation[most], 1e-9))
    by = {s.effect.name: s for s in scores}
    alike = confusion(by[best.effects[0].name], by[other.effects[0].name])
    return (f"Record {most} again: {best.name} and {other.name} differ most there, by a chi-square of "
            f"{separation[most]:.1f}; {times:.0f} times the recordings tell them apart (their tangents have a cosine "
            f"of {alike:.3f}).")


def known_physics(found: Diagnosis) -> list[tuple[str, str, Spectrum, Spectrum]]:
    """What the effects with known constants do, which are part of the model and never fitted.

    Returns:
        (effect, state, spectrum with it, spectrum without it) at the parameters found, for every fitted state that has
        it. Without it its constant is zero.
    """
    objective, x = found.model.fitted, found.best.x
    objective.cover(x, {}, UNNEEDED)
    result = []
    for index, (state, recording) in enumerate(zip(found.campaign.fitted, objective.recordings, strict=True)):
        if state.fluid is None:
            continue
        values, _ = objective.settings(x, index)
        values = {**recording.problem.values, **values}
        for effect, constant in KNOWN_PHYSICS.items():
            name = f"{state.fluid.name}.{constant}"
            if values.get(name):
                pair = [Spectrum(state.measured.frequency, objective.predictors[index](there).impedance)
                        for there in (values, {**values, name: 0j})]
                result.append((effect, state.name, pair[0], pair[1]))
    return result


def detection_limits(diagnosis: Diagnosis) -> dict[str, float]:
    """The smallest value (SI, from its start) of every hypothesis' first parameter that this campaign would detect."""
    return {s.effect.name: float(DETECTED * s.error[0]) for s in diagnosis.scores
            if s.error.size and np.isfinite(s.error[0])}


def intervals(fit: Refit) -> dict[str, tuple[float, float, float]]:
    """Estimate, low and high end of the 95 % interval of every parameter of a refit's effects, SI."""
    return {name: (value, *fit.interval(name)) for name, value in fit.estimate.items()}


