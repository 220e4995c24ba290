"""Recorded focusing over frequency beside the simulated energy, as a table, as a record and as a page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from workbench.render.recorded_energy import draw_recorded_energy
from workbench.report.page import Answer, Note, Picture, TextTable, number_text, write_report
from workbench.report.simulation import ENERGY_PICTURE, model_table
from workbench.results.lorentzian import FittedPeak
from workbench.simulation.energy_comparison import EnergyComparison
from workbench.simulation.run import Simulation


def compared_peaks_table(compared: EnergyComparison) -> TextTable:
    """Every peak with its frequency, Q and, if they are absolute, energies: recorded, simulated, differences."""
    rows = []
    for number, pair in enumerate(compared.peaks, 1):
        recorded, simulated = pair.recorded, pair.simulated
        label = f"peak {number}: " if len(compared.peaks) > 1 else ""
        rows.append((
            f"{label}f (MHz)", "" if recorded is None else f"{recorded.frequency / 1e6:.4f}",
            "" if recorded is None else _interval(recorded.frequency_interval, 1e-6, ".4f"),
            "" if simulated is None else f"{simulated.frequency / 1e6:.4f}", _signed(pair.difference, 100.0),
            _signed(pair.widths, 1.0)))
        rows.append((
            f"{label}Q", "" if recorded is None else number_text(recorded.q, 3),
            "" if recorded is None else _interval(recorded.q_interval, 1.0, ".3g"),
            "" if simulated is None or simulated.q is None else number_text(simulated.q, 3),
            _signed(pair.q_difference, 100.0), ""))
        if compared.recording.is_absolute and recorded is not None and simulated is not None:
            rows.append((f"{label}mean E_ac (J/m^3 per Vpp^2)", number_text(recorded.height, 3), "",
                         number_text(simulated.per_square_volt, 3),
                         _signed(simulated.per_square_volt / recorded.height - 1.0, 100.0), ""))
    return TextTable(("", "recorded", "95 % interval", "simulated", "difference (%)", "in recorded widths"),
                     tuple(rows))


def _interval(interval: tuple[float, float] | None, factor: float, form: str) -> str:
    return "not determined" if interval is None else " to ".join(format(factor * end, form) for end in interval)


def _signed(value: float | None, factor: float) -> str:
    return "" if value is None else f"{factor * value:+.3g}"


def recording_table(compared: EnergyComparison) -> TextTable:
    """The recording and its fit: file, columns, points, scatter, and the evidence for two peaks."""
    recording, fit = compared.recording, compared.fit
    used = int(compared.inside.sum())
    return TextTable(("recording", "value"), (
        ("file", recording.source), ("quantity", recording.kind), ("read", recording.read_as),
        ("points, compared", f"{recording.frequency.size}, {used}"),
        ("frequencies (MHz)", f"{recording.frequency[0] / 1e6:.4f} to {recording.frequency[-1] / 1e6:.4f}"),
        ("standard deviation of a point (%)",
         f"{100.0 * fit.noise:.3g}, {'as stated' if fit.is_noise_stated else 'from the scatter about the fit'}"),
        ("information criterion, one peak less two", "too few points for two peaks" if fit.preference is None
         else f"{fit.preference:.3g}; two are taken above 6"),
        ("rms of ln(recorded / simulated)", number_text(compared.rms_log_residual, 3))))


def energy_comparison_record(compared: EnergyComparison) -> dict[str, Any]:
    """A comparison for a JSON file."""
    fit = compared.fit
    return {
        "kind": compared.recording.kind, "absolute": compared.recording.is_absolute,
        "points": int(compared.recording.frequency.size), "points_compared": int(compared.inside.sum()),
        "recorded_over_simulated": compared.factor, "rms_log_residual": compared.rms_log_residual,
        "noise_of_a_point": fit.noise, "noise_is_stated": fit.is_noise_stated,
        "preference_for_two_peaks": fit.preference,
        "peaks": [{
            "recorded": None if pair.recorded is None else _recorded_record(pair.recorded),
            "simulated": None if pair.simulated is None else {
                "frequency_hz": pair.simulated.frequency, "q": pair.simulated.q,
                "mean_energy_density_j_m3_per_vpp2": pair.simulated.per_square_volt},
            "difference": pair.difference, "difference_in_recorded_widths": pair.widths,
            "q_difference": pair.q_difference} for pair in compared.peaks],
    }


def _recorded_record(peak: FittedPeak) -> dict[str, Any]:
    return {"frequency_hz": peak.frequency, "frequency_95_hz": peak.frequency_interval, "q": peak.q,
            "q_95": peak.q_interval, "height": peak.height, "points_within_half_power": peak.points}


def write_energy_comparison(compared: EnergyComparison, run: Simulation, folder: Path) -> Path:
    """``report.html``: the peaks side by side, the curves, the recording and the model."""
    picture = draw_recorded_energy(compared, folder / ENERGY_PICTURE, title=run.chip.name)
    title = f"{run.chip.name}, {run.state}: focusing recorded and simulated"
    materials = ", ".join(f"{region}: {m.name}" for region, m in run.problem.materials.items())
    return write_report(folder / "report.html", title, [
        ("Where the peaks are", [compared_peaks_table(compared), Answer(compared.basis),
                                 *(Note(text) for text in (*compared.findings, *run.findings)),
                                 f"Nothing of the chip was fitted. Materials as filed: {materials}."]),
        ("Over frequency", [Picture(picture, "recorded focusing over the simulated energy in the cavity, at a constant "
                                             "voltage at the electrodes; dotted lines are the peaks")]),
        ("The recording", [recording_table(compared)]),
        ("The model", [model_table([run])]),
    ])
