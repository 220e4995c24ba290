"""A diagnosis as tables, as the record of ``diagnosis.json``, and as a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from geometry.names import parent_place
from workbench.acoustics.fields import section_nodes
from workbench.campaign.campaign import Campaign
from workbench.campaign.state import DeviceState, StateFit, fitted_spectrum
from workbench.diagnosis.decision import NOT_FINISHED
from workbench.diagnosis.description import Description, regions_in_words, states_that_show
from workbench.diagnosis.known_physics import Contribution
from workbench.diagnosis.outcome import Diagnosis, FoundNumber
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
LEFT = "left of Z: rms of ln(Z_model / Z_measured), both parts together, in %"

#: Rows of a table of hypotheses.
LISTED = 12

#: Share of the change by an effect from which on a state shows it.
SHOWN = 0.01

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
    return TextTable(("effect", "share of the mismatch", "parameter", "value", "95 % interval", "unit"), tuple(rows))


def remainder_table(found: Diagnosis) -> TextTable:
    """Rms of ln(Z / Z_measured) of every state (%): that of noise alone, as stated, with the known numbers fitted
    within their uncertainties, and with the effects; those held out last."""
    rows = []
    for state, *fits in zip(found.states, found.stated, found.base, found.best, strict=True):
        noise = 100.0 * math.sqrt(state.data * float((state.noise**2).mean()))
        cells = [number_text(100.0 * fit.rms, 3) for fit in fits]
        rows.append((_state_name(found, state), number_text(noise, 3), *(cells if found.established else cells[:2])))
    known = "known numbers, some beyond their uncertainties" if _beyond(found) else (
        "known numbers within their uncertainties")
    columns = ("state", "noise alone (%)", "as stated (%)", f"{known} (%)", "with what was found (%)")
    return TextTable(columns if found.established else columns[:-1], tuple(rows))


def observations_table(found: Diagnosis) -> TextTable:
    """Observations beside the impedance: as measured, and as predicted before and after."""
    columns = ("observation", "measured", "uncertainty (%)", "as stated", "with the known numbers fitted",
               "with what was found", "unit")
    rows = []
    for state, *fits in zip(found.states, found.stated, found.base, found.best, strict=True):
        if (own := state.observation) is not None:
            rows.append((_state_name(found, state), number_text(own.value, 4), number_text(100.0 * own.uncertainty, 3),
                         *(number_text(float(fit.impedance[0].real), 4) for fit in fits), own.unit))
    return TextTable(columns, tuple(rows))


def unexplained_tables(found: Description) -> list[Block]:
    """The mismatch that nothing explains: in which states, at which frequencies, and what takes most of it."""
    states = TextTable(("state", "left of Z (%)", "times the noise", "share of what is left (%)"), tuple(
        (each.name, number_text(100.0 * each.rms, 3), number_text(each.times, 3),
         "held out" if each.share is None else f"{100.0 * each.share:.0f}") for each in found.states))
    bands = TextTable(("state", "from (MHz)", "to (MHz)", "largest at (MHz)", "left of Z (%)",
                       "share of what is left (%)", "nearest mode of the model", "its energy in"), tuple(
        (each.state, *(f"{number / 1e6:.4f}" for number in (each.low, each.high, each.peak)),
         number_text(100.0 * each.rms, 3), f"{100.0 * each.share:.0f}",
         "none in the recording" if each.mode is None else f"{each.mode.kind} {each.mode.frequency / 1e6:.4f} MHz",
         regions_in_words(each.regions)) for each in found.bands))
    takers = TextTable(("hypothesis", "share of what is left (%)", "odds against nothing further", "found by"), tuple(
        (plain_words(each.name), f"{100.0 * each.share:.2g}", _power(each.log_odds),
         "its score" if each.predicted else "a fit") for each in found.takers))
    first = [f"{100.0 * found.rms:.3g} % of Z is left, {found.times:.3g} times the stated noise. By state:", states,
             "The frequencies where most of it lies, with the regions that hold the mechanical energy of the nearest "
             "mode:", bands]
    taken = ["The hypotheses of the catalogue that take most of it:", takers] if found.takers else [
        "No hypothesis of the catalogue takes any of it."]
    return [*first, *taken]


def _state_name(found: Diagnosis, state: DeviceState) -> str:
    """The name of a state, marked if it is held out."""
    held = {each.name for each in found.campaign.held_out}
    return state.name + (", held out" if state.name in held else "")


def write_diagnosis_report(found: Diagnosis, known: Sequence[Contribution], folder: Path) -> Path:
    """``report.html``: the headline, a rest that nothing explains, the fit before and after, the next measurement and
    the prior knowledge; then evidence."""
    first: list[Block] = [Note(found.headline), f"Verdict: {found.verdict.replace('_', ' ')}.",
                           "\n\n".join(found.findings)]
    if found.established:
        first.append(established_table(found))
    if found.next_measurement:
        first.append(Note(f"Next measurement. {found.next_measurement}"))
    rest: list[tuple[str, Sequence[Block]]] = []
    if found.description is not None:
        rest.append(("What nothing explains", unexplained_tables(found.description)))
    so_far = found.provisional
    provisional: list[tuple[str, Sequence[Block]]] = []
    if so_far is not None and so_far.established:
        provisional.append(("Provisional", ["What explains best of what was looked at. What was not may explain as "
                                            "much, or more.", established_table(so_far)]))
    cut = "" if so_far is None else ", as far as it went"
    observations: list[tuple[str, Sequence[Block]]] = []
    if any(state.observation for state in found.states):
        observations.append(("Observed beside the impedance", ["Each is one datum with its stated uncertainty, weighed "
                                                               "like a recording.", observations_table(found)]))
    recordings: list[Block] = []
    for state in (state for state in found.states if state.observation is None):
        recordings += [f"State {state.name}:", *map(Note, state.findings), origin_table(state.measured.origin)]
    sections: Sequence[tuple[str, Sequence[Block]]] = [
        ("What was found" if so_far is None else "Not finished", first), *rest, *provisional,
        ("Before and after", [f"{LEFT[0].upper()}{LEFT[1:]}.", *_beyond(found), remainder_table(found),
                              *_pictures(found, folder)]),
        *observations,
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
        ("The recordings", recordings)]
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
    """Every state before and after, a bar of shares, and the section with the suspect places marked and the states that
    show them."""
    first, last = ((found.base, found.best) if found.established else (found.stated, found.base))
    labels = (("before: known numbers alone", "after: with what was found") if found.established
              else ("before: as stated", "after: known numbers fitted"))
    states = [StatePicture(_state_name(found, state), state.measured.frequency, state.measured.impedance,
                           before.impedance, after.impedance, state.noise)
              for state, before, after in zip(found.states, first, last, strict=True) if state.observation is None]
    pictures: list[Block] = [Picture(draw_states(states, folder / "states.png", before=labels[0], after=labels[1]),
                                     "Every state as recorded, before and after, and below the difference, "
                                     "|ln(Z_model / Z_measured)|")]
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
        shown = _shown_by(found)
        pictures.append(Picture(
            draw_marked(nodes, marked, folder / "where.png", title="\n".join(filter(None, ("Where it sits", shown)))),
            f"The section of the chip, with {' and '.join(marked)} marked"
            + (f"; {shown}, by the square of its change of ln Z in units of the noise" if shown else "")))
    elif found.where:
        pictures.append(f"It sits in the {' and the '.join(found.where)}, which the section of the chip does not show.")
    return pictures


def _shown_by(found: Diagnosis) -> str:
    """The states that show what is established, or the region that there is evidence for."""
    outside = None if found.established else next(
        (each for each in found.found.final if each.hypothesis.region == found.suspect_region), None)
    shares = states_that_show(found.model, found.conclusion.chosen.explanation, outside)
    shown = [f"{name} ({100.0 * share:.0f} %)" for name, share in shares.items() if share >= SHOWN]
    others = [name for name, share in shares.items() if share < SHOWN]
    return "" if not shown else f"shown by {', '.join(shown)}" + (f", not by {', '.join(others)}" if others else "")


def _beyond(found: Diagnosis) -> list[str]:
    """A sentence on known numbers that the fit of these alone moves beyond their uncertainties; none if there are none.
    """
    model, base, limit = found.model, found.found.base.explanation, found.criteria.at_odds
    moved = {p.name: abs(float(x) - p.start) / p.prior
             for p, x in zip(model.parameters[:model.known], base.x, strict=False) if p.prior}
    beyond = sorted((name for name, far in moved.items() if far > limit), key=lambda name: -moved[name])
    return [f"To come so far, known numbers leave what is stated of them, by more than {limit:g} of their standard "
            f"uncertainties: {', '.join(beyond)}."] if beyond else []


def _taken(campaign: Campaign) -> TextTable:
    return TextTable(("parameter", "standard uncertainty", "unit", "source"), tuple(
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
            f"{100.0 * e.rms:.2g}", "; ".join(f"{p.name} {p.in_words}" for p in found.estimates_of(refit)))))
    return TextTable(("hypothesis", "odds", "evidence", "of it by states held out", "left of Z (%)",
                      "parameters"), tuple(row for _, row in sorted(rows, key=lambda both: -both[0])))


def _power(log_odds: float) -> str:
    """Odds from their natural logarithm."""
    return f"{math.exp(log_odds):.3g}" if abs(log_odds) < 14.0 else f"10^{log_odds / math.log(10.0):.0f}"


def _given_up(found: Diagnosis) -> TextTable:
    refitted = {each.explanation.hypothesis.name for each in found.found.final}
    null = next((each.log_evidence for each in found.found.candidates
                  if each.hypothesis.name == found.found.base.explanation.hypothesis.name), 0.0)
    others = [each for each in found.found.candidates if each.hypothesis.name not in refitted]
    return TextTable(("hypothesis", "evidence there"), tuple(
        (each.hypothesis.name, f"{each.log_evidence - null:.1f}")
        for each in sorted(others, key=lambda each: -each.log_evidence)))


def _location(found: Diagnosis) -> TextTable:
    return TextTable(("region", "evidence added", "as sigmas", "modes"), tuple(
        (place.region, f"{place.evidence:.1f}", f"{place.sigmas:.1f}", "; ".join(place.modes))
        for place in found.location))


def _scores(found: Diagnosis) -> TextTable:
    return TextTable(("hypothesis", "region", "kind", "fall of chi-square", "evidence predicted"), tuple(
        (s.effect.name, s.effect.region, s.effect.kind, f"{s.gain:.1f}", f"{s.evidence:.1f}")
        for s in found.scores[:LISTED]))


def _known(known: Sequence[FoundNumber]) -> TextTable:
    return TextTable(("known parameter", "stated", "found", "unit", "moved by (sigmas)"), tuple(
        (each.name, number_text(each.shown[3], 5), number_text(each.shown[0], 5), shown_unit(each.unit),
         f"{each.sigmas or 0.0:+.2f}") for each in sorted(known, key=lambda each: -abs(each.sigmas or 0.0))))


def _known_physics(known: Sequence[Contribution]) -> TextTable:
    """Changes by every effect with known constants."""
    return TextTable(("effect", "state", "change of f0 (Hz)", "change of Q", "change of ln Z, rms (%)"), tuple(
        (row.effect, row.state, *("none" if value is None else f"{value:+.3g}"
                                  for value in (row.f0_change, row.q_change)),
         f"{100.0 * row.rms_log_change:.3g}") for row in known))


def _merit(found: Diagnosis) -> TextTable:
    rows = []
    for state, stated, base, best in zip(found.states, found.stated, found.base, found.best, strict=True):
        if state.observation is not None:
            continue
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
        "left": vars(found.remainder),
        "moved_parameters": [{"name": p.name, "from": p.stated, "to": p.value, "unit": p.unit, "sigmas": p.sigmas}
                             for p in found.known],
        "rivals": [{"effects": list(e.effects), "name": e.name,
                    "behind": decision.log_odds[decision.chosen.name] - decision.log_odds[e.name],
                    "parameters": {p.name: [p.value, p.low, p.high] for p in found.estimates_of(refit)}}
                   for e, refit in rivals],
        "location": [place._asdict() for place in found.location],
        # None where nothing more than noise is left.
        "unexplained": None if found.description is None else asdict(found.description),
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
                    "log_odds": decision.log_odds[e.hypothesis.name], "rms_log_residual": e.rms,
                    "reduced_chi_square": e.chi_square / e.local.residual.size}
                   for refit in found.found.final for e in [refit.explanation]],
        "taken": _taken_record(found.campaign), "undone": list(found.found.undone),
        "not_tried": [vars(each) for each in found.found.not_tried],
        # Of a search that was cut short: what explains best of what it looked at.
        "provisional": None if found.provisional is None else {"effects": _effects(found.provisional)},
        "findings": list(found.findings), "seconds": found.seconds,
        "reader_findings": {s.name: list(s.findings) for s in states if s.findings},
    }


def _state_record(fit: StateFit, state: DeviceState) -> dict[str, Any]:
    """A state as it was fitted, for a JSON file."""
    if state.observation is not None:
        return {"value": float(fit.impedance[0].real), "measured": state.observation.value,
                "unit": state.observation.unit, "log_residual": fit.rms, "reduced_chi_square": fit.reduced}
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
