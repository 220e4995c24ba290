"""A diagnosis as tables, as the record of ``diagnosis.json``, and as a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geometry.names import parent_place
from workbench.acoustics.fields import section_nodes
from workbench.diagnosis.campaign import Campaign
from workbench.diagnosis.decision import NOT_FINISHED
from workbench.diagnosis.known_physics import Contribution
from workbench.diagnosis.outcome import Diagnosis, FoundNumber
from workbench.diagnosis.state import DeviceState, StateFit, fitted_spectrum
from workbench.files.quantities import shown_factor, shown_unit
from workbench.files.writing import write_json
from workbench.model.numbers import plain_words
from workbench.render.diagnoses import StatePicture, draw_shares, draw_states
from workbench.render.sections import draw_marked
from workbench.report.figures import origin_table
from workbench.report.page import Block, Note, Picture, TextTable, number_text, write_report
from workbench.results.comparison import compare
from workbench.results.merit import Figures, measured_figures

#: Title of the table of remainders.
LEFT = "what is left of Z, rms of both parts (%)"

#: Rows of a table of hypotheses.
LISTED = 12

#: A hypothesis is detected from this many standard deviations on.
DETECTED = 5.0


def established_table(found: Diagnosis) -> TextTable:
    """Effects with the share that they take, those that belong together as one, and their parameters with intervals."""
    rows = []
    for group, share in found.shares:
        cell = f"{100.0 * share:.3g} %" + (", together" if len(group) > 1 else "")
        for each in group:
            for k, e in enumerate(each.estimates):
                rows.append((plain_words(each.effect.name) if k == 0 else "", cell, e.name, number_text(e.shown[0]),
                             f"{number_text(e.shown[1])} to {number_text(e.shown[2])}",
                             "of what is stated" if e.relative else shown_unit(e.unit)))
                cell = ""
    return TextTable(("effect", "share", "parameter", "value", "95 % interval", "unit"), tuple(rows))


def remainder_table(found: Diagnosis) -> TextTable:
    """Rms of ln(Z / Z_measured) of every state (%): noise, as stated, with the known parameters, with the effects."""
    held = {state.name for state in found.campaign.held_out}
    rows = []
    for state, *fits in zip(found.states, found.stated, found.base, found.best, strict=True):
        stated = 100.0 * math.sqrt(float((state.noise**2).mean()))
        cell = [number_text(100.0 * fit.rms, 3) for fit in fits]
        rows.append((state.name + (", held out" if state.name in held else ""),
                     f"{number_text(stated, 3)} leaves {number_text(math.sqrt(2.0) * stated, 3)}",
                     *(cell if found.established else cell[:2])))
    columns = ("state", "noise", "as stated", "known parameters", "with what was found")
    return TextTable(columns if found.established else columns[:-1], tuple(rows))


def write_diagnosis_report(found: Diagnosis, known: Sequence[Contribution], folder: Path) -> Path:
    """``report.html``: the headline, its pictures, the next measurement and the prior knowledge; then evidence."""
    first: list[Block] = [Note(found.headline), f"Verdict: {found.verdict.replace('_', ' ')}.",
                           "\n\n".join(found.findings)]
    if found.established:
        first.append(established_table(found))
    first += [f"{LEFT[0].upper()}{LEFT[1:]}:", remainder_table(found), *_pictures(found, folder)]
    if found.next_measurement:
        first.append(Note(f"Next measurement. {found.next_measurement}"))
    so_far = found.provisional
    provisional: list[tuple[str, Sequence[Block]]] = []
    if so_far is not None and so_far.established:
        provisional.append(("Provisional", ["What explains best of what was looked at. What was not may explain as "
                                            "much, or more.", established_table(so_far)]))
    cut = "" if so_far is None else ", as far as it went"
    sections: Sequence[tuple[str, Sequence[Block]]] = [
        ("What was found" if so_far is None else "Not finished", first), *provisional,
        ("What was taken as known", ["Standard uncertainties, and where they come from; what is not listed is exact.",
                                     _taken(found.campaign)]),
        (f"Odds of the hypotheses{cut}", [
            "Posterior odds against nothing being wrong. Evidences are natural logarithms relative to that.",
            _odds(found), "What was given up on the way, by its evidence there:", _given_up(found)]),
        (f"Where{cut}", ["What anything within one region, or modes that the model does not have, would add to what "
                         "explains best.", _location(found)]),
        ("Score test", ["What each hypothesis promises where the known parameters alone explain most; it decides "
                        "nothing.", _scores(found)]),
        ("Known parameters", [_known(found.known)]),
        ("Figures of merit", [_merit(found)]),
        ("Effects with known constants", [
            "They are part of the model and never fitted; this is what each changes.",
            _known_physics(known)]),
        ("The recordings", [block for state in found.states
                            for block in (f"State {state.name}:", origin_table(state.measured.origin))])]
    title = "Diagnosis" if so_far is None else "Diagnosis, not finished"
    return write_report(folder / "report.html", f"{title}: {found.campaign.name}", sections)


def write_stopped(campaign: Campaign, folder: Path, seconds: float) -> None:
    """``diagnosis.json`` and ``report.html`` of a diagnosis that was stopped before its first result: what was read."""
    said = stopped_record(campaign, seconds)
    write_json(folder / "diagnosis.json", said)
    states = TextTable(("state", "points", "from (MHz)", "to (MHz)", "held out"), tuple(
        (state.name, str(state.measured.frequency.size), number_text(state.measured.frequency[0] / 1e6),
         number_text(state.measured.frequency[-1] / 1e6),
         "yes" if state.held_out else "no") for state in campaign.states))
    write_report(folder / "report.html", f"Diagnosis, not finished: {campaign.name}", [
        ("Not finished", [Note(said["headline"]), "Verdict: not finished."]),
        ("The recordings that were read", [states]),
        ("What was taken as known", ["Standard uncertainties, and where they come from; what is not listed is exact.",
                                     _taken(campaign)])])


def _pictures(found: Diagnosis, folder: Path) -> list[Block]:
    """Every state before and after, a bar of shares, and the section with the suspect places marked."""
    first, last = ((found.base, found.best) if found.established else (found.stated, found.base))
    labels = (("known parameters alone", "with what was found") if found.established
              else ("as stated", "known parameters fitted"))
    held = {state.name for state in found.campaign.held_out}
    states = [StatePicture(state.name + (", held out" if state.name in held else ""), state.measured.frequency,
                           state.measured.impedance, before.impedance, after.impedance, state.noise)
              for state, before, after in zip(found.states, first, last, strict=True)]
    pictures: list[Block] = [Picture(draw_states(states, folder / "states.png", before=labels[0], after=labels[1]),
                                     "Every state as recorded, before and after, and below what is left of it")]
    if found.established:
        shares = {" and ".join(plain_words(each.effect.name) for each in group): share
                  for group, share in found.shares}
        pictures.append(Picture(draw_shares(shares, folder / "shares.png", title="What explains the mismatch"),
                                "Of the mismatch that the known parameters leave, beyond noise"))
    mesh = max((recording.problem.mesh for recording in found.model.fitted.recordings),
               key=lambda each: each.mesh.t.shape[1])
    nodes, _ = section_nodes(mesh)
    marked = [name for name in dict.fromkeys(map(parent_place, found.where)) if name in nodes.regions]
    if marked:
        pictures.append(Picture(draw_marked(nodes, marked, folder / "where.png", title="Where it sits"),
                                f"The section of the chip, with {' and '.join(marked)} marked"))
    elif found.where:
        pictures.append(f"It sits in the {' and the '.join(found.where)}, which the section of the chip does not show.")
    return pictures


def _taken(campaign: Campaign) -> TextTable:
    return TextTable(("parameter", "standard uncertainty", "unit", "from"), tuple(
        (each.name, number_text(each.deviation * shown_factor(each.unit), 3), shown_unit(each.unit), each.origin)
        for each in campaign.taken))


def _odds(found: Diagnosis) -> TextTable:
    decision, base = found.conclusion.decision, found.found.base
    rows = []
    for refit in found.found.final:
        e = refit.explanation
        rows.append((decision.log_odds[e.hypothesis.name], (
            e.hypothesis.name, _power(decision.log_odds[e.hypothesis.name]),
            f"{e.log_evidence - base.explanation.log_evidence:.1f}", f"{refit.held_out - base.held_out:.1f}",
            f"{100.0 * e.accuracy:.2g}", "; ".join(f"{p.name} {p.in_words}" for p in found.estimates_of(refit)))))
    return TextTable(("hypothesis", "odds", "evidence", "of it by states held out", "accuracy of the model (%)",
                      "parameters"), tuple(row for _, row in sorted(rows, key=lambda both: -both[0])))


def _power(log_odds: float) -> str:
    """Odds from their natural logarithm."""
    return f"{math.exp(log_odds):.3g}" if abs(log_odds) < 14.0 else f"10^{log_odds / math.log(10.0):.0f}"


def _given_up(found: Diagnosis) -> TextTable:
    refitted = {each.explanation.hypothesis.name for each in found.found.final}
    null = next((each.log_evidence for each in found.found.candidates
                  if each.hypothesis.name == found.found.base.explanation.hypothesis.name), 0.0)
    others = [each for each in found.found.candidates if each.hypothesis.name not in refitted]
    return TextTable(("hypothesis", "evidence"), tuple(
        (each.hypothesis.name, f"{each.log_evidence - null:.1f}")
        for each in sorted(others, key=lambda each: -each.log_evidence)))


def _location(found: Diagnosis) -> TextTable:
    return TextTable(("region", "evidence", "sigmas", "where"), tuple(
        (place.region, f"{place.evidence:.1f}", f"{place.sigmas:.1f}", "; ".join(place.modes))
        for place in found.location))


def _scores(found: Diagnosis) -> TextTable:
    return TextTable(("hypothesis", "where", "kind", "fall of chi-square", "evidence"), tuple(
        (s.effect.name, s.effect.region, s.effect.kind, f"{s.gain:.1f}", f"{s.evidence:.1f}")
        for s in found.scores[:LISTED]))


def _known(known: Sequence[FoundNumber]) -> TextTable:
    return TextTable(("known parameter", "stated", "found", "unit", "sigmas"), tuple(
        (each.name, number_text(each.shown[3], 5), number_text(each.shown[0], 5), shown_unit(each.unit),
         f"{each.sigmas or 0.0:+.2f}") for each in sorted(known, key=lambda each: -abs(each.sigmas or 0.0))))


def _known_physics(known: Sequence[Contribution]) -> TextTable:
    """Changes by every effect with known constants."""
    return TextTable(("effect", "state", "f0 (Hz)", "Q", "ln Z, rms (%)"), tuple(
        (row.effect, row.state, *("none" if value is None else f"{value:+.3g}"
                                  for value in (row.f0_change, row.q_change)),
         f"{100.0 * row.rms_log_change:.3g}") for row in known))


def _merit(found: Diagnosis) -> TextTable:
    rows = []
    for state, stated, base, best in zip(found.states, found.stated, found.base, found.best, strict=True):
        rows.append((state.name, "measured", *_merit_cells(measured_figures(state.measured)[0]), ""))
        fits = {"as stated": stated, "known parameters": base}
        if found.established:
            fits["with what was found"] = best
        rows += [(state.name, label, *_merit_cells(measured_figures(fitted_spectrum(fit, state))[0]),
                  number_text(fit.reduced, 3))
                 for label, fit in fits.items()]
    return TextTable(("state", "spectrum", "f0 (kHz)", "Z_min (ohm)", "Q", "chi-square"), tuple(rows))

def _merit_cells(merit: Figures | None) -> tuple[str, str, str]:
    """f0 (kHz), Z_min (ohm) and Q."""
    if merit is None:
        return "none", "none", "none"
    return f"{merit.f0 / 1e3:.3f}", number_text(merit.z_min), number_text(merit.q)


# --------------------------------------------------------------------------------------------------------------------
# diagnosis.json. Evidences and odds are natural logarithms.


def detection_limits(found: Diagnosis) -> dict[str, float]:
    """The smallest value (SI, from its start) of every hypothesis' first parameter that this campaign would detect."""
    return {s.effect.name: float(DETECTED * s.error[0]) for s in found.scores
            if s.error.size and np.isfinite(s.error[0])}


def diagnosis_record(found: Diagnosis) -> dict[str, Any]:
    """The content of ``diagnosis.json``, but for what effects with known constants contribute."""
    decision, states, count = found.conclusion.decision, found.states, len(found.campaign.fitted)

    def fits(of: Sequence[StateFit]) -> dict[str, Any]:
        return {fit.name: _state_record(fit, state) for fit, state in zip(of, states, strict=True)}

    before, base, after = fits(found.stated), fits(found.base), fits(found.best)
    fitted, held = [s.name for s in states[:count]], [s.name for s in states[count:]]
    rivals = zip(decision.rivals, found.conclusion.rivals, strict=True)
    return {
        "campaign": found.campaign.name, "verdict": found.verdict, "headline": found.headline,
        "effects": _effects(found),
        "left": vars(found.remainder), "accuracy": found.remainder.accuracy,
        "moved_parameters": [{"name": p.name, "from": p.stated, "to": p.value, "unit": p.unit, "sigmas": p.sigmas}
                             for p in found.known],
        "rivals": [{"effects": list(e.effects), "name": e.name,
                    "behind": decision.log_odds[decision.chosen.name] - decision.log_odds[e.name],
                    "parameters": {p.name: [p.value, p.low, p.high] for p in found.estimates_of(refit)}}
                   for e, refit in rivals],
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
                    "held_out": refit.held_out - found.found.base.held_out,
                    "log_odds": decision.log_odds[e.hypothesis.name], "accuracy": e.accuracy,
                    "reduced_chi_square": float(np.mean(e.residual.vector**2))}
                   for refit in found.found.final for e in [refit.explanation]],
        "taken": _taken_record(found.campaign), "undone": list(found.found.undone),
        "not_tried": [vars(each) for each in found.found.not_tried],
        # Of a search that was cut short: what explains best of what it looked at.
        "provisional": None if found.provisional is None else {"effects": _effects(found.provisional)},
        "findings": list(found.findings), "seconds": found.seconds,
    }


def _state_record(fit: StateFit, state: DeviceState) -> dict[str, Any]:
    """A state as it was fitted, for a JSON file."""
    spectrum = fitted_spectrum(fit, state)
    figures, _ = measured_figures(spectrum)
    return {"f0": None if figures is None else figures.f0, "z_min": None if figures is None else figures.z_min,
            "q": None if figures is None else figures.q, "mape_percent": compare(state.measured, spectrum).mape_percent,
            "rms_log_residual": fit.rms, "reduced_chi_square": fit.reduced, "correlation": fit.correlation}


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
        "taken": _taken_record(campaign), "seconds": seconds,
    }


def _effects(found: Diagnosis) -> list[dict[str, Any]]:
    return [{"name": e.effect.name, "region": e.effect.region, "kind": e.effect.kind, "admissible": e.admissible,
             "share": e.share, "parameters": {p.name: _estimate(p) for p in e.estimates}} for e in found.established]


def _estimate(found: FoundNumber) -> dict[str, Any]:
    return {"value": found.value, "low": found.low, "high": found.high, "unit": found.unit}


def _taken_record(campaign: Campaign) -> list[dict[str, object]]:
    """The numbers that were taken as known: how exactly, and who says so."""
    return [{"name": each.name, "uncertainty": each.deviation, "unit": each.unit, "source": each.origin}
            for each in campaign.taken]
