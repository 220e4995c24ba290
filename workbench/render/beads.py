"""Particles of a cavity as dots and animations, and their shares."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geometry.measure import Axisymmetric
from workbench.acoustics.captures import Window, arrived_share, light_curve
from workbench.acoustics.nodal import FloatArray, raster
from workbench.acoustics.trajectories import Trajectories
from workbench.acoustics.trajectories import time_text as time_text
from workbench.acoustics.walls import walls_of
from workbench.files.writing import replacing
from workbench.render.canvas import PLAIN_COLOURS, new_figure, prefixed, save_figure, typeset

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import EllipseCollection
    from matplotlib.image import AxesImage
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

#: Colours of particles on white and on the potential, and of outlines.
_DOT, _DOT_ON_POTENTIAL, _OUTLINE = "#d55e00", "#ffffff", "#303030"
#: Least diameter of a dot, as a share of the width of a picture: a bead of 10 um in 8 mm is less than a pixel.
LEAST_DOT = 0.006
#: Largest length of a scale bar, as a share of the width.
SCALE_BAR = 0.25
#: Width of the pictures in inches. The view from above has the size of the cavity, to be laid over a micrograph.
_ABOVE, _SIDE = 6.0, 9.0
#: Ratio of height to width above which panels are in two columns. Doubled, panels of a half channel fill pages.
_BESIDE = 0.5
#: Points of the raster of the potential along r and z.
_RASTER = (400, 120)
#: Frames of an animation, for each second, and dots per inch. Doubled, files are twice (four times) as large.
FRAMES, FRAMES_PER_SECOND, _DOTS_PER_INCH = 60, 12, 80


def draw_from_above(found: Trajectories, path: Path, *, at: float, transparent: bool = False) -> Path:
    """Draw the particles as seen along z at the time `at` (s).

    The picture has a scale bar and the time. It is as wide as the cavity, without a margin, so that it fits over a
    micrograph of the cavity if it is `transparent`. A channel is drawn upright, as a piece of its length with random
    positions along it. Dots are as large as the particles, but at least :data:`LEAST_DOT`.
    """
    figure = new_figure(_ABOVE, _ABOVE * _View.of(found).tallness)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    dots, stamp = _above(axes, found)
    _move_above(dots, stamp, found, _index(found, at))
    if transparent:
        figure.patch.set_alpha(0.0)
    return save_figure(figure, path)


def draw_from_side(found: Trajectories, path: Path, *, at: Sequence[float]) -> Path:
    """Draw the particles on the Gor'kov potential of the section. There is a panel for each of the times `at` (s)."""
    tall = _heights_enlarged(found)
    # Panels that are about as high as wide are side by side.
    columns = min(len(at), 1 if _flatness(found) * tall < _BESIDE else 2)
    rows = math.ceil(len(at) / columns)
    height = 0.35 + (_SIDE - 1.2) / columns * _flatness(found) * tall
    figure = new_figure(_SIDE, height * rows + 1.4)
    figure.set_layout_engine("constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True)
    for axes in panels.ravel()[len(at):]:
        axes.remove()
    for axes, time in zip(panels.ravel(), at, strict=False):
        dots, stamp, shown = _side(axes, found, tall)
        _move_side(dots, stamp, found, _index(found, time))
    for axes in panels.ravel()[len(at) - columns:len(at)]:
        axes.set_xlabel(f"{found.velocity.mesh.measure.symbol} (mm)", fontsize=9)
    unit = _potential(found)[1]
    bar = figure.colorbar(shown, ax=list(panels.ravel()[:len(at)]), location="bottom", shrink=0.4, aspect=40, pad=0.02)
    bar.set_label(f"Gor'kov potential U ({unit})", fontsize=9)
    title = f"{found.report.forces.particle.name}, {2e6 * found.report.forces.particle.radius:.3g} µm"
    if tall > 1.0:
        title += f"; heights are drawn {tall:.0f} times as large as widths"
    figure.suptitle(f"{title}\n{_field_words(found)}", fontsize=9)
    return save_figure(figure, path)


def draw_light_curves(found: Trajectories, windows: Sequence[tuple[str, Window]], path: Path) -> Path:
    """Draw shares of the particles over time. There is a curve for each of the named `windows`, and for focused,
    levitating, trapped and stopped particles."""
    figure = new_figure(7.5, 4.5)
    axes = figure.add_subplot()
    curves = [(f"in the window, {name}", light_curve(found, window), "-") for name, window in windows]
    if 0 in found.report.forces.mesh.measure.focusing:
        curves.append(("have focused across the channel", arrived_share(found, found.focused_at), "-."))
    curves += [("have come to levitate", arrived_share(found, found.levitated_at), "--"),
               ("have come to their trap", arrived_share(found, found.trapped_at), "-."),
               ("stopped by a wall or settled", arrived_share(found, found.stopped_at), ":")]
    for name, curve, style in curves:
        axes.plot(found.times[1:], 100.0 * curve[1:], style, label=name)
    axes.set_xscale("log")
    axes.set_xlim(found.times[1], found.times[-1])
    axes.set_ylim(-2.0, 102.0)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("share of the particles (%)")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=9)
    axes.set_title(_field_words(found), fontsize=9)
    figure.tight_layout()
    return save_figure(figure, path)


def animate_beads(found: Trajectories, path: Path, *, frames: int = FRAMES) -> Path:
    """Write the particles from above and from the side as a GIF.

    It has `frames` of the recorded times.

    Raises:
        ValueError: the suffix of `path` is not .gif.
    """
    from matplotlib.animation import PillowWriter

    if path.suffix.lower() != ".gif":
        raise ValueError(f"cannot write {path.name!r}: the suffix is {path.suffix!r}; expected .gif")
    tall = _heights_enlarged(found)
    high = _ABOVE * _View.of(found).tallness + 1.4
    figure = new_figure(_ABOVE, high)
    above = figure.add_axes((0.1, 1.776 / high, 0.8, 1.0 - 1.924 / high))
    side = figure.add_axes((0.1, 0.518 / high, 0.8, 0.962 / high))
    dots, stamp = _above(above, found)
    dots_beside, stamp_beside, _ = _side(side, found, tall)
    side.set_aspect("auto")
    side.set_xlabel(f"{found.velocity.mesh.measure.symbol} (mm)", fontsize=9)
    writer = PillowWriter(fps=FRAMES_PER_SECOND)
    with replacing(path) as whole, writer.saving(figure, str(whole), dpi=_DOTS_PER_INCH):
        for index in np.unique(np.linspace(0, len(found.times) - 1, frames).round().astype(int)):
            _move_above(dots, stamp, found, int(index))
            _move_side(dots_beside, stamp_beside, found, int(index))
            writer.grab_frame()
    return path


def scale_bar_length(width: float) -> float:
    """A round length, at most :data:`SCALE_BAR` of a `width` (m). It is 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(SCALE_BAR * width))
    return power * max(each for each in (1.0, 2.0, 5.0) if each * power <= SCALE_BAR * width * (1.0 + 1e-9))


def _field_words(found: Trajectories) -> str:
    return typeset(found.forces.excitation)


def _index(found: Trajectories, at: float) -> int:
    return int(np.abs(found.times - at).argmin())


@dataclass(frozen=True)
class _View:
    """A cavity from above: half width and half length (mm), and shape."""

    half_width: float
    half_length: float
    is_round: bool

    @classmethod
    def of(cls, found: Trajectories) -> _View:
        mesh = found.velocity.mesh
        width = 1e3 * float(np.abs(mesh.points[:, 0]).max())
        is_round = isinstance(mesh.measure, Axisymmetric)
        return cls(width, width if is_round else 0.5e3 * found.strip, is_round)

    @property
    def tallness(self) -> float:
        return self.half_length / self.half_width

    def outline(self, axes: Axes) -> None:
        from matplotlib.patches import Circle

        if self.is_round:
            axes.add_patch(Circle((0.0, 0.0), self.half_width, fill=False, edgecolor=_OUTLINE, linewidth=1.2))
        else:
            axes.vlines([-self.half_width, self.half_width], -self.half_length, self.half_length, colors=_OUTLINE,
                        linewidth=2.4)


def _flatness(found: Trajectories) -> float:
    low, high = found.velocity.mesh.points.min(axis=0), found.velocity.mesh.points.max(axis=0)
    return float((high[1] - low[1]) / (high[0] - low[0]))


def _heights_enlarged(found: Trajectories) -> float:
    """Factor of heights, for panels at least 0.15 as high as wide."""
    return float(max(1, math.ceil(0.15 / _flatness(found))))


def _above(axes: Axes, found: Trajectories) -> tuple[EllipseCollection, Text]:
    """Axes with walls, a scale bar, a time stamp and empty dots."""
    from matplotlib.collections import EllipseCollection

    view = _View.of(found)
    radius, top = view.half_width, view.half_length
    axes.set_xlim(-radius, radius)
    axes.set_ylim(-top, top)
    axes.set_aspect("equal")
    axes.axis("off")
    view.outline(axes)
    length = 1e3 * scale_bar_length(2e-3 * radius)
    right, bottom = 0.97 * radius, 0.07 * radius - top
    axes.plot([right - length, right], [bottom, bottom], color=_OUTLINE, linewidth=3.0, solid_capstyle="butt")
    factor, unit = prefixed(1e-3 * length, "m")
    axes.text(right - 0.5 * length, bottom + 0.02 * radius, f"{1e-3 * length * factor:g} {unit}", ha="center",
              va="bottom", fontsize=10, color=_OUTLINE)
    stamp = axes.text(-0.97 * radius, top - 0.05 * radius, "", ha="left", va="top", fontsize=11, color=_OUTLINE)
    diameter = max(2e3 * found.report.forces.particle.radius, LEAST_DOT * 2.0 * radius)
    dots = EllipseCollection([diameter], [diameter], [0.0], units="xy", facecolors=_DOT, edgecolors="none",
                             offsets=np.empty((0, 2)), offset_transform=axes.transData)
    axes.add_collection(dots)
    return dots, stamp


def _move_above(dots: EllipseCollection, stamp: Text, found: Trajectories, index: int) -> None:
    dots.set_offsets(1e3 * found.spatial[:, index, :2])
    stamp.set_text(time_text(float(found.times[index])))


def _potential(found: Trajectories) -> tuple[FloatArray, str]:
    """The potential (N,) in a suitable unit, and the unit."""
    potential = found.forces.potential
    factor, unit = prefixed(float(np.abs(potential).max()), "J")
    return np.asarray(factor * potential), unit


def _side(axes: Axes, found: Trajectories, tall: float) -> tuple[Line2D, Text, AxesImage]:
    """Empty dots, a time stamp and the potential, on axes with walls."""
    from matplotlib.collections import LineCollection

    forces = found.report.forces
    low, high = forces.mesh.points.min(axis=0), forces.mesh.points.max(axis=0)
    r, z = (a + (np.arange(count) + 0.5) * (b - a) / count for a, b, count in zip(low, high, _RASTER, strict=True))
    values = raster(forces.mesh, _potential(found)[0], r, z, [forces.region])
    shown = axes.imshow(values.T[::-1], extent=(1e3 * low[0], 1e3 * high[0], 1e3 * low[1], 1e3 * high[1]),
                        cmap=PLAIN_COLOURS, aspect=tall, interpolation="bilinear")
    walls = walls_of(forces.mesh)
    axes.add_collection(LineCollection(list(1e3 * np.stack([walls.begin, walls.end], axis=1)), colors=_OUTLINE,
                                       linewidths=0.8))
    (dots,) = axes.plot([], [], linestyle="", marker="o", markersize=3.0, color=_DOT_ON_POTENTIAL,
                        markeredgecolor=_OUTLINE, markeredgewidth=0.4, clip_on=False)
    axes.set_ylabel("z (mm)", fontsize=9)
    axes.tick_params(labelsize=8)
    return dots, axes.set_title("", loc="left", fontsize=9), shown


def _move_side(dots: Line2D, stamp: Text, found: Trajectories, index: int) -> None:
    dots.set_data(*(1e3 * found.positions[:, index].T))
    stamp.set_text(time_text(float(found.times[index])))
