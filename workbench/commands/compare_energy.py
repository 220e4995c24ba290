"""``workbench compare`` of a table of focusing over frequency."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from geometry.chip import read_chip
from workbench.commands.parsed_options import model_options, output_folder, say_read_as
from workbench.commands.states import run_state
from workbench.commands.terminal import print_paragraph, print_table, progress_bars, say_finding
from workbench.files.errors import InputError
from workbench.files.ownership import Outputs
from workbench.files.quantities import frequency_text, in_another_unit
from workbench.files.writing import write_json
from workbench.model.problem import fill
from workbench.readers.energy_table import read_energy_recording, recognises_energy
from workbench.readers.text import load_text
from workbench.report.energy_comparison import (
    compared_peaks_table,
    energy_comparison_record,
    write_energy_comparison,
)
from workbench.report.simulation import simulation_record
from workbench.results.spectrum import write_spectrum
from workbench.simulation.energy_comparison import compare_energy

if TYPE_CHECKING:
    from rich.console import Console


def is_of_energy(options: argparse.Namespace) -> bool:
    """Whether the recording is a table of focusing. One with stated columns or format is of impedance."""
    return options.columns is None and options.format is None and recognises_energy(load_text(options.recording))


def run_compare_energy(options: argparse.Namespace, outputs: Outputs, console: Console) -> int:
    """Compare recorded focusing with the simulated energy of the sound.

    Raises:
        InputError: a mistake in the table, a correction of impedances, a state without a liquid, or no common band.
    """
    for field, value in (("--correction", options.correction), ("--without-outliers", options.without_outliers)):
        if value:
            raise InputError("command line", field, value, f"no such option: {options.recording} has focusing over "
                             "frequency, no impedance")
    recording = read_energy_recording(options.recording)
    say_read_as(recording.read_as, options.recording.name, console)
    chip = read_chip(options.chip)
    model = model_options(options, chip)
    state = chip.state(options.state).name
    if not fill(chip, state, model.registry).is_wet:
        raise InputError(str(options.chip), f"states.{state}.cavity", state, "a state with a liquid in its cavity; "
                         "--state names another one")
    inside = (recording.frequency >= model.band[0]) & (recording.frequency <= model.band[1])
    if inside.sum() < 2:
        raise InputError(
            str(options.recording), "frequency", frequency_text(*recording.frequency[[0, -1]]),
            f"2 points or more in the band of {options.chip}, {frequency_text(*model.band)}; --from and "
            "--to set another band", in_another_unit(model.band, *recording.frequency[[0, -1]]))
    folder = output_folder(options, outputs)
    with progress_bars(console) as show:
        run = run_state(chip, state, model, show)
        show(run.state, "done", 1.0)
    compared = compare_energy(recording, run, registry=model.registry)
    write_spectrum(run.spectrum, folder / "spectrum.csv")
    write_json(folder / "merit.json", {
        "chip": chip.name, "recording": str(options.recording), "state": run.state, "read_as": recording.read_as,
        "findings": list(compared.findings), "simulated": simulation_record(run),
        "energy_comparison": energy_comparison_record(compared),
    })
    write_energy_comparison(compared, run, folder)
    print_table(f"{chip.name}, {run.state}", compared_peaks_table(compared))
    print_paragraph(compared.basis)
    for text in (*compared.findings, *run.findings):
        say_finding(text, console)
    return 0
