"""Along a channel: waves, and the energy between the ends."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from workbench.render.canvas import PLAIN_COLOURS, new_figure, save_figure
from workbench.render.plots import LINE_COLOURS, energy_panels, save_energy, tidy

if TYPE_CHECKING:
    from workbench.simulation.dispersion import GuidedWaves
    from workbench.simulation.finite_length import EnergyProfile, FiniteLength

#: Lowest energy of the colours, in dB below the highest.
_FLOOR = -40.0


def draw_dispersion(found: GuidedWaves, path: Path) -> Path:
    """Draw f over k of the branches. Writes `path`.

    The colour is the share of the energy in the liquid.
    """
    from matplotlib.collections import LineCollection

    figure = new_figure(8.0, 6.0)
    figure.set_layout_engine("constrained")
    axes = figure.subplots()
    for branch in found.branches:
        # Between two wave numbers, the cubic with both group velocities.
        k = np.linspace(branch.wave_number[0], branch.wave_number[-1], 8 * branch.wave_number.size)
        places = np.column_stack([k / 1e3, branch.curve(k) / 1e6])
        liquid = np.interp(0.5 * (k[1:] + k[:-1]), branch.wave_number, branch.liquid)
        lines = LineCollection(list(np.stack([places[:-1], places[1:]], axis=1)), array=liquid, cmap=PLAIN_COLOURS,
                               linewidths=1.8)
        lines.set_clim(0.0, 1.0)
        axes.add_collection(lines)
        axes.plot(branch.wave_number / 1e3, branch.frequency / 1e6, ".", color="black", markersize=2.0)
    axes.set_xlim(0.0, float(found.wave_numbers[-1]) / 1e3)
    axes.set_ylim(found.band[0] / 1e6, found.band[1] / 1e6)
    axes.set_xlabel("wave number along the channel k (1/mm)")
    axes.set_ylabel("frequency (MHz)")
    axes.set_title(f"{found.chip.name}, {found.state}: waves along the channel, Q of {found.least_q:.3g} or more",
                   fontsize=10)
    if found.branches:
        figure.colorbar(lines, ax=axes, label="share of the energy in the liquid")
    tidy(axes)
    return save_figure(figure, path)


def draw_along(found: FiniteLength, profiles: Sequence[EnergyProfile], path: Path) -> Path:
    """Draw the energy along the channel over frequency, and its `profiles`.

    A profile is over its mean, with marks at its maxima. Writes `path`.
    """
    place, density = found.energy_map()
    figure = new_figure(9.0, 7.5)
    figure.set_layout_engine("constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    level = 10.0 * np.log10(density / density.max())
    shown = above.pcolormesh(1e3 * place, found.frequency / 1e6, level, cmap=PLAIN_COLOURS, vmin=_FLOOR, vmax=0.0,
                             shading="nearest", rasterized=True)
    bar = figure.colorbar(shown, ax=[above, below], label="mean energy of the section at constant voltage (dB)")
    bar.ax.tick_params(labelsize=8)
    for colour, each in zip(LINE_COLOURS, profiles, strict=False):
        above.axhline(each.frequency / 1e6, color=colour, linewidth=0.8, linestyle="--")
        relative = each.energy_density / each.energy_density.mean()
        below.plot(1e3 * each.place, relative, color=colour, label=f"{each.frequency / 1e6:.4f} MHz")
        below.plot(1e3 * each.spots, np.interp(each.spots, each.place, relative), "v", color=colour, markersize=5.0)
    above.set_ylabel("frequency (MHz)")
    above.set_title(f"{found.chip.name}, {found.state}: energy along the channel between simply supported ends",
                    fontsize=10)
    below.set_ylabel("energy over its mean")
    below.set_xlabel("y from the middle of the length (mm)")
    below.set_ylim(bottom=0.0)
    if profiles:
        below.legend(frameon=False, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(profiles))
    tidy(below)
    return save_figure(figure, path)


def draw_between_ends(found: FiniteLength, path: Path) -> Path:
    """Draw |Z| and the mean energy per Vpp^2. Writes `path`.

    They are those of the chip, and of the same without ends.
    """
    figure, above, below = energy_panels(f"{found.chip.name}, {found.state}")
    megahertz = found.frequency / 1e6
    for label, colour, impedance, energy in (
            ("without ends", LINE_COLOURS[1], found.without_ends, found.energy_without_ends),
            (f"{1e3 * found.length:.4g} mm between its ends", LINE_COLOURS[0], found.impedance, found.energy_density)):
        above.plot(megahertz, np.abs(impedance), color=colour, linewidth=1.4, label=label)
        if found.cavity is not None:
            below.plot(megahertz, energy / 4.0, color=colour, linewidth=1.4)
    return save_energy(figure, path)
