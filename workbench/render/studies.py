"""Pictures of a study: parallel coordinates, and figures over parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from workbench.render.canvas import PANELS_ACROSS, PLAIN_COLOURS, new_figure, panel_grid, save_figure
from workbench.render.plots import LINE_COLOURS, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Real = NDArray[np.float64]

#: Dots per inch: a report has many of these pictures.
DOTS = 100

#: Quantiles at the ends of the colours of parallel coordinates, so that outliers do not stretch the range.
COLOURED = (0.02, 0.98)

#: Largest number of lines in a picture of parallel coordinates: more hide each other.
MOST_LINES = 1500

#: Largest number of different values of a column that is drawn value by value; others are drawn in bins.
FEW_VALUES = 12

#: Mean number of points in a bin of a pair, and the least and largest number of bins along an axis.
POINTS_IN_BIN, FEWEST_BINS, MOST_BINS = 5, 4, 24

#: Largest number of parameters in a picture of pairs: more would be too small to read.
MOST_IN_PAIRS = 6


@dataclass(frozen=True, eq=False)
class StudyColumn:
    """A varied parameter or a figure: ``label`` with unit, ``values`` (n,). If there are ``words``, the values are
    their indices."""

    label: str
    values: Real
    words: tuple[str, ...] = ()

    @property
    def few(self) -> Real:
        """Its different values if they are few, else empty."""
        found = np.unique(self.values[np.isfinite(self.values)])
        return found if len(found) <= FEW_VALUES else np.zeros(0)

    def edges(self, points_in_bin: int, dimensions: int) -> Real:
        """Ends of bins with about `points_in_bin` points on average. `dimensions` is that of the binning."""
        few = self.few
        if len(few) > 1:
            middles = 0.5 * (few[1:] + few[:-1])
            return np.concatenate([[2.0 * few[0] - middles[0]], middles, [2.0 * few[-1] - middles[-1]]])
        count = round((len(self.values) / points_in_bin) ** (1.0 / dimensions))
        low, high = float(np.nanmin(self.values)), float(np.nanmax(self.values))
        if low == high:
            # A bin about the only value.
            low, high = low - 0.5, high + 0.5
        return np.linspace(low, high, min(max(count, FEWEST_BINS), MOST_BINS) + 1)


def draw_parallel(columns: Sequence[StudyColumn], colour: StudyColumn, path: Path, *, title: str = "") -> Path:
    """Draw every point as a line across one axis for each column.

    Lines are coloured by `colour`. At most :data:`MOST_LINES` points are drawn, evenly chosen; points without a colour
    are left out, and lines end at a missing figure.

    Raises:
        ValueError: no point has a colour.
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import LineCollection
    from matplotlib.colors import Normalize

    known = np.flatnonzero(np.isfinite(colour.values))
    if not known.size:
        raise ValueError(f"no point has {colour.label}")
    shown = known[np.unique(np.linspace(0, known.size - 1, min(known.size, MOST_LINES)).astype(int))]
    figure = new_figure(max(6.0, 1.45 * len(columns) + 1.2), 5.0)
    axes = figure.subplots()
    norm = Normalize(*_ends(np.quantile(colour.values[known], COLOURED)))
    ends = [_ends(column.values) for column in columns]
    heights = np.stack([(column.values[shown] - low) / (high - low)
                        for column, (low, high) in zip(columns, ends, strict=True)], axis=1)
    lines = LineCollection([np.column_stack([np.arange(len(columns)), each]) for each in heights],
                           colors=colormaps[PLAIN_COLOURS](norm(colour.values[shown])), linewidths=0.7,
                           alpha=min(1.0, max(0.15, 60.0 / max(shown.size, 1))))
    axes.add_collection(lines)
    for place, (column, (low, high)) in enumerate(zip(columns, ends, strict=True)):
        axes.axvline(place, color="#404040", linewidth=0.9)
        marks = [(float(k), _broken(word)) for k, word in enumerate(column.words)]
        marks = marks or [(end, f"{end:.4g}") for end in (low, high)]
        for value, text in marks:
            height = (value - low) / (high - low)
            axes.annotate(text, (place, height), (3, 4 if height > 0.5 else -10), textcoords="offset points",
                          fontsize=7)
    axes.set_xlim(-0.3, len(columns) - 0.3)
    axes.set_ylim(-0.08, 1.08)
    axes.set_xticks(range(len(columns)), [_broken(column.label) for column in columns], fontsize=8)
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    axes.set_title(title)
    figure.colorbar(ScalarMappable(norm, PLAIN_COLOURS), ax=axes, label=colour.label, pad=0.02, extend="both")
    figure.tight_layout()
    return save_figure(figure, path, dots_per_inch=DOTS)


def draw_slices(parameters: Sequence[StudyColumn], found: StudyColumn, path: Path, *, title: str = "") -> Path:
    """Draw a figure over each parameter, with all points as dots. Also the median and the range of 5 to 95 % of near
    points."""
    figure, panels = panel_grid(len(parameters), across=PANELS_ACROSS, panel=(3.4, 2.8), margin=(0.6, 0.4), sharey=True)
    for axes, parameter in zip(panels.flat, parameters, strict=False):
        # Few points are large and dark; many are faint, so that their density shows.
        count = max(1, parameter.values.size)
        axes.plot(parameter.values, found.values, linestyle="", marker="o", color="#404040", markeredgewidth=0.0,
                  markersize=min(5.0, max(2.0, 60.0 / math.sqrt(count))), alpha=min(0.7, max(0.2, 150.0 / count)),
                  zorder=3, rasterized=True)
        where, low, middle, high = _quantiles(parameter, found)
        if where.size > 1 and not parameter.words:
            axes.fill_between(where, low, high, color=LINE_COLOURS[0], alpha=0.18, linewidth=0.0)
            axes.plot(where, middle, color=LINE_COLOURS[0], linewidth=1.6)
        else:
            axes.errorbar(where, middle, [middle - low, high - middle], color=LINE_COLOURS[0], linestyle="",
                          marker="o", capsize=4.0)
        _label(axes, parameter, "x")
        tidy(axes)
    for row in panels:
        row[0].set_ylabel(found.label)
    figure.suptitle(title)
    figure.tight_layout()
    return save_figure(figure, path, dots_per_inch=DOTS)


def draw_maps(parameters: Sequence[StudyColumn], found: StudyColumn, path: Path, *, title: str = "") -> Path:
    """Draw a figure over every pair of parameters, as a local mean.

    Raises:
        ValueError: fewer than two parameters, or more than :data:`MOST_IN_PAIRS`.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    if not 2 <= len(parameters) <= MOST_IN_PAIRS:
        raise ValueError(f"{len(parameters)} parameters; pairs are drawn of 2 to {MOST_IN_PAIRS}")
    size = len(parameters) - 1
    # The longest number or word beside the panels, and the lines of a label, in inches at 7 and 8 points.
    words = [word for each in parameters[1:] for word in each.words]
    beside = max([6, *(len(line) for word in words for line in _broken(word).split("\n"))])
    lines = max(_broken(each.label).count("\n") + 1 for each in parameters[1:])
    left = 0.25 + 0.07 * beside + 0.15 * lines
    width, height = 2.3 * size + 1.4 + left, 2.1 * size + 1.4
    figure = new_figure(width, height)
    # Margins in inches: an automatic layout takes most of a second for fifteen panels.
    figure.subplots_adjust(left=left / width, right=1.0 - 1.4 / width, bottom=0.9 / height, top=1.0 - 0.5 / height,
                           wspace=0.08, hspace=0.08)
    panels = figure.subplots(size, size, squeeze=False, sharex="col", sharey="row")
    means = {(i, j): _mean_over(parameters[j], parameters[i], found)
             for i in range(1, len(parameters)) for j in range(i)}
    every = np.concatenate([each[2].ravel() for each in means.values()])
    norm = Normalize(*_ends(every))
    for (i, j), (along_x, along_y, mean) in means.items():
        axes = panels[i - 1, j]
        axes.pcolormesh(along_x, along_y, mean.T, norm=norm, cmap=PLAIN_COLOURS)
        if i == size:
            _label(axes, parameters[j], "x")
        if j == 0:
            _label(axes, parameters[i], "y")
    for row in range(size):
        for axes in panels[row, row + 1:]:
            axes.set_visible(False)
    figure.suptitle(title)
    bar = figure.add_axes((1.0 - 1.15 / width, 0.9 / height, 0.2 / width, 1.0 - 1.4 / height))
    figure.colorbar(ScalarMappable(norm, PLAIN_COLOURS), cax=bar, label=found.label)
    return save_figure(figure, path, dots_per_inch=DOTS)


def most_telling(parameters: Sequence[StudyColumn], found: StudyColumn,
                 count: int = MOST_IN_PAIRS) -> tuple[StudyColumn, ...]:
    """The `count` parameters along which a figure's local median varies most. They are in their original order."""
    def spread(parameter: StudyColumn) -> float:
        _, _, middle, _ = _quantiles(parameter, found)
        return float(np.ptp(middle)) if middle.size else 0.0

    chosen = sorted(range(len(parameters)), key=lambda k: -spread(parameters[k]))[:count]
    return tuple(parameters[k] for k in sorted(chosen))


def _ends(values: Real) -> tuple[float, float]:
    """The lowest and the highest finite value, apart if they are equal."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    # A constant gets a margin of 0.1 % to both sides, or of one if it is zero.
    margin = 0.0 if low < high else (1e-3 * abs(low) or 1.0)
    return low - margin, high + margin


def _quantiles(parameter: StudyColumn, found: StudyColumn) -> tuple[Real, Real, Real, Real]:
    """Places (k,) along a parameter, and local quantiles of a figure. The quantiles are 5, 50 and 95 %."""
    edges, few = parameter.edges(10 * POINTS_IN_BIN, 1), parameter.few
    bins = np.clip(np.digitize(parameter.values, edges) - 1, 0, len(edges) - 2)
    where, quantiles = [], []
    for k in range(len(edges) - 1):
        there = found.values[(bins == k) & np.isfinite(found.values)]
        if there.size:
            where.append(few[k] if len(few) > 1 else 0.5 * (edges[k] + edges[k + 1]))
            quantiles.append(np.quantile(there, (0.05, 0.5, 0.95)))
    low, middle, high = np.array(quantiles).reshape(-1, 3).T
    return np.array(where), low, middle, high


def _mean_over(first: StudyColumn, second: StudyColumn, found: StudyColumn) -> tuple[Real, Real, Real]:
    """Edges along both parameters, and the mean (n, m) in every bin. NaN in an empty bin."""
    edges = [each.edges(POINTS_IN_BIN, 2) for each in (first, second)]
    known = np.isfinite(found.values)
    at = first.values[known], second.values[known]
    count, _, _ = np.histogram2d(*at, bins=edges)
    total, _, _ = np.histogram2d(*at, bins=edges, weights=found.values[known])
    return edges[0], edges[1], np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)


def _label(axes: Axes, column: StudyColumn, side: str) -> None:
    (axes.set_xlabel if side == "x" else axes.set_ylabel)(_broken(column.label), fontsize=8)
    axes.tick_params(labelsize=7)
    if column.words:
        places, texts = range(len(column.words)), [_broken(word) for word in column.words]
        if side == "x":
            axes.set_xticks(places, texts)
        else:
            axes.set_yticks(places, texts)


def _broken(text: str) -> str:
    """A name on several lines. It is broken after slashes, and before its last part and its unit."""
    name, bracket, unit = text.partition(" (")
    return name.replace("/", "/\n").replace(".", "\n.") + (f"\n({unit}" if bracket else "")
