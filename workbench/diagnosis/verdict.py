"""What a diagnosis comes to: which physics, where, how sure, and what else it could be."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from workbench.diagnosis.belong import each_alone
from workbench.diagnosis.campaign import Campaign
from workbench.diagnosis.criteria import (
    ACCEPTED,
    CLEAR,
    REMNANT,
    RIVAL,
    explains,
    fall_of,
    fits_as_well,
    further_scores,
    gain,
    has_mode_besides,
    held_out_chi_square,
    is_complete,
    is_quiet,
    is_rare,
    remaining_gain,
)
from workbench.diagnosis.device import Model
from workbench.diagnosis.hypothesis import Effect
from workbench.diagnosis.locate import Place
from workbench.diagnosis.refit import GOOD_STATE, TRUSTED, UNNEEDED, Refit, StateFit, checked, leaves_less
from workbench.diagnosis.score import Score, confusion
from workbench.fitting.joint import refused_steps
from workbench.notebook import Shown, Summary
from workbench.spectrum import Origin, Spectrum

if TYPE_CHECKING:
    import xarray

Weighed = tuple[Refit, tuple[StateFit, ...]]

#: Effects with known constants, and the constant of the cavity's fluid without which there is none.
KNOWN_PHYSICS = {"viscous boundary layer": "shear_viscosity", "thermal boundary layer": "thermal_conductivity",
                 "absorption of the fluid": "diffusivity_of_sound"}

#: Noise is called white up to this many neighbouring points that go together.
CORRELATED = 2.0

#: A known parameter that left what was known of it by more than this many uncertainties is a finding of its own.
STRAYED = 3.5

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
class Diagnosis(Shown):
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
    at_odds: tuple[tuple[str, float], ...]
    admissible: bool
    next_measurement: str
    findings: tuple[str, ...]
    seconds: float
    full_solves: int

    @property
    def effects(self) -> tuple[Effect, ...]:
        return self.best.effects

    def summary(self) -> Summary:
        """Verdict, effects with their numbers, and findings, for a notebook."""
        found = intervals(self.best)
        units = {parameter.name: parameter.unit for parameter in self.model.parameters}
        rows = [("verdict", self.verdict.replace("_", " ")), *(("effect", effect.name) for effect in self.effects)]
        rows += [(name, f"{value:.4g} ({low:.4g} to {high:.4g}) {units[name]}")
                 for name, (value, low, high) in found.items()]
        rows += [("finding", text) for text in self.findings]
        rows += [("next", self.next_measurement)] if self.next_measurement else []
        measured = {f"{state.name}, measured": state.measured for state in self.campaign.fitted}
        fitted = {f"{fit.name}, fitted": Spectrum(state.measured.frequency, fit.impedance, origin=Origin("simulated"))
                  for fit, state in zip(self.best.states, self.campaign.fitted, strict=True)}
        return Summary(f"Diagnosis: {self.campaign.name}", tuple(rows), {**measured, **fitted}, tuple(measured))

    def to_xarray(self) -> xarray.Dataset:
        """rms of ln(Z / Z_measured) and reduced chi-square over ``state`` and ``stage``.

        Stages: as stated, with the known parameters fitted, with the accepted effects.
        """
        import xarray

        stages = {"stated": self.nominal, "known parameters": self.base.states, "effects": self.best.states}
        both = {name: (("stage", "state"), np.array([[getattr(fit, key) for fit in fits] for fits in stages.values()]))
                for name, key in (("rms_log_residual", "rms"), ("reduced_chi_square", "reduced"))}
        names = [state.name for state in self.campaign.fitted]
        return xarray.Dataset(both, {"stage": list(stages), "state": names},
                              {"verdict": self.verdict, "effects": ", ".join(each.name for each in self.effects)})


def verdict_on(
    model: Model, nominal: tuple[StateFit, ...], base: Refit, weighed: Sequence[Weighed], scores: Sequence[Score],
    location: tuple[Place, ...], singles: Sequence[Refit], pairs: Sequence[Refit],
    held_before: tuple[StateFit, ...], started: float,
) -> Diagnosis:
    """The diagnosis that the fits in `weighed`, best first, come to; `started` (s) is when it was begun."""
    best, held_after = weighed[0]
    gained = gain(base, best)
    found = best is not base and gained > ACCEPTED and is_rare(fall_of(base, best), len(best.estimate), CLEAR)
    left = remaining_gain(best, further_scores(model, best), pairs) if found else 0.0
    complete = is_complete(base, best, left)
    held = held_out_chi_square(model, held_after)
    worse = held - held_out_chi_square(model, held_before)
    outdone = found and has_mode_besides(base, best, location)
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
    at_odds = tuple((name, shift) for name, shift in sorted(chosen.shifts.items(), key=lambda item: -abs(item[1]))
                    if abs(shift) > STRAYED)
    rivals: tuple[Rival, ...] = ()
    if accepted:
        others = [(fit, held_out_chi_square(model, states) - held) for fit, states in weighed[1:]]
        behind = [Rival(fit, fit.evidence - best.evidence + more, fits_as_well(fit, best, more))
                  for fit, more in others]
        rivals = tuple(rival for rival in behind if rival.behind < RIVAL or rival.fits_as_well)
    if accepted:
        verdict = "ambiguous" if rivals else "missing_physics"
    elif found or not base.good:
        verdict = "unexplained"
    elif not is_quiet(base, scores):
        verdict = "below_detection"
    elif any(s.reduced > GOOD_STATE for s in nominal):
        verdict = "parameters_explain"
    else:
        verdict = "no_mismatch"
    findings += _statements(verdict, chosen, rivals, at_odds, location)
    if verdict == "unexplained" and (said := each_alone(model, base)):
        findings.append(said)
    following = _next(model, chosen, rivals, scores)
    findings += [_inexact(model, fit) for fit in dict.fromkeys((best if found else chosen, chosen))
                 if not fit.doubt < TRUSTED]
    return Diagnosis(model.campaign, model, verdict, nominal, base, chosen, tuple(scores), tuple(singles), tuple(pairs),
                     rivals, location, held_before, held_after if accepted else held_before, at_odds,
                     all(_inside(chosen, name) for name in chosen.estimate), following,
                     tuple(findings), time.perf_counter() - started, model.fitted.solves)


def _inside(fit: Refit, name: str) -> bool:
    for effect in fit.effects:
        if name in effect.admissible:
            limit = effect.admissible[name]
            return limit.lowest <= fit.estimate[name] <= limit.highest
    return True


def _lacking(base: Refit, best: Refit, left: float) -> str:
    """Why the best fit, of which a further hypothesis would take `left`, is not :func:`is_complete`."""
    if explains(base, best):
        why = (f"of the reduced chi-square of {best.reduced:.3g} that it leaves, a further hypothesis would take "
               f"{left:.1f}")
    elif leaves_less(best, base, REMNANT):
        why = (f"with it the known parameters still lie {best.prior_pull:.2g} standard uncertainties (rms) from what "
               "is known of them")
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
    verdict: str, best: Refit, rivals: Sequence[Rival], at_odds: Sequence[tuple[str, float]],
    location: Sequence[Place],
) -> list[str]:
    """What the verdict means, in sentences with figures."""
    result = []
    if not all(_inside(best, name) for name in best.estimate):
        result.append("Its parameter lies outside what is admissible: the sign of another cause.")
    for rival in rivals:
        result.append(f"The data cannot rule out {rival.refit.name} ({rival.behind:.1f} behind"
                      + (", though it fits as well)." if rival.fits_as_well else ")."))
    for name, shift in at_odds:
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
