"""What is written of a diagnosis: the content of ``diagnosis.json``."""

from __future__ import annotations

from typing import Any

from workbench.diagnosis.archive import Contribution
from workbench.diagnosis.criteria import gain
from workbench.diagnosis.state import state_record
from workbench.diagnosis.verdict import Diagnosis, detection_limits, intervals, known_physics


def contributions(found: Diagnosis) -> list[Contribution]:
    """What every effect with known constants changes in every fitted state."""
    return [Contribution.of(*row) for row in known_physics(found)]


def record(found: Diagnosis) -> dict[str, Any]:
    """The content of ``diagnosis.json``, but for what effects with known constants contribute."""
    estimates = intervals(found.best)
    parameters = {p.name: p for p in found.model.parameters}
    return {
        "campaign": found.campaign.name,
        "verdict": found.verdict,
        "effects": [
            {"name": e.name, "region": e.region, "kind": e.kind, "admissible": found.admissible,
             "parameters": {n: {"value": estimates[n][0], "low": estimates[n][1], "high": estimates[n][2],
                                "unit": parameters[n].unit} for n in e.names}}
            for e in found.effects],
        "moved_parameters": [
            {"name": p.name, "from": p.start, "to": float(found.best.x[i]), "unit": p.unit,
             "sigmas": found.best.shifts[p.name]}
            for i, p in enumerate(found.model.parameters[:found.model.known]) if p.name in found.best.shifts],
        "rivals": [{"effects": [e.name for e in r.refit.effects], "behind": r.behind,
                    "parameters": {n: list(v) for n, v in intervals(r.refit).items()}} for r in found.rivals],
        "location": [place._asdict() for place in found.location],
        "before": {
            s.name: state_record(s, state) for s, state in zip(found.nominal, found.campaign.fitted, strict=True)},
        "known_parameters_only": {
            s.name: state_record(s, state) for s, state in zip(found.base.states, found.campaign.fitted, strict=True)},
        "after": {
            s.name: state_record(s, state) for s, state in zip(found.best.states, found.campaign.fitted, strict=True)},
        "held_out": {
            before.name: {"before": state_record(before, state), "after": state_record(after, state)}
            for before, after, state in zip(found.held_before, found.held_after, found.campaign.held_out, strict=True)},
        "next_measurement": found.next_measurement,
        "detection_limits": detection_limits(found),
        "scores": [{"effect": s.effect.name, "region": s.effect.region, "gain": s.gain, "sigmas": s.sigmas,
                    "evidence": s.evidence} for s in found.scores],
        "refits": [{"effects": [e.name for e in f.effects], "evidence": gain(found.base, f),
                    "reduced_chi_square": f.reduced} for f in (*found.singles, *found.pairs)],
        "findings": list(found.findings),
        "seconds": found.seconds,
        "full_solves": found.full_solves,
    }
