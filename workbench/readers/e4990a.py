"""Keysight/Agilent E4990A, "Save Trace Data" as CSV.

Lines starting ``!`` name the analyser and the date; ``BEGIN CH1_DATA``; column names such as
``Frequency(Hz), |Z|(Ohm)-data, theta-z(deg)-data``; rows; ``END``. Which pair of columns holds the impedance is read
from their names.
"""

from __future__ import annotations

from collections.abc import Mapping

from workbench.readers.quantities import Quantity
from workbench.readers.text import RecordingText, cells, check_frequencies, check_impedance, numbers
from workbench.spectrum import Origin, Spectrum

#: Column names in lower case, and what the pair means.
PAIRS: Mapping[tuple[str, str], Quantity] = {
    ("|z|(ohm)-data", "theta-z(deg)-data"): Quantity("impedance", "polar", "ohm", "deg"),
    ("|z|(ohm)-data", "theta-z(rad)-data"): Quantity("impedance", "polar", "ohm", "rad"),
    ("r(ohm)-data", "x(ohm)-data"): Quantity("impedance", "rectangular", "ohm"),
    ("|y|(s)-data", "theta-y(deg)-data"): Quantity("admittance", "polar", "S", "deg"),
    ("|y|(s)-data", "theta-y(rad)-data"): Quantity("admittance", "polar", "S", "rad"),
    ("g(s)-data", "b(s)-data"): Quantity("admittance", "rectangular", "S"),
}


def recognises(text: RecordingText) -> bool:
    head = text.lines[:10]
    return any(line.startswith("!") and "E4990A" in line for line in head) or any(
        line.startswith("BEGIN CH") for line in head)


def parse(text: RecordingText) -> Spectrum:
    """Read the file.

    Raises:
        InputError: no data block, no END (the file was cut short), more than one channel, columns that hold no
            impedance, or a faulty row.
    """
    stripped = [line.strip().rstrip(",;").strip() for line in text.lines]
    begins = [index for index, line in enumerate(stripped) if line.startswith("BEGIN ")]
    if not begins:
        raise text.error(len(stripped), None, stripped[-1], "a line 'BEGIN CH1_DATA' before the data")
    if len(begins) > 1:
        raise text.error(begins[1] + 1, None, stripped[begins[1]], "one channel; save each channel to its own file")
    begin = begins[0]
    if "END" not in stripped[begin:]:
        raise text.error(len(stripped), None, stripped[-1], "a last line 'END'; the file is cut short")
    end = stripped.index("END", begin)
    block = [(index + 1, text.lines[index]) for index in range(begin + 1, end) if stripped[index]]
    if not block:
        raise text.error(begin + 1, None, stripped[begin], "column names and rows after it")
    header_line, header = block[0]
    if ";" in header:
        raise text.error(header_line, None, header, "commas between columns; semicolons are a spreadsheet's rewriting: "
                         "use the instrument's own file, or --columns MAP.toml")
    names = [name.casefold() for name in cells(header, ",")]
    if names[0] != "frequency(hz)":
        raise text.error(header_line, 1, cells(header, ",")[0], "Frequency(Hz)")
    chosen = next((pair for pair in PAIRS if pair[0] in names and pair[1] in names), None)
    if chosen is None:
        raise text.error(header_line, None, header, "the columns " + "; or ".join(", ".join(pair) for pair in PAIRS))
    rows = numbers(text, block[1:], delimiter=",", columns=len(names))
    first, second = (rows.values[:, names.index(name)] for name in chosen)
    check_frequencies(text, rows.values[:, 0], rows.lines, column=1)
    impedance = PAIRS[chosen].impedance(first, second)
    check_impedance(text, impedance, rows.lines)
    notes = [line[1:].strip() for line in stripped[:begin] if line.startswith("!")]
    date = next((note.removeprefix("Date:").strip() for note in notes if note.startswith("Date:")), "")
    instrument = next((note for note in notes if not note.startswith("Date:")), "")
    origin = Origin("measured", text.path, text.sha256, instrument, date, {"columns": ", ".join(cells(header, ","))})
    return Spectrum(rows.values[:, 0], impedance, None, origin)
