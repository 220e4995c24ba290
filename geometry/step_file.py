"""The solids of a STEP file with their names.

A solid has the name of its instance in the assembly, else that of its product, else ``part 1``, ``part 2``, ... in file
order. Names made by programs (numbers, ``NAUO3``, ``Open CASCADE STEP translator``) are ignored. Several solids of one
name are numbered: ``disc (1)``, ``disc (2)``.
"""

from __future__ import annotations

import re
import tempfile
import unicodedata
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geometry.kernel import MILLIMETRES, cadquery_module
from workbench.files.errors import InputError, nearest_names, one_of

if TYPE_CHECKING:
    from cadquery import Solid

#: Names made by programs: entity counters, instance numbers, fillers of translators.
_MADE_UP = re.compile(r"\s*|\d+|NAUO\d+|=>\[[\d:]*\]|Open CASCADE .*|(COMP)?SOLID|COMPOUND|SHELL|NONE|UNNAMED\d*|"
                      r"ASSEMBLY", re.IGNORECASE)

#: Smallest and largest width (mm) of a chip.
SMALLEST, LARGEST = 0.5, 1000.0


@dataclass(frozen=True, eq=False)
class Named:
    """A solid (mm), its name, and unambiguous other names."""

    name: str
    others: tuple[str, ...]
    solid: Solid


def step_parts(path: Path, scale: float, content: str) -> dict[str, Solid]:
    """The solids (mm) of a STEP file by name. `scale` (m) is the file's unit.

    `content` distinguishes versions of the file.

    Raises:
        InputError: not a STEP file, no solids, or an unusual size.
    """
    return {each.name: each.solid for each in _scaled(path, scale, content)}


def step_part(path: Path, scale: float, content: str, part: str) -> Solid:
    """The solid of that name, or of an unambiguous other name.

    Raises:
        InputError: as in :func:`step_parts`, or no solid or several have the name.
    """
    listed = _scaled(path, scale, content)
    wanted = _composed(part)
    for each in listed:
        if each.name == wanted:
            return each.solid
    found = [each for each in listed if wanted in each.others]
    if len(found) == 1:
        return found[0].solid
    names = [f"{each.name} ({_where(each.solid)})" if found else each.name for each in found or listed]
    raise InputError(str(path), "part", part, one_of(names, wanted),
                     nearest_names(wanted, [each.name for each in listed]))


def _where(solid: Solid) -> str:
    box = solid.BoundingBox()
    return f"z = {box.zmin:.4g} to {box.zmax:.4g} mm"


@lru_cache(maxsize=8)
def _scaled(path: Path, scale: float, content: str) -> tuple[Named, ...]:
    """The solids in millimetres."""
    listed = _read(path, content)
    if scale * MILLIMETRES != 1.0:
        listed = tuple(replace(each, solid=each.solid.scale(scale * MILLIMETRES).Solids()[0]) for each in listed)
    boxes = [each.solid.BoundingBox() for each in listed]
    width = max(max(getattr(box, f"{axis}max") for box in boxes) - min(getattr(box, f"{axis}min") for box in boxes)
                for axis in "xyz")
    if not SMALLEST <= width <= LARGEST:
        likely = "m" if width < SMALLEST else "um"
        raise InputError(str(path), "STEP file", f"parts that are {width:.4g} mm wide together",
                         f"{SMALLEST:g} mm to {LARGEST / 1e3:g} m: if the file states a wrong unit, state it as "
                         f'profile.scale in the chip file, such as scale = "1 {likely}"')
    return listed


def _read(path: Path, content: str) -> tuple[Named, ...]:
    """The solids in the file's own unit, with names."""
    del content
    try:
        found = list(_solids(path))
    except InputError:
        raise
    except Exception as error:
        raise InputError(str(path), "STEP file", f"{type(error).__name__}: {error}", "a STEP file of solids") from error
    if not found:
        raise InputError(str(path), "STEP file", "no solid (surfaces and curves at most)", "a STEP file of solids")
    names: list[str] = []
    for number, (called, _, _) in enumerate(found, start=1):
        given = [name for name in called if not _MADE_UP.fullmatch(name)]
        names.append(given[0] if given else f"part {number}")
    counted = Counter(names)
    seen: Counter[str] = Counter()
    listed = []
    for number, (name, (called, more, solid)) in enumerate(zip(names, found, strict=True), start=1):
        seen[name] += 1
        unique = name if counted[name] == 1 else f"{name} ({seen[name]})"
        others = {*called, *more, name, f"part {number}"} - {unique}
        listed.append(Named(unique, tuple(sorted(others)), solid))
    return tuple(listed)


def _solids(path: Path) -> Iterator[tuple[list[str], list[str], Solid]]:
    """Every solid in its place, its names, and other names. The names are those of instance, product and solid."""
    from OCP.IFSelect import IFSelect_RetDone
    from OCP.Interface import Interface_Static
    from OCP.STEPCAFControl import STEPCAFControl_Reader
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDF import TDF_LabelSequence
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFDoc import XCAFDoc_DocumentTool

    reader = STEPCAFControl_Reader()
    reader.SetNameMode(True)
    Interface_Static.SetIVal_s("read.stepcaf.subshapes.name", 1)
    Interface_Static.SetCVal_s("xstep.cascade.unit", "MM")
    document = TDocStd_Document(TCollection_ExtendedString("XmXCAF"))
    with tempfile.TemporaryDirectory() as folder:
        status = reader.ReadFile(str(_as_utf_8(path, Path(folder))))
        if status != IFSelect_RetDone or not reader.Transfer(document):
            raise InputError(str(path), "STEP file", path.name, "a STEP file of solids (ISO 10303-21)")
    shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    roots = TDF_LabelSequence()
    shapes.GetFreeShapes(roots)
    for k in range(1, roots.Length() + 1):
        yield from _below(shapes, roots.Value(k), cadquery_module().Location(), [], "")


def _as_utf_8(path: Path, folder: Path) -> Path:
    """The file itself if it is UTF-8, else a copy in UTF-8. The kernel would lose letters of other encodings.
    Windows-1252 is read as Latin-1, which it extends; other encodings give wrong letters, but lose none."""
    data = path.read_bytes()
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        copy = folder / "copy.step"
        copy.write_text(data.decode("latin-1"), encoding="utf-8", newline="")
        return copy
    return path


def _below(
    shapes: Any, label: Any, place: Any, names: list[str], within: str
) -> Iterator[tuple[list[str], list[str], Solid]]:
    """The solids of a label: an assembly, an instance or part. `names` are those of the instance, `within` is the name
    of the assembly."""
    from OCP.TDF import TDF_Label, TDF_LabelSequence

    cadquery = cadquery_module()
    if shapes.IsReference_s(label):
        referred = TDF_Label()
        shapes.GetReferredShape_s(label, referred)
        place = place * cadquery.Location(shapes.GetLocation_s(label))
        yield from _below(shapes, referred, place, _name(label), within)
        return
    own = _name(label)
    if shapes.IsAssembly_s(label):
        called = next((name for name in (*names, *own) if not _MADE_UP.fullmatch(name)), within)
        parts = TDF_LabelSequence()
        shapes.GetComponents_s(label, parts)
        for k in range(1, parts.Length() + 1):
            yield from _below(shapes, parts.Value(k), place, [], called)
        return
    solids = cadquery.Shape.cast(shapes.GetShape_s(label)).Solids()
    inner = TDF_LabelSequence()
    shapes.GetSubShapes_s(label, inner)
    labelled = [(cadquery.Shape.cast(shapes.GetShape_s(inner.Value(k))), _name(inner.Value(k)))
                for k in range(1, inner.Length() + 1)]
    called_so = [*names, *own]
    for solid in solids:
        of_solid = [name for shape, found in labelled if shape.isSame(solid) for name in found]
        # Several solids in one part have their own names first.
        both = [*of_solid, *called_so] if len(solids) > 1 else [*called_so, *of_solid]
        paths = [f"{within}/{name}" for name in both] if within else []
        # CadQuery calls the object of an assembly X with children X_part.
        paths += [within] if f"{within}_part" in both else []
        yield both, paths, solid.moved(place)


def _name(label: Any) -> list[str]:
    """The name of a label, repaired and as written."""
    from OCP.TDataStd import TDataStd_Name

    attribute = TDataStd_Name()
    if not label.FindAttribute(TDataStd_Name.GetID_s(), attribute):
        return []
    written = _composed(str(attribute.Get().ToExtString()).strip())
    return list(dict.fromkeys([_mended(written), written]))


def _composed(name: str) -> str:
    """A name in composed characters. Some systems write an umlaut as two characters."""
    return unicodedata.normalize("NFC", name)


def _mended(name: str) -> str:
    """A name whose UTF-8 was read as Latin-1 or Windows-1252, repaired."""
    for _ in range(2):
        for encoding in ("latin-1", "cp1252"):
            try:
                better = name.encode(encoding).decode("utf-8")
            except UnicodeError:
                continue
            if better != name:
                name = _composed(better)
                break
        else:
            break
    return name

