"""Pictures of tolerances: influences on figures, samples, and yields."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from workbench.design.figures import change_unit
from workbench.design.uncertainty import amount
from workbench.render.canvas import PANELS_ACROSS, Picture, new_figure, panel_grid, save_figure
from workbench.render.plots import LINE_COLOURS, tidy

if TYPE_CHECKING:
    from workbench.design.tolerance import Tolerance

Real = NDArray[np.float64]

#: Largest number of bars of a tornado: smaller influences are invisible.
BARS = 12
PASSED, FAILED = LINE_COLOURS[0], "#c9c9c9"


@dataclass(frozen=True, eq=False)
class Tornado:
    """Influences on one figure: ``changes`` (k,) of it, largest first. ``title`` has the unit, ``labels`` name the
    parameters with their steps."""

    title: str
    labels: tuple[str, ...]
    changes: Real


@dataclass(frozen=True, eq=False)
class Histogram:
    """Samples (n,) of one figure, in the unit of its ``title``. Limits are infinite if there are none."""

    title: str
    values: Real
    nominal: float
    low: float
    high: float


@dataclass(frozen=True)
class YieldBar:
    """A yield with the ends of its interval, and its linear estimate."""

    label: str
    value: float
    low: float
    high: float
    linear: float


def draw_tolerance(found: Tolerance, folder: Path | str) -> dict[str, Picture]:
    """Draw a tolerance: ``tornado``, and with requirements ``yield`` and ``samples``. The pictures are in `folder`.
    Figures without derivatives are left out of the tornado."""
    folder = Path(folder)
    pictures: dict[str, Picture] = {}
    panels = _tornados(found)
    if panels:
        pictures["tornado"] = Picture(
            draw_tornado(panels, folder / "tornado.png"),
            "change of each figure as a parameter grows (dark) or shrinks (light) by its standard uncertainty, or by "
            "1 % if none is stated; first order, exact derivatives")
    if found.yields is not None and found.outcomes is not None:
        bars = [YieldBar(each.name, each.sampled.value, each.sampled.low, each.sampled.high, each.linear)
                for each in (*found.yields.each, found.yields.together)]
        pictures["yield"] = Picture(draw_yields(bars, folder / "yield.png"),
                                    "yield of each requirement and of all together")
        pictures["samples"] = Picture(draw_histograms(_histograms(found), folder / "samples.png"),
                                      "samples, limits, and the chip as stated")
    return pictures


def _histograms(found: Tolerance) -> list[Histogram]:
    assert found.outcomes is not None
    panels = []
    for each in found.bounds:
        named = each.requirement.figure
        panels.append(Histogram(
            f"{each.requirement.text}\n{each.label}" + (f" ({named.shown})" if named.shown else ""),
            found.outcomes.column(each.label) / named.factor, each.nominal / named.factor, each.low / named.factor,
            each.high / named.factor))
    return panels


def _tornados(found: Tolerance) -> list[Tornado]:
    known, panels = found.sensitivities, []
    for each in found.requested:
        unit, factor = change_unit(each.figure)
        changes = known.changes(each.label) / factor
        order = [k for k in known.ranked(each.label) if np.isfinite(changes[k])]
        labels = tuple(f"{_short(known.names[k])}, {amount(known.names[k], known.steps[k])}" for k in order)
        if order:
            panels.append(Tornado(f"change of {each.label}" + (f" ({unit})" if unit else ""), labels, changes[order]))
    return panels


def _short(name: str) -> str:
    """The name of a parameter; a material without its source."""
    material, slash, rest = name.partition("/")
    return f"{material}.{rest.partition('.')[2]}" if slash else name


def draw_tornado(panels: Sequence[Tornado], path: Path, *, title: str = "") -> Path:
    """Draw the change of each figure by each parameter.

    The change is lighter for a smaller parameter.

    Raises:
        ValueError: nothing to draw.
    """
    if not panels:
        raise ValueError("no figures to draw")
    bars = max(min(BARS, len(each.labels)) for each in panels)
    figure, grid = panel_grid(len(panels), across=2, panel=(5.4, 0.9 + 0.26 * bars), margin=(0.0, 0.5))
    for axes, each in zip(grid.flat, panels, strict=False):
        changes = each.changes[:BARS]
        places = np.arange(len(changes))
        axes.barh(places, changes, height=0.6, color=LINE_COLOURS[0], label="parameter grows")
        axes.barh(places, -changes, height=0.6, color="#b8cfe0", label="parameter shrinks")
        axes.axvline(0.0, color="black", linewidth=0.8)
        axes.set_yticks(places, each.labels[:BARS], fontsize=8)
        axes.set_ylim(bars - 0.4, -0.6)
        axes.set_title(each.title, fontsize=10)
        tidy(axes)
    grid.flat[0].legend(frameon=False, loc="lower right", fontsize=8)
    figure.suptitle(title)
    figure.tight_layout()
    return save_figure(figure, path)


def draw_histograms(panels: Sequence[Histogram], path: Path, *, title: str = "") -> Path:
    """Draw samples of every figure, limits, and the chip as stated.

    Samples that meet the requirement are coloured.

    Raises:
        ValueError: nothing to draw.
    """
    if not panels:
        raise ValueError("no figures to draw")
    figure, grid = panel_grid(len(panels), across=PANELS_ACROSS, panel=(4.2, 3.0), margin=(0.4, 0.5))
    for axes, each in zip(grid.flat, panels, strict=False):
        there = each.values[np.isfinite(each.values)]
        met = (there >= each.low) & (there <= each.high)
        # The rule of Freedman and Diaconis, as in numpy; at least two, for figures that hardly differ.
        edges = np.histogram_bin_edges(there, bins="auto") if np.ptp(there) > 0.0 else 2
        axes.hist([there[met], there[~met]], bins=edges, stacked=True, color=[PASSED, FAILED],
                  label=["meets it", "does not"])
        axes.axvline(each.nominal, color="black", linewidth=1.0, label="as stated")
        for k, end in enumerate(end for end in (each.low, each.high) if np.isfinite(end)):
            axes.axvline(end, color=LINE_COLOURS[1], linewidth=1.2, linestyle="--", label="limit" if k == 0 else None)
        axes.set_title(each.title, fontsize=9)
        axes.ticklabel_format(axis="x", useOffset=False)
        axes.tick_params(axis="x", labelsize=8)
        axes.locator_params(axis="x", nbins=5)
        axes.set_ylabel("samples")
        tidy(axes)
    figure.suptitle(title)
    figure.tight_layout(rect=(0.0, 0.3 / figure.get_figheight(), 1.0, 1.0))
    figure.legend(*grid.flat[0].get_legend_handles_labels(), frameon=False, fontsize=8, loc="lower center", ncols=4)
    return save_figure(figure, path)


def draw_yields(bars: Sequence[YieldBar], path: Path, *, title: str = "") -> Path:
    """Draw the yield of every requirement: interval and linear estimate.

    Raises:
        ValueError: nothing to draw.
    """
    if not bars:
        raise ValueError("no yields to draw")
    figure = new_figure(8.0, 1.3 + 0.5 * len(bars))
    axes = figure.subplots()
    places = np.arange(len(bars))
    values = np.array([each.value for each in bars])
    spans = 100.0 * np.array([[each.value - each.low for each in bars], [each.high - each.value for each in bars]])
    axes.barh(places, 100.0 * values, height=0.55, color=PASSED, alpha=0.85)
    axes.errorbar(100.0 * values, places, xerr=np.maximum(spans, 0.0), linestyle="", color="black", capsize=3.0,
                  label="sampled, 95 % interval")
    axes.plot([100.0 * each.linear for each in bars], places, linestyle="", marker="D", color=LINE_COLOURS[1],
              markersize=5.0, label="linear estimate")
    axes.set_yticks(places, [each.label for each in bars], fontsize=9)
    axes.set_ylim(len(bars) - 0.4, -0.6)
    axes.set_xlim(0.0, 104.0)
    axes.set_xlabel("yield (%)")
    axes.set_title(title, loc="right")
    axes.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize=8)
    tidy(axes)
    figure.tight_layout()
    return save_figure(figure, path)
