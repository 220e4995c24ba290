"""A problem whose lengths are parameters like its moduli (see `workbench.physics.stretched`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from geometry.chip import Chip
from geometry.dimension import SHAPES
from geometry.stretch import Piece, movable, split, tied
from workbench.files.errors import InputError, choose
from workbench.physics.stretched import Column, Part, Radius, Rim, Stretched
from workbench.problem import Problem

#: How far a radius may move unless told otherwise, relative.
RADIAL_RANGE = 0.1


def thickness(layer: str) -> str:
    """Name of the parameter that is the thickness of a layer of the stack."""
    return f"{layer}.thickness"


def flexible(
    problem: Problem, chip: Chip, radii: Mapping[str, tuple[float, float]] | Sequence[str] = ()
) -> Problem:
    """`problem` with ``<layer>.thickness`` (m) of every layer of `chip` among its parameters, and some `radii` (m).

    Radii are given with the range they may move in, or by name, which stands for a tenth to either side; none passes
    another one. Radii that coincide are one parameter, under the first of their names in the chip file
    (`geometry.stretch.tied`). Spectra are those of a mesh stretched to the new lengths; the mesh itself stays. Terms
    added afterwards do not follow a length: add them first. They may name parts of places (`geometry.names.part`).

    Raises:
        InputError: a radius that the chip has not, or one that is given twice under two of its names.
        MeshError: the mesh is not of this chip.
    """
    if chip.is_shaped:
        raise InputError(chip.file, "layers", f"a {', a '.join(SHAPES)}", "layers with plane faces and upright sides, "
                         "where lengths are to move: others are not stretched yet")
    ranges = _ranges(chip, radii)
    known = chip.dimensions()
    moving = {known[name].value: name for name in ranges}
    mesh, pieces = split(problem.mesh, chip, tuple(moving))
    nominal = {layer.region: layer.thickness.value for layer in chip.layers}

    def radius(value: float) -> Radius:
        return Radius(value, next((name for each, name in moving.items() if each == value), ""))

    columns: dict[tuple[float, float], Column] = {}

    def part(piece: Piece) -> Part:
        if piece.column is None:
            return Part(piece.name, piece.layer)
        inner, outer = piece.column
        if inner == outer:
            return Part(piece.name, piece.layer, Rim(radius(inner)))
        if piece.column not in columns:
            columns[piece.column] = Column.between(radius(inner), radius(outer), ranges)
        return Part(piece.name, piece.layer, columns[piece.column])

    parts = {place: tuple(part(piece) for piece in found) for place, found in pieces.items()}
    terms = []
    for term in problem.terms:
        places = tuple(dict.fromkeys(p for i in term.integrals() for p in (i.place, i.facing) if p))
        layers = sorted({each.layer for place in places for each in parts[place]} - {""})
        terms.append(Stretched(term, tuple((place, parts[place]) for place in places),
                               tuple((layer, nominal[layer]) for layer in layers)))
    values = {**problem.values, **{thickness(layer): complex(value) for layer, value in nominal.items()},
              **{name: complex(known[name].value) for name in ranges}}
    return replace(problem, mesh=mesh, terms=tuple(terms), values=values)


def _ranges(chip: Chip, radii: Mapping[str, tuple[float, float]] | Sequence[str]) -> dict[str, tuple[float, float]]:
    """The range (m) of every radius that moves, by the first of its names."""
    known, first = chip.dimensions(), tied(chip)
    ranges: dict[str, tuple[float, float]] = {}
    for name in radii:
        choose(name, first, source=chip.file, field="radius")
        value = known[name].value
        low, high = (radii[name] if isinstance(radii, Mapping)
                     else ((1.0 - RADIAL_RANGE) * value, (1.0 + RADIAL_RANGE) * value))
        if not low <= value <= high:
            raise InputError(chip.file, name, f"{low:g} to {high:g} m", f"a range that holds its length, {value:g} m")
        wanted = movable(chip, name, low, high)
        if ranges.setdefault(first[name], wanted) != wanted:
            raise InputError(chip.file, name, f"{low:g} to {high:g} m", f"one range for radii that coincide: "
                             f"{first[name]} has another")
    return ranges
