"""One size of a chip: its value, its tolerance, and its source."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from workbench.files.errors import InputError
from workbench.files.quantities import message_unit, parse_quantity
from workbench.files.tables import FileTable

#: Lengths closer than this are the same length (metres): far below any tolerance, far above rounding.
SAME_LENGTH = 1e-9


#: Suffixes of the names of distances from the axis of a chip, or from the middle of a straight one.
ACROSS = ("radius", "half_width")

#: Shapes that may be stated for a layer, and the dimension of each.
SHAPES: Mapping[str, str] = {"draft": "angle", "barrel": "length", "bow": "length", "dome": "length"}


@dataclass(frozen=True)
class Dimension:
    """One length of a chip, or one angle.

    ``value`` and ``tolerance`` are in metres or radians; ``tolerance`` is None if not stated. ``assumed`` marks a value
    that was chosen, not measured or published. ``note`` is its source. ``typed`` is the value as written in a file, for
    messages; it is ignored if the value has changed.
    """

    value: float
    tolerance: float | None = None
    assumed: bool = False
    note: str = ""
    typed: str = field(default="", compare=False, repr=False)


def millimetres(length: float) -> str:
    """A length (metres) as text for messages."""
    return f"{1e3 * length:.6g} mm"


def as_text(value: float, kind: str, *, as_stated: bool = False) -> str:
    """A quantity as text for messages."""
    if kind == "temperature":
        return f"{value:.6g} K" if as_stated else f"{value - 273.15:.4g} degC"
    unit, factor = message_unit(value, kind)
    return f"{value / factor:.4g} {unit}"


def dimension_text(dimension: Dimension, kind: str = "length") -> str:
    """A length or an angle as message text, as typed if unchanged."""
    try:
        if parse_quantity(dimension.typed, kind, source="", field="") == dimension.value:
            return dimension.typed
    except InputError:
        pass
    return f"{math.degrees(dimension.value):.4g} deg" if kind == "angle" else millimetres(dimension.value)


def read_radius(table: FileTable, key: str, diameter: str) -> Dimension:
    """The radius under `key`, or half of the diameter under `diameter`.

    Raises:
        InputError: both are given, or neither.
    """
    if diameter not in table:
        return read_dimension(table, key)
    if key in table:
        raise table.error(diameter, f"{key} or {diameter}, not both")
    read = read_dimension(table, diameter)
    return replace(read, value=0.5 * read.value, tolerance=None if read.tolerance is None else 0.5 * read.tolerance)


def read_dimension(table: FileTable, key: str, kind: str = "length") -> Dimension:
    """Read a length or an angle.

    Examples: ``"2.02 mm"``, ``{ value = "2.02 mm", tolerance = "20 um", assumed = true, note = "..." }``.
    """
    example = {"length": "2.02 mm", "angle": "3 deg"}[kind]
    if not isinstance(table.required(key, f'{"an" if kind == "angle" else "a"} {kind} with its unit, for example '
                                          f'"{example}"'), dict):
        return Dimension(table.quantity(key, kind), typed=str(table.content[key]))
    inner = table.table(key).only(("value", "tolerance", "assumed", "note"))
    assumed = inner.flag("assumed")
    inner.required("value", f"a {kind} with its unit")
    tolerance = inner.optional_quantity("tolerance", kind)
    if tolerance is not None and tolerance < 0.0:
        raise inner.error("tolerance", "zero or more")
    return Dimension(inner.quantity("value", kind), tolerance, assumed,
                     inner.text("note", ""), str(inner.content["value"]))
