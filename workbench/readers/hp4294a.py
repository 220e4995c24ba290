"""HP/Agilent 4294A, ASCII save.

A quoted header, then trace A as a whole table and trace B as a second one below it. Each row is frequency, real,
imaginary (imaginary zero, since both traces are real numbers). With a stored memory trace there are two more columns of
an older sweep, which must not be taken for the data.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from workbench.readers.quantities import RecordedQuantity
from workbench.readers.sweep import Recorded, in_order
from workbench.readers.text import NumberRows, RecordingText, cells, numbers
from workbench.results.spectrum import Origin

PARAMETERS: Mapping[str, RecordedQuantity] = {
    "IMPEDANCE MAG PHASE (DEG)": RecordedQuantity("impedance", "polar", "ohm", "deg"),
    "IMPEDANCE MAG PHASE (RAD)": RecordedQuantity("impedance", "polar", "ohm", "rad"),
    "IMPEDANCE REAL IMAG": RecordedQuantity("impedance", "rectangular", "ohm"),
    "ADMITTANCE MAG PHASE (DEG)": RecordedQuantity("admittance", "polar", "S", "deg"),
    "ADMITTANCE MAG PHASE (RAD)": RecordedQuantity("admittance", "polar", "S", "rad"),
    "ADMITTANCE REAL IMAG": RecordedQuantity("admittance", "rectangular", "S"),
}

_COLUMNS = ("Frequency", "Data Trace Real", "Data Trace Imag")
_MEMORY_COLUMNS = ("Memory Trace Real", "Memory Trace Imag")


def recognises_hp4294a(text: RecordingText) -> bool:
    return text.lines[0].lstrip('"').startswith("4294A")


def parse_hp4294a(text: RecordingText) -> Recorded:
    """Read the file.

    Raises:
        InputError: a parameter or sweep that is no impedance against frequency, a trace that is missing or shorter
            than the header declares, traces on different frequencies, or a faulty row.
    """
    header = _header(text)
    parameter, line = _required(text, header, "MEASURE PARAMETER")
    spelling = re.sub(r"\s*\(\s*", " (", parameter.upper())
    if spelling not in PARAMETERS:
        raise text.error(line, None, parameter, "one of " + ", ".join(PARAMETERS))
    quantity = PARAMETERS[spelling]
    sweep, line = _required(text, header, "SWEEP TYPE")
    if "FREQ" not in sweep.upper():
        raise text.error(line, None, sweep, "a sweep of frequency")
    declared, line = _required(text, header, "NUMBER of POINTS")
    if not declared.isdigit():
        raise text.error(line, None, declared, "a whole number of points")
    first, second = (_trace(text, name, int(declared)) for name in "AB")
    differs = first.values[:, 0] != second.values[:, 0]
    if np.any(differs):
        index = int(np.argmax(differs))
        raise text.error(second.lines[index], 1, float(second.values[index, 0]),
                         f"the frequency of trace A, {first.values[index, 0]:.12g} Hz (line {first.lines[index]})")
    impedance = quantity.impedance(_real(text, first), _real(text, second))
    settings = {key.lower(): value for key, (value, _) in header.items() if key not in ("DATE", "TRACE", "FORMAT")}
    date = header["DATE"][0] if "DATE" in header else ""
    origin = Origin("measured", text.path, text.sha256, text.lines[0].strip().strip('"'), date, settings)
    return in_order(text, first.values[:, 0], impedance, lines=first.lines, column=1, origin=origin,
                    cells=[first.values[:, 1], second.values[:, 1]])


def _header(text: RecordingText) -> dict[str, tuple[str, int]]:
    """Key -> (value, line) of the quoted lines above the first table."""
    header: dict[str, tuple[str, int]] = {}
    for index, line in enumerate(text.lines):
        content = line.strip().strip('"')
        if content.startswith("Frequency"):
            break
        key, colon, value = content.partition(":")
        if colon:
            header[key.strip()] = (value.strip(), index + 1)
    return header


def _required(text: RecordingText, header: Mapping[str, tuple[str, int]], key: str) -> tuple[str, int]:
    if key not in header:
        raise text.error(len(text.lines), None, "end of the header", f'a line "{key}: ..."')
    return header[key]


def _trace(text: RecordingText, name: str, declared: int) -> NumberRows:
    """The table of trace `name`, data columns only, checked against the number of points in the header."""
    bare = [line.strip().strip('"').strip() for line in text.lines]
    if f"TRACE: {name}" not in bare:
        raise text.error(len(bare), None, bare[-1], f'"TRACE: {name}"; the file is cut short')
    start = bare.index(f"TRACE: {name}")
    header = next((index for index in range(start, len(bare)) if bare[index].startswith("Frequency")), None)
    if header is None:
        raise text.error(len(bare), None, bare[-1], f"the table of trace {name}; the file is cut short")
    names = tuple(cells(text.lines[header], "\t"))
    if names not in (_COLUMNS, _COLUMNS + _MEMORY_COLUMNS):
        raise text.error(header + 1, None, text.lines[header],
                         ", ".join(_COLUMNS) + " and, with a memory trace, " + ", ".join(_MEMORY_COLUMNS))
    block: list[tuple[int, str]] = []
    for index in range(header + 1, len(bare)):
        if not bare[index] or bare[index].startswith("TRACE:"):
            break
        block.append((index + 1, text.lines[index]))
    if len(block) != declared:
        raise text.error(block[-1][0] if block else header + 1, None, f"{len(block)} rows in trace {name}",
                         f"the {declared} points the header declares")
    rows = numbers(text, block, delimiter="\t", columns=len(names))
    return NumberRows(rows.values[:, :3], rows.lines)


def _real(text: RecordingText, rows: NumberRows) -> NDArray[np.float64]:
    """The trace's values; an imaginary part would mean a trace this reader does not know."""
    wrong = np.nan_to_num(rows.values[:, 2]) != 0.0
    if np.any(wrong):
        index = int(np.argmax(wrong))
        raise text.error(rows.lines[index], 3, float(rows.values[index, 2]), "zero: a magnitude, phase, real or "
                         "imaginary trace is real")
    return np.asarray(rows.values[:, 1])
