"""The chip's r-z section: displacement, pressure, potential, streaming, regions, mesh.

It is mirrored about its axis. Every dot is the value of its cell's own polynomial there, so a picture is smooth for
cells of any size. Matplotlib frames it: axes in millimetres at equal scale (a flat section has its heights enlarged,
with a note), a colour bar with its unit, a title with frequency and drive. A complex amplitude is drawn at the phase at
which it is largest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from geometry.measure import ABOUT_AXIS, Axisymmetric, Measure
from workbench.acoustics.nodal import (
    FloatArray,
    NodalMesh,
    border_lines,
    borders,
    cell_raster,
    edge_nodes,
    interpolate,
    raster,
)
from workbench.acoustics.streaming import Streaming
from workbench.acoustics.traps import TrapReport
from workbench.files.writing import replacing
from workbench.render.canvas import (
    PLAIN_COLOURS,
    POINTS_PER_DOT,
    SIGNED_COLOURS,
    coloured_dots,
    new_figure,
    prefixed,
    role_colour,
    save_figure,
    typeset,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

    from workbench.acoustics.fields import Fields
    from workbench.simulation.modes import ChipMode

#: Width of the drawn section in inches and its resolution: a 20 um layer of a 26 mm chip is more than a dot wide.
_WIDTH = 13.0
_DOTS_PER_INCH = 160
_OUTLINE = "#303030"
#: Colours of marked regions, and of all others.
_MARKED, _UNMARKED = "#d55e00", "#eeeeee"
#: Thickness of a region, as a share of the section's height, below which an arrow points at it too.
_THIN = 0.02
#: Speed relative to the largest one below which a flow has no arrow: the error of the mesh may change its direction.
_STILL = 0.01
#: Arrows of a flow along the radius.
_ARROWS = 40
#: Colours of the pressure beside displacements.
_PRESSURE_COLOURS = "PuOr_r"
#: Frames of a cycle of a mode, a second long, their dots per inch, and the largest displacement over the height.
#: Doubled, files are twice, or four times, as large.
_FRAMES, _MOVING_DOTS_PER_INCH, _MOVED = 16, 80, 0.06
#: Least ratio of height to width; heights of a flatter section are enlarged. Doubled, those of a whole chip would be.
_FLATTEST = 0.08


@dataclass(frozen=True)
class _Window:
    """The drawn rectangle of the r-z plane (m). ``tall`` is the factor by which heights are enlarged. ``measure`` is
    that of the section, with the sign of the mirror image in the left half, if any."""

    left: float
    right: float
    bottom: float
    top: float
    tall: float = 1.0
    measure: Measure = ABOUT_AXIS

    @property
    def is_mirrored(self) -> bool:
        return self.measure.mirror != 0


def draw_axial_displacement(fields: Fields, path: Path) -> Path:
    """Draw u_z in the solids, with white fluids. As in Fig. 8 of Acevedo-Espinosa et al. (RP-UEIS)."""
    values, phase = at_largest(fields.displacement[:, 1])
    return _draw_signed(
        fields.mesh, values, path, unit="m", label="axial displacement u_z",
        window=_window(fields.mesh.points, fields.mesh.measure), title=phase_title(fields, phase),
    )


def draw_mode(mesh: NodalMesh, mode: ChipMode, path: Path) -> Path:
    """Draw a `mode` in the section. Writes `path`.

    It is the leading displacement in solids, and the pressure in fluids.
    """
    drawing = _DrawnMode.of(mesh, mode)
    figure, axes = drawing.framed()
    drawing.show(axes, 1.0)
    _outline(axes, mesh)
    return save_figure(figure, path, dots_per_inch=_DOTS_PER_INCH)


def animate_mode(mesh: NodalMesh, mode: ChipMode, path: Path) -> Path:
    """Write a cycle of a `mode` as a GIF, with moving outlines.

    The colours are those of :func:`draw_mode`. The largest displacement is drawn as :data:`_MOVED` of the height.
    """
    from matplotlib.animation import PillowWriter
    from matplotlib.collections import LineCollection

    drawing = _DrawnMode.of(mesh, mode)
    # Half of the dots each way.
    across, up = (size - size % (2 * POINTS_PER_DOT) for size in drawing.solid.shape)
    drawing = replace(drawing, solid=drawing.solid[:across:2, :up:2], liquid=drawing.liquid[:across:2, :up:2])
    figure, axes = drawing.framed()
    lines = LineCollection([], colors=_OUTLINE, linewidths=0.8)
    axes.add_collection(lines)
    image = None
    writer = PillowWriter(fps=_FRAMES)
    with replacing(path) as whole, writer.saving(figure, str(whole), dpi=_MOVING_DOTS_PER_INCH):
        for frame in range(_FRAMES):
            now = math.cos(2.0 * math.pi * frame / _FRAMES)
            if image is not None:
                image.remove()
            image = drawing.show(axes, now)
            lines.set_segments(drawing.moved_edges(now))
            writer.grab_frame()
    return path


@dataclass(frozen=True, eq=False)
class _DrawnMode:
    """A mode in its window.

    ``leading`` is the component of the displacement that is drawn. ``solid`` and ``liquid`` are it and the pressure at
    the points of a picture, NaN elsewhere; ``images`` are the signs in the mirror image of the components and, last, of
    the pressure.
    """

    mesh: NodalMesh
    mode: ChipMode
    window: _Window
    leading: int
    solid: FloatArray
    liquid: FloatArray
    images: tuple[int, int, int, int]

    @classmethod
    def of(cls, mesh: NodalMesh, mode: ChipMode) -> _DrawnMode:
        leading = int(np.argmax(np.nansum(mode.shape**2, axis=1)))
        window = _window(mesh.points, mesh.measure)
        # On the other side cos(m t) has the sign (-1)^m, and a displacement away from the axis points to the left.
        scalar = (-1 if mesh.measure.mirror < 0 else 1) * (-1) ** mode.order
        return cls(mesh, mode, window, leading, _nodal(mesh, mode.shape[leading], window),
                   _nodal(mesh, mode.pressure, window), (-scalar, scalar, scalar, scalar))

    def framed(self) -> tuple[Figure, Axes]:
        """A figure with its colour bars, and axes for the section."""
        figure, axes, bar = _frame(self.window, title=(
            f"{self.mode.frequency / 1e6:.4f} MHz, Q {self.mode.q:.3g}\n{self.mode.words}"))
        way = ("to the right", "upwards", "along the third direction")[self.leading]
        limits, low, high = self._limits, bar.get_position().y0, bar.get_position().height
        if self._has_liquid:
            bar.set_position((0.08, low, 0.38, high))
            beside = figure.add_axes((0.54, low, 0.38, high))
            _colour_bar(figure, beside, limits=(-1.0, 1.0), colours=_PRESSURE_COLOURS,
                        label="pressure, over its maximum")
        _colour_bar(figure, bar, limits=limits, colours=SIGNED_COLOURS,
                    label=f"displacement {way}, over the largest displacement")
        return figure, axes

    def show(self, axes: Axes, now: float) -> AxesImage:
        """Draw the fields times the factor `now`."""
        dots = _picture(self.window, self.solid * now, limits=self._limits, colours=SIGNED_COLOURS,
                        image=self.images[self.leading])
        if self._has_liquid:
            liquid = _picture(self.window, self.liquid * now, limits=(-1.0, 1.0), colours=_PRESSURE_COLOURS,
                              image=self.images[-1])
            dots = np.minimum(dots, liquid)  # Each is white where the other has its values.
        return _show_dots(axes, self.window, dots)

    def moved_edges(self, now: float) -> list[FloatArray]:
        """The edges of regions (2, 2; mm), mirrored too.

        They are moved by the displacement times `now`.
        """
        pairs = [np.stack([nodes[:, :-1], nodes[:, 1:]], axis=2).reshape(-1, 2) for nodes in (
            edge_nodes(self.mesh, side, cells) for side, cells in borders(self.mesh, self.mesh.region))]
        ends = np.concatenate(pairs)
        factor = now * _MOVED * (self.window.top - self.window.bottom)
        move = factor * self.mode.shape[:2].T[ends]
        move[:, :, 0] *= self.window.tall
        solid = np.isfinite(move).all(axis=(1, 2))
        rest, move = self.mesh.points[ends[solid]], move[solid]
        edges = [rest + move]
        if self.mesh.measure.mirror:
            edges.append(rest * [-1.0, 1.0] + move * [-self.images[1], self.images[1]])
        return list(np.concatenate(edges) * 1e3)

    @property
    def _has_liquid(self) -> bool:
        return bool(np.isfinite(self.liquid).any())

    @property
    def _limits(self) -> tuple[float, float]:
        largest = float(np.nanmax(np.abs(self.mode.shape[self.leading])))
        return -largest, largest


def draw_pressure(fields: Fields, path: Path, *, region: str | None = None) -> Path:
    """Draw the pressure in all fluids, or close up in one `region`."""
    pressure, shown = fields.pressure, fields.mesh.points
    if region is not None:
        nodes = fields.mesh.nodes_of([region])
        shown = shown[nodes]
        pressure = np.full_like(fields.pressure, np.nan)
        pressure[nodes] = fields.pressure[nodes]
    values, phase = at_largest(pressure)
    return _draw_signed(
        fields.mesh, values, path, unit="Pa", label="acoustic pressure p", window=_window(shown, fields.mesh.measure),
        title=phase_title(fields, phase),
    )


def draw_gorkov_potential(report: TrapReport, path: Path) -> Path:
    """Draw the Gor'kov potential with its traps. As in Fig. 9a of Acevedo-Espinosa et al. (RP-UEIS)."""
    forces = report.forces
    factor, unit = prefixed(float(np.nanmax(np.abs(forces.potential))), "J")
    values = forces.potential * factor
    limits = float(np.nanmin(values)), float(np.nanmax(values))
    window = _window(forces.mesh.points, forces.mesh.measure)
    figure, axes, bar = _frame(window, title=(
        f"Gor'kov potential of a {2e6 * forces.particle.radius:.3g} µm {forces.particle.name} sphere "
        f"in the {forces.region}\n"
        f"{typeset(forces.excitation)}"
    ))
    _show(axes, window, _nodal(forces.mesh, values, window), limits=limits, colours=PLAIN_COLOURS)
    for trap in report.traps:
        images = (-1.0, 1.0) if window.is_mirrored and trap.radius > 0.0 else (1.0,)
        place = [sign * trap.radius * 1e3 for sign in images]
        axes.plot(place, [trap.height * 1e3] * len(place), linestyle="", marker="x", color="white", markersize=7,
                  markeredgewidth=1.5, clip_on=False, zorder=5)
    _outline(axes, forces.mesh)
    _colour_bar(figure, bar, limits=limits, colours=PLAIN_COLOURS, label=f"Gor'kov potential U ({unit})")
    return save_figure(figure, path, dots_per_inch=_DOTS_PER_INCH)


def draw_streaming(flow: Streaming, path: Path) -> Path:
    """Draw the speed at which the liquid carries particles, with arrows. Arrows have one length, and are omitted below
    :data:`_STILL` of the largest speed; the title gives the limit."""
    speed = np.linalg.norm(flow.carrier_velocity, axis=1)
    factor, unit = prefixed(flow.largest_speed, "m/s")
    least = _STILL * flow.largest_speed
    window = _window(flow.mesh.points, flow.mesh.measure)
    peclet = "" if flow.peclet is None else f", Peclet number {flow.peclet:.2g}"
    figure, axes, bar = _frame(window, title=(
        f"streaming in the {flow.region}: {factor * flow.rms_speed:.3g} {unit} rms{peclet}; no arrows below "
        f"{factor * least:.2g} {unit}\n{typeset(flow.excitation)}"))
    limits = (0.0, flow.largest_speed * factor or 1.0)
    _show(axes, window, _nodal(flow.mesh, speed * factor, window), limits=limits, colours=PLAIN_COLOURS)
    _outline(axes, flow.mesh)
    step, sides = window.right / _ARROWS, (1.0, -1.0) if window.is_mirrored else (1.0,)
    places = np.stack(np.meshgrid(
        np.arange(0.5 * step if window.is_mirrored else window.left + 0.5 * step, window.right, step),
        np.arange(window.bottom + 0.5 * step / window.tall, window.top, step / window.tall), indexing="ij"),
        axis=-1).reshape(-1, 2)
    arrows = interpolate(flow.mesh, flow.carrier_velocity, places, [flow.region])
    size = np.linalg.norm(arrows, axis=1)
    seen = size > max(least, np.finfo(float).tiny)  # NaN, outside the region, is not.
    ends, ways = places[seen] * 1e3, arrows[seen] / size[seen, None]
    for side in sides:
        axes.quiver(side * ends[:, 0], ends[:, 1], side * ways[:, 0], ways[:, 1], angles="xy", pivot="middle",
                    color="white", units="inches", scale=1.0 / (0.7 * step / window.right * 0.5 * _WIDTH), width=0.012)
    _colour_bar(figure, bar, limits=limits, colours=PLAIN_COLOURS, label=f"speed of the liquid ({unit})")
    return save_figure(figure, path, dots_per_inch=_DOTS_PER_INCH)


def draw_regions(mesh: NodalMesh, path: Path, *, show_cells: bool = True) -> Path:
    """Draw the regions in colour with names, and the mesh's cells."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Patch

    window = _window(mesh.points, mesh.measure)
    figure, axes, bar = _frame(
        window, title=f"{len(mesh.regions)} regions, {len(mesh.cells)} cells with fields of order {mesh.order}")
    colours = [role_colour(name) for name in mesh.regions]
    _show(axes, window, cell_raster(mesh, mesh.region, *_raster_points(window)), limits=(0.0, len(colours) - 1.0),
          colours=colours)
    if show_cells:
        lines = _segments(mesh, np.arange(len(mesh.cells)))
        axes.add_collection(LineCollection(lines, colors="#606060", alpha=0.5, linewidths=0.4))
    _outline(axes, mesh)
    bar.axis("off")
    bar.legend(handles=[Patch(facecolor=colour, edgecolor=_OUTLINE, linewidth=0.5, label=name)
                        for name, colour in zip(mesh.regions, colours, strict=True)],
               loc="center", ncols=min(8, len(colours)), frameon=False, fontsize=10)
    return save_figure(figure, path, dots_per_inch=_DOTS_PER_INCH)


def draw_marked(mesh: NodalMesh, marked: Sequence[str], path: Path, *, title: str) -> Path:
    """Draw the `marked` regions in colour, the others in pale grey.

    Raises:
        ValueError: a marked region that the mesh does not have.
    """
    from matplotlib.patches import Patch

    for name in marked:
        if name not in mesh.regions:
            raise ValueError(f"no region {name!r} to mark; expected one of {', '.join(mesh.regions)}")
    window = _window(mesh.points, mesh.measure)
    figure, axes, bar = _frame(window, title=title)
    colours = [_MARKED if name in marked else _UNMARKED for name in mesh.regions]
    _show(axes, window, cell_raster(mesh, mesh.region, *_raster_points(window)), limits=(0.0, len(colours) - 1.0),
          colours=colours)
    _outline(axes, mesh)
    for name in marked:
        points = mesh.points[mesh.nodes_of([name])] * 1e3
        low, high = points[:, 1].min(), points[:, 1].max()
        if high - low < _THIN * 1e3 * (window.top - window.bottom):
            axes.annotate(name, (points[:, 0].max(), 0.5 * (low + high)), (-4, 14), textcoords="offset points",
                          ha="right", fontsize=11, color=_MARKED, arrowprops={"arrowstyle": "->", "color": _MARKED})
    bar.axis("off")
    bar.legend(handles=[Patch(facecolor=_MARKED, label=", ".join(marked) or "nothing"),
                        Patch(facecolor=_UNMARKED, edgecolor=_OUTLINE, linewidth=0.5, label="all else")],
               loc="center", ncols=2, frameon=False, fontsize=10)
    return save_figure(figure, path, dots_per_inch=_DOTS_PER_INCH)


def at_largest(amplitude: NDArray[Any]) -> tuple[FloatArray, float]:
    """Real part of complex `amplitude` (N,) at the phase of its maximum.

    At that phase, also returned in degrees, its largest value is real and positive. NaN stays NaN.

    Raises:
        ValueError: nothing is finite.
    """
    finite = np.isfinite(amplitude)
    if not finite.any():
        raise ValueError("no finite value to draw: the field does not live in any region of this mesh")
    largest = amplitude[np.argmax(np.where(finite, np.abs(amplitude), -1.0))]
    phase = float(np.angle(largest))
    shown: FloatArray = np.real(amplitude * np.exp(-1j * phase))
    return shown, float(np.degrees(phase))


def phase_title(fields: Fields, phase: float) -> str:
    """Two lines: frequency and drive, and the instant of a `phase`. The instant in the cycle is after the maximum of
    the voltage; `phase` is in degrees, e^{-i w t}."""
    # With e^{-i w t} a larger phase comes later; 360 degrees later is the same time.
    later = round(phase - np.degrees(np.angle(fields.voltage))) % 360
    return (f"{fields.frequency / 1e6:.4f} MHz, {fields.drive}\n"
            f"shown at its maximum in the cycle, {later}° after that of the voltage")


def _draw_signed(
    mesh: NodalMesh, values: FloatArray, path: Path, *, unit: str, label: str, window: _Window, title: str,
    image: int | None = None,
) -> Path:
    """Draw regions with a value at all nodes, the others white. Colours are symmetric about zero.

    `image` is the sign of the values in the mirror image, by default that of scalar fields.
    """
    image = image or (-1 if window.measure.mirror < 0 else 1)
    largest = float(np.nanmax(np.abs(values)))
    factor, shown_unit = prefixed(largest, unit) if unit else (1.0, "")
    limits = (-largest * factor or -1.0, largest * factor or 1.0)
    figure, axes, bar = _frame(window, title=title)
    _show(axes, window, _nodal(mesh, values * factor, window), limits=limits, colours=SIGNED_COLOURS, image=image)
    _outline(axes, mesh)
    label = f"{label} ({shown_unit})" if shown_unit else label
    _colour_bar(figure, bar, limits=limits, colours=SIGNED_COLOURS, label=label)
    return save_figure(figure, path, dots_per_inch=_DOTS_PER_INCH)


def _window(points: FloatArray, measure: Measure = ABOUT_AXIS) -> _Window:
    """The window of `points` (K, 2) and their mirror images."""
    radius, low, high = np.abs(points[:, 0]).max(), points[:, 1].min(), points[:, 1].max()
    margin = 0.015 * max(2.0 * radius, high - low)
    below = min(margin, 0.1 * (high - low))
    flat = 2.0 * radius * _FLATTEST / (high - low)
    return _Window(-radius - margin, radius + margin, low - below, high + below, float(max(1, math.ceil(flat))),
                   measure)


def _extent(window: _Window) -> tuple[float, float, float, float]:
    return (window.left * 1e3, window.right * 1e3, window.bottom * 1e3, window.top * 1e3)


def _frame(window: _Window, *, title: str) -> tuple[Figure, Axes, Axes]:
    """A figure with axes for the section and for a legend."""
    left, right, below, above = 0.75, 0.25, 1.3, 0.6
    height = window.tall * (_WIDTH - left - right) * (window.top - window.bottom) / (window.right - window.left)
    if window.tall > 1.0:
        title += f"\nheights are drawn {window.tall:.0f} times as large as widths"
        above += 0.25
    total = height + below + above
    figure = new_figure(_WIDTH, total)
    axes = figure.add_axes((left / _WIDTH, below / total, 1.0 - (left + right) / _WIDTH, height / total))
    bar = figure.add_axes((0.3, 0.5 / total, 0.4, 0.16 / total))
    axes.set_xlim(window.left * 1e3, window.right * 1e3)
    axes.set_ylim(window.bottom * 1e3, window.top * 1e3)
    axes.set_aspect(window.tall)
    axes.set_autoscale_on(False)
    axes.set_xlabel(f"{window.measure.symbol} (mm)", fontsize=11)
    axes.set_ylabel("z (mm)", fontsize=11)
    # A fixed place is faster: the axes need not measure the artists above them.
    axes.set_title(title, fontsize=12, y=1.0)
    if isinstance(window.measure, Axisymmetric):
        # A radius has no sign: the left half is the right half again.
        axes.xaxis.set_major_formatter(lambda value, _: f"{abs(value):g}")
    return figure, axes, bar


def _colour_bar(figure: Figure, bar: Axes, *, limits: tuple[float, float], colours: str, label: str) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    figure.colorbar(ScalarMappable(Normalize(*limits), colours), cax=bar, orientation="horizontal")
    bar.set_xlabel(label, fontsize=11)


def _dots(window: _Window) -> tuple[int, int]:
    """Width (even) and height in dots of a picture of `window`."""
    width = 2 * round((_WIDTH - 1.0) * _DOTS_PER_INCH / 2.0)
    return width, round(window.tall * width * (window.top - window.bottom) / (window.right - window.left))


def _raster_points(window: _Window) -> tuple[FloatArray, FloatArray]:
    """Radii and heights (m) of the points of a picture, ascending. They are right of the axis, or everywhere if the
    section has no mirror image."""
    width, height = _dots(window)
    across, up = POINTS_PER_DOT * width // (2 if window.is_mirrored else 1), POINTS_PER_DOT * height
    left = 0.0 if window.is_mirrored else window.left
    return (left + (np.arange(across) + 0.5) * (window.right - left) / across,
            window.bottom + (np.arange(up) + 0.5) * (window.top - window.bottom) / up)


def _nodal(mesh: NodalMesh, values: FloatArray, window: _Window) -> FloatArray:
    """Nodal `values` (N,) at the points of a picture. NaN in regions without all values."""
    regions = [name for name in mesh.regions if np.isfinite(values[mesh.nodes_of([name])]).all()]
    return raster(mesh, values, *_raster_points(window), regions)


def _show(
    axes: Axes, window: _Window, values: FloatArray, *, limits: tuple[float, float], colours: str | Sequence[str],
    image: int = 1,
) -> None:
    """Draw `values` at :func:`_raster_points` and mirrored, NaN white. `colours` is the name of a map, or one colour
    for every step between `limits`. `image` is the sign of the values in the mirror image."""
    _show_dots(axes, window, _picture(window, values, limits=limits, colours=colours, image=image))


def _picture(
    window: _Window, values: FloatArray, *, limits: tuple[float, float], colours: str | Sequence[str], image: int
) -> NDArray[np.uint8]:
    """The dots of :func:`_show`."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    shades = colormaps[colours] if isinstance(colours, str) else ListedColormap(list(colours))
    seen = values.T[::-1]
    right = coloured_dots(seen, shades, limits)
    if not window.is_mirrored:
        return right
    left = right if image > 0 else coloured_dots(-seen, shades, limits)
    return np.concatenate([left[:, ::-1], right], axis=1)


def _show_dots(axes: Axes, window: _Window, picture: NDArray[np.uint8]) -> AxesImage:
    # Dot for dot: another interpolation blurs them, and doubles the time of a picture.
    return axes.imshow(picture, extent=_extent(window), interpolation="nearest", aspect=window.tall)


def _outline(axes: Axes, mesh: NodalMesh) -> None:
    from matplotlib.collections import LineCollection

    axes.add_collection(LineCollection(region_edges(mesh), colors=_OUTLINE, linewidths=0.25))


def region_edges(mesh: NodalMesh) -> list[FloatArray]:
    """The edges of cells (2, 2; mm) that bound regions, mirrored too."""
    return _segments(mesh, mesh.region)


def _segments(mesh: NodalMesh, label: NDArray[np.int64]) -> list[FloatArray]:
    """Edges (2, 2; mm) between cells of different `label` (M,), mirrored too."""
    ends = mesh.points[border_lines(mesh, label)] * 1e3
    whole = np.unique(ends.round(6).reshape(-1, 4), axis=0).reshape(-1, 2, 2)
    return list(np.concatenate([whole, whole * [-1.0, 1.0]]) if mesh.measure.mirror else whole)
