"""``workbench diagnose``."""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from typing import TYPE_CHECKING

from geometry.chip import read_chip
from materials.registry import user_registry
from workbench.campaign.campaign import Campaign, read_campaign
from workbench.commands.parsed_options import (
    accuracy_option,
    band_option,
    executor_option,
    output_folder,
    reading_option,
    say_read_as,
)
from workbench.commands.terminal import print_paragraph, print_table, progress_bars, say_finding
from workbench.diagnosis.appraisal import diagnose
from workbench.diagnosis.known_physics import contributions
from workbench.diagnosis.outcome import Diagnosis
from workbench.files.errors import InputError
from workbench.files.ownership import Outputs
from workbench.files.quantities import ProgramSource
from workbench.files.writing import write_json
from workbench.readers import READ_AS
from workbench.report.diagnosis import (
    RESIDUAL,
    diagnosis_record,
    established_table,
    remainder_table,
    write_diagnosis_report,
    write_stopped,
)

if TYPE_CHECKING:
    from rich.console import Console

#: Exit statuses of an incomplete diagnosis: by Ctrl-C, and by the end of its minutes.
INTERRUPTED, NOT_FINISHED = 130, 3

#: Files of `diagnose`.
OUTPUTS = Outputs("diagnose", names=("report.html", "diagnosis.json", "states.png", "shares.png", "where.png"))


def run_diagnose(options: argparse.Namespace, console: Console) -> int:
    """``workbench diagnose``: locate differences and attribute them to physics.

    If incomplete, it returns :data:`INTERRUPTED` or :data:`NOT_FINISHED`, and the results claim nothing.
    """
    accuracy, minutes = accuracy_option(options), options.minutes
    if minutes is not None and not minutes > 0.0:
        raise InputError("command line", "--minutes", minutes, "more than no time")
    campaign = (_of_file if options.chip is None else _of_one_recording)(options, console)
    folder = output_folder(options, OUTPUTS)
    started = time.perf_counter()
    try:
        with executor_option(options) as (executor, jobs), progress_bars(console) as show:
            found = diagnose(campaign, accuracy=accuracy, jobs=jobs, executor=executor, minutes=minutes,
                             progress=lambda text, share: show(campaign.name, text, share))
            show(campaign.name, "done" if found.provisional is None else "not finished", 1.0)
    except KeyboardInterrupt:
        write_stopped(campaign, folder, time.perf_counter() - started)
        raise
    # The result is written first, in case one of the next steps fails.
    record = diagnosis_record(found)
    write_json(folder / "diagnosis.json", {**record, "known_physics": []})
    known = contributions(found)
    write_json(folder / "diagnosis.json", {**record, "known_physics": [row._asdict() for row in known]})
    write_diagnosis_report(found, known, folder)
    print_diagnosis(found)
    if found.provisional is None:
        return 0
    console.print(f"not finished; the results so far are in {folder}", style="yellow", markup=False)
    return INTERRUPTED if found.found.interrupted else NOT_FINISHED


def print_diagnosis(found: Diagnosis) -> None:
    """Print headline, established effects, residuals and the next measurement."""
    print_paragraph(found.headline)
    if found.established:
        print_table("", established_table(found))
    print_table(RESIDUAL, remainder_table(found))
    for text in (*found.findings, found.next_measurement):
        if text:
            print_paragraph(text)


def _of_file(options: argparse.Namespace, console: Console) -> Campaign:
    found = read_campaign(options.diagnosed, materials=options.materials)
    for state in found.states:
        say_read_as(state.measured.origin.settings.get(READ_AS, ""), state.name, console)
        for text in state.findings:
            say_finding(f"{state.name}: {text}", console)
    return found


def _of_one_recording(options: argparse.Namespace, console: Console) -> Campaign:
    """The campaign of one recording and its chip file.

    It has one state, and the priors in the files of the chip and its materials.

    Raises:
        InputError: a mistake in the options or the files, or a recording that cannot be of this chip.
    """
    reading, chip = reading_option(options, options.diagnosed, console), read_chip(options.chip)
    name = chip.state(options.state).name
    state = {"chip": chip, "state": name, "recording": reading, "noise": options.noise,
             "band": band_option(options, chip)}
    try:
        found = Campaign({name: state}, name=chip.name, registry=user_registry(options.materials),
                         source=ProgramSource("command line"))
    except InputError as error:
        # A key of the state is an option here, and its recording a file.
        key = f"states.{name}."
        source = str(options.diagnosed) if error.source == f"{key}recording" else error.source
        raise replace(error, source=source, field=error.field.replace(key, "--")) from None
    for finding in reading.findings:
        say_finding(finding.message, console)
    return found
