"""TOML text that is read back as exactly what was written, laid out as people write it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from decimal import Decimal

import tomli_w

#: Texts, numbers, flags, and tables and lists of these.
TomlEntry = str | float | bool | Mapping[str, "TomlEntry"] | Sequence["TomlEntry"]


def toml_table(heading: str, content: Mapping[str, TomlEntry]) -> str:
    """A table under its `heading` line, an empty line at its end."""
    return "\n".join([heading, *toml_lines(content), ""])


def toml_heading(*names: str) -> str:
    """The heading of a table, its names quoted where they must be."""
    nested: dict[str, object] = {}
    for name in reversed(names):
        nested = {name: nested}
    return tomli_w.dumps(nested).strip().splitlines()[-1]


def toml_lines(content: Mapping[str, TomlEntry]) -> list[str]:
    """One line a key, tables and lists on it; only a text of several lines keeps them."""
    return [
        tomli_w.dumps({key: value}, multiline_strings=True).rstrip("\n")
        if isinstance(value, str) and "\n" in value and "\r" not in value else _assignment(key, value)
        for key, value in content.items()]


def _assignment(key: str, value: TomlEntry) -> str:
    """``key = value``, the key quoted where it must be."""
    return tomli_w.dumps({key: 0}).removesuffix("0\n") + _value(value)


def _value(value: TomlEntry) -> str:
    """The value on one line: `tomli_w` gives tables and lists lines of their own."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(_assignment(key, each) for key, each in value.items()) + " }"
    if isinstance(value, str):
        # The escapes of JSON are TOML's, but for the DEL that JSON leaves as it is; `tomli_w` writes tabs as they are.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, float):
        return toml_number(value)
    if isinstance(value, Sequence):
        return "[" + ", ".join(map(_value, value)) + "]"
    return tomli_w.dumps({"x": value}).removeprefix("x = ").rstrip("\n")


def toml_number(value: float) -> str:
    """A float to the last bit; in powers of ten where that is shorter to read."""
    value = float(value)
    if value == 0.0 or 1e-3 <= abs(value) < 1e6 or not math.isfinite(value):
        return repr(value)
    # An exponent makes it a float even without a decimal point.
    return format(Decimal(repr(value)).normalize(), "e")
