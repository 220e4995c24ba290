"""One size of a chip: its value, how exact it is, and where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.files.tables import Table

#: Lengths closer than this are the same length (metres): far below any tolerance, far above rounding.
SAME_LENGTH = 1e-9


#: What may be stated of the shape of a layer, and the dimension of each.
SHAPES: Mapping[str, str] = {"draft": "angle", "barrel": "length", "bow": "length", "dome": "length"}


@dataclass(frozen=True)
class Dimension:
    """One length of a chip, or one angle.

    ``value`` and ``tolerance`` in metres, or radians (``None``: nobody said how exact), ``assumed`` when it was not
    measured or published but chosen, ``note`` where it comes from.
    """

    value: float
    tolerance: float | None = None
    assumed: bool = False
    note: str = ""


def millimetres(length: float) -> str:
    """A length (metres) as messages show it."""
    return f"{1e3 * length:.6g} mm"


def read_dimension(table: Table, key: str, kind: str = "length") -> Dimension:
    """``"2.02 mm"`` or ``{ value = "2.02 mm", tolerance = "20 um", assumed = true, note = "..." }``."""
    example = {"length": "2.02 mm", "angle": "3 deg"}[kind]
    if not isinstance(table.required(key, f'{"an" if kind == "angle" else "a"} {kind} with its unit, for example '
                                          f'"{example}"'), dict):
        return Dimension(table.quantity(key, kind))
    inner = table.table(key).only(("value", "tolerance", "assumed", "note"))
    assumed = inner.flag("assumed")
    inner.required("value", f"a {kind} with its unit")
    return Dimension(inner.quantity("value", kind), inner.optional_quantity("tolerance", kind), assumed,
                     inner.text("note", ""))
