"""Curves: impedance spectra and residuals, loss budget, mesh convergence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from workbench.render.canvas import new_figure, prefixed, role_colour, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from workbench.simulation.energy import EnergySpectrum

#: Distinct in hue and in grey, and to colour-blind eyes (Okabe & Ito 2008).
LINE_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")

#: Points drawn per point of a computed spectrum, and the largest number of a line.
BETWEEN, MOST_POINTS = 8, 20_000


class SpectrumLike(Protocol):
    """A spectrum to draw. Frequency (n,) is in Hz, impedance (n,) in ohm, complex, e^{+j w t}."""

    @property
    def frequency(self) -> NDArray[np.float64]: ...
    @property
    def impedance(self) -> NDArray[np.complex128]: ...


def draw_spectra(
    spectra: Mapping[str, SpectrumLike], path: Path | str, *, measured: Sequence[str] = (), title: str = ""
) -> Path:
    """Draw magnitude (logarithmic) over phase of labelled spectra.

    Spectra that are `measured` are dots, others are lines of their interpolant, which also defines the figures of
    merit. As in Fig. 7 of Acevedo-Espinosa et al. (RP-UEIS).

    Raises:
        ValueError: no spectra, or a measured label that is none of them.
    """
    if not spectra:
        raise ValueError("no spectra to draw")
    for label in measured:
        if label not in spectra:
            raise ValueError(f"measured spectrum {label!r} is not one of {', '.join(spectra)}")
    figure = new_figure(8.0, 6.5)
    magnitude, phase = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for index, (label, spectrum) in enumerate(spectra.items()):
        colour = LINE_COLOURS[index % len(LINE_COLOURS)]
        frequency, impedance = np.asarray(spectrum.frequency), np.asarray(spectrum.impedance)
        if label not in measured and frequency.size * BETWEEN <= MOST_POINTS and hasattr(spectrum, "interpolant"):
            points = np.arange(frequency.size)
            frequency = np.interp(np.linspace(0.0, points[-1], points[-1] * BETWEEN + 1), points, frequency)
            impedance = spectrum.interpolant()(frequency)
        megahertz = frequency / 1e6
        # Dots are drawn first: the model's line stays visible on a dense measurement.
        style = ({"linestyle": "", "marker": "o", "markersize": 3.0, "alpha": 0.55, "markeredgewidth": 0.0, "zorder": 1}
                 if label in measured else {"linestyle": "-", "linewidth": 1.5, "zorder": 2})
        magnitude.plot(megahertz, np.abs(impedance), color=colour, label=label, **style)
        phase.plot(megahertz, np.degrees(np.angle(impedance)), color=colour, **style)
    return save_impedance(figure, magnitude, phase, Path(path), title=title)


def save_impedance(figure: Figure, magnitude: Axes, phase: Axes, path: Path, *, title: str) -> Path:
    """Label the axes of |Z| (logarithmic) and phase, and write `path`."""
    logarithmic(magnitude)
    magnitude.set_ylabel("|Z| (Ω)")
    magnitude.set_title(title)
    magnitude.legend(frameon=False)
    phase.set_ylabel("phase of Z (°)")
    phase.set_ylim(-100.0, 100.0)
    phase.set_yticks([-90, -45, 0, 45, 90])
    phase.set_xlabel("frequency (MHz)")
    for axes in (magnitude, phase):
        tidy(axes, both=True)
    figure.align_ylabels()
    figure.tight_layout()
    return save_figure(figure, path)


def draw_energy(
    energy: Mapping[str, EnergySpectrum], peaks: Mapping[str, Sequence[float]], path: Path | str, *, title: str = ""
) -> Path:
    """Draw |Z| and the cavity's energy density per Vpp^2 over frequency. Both are logarithmic. The `peaks` (Hz) of each
    label are marked with their frequency."""
    figure, above, below = energy_panels(title)
    for index, (label, each) in enumerate(energy.items()):
        colour, megahertz = LINE_COLOURS[index % len(LINE_COLOURS)], each.frequency / 1e6
        above.plot(megahertz, np.abs(each.impedance), color=colour, linewidth=1.5, label=label)
        below.plot(megahertz, each.per_square_volt, color=colour, linewidth=1.5)
        for number, frequency in enumerate(peaks[label]):
            height = float(np.interp(frequency, each.frequency, each.per_square_volt))
            for axes in (above, below):
                axes.axvline(frequency / 1e6, color=colour, linewidth=0.8, linestyle=":" if number else "--", zorder=1)
            below.annotate(f"{frequency / 1e6:.4f} MHz", (frequency / 1e6, height), textcoords="offset points",
                           xytext=(4, 2), fontsize=8, color=colour)
    return save_energy(figure, path)


def energy_panels(title: str) -> tuple[Figure, Axes, Axes]:
    """A figure for |Z| above the cavity's energy density per Vpp^2."""
    figure = new_figure(8.0, 6.5)
    above, below = figure.subplots(2, 1, sharex=True)
    above.set_title(title)
    above.set_ylabel("|Z| (Ω)")
    below.set_ylabel("mean E_ac (J/m³ per Vpp²)")
    below.set_xlabel("frequency (MHz)")
    return figure, above, below


def save_energy(figure: Figure, path: Path | str) -> Path:
    """Write a figure of :func:`energy_panels` with a legend and logarithmic axes."""
    figure.axes[0].legend(frameon=False)
    for axes in figure.axes:
        logarithmic(axes)
        tidy(axes, both=True)
    figure.align_ylabels()
    figure.tight_layout()
    return save_figure(figure, Path(path))


def draw_residuals(
    frequency: NDArray[np.float64], residuals: Mapping[str, NDArray[np.float64]], path: Path, *, label: str,
    title: str = "", band: float | None = None,
) -> Path:
    """Draw labelled residuals (n,) over `frequency` (n,) in Hz. `label` names the quantity with its unit; the shaded
    `band` of plus and minus that value is the effect of noise alone."""
    figure = new_figure(8.0, 3.6)
    axes = figure.subplots()
    if band is not None:
        axes.axhspan(-band, band, color="#dddddd", label=f"±{band:.3g}")
    for index, (name, values) in enumerate(residuals.items()):
        axes.plot(np.asarray(frequency) / 1e6, values, color=LINE_COLOURS[index % len(LINE_COLOURS)], linewidth=1.2,
                  label=name)
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.set_xlabel("frequency (MHz)")
    axes.set_ylabel(label)
    axes.set_title(title)
    axes.legend(frameon=False)
    tidy(axes)
    figure.tight_layout()
    return save_figure(figure, path)


def draw_loss_budget(losses: Mapping[str, float], path: Path, *, title: str) -> Path:
    """Draw dissipated power (W) and its share by region, largest on top.

    Raises:
        ValueError: nothing is dissipated.
    """
    total = sum(losses.values())
    if not total > 0.0:
        raise ValueError(f"the losses add up to {total} W; expected a positive power")
    ranked = sorted(losses.items(), key=lambda item: item[1])
    factor, unit = prefixed(max(losses.values()), "W")
    figure = new_figure(7.5, 1.4 + 0.42 * len(ranked))
    axes = figure.subplots()
    bars = axes.barh([name for name, _ in ranked], [power * factor for _, power in ranked],
                     color=[role_colour(name) for name, _ in ranked], edgecolor="#404040", linewidth=0.6)
    axes.bar_label(bars, [f"{100.0 * power / total:.2g} %" if power else "lossless" for _, power in ranked], padding=4)
    axes.margins(x=0.12)
    axes.set_xlabel(f"dissipated power ({unit}), total {total * factor:.4g} {unit}")
    axes.set_title(title)
    axes.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    return save_figure(figure, path)


def draw_convergence(
    size: NDArray[np.float64], errors: Mapping[str, NDArray[np.float64]], path: Path, *, title: str,
    order: float | None = None,
) -> Path:
    """Draw relative errors (n,) over cell `size` (n,) in m, logarithmic.

    A dashed line of slope `order` passes through the finest point of the first.

    Raises:
        ValueError: no errors.
    """
    if not errors:
        raise ValueError("no errors to draw")
    figure = new_figure(6.5, 4.8)
    axes = figure.subplots()
    size = np.asarray(size, dtype=float)
    for index, (name, values) in enumerate(errors.items()):
        axes.loglog(size * 1e6, values, marker="o", color=LINE_COLOURS[index % len(LINE_COLOURS)], label=name)
    if order is not None:
        finest = int(np.argmin(size))
        anchor = float(np.asarray(next(iter(errors.values())))[finest])
        axes.loglog(size * 1e6, anchor * (size / size[finest]) ** order, linestyle="--", color="#888888",
                    label=f"order {order:g}")
    axes.set_xticks(size * 1e6, [f"{value * 1e6:.3g}" for value in size])
    axes.set_xticks([], minor=True)
    axes.set_xlabel("cell size (µm)")
    axes.set_ylabel("relative error")
    axes.set_title(title)
    axes.legend(frameon=False)
    tidy(axes, both=True)
    figure.tight_layout()
    return save_figure(figure, path)


def logarithmic(axes: Axes) -> None:
    """Set a logarithmic axis of y, with plain numbers within a decade."""
    from matplotlib.ticker import LogFormatter

    class Plain(LogFormatter):
        """Plain numbers instead of powers: 50 for 5 x 10^1."""

        def __call__(self, x: float, pos: int | None = None) -> str:
            return f"{x:g}" if super().__call__(x, pos) else ""

    axes.set_yscale("log")
    low, high = axes.get_ylim()
    # Over more than a decade, only powers of ten have labels.
    if high <= 10.0 * low:
        axes.yaxis.set_major_formatter(Plain())
        axes.yaxis.set_minor_formatter(Plain())


def tidy(axes: Axes, *, both: bool = False) -> None:
    """Set light grid lines behind curves, and hide two frame lines. With `both`, minor grid lines too."""
    axes.grid(visible=True, which="both" if both else "major", color="#e4e4e4", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
