"""Short texts of results for a prompt."""

from __future__ import annotations

import dataclasses
import reprlib
import textwrap
from collections import Counter
from collections.abc import Mapping

import numpy as np

#: Lines and columns of the text of a result. Doubled, a few results in a row fill a terminal.
TEXT_LINES, TEXT_COLUMNS = 10, 100
#: Number of names of a mapping, or elements of a sequence, in the text.
_FEW = 4


class Brief:
    """Base of a dataclass (with ``repr=False``) with a short text. The text has the names of the fields, and the shapes
    of arrays instead of their numbers."""

    def __repr__(self) -> str:
        assert dataclasses.is_dataclass(self)
        fields = ", ".join(f"{each.name}={_short(getattr(self, each.name))}" for each in dataclasses.fields(self))
        return lines_of(textwrap.wrap(f"{type(self).__name__}({fields})", TEXT_COLUMNS, subsequent_indent="  "))


def lines_of(lines: list[str]) -> str:
    """The lines as one text, cut to :data:`TEXT_LINES` of :data:`TEXT_COLUMNS`."""
    if len(lines) > TEXT_LINES:
        lines = [*lines[:TEXT_LINES - 1], f"... {len(lines) - TEXT_LINES + 1} more lines"]
    return "\n".join(textwrap.shorten(line, TEXT_COLUMNS, placeholder=" ...", drop_whitespace=False)
                     if len(line) > TEXT_COLUMNS else line for line in lines)


def _short(value: object) -> str:
    match value:
        case np.ndarray():
            return f"<{' x '.join(map(str, value.shape)) or 'one'} {value.dtype}>"
        case Mapping():
            names = [str(name) for name in value]
            return f"<{len(names)}: {', '.join(names[:_FEW])}{', ...' if len(names) > _FEW else ''}>"
        case tuple() | list():
            if len(value) > _FEW:
                kinds = Counter(type(each).__name__ for each in value).most_common(_FEW)
                return f"<{len(value)}: {', '.join(f'{count} {name}' for name, count in kinds)}>"
            inside = ", ".join(map(_short, value))
            return f"({inside}{',' if len(value) == 1 else ''})"
        case float() | complex():
            return f"{value:.6g}"
        case _ if dataclasses.is_dataclass(value) and not isinstance(value, type):
            name = getattr(value, "name", "")
            return f"<{type(value).__name__}{f' {name}' if isinstance(name, str) and name else ''}>"
    return reprlib.repr(value)
