"""The chip in space: a revolved section, and CAD solids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry.measure import Axisymmetric
from workbench.acoustics.nodal import (
    FloatArray,
    IntArray,
    NodalMesh,
    border_lines,
    borders,
    edge_nodes,
    raised,
    transfer,
)
from workbench.render.canvas import (
    SIGNED_COLOURS,
    DrawnShape,
    new_figure,
    photograph,
    prefixed,
    role_colour,
    save_figure,
    surface,
    vtk_modules,
)
from workbench.render.sections import at_largest, phase_title

if TYPE_CHECKING:
    from workbench.acoustics.fields import Fields

_WIDTH, _HEIGHT, _DOTS_PER_INCH = 10.0, 6.2, 140
#: Order of the refined nodes between which colours are interpolated linearly.
_FINER = 4


@dataclass(frozen=True, eq=False)
class Solid:
    """A named closed surface. ``vertices`` (N, 3) are in m, ``triangles`` (M, 3) are vertex numbers."""

    name: str
    vertices: FloatArray
    triangles: IntArray


def read_stl(path: Path, *, metres_per_unit: float) -> Solid:
    """Read the surface in an STL file, named after the file.

    STL has no unit: CAD programs mostly write millimetres (1e-3).

    Raises:
        FileNotFoundError: no such file.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no STL file at {path}")
    (files,) = vtk_modules("vtkIOGeometry")
    reader = files.vtkSTLReader()
    reader.SetFileName(str(path))
    reader.Update()
    points, triangles = _arrays(reader.GetOutput(), 3)
    return Solid(path.stem, points * metres_per_unit, triangles)


def draw_revolved(fields: Fields, path: Path, *, degrees: float = 250.0) -> Path:
    """Draw the section revolved by `degrees`, cut open.

    It shows u_z in the solids at the phase of its maximum, pale blue fluids, and no vacuum.

    Raises:
        ValueError: the section is straight.
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    mesh = fields.mesh
    if not isinstance(mesh.measure, Axisymmetric):
        raise ValueError("the section is straight; expected one that turns about its axis")
    values, phase = at_largest(fields.displacement[:, 1])
    largest = float(np.nanmax(np.abs(values)))
    factor, unit = prefixed(largest, "m")
    limits = (-largest * factor or -1.0, largest * factor or 1.0)
    solid, fluid = ([bool(np.isfinite(field[mesh.nodes_of([name])]).all()) for name in mesh.regions]
                    for field in (values, fields.pressure))
    there = [name for name, *any_of in zip(mesh.regions, solid, fluid, strict=True) if any(any_of)]

    shades, scale = colormaps[SIGNED_COLOURS], Normalize(*limits)
    # The cut faces are unlit, so that their colours are those of the colour bar.
    shapes = [DrawnShape(*_section_outlines(mesh, degrees), "#303030")]
    skin = borders(mesh, np.where(np.isin(mesh.region, [mesh.regions.index(name) for name in there]), 0, -1))
    for index, name in enumerate(mesh.regions):
        if name not in there:
            continue
        finer = raised(mesh, _FINER, name)
        colours = shades(scale(transfer(mesh, values * factor, finer)), bytes=True)[:, :3]
        plain = role_colour("cavity") if fluid[index] else None
        points, cells = _cut_faces(finer, degrees=degrees)
        shapes.append(DrawnShape(points, cells, plain or np.tile(colours, (2, 1))))
        number = np.cumsum(mesh.region == index) - 1
        edges = np.concatenate([edge_nodes(finer, side, number[cells[mesh.region[cells] == index]])
                                for side, cells in skin])
        if len(edges):
            points, cells, nodes = _swept(finer, edges, degrees=degrees)
            shapes.append(DrawnShape(points, cells, plain or colours[nodes], light=(0.6, 0.42, 0.0)))
    picture = photograph(shapes, azimuth=(degrees + 360.0) / 2.0, elevation=24.0,
                         width=round(_WIDTH * _DOTS_PER_INCH), height=round(0.74 * _HEIGHT * _DOTS_PER_INCH))
    figure = new_figure(_WIDTH, _HEIGHT)
    axes = figure.add_axes((0.0, 0.15, 1.0, 0.74))
    axes.imshow(picture, interpolation="nearest")
    axes.axis("off")
    axes.set_title(
        f"{phase_title(fields, phase)}; "
        f"Ø {2e3 * mesh.points[:, 0].max():.3g} mm × {1e3 * np.ptp(mesh.points[:, 1]):.3g} mm"
        f"{', fluids pale blue' if any(fluid) else ''}",
        fontsize=11,
    )
    bar = figure.add_axes((0.3, 0.1, 0.4, 0.025))
    figure.colorbar(ScalarMappable(scale, shades), cax=bar, orientation="horizontal")
    bar.set_xlabel(f"axial displacement u_z ({unit})", fontsize=11)
    return save_figure(figure, path, dots_per_inch=_DOTS_PER_INCH)


def draw_solids(
    solids: Sequence[Solid], path: Path, *, title: str, opacity: float = 1.0, explode: float = 0.0,
    cut_open: bool = False,
) -> Path:
    """Draw the solids of a CAD model with names and colours.

    The first is at the bottom of the legend. `explode` (m) is the extra gap between consecutive solids along z, which
    shows inner faces; `cut_open` omits the half in front of the plane y = 0.

    Raises:
        ValueError: no solids.
    """
    if not solids:
        raise ValueError("no solids to draw")
    from matplotlib.patches import Patch

    colours = [role_colour(solid.name) for solid in solids]
    shapes = []
    for index, (solid, colour) in enumerate(zip(solids, colours, strict=True)):
        body = surface(solid.vertices + np.array([0.0, 0.0, explode * index]), solid.triangles)
        if cut_open:
            body = _halved(body)
        shapes.append(DrawnShape(*_arrays(body, 3), colour, light=(0.3, 0.7, 0.15), opacity=opacity))
        # Edges between faces at an angle show the shape; those of all triangles would hide it.
        points, edges = _arrays(_sharp_edges(body), 2)
        if len(edges):
            shapes.append(DrawnShape(points, edges, "#303030", width=1.2))
    picture = photograph(shapes, azimuth=-75.0 if cut_open else -60.0, elevation=28.0,
                         width=round(0.8 * _WIDTH * _DOTS_PER_INCH), height=round(0.9 * _HEIGHT * _DOTS_PER_INCH))
    figure = new_figure(_WIDTH, _HEIGHT)
    axes = figure.add_axes((0.0, 0.0, 0.8, 0.9))
    axes.imshow(picture, interpolation="nearest")
    axes.axis("off")
    span = np.concatenate([solid.vertices for solid in solids])
    size = " × ".join(f"{1e3 * extent:.3g}" for extent in np.ptp(span, axis=0))
    figure.suptitle(f"{title}\n{size} mm" + (f", drawn {explode * 1e3:.3g} mm apart" if explode else ""), fontsize=11)
    figure.legend(handles=[Patch(facecolor=colour, edgecolor="#303030", linewidth=0.5, label=solid.name)
                           for solid, colour in zip(solids, colours, strict=True)][::-1],
                  loc="center left", bbox_to_anchor=(0.8, 0.45), frameon=False, fontsize=11)
    return save_figure(figure, path, dots_per_inch=_DOTS_PER_INCH)


def _arrays(data: Any, corners: int) -> tuple[FloatArray, IntArray]:
    """Points (N, 3) and cells (M, `corners`) of a vtkPolyData."""
    (support,) = vtk_modules("util.numpy_support")
    if not data.GetNumberOfPoints():
        return np.empty((0, 3)), np.empty((0, corners), dtype=np.int64)
    cells = (data.GetLines() if corners == 2 else data.GetPolys()).GetConnectivityArray()
    numbers = support.vtk_to_numpy(cells).astype(np.int64).reshape(-1, corners)
    return support.vtk_to_numpy(data.GetPoints().GetData()).astype(float), numbers


def _clean(data: Any) -> Any:
    """The `data` with every point once; files of triangles repeat them."""
    (filters,) = vtk_modules("vtkFiltersCore")
    merge = filters.vtkCleanPolyData()
    merge.SetInputData(data)
    merge.Update()
    return merge.GetOutput()


def _halved(data: Any) -> Any:
    """The half of a closed surface behind y = 0, closed."""
    model, general = vtk_modules("vtkCommonDataModel", "vtkFiltersGeneral")
    plane, planes, clip = model.vtkPlane(), model.vtkPlaneCollection(), general.vtkClipClosedSurface()
    plane.SetOrigin(0.0, 0.0, 0.0)
    plane.SetNormal(0.0, 1.0, 0.0)
    planes.AddItem(plane)
    clip.SetInputData(_clean(data))
    clip.SetClippingPlanes(planes)
    clip.Update()
    return clip.GetOutput()


def _sharp_edges(data: Any) -> Any:
    """Edges between faces at more than 25 degrees, and open edges."""
    (filters,) = vtk_modules("vtkFiltersCore")
    edges = filters.vtkFeatureEdges()
    edges.SetInputData(_clean(data))
    edges.SetFeatureAngle(25.0)
    edges.ManifoldEdgesOff()
    edges.ColoringOff()
    edges.Update()
    return edges.GetOutput()


def _turned(points: FloatArray, angle: float) -> FloatArray:
    """Points (K, 2) of the section, turned to `angle` (rad), (K, 3)."""
    return np.column_stack([points[:, 0] * np.cos(angle), points[:, 0] * np.sin(angle), points[:, 1]])


def _cut_faces(mesh: NodalMesh, *, degrees: float) -> tuple[FloatArray, IntArray]:
    """Points and quadrilaterals of the cells on the two cut faces. The points are the nodes of the mesh, twice."""
    cells = mesh.cells
    quads = np.stack([cells[:, :-1, :-1], cells[:, 1:, :-1], cells[:, 1:, 1:], cells[:, :-1, 1:]], axis=-1)
    points = [_turned(mesh.points, angle) for angle in (0.0, np.radians(degrees))]
    return np.concatenate(points), np.concatenate([quads, quads + len(mesh.points)]).reshape(-1, 4)


def _swept(mesh: NodalMesh, edges: IntArray, *, degrees: float) -> tuple[FloatArray, IntArray, IntArray]:
    """Points and quadrilaterals of a surface swept by `edges` (L, k). Edges are lines through k nodes. The node of
    every point is returned too."""
    nodes, numbers = np.unique(edges, return_inverse=True)
    numbers = numbers.reshape(edges.shape)
    turns = np.radians(np.linspace(0.0, degrees, round(degrees / 2.0) + 1))
    points = np.concatenate([_turned(mesh.points[nodes], angle) for angle in turns])
    first = np.arange(len(turns) - 1)[:, None, None] * len(nodes) + numbers
    quads = np.stack([first[:, :, :-1], first[:, :, 1:], first[:, :, 1:] + len(nodes), first[:, :, :-1] + len(nodes)],
                     axis=-1).reshape(-1, 4)
    return points, quads, np.tile(nodes, len(turns))


def _section_outlines(mesh: NodalMesh, degrees: float) -> tuple[FloatArray, IntArray]:
    """Points and lines of the outlines of regions on both cut faces. They are slightly in front of the faces."""
    edges = border_lines(mesh, mesh.region)
    pieces = mesh.points[edges].reshape(-1, 2)
    front = 1e-3 * mesh.points[:, 0].max()
    points = []
    for angle, side in ((0.0, -1.0), (np.radians(degrees), 1.0)):
        normal = side * front * np.array([-np.sin(angle), np.cos(angle), 0.0])
        points.append(_turned(pieces, angle) + normal)
    return np.concatenate(points), np.arange(4 * len(edges)).reshape(-1, 2)
