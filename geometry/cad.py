"""Layers of any shape drawn by CadQuery, in the half plane x = r, z, in **millimetres** as in every CAD file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geometry.curves import Arc, Curve
from geometry.kernel import MILLIMETRES, cadquery_module
from geometry.profile import Outline, Profile, Script, Size, StepPart, called
from workbench.files.errors import InputError, nearest_names

if TYPE_CHECKING:
    from cadquery import Face, Solid

#: Faces that have more than this in common (mm^2) overlap, and solids of another volume (mm^3) differ: far below what
#: anybody means, far above rounding.
SOME = 1e-7

#: Points closer than this (mm) are one point: the same length as `geometry.parts.SAME_LENGTH`.
CLOSE = 1e-6

#: Azimuths (degrees) at which a solid may be cut; the first one is taken that shows most of what turns about the axis.
AZIMUTHS = (0.0, 90.0, 45.0, 30.0, 60.0, 75.0)

#: A chip is neither smaller nor larger than this across (mm).
SMALLEST, LARGEST = 0.5, 1000.0


@dataclass(frozen=True)
class Drawn:
    """The section of a layer, and what of its solid it leaves out ("" for nothing)."""

    face: Face
    left_out: str = ""


def place(point: Any) -> str:
    """A point of the section as messages show it."""
    return f"r = {point.x:.4g} mm, z = {point.z:.4g} mm"


def closest(one: Any, other: Any) -> tuple[float, list[Any]]:
    """The distance (mm) between two shapes, and the points of the first one where it is so small."""
    from OCP.BRepExtrema import BRepExtrema_DistShapeShape

    near = BRepExtrema_DistShapeShape(one.wrapped, other.wrapped)
    points = [near.PointOnShape1(k + 1) for k in range(near.NbSolution())]
    return near.Value(), [cadquery_module().Vector(point.X(), point.Y(), point.Z()) for point in points]


def profile_face(profile: Profile, sizes: Mapping[str, float], bottom: float, *, source: str, field: str) -> Drawn:
    """The section of a layer whose bottom is at that height (m).

    Args:
        sizes: the layer's own dimensions by name (m).

    Raises:
        InputError: the outline is not closed, crosses itself or leaves the half plane, a script or a STEP file has not
            what is asked for, or a solid does not turn about the axis.
    """
    where = profile.source
    if isinstance(where, Outline):
        drawn = Drawn(_outline(where, profile.sizes(sizes), source=source, field=f"{field}.points"))
    elif isinstance(where, Script):
        made = called(where, profile.sizes(sizes), profile.angles)
        drawn = _section(made, profile.asymmetry, str(where.path), where.function)
    else:
        drawn, bottom = _step_section(where, profile.asymmetry), 0.0
    box = drawn.face.BoundingBox()
    if box.xmin < -CLOSE:
        raise InputError(source, field, f"r = {box.xmin:.4g} mm", "no point beyond the axis: r of zero or more")
    if box.xmin > CLOSE and "cavity_radius" not in sizes:
        raise InputError(source, field, f"r = {box.xmin:.4g} mm and more", "an outline that reaches the axis: a "
                         "layer with a hole has a cavity_radius")
    up = cadquery_module().Vector(0.0, 0.0, MILLIMETRES * bottom)
    return Drawn(drawn.face.moved(cadquery_module().Location(up)), drawn.left_out)


# --------------------------------------------------------------------------------------------------------------------
# Outlines


def _outline(outline: Outline, sizes: Mapping[str, float], *, source: str, field: str) -> Face:
    cadquery = cadquery_module()

    def length(size: Size) -> float:
        return MILLIMETRES * (sizes[size] if isinstance(size, str) else size)

    def vector(point: tuple[Size, Size]) -> Any:
        return cadquery.Vector(length(point[0]), 0.0, length(point[1]))

    corners = outline.corners
    edges = []
    for number, corner in enumerate(corners):
        begin, end = vector(corners[number - 1].at), vector(corner.at)
        if (end - begin).Length < CLOSE:
            raise InputError(source, f"{field}[{number}]", place(end), "another place than the point before it")
        if corner.arc is not None:
            edges.append(_arc(begin, vector(corner.arc), end, source=source, field=f"{field}[{number}].arc"))
        elif corner.through:
            edges.append(cadquery.Edge.makeSpline([begin, *map(vector, corner.through), end]))
        else:
            edges.append(cadquery.Edge.makeLine(begin, end))
    _check_simple(edges, source, field)
    face = cadquery.Face.makeFromWires(cadquery.Wire.assembleEdges(edges))
    for number, corner in enumerate(corners):
        if corner.fillet is None or length(corner.fillet) == 0.0:
            continue
        at = vector(corner.at)
        vertex = [each for each in face.Vertices() if (each.Center() - at).Length < CLOSE]
        before = face.Area()
        try:
            rounded = face.fillet2D(length(corner.fillet), vertex)
        except Exception:
            rounded = None
        if rounded is None or not rounded.isValid() or abs(rounded.Area() - before) < 1e-14:
            raise InputError(source, f"{field}[{number}].fillet", f"{length(corner.fillet):.4g} mm",
                             f"a radius that fits between the neighbours of the corner at {place(at)}")
        face = rounded
    return face


def _arc(begin: Any, middle: Any, end: Any, *, source: str, field: str) -> Any:
    across = (middle - begin).cross(end - begin)
    if across.Length < CLOSE * (end - begin).Length:
        raise InputError(source, field, place(middle), "a point beside the line between the two ends")
    return cadquery_module().Edge.makeThreePointArc(begin, middle, end)


def _check_simple(edges: Sequence[Any], source: str, field: str) -> None:
    """Refuse an outline that meets itself elsewhere than in the corners of neighbours."""
    count = len(edges)
    for i in range(count):
        for j in range(i + 1, count):
            distance, meeting = closest(edges[i], edges[j])
            if distance > CLOSE:
                continue
            shared = [edges[i].endPoint()] * (j == i + 1) + [edges[j].endPoint()] * ((j + 1) % count == i)
            for at in meeting:
                if not any((at - corner).Length < 10.0 * CLOSE for corner in shared):
                    raise InputError(source, field, place(at), f"an outline that does not cross itself: the ways to "
                                     f"points {i} and {j} meet there")


# --------------------------------------------------------------------------------------------------------------------
# Solids


def _section(made: Any, asymmetry: float, source: str, field: str) -> Drawn:
    """The section of what a script or a file holds: of a solid, or the face itself."""
    cadquery = cadquery_module()
    values = [made]
    if isinstance(made, cadquery.Workplane):
        # Lines that were drawn and nothing was made of yet.
        drawn = [*made.ctx.pendingWires, *([cadquery.Wire.assembleEdges(made.ctx.pendingEdges)]
                                           if made.ctx.pendingEdges else [])]
        values = drawn or list(made.vals())
    shapes = [each for each in values if isinstance(each, cadquery.Shape)]
    if not shapes or len(shapes) != len(values):
        raise InputError(source, field, type(made).__name__, "a CadQuery solid, face or closed wire")
    solids = [solid for each in shapes for solid in each.Solids()]
    if len(solids) > 1:
        raise InputError(source, field, f"{len(solids)} solids", "one solid: `union` joins what touches")
    if solids:
        return _cut(solids[0], asymmetry, source, field)
    faces = [face for each in shapes for face in each.Faces()]
    if not faces:
        faces = [_closed(wire, source, field) for each in shapes for wire in each.Wires()]
    if len(faces) != 1:
        raise InputError(source, field, f"{len(faces)} faces and no solid", "one solid, or one face in the plane y = 0")
    box = faces[0].BoundingBox()
    if max(abs(box.ymin), abs(box.ymax)) > CLOSE:
        raise InputError(source, field, f"a face from y = {box.ymin:.4g} to {box.ymax:.4g} mm",
                         'a face in the plane y = 0, as of Workplane("XZ")')
    return Drawn(faces[0])


def _closed(wire: Any, source: str, field: str) -> Face:
    if not wire.IsClosed():
        ends = [place(end) for end in (wire.startPoint(), wire.endPoint())]
        raise InputError(source, field, f"a wire from {ends[0]} to {ends[1]}", "a closed one: `close()` joins its ends")
    face: Face = cadquery_module().Face.makeFromWires(wire)
    return face


def _cut(solid: Solid, asymmetry: float, source: str, field: str) -> Drawn:
    """The section of a solid where it shows most, checked against the solid's volume."""
    cadquery = cadquery_module()
    if not solid.isValid() or solid.Volume() <= SOME:
        raise InputError(source, field, f"a solid of {solid.Volume():.4g} mm^3, valid: {solid.isValid()}",
                         "a valid, closed solid")
    best = None
    for azimuth in AZIMUTHS:
        turned = solid.rotate(cadquery.Vector(), cadquery.Vector(0, 0, 1), azimuth)
        faces = half_plane(turned.BoundingBox()).intersect(turned).Faces()
        if len(faces) != 1:
            continue
        body = revolved(faces[0])
        differing = [*turned.cut(body).Solids(), *body.cut(turned).Solids()]
        share = sum(each.Volume() for each in differing) / solid.Volume()
        if best is None or share < best[0] * (1.0 - 1e-9):
            best = (share, faces[0], differing)
        if share < asymmetry * 1e-3:
            break
    if best is None:
        box = solid.BoundingBox()
        raise InputError(source, field, f"a solid from x = {box.xmin:.4g} to {box.xmax:.4g} mm and y = {box.ymin:.4g} "
                         f"to {box.ymax:.4g} mm, cut by no plane into one piece", "a solid that turns about the z axis")
    share, face, differing = best
    if share <= min(asymmetry, 1e-6):
        return Drawn(face)
    worst = max(differing, key=lambda each: each.Volume())
    centre = worst.Center()
    said = (f"{100.0 * share:.3g} % of its volume ({sum(e.Volume() for e in differing):.4g} mm^3 in {len(differing)} "
            f"places) differs from its section turned about the axis, most at r = {math.hypot(centre.x, centre.y):.4g} "
            f"mm, z = {centre.z:.4g} mm")
    if share > asymmetry:
        raise InputError(source, field, said, f"a solid that turns about the z axis within {100.0 * asymmetry:.3g} %; "
                         "profile.asymmetry states how much may be left out")
    return Drawn(face, said)


def half_plane(box: Any) -> Face:
    """The part r >= 0 of the plane y = 0, a little larger than a bounding box."""
    reach = 1.1 * max(box.xmax, -box.xmin, box.ymax, -box.ymin) + 1.0
    return rectangle(0.0, reach, box.zmin - 1.0, box.zmax + 1.0)


def rectangle(r_inner: float, r_outer: float, z_bottom: float, z_top: float) -> Face:
    """A rectangle of the half plane (mm)."""
    cadquery = cadquery_module()
    corners = [cadquery.Vector(r, 0.0, z) for r, z in (
        (r_inner, z_bottom), (r_outer, z_bottom), (r_outer, z_top), (r_inner, z_top))]
    face: Face = cadquery.Face.makeFromWires(cadquery.Wire.makePolygon(corners, close=True))
    return face


def revolved(face: Face) -> Solid:
    """A face of the half plane turned about the axis."""
    cadquery = cadquery_module()
    solid: Solid = cadquery.Solid.revolve(face, 360.0, cadquery.Vector(), cadquery.Vector(0.0, 0.0, 1.0))
    return solid


def step_parts(path: Path, scale: float) -> dict[str, Solid]:
    """The solids of a STEP file by name, in millimetres if the unit of the file should be `scale` metres.

    Raises:
        InputError: no STEP file, no solids, two of one name, or a size that no chip has.
    """
    cadquery = cadquery_module()
    found: dict[str, Any] = {}
    try:
        try:
            assembly = cadquery.Assembly.importStep(str(path))
            listed = [(name.split("/")[-1], shape.moved(where)) for shape, name, where, _ in assembly]
        except ValueError:  # a file of solids that are no assembly
            listed = [(f"part {k + 1}", each)
                      for k, each in enumerate(cadquery.importers.importStep(str(path)).solids().vals())]
    except Exception as error:
        raise InputError(str(path), "STEP file", f"{type(error).__name__}: {error}", "a STEP file of solids") from error
    for name, shape in listed:
        solids = shape.Solids()
        if not solids:
            continue
        if name in found or len(solids) > 1:
            raise InputError(str(path), "STEP file", f"{1 + len(solids)} solids called {name!r}", "a name for each")
        found[name] = solids[0].scale(scale * MILLIMETRES) if scale * MILLIMETRES != 1.0 else solids[0]
    if not found:
        raise InputError(str(path), "STEP file", f"{len(listed)} parts, none of them solid", "a STEP file of solids")
    boxes = [each.BoundingBox() for each in found.values()]
    width = max(max(box.xmax, box.ymax) for box in boxes) - min(min(box.xmin, box.ymin) for box in boxes)
    if not SMALLEST <= width <= LARGEST:
        likely = "m" if width < SMALLEST else "um"
        raise InputError(str(path), "STEP file", f"parts that are {width:.4g} mm wide together",
                         f"{SMALLEST:g} mm to {LARGEST / 1e3:g} m: if its numbers are not in the unit that it names, "
                         f'profile.scale is the length of one in the chip file, as in scale = "1 {likely}"')
    return found


def step_part(where: StepPart) -> Solid:
    """The solid of a STEP file.

    Raises:
        InputError: as of :func:`step_parts`, or there is none of that name.
    """
    found = step_parts(where.path, where.scale)
    if where.part not in found:
        raise InputError(str(where.path), "part", where.part, "one of " + ", ".join(found),
                         nearest_names(where.part, found))
    return found[where.part]


@lru_cache(maxsize=32)
def _step_section(where: StepPart, asymmetry: float) -> Drawn:
    return _section(step_part(where), asymmetry, str(where.path), where.part)


def measured_part(where: StepPart, asymmetry: float) -> dict[str, float]:
    """Where the solid of a STEP file begins and how large it is: ``bottom``, ``thickness``, ``radius`` and, of one with
    a hole along the axis, ``cavity_radius`` (m).

    Raises:
        InputError: as of :func:`profile_face`.
    """
    box = _step_section(where, asymmetry).face.BoundingBox()
    found = {"bottom": box.zmin, "thickness": box.zmax - box.zmin, "radius": box.xmax}
    found |= {"cavity_radius": box.xmin} if box.xmin > CLOSE else {}
    return {name: length / MILLIMETRES for name, length in found.items()}


# --------------------------------------------------------------------------------------------------------------------
# Between CadQuery and curves


def curve_of(edge: Any) -> Arc:
    """An edge of the half plane as a curve, in its direction."""
    from OCP.BRep import BRep_Tool
    from OCP.Geom import Geom_TrimmedCurve
    from OCP.GeomConvert import GeomConvert
    from OCP.TopAbs import TopAbs_Orientation

    begin, end = edge._bounds()
    spline = GeomConvert.CurveToBSplineCurve_s(Geom_TrimmedCurve(BRep_Tool.Curve_s(edge.wrapped, 0.0, 1.0), begin, end))
    knots = [spline.Knot(k) for k in range(1, spline.NbKnots() + 1)
             for _ in range(spline.Multiplicity(k))]
    scaled = tuple((knot - knots[0]) / (knots[-1] - knots[0]) for knot in knots)
    poles = []
    for k in range(1, spline.NbPoles() + 1):
        pole, weight = spline.Pole(k), spline.Weight(k)
        poles.append((pole.X() / MILLIMETRES * weight, pole.Z() / MILLIMETRES * weight, weight))
    arc = Arc(Curve(spline.Degree(), scaled, tuple(poles)))
    return arc if edge.wrapped.Orientation() == TopAbs_Orientation.TopAbs_FORWARD else arc.back


def face_of(arcs: Iterable[Arc]) -> Face:
    """The face that whole lines and parabolas bound (`geometry.curves`), whose poles are those of Bezier curves."""
    cadquery = cadquery_module()
    edges = []
    for arc in arcs:
        points = [cadquery.Vector(MILLIMETRES * r, 0.0, MILLIMETRES * z) for r, z, _ in arc.curve.poles]
        edges.append(cadquery.Edge.makeLine(*points) if len(points) == 2 else cadquery.Edge.makeBezier(points))
    face: Face = cadquery.Face.makeFromWires(cadquery.Wire.assembleEdges(edges))
    return face


def directed_edges(face: Any) -> Iterator[list[Any]]:
    """The edges of every loop of a face, the outer one first."""
    yield list(face.outerWire())
    for wire in face.innerWires():
        yield list(wire)
