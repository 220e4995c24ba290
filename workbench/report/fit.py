"""A fit as tables, as pictures, as a page and as the record of ``fit.json``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from workbench.files.quantities import finite, shown_factor, shown_unit
from workbench.fitting.gel import PUBLISHED, GelCase
from workbench.fitting.joint import FitResult, Match
from workbench.fitting.prepare import Prepared
from workbench.fitting.record import (
    Source,
    derived_quantities,
    name_in_fit,
    reference_frequency,
    refusals,
    rms_log_residual,
    software,
)
from workbench.fitting.uncertainty import CONFIDENCE, DEVIATIONS, ParameterEstimate
from workbench.render.fits import Interval, draw_correlation, draw_fit, draw_gel_study, draw_intervals
from workbench.report.figures import figures_record, origin_table
from workbench.report.page import Block, Note, Picture, TextTable, number_text, write_report
from workbench.results.merit import measured_figures


def number_in_unit(value: float, unit: str, *, digits: int = 5) -> str:
    """A number in the unit it is shown in, without the unit; nothing for NaN."""
    return number_text(value * shown_factor(unit), digits) if np.isfinite(value) else ""


def shown_estimate(value: float, low: float, high: float, unit: str) -> tuple[str, str]:
    """An estimate and its interval, without the unit, with digits enough to show two of the interval's width."""
    if not np.isfinite(low):
        return number_in_unit(value, unit), ""
    digits = 5
    if high > low:
        digits = max(digits, math.ceil(math.log10(max(abs(value), abs(low), abs(high)) / (high - low))) + 2)
    shown, *ends = (number_in_unit(number, unit, digits=digits) for number in (value, low, high))
    return shown, " to ".join(ends)


def short_name(estimate: ParameterEstimate, prepared: Prepared) -> str:
    """The name of a parameter: without the freed material's, with the recording if it is its own."""
    p = estimate.parameter
    text = p.parsed.within(prepared.material.name)
    return f"{text} ({', '.join(p.recordings)})" if p.recordings else text


def parameter_table(result: FitResult, prepared: Prepared) -> TextTable:
    """Every fitted parameter, as in Table 3 of Acevedo-Espinosa et al. (RP-UEIS), with intervals."""
    rows = []
    for e in result.estimates:
        p = e.parameter
        difference = f"{100.0 * (e.value / p.start - 1.0):+.2f}" if p.start else ""
        held = e.at_bound.removesuffix(f" of {prepared.material.name}")
        remarks = [f"held by {held}" if held else "",
                   "of all points together" if p.nuisance else "" if e.determined else "not determined",
                   "by profile" if e.method == "profile" else ""]
        spread = "" if p.prior is None else number_in_unit(p.prior, p.unit, digits=2)
        prior = f"± {spread}{' (assumed)' if p.assumed else ''}" if spread else ""
        part = number_in_unit(DEVIATIONS * e.held, p.unit, digits=2) if e.held > 0.0 else ""
        rows.append((short_name(e, prepared), number_in_unit(p.start, p.unit),
                     *shown_estimate(e.value, e.low, e.high, p.unit), f"± {part}" if part else "", shown_unit(p.unit),
                     difference, prior, "; ".join(filter(None, remarks))))
    return TextTable(("parameter", "start", "fitted", "95 % interval", OF_HELD, "unit", "change (%)", "known before",
                      "remark"), tuple(rows))


#: Heading of the part of an interval that comes of the numbers that a fit holds.
OF_HELD = "of which held constants"


def for_terminal(table: TextTable) -> TextTable:
    """The table of parameters for a terminal of 80 columns: without what was known before, the change in per cent, and
    the part of the held constants if there is none."""
    left_out = {"known before", "change (%)"}
    where = table.columns.index(OF_HELD)
    if not any(row[where] for row in table.rows):
        left_out.add(OF_HELD)
    kept = [i for i, head in enumerate(table.columns) if head not in left_out]
    heads, *rows = (tuple(row[i] for i in kept) for row in (table.columns, *table.rows))
    return TextTable(heads, tuple(rows))


def held_table(result: FitResult) -> TextTable | None:
    """The numbers that the fit held although they are uncertain; None if there are none."""
    if not result.held:
        return None
    errors = {e.parameter.name: e for e in result.estimates}
    rows = []
    for h in result.held:
        p, moved = h.parameter, errors[h.moved]
        spread = number_in_unit(p.scale, p.unit, digits=2)
        rows.append((name_in_fit(p, result), number_in_unit(p.value, p.unit), f"± {spread}", shown_unit(p.unit),
                     f"{name_in_fit(moved.parameter, result)}, by {h.part:.2g} of its error" if h.part >= 0.01 else "",
                     number_text(100.0 * h.share, 2)))
    return TextTable(("held", "value", "known to", "unit", "moves most", "would take of the residual's square (%)"),
                     tuple(rows))


def derived_table(result: FitResult, prepared: Prepared) -> TextTable | None:
    """Wave speeds and moduli that follow from the fit, as in Table 4 of the paper; None for a transducer."""
    found = derived_quantities(result, prepared)
    if not found:
        return None
    return TextTable(("follows from it", "value", "95 % interval", "unit"), tuple(
        (d.name, *shown_estimate(d.value, d.low, d.high, d.unit), shown_unit(d.unit)) for d in found))


def match_table(result: FitResult) -> TextTable:
    """Distances of start and fit from every recording."""
    rows = []
    for m in result.recordings:
        rows += [(f"{m.name}: MAPE of |Z| (%)", number_text(m.before.mape_percent), number_text(m.after.mape_percent)),
                 (f"{m.name}: rms of ln(Z / Z_measured)", number_text(m.before.rms_log_residual),
                  number_text(m.after.rms_log_residual))]
        before = {row.metric: row for row in m.before.rows}
        for row in m.after.rows:
            start = f"{before[row.metric].simulated:.6g}" if row.metric in before else ""
            rows.append((f"{m.name}: {row.metric}, measured {row.measured:.6g}", start,
                         f"{row.simulated:.6g} ({row.difference_percent:+.2f} %)"))
    return TextTable(("", "start", "fitted"), tuple(rows))


def gel_table(cases: Sequence[GelCase]) -> TextTable:
    """Errors for every thickness of the gel, as in section 4.3 of the paper."""
    return TextTable(("gel (um)", "MAPE of |Z| (%)", "rms of ln(Z / Z_measured)", "MAPE in the paper (%)"), tuple(
        (f"{1e6 * c.thickness:g}", number_text(c.comparison.mape_percent), number_text(c.comparison.rms_log_residual),
         "" if _published(c.thickness) is None else f"{_published(c.thickness):g}") for c in cases))


def _published(thickness: float) -> float | None:
    return next((error for known, error in PUBLISHED.items() if abs(known - thickness) < 1e-9), None)


def write_fit_report(
    folder: Path, title: str, result: FitResult, prepared: Prepared, sources: Sequence[Source], *,
    gel: Sequence[GelCase], saved_as: str | None,
) -> Path:
    """Pictures and ``report.html``: first what was found, then pictures, starts, bands, noise, provenance."""
    pictures = [Picture(draw_fit(m.measured, m.start, m.fitted, folder / f"fit_{m.name}.png", title=m.name),
                        f"{m.name}: impedance as measured, at the start and fitted, and what the fit leaves")
                for m in result.recordings]
    names = [short_name(e, prepared) for e in result.estimates]
    known_well = np.isfinite(result.covariance).all()
    if known_well:
        intervals = [Interval(
            name, e.value, e.low, e.high, e.parameter.start, e.parameter.prior,
            "; ".join(filter(None, ("at bound" if e.at_bound else "", "" if e.determined else "not determined"))))
            for name, e in zip(names, result.estimates, strict=True)]
        pictures.append(Picture(draw_intervals(intervals, folder / "intervals.png", title="parameters"),
                                "fitted values with their 95 % intervals, and what was known before"))
    if known_well and len(names) > 1:
        pictures.append(Picture(draw_correlation(names, result.correlation, folder / "correlation.png",
                                                      title="correlation of the estimates"), "correlations"))
    verdict: list[Block] = [Note(text) for text in refusals(result)]
    verdict += [Note(f"{s.recording}: {text}") for s in sources for text in s.findings]
    if saved_as:
        verdict.append(f"Saved as {saved_as}.")
    found: list[Block] = [*verdict, "\n\n".join(result.findings), parameter_table(result, prepared)]
    held = held_table(result)
    if held is not None:
        found += ["Held fixed, although uncertain too:", held]
    found.append(match_table(result))
    table = derived_table(result, prepared)
    if table is not None:
        found += [f"At {reference_frequency(result) / 1e6:.4f} MHz:", table]
    sections: list[tuple[str, Sequence[Block]]] = [("What was found", found), ("Pictures", pictures)]
    if gel:
        shown_cases = {f"{1e6 * c.thickness:g} µm": (c.spectrum, c.comparison.mape_percent) for c in gel}
        sections.append(("Thickness of the gel", [
            "Nothing was fitted again: only the gel is made thicker or thinner.", gel_table(gel),
            Picture(draw_gel_study(result.recordings[0].measured, shown_cases, folder / "gel.png",
                                        resonance=reference_frequency(result), title="thickness of the gel"),
                    "impedance predicted for several thicknesses of the gel")]))
    sections += _background(result, sources)
    return write_report(folder / "report.html", f"{title}: {prepared.material.name} fitted", sections)


def _background(result: FitResult, sources: Sequence[Source]) -> list[tuple[str, Sequence[Block]]]:
    starts = TextTable(("start", "rms of ln(Z / Z_measured)", "outcome", "steps"), tuple(
        (s.label, number_text(s.rms), s.outcome, str(s.steps)) for s in result.starts))
    spent = TextTable(("algorithm", "wall time (s)", "full solves", "steps", "difference from full solves"), (
        (result.algorithm, f"{result.seconds:.1f}", str(result.full_solves), str(result.iterations),
         f"{result.check[0]:.1e} at {result.check[1] / 1e3:.1f} kHz" if np.isfinite(result.check[0]) else ""),))
    sections: list[tuple[str, Sequence[Block]]] = [("Starts and effort", [starts, spent])]
    if result.bands:
        sections.append(("Bands left out", [
            "Each band was left out in turn, and predicted by a fit to the rest.",
            TextTable(("recording", "band (kHz)", "rms when fitted", "rms when left out"), tuple(
                (b.recording, f"{b.low / 1e3:.1f} to {b.high / 1e3:.1f}", number_text(b.fitted_rms, 3),
                 number_text(b.predicted_rms, 3)) for b in result.bands))]))
    if result.undetermined:
        sections.append(("What the data do not determine", [TextTable(("combination", "narrowed to", "symmetry"), tuple(
            (", ".join(f"{share:+.2f} {name}" for name, share in d.shares[:6]), f"{d.narrowing:.0%}", d.symmetry)
            for d in result.undetermined))]))
    sections.append(("Noise", [TextTable(
        ("recording", "relative deviation of a point (%)", "points that say as much as one", "stated"),
        tuple((m.name, number_text(100.0 * m.noise.deviation, 3), f"{m.noise.correlation:.1f}",
               f"yes, residual {m.noise.ratio:.2f} times as large" if m.noise.stated else "no")
              for m in result.recordings))]))
    provenance: list[Block] = []
    for m, s in zip(result.recordings, sources, strict=True):
        files = (("recording", s.recording), ("SHA-256", s.sha256), ("chip", s.chip),
                 ("SHA-256 of the chip", s.chip_sha256))
        provenance += [TextTable((m.name, "value"), files), origin_table(m.measured.origin)]
    sections.append(("The recordings", provenance))
    return sections


# --------------------------------------------------------------------------------------------------------------------
# fit.json.


def fit_record(
    result: FitResult, prepared: Prepared, sources: Sequence[Source], *, date: datetime, saved_as: str | None = None
) -> dict[str, Any]:
    """Everything of a fit for a JSON file: SI units in the names, or beside the numbers where they differ."""
    refused = refusals(result)
    return {
        "kind": prepared.kind, "algorithm": result.algorithm, "software": software(), "date": date.isoformat(),
        "chip": prepared.chip.name, "state": prepared.state, "material": prepared.material.name,
        "accepted": not refused, "refusals": list(refused), "saved_as": saved_as,
        "findings": list(result.findings),
        "mape_percent": float(np.mean([m.after.mape_percent for m in result.recordings])),
        "rms_log_residual": rms_log_residual(result),
        "converged": result.converged, "improved": result.improved, "iterations": result.iterations,
        "wall_seconds": result.seconds, "full_solves": result.full_solves, "confidence": CONFIDENCE,
        "parameters": [parameter_record(e) for e in result.estimates],
        "derived": [{"name": d.name, "value": d.value, "unit": d.unit, "low": finite(d.low), "high": finite(d.high),
                     "standard_error": finite(d.standard_error)} for d in derived_quantities(result, prepared)],
        "derived_frequency_hz": reference_frequency(result),
        "recordings": [_match_record(m, s) for m, s in zip(result.recordings, sources, strict=True)],
        "correlation": {"names": [e.parameter.name for e in result.estimates],
                        "rows": [[finite(x) for x in row] for row in result.correlation]},
        "held": [{"name": h.parameter.name, "value": h.parameter.value, "unit": h.parameter.unit,
                  "standard_uncertainty": h.parameter.scale, "moves": h.moved, "by_standard_errors": h.part,
                  "share_of_residual": h.share, "taken_if_proposed": h.taken} for h in result.held],
        "entries_tried": [{"name": each.name, "rms_log_residual": each.rms} for each in result.entries],
        "undetermined": [{"shares": dict(d.shares), "narrowing": d.narrowing, "symmetry": d.symmetry}
                         for d in result.undetermined],
        "starts": [{"label": s.label, "rms_log_residual": finite(s.rms),
                    "outcome": s.outcome, "steps": s.steps,
                    "begin": [float(x) for x in s.begin], "end": [float(x) for x in s.end]} for s in result.starts],
        "bands_left_out": [{"recording": b.recording, "low_hz": b.low, "high_hz": b.high, "fitted_rms": b.fitted_rms,
                            "predicted_rms": b.predicted_rms} for b in result.bands],
        "check_against_full_solves": {"relative_difference": finite(result.check[0]),
                                      "frequency_hz": finite(result.check[1])},
    }


def parameter_record(estimate: ParameterEstimate) -> dict[str, Any]:
    """One row of the parameter table."""
    p = estimate.parameter
    return {
        "name": p.name, "recordings": list(p.recordings), "value": estimate.value, "unit": p.unit,
        "low": finite(estimate.low), "high": finite(estimate.high),
        "standard_error": finite(estimate.standard_error), "numerical": finite(estimate.numerical), "prior": p.prior,
        "start": p.start, "at_bound": estimate.at_bound, "determined": estimate.determined,
        "narrowing": finite(estimate.narrowing), "method": estimate.method, "of_held": finite(estimate.held),
    }


def gel_record(cases: Sequence[GelCase]) -> list[dict[str, Any]]:
    """The study of the gel in ``fit.json``."""
    return [{"thickness_m": c.thickness, "mape_percent": c.comparison.mape_percent,
             "rms_log_residual": c.comparison.rms_log_residual,
             "published_mape_percent": _published(c.thickness)} for c in cases]


def _match_record(match: Match, files: Source) -> dict[str, Any]:
    measured = match.measured
    return {
        "name": match.name, "file": files.recording, "sha256": files.sha256, "chip_file": files.chip,
        "chip_sha256": files.chip_sha256, "reader_findings": list(files.findings),
        "band_hz": [float(measured.frequency[0]), float(measured.frequency[-1])],
        "points": int(measured.frequency.size),
        "mape_percent": match.after.mape_percent, "rms_log_residual": match.after.rms_log_residual,
        "worst_percent": match.after.worst_percent, "worst_frequency_hz": match.after.worst_frequency,
        "phase_mean_deg": match.after.phase_mean_deg, "phase_max_deg": match.after.phase_max_deg,
        "start_mape_percent": match.before.mape_percent, "start_rms_log_residual": match.before.rms_log_residual,
        "figures": {label: figures_record(*measured_figures(s)) for label, s in
                    (("measured", measured), ("start", match.start), ("fitted", match.fitted))},
        "noise": {"relative_deviation": match.noise.deviation, "correlated_points": match.noise.correlation,
                  "stated": match.noise.stated, "ratio_to_stated": match.noise.ratio},
    }
