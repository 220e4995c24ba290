"""Tables with one quantity per line: LabOne's sweeps (Zurich Instruments MFIA, MFLI, HF2LI), and transposed tables.

LabOne's sweeper saves ``chunk;timestamp;size;fieldname`` and then the values of that field, one line per field and
sweep: ``frequency`` (or ``grid``), ``realz`` and ``imagz``, ``absz`` and ``phasez`` in radians, and further ones that
are not needed. A point that was not measured is ``nan``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.readers import headed
from workbench.readers.columns import READ_AS
from workbench.readers.findings import Finding
from workbench.readers.headings import understand
from workbench.readers.quantities import RecordedQuantity
from workbench.readers.sweep import Recorded, in_order
from workbench.readers.text import RecordingText, cell_number, cells, complex_parts, holds_no_value, is_number
from workbench.results.spectrum import Origin

#: Quantities by the pair of fields that hold an impedance.
PAIRS: Mapping[tuple[str, str], RecordedQuantity] = {
    ("realz", "imagz"): RecordedQuantity("impedance", "rectangular", "ohm"),
    ("absz", "phasez"): RecordedQuantity("impedance", "polar", "ohm", "rad"),
}


def recognises_labone(text: RecordingText) -> bool:
    return _delimiter(text) != ""


def _delimiter(text: RecordingText) -> str:
    """The delimiter of the cells of a LabOne file; "" for any other file."""
    head = next((line for line in text.lines if line.strip()), "").casefold().replace(" ", "")
    return next((mark for mark in ";,\t" if head.startswith(f"chunk{mark}timestamp{mark}size{mark}fieldname")), "")


def parse_labone(text: RecordingText) -> Recorded:
    """Read the first sweep of the file; a finding states the differences of the others.

    Raises:
        InputError: no LabOne file; fields that are no impedance against frequency, or are of different length.
    """
    delimiter = _delimiter(text)
    if not delimiter:
        raise text.error(1, None, text.lines[0][:80], "a line that begins with chunk;timestamp;size;fieldname")
    chunks: dict[str, dict[str, tuple[int, list[str]]]] = {}
    for line, content in enumerate(text.lines, 1):
        row = cells(content, delimiter)
        if len(row) > 4 and row[0].isdigit():
            chunks.setdefault(row[0], {})[row[3].casefold()] = (line, row[4:])
    read = {name: _chunk(text, name, fields) for name, fields in chunks.items()}
    if not read:
        raise text.error(len(text.lines), None, text.lines[-1][:80], "a line of values behind the first one")
    first, *others = read.values()
    said = []
    for name, other in list(read.items())[1:]:
        share = first.share_apart(other)
        said.append(f"sweep {name} " + (f"differs by {100.0 * share:.2g} %" if np.isfinite(share) else
                                        "has other frequencies"))
    if others:
        words = (f"{len(read)} sweeps in the file: the first was read; {'; '.join(said)}; to read another, take the "
                 "lines of the first out of a copy of the file")
        first = replace(first, findings=(*first.findings, Finding("sweeps", words)))
    return first


def _chunk(text: RecordingText, name: str, fields: Mapping[str, tuple[int, list[str]]]) -> Recorded:
    """One sweep of the file."""
    pair = next((pair for pair in PAIRS if set(pair) <= set(fields)), None)
    frequency = next((field for field in ("frequency", "grid") if field in fields), None)
    if pair is None or frequency is None:
        raise InputError(text.path, f"chunk {name}", ", ".join(fields), "the fields frequency, and realz with imagz or "
                         "absz with phasez: a sweep of the impedance analyser over frequency")
    line = fields[frequency][0]
    values = [_values(text, *fields[field]) for field in (frequency, *pair)]
    sizes = {len(each) for each in values}
    if len(sizes) > 1:
        raise text.error(line, None, " and ".join(map(str, sorted(sizes))) + " values", f"as many of {pair[0]} and "
                         f"{pair[1]} as of {frequency}; the file may be cut short")
    quantity = PAIRS[pair]
    unit = f"rad; the phase of Z is {pair[1]}" if quantity.form == "polar" else "ohm"
    read_as = f"as a LabOne sweep, lines {frequency} in Hz, {pair[0]} and {pair[1]} in {unit}"
    origin = Origin("measured", text.path, text.sha256, "Zurich Instruments, LabOne", settings={READ_AS: read_as})
    one, two, three = values
    # The frequency of a point that was not measured may be missing too; the last cell of a line may be an empty one.
    return in_order(replace(text, row="value"), one, quantity.impedance(two, three), cells=[two + 0.0 * one, three],
                    lines=range(1, len(one) + 1), column=1, origin=origin)


def _values(text: RecordingText, line: int, row: list[str]) -> NDArray[np.float64]:
    """The numbers of a line, NaN for a missing one.

    Raises:
        InputError: a cell that is no number.
    """
    found = np.full(len(row), np.nan)
    for place, cell in enumerate(row):
        if cell:
            found[place] = cell_number(text, line, place + 5, cell=cell)
    return found


# --------------------------------------------------------------------------------------------------------------------
# Any table with one quantity per line.


def recognises_lines(text: RecordingText) -> bool:
    """Whether the lines of a table are its columns: a frequency and more, each a heading and then numbers."""
    return _turned(text) is not None


def parse_lines(text: RecordingText) -> Recorded:
    """Read a table whose lines are its columns.

    Raises:
        InputError: no such table, or headings that leave a doubt.
    """
    turned = _turned(text)
    if turned is None:
        raise text.error(1, None, text.lines[0][:80], "lines that are each a heading and numbers, one of them "
                         "a frequency")
    try:
        found = headed.parse_headed(turned)
    except InputError as error:
        # Its column map is for the transposed table, which is no file.
        raise InputError(text.path, error.field, error.value, error.expected.split(". Look through")[0]
                         + "; this table has one quantity a line: turn it over (transpose it) in a spreadsheet to name "
                         "its columns by --columns MAP.toml") from None
    origin = found.spectrum.origin
    said = origin.settings[READ_AS].replace("by its headings", "by its headings, one quantity a line")
    return replace(found, spectrum=replace(found.spectrum, origin=replace(
        origin, settings={**origin.settings, READ_AS: said})))


def _turned(text: RecordingText) -> RecordingText | None:
    """The text with its lines as columns divided by tabs; None if its lines are no columns."""
    for delimiter in ("\t", ";", ","):
        rows = [row for row in (cells(line, delimiter) for line in text.lines[:200]) if len(row) > 3]
        known = [row for row in rows if understand(row[0]) is not None and all(
            is_number(cell) or is_number(cell, ",") or complex_parts(cell) is not None or holds_no_value(cell)
            for cell in row[1:])]
        sizes = {len(row) for row in known}
        parts = {heading.part for heading in (understand(row[0]) for row in known) if heading is not None}
        if len(known) >= 2 and len(sizes) == 1 and "frequency" in parts:
            lines = ("\t".join(column) for column in zip(*known, strict=True))
            return replace(text, lines=tuple(lines), row="column")
    return None
