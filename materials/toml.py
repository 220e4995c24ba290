"""TOML text that reads back exactly as it was written."""

from __future__ import annotations

import json
import math
from decimal import Decimal


def quoted(text: str) -> str:
    """A TOML text. The escapes of JSON are TOML's, except for DEL, which JSON leaves as it is."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def toml_number(value: float) -> str:
    """A TOML float, exact to the last bit; in powers of ten if that is shorter."""
    value = float(value)
    if value == 0.0 or 1e-3 <= abs(value) < 1e6 or not math.isfinite(value):
        return repr(value)
    # An exponent makes it a float even without a decimal point.
    return format(Decimal(repr(value)).normalize(), "e")


def array(items: list[str]) -> str:
    """A TOML array of items that are already TOML."""
    return f"[{', '.join(items)}]"


def inline(pairs: dict[str, str]) -> str:
    """A TOML table on one line, of values that are already TOML."""
    return f"{{ {', '.join(f'{key} = {value}' for key, value in pairs.items())} }}"
