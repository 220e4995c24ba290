"""The chip's r-z section, mirrored about its axis: displacement, pressure, Gor'kov potential, regions and mesh.

VTK draws the biquadratic cells off screen, matplotlib frames them: axes in millimetres at equal scale, a colour bar
with its unit, a title with frequency and drive. A complex amplitude is drawn at the phase at which it is largest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from workbench.nodal import FloatArray, IntArray, NodalMesh
from workbench.particles import TrapReport
from workbench.render.canvas import (
    PLAIN_COLOURS,
    SIGNED_COLOURS,
    new_figure,
    photograph,
    prefixed,
    pyvista,
    role_colour,
    save,
    typeset,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from workbench.fields import Fields

#: Width of the drawn section in inches and its resolution: a 20 um layer of a 26 mm chip is more than a dot wide.
_WIDTH = 13.0
_DOTS_PER_INCH = 160
_OUTLINE = "#303030"


@dataclass(frozen=True)
class _Window:
    """The rectangle of the r-z plane that is shown, in metres."""

    left: float
    right: float
    bottom: float
    top: float


def draw_axial_displacement(fields: Fields, path: Path) -> Path:
    """u_z in the solids, fluids left white, as in Fig. 8 of Acevedo-Espinosa et al. (RP-UEIS). Writes `path`."""
    values, phase = at_largest(fields.displacement[:, 1])
    return _draw_signed(
        fields.mesh, values, path, unit="m", label="axial displacement $u_z$", window=_window(fields.mesh.points),
        title=phase_title(fields, phase),
    )


def draw_pressure(fields: Fields, path: Path, *, region: str | None = None) -> Path:
    """Pressure in the fluids of the whole section, or close up in the one `region`. Writes `path`."""
    pressure, shown = fields.pressure, fields.mesh.points
    if region is not None:
        nodes = fields.mesh.nodes_of([region])
        shown = shown[nodes]
        pressure = np.full_like(fields.pressure, np.nan)
        pressure[nodes] = fields.pressure[nodes]
    values, phase = at_largest(pressure)
    return _draw_signed(
        fields.mesh, values, path, unit="Pa", label="acoustic pressure $p$", window=_window(shown),
        title=phase_title(fields, phase),
    )


def draw_gorkov_potential(report: TrapReport, path: Path) -> Path:
    """Gor'kov potential, traps marked, as in Fig. 9a of Acevedo-Espinosa et al. (RP-UEIS). Writes `path`."""
    forces = report.forces
    factor, unit = prefixed(float(np.nanmax(np.abs(forces.potential))), "J")
    values = forces.potential * factor
    limits = float(np.nanmin(values)), float(np.nanmax(values))
    cells = forces.mesh.cells_of([forces.region])
    window = _window(forces.mesh.points[forces.mesh.cells[cells]].reshape(-1, 2))
    figure, axes, bar = _frame(window, title=(
        f"Gor'kov potential of a {2e6 * forces.particle.radius:.3g} µm {forces.particle.name} sphere "
        f"in the {forces.region}\n"
        f"{typeset(forces.excitation)}"
    ))
    axes.imshow(_photograph_cells(forces.mesh, cells, values, window, limits=limits, colours=PLAIN_COLOURS),
                extent=_extent(window), interpolation="antialiased")
    for trap in report.traps:
        place = [sign * trap.radius * 1e3 for sign in ((-1.0, 1.0) if trap.radius > 0.0 else (1.0,))]
        axes.plot(place, [trap.height * 1e3] * len(place), linestyle="", marker="x", color="white", markersize=7,
                  markeredgewidth=1.5, clip_on=False, zorder=5)
    _outline(axes, forces.mesh)
    _colour_bar(figure, bar, limits=limits, colours=PLAIN_COLOURS, label=f"Gor'kov potential $U$ ({unit})")
    return save(figure, path, dots_per_inch=_DOTS_PER_INCH)


def draw_regions(mesh: NodalMesh, path: Path, *, show_cells: bool = True) -> Path:
    """The regions in colour with their names, and the cells of the mesh unless `show_cells` is off. Writes `path`."""
    from matplotlib.patches import Patch

    window = _window(mesh.points)
    figure, axes, bar = _frame(window, title=f"{len(mesh.regions)} regions, {len(mesh.cells)} biquadratic cells")
    colours = [role_colour(name) for name in mesh.regions]
    lines = mesh.cells[:, :4]

    def arrange(plotter: Any) -> None:
        for mirror in (1.0, -1.0):
            for index, colour in enumerate(colours):
                quads = _grid(mesh.points, lines[mesh.region == index], mirror=mirror, kind="QUAD")
                plotter.add_mesh(quads, color=colour, lighting=False, show_edges=show_cells, edge_color="#606060",
                                 edge_opacity=0.4, line_width=0.5)

    axes.imshow(_photograph(window, arrange), extent=_extent(window), interpolation="antialiased")
    _outline(axes, mesh)
    bar.axis("off")
    bar.legend(handles=[Patch(facecolor=colour, edgecolor=_OUTLINE, linewidth=0.5, label=name)
                        for name, colour in zip(mesh.regions, colours, strict=True)],
               loc="center", ncols=min(8, len(colours)), frameon=False, fontsize=10)
    return save(figure, path, dots_per_inch=_DOTS_PER_INCH)


def draw_cells(mesh: NodalMesh, values: FloatArray, path: Path, *, label: str, title: str) -> Path:
    """One value (cells,) in every cell, none of them negative. Writes `path`."""
    window = _window(mesh.points)
    limits = (0.0, float(values.max()) or 1.0)
    figure, axes, bar = _frame(window, title=title)

    def arrange(plotter: Any) -> None:
        for mirror in (1.0, -1.0):
            quads = _grid(mesh.points, mesh.cells[:, :4], mirror=mirror, kind="QUAD")
            quads.cell_data["value"] = values
            plotter.add_mesh(quads, scalars="value", cmap=PLAIN_COLOURS, clim=limits, lighting=False,
                             show_scalar_bar=False)

    axes.imshow(_photograph(window, arrange), extent=_extent(window), interpolation="antialiased")
    _outline(axes, mesh)
    _colour_bar(figure, bar, limits=limits, colours=PLAIN_COLOURS, label=label)
    return save(figure, path, dots_per_inch=_DOTS_PER_INCH)


def at_largest(amplitude: NDArray[Any]) -> tuple[FloatArray, float]:
    """Real part of complex `amplitude` (N,) at the phase at which its largest value is real and positive, and that
    phase in degrees; NaN stays NaN.

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
    """Two lines: frequency and drive, and when in the cycle a field of that `phase` (degrees, e^{-i w t}) is shown."""
    # With e^{-i w t} a larger phase comes later; 360 degrees later is the same time.
    later = round(phase - np.degrees(np.angle(fields.voltage))) % 360
    return (f"{fields.frequency / 1e6:.4f} MHz, {fields.drive}\n"
            f"shown at its maximum in the cycle, {later}° after that of the voltage")


def _draw_signed(
    mesh: NodalMesh, values: FloatArray, path: Path, *, unit: str, label: str, window: _Window, title: str
) -> Path:
    """The cells all of whose nodes have a value, in colours symmetric about zero; the others stay white."""
    largest = float(np.nanmax(np.abs(values)))
    factor, shown_unit = prefixed(largest, unit)
    limits = (-largest * factor or -1.0, largest * factor or 1.0)
    cells = np.flatnonzero(np.isfinite(values[mesh.cells]).all(axis=1))
    figure, axes, bar = _frame(window, title=title)
    axes.imshow(_photograph_cells(mesh, cells, values * factor, window, limits=limits, colours=SIGNED_COLOURS),
                extent=_extent(window), interpolation="antialiased")
    _outline(axes, mesh)
    _colour_bar(figure, bar, limits=limits, colours=SIGNED_COLOURS, label=f"{label} ({shown_unit})")
    return save(figure, path, dots_per_inch=_DOTS_PER_INCH)


def _window(points: FloatArray) -> _Window:
    """All of the (K, 2) `points` and their mirror images, with a margin."""
    radius, low, high = points[:, 0].max(), points[:, 1].min(), points[:, 1].max()
    margin = 0.015 * max(2.0 * radius, high - low)
    return _Window(-radius - margin, radius + margin, low - margin, high + margin)


def _extent(window: _Window) -> tuple[float, float, float, float]:
    return (window.left * 1e3, window.right * 1e3, window.bottom * 1e3, window.top * 1e3)


def _frame(window: _Window, *, title: str) -> tuple[Figure, Axes, Axes]:
    """A figure with axes for the section at equal scale and, below, axes for its colour bar or legend."""
    left, right, below, above = 0.75, 0.25, 1.3, 0.6
    height = (_WIDTH - left - right) * (window.top - window.bottom) / (window.right - window.left)
    total = height + below + above
    figure = new_figure(_WIDTH, total)
    axes = figure.add_axes((left / _WIDTH, below / total, 1.0 - (left + right) / _WIDTH, height / total))
    bar = figure.add_axes((0.3, 0.5 / total, 0.4, 0.16 / total))
    axes.set_xlim(window.left * 1e3, window.right * 1e3)
    axes.set_ylim(window.bottom * 1e3, window.top * 1e3)
    axes.set_aspect("equal")
    axes.set_autoscale_on(False)
    axes.set_xlabel("r (mm)", fontsize=11)
    axes.set_ylabel("z (mm)", fontsize=11)
    axes.set_title(title, fontsize=12)
    # A radius has no sign: the left half is the right half again.
    axes.xaxis.set_major_formatter(lambda value, _: f"{abs(value):g}")
    return figure, axes, bar


def _colour_bar(figure: Figure, bar: Axes, *, limits: tuple[float, float], colours: str, label: str) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    figure.colorbar(ScalarMappable(Normalize(*limits), colours), cax=bar, orientation="horizontal")
    bar.set_xlabel(label, fontsize=11)


def _photograph_cells(
    mesh: NodalMesh, cells: IntArray, values: FloatArray, window: _Window, *, limits: tuple[float, float], colours: str
) -> NDArray[np.uint8]:
    """The `cells` and their mirror images coloured by nodal `values`; the rest white."""

    def arrange(plotter: Any) -> None:
        for mirror in (1.0, -1.0):
            grid = _grid(mesh.points, mesh.cells[cells], mirror=mirror, kind="BIQUADRATIC_QUAD")
            grid.point_data["value"] = values
            plotter.add_mesh(grid, scalars="value", cmap=colours, clim=limits, lighting=False, show_scalar_bar=False)

    return _photograph(window, arrange)


def _photograph(window: _Window, arrange: Callable[[Any], None]) -> NDArray[np.uint8]:
    """A scene in the plane of the section as exactly `window` shows it."""
    width = round((_WIDTH - 1.0) * _DOTS_PER_INCH)
    height = round(width * (window.top - window.bottom) / (window.right - window.left))

    def arrange_flat(plotter: Any) -> None:
        arrange(plotter)
        centre = ((window.left + window.right) / 2.0, (window.bottom + window.top) / 2.0)
        plotter.camera.parallel_projection = True
        plotter.camera.focal_point = (*centre, 0.0)
        plotter.camera.position = (*centre, window.right)
        plotter.camera.up = (0.0, 1.0, 0.0)
        plotter.camera.parallel_scale = (window.top - window.bottom) / 2.0
        plotter.camera.clipping_range = (0.5 * window.right, 2.0 * window.right)

    return photograph(arrange_flat, width=width, height=height)


def _grid(points: FloatArray, cells: IntArray, *, mirror: float, kind: str) -> Any:
    """A pyvista grid of `cells` (m, k) in the plane z = 0 of VTK, r times `mirror` along x."""
    module = pyvista()
    flat = np.column_stack([mirror * points[:, 0], points[:, 1], np.zeros(len(points))])
    return module.UnstructuredGrid({getattr(module.CellType, kind): cells}, flat)


def _outline(axes: Axes, mesh: NodalMesh) -> None:
    """Hair lines around every region."""
    from matplotlib.collections import LineCollection

    lines = mesh.points[outline_nodes(mesh, mesh.regions)[:, :2]] * 1e3
    for mirror in (1.0, -1.0):
        axes.add_collection(LineCollection(list(lines * [mirror, 1.0]), colors=_OUTLINE, linewidths=0.25))


def outline_nodes(mesh: NodalMesh, regions: Sequence[str]) -> IntArray:
    """Edges (L, 3) of the outlines of `regions`, each first node, last node and middle; the axis is left out."""
    cells = mesh.cells[mesh.cells_of(regions)]
    edges = np.concatenate([cells[:, [0, 1, 4]], cells[:, [1, 2, 5]], cells[:, [2, 3, 6]], cells[:, [3, 0, 7]]])
    # Nodes are not shared between regions, so an edge between two regions counts once in each.
    _, first, counts = np.unique(edges[:, 2], return_index=True, return_counts=True)
    outline: IntArray = edges[first[counts == 1]]
    on_axis = (mesh.points[outline, 0] <= 1e-9 * mesh.points[:, 0].max()).all(axis=1)
    return outline[~on_axis]
