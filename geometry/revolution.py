"""The section of a solid of revolution, and its axis. Lengths are in millimetres."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry.kernel import MILLIMETRES, cadquery_module
from geometry.limits import NOT_ROUND
from geometry.profile import AXES, Placement
from geometry.step_file import LARGEST, SMALLEST
from workbench.files.errors import InputError

if TYPE_CHECKING:
    from cadquery import Face, Solid

#: Least volume (mm^3) of a solid.
LEAST_VOLUME = 1e-7

#: Points closer than this (mm) are equal; the length is `geometry.parts.SAME_LENGTH`.
SAME_POINT = 1e-6

#: Azimuths (degrees) of the trial cuts of a solid. The best cut represents most of its volume.
AZIMUTHS = (0.0, 90.0, 45.0, 30.0, 60.0, 75.0)

#: Largest relative volume difference at which a message names an axis: that of a solid with ports or a key. Doubled, a
#: plate with a large round boss counts as round.
NAMED_WITHIN = 0.05

#: Largest relative volume difference at which a message shows the differing places; above it the solids are unrelated.
SHOWN_WITHIN = 0.2


@dataclass(frozen=True, eq=False)
class Turned:
    """A solid's section in the half plane, compared with the solid. ``share`` is the share of the solid's volume that
    differs from the turned section, in the solids ``differing``."""

    face: Face
    share: float
    differing: tuple[Any, ...]


def cut(solid: Solid, placement: Placement, asymmetry: float, source: str, field: str) -> tuple[Face, str]:
    """The checked section of a solid, and a note on omitted parts.

    The note is empty if it leaves out none.

    Raises:
        InputError: the solid is not closed, has an unusual size, or is not a body of revolution about the stated axis
            within `asymmetry` of its volume; the message then names the axis that fits.
    """
    box = solid.BoundingBox()
    width = max(box.xmax - box.xmin, box.ymax - box.ymin, box.zmax - box.zmin)
    if solid.isValid() and not SMALLEST <= width <= LARGEST:
        raise InputError(source, field, f"a solid {width:.4g} mm wide", f"{SMALLEST:g} mm to {LARGEST / 1e3:g} m: "
                         "lengths are in millimetres, those that a script gets and those that it draws with")
    if not solid.isValid() or solid.Volume() <= LEAST_VOLUME:
        raise InputError(source, field, f"a solid of {solid.Volume():.4g} mm^3, valid: {solid.isValid()}",
                         "a valid, closed solid")
    found = turned_about(solid, placement, asymmetry * 1e-3, max(asymmetry, SHOWN_WITHIN))
    if found is not None and found.share <= min(asymmetry, 1e-6):
        return found.face, ""
    if found is not None and found.share <= asymmetry:
        return found.face, _difference_text(found)
    stated = "the z axis" if placement == Placement() else f"the axis that is stated: {words(placement)}"
    if found is None or found.share > 1e-2:
        other = turning(solid, asymmetry)
        if other is not None and (found is None or other[1].share < 0.5 * found.share):
            within = "" if other[1].share <= asymmetry else f", asymmetry = \"{_above(other[1].share)} %\""
            raise InputError(source, field, words(other[0]), f"a solid that turns about {stated}; "
                             f"in the profile {revolution_keys(other[0])}{within} states the axis of this one")
    if found is None or found.share > SHOWN_WITHIN:
        raise InputError(source, field, f"a solid from x = {box.xmin:.4g} to {box.xmax:.4g} mm and y = {box.ymin:.4g} "
                         f"to {box.ymax:.4g} mm that turns about no axis", f"a solid that turns about {stated}; "
                         f"{NOT_ROUND}")
    raise InputError(source, field, _difference_text(found), f"a solid that turns about {stated} within "
                     f"{100.0 * asymmetry:.3g} %; profile.asymmetry states the share that may be left out; {NOT_ROUND}")


def _difference_text(found: Turned) -> str:
    worst = max(found.differing, key=lambda each: each.Volume())
    centre = worst.Center()
    return (f"{100.0 * found.share:.3g} % of its volume ({sum(e.Volume() for e in found.differing):.4g} mm^3 in "
            f"{len(found.differing)} places) differs from its section turned about the axis, most at "
            f"r = {math.hypot(centre.x, centre.y):.4g} mm, z = {centre.z:.4g} mm")


def _above(share: float) -> str:
    """A percentage, rounded up to one digit with a margin."""
    percent = 110.0 * share
    digit = 10.0 ** math.floor(math.log10(percent))
    return f"{math.ceil(percent / digit) * digit:.6g}"


# --------------------------------------------------------------------------------------------------------------------
# About an axis


def upright(solid: Solid, placement: Placement) -> Solid:
    """The solid with its axis along z and origin at zero. A sector has its middle at azimuth 0."""
    cadquery = cadquery_module()
    if placement.axis != AXES["z"] or any(placement.origin):
        origin = tuple(MILLIMETRES * each for each in placement.origin)
        solid = solid.moved(cadquery.Plane(origin=origin, normal=placement.axis).location.inverse)
    if placement.sector < 2.0 * math.pi:
        centre = solid.Center()
        solid = _rotated(solid, -math.degrees(math.atan2(centre.y, centre.x)))
    return solid


def turned_about(solid: Solid, placement: Placement, enough: float, most: float) -> Turned | None:
    """The section that represents most of a solid, or None. None means that no cut is in one piece, or that all leave
    out more than the share `most` of the volume. The search ends at a share of `enough`."""
    solid = upright(solid, placement)
    whole = placement.sector == 2.0 * math.pi
    best: Turned | None = None
    for azimuth in AZIMUTHS if whole else AZIMUTHS[:1]:
        turned = _rotated(solid, azimuth) if azimuth else solid
        faces = half_plane(turned.BoundingBox()).intersect(turned).Faces()
        if len(faces) != 1:
            continue
        body = revolved(faces[0])
        if not whole:
            degrees = math.degrees(placement.sector)
            body = _rotated(revolved(faces[0], degrees), -0.5 * degrees)
        # The difference of volumes is a fast lower limit of the exact difference of the bodies.
        if abs(body.Volume() - solid.Volume()) > most * solid.Volume():
            continue
        differing = (*turned.cut(body).Solids(), *body.cut(turned).Solids())
        share = sum(each.Volume() for each in differing) / solid.Volume()
        if best is None or share < best.share * (1.0 - 1e-9):
            best = Turned(faces[0], share, differing)
        if share < enough:
            break
    return best


def _rotated(solid: Any, degrees: float) -> Any:
    """The solid turned about z."""
    cadquery = cadquery_module()
    return solid.rotate(cadquery.Vector(), cadquery.Vector(0.0, 0.0, 1.0), degrees)


def half_plane(box: Any, *, is_whole: bool = False) -> Face:
    """The half plane r >= 0 beyond a bounding box. It is the whole plane y = 0 if `is_whole`. It is the whole plane if
    `is_whole`."""
    reach = 1.1 * max(box.xmax, -box.xmin, box.ymax, -box.ymin) + 1.0
    return rectangle(-reach if is_whole else 0.0, reach, box.zmin - 1.0, box.zmax + 1.0)


def rectangle(r_inner: float, r_outer: float, z_bottom: float, z_top: float) -> Face:
    """A rectangle of the half plane (mm)."""
    cadquery = cadquery_module()
    corners = [cadquery.Vector(r, 0.0, z) for r, z in (
        (r_inner, z_bottom), (r_outer, z_bottom), (r_outer, z_top), (r_inner, z_top))]
    face: Face = cadquery.Face.makeFromWires(cadquery.Wire.makePolygon(corners, close=True))
    return face


def revolved(face: Face, degrees: float = 360.0) -> Solid:
    """A face of the half plane turned about the axis."""
    cadquery = cadquery_module()
    solid: Solid = cadquery.Solid.revolve(face, degrees, cadquery.Vector(), cadquery.Vector(0.0, 0.0, 1.0))
    return solid


# --------------------------------------------------------------------------------------------------------------------
# About which axis


def turning(solid: Solid, asymmetry: float) -> tuple[Placement, Turned] | None:
    """The placement of a body of revolution or its sector, or None. The tolerance is `asymmetry` or
    :data:`NAMED_WITHIN` of its volume."""
    best: tuple[Placement, Turned] | None = None
    for axis, origin in _candidates(solid):
        whole = Placement(axis, origin)
        for placement in (whole, _sector(solid, whole)):
            found = None if placement is None else turned_about(
                solid, placement, 1e-6, max(asymmetry, NAMED_WITHIN))
            if placement is not None and found is not None and (best is None or found.share < 0.5 * best[1].share):
                best = placement, found
        if best is not None and best[1].share < asymmetry:
            break
    return best if best is not None and best[1].share < max(asymmetry, NAMED_WITHIN) else None


def _candidates(solid: Solid) -> Iterator[tuple[tuple[float, float, float], tuple[float, float, float]]]:
    """Possible axes (direction, point in m) of a solid. They are those of its round faces, the largest first. A solid
    without round faces (some programs write only splines) gets the middle lines of its bounding box."""
    found: list[tuple[float, Any, Any]] = []
    for face in solid.Faces():
        axis = _axis_of(face)
        if axis is None:
            continue
        point, direction = axis
        for k, (area, other, along) in enumerate(found):
            apart = np.cross(point - other, along)
            if abs(abs(direction @ along) - 1.0) < 1e-9 and np.linalg.norm(apart) < SAME_POINT:
                found[k] = (area + face.Area(), other, along)
                break
        else:
            found.append((face.Area(), point, direction))
    found.sort(key=lambda each: -each[0])
    lines = [(point, direction) for _, point, direction in found[:4]]
    if not lines:
        # The bounding box is exact to some 1e-7 mm; integrals over splines are not.
        middle = _round(np.array(solid.BoundingBox().center.toTuple()), 10.0 * SAME_POINT)
        lines = [(middle, np.array(AXES[name])) for name in ("z", "y", "x")]
    for point, direction in lines:
        # The largest component is positive upwards; the point is the point of the axis nearest to the file's origin.
        direction = _round(direction * math.copysign(1.0, direction[np.argmax(np.abs(direction))]), 1e-9)
        direction = direction / np.linalg.norm(direction)
        nearest = _round(point - (point @ direction) * direction, SAME_POINT) / MILLIMETRES
        yield (tuple(direction.tolist()), tuple(nearest.tolist()))


def _round(values: Any, step: float) -> Any:
    """Components rounded to thousandths if they differ only by rounding."""
    near = np.round(values, 3) + 0.0
    return np.where(np.abs(values - near) < step, near, values)


def _axis_of(face: Any) -> tuple[Any, Any] | None:
    """Point and direction of the axis of a round face."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.GeomAbs import GeomAbs_SurfaceType as Kind

    surface = BRepAdaptor_Surface(face.wrapped)
    match surface.GetType():
        case Kind.GeomAbs_Cylinder:
            axis = surface.Cylinder().Axis()
        case Kind.GeomAbs_Cone:
            axis = surface.Cone().Axis()
        case Kind.GeomAbs_Torus:
            axis = surface.Torus().Axis()
        case Kind.GeomAbs_SurfaceOfRevolution:
            axis = surface.AxeOfRevolution()
        case _:
            return None
    point, direction = axis.Location(), axis.Direction()
    return (np.array([point.X(), point.Y(), point.Z()]), np.array([direction.X(), direction.Y(), direction.Z()]))


def _sector(solid: Solid, whole: Placement) -> Placement | None:
    """The sector that a solid fills about an axis, or None. It follows from the volume."""
    standing = upright(solid, whole)
    centre = standing.Center()
    if math.hypot(centre.x, centre.y) < SAME_POINT:
        return None
    turned = _rotated(standing, -math.degrees(math.atan2(centre.y, centre.x)))
    faces = half_plane(turned.BoundingBox()).intersect(turned).Faces()
    if len(faces) != 1:
        return None
    degrees = 360.0 * solid.Volume() / revolved(faces[0]).Volume()
    near = round(2.0 * degrees) / 2.0
    degrees = near if abs(degrees - near) < 0.01 * near else degrees
    if not 0.0 < degrees < 359.9:
        return None
    return Placement(whole.axis, whole.origin, math.radians(degrees))


# --------------------------------------------------------------------------------------------------------------------
# In words


def words(placement: Placement) -> str:
    """A placement in words. Example: "half of a body of revolution about y through x = 15 mm"."""
    degrees = math.degrees(placement.sector)
    part = {360.0: "", 180.0: "half of ", 90.0: "a quarter of "}.get(
        round(degrees, 6), f"a sector of {degrees:.4g} degrees of ")
    named = next((name for name, axis in AXES.items() if axis == placement.axis), "")
    through = ", ".join(f"{name} = {MILLIMETRES * value:.6g} mm" for name, value in zip(
        "xyz", placement.origin, strict=True) if value and name != named)
    return (f"{part}a body of revolution about {named or f'the direction [{_numbers(placement.axis)}]'} through "
            f"{through or 'the origin'}")


def revolution_keys(placement: Placement) -> str:
    """The keys of a profile that state a placement."""
    named = next((name for name, axis in AXES.items() if axis == placement.axis), "")
    found = []
    if placement.axis != AXES["z"]:
        found.append(f'axis = "{named}"' if named else f"axis = [{_numbers(placement.axis)}]")
    if any(placement.origin):
        lengths = ", ".join(f'"{MILLIMETRES * each:.9g} mm"' for each in placement.origin)
        found.append(f"origin = [{lengths}]")
    if placement.sector < 2.0 * math.pi:
        found.append(f'sector = "{math.degrees(placement.sector):.9g} deg"')
    return ", ".join(found)


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{each:.12g}" for each in values)
