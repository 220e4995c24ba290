"""``workbench diagnose``."""

from __future__ import annotations

import argparse
import time
from typing import TYPE_CHECKING

from workbench.commands.parsed_options import accuracy_option, jobs_option, output_folder, say_read_as
from workbench.commands.terminal import print_paragraph, print_table, progress_bars
from workbench.diagnosis.appraisal import diagnose
from workbench.diagnosis.campaign import read_campaign
from workbench.diagnosis.known_physics import contributions
from workbench.diagnosis.outcome import Diagnosis
from workbench.files.errors import InputError
from workbench.files.writing import write_json
from workbench.readers import READ_AS
from workbench.report.diagnosis import (
    LEFT,
    diagnosis_record,
    established_table,
    remainder_table,
    write_diagnosis_report,
    write_stopped,
)

if TYPE_CHECKING:
    from rich.console import Console

#: Exit statuses of a diagnosis that was cut short: by Ctrl-C, and by the end of its minutes.
INTERRUPTED, NOT_FINISHED = 130, 3


def run_diagnose(options: argparse.Namespace, console: Console) -> int:
    """``workbench diagnose``: what differs, where, which physics, how sure, what else it could be.

    Cut short, it returns :data:`INTERRUPTED` or :data:`NOT_FINISHED`, and what it writes claims nothing.
    """
    accuracy, (jobs, minutes) = accuracy_option(options), _effort_options(options)
    campaign = read_campaign(options.campaign, materials=options.materials)
    folder = output_folder(options.output)
    for state in campaign.states:
        say_read_as(state.measured.origin.settings.get(READ_AS, ""), state.name, console)
    started = time.perf_counter()
    try:
        with progress_bars(console) as show:
            found = diagnose(campaign, accuracy=accuracy, jobs=jobs, minutes=minutes,
                             progress=lambda text, share: show(campaign.name, text, share))
            show(campaign.name, "done" if found.provisional is None else "not finished", 1.0)
    except KeyboardInterrupt:
        write_stopped(campaign, folder, time.perf_counter() - started)
        raise
    # Whatever ends what follows, the result is kept.
    record = diagnosis_record(found)
    write_json(folder / "diagnosis.json", {**record, "known_physics": []})
    known = contributions(found)
    write_json(folder / "diagnosis.json", {**record, "known_physics": [row._asdict() for row in known]})
    write_diagnosis_report(found, known, folder)
    print_diagnosis(found)
    if found.provisional is None:
        return 0
    console.print(f"not finished; what is known so far is in {folder}", style="yellow", markup=False)
    return INTERRUPTED if found.interrupted else NOT_FINISHED


def print_diagnosis(found: Diagnosis) -> None:
    """Headline, established effects, the remainder of each state, and the next measurement, to standard output."""
    print_paragraph(found.headline)
    if found.established:
        print_table("", established_table(found))
    print_table(LEFT, remainder_table(found))
    for text in (*found.findings, found.next_measurement):
        if text:
            print_paragraph(text)


def _effort_options(options: argparse.Namespace) -> tuple[int, float | None]:
    """Processes and minutes that the options ask for.

    Raises:
        InputError: no process, or no time.
    """
    if options.minutes is not None and not options.minutes > 0.0:
        raise InputError("command line", "--minutes", options.minutes, "more than no time")
    return jobs_option(options), options.minutes
