"""Values of JSON files, in SI, from the attributes of results."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from operator import attrgetter
from typing import Any

import numpy as np

from workbench.results.circuit import FittedNumber

#: The endings of keys that state a unit: that of the attribute, which has the rest of the key as its name.
_UNIT = re.compile("_(?:hz|ohm|f|h|rad|m|s|k|v|vpp|w|j|n|pa|m_s|n_m|j_m3|m_pa|m3)$")


def record(value: object, keys: str) -> dict[str, Any]:
    """Attributes of a value by the keys of a JSON file.

    `keys` are separated by blanks. "key=attribute" names the attribute, which may be one of an attribute, such as
    "parameter.name". Without it the attribute has the name of the key without the unit at its end.
    """
    pairs = (key.partition("=") for key in keys.split())
    return {key: plain(attrgetter(path or _UNIT.sub("", key))(value)) for key, _, path in pairs}


def records(values: Iterable[object], keys: str) -> list[dict[str, Any]]:
    """The :func:`record` of each value."""
    return [record(value, keys) for value in values]


def plain(value: Any) -> Any:
    """A value as JSON has it: arrays and tuples as lists, infinite numbers and NaN as None.

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
