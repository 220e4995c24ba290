"""The profile of a layer: the source of its outline.

There are three sources: points in the file, a CadQuery script, a part of a STEP file. A size in an outline is a length
or a name: of the layer's dimensions (``thickness``, ``radius``, ``cavity_radius``) or of a parameter of the profile. A
script's function gets the sizes named in its signature, in millimetres and degrees. Heights start at the layer's
bottom; in a STEP file, at its own origin. In a straight chip x starts at the middle of the layer, whose left half is
the mirror image, and ``half_width`` stands for ``radius``.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from geometry.dimension import SHAPES, Dimension, read_dimension
from geometry.measure import ABOUT_AXIS, Measure, Straight
from geometry.scripts import Script, check_script, warn_of
from workbench.files.errors import InputError, choose, nearest_files
from workbench.files.quantities import parse_quantity
from workbench.files.tables import FileTable

#: Names that a parameter of a profile cannot have.
RESERVED = ("material", "density", "gauge")

#: A length (m), or the name of one.
Size = float | str

#: Keys of an outline's segment, and of a profile.
_CORNER_KEYS = ("at", "fillet", "through", "arc")
_OF_SOLIDS = ("step", "part", "scale", "asymmetry", "axis", "origin", "sector")
_PROFILE_KEYS = ("points", "script", "function", "parameters", *_OF_SOLIDS)

#: Directions of the named axes.
AXES: Mapping[str, tuple[float, float, float]] = {
    "x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0), "-y": (0.0, -1.0, 0.0), "-z": (0.0, 0.0, -1.0)}

#: Largest relative difference between the volumes of a solid and of its section turned about the axis, unless the file
#: states another: the error of the kernel's integrals.
ASYMMETRY = 1e-6


@dataclass(frozen=True)
class Corner:
    """A corner of an outline at ``at`` (r, z), rounded by ``fillet``. The segment from the previous corner is a line, a
    circular arc through ``arc``, or a spline through ``through``."""

    at: tuple[Size, Size]
    fillet: Size | None = None
    through: tuple[tuple[Size, Size], ...] = ()
    arc: tuple[Size, Size] | None = None


@dataclass(frozen=True)
class Outline:
    """A closed outline; the last corner is joined to the first."""

    corners: tuple[Corner, ...]


@dataclass(frozen=True)
class StepPart:
    """A solid of a STEP file. ``part`` is its name, ``scale`` (m) the file's unit."""

    path: Path
    part: str
    scale: float
    content: str


@dataclass(frozen=True)
class Placement:
    """The placement of a solid in its file.

    ``axis`` is the unit vector of its axis, upwards through the chip, and ``origin`` (m) a point on it, where heights
    start. ``sector`` (rad) is the angle that the solid covers, as in models of one half or quarter.
    """

    axis: tuple[float, float, float] = AXES["z"]
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sector: float = 2.0 * math.pi


@dataclass(frozen=True)
class Profile:
    """The source of a layer's outline, and its ``parameters``. A parameter is a name and a size in m or rad.

    The parameters are dimensions of the chip; ``angles`` names the angles among them. ``asymmetry`` is the largest
    relative difference between the volumes of a solid and of its section turned about the axis; ``placement`` is that
    of the axis.
    """

    source: Outline | Script | StepPart
    parameters: tuple[tuple[str, Dimension], ...] = ()
    angles: frozenset[str] = frozenset()
    asymmetry: float = ASYMMETRY
    placement: Placement = Placement()

    def sizes(self, layer: Mapping[str, float]) -> dict[str, float]:
        """Sizes (m, rad) by name: the layer's and the profile's."""
        return {**layer, **{name: each.value for name, each in self.parameters}}

    def changed(self, change: Callable[[str, Dimension], Dimension]) -> Profile:
        """A copy with other sizes of its parameters."""
        return replace(self, parameters=tuple((name, change(name, size)) for name, size in self.parameters))


def names_of_layer(measure: Measure) -> tuple[str, ...]:
    """Names of a layer's dimensions that its profile can use."""
    return "thickness", measure.across, f"cavity_{measure.across}"


def read_profile(table: FileTable, measure: Measure = ABOUT_AXIS, *, scripts: bool = True) -> Profile:
    """The profile of a layer, from its table ``profile``. `scripts` allows a script.

    Raises:
        InputError: an invalid key, name or unit, a missing file, a script that is refused or outside the chip's folder,
            or a solid in a straight chip.
    """
    if isinstance(measure, Straight):
        for key in _OF_SOLIDS:
            if key in table:
                raise table.error(key, "points, or a script that draws a face, in a straight chip: solids of files are "
                                  "turned about an axis")
    table.only(_PROFILE_KEYS)
    sources = [key for key in ("points", "script", "step") if key in table]
    if len(sources) != 1:
        raise InputError(table.source, table.field, sources or None,
                         "one of points, script, step: where the outline comes from")
    of_layer = names_of_layer(measure)
    parameters, angles = _parameters(table.table("parameters"), of_layer)
    asymmetry = table.quantity("asymmetry", "dimensionless", ASYMMETRY)
    if not 0.0 < asymmetry < 1.0:
        raise table.error("asymmetry", "a share above 0 and below 1 of the part's volume")
    placement = _placement(table)
    if sources == ["points"] and placement != Placement():
        key = next(key for key in ("axis", "origin", "sector") if key in table)
        raise table.error(key, "none for points, which are r and z already; it places the solid of a script or file")
    source: Outline | Script | StepPart
    if sources == ["points"]:
        source = _outline(table, {*of_layer, *(name for name, _ in parameters)}, angles)
    elif sources == ["script"]:
        source = _script(table, scripts=scripts)
    else:
        path, content = _file(table, "step")
        source = StepPart(path, table.text("part", expected="the name of a solid in the file"),
                          table.quantity("scale", "length", 1e-3), content)
        if parameters:
            raise table.error("parameters", "none: a STEP file has no parameters")
    return Profile(source, parameters, angles, asymmetry, placement)


def _placement(table: FileTable) -> Placement:
    axis = AXES["z"]
    if "axis" in table:
        given = table.content["axis"]
        expected = "one of " + ", ".join(AXES) + ", or three numbers [x, y, z]: the direction up through the chip"
        if isinstance(given, str) and given in AXES:
            axis = AXES[given]
        elif isinstance(given, list) and len(given) == 3 and all(
                isinstance(each, int | float) and not isinstance(each, bool) for each in given) and (
                    0.0 < math.hypot(*given) < math.inf):
            length = math.hypot(*given)
            length = 1.0 if abs(length - 1.0) < 1e-12 else length  # Read back exactly as it was written.
            axis = given[0] / length, given[1] / length, given[2] / length
        else:
            raise table.error("axis", expected)
    origin = 0.0, 0.0, 0.0
    if "origin" in table:
        given = table.content["origin"]
        if not isinstance(given, list) or len(given) != 3:
            raise table.error("origin", 'a point on the axis, ["15 mm", "0 mm", "0 mm"]: x, y, z in the file, from '
                              "which heights are counted")
        x, y, z = (parse_quantity(each, "length", source=table.source, field=f"{table.at('origin')}[{k}]")
                   for k, each in enumerate(given))
        origin = x, y, z
    sector = table.quantity("sector", "angle", 2.0 * math.pi)
    if not 0.0 < sector <= 2.0 * math.pi * (1.0 + 1e-12):
        raise table.error("sector", 'an angle above 0 and up to "360 deg": "180 deg" where the file has one half')
    return Placement(axis, origin, min(sector, 2.0 * math.pi))


def _parameters(
    table: FileTable, of_layer: Sequence[str]
) -> tuple[tuple[tuple[str, Dimension], ...], frozenset[str]]:
    found, angles = [], set()
    for name in table:
        if not name.isidentifier() or name in {*of_layer, *SHAPES, *RESERVED}:
            raise table.error(name, "a name of letters, digits and underscores that is no key of the layer")
        inner = table.table(name) if isinstance(table.content[name], Mapping) else None
        value = inner.required("value", "a length or an angle with its unit") if inner else table.content[name]
        kind = "angle" if isinstance(value, str) and value.strip().endswith(("deg", "rad")) else "length"
        angles |= {name} if kind == "angle" else set()
        found.append((name, read_dimension(table, name, kind)))
    return tuple(found), frozenset(angles)


def _outline(table: FileTable, names: set[str], angles: frozenset[str]) -> Outline:
    entries = table.content["points"]
    expected = 'a list of three or more points, each ["1 mm", "0 mm"] (r, z) or { at = [...], fillet = "0.2 mm" }'
    if not isinstance(entries, list) or len(entries) < 3:
        raise table.error("points", expected)

    def size(value: object, place: str) -> Size:
        if isinstance(value, str) and value in angles:
            raise InputError(table.source, place, value, "a length: that parameter is an angle, for scripts alone")
        if isinstance(value, str) and not any(c.isdigit() for c in value[:2]):
            return choose(value, names, source=table.source, field=place)
        return parse_quantity(value, "length", source=table.source, field=place)

    def point(value: object, place: str) -> tuple[Size, Size]:
        if not isinstance(value, list) or len(value) != 2:
            raise InputError(table.source, place, value, 'a point ["1 mm", "0 mm"]: r and z')
        return size(value[0], f"{place}[0]"), size(value[1], f"{place}[1]")

    corners = []
    for number, entry in enumerate(entries):
        place = f"{table.at('points')}[{number}]"
        if isinstance(entry, list):
            corners.append(Corner(point(entry, place)))
            continue
        inner = FileTable.of(entry, source=table.source, field=place, expected=expected).only(_CORNER_KEYS)
        inner.required("at", 'a point ["1 mm", "0 mm"]: r and z')
        through = inner.content.get("through", [])
        if not isinstance(through, list) or ("arc" in inner and through):
            raise inner.error("through", "a list of points, without an arc")
        corners.append(Corner(
            point(inner.content["at"], f"{place}.at"),
            size(inner.content["fillet"], f"{place}.fillet") if "fillet" in inner else None,
            tuple(point(each, f"{place}.through[{k}]") for k, each in enumerate(through)),
            point(inner.content["arc"], f"{place}.arc") if "arc" in inner else None))
    return Outline(tuple(corners))


def _file(table: FileTable, key: str) -> tuple[Path, str]:
    """The file under `key`, relative to the chip file, and its digest."""
    name = table.text(key, expected="the name of a file")
    path = _path(table, name)
    try:
        if path.exists() and not path.is_file():
            raise OSError("it is no regular file")  # Reading a pipe may never end.
        return path, hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        near = nearest_files(path, lambda each: each.suffix == path.suffix)
        raise InputError(table.source, table.at(key), name, f"a readable file ({error.strerror or error})",
                         near) from None


def _path(table: FileTable, name: str) -> Path:
    return Path(table.source).parent / name


def _script(table: FileTable, *, scripts: bool) -> Script:
    name = table.text("script", expected="the name of a file")
    check_script(name, _path(table, name), source=table.source, field=table.at("script"), scripts=scripts)
    path, content = _file(table, "script")
    found = Script(path, table.text("function", expected="the name of a function of the script"), content)
    warn_of(found, table.source)
    return found


def step_profiles(profiles: Iterable[Profile | None]) -> tuple[Profile, ...]:
    """The profiles that are parts of STEP files."""
    return tuple(each for each in profiles if each is not None and isinstance(each.source, StepPart))
