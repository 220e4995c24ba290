"""What is written of a diagnosis: the content of ``diagnosis.json``."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from workbench.comparison import compare
from workbench.diagnosis.campaign import DeviceState
from workbench.diagnosis.criteria import gain
from workbench.diagnosis.refit import StateFit
from workbench.diagnosis.verdict import Diagnosis, detection_limits, intervals, known_physics
from workbench.report.figures import measured_figures
from workbench.spectrum import Origin, Spectrum


class Contribution(NamedTuple):
    """What an effect with known constants changes in a state: f0 (Hz) and Q (None: no resonance), and ln Z, rms."""

    effect: str
    state: str
    f0_change: float | None
    q_change: float | None
    rms_log_change: float


def contributions(found: Diagnosis) -> list[Contribution]:
    """What every effect with known constants changes in every fitted state."""
    rows = []
    for effect, state, there, without in known_physics(found):
        (one, _), (other, _) = measured_figures(there), measured_figures(without)
        f0, q = (None, None) if one is None or other is None else (one.f0 - other.f0, one.q - other.q)
        rms = float(np.sqrt(np.mean(np.abs(np.log(there.impedance / without.impedance)) ** 2)))
        rows.append(Contribution(effect, state, f0, q, rms))
    return rows


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
        "before": {s.name: _state(s, state) for s, state in zip(found.nominal, found.campaign.fitted, strict=True)},
        "known_parameters_only": {
            s.name: _state(s, state) for s, state in zip(found.base.states, found.campaign.fitted, strict=True)},
        "after": {s.name: _state(s, state) for s, state in zip(found.best.states, found.campaign.fitted, strict=True)},
        "held_out": {
            before.name: {"before": _state(before, state), "after": _state(after, state)}
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


def _state(fit: StateFit, state: DeviceState) -> dict[str, Any]:
    spectrum = spectrum_of(fit, state)
    figures, _ = measured_figures(spectrum)
    return {"f0": None if figures is None else figures.f0, "z_min": None if figures is None else figures.z_min,
            "q": None if figures is None else figures.q, "mape_percent": compare(state.measured, spectrum).mape_percent,
            "rms_log_residual": fit.rms, "reduced_chi_square": fit.reduced, "correlation": fit.correlation}


def spectrum_of(fit: StateFit, state: DeviceState) -> Spectrum:
    """The spectrum of a state as it was fitted."""
    return Spectrum(state.measured.frequency, fit.impedance, origin=Origin("simulated"))
