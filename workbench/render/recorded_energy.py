"""Recorded focusing over the simulated energy density in a cavity."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from workbench.render.canvas import new_figure, save_figure
from workbench.render.plots import LINE_COLOURS, tidy

if TYPE_CHECKING:
    from workbench.simulation.energy_comparison import EnergyComparison


def draw_recorded_energy(compared: EnergyComparison, path: Path | str, *, title: str = "") -> Path:
    """Draw recorded points over the simulated mean energy density per Vpp^2. They have bars of two standard deviations
    if stated. The fitted peaks are dashed, and every peak has a line."""
    recording, spectrum, scale = compared.recording, compared.spectrum, 1.0 / compared.scaled_by
    figure = new_figure(8.0, 4.5)
    axes = figure.subplots()
    line, dots = LINE_COLOURS[:2]
    axes.plot(spectrum.frequency / 1e6, spectrum.per_square_volt, color=line, label="simulated")
    fine = np.linspace(recording.frequency[0], recording.frequency[-1], 500)
    axes.plot(fine / 1e6, compared.fit.at(fine) * scale, color=dots, linestyle="--", label="fitted peaks")
    spread, rate = recording.relative_uncertainty, recording.rate * scale
    bars = None if spread is None else rate * np.array([-np.expm1(-2.0 * spread), np.expm1(2.0 * spread)])
    axes.errorbar(recording.frequency / 1e6, rate, bars, color=dots, linestyle="", marker="o", markersize=4.0,
                  elinewidth=0.8, label="recorded" if recording.is_absolute else f"recorded, over {1.0 / scale:.3g}")
    for pair in compared.peaks:
        for peak, colour in ((pair.simulated, line), (pair.recorded, dots)):
            if peak is not None:
                axes.axvline(peak.frequency / 1e6, color=colour, linewidth=0.8, linestyle=":", zorder=1)
    axes.set_yscale("log")
    axes.set_ylabel("mean E_ac (J/m³ per Vpp²)")
    axes.set_xlabel("frequency (MHz)")
    axes.set_title(title)
    axes.legend(frameon=False)
    tidy(axes, both=True)
    figure.tight_layout()
    return save_figure(figure, Path(path))
