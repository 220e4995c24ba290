"""``workbench diagnose``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geometry.mesh import user_cache
from workbench.commands.asked import asked_accuracy, output_folder, say_read_as
from workbench.commands.tables import known_physics_table, merit_cells, origin_table
from workbench.commands.terminal import print_line, print_table, progress_bars
from workbench.comparison import compare
from workbench.diagnosis.archive import Contribution
from workbench.diagnosis.campaign import read_campaign
from workbench.diagnosis.criteria import gain
from workbench.diagnosis.element_map import element_map, largest
from workbench.diagnosis.procedure import diagnose
from workbench.diagnosis.record import contributions, record
from workbench.diagnosis.state import spectrum_of
from workbench.diagnosis.verdict import Diagnosis
from workbench.fitting.parameter import shown_factor, shown_unit
from workbench.fitting.seen import log_ratio
from workbench.readers import READ_AS
from workbench.report.figures import measured_figures
from workbench.report.page import Block, Note, Picture, Table, number, write_json, write_report

if TYPE_CHECKING:
    from rich.console import Console

#: Rows of the table of scores.
LISTED = 12


def run(options: argparse.Namespace, console: Console) -> int:
    """``workbench diagnose``: what differs, where, which physics, how sure, what else it could be."""
    accuracy = asked_accuracy(options)
    campaign = read_campaign(options.campaign, materials=options.materials)
    folder = output_folder(options.output)
    for state in campaign.states:
        say_read_as(state.measured.origin.settings.get(READ_AS, ""), state.name, console)
    with progress_bars(console) as show:
        found = diagnose(campaign, accuracy=accuracy, cache=user_cache(),
                         progress=lambda text, share: show(campaign.name, text, share))
        show(campaign.name, "done", 1.0)
    known = contributions(found)
    write_json(folder / "diagnosis.json", {**record(found), "known_physics": [row._asdict() for row in known]})
    write_diagnosis_report(found, known, folder)
    print_line(f"{campaign.name}: {found.verdict.replace('_', ' ')}")
    for text in found.findings:
        print_line(text)
    if found.next_measurement:
        print_line(found.next_measurement)
    print_table("before and after", states_table(found))
    return 0


def states_table(found: Diagnosis) -> Table:
    """f0, Z_min, Q, MAPE, rms and reduced chi-square of every state: measured, stated, known parameters, effects."""
    rows = []
    stages = [("as stated", found.nominal, found.campaign.fitted), ("known parameters", found.base.states,
                                                                    found.campaign.fitted)]
    if found.effects:
        stages.append(("with " + found.best.name, found.best.states, found.campaign.fitted))
    stages.append(("known parameters, held out", found.held_before, found.campaign.held_out))
    if found.effects:
        stages.append(("with " + found.best.name + ", held out", found.held_after, found.campaign.held_out))
    for state in found.campaign.states:
        measured, _ = measured_figures(state.measured)
        rows.append((state.name, "measured", *merit_cells(measured), "", "", ""))
        for label, fits, states in stages:
            for fit, of in zip(fits, states, strict=True):
                if of is state:
                    spectrum = spectrum_of(fit, state)
                    merit, _ = measured_figures(spectrum)
                    rows.append((state.name, label, *merit_cells(merit),
                                 number(compare(state.measured, spectrum).mape_percent, 3), number(100 * fit.rms, 3),
                                 number(fit.reduced, 3)))
    return Table(("state", "", "f0 (kHz)", "Z_min (ohm)", "Q", "MAPE (%)", "rms (%)", "chi-square"), tuple(rows))


def write_diagnosis_report(found: Diagnosis, known: Sequence[Contribution], folder: Path) -> None:
    """``report.html``: one page with the verdict, then the evidence."""
    from workbench.render.plots import draw_residuals, draw_spectra
    from workbench.render.sections import draw_cells

    first: list[Block] = [Note(f"Verdict: {found.verdict.replace('_', ' ')}"), "\n".join(found.findings)]
    if found.next_measurement:
        first.append(f"Next measurement: {found.next_measurement}")
    first.append(states_table(found))
    scores = Table(("hypothesis", "where", "kind", "sigmas", "fall of chi-square", "evidence"), tuple(
        (s.effect.name, s.effect.region, s.effect.kind, f"{s.sigmas:.1f}", f"{s.gain:.1f}", f"{s.evidence:.1f}")
        for s in found.scores[:LISTED]))
    refits = Table(("hypothesis", "fall of chi-square", "evidence", "reduced chi-square", "parameters"), tuple(
        (f.name, f"{found.base.chi_square - f.chi_square:.1f}", f"{gain(found.base, f):.1f}",
         f"{f.reduced:.3f}", f.in_words())
        for f in (*found.singles, *found.pairs)))
    moved = Table(("known parameter", "stated", "fitted", "unit", "sigmas"), tuple(
        (p.name, *(number(value * shown_factor(p.unit), 5) for value in (p.start, found.best.x[i])),
         shown_unit(p.unit), f"{found.best.shifts.get(p.name, 0.0):+.2f}")
        for i, p in enumerate(found.model.parameters[:found.model.known])))
    pictures = []
    for fit, before, state in zip(found.best.states, found.nominal, found.campaign.fitted, strict=True):
        spectra = {"measured": state.measured, "as stated": spectrum_of(before, state),
                   "diagnosed": spectrum_of(fit, state)}
        pictures.append(Picture(draw_spectra(spectra, folder / f"state_{state.name}.png", measured=("measured",),
                                             title=state.name),
                                f"{state.name}: as recorded, as stated and as diagnosed"))
        ratio = log_ratio(fit.impedance, state.measured.impedance)
        pictures.append(Picture(draw_residuals(
            state.measured.frequency, {"magnitude": 100.0 * ratio.real, "phase": 100.0 * ratio.imag},
            folder / f"residual_{state.name}.png", label="ln(Z / Z measured), real and imaginary (%)", title=state.name,
            band=200.0 * float(np.median(state.noise))), f"{state.name}: what is left, and twice the noise"))
    where = element_map(found.model, found.base)
    maps = [Picture(draw_cells(where.mesh, values, folder / f"where_{kind}.png", label=f"a change of {kind} (sigmas)",
                               title=f"{', '.join(where.states)}: what a change of {kind} in one cell would explain"),
                    f"{kind}: largest in {region}, {sigmas:.1f} sigmas")
            for (kind, values), (_, region, sigmas) in zip(where.sigmas.items(), largest(where), strict=True)]
    sections: Sequence[tuple[str, Sequence[Block]]] = [
        ("What differs, and why", first),
        ("Where", ["What changes of any pattern within each region would explain, in standard deviations, and of which "
                   "kind most. Regions that come close cannot be told apart.", _location(found), *maps]),
        ("Hypotheses by the score test", [scores]), ("Hypotheses refitted", [refits]),
        ("Known parameters", [moved]),
        ("Effects with known constants", [
            "They are part of the model and never fitted; this is what each changes.",
            known_physics_table(known)]),
        ("Spectra", pictures),
        ("The recordings", [block for state in found.campaign.states
                            for block in (f"State {state.name}:", origin_table(state.measured.origin))])]
    write_report(folder / "report.html", f"Diagnosis: {found.campaign.name}", sections)


def _location(found: Diagnosis) -> Table:
    return Table(("region", "kind", "sigmas", "where"), tuple(
        (place.region, place.kind, f"{place.sigmas:.1f}", "; ".join(place.modes))
        for place in found.location[:LISTED] if np.isfinite(place.sigmas)))
