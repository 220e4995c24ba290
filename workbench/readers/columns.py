"""Any other table of text, with columns named by a :class:`ColumnMap`.

Nothing is guessed: a person who knows the set-up states the columns, their units and, for a gain, the reference
resistor and which way up the ratio is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError, nearest_names
from workbench.files.quantities import UNITS
from workbench.files.tables import FileTable
from workbench.files.toml import toml_lines
from workbench.readers.findings import Finding
from workbench.readers.headings import SYMBOLS, understand
from workbench.readers.quantities import RecordedQuantity
from workbench.readers.sweep import ONE_FREQUENCY, Recorded, in_order
from workbench.readers.text import (
    COMMENTS,
    RecordingText,
    RowCells,
    cell_number,
    cells,
    complex_parts,
    holds_no_value,
    is_number,
    load_text,
    row_cells,
)
from workbench.results.spectrum import Origin

#: The setting of an origin that states the meaning of the columns of a table.
READ_AS = "read as"

#: Symbol or name of every quantity, for messages.
QUANTITY_WORDS: Mapping[str, str] = {**SYMBOLS, "gain": "the gain"}

#: A column map as an example for messages: its own keys, and its table `quantity`.
EXAMPLE: tuple[Mapping[str, object], Mapping[str, object]] = (
    {"frequency": "Freq", "first": "|Z|", "second": "angle", "frequency_unit": "kHz"},
    {"kind": "impedance", "form": "polar", "unit": "ohm", "phase_unit": "deg"},
)


@dataclass(frozen=True)
class ColumnMap:
    """The columns of a table that hold the spectrum.

    ``frequency``, ``first`` and ``second`` name a column by its heading or count it from 1; ``quantity`` is the meaning
    of ``first`` and ``second`` (magnitude and phase, real and imaginary part, or a pair such as Cp and D). A complex
    number in one cell has no ``second``. ``decimal`` is "." or ",". If the second column is in a file of its own,
    ``second_file`` names it, relative to the folder of the recording; both files have the frequency in the column
    ``frequency``, or the second one in its ``second_frequency``.

    Raises:
        ValueError: an unknown frequency unit, a separator that is the decimal mark, or a column twice.
    """

    frequency: str | int
    first: str | int
    second: str | int | None
    quantity: RecordedQuantity
    frequency_unit: str = "Hz"
    delimiter: str = ","
    decimal: str = "."
    second_file: str = ""
    second_frequency: str | int | None = None

    def __post_init__(self) -> None:
        if self.frequency_unit not in UNITS["frequency"]:
            raise ValueError(f"frequency unit {self.frequency_unit!r} is not one of {', '.join(UNITS['frequency'])}")
        if self.decimal not in (".", ",") or len(self.delimiter) != 1 or self.delimiter == self.decimal:
            raise ValueError(f"decimal {self.decimal!r} must be '.' or ',' and differ from the one-character "
                             f"delimiter {self.delimiter!r}")
        if self.quantity.form == "complex":
            if self.second not in (None, self.first) or self.second_file:
                raise ValueError(f"second {self.second!r}: a complex number is in one column, first")
            object.__setattr__(self, "second", None)
        elif self.second is None:
            raise ValueError(f"second must be given in form {self.quantity.form!r}")
        if self.second_frequency is not None and not self.second_file:
            raise ValueError("second_frequency is the frequency of a second_file, which is not given")
        for pair in ((self.frequency, self.first), (self.frequency_of_second, self.second)):
            if pair[0] == pair[1]:
                raise ValueError(f"frequency, first and second must be three columns, received {self.named}")
        if not self.second_file and self.first == self.second:
            raise ValueError(f"frequency, first and second must be three columns, received {self.named}")
        if any(isinstance(name, int) and name < 1 for name in self.named):
            raise ValueError(f"columns are counted from 1, received {self.named}")

    @property
    def named(self) -> tuple[str | int, ...]:
        """The columns that the map names."""
        return tuple(name for name in (self.frequency, self.first, self.second) if name is not None)

    @property
    def frequency_of_second(self) -> str | int:
        """The column of the frequency in the file of the second column."""
        return self.frequency if self.second_frequency is None else self.second_frequency


def read_column_map(path: Path | str) -> ColumnMap:
    """A column map from a TOML file: the fields of :class:`ColumnMap`, with ``quantity`` a table of those of Quantity.

    ::

        frequency = "Freq"          # a heading, or the number of the column from 1
        first = "|Z|"
        second = "angle"
        frequency_unit = "kHz"
        delimiter = ","             # or ";", "\\t" or " " (any number of blanks)
        decimal = "."               # or ","
        quantity = { kind = "impedance", form = "polar", unit = "ohm", phase_unit = "deg" }

    ``negated = true`` in the quantity: the second column is minus the phase or imaginary part, as in -Im(Z). Other
    quantities, one a line::

        { kind = "reflection", form = "polar", unit = "dB", phase_unit = "deg", reference_resistance = 50 }
        { kind = "transmission", form = "rectangular", unit = "1", configuration = "shunt" }   # or "series"
        { kind = "circuit", form = "Cp-D", unit = "pF", second_unit = "1" }
        { kind = "gain", form = "polar", unit = "dB", phase_unit = "deg", reference_resistance = 100 }
        { kind = "impedance", form = "complex", unit = "ohm" }    # both parts in the column first; no second

    Raises:
        InputError: a missing or unknown key, or a value that ColumnMap or Quantity refuse.
    """
    table = FileTable.read(Path(path))
    quantity = FileTable.of(table.content.get("quantity"), source=table.source, field="quantity",
                            expected="a table with kind, form and unit")
    for each, kind in ((table, ColumnMap), (quantity, RecordedQuantity)):
        each.only([f.name for f in fields(kind)])
        for required in (f.name for f in fields(kind) if f.default is MISSING):
            # The form decides whether there is a second column.
            if required not in each and required != "second":
                raise each.error(required, "to be given")
    try:
        return ColumnMap(**{"second": None, **table.content, "quantity": RecordedQuantity(**quantity.content)})
    except (TypeError, ValueError) as error:
        expected = f"a map such as\n\n{map_text(*EXAMPLE, {})}\n"
        raise InputError(str(path), "column map", str(error), expected) from error


def parse_columns(text: RecordingText, columns: ColumnMap) -> Recorded:
    """Read the file.

    Columns given by heading: the heading line is the first that holds all of them (a leading %, # or ! is ignored).
    Columns given by number: the lines in which all of them are numbers, those of the commonest width. Lines below that
    are no rows (:func:`~workbench.readers.text.row_cells`) are left out.

    The origin's setting :data:`READ_AS` states the meaning of each column.

    Raises:
        InputError: headings not found, a faulty row; a second file that is missing or has other frequencies.
    """
    against = contradiction(columns)
    if against is not None:
        raise InputError(text.path, "column map", against[0], f"a column that is what the map says, {against[1]}; the "
                         f"heading says {against[2]}: mend the map (kind, form), or count the columns (first = 2) to "
                         "overrule the heading")
    table = _Table.find(text, columns, columns.frequency, [
        columns.first, *([] if columns.second is None or columns.second_file else [columns.second])])
    values = [table.column(place) for place in table.places[:1]]
    if columns.quantity.form == "complex":
        values += table.rows.complex_column(text, table.places[1], width=table.width, decimal=columns.decimal)
    else:
        values += [table.column(place) for place in table.places[1:]]
    notes: dict[str, str] = {}
    if columns.second_file:
        values.append(_second(text, columns, values[0]))
        other = Path(text.path).parent / columns.second_file
        notes["second file"] = f"{columns.second_file}, sha256 {load_text(other).sha256}"
    return recorded(text, table.rows, columns, values=values, column=table.places[0] + 1,
                    read_as=f"by a column map, {column_map_text(columns)}", settings=notes)


def uncommented(line: str) -> str:
    """A line without a leading comment sign."""
    return line.lstrip("%#! ") if line.startswith(COMMENTS) else line


def recorded(
    text: RecordingText, rows: RowCells, columns: ColumnMap, *, values: Sequence[NDArray[np.float64]], column: int,
    read_as: str, settings: Mapping[str, str] = MappingProxyType({}), instrument: str = "",
) -> Recorded:
    """The spectrum of a table's `values`: frequency (its column counted from one), first and second.

    Raises:
        InputError: fewer than two frequencies, an impedance that is zero or infinite.
    """
    frequency = values[0] * UNITS["frequency"][columns.frequency_unit]
    quantity = columns.quantity
    impedance = quantity.impedance(values[1], values[2], frequency)
    found = []
    if rows.skipped:
        said = "; ".join(f"line {line} {text.lines[line - 1].strip()[:40]!r}" for line in rows.skipped[:3])
        many = f"{len(rows.skipped)} lines" if len(rows.skipped) > 1 else "one line"
        found.append(Finding("no_rows", f"{many} below the first row left out as no rows: {said}"
                             + (" ..." if len(rows.skipped) > 3 else "")))
    if rows.next_table is not None:
        found.append(Finding("another_table", f"line {rows.next_table} "
                             f"{text.lines[rows.next_table - 1].strip()[:60]!r} begins another table, "
                             "which is not read"))
    if quantity.unsigned_losses(values[1], values[2]):
        found.append(Finding("unsigned_losses", f"{quantity.form}: D or Q is positive where the reactive element is "
                             "negative, hence taken to be written without its sign"))
    noted = {READ_AS: " ".join(read_as.split()), **settings}
    origin = Origin("measured", text.path, text.sha256, instrument, settings=noted)
    return in_order(text, frequency, impedance, lines=rows.lines, column=column, origin=origin,
                    cells=values[1:], findings=found)


def column_map_text(columns: ColumnMap, notes: Mapping[str | int, str] = MappingProxyType({})) -> str:
    """Text with the meaning of every column of a map, with unit and sign; `notes` by column give reasons."""
    quantity = columns.quantity
    symbol = QUANTITY_WORDS.get(quantity.kind, "")
    if quantity.kind == "circuit":
        one, _, two = quantity.form.partition("-")
        meanings = ("the frequency", one, two)
        units = (columns.frequency_unit, quantity.unit, quantity.second_unit)
    else:
        parts = ("magnitude", "phase") if quantity.form == "polar" else ("real part", "imaginary part")
        unit = {"dB": "dB" + {"impedance": " of one ohm", "admittance": " of one siemens"}.get(quantity.kind, "")}.get(
            quantity.unit, quantity.unit)
        units = (columns.frequency_unit, unit, quantity.phase_unit if quantity.form == "polar" else unit)
        meanings = ("the frequency", f"the {parts[0]} of {symbol}",
                    f"{'minus ' if quantity.negated else ''}the {parts[1]} of {symbol}")
        if quantity.form == "complex":
            meanings = ("the frequency", f"{symbol} as complex numbers"
                        + (" whose imaginary part is negated" if quantity.negated else ""), "")
    found = []
    for name, meaning, its in zip((columns.frequency, columns.first, columns.second), meanings, units, strict=True):
        if name is None:
            continue
        called = f'"{name}"' if isinstance(name, str) else f"column {name}"
        if name is columns.second and columns.second_file:
            called += f" of {columns.second_file}"
        its = {"1": "no unit"}.get(its, its)
        found.append(f"{called} is {meaning} in {its}" + (f" ({notes[name]})" if name in notes else ""))
    resistance = f"{quantity.reference_resistance or 0.0:g} ohm"
    match quantity.kind:
        case "gain":
            both, resistor = "the voltage across both", f"that across {resistance}"
            found.append(f"the gain is {both} over {resistor}" if quantity.inverse else f"the gain is {resistor} over "
                         f"{both}")
        case "reflection":
            found.append(f"reflection at one port of {resistance}")
        case "transmission":
            found.append(f"transmission between two ports of {resistance}, the specimen in {quantity.configuration}")
        case "impedance" | "admittance":
            sign = "negative" if (quantity.kind == "impedance") != quantity.negated else "positive"
            found.append(f"of a capacitor the {'imaginary part' if columns.second is None else 'last'} is {sign}")
    delimiter = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks"}.get(
        columns.delimiter, repr(columns.delimiter))
    found.append(f"columns divided by {delimiter}, decimal {'comma' if columns.decimal == ',' else 'point'}")
    return "; ".join(found)


def map_text(fields_: Mapping[str, Any], quantity: Mapping[str, Any], doubts: Mapping[str, str]) -> str:
    """The text of a column map for :func:`read_column_map`; `doubts` by key become comments beside it."""
    lines = []
    for content, head in ((fields_, ""), (quantity, "[quantity]")):
        lines += [head] if head else []
        for key, line in zip(content, toml_lines(content), strict=True):
            lines.append(f"{line:<35} # {doubts[key]}" if key in doubts else line)
    return "\n".join(lines)


def contradiction(columns: ColumnMap) -> tuple[str, str, str] | None:
    """A heading that contradicts the map that names it: the heading, the meaning in the map, and its own meaning.

    None if there is none. A counted column cannot contradict, so counting overrules a heading. Signs and units of a
    phase are not compared, since headings are often wrong about them.
    """
    quantity = columns.quantity
    if quantity.kind == "circuit":
        parts = [("element", symbol) for symbol in quantity.form.split("-")]
    else:
        parts = [(part, quantity.kind) for part in {"polar": ("magnitude", "phase"), "complex": ("whole",)}.get(
            quantity.form, ("real", "imaginary"))]
    for name, (part, kind) in zip((columns.first, columns.second), parts, strict=False):
        # One small letter may be anybody's name for anything.
        heading = understand(name) if isinstance(name, str) and not (len(name) == 1 and name.islower()) else None
        if heading is None or heading.part == "scalar":
            continue
        if part == "element":
            said = {("real", "impedance"): "R", ("imaginary", "impedance"): "X", ("real", "admittance"): "G",
                    ("imaginary", "admittance"): "B"}.get((heading.part, heading.kind), "")
            said = heading.kind if heading.part == "element" else said
            # "C" may be Cp or Cs, and R either resistance.
            fits = kind.startswith(said) if said else heading.part not in ("frequency", "phase") and not heading.kind
        else:
            fits = heading.part in (part, "whole") or (part == "whole" and heading.part != "frequency")
            fits = fits and heading.kind in ("", kind) and (heading.part != "whole" or part != "imaginary")
        if not fits:
            what = f"{heading.kind} {heading.part}".strip() if heading.part != "element" else heading.kind
            return str(name), f"{part} of {kind}" if part != "element" else kind, what
    return None


@dataclass(frozen=True, eq=False)
class _Table:
    """The rows of a table with the columns at `places` (from 0), the frequency first."""

    text: RecordingText
    rows: RowCells
    places: tuple[int, ...]
    width: int
    decimal: str

    @classmethod
    def find(
        cls, text: RecordingText, columns: ColumnMap, frequency: str | int, others: Sequence[str | int]
    ) -> _Table:
        """The first table that has the column `frequency` and the `others`."""
        split = [cells(uncommented(line), columns.delimiter) for line in text.lines]
        places, width, start, headings = _locate(text, columns, (frequency, *others), split)
        rows = row_cells(text, start, width=width, delimiter=columns.delimiter, decimal=columns.decimal,
                         frequency=places[0], headings=headings)
        return cls(text, rows, tuple(places), width, columns.decimal)

    def column(self, place: int) -> NDArray[np.float64]:
        """The numbers (n,) of the column `place` (from 0)."""
        return self.rows.column(self.text, place, width=self.width, decimal=self.decimal)


def _second(text: RecordingText, columns: ColumnMap, frequency: NDArray[np.float64]) -> NDArray[np.float64]:
    """The second column (n,), from its own file, at the `frequency` (n,) of the first."""
    other = load_text(Path(text.path).parent / columns.second_file)
    assert columns.second is not None  # held by ColumnMap
    table = _Table.find(other, columns, columns.frequency_of_second, [columns.second])
    own, values = table.column(table.places[0]), table.column(table.places[1])
    if len(own) != len(frequency) or np.any(np.abs(own - frequency) > ONE_FREQUENCY * np.abs(frequency)):
        raise InputError(other.path, "frequency", f"{len(own)} frequencies", f"the {len(frequency)} frequencies of "
                         f"{text.path}, in the same order")
    return values


def _locate(
    text: RecordingText, columns: ColumnMap, wanted: Sequence[str | int], split: Sequence[list[str]]
) -> tuple[list[int], int, int, Sequence[str]]:
    """Places of the columns (from 0), number of columns, index of the line at or above the first row, and the headings.
    """
    headings = [name for name in wanted if isinstance(name, str)]
    names: Sequence[str] = ()
    if headings:
        found = next((index for index, row in enumerate(split) if all(name in row for name in headings)), None)
        if found is None:
            missing = next(name for name in headings if not any(name in row for row in split)) if any(
                not any(name in row for row in split) for name in headings) else headings[0]
            seen = [cell for row in split[:50] for cell in row if cell]
            raise InputError(text.path, "column headings", missing, "a line holding " + ", ".join(map(repr, headings)),
                             nearest_names(missing, seen))
        for name in headings:
            if split[found].count(name) > 1:
                raise text.error(found + 1, None, name, "a heading that occurs once; count the columns instead")
        names = split[found]
        places = [names.index(name) if isinstance(name, str) else name - 1 for name in wanted]
        width, start = len(names), found + 1
    else:
        places = [int(name) - 1 for name in wanted]
        whole = [(index, len(row)) for index, row in enumerate(split) if _holds_numbers(row, places, columns.decimal)
                 and not text.lines[index].startswith(COMMENTS)]
        if not whole:
            _refuse_columns(text, columns, places, split)
        # Settings and counts above a table may be numbers too, but have fewer cells than most rows.
        widths = [count for _, count in whole]
        width = max(widths, key=widths.count)
        start = next(index for index, count in whole if count == width)
        above = next((index for index in range(start - 1, -1, -1) if text.lines[index].strip()), None)
        if above is not None and len(split[above]) == width:
            names = split[above]
    if max(places) >= width:
        raise text.error(min(start + 1, len(split)), None, f"{width} columns", f"at least {max(places) + 1} columns")
    return places, width, start, names


def _holds_numbers(row: Sequence[str], places: Sequence[int], decimal: str) -> bool:
    return max(places) < len(row) and is_number(row[places[0]], decimal) and all(
        is_number(row[place], decimal) or complex_parts(row[place]) is not None or holds_no_value(row[place], decimal)
        for place in places)


def _refuse_columns(
    text: RecordingText, columns: ColumnMap, places: Sequence[int], split: Sequence[Sequence[str]]
) -> NoReturn:
    """Raise with the reason why no line has numbers in all of the `places`."""
    start = next((index for index, row in enumerate(split) if len(row) > 1 and all(
        cell.lstrip("+-.")[:1].isdigit() for cell in row)), None)
    if start is None:
        raise InputError(text.path, "rows", text.lines[0], f"rows of numbers separated by {columns.delimiter!r}")
    if max(places) >= len(split[start]):
        raise text.error(start + 1, None, f"{len(split[start])} columns", f"at least {max(places) + 1} columns")
    place = next(place for place in places if not is_number(split[start][place], columns.decimal))
    cell_number(text, start + 1, place + 1, cell=split[start][place], decimal=columns.decimal)
    raise AssertionError(split[start])  # number() raises
