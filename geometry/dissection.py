"""Sections from the faces of layers: the cavity, and meshable faces.

Faces of neighbours may not overlap. The space that they enclose is the cavity, otherwise an unintended gap. A face with
four sides gets rows and columns of quadrilaterals. Other faces are cut by lines along z, at re-entrant corners and on
both sides of steep or strongly curved parts (a fillet, a drafted wall), so that only a small part without four sides
remains.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry import cad, revolution
from geometry.curves import Arc
from geometry.dimension import SAME_LENGTH
from geometry.free_section import Directed, Face, FreeSection
from geometry.kernel import MILLIMETRES, cadquery_module
from geometry.measure import ABOUT_AXIS, Measure, Straight
from geometry.names import CAVITY
from geometry.section import Electrode, Rectangle
from workbench.files.errors import InputError

if TYPE_CHECKING:
    import cadquery

#: Least angle (degrees) by which the tangent turns at a corner of a face.
CORNER = 30.0

#: Largest slope of a side of a face with four sides, and largest angle by which such a side curves (degrees).
OBLIQUE = 40.0

#: Margin of the cuts beside a steep or curved part, as a share of the face's height, added to half the part's width.
CUT_MARGIN = 0.3


def section_of(
    drawn: Mapping[str, cad.DrawnLayer], electrodes: Sequence[Electrode], rectangles: Sequence[Rectangle], *,
    walls: Collection[str], source: str, cuts: Mapping[str, Sequence[float]] = MappingProxyType({}),
    measure: Measure = ABOUT_AXIS,
) -> FreeSection:
    """The section of layers drawn in the plane.

    Args:
        drawn: the sections of the layers by region, bottom to top: for r >= 0, or on both sides if the `measure` is
            whole.
        walls: the layers around the cavity; empty without one.
        cuts: radii (m) of the cuts beside steep or curved parts, by region.

    Raises:
        InputError: layers overlap, leave a gap or do not touch, or the cavity is open.
    """
    faces = faces_of(drawn, walls=walls, source=source, measure=measure)
    notes = tuple(f"{region}: {each.left_out}" for region, each in drawn.items() if each.left_out)
    pieces, beside = [], []
    for region, face in faces.items():
        found: list[float] = []
        for part in face.Faces():
            own, radii = _pieces(part, cuts.get(region))
            pieces += [(region, piece) for piece in own]
            found += [radius for radius in radii if radius not in found]
        beside.append((region, tuple(found)))
    fused = _fused(pieces, tuple(electrodes), tuple(rectangles), notes)
    _check_contact(fused, list(drawn), source)
    return replace(fused, cuts=tuple(beside), measure=measure)


def faces_of(
    drawn: Mapping[str, cad.DrawnLayer], *, walls: Collection[str], source: str, measure: Measure = ABOUT_AXIS
) -> dict[str, cadquery.Shape]:
    """The faces of layers and of the enclosed cavity, by region.

    A region on both sides of a channel is a compound.

    Raises:
        InputError: as in :func:`section_of`.
    """
    faces: dict[str, cadquery.Shape] = {region: each.face for region, each in drawn.items()}
    _check_fit(faces, source)
    cavity = _enclosed(faces, walls=walls, source=source, measure=measure)
    return faces if cavity is None else {**faces, CAVITY: cavity}


def _check_fit(faces: Mapping[str, cadquery.Shape], source: str) -> None:
    """Raise if faces overlap or a layer has no contact below."""
    for (one, first), (other, second) in combinations(faces.items(), 2):
        common = [each for each in first.intersect(second).Faces() if each.Area() > cad.LEAST_AREA]
        if common:
            worst = max(common, key=lambda face: face.Area())
            raise InputError(source, f"layers {one} and {other}", f"an overlap of "
                             f"{sum(each.Area() for each in common):.4g} mm^2 about {cad.place(worst.Center())}",
                             "layers that touch and do not overlap")
    names = list(faces)
    for k, name in enumerate(names[1:], start=1):
        below = cadquery_module().Compound.makeCompound([faces[each] for each in names[:k]])
        distance, points = cad.closest(faces[name], below)
        if distance > cad.SAME_POINT:
            raise InputError(source, f"layer {name}", f"a gap of {distance:.4g} mm below it, least at "
                             f"{cad.place(points[0])}", "a layer that touches one below it")


def _check_contact(section: FreeSection, layers: Sequence[str], source: str) -> None:
    """Raise if a layer touches the layers below only in points."""
    touching = [{section.faces[face].region for face in faces} for faces in section.beside if len(faces) == 2]
    for k, layer in enumerate(layers[1:], start=1):
        if not any(layer in both and both & set(layers[:k]) for both in touching):
            raise InputError(source, f"layer {layer}", "a contact in points alone with the layers below",
                             "a layer that lies on one below it, along a line of the section")


def _enclosed(
    faces: Mapping[str, cadquery.Shape], *, walls: Collection[str], source: str, measure: Measure
) -> cadquery.Face | None:
    """The enclosed cavity, or None."""
    whole = cadquery_module().Compound.makeCompound(list(faces.values()))
    around = revolution.half_plane(whole.BoundingBox(), is_whole=measure.is_whole)
    edge = around.BoundingBox()
    free = around.cut(*faces.values()).Faces()
    inside = [each for each in free if each.BoundingBox().xmax < edge.xmax - cad.SAME_POINT
              and (not measure.is_whole or each.BoundingBox().xmin > edge.xmin + cad.SAME_POINT)
              and each.BoundingBox().zmax < edge.zmax - cad.SAME_POINT
              and each.BoundingBox().zmin > edge.zmin + cad.SAME_POINT]
    inside = [each for each in inside if each.Area() > cad.LEAST_AREA]
    likely = [each for each in inside if any(faces[wall].distance(each) < cad.SAME_POINT for wall in walls)]
    # In half a straight section one beside the middle would be one of two, with a wall between them.
    if len(likely) > 1 or (isinstance(measure, Straight) and not measure.is_whole):
        likely = [each for each in likely if each.BoundingBox().xmin < cad.SAME_POINT]
    wanted = likely if len(likely) == 1 else []
    gaps = [each for each in inside if not any(each is other for other in wanted)]
    if gaps:
        worst = max(gaps, key=lambda face: face.Area())
        between = [name for name, face in faces.items() if face.distance(worst) < cad.SAME_POINT]
        expected = "layers that leave no gap"
        if not walls:
            expected += "; a cavity is one where layers have a cavity_radius"
        raise InputError(source, "layers " + ", ".join(between), f"a gap of {worst.Area():.4g} mm^2 about "
                         f"{cad.place(worst.Center())}", expected)
    if walls and not wanted:
        raise InputError(source, "cavity", _opening(faces), "layers that close the cavity on all sides")
    return wanted[0] if wanted else None


def _opening(faces: Mapping[str, cadquery.Shape]) -> str:
    """The narrowest opening of an open cavity, in words."""
    found = []
    for (one, first), (other, second) in combinations(faces.items(), 2):
        distance, points = cad.closest(first, second)
        if distance > cad.SAME_POINT:
            found.append((distance, f"an opening between {one} and {other}, {distance:.4g} mm wide at "
                          f"{cad.place(points[0])}"))
    return min(found)[1] if found else "no empty space between the layers"


# --------------------------------------------------------------------------------------------------------------------
# Cuts


def _pieces(
    face: cadquery.Face, beside: Sequence[float] | None = None
) -> tuple[list[cadquery.Face], tuple[float, ...]]:
    """A face cut into mostly four-sided pieces, and the cuts' radii (m). The cuts beside steep or curved parts are at
    the radii `beside`, if given."""
    loops = [[cad.curve_of(edge) for edge in edges] for edges in cad.directed_edges(face)]
    if len(loops) == 1 and four_sides(loops[0]) is not None:
        return [face], ()
    zones = _zones(loops)
    if beside is None:
        points = np.concatenate([arc.polyline for loop in loops for arc in loop], axis=1)
        left, right = points[0].min(), points[0].max()
        # No cut is made that would leave only a sliver.
        beside = [radius for low, high in zones for radius in (low, high)
                  if left + 0.2 * (high - low) < radius < right - 0.2 * (high - low)]
    corners = [radius for radius in _corners(loops) if not any(low < radius < high for low, high in zones)]
    radii = sorted({*beside, *corners})
    if not radii:
        return [face], tuple(beside)
    box, module = face.BoundingBox(), cadquery_module()
    lines = [module.Edge.makeLine(module.Vector(MILLIMETRES * r, 0.0, box.zmin - 1.0),
                                  module.Vector(MILLIMETRES * r, 0.0, box.zmax + 1.0)) for r in radii]
    return list(face.split(*lines).Faces()), tuple(beside)


def _zones(loops: Sequence[Sequence[Arc]]) -> list[tuple[float, float]]:
    """Ranges of radii (m) where a face is steep or curved. They have margins and are merged."""
    arcs = [arc for loop in loops for arc in loop]
    points = np.concatenate([arc.polyline for arc in arcs], axis=1)
    merged: list[tuple[float, float]] = []
    found = []
    for arc in arcs:
        r, _ = arc.polyline
        if np.ptp(r) > 0.0 and _steepest(arc) > OBLIQUE:
            margin = 0.5 * float(np.ptp(r)) + CUT_MARGIN * float(np.ptp(points[1]))
            found.append((float(r.min()) - margin, float(r.max()) + margin))
    for low, high in sorted(found):
        if merged and low <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(high, merged[-1][1]))
        else:
            merged.append((low, high))
    return merged


def _corners(loops: Sequence[Sequence[Arc]]) -> Iterator[float]:
    """Radii (m) of the re-entrant corners of a face."""
    for loop in loops:
        for before, after in zip([loop[-1], *loop], loop, strict=False):
            if turned(before, after) < -CORNER:
                yield after.ends[0][0]


def _steepest(arc: Arc) -> float:
    """The largest slope (degrees) of a curve; zero if vertical."""
    if arc.is_straight and abs(arc.ends[0][0] - arc.ends[1][0]) < SAME_LENGTH:
        return 0.0
    steps = np.abs(np.diff(arc.polyline, axis=1))
    return float(np.degrees(np.arctan2(steps[1], steps[0])).max())


def turned(before: Arc, after: Arc) -> float:
    """The angle (degrees) of the left turn between two edges."""
    (a, b), (c, d) = before.direction(1.0), after.direction(0.0)
    return math.degrees(math.atan2(a * d - b * c, a * c + b * d))


def four_sides(loop: Sequence[Arc]) -> list[list[int]] | None:
    """The edges (indices) of a face's four sides, anticlockwise, or None. The first side begins in the corner that is
    lowest and nearest to the axis."""
    turns = [turned(loop[k - 1], loop[k]) for k in range(len(loop))]
    corners = [k for k, angle in enumerate(turns) if angle > CORNER]
    if len(corners) != 4 or min(turns) < -CORNER or max(turns) > 180.0 - CORNER:
        return None
    first = min(range(4), key=lambda k: (round(sum(loop[corners[k]].ends[0]), 12), loop[corners[k]].ends[0][0]))
    corners = corners[first:] + corners[:first]
    sides = [[j % len(loop) for j in range(begin, end if end > begin else end + len(loop))]
             for begin, end in zip(corners, [*corners[1:], corners[0]], strict=True)]
    for side in sides:
        (r0, z0), (r1, z1) = loop[side[0]].ends[0], loop[side[-1]].ends[1]
        chord = math.atan2(z1 - z0, r1 - r0)
        steps = np.concatenate([np.diff(loop[k].polyline, axis=1) for k in side], axis=1)
        steps = steps[:, np.hypot(*steps) > 0.0]
        off = (np.arctan2(steps[1], steps[0]) - chord + np.pi) % (2.0 * np.pi) - np.pi
        if np.degrees(np.abs(off)).max() > OBLIQUE:
            return None
    return sides


# --------------------------------------------------------------------------------------------------------------------
# Faces that share their edges


def _fused(
    pieces: Sequence[tuple[str, cadquery.Face]], electrodes: tuple[Electrode, ...], rectangles: tuple[Rectangle, ...],
    notes: tuple[str, ...],
) -> FreeSection:
    from OCP.BOPAlgo import BOPAlgo_Builder

    builder = BOPAlgo_Builder()
    builder.SetFuzzyValue(cad.SAME_POINT)
    for _, piece in pieces:
        builder.AddArgument(piece.wrapped)
    builder.Perform()
    numbers: dict[Any, int] = {}
    edges: list[Arc] = []
    ends: list[tuple[int, int]] = []
    points: list[tuple[float, float]] = []

    def point(at: tuple[float, float]) -> int:
        for number, (r, z) in enumerate(points):
            if math.hypot(r - at[0], z - at[1]) < SAME_LENGTH:
                return number
        points.append((0.0 if abs(at[0]) < SAME_LENGTH else at[0], at[1]))
        return len(points) - 1

    def directed(edge: Any) -> Directed:
        arc = cad.curve_of(edge)
        begin, end = point(arc.ends[0]), point(arc.ends[1])
        if edge not in numbers:
            numbers[edge] = len(edges)
            edges.append(arc)
            ends.append((begin, end))
        number = numbers[edge]
        return number, ends[number] == (begin, end)

    faces: list[Face] = []
    module = cadquery_module()
    for region, piece in pieces:
        for shape in list(builder.Modified(piece.wrapped)) or [piece.wrapped]:
            found = module.Shape.cast(shape)
            loops = [tuple(directed(edge) for edge in each) for each in cad.directed_edges(found)]
            if sum(arc.area for arc in (edges[n] if f else edges[n].back for n, f in loops[0])) < 0.0:
                loops = [tuple((n, not f) for n, f in reversed(loop)) for loop in loops]
            faces.append(Face(region, tuple(loops)))
    return FreeSection(tuple(points), tuple(edges), tuple(ends), tuple(faces), electrodes, rectangles, notes)
