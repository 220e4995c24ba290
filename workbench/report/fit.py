"""A fit: tables, record of ``fit.json``, and page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from workbench.files.quantities import shown_factor, shown_unit
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
from workbench.report.page import Picture, TextTable, Value, number_text, table, write_report
from workbench.report.record import plain, record
from workbench.results.merit import measured_figures


def number_in_unit(value: float, unit: str, *, digits: int = 5) -> str:
    """A number (SI) as text in its shown unit; empty for NaN."""
    return number_text(value * shown_factor(unit), digits) if np.isfinite(value) else ""


def shown_estimate(value: float, low: float, high: float, unit: str) -> tuple[str, str]:
    """An estimate and its interval, to two digits of the interval's width."""
    if not np.isfinite(low):
        return number_in_unit(value, unit), ""
    digits = 5
    if high > low:
        digits = max(digits, math.ceil(math.log10(max(abs(value), abs(low), abs(high)) / (high - low))) + 2)
    shown, *ends = (number_in_unit(number, unit, digits=digits) for number in (value, low, high))
    return shown, " to ".join(ends)


def short_name(estimate: ParameterEstimate, prepared: Prepared) -> str:
    """The name of a parameter without its material, with its own recordings."""
    p = estimate.parameter
    text = p.parsed.within(prepared.material.name)
    return f"{text} ({', '.join(p.recordings)})" if p.recordings else text


def parameter_table(result: FitResult, prepared: Prepared) -> TextTable:
    """Every fitted parameter, as in Table 3 of Acevedo-Espinosa et al. (RP-UEIS), with intervals."""
    rows = []
    for e in result.estimates:
        p = e.parameter
        bound = e.at_bound.removesuffix(f" of {prepared.material.name}")
        remarks = [f"at its bound: {bound}" if bound else "",
                   "of all points together" if p.nuisance else "" if e.determined else "not determined",
                   "by profile" if e.method == "profile" else ""]
        spread = "" if p.prior is None else number_in_unit(p.prior, p.unit, digits=2)
        part = number_in_unit(DEVIATIONS * e.held, p.unit, digits=2) if e.held > 0.0 else ""
        rows.append((short_name(e, prepared), number_in_unit(p.start, p.unit),
                     *shown_estimate(e.value, e.low, e.high, p.unit), part and f"± {part}", shown_unit(p.unit),
                     e.value / p.start - 1.0 if p.start else None,
                     spread and f"± {spread}{' (assumed)' if p.assumed else ''}", "; ".join(filter(None, remarks))))
    return table(f"parameter | start | fitted | 95 % interval | {OF_FIXED} | unit | change (%):+.2f | prior | "
                 "remark", rows)


#: Heading of the part of an interval that comes from the fixed constants.
OF_FIXED = "of which fixed constants"


def for_terminal(shown: TextTable) -> TextTable:
    """The table of parameters without prior, change and empty columns."""
    cells = [column for column in zip(shown.columns, *shown.rows, strict=True)
             if column[0] not in ("prior", "change (%)") and (column[0] != OF_FIXED or any(column[1:]))]
    heads, *rows = zip(*cells, strict=True)
    return TextTable(heads, tuple(rows))


def held_table(result: FitResult) -> TextTable | None:
    """The fixed parameters that are uncertain; None if there are none."""
    if not result.held:
        return None
    errors = {e.parameter.name: e for e in result.estimates}
    return table("fixed | value | known to | unit | moves most | would explain of the residual's square (%):.2g", (
        (name_in_fit(h.parameter, result), number_in_unit(h.parameter.value, h.parameter.unit),
         f"± {number_in_unit(h.parameter.scale, h.parameter.unit, digits=2)}", shown_unit(h.parameter.unit),
         f"{name_in_fit(errors[h.moved].parameter, result)}, by {h.part:.2g} of its error" if h.part >= 0.01 else None,
         h.share) for h in result.held))


def derived_table(result: FitResult, prepared: Prepared) -> TextTable | None:
    """Wave speeds and moduli from the fit; None for a transducer.

    The paper has them in its Table 4.
    """
    found = derived_quantities(result, prepared)
    return None if not found else table("derived quantity | value | 95 % interval | unit", (
        (d.name, *shown_estimate(d.value, d.low, d.high, d.unit), shown_unit(d.unit)) for d in found))


def match_table(result: FitResult) -> TextTable:
    """Distances of start and fit from every recording."""
    rows: list[tuple[Value, ...]] = []
    for m in result.recordings:
        rows += [(f"{m.name}: MAPE of |Z| (%)", m.before.mape_percent, m.after.mape_percent),
                 (f"{m.name}: rms of ln(Z / Z_measured)", m.before.rms_log_residual, m.after.rms_log_residual)]
        before = {row.metric: f"{row.simulated:.6g}" for row in m.before.rows}
        rows += [(f"{m.name}: {row.metric}, measured {row.measured:.6g}", before.get(row.metric),
                  f"{row.simulated:.6g} ({row.difference_percent:+.2f} %)") for row in m.after.rows]
    return table(" | start | fitted", rows)


def gel_table(cases: Sequence[GelCase]) -> TextTable:
    """Errors for every thickness of the gel (section 4.3 of the paper)."""
    published = (_published(c.thickness) for c in cases)
    return table("gel (um):g | MAPE of |Z| (%) | rms of ln(Z / Z_measured) | MAPE in the paper (%):g", (
        (c.thickness, c.comparison.mape_percent / 100.0, c.comparison.rms_log_residual, error and error / 100.0)
        for c, error in zip(cases, published, strict=True)))


def _published(thickness: float) -> float | None:
    return next((error for known, error in PUBLISHED.items() if abs(known - thickness) < 1e-9), None)


def write_fit_report(
    folder: Path, title: str, result: FitResult, prepared: Prepared, sources: Sequence[Source], *,
    gel: Sequence[GelCase], saved_as: str | None,
) -> Path:
    """Write ``report.html``: result, pictures, starts, bands, noise and recordings."""
    return write_report(folder / "report.html", f"{title}: {prepared.material.name} fitted", module=__name__, values={
        "result": result, "prepared": prepared, "sources": sources, "gel": gel, "saved_as": saved_as,
        "origin_table": origin_table, "pictures": _pictures(folder, result, prepared),
        "gel_picture": gel and _gel_picture(folder, result, gel)})


def _gel_picture(folder: Path, result: FitResult, gel: Sequence[GelCase]) -> Picture:
    cases = {f"{1e6 * c.thickness:g} µm": (c.spectrum, c.comparison.mape_percent) for c in gel}
    return Picture(draw_gel_study(result.recordings[0].measured, cases, folder / "gel.png",
                                  resonance=reference_frequency(result), title="thickness of the gel"),
                   "impedance predicted for several thicknesses of the gel")


def undetermined_table(result: FitResult) -> TextTable:
    """The combinations of parameters that the data do not determine."""
    return table("combination | narrowed to:.0% | symmetry", (
        (", ".join(f"{share:+.2f} {name}" for name, share in d.shares[:6]), d.narrowing, d.symmetry)
        for d in result.undetermined))


def noise_table(result: FitResult) -> TextTable:
    """The noise of every recording, and whether it is the stated one."""
    return table(
        "recording | relative deviation of a point (%):.3g | correlation length (points):.1f | stated",
        ((m.name, m.noise.deviation, m.noise.correlation,
          f"yes, residual {m.noise.ratio:.2f} times as large" if m.noise.stated else "no") for m in result.recordings))


def effort_table(result: FitResult) -> TextTable:
    """Algorithm, time and steps of a fit, and its check."""
    difference, frequency = result.check
    check = f"{difference:.1e} at {frequency / 1e3:.1f} kHz" if np.isfinite(difference) else None
    return table("algorithm | wall time (s):.1f | full solves | steps | difference from full solves", [
        (result.algorithm, result.seconds, result.full_solves, result.iterations, check)])


def _pictures(folder: Path, result: FitResult, prepared: Prepared) -> list[Picture]:
    """The spectra, and the estimates with their correlations if these are known."""
    pictures = [Picture(draw_fit(m.measured, m.start, m.fitted, folder / f"fit_{m.name}.png", title=m.name),
                        f"{m.name}: impedance as measured, at the start and fitted, and the residual of the fit")
                for m in result.recordings]
    if not np.isfinite(result.covariance).all():
        return pictures
    names = [short_name(e, prepared) for e in result.estimates]
    intervals = [Interval(
        name, e.value, e.low, e.high, e.parameter.start, e.parameter.prior,
        "; ".join(filter(None, ("at bound" if e.at_bound else "", "" if e.determined else "not determined"))))
        for name, e in zip(names, result.estimates, strict=True)]
    pictures.append(Picture(draw_intervals(intervals, folder / "intervals.png", title="parameters"),
                            "fitted values with their 95 % intervals, and the prior"))
    if len(names) > 1:
        pictures.append(Picture(draw_correlation(names, result.correlation, folder / "correlation.png",
                                                 title="correlation of the estimates"), "correlations"))
    return pictures


def fit_record(
    result: FitResult, prepared: Prepared, sources: Sequence[Source], *, date: datetime
) -> dict[str, Any]:
    """An unsaved fit for a JSON file, in SI or with units."""
    refused = refusals(result)
    return {
        **record(prepared, "kind chip=chip.name state material=material.name"),
        **record(result, "algorithm findings converged improved interrupted further_descents=further "
                         "starts_untried=untried iterations wall_seconds=seconds full_solves "
                         "held { name=parameter.name value=parameter.value unit=parameter.unit "
                         "standard_uncertainty=parameter.scale moves=moved by_standard_errors=part "
                         "share_of_residual=share taken_if_proposed=taken } "
                         "entries_tried=entries { name rms_log_residual=rms } "
                         "starts { label rms_log_residual=rms outcome steps begin end } "
                         "bands_left_out=bands { recording low_hz high_hz fitted_rms predicted_rms }"),
        "software": software(), "date": date.isoformat(), "accepted": not refused, "refusals": list(refused),
        "saved_as": None, "mape_percent": float(np.mean([m.after.mape_percent for m in result.recordings])),
        "rms_log_residual": rms_log_residual(result), "confidence": CONFIDENCE,
        "parameters": list(map(parameter_record, result.estimates)),
        "derived": record(derived_quantities(result, prepared), "name value unit low high standard_error"),
        "derived_frequency_hz": reference_frequency(result),
        "recordings": list(map(_match_record, result.recordings, sources)),
        "correlation": {"names": [e.parameter.name for e in result.estimates], "rows": plain(result.correlation)},
        "undetermined": [record(d, "narrowing symmetry") | {"shares": dict(d.shares)} for d in result.undetermined],
        "check_against_full_solves": plain(
            dict(zip(("relative_difference", "frequency_hz"), result.check, strict=True)))}


def parameter_record(estimate: ParameterEstimate) -> dict[str, Any]:
    """One row of the parameter table."""
    return record(estimate, "name=parameter.name recordings=parameter.recordings value unit=parameter.unit low high "
                            "standard_error numerical prior=parameter.prior start=parameter.start at_bound determined "
                            "narrowing method of_held=held")


def gel_record(cases: Sequence[GelCase]) -> list[dict[str, Any]]:
    """The study of the gel in ``fit.json``."""
    return [record(c, "thickness_m mape_percent=comparison.mape_percent rms_log_residual=comparison.rms_log_residual")
            | {"published_mape_percent": _published(c.thickness)} for c in cases]


def _match_record(match: Match, files: Source) -> dict[str, Any]:
    measured = match.measured
    return {
        **record(match, "name start_mape_percent=before.mape_percent start_rms_log_residual=before.rms_log_residual "
                        "noise { relative_deviation=deviation correlated_points=correlation stated "
                        "ratio_to_stated=ratio }"),
        **record(match.after, "mape_percent rms_log_residual worst_percent worst_frequency_hz phase_mean_deg "
                              "phase_max_deg"),
        **record(files, "file=recording sha256 chip_file=chip chip_sha256 reader_findings=findings"),
        "band_hz": plain(measured.frequency[[0, -1]]), "points": measured.frequency.size,
        "figures": {label: figures_record(*measured_figures(s)) for label, s in
                    (("measured", measured), ("start", match.start), ("fitted", match.fitted))}}
