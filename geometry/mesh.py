"""From a section to a mesh: structured quadrilaterals with named regions and boundaries. The only place that runs gmsh.

The section is cut by every break in r and z into a tensor grid of rectangles, so neighbouring regions share their nodes
by construction. Each interval between two breaks is divided into panels of elements in geometric progression; each
rectangle of panels is one transfinite, recombined surface of gmsh. Quadrilaterals with straight sides describe such a
section exactly, so the mesh has first-order geometry whatever the order of the fields on it.

Element size: a share of the slowest wavelength at the highest frequency, in every row and in every column that of the
slowest region in it; smaller towards the corners in which fields are singular.
"""

from __future__ import annotations

import ctypes
import hashlib
import io
import json
import math
import os
import signal
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from threading import RLock
from types import ModuleType

import numpy as np
import skfem
from numpy.typing import NDArray

from geometry.free_section import FreeSection
from geometry.mesh_size import MeshSize
from geometry.names import AXIS, TRANSDUCER, whole
from geometry.panels import Panel, divided
from geometry.quads import measures, numbering
from geometry.section import VOID, Section, boundary_name
from workbench.files.errors import InputError, nearest_names
from workbench.files.writing import replacing

#: Part of the key of a cached mesh: raise it whenever the same section and size would give another mesh.
CACHE_VERSION = 2

#: Agreement demanded between a region of the mesh and the section's own arithmetic, relative. Rounding accumulates to
#: about 1e-14 over ten thousand cells; a missing or doubled element shows as 1e-5 or more.
VOLUME_TOLERANCE = 1e-9


#: The same where cells have curved sides: polynomials of order 4 leave 2e-8 of an arc that turns by 30 degrees.
CURVED_TOLERANCE = 1e-6


class MeshError(RuntimeError):
    """The mesh is not the one the section asked for, or gmsh could not be used."""


@dataclass(frozen=True)
class SectionMesh:
    """The mesh of a section.

    ``mesh``: quadrilaterals with straight sides, coordinates (r, z) in metres, cell indices by region in
    ``mesh.subdomains``, facet indices by boundary name in ``mesh.boundaries``. The four nodes of every cell run
    (bottom left, bottom right, top right, top left), so the local coordinates point along r and along z. Nodes are
    numbered along r, then upwards; so are cells. ``order``: polynomial order of the fields the mesh was sized for.
    ``coordinates`` (2, nodes, cells) in metres of the nodes of any order in every cell, numbered as those of
    `workbench.elements.Lagrange`, where cells are not straight: ``mesh`` is then where they come from. ``variants`` are
    such coordinates for other shapes of the layers, by name; ``shown`` is the one in use, if any. ``plan`` is what the
    mesh of a section of any shape can be moved by (`geometry.free_mesh.Plan`).

    Raises:
        MeshError: a region or boundary of the section is missing, empty or not named in the section, or the area or
            volume of a region differs from the section's.
    """

    mesh: skfem.MeshQuad
    order: int
    section: Section | FreeSection
    coordinates: NDArray[np.float64] | None = None
    plan: object = None
    variants: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    shown: str = ""

    def __post_init__(self) -> None:
        if self.shown:
            return  # the same mesh, checked before
        _check_names(self.mesh, self.section)
        if isinstance(self.section, Section):
            _check_rectangles(self.mesh, self.section)
        else:
            _check_cells(self)

    @property
    def nodes(self) -> NDArray[np.float64] | None:
        """The coordinates that cells have: of the variant shown, or of the mesh itself."""
        return self.variants[self.shown] if self.shown else self.coordinates


def elements_per_wavelength(mesh: SectionMesh, slowest_wave: Mapping[str, float], frequency: float) -> dict[str, float]:
    """Elements per wavelength in the longest edge of each region of `slowest_wave`, at `frequency` (Hz).

    Raises:
        InputError: `slowest_wave` (m/s) names a region the mesh has not.
    """
    edges = np.ptp(mesh.mesh.p[:, mesh.mesh.t], axis=1).max(axis=0)
    counts = {}
    for region, speed in slowest_wave.items():
        if region not in mesh.mesh.subdomains:
            known = mesh.section.regions
            raise InputError("mesh", "slowest_wave", region, "one of " + ", ".join(known), nearest_names(region, known))
        counts[region] = speed / frequency / float(edges[mesh.mesh.subdomains[region]].max())
    return counts


def mesh_section(section: Section, size: MeshSize, *, cache: Path | None = None) -> SectionMesh:
    """The mesh of `section`, as fine as `size` asks for.

    With a `cache` folder (:func:`user_cache` is the usual one) a mesh made before is read instead of made again. A
    damaged file there is reported by a warning and replaced.

    Raises:
        InputError: no speed is given for a region of the section.
        MeshError: gmsh is in use already, or its mesh is not the section.
    """
    if cache is None:
        return _named(_generate(section, size), section, size.order)
    path = cache / f"{_content_key(section, size)}.npz"
    if path.is_file():
        try:
            return _named(_load(path), section, size.order)
        except (OSError, EOFError, ValueError, TypeError, LookupError, zipfile.BadZipFile, MeshError) as error:
            warnings.warn(f"the cached mesh {path} is damaged ({error!r}); making it again", stacklevel=2)
    cells = _generate(section, size)
    mesh = _named(cells, section, size.order)
    _save(path, cells)
    return mesh


def user_cache() -> Path:
    """The folder for meshes of this user: below ``$XDG_CACHE_HOME``, or ``~/.cache``."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "acoustofluidic-chip-workbench" / "meshes"


#: gmsh is one session for the whole process: threads take turns.
_TURN = RLock()


def _keep_broken_pipes_errors() -> None:
    """Let writing to a closed pipe or socket be an error again, as Python has it: gmsh lets it end the program.

    From any thread, which :func:`signal.signal` is not made for.
    """
    if hasattr(signal, "SIGPIPE") and signal.getsignal(signal.SIGPIPE) is signal.SIG_IGN:
        set_handler = ctypes.pythonapi.PyOS_setsig
        set_handler.argtypes, set_handler.restype = [ctypes.c_int, ctypes.c_void_p], ctypes.c_void_p
        set_handler(signal.SIGPIPE, int(signal.SIG_IGN))


@contextmanager
def gmsh_session() -> Iterator[ModuleType]:
    """gmsh, started with its own defaults and shut down on leaving, error or not.

    gmsh is one global session with global options: starting it for every mesh is what keeps one mesh from changing the
    next.

    Raises:
        MeshError: gmsh is not installed, or a session is open already.
    """
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise MeshError(f"meshing needs gmsh and its system libraries: {error}") from error
    with _TURN:
        if gmsh.isInitialized():
            raise MeshError("a gmsh session is open already; close it before meshing a section")
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        _keep_broken_pipes_errors()
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            yield gmsh
        finally:
            gmsh.finalize()


# --------------------------------------------------------------------------------------------------------------------
# gmsh


@dataclass(frozen=True)
class _Cells:
    """A mesh without names: points (2, n) in metres, cells (4, m) of points, region (m,) of every cell."""

    points: NDArray[np.float64]
    cells: NDArray[np.int64]
    region: NDArray[np.int64]


def _generate(section: Section, size: MeshSize) -> _Cells:
    along_r, along_z = divided(section, size)
    grid = section.grid()[np.ix_([p.interval for p in along_z], [p.interval for p in along_r])]
    occupied = [(int(j), int(i)) for j, i in np.argwhere(grid != VOID)]
    with gmsh_session() as gmsh:
        surfaces = _transfinite_surfaces(gmsh.model.geo, along_r, along_z, occupied)
        gmsh.model.geo.synchronize()
        gmsh.model.mesh.generate(2)
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        blocks = [_quadrilaterals(gmsh.model.mesh, surface) for surface in surfaces]
    number = np.empty(int(tags.max()) + 1, dtype=np.int64)
    number[tags.astype(np.int64)] = np.arange(len(tags))
    cells = number[np.concatenate(blocks)].T
    region = np.repeat([grid[j, i] for j, i in occupied], [len(block) for block in blocks])
    r, z = coordinates.reshape(-1, 3)[:, :2].T
    return _ordered(_on_lines(r, along_r), _on_lines(z, along_z), cells, region)


def _transfinite_surfaces(
    geo: ModuleType, along_r: list[Panel], along_z: list[Panel], occupied: list[tuple[int, int]]
) -> list[int]:
    """One surface of gmsh for every occupied rectangle (row, column) of panels; their tags in that order."""
    r = [along_r[0].start, *(panel.end for panel in along_r)]
    z = [along_z[0].start, *(panel.end for panel in along_z)]
    points: dict[tuple[int, int], int] = {}
    lines: dict[tuple[tuple[int, int], tuple[int, int]], int] = {}

    def point(j: int, i: int) -> int:
        if (j, i) not in points:
            points[j, i] = geo.addPoint(r[i], z[j], 0.0)
        return points[j, i]

    def line(start: tuple[int, int], end: tuple[int, int], panel: Panel) -> int:
        if (start, end) not in lines:
            tag = geo.addLine(point(*start), point(*end))
            geo.mesh.setTransfiniteCurve(tag, panel.count + 1, "Progression", panel.ratio)
            lines[start, end] = tag
        return lines[start, end]

    surfaces = []
    for j, i in occupied:
        bottom = line((j, i), (j, i + 1), along_r[i])
        right = line((j, i + 1), (j + 1, i + 1), along_z[j])
        top = line((j + 1, i), (j + 1, i + 1), along_r[i])
        left = line((j, i), (j + 1, i), along_z[j])
        surface = geo.addPlaneSurface([geo.addCurveLoop([bottom, right, -top, -left])])
        geo.mesh.setTransfiniteSurface(surface)
        geo.mesh.setRecombine(2, surface)
        surfaces.append(surface)
    return surfaces


def _quadrilaterals(mesh: ModuleType, surface: int) -> NDArray[np.int64]:
    """(m, 4) node tags of the elements on one surface.

    Raises:
        MeshError: there are none, or some are not quadrilaterals.
    """
    four_node_quadrilateral = 3
    kinds, _, nodes = mesh.getElements(2, surface)
    if [int(kind) for kind in kinds] != [four_node_quadrilateral]:
        raise MeshError(f"gmsh filled a rectangle with elements of kinds {list(kinds)}, not with quadrilaterals only")
    return np.asarray(nodes[0], dtype=np.int64).reshape(-1, 4)


def _on_lines(values: NDArray[np.float64], panels: list[Panel]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The coordinates of the grid lines, and the line each of `values` is on.

    gmsh places the nodes of a graded curve by numerical integration; the lines are its nodes without that error.

    Raises:
        MeshError: a value is further from its line than a hundredth of the distance to the next line.
    """
    lines = np.concatenate([panels[0].nodes()[:1], *(panel.nodes()[1:] for panel in panels)])
    index = np.searchsorted(0.5 * (lines[:-1] + lines[1:]), values)
    if (np.abs(values - lines[index]) > 0.01 * np.diff(lines).min()).any():
        raise MeshError("gmsh placed nodes off the lines of the section")
    return lines, index


def _ordered(
    r: tuple[NDArray[np.float64], NDArray[np.int64]],
    z: tuple[NDArray[np.float64], NDArray[np.int64]],
    cells: NDArray[np.int64],
    region: NDArray[np.int64],
) -> _Cells:
    """The cells with nodes and cells numbered along r, then upwards, and local nodes anticlockwise from bottom left."""
    (r_lines, r_index), (z_lines, z_index) = r, z
    place, node = np.unique(z_index * len(r_lines) + r_index, return_inverse=True)
    # By its place on the grid a corner is bottom left, bottom right, top left, top right when the four are sorted.
    corners = np.sort(node[cells], axis=0)[[0, 1, 3, 2]]
    order = np.argsort(corners[0], kind="stable")
    points = np.stack([r_lines[place % len(r_lines)], z_lines[place // len(r_lines)]])
    return _Cells(points, np.ascontiguousarray(corners[:, order]), region[order])


# --------------------------------------------------------------------------------------------------------------------
# Names


def _named(cells: _Cells, section: Section, order: int) -> SectionMesh:
    """The cells as a mesh whose regions and boundaries carry the names of the section."""
    mesh = skfem.MeshQuad(cells.points, cells.cells)
    regions = {name: np.flatnonzero(cells.region == i) for i, name in enumerate(section.regions)}
    # Region on either side of every facet, VOID beyond the outer boundary; smaller index first.
    neighbours = np.append(cells.region, VOID)[mesh.f2t]
    neighbours.sort(axis=0)
    r, z = mesh.p[:, mesh.facets]
    facets: dict[str, NDArray[np.int64]] = {AXIS: np.flatnonzero((r == 0.0).all(axis=0))}
    between = neighbours[0] != neighbours[1]
    between[facets[AXIS]] = False
    for a, b in np.unique(neighbours[:, between], axis=1).T:
        name = boundary_name(section.regions, int(a), int(b))
        facets[name] = np.flatnonzero(between & (neighbours[0] == a) & (neighbours[1] == b))
    of_transducer = (neighbours == section.regions.index(TRANSDUCER)).any(axis=0)
    for electrode in section.electrodes:
        covered = (z == electrode.z) & (r >= electrode.r_inner) & (r <= electrode.r_outer)
        facets[electrode.name] = np.flatnonzero(of_transducer & covered.all(axis=0))
    return SectionMesh(mesh.with_subdomains(regions).with_boundaries(facets), order, section)


def _check_names(mesh: skfem.MeshQuad, section: Section | FreeSection) -> None:
    """See :class:`SectionMesh`."""
    for kind, found, expected in (
        ("regions", mesh.subdomains or {}, section.regions),
        ("boundaries", mesh.boundaries or {}, section.boundary_names()),
    ):
        filled = {name for name, indices in found.items() if len(indices) and whole(name) == name}
        if filled != set(expected):
            raise MeshError(
                f"{kind} missing from the mesh: {sorted(set(expected) - filled)}; not of the section: "
                f"{sorted(filled - set(expected))}"
            )


def _check_rectangles(mesh: skfem.MeshQuad, section: Section) -> None:
    """See :class:`SectionMesh`."""
    r, z = mesh.p[:, mesh.t]
    widths, heights = r[1] - r[0], z[3] - z[0]
    if min(widths.min(), heights.min()) <= 0.0:
        raise MeshError("the mesh has an element without area or with its nodes out of order")
    areas = widths * heights
    _check_measures(mesh, section, areas, math.pi * (r[0] + r[1]) * areas, VOLUME_TOLERANCE)


def _check_cells(mesh: SectionMesh) -> None:
    """See :class:`SectionMesh`."""
    if mesh.coordinates is None:
        raise MeshError("the mesh of a section of any shape comes without the nodes of its cells")
    order = math.isqrt(mesh.coordinates.shape[1]) - 1
    nodes = np.empty((2, mesh.coordinates.shape[2], order + 1, order + 1))
    along, across = np.array(numbering(order)).T
    nodes[:, :, along, across] = mesh.coordinates.transpose(0, 2, 1)
    areas, volumes, least = measures(nodes)
    if not least.min() > 0.0:
        r, z = 1e3 * nodes[:, int(np.argmin(least))].mean(axis=(1, 2))
        raise MeshError(f"the mesh has a folded cell at r = {r:.4g} mm, z = {z:.4g} mm")
    _check_measures(mesh.mesh, mesh.section, areas, volumes, CURVED_TOLERANCE)


def _check_measures(
    mesh: skfem.MeshQuad, section: Section | FreeSection, areas: NDArray[np.float64], volumes: NDArray[np.float64],
    tolerance: float,
) -> None:
    for region in section.regions:
        cells = mesh.subdomains[region]
        for quantity, measured, exact in (
            ("area", areas[cells].sum(), section.area(region)),
            ("volume", volumes[cells].sum(), section.volume(region)),
        ):
            if not abs(measured - exact) <= tolerance * exact:
                raise MeshError(f"{quantity} of {region!r} in the mesh is {measured:.12g}, in the section {exact:.12g}")


# --------------------------------------------------------------------------------------------------------------------
# Cache


def _content_key(section: Section, size: MeshSize) -> str:
    content = {
        "version": CACHE_VERSION,
        "rectangles": [asdict(rectangle) for rectangle in section.rectangles],
        "electrodes": [asdict(electrode) for electrode in section.electrodes],
        # A mapping proxy cannot be deep-copied, as asdict would.
        "size": asdict(replace(size, slowest_wave=dict(size.slowest_wave), skins=dict(size.skins))),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _save(path: Path, cells: _Cells) -> None:
    with replacing(path) as written:
        np.savez(written, points=cells.points, cells=cells.cells, region=cells.region)


def _load(path: Path) -> _Cells:
    # From bytes: numpy leaves a file it cannot read open.
    with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
        return _Cells(archive["points"], archive["cells"], archive["region"])
