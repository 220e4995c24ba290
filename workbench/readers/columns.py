"""Any other table of text, with columns named by a :class:`ColumnMap`.

Nothing is guessed: a person who knows the set-up states the columns, their units and, for a gain, the reference
resistor and which way up the ratio is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
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
from workbench.readers.headings import RECTANGULAR, SYMBOLS, Heading, hint, understand, units_of
from workbench.readers.quantities import RecordedQuantity
from workbench.readers.states import select_of, selected, telling_columns, values_in_words
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

#: The beginning of a comment in a proposed column map that asks for a decision.
UNCLEAR = "UNCLEAR:"

#: Symbol or name of every quantity, for messages.
QUANTITY_WORDS: Mapping[str, str] = {**SYMBOLS, "gain": "the gain"}

#: Every part of a quantity, for messages.
PART_WORDS: Mapping[str, str] = {
    "frequency": "the frequency", "magnitude": "the magnitude", "phase": "the phase", "real": "the real part",
    "imaginary": "the imaginary part", "whole": "a complex number",
}

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
    ``frequency``, or the second one in its ``second_frequency``. ``select`` holds values by column: only rows with all
    of them are read, such as those of one device.

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
    select: Mapping[str, str | float] = field(default_factory=dict)

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
        if not isinstance(self.select, Mapping) or not all(
                isinstance(value, str | int | float) for value in self.select.values()):
            raise ValueError(f'select {self.select!r} must be a table of values by column, such as {{ DUT = "1" }}')
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

    ``select = { DUT = "1" }`` reads the rows of one device alone.

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
            if required not in each and required not in ("second", "select"):
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
        InputError: headings not found, a faulty row; sweeps of several states; a second file that is missing or has
            other frequencies.
    """
    against = contradiction(columns)
    if against is not None:
        raise InputError(text.path, "column map", against.heading, f"a column that is what the map says, "
                         f"{against.mapped}; the heading says {against.said}: mend the map (kind, form, unit), or "
                         "count the columns (first = 2) to overrule the heading")
    whole = columns.quantity.form == "complex"
    rows, places, headings = _find(text, columns, columns.named[:2] if columns.second_file else columns.named)
    values = rows.numbers(places, last_is_complex=whole)
    notes: dict[str, str] = {}
    if columns.second_file:
        values.append(_second(text, columns, values[0]))
        other = Path(text.path).parent / columns.second_file
        notes["second file"] = f"{columns.second_file}, sha256 {load_text(other).sha256}"
    else:
        hertz = values[0] * UNITS["frequency"][columns.frequency_unit]
        impedance = columns.quantity.impedance(values[1], values[2], hertz)
        telling = telling_columns(rows, headings, places, values[0], impedance)
        if telling:
            line = toml_lines({"select": {**columns.select, **select_of(telling, headings)}})[0]
            raise InputError(text.path, "rows", values_in_words(telling, headings), "the sweep of one device or "
                             f"state: choose one by a line such as {line} in the column map")
    return recorded(rows, columns, values=values, column=places[0] + 1,
                    read_as=f"by a column map, {column_map_text(columns)}", settings=notes)


def uncommented(line: str) -> str:
    """A line without a leading comment sign."""
    return line.lstrip("%#! ") if line.startswith(COMMENTS) else line


def recorded(
    rows: RowCells, columns: ColumnMap, *, values: Sequence[NDArray[np.float64]], column: int, read_as: str,
    settings: Mapping[str, str] = MappingProxyType({}), instrument: str = "",
) -> Recorded:
    """The spectrum of a table's `values`: frequency (its column counted from one), first and second.

    Raises:
        InputError: fewer than two frequencies, an impedance that is zero or infinite.
    """
    text, quantity = rows.text, columns.quantity
    frequency = values[0] * UNITS["frequency"][columns.frequency_unit]
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
    found = []
    for name, (part, kind, unit) in zip(columns.named, (
            ("frequency", "", columns.frequency_unit), *quantity.columns), strict=True):
        meaning = kind if part == "element" else PART_WORDS[part] + (
            f" of {QUANTITY_WORDS[kind]}" if part not in ("frequency", "whole") else "")
        if part == "whole":
            meaning = f"{QUANTITY_WORDS[kind]} as complex numbers" + (
                " whose imaginary part is negated" if quantity.negated else "")
        elif quantity.negated and name is columns.second:
            meaning = f"minus {meaning}"
        called = f'"{name}"' if isinstance(name, str) else f"column {name}"
        if name is columns.second and columns.second_file:
            called += f" of {columns.second_file}"
        unit = {"1": "no unit", "dB": "dB" + {"impedance": " of one ohm", "admittance": " of one siemens"}.get(
            kind, "")}.get(unit, unit)
        found.append(f"{called} is {meaning} in {unit}" + (f" ({notes[name]})" if name in notes else ""))
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
    found += [f"rows with {name} {value} alone" for name, value in columns.select.items()]
    delimiter = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks"}.get(
        columns.delimiter, repr(columns.delimiter))
    found.append(f"columns divided by {delimiter}, decimal {'comma' if columns.decimal == ',' else 'point'}")
    return "; ".join(found)


def map_text(fields_: Mapping[str, Any], quantity: Mapping[str, Any], doubts: Mapping[str, str]) -> str:
    """The text of a column map for :func:`read_column_map`; `doubts`, choices by key, become
    comments beside it that begin with :data:`UNCLEAR`."""
    lines = []
    for content, head in ((fields_, ""), (quantity, "[quantity]")):
        lines += [head] if head else []
        for key, line in zip(content, toml_lines(content), strict=True):
            lines.append(f"{line:<35} # {UNCLEAR} {doubts[key]}" if key in doubts else line)
    return "\n".join(lines)


@dataclass(frozen=True)
class Contradiction:
    """A ``heading`` against the map that names it: their meanings in words; ``unit`` if they differ in the unit alone.
    """

    heading: str
    mapped: str
    said: str
    unit: bool


def contradiction(columns: ColumnMap) -> Contradiction | None:
    """The first heading that contradicts the map that names it; None if there is none.

    A counted column cannot contradict, so counting overrules a heading. Signs are not compared, since headings are
    often wrong about them.
    """
    wanted = (("frequency", "", columns.frequency_unit), *columns.quantity.columns)
    for name, (part, kind, unit) in zip(columns.named, wanted, strict=True):
        # One small letter may be anybody's name for anything.
        if isinstance(name, int) or (len(name) == 1 and name.islower()):
            continue
        heading = understand(name)
        if heading is None and (heading := hint(name)) is not None and heading.part == "whole" and part in (
                "real", "imaginary"):
            # A unit among foreign words leaves the part open.
            heading = replace(heading, part=part)
        if heading is None or heading.part == "scalar":
            continue
        if not _fits(heading, part, kind):
            what = f"{heading.kind} {heading.part if heading.part not in ('element', 'whole') else ''}".strip()
            what += f" in {heading.unit}" if heading.unit else ""
            return Contradiction(str(name), f"{part} of {kind}" if part not in ("element", "frequency") else
                                 kind or part, what, unit=False)
        stated = {heading.unit} if heading.unit else units_of(heading.strange_unit)
        if stated and unit not in stated:
            return Contradiction(str(name), f"in {unit}", heading.unit or heading.strange_unit, unit=True)
    return None


def _fits(heading: Heading, part: str, kind: str) -> bool:
    """Whether a heading may be that part of that kind of quantity."""
    if part == "frequency" or heading.part == "frequency":
        return part == heading.part
    if part != "element":
        fits = heading.part in (part, "whole") or part == "whole"
        return fits and heading.kind in ("", kind) and (heading.part != "whole" or part != "imaginary")
    said = heading.kind if heading.part == "element" else RECTANGULAR.get((heading.part, heading.kind), "")
    # "C" may be Cp or Cs, and R either resistance.
    return kind.startswith(said[:1] if said == "Rs" and kind == "Rp" else said) if said else (
        heading.part != "phase" and not heading.kind)


def _find(
    text: RecordingText, columns: ColumnMap, wanted: Sequence[str | int]
) -> tuple[RowCells, tuple[int, ...], Sequence[str]]:
    """The rows of the first table with the columns `wanted`, the frequency first; their places, and the headings."""
    split = [cells(uncommented(line), columns.delimiter) for line in text.lines]
    places, width, start, headings = _locate(text, columns, wanted, split)
    rows = row_cells(text, start, width=width, delimiter=columns.delimiter, decimal=columns.decimal,
                     frequency=places[0], headings=headings)
    return selected(text.path, rows, headings, columns.select), tuple(places), headings


def _second(text: RecordingText, columns: ColumnMap, frequency: NDArray[np.float64]) -> NDArray[np.float64]:
    """The second column (n,), from its own file, at the `frequency` (n,) of the first."""
    other = load_text(Path(text.path).parent / columns.second_file)
    assert columns.second is not None  # held by ColumnMap
    rows, places, _ = _find(other, columns, (columns.frequency_of_second, columns.second))
    own, values = rows.numbers(places)
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
