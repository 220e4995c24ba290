"""``workbench fit``."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from workbench.commands.fit_job import Done, fit_files, known, run_job
from workbench.commands.parsed_options import (
    accuracy_option,
    executor_option,
    output_folder,
    saving_folder,
    say_read_as,
)
from workbench.commands.terminal import Show, print_line, print_table, progress_bars
from workbench.fem.solve import one_thread
from workbench.files.errors import InputError, choose
from workbench.files.output import MARK
from workbench.files.ownership import Outputs, discard
from workbench.files.quantities import parse_quantity
from workbench.files.writing import write_json
from workbench.fitting.batch import (
    BatchMember,
    Job,
    Settings,
    read_batch,
    summarise,
)
from workbench.fitting.prepare import DEFAULT
from workbench.fitting.record import held_names, refusals
from workbench.jobs.workers import Task, Workers, begin_workers
from workbench.readers import READ_AS
from workbench.report.fit import derived_table, for_terminal, gel_table, match_table, parameter_table
from workbench.report.fit_batch import batch_columns_table, devices_table, summary_record, write_batch_report

if TYPE_CHECKING:
    from rich.console import Console


#: Files of a batch beside those of its fits.
BATCH_FILES = ("summary.json", "report.html", "batch.png")


def run_fit(options: argparse.Namespace, console: Console) -> int:
    """``workbench fit``: material parameters from one or several recordings."""
    if options.tries < 0:
        raise InputError("command line", "--tries", options.tries, "a number of descents, 0 for none")
    settings = Settings(
        materials=tuple(options.materials), inviscid=options.inviscid, accuracy=accuracy_option(options),
        algorithm=options.algorithm, starts=tuple(options.start), tries=options.tries, force=options.force)
    if options.kind == "batch":
        return _batch(options, console, settings)
    settings = dataclasses.replace(settings, gel_thicknesses=_thicknesses(options.gel_study))
    job = Job(options.recording.stem, (_member(options),), save=options.save)
    folder = output_folder(options, Outputs("fit", fit_files(job)))
    if job.save is not None:
        saving_folder(settings.materials)  # before materials are read from it
    with progress_bars(console) as show:
        done = run_job(job, settings, folder, progress=partial(show, job.name))
        show(job.name, "done", 1.0)
    return _print_results(done, console, options.save)


def _member(options: argparse.Namespace) -> BatchMember:
    def end(text: str | None, field: str) -> float | None:
        return None if text is None else parse_quantity(text, "frequency", source="command line", field=field)

    free = DEFAULT if options.free is None else options.free
    names = tuple(name.strip() for name in free.split(","))
    if not all(names):
        raise InputError("command line", "--free", options.free, "names of parameters with commas between them")
    return BatchMember(
        options.recording.stem, options.recording, options.chip, options.kind, options.state, options.material,
        options.region, names, (end(options.low, "--from"), end(options.high, "--to")), options.columns, options.format,
        options.correction, options.without_outliers)


def _thicknesses(text: str | None) -> tuple[float, ...]:
    if text is None:
        return ()
    found = tuple(parse_quantity(one.strip(), "length", source="command line", field="--gel-study")
                  for one in text.split(","))
    if not min(found) > 0.0:
        raise InputError("command line", "--gel-study", text, 'thicknesses above zero, such as "5um,20um,50um"')
    return found


def _print_results(done: Done, console: Console, wanted: str | None) -> int:
    """Print the result of a fit; returns the exit status."""
    print_table(f"{done.prepared.material.name}, {done.result.algorithm}",
                for_terminal(parameter_table(done.result, done.prepared)))
    if done.result.held:
        print_line(f"fixed, although uncertain: {held_names(done.result)}")
    derived = derived_table(done.result, done.prepared)
    if derived is not None:
        print_table("", derived)
    print_table("", match_table(done.result))
    if done.gel:
        print_table("thickness of the gel", gel_table(done.gel))
    for match in done.result.recordings:
        say_read_as(match.measured.origin.settings.get(READ_AS, ""), match.name, console)
    for text in (text for recording in done.record["recordings"] for text in recording["reader_findings"]):
        console.print(f"finding: {text}", style="yellow", markup=False)
    for text in done.result.findings:
        console.print(f"finding: {text}", markup=False)
    refused = refusals(done.result)
    for text in refused:
        console.print(f"not accepted: {text}", style="bold red", markup=False)
    if done.saved_before:
        print_line(f"{done.record['saved_as']} has the same content already: not saved again")
    elif done.record["saved_as"]:
        print_line(f"saved as {done.record['saved_as']}")
    elif wanted is not None:
        console.print(f"not saved as {wanted}; --force saves it all the same", style="bold red", markup=False)
    console.print(f"{done.result.seconds:.1f} s, {done.result.full_solves} full solves", markup=False)
    return 1 if refused else 0


# --------------------------------------------------------------------------------------------------------------------


def _batch(options: argparse.Namespace, console: Console, settings: Settings) -> int:
    """``workbench fit batch``: several fits, resumable."""
    batch = read_batch(options.file)
    for job in batch.jobs:
        if job.name in (*BATCH_FILES, MARK):
            raise InputError(str(options.file), "name", job.name,
                             f"another name: {job.name} is a file of the batch itself")
    # Fits of devices that were removed from the file are separate results.
    folder = output_folder(options, Outputs("fit batch", kept=("*/*",), names=(
        *BATCH_FILES, *(f"{job.name}/{name}" for job in batch.jobs
                                                      for name in fit_files(job)))))
    if any(job.save is not None for job in batch.jobs):
        saving_folder(settings.materials)
    # Every file is checked before the first fit, so that a mistake in the last one is found early.
    records = {job.name: None if options.again else known(job, settings, folder) for job in batch.jobs}
    waiting = [job for job in batch.jobs if records[job.name] is None]
    if options.only is not None:
        chosen = {job.name: job for job in batch.jobs}
        return _one_of_batch(chosen[choose(options.only, chosen, source=str(options.file), field="--only")], settings,
                             folder, console)
    for name, record in records.items():
        if record is not None:
            console.print(f"{name}: finished before, --again repeats it", markup=False)
    for job in waiting:
        # Otherwise the result of an earlier fit would replace that of a failed one.
        discard(folder / job.name / "fit.json")
    with (executor_option(options) as (executor, jobs), progress_bars(console) as show,
          begin_workers(min(jobs, len(waiting) or 1), executor) as workers):
        failed = fit_all(waiting, settings, folder, workers, show)
    for job in waiting:
        records[job.name] = known(job, settings, folder)
    finished = {name: record for name, record in records.items() if record is not None}
    columns = summarise(finished)
    write_json(folder / "summary.json", summary_record(batch.name, columns, finished, failed))
    write_batch_report(folder, batch.name, columns, finished, failed)
    print_table(batch.name, devices_table(finished))
    if columns:
        print_table("quantities over the devices", batch_columns_table(columns))
    for name, words in failed.items():
        console.print(f"{name}: {words}", style="bold red", markup=False)
    for name, record in finished.items():
        for text in record["refusals"]:
            console.print(f"{name}, not accepted: {text}", style="bold red", markup=False)
    return 1 if failed or any(not record["accepted"] for record in finished.values()) else 0


def _one_of_batch(job: Job, settings: Settings, folder: Path, console: Console) -> int:
    with progress_bars(console) as show:
        done = run_job(job, settings, folder / job.name, progress=partial(show, job.name))
        show(job.name, "done", 1.0)
    return _print_results(done, console, job.save)


def fit_all(jobs: Sequence[Job], settings: Settings, folder: Path, workers: Workers, show: Show) -> dict[str, str]:
    """Fit jobs into their own folders. The errors of failed jobs are returned by name. Finished fits stay when the rest
    is interrupted."""
    failed: dict[str, str] = {}

    def tasks() -> Iterator[tuple[str, Task[None]]]:
        for job in jobs:
            show(job.name, "fitting", 0.0)
            yield job.name, partial(_fitted, job, settings, folder / job.name)

    for name, done in workers.completed(tasks()):
        error = done.exception()
        if error is not None:
            failed[name] = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
        show(name, "done" if error is None else "failed", 1.0)
    return failed


@one_thread()
def _fitted(job: Job, settings: Settings, folder: Path) -> None:
    if run_job(job, settings, folder).result.interrupted:
        raise KeyboardInterrupt
