"""Recorded focusing beside the simulated energy: tables, record and page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from workbench.render.recorded_energy import draw_recorded_energy
from workbench.report.page import Picture, TextTable, in_unit, table, write_report
from workbench.report.record import attribute, record
from workbench.report.simulation import ENERGY_PICTURE, model_table
from workbench.simulation.energy_comparison import EnergyComparison
from workbench.simulation.run import Simulation


def compared_peaks_table(compared: EnergyComparison) -> TextTable:
    """Frequency and Q of every peak, recorded and simulated; energies if absolute."""
    rows = []
    for number, pair in enumerate(compared.peaks, 1):
        recorded, simulated = pair.recorded, pair.simulated
        label = f"peak {number}: " if len(compared.peaks) > 1 else ""
        rows += [
            (f"{label}f (MHz)", in_unit(attribute(recorded, "frequency"), "MHz", ".4f"),
             recorded and _interval(recorded.frequency_interval, "MHz", ".4f"),
             in_unit(attribute(simulated, "frequency"), "MHz", ".4f"), pair.difference, pair.widths),
            (f"{label}Q", attribute(recorded, "q"), recorded and _interval(recorded.q_interval, "", ".3g"),
             attribute(simulated, "q"), pair.q_difference, None)]
        if compared.recording.is_absolute and recorded is not None and simulated is not None:
            rows.append((f"{label}mean E_ac (J/m^3 per Vpp^2)", recorded.height, None, simulated.per_square_volt,
                         simulated.per_square_volt / recorded.height - 1.0, None))
    return table(" | recorded:.3g | 95 % interval | simulated:.3g | difference (%):+.3g | in recorded widths:+.3g",
                 rows)


def _interval(interval: tuple[float, float] | None, unit: str, form: str) -> str:
    return "not determined" if interval is None else " to ".join(in_unit(end, unit, form) for end in interval)


def recording_table(compared: EnergyComparison) -> TextTable:
    """The recording, its scatter, and the evidence for two peaks."""
    recording, fit = compared.recording, compared.fit
    low, high = recording.frequency[[0, -1]] / 1e6
    return table("recording | value:.3g", (
        ("file", recording.source), ("quantity", recording.kind), ("read", recording.read_as),
        ("points, compared", f"{recording.frequency.size}, {compared.inside.sum()}"),
        ("frequencies (MHz)", f"{low:.4f} to {high:.4f}"),
        ("standard deviation of a point (%)",
         f"{100.0 * fit.noise:.3g}, {'as stated' if fit.is_noise_stated else 'from the scatter about the fit'}"),
        ("information criterion, one peak less two", "too few points for two peaks" if fit.preference is None
         else f"{fit.preference:.3g}; two are taken above 6"),
        ("rms of ln(recorded / simulated)", compared.rms_log_residual)))


def energy_comparison_record(compared: EnergyComparison) -> dict[str, Any]:
    """A comparison for a JSON file."""
    return record(
        compared, "kind=recording.kind absolute=recording.is_absolute points=recording.frequency.size "
                  "recorded_over_simulated=factor rms_log_residual noise_of_a_point=fit.noise "
                  "noise_is_stated=fit.is_noise_stated preference_for_two_peaks=fit.preference peaks { "
                  "recorded { frequency_hz frequency_95_hz=frequency_interval q q_95=q_interval height "
                  "points_within_half_power=points } "
                  "simulated { frequency_hz q mean_energy_density_j_m3_per_vpp2=per_square_volt } "
                  "difference difference_in_recorded_widths=widths q_difference }") | {
        "points_compared": int(compared.inside.sum())}


def write_energy_comparison(compared: EnergyComparison, run: Simulation, folder: Path) -> Path:
    """Write ``report.html``: peaks, curves, recording and model."""
    picture = draw_recorded_energy(compared, folder / ENERGY_PICTURE, title=run.chip.name)
    return write_report(
        folder / "report.html", f"{run.chip.name}, {run.state}: focusing recorded and simulated", module=__name__,
        values={"compared": compared, "run": run, "model": model_table([run]), "curves": Picture(
            picture, "recorded focusing over the simulated energy in the cavity, at a constant voltage at the "
                     "electrodes; dotted lines are the peaks")})
