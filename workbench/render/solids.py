"""The chip in space: a revolved cutaway coloured by a field, and the solids of its CAD model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from workbench.nodal import FloatArray, IntArray, NodalMesh
from workbench.render.canvas import SIGNED_COLOURS, new_figure, photograph, prefixed, pyvista, save
from workbench.render.sections import at_largest, outlines

if TYPE_CHECKING:
    from workbench.fields import Fields

_WIDTH, _HEIGHT, _DOTS_PER_INCH = 10.0, 6.2, 160
_WATER = "#cfe8f5"


@dataclass(frozen=True, eq=False)
class Solid:
    """A named closed surface: ``vertices`` (N, 3) m, ``triangles`` (M, 3) vertex numbers."""

    name: str
    vertices: FloatArray
    triangles: IntArray


def read_stl(path: Path, *, metres_per_unit: float) -> Solid:
    """The surface in an STL file, named by the file. STL has no unit: CAD programs mostly write millimetres (1e-3).

    Raises:
        FileNotFoundError: no such file.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no STL file at {path}")
    surface = pyvista().read(path)
    return Solid(path.stem, np.asarray(surface.points, dtype=float) * metres_per_unit, surface.regular_faces)


def draw_revolved(fields: Fields, path: Path, *, drive: str, degrees: float = 250.0) -> Path:
    """The section revolved by `degrees`, so that one looks inside: u_z in the solids, fluids in plain pale blue.

    Drawn at the phase at which u_z is largest. Writes `path`.
    """
    mesh = fields.mesh
    values, phase = at_largest(fields.displacement[:, 1])
    largest = float(np.nanmax(np.abs(values)))
    factor, unit = prefixed(largest, "m")
    limits = (-largest * factor or -1.0, largest * factor or 1.0)
    solid = np.isfinite(values[mesh.cells]).all(axis=1)

    def arrange(plotter: Any) -> None:
        for index in range(len(mesh.regions)):
            inside = mesh.region == index
            if solid[inside].all():
                surface = _revolved(mesh, mesh.cells[inside], degrees=degrees, values=values * factor)
                plotter.add_mesh(surface, scalars="value", cmap=SIGNED_COLOURS, clim=limits, show_scalar_bar=False,
                                 ambient=0.35, diffuse=0.7, specular=0.05)
            else:
                surface = _revolved(mesh, mesh.cells[inside], degrees=degrees, values=None)
                plotter.add_mesh(surface, color=_WATER, ambient=0.5, diffuse=0.6)
        for line in _section_outlines(mesh, degrees):
            plotter.add_mesh(line, color="#303030", line_width=1.0, lighting=False)
        _look_from(plotter, azimuth=-90.0 + (degrees - 360.0) / 2.0, elevation=28.0)

    picture = photograph(arrange, width=round(_WIDTH * _DOTS_PER_INCH), height=round(0.74 * _HEIGHT * _DOTS_PER_INCH))
    figure = new_figure(_WIDTH, _HEIGHT)
    axes = figure.add_axes((0.0, 0.15, 1.0, 0.74))
    axes.imshow(picture)
    axes.axis("off")
    axes.set_title(
        f"{drive}: {fields.frequency / 1e6:.4f} MHz, {2.0 * abs(fields.voltage):.3g} Vpp at the transducer\n"
        f"shown at the phase of its maximum, {phase:+.0f}° to the drive; "
        f"Ø {2e3 * mesh.points[:, 0].max():.3g} mm × {1e3 * np.ptp(mesh.points[:, 1]):.3g} mm, fluids pale blue",
        fontsize=11,
    )
    bar = figure.add_axes((0.3, 0.1, 0.4, 0.025))
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    figure.colorbar(ScalarMappable(Normalize(*limits), SIGNED_COLOURS), cax=bar, orientation="horizontal")
    bar.set_xlabel(f"axial displacement $u_z$ ({unit})", fontsize=11)
    return save(figure, path, dots_per_inch=_DOTS_PER_INCH)


def draw_solids(solids: Sequence[Solid], path: Path, *, title: str, opacity: float = 1.0, explode: float = 0.0) -> Path:
    """The solids of a CAD model in different colours with their names, those given first at the bottom of the legend.

    `explode` (m) is the extra gap drawn between consecutive solids along z, so that inner faces can be seen.
    Writes `path`.

    Raises:
        ValueError: no solids.
    """
    if not solids:
        raise ValueError("no solids to draw")
    from matplotlib import colormaps
    from matplotlib.colors import to_hex
    from matplotlib.patches import Patch

    colours = [to_hex(colormaps["Set2"](index % 8)) for index in range(len(solids))]
    module = pyvista()

    def arrange(plotter: Any) -> None:
        for index, (solid, colour) in enumerate(zip(solids, colours, strict=True)):
            lifted = solid.vertices + [0.0, 0.0, explode * index]
            surface = module.PolyData.from_regular_faces(lifted, solid.triangles)
            plotter.add_mesh(surface, color=colour, opacity=opacity, ambient=0.3, diffuse=0.7, specular=0.15)
            # Edges where faces meet at an angle show the shape; the triangles would hide it.
            edges = surface.clean().extract_feature_edges(feature_angle=25.0)
            if edges.n_cells:
                plotter.add_mesh(edges, color="#303030", line_width=1.2, lighting=False)
        _look_from(plotter, azimuth=-60.0, elevation=28.0)

    picture = photograph(arrange, width=round(0.8 * _WIDTH * _DOTS_PER_INCH), height=round(0.9 * _HEIGHT * _DOTS_PER_INCH))
    figure = new_figure(_WIDTH, _HEIGHT)
    axes = figure.add_axes((0.0, 0.0, 0.8, 0.9))
    axes.imshow(picture)
    axes.axis("off")
    span = np.concatenate([solid.vertices for solid in solids])
    size = " × ".join(f"{1e3 * extent:.3g}" for extent in np.ptp(span, axis=0))
    figure.suptitle(f"{title}\n{size} mm" + (f", drawn {explode * 1e3:.3g} mm apart" if explode else ""), fontsize=11)
    figure.legend(handles=[Patch(facecolor=colour, edgecolor="#303030", linewidth=0.5, label=solid.name)
                           for solid, colour in zip(solids, colours, strict=True)][::-1],
                  loc="center left", bbox_to_anchor=(0.8, 0.45), frameon=False, fontsize=11)
    return save(figure, path, dots_per_inch=_DOTS_PER_INCH)


def _look_from(plotter: Any, *, azimuth: float, elevation: float) -> None:
    """Parallel projection from `azimuth` (degrees from +x, about z) and `elevation`, everything in view."""
    turn, rise = np.radians(azimuth), np.radians(elevation)
    direction = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    plotter.camera.parallel_projection = True
    plotter.view_vector(direction, viewup=(0.0, 0.0, 1.0))
    plotter.reset_camera()
    plotter.camera.zoom(1.45)


def _revolved(mesh: NodalMesh, cells: IntArray, *, degrees: float, values: NDArray[Any] | None) -> Any:
    """The surface swept by `cells` about the axis, both ends closed, with point array "value" where given."""
    module = pyvista()
    flat = np.column_stack([mesh.points[:, 0], np.zeros(len(mesh.points)), mesh.points[:, 1]])
    grid = module.UnstructuredGrid({module.CellType.BIQUADRATIC_QUAD: cells}, flat)
    if values is not None:
        grid.point_data["value"] = values
    section = grid.extract_surface(nonlinear_subdivision=1, algorithm="dataset_surface").clean(tolerance=0.0)
    return section.extrude_rotate(resolution=round(degrees / 3.0), angle=degrees, rotation_axis=(0.0, 0.0, 1.0),
                                  capping=True)


def _section_outlines(mesh: NodalMesh, degrees: float) -> list[Any]:
    """The outlines of the regions on the two cut faces."""
    module = pyvista()
    pieces = outlines(mesh)
    result = []
    for angle in (0.0, np.radians(degrees)):
        radius, height = pieces[:, :, 0].ravel(), pieces[:, :, 1].ravel()
        points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
        links = np.column_stack([np.full(len(pieces), 2), np.arange(2 * len(pieces)).reshape(-1, 2)])
        result.append(module.PolyData(points, lines=links.ravel()))
    return result
