"""The sound in the cavity, as seen from above."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.render.canvas import PLAIN_COLOURS, new_figure, prefixed, save_figure
from workbench.simulation.pattern import CavityPattern

Real = NDArray[np.float64]

#: Points of the raster along each side. Doubled, four times as many are computed.
_POINTS = 200


def draw_pattern(pattern: CavityPattern, path: Path) -> Path:
    """Draw the pressure amplitude at the height where it is largest.

    The Gor'kov potential of a particle, if any, at the height of its deepest trap is drawn beside it, with all traps
    whose height is within a sixteenth of a wavelength. Writes `path`.
    """
    from matplotlib.patches import Circle

    radius = 1e3 * pattern.radius
    found, has_particle = pattern.traps, pattern.forces is not None
    figure = new_figure(11.0 if has_particle else 5.5, 5.2)
    axes = figure.subplots(1, 2 if has_particle else 1, squeeze=False)[0]
    panels = [(pattern.height, "pressure amplitude", "Pa", _on_raster(
        pattern.radius, pattern.height, lambda places, angles: np.abs(pattern.pressure(places, angles))))]
    if has_particle:
        height = found[0].height if found else pattern.height
        panels.append((height, "Gor'kov potential", "J", _on_raster(pattern.radius, height, pattern.potential)))
    for axis, (height, words, unit, values) in zip(axes, panels, strict=True):
        factor, shown = prefixed(float(np.nanmax(np.abs(values))), unit)
        drawn = axis.imshow(np.ma.masked_invalid(values * factor), cmap=PLAIN_COLOURS, origin="lower",
                            extent=(-radius, radius, -radius, radius), interpolation="nearest")
        figure.colorbar(drawn, ax=axis, label=f"{words} ({shown})", shrink=0.75)
        axis.set(title=f"z = {1e3 * height:.3f} mm", xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    if found:
        near = [trap for trap in found if abs(trap.height - found[0].height) < pattern.wavelength / 16.0]
        places = np.array([trap.radius * np.exp(1j * trap.angle) for trap in near if trap.angle is not None])
        for ring in (trap for trap in near if trap.angle is None):
            axes[-1].add_patch(Circle((0.0, 0.0), 1e3 * ring.radius, fill=False, edgecolor="#d55e00"))
        axes[-1].plot(1e3 * places.real, 1e3 * places.imag, "o", markerfacecolor="none", markeredgecolor="#d55e00",
                      label="traps")
        axes[-1].legend(loc="upper right")
    figure.suptitle(f"in the cavity at {pattern.frequency / 1e6:.4f} MHz, from above", fontsize=10)
    return save_figure(figure, path)


def _on_raster(radius: float, height: float, values_at: Callable[[Real, Real], Real]) -> Real:
    """Values at places and angles on a square (m, m).

    The square is at a `height` (m), with NaN beyond the `radius` (m) of the cavity. `values_at` gives the values (n, a)
    at places (n, 2) in m and angles (a,) in rad.
    """
    ends = np.linspace(-radius, radius, _POINTS)
    x, y = np.meshgrid(ends, ends)
    r, angles = np.linspace(0.0, radius, _POINTS), np.linspace(-np.pi, np.pi, 2 * _POINTS + 1)
    places = np.column_stack([r, np.full(r.size, height)])
    values = values_at(places, angles)
    # The nearest place of the polar raster is closer than a point of the picture.
    across = np.round(np.hypot(x, y) / radius * (r.size - 1)).astype(int)
    around = np.round((np.arctan2(y, x) + np.pi) / (2.0 * np.pi) * (angles.size - 1)).astype(int)
    return np.where(across < r.size, values[np.minimum(across, r.size - 1), around], np.nan)
