"""Sections of layers of any shape, drawn by CadQuery. Lengths are in millimetres, in the half plane x = r, z."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geometry.apart import NoAnswer, answer_apart
from geometry.curves import Arc, Curve
from geometry.kernel import MILLIMETRES, cadquery_module
from geometry.limits import FULL_DISC
from geometry.measure import ABOUT_AXIS, Measure, Straight
from geometry.profile import AXES, Outline, Placement, Profile, Size, StepPart
from geometry.revolution import SAME_POINT, cut
from geometry.scripts import Script, called
from geometry.step_file import step_part
from workbench.files.errors import InputError

if TYPE_CHECKING:
    from cadquery import Compound, Face

#: Largest area (mm^2) that two faces may share without an overlap.
LEAST_AREA = 1e-7

#: Time limit (s) of the CAD kernel for one STEP file. Doubled, a file that hangs is rejected later and larger
#: assemblies can be read.
STEP_SECONDS = 300


@dataclass(frozen=True)
class DrawnLayer:
    """A layer's section: a face, or a compound of two. ``left_out`` describes parts of the solid that the section
    leaves out."""

    face: Face | Compound
    left_out: str = ""


def place(point: Any) -> str:
    """A point of the section as text for messages."""
    return f"({point.x:.4g} mm, {point.z:.4g} mm)"


def closest(one: Any, other: Any) -> tuple[float, list[Any]]:
    """The distance (mm) between two shapes; the nearest points of the first."""
    from OCP.BRepExtrema import BRepExtrema_DistShapeShape

    near = BRepExtrema_DistShapeShape(one.wrapped, other.wrapped)
    points = [near.PointOnShape1(k + 1) for k in range(near.NbSolution())]
    return near.Value(), [cadquery_module().Vector(point.X(), point.Y(), point.Z()) for point in points]


def mirrored(drawn: DrawnLayer, middle: float) -> DrawnLayer:
    """A section right of r = 0 and its mirror image, joined. They are centred at `middle` (m)."""
    cadquery = cadquery_module()
    both = drawn.face.fuse(drawn.face.mirror("YZ")).clean()
    faces = both.moved(cadquery.Location(cadquery.Vector(MILLIMETRES * middle, 0.0, 0.0))).Faces()
    return DrawnLayer(faces[0] if len(faces) == 1 else cadquery.Compound.makeCompound(faces), drawn.left_out)


def profile_face(profile: Profile, sizes: Mapping[str, float], bottom: float, *, source: str, field: str,
                 measure: Measure = ABOUT_AXIS, is_transducer: bool = False, steps: tuple[Profile, ...] = ()
                 ) -> DrawnLayer:
    """The section of a profiled layer, right of the axis or middle.

    Args:
        sizes: the layer's own dimensions by name (m).
        bottom: height of the layer's bottom (m).
        steps: the profiles of all STEP parts of the chip, which are read together.

    Raises:
        InputError: the outline is open, crosses itself or leaves the half plane; a script or a STEP file lacks the
            part; a solid is not a body of revolution about the axis; the script of a straight chip draws a solid.
    """
    where = profile.source
    if isinstance(where, Outline):
        drawn = DrawnLayer(_outline(where, profile.sizes(sizes), source=source, field=f"{field}.points"))
    elif isinstance(where, Script):
        made = called(where, profile.sizes(sizes), profile.angles, [name for name, _ in profile.parameters])
        drawn = _section(made, profile.asymmetry, profile.placement, str(where.path), where.function, measure)
    else:
        drawn, bottom = step_sections(steps or (profile,))[profile], 0.0
    box = drawn.face.BoundingBox()
    hole, middle = f"cavity_{measure.across}", measure.middle
    if box.xmin < -SAME_POINT:
        raise InputError(source, field, f"{measure.symbol} = {box.xmin:.4g} mm",
                         f"no point beyond the {middle}: {measure.symbol} of zero or more")
    if box.xmin > SAME_POINT and hole not in sizes:
        raise InputError(source, field, f"{measure.symbol} = {box.xmin:.4g} mm and more", FULL_DISC if is_transducer
                         else f"an outline that reaches the {middle}: a layer with a hole has a {hole}")
    if isinstance(where, Script) and box.zmax < SAME_POINT:
        over = "-z" if profile.placement.axis == AXES["z"] else "of the other sign"
        raise InputError(str(where.path), where.function, f"a body upside down, from z = {box.zmin:.4g} to "
                         f"{box.zmax:.4g} mm", "its bottom at z = 0; the key of the profile axis "
                         f"{'= ' if over == '-z' else ''}{repr(over) if over == '-z' else over} turns it over")
    up = cadquery_module().Vector(0.0, 0.0, MILLIMETRES * bottom)
    return DrawnLayer(drawn.face.moved(cadquery_module().Location(up)), drawn.left_out)


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
        if (end - begin).Length < SAME_POINT:
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
        vertex = [each for each in face.Vertices() if (each.Center() - at).Length < SAME_POINT]
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
    if across.Length < SAME_POINT * (end - begin).Length:
        raise InputError(source, field, place(middle), "a point beside the line between the two ends")
    return cadquery_module().Edge.makeThreePointArc(begin, middle, end)


def _check_simple(edges: Sequence[Any], source: str, field: str) -> None:
    """Raise if an outline touches itself outside the corners of neighbours."""
    count = len(edges)
    for i in range(count):
        for j in range(i + 1, count):
            distance, meeting = closest(edges[i], edges[j])
            if distance > SAME_POINT:
                continue
            shared = [edges[i].endPoint()] * (j == i + 1) + [edges[j].endPoint()] * ((j + 1) % count == i)
            for at in meeting:
                if not any((at - corner).Length < 10.0 * SAME_POINT for corner in shared):
                    raise InputError(source, field, place(at), f"an outline that does not cross itself: the ways to "
                                     f"points {i} and {j} meet there")


# --------------------------------------------------------------------------------------------------------------------
# Solids


def _section(
    made: Any, asymmetry: float, placement: Placement, source: str, field: str, measure: Measure = ABOUT_AXIS
) -> DrawnLayer:
    """The section of a CadQuery result: a solid or a face."""
    cadquery = cadquery_module()
    values = [made]
    if isinstance(made, cadquery.Workplane):
        # Lines that were drawn but not made into a shape.
        drawn = [*made.ctx.pendingWires, *([cadquery.Wire.assembleEdges(made.ctx.pendingEdges)]
                                           if made.ctx.pendingEdges else [])]
        values = drawn or list(made.vals())
    shapes = [each for each in values if isinstance(each, cadquery.Shape)]
    if not shapes or len(shapes) != len(values):
        raise InputError(source, field, type(made).__name__, "a CadQuery solid, face or closed wire")
    solids = [solid for each in shapes for solid in each.Solids()]
    if len(solids) > 1:
        raise InputError(source, field, f"{len(solids)} solids", "one solid: `union` joins solids that touch")
    if solids and isinstance(measure, Straight):
        raise InputError(source, field, "a solid", "the cross-section of a straight chip: a face, or a closed wire, in "
                         'the plane y = 0, as of Workplane("XZ")')
    if solids:
        return DrawnLayer(*cut(solids[0], placement, asymmetry, source, field))
    if placement != Placement():
        raise InputError(source, field, "no solid", "a solid: axis, origin and sector of a profile are for solids")
    faces = [face for each in shapes for face in each.Faces()]
    if not faces:
        faces = [_closed(wire, source, field) for each in shapes for wire in each.Wires()]
    if len(faces) != 1:
        raise InputError(source, field, f"{len(faces)} faces and no solid", "one solid, or one face in the plane y = 0")
    box = faces[0].BoundingBox()
    if max(abs(box.ymin), abs(box.ymax)) > SAME_POINT:
        raise InputError(source, field, f"a face from y = {box.ymin:.4g} to {box.ymax:.4g} mm",
                         'a face in the plane y = 0, as of Workplane("XZ")')
    return DrawnLayer(faces[0])


def _closed(wire: Any, source: str, field: str) -> Face:
    if not wire.IsClosed():
        ends = [place(end) for end in (wire.startPoint(), wire.endPoint())]
        raise InputError(source, field, f"a wire from {ends[0]} to {ends[1]}", "a closed one: `close()` joins its ends")
    face: Face = cadquery_module().Face.makeFromWires(wire)
    return face


@lru_cache(maxsize=8)
def step_sections(profiles: tuple[Profile, ...]) -> Mapping[Profile, DrawnLayer]:
    """The sections of STEP solids, by profile. A separate process reads each file.

    Raises:
        InputError: as in :func:`profile_face`, or the CAD kernel crashed or did not finish.
    """
    files = dict[tuple[Path, float, str], list[Profile]]()
    for profile in profiles:
        if isinstance(where := profile.source, StepPart):
            files.setdefault((where.path, where.scale, where.content), []).append(profile)
    cadquery, found = cadquery_module(), dict[Profile, DrawnLayer]()
    for (path, scale, content), of_file in files.items():
        request = {"path": str(path), "scale": scale, "content": content, "parts": [
            {"part": each.source.part, "asymmetry": each.asymmetry, **vars(each.placement)}
            for each in of_file if isinstance(each.source, StepPart)]}
        try:
            answers = answer_apart("geometry.cad:step_answers", request, seconds=STEP_SECONDS)
        except NoAnswer as error:
            raise InputError(str(path), "STEP file", f"a file that the CAD kernel failed on ({error})",
                             "a STEP file of solids that it can read; export it anew") from None
        for profile, answer in zip(of_file, answers, strict=False):
            if "error" in answer:
                source, field, value, expected, nearest = answer["error"]
                raise InputError(source, field, value, expected, tuple(nearest))
            face = cadquery.Shape.importBin(io.BytesIO(base64.b64decode(answer["face"])))
            found[profile] = DrawnLayer(face, answer["left_out"])
    return found


def step_answers(request: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Sections of the parts of one STEP file, as JSON. They end at the first mistake."""
    found = list[dict[str, Any]]()
    path, scale, content = Path(request["path"]), request["scale"], request["content"]
    for each in request["parts"]:
        placement = Placement(tuple(each["axis"]), tuple(each["origin"]), each["sector"])
        try:
            drawn = _section(step_part(path, scale, content, each["part"]), each["asymmetry"], placement, str(path),
                             each["part"])
        except InputError as error:
            return [*found, {"error": [error.source, error.field, error.value, error.expected, error.nearest]}]
        stream = io.BytesIO()
        drawn.face.exportBin(stream)
        found.append({"face": base64.b64encode(stream.getvalue()).decode(), "left_out": drawn.left_out})
    return found


def section_measures(drawn: DrawnLayer) -> dict[str, float]:
    """Measures (m) of the section of a solid. The keys are ``bottom``, ``thickness``, ``radius`` and, if there is a
    hole along the axis, ``cavity_radius``."""
    box = drawn.face.BoundingBox()
    found = {"bottom": box.zmin, "thickness": box.zmax - box.zmin, "radius": box.xmax}
    found |= {"cavity_radius": box.xmin} if box.xmin > SAME_POINT else {}
    return {name: length / MILLIMETRES for name, length in found.items()}


# --------------------------------------------------------------------------------------------------------------------
# Between CadQuery and curves


def curve_of(edge: Any) -> Arc:
    """A CadQuery edge of the half plane as a curve."""
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
    """The face bounded by whole lines and parabolas (`geometry.curves`)."""
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
