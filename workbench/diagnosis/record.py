"""What is written of a diagnosis: the content of ``diagnosis.json``. Evidences and odds are natural logarithms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from workbench.diagnosis.campaign import Campaign
from workbench.diagnosis.decision import NOT_FINISHED
from workbench.diagnosis.device import Model
from workbench.diagnosis.outcome import Diagnosis, FoundNumber
from workbench.diagnosis.state import StateFit, state_record
from workbench.report.figures import measured_figures
from workbench.results.spectrum import Spectrum

#: Effects with known constants, and the constant of the cavity's fluid without which there is none.
KNOWN_PHYSICS = {"viscous boundary layer": "shear_viscosity", "thermal boundary layer": "thermal_conductivity",
                 "absorption of the fluid": "diffusivity_of_sound"}

#: Estimated error of Z that a prediction without one of these effects may have, relative.
UNNEEDED = 1e-5

#: Detection needs this many standard deviations.
DETECTED = 5.0


class Contribution(NamedTuple):
    """What an effect with known constants changes in a state: f0 (Hz) and Q (None: no resonance), and ln Z, rms."""

    effect: str
    state: str
    f0_change: float | None
    q_change: float | None
    rms_log_change: float

    @classmethod
    def of(cls, effect: str, state: str, there: Spectrum, without: Spectrum) -> Contribution:
        """From the spectra with the effect and without it."""
        (one, _), (other, _) = measured_figures(there), measured_figures(without)
        f0, q = (None, None) if one is None or other is None else (one.f0 - other.f0, one.q - other.q)
        changed = np.abs(np.log(there.impedance / without.impedance))
        return cls(effect, state, f0, q, float(np.sqrt(np.mean(changed**2))))


def contributions(found: Diagnosis) -> list[Contribution]:
    """What every effect with known constants changes in every fitted state, at the parameters found."""
    model: Model = found.model
    objective, x = model.fitted, found.conclusion.chosen.explanation.x
    objective.cover(x, {}, UNNEEDED)
    rows = []
    for index, (state, recording) in enumerate(zip(found.campaign.fitted, objective.recordings, strict=True)):
        values = {**recording.problem.values, **objective.settings(x, index)[0]}
        for effect, constant in KNOWN_PHYSICS.items():
            name = "" if state.fluid is None else f"{state.fluid.name}.{constant}"
            if values.get(name):
                there, without = (Spectrum(state.measured.frequency, objective.predictors[index](each).impedance)
                                  for each in (values, {**values, name: 0j}))
                rows.append(Contribution.of(effect, state.name, there, without))
    return rows


def detection_limits(found: Diagnosis) -> dict[str, float]:
    """The smallest value (SI, from its start) of every hypothesis' first parameter that this campaign would detect."""
    return {s.effect.name: float(DETECTED * s.error[0]) for s in found.scores
            if s.error.size and np.isfinite(s.error[0])}


def record(found: Diagnosis) -> dict[str, Any]:
    """The content of ``diagnosis.json``, but for what effects with known constants contribute."""
    decision, states, count = found.conclusion.decision, found.states, len(found.campaign.fitted)

    def fits(of: Sequence[StateFit]) -> dict[str, Any]:
        return {fit.name: state_record(fit, state) for fit, state in zip(of, states, strict=True)}

    before, base, after = fits(found.stated), fits(found.base), fits(found.best)
    fitted, held = [s.name for s in states[:count]], [s.name for s in states[count:]]
    rivals = zip(decision.rivals, found.conclusion.rivals, strict=True)
    return {
        "campaign": found.campaign.name, "verdict": found.verdict, "headline": found.headline,
        "effects": _effects(found),
        "left": vars(found.left), "accuracy": found.left.accuracy,
        "moved_parameters": [{"name": p.name, "from": p.stated, "to": p.value, "unit": p.unit, "sigmas": p.sigmas}
                             for p in found.known],
        "rivals": [{"effects": list(e.effects), "name": e.name,
                    "behind": decision.log_odds[decision.chosen.name] - decision.log_odds[e.name],
                    "parameters": {p.name: [p.value, p.low, p.high] for p in found.estimates_of(settled)}}
                   for e, settled in rivals],
        "location": [place._asdict() for place in found.location],
        **{key: {name: of[name] for name in fitted}
           for key, of in (("before", before), ("known_parameters_only", base), ("after", after))},
        "held_out": {name: {"before": base[name], "after": after[name]} for name in held},
        "next_measurement": found.next_measurement, "next_options": [vars(option) for option in found.next_options],
        "detection_limits": detection_limits(found),
        "scores": [{"effect": s.effect.name, "region": s.effect.region, "gain": s.gain,
                    "sigmas": math.sqrt(max(s.gain, 0.0)), "evidence": s.evidence} for s in found.scores],
        "refits": [{"name": e.hypothesis.name, "effects": [effect.name for effect in e.hypothesis.effects],
                    "evidence": e.log_evidence - found.found.base.explanation.log_evidence,
                    "held_out": settled.held_out - found.found.base.held_out,
                    "log_odds": decision.log_odds[e.hypothesis.name], "accuracy": e.accuracy,
                    "reduced_chi_square": float(np.mean(e.residual.vector**2))}
                   for settled in found.found.final for e in [settled.explanation]],
        "taken": _taken(found.campaign), "undone": list(found.found.undone),
        "not_tried": [vars(each) for each in found.found.not_tried],
        # Of a search that was cut short: what explains best of what it looked at.
        "provisional": None if found.provisional is None else {"effects": _effects(found.provisional)},
        "findings": list(found.findings), "seconds": found.seconds, "full_solves": found.model.whole.solves,
    }


def stopped_record(campaign: Campaign, seconds: float) -> dict[str, Any]:
    """The content of ``diagnosis.json`` where a diagnosis was stopped after so many `seconds`, before its first result.
    """
    return {
        "campaign": campaign.name, "verdict": NOT_FINISHED,
        "headline": "Not finished: it was stopped before its first result, and nothing can be said of any hypothesis.",
        "effects": [], "rivals": [], "provisional": None, "undone": ["everything"], "not_tried": [], "findings": [],
        "read": {state.name: {"recording": state.measured.origin.source,
                              "points": int(state.measured.frequency.size), "held_out": state.held_out}
                 for state in campaign.states},
        "taken": _taken(campaign), "seconds": seconds,
    }


def _effects(found: Diagnosis) -> list[dict[str, Any]]:
    return [{"name": e.effect.name, "region": e.effect.region, "kind": e.effect.kind, "admissible": e.admissible,
             "share": e.share, "parameters": {p.name: _estimate(p) for p in e.estimates}} for e in found.established]


def _estimate(found: FoundNumber) -> dict[str, Any]:
    return {"value": found.value, "low": found.low, "high": found.high, "unit": found.unit}


def _taken(campaign: Campaign) -> list[dict[str, object]]:
    """The numbers that were taken as known: how exactly, and who says so."""
    return [{"name": each.name, "uncertainty": each.deviation, "unit": each.unit, "source": each.origin}
            for each in campaign.taken]
