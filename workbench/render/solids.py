"""The chip in space: a revolved cutaway coloured by a field, and the solids of its CAD model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from workbench.nodal import FloatArray, IntArray, NodalMesh, borders, edge_nodes, raised, transfer
from workbench.render.canvas import SIGNED_COLOURS, new_figure, photograph, prefixed, pyvista, role_colour, save
from workbench.render.sections import at_largest, phase_title

if TYPE_CHECKING:
    from workbench.fields import Fields

_WIDTH, _HEIGHT, _DOTS_PER_INCH = 10.0, 6.2, 140
#: Order of the nodes between which colours are linear.
_FINER = 8


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


def draw_revolved(fields: Fields, path: Path, *, degrees: float = 250.0) -> Path:
    """The section revolved by `degrees`, so that one looks inside: u_z in the solids, fluids in plain pale blue, and
    nothing where there is nothing.

    Drawn at the phase at which u_z is largest. Writes `path`.
    """
    mesh = fields.mesh
    values, phase = at_largest(fields.displacement[:, 1])
    largest = float(np.nanmax(np.abs(values)))
    factor, unit = prefixed(largest, "m")
    limits = (-largest * factor or -1.0, largest * factor or 1.0)
    solid, fluid = ([bool(np.isfinite(field[mesh.nodes_of([name])]).all()) for name in mesh.regions]
                    for field in (values, fields.pressure))
    there = [name for name, *any_of in zip(mesh.regions, solid, fluid, strict=True) if any(any_of)]

    def arrange(plotter: Any) -> None:
        # The cut faces are unlit, so that their colours are those of the colour bar.
        coloured = {"scalars": "value", "cmap": SIGNED_COLOURS, "clim": limits, "show_scalar_bar": False}
        skin = borders(mesh, np.where(np.isin(mesh.region, [mesh.regions.index(name) for name in there]), 0, -1))
        for index, name in enumerate(mesh.regions):
            if name not in there:
                continue
            finer = raised(mesh, _FINER, name)
            shown = transfer(mesh, values * factor, finer)
            look = {"color": role_colour("cavity")} if fluid[index] else coloured
            plotter.add_mesh(_cut_faces(finer, degrees=degrees, values=shown), lighting=False, **look)
            number = np.cumsum(mesh.region == index) - 1
            edges = np.concatenate([edge_nodes(finer, side, number[cells[mesh.region[cells] == index]])
                                    for side, cells in skin])
            if len(edges):
                swept = _swept(finer, edges, degrees=degrees, values=shown)
                plotter.add_mesh(swept, ambient=0.6, diffuse=0.42, **look)
        plotter.add_mesh(_section_outlines(mesh, degrees), color="#303030", line_width=1.0, lighting=False)
        _look_from(plotter, azimuth=(degrees + 360.0) / 2.0, elevation=24.0, zoom=2.3)

    picture = photograph(arrange, width=round(_WIDTH * _DOTS_PER_INCH), height=round(0.74 * _HEIGHT * _DOTS_PER_INCH))
    figure = new_figure(_WIDTH, _HEIGHT)
    axes = figure.add_axes((0.0, 0.15, 1.0, 0.74))
    axes.imshow(picture)
    axes.axis("off")
    axes.set_title(
        f"{phase_title(fields, phase)}; "
        f"Ø {2e3 * mesh.points[:, 0].max():.3g} mm × {1e3 * np.ptp(mesh.points[:, 1]):.3g} mm"
        f"{', fluids pale blue' if any(fluid) else ''}",
        fontsize=11,
    )
    bar = figure.add_axes((0.3, 0.1, 0.4, 0.025))
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    figure.colorbar(ScalarMappable(Normalize(*limits), SIGNED_COLOURS), cax=bar, orientation="horizontal")
    bar.set_xlabel(f"axial displacement $u_z$ ({unit})", fontsize=11)
    return save(figure, path, dots_per_inch=_DOTS_PER_INCH)


def draw_solids(
    solids: Sequence[Solid], path: Path, *, title: str, opacity: float = 1.0, explode: float = 0.0,
    cut_open: bool = False,
) -> Path:
    """The solids of a CAD model with their names, in the colours of their roles, the first at the bottom of the legend.

    `explode` (m) is the extra gap drawn between consecutive solids along z, so that inner faces can be seen; `cut_open`
    leaves out the half in front of the plane y = 0. Writes `path`.

    Raises:
        ValueError: no solids.
    """
    if not solids:
        raise ValueError("no solids to draw")
    from matplotlib.patches import Patch

    colours = [role_colour(solid.name) for solid in solids]
    module = pyvista()

    def arrange(plotter: Any) -> None:
        for index, (solid, colour) in enumerate(zip(solids, colours, strict=True)):
            lifted = solid.vertices + np.array([0.0, 0.0, explode * index])
            surface = module.PolyData.from_regular_faces(lifted, solid.triangles)
            if cut_open:
                surface = surface.clean().clip_closed_surface(normal=(0.0, 1.0, 0.0), origin=(0.0, 0.0, 0.0))
            plotter.add_mesh(surface, color=colour, opacity=opacity, ambient=0.3, diffuse=0.7, specular=0.15)
            # Edges where faces meet at an angle show the shape; the triangles would hide it.
            edges = surface.clean().extract_feature_edges(feature_angle=25.0)
            if edges.n_cells:
                plotter.add_mesh(edges, color="#303030", line_width=1.2, lighting=False)
        _look_from(plotter, azimuth=-75.0 if cut_open else -60.0, elevation=28.0, zoom=1.3)

    width, height = round(0.8 * _WIDTH * _DOTS_PER_INCH), round(0.9 * _HEIGHT * _DOTS_PER_INCH)
    picture = photograph(arrange, width=width, height=height)
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


def _look_from(plotter: Any, *, azimuth: float, elevation: float, zoom: float) -> None:
    """Parallel projection from `azimuth` (degrees from +x, about z) and `elevation`, everything in view."""
    turn, rise = np.radians(azimuth), np.radians(elevation)
    direction = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    plotter.camera.parallel_projection = True
    plotter.view_vector(direction, viewup=(0.0, 0.0, 1.0))
    plotter.reset_camera()
    plotter.camera.zoom(zoom)


def _turned(points: FloatArray, angle: float) -> FloatArray:
    """Points (K, 2) r, z of the half plane at `angle` (radians) in space (K, 3)."""
    return np.column_stack([points[:, 0] * np.cos(angle), points[:, 0] * np.sin(angle), points[:, 1]])


def _cut_faces(mesh: NodalMesh, *, degrees: float, values: FloatArray) -> Any:
    """The cells of `mesh` on the two faces of the cut, one quadrilateral between four nodes, with point array "value".
    """
    cells = mesh.cells
    quads = np.stack([cells[:, :-1, :-1], cells[:, 1:, :-1], cells[:, 1:, 1:], cells[:, :-1, 1:]], axis=-1)
    quads = quads.reshape(-1, 4)
    both = np.concatenate([quads, quads + len(mesh.points)])
    faces = pyvista().PolyData.from_regular_faces(
        np.concatenate([_turned(mesh.points, angle) for angle in (0.0, np.radians(degrees))]), both)
    faces.point_data["value"] = np.tile(values, 2)
    return faces


def _swept(mesh: NodalMesh, edges: IntArray, *, degrees: float, values: FloatArray) -> Any:
    """The surface swept by `edges` (L, k), lines through k nodes, with point array "value"."""
    nodes, numbers = np.unique(edges, return_inverse=True)
    numbers = numbers.reshape(edges.shape)
    turns = np.radians(np.linspace(0.0, degrees, round(degrees / 2.0) + 1))
    points = np.concatenate([_turned(mesh.points[nodes], angle) for angle in turns])
    first = np.arange(len(turns) - 1)[:, None, None] * len(nodes) + numbers
    quads = np.stack([first[:, :, :-1], first[:, :, 1:], first[:, :, 1:] + len(nodes), first[:, :, :-1] + len(nodes)],
                     axis=-1).reshape(-1, 4)
    surface = pyvista().PolyData.from_regular_faces(points, quads)
    surface.point_data["value"] = np.tile(values[nodes], len(turns))
    return surface


def _section_outlines(mesh: NodalMesh, degrees: float) -> Any:
    """The outlines of the regions on the two cut faces, a hair in front of them."""
    edges = np.concatenate([edge_nodes(mesh, side, cells)[:, [0, -1]] for side, cells in borders(mesh, mesh.region)])
    pieces = mesh.points[edges].reshape(-1, 2)
    front = 1e-3 * mesh.points[:, 0].max()
    points = []
    for angle, side in ((0.0, -1.0), (np.radians(degrees), 1.0)):
        normal = side * front * np.array([-np.sin(angle), np.cos(angle), 0.0])
        points.append(_turned(pieces, angle) + normal)
    count = 2 * len(edges)
    links = np.column_stack([np.full(count, 2), np.arange(2 * count).reshape(-1, 2)]).ravel()
    return pyvista().PolyData(np.concatenate(points), lines=links)
