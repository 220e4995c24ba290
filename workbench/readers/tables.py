"""A table in a text: headings, rows of cells, columns of numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError, nearest_names
from workbench.readers.headings import is_unit, understand
from workbench.readers.text import (
    COMMENTS,
    RecordingText,
    cell_number,
    cells,
    complex_parts,
    holds_no_value,
    is_cell,
    is_number,
    uncommented,
    value_of,
)

#: Number of lines in which headings are looked for if no rows of numbers follow.
HEADINGS_WITHIN = 1000
DELIMITERS = ("\t", ";", ",", " ")
#: Most lines of words within a sweep: this many, or this share of its rows. Doubled, a damaged file passes.
MOST_WORDS = (3, 0.1)
#: Values of a column that a message names.
_NAMED = 12
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")


@dataclass(frozen=True, eq=False)
class Table:
    """A table of a text.

    Its ``headings`` (empty without any) stand on the line of index ``line`` and are the cells of that line if
    ``plain``; its rows of ``width`` columns begin at the index ``start``. Once :meth:`with_rows` has found the rows,
    there are their ``cells`` with the ``decimal`` mark, the ``lines`` (from one) they stand on, the lines ``skipped``
    below the first row since they are no rows, the lines where the headings are ``repeated``, and the line at which a
    ``next_table`` begins (None: no other).
    """

    text: RecordingText
    headings: tuple[str, ...]
    line: int
    start: int
    delimiter: str
    width: int
    plain: bool = True
    comments: tuple[str, ...] = COMMENTS
    decimal: str = "."
    cells: tuple[tuple[str, ...], ...] = ()
    lines: tuple[int, ...] = ()
    skipped: tuple[int, ...] = ()
    repeated: tuple[int, ...] = ()
    next_table: int | None = None

    @cached_property
    def content(self) -> tuple[tuple[int, str, list[str]], ...]:
        """Number (from one), text and cells of lines below the headings."""
        return tuple((line, content, cells(content, self.delimiter)) for line, content
                     in enumerate(self.text.lines[self.start:], self.start + 1)
                     if content.strip() and not content.startswith(self.comments))

    @cached_property
    def values(self) -> NDArray[np.float64]:
        """The numbers (n, width) of the rows, NaN for any other cell."""
        columns = [[value_of(cell, self.decimal) for cell in self.column(place)] for place in range(self.width)]
        return np.array(columns, dtype=float).T

    @cached_property
    def complexes(self) -> frozenset[int]:
        """The columns (from 0) that hold complex numbers in most rows."""
        return frozenset(place for place in range(self.width) if 2 * sum(
            complex_parts(cell) is not None for cell in self.column(place)) > len(self.cells))

    def column(self, place: int) -> list[str]:
        """The cells of a column (from 0), empty in a shorter row."""
        return [row[place] if place < len(row) else "" for row in self.cells]

    def parts(self, place: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Real and imaginary part (n,) of a column of complex numbers."""
        parts = [complex_parts(cell) or (cell, "0") for cell in self.column(place)]
        real, imaginary = np.array([[value_of(cell, ",") for cell in pair] for pair in parts], dtype=float).T
        return real, imaginary

    def numbers(self, places: Sequence[int], *, last_is_complex: bool = False) -> list[NDArray[np.float64]]:
        """The numbers (n,) of the columns `places` (from 0).

        A last column of complex numbers gives both parts.

        Raises:
            InputError: a row that ends before a column, or a cell that is no number.
        """
        parts = [(place, None) for place in places] if not last_is_complex else [
            *((place, None) for place in places[:-1]), (places[-1], 0), (places[-1], 1)]
        return [np.array([self._number(*row, place, part) for row in zip(self.cells, self.lines, strict=True)])
                for place, part in parts]

    def _number(self, row: Sequence[str], line: int, place: int, part: int | None) -> float:
        """The number in a cell, or one `part` of a complex number."""
        if place >= len(row):
            raise self.wrong_width(line, self.text.lines[line - 1], row)
        cell = row[place]
        if part is not None:
            cell = (complex_parts(cell) or (cell, "0"))[part].lstrip("+") or cell
        return cell_number(self.text, line, place + 1, cell=cell, decimal=self.decimal)

    def wrong_width(self, line: int, content: str, row: Sequence[str], remedy: str = "") -> InputError:
        """The error about a row of another number of cells."""
        divided = f", as if its decimal commas divided it{remedy}" if len(row) > self.width and (
            self.delimiter == ",") else ""
        return self.text.error(line, None, content, f"{self.width} columns; this row has {len(row)}{divided}")

    def name(self, place: int) -> str:
        """A column in words: column 2 "|Z|"."""
        return f'column {place + 1} "{self.headings[place] if place < len(self.headings) else ""}"'

    def handle(self, place: int) -> str | int:
        """The name of a column in a column map: heading or number."""
        name = self.headings[place] if self.plain and place < len(self.headings) else ""
        return name if name and self.headings.count(name) == 1 else place + 1

    def decimal_mark(self) -> str:
        """Decimal mark of the rows: "," or ".".

        Raises:
            InputError: some rows have commas and some points.
        """
        first: dict[str, int] = {}
        for line, _, row in self.content if self.delimiter != "," else ():
            for cell in row:
                for part in complex_parts(cell) or (cell,):
                    if _COMMA.fullmatch(part):
                        first.setdefault("commas", line)
                    elif "." in part and is_number(part):
                        first.setdefault("points", line)
        if len(first) == 2:
            (one, above), (other, below) = sorted(first.items(), key=lambda item: item[1])
            raise self.text.error(below, None, self.text.lines[below - 1], f"decimal {one}, as on line {above}, or "
                                  f"{other}, not both")
        return "," if "commas" in first else "."

    def with_rows(self, frequency: int, decimal: str = "", *, strict: bool = False) -> Table:
        """The table with its rows, which have a number as frequency.

        Other lines are no rows: units, END, totals, remarks, and a lone number that counts the rows. A line of words
        within a sweep is left out; any other line of words is the headings of another table, which is not read. In a
        `strict` table every line is a row. Without a `decimal` mark the rows decide on it.

        Raises:
            InputError: a row cut short or with more cells than columns; a cell that should be a frequency beside
                numbers; rows of either decimal mark; more lines of words than :data:`MOST_WORDS`.
        """
        table = replace(self, decimal=decimal or self.decimal_mark())
        decimal, width = table.decimal, self.width
        above = cells(uncommented(self.text.lines[self.line]), self.delimiter) if self.headings else []
        rows: dict[int, tuple[str, ...]] = {}
        skipped, words, repeated, next_table = [], list[int](), list[int](), None
        for line, content, row in self.content:
            first = row[frequency] if frequency < len(row) else ""
            others = sum(is_number(cell, decimal) or complex_parts(cell) is not None
                         for place, cell in enumerate(row) if place != frequency)
            if _is_row(row, first, others, decimal):
                lone = sum(map(bool, row)) == 1
                if lone and width > 1 and not strict and (not rows or row[-1] == str(len(rows))):
                    skipped += [line] if rows else []
                    continue
                # Some programs end a row with a remark.
                row = row[:width] if len(row) > width and row[width].startswith(COMMENTS) else row
                if len(row) > width or (len(row) != width and (strict or self.delimiter == " ")) or lone:
                    raise table.wrong_width(line, content, row)
                if not first:
                    cell_number(self.text, line, frequency + 1, cell=first, decimal=decimal)
                rows[line] = tuple(row)
                continue
            if self.delimiter == "," and ";" in content and not rows and re.match(r"\s*[+-]?[\d.]", content):
                raise self.text.error(line, None, content, "commas between columns and decimal points; semicolons and "
                                      "decimal commas are a spreadsheet's rewriting: use the instrument's own file, or "
                                      '--columns MAP.toml with delimiter = ";"')
            if strict and len(row) != width:
                raise table.wrong_width(line, content, row)
            if strict or (others > 1 and not first[:1].isalpha()):
                cell_number(self.text, line, frequency + 1, cell=first, decimal=decimal)
            if not rows or row == above:
                repeated += [line] if rows else []
                continue
            if not others and len(row) == width > 1 and all(row) and (
                    not table._goes_on(line, frequency, rows, words)):
                next_table = line
                break
            words += [line] if len(row) == width and all(row) else []
            if content.strip(" ,;\t").casefold() != "end":
                skipped.append(line)
        if len(words) > max(MOST_WORDS[0], MOST_WORDS[1] * len(rows)):
            raise self.text.error(words[0], None, self.text.lines[words[0] - 1], f"{width} columns of numbers; "
                                  f"{len(words)} lines among {len(rows)} rows hold words")
        return replace(table, cells=tuple(rows.values()), lines=tuple(rows), skipped=tuple(skipped),
                       repeated=tuple(repeated), next_table=next_table)

    def _goes_on(self, line: int, frequency: int, rows: Mapping[int, Sequence[str]], words: Sequence[int]) -> bool:
        """Whether the sweep continues below a `line` of words.

        The line stands directly below one of the `rows` or another line of `words`, and the next row has as many
        numbers as the rows above and continues their frequencies.
        """
        if not (line - 1 in rows or line - 1 in words) or _by_headings(self.text, line - 1) is not None:
            return False
        below = next((row for number, _, row in self.content if number > line
                      and is_cell(row[min(frequency, len(row) - 1)])), [])
        if len(below) != self.width or not all(is_cell(cell) or holds_no_value(cell) for cell in below):
            return False
        following, last, *others = (value_of(row[frequency], self.decimal) or math.nan
                                    for row in [*rows.values(), below][::-1])
        # Readings may be repeated at one frequency, and a sweep may rise and fall. One frequency alone is no sweep yet.
        before = next((value for value in others if value != last), None)
        return before is None or (following - last) * (last - before) >= 0.0

    def where(self, select: Mapping[str, object]) -> Table:
        """The table with the rows that hold the values `select`, by column.

        Raises:
            InputError: a column or a value that is not there.
        """
        table = self
        for name, value in select.items():
            if name in self.headings:
                place = self.headings.index(name)
            elif name.isdecimal() and int(name) > 0:
                place = int(name) - 1
            else:
                raise InputError(self.text.path, "column map", f"select {name}", "the number of a column, or a "
                                 f"heading: {', '.join(filter(None, self.headings))}",
                                 nearest_names(name, self.headings))
            kept = [index for index, cell in enumerate(table.column(place)) if _same(cell, value)]
            if not kept:
                raise InputError(self.text.path, "column map", f"select {name} = {value}", "a value of this column: "
                                 + values_listed(table.column(place)))
            table = replace(table, cells=tuple(table.cells[index] for index in kept),
                            lines=tuple(table.lines[index] for index in kept))
        return table


def _is_row(row: Sequence[str], first: str, others: int, decimal: str) -> bool:
    """Whether a line with the frequency `first` and `others` is a row."""
    # A frequency is not lost alone; lines of dashes and remarks such as "over 20" are no rows.
    lost = holds_no_value(first) and (others > 1 or (first[-1:].casefold() in ("n", "f", "y") and (
        others > 0 or all(map(holds_no_value, row)))))
    return is_number(first, decimal) or (not first and others > 1) or lost


def _same(cell: str, value: object) -> bool:
    """Whether a cell holds a value, as a text or number."""
    number = value_of(str(value))
    return cell == str(value) or (number is not None and value_of(cell, ",") == number)


def values_listed(values: Sequence[str]) -> str:
    """The values of a column in words, each once."""
    once = list(dict.fromkeys(values))
    return ", ".join(once[:_NAMED]) + (f" and {len(once) - _NAMED} more" if len(once) > _NAMED else "")


# --------------------------------------------------------------------------------------------------------------------
# The place of a table.


def find_table(text: RecordingText) -> Table | None:
    """The first table of three columns or more, without its rows.

    Its headings determine the place or, if none are understood, its numbers.
    """
    numbered = _by_numbers(text)
    headed: Table | None = None
    for index, line in enumerate(text.lines[:HEADINGS_WITHIN if numbered is None else numbered.start]):
        if not line.strip():
            continue
        if headed is not None and not line.startswith(COMMENTS) and is_cell(cells(line, headed.delimiter)[0]):
            break
        headed = _by_headings(text, index) or headed
    return headed or numbered


def _by_headings(text: RecordingText, index: int) -> Table | None:
    """The table below the line `index`, if that holds headings."""
    line = uncommented(text.lines[index]).strip(" ")
    if line.count('"') == 2 and line.startswith('"') and line.endswith('"'):
        line = line[1:-1]
    below = next((row for row in text.lines[index + 1:] if row.strip() and not row.startswith(COMMENTS)
                  and row.strip()[:1] in "+-.0123456789("), "")
    best: list[tuple[int, Table]] = []
    for delimiter in DELIMITERS:
        for plain, names in _divisions(line, delimiter):
            # Blanks occur in sentences too, of which a word or two may be understood.
            if len(names) < 2 or ((delimiter == " " or not plain or len(names) == 2)
                                  and len(cells(below, delimiter)) != len(names)):
                continue
            known = [heading for heading in map(understand, names) if heading is not None]
            if len(known) > 1 and any(heading.part == "frequency" for heading in known):
                # Of several possible tables, the one that leaves fewest cells unexplained.
                best.append((2 * len(known) - len(names),
                             Table(text, tuple(names), index, index + 1, delimiter, len(names), plain)))
    return _with_units(max(best, key=lambda each: each[0])[1]) if best else None


def _divisions(line: str, delimiter: str) -> Iterator[tuple[bool, list[str]]]:
    """Every way to divide headings: at the delimiter (True), or at blanks."""
    yield True, cells(line, delimiter)
    yield False, re.split(r"\s{2,}", line.strip())
    if delimiter == " ":
        yield from ((False, re.split(behind + r"\s+(?![(\[])", line.strip())) for behind in ("", r"(?<=[)\]])"))


def _with_units(table: Table) -> Table:
    """The table, with the units from a line below the headings."""
    if table.start >= len(table.text.lines):
        return table
    units = cells(uncommented(table.text.lines[table.start]), table.delimiter)
    # Other columns may have units of their own ("s", "V", "#"), but no numbers.
    if abs(len(units) - table.width) > 1 or sum(map(is_unit, units)) < 2 or any(map(is_cell, units)):
        return table
    units += [""] * (table.width - len(units))
    names = []
    for name, unit in zip(table.headings, units, strict=False):
        whole = f"{name} ({unit.strip('()[]')})"
        bare, known = understand(name), understand(whole)
        takes = is_unit(unit) and bare is not None and known is not None and not bare.unit and not known.strange_unit
        names.append(whole if takes else name)
    return replace(table, headings=tuple(names), start=table.start + 1, plain=False)


def _by_numbers(text: RecordingText) -> Table | None:
    """The table of the first two rows of three numbers or more.

    The line above may hold its headings. A complex number counts as two; a table of two columns is ambiguous.
    """
    lines = [(index, line) for index, line in enumerate(text.lines) if line.strip()]
    bare = [(index, line) for index, line in lines if not line.startswith(COMMENTS)]
    for (index, line), (_, following) in pairwise(bare):
        for delimiter in DELIMITERS:
            row, second = cells(line, delimiter), cells(following, delimiter)
            whole = any(complex_parts(cell) is not None for cell in row)
            if len(row) == len(second) > (1 if whole else 2) and all(map(is_cell, (*row, *second))):
                above = max((i for i, _ in lines if i < index), default=index)
                for plain, names in () if above == index else _divisions(uncommented(text.lines[above]), delimiter):
                    if len(names) == len(row) and not all(map(is_cell, names)):
                        return Table(text, tuple(names), above, index, delimiter, len(row), plain)
                return Table(text, (), index, index, delimiter, len(row), plain=False)
    return None
