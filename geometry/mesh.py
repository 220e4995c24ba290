"""From a section to a mesh: structured quadrilaterals with named regions and boundaries. The only place that runs gmsh.

The section is cut by every break in r and z into a tensor grid of rectangles, so neighbouring regions share their nodes
by construction. Each interval between two breaks is divided into panels of elements in geometric progression; each
rectangle of panels is one transfinite, recombined surface of gmsh. Quadrilaterals with straight sides describe such a
section exactly, so the mesh has first-order geometry whatever the order of the fields on it.

Element size: a share of the slowest wavelength at the highest frequency, in every row and in every column that of the
slowest region in it; smaller towards the corners in which fields are singular.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import warnings
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from threading import RLock
from types import ModuleType

import numpy as np
import skfem
from numpy.typing import NDArray

from geometry.names import AXIS, CAVITY, TRANSDUCER, role_of, whole
from geometry.section import VOID, Section, boundary_name
from workbench.files.errors import InputError, nearest_names
from workbench.files.writing import replacing

#: Part of the key of a cached mesh: raise it whenever the same section and size would give another mesh.
CACHE_VERSION = 2

COUPLANT = "couplant"

#: Regions with these roles hold a fluid, or nothing.
FLUID_ROLES = (CAVITY, COUPLANT)

#: Agreement demanded between a region of the mesh and the section's own arithmetic, relative. Rounding accumulates to
#: about 1e-14 over ten thousand cells; a missing or doubled element shows as 1e-5 or more.
VOLUME_TOLERANCE = 1e-9


class MeshError(RuntimeError):
    """The mesh is not the one the section asked for, or gmsh could not be used."""


@dataclass(frozen=True)
class MeshSize:
    """How fine a mesh has to be.

    ``slowest_wave``: the slowest sound or shear speed (m/s) of every region, ``math.inf`` where nothing propagates (a
    vacuum). ``frequency_max`` in Hz. ``elements_per_wavelength`` for fields of polynomial ``order``.
    ``minimum_through_thickness``: elements across the thinnest layer. ``minimum_through_quarter_wave``: elements across
    a layer that is thicker than a quarter of the slowest wavelength in it. ``corner_refinement``: largest size of the
    elements in re-entrant corners of the solids and at the rim of a couplant, relative to the others, and its cube
    at the ends of electrodes; 1 leaves them alike. ``growth``: ratio between neighbouring elements from there on.
    ``skins``: regions that have a row of elements of its own at either face, and the share of the thickness that it
    takes.
    """

    slowest_wave: Mapping[str, float]
    frequency_max: float
    elements_per_wavelength: float
    order: int
    minimum_through_thickness: int = 1
    minimum_through_quarter_wave: int = 1
    corner_refinement: float = 1.0
    growth: float = 4.0
    skins: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        def refuse(name: str, value: object, expected: str) -> None:
            raise InputError("mesh size", name, value, expected)

        for region, speed in self.slowest_wave.items():
            if not speed > 0.0:
                refuse(f"slowest_wave.{region}", speed, "a speed above zero in m/s")
        if not 0.0 < self.frequency_max < math.inf:
            refuse("frequency_max", self.frequency_max, "a frequency above zero in Hz")
        if not 0.0 < self.elements_per_wavelength < math.inf:
            refuse("elements_per_wavelength", self.elements_per_wavelength, "a number above zero")
        if self.order < 1:
            refuse("order", self.order, "a polynomial order of 1 or more")
        for name in ("minimum_through_thickness", "minimum_through_quarter_wave"):
            if getattr(self, name) < 1:
                refuse(name, getattr(self, name), "1 or more")
        if not 0.0 < self.corner_refinement <= 1.0:
            refuse("corner_refinement", self.corner_refinement, "a ratio above 0 and up to 1")
        if not self.growth > 1.0:
            refuse("growth", self.growth, "a ratio above 1")
        for region, share in self.skins.items():
            if not 0.0 < share < 0.5:
                refuse(f"skins.{region}", share, "a share of the thickness above 0 and below a half")

    def largest_element(self, region: str) -> float:
        """Largest edge of an element in the region, metres.

        Raises:
            InputError: no speed is given for the region.
        """
        if region not in self.slowest_wave:
            raise InputError(
                "mesh size",
                f"slowest_wave.{region}",
                None,
                "the slowest wave speed of every region, inf where nothing propagates",
                nearest_names(region, self.slowest_wave),
            )
        return self.slowest_wave[region] / (self.frequency_max * self.elements_per_wavelength)


@dataclass(frozen=True)
class SectionMesh:
    """The mesh of a section.

    ``mesh``: quadrilaterals with straight sides, coordinates (r, z) in metres, cell indices by region in
    ``mesh.subdomains``, facet indices by boundary name in ``mesh.boundaries``. The four nodes of every cell run
    (bottom left, bottom right, top right, top left), so the local coordinates point along r and along z. Nodes are
    numbered along r, then upwards; so are cells. ``order``: polynomial order of the fields the mesh was sized for.

    Raises:
        MeshError: a region or boundary of the section is missing, empty or not named in the section, or the area or
            volume of a region differs from the section's.
    """

    mesh: skfem.MeshQuad
    order: int
    section: Section

    def __post_init__(self) -> None:
        _check_mesh(self.mesh, self.section)


def refined(size: MeshSize, factor: float) -> MeshSize:
    """`size` with elements smaller by `factor` in both directions, thin layers included."""
    return replace(
        size,
        elements_per_wavelength=size.elements_per_wavelength * factor,
        minimum_through_thickness=math.ceil(size.minimum_through_thickness * factor),
        minimum_through_quarter_wave=math.ceil(size.minimum_through_quarter_wave * factor),
    )


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
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            yield gmsh
        finally:
            gmsh.finalize()


# --------------------------------------------------------------------------------------------------------------------
# Dividing the section


@dataclass(frozen=True)
class _Panel:
    """Part of an interval between two breaks: `count` elements, each `ratio` times as long as the one before."""

    interval: int
    start: float
    end: float
    count: int
    ratio: float

    def nodes(self) -> NDArray[np.float64]:
        """(count + 1,) coordinates from start to end, both exact."""
        lengths = self.ratio ** np.arange(self.count)
        steps = np.concatenate([[0.0], np.cumsum(lengths)]) / lengths.sum()
        nodes: NDArray[np.float64] = self.start + (self.end - self.start) * steps
        nodes[-1] = self.end
        return nodes


def _panels(
    breaks: tuple[float, ...], largest: NDArray[np.float64], graded: Mapping[float, float], *, size: MeshSize,
    minimum: NDArray[np.int64], cuts: Sequence[float] = (),
) -> list[_Panel]:
    """Panels of the intervals between `breaks`: elements no longer than `largest`, `minimum` of them at least (one
    value an interval each).

    They are graded towards the breaks in `graded`, to elements of that share of the largest. There is a line of nodes
    at each of the `cuts` too.
    """
    panels: list[_Panel] = []
    for i, (start, end, limit, least) in enumerate(zip(breaks, breaks[1:], largest, minimum, strict=False)):
        inner = [cut for cut in sorted(cuts) if start < cut < end]
        for low, high in pairwise([start, *inner, end]):
            ends = (graded.get(low, 1.0), graded.get(high, 1.0))
            lengths, counts, ratios = _divide(high - low, limit, ends, size.growth, 1 if inner else int(least))
            knots = low + np.concatenate([[0.0], np.cumsum(lengths)])
            knots[-1] = high
            for a, b, n, q in zip(knots, knots[1:], counts, ratios, strict=False):
                panel = _Panel(i, float(a), float(b), n, q)
                # gmsh places the nodes of a steeply graded line by numerical integration, too roughly for the smallest.
                nodes = [panel.start, panel.end] if q == 1.0 else panel.nodes().tolist()
                panels += [_Panel(i, low, high, n if q == 1.0 else 1, 1.0) for low, high in pairwise(nodes)]
    return panels


def _divide(
    length: float, largest: float, ends: tuple[float, float], growth: float, minimum: int
) -> tuple[list[float], list[int], list[float]]:
    """Lengths, counts and ratios of the panels of one interval.

    The interval is divided into equal parts no longer than `largest`, `minimum` at least. A part next to a graded end,
    half of it where it is next to both, is divided again: from an element no longer than so much of `largest` as `ends`
    say on they grow by `growth`. An end of 1 is not graded.
    """
    parts = max(minimum, _ceiling(length / largest))
    share = 0.5 if parts == 1 and max(ends) < 1.0 else 1.0
    piece = share * length / parts
    first, last = (_graded(piece, end * largest, growth) if end < 1.0 else 1 for end in ends)
    if first == last == 1:  # too thin to be graded, or not to be
        return [length], [parts], [1.0]
    # A half that is too thin stays one element.
    graded = (first > 1 or share < 1.0, last > 1 or share < 1.0)
    rest = round(parts - share * sum(graded))
    pieces = [(piece, first, growth)] * graded[0]
    pieces += [(length - sum(graded) * piece, rest, 1.0)] * (rest > 0)
    pieces += [(piece, last, 1.0 / growth)] * graded[1]
    lengths, counts, ratios = zip(*pieces, strict=True)
    return list(lengths), list(counts), list(ratios)


def _graded(length: float, smallest: float, growth: float) -> int:
    """How many elements, each `growth` times as long as the one before, divide a length so that the first is no longer
    than `smallest`."""
    count, total = 1, 1.0
    while length / total > smallest * (1.0 + 1e-12):
        total += growth**count
        count += 1
    return count


def _ceiling(quotient: float) -> int:
    """Smallest number of elements; a quotient above a whole number by rounding only does not cost one more."""
    return max(1, math.ceil(quotient * (1.0 - 1e-12)))


def _corners(section: Section, refinement: float) -> tuple[dict[float, float], dict[float, float]]:
    """Radii and heights that the mesh is graded towards, and the size of the elements there, relative to the others.

    Fields are singular in re-entrant corners of the solids, and more so at the ends of electrodes: elements there are
    smaller by the cube of `refinement`: by itself 0.65 % in Z of a disc were left, by its square 0.08 %. The
    rim of a couplant, which gives way there, is too thin to have anything of its own across: its radius counts, not
    its heights.
    """
    fluid = [role_of(region) in FLUID_ROLES for region in section.regions]
    cells = section.grid()
    solid = (cells != VOID) & ~np.append(fluid, True)[cells]  # VOID is -1: the last entry
    quarters = np.stack([solid[1:, 1:], solid[1:, :-1], solid[:-1, 1:], solid[:-1, :-1]])
    # Two solids in opposite quarters meet in an edge; side by side they have a plane face.
    opposite = (quarters.sum(axis=0) == 2) & (quarters[0] == quarters[3])
    corners = np.argwhere((quarters.sum(axis=0) == 3) | opposite) + 1
    radii = {section.r_breaks[i]: refinement for _, i in corners}
    heights = {section.z_breaks[j]: refinement for j, _ in corners}
    radii |= {p.r_outer: refinement for p in section.rectangles if role_of(p.region) == COUPLANT}
    disc = max(p.r_outer for p in section.rectangles if p.region == TRANSDUCER)
    for electrode in section.electrodes:
        ends = {electrode.r_inner, electrode.r_outer} - {0.0, disc}
        radii |= dict.fromkeys(ends, refinement**3)
        heights |= {electrode.z: refinement**3} if ends else {}
    return radii, heights


def _divided(section: Section, size: MeshSize) -> tuple[list[_Panel], list[_Panel]]:
    """Panels along r and along z."""
    grid = section.grid()
    # VOID is -1: it takes the last entry, no limit.
    limits = np.array([size.largest_element(region) for region in section.regions] + [math.inf])[grid]
    columns, rows = limits.min(axis=0), limits.min(axis=1)
    if math.isinf(max(columns.max(), rows.max())):
        raise InputError("mesh size", "slowest_wave", math.inf, "a finite speed in some region of every row and column")
    radii, heights = _corners(section, size.corner_refinement)
    cuts = []
    for rectangle in section.rectangles:
        skin = size.skins.get(rectangle.region, 0.0) * (rectangle.z_top - rectangle.z_bottom)
        cuts += [rectangle.z_bottom + skin, rectangle.z_top - skin] if skin else []
    thick = np.diff(section.z_breaks) > 0.25 * size.elements_per_wavelength * rows
    least = np.maximum(size.minimum_through_thickness, np.where(thick, size.minimum_through_quarter_wave, 1))
    return (
        _panels(section.r_breaks, columns, radii, size=size, minimum=np.ones(len(columns), dtype=int)),
        _panels(section.z_breaks, rows, heights, size=size, minimum=least, cuts=cuts),
    )


# --------------------------------------------------------------------------------------------------------------------
# gmsh


@dataclass(frozen=True)
class _Cells:
    """A mesh without names: points (2, n) in metres, cells (4, m) of points, region (m,) of every cell."""

    points: NDArray[np.float64]
    cells: NDArray[np.int64]
    region: NDArray[np.int64]


def _generate(section: Section, size: MeshSize) -> _Cells:
    along_r, along_z = _divided(section, size)
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
    geo: ModuleType, along_r: list[_Panel], along_z: list[_Panel], occupied: list[tuple[int, int]]
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

    def line(start: tuple[int, int], end: tuple[int, int], panel: _Panel) -> int:
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


def _on_lines(values: NDArray[np.float64], panels: list[_Panel]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
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


def _check_mesh(mesh: skfem.MeshQuad, section: Section) -> None:
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
    r, z = mesh.p[:, mesh.t]
    widths, heights = r[1] - r[0], z[3] - z[0]
    if min(widths.min(), heights.min()) <= 0.0:
        raise MeshError("the mesh has an element without area or with its nodes out of order")
    areas = widths * heights
    volumes = math.pi * (r[0] + r[1]) * areas
    for region in section.regions:
        cells = mesh.subdomains[region]
        for quantity, measured, exact in (
            ("area", areas[cells].sum(), section.area(region)),
            ("volume", volumes[cells].sum(), section.volume(region)),
        ):
            if not abs(measured - exact) <= VOLUME_TOLERANCE * exact:
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
