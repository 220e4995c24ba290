"""Lengths as parameters: ranges, shared radii, and moved mesh parts.

Between two breaks of the section the map from old to new coordinates is linear in r and in z, so straight
quadrilaterals stay straight. A dimension is thus a parameter like a modulus, without remeshing.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.chip import Chip
from geometry.dimension import ACROSS, SAME_LENGTH, SHAPES, millimetres
from geometry.mesh import MeshError, SectionMesh
from geometry.names import COLUMN, LEVEL, part_name
from geometry.parts import discs, hole_names, largest_shape
from geometry.section import cut_section
from workbench.files.errors import InputError

#: Least share of the distance to zero, or to the next break, that remains after a length moves. Doubled, ranges are a
#: ninth shorter.
KEPT_SHARE = 0.1


def mesh_limits(chip: Chip, name: str) -> tuple[float, float]:
    """Limits (m or rad) of a dimension for one mesh.

    For a radius they are the next breaks of the section; for a shape the limits of its layer; otherwise zero and
    infinity. All radii of one length change together.

    Raises:
        KeyError: the chip has no dimension of that name.
    """
    value = chip.dimensions()[name].value
    region, _, what = name.rpartition(".")
    if what in SHAPES:
        limit = largest_shape(chip.layer(region), what)
        return -limit, limit
    if not name.endswith(ACROSS):
        return 0.0, math.inf
    breaks, first = cut_section(chip).r_breaks, canonical_names(chip)[name]
    movers = moved_places(chip, [first])
    lines = breaks if chip.measure.is_whole else sorted({0.0, *breaks})
    low, high = 0.0, math.inf
    for place, (_, sign) in movers.items():
        for other in lines:
            apart = sign * (other - place)
            # A line that moves towards this one has half of the way.
            share = 0.5 if movers.get(other, ("", 0)) == (first, -sign) else 1.0
            if apart > SAME_LENGTH:
                high = min(high, value + share * apart)
            elif apart < -SAME_LENGTH:
                low = max(low, value + share * apart)
    return low, high


def moved_places(chip: Chip, names: Collection[str]) -> dict[float, tuple[str, int]]:
    """The breaks across the section (m) that these radii move. `names` are canonical.

    For each break: the name, and whether the break moves with it (1) or against it (-1), as a left side does.

    Raises:
        InputError: two lengths move one break, or one length moves it in two ways.
    """
    first, across, holes = canonical_names(chip), chip.measure.across, hole_names(chip.layers, chip.measure.across)
    breaks, found = cut_section(chip).r_breaks, dict[float, tuple[str, int]]()
    for place, name, sign in _sides_across(chip, across, holes):
        at = next((each for each in breaks if abs(each - place) < SAME_LENGTH), None)
        if at is None or (sign < 0 and at < SAME_LENGTH and not chip.measure.is_whole):
            continue  # It is on the other half, outside the section.
        mover = first[name], sign
        if found.setdefault(at, mover) != mover and {mover[0], found[at][0]} & {*names}:
            raise InputError(chip.file, name, millimetres(place), "a side that does not coincide with one that "
                             f"{found[at][0]} moves, or moves as that does")
    return {at: mover for at, mover in found.items() if mover[0] in names}


def _sides_across(chip: Chip, across: str, holes: Mapping[str, str]) -> Iterator[tuple[float, str, int]]:
    """Places (m) of left (-1) and right (1) sides. Each has the dimension that moves it. `holes` are the names of the
    cavity's radii by layer."""
    for layer in chip.layers:
        for side, sign in zip(layer.sides, (-1, 1), strict=True):
            yield side, f"{layer.region}.{across}", sign
        for hole in layer.holes:
            for side, sign in zip(hole, (-1, 1), strict=True):
                yield side, holes.get(layer.region, f"{layer.region}.inner_{across}"), sign
    for name, disc in discs(chip.electrodes):
        for radius, key in ((disc.radius, across), (disc.inner_radius, f"inner_{across}")):
            if radius is not None:
                yield from ((chip.transducer.offset + sign * radius.value, f"{name}.{key}", sign) for sign in (-1, 1))


def admissible_range(chip: Chip, name: str, low: float = -math.inf, high: float = math.inf) -> tuple[float, float]:
    """Admissible range (m or rad) of a dimension, within the given bounds.

    It covers nine tenths of the way to the next break.

    Raises:
        KeyError: the chip has no dimension of that name.
    """
    value, (before, behind) = chip.dimensions()[name].value, mesh_limits(chip, name)
    moved = 1.0 - KEPT_SHARE
    return (max(low, value - moved * (value - before)), min(high, value + moved * (behind - value)))


@dataclass(frozen=True)
class Piece:
    """A part of a region or boundary.

    ``name`` is its name on the mesh; ``layer`` is the layer whose thickness moves it ("" for a level part); ``column``
    are the two radii (m) of its column (None if they never move; one radius twice for facets along z).
    """

    name: str
    layer: str
    column: tuple[float, float] | None


def canonical_names(*chips: Chip) -> dict[str, str]:
    """Canonical name of every radius. It is the first name among radii of one length. Radii that are equal in any of
    the chips move together and share the name."""
    first: dict[str, str] = {}
    for chip in chips:
        known = {name: each.value for name, each in chip.dimensions().items() if name.endswith(ACROSS)}
        for name, value in known.items():
            alike = [other for other, length in known.items() if abs(length - value) < SAME_LENGTH]
            names = [first[other] for other in alike if other in first] or [name]
            for other, chosen in [*first.items(), *((other, names[0]) for other in alike)]:
                # Radii that differed in an earlier chip and coincide here share one name from now on.
                first[other] = names[0] if chosen in names else chosen
    return first


def moving_together(chip: Chip, name: str) -> tuple[str, ...]:
    """The lengths that change with `name`. For a radius, they are all equal radii."""
    first = canonical_names(chip)
    return tuple(other for other in first if first[other] == first[name]) if name in first else (name,)


def split(mesh: SectionMesh, chip: Chip, moving: Sequence[float] = ()) -> tuple[SectionMesh, dict[str, list[Piece]]]:
    """A copy of the mesh with names for parts that move.

    A region that spans several layers has a part for each. Facets along z belong to their layer, all others to
    :data:`geometry.names.LEVEL`. A column of the section that one of the places `moving` (m) bounds is a further part;
    so are facets along z at such a place.

    Returns:
        the mesh, and the pieces of every region, of every boundary and of their parts by layers.

    Raises:
        MeshError: `mesh` is not of this chip, or has no break at a place.
    """
    if cut_section(chip) != mesh.section:
        raise MeshError(f"the mesh is not of chip {chip.name!r} with its present dimensions")
    levels = np.array([layer.z_bottom for layer in chip.layers[1:]])
    names = [layer.region for layer in chip.layers]
    breaks = np.array(mesh.section.r_breaks)
    follows = np.array([any(abs(each - radius) < SAME_LENGTH for radius in moving) for each in breaks])
    if follows.sum() != len(set(moving)):
        raise MeshError(f"the section of {chip.name!r} has breaks at {breaks.tolist()} m, not at every one of "
                        f"{list(moving)}")
    lengths = [next((radius for radius in moving if abs(each - radius) < SAME_LENGTH), float(each)) for each in breaks]
    r, z = mesh.mesh.p
    of_cell = np.searchsorted(levels, z[mesh.mesh.t].mean(axis=0))
    ends, radii = z[mesh.mesh.facets], r[mesh.mesh.facets]
    of_facet = np.where(ends[0] == ends[1], -1, np.searchsorted(levels, ends.mean(axis=0)))
    # Numbers of columns, then of radii; -1 for columns that never move.
    last = breaks.size - 1
    inside = np.array([*(k if follows[k] or follows[k + 1] else -1 for k in range(last)),
                       *(last + k if follows[k] else -1 for k in range(breaks.size))])
    middle = np.searchsorted(breaks, r[mesh.mesh.t].mean(axis=0)) - 1
    standing = np.searchsorted(breaks - 0.5 * SAME_LENGTH, radii[0]) - 1
    column_of_cell = inside[middle]
    column_of_facet = inside[np.where(radii[0] == radii[1], last + standing,
                                      np.searchsorted(breaks, radii.mean(axis=0)) - 1)]
    regions, boundaries = dict(mesh.mesh.subdomains), dict(mesh.mesh.boundaries)
    pieces: dict[str, list[Piece]] = {}
    for places, layers, columns in ((regions, of_cell, column_of_cell), (boundaries, of_facet, column_of_facet)):
        for place, indices in list(places.items()):
            indices = np.asarray(indices)
            found: list[Piece] = []
            for layer in np.unique(layers[indices]):
                name = part_name(place, LEVEL if layer < 0 else names[layer])
                within = indices[layers[indices] == layer]
                places[name] = within
                own = []
                for column in np.unique(columns[within]):
                    piece = Piece(name, "" if layer < 0 else names[layer], None)
                    if column >= 0:
                        sides = ((lengths[column], lengths[column + 1]) if column < last
                                 else (lengths[column - last],) * 2)
                        piece = replace(piece, column=sides)
                    if np.unique(columns[within]).size > 1:
                        piece = replace(piece, name=f"{name}{COLUMN}{column}")
                        places[piece.name] = within[columns[within] == column]
                    own.append(piece)
                pieces[name] = own
                found += own
            # A place with a single part is that part.
            pieces[place] = [replace(found[0], name=place)] if len(found) == 1 else found
    return replace(mesh, mesh=mesh.mesh.with_subdomains(regions).with_boundaries(boundaries)), pieces
