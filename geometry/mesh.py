"""Meshes of sections of rectangles: structured quadrilaterals with named regions and boundaries.

All breaks in r and z cut the section into a tensor grid, so neighbouring regions share their nodes. Each interval
between two breaks is divided into panels of elements in geometric progression. Straight quadrilaterals describe such a
section exactly, so the mesh geometry is of first order for fields of any order. Sections of any shape:
`geometry.free_mesh`.

The element size is a share of the shortest wavelength in each row and column at the highest frequency. Elements are
smaller towards corners where fields are singular.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import skfem
from numpy.typing import NDArray

from geometry.free_section import FreeSection
from geometry.measure import Measure
from geometry.mesh_size import MeshSize
from geometry.names import TRANSDUCER, parent_place, role_of
from geometry.panels import Panel, divided
from geometry.quads import measures, numbering
from geometry.section import VOID, Section, boundary_name
from workbench.files.errors import InputError, nearest_names, one_of

#: Largest relative difference of a region's area or volume between mesh and section. Rounding accumulates to about
#: 1e-14 over ten thousand cells; a missing or doubled element shows as 1e-5 or more.
STRAIGHT_TOLERANCE = 1e-9


#: Largest relative difference for curved cells: polynomials of order 4 deviate by 2e-8 for an arc of 30 degrees.
CURVED_TOLERANCE = 1e-6


class MeshError(RuntimeError):
    """The mesh differs from its section, or gmsh is not available."""


@dataclass(frozen=True)
class SectionMesh:
    """The mesh of a section.

    ``mesh``: quadrilaterals with straight sides, coordinates (r, z) in metres, cell indices by region in
    ``mesh.subdomains``, facet indices by boundary name in ``mesh.boundaries``. The four nodes of a cell are (bottom
    left, bottom right, top right, top left), so the local coordinates point along r and along z. Nodes and cells are
    numbered along r, then upwards. ``order``: polynomial order of the fields. ``coordinates``: (2, nodes, cells) in
    metres of the nodes of curved cells, numbered as in `workbench.fem.elements.Lagrange`; None for straight cells.
    ``variants``: such coordinates for other shapes of the layers, by name; ``shown`` names the one in use. ``plan``:
    the plan by which a free mesh can be moved (`geometry.free_mesh.Plan`).

    Raises:
        MeshError: a region or boundary is missing, empty or not in the section, or the area or volume of a region
            differs from the section's.
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
            return  # The mesh was checked before it was shown in this variant.
        _check_names(self.mesh, self.section)
        if isinstance(self.section, Section):
            _check_rectangles(self.mesh, self.section)
        else:
            _check_cells(self)

    @property
    def measure(self) -> Measure:
        """The measure of its section."""
        return self.section.measure

    @property
    def nodes(self) -> NDArray[np.float64] | None:
        """The node coordinates of the cells, of the variant in use."""
        return self.variants[self.shown] if self.shown else self.coordinates


def elements_per_wavelength(mesh: SectionMesh, slowest_wave: Mapping[str, float], frequency: float) -> dict[str, float]:
    """Elements per wavelength in each region's longest edge, at `frequency` (Hz).

    `slowest_wave` is the slowest wave speed (m/s) by region.

    Raises:
        InputError: `slowest_wave` has an unknown region.
    """
    edges = np.ptp(mesh.mesh.p[:, mesh.mesh.t], axis=1).max(axis=0)
    counts = {}
    for region, speed in slowest_wave.items():
        if region not in mesh.mesh.subdomains:
            known = mesh.section.regions
            raise InputError("mesh", "slowest_wave", region, one_of(known, region), nearest_names(region, known))
        counts[region] = speed / frequency / float(edges[mesh.mesh.subdomains[region]].max())
    return counts


def mesh_section(section: Section, size: MeshSize) -> SectionMesh:
    """The mesh of `section`, as fine as `size` requires.

    Raises:
        InputError: a region of the section has no speed.
        MeshError: the mesh differs from the section.
    """
    return _named(_generate(section, size), section, size.order)


@dataclass(frozen=True)
class _Cells:
    """A mesh without names. Points are (2, n) in metres, cells (4, m), region (m,)."""

    points: NDArray[np.float64]
    cells: NDArray[np.int64]
    region: NDArray[np.int64]


def _generate(section: Section, size: MeshSize) -> _Cells:
    along_r, along_z = divided(section, size)
    (r, columns), (z, rows) = (_lines(panels) for panels in (along_r, along_z))
    region = section.grid()[np.ix_(rows, columns)]
    row, column = np.nonzero(region != VOID)
    place = row * r.size + column
    # Order along r, then upwards; corners anticlockwise from bottom left.
    used, cells = np.unique(np.stack([place, place + 1, place + r.size + 1, place + r.size]), return_inverse=True)
    return _Cells(np.stack([r[used % r.size], z[used // r.size]]), cells.reshape(4, -1), region[row, column])


def _lines(panels: Sequence[Panel]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The lines of nodes, and the interval of every element."""
    lines = np.concatenate([panels[0].nodes()[:1], *(panel.nodes()[1:] for panel in panels)])
    return lines, np.repeat([panel.interval for panel in panels], [panel.count for panel in panels])


# --------------------------------------------------------------------------------------------------------------------
# Names


def _named(cells: _Cells, section: Section, order: int) -> SectionMesh:
    """The mesh of the cells, with the section's names."""
    mesh = skfem.MeshQuad(cells.points, cells.cells)
    regions = {name: np.flatnonzero(cells.region == i) for i, name in enumerate(section.regions)}
    # Region on either side of every facet, VOID outside the outer boundary; smaller index first.
    neighbours = np.append(cells.region, VOID)[mesh.f2t]
    neighbours.sort(axis=0)
    r, z = mesh.p[:, mesh.facets]
    ends = section.measure.ends(section.r_breaks)
    facets: dict[str, NDArray[np.int64]] = {name: np.flatnonzero((r == place).all(axis=0))
                                            for name, place in ends.items()}
    between = neighbours[0] != neighbours[1]
    for found in facets.values():
        between[found] = False
    for a, b in np.unique(neighbours[:, between], axis=1).T:
        name = boundary_name(section.regions, int(a), int(b))
        facets[name] = np.flatnonzero(between & (neighbours[0] == a) & (neighbours[1] == b))
    transducers = [i for i, region in enumerate(section.regions) if role_of(region) == TRANSDUCER]
    of_transducer = np.isin(neighbours, transducers).any(axis=0)
    for name in dict.fromkeys(electrode.name for electrode in section.electrodes):
        pieces = [(z == each.z) & (r >= each.r_inner) & (r <= each.r_outer) for each in section.electrodes
                  if each.name == name]
        covered = np.any([piece.all(axis=0) for piece in pieces], axis=0)
        facets[name] = np.flatnonzero(of_transducer & covered)
    return SectionMesh(mesh.with_subdomains(regions).with_boundaries(facets), order, section)


def _check_names(mesh: skfem.MeshQuad, section: Section | FreeSection) -> None:
    """Check the names of regions and boundaries, see :class:`SectionMesh`."""
    for kind, found, expected in (
        ("regions", mesh.subdomains or {}, section.regions),
        ("boundaries", mesh.boundaries or {}, section.boundary_names()),
    ):
        filled = {name for name, indices in found.items() if len(indices) and parent_place(name) == name}
        if filled != set(expected):
            raise MeshError(
                f"{kind} missing from the mesh: {sorted(set(expected) - filled)}; not of the section: "
                f"{sorted(filled - set(expected))}"
            )


def _check_rectangles(mesh: skfem.MeshQuad, section: Section) -> None:
    """Check the cells of a section of rectangles, see :class:`SectionMesh`."""
    r, z = mesh.p[:, mesh.t]
    widths, heights = r[1] - r[0], z[3] - z[0]
    if min(widths.min(), heights.min()) <= 0.0:
        raise MeshError("the mesh has an element without area or with its nodes out of order")
    areas = widths * heights
    _check_measures(mesh, section, areas, 0.5 * (r[0] + r[1]) * areas, STRAIGHT_TOLERANCE)


def _check_cells(mesh: SectionMesh) -> None:
    """Check the cells of a section of any shape, see :class:`SectionMesh`."""
    if mesh.coordinates is None:
        raise MeshError("the mesh of a section of any shape comes without the nodes of its cells")
    order = math.isqrt(mesh.coordinates.shape[1]) - 1
    nodes = np.empty((2, mesh.coordinates.shape[2], order + 1, order + 1))
    along, across = np.array(numbering(order)).T
    nodes[:, :, along, across] = mesh.coordinates.transpose(0, 2, 1)
    areas, moments, least = measures(nodes)
    if not least.min() > 0.0:
        r, z = 1e3 * nodes[:, int(np.argmin(least))].mean(axis=(1, 2))
        raise MeshError(f"the mesh has a folded cell at r = {r:.4g} mm, z = {z:.4g} mm")
    _check_measures(mesh.mesh, mesh.section, areas, moments, CURVED_TOLERANCE)


def _check_measures(
    mesh: skfem.MeshQuad, section: Section | FreeSection, areas: NDArray[np.float64], moments: NDArray[np.float64],
    tolerance: float,
) -> None:
    for region in section.regions:
        area, moment = (float(each[mesh.subdomains[region]].sum()) for each in (areas, moments))
        for quantity, measured, exact in (
            ("area", area, section.area(region)),
            ("volume", section.measure.body(area, moment), section.volume(region)),
        ):
            if not abs(measured - exact) <= tolerance * exact:
                raise MeshError(f"{quantity} of {region!r} in the mesh is {measured:.12g}, in the section {exact:.12g}")
