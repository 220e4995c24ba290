"""The text of a recording: loaded once, with its digest, and turned into numbers with loud complaints."""

from __future__ import annotations

import csv
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError, nearest_names
from workbench.instruments.waveform_table import recognised

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")


@dataclass(frozen=True)
class RecordingText:
    """The lines of a recording (without their ends), the path as given and the SHA-256 of the bytes."""

    path: str
    lines: tuple[str, ...]
    sha256: str

    def error(self, line: int, column: int | None, value: object, expected: str) -> InputError:
        """The complaint about one place; `line` and `column` count from one."""
        place = f"line {line}" if column is None else f"line {line}, column {column}"
        return InputError(self.path, place, value, expected)


@dataclass(frozen=True)
class Rows:
    """A table of numbers: ``values`` (n, columns) and the line of the file, from one, on which each row stands."""

    values: NDArray[np.float64]
    lines: tuple[int, ...]


def load(path: Path) -> RecordingText:
    """The text of a recording.

    Instruments write ASCII, UTF-8 or Latin-1 (the degree sign); either line end is accepted.

    Raises:
        InputError: the file is missing, unreadable, empty or binary.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        folder = path.parent if path.parent.is_dir() else Path()
        near = nearest_names(path.name, (entry.name for entry in folder.iterdir() if entry.is_file()))
        raise InputError(str(path), "file", path.name, "an existing file", near) from None
    except OSError as error:
        raise InputError(str(path), "file", path.name, f"a readable file ({error.strerror})") from None
    if not data.strip():
        raise InputError(str(path), "file", f"{len(data)} bytes", "a recording; this file is empty")
    strange = sum(byte < 32 and byte not in b"\t\n\r\f" for byte in data[:65536])
    # A waveform in a Tektronix .ISF file is binary behind a text header; it deserves its own name.
    if strange and data[:8].upper().startswith((b":WFMP", b"WFMP")):
        raise _waveform(str(path), data[:40].decode("latin-1"))
    if strange:
        raise InputError(str(path), "file", data[:16], "a text file; this one is binary (or UTF-16 from a spreadsheet)")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return RecordingText(str(path), tuple(text.splitlines()), hashlib.sha256(data).hexdigest())


def refuse_waveform(text: RecordingText) -> None:
    """Raise if the file is a Tektronix oscilloscope waveform: voltage against time, not a spectrum."""
    if maker := recognised(text.lines):
        raise InputError(text.path, "format", maker, "an impedance spectrum; `workbench import FILE ... --resistance "
                         "R` makes one of a capture at every frequency, R being the resistor in series with the device")
    for line in text.lines[:4]:
        if line.startswith(("Record Length,", "Sample Interval,")) or line.upper().startswith((":WFMP", "WFMP")):
            raise _waveform(text.path, line[:40])


def _waveform(path: str, value: str) -> InputError:
    return InputError(path, "format", value, "an impedance spectrum; this is an oscilloscope waveform (Tektronix)")


def cells(line: str, delimiter: str) -> list[str]:
    """The cells of a line without blanks, quotes, or the empty cells that trailing tabs and spreadsheets leave.

    A delimiter within quotes divides nothing, a quotation mark within a cell (Z" is an imaginary part) is a part of
    it, and any number of blanks is one delimiter.
    """
    line = line.strip(" ")
    if line.count('"') == 2 and line.startswith('"') and line.endswith('"'):
        line = line[1:-1]
    if '"' in line and line.count('"') % 2 == 0:
        found = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    else:
        found = line.split() if delimiter == " " else line.split(delimiter)
    found = [_unquoted(cell.strip()) for cell in found]
    while len(found) > 1 and not found[-1]:
        found.pop()
    return found


def _unquoted(cell: str) -> str:
    return cell[1:-1].strip() if len(cell) > 1 and cell.startswith('"') and cell.endswith('"') else cell


def number(text: RecordingText, line: int, column: int, *, cell: str, decimal: str = ".") -> float:
    """The number in one cell.

    Raises:
        InputError: the cell holds no number, NaN or infinity, or a decimal comma where none was declared.
    """
    plain = cell.replace(",", ".") if decimal == "," else cell
    if _NUMBER.fullmatch(plain):
        value = float(plain)
        if np.isfinite(value):
            return value
    if cell.casefold().lstrip("+-") in ("nan", "inf", "infinity") or _NUMBER.fullmatch(plain):
        raise text.error(line, column, cell, "a finite number")
    if _DECIMAL_COMMA.fullmatch(cell):
        raise text.error(line, column, cell, "a number with a decimal point; this one has a decimal comma")
    raise text.error(line, column, cell, "a number" if cell else "a number; this cell is empty")


def numbers(
    text: RecordingText,
    numbered: Sequence[tuple[int, str]],
    *,
    delimiter: str,
    columns: int,
    decimal: str = ".",
) -> Rows:
    """The table in the lines `numbered` (pairs of line number and line), each with exactly `columns` cells.

    Raises:
        InputError: a row of another length, or a cell that is not a finite number.
    """
    values = np.empty((len(numbered), columns))
    for index, (line, content) in enumerate(numbered):
        row = cells(content, delimiter)
        if delimiter == "," and ";" in content:
            raise text.error(line, None, content, "commas between columns and decimal points; semicolons and decimal "
                             "commas are a spreadsheet's rewriting: use the instrument's own file, or --columns "
                             "MAP.toml")
        if len(row) != columns:
            raise text.error(line, None, content, f"{columns} columns; this row has {len(row)}")
        for column, cell in enumerate(row):
            values[index, column] = number(text, line, column + 1, cell=cell, decimal=decimal)
    return Rows(values, tuple(line for line, _ in numbered))


def check_frequencies(
    text: RecordingText, frequency: NDArray[np.float64], lines: Sequence[int], *, column: int
) -> None:
    """Raise unless `frequency` (n,) Hz has two points or more and is positive and strictly increasing."""
    if len(frequency) < 2:
        where = lines[0] if lines else len(text.lines)
        raise text.error(where, None, f"{len(frequency)} rows of numbers", "at least 2; the file may be cut short")
    for index, value in enumerate(frequency):
        if value <= 0.0:
            raise text.error(lines[index], column, float(value), "a frequency above zero")
        if index and value == frequency[index - 1]:
            raise text.error(lines[index], column, float(value),
                             f"a new frequency; line {lines[index - 1]} has the same")
        if index and value < frequency[index - 1]:
            turns = "the sweep runs downwards" if np.all(np.diff(frequency) < 0) else (
                "the frequencies are out of order, or an upward sweep is followed by another sweep")
            raise text.error(lines[index], column, float(value),
                             f"more than the {frequency[index - 1]:.12g} Hz before it; {turns}")


def check_impedance(text: RecordingText, impedance: NDArray[np.complex128], lines: Sequence[int]) -> None:
    """Raise where `impedance` (n,) ohm is zero or not finite."""
    wrong = ~np.isfinite(impedance) | (impedance == 0.0)
    if np.any(wrong):
        index = int(np.argmax(wrong))
        raise text.error(lines[index], None, f"{impedance[index]} ohm", "an impedance neither zero nor infinite")
