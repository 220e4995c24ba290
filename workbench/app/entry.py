"""Numbers as typed on the page, in the displayed or another unit."""

from __future__ import annotations

import math
import re

from workbench.app.controls import Control
from workbench.files.errors import InputError
from workbench.files.quantities import parse_quantity

#: A number with the decimal comma of many languages, and the text after it.
_COMMA = re.compile(r"\s*([+-]?\d*),(\d+)(\s*[^\d,.\s].*)?\s*")


def typed_number(text: object, control: Control, field: str) -> float:
    """The number (SI) typed for a `control`.

    Examples are "20.5" in its unit, or "0.0205 mm"; errors name `field`.

    Raises:
        InputError: no finite number, a decimal comma, or an unknown unit.
    """
    typed, unit = str(text).strip(), control.shown_unit or "no unit"
    comma = _COMMA.fullmatch(typed)
    if comma is not None:
        point = f"{comma[1] or 0}.{comma[2]}{comma[3] or ''}"
        raise InputError("live view", field, typed, f"a decimal point, not a comma: {point}?")
    try:
        number = float(typed)
    except ValueError:
        if typed[:1].isdigit() or typed[:1] in ("+", "-", "."):
            return parse_quantity(typed, control.quantity, source="live view", field=field)
        raise InputError("live view", field, typed, f"a number in {unit}, for example {control.shown(control.value)}"
                         ) from None
    if not math.isfinite(number):
        raise InputError("live view", field, typed, f"a finite number in {unit}")
    return number / control.factor


def typed_tolerance(text: object, control: Control) -> float | None:
    """The tolerance (SI) typed for a `control`, or None.

    With None, the tolerance of the file or the assumed one of the role applies.

    Raises:
        InputError: as for :func:`typed_number`.
    """
    typed = str(text).strip()
    if not typed or (control.tolerance is None and typed == control.shown_tolerance):
        return None
    return typed_number(typed, control, f"tolerance of {control.name}")


def slider_number(number: float) -> float:
    """A number with the seven digits of a slider."""
    return float(f"{number:.7g}")
