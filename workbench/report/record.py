"""Values of JSON files and cells of tables, from attributes of results."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from workbench.results.circuit import FittedNumber

#: The endings of keys that state a unit. The attribute has the rest of the key as its name.
_UNIT = re.compile("_(?:hz|ohm|f|h|rad|m|s|k|v|vpp|w|j|n|pa|m_s|n_m|j_m3|m_pa)$")

#: Attributes by key: the path of each, and the keys of its own record if it has one.
_Keys = dict[str, tuple[str, Any]]


def record(value: object, keys: str) -> Any:
    """Attributes of a value by the keys of a JSON file.

    `keys` are separated by blanks: "frequency_hz" is the attribute "frequency", without the unit, and "chip=chip.name"
    that of an attribute. "peaks { frequency_hz q }" is the record of an attribute. The record of a sequence is a list,
    and that of None is None.
    """
    return _selected(value, _parsed(iter(re.findall(r"[{}]|[^\s{}]+", keys))))


def _parsed(words: Iterator[str]) -> _Keys:
    """Keys up to the brace that ends them."""
    found: _Keys = {}
    last = ""
    for word in words:
        if word == "}":
            break
        if word == "{":
            found[last] = found[last][0], _parsed(words)
        else:
            last, _, path = word.partition("=")
            found[last] = path or _UNIT.sub("", last), None
    return found


def _selected(value: object, keys: _Keys | None) -> Any:
    if value is None or keys is None:
        return plain(value)
    if isinstance(value, list | tuple) and not hasattr(value, "_fields"):
        return [_selected(each, keys) for each in value]
    return {key: _selected(attribute(value, path), own) for key, (path, own) in keys.items()}


def attribute(value: Any, path: str) -> Any:
    """An attribute of an attribute, or an item; None after None."""
    for name in path.split("."):
        if value is not None:
            value = value[name] if isinstance(value, Mapping) else getattr(value, name)
    return value


def plain(value: Any) -> Any:
    """A value for JSON: lists for arrays, None for infinity and NaN.

    A fitted number is a list of its value and its standard error.
    """
    match value:
        case FittedNumber():
            return [plain(value.value), plain(value.standard_error)]
        case float():
            return value if math.isfinite(value) else None
        case np.ndarray() | np.generic():
            return plain(value.tolist())
        case Mapping():
            return {key: plain(each) for key, each in value.items()}
        case list() | tuple():
            return [plain(each) for each in value]
        case _:
            return value
