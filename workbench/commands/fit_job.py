"""One fit from its files to its results: what every kind of ``workbench fit`` does."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from geometry.chip import read_chip
from materials import Registry, save_fit, user_registry
from materials.kinds import Material
from materials.versions import check_name
from workbench.commands.asked import saving_folder
from workbench.commands.tables import origin_table
from workbench.files.errors import InputError
from workbench.files.quantities import shown_factor, shown_unit
from workbench.fitting.batch import BatchMember, Job, Settings, content_key, finished
from workbench.fitting.gel import PUBLISHED, GelCase, gel_study, with_gel
from workbench.fitting.joint import FitResult, fit_parameters
from workbench.fitting.prepare import Prepared, free_region, material_starts, prepare, prepare_together, with_material
from workbench.fitting.record import (
    Source,
    derived_quantities,
    fit_record,
    paper_result,
    reference_frequency,
    refusals,
    registry_entry,
    source,
)
from workbench.fitting.uncertainty import ParameterEstimate
from workbench.model.problem import fill
from workbench.readers import read_column_map, read_recording
from workbench.report.page import Block, Note, Picture, TextTable, number_text, write_json, write_report
from workbench.reproduction import fits as paper
from workbench.results.spectrum import write_csv

#: Called with what is being done and the share of it that is done.
Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Done:
    """A finished fit: its result, the content of its ``fit.json``, and what was written for it."""

    result: FitResult
    prepared: Prepared
    record: Mapping[str, Any]
    gel: tuple[GelCase, ...]


def run_job(job: Job, settings: Settings, folder: Path, *, progress: Progress = lambda _text, _share: None) -> Done:
    """Fit a job and write ``fit.json``, spectra, pictures and the report into `folder`.

    Raises:
        InputError: a mistake in a file, or a recording that cannot be of its device.
        RuntimeError: no spectrum could be predicted, or no mesh made.
    """
    registry = user_registry(settings.materials)
    progress("reading", 0.0)
    prepared, sources = _prepared(job, settings, registry)
    # Mistakes are reported before the search, not after.
    if job.save is not None:
        check_name(job.save)
    for thickness in settings.gel_thicknesses:
        with_gel(prepared.chip, thickness)
    starts = material_starts(prepared, registry, settings.starts)
    match settings.algorithm:
        case "joint":
            result = fit_parameters(prepared.recordings, prepared.parameters, coarse=prepared.coarse, starts=starts,
                                    tries=settings.tries, progress=progress)
        case _:
            result = _as_published(prepared, starts, progress)
    progress("writing", 0.95)
    date = datetime.now(UTC)
    refused = bool(refusals(result))
    saved_as = None
    if job.save is not None and (settings.force or not refused):
        # The entry's `start` names the registry's material, which a chip's density may have changed.
        entry = registry_entry(result, prepared, sources, date=date, forced=refused,
                               temperature=prepared.chip.state(prepared.state).temperature)
        saved_as = save_fit(entry, job.save, folder=saving_folder(settings.materials))
    gel: tuple[GelCase, ...] = ()
    if settings.gel_thicknesses:
        gel = gel_study(prepared, registry, numbers={e.parameter.name: e.value for e in result.estimates},
                        thicknesses=settings.gel_thicknesses,
                        accuracy=settings.accuracy)
    record = {"key": job_key(job, settings), "name": job.name,
              **fit_record(result, prepared, sources, date=date, saved_as=saved_as)}
    if gel:
        record["gel_study"] = [
            {"thickness_m": c.thickness, "mape_percent": c.comparison.mape_percent,
             "rms_log_residual": c.comparison.rms_log_residual,
             "published_mape_percent": _published(c.thickness)} for c in gel]
    for match in result.recordings:
        write_csv(match.fitted, folder / f"{match.name}_fitted.csv")
        write_csv(match.start, folder / f"{match.name}_start.csv")
    write_fit_report(folder, job.name, result, prepared, sources, gel=gel, saved_as=saved_as)
    # Last: where it is, everything is.
    write_json(folder / "fit.json", record)
    return Done(result, prepared, record, gel)


def job_key(job: Job, settings: Settings) -> str:
    """A digest of all that decides the result of a job (see `batch.content_key`)."""
    return content_key(job, settings, [_filling(member, user_registry(settings.materials)) for member in job.members])


def known(job: Job, settings: Settings, folder: Path) -> dict[str, Any] | None:
    """The record of the job if it has been done before, None otherwise.

    Raises:
        InputError: a mistake in one of its files.
    """
    return finished(folder / job.name, job_key(job, settings))


def _filling(member: BatchMember, registry: Registry) -> dict[str, Material]:
    chip = read_chip(member.chip)
    state = chip.state(member.state).name
    if member.material is not None:
        chip = with_material(chip, state, free_region(chip, state, member.kind, member.region), member.material)
    return dict(fill(chip, state, registry).materials)


def _prepared(job: Job, settings: Settings, registry: Registry) -> tuple[Prepared, tuple[Source, ...]]:
    parts, sources = [], []
    for member in job.members:
        if member.columns is not None and member.format is not None:
            raise InputError(member.name, "format", member.format, "columns or format, not both")
        columns = None if member.columns is None else read_column_map(member.columns)
        reading = read_recording(member.recording, columns=columns, format=member.format, correction=member.correction)
        chip = read_chip(member.chip)
        band = tuple(own if asked is None else asked for asked, own in zip(member.band, chip.band, strict=True))
        if not 0.0 < band[0] < band[1]:
            raise InputError(member.name, "band", f"{band[0]:g} Hz to {band[1]:g} Hz", "a rising band")
        parts.append(prepare(
            chip, registry, kind=member.kind, name=member.name, measured=reading.spectrum, state=member.state,
            material=member.material, region=member.region, free=member.free, band=(band[0], band[1]),
            accuracy=settings.accuracy, check=not settings.force))
        sources.append(source(member.recording, member.chip, findings=[str(f.message) for f in reading.findings]))
    return (parts[0] if len(parts) == 1 and not job.own else prepare_together(parts, own=job.own)), tuple(sources)


def _as_published(prepared: Prepared, starts: Mapping[str, Any], progress: Progress) -> FitResult:
    """Algorithm 2 or the polymer fit of the paper, from the first of the starts given."""
    if len(prepared.recordings) > 1:
        raise InputError("fit", "algorithm", "paper", "joint: the paper's algorithms fit one recording")
    if len(starts) > 1:
        raise InputError("fit", "start", ", ".join(starts), "one start: the paper's algorithms take no more")
    begin = None
    for vector in starts.values():
        begin = {p.parsed.within(prepared.material.name): float(x)
                 for p, x in zip(prepared.parameters, vector, strict=True)}

    def show(text: str, _cost: float) -> None:
        progress(text, 0.5)

    recording = prepared.recordings[0]
    if prepared.kind == "pzt":
        found = paper.fit_transducer(recording, start=begin, progress=show)
    else:
        found = paper.fit_polymer(recording, prepared.material.name, start=begin, progress=show)
    return paper_result(found, prepared)


# --------------------------------------------------------------------------------------------------------------------
# Tables, pictures, report.


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
    """As Table 3 of Acevedo-Espinosa et al. (RP-UEIS), with intervals."""
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
        rows.append((short_name(e, prepared), number_in_unit(p.start, p.unit),
                     *shown_estimate(e.value, e.low, e.high, p.unit), shown_unit(p.unit), difference, prior,
                     "; ".join(filter(None, remarks))))
    return TextTable(("parameter", "start", "fitted", "95 % interval", "unit", "change (%)", "known before", "remark"),
                     tuple(rows))


def derived_table(result: FitResult, prepared: Prepared) -> TextTable | None:
    """As Table 4 of the paper, None for a transducer."""
    found = derived_quantities(result, prepared)
    if not found:
        return None
    return TextTable(("follows from it", "value", "95 % interval", "unit"), tuple(
        (d.name, *shown_estimate(d.value, d.low, d.high, d.unit), shown_unit(d.unit)) for d in found))


def match_table(result: FitResult) -> TextTable:
    """How far start and fit are from every recording."""
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
    """As section 4.3 of the paper."""
    return TextTable(("gel (um)", "MAPE of |Z| (%)", "rms of ln(Z / Z_measured)", "MAPE in the paper (%)"), tuple(
        (f"{1e6 * c.thickness:g}", number_text(c.comparison.mape_percent), number_text(c.comparison.rms_log_residual),
         "" if _published(c.thickness) is None else f"{_published(c.thickness):g}") for c in cases))


def _published(thickness: float) -> float | None:
    return next((error for known, error in PUBLISHED.items() if abs(known - thickness) < 1e-9), None)


def write_fit_report(
    folder: Path, title: str, result: FitResult, prepared: Prepared, sources: Sequence[Source], *,
    gel: Sequence[GelCase], saved_as: str | None,
) -> None:
    """Pictures and ``report.html``: first what was found, then pictures, starts, bands, noise, provenance."""
    from workbench.render import fits

    pictures = [Picture(fits.draw_fit(m.measured, m.start, m.fitted, folder / f"fit_{m.name}.png", title=m.name),
                        f"{m.name}: impedance as measured, at the start and fitted, and what the fit leaves")
                for m in result.recordings]
    names = [short_name(e, prepared) for e in result.estimates]
    known_well = np.isfinite(result.covariance).all()
    if known_well:
        intervals = [fits.Interval(
            name, e.value, e.low, e.high, e.parameter.start, e.parameter.prior,
            "; ".join(filter(None, ("at bound" if e.at_bound else "", "" if e.determined else "not determined"))))
            for name, e in zip(names, result.estimates, strict=True)]
        pictures.append(Picture(fits.draw_intervals(intervals, folder / "intervals.png", title="parameters"),
                                "fitted values with their 95 % intervals, and what was known before"))
    if known_well and len(names) > 1:
        pictures.append(Picture(fits.draw_correlation(names, result.correlation, folder / "correlation.png",
                                                      title="correlation of the estimates"), "correlations"))
    verdict: list[Block] = [Note(text) for text in refusals(result)]
    verdict += [Note(f"{s.recording}: {text}") for s in sources for text in s.findings]
    if saved_as:
        verdict.append(f"Saved as {saved_as}.")
    found: list[Block] = [*verdict, "\n\n".join(result.findings), parameter_table(result, prepared),
                          match_table(result)]
    table = derived_table(result, prepared)
    if table is not None:
        found += [f"At {reference_frequency(result) / 1e6:.4f} MHz:", table]
    sections: list[tuple[str, Sequence[Block]]] = [("What was found", found), ("Pictures", pictures)]
    if gel:
        shown_cases = {f"{1e6 * c.thickness:g} µm": (c.spectrum, c.comparison.mape_percent) for c in gel}
        sections.append(("Thickness of the gel", [
            "Nothing was fitted again: only the gel is made thicker or thinner.", gel_table(gel),
            Picture(fits.draw_gel_study(result.recordings[0].measured, shown_cases, folder / "gel.png",
                                        resonance=reference_frequency(result), title="thickness of the gel"),
                    "impedance predicted for several thicknesses of the gel")]))
    sections += _background(result, sources)
    write_report(folder / "report.html", f"{title}: {prepared.material.name} fitted", sections)


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
