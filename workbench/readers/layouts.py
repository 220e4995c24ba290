"""The place of a table in a text: its headings, its first row, the delimiter of its cells, and its rows."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from workbench.readers.columns import uncommented
from workbench.readers.headings import is_unit, understand
from workbench.readers.text import COMMENTS, RecordingText, RowCells, cells, complex_parts, row_cells

#: Number of lines in which headings are looked for if no rows of numbers follow.
HEADINGS_WITHIN = 1000

_DELIMITERS = ("\t", ";", ",", " ")
_CELL = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?")
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")


@dataclass(frozen=True)
class TableLayout:
    """The place of a table: its ``headings`` (empty without any), their ``line`` (index), the index ``start`` of its
    first row, its ``delimiter`` and number of columns; ``plain`` if the headings are cells of that one line."""

    headings: tuple[str, ...]
    line: int
    start: int
    delimiter: str
    width: int
    plain: bool


@dataclass(frozen=True, eq=False)
class Body:
    """The rows below a layout: their ``values`` (n, columns), NaN for a cell that is no real number, and the columns
    (from 0) that hold ``complexes``."""

    rows: RowCells
    values: NDArray[np.float64]
    complexes: frozenset[int]
    decimal: str


def find_layout(text: RecordingText) -> TableLayout | None:
    """The first table of three columns or more, by its headings or, if none are understood, by its numbers."""
    numbered = _numbers(text)
    headed: TableLayout | None = None
    for index, line in enumerate(text.lines[:HEADINGS_WITHIN if numbered is None else numbered.start]):
        if not line.strip():
            continue
        if headed is not None and not line.startswith(COMMENTS) and is_cell(
                cells(line, headed.delimiter)[0]):
            break
        headed = _headings(text, index) or headed
    return headed or numbered


def _headings(text: RecordingText, index: int) -> TableLayout | None:
    """The layout from the line `index` if it is understood as headings; of several delimiters, the best."""
    line = uncommented(text.lines[index]).strip(" ")
    if line.count('"') == 2 and line.startswith('"') and line.endswith('"'):
        line = line[1:-1]
    below = next((row for row in text.lines[index + 1:] if row.strip() and not row.startswith(COMMENTS)
                  and row.strip()[:1] in "+-.0123456789("), "")
    best: tuple[int, TableLayout] | None = None
    for delimiter in _DELIMITERS:
        for plain, names in _names(line, delimiter):
            # Blanks occur in sentences too, of which a word or two may be understood.
            if len(names) < 2 or ((delimiter == " " or not plain or len(names) == 2)
                                  and len(cells(below, delimiter)) != len(names)):
                continue
            known = [understand(name) for name in names]
            count = sum(heading is not None for heading in known)
            if count < 2 or not any(heading and heading.part == "frequency" for heading in known):
                continue
            # Of several possible layouts, the one that leaves fewest cells unexplained.
            score = 2 * count - len(names)
            if best is None or score > best[0]:
                best = score, _with_units(text, TableLayout(tuple(names), index, index + 1, delimiter, len(names),
                                                            plain))
    return None if best is None else best[1]


def _names(line: str, delimiter: str) -> Iterator[tuple[bool, list[str]]]:
    """Every way to divide a line of headings: at the delimiter (True), at runs of blanks, before any word but a unit in
    brackets, and behind such units."""
    yield True, cells(line, delimiter)
    yield False, re.split(r"\s{2,}", line.strip())
    if delimiter == " ":
        yield from ((False, re.split(behind + r"\s+(?![(\[])", line.strip())) for behind in ("", r"(?<=[)\]])"))


def _with_units(text: RecordingText, layout: TableLayout) -> TableLayout:
    """The layout, with the units from a line below the headings."""
    if layout.start >= len(text.lines):
        return layout
    units = cells(uncommented(text.lines[layout.start]), layout.delimiter)
    given = [is_unit(unit) for unit in units]
    # Other columns may have units of their own ("s", "V", "#"), but no numbers.
    if abs(len(units) - layout.width) > 1 or sum(given) < 2 or any(map(is_cell, units)):
        return layout
    units += [""] * (layout.width - len(units))
    names = tuple(f"{name} ({unit.strip('()[]')})" if unit and is_unit(unit) and _takes(name, unit) else name
                  for name, unit in zip(layout.headings, units, strict=False))
    return replace(layout, headings=names, start=layout.start + 1, plain=False)


def _takes(name: str, unit: str) -> bool:
    """Whether a unit completes a heading without one."""
    bare, whole = understand(name), understand(f"{name} ({unit.strip('()[]')})")
    return bare is not None and whole is not None and not bare.unit and not whole.strange_unit


def _numbers(text: RecordingText) -> TableLayout | None:
    """The layout of the first two rows of three numbers or more, with the line above them as headings.

    A complex number counts as two; a table of two columns is ambiguous.
    """
    lines = [(index, line) for index, line in enumerate(text.lines) if line.strip()]
    bare = [(index, line) for index, line in lines if not line.startswith(COMMENTS)]
    for (index, line), (_, following) in pairwise(bare):
        for delimiter in _DELIMITERS:
            row, second = cells(line, delimiter), cells(following, delimiter)
            whole = any(complex_parts(cell) is not None for cell in row)
            if len(row) == len(second) > (1 if whole else 2) and all(map(is_cell, (*row, *second))):
                above = max((i for i, _ in lines if i < index), default=index)
                for plain, names in () if above == index else _names(uncommented(text.lines[above]), delimiter):
                    if len(names) == len(row) and not all(map(is_cell, names)):
                        return TableLayout(tuple(names), above, index, delimiter, len(row), plain)
                return TableLayout((), index, index, delimiter, len(row), plain=False)
    return None


def is_cell(cell: str) -> bool:
    return _CELL.fullmatch(cell) is not None or complex_parts(cell) is not None


def decimal_mark(text: RecordingText, layout: TableLayout) -> str:
    """Decimal mark of the rows: "," or ".".

    Raises:
        InputError: some rows have commas and some points.
    """
    if layout.delimiter == ",":
        return "."
    commas = points = None
    for index, line in enumerate(text.lines[layout.start:], layout.start):
        if line.strip() and not line.startswith(COMMENTS):
            for cell in cells(line, layout.delimiter):
                for part in complex_parts(cell) or (cell,):
                    if _COMMA.fullmatch(part):
                        commas = index if commas is None else commas
                    elif "." in part and _CELL.fullmatch(part):
                        points = index if points is None else points
    if commas is not None and points is not None:
        last, first = max(commas, points), min(commas, points)
        words = ("commas", "points") if first == commas else ("points", "commas")
        raise text.error(last + 1, None, text.lines[last], f"decimal {words[0]}, as on line {first + 1}, or "
                         f"{words[1]}, not both")
    return "." if commas is None else ","


def body_of(text: RecordingText, layout: TableLayout, frequency: int) -> Body:
    """The rows of a table; `frequency` is the column (from 0) that every row has a number in.

    Raises:
        InputError: a faulty row, or fewer than two.
    """
    decimal = decimal_mark(text, layout)
    above = cells(uncommented(text.lines[layout.line]), layout.delimiter) if layout.headings else ()
    rows = row_cells(text, layout.start, width=layout.width, delimiter=layout.delimiter, decimal=decimal,
                     frequency=frequency, headings=above)
    if len(rows.lines) < 2:
        raise text.error(layout.start, None, f"{len(rows.lines)} rows of numbers", "at least 2; the file may be cut "
                         "short")
    values = np.column_stack([rows.loosely(place) for place in range(layout.width)])
    complexes = frozenset(
        place for place in range(layout.width)
        if 2 * sum(place < len(row) and complex_parts(row[place]) is not None for row in rows.cells) > len(rows.cells))
    return Body(rows, values, complexes, decimal)


def column_name(layout: TableLayout, place: int) -> str:
    return f'column {place + 1} "{layout.headings[place]}"'


def handle(layout: TableLayout, place: int) -> str | int:
    """The name of a column in a column map: its heading if that is unique, otherwise its number."""
    if layout.plain and layout.headings.count(layout.headings[place]) == 1 and layout.headings[place]:
        return layout.headings[place]
    return place + 1
