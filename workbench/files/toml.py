"""Readable TOML text that is read back exactly."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from decimal import Decimal

import tomli_w

#: Texts, numbers, flags, and tables and lists of these.
TomlEntry = str | float | bool | Mapping[str, "TomlEntry"] | Sequence["TomlEntry"]


def toml_table(heading: str, content: Mapping[str, TomlEntry]) -> str:
    """A table under its `heading` line, with an empty line after it."""
    return "\n".join([heading, *toml_lines(content), ""])


def toml_heading(*names: str) -> str:
    """The heading of a table, with names quoted if needed."""
    nested: dict[str, object] = {}
    for name in reversed(names):
        nested = {name: nested}
    return tomli_w.dumps(nested).strip().splitlines()[-1]


def toml_lines(content: Mapping[str, TomlEntry]) -> list[str]:
    """One line for each key, except for texts of several lines."""
    return [
        tomli_w.dumps({key: value}, multiline_strings=True).rstrip("\n")
        if isinstance(value, str) and "\n" in value and "\r" not in value else _assignment(key, value)
        for key, value in content.items()]


def _assignment(key: str, value: TomlEntry) -> str:
    """``key = value``, with the key quoted if needed."""
    return tomli_w.dumps({key: 0}).removesuffix("0\n") + _value(value)


def _value(value: TomlEntry) -> str:
    """The value on one line; `tomli_w` would use several."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(_assignment(key, each) for key, each in value.items()) + " }"
    if isinstance(value, str):
        # The escapes of JSON are valid TOML, except that JSON does not escape DEL; `tomli_w` does not escape tabs.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, float):
        return toml_number(value)
    if isinstance(value, Sequence):
        return "[" + ", ".join(map(_value, value)) + "]"
    return tomli_w.dumps({"x": value}).removeprefix("x = ").rstrip("\n")


def toml_number(value: float) -> str:
    """A float to the last bit, in the shorter of two notations."""
    value = float(value)
    if value == 0.0 or 1e-3 <= abs(value) < 1e6 or not math.isfinite(value):
        return repr(value)
    # With an exponent it is a float, even without a decimal point.
    return format(Decimal(repr(value)).normalize(), "e")
