"""Sizes of a section of any shape (`geometry.profile`) as parameters.

All of them move points of the mesh (`geometry.free_mesh.moved_free`), thicknesses and radii too. The contribution of a
cell to a form does not depend on its height, so only sizes that deform it or move it along r count; forms are
interpolated in these (`workbench.physics.shaped`), with as many matrices as the accuracy requires. Positive lengths
count by their logarithms, in which thicknesses of a fifth to five times the stated one need only a handful of nodes.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.chip_section import chip_section
from geometry.free_mesh import moved_free
from geometry.free_section import FreeSection
from geometry.mesh import MeshError, SectionMesh
from geometry.names import LEVEL, PART, parent_place
from geometry.stretch import moving_together
from workbench.files.errors import InputError, choose
from workbench.model.moved_mesh import TO_ROUNDING, Cells, Interpolation, MovedMesh, MovedSize, split_by_sizes
from workbench.model.problem import Problem
from workbench.physics.shaped import Amplitude, Moves, ShapeScale
from workbench.physics.stretched import Stretched, StretchedPart
from workbench.physics.term import Term

Real = NDArray[np.float64]
Integers = NDArray[np.int64]
Range = tuple[float, float]

def parametrised_free(
    problem: Problem, chip: Chip, ranges: Mapping[str, Range], *, interpolation: Interpolation = TO_ROUNDING,
    neutral: Collection[Term] = (),
) -> Problem:
    """`problem` of a chip with profiles, with dimensions among its parameters.

    `ranges` (m or rad) are those of the dimensions by name. Spectra are those of the mesh moved to the new sizes; the
    mesh itself stays. `neutral` are terms that are zero on the mesh.

    Raises:
        InputError: an unknown dimension, a range without its size, or one in which layers do not fit each other.
        MeshError: the mesh is not of this chip, or folds within a range.
    """
    known = chip.dimensions()
    sizes = []
    for name, (low, high) in ranges.items():
        value = known[choose(name, known, source=chip.file, field="dimension")].value
        if not low <= value <= high:
            raise InputError(chip.file, name, f"{low:g} to {high:g}", f"a range that contains its size, {value:g}")
        if low < high:
            scale = ShapeScale.LOGARITHM if low > 0.0 else ShapeScale.PROPORTIONAL
            sizes.append(MovedSize(name, value, (low, high), scale, value))
    if problem.mesh.section != chip_section(chip):
        raise MeshError(f"the mesh is not of chip {chip.name!r} with its present dimensions")
    moved = MovedMesh(chip, lambda own: _coordinates(problem.mesh, chip, own), interpolation)
    for corner in product(*(size.bounds for size in sizes)) if len(sizes) < 4 else ():
        moved.at(dict(zip(sizes, corner, strict=True)))
    mesh, terms = problem.mesh, dict[Term, Term]()
    for group, each in interpolation.of(problem.terms, neutral):
        integrals = {term: term.integrals() for term in group}
        used = dict.fromkeys((i.place, i.opposite) for found in integrals.values() for i in found)
        mesh, parts = _parts(_with_sides(mesh, used), replace(moved, interpolation=each), sizes, list(used))
        terms |= {term: Stretched(term, tuple((place, parts[place]) for place in dict.fromkeys(
            place for i in found for place in (i.place, i.opposite) if place)), ())
                  for term, found in integrals.items()}
    values = {**problem.values, **{size.name: complex(size.nominal) for size in sizes}}
    return replace(problem, mesh=replace(mesh, variants=moved.variants), values=values,
                   terms=tuple(terms[term] for term in problem.terms))


def _coordinates(mesh: SectionMesh, chip: Chip, sizes: Mapping[str, float]) -> Real:
    """Coordinates (2, nodes, cells) of a chip's mesh for other sizes.

    `sizes` are in m or rad, by name.

    Raises:
        InputError: layers do not fit each other any more.
        MeshError: a cell is folded, or the section has other faces.
    """
    found = mesh.coordinates
    if sizes:
        together = {other: value for name, value in sizes.items() for other in moving_together(chip, name)}
        assert isinstance(mesh.section, FreeSection)
        section = chip_section(chip.with_dimensions(together), like=mesh.section)
        assert isinstance(section, FreeSection)
        try:
            found = moved_free(mesh, section).coordinates
        except MeshError as error:
            stated = ", ".join(f"{name} = {value:.6g}" for name, value in sizes.items())
            raise MeshError(f"{error} ({stated}, in m or rad; use a narrower range about the stated size)"
                            ) from error
    assert found is not None
    return found


def _with_sides(mesh: SectionMesh, used: Iterable[tuple[str, str]]) -> SectionMesh:
    """The mesh with names for the `used` parts of outer boundaries. Facets more level than steep belong to
    :data:`geometry.names.LEVEL`, the others to the layer."""
    boundaries = dict(mesh.mesh.boundaries)
    for place in {place for pair in used for place in pair if PART in place}:
        facets = np.asarray(boundaries[parent_place(place)])
        across, along = np.abs(np.ptp(mesh.mesh.p[:, mesh.mesh.facets[:, facets]], axis=1))
        boundaries[place] = facets[(along < across) == place.endswith(f"{PART}{LEVEL}")]
    return replace(mesh, mesh=mesh.mesh.with_boundaries(boundaries))


def _parts(
    mesh: SectionMesh, moved: MovedMesh, sizes: Sequence[MovedSize], used: Sequence[tuple[str, str]]
) -> tuple[SectionMesh, dict[str, tuple[StretchedPart, ...]]]:
    """The parts of all `used` places and opposite boundaries, with their sizes. The mesh names them."""
    regions, boundaries = dict(mesh.mesh.subdomains), dict(mesh.mesh.boundaries)
    facing = {place: other for place, other in used if other}
    at_once = {*facing, *facing.values()}
    parts: dict[str, tuple[StretchedPart, ...]] = {}
    for place in dict.fromkeys(place for pair in used for place in pair if place):
        places = regions if place in regions else boundaries
        indices = np.asarray(places[place])
        cells = Cells(mesh, indices) if place in regions else Cells.of_facets(mesh, indices)
        touched = moved.moving(cells, sizes)
        if place in at_once:
            touched[:] = touched.any(axis=1, keepdims=True)
        found = []
        for name, own, acting in split_by_sizes(place, indices, touched, sizes):
            places[name] = own
            cells = Cells(mesh, own) if place in regions else Cells.of_facets(mesh, own)
            found.append(StretchedPart(name, moves=_moves(moved, acting, cells) if acting else None))
        parts[place] = tuple(found)
    named = mesh.mesh.with_subdomains(regions).with_boundaries(boundaries)
    return replace(mesh, mesh=named), parts


def _moves(moved: MovedMesh, sizes: Sequence[MovedSize], cells: Cells) -> Moves:
    bounds = [size.bounds for size in sizes]
    return moved.moves(cells, sizes, [Amplitude(size.length, size.scale) for size in sizes], bounds, bounds)
