"""Pictures of a fit: spectra, intervals, correlations, sensitivities, gel thickness, batches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.render.canvas import PANELS_ACROSS, SIGNED_COLOURS, new_figure, panel_grid, save_figure
from workbench.render.plots import LINE_COLOURS, SpectrumLike, save_impedance, tidy

Real = NDArray[np.float64]


@dataclass(frozen=True)
class Interval:
    """A fitted parameter: value, interval, start and prior uncertainty. All are in one unit; ``prior`` is None without
    a prior; ``remark`` is printed beside the interval."""

    name: str
    value: float
    low: float
    high: float
    start: float
    prior: float | None
    remark: str = ""


def draw_fit(
    measured: SpectrumLike, start: SpectrumLike, fitted: SpectrumLike, path: Path, *, title: str = ""
) -> Path:
    """Draw magnitude and phase of recording, start and fit, with residuals. As in Fig. 5 of Acevedo-Espinosa et al.
    (RP-UEIS). All three have the same frequencies."""
    figure = new_figure(9.0, 9.0)
    panels = figure.subplots(4, 1, sharex=True, height_ratios=(3.0, 1.3, 2.2, 1.3))
    magnitude, magnitude_residual, phase, phase_residual = panels
    megahertz = np.asarray(measured.frequency) / 1e6
    # Dots first and the fit last: it stays visible on a dense recording.
    styles = (("measured", measured, {"linestyle": "", "marker": "o", "markersize": 3.0, "alpha": 0.5,
                                      "markeredgewidth": 0.0, "color": LINE_COLOURS[1]}),
              ("start", start, {"linestyle": "--", "linewidth": 1.1, "color": LINE_COLOURS[2]}),
              ("fitted", fitted, {"linestyle": "-", "linewidth": 1.4, "color": LINE_COLOURS[0]}))
    for label, spectrum, style in styles:
        impedance = np.asarray(spectrum.impedance)
        magnitude.plot(megahertz, np.abs(impedance), label=label, **style)
        phase.plot(megahertz, np.degrees(np.angle(impedance)), label=label, **style)
    ratio = np.asarray(fitted.impedance) / np.asarray(measured.impedance)
    for axes, values in ((magnitude_residual, 100.0 * (np.abs(ratio) - 1.0)),
                         (phase_residual, np.degrees(np.angle(ratio)))):
        axes.axhline(0.0, color="black", linewidth=0.8)
        axes.plot(megahertz, values, color=LINE_COLOURS[0], linewidth=1.0)
    magnitude.set_yscale("log")
    magnitude.set_ylabel("|Z| (Ω)")
    magnitude.set_title(title)
    magnitude.legend(frameon=False)
    magnitude_residual.set_ylabel("fitted − measured\n|Z| (%)", fontsize=9)
    phase.set_ylabel("phase of Z (°)")
    phase.set_ylim(-100.0, 100.0)
    phase.set_yticks([-90, -45, 0, 45, 90])
    phase_residual.set_ylabel("fitted − measured\nphase (°)", fontsize=9)
    phase_residual.set_xlabel("frequency (MHz)")
    for axes in panels:
        tidy(axes, both=axes is magnitude)
    figure.align_ylabels()
    figure.tight_layout()
    return save_figure(figure, path)


def draw_correlation(names: Sequence[str], matrix: Real, path: Path, *, title: str = "") -> Path:
    """Draw a correlation matrix (p, p) with its numbers.

    Raises:
        ValueError: the numbers of names and rows differ.
    """
    matrix = np.asarray(matrix, dtype=float)
    count = len(names)
    if matrix.shape != (count, count):
        raise ValueError(f"a matrix of shape {matrix.shape} for {count} names")
    side = 2.2 + 0.55 * count
    figure = new_figure(side + 1.0, side)
    axes = figure.subplots()
    image = axes.imshow(matrix, cmap=SIGNED_COLOURS, vmin=-1.0, vmax=1.0)
    axes.set_xticks(range(count), names, rotation=60, ha="right")
    axes.set_yticks(range(count), names)
    for row in range(count):
        for column in range(count):
            number = round(float(matrix[row, column]), 2) + 0.0  # no minus zero
            axes.text(column, row, f"{number:.2f}", ha="center", va="center", fontsize=7,
                      color="white" if abs(number) > 0.6 else "black")
    axes.spines[:].set_visible(False)
    figure.colorbar(image, ax=axes, shrink=0.8, label="correlation")
    axes.set_title(title)
    figure.tight_layout()
    return save_figure(figure, path)


def draw_intervals(intervals: Sequence[Interval], path: Path, *, title: str = "") -> Path:
    """Draw fitted values with their 95 % intervals and priors.

    Values are in units of the start, or of the prior for a parameter that starts at zero. The prior's 95 % interval is
    grey.

    Raises:
        ValueError: nothing to draw.
    """
    if not intervals:
        raise ValueError("no parameters to draw")
    figure = new_figure(9.0, 1.6 + 0.42 * len(intervals))
    axes = figure.subplots()
    labels = []
    for row, found in enumerate(intervals):
        unit = abs(found.start) or found.prior or abs(found.value) or 1.0
        sign = 1.0 if found.start >= 0.0 else -1.0

        def scaled(number: float, unit: float = unit, sign: float = sign, start: float = found.start) -> float:
            return 100.0 * sign * (number - start) / unit

        if found.prior is not None:
            reach = 196.0 * found.prior / unit
            axes.barh(row, 2.0 * reach, left=-reach, height=0.56, color="#dddddd",
                      label="prior (95 %)" if row == 0 else None)
        ends = sorted((scaled(found.low), scaled(found.high)))
        axes.plot(ends, [row, row], color=LINE_COLOURS[0], linewidth=3.0, solid_capstyle="butt",
                  label="fitted (95 %)" if row == 0 else None)
        axes.plot([scaled(found.value)], [row], marker="o", markersize=5.0, color=LINE_COLOURS[1], linestyle="",
                  label="fitted value" if row == 0 else None)
        labels.append(found.name + (" (of its prior)" if found.start == 0.0 else ""))
        if found.remark:
            axes.annotate(found.remark, (1.01, row), xycoords=("axes fraction", "data"), va="center", fontsize=8,
                          color="#555555")
    # A loss may be known to a factor only: a symmetric logarithm shows 1 % beside 1000 %.
    axes.set_xscale("symlog", linthresh=10.0)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    low, high = axes.get_xlim()
    ticks = [t for t in (-1000, -100, -10, -5, 0, 5, 10, 100, 1000) if low <= t <= high]
    axes.set_xticks(ticks, [f"{t:+d}" if t else "0" for t in ticks])
    axes.set_xticks([], minor=True)
    axes.set_xlabel("difference from the start (% of the start; beyond 10 % logarithmic)")
    axes.set_title(title)
    axes.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.9 / figure.get_figheight()), ncols=3)
    tidy(axes)
    figure.tight_layout()
    return save_figure(figure, path)


def draw_sensitivity(
    real: Sequence[tuple[str, float, float | None]], imaginary: Sequence[tuple[str, float, float | None]], path: Path,
    *, thresholds: tuple[float, float], title: str = ""
) -> Path:
    """Draw the ranking of Algorithm 1, steepest first.

    Rows are (name, normalised slope, published slope or None), as in Table 2 of Acevedo-Espinosa et al. (RP-UEIS), with
    the thresholds that drop a parameter.

    Raises:
        ValueError: nothing to draw.
    """
    if not real and not imaginary:
        raise ValueError("no parameters to draw")
    figure = new_figure(10.0, 1.8 + 0.36 * max(len(real), len(imaginary)))
    for axes, rows, threshold, label in zip(figure.subplots(1, 2), (real, imaginary), thresholds,
                                            ("real parts", "imaginary parts"), strict=True):
        places = np.arange(len(rows))
        slopes = np.array([slope for _, slope, _ in rows])
        axes.barh(places, slopes, height=0.62, label="here",
                  color=[LINE_COLOURS[0] if slope >= threshold else "#b8cfe0" for slope in slopes])
        published = [(place, known) for place, (_, _, known) in zip(places, rows, strict=True) if known is not None]
        if published:
            axes.plot([known for _, known in published], [place for place, _ in published], linestyle="", marker="D",
                      color=LINE_COLOURS[1], markersize=5.0, label="published")
        axes.axvline(threshold, color="#555555", linewidth=1.0, linestyle="--", label=f"threshold {threshold:.0%}")
        axes.set_yticks(places, [name for name, _, _ in rows])
        axes.set_ylim(max(len(real), len(imaginary)) - 0.4, -0.6)
        axes.set_xlim(0.0, 1.08)
        axes.set_xlabel("slope of the cost over the largest")
        axes.set_title(label, fontsize=10)
        axes.legend(frameon=False, loc="lower right")
        tidy(axes)
    figure.suptitle(title)
    figure.tight_layout()
    return save_figure(figure, path)


def draw_costs(scalings: Real, costs: Mapping[str, Real], path: Path, *, title: str = "") -> Path:
    """Draw the cost (s,) of every labelled part over its scaling (s,).

    Algorithm 1 uses their slopes.

    Raises:
        ValueError: nothing to draw.
    """
    if not costs:
        raise ValueError("no costs to draw")
    figure = new_figure(9.0, 4.8)
    axes = figure.subplots()
    for index, (name, values) in enumerate(costs.items()):
        axes.plot(scalings, values, color=LINE_COLOURS[index % len(LINE_COLOURS)], label=name, linewidth=1.3,
                  linestyle=("-", "--", ":")[index // len(LINE_COLOURS) % 3])
    axes.set_xlabel("part over its baseline")
    axes.set_ylabel("sum of squares of ln|Z / Z_baseline|")
    axes.set_title(title)
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    tidy(axes)
    figure.tight_layout()
    return save_figure(figure, path)


def draw_gel_study(
    measured: SpectrumLike, predicted: Mapping[str, tuple[SpectrumLike, float]], path: Path, *,
    resonance: float | None = None, title: str = "",
) -> Path:
    """Draw the recording and predictions for several gel thicknesses.

    Each prediction has the mean error (%) of its |Z|. As in Fig. 6 of Acevedo-Espinosa et al. (RP-UEIS); `resonance`
    (Hz) is marked.

    Raises:
        ValueError: no predictions.
    """
    if not predicted:
        raise ValueError("no predictions to draw")
    figure = new_figure(9.0, 6.8)
    magnitude, phase = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    dots = {"linestyle": "", "marker": "o", "markersize": 3.0, "alpha": 0.45, "markeredgewidth": 0.0, "color": "black"}
    megahertz = np.asarray(measured.frequency) / 1e6
    magnitude.plot(megahertz, np.abs(measured.impedance), label="measured", **dots)
    phase.plot(megahertz, np.degrees(np.angle(measured.impedance)), **dots)
    for index, (label, (spectrum, error)) in enumerate(predicted.items()):
        colour = LINE_COLOURS[index % len(LINE_COLOURS)]
        megahertz = np.asarray(spectrum.frequency) / 1e6
        magnitude.plot(megahertz, np.abs(spectrum.impedance), color=colour, linewidth=1.3,
                       label=f"{label}: MAPE {error:.3g} %")
        phase.plot(megahertz, np.degrees(np.angle(spectrum.impedance)), color=colour, linewidth=1.3)
    if resonance is not None:
        for axes in (magnitude, phase):
            axes.axvline(resonance / 1e6, color="#666666", linestyle=":", linewidth=1.0)
    return save_impedance(figure, magnitude, phase, path, title=title)


def draw_batch(
    devices: Sequence[str], values: Mapping[str, tuple[Real, Real, Real]], outliers: Mapping[str, Sequence[str]],
    path: Path, *, title: str = "",
) -> Path:
    """Draw every parameter over the devices, with interval and median.

    Outliers are red crosses.

    Args:
        values: by label (with its unit) the values and the ends of their intervals, each (len(devices),), NaN for a
            device without such a parameter.
        outliers: by label the names of outlying devices.

    Raises:
        ValueError: no values.
    """
    if not values:
        raise ValueError("no values to draw")
    figure, panels = panel_grid(len(values), across=PANELS_ACROSS, panel=(3.3, 2.5), margin=(1.2, 1.0))
    places = np.arange(len(devices))
    for axes, (label, (value, low, high)) in zip(panels.flat, values.items(), strict=False):
        out = np.array([device in outliers.get(label, ()) for device in devices])
        axes.axhline(float(np.nanmedian(value)), color="#888888", linewidth=0.9, linestyle="--")
        spans = np.maximum(np.stack([value - low, high - value]), 0.0)
        axes.errorbar(places[~out], value[~out], yerr=spans[:, ~out], linestyle="", marker="o", markersize=4.5,
                      color=LINE_COLOURS[0], capsize=3.0)
        axes.errorbar(places[out], value[out], yerr=spans[:, out], linestyle="", marker="X", markersize=7.0,
                      color="#c00000", capsize=3.0)
        axes.set_title(label, fontsize=9)
        axes.set_xlim(-0.5, len(devices) - 0.5)
        axes.set_xticks(places, devices, rotation=45, ha="right", fontsize=8)
        axes.ticklabel_format(axis="y", useOffset=False, style="plain")
        tidy(axes)
    figure.suptitle(title)
    figure.tight_layout()
    return save_figure(figure, path)
