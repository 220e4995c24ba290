"""Meshes of chips whose layers have sloping, bulging or curved sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from skfem import Dofs

from geometry.chip import Chip
from geometry.free_mesh import mesh_free
from geometry.free_section import FreeSection
from geometry.mesh import MeshError, SectionMesh, mesh_section
from geometry.mesh_size import MeshSize
from geometry.section import Section
from geometry.shapes import moved
from workbench.fem.elements import Lagrange
from workbench.fem.places import areas, mapped

#: Rounding tolerance of coincident nodes, relative to the section.
TORN = 1e-12


def meshed(section: Section | FreeSection, size: MeshSize) -> SectionMesh:
    """The mesh of a section: tensor mesh or free mesh.

    Raises:
        InputError: a region of the section has no speed.
        MeshError: the mesh cannot be made.
    """
    return mesh_section(section, size) if isinstance(section, Section) else mesh_free(section, size)


def coordinates_of(mesh: SectionMesh, chip: Chip) -> NDArray[np.float64] | None:
    """Coordinates (2, nodes, cells) in metres with the layers' shapes. They are those of a chip's straight mesh.

    Cells may be folded. None if no layer has a shape.

    Raises:
        MeshError: neighbouring cells disagree on a shared side.
    """
    element = Lagrange(mesh.order)
    coordinates = moved(mesh, chip, np.array(element.doflocs).T)
    if coordinates is not None:
        _check_whole(mesh, element, coordinates)
    return coordinates


def shaped(mesh: SectionMesh, chip: Chip) -> SectionMesh:
    """The mesh of a chip's straight section with the layers' shapes.

    Raises:
        MeshError: a cell is folded: a shape is larger than its neighbour.
    """
    coordinates = coordinates_of(mesh, chip)
    if coordinates is None:
        return mesh
    result = replace(mesh, coordinates=coordinates)
    area = node_areas(result, np.arange(coordinates.shape[2]))
    if area.min() <= 0.0:
        cell, node = np.unravel_index(int(np.argmin(area)), area.shape)
        r, z = 1e3 * coordinates[:, node, cell]
        shapes = ", ".join(f"{layer.region}.{shape}" for layer in chip.layers for shape in layer.shapes)
        raise MeshError(f"the shapes of chip {chip.name!r} ({shapes}) fold its section at {chip.measure.symbol} = "
                        f"{r:.4g} mm, z = {z:.4g} mm: a side crosses its neighbour")
    return result


def node_areas(mesh: SectionMesh, cells: NDArray[np.int64]) -> NDArray[np.float64]:
    """Factor (cells, nodes) of an area in local coordinates at cells' nodes."""
    return areas(mapped(mesh, cells, np.array(Lagrange(mesh.order).doflocs).T)[1])


def _check_whole(mesh: SectionMesh, element: Lagrange, coordinates: NDArray[np.float64]) -> None:
    """Raise if neighbouring cells disagree on a side. The coordinates are (2, nodes, cells)."""
    dofs = Dofs(mesh.mesh, element).element_dofs
    shared = np.empty((2, int(dofs.max()) + 1))
    shared[:, dofs] = coordinates
    torn = np.abs(shared[:, dofs] - coordinates).max(axis=0)
    if torn.max() > TORN * np.ptp(coordinates):
        node, cell = np.unravel_index(int(np.argmax(torn)), torn.shape)
        r, z = 1e3 * coordinates[:, node, cell]
        raise MeshError(f"the shapes of layers tear the section apart at r = {r:.4g} mm, z = {z:.4g} mm")
