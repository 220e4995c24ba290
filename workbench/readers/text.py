"""The text of a recording, and its cells and numbers."""

from __future__ import annotations

import codecs
import csv
import hashlib
import math
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from workbench.files.errors import InputError, file_error, nearest_files
from workbench.instruments.waveform_table import recognised
from workbench.results.spectrum import Origin

#: The setting of an origin that states the meaning of the columns of a table.
READ_AS = "read as"

#: Least size of a number that stands for no value: instruments write 9.9e37 (SCPI: 9.91e37, not a number) for overload
#: and for a point that was not measured. Doubled, it is read as ohms.
NO_VALUE = 9.9e37
#: Words that instruments, programs and spreadsheets write for the same.
_NO_VALUE = re.compile(r"[+-]?(nan|inf|infinity|1\.#(inf|qnan|ind)|ol|ov(er)?(ld|l|f|r|load|flow|range)|over)|"
                       r"n/?a|#n/a|#num!|#div/0!|-{2,}", re.IGNORECASE)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
#: Signs at the beginning of a line that is no row.
COMMENTS = ("%", "#", "!")

#: Encodings by the byte-order mark that declares them; the marks of UTF-32 begin as those of UTF-16 do.
_BYTE_ORDER_MARKS = ((codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF32_BE, "utf-32"), (codecs.BOM_UTF16_LE, "utf-16"),
                     (codecs.BOM_UTF16_BE, "utf-16"))
#: Encodings without a mark, of Western Europe and of East Asia.
_ENCODINGS = ("cp1252", "shift_jis", "gbk")
#: Letters beyond ASCII that headings need: a text of these, of Latin letters and of those of East Asia was decoded
#: rightly. The first byte of a Greek letter in Shift-JIS looks like the hooked f.
_EXPECTED = frozenset("°ºΩΩµμθϑΘφϕΦ∠δγ²³′″−–’“”±×·…®©«» ")
_STRANGE_LATIN = "ƒ"
_EAST_ASIAN = 0x2E80

_REAL = r"(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?"
#: A complex number, with its imaginary unit before or after the second part.
_COMPLEX = re.compile(
    rf"(?:\( *)?((?:[+-] *)?{_REAL}) *([+-]) *(?:[ijIJ] *\*? *({_REAL})|({_REAL}) *\*? *[ijIJ])(?: *\))?(?![\w.])")
#: A complex number as a pair in brackets. After a letter, brackets hold the ports of S(1,1).
_BRACKETED = re.compile(rf"(?<![\w'\"])\(\s*([+-]?{_REAL})\s*[,;]\s*([+-]?{_REAL})\s*\)")
_PORTS = re.compile(r"(?<=[A-Za-z])\((\d),(\d)\)")
_WRITTEN = re.compile(rf"([+-]?{_REAL})([+-]{_REAL})j")
#: Stands for the comma of "S(1,1)" while a line is divided (private use area of Unicode).
_COMMA_OF_PORTS = "\ue000"


@dataclass(frozen=True)
class RecordingText:
    """The lines of a recording, its path, the SHA-256 of its bytes.

    ``ended`` if the last line has an end; ``row`` is the word for a line, which in a table turned over is a column.
    """

    path: str
    lines: tuple[str, ...]
    sha256: str
    ended: bool = True
    row: str = "line"

    def error(self, line: int, column: int | None, value: object, expected: str) -> InputError:
        """The error about one place; `line` and `column` count from one."""
        place = f"{self.row} {line}" if column is None or self.row != "line" else f"line {line}, column {column}"
        return InputError(self.path, place, value, expected)


    def origin(
        self, instrument: str = "", date: str = "", *, read_as: str = "",
        settings: Mapping[str, str] = MappingProxyType({}),
    ) -> Origin:
        """The origin of a measured spectrum; `read_as` explains its columns."""
        meaning = {READ_AS: " ".join(read_as.split())} if read_as else {}
        return Origin("measured", self.path, self.sha256, instrument, date, {**meaning, **settings})


def load_text(path: Path) -> RecordingText:
    """The text of a recording.

    A byte-order mark declares UTF-8, UTF-16 or UTF-32. Without one the text is UTF-8 or else of the first encoding that
    makes sense of its letters beyond ASCII (the degree and ohm signs). Either line end is accepted.

    Raises:
        InputError: the file is missing, unreadable, empty or binary.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        near = nearest_files(path, Path.is_file)
        raise file_error(path, "an existing file", near) from None
    except OSError as error:
        raise file_error(path, f"a readable file ({error.strerror})") from None
    # A waveform in a Tektronix .ISF file is binary after a text header; it deserves its own message.
    if _is_binary(data) and data[:8].upper().startswith((b":WFMP", b"WFMP")):
        raise _waveform(str(path), data[:40].decode("latin-1"))
    text = _decoded(data)
    if text is None:
        raise InputError(str(path), "file", data[:16], "a text file; this one is binary")
    if not text.strip():
        raise InputError(str(path), "file", f"{len(data)} bytes", "a recording; this file is empty")
    lines = re.split(r"\r\n|[\r\n\f]", text)
    ended = not lines[-1]
    return RecordingText(str(path), tuple(lines[:-1] if ended else lines), hashlib.sha256(data).hexdigest(), ended)


def _is_binary(data: bytes) -> bool:
    """Whether the bytes hold control characters that no text has."""
    return any(byte < 32 and byte not in b"\t\n\r\f" for byte in data[:65536])


def _decoded(data: bytes) -> str | None:
    """The text that the bytes hold; None if they hold none."""
    for mark, encoding in _BYTE_ORDER_MARKS:
        if data.startswith(mark):
            # A file cut short may end with half a character.
            return data.decode(encoding, errors="ignore")
    if _is_binary(data):
        # Without a mark every other byte of UTF-16 is zero, since instruments write ASCII nearly throughout.
        for encoding, zeros in (("utf-16-le", data[1::2]), ("utf-16-be", data[::2])):
            if len(zeros) > 8 and zeros.count(0) > 0.9 * len(zeros):
                text = data.decode(encoding, errors="ignore")
                return None if _is_binary(text.encode("utf-8")) else text
        return None
    for encoding in ("utf-8-sig", *_ENCODINGS):
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if encoding == "utf-8-sig" or all(map(_is_expected, set(text))):
            return text
    return data.decode("latin-1")


def _is_expected(letter: str) -> bool:
    """Whether a letter is one that recordings hold."""
    latin = unicodedata.name(letter, "").startswith("LATIN") and letter not in _STRANGE_LATIN
    return letter.isascii() or letter in _EXPECTED or latin or ord(letter) >= _EAST_ASIAN


def refuse_waveform(text: RecordingText) -> None:
    """Raise if the file is a waveform of an oscilloscope, no spectrum."""
    if maker := recognised(text.lines):
        raise InputError(text.path, "format", maker, "an impedance spectrum; `workbench import FILE ... --resistance "
                         "R` makes one of a capture at every frequency, R being the resistor in series with the device "
                         "(--current N: the channel of a current probe)")
    for line in text.lines[:4]:
        if line.startswith(("Record Length,", "Sample Interval,")) or line.upper().startswith((":WFMP", "WFMP")):
            raise _waveform(text.path, line[:40])


def _waveform(path: str, value: str) -> InputError:
    return InputError(path, "format", value, "an impedance spectrum; this is an oscilloscope waveform (Tektronix): "
                      "workbench import makes an impedance of such files")


# --------------------------------------------------------------------------------------------------------------------
# Cells and numbers.


def uncommented(line: str) -> str:
    """A line without a leading comment sign."""
    return line.lstrip("%#! ") if line.startswith(COMMENTS) else line


def cells(line: str, delimiter: str) -> list[str]:
    """The cells of a line, without blanks, quotes and empty last ones.

    A delimiter within quotes divides nothing, a quotation mark within a cell (Z" is an imaginary part) is a part of it,
    and any number of blanks is one delimiter. A complex number is one cell, however it is written: "3.3-52.6j",
    "(3.3,-52.6)" and "3.3 - i52.6" become "3.3-52.6j".
    """
    line = line.strip(" ")
    if "(" in line:
        line = _PORTS.sub(rf"(\1{_COMMA_OF_PORTS}\2)", line)
        line = _BRACKETED.sub(lambda found: _written(found[1], found[2]), line)
    if re.search("[ijIJ]", line):
        line = _COMPLEX.sub(lambda found: _written(found[1], found[2] + (found[3] or found[4])), line)
    if line.count('"') == 2 and line.startswith('"') and line.endswith('"'):
        line = line[1:-1]
    if '"' in line and line.count('"') % 2 == 0:
        found = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    else:
        found = line.split() if delimiter == " " else line.split(delimiter)
    found = [_unquoted(cell.strip()).replace(_COMMA_OF_PORTS, ",") for cell in found]
    while len(found) > 1 and not found[-1]:
        found.pop()
    return found


def _written(real: str, imaginary: str) -> str:
    """A complex number in the form of :data:`_WRITTEN`."""
    imaginary = imaginary.replace(" ", "")
    return f"{real.replace(' ', '')}{imaginary if imaginary[0] in '+-' else '+' + imaginary}j"


def _unquoted(cell: str) -> str:
    return cell[1:-1].strip() if len(cell) > 1 and cell.startswith('"') and cell.endswith('"') else cell


def complex_parts(cell: str) -> tuple[str, str] | None:
    """Both parts of a complex number as :func:`cells` writes it, or None."""
    found = _WRITTEN.fullmatch(cell)
    return None if found is None else (found[1], found[2])


def _plain(cell: str, decimal: str) -> str:
    return cell.replace(",", ".") if decimal == "," else cell


def is_number(cell: str, decimal: str = ".") -> bool:
    """Whether a cell holds a real number."""
    return _NUMBER.fullmatch(_plain(cell, decimal)) is not None


def is_cell(cell: str) -> bool:
    """Whether a cell holds a number, real or complex."""
    return is_number(cell, ",") or complex_parts(cell) is not None


def value_of(cell: str, decimal: str = ".") -> float | None:
    """The number in a cell, NaN for no value, None for text.

    A code for no value is a word, or a number of :data:`NO_VALUE` or more.
    """
    if is_number(cell, decimal):
        number = float(_plain(cell, decimal))
        return number if abs(number) < NO_VALUE else math.nan
    return math.nan if _NO_VALUE.fullmatch(cell) else None


def holds_no_value(cell: str, decimal: str = ".") -> bool:
    """Whether a cell holds a code for no value."""
    value = value_of(cell, decimal)
    return value is not None and math.isnan(value)


def cell_number(text: RecordingText, line: int, column: int, *, cell: str, decimal: str = ".") -> float:
    """The number in one cell, NaN for a code of no value.

    Raises:
        InputError: the cell holds no number, or an undeclared decimal comma.
    """
    value = value_of(cell, decimal)
    if value is not None:
        return value
    if _DECIMAL_COMMA.fullmatch(cell):
        raise text.error(line, column, cell, "a number with a decimal point; this one has a decimal comma")
    raise text.error(line, column, cell, "a number" if cell else "a number; this cell is empty")
