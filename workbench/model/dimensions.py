"""Problems with lengths as parameters (see `workbench.physics.stretched`)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from geometry.chip import Chip
from geometry.dimension import SAME_LENGTH, SHAPES
from geometry.measure import Straight
from geometry.mesh import MeshError, SectionMesh
from geometry.shapes import with_shapes
from geometry.stretch import Piece, admissible_range, canonical_names, moved_places, split
from workbench.files.errors import InputError, choose
from workbench.model.moved_mesh import TO_ROUNDING, Cells, Interpolation
from workbench.model.moved_parts import LayerShape, ShapedLayers, shapes_of
from workbench.model.moved_sections import parametrised_free
from workbench.model.numbers import ParameterName
from workbench.model.problem import Problem
from workbench.model.shaped_mesh import coordinates_of
from workbench.physics.shaped import MovableLength, Moves, Ratio
from workbench.physics.stretched import MovingRim, RadialInterval, Stretched, StretchedPart
from workbench.physics.term import Term

Range = tuple[float, float]

#: Default relative range of a radius to either side.
RADIAL_RANGE = 0.1

#: Relative range of a thickness to either side if a layer has a shape.
SHAPED_RANGE = 0.2


def thickness(layer: str) -> str:
    """Name of the thickness of a layer as a parameter."""
    return f"{layer}.thickness"


def parametrised(
    problem: Problem, chip: Chip, radii: Mapping[str, Range] | Sequence[str] = (),
    shapes: Mapping[str, Range] = MappingProxyType({}), *, thicknesses: Mapping[str, Range] = MappingProxyType({}),
    interpolation: Interpolation = TO_ROUNDING, neutral: Collection[Term] = (),
) -> Problem:
    """`problem` with lengths of `chip` among its parameters.

    The parameters are ``<layer>.thickness`` (m) of every layer, some `radii` (m) and some `shapes` (m, or rad). Radii
    have a range, or only a name for a tenth to either side; none passes another one. Equal radii are one parameter,
    under their first name (`geometry.stretch.canonical_names`). Shapes have a range, by their (possible) names among
    the chip's dimensions; one that the chip does not state is 0. Spectra are those of a mesh stretched to the new
    lengths and moved to the new shapes, whose forms are interpolated; the mesh itself stays. Terms added later do not
    follow a length: add them first. They may name parts of places (`geometry.names.part_name`).

    If a layer has a shape, thicknesses have the ranges `thicknesses` (m), by default a fifth to either side; beyond,
    coefficients raise `ModelError`. A moving radius changes a parabola over it on the cells: this raises, unless the
    `interpolation` carries it along. Forms are extrapolated if less than half of a cell remains, in a thin layer beside
    a bent one (`workbench.model.moved_parts.LEAST_AREA_SHARE`). `neutral` are terms that are zero on the mesh.

    Raises:
        InputError: an impossible radius or shape, one with two ranges under two of its names, a range without its size,
            or a radius that moves within a parabola.
        MeshError: the mesh is not of this chip, or a shape within its range folds it.
    """
    ranges = _ranges(chip, radii)
    straight = isinstance(chip.measure, Straight)
    known = chip.dimensions()
    moving = moved_places(chip, ranges) if ranges else {}
    mesh, pieces = split(problem.mesh, chip, tuple(moving))
    nominal = {layer.region: layer.thickness.value for layer in chip.layers}
    lengths = {**ranges, **_thickness_ranges(nominal, thicknesses)}
    layers = _shaped_layers(problem.mesh, chip, shapes, lengths, interpolation)
    if not interpolation.carried:
        _check_parabolas(layers.shapes, chip, ranges)

    def radius(value: float) -> MovableLength:
        name, sign = moving.get(value, ("", 1))
        return MovableLength(value, name, sign, known[name].value if name and straight else None)

    columns: dict[tuple[float, float], RadialInterval] = {}

    def part(piece: Piece) -> StretchedPart:
        if piece.column is None:
            return StretchedPart(piece.name, piece.layer)
        inner, outer = piece.column
        if inner == outer:
            return StretchedPart(piece.name, piece.layer, MovingRim(radius(inner), straight))
        if piece.column not in columns:
            columns[piece.column] = RadialInterval.between(radius(inner), radius(outer), ranges,
                                                             straight=straight)
        return StretchedPart(piece.name, piece.layer, columns[piece.column])

    terms: dict[Term, Term] = {}
    for group, each in interpolation.of(problem.terms, neutral):
        own = layers.following(each)
        integrals = {term: term.integrals() for term in group}
        used = dict.fromkeys((i.place, i.opposite) for found in integrals.values() for i in found)
        parts: dict[str, tuple[StretchedPart, ...]] = {}
        if own.shapes:
            mesh, parts = _moved_parts(mesh, pieces, own, used, part)
        else:
            parts = {place: tuple(part(piece) for piece in pieces[place]) for pair in used for place in pair if place}
        for term, found in integrals.items():
            places = tuple(dict.fromkeys(p for i in found for p in (i.place, i.opposite) if p))
            stretched = sorted({each.layer for place in places for each in parts[place]} - {""})
            terms[term] = Stretched(term, tuple((place, parts[place]) for place in places),
                                    tuple((layer, nominal[layer]) for layer in stretched))
    values = {**problem.values, **{thickness(layer): complex(value) for layer, value in nominal.items()},
              **{name: complex(known[name].value) for name in ranges},
              **{each.name: complex(each.nominal) for each in layers.shapes if each.parameter}}
    return replace(problem, mesh=mesh, terms=tuple(terms[term] for term in problem.terms), values=values)


def parametrised_within(
    problem: Problem, chip: Chip, ranges: Mapping[str, Range], *,
    interpolation: Interpolation = TO_ROUNDING, neutral: Collection[Term] = (),
) -> Problem:
    """`problem` with parameters for dimensions by name, within their ranges.

    `ranges` are in m or rad. Radii and shapes among them become parameters; thicknesses have these ranges. A chip with
    profiles has only parameters named in `ranges`.
    """
    if chip.is_profiled:
        sizes = {name: each for name,
                 each in ranges.items() if ParameterName.parse(name).is_dimension}
        return parametrised_free(problem, chip, sizes, interpolation=interpolation, neutral=neutral)
    found = {name: ParameterName.parse(name) for name in ranges}
    radii, shapes, thicknesses = ({name: ranges[name] for name in ranges if chosen(found[name])} for chosen in (
        lambda each: each.is_radius, lambda each: each.coefficient in SHAPES, lambda each: each.is_thickness))
    return parametrised(
        problem, chip, radii, shapes, thicknesses=thicknesses, interpolation=interpolation, neutral=neutral)


def _shaped_layers(mesh: SectionMesh, chip: Chip, shapes: Mapping[str, Range], lengths: Mapping[str, Range],
                   interpolation: Interpolation) -> ShapedLayers:
    """The section of the chip with its shapes. Those of `shapes` are parameters."""
    stating = with_shapes(chip, list(shapes))
    for name, (low, high) in shapes.items():
        value = stating.dimensions()[name].value
        if not low <= value <= high:
            raise InputError(chip.file, name, f"{low:g} to {high:g}", f"a range that contains its size, {value:g}")
    straight = replace(mesh, coordinates=None)
    nominal = {layer.region: layer.thickness.value for layer in chip.layers}
    found = ShapedLayers.of(straight, stating, shapes_of(stating, shapes), lengths, nominal, interpolation)
    if stating.is_shaped:
        wanted = coordinates_of(straight, stating)
        own = found.mesh.existing({}) if mesh.coordinates is None else mesh.coordinates
        assert wanted is not None
        if np.abs(own - wanted).max() > SAME_LENGTH:
            raise MeshError(f"the mesh is not of chip {chip.name!r} with the shapes that its layers have")
    return found


def _thickness_ranges(nominal: Mapping[str, float], wanted: Mapping[str, Range]) -> dict[str, Range]:
    """The range (m) of every thickness, by the name of its parameter."""
    return {thickness(layer): wanted.get(thickness(layer), ((1.0 - SHAPED_RANGE) * value, (1.0 + SHAPED_RANGE) * value))
            for layer, value in nominal.items()}


def _check_parabolas(shapes: Sequence[LayerShape], chip: Chip, ranges: Mapping[str, Range]) -> None:
    """Raise for radii that move within a parabola."""
    for shape in shapes:
        for name in ranges:
            if chip.dimensions()[name].value < shape.reach.within + SAME_LENGTH:
                raise InputError(chip.file, name, f"a radius that moves, within the parabola of {shape.name}",
                                 "a fixed radius, or an interpolation that carries the parabola along")


def _moved_parts(
    mesh: SectionMesh, pieces: Mapping[str, Sequence[Piece]], layers: ShapedLayers, used: Iterable[tuple[str, str]],
    part: Callable[[Piece], StretchedPart],
) -> tuple[SectionMesh, dict[str, tuple[StretchedPart, ...]]]:
    """The parts of all `used` places and opposite boundaries, with their motion."""
    found: dict[str, tuple[StretchedPart, ...]] = {}
    faced: dict[str, list[str]] = {}
    for place, facing in used:
        faced.setdefault(place, []).append(facing)
    for place, others in faced.items():
        if place in mesh.mesh.subdomains:
            mesh, own = layers.pieces(mesh, pieces[place])
            cells = [Cells(mesh, np.asarray(mesh.mesh.subdomains[piece.name])) for piece, _ in own]
        else:
            # The opposite boundary has the same mesh, whichever of both moves.
            sides = zip(*(pieces[each] for each in dict.fromkeys([place, *others]) if each), strict=True)
            cells = [Cells.of_facets(mesh, np.concatenate([np.asarray(mesh.mesh.boundaries[each.name])
                                                           for each in both])) for both in sides]
            own = [(piece, layers.moving(each)) for piece, each in zip(pieces[place], cells, strict=True)]
        found[place] = tuple(
            replace(part(piece), moves=_moves(part(piece), piece, shapes, each, layers)) if shapes else part(piece)
            for (piece, shapes), each in zip(own, cells, strict=True))
    for facing in dict.fromkeys(each for others in faced.values() for each in others if each and each not in found):
        found[facing] = tuple(map(part, pieces[facing]))
    return replace(mesh, variants=layers.mesh.variants), found


def _moves(plain: StretchedPart, piece: Piece, shapes: Sequence[LayerShape], cells: Cells,
           layers: ShapedLayers) -> Moves:
    """The motion of one piece of a place by shapes."""
    column = Ratio(plain.across.outer, plain.across.inner) if isinstance(plain.across, RadialInterval) else None
    side = None
    if cells.facets and piece.layer:
        side = plain.across.radius if isinstance(plain.across, MovingRim) else MovableLength(cells.radius)
    return layers.moves(piece, shapes, cells, column, side)


def _ranges(chip: Chip, radii: Mapping[str, tuple[float, float]] | Sequence[str]) -> dict[str, tuple[float, float]]:
    """The range (m) of every moving radius, by its first name."""
    known, first = chip.dimensions(), canonical_names(chip)
    ranges: dict[str, tuple[float, float]] = {}
    for name in radii:
        choose(name, first, source=chip.file, field="radius")
        value = known[name].value
        low, high = (radii[name] if isinstance(radii, Mapping)
                     else ((1.0 - RADIAL_RANGE) * value, (1.0 + RADIAL_RANGE) * value))
        if not low <= value <= high:
            raise InputError(chip.file, name, f"{low:g} to {high:g} m", f"a range around its length, {value:g} m")
        wanted = admissible_range(chip, name, low, high)
        if ranges.setdefault(first[name], wanted) != wanted:
            raise InputError(chip.file, name, f"{low:g} to {high:g} m", f"one range for equal radii: "
                             f"{first[name]} has another")
    return ranges
