"""``workbench compare``."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING

from geometry.chip import read_chip
from geometry.straight import check_stated_length
from materials.assumed import with_assumed_loss
from workbench.commands.compare_energy import is_of_energy, run_compare_energy
from workbench.commands.parsed_options import common_band, model_options, output_folder, reading_option
from workbench.commands.states import run_state
from workbench.commands.terminal import print_paragraph, print_table, progress_bars, say_finding
from workbench.files.ownership import Outputs
from workbench.files.writing import write_json
from workbench.model.problem import fill
from workbench.report.comparison import (
    compared_figures_table,
    comparison_record,
    distance_table,
    likely_causes,
    what_next,
    write_comparison_report,
)
from workbench.report.figures import figures_record
from workbench.report.resonances import resonance_notes, resonances_record, resonances_table
from workbench.report.simulation import ENERGY_PICTURE, simulation_record
from workbench.results.comparison import compare
from workbench.results.coupling import plate_of
from workbench.results.merit import measured_figures
from workbench.results.resonances import resonances_of
from workbench.results.spectrum import write_spectrum

if TYPE_CHECKING:
    from rich.console import Console

#: Files of `compare`.
OUTPUTS = Outputs("compare", names=("report.html", "merit.json", "spectrum.csv", "impedance.png", "residual.png",
                                    ENERGY_PICTURE))


def run_compare(options: argparse.Namespace, console: Console) -> int:
    """``workbench compare``: compare a recording with the simulation of a chip. The recording is of impedance or of
    focusing."""
    if is_of_energy(options):
        return run_compare_energy(options, OUTPUTS, console)
    reading = reading_option(options, options.recording, console)
    measured, found = reading.spectrum, [finding.message for finding in reading.findings]
    chip = read_chip(options.chip)
    check_stated_length(chip.measure, chip.file, "the impedance, which the recording is compared with,")
    model = model_options(options, chip)
    model = replace(model, band=common_band(options, model.band, measured.frequency),
                    points=max(model.points, 2 * len(measured.frequency) - 1))
    folder = output_folder(options, OUTPUTS)
    with progress_bars(console) as show:
        run = run_state(chip, options.state, model, show)
        show(run.state, "done", 1.0)
    comparison = compare(measured, run.spectrum)
    write_spectrum(run.spectrum, folder / "spectrum.csv")
    merit, reason = measured_figures(measured, plate_of(chip, run.problem.materials))
    if merit is not None and merit.is_weak:
        found.append(f"the recording: {merit.weakness}")
    resonances = {"measured": resonances_of(comparison.measured), "simulated": run.resonances}
    stated = fill(chip, run.state, model.registry).materials.values()
    found += likely_causes(comparison, run, resonances["measured"], assumed=model.assumed_losses,
                           doubtful=any(finding.code == "radians" for finding in reading.findings),
                           lossless=sorted({each.name for each in stated if with_assumed_loss(each)[1]}))
    write_json(folder / "merit.json", {
        "chip": chip.name, "recording": str(options.recording), "state": run.state,
        "read_as": reading.read_as or None,
        "findings": found,
        "measured": {**figures_record(merit, reason), "circuit": resonances_record(resonances["measured"])},
        "simulated": simulation_record(run),
        "comparison": comparison_record(comparison),
    })
    next_step = what_next(comparison, options.chip, options.recording, run.state)
    write_comparison_report(measured, run, comparison, folder, findings=found,
                            next_step=next_step, resonances=resonances)
    print_table(f"{chip.name}, {run.state}", compared_figures_table(comparison))
    print_table("", distance_table(comparison))
    print_table("", resonances_table(resonances))
    for text in (*resonance_notes(resonances), next_step):
        print_paragraph(text)
    for text in (*found, *run.findings):
        say_finding(text, console)
    return 0

