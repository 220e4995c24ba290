"""``workbench compare``."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from geometry.chip import read_chip
from workbench.commands.asked import asked_model, asked_reading, output_folder
from workbench.commands.states import run_state
from workbench.commands.tables import model_table, origin_table
from workbench.commands.terminal import print_paragraph, print_table, progress_bars, say_finding
from workbench.files.errors import InputError
from workbench.report.figures import figures_record, measured_figures
from workbench.report.page import Block, Note, Picture, TextTable, number_text, write_json, write_report
from workbench.report.simulations import comparison_record, simulation_record
from workbench.results.spectrum import write_spectrum

if TYPE_CHECKING:
    from rich.console import Console

    from workbench.results.comparison import Comparison


#: Reduced chi-square below which a simulation is said to agree with a recording whose uncertainty is known. Doubled,
#: a systematic difference as large as the noise is called agreement.
AGREES = 1.5


def run_compare(options: argparse.Namespace, console: Console) -> int:
    """``workbench compare``: a recording beside the simulation of a chip."""
    from workbench.render import plots
    from workbench.results.comparison import compare as compare_spectra

    reading = asked_reading(options, options.recording, console)
    measured = reading.spectrum
    chip = read_chip(options.chip)
    asked = asked_model(options, chip)
    asked = replace(asked, band=_common_band(options, asked.band, measured.frequency),
                    points=max(asked.points, 2 * len(measured.frequency) - 1))
    folder = output_folder(options.output)
    with progress_bars(console) as show:
        run = run_state(chip, options.state, asked, show)
        show(run.state, "done", 1.0)
    comparison = compare_spectra(measured, run.spectrum)
    write_spectrum(run.spectrum, folder / "spectrum.csv")
    spectra = {"measured": measured, "simulated": run.spectrum}
    residual = comparison.log_residual
    pictures = [
        Picture(plots.draw_spectra(spectra, folder / "impedance.png", measured=["measured"], title=chip.name),
                "impedance, measured and simulated"),
        Picture(plots.draw_residuals(
            comparison.measured.frequency,
            {"magnitude (%)": 100.0 * np.expm1(residual.real), "phase (degrees)": np.degrees(residual.imag)},
            folder / "residual.png", label="simulated against measured", title=chip.name,
        ), "residual: relative error of |Z| in per cent and error of phase in degrees"),
    ]
    merit, reason = measured_figures(measured)
    write_json(folder / "merit.json", {
        "chip": chip.name, "recording": str(options.recording), "state": run.state,
        "read_as": reading.read_as or None,
        "findings": [str(finding) for finding in reading.findings],
        "measured": figures_record(merit, reason), "simulated": simulation_record(run),
        "comparison": comparison_record(comparison),
    })
    rows = TextTable(("", "measured", "simulated", "difference (%)"), tuple(
        (row.metric.removesuffix(" factor"), number_text(row.measured, 6), number_text(row.simulated, 6),
         f"{row.difference_percent:+.2f}")
        for row in comparison.rows))
    summary = TextTable(("over the common band", "value"), (
        ("MAPE of |Z| (%)", number_text(comparison.mape_percent)),
        ("rms of ln(Z_sim / Z_meas)", number_text(comparison.rms_log_residual)),
        ("mean, largest error of phase (degrees)",
         f"{comparison.phase_mean_deg:.2f}, {comparison.phase_max_deg:.2f}"),
        ("largest error of |Z| (%) and where", f"{comparison.worst_percent:.1f} at "
         f"{comparison.worst_frequency / 1e6:.4f} MHz"),
        ("measured points used", f"{100.0 * comparison.fraction_used:.1f} %"),
    ))
    notes: list[Block] = [Note(text) for text in (*map(str, reading.findings), *run.findings)]
    if comparison.rows_missing:
        notes.append(Note(comparison.rows_missing))
    next_step = what_next(comparison, options.chip, options.recording)
    materials_used = ", ".join(f"{region}: {m.name}" for region, m in run.problem.materials.items())
    write_report(folder / "report.html", f"{chip.name}: measured and simulated", [
        ("How far apart", [*notes, rows, summary, f"Nothing was fitted. Materials as filed: {materials_used}.",
                          next_step]),
        ("Where in frequency", list(pictures)),
        ("The recording", [origin_table(measured.origin)]),
        ("The model", [model_table([run])]),
    ])
    print_table(f"{chip.name}, {run.state}", rows)
    print_table("", summary)
    print_paragraph(next_step)
    for text in (*(finding.message for finding in reading.findings), *run.findings):
        say_finding(text, console)
    return 0


def what_next(comparison: Comparison, chip: Path, recording: Path) -> str:
    """The next step after a comparison: none, or the commands that find where the difference comes from."""
    if comparison.reduced_chi_square is not None and comparison.reduced_chi_square < AGREES:
        return ("The simulation agrees with the recording within their uncertainties: there is nothing here to fit or "
                "to diagnose.")
    return (f"Next: `workbench sensitivity {chip} -o out/sensitivity` ranks the numbers that move this spectrum. To "
            f"find which of them explain the difference, name {recording}, the state and what is known of the device "
            "in a campaign file (docs/diagnosis.md has one) and run `workbench diagnose CAMPAIGN.toml`; of a bare "
            "transducer or a polymer on one, `workbench fit` finds the material.")


def _common_band(
    options: argparse.Namespace, band: tuple[float, float], recorded: NDArray[np.float64]
) -> tuple[float, float]:
    """Where the band asked for and the recording overlap (Hz): simulating more would have nothing to be compared with.

    Raises:
        InputError: fewer than two recorded points lie in the band.
    """
    inside = recorded[(recorded >= band[0]) & (recorded <= band[1])]
    if inside.size < 2:
        raise InputError(
            str(options.recording), "frequency", f"{recorded[0]:g} to {recorded[-1]:g} Hz",
            f"2 points or more in the band of {options.chip}, {band[0]:g} to {band[1]:g} Hz; --from and --to set "
            "another band")
    return max(band[0], float(recorded[0])), min(band[1], float(recorded[-1]))
