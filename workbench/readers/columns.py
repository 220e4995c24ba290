"""Any other table of text, once its columns have been named by a :class:`ColumnMap`.

Nothing is guessed: what the columns are, their units and, for a gain, the reference resistor and which way up the
ratio is, are said by the person who knows the set-up.
"""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from pathlib import Path

from inputs import UNITS, InputError, nearest_names, read_toml, refuse_unknown_keys
from workbench.readers.quantities import Quantity
from workbench.readers.text import RecordingText, cells, check_frequencies, check_impedance, numbers
from workbench.spectrum import Origin, Spectrum


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


def read_column_map(path: Path) -> ColumnMap:
    """A column map from a TOML file: the fields of :class:`ColumnMap`, with ``quantity`` a table of those of Quantity.

    ::

        frequency = "Freq"          # a heading, or the number of the column from 1
        first = "|Z|"
        second = "angle"
        frequency_unit = "kHz"
        quantity = { kind = "impedance", form = "polar", unit = "ohm", phase_unit = "deg" }

    Raises:
        InputError: a missing or unknown key, or a value that ColumnMap or Quantity refuse.
    """
    table = read_toml(path)
    quantity = table.get("quantity")
    if not isinstance(quantity, dict):
        raise InputError(str(path), "quantity", quantity, "a table with kind, form and unit")
    for content, kind, place in ((table, ColumnMap, ""), (quantity, Quantity, "quantity")):
        refuse_unknown_keys(content, [f.name for f in fields(kind)], source=str(path), field=place)
        for required in (f.name for f in fields(kind) if f.default is MISSING):
            if required not in content:
                raise InputError(str(path), f"{place}.{required}".lstrip("."), None, "to be given")
    try:
        return ColumnMap(**{**table, "quantity": Quantity(**quantity)})
    except (TypeError, ValueError) as error:
        expected = "a map that fits; see workbench.readers.ColumnMap"
        raise InputError(str(path), "column map", str(error), expected) from error


def parse(text: RecordingText, columns: ColumnMap) -> Spectrum:
    """Read the file.

    Columns given by heading: the heading line is the first that holds all of them (a leading %, # or ! is
    ignored). Columns given by number: rows begin at the first line whose cells all look like numbers. Every line
    after that must be a row, apart from comment lines.

    Raises:
        InputError: headings not found, a faulty row.
    """
    split = [cells(line.lstrip("%#! ") if line.startswith(("%", "#", "!")) else line, columns.delimiter)
             for line in text.lines]
    places, width, start = _locate(text, columns, split)
    block = [(index + 1, line) for index, line in enumerate(text.lines)
             if index >= start and line.strip() and not line.startswith(("%", "#", "!"))]
    rows = numbers(text, block, delimiter=columns.delimiter, columns=width, decimal=columns.decimal)
    frequency = rows.values[:, places[0]] * UNITS["frequency"][columns.frequency_unit]
    check_frequencies(text, frequency, rows.lines, column=places[0] + 1)
    impedance = columns.quantity.impedance(rows.values[:, places[1]], rows.values[:, places[2]])
    check_impedance(text, impedance, rows.lines)
    settings = {"columns": repr(columns)}
    return Spectrum(frequency, impedance, None, Origin("measured", text.path, text.sha256, settings=settings))


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
