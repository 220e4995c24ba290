"""Recordings of impedance in many formats: a spectrum, and findings on it.

    reading = read_recording(Path("disc.csv"))
    reading.spectrum, reading.findings

A table with clear headings needs no more; for one without, :func:`read_recording` asks for a column map, and proposes
one. A file that cannot be trusted (cut short, not a number) is an `InputError` with the line. A sweep in another order
than that of frequency is put in order, with a finding. A file that can be read but contradicts physics gives findings,
and is corrected only on request. Rows without a value are left out with a finding, impossible points only on request.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from workbench.files.errors import InputError, choose
from workbench.readers import columns as _columns
from workbench.readers import headed, makers, touchstone, workbench_csv
from workbench.readers.columns import ColumnMap, read_column_map
from workbench.readers.findings import Finding
from workbench.readers.proposals import OPTION
from workbench.readers.quantities import RecordedQuantity
from workbench.readers.sweep import Reading
from workbench.readers.tables import find_table
from workbench.readers.text import READ_AS, RecordingText, load_text, refuse_waveform

__all__ = ["FORMATS", "READ_AS", "ColumnMap", "Finding", "Reading", "RecordedQuantity", "detect", "read_column_map",
           "read_recording"]


@dataclass(frozen=True)
class Format:
    """One file format: a description, a test of the text, a parser."""

    description: str
    recognises: Callable[[RecordingText], bool]
    parse: Callable[[RecordingText], Reading]


_MAKERS = {name: Format(f"{maker.name} table", maker.recognises, maker.parse) for name, maker in makers.MAKERS.items()}
FORMATS: Mapping[str, Format] = {
    "workbench": Format("the workbench's own CSV", workbench_csv.recognises_workbench_csv,
                        workbench_csv.parse_workbench_csv),
    "e4990a": _MAKERS["e4990a"],
    "4294a": Format("HP/Agilent 4294A ASCII", makers.recognises_hp4294a, makers.parse_hp4294a),
    "touchstone": Format("Touchstone .s1p, .s2p, .ts", touchstone.recognises_touchstone, touchstone.parse_touchstone),
    "labone": Format("Zurich Instruments LabOne sweep", makers.recognises_labone, makers.parse_labone),
    **_MAKERS,
    "lines": Format("a table with one quantity a line", makers.recognises_lines, makers.parse_lines),
    # The last one, since it takes any file with three columns of numbers.
    "table": Format("a table whose headings say what its columns are", lambda text: find_table(text) is not None,
                    headed.parse_headed),
}


def detect(path: Path | str) -> str:
    """The name of the file's format, a key of :data:`FORMATS`.

    Raises:
        InputError: the file is missing, empty, binary, an oscilloscope waveform, or of no known format.
    """
    return _detect(load_text(Path(path)))


def read_recording(
    path: Path | str, *, columns: ColumnMap | Path | str | None = None, format: str | None = None,
    correction: str | None = None, without_outliers: bool = False,
) -> Reading:
    """Read a recording of impedance.

    `format` (a key of :data:`FORMATS`) skips the detection; `columns`, a map or its file, reads any other table;
    `correction` ("negate", "conjugate" or "signs") is applied by :meth:`Reading.corrected`; `without_outliers` leaves
    out points as :meth:`Reading.without_outliers` does. :attr:`Reading.read_as` states the meaning of every column.

    Raises:
        InputError: the file is not a spectrum that can be trusted; the message gives line and column.
        ValueError: both `columns` and `format`, or an unknown correction.
    """
    if columns is not None and format is not None:
        raise ValueError("give columns or format, not both")
    if isinstance(columns, str | Path):
        columns = read_column_map(Path(columns))
    text = load_text(Path(path))
    refuse_waveform(text)
    if columns is not None:
        found = _columns.parse_columns(text, columns)
    else:
        name = _detect(text) if format is None else choose(format, FORMATS, source=text.path, field="format")
        found = FORMATS[name].parse(text)
    reading = found.examined(found.spectrum, shunt_gain=columns is not None and columns.quantity.kind == "gain")
    reading = reading if correction is None else reading.corrected(correction)
    return reading.without_outliers() if without_outliers else reading


def _detect(text: RecordingText) -> str:
    refuse_waveform(text)
    for name, known in FORMATS.items():
        if known.recognises(text):
            return name
    descriptions = ", ".join(f"{name} ({known.description})" for name, known in FORMATS.items())
    first = [line[:80] for line in text.lines if line.strip()][:3]
    raise InputError(text.path, "format", first, f"one of {descriptions}; any other table of numbers needs "
                     f"{OPTION}")
