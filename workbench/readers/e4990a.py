"""Keysight/Agilent E4990A, "Save Trace Data" as CSV.

Lines starting ``!`` name the analyser and the date; ``BEGIN CH1_DATA``; column names such as ``Frequency(Hz),
|Z|(Ohm)-data, theta-z(deg)-data``; rows; ``END``. The names of the columns show which pair holds the impedance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from workbench.files.errors import InputError
from workbench.readers import headed
from workbench.readers.findings import Finding
from workbench.readers.quantities import RecordedQuantity
from workbench.readers.sweep import Recorded, in_order
from workbench.readers.text import RecordingText, cells, numbers
from workbench.results.spectrum import Origin

#: Quantities by the column names of the pair, in lower case.
PAIRS: Mapping[tuple[str, str], RecordedQuantity] = {
    ("|z|(ohm)-data", "theta-z(deg)-data"): RecordedQuantity("impedance", "polar", "ohm", "deg"),
    ("|z|(ohm)-data", "theta-z(rad)-data"): RecordedQuantity("impedance", "polar", "ohm", "rad"),
    ("r(ohm)-data", "x(ohm)-data"): RecordedQuantity("impedance", "rectangular", "ohm"),
    ("|y|(s)-data", "theta-y(deg)-data"): RecordedQuantity("admittance", "polar", "S", "deg"),
    ("|y|(s)-data", "theta-y(rad)-data"): RecordedQuantity("admittance", "polar", "S", "rad"),
    ("g(s)-data", "b(s)-data"): RecordedQuantity("admittance", "rectangular", "S"),
}


def recognises_e4990a(text: RecordingText) -> bool:
    head = text.lines[:10]
    return any(line.startswith("!") and "E4990A" in line for line in head) or any(
        line.startswith("BEGIN CH") for line in head)


def parse_e4990a(text: RecordingText) -> Recorded:
    """Read the file.

    Columns that :data:`PAIRS` does not list (equivalent circuits, a spreadsheet's copy) are read by their headings. Of
    several channels, the first that holds an impedance is read, and a finding says so.

    Raises:
        InputError: no data block, no END (the file was cut short), columns that hold no impedance, or a faulty row.
    """
    stripped = [line.strip().rstrip(",;\t").strip() for line in text.lines]
    begins = [index for index, line in enumerate(stripped) if line.startswith("BEGIN ")]
    if not begins:
        raise text.error(len(stripped), None, stripped[-1], "a line 'BEGIN CH1_DATA' before the data")
    found: list[Recorded | InputError] = []
    for begin in begins:
        try:
            found.append(_block(text, stripped, begin))
        except InputError as error:
            found.append(error)
    read = [(stripped[begin], each) for begin, each in zip(begins, found, strict=True) if isinstance(each, Recorded)]
    if not read or (len(begins) == 1 and isinstance(found[0], InputError)):
        raise next(each for each in found if isinstance(each, InputError))
    name, first = read[0]
    if len(begins) == 1:
        return first
    others = ", ".join(stripped[begin].removeprefix("BEGIN ") for begin in begins if stripped[begin] != name)
    said = f"{len(begins)} channels: {name.removeprefix('BEGIN ')} was read, not {others}"
    for other, each in read[1:]:
        said += f"; {other.removeprefix('BEGIN ')} {_compared(first, each)}"
    return replace(first, findings=(*first.findings, Finding("channels", said)))


def _compared(one: Recorded, two: Recorded) -> str:
    """The difference of another channel's impedance from the one that is read, in words."""
    share = one.share_apart(two)
    if not np.isfinite(share):
        return "has other frequencies"
    return f"differs from it by {100.0 * share:.2g} % (rms)" + (
        "; to read that channel, take the block of the other out of a copy of the file" if share > 0.01 else "")


def _block(text: RecordingText, stripped: Sequence[str], begin: int) -> Recorded:
    """The channel whose data begin after the line index `begin`."""
    if "END" not in stripped[begin:]:
        raise text.error(len(stripped), None, stripped[-1], "a last line 'END'; the file is cut short")
    end = stripped.index("END", begin)
    block = [(index + 1, text.lines[index]) for index in range(begin + 1, end) if stripped[index]]
    if not block:
        raise text.error(begin + 1, None, stripped[begin], "column names and rows after it")
    header_line, header = block[0]
    notes = [line[1:].strip() for line in stripped[:begin] if line.startswith("!")]
    date = next((note.removeprefix("Date:").strip() for note in notes if note.startswith("Date:")), "")
    instrument = next((note for note in notes if not note.startswith("Date:")), "")
    names = [name.casefold() for name in cells(header, ",")]
    chosen = next((pair for pair in PAIRS if pair[0] in names and pair[1] in names), None)
    if ";" in header or "\t" in header or chosen is None:
        return _by_headings(text, begin, end, instrument, date)
    if names[0] != "frequency(hz)":
        raise text.error(header_line, 1, cells(header, ",")[0], "Frequency(Hz)")
    rows = numbers(text, block[1:], delimiter=",", columns=len(names))
    first, second = (rows.values[:, names.index(name)] for name in chosen)
    origin = Origin("measured", text.path, text.sha256, instrument, date, {"columns": ", ".join(cells(header, ","))})
    return in_order(text, rows.values[:, 0], PAIRS[chosen].impedance(first, second), lines=rows.lines, column=1,
                    origin=origin, cells=[first, second])


def _by_headings(text: RecordingText, begin: int, end: int, instrument: str, date: str) -> Recorded:
    """The channel between two line indices, as a table; the lines keep their numbers."""
    alone = replace(text, lines=tuple(line if begin < index < end else "" for index, line in enumerate(text.lines)))
    found = headed.parse_headed(alone, instrument=instrument)
    return replace(found, spectrum=replace(found.spectrum, origin=replace(found.spectrum.origin, date=date)))
