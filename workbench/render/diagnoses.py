"""Pictures of a diagnosis: states before and after, and explained shares."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from workbench.render.canvas import OTHER_COLOUR, new_figure, save_figure
from workbench.render.plots import LINE_COLOURS, tidy

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

#: Number of states side by side, the size of each in inches, and the height of the legend above them.
_ACROSS, _WIDTH, _HEIGHT, _LEGEND = 3, 4.4, 4.3, 1.0
_AFTER, _BEFORE = LINE_COLOURS[:2]

#: Ratio of the residuals before and after above which the scale is logarithmic.
_ORDERS = 10.0


@dataclass(frozen=True, eq=False)
class StatePicture:
    """A state as ``measured``, and as modelled ``before`` and ``after``. Impedances (n,) are in ohm, ``frequency`` (n,)
    in Hz; ``noise`` (n,) is that of a point, relative."""

    name: str
    frequency: NDArray[np.float64]
    measured: NDArray[np.complex128]
    before: NDArray[np.complex128]
    after: NDArray[np.complex128]
    noise: NDArray[np.float64]


def draw_states(states: Sequence[StatePicture], path: Path, *, before: str, after: str) -> Path:
    """Draw |Z| of every state above its residual, before and after.

    `before` and `after` are the labels of the lines.

    Raises:
        ValueError: no states.
    """
    if not states:
        raise ValueError("no states to draw")
    across = min(_ACROSS, len(states))
    down = math.ceil(len(states) / across)
    height, width = _HEIGHT * down + 0.5, _WIDTH * across
    figure = new_figure(width, height)
    outer = figure.add_gridspec(down, across, hspace=0.42, wspace=0.22, top=1.0 - _LEGEND / height, bottom=0.5 / height,
                                left=0.75 / width, right=1.0 - 0.15 / width)
    handles: list[Artist] = []
    for index, state in enumerate(states):
        row, column = divmod(index, across)
        inner = outer[row, column].subgridspec(2, 1, height_ratios=(1, 1), hspace=0.08)
        upper = figure.add_subplot(inner[0])
        lower = figure.add_subplot(inner[1], sharex=upper)
        handles = _draw_state(upper, lower, state)
        if column == 0:
            upper.set_ylabel("|Z| (Ω)")
            lower.set_ylabel("residual (% of |Z|)")
        if index + across >= len(states):
            lower.set_xlabel("frequency (MHz)")
    figure.legend(handles, ["measured", before, after, "noise, two standard deviations"], loc="upper center",
                  ncols=4 if across == _ACROSS else 2, frameon=False)
    return save_figure(figure, path)


def _draw_state(upper: Axes, lower: Axes, state: StatePicture) -> list[Artist]:
    """Draw |Z| and the residual of a state; returns the legend's lines."""
    megahertz = state.frequency / 1e6
    dots, = upper.plot(megahertz, np.abs(state.measured), linestyle="", marker="o", markersize=2.5, color="#555555",
                       alpha=0.5, markeredgewidth=0.0)
    differences = [100.0 * np.abs(np.log(each / state.measured)) for each in (state.before, state.after)]
    rms = [float(np.sqrt(np.mean(each**2))) for each in differences]
    # A logarithmic scale starts far below the noise.
    lowest = 10.0 * math.sqrt(2.0) * float(np.min(state.noise)) if rms[0] > _ORDERS * rms[1] else 0.0
    lines = []
    # A broad pale line and a narrow one, since they may coincide.
    for impedance, difference, colour, width, alpha in ((state.before, differences[0], _BEFORE, 3.2, 0.45),
                                                        (state.after, differences[1], _AFTER, 1.1, 1.0)):
        line, = upper.plot(megahertz, np.abs(impedance), color=colour, linewidth=width, alpha=alpha)
        lower.plot(megahertz, np.maximum(difference, lowest), color=colour, linewidth=0.5 * (1.0 + width), alpha=alpha)
        lines.append(line)
    # Both parts of ln Z have that standard deviation.
    band = lower.fill_between(megahertz, lowest, 200.0 * math.sqrt(2.0) * state.noise, color="#dddddd", zorder=0)
    upper.set_yscale("log")
    first, last = (f"{float(f'{each:.2g}'):g} %" for each in rms)
    upper.set_title(f"{state.name}\nresidual {first} of Z before, {last} after", fontsize=9)
    upper.tick_params(labelbottom=False)
    upper.tick_params(which="minor", labelsize=6)
    if lowest:
        lower.set_yscale("log")
        lower.yaxis.set_major_formatter("{x:g}")
        lower.tick_params(which="minor", labelsize=6)
    lower.set_ylim(bottom=lowest)
    tidy(upper)
    tidy(lower)
    return [dots, *lines, band]


def draw_shares(shares: Mapping[str, float], path: Path, *, title: str) -> Path:
    """Draw the explained shares of the residual as stated, and the rest.

    Raises:
        ValueError: a share below zero, or a sum above one.
    """
    if any(share < 0.0 for share in shares.values()) or sum(shares.values()) > 1.0 + 1e-9:
        raise ValueError(f"shares of {', '.join(f'{name} {share:g}' for name, share in shares.items())}: expected none "
                         "below 0, and no more than 1 together")
    parts = {**shares, "not explained": max(1.0 - sum(shares.values()), 0.0)}
    figure = new_figure(9.0, 1.7)
    axes = figure.subplots()
    start = 0.0
    for index, (name, share) in enumerate(parts.items()):
        colour = OTHER_COLOUR if name == "not explained" else LINE_COLOURS[index % len(LINE_COLOURS)]
        axes.barh([0.0], [100.0 * share], left=100.0 * start, color=colour, edgecolor="white", height=0.6,
                  label=f"{name}: {100.0 * share:.3g} %")
        start += share
    axes.set_xlim(0.0, 100.0)
    axes.set_yticks([])
    axes.set_xlabel("share of the residual as stated, beyond noise (%)")
    axes.set_title(title, fontsize=11)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.72), ncols=2, frameon=False)
    figure.subplots_adjust(left=0.04, right=0.97, top=0.84, bottom=0.55)
    return save_figure(figure, path)
