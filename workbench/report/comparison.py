"""A recording beside the simulation of its chip, as tables, as a record and as a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from workbench.render.plots import draw_residuals, draw_spectra
from workbench.report.figures import origin_table
from workbench.report.page import Block, Note, Picture, TextTable, number_text, write_report
from workbench.report.resonances import resonance_notes, resonances_table
from workbench.report.simulation import model_table
from workbench.results.circuit import CircuitFit
from workbench.results.comparison import Comparison
from workbench.results.spectrum import Spectrum
from workbench.simulation.run import Simulation

#: Reduced chi-square below which a simulation is said to agree with a recording whose uncertainty is known. Doubled,
#: a systematic difference as large as the noise is called agreement.
AGREES = 1.5


def compared_figures_table(comparison: Comparison) -> TextTable:
    """Every figure that both spectra have, measured and simulated."""
    return TextTable(("", "measured", "simulated", "difference (%)"), tuple(
        (row.metric.removesuffix(" factor"), number_text(row.measured, 6), number_text(row.simulated, 6),
         f"{row.difference_percent:+.2f}")
        for row in comparison.rows))


def distance_table(comparison: Comparison) -> TextTable:
    """Distances of the two spectra over their common band."""
    return TextTable(("over the common band", "value"), (
        ("MAPE of |Z| (%)", number_text(comparison.mape_percent)),
        ("rms of ln(Z_sim / Z_meas)", number_text(comparison.rms_log_residual)),
        ("mean, largest error of phase (degrees)",
         f"{comparison.phase_mean_deg:.2f}, {comparison.phase_max_deg:.2f}"),
        ("largest error of |Z| (%) and where", f"{comparison.worst_percent:.1f} at "
         f"{comparison.worst_frequency / 1e6:.4f} MHz"),
        ("measured points used", f"{100.0 * comparison.fraction_used:.1f} %"),
    ))


def what_next(comparison: Comparison, chip: Path, recording: Path, state: str) -> str:
    """The next step after a comparison: none, or the commands that find where the difference comes from."""
    if comparison.reduced_chi_square is not None and comparison.reduced_chi_square < AGREES:
        return ("The simulation agrees with the recording within their uncertainties: there is nothing here to fit or "
                "to diagnose.")
    return (f"Next: `workbench sensitivity {chip} -o out/sensitivity` ranks the numbers that move this spectrum. "
            f"`workbench diagnose {recording} --chip {chip} --state {state} -o out/diagnosis` finds which of them, or "
            "which physics that the model lacks, explain the difference; several states of one device tell more, in a "
            "campaign file (docs/diagnosis.md has one). Of a bare transducer or a polymer on one, `workbench fit` "
            "finds the material.")


def comparison_record(comparison: Comparison) -> dict[str, Any]:
    """A comparison for a JSON file."""
    return {
        "mape_percent": comparison.mape_percent, "rms_log_residual": comparison.rms_log_residual,
        "phase_mean_deg": comparison.phase_mean_deg, "phase_max_deg": comparison.phase_max_deg,
        "worst_percent": comparison.worst_percent, "worst_frequency_hz": comparison.worst_frequency,
        "fraction_used": comparison.fraction_used, "reduced_chi_square": comparison.reduced_chi_square,
        "figures": {row.metric: {"measured": row.measured, "simulated": row.simulated,
                                 "difference_percent": row.difference_percent} for row in comparison.rows},
        "figures_missing": comparison.rows_missing,
    }


def write_comparison_report(
    measured: Spectrum, run: Simulation, comparison: Comparison, folder: Path, *, findings: Sequence[str],
    next_step: str, resonances: Mapping[str, CircuitFit | None],
) -> Path:
    """``report.html``: how far apart, where in frequency, and of what; `findings` are those of the recording's reader,
    `resonances` those of both spectra.
    """
    title, residual = run.chip.name, comparison.log_residual
    spectra = draw_spectra({"measured": measured, "simulated": run.spectrum}, folder / "impedance.png",
                           measured=["measured"], title=title)
    residuals = draw_residuals(
        comparison.measured.frequency,
        {"magnitude (%)": 100.0 * np.expm1(residual.real), "phase (degrees)": np.degrees(residual.imag)},
        folder / "residual.png", label="simulated against measured", title=title)
    notes: list[Block] = [Note(text) for text in (*findings, *run.findings)]
    if comparison.rows_missing:
        notes.append(Note(comparison.rows_missing))
    materials_used = ", ".join(f"{region}: {m.name}" for region, m in run.problem.materials.items())
    return write_report(folder / "report.html", f"{title}: measured and simulated", [
        ("How far apart", [*notes, compared_figures_table(comparison), distance_table(comparison),
                           f"Nothing was fitted. Materials as filed: {materials_used}.", next_step]),
        ("Where in frequency", [
            Picture(spectra, "impedance, measured and simulated"),
            Picture(residuals, "residual: relative error of |Z| in per cent and error of phase in degrees"),
            resonances_table(resonances), *resonance_notes(resonances)]),
        ("The recording", [origin_table(measured.origin)]),
        ("The model", [model_table([run])]),
    ])
