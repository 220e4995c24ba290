"""A chip that its drive warms: its energy over drive and temperature."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from workbench.model.drive import GeneratorDrive, PowerDrive, VoltageDrive
from workbench.render.canvas import new_figure, save_figure
from workbench.render.plots import LINE_COLOURS, tidy

if TYPE_CHECKING:
    from workbench.simulation.warm import WarmState

#: Rises (K) of the drawn peaks, and half width of the frequency axis relative to the peak's frequency.
RISES, SHOWN = (0.0, 2.0, 5.0, 10.0), 0.01

#: Points of a curve over frequency, and intervals between two points of a curve over the drive.
POINTS, BETWEEN = 240, 8


def draw_warmth(state: WarmState, path: Path | str, *, title: str = "") -> Path:
    """Draw the energy density of a cold and a warming chip. It is over the drive; below it is the peak of the energy
    over frequency, at several temperatures of the liquid."""
    figure = new_figure(8.0, 6.5)
    above, below = figure.subplots(2, 1)
    match state.drive:
        case VoltageDrive(size):
            label, power = "voltage at the electrodes (Vpp)", 1.0
        case GeneratorDrive(size):
            label, power = "open-circuit voltage of the generator (Vpp)", 1.0
        case PowerDrive(size):
            label, power = "electrical input power (W)", 2.0
        case _:
            label, power, size = "times the voltage of the drive", 1.0, 1.0
    curve = state.curve
    known = np.isfinite(curve.factor) & (curve.factor >= 0.0)
    factor = curve.factor[known]
    even = np.linspace(0.0, factor.max(initial=1.0), POINTS)
    above.plot(size * even**power, state.cold.energy_density * even**2, "--", color=LINE_COLOURS[0],
               label=f"kept at {state.stated - 273.15:.3g} °C")
    # The ratio of the energy to the square of the drive varies slowly, so it is interpolated.
    ratio = np.where(factor > 0.0, curve.energy_density[known] / np.maximum(factor, 1e-9) ** 2,
                     state.cold.energy_density)
    place, between = np.arange(factor.size), np.linspace(0, factor.size - 1, (factor.size - 1) * BETWEEN + 1)
    finer = np.interp(between, place, factor)
    above.plot(size * finer**power, np.interp(between, place, ratio) * finer**2, color=LINE_COLOURS[1],
               label="driven steadily")
    if state.here is not None:
        above.plot([size], [state.here.energy_density], "o", color=LINE_COLOURS[1])
    above.set_ylim(0.0, 2.0 * float(np.nanmax(curve.energy_density[known], initial=1e-9)))
    above.set_xlim(0.0)
    above.set_xlabel(label)
    above.set_ylabel("mean E_ac (J/m³)")
    above.set_title(title)
    above.legend(frameon=False)
    rises = [rise for rise in RISES if rise <= curve.rise[-1]]
    middle = state.cold.frequency
    shift = abs(state.peak_per_kelvin or 0.0) * rises[-1] / middle
    low, high = (0.5 * SHOWN, SHOWN + 2.0 * shift)
    if (state.peak_per_kelvin or 0.0) < 0.0:
        low, high = high, low
    frequency = middle * np.linspace(1.0 - low, 1.0 + high, POINTS)
    for index, rise in enumerate(rises):
        below.plot(frequency / 1e6, state.evaluate(rise, frequency), color=LINE_COLOURS[index % len(LINE_COLOURS)],
                   label=f"{state.stated + rise - 273.15:.3g} °C")
    below.axvline(middle / 1e6, color="black", linewidth=0.8, linestyle=":")
    below.set_xlabel("frequency (MHz)")
    below.set_ylabel("mean E_ac (J/m³), this drive")
    below.legend(frameon=False, title="liquid at")
    for axes in (above, below):
        tidy(axes, both=True)
    figure.tight_layout()
    return save_figure(figure, Path(path))
