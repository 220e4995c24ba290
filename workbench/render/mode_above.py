"""Modes around the axis, or along a channel, as seen from above."""

from __future__ import annotations

import math
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geometry.measure import Axisymmetric
from workbench.acoustics.nodal import FloatArray, NodalMesh, interpolate
from workbench.model.numbers import plain_words
from workbench.render.canvas import SIGNED_COLOURS, new_figure, save_figure

if TYPE_CHECKING:
    from workbench.simulation.modes import ChipMode

#: Letters of a line of the title.
_LETTERS = 80
#: Points of the raster along each side. Doubled, four times as many are computed.
_POINTS = 600
#: Places across the section at which the values are interpolated.
_ACROSS = 1000
#: Distance below the upper face, over the height of the region.
_BELOW = 1e-6


def draw_mode_above(mesh: NodalMesh, mode: ChipMode, path: Path) -> Path:
    """Draw a mode on the upper face of its leading region.

    The region is that of most energy. The picture shows the displacement upwards; in a fluid, the pressure. A channel
    is drawn over one wavelength. Writes `path`.
    """
    from matplotlib.patches import Circle

    region = next(iter(mode.energy))
    is_solid = bool(np.isfinite(mode.shape[1][mesh.nodes_of([region])]).all())
    shown = mode.shape[1] if is_solid else mode.pressure
    width = float(np.abs(mesh.points[mesh.nodes_of([region]), 0]).max())
    is_round = isinstance(mesh.measure, Axisymmetric)
    length = width if is_round else 0.5 * mode.wavelength
    x, y = np.meshgrid(np.linspace(-width, width, _POINTS), np.linspace(-length, length, _POINTS))
    if is_round:
        values = _on_face(mesh, shown, region, np.hypot(x, y)) * np.cos(mode.order * np.arctan2(y, x))
    else:
        across = _on_face(mesh, shown, region, np.abs(x) if mesh.measure.mirror else x)
        side = np.where(x < 0.0, mesh.measure.mirror, 1) if mesh.measure.mirror else 1
        values = across * side * np.cos(2.0 * np.pi * y / mode.wavelength)
    largest = float(np.nanmax(np.abs(values))) or 1.0
    figure = new_figure(7.0, 7.0)
    axes = figure.add_axes((0.12, 0.2, 0.8, 0.66))
    drawn = axes.imshow(np.ma.masked_invalid(values), cmap=SIGNED_COLOURS, vmin=-largest, vmax=largest, origin="lower",
                        extent=(-1e3 * width, 1e3 * width, -1e3 * length, 1e3 * length),
                        aspect="equal" if is_round else "auto", interpolation="nearest")
    if is_round:
        axes.add_patch(Circle((0.0, 0.0), 1e3 * width, fill=False, edgecolor="#303030", linewidth=1.0))
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
    axes.set_title("\n".join((
        f"{mode.frequency / 1e6:.4f} MHz, Q {mode.q:.3g}, upper face of the {plain_words(region)}, from above",
        *textwrap.wrap(mode.words, _LETTERS))), fontsize=9)
    bar = figure.colorbar(drawn, cax=figure.add_axes((0.2, 0.08, 0.6, 0.02)), orientation="horizontal")
    bar.set_label("displacement upwards, over the largest displacement" if is_solid else "pressure, over its maximum")
    return save_figure(figure, path)


def has_view_above(mode: ChipMode) -> bool:
    """Whether the mode varies around the axis or along the channel."""
    return mode.order > 0 or math.isfinite(mode.wavelength)


def _on_face(mesh: NodalMesh, values: FloatArray, region: str, across: FloatArray) -> FloatArray:
    """Nodal `values` (N,) on the upper face of a region.

    They are at places `across` the section; NaN beside the region.
    """
    points = mesh.points[mesh.nodes_of([region])]
    left, right = points[:, 0].min(), points[:, 0].max()
    low, high = points[:, 1].min(), points[:, 1].max()
    places = np.linspace(left, right, _ACROSS)
    inside = np.clip(places, left + _BELOW * (right - left), right - _BELOW * (right - left))
    at = np.column_stack([inside, np.full(_ACROSS, high - _BELOW * (high - low))])
    return np.interp(across, places, interpolate(mesh, values, at, [region]), left=np.nan, right=np.nan)
