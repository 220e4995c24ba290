"""Any other table of text, once its columns have been named by a :class:`ColumnMap`.

Nothing is guessed: what the columns are, their units and, for a gain, the reference resistor and which way up the
ratio is, are said by the person who knows the set-up.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from types import MappingProxyType

from workbench.files.errors import InputError, nearest_names
from workbench.files.quantities import UNITS
from workbench.files.tables import Table
from workbench.readers.quantities import Quantity
from workbench.readers.text import RecordingText, Rows, cells, check_frequencies, check_impedance, numbers
from workbench.spectrum import Origin, Spectrum

#: The setting of an origin that says what the columns of a table were taken for.
READ_AS = "read as"

#: A line that begins so is no row.
COMMENTS = ("%", "#", "!")

#: A column map as an example for messages: what stands above, and its table `quantity`.
EXAMPLE: tuple[Mapping[str, object], Mapping[str, object]] = (
    {"frequency": "Freq", "first": "|Z|", "second": "angle", "frequency_unit": "kHz"},
    {"kind": "impedance", "form": "polar", "unit": "ohm", "phase_unit": "deg"},
)


@dataclass(frozen=True)
class ColumnMap:
    """Which columns of a table hold the spectrum.

    ``frequency``, ``first`` and ``second`` name a column by its heading or count it from 1; ``quantity`` says what
    ``first`` and ``second`` are (magnitude and phase, or real and imaginary part). ``decimal`` is "." or ",".

    Raises:
        ValueError: an unknown frequency unit, a separator that is the decimal mark, or a column twice.
    """

    frequency: str | int
    first: str | int
    second: str | int
    quantity: Quantity
    frequency_unit: str = "Hz"
    delimiter: str = ","
    decimal: str = "."

    def __post_init__(self) -> None:
        if self.frequency_unit not in UNITS["frequency"]:
            raise ValueError(f"frequency unit {self.frequency_unit!r} is not one of {', '.join(UNITS['frequency'])}")
        if self.decimal not in (".", ",") or len(self.delimiter) != 1 or self.delimiter == self.decimal:
            raise ValueError(f"decimal {self.decimal!r} must be '.' or ',' and differ from the one-character "
                             f"delimiter {self.delimiter!r}")
        named = (self.frequency, self.first, self.second)
        if len(set(named)) != 3:
            raise ValueError(f"frequency, first and second must be three columns, received {named}")
        if any(isinstance(name, int) and name < 1 for name in named):
            raise ValueError(f"columns are counted from 1, received {named}")


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

    ``negated = true`` in the quantity: the second column is minus the phase or imaginary part, as in -Im(Z).

    Raises:
        InputError: a missing or unknown key, or a value that ColumnMap or Quantity refuse.
    """
    table = Table.read(Path(path))
    quantity = Table.of(table.content.get("quantity"), source=table.source, field="quantity",
                        expected="a table with kind, form and unit")
    for each, kind in ((table, ColumnMap), (quantity, Quantity)):
        each.only([f.name for f in fields(kind)])
        for required in (f.name for f in fields(kind) if f.default is MISSING):
            if required not in each:
                raise each.error(required, "to be given")
    try:
        return ColumnMap(**{**table.content, "quantity": Quantity(**quantity.content)})
    except (TypeError, ValueError) as error:
        expected = f"a map such as\n\n{map_text(*EXAMPLE, {})}\n"
        raise InputError(str(path), "column map", str(error), expected) from error


def parse(text: RecordingText, columns: ColumnMap) -> Spectrum:
    """Read the file.

    Columns given by heading: the heading line is the first that holds all of them (a leading %, # or ! is
    ignored). Columns given by number: rows begin at the first line whose cells all look like numbers. Every line
    after that must be a row, apart from comment lines.

    The origin's setting :data:`READ_AS` says what each column was taken for.

    Raises:
        InputError: headings not found, a faulty row.
    """
    places, width, start = _locate(text, columns, [cells(uncommented(line), columns.delimiter) for line in text.lines])
    rows = table_rows(text, start, width=width, delimiter=columns.delimiter, decimal=columns.decimal)
    return spectrum(text, rows, columns, places=places, read_as=f"by a column map, {in_words(columns)}")


def uncommented(line: str) -> str:
    """A line without the sign of a comment that it may begin with."""
    return line.lstrip("%#! ") if line.startswith(COMMENTS) else line


def table_rows(text: RecordingText, start: int, *, width: int, delimiter: str, decimal: str) -> Rows:
    """The table of `width` columns in all lines from index `start` on, blank lines and comments left out.

    Raises:
        InputError: a row of another length, or a cell that is not a finite number.
    """
    block = [(index + 1, line) for index, line in enumerate(text.lines)
             if index >= start and line.strip() and not line.startswith(COMMENTS)]
    return numbers(text, block, delimiter=delimiter, columns=width, decimal=decimal)


def spectrum(text: RecordingText, rows: Rows, columns: ColumnMap, *, places: Sequence[int], read_as: str) -> Spectrum:
    """The spectrum in three columns of a table: `places` (from 0) of frequency, first and second.

    Raises:
        InputError: frequencies that do not rise, an impedance that is zero or infinite.
    """
    frequency = rows.values[:, places[0]] * UNITS["frequency"][columns.frequency_unit]
    check_frequencies(text, frequency, rows.lines, column=places[0] + 1)
    impedance = columns.quantity.impedance(rows.values[:, places[1]], rows.values[:, places[2]])
    check_impedance(text, impedance, rows.lines)
    settings = {READ_AS: " ".join(read_as.split())}
    return Spectrum(frequency, impedance, None, Origin("measured", text.path, text.sha256, settings=settings))


def in_words(columns: ColumnMap, notes: Mapping[str | int, str] = MappingProxyType({})) -> str:
    """What every column of a map is taken for, with its unit and sign; `notes` by column say why."""
    quantity = columns.quantity
    symbol = {"impedance": "Z", "admittance": "Y", "gain": "the gain"}[quantity.kind]
    parts = ("magnitude", "phase") if quantity.form == "polar" else ("real part", "imaginary part")
    unit = {"dB": "dB of one " + {"impedance": "ohm", "admittance": "siemens", "gain": ""}[quantity.kind],
            "1": "no unit"}.get(quantity.unit, quantity.unit).removesuffix(" of one ")
    units = (columns.frequency_unit, unit, quantity.phase_unit if quantity.form == "polar" else unit)
    meanings = ("the frequency", f"the {parts[0]} of {symbol}",
                f"{'minus ' if quantity.negated else ''}the {parts[1]} of {symbol}")
    found = []
    for name, meaning, its in zip((columns.frequency, columns.first, columns.second), meanings, units, strict=True):
        called = f'"{name}"' if isinstance(name, str) else f"column {name}"
        found.append(f"{called} is {meaning} in {its}" + (f" ({notes[name]})" if name in notes else ""))
    if quantity.reference_resistance is not None:
        both, resistor = "the voltage across both", f"that across {quantity.reference_resistance:g} ohm"
        found.append(f"the gain is {both} over {resistor}" if quantity.inverse else f"the gain is {resistor} over "
                     f"{both}")
    else:
        sign = "negative" if (quantity.kind == "impedance") != quantity.negated else "positive"
        found.append(f"of a capacitor the last is {sign}")
    delimiter = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks"}.get(
        columns.delimiter, repr(columns.delimiter))
    found.append(f"columns divided by {delimiter}, decimal {'comma' if columns.decimal == ',' else 'point'}")
    return "; ".join(found)


def map_text(fields_: Mapping[str, object], quantity: Mapping[str, object], doubts: Mapping[str, str]) -> str:
    """The text of a column map for :func:`read_column_map`; `doubts` by key become comments beside it."""
    lines = []
    for content, head in ((fields_, ""), (quantity, "[quantity]")):
        lines += [head] if head else []
        for key, value in content.items():
            line = f"{key} = {json.dumps(value, ensure_ascii=False)}"
            lines.append(f"{line:<35} # {doubts[key]}" if key in doubts else line)
    return "\n".join(lines)


def _locate(text: RecordingText, columns: ColumnMap, split: list[list[str]]) -> tuple[list[int], int, int]:
    """Places of the three columns (from 0), number of columns, and index of the first line of rows."""
    wanted = (columns.frequency, columns.first, columns.second)
    headings = [name for name in wanted if isinstance(name, str)]
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
        places = [split[found].index(name) if isinstance(name, str) else name - 1 for name in wanted]
        width, start = len(split[found]), found + 1
    else:
        places = [int(name) - 1 for name in wanted]
        start = next((index for index, row in enumerate(split) if len(row) > 1 and all(
            cell.lstrip("+-.")[:1].isdigit() for cell in row)), len(split))
        if start == len(split):
            raise InputError(text.path, "rows", text.lines[0], f"rows of numbers separated by {columns.delimiter!r}")
        width = len(split[start])
    if max(places) >= width:
        raise text.error(min(start + 1, len(split)), None, f"{width} columns", f"at least {max(places) + 1} columns")
    return places, width, start
