"""One fit from its files to its results, for all kinds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from geometry.chip import read_chip
from materials import Registry, save_fit, user_registry
from materials.kinds import Material
from materials.saving import saved_versions
from materials.versions import check_saved_name
from workbench.commands.parsed_options import saving_folder
from workbench.files.errors import InputError
from workbench.files.quantities import frequency_text
from workbench.files.writing import write_json
from workbench.fitting.batch import BatchMember, Job, Settings, content_key, finished
from workbench.fitting.gel import GelCase, gel_study, with_gel
from workbench.fitting.joint import FitResult, fit_parameters
from workbench.fitting.prepare import (
    DEFAULT,
    KINDS,
    Prepared,
    free_region,
    material_starts,
    other_ceramics,
    prepare,
    prepare_together,
    with_material,
)
from workbench.fitting.record import (
    Source,
    paper_result,
    registry_entry,
    source,
    tried,
)
from workbench.jobs.interruption import SAVED
from workbench.jobs.progress import Progress, no_progress
from workbench.model.problem import fill
from workbench.readers import read_column_map, read_recording
from workbench.report.fit import fit_record, gel_record, write_fit_report
from workbench.reproduction import fits as paper
from workbench.results.spectrum import write_spectrum


@dataclass(frozen=True, eq=False)
class Done:
    """A finished fit: its result, and the content of its ``fit.json``. ``saved_before`` is whether the registry had its
    content already, under the name ``saved_as`` of the record."""

    result: FitResult
    prepared: Prepared
    record: Mapping[str, Any]
    gel: tuple[GelCase, ...]
    saved_before: bool = False


def run_job(job: Job, settings: Settings, folder: Path, *, progress: Progress = no_progress) -> Done:
    """Fit a job; write ``fit.json``, spectra, pictures and the report into `folder`.

    Raises:
        InputError: a mistake in a file, or a recording that cannot be of its device.
        RuntimeError: no spectrum could be predicted, or no mesh made.
    """
    registry = user_registry(settings.materials, inviscid=settings.inviscid)
    progress("reading", 0.0)
    prepared, sources = _prepared(job, settings, registry)
    # Mistakes are reported before the search, not after.
    if job.save is not None:
        check_saved_name(job.save)
    for thickness in settings.gel_thicknesses:
        with_gel(prepared.chip, thickness)
    starts = material_starts(prepared, registry, settings.starts)
    match settings.algorithm:
        case "joint":
            others = material_starts(prepared, registry, other_ceramics(prepared, registry, settings.starts))
            result = fit_parameters(prepared.recordings, prepared.parameters, coarse=prepared.coarse, starts=starts,
                                    others=others, tries=settings.tries, progress=progress)
            result = tried(result, prepared, registry, settings.tries, progress)
        case _:
            result = _as_published(prepared, starts, progress)
    progress("writing", 0.95)
    date = datetime.now(UTC)
    record = {"key": None, "name": job.name, **fit_record(result, prepared, sources, date=date)}
    refused = not record["accepted"]
    # The fit is on disk before the next steps, which may be interrupted. A batch repeats a fit without a key.
    write_json(folder / "fit.json", record)
    gel: tuple[GelCase, ...] = ()
    if settings.gel_thicknesses:
        gel = gel_study(prepared, registry, numbers={e.parameter.name: e.value for e in result.estimates},
                        thicknesses=settings.gel_thicknesses,
                        accuracy=settings.accuracy)
    for match in result.recordings:
        write_spectrum(match.fitted, folder / f"{match.name}_fitted.csv")
        write_spectrum(match.start, folder / f"{match.name}_start.csv")
    saved_as, saved_before = None, False
    if job.save is not None and (settings.force or not refused):
        # The entry's `start` names the registry's material, which a chip's density may have changed.
        entry = registry_entry(result, prepared, sources, date=date, forced=refused,
                               temperature=prepared.chip.state(prepared.state).temperature)
        kept = saving_folder(settings.materials)
        before = saved_versions(job.save, kept)
        saved_as = save_fit(entry, job.save, folder=kept)
        saved_before = saved_as in before
    try:
        record |= {"key": None if result.interrupted else job_key(job, settings), "saved_as": saved_as}
        if gel:
            record["gel_study"] = gel_record(gel)
        write_fit_report(folder, job.name, result, prepared, sources, gel=gel, saved_as=saved_as)
        # Written last: with the key, all files exist.
        write_json(folder / "fit.json", record)
    except BaseException as error:
        if saved_as is not None:
            error.add_note(f"{saved_as}{SAVED}")
        raise
    return Done(result, prepared, record, gel, saved_before)


def fit_files(job: Job) -> tuple[str, ...]:
    """Names of the files of a fit."""
    return ("fit.json", "report.html", "intervals.png", "correlation.png", "gel.png",
            *(name for member in job.members
              for name in (f"{member.name}_fitted.csv", f"{member.name}_start.csv", f"fit_{member.name}.png")))


def job_key(job: Job, settings: Settings) -> str:
    """A digest of all inputs of a job (see `batch.content_key`)."""
    registry = user_registry(settings.materials, inviscid=settings.inviscid)
    return content_key(job, settings, [_filling(member, registry) for member in job.members])


def known(job: Job, settings: Settings, folder: Path) -> dict[str, Any] | None:
    """The record of a finished job, or None.

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
        reading = read_recording(member.recording, columns=columns, format=member.format, correction=member.correction,
                                 without_outliers=member.without_outliers)
        chip = read_chip(member.chip)
        band = tuple(own if end is None else end for end, own in zip(member.band, chip.band, strict=True))
        if not 0.0 < band[0] < band[1]:
            raise InputError(member.name, "band", frequency_text(*band), "a rising band")
        free = member.free
        if settings.algorithm != "joint":
            free = tuple(each for item in free for each in (KINDS[member.kind] if item == DEFAULT else (item,)))
        parts.append(prepare(
            chip, registry, kind=member.kind, name=member.name, measured=reading.spectrum, state=member.state,
            material=member.material, region=member.region, free=free, band=(band[0], band[1]),
            accuracy=settings.accuracy, check=not settings.force))
        sources.append(source(member.recording, member.chip, findings=[str(f.message) for f in reading.findings]))
    return (parts[0] if len(parts) == 1 and not job.own else prepare_together(parts, own=job.own)), tuple(sources)


def _as_published(prepared: Prepared, starts: Mapping[str, Any], progress: Progress) -> FitResult:
    """Algorithm 2 or the polymer fit of the paper, from one start."""
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


