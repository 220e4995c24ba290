"""Makers' files: where their tables are. The headings of a table give the meaning of its columns.

Layouts: Keysight's "Save Trace Data"; Gamry's DTA and ZPlot's .z as in the samples of impedance.py (ECSHackWeek),
EC-Lab's .mpt as in those and in yadg's documentation; Bode Analyzer Suite and Hioki IM3570/IM3536 as their users
publish them; HP's 4294A and Zurich Instruments' LabOne, whose columns stand below each other.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from workbench.files.errors import InputError
from workbench.readers.columns import ColumnMap, recorded
from workbench.readers.findings import Finding
from workbench.readers.headed import parse_headed
from workbench.readers.headings import understand
from workbench.readers.quantities import RecordedQuantity
from workbench.readers.sweep import Reading
from workbench.readers.tables import Table, find_table
from workbench.readers.text import RecordingText, cells, holds_no_value, is_cell


@dataclass(frozen=True)
class Maker:
    """A maker's file: how to recognise it, and where its tables are.

    The pattern ``sign`` is on one of its first ``lines``. A table stands below a line with the pattern ``above`` (of
    which one is ``such_as``), and above the line ``end`` ("": it goes to the end of the file). Without ``above`` it is
    found by its headings. Lines with an exclamation mark name the instrument and the date.
    """

    name: str
    sign: str
    lines: int
    above: str = ""
    such_as: str = ""
    end: str = ""

    def recognises(self, text: RecordingText) -> bool:
        """Whether a text is of this maker."""
        return any(re.search(self.sign, line) for line in text.lines[:self.lines]) and (
            bool(self.end) or find_table(text) is not None)

    def parse(self, text: RecordingText) -> Reading:
        """Read the first table with an impedance; a finding compares the others.

        Raises:
            InputError: no table of this maker, one that is cut short, or headings that leave a doubt.
        """
        bare = [line.strip().rstrip(",;\t").strip() for line in text.lines]
        above = [index for index, line in enumerate(bare) if re.match(self.above, line)] if self.above else [-1]
        if not above:
            raise text.error(len(bare), None, bare[-1][:80], f"a line such as {self.such_as!r} above the table of a "
                             f"{self.name} file")
        return first_of("channel", [(bare[begin].removeprefix("BEGIN "), _tried(self._table, text, bare, begin))
                                    for begin in (above if self.end else above[:1])])

    def _table(self, text: RecordingText, bare: Sequence[str], begin: int) -> Reading:
        """The table below the line index `begin`; its lines keep their numbers."""
        if self.end and self.end not in bare[begin:]:
            raise text.error(len(bare), None, bare[-1], f"a last line {self.end!r}; the file is cut short")
        end = bare.index(self.end, begin) if self.end else len(bare)
        notes = [line[1:].strip() for line in bare[:max(begin, 0)] if line.startswith("!")]
        dates = [note.removeprefix("Date:").strip() for note in notes if note.startswith("Date:")]
        names = [note for note in notes if not note.startswith("Date:")]
        return parse_headed(replace(text, lines=tuple(line if begin < index < end else ""
                                                      for index, line in enumerate(text.lines))),
                            instrument=[*names, self.name][0], date=[*dates, ""][0])


MAKERS: Mapping[str, Maker] = {
    "e4990a": Maker("Keysight/Agilent E4990A", r"^!.*E4990A|^BEGIN CH", 10, "BEGIN ", "BEGIN CH1_DATA", "END"),
    "bode100": Maker("Omicron Lab Bode 100", r"(?i)bode ?(100|500|analyzer)", 30),
    "gamry": Maker("Gamry", r"EXPLAIN\b", 3, r"Z\w*CURVE\s+TABLE", "ZCURVE TABLE"),
    "biologic": Maker("BioLogic EC-Lab", r"(BT|EC)-Lab ASCII FILE", 3),
    "zplot": Maker("Scribner ZPlot", r"(?i)\"?(ZPLOT2? ASCII|ZPlotW? Data File|ZView|Z60W Data File)", 3),
    "hioki": Maker("Hioki", r"(?i)hioki|\bIM3(5[37]\d|590)", 20),
}


def _tried(parse: Callable[..., Reading], *arguments: object) -> Reading | InputError:
    """The recording that a function reads, or its error."""
    try:
        return parse(*arguments)
    except InputError as error:
        return error


def first_of(word: str, read: Sequence[tuple[str, Reading | InputError]]) -> Reading:
    """The first recording of a file that could be read.

    A finding compares the others, each called a `word`, with it.

    Raises:
        InputError: none could be read.
    """
    found = [(name, each) for name, each in read if isinstance(each, Reading)]
    if not found:
        raise next(each for _, each in read if isinstance(each, InputError))
    name, first = found[0]
    if len(read) == 1:
        return first
    said = [f"{len(read)} {word}s: {name} was read, not {', '.join(other for other, _ in read if other != name)}"]
    for other, each in found[1:]:
        share = first.share_apart(each)
        said.append(f"{other} differs from it by {100.0 * share:.2g} % (rms)" if np.isfinite(share) else
                    f"{other} has other frequencies")
    said.append(f"to read another, take the lines of {name} out of a copy of the file")
    return replace(first, findings=(*first.findings, Finding(f"{word}s", "; ".join(said))))


# --------------------------------------------------------------------------------------------------------------------
# HP/Agilent 4294A, ASCII save: a quoted header, then trace A as a whole table and trace B as a second one below it.
# Each row is frequency, real, imaginary (imaginary zero, since both traces are real numbers). With a stored memory
# trace there are two more columns of an older sweep, which must not be taken for the data.

PARAMETERS: Mapping[str, RecordedQuantity] = {
    f"{kind} {words}": RecordedQuantity(kind.casefold(), form, unit, phase_unit)
    for kind, unit in (("IMPEDANCE", "ohm"), ("ADMITTANCE", "S")) for words, form, phase_unit in (
        ("MAG PHASE (DEG)", "polar", "deg"), ("MAG PHASE (RAD)", "polar", "rad"), ("REAL IMAG", "rectangular", "deg"))}
_COLUMNS = ("Frequency", "Data Trace Real", "Data Trace Imag")
_MEMORY_COLUMNS = ("Memory Trace Real", "Memory Trace Imag")


def recognises_hp4294a(text: RecordingText) -> bool:
    """Whether the first line names the analyser."""
    return text.lines[0].lstrip('"').startswith("4294A")


def parse_hp4294a(text: RecordingText) -> Reading:
    """Read the file.

    Raises:
        InputError: a parameter or sweep that is no impedance against frequency, a trace that is missing or shorter
            than the header declares, traces on different frequencies, or a faulty row.
    """
    bare = [line.strip().strip('"').strip() for line in text.lines]
    header: dict[str, tuple[str, int]] = {}
    for line, (key, colon, value) in enumerate((content.partition(":") for content in bare), 1):
        if key.startswith("Frequency"):
            break
        if colon:
            header[key.strip()] = (value.strip(), line)
    known = {"MEASURE PARAMETER": ("one of " + ", ".join(PARAMETERS), lambda value: _spelling(value) in PARAMETERS),
             "SWEEP TYPE": ("a sweep of frequency", lambda value: "FREQ" in value.upper()),
             "NUMBER of POINTS": ("a whole number of points", str.isdigit)}
    for key, (expected, holds) in known.items():
        if key not in header:
            raise text.error(len(bare), None, "end of the header", f'a line "{key}: ..."')
        if not holds(header[key][0]):
            raise text.error(header[key][1], None, header[key][0], expected)
    first, second = (_trace(text, bare, name, int(header["NUMBER of POINTS"][0])) for name in "AB")
    (one, real), (other, imaginary) = (_real(trace) for trace in (first, second))
    if np.any(one != other):
        index = int(np.argmax(one != other))
        raise text.error(second.lines[index], 1, float(other[index]), f"the frequency of trace A, {one[index]:.12g} Hz "
                         f"(line {first.lines[index]})")
    settings = {key.lower(): value for key, (value, _) in header.items() if key not in ("DATE", "TRACE", "FORMAT")}
    origin = text.origin(text.lines[0].strip().strip('"'), header.get("DATE", ("", 0))[0], settings=settings)
    columns = ColumnMap(1, 2, 3, PARAMETERS[_spelling(header["MEASURE PARAMETER"][0])])
    return recorded(replace(first, text=text), columns, [one, real, imaginary], 0, origin)


def _spelling(parameter: str) -> str:
    return re.sub(r"\s*\(\s*", " (", parameter.upper())


def _trace(text: RecordingText, bare: Sequence[str], name: str, declared: int) -> Table:
    """The table of trace `name`, with as many points as `declared`."""
    if f"TRACE: {name}" not in bare:
        raise text.error(len(bare), None, bare[-1], f'"TRACE: {name}"; the file is cut short')
    place = bare.index(f"TRACE: {name}")
    start = next((index for index in range(place, len(bare)) if bare[index].startswith("Frequency")), None)
    if start is None:
        raise text.error(len(bare), None, bare[-1], f"the table of trace {name}; the file is cut short")
    names = tuple(cells(text.lines[start], "\t"))
    if names not in (_COLUMNS, _COLUMNS + _MEMORY_COLUMNS):
        raise text.error(start + 1, None, text.lines[start],
                         ", ".join(_COLUMNS) + " and, with a memory trace, " + ", ".join(_MEMORY_COLUMNS))
    end = next((index for index in range(start + 1, len(bare)) if not bare[index] or bare[index].startswith("TRACE:")),
               len(bare))
    if end - start - 1 != declared:
        raise text.error(end, None, f"{end - start - 1} rows in trace {name}",
                         f"the {declared} points the header declares")
    alone = replace(text, lines=text.lines[:end])
    return Table(alone, names, start, start + 1, "\t", len(names), comments=()).with_rows(0, ".", strict=True)


def _real(trace: Table) -> tuple[np.ndarray, np.ndarray]:
    """Frequency and value (n,) of a trace, whose imaginary part is zero."""
    frequency, real, imaginary = trace.numbers((0, 1, 2))
    wrong = np.nan_to_num(imaginary) != 0.0
    if np.any(wrong):
        index = int(np.argmax(wrong))
        raise trace.text.error(trace.lines[index], 3, float(imaginary[index]), "zero: a magnitude, phase, real or "
                               "imaginary trace is real")
    return frequency, real


# --------------------------------------------------------------------------------------------------------------------
# Zurich Instruments' LabOne: ``chunk;timestamp;size;fieldname`` and then the values of that field, one line per field
# and sweep: ``frequency`` (or ``grid``), ``realz`` and ``imagz``, ``absz`` and ``phasez`` in radians, and further ones
# that are not needed. A point that was not measured is ``nan``.

#: Quantities by the pair of fields that hold an impedance.
FIELDS: Mapping[tuple[str, str], RecordedQuantity] = {
    ("realz", "imagz"): RecordedQuantity("impedance", "rectangular", "ohm"),
    ("absz", "phasez"): RecordedQuantity("impedance", "polar", "ohm", "rad"),
}


def _labone_delimiter(text: RecordingText) -> str:
    """The delimiter of a LabOne file; "" for any other file."""
    head = next((line for line in text.lines if line.strip()), "").casefold().replace(" ", "")
    return next((mark for mark in ";,\t" if head.startswith(f"chunk{mark}timestamp{mark}size{mark}fieldname")), "")


def recognises_labone(text: RecordingText) -> bool:
    """Whether the first line is that of a LabOne sweep."""
    return bool(_labone_delimiter(text))


def parse_labone(text: RecordingText) -> Reading:
    """Read the first sweep; a finding compares the others.

    Raises:
        InputError: no LabOne file; fields that are no impedance against frequency, or are of different length.
    """
    delimiter = _labone_delimiter(text)
    if not delimiter:
        raise text.error(1, None, text.lines[0][:80], "a line that begins with chunk;timestamp;size;fieldname")
    chunks: dict[str, dict[str, tuple[int, list[str]]]] = {}
    for line, content in enumerate(text.lines, 1):
        row = cells(content, delimiter)
        if len(row) > 4 and row[0].isdigit():
            chunks.setdefault(row[0], {})[row[3].casefold()] = (line, row[4:])
    if not chunks:
        raise text.error(len(text.lines), None, text.lines[-1][:80], "a line of values behind the first one")
    return first_of("sweep", [(f"sweep {name}", _tried(_chunk, text, name, fields)) for name, fields in chunks.items()])


def _chunk(text: RecordingText, name: str, fields: Mapping[str, tuple[int, list[str]]]) -> Reading:
    """One sweep of the file."""
    pair = next((pair for pair in FIELDS if set(pair) <= set(fields)), None)
    frequency = next((field for field in ("frequency", "grid") if field in fields), None)
    if pair is None or frequency is None:
        raise InputError(text.path, f"chunk {name}", ", ".join(fields), "the fields frequency, and realz with imagz or "
                         "absz with phasez: a sweep of the impedance analyser over frequency")
    names = (frequency, *pair)
    sizes = sorted({len(fields[field][1]) for field in names})
    if len(sizes) > 1:
        raise text.error(fields[frequency][0], None, " and ".join(map(str, sizes)) + " values", f"as many of {pair[0]} "
                         f"and {pair[1]} as of {frequency}; the file may be cut short")
    # The last cell of a line may be an empty one.
    points = tuple(zip(*([cell or "nan" for cell in fields[field][1]] for field in names), strict=True))
    table = Table(replace(text, row="value"), names, 0, 0, "\t", 3, cells=points, lines=tuple(range(1, sizes[0] + 1)))
    one, two, three = table.numbers((0, 1, 2))
    quantity = FIELDS[pair]
    unit = f"rad; the phase of Z is {pair[1]}" if quantity.form == "polar" else "ohm"
    read_as = f"as a LabOne sweep, lines {frequency} in Hz, {pair[0]} and {pair[1]} in {unit}"
    # The frequency of a point that was not measured may be missing too.
    return recorded(table, ColumnMap(1, 2, 3, quantity), [one, two + 0.0 * one, three], 0,
                    text.origin("Zurich Instruments, LabOne", read_as=read_as))


# --------------------------------------------------------------------------------------------------------------------
# Any table with one quantity per line.


def recognises_lines(text: RecordingText) -> bool:
    """Whether the lines are columns: each a heading and then numbers."""
    return _turned(text) is not None


def parse_lines(text: RecordingText) -> Reading:
    """Read a table whose lines are its columns.

    Raises:
        InputError: no such table, or headings that leave a doubt.
    """
    turned = _turned(text)
    if turned is None:
        raise text.error(1, None, text.lines[0][:80], "lines that are each a heading and numbers, one of them "
                         "a frequency")
    try:
        return parse_headed(turned, how="by its headings, one quantity a line")
    except InputError as error:
        # Its column map is for the transposed table, which is no file.
        raise InputError(text.path, error.field, error.value, error.expected.split(". Look through")[0]
                         + "; this table has one quantity a line: turn it over (transpose it) in a spreadsheet to name "
                         "its columns by --columns MAP.toml") from None


def _turned(text: RecordingText) -> RecordingText | None:
    """The text with its lines as columns, None if they are none."""
    for delimiter in ("\t", ";", ","):
        rows = [row for row in (cells(line, delimiter) for line in text.lines[:200]) if len(row) > 3]
        known = [(heading, row) for row in rows if (heading := understand(row[0])) is not None
                 and all(is_cell(cell) or holds_no_value(cell) for cell in row[1:])]
        if len(known) > 1 and len({len(row) for _, row in known}) == 1 and any(
                heading.part == "frequency" for heading, _ in known):
            columns = zip(*(row for _, row in known), strict=True)
            return replace(text, lines=tuple("\t".join(column) for column in columns), row="column")
    return None
