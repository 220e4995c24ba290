"""A diagnosis as tables, as the record of ``diagnosis.json``, and as a page."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
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
from workbench.diagnosis.estimates import beyond_priors, pulls
from workbench.diagnosis.known_physics import Contribution
from workbench.diagnosis.odds import odds_text
from workbench.diagnosis.outcome import Diagnosis
from workbench.files.quantities import shown_factor, shown_unit
from workbench.files.writing import write_json
from workbench.model.numbers import plain_words, word_list
from workbench.render.diagnoses import StatePicture, draw_shares, draw_states
from workbench.render.sections import draw_marked
from workbench.report.figures import origin_table
from workbench.report.page import Block, Note, Picture, TextTable, number_text, write_report
from workbench.results.comparison import compare
from workbench.results.merit import measured_figures

#: Title of the table of residuals.
RESIDUAL = "residual of Z: rms of ln(Z_model / Z_measured), both parts together, in %"

#: Rows of a table of hypotheses.
LISTED = 12

#: Share of the change by an effect from which on a state shows it.
SHOWN = 0.01

#: A hypothesis is detected from this many standard deviations on.
DETECTED = 5.0

#: The heading and the blocks of a section.
Section = tuple[str, Sequence[Block]]


def _table(columns: str, rows: Iterable[Sequence[str]]) -> TextTable:
    """A table whose columns are separated by bars."""
    return TextTable(tuple(columns.split(" | ")), tuple(map(tuple, rows)))


def established_table(found: Diagnosis) -> TextTable:
    """Effects with the share of each group that belongs together, and their parameters with intervals."""
    rows = []
    for group, share in found.shares:
        cell = f"{100.0 * share:.3g} %" + (", together" if len(group) > 1 else "")
        for each in group:
            name = plain_words(each.effect.name)
            for e in each.estimates:
                rows.append((name, cell, e.name, number_text(e.shown[0]),
                             f"{number_text(e.shown[1])} to {number_text(e.shown[2])}",
                             "of what is stated" if e.relative else shown_unit(e.unit)))
                name = cell = ""
    return _table("effect | share of the residual as stated | parameter | value | 95 % interval | unit", rows)


def remainder_table(found: Diagnosis) -> TextTable:
    """Rms of ln(Z / Z_measured) of every state (%): of noise alone, as stated, with the known parameters fitted, and
    with the effects; those held out last."""
    rows = []
    for state, *fits in zip(found.states, *_stages(found).values(), strict=True):
        noise = 100.0 * math.sqrt(state.data * float((state.noise**2).mean()))
        rows.append((_state_name(found, state), *(number_text(each, 3) for each in (
            noise, *(100.0 * fit.rms for fit in fits)))))
    beyond = beyond_priors(found.model, found.found.base.explanation, found.criteria)
    known = f"known parameters{', some beyond' if beyond else ' within'} {found.criteria.at_odds:g} sigma (%)"
    effects = ("with the effects (%)",) if found.established else ()
    return TextTable(("state", "noise floor (%)", "as stated (%)", known, *effects), tuple(rows))


def _stages(found: Diagnosis) -> dict[str, tuple[StateFit, ...]]:
    """All states as stated, with the known parameters fitted, and with the effects if any are established."""
    effects = {"with the effects": found.best} if found.established else {}
    return {"as stated": found.stated, "known parameters": found.base, **effects}


def observations_table(found: Diagnosis) -> TextTable:
    """Observations beside the impedance: as measured, and as predicted before and after."""
    stages = _stages(found)
    rows = [(_state_name(found, state), number_text(own.value, 4), number_text(100.0 * own.uncertainty, 3),
             *(number_text(float(fit.impedance[0].real), 4) for fit in fits), own.unit)
            for state, *fits in zip(found.states, *stages.values(), strict=True)
            if (own := state.observation) is not None]
    return TextTable(("observation", "measured", "uncertainty (%)", *stages, "unit"), tuple(rows))


def unexplained_tables(found: Description) -> list[Block]:
    """A residual that nothing explains: its states, its bands, and the hypotheses that would explain most of it."""
    states = _table("state | residual of Z (%) | times the noise | share of the residual (%)", (
        (each.name, number_text(100.0 * each.rms, 3), number_text(each.times, 3),
         "held out" if each.share is None else f"{100.0 * each.share:.0f}") for each in found.states))
    bands = _table("state | from (MHz) | to (MHz) | largest at (MHz) | residual of Z (%) | share of the residual (%) | "
                   "nearest mode of the model | its energy in", (
        (each.state, *(f"{number / 1e6:.4f}" for number in (each.low, each.high, each.peak)),
         number_text(100.0 * each.rms, 3), f"{100.0 * each.share:.0f}",
         "none in the recording" if each.mode is None else f"{each.mode.kind} {each.mode.frequency / 1e6:.4f} MHz",
         regions_in_words(each.regions)) for each in found.bands))
    takers = _table("hypothesis | share of the residual (%) | odds against nothing further | found by", (
        (plain_words(each.name), f"{100.0 * each.share:.3g}", *(
            ("not fitted", "its score") if each.log_odds is None else (odds_text(each.log_odds), "a fit")))
        for each in found.takers))
    return [f"The residual is {100.0 * found.rms:.3g} % of Z, {found.times:.3g} times the stated noise. By state:",
            states, "The bands of the largest residual, with the energy by region of the nearest mode:", bands,
            *(["The hypotheses of the catalogue that would explain most of it:", takers] if found.takers else
              ["No hypothesis of the catalogue would explain any of it."])]


def _state_name(found: Diagnosis, state: DeviceState) -> str:
    """The name of a state, marked if it is held out."""
    held = {each.name for each in found.campaign.held_out}
    return state.name + (", held out" if state.name in held else "")


def write_diagnosis_report(found: Diagnosis, known: Sequence[Contribution], folder: Path) -> Path:
    """``report.html``: the answer first, a residual that nothing explains, the fit before and after, then evidence."""
    first: list[Block] = [Note(found.headline), f"Verdict: {found.verdict.replace('_', ' ')}.",
                           "\n\n".join(found.findings)]
    first += [established_table(found)] if found.established else []
    first += [Note(f"Next measurement. {found.next_measurement}")] if found.next_measurement else []
    so_far, optional = found.provisional, list[Section]()
    if found.description is not None:
        optional.append(("What nothing explains", unexplained_tables(found.description)))
    if so_far is not None and so_far.established:
        optional.append(("Provisional", ["The best explanation so far. A hypothesis that was not tried may explain as "
                                         "much, or more.", established_table(so_far)]))
    observations: list[Section] = [("Observed beside the impedance", [
        "Each is one datum with its stated uncertainty, weighed like a recording.", observations_table(found)])]
    recordings: list[Block] = []
    for state in (state for state in found.states if state.observation is None):
        recordings += [f"State {state.name}:", *map(Note, state.findings), origin_table(state.measured.origin)]
    cut = "" if so_far is None else ", as far as it went"
    sections: list[Section] = [
        ("What was found" if so_far is None else "Not finished", first), *optional,
        ("Before and after", [f"{RESIDUAL[0].upper()}{RESIDUAL[1:]}.", remainder_table(found),
                              *_pictures(found, folder)]),
        *(observations if any(state.observation for state in found.states) else []),
        ("What was taken as known", _taken(found.campaign)),
        (f"Odds of the hypotheses{cut}", [
            "Posterior odds against the null hypothesis. Evidences are natural logarithms relative to it.",
            _odds(found), "Hypotheses that were not refitted, with their evidence so far:", _given_up(found)]),
        (f"Where{cut}", ["The evidence that a change within one region, or modes that the model does not have, would "
                         "add to the best explanation.", _location(found)]),
        ("Score test", ["The gain that each hypothesis promises beside the known parameters; it decides nothing.",
                        _scores(found)]),
        ("Known parameters", [_known(found)]),
        ("Figures of merit", [_merit(found)]),
        ("Effects with known constants", [
            "They are part of the model and never fitted; this is the change by each.", _known_physics(known)]),
        ("The recordings", recordings)]
    title = "Diagnosis" if so_far is None else "Diagnosis, not finished"
    return write_report(folder / "report.html", f"{title}: {found.campaign.name}", sections)


def write_stopped(campaign: Campaign, folder: Path, seconds: float) -> None:
    """``diagnosis.json`` and ``report.html`` of a diagnosis that was stopped before its first result: its input."""
    record = stopped_record(campaign, seconds)
    write_json(folder / "diagnosis.json", record)
    states = _table("state | points | from (MHz) | to (MHz) | held out", (
        (state.name, str(state.measured.frequency.size), number_text(state.measured.frequency[0] / 1e6),
         number_text(state.measured.frequency[-1] / 1e6),
         "yes" if state.held_out else "no") for state in campaign.states))
    write_report(folder / "report.html", f"Diagnosis, not finished: {campaign.name}", [
        ("Not finished", [Note(record["headline"]), "Verdict: not finished."]),
        ("The recordings that were read", [states]), ("What was taken as known", _taken(campaign))])


def _pictures(found: Diagnosis, folder: Path) -> list[Block]:
    """Every state before and after, a bar of shares, and the section with the suspect places marked and the states that
    show them."""
    first, last = list(_stages(found).items())[-2:]
    states = [StatePicture(_state_name(found, state), state.measured.frequency, state.measured.impedance,
                           before.impedance, after.impedance, state.noise)
              for state, before, after in zip(found.states, first[1], last[1], strict=True)
              if state.observation is None]
    pictures: list[Block] = [Picture(
        draw_states(states, folder / "states.png", before=f"before: {first[0]}", after=f"after: {last[0]}"),
        "Every state as recorded, before and after, and below the residual, |ln(Z_model / Z_measured)|")]
    if found.established:
        shares = {word_list([plain_words(each.effect.name) for each in group]): share for group, share in found.shares}
        pictures.append(Picture(draw_shares(shares, folder / "shares.png", title="What explains the residual"),
                                "Of the residual as stated, beyond noise"))
    mesh = max((recording.problem.mesh for recording in found.model.fitted.recordings),
               key=lambda each: each.mesh.t.shape[1])
    nodes, _ = section_nodes(mesh)
    marked = [name for name in dict.fromkeys(map(parent_place, found.where)) if name in nodes.regions]
    if marked:
        shown = _shown_by(found)
        pictures.append(Picture(
            draw_marked(nodes, marked, folder / "where.png", title="\n".join(filter(None, ("Where it sits", shown)))),
            f"The section of the chip, with {word_list(marked)} marked"
            + (f"; {shown}, by the square of its change of ln Z in units of the noise" if shown else "")))
    elif found.where:
        pictures.append(f"It sits in the {' and the '.join(found.where)}, which the section of the chip does not show.")
    return pictures


def _shown_by(found: Diagnosis) -> str:
    """The states that show what is established, or the region that there is evidence for."""
    outside = None if found.established else next(
        (each for each in found.found.final if each.hypothesis.region == found.suspect_region), None)
    shares = states_that_show(found.model, found.chosen.explanation, outside)
    shown = [f"{name} ({100.0 * share:.0f} %)" for name, share in shares.items() if share >= SHOWN]
    others = [name for name, share in shares.items() if share < SHOWN]
    return "" if not shown else f"shown by {', '.join(shown)}" + (f", not by {', '.join(others)}" if others else "")


def _taken(campaign: Campaign) -> list[Block]:
    return ["Standard uncertainties and their sources; all that is not listed is exact.",
            _table("parameter | standard uncertainty | unit | source", (
                (e.name, number_text(e.deviation * shown_factor(e.unit), 3), shown_unit(e.unit), e.origin)
                for e in campaign.uncertain))]


def _odds(found: Diagnosis) -> TextTable:
    odds, base = found.decision.log_odds, found.found.base
    refits = sorted(found.found.final, key=lambda each: -odds[each.hypothesis.name])
    return _table("hypothesis | odds | evidence | of it by states held out | residual of Z (%) | parameters", (
        (refit.hypothesis.name, odds_text(odds[refit.hypothesis.name]),
         f"{refit.explanation.log_evidence - base.explanation.log_evidence:.1f}",
         f"{refit.held_out - base.held_out:.1f}", f"{100.0 * refit.explanation.rms:.2g}",
         "; ".join(f"{p.name} {p.in_words}" for p in found.estimates_of(refit))) for refit in refits))


def _given_up(found: Diagnosis) -> TextTable:
    refitted = {each.hypothesis.name for each in found.found.final}
    evidences = sorted(((each.log_evidence, each.hypothesis.name) for each in found.found.candidates), reverse=True)
    null = next((evidence for evidence, name in evidences if name == found.found.base.hypothesis.name), 0.0)
    return _table("hypothesis | evidence there", (
        (name, f"{evidence - null:.1f}") for evidence, name in evidences if name not in refitted))


def _location(found: Diagnosis) -> TextTable:
    return _table("region | evidence added | as sigmas | modes", (
        (place["region"], f"{place['evidence']:.1f}", f"{place['sigmas']:.1f}", "; ".join(place["modes"]))
        for place in (each.record for each in found.location)))


def _scores(found: Diagnosis) -> TextTable:
    return _table("hypothesis | region | kind | fall of chi-square | evidence predicted", (
        (s.effect.name, s.effect.region, s.effect.kind, f"{s.gain:.1f}", f"{s.evidence:.1f}")
        for s in found.found.base.scores[:LISTED]))


def _known(found: Diagnosis) -> TextTable:
    """The known parameters with their pulls, with the established effects and without, largest first."""
    alone = pulls(found.model, found.found.base.explanation) if found.established else {}
    rows = [(each.name, number_text(each.shown[3], 5), number_text(each.shown[0], 5), shown_unit(each.unit),
             f"{each.sigmas or 0.0:+.2f}", *([f"{alone.get(each.name, 0.0):+.2f}"] if alone else []))
            for each in sorted(found.known, key=lambda each: -abs(each.sigmas or 0.0))]
    return _table("known parameter | stated | found | unit | moved by (sigmas)"
                  + (" | without the effects (sigmas)" if alone else ""), rows)


def _known_physics(known: Sequence[Contribution]) -> TextTable:
    """Changes by every effect with known constants."""
    return _table("effect | state | change of f0 (Hz) | change of Q | change of ln Z, rms (%)", (
        (row.effect, row.state, *("none" if value is None else f"{value:+.3g}"
                                  for value in (row.f0_change, row.q_change)),
         f"{100.0 * row.rms_log_change:.3g}") for row in known))


def _merit(found: Diagnosis) -> TextTable:
    rows, stages = [], _stages(found)
    for state, *fits in zip(found.states, *stages.values(), strict=True):
        if state.observation is not None:
            continue
        spectra = {"measured": (state.measured, ""), **{
            label: (fitted_spectrum(fit, state), number_text(fit.reduced, 3))
            for label, fit in zip(stages, fits, strict=True)}}
        for label, (spectrum, chi_square) in spectra.items():
            merit, _ = measured_figures(spectrum)
            cells = ("none",) * 3 if merit is None else (
                f"{merit.f0 / 1e3:.3f}", number_text(merit.z_min), number_text(merit.q))
            rows.append((state.name, label, *cells, chi_square))
    return _table("state | spectrum | f0 (kHz) | Z_min (ohm) | Q | chi-square", rows)


# --------------------------------------------------------------------------------------------------------------------
# diagnosis.json. Numbers are in SI; evidences and odds are natural logarithms.


def detection_limits(found: Diagnosis) -> dict[str, float]:
    """The smallest value (SI, from its start) of every hypothesis' first parameter that this campaign would detect."""
    return {s.effect.name: float(DETECTED * s.error[0]) for s in found.found.base.scores
            if s.error.size and np.isfinite(s.error[0])}


def diagnosis_record(found: Diagnosis) -> dict[str, Any]:
    """The content of ``diagnosis.json``, but for what effects with known constants contribute."""
    decision, base, states = found.decision, found.found.base, found.states
    odds, count = decision.log_odds, len(found.campaign.fitted)
    before, alone, after = ({fit.name: _state_record(fit, state) for fit, state in zip(fits, states, strict=True)}
                            for fits in (found.stated, found.base, found.best))
    fitted = [state.name for state in states[:count]]
    predicted = {each.state.name: each.reduced for each in found.chosen.predicted}
    return {
        "campaign": found.campaign.name, "verdict": found.verdict, "headline": found.headline,
        "explained": decision.is_explained, "effects": _effects(found),
        "alike": [list(e.effects) for e in decision.alike],
        "left": asdict(found.remainder),
        "moved_parameters": [{"name": p.name, "from": p.stated, "to": p.value, "unit": p.unit, "sigmas": p.sigmas}
                             for p in found.known],
        "rivals": [{"effects": list(e.effects), "name": e.name, "behind": odds[decision.chosen.name] - odds[e.name],
                    "parameters": {p.name: [p.value, p.low, p.high]
                                   for p in found.estimates_of(found.found.refit(e.name))}} for e in decision.rivals],
        "location": [each.record for each in found.location],
        # None if every state is explained.
        "unexplained": None if found.description is None else asdict(found.description),
        **{key: {name: of[name] for name in fitted}
           for key, of in (("before", before), ("known_parameters_only", alone), ("after", after))},
        "held_out": {state.name: {"before": alone[state.name], "after": after[state.name],
                                  "predicted_reduced_chi_square": predicted[state.name]} for state in states[count:]},
        "next_measurement": found.next_measurement, "next_options": [asdict(option) for option in found.next_options],
        "detection_limits": detection_limits(found),
        "scores": [{"effect": s.effect.name, "region": s.effect.region, "gain": s.gain,
                    "sigmas": math.sqrt(max(s.gain, 0.0)), "evidence": s.evidence} for s in found.found.base.scores],
        "refits": [{"name": e.hypothesis.name, "effects": [effect.name for effect in e.hypothesis.effects],
                    "evidence": e.log_evidence - base.explanation.log_evidence,
                    "held_out": refit.held_out - base.held_out, "log_odds": odds[e.hypothesis.name],
                    "rms_log_residual": e.rms, "reduced_chi_square": e.chi_square / e.local.residual.size,
                    "noise_scales": e.local.noise.tolist(), "unconverged": list(e.unconverged)}
                   for refit in found.found.final for e in [refit.explanation]],
        "taken": _taken_record(found.campaign), "undone": list(found.found.undone),
        "not_tried": [asdict(each) for each in found.found.not_tried],
        # Of a search that was cut short: its best explanation so far.
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
    return {**{key: None if figures is None else getattr(figures, key) for key in ("f0", "z_min", "q")},
            "mape_percent": compare(state.measured, spectrum).mape_percent,
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
             "share": e.share, "parameters": {p.name: {key: getattr(p, key) for key in ("value", "low", "high", "unit")}
                                              for p in e.estimates}} for e in found.established]


def _taken_record(campaign: Campaign) -> list[dict[str, object]]:
    """The known parameters: how exactly they are known, and the source."""
    return [{"name": each.name, "uncertainty": each.deviation, "unit": each.unit, "source": each.origin}
            for each in campaign.uncertain]
