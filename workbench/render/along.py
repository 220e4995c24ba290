"""Waves along a channel: frequency over wave number."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from workbench.render.canvas import PLAIN_COLOURS, new_figure, save_figure
from workbench.render.plots import tidy

if TYPE_CHECKING:
    from workbench.simulation.dispersion import Dispersion


def draw_dispersion(found: Dispersion, path: Path) -> Path:
    """Draw the branches, with the share of the energy in the liquid as colour.

    Writes `path`.
    """
    from matplotlib.collections import LineCollection

    figure = new_figure(8.0, 6.0)
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
    axes.set_title(f"{found.chip.name}, {found.state}: waves along the channel, Q of {found.least_q:.3g} or more")
    if found.branches:
        figure.colorbar(lines, ax=axes, label="share of the energy in the liquid")
    tidy(axes)
    return save_figure(figure, path)
