"""The tables of all results, and the page of all reports."""

from __future__ import annotations

import base64
import math
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any

from workbench.files.names import visible
from workbench.files.quantities import UNITS
from workbench.files.writing import write_atomic
from workbench.render.canvas import Picture
from workbench.report.definitions import defined, definition
from workbench.report.record import attribute

#: Cells of a table with more characters than this are text, aligned left; shorter ones are numbers.
_WORDS = 24

#: Factors to SI of the units that headings of tables may have; the values of a column with another unit have that unit.
_FACTORS = {unit: factor for units in UNITS.values() for unit, factor in units.items()} | {"pN": 1e-12, "pN/mm": 1e-9}


@dataclass(frozen=True)
class TextTable:
    """A table of text with a heading for every column.

    Headings of columns and rows that `definitions` has show their meaning, and a legend below the first table of a page
    with such a heading lists it.

    Raises:
        ValueError: a column other than the first has no heading, or a row is of another length.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def __post_init__(self) -> None:
        if not all(self.columns[1:]):
            raise ValueError(f"a table with the headings {self.columns} has a column without one")
        wrong = [row for row in self.rows if len(row) != len(self.columns)]
        if wrong:
            raise ValueError(f"the row {wrong[0]} does not have the {len(self.columns)} cells of {self.columns}")


#: A cell of a table before it is formatted: text, texts, a number in SI, or None for an empty cell.
Value = str | Sequence[str] | float | None


def table(columns: str, rows: Iterable[Any]) -> TextTable:
    """A table of text and numbers (SI), in the units of columns.

    `columns` are separated by " | ". "p0 (kPa):.3f=field.amplitude" has a heading, a format (".4g" if not stated), and
    the attribute of each row that its cells show; without attributes each row has its cells. None and NaN are empty.
    """
    heads, units, formats, paths = list[str](), list[str](), list[str](), list[str]()
    for column in columns.split(" | "):
        shown, _, path = column.partition("=")
        head, _, form = shown.partition(":")
        heads.append(head)
        units.append(head.rpartition(" (")[2].removesuffix(")"))
        formats.append(form)
        paths.append(path)
    cells = ([attribute(row, path) for path in paths] for row in rows) if any(paths) else rows
    return TextTable(tuple(heads), tuple(tuple(map(in_unit, row, units, formats)) for row in cells))


def in_unit(value: Value, unit: str, form: str = "") -> str:
    """Text, or a number (SI) in a unit; empty without one."""
    match value:
        case None:
            return ""
        case float():
            return "" if math.isnan(value) else format(value / _FACTORS.get(unit, 1.0), form or ".4g")
        case str() | Integral():
            return str(value)
        case _:
            return "; ".join(value)


def number_text(value: float, digits: int = 4) -> str:
    """A number for a table: `digits` significant digits."""
    return f"{value:.{digits}g}"


def with_unit(name: str, unit: str) -> str:
    """A heading: the name with its unit in brackets, if any."""
    return f"{name} ({unit})" if unit else name


class Note(str):
    """A sentence the reader must not miss."""


class Answer(str):
    """The sentences that answer the question of the report."""


class Verbatim(str):
    """Text of a file, with its line ends."""


#: In plain text, an empty line begins a new paragraph; other line ends are spaces.
Block = str | TextTable | Picture

#: The macro of ``blocks.html`` that shows a value of each type.
_MACROS: Mapping[type, str] = {
    TextTable: "table", Picture: "picture", Note: "note", Answer: "answer", Verbatim: "verbatim"}


def write_report(
    path: Path, title: str, sections: Sequence[tuple[str, Sequence[Block]]] = (), *, module: str = "",
    values: Mapping[str, object] | None = None,
) -> Path:
    """Write an HTML page with every picture inside it.

    Parameters
    ----------
    sections : sequence of (heading, blocks)
        The content of a page without a template of its own.
    module : str
        Full name of a module. Its template has its name, and calls its functions.
    values : mapping
        Further names of the template.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    explained = set[str]()

    def not_yet_explained(shown: TextTable) -> dict[str, str]:
        new = {name: meaning for name, meaning in defined((*shown.columns, *(row[0] for row in shown.rows if row)))
               if name not in explained}
        explained.update(new)
        return new

    def shown(value: object) -> Any:
        match value:
            case None:
                return ""
            case list() | tuple():
                return Markup("\n").join(map(block, value))
            case Markup():
                return value
            case str() if type(value) is str:
                return visible(value, keep="\n\t")
        macro = _MACROS.get(type(value))
        return value if macro is None else getattr(blocks, macro)(str(value) if isinstance(value, str) else value)

    def block(value: object) -> Any:
        if type(value) is not str:
            return shown(value)
        paragraphs = (" ".join(each.split()) for each in re.split(r"\n\s*\n", value))
        return Markup("").join(Markup("<p>{}</p>").format(shown(each)) for each in paragraphs if each)

    environment = Environment(loader=PackageLoader("workbench.report"), autoescape=True, undefined=StrictUndefined,
                              trim_blocks=True, lstrip_blocks=True, finalize=shown)
    environment.globals |= {"definition": definition, "not_yet_explained": not_yet_explained, "words": _WORDS,
                            "table": table, "png": lambda file: base64.b64encode(file.read_bytes()).decode("ascii")}
    environment.filters |= {"notes": lambda texts: [Note(text) for text in texts],
                            "answers": lambda texts: [Answer(text) for text in texts]}
    blocks = environment.get_template("blocks.html").module
    page = environment.get_template(f"{module.rpartition('.')[2] or 'page'}.html").render(
        {**(vars(sys.modules[module]) if module else {}), "title": title, "sections": sections, **(values or {})})
    write_atomic(path, page + "\n")
    return path
