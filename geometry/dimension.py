"""One size of a chip: its value, how exact it is, and where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

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
