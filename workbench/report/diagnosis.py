"""A diagnosis: tables, record of ``diagnosis.json``, and page."""

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
from workbench.report.page import Block, Note, Picture, TextTable, Value, number_text, table, write_report
from workbench.report.record import record
from workbench.results.comparison import compare
from workbench.results.merit import measured_figures

#: Title of the table of residuals.
RESIDUAL = "residual of Z: rms of ln(Z_model / Z_measured), both parts together, in %"

#: Rows of a table of hypotheses.
LISTED = 12

#: Share of the change by an effect from which on a state shows it.
SHOWN = 0.01

#: Keys of a known parameter in ``diagnosis.json``: how exactly it is known, and the source.
_KNOWN = "name uncertainty=deviation unit source=origin"

#: A hypothesis is detected from this many standard deviations on.
DETECTED = 5.0

def established_table(found: Diagnosis) -> TextTable:
    """Effects with the share of each group, and parameters with intervals."""
    rows = []
    for group, share in found.shares:
        cell = f"{100.0 * share:.3g} %" + (", together" if len(group) > 1 else "")
        for each in group:
            name = plain_words(each.effect.name)
            for e in each.estimates:
                value, low, high, _ = e.shown
                rows.append((name, cell, e.name, value, f"{number_text(low)} to {number_text(high)}",
                             "of what is stated" if e.relative else shown_unit(e.unit)))
                name = cell = ""
    return table("effect | share of the residual as stated | parameter | value | 95 % interval | unit", rows)


def remainder_table(found: Diagnosis) -> TextTable:
    """Rms of ln(Z / Z_measured) of every state, those held out last.

    Its columns are the noise alone, the model as stated, with fitted known parameters, and with the effects.
    """
    rows = []
    for state, *fits in zip(found.states, *_stages(found).values(), strict=True):
        noise = math.sqrt(state.data * float((state.noise**2).mean()))
        rows.append((_state_name(found, state), noise, *(fit.rms for fit in fits)))
    beyond = beyond_priors(found.model, found.found.base.explanation, found.criteria)
    effects = " | with the effects (%):.3g" if found.established else ""
    return table("state | noise floor (%):.3g | as stated (%):.3g | known parameters"
                 f"{', some beyond' if beyond else ' within'} {found.criteria.at_odds:g} sigma (%):.3g{effects}", rows)


def _stages(found: Diagnosis) -> dict[str, tuple[StateFit, ...]]:
    """All states as stated, with fitted known parameters, and with any effects."""
    effects = {"with the effects": found.best} if found.established else {}
    return {"as stated": found.stated, "known parameters": found.base, **effects}


def observations_table(found: Diagnosis) -> TextTable:
    """Observations beside the impedance: as measured, and as predicted before and after."""
    stages = _stages(found)
    return table(f"observation | measured | uncertainty (%):.3g | {' | '.join(stages)} | unit", (
        (_state_name(found, state), own.value, own.uncertainty, *(float(fit.impedance[0].real) for fit in fits),
         own.unit) for state, *fits in zip(found.states, *stages.values(), strict=True)
        if (own := state.observation) is not None))


def unexplained_tables(found: Description) -> list[Block]:
    """An unexplained residual: its states, its bands, and the nearest hypotheses."""
    states = table("state | residual of Z (%):.3g | times the noise:.3g | share of the residual (%):.0f", (
        (each.name, each.rms, each.times, "held out" if each.share is None else each.share) for each in found.states))
    bands = table(
        "state | from (MHz):.4f | to (MHz):.4f | largest at (MHz):.4f | residual of Z (%):.3g | "
        "share of the residual (%):.0f | nearest mode of the model | its energy in",
        ((each.state, each.low, each.high, each.peak, each.rms, each.share,
          "none in the recording" if each.mode is None else f"{each.mode.kind} {each.mode.frequency / 1e6:.4f} MHz",
          regions_in_words(each.regions)) for each in found.bands))
    hypotheses = table("hypothesis | share of the residual (%):.3g | odds against nothing further | found by", (
        (plain_words(each.name), each.share, *(
            ("not fitted", "its score") if each.log_odds is None else (odds_text(each.log_odds), "a fit")))
        for each in found.takers))
    return [f"The residual is {100.0 * found.rms:.3g} % of Z, {found.times:.3g} times the stated noise. By state:",
            states, "The bands of the largest residual, with the energy by region of the nearest mode:", bands,
            *(["The hypotheses of the catalogue that would explain most of it:", hypotheses] if found.takers else
              ["No hypothesis of the catalogue would explain any of it."])]


def _state_name(found: Diagnosis, state: DeviceState) -> str:
    """The name of a state, marked if it is held out."""
    held = {each.name for each in found.campaign.held_out}
    return state.name + (", held out" if state.name in held else "")


def write_diagnosis_report(found: Diagnosis, known: Sequence[Contribution], folder: Path) -> Path:
    """Write ``report.html``: answer, unexplained residual, fits, then evidence."""
    title = "Diagnosis" if found.provisional is None else "Diagnosis, not finished"
    return write_report(folder / "report.html", f"{title}: {found.campaign.name}", module=__name__, values={
        "found": found, "known": known, "pictures": _pictures(found, folder), "origin_table": origin_table})


def write_stopped(campaign: Campaign, folder: Path, seconds: float) -> None:
    """Write record and page of a diagnosis without a result: its input."""
    content = stopped_record(campaign, seconds)
    write_json(folder / "diagnosis.json", content)
    states = table("state | points | from (MHz) | to (MHz) | held out", (
        (state.name, state.measured.frequency.size, *state.measured.frequency[[0, -1]],
         "yes" if state.held_out else "no") for state in campaign.states))
    write_report(folder / "report.html", f"Diagnosis, not finished: {campaign.name}", [
        ("Not finished", [Note(content["headline"]), "Verdict: not finished."]),
        ("The recordings that were read", [states]),
        ("Stated uncertainties", ["Standard uncertainties and their sources; all that is not listed is exact.",
                                  stated_table(campaign)])])


def _pictures(found: Diagnosis, folder: Path) -> list[Block]:
    """Draw states before and after, shares, and the section with suspect places."""
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
        pictures.append(Picture(draw_shares(shares, folder / "shares.png", title="Explained shares of the residual"),
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
    """The states that show the established effects, or the suspect region."""
    outside = None if found.established else next(
        (each for each in found.found.final if each.hypothesis.region == found.suspect_region), None)
    shares = states_that_show(found.model, found.chosen.explanation, outside)
    shown = [f"{name} ({100.0 * share:.0f} %)" for name, share in shares.items() if share >= SHOWN]
    others = [name for name, share in shares.items() if share < SHOWN]
    return "" if not shown else f"shown by {', '.join(shown)}" + (f", not by {', '.join(others)}" if others else "")


def stated_table(campaign: Campaign) -> TextTable:
    return table("parameter | standard uncertainty:.3g | unit | source", (
        (e.name, e.deviation * shown_factor(e.unit), shown_unit(e.unit), e.origin) for e in campaign.uncertain))


def odds_table(found: Diagnosis) -> TextTable:
    odds, base = found.decision.log_odds, found.found.base
    refits = sorted(found.found.final, key=lambda each: -odds[each.hypothesis.name])
    return table(
        "hypothesis | odds | evidence:.1f | of it by states held out:.1f | residual of Z (%):.2g | parameters",
        ((refit.hypothesis.name, odds_text(odds[refit.hypothesis.name]),
          refit.explanation.log_evidence - base.explanation.log_evidence, refit.held_out - base.held_out,
          refit.explanation.rms, "; ".join(f"{p.name} {p.in_words}" for p in found.estimates_of(refit)))
         for refit in refits))


def not_refitted_table(found: Diagnosis) -> TextTable:
    refitted = {each.hypothesis.name for each in found.found.final}
    evidences = sorted(((each.log_evidence, each.hypothesis.name) for each in found.found.candidates), reverse=True)
    null = next((evidence for evidence, name in evidences if name == found.found.base.hypothesis.name), 0.0)
    return table("hypothesis | evidence there:.1f", (
        (name, evidence - null) for evidence, name in evidences if name not in refitted))


def known_table(found: Diagnosis) -> TextTable:
    """The known parameters with their pulls, the largest first."""
    alone = pulls(found.model, found.found.base.explanation) if found.established else {}
    rows = [(each.name, each.shown[3], each.shown[0], shown_unit(each.unit), each.sigmas or 0.0,
             *([alone.get(each.name, 0.0)] if alone else []))
            for each in sorted(found.known, key=lambda each: -abs(each.sigmas or 0.0))]
    return table("known parameter | stated:.5g | found:.5g | unit | moved by (sigmas):+.2f"
                 + (" | without the effects (sigmas):+.2f" if alone else ""), rows)


def merit_table(found: Diagnosis) -> TextTable:
    rows, stages = list[tuple[Value, ...]](), _stages(found)
    for state, *fits in zip(found.states, *stages.values(), strict=True):
        if state.observation is not None:
            continue
        spectra = {"measured": (state.measured, None), **{
            label: (fitted_spectrum(fit, state), fit.reduced) for label, fit in zip(stages, fits, strict=True)}}
        for label, (spectrum, chi_square) in spectra.items():
            merit, _ = measured_figures(spectrum)
            rows.append((state.name, label, *(("none",) * 3 if merit is None else (merit.f0, merit.z_min, merit.q)),
                         chi_square))
    return table("state | spectrum | f0 (kHz):.3f | Z_min (ohm) | Q | chi-square:.3g", rows)


def detection_limits(found: Diagnosis) -> dict[str, float]:
    """The smallest detectable value (SI) of the first parameter of each hypothesis."""
    return {s.effect.name: float(DETECTED * s.error[0]) for s in found.found.base.scores
            if s.error.size and np.isfinite(s.error[0])}


def diagnosis_record(found: Diagnosis) -> dict[str, Any]:
    """The content of ``diagnosis.json`` without effects of known constants."""
    decision, base, states = found.decision, found.found.base, found.states
    odds, count = decision.log_odds, len(found.campaign.fitted)
    before, alone, after = ({fit.name: _state_record(fit, state) for fit, state in zip(fits, states, strict=True)}
                            for fits in (found.stated, found.base, found.best))
    predicted = {each.state.name: each.reduced for each in found.chosen.predicted}
    return {
        **record(found, "campaign=campaign.name verdict headline explained=decision.is_explained next_measurement "
                        "findings seconds undone=found.undone "
                        "moved_parameters=known { name from=stated to=value unit sigmas } "
                        f"taken=campaign.uncertain {{ {_KNOWN} }}"),
        "effects": _effects(found), "alike": [list(e.effects) for e in decision.alike],
        "left": asdict(found.remainder),
        "rivals": [record(e, "effects name") | {
            "behind": odds[decision.chosen.name] - odds[e.name], "parameters": {
                p.name: [p.value, p.low, p.high] for p in found.estimates_of(found.found.refit(e.name))}}
            for e in decision.rivals],
        "location": [each.record for each in found.location],
        # None if every state is explained.
        "unexplained": None if found.description is None else asdict(found.description),
        # Empty if they were not searched for.
        "not_round": [{"cause": each.cause, **asdict(each), "share": each.share} for each in found.not_round],
        **{key: {state.name: of[state.name] for state in states[:count]}
           for key, of in (("before", before), ("known_parameters_only", alone), ("after", after))},
        "held_out": {state.name: {"before": alone[state.name], "after": after[state.name],
                                  "predicted_reduced_chi_square": predicted[state.name]} for state in states[count:]},
        "next_options": [asdict(option) for option in found.next_options],
        "detection_limits": detection_limits(found),
        "scores": [record(s, "effect=effect.name region=effect.region gain evidence") | {
            "sigmas": math.sqrt(max(s.gain, 0.0))} for s in found.found.base.scores],
        "refits": [record(e, "name=hypothesis.name rms_log_residual=rms noise_scales=local.noise reduced_chi_squares "
                              "inhomogeneity=scales.inhomogeneity unconverged") | {
            "effects": [effect.name for effect in e.hypothesis.effects],
            "evidence": e.log_evidence - base.explanation.log_evidence, "held_out": refit.held_out - base.held_out,
            "log_odds": odds[e.hypothesis.name], "reduced_chi_square": e.chi_square / e.local.residual.size}
            for refit in found.found.final for e in [refit.explanation]],
        "not_tried": [asdict(each) for each in found.found.not_tried],
        # Of a search that was cut short: its best explanation so far.
        "provisional": found.provisional and {"effects": _effects(found.provisional)},
        "reader_findings": {s.name: list(s.findings) for s in states if s.findings}}


def _state_record(fit: StateFit, state: DeviceState) -> dict[str, Any]:
    """A state as it was fitted, for a JSON file."""
    quality = record(fit, "reduced_chi_square=reduced")
    if state.observation is not None:
        return quality | {"value": float(fit.impedance[0].real), "measured": state.observation.value,
                          "unit": state.observation.unit, "log_residual": fit.rms}
    spectrum = fitted_spectrum(fit, state)
    figures, _ = measured_figures(spectrum)
    return quality | record(fit, "rms_log_residual=rms correlation") | {
        **{key: figures and getattr(figures, key) for key in ("f0", "z_min", "q")},
        "mape_percent": compare(state.measured, spectrum).mape_percent}


def stopped_record(campaign: Campaign, seconds: float) -> dict[str, Any]:
    """The content of ``diagnosis.json`` without a result, after so many `seconds`."""
    return {
        "campaign": campaign.name, "verdict": NOT_FINISHED,
        "headline": "Not finished: it was stopped before its first result, and nothing can be said of any hypothesis.",
        "effects": [], "rivals": [], "provisional": None, "undone": ["everything"], "not_tried": [], "findings": [],
        "read": {state.name: record(state, "recording=measured.origin.source points=measured.frequency.size held_out")
                 for state in campaign.states},
        "taken": record(campaign.uncertain, _KNOWN), "seconds": seconds}


def _effects(found: Diagnosis) -> list[dict[str, Any]]:
    return [record(e, "name=effect.name region=effect.region kind=effect.kind admissible share") | {
        "parameters": {p.name: record(p, "value low high unit") for p in e.estimates}} for e in found.established]
