"""Tables whose columns a :class:`ColumnMap` names, with unit and quantity.

Nothing is guessed: a person who knows the set-up states the map, or clear headings determine it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError, nearest_names
from workbench.files.quantities import UNITS
from workbench.files.tables import FileTable
from workbench.files.toml import toml_lines
from workbench.readers.findings import Finding
from workbench.readers.headings import RECTANGULAR, SYMBOLS, Heading, apparent_meaning, understand, units_of
from workbench.readers.quantities import RecordedQuantity
from workbench.readers.states import select_of, telling_columns, values_in_words
from workbench.readers.sweep import ONE_FREQUENCY, Reading, in_order
from workbench.readers.tables import Table
from workbench.readers.text import (
    COMMENTS,
    RecordingText,
    cells,
    complex_parts,
    is_number,
    load_text,
    uncommented,
    value_of,
)
from workbench.results.spectrum import Origin

#: The beginning of a comment in a proposed column map that asks for a decision.
UNCLEAR = "UNCLEAR:"
#: Symbol or name of every quantity, for messages.
QUANTITY_WORDS: Mapping[str, str] = {**SYMBOLS, "gain": "the gain"}
#: Every part of a quantity, for messages.
PART_WORDS: Mapping[str, str] = {
    "frequency": "the frequency", "magnitude": "the magnitude", "phase": "the phase", "real": "the real part",
    "imaginary": "the imaginary part", "whole": "a complex number",
}


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
        if self.frequency == self.first or self.frequency_of_second == self.second or (
                not self.second_file and self.first == self.second):
            raise ValueError(f"frequency, first and second must be three columns, received {self.named}")
        if any(isinstance(name, int) and name < 1 for name in self.named):
            raise ValueError(f"columns are counted from 1, received {self.named}")

    @property
    def named(self) -> tuple[str | int, ...]:
        """The columns that the map names."""
        return tuple(name for name in (self.frequency, self.first, self.second) if name is not None)

    @property
    def meanings(self) -> tuple[tuple[str, str, str], ...]:
        """Part, kind and unit of every column that the map names."""
        return ("frequency", "", self.frequency_unit), *self.quantity.columns

    @property
    def frequency_of_second(self) -> str | int:
        """The column of the frequency in the file of the second column."""
        return self.frequency if self.second_frequency is None else self.second_frequency

    def impedance(self, values: Sequence[NDArray[np.float64]]) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
        """Frequency (n,) Hz and impedance (n,) ohm of columns of numbers."""
        hertz = values[0] * UNITS["frequency"][self.frequency_unit]
        return hertz, self.quantity.impedance(values[1], values[2], hertz)


def read_column_map(path: Path | str) -> ColumnMap:
    """A column map from a TOML file.

    Its keys are the fields of :class:`ColumnMap`, and ``quantity`` is a table of those of Quantity.

    ::

        frequency = "Freq"          # a heading, or the number of the column from 1
        first = "|Z|"
        second = "angle"
        frequency_unit = "kHz"
        delimiter = ","             # or ";", "\\t" or " " (any number of blanks)
        decimal = "."               # or ","
        quantity = { kind = "impedance", form = "polar", unit = "ohm", phase_unit = "deg" }

    ``negated = true`` in the quantity: the second column is minus the phase or imaginary part, as in -Im(Z). The page
    on recordings lists the quantities (``kind``, ``form`` and their units).
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
        example = ColumnMap("Freq", "|Z|", "angle", RecordedQuantity("impedance", "polar", "ohm"), "kHz")
        raise InputError(str(path), "column map", str(error), f"a map such as\n\n{map_text(example)}\n") from error


def map_text(columns: ColumnMap, doubts: Mapping[str, str] = MappingProxyType({})) -> str:
    """The text of a column map for :func:`read_column_map`.

    `doubts`, choices by key, become comments beside it that begin with :data:`UNCLEAR`. A resistance or selection in
    doubt has a value that is refused until it is replaced.
    """
    lines = []
    shown = {"frequency_unit", "delimiter", "decimal", *(["phase_unit"] if columns.quantity.form == "polar" else []),
             *doubts}
    for of, head in ((columns, ""), (columns.quantity, "[quantity]")):
        lines += [head] if head else []
        for each in fields(of):
            value = getattr(of, each.name)
            if each.name == "quantity" or value is None or not (
                    each.name in shown or value != ({} if each.default is MISSING else each.default)):
                continue
            value = 0.0 if each.name == "reference_resistance" and each.name in doubts else value
            line = toml_lines({each.name: value})[0]
            lines.append(f"{line:<35} # {UNCLEAR} {doubts[each.name]}" if each.name in doubts else line)
    return "\n".join(lines)


def parse_columns(text: RecordingText, columns: ColumnMap) -> Reading:
    """Read the file.

    Columns given by heading: the heading line is the first that holds all of them (a leading %, # or ! is ignored).
    Columns given by number: the lines in which all of them are numbers, those of the commonest width. Lines below that
    are no rows (:meth:`~workbench.readers.tables.Table.with_rows`) are left out.

    The origin's setting :data:`~workbench.readers.text.READ_AS` states the meaning of each column.

    Raises:
        InputError: headings not found, a faulty row; sweeps of several states; a second file that is missing or has
            other frequencies.
    """
    against = contradiction(columns)
    if against is not None:
        raise InputError(text.path, "column map", against.heading, f"a column that is what the map says, "
                         f"{against.mapped}; the heading says {against.said}: mend the map (kind, form, unit), or "
                         "count the columns (first = 2) to overrule the heading")
    table, places = _mapped(text, columns, columns.named[:2] if columns.second_file else columns.named)
    values = table.numbers(places, last_is_complex=columns.quantity.form == "complex")
    settings: dict[str, str] = {}
    if columns.second_file:
        assert columns.second is not None  # held by ColumnMap
        other = load_text(Path(text.path).parent / columns.second_file)
        beside, both = _mapped(other, columns, (columns.frequency_of_second, columns.second))
        own, second = beside.numbers(both)
        if len(own) != len(values[0]) or np.any(np.abs(own - values[0]) > ONE_FREQUENCY * np.abs(values[0])):
            raise InputError(other.path, "frequency", f"{len(own)} frequencies", f"the {len(values[0])} frequencies of "
                             f"{text.path}, in the same order")
        values.append(second)
        settings["second file"] = f"{columns.second_file}, sha256 {other.sha256}"
    else:
        telling = telling_columns(table, places, *columns.impedance(values))
        if telling:
            line = toml_lines({"select": {**columns.select, **select_of(telling, table)}})[0]
            raise InputError(text.path, "rows", values_in_words(telling, table), "the sweep of one device or state: "
                             f"choose one by a line such as {line} in the column map")
    return recorded(table, columns, values, places[0], text.origin(
        read_as=f"by a column map, {column_map_text(columns)}", settings=settings))


def recorded(
    table: Table, columns: ColumnMap, values: Sequence[NDArray[np.float64]], place: int, origin: Origin, *,
    scale: float = 1.0, findings: Sequence[Finding] = (),
) -> Reading:
    """The spectrum of a table's columns of numbers.

    `values` are frequency (its `place` counted from 0), first and second, (n,) each. `scale` multiplies the impedance.

    Raises:
        InputError: as :func:`workbench.readers.sweep.in_order`.
    """
    text, found = table.text, list(findings)
    if table.skipped:
        said = "; ".join(f"line {line} {text.lines[line - 1].strip()[:40]!r}" for line in table.skipped[:3])
        many = f"{len(table.skipped)} lines" if len(table.skipped) > 1 else "one line"
        found.append(Finding("no_rows", f"{Path(text.path).name}: {many} below the first row left out as no "
                             f"rows: {said}"
                             + (" ..." if len(table.skipped) > 3 else "")))
    if table.next_table is not None:
        found.append(Finding("another_table", f"{Path(text.path).name}: line {table.next_table} "
                             f"{text.lines[table.next_table - 1].strip()[:60]!r} begins another table, "
                             "which is not read"))
    if columns.quantity.unsigned_losses(values[1], values[2]):
        found.append(Finding("unsigned_losses", f"{columns.quantity.form}: D or Q is positive where the reactive "
                             "element is negative, hence taken to be written without its sign"))
    frequency, impedance = columns.impedance(values)
    with np.errstate(invalid="ignore"):
        impedance = scale * impedance
    return in_order(table, frequency, impedance, values=values[1:], column=place + 1, origin=origin,
                    findings=found)


def column_map_text(columns: ColumnMap, notes: Mapping[str | int, str] = MappingProxyType({})) -> str:
    """The meaning of every column of a map, in words.

    `notes` by column give reasons.
    """
    quantity = columns.quantity
    found = []
    for name, (part, kind, unit) in zip(columns.named, columns.meanings, strict=True):
        minus = quantity.negated and name is columns.second
        meaning = ("minus " if minus else "") + (kind if part == "element" else PART_WORDS[part] + (
            f" of {QUANTITY_WORDS[kind]}" if part != "frequency" else ""))
        if part == "whole":
            meaning = f"{QUANTITY_WORDS[kind]} as complex numbers" + (
                " whose imaginary part is negated" if quantity.negated else "")
        called = f'"{name}"' if isinstance(name, str) else f"column {name}"
        if name is columns.second and columns.second_file:
            called += f" of {columns.second_file}"
        of = {"impedance": " of one ohm", "admittance": " of one siemens"}.get(kind, "")
        unit = {"1": "no unit", "dB": f"dB{of}"}.get(unit, unit)
        found.append(f"{called} is {meaning} in {unit}" + (f" ({notes[name]})" if name in notes else ""))
    resistance = f"{quantity.reference_resistance or 0.0:g} ohm"
    ratio = ("the voltage across both", f"that across {resistance}")[::1 if quantity.inverse else -1]
    sign = "negative" if (quantity.kind == "impedance") != quantity.negated else "positive"
    of_capacitor = f"of a capacitor the {'imaginary part' if columns.second is None else 'last'} is {sign}"
    found += {"gain": [f"the gain is {ratio[0]} over {ratio[1]}"],
              "reflection": [f"reflection at one port of {resistance}"],
              "transmission": [f"transmission between two ports of {resistance}, the specimen in "
                               f"{quantity.configuration}"],
              "impedance": [of_capacitor], "admittance": [of_capacitor]}.get(quantity.kind, [])
    found += [f"rows with {name} {value} alone" for name, value in columns.select.items()]
    delimiters = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks"}
    found.append(f"columns divided by {delimiters.get(columns.delimiter, repr(columns.delimiter))}, decimal "
                 f"{'comma' if columns.decimal == ',' else 'point'}")
    return "; ".join(found)


# --------------------------------------------------------------------------------------------------------------------
# Headings against a map, and the place of its columns.


@dataclass(frozen=True)
class Contradiction:
    """A heading against a map, in words; ``unit`` if only units differ."""

    heading: str
    mapped: str
    said: str
    unit: bool


def contradiction(columns: ColumnMap) -> Contradiction | None:
    """The first heading that contradicts the map, or None.

    A counted column cannot contradict, so counting overrules a heading. Signs are not compared, since headings are
    often wrong about them.
    """
    for name, (part, kind, unit) in zip(columns.named, columns.meanings, strict=True):
        # One small letter may be anybody's name for anything.
        if isinstance(name, int) or (len(name) == 1 and name.islower()):
            continue
        heading = understand(name)
        if heading is None and (heading := apparent_meaning(name)) is not None and heading.part == "whole" and part in (
                "real", "imaginary"):
            # A unit among foreign words leaves the part open.
            heading = replace(heading, part=part)
        if heading is None or heading.part == "scalar":
            continue
        if not _fits(heading, part, kind):
            said = f"{heading.kind} {heading.part if heading.part not in ('element', 'whole') else ''}".strip()
            said += f" in {heading.unit}" if heading.unit else ""
            mapped = f"{part} of {kind}" if part not in ("element", "frequency") else kind or part
            return Contradiction(name, mapped, said, unit=False)
        stated = {heading.unit} if heading.unit else units_of(heading.strange_unit)
        if stated and unit not in stated:
            return Contradiction(name, f"in {unit}", heading.unit or heading.strange_unit, unit=True)
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


def _mapped(text: RecordingText, columns: ColumnMap, wanted: Sequence[str | int]) -> tuple[Table, list[int]]:
    """The first table with the columns `wanted`, and their places (from 0)."""
    split = [cells(uncommented(line), columns.delimiter) for line in text.lines]
    headings = [name for name in wanted if isinstance(name, str)]
    if headings:
        index = next((index for index, row in enumerate(split) if set(headings) <= set(row)), None)
        if index is None:
            missing = next((name for name in headings if not any(name in row for row in split)), headings[0])
            raise InputError(text.path, "column headings", missing, "a line holding " + ", ".join(map(repr, headings)),
                             nearest_names(missing, [cell for row in split[:50] for cell in row if cell]))
        names = split[index]
        twice = next((name for name in headings if names.count(name) > 1), None)
        if twice is not None:
            raise text.error(index + 1, None, twice, "a heading that occurs once; count the columns instead")
        places = [names.index(name) if isinstance(name, str) else name - 1 for name in wanted]
        table = Table(text, tuple(names), index, index + 1, columns.delimiter, len(names))
    else:
        places = [int(name) - 1 for name in wanted]
        numbered = [index for index, row in enumerate(split) if _holds_numbers(row, places, columns.decimal)
                    and not text.lines[index].startswith(COMMENTS)]
        # Rows that a decimal mark or a missing column spoils are refused with their place.
        numbered = numbered or [index for index, row in enumerate(split) if len(row) > 1 and all(
            cell.lstrip("+-.")[:1].isdigit() for cell in row)]
        if not numbered:
            raise InputError(text.path, "rows", text.lines[0], f"rows of numbers separated by {columns.delimiter!r}")
        # Settings and counts above a table may be numbers too, but have fewer cells than most rows.
        widths = [len(split[index]) for index in numbered]
        width = max(widths, key=widths.count)
        start = numbered[widths.index(width)]
        above = next((index for index in range(start - 1, -1, -1) if text.lines[index].strip()), start)
        names = split[above] if above < start and len(split[above]) == width else []
        table = Table(text, tuple(names), above, start, columns.delimiter, width)
    if max(places) >= table.width:
        raise text.error(min(table.start + 1, len(split)), None, f"{table.width} columns",
                         f"at least {max(places) + 1} columns")
    return table.with_rows(places[0], columns.decimal).where(columns.select), places


def _holds_numbers(row: Sequence[str], places: Sequence[int], decimal: str) -> bool:
    return max(places) < len(row) and is_number(row[places[0]], decimal) and all(
        value_of(row[place], decimal) is not None or complex_parts(row[place]) is not None
        for place in places)
