"""Recordings of impedance: find out the format, read it, and report what looks wrong.

    reading = read_recording(Path("disc.csv"))
    reading.spectrum, reading.findings

A table with clear headings needs no more; for one without, :func:`read_recording` asks for a column map, and proposes
one. A file that cannot be trusted (cut short, not a number) is an `InputError` with the line. A sweep in another order
than that of frequency is put in order, with a finding. A file that can be read but contradicts physics gives findings,
and is corrected only on request. Rows without a value are left out with a finding, impossible points only on request.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from workbench.files.errors import InputError, choose
from workbench.readers import columns as _columns
from workbench.readers import headed, makers, touchstone, workbench_csv
from workbench.readers.columns import ColumnMap, read_column_map
from workbench.readers.findings import Finding, Rows, examine
from workbench.readers.proposals import OPTION
from workbench.readers.quantities import RecordedQuantity
from workbench.readers.sweep import Recorded
from workbench.readers.tables import find_table
from workbench.readers.text import READ_AS, RecordingText, load_text, refuse_waveform
from workbench.results.notebook import Shown, Summary
from workbench.results.spectrum import Spectrum, corrected

if TYPE_CHECKING:
    import xarray

__all__ = ["FORMATS", "READ_AS", "ColumnMap", "Finding", "Reading", "RecordedQuantity", "detect", "read_column_map",
           "read_recording"]


@dataclass(frozen=True)
class Format:
    """One file format: a test of the text, its parser, and a description for messages."""

    description: str
    recognises: Callable[[RecordingText], bool]
    parse: Callable[[RecordingText], Recorded]


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

#: Findings on the spectrum itself, which are found anew after a correction.
_EXAMINED = frozenset({"inverse_ratio", "negated", "active", "conjugated", "unsigned", "stretch", "magnitude",
                       "frequency", "outlier", "spacing"})
#: The setting of an origin that lists the points left out on request.
LEFT_OUT = "left out"


@dataclass(frozen=True, eq=False, repr=False)
class Reading(Shown):
    """A spectrum as recorded, the findings on it, and the rows of the file that its points stand in, if known."""

    spectrum: Spectrum
    findings: tuple[Finding, ...]
    rows: Rows | None = None

    @property
    def read_as(self) -> str:
        """Meaning of every column according to headings or a column map; otherwise empty."""
        return self.spectrum.origin.settings.get(READ_AS, "")

    def summary(self) -> Summary:
        """The spectrum and its findings, for a notebook."""
        own = self.spectrum.summary()
        found = [("read as", self.read_as)] if self.read_as else []
        rows = (*own.rows, *found, *(("finding", str(finding.message)) for finding in self.findings))
        return Summary("Recording", rows, {"measured": self.spectrum}, ("measured",))

    def to_xarray(self) -> xarray.Dataset:
        """The spectrum as a dataset, see :meth:`Spectrum.to_xarray`."""
        return self.spectrum.to_xarray()

    def corrected(self, correction: str) -> Reading:
        """The reading with its spectrum corrected, noted in the origin, and re-examined.

        `correction` is "negate", "conjugate" or "signs", see :func:`workbench.results.spectrum.corrected`.
        """
        spectrum = corrected(self.spectrum, correction)
        kept = tuple(finding for finding in self.findings if finding.code not in _EXAMINED)
        return Reading(spectrum, (*kept, *examine(spectrum, rows=self.rows)), self.rows)

    def without_outliers(self) -> Reading:
        """The reading without the points in the ``rows`` of its findings, noted in the origin and in a finding.

        Raises:
            InputError: they are half of the points or more.
        """
        rows = self.rows or Rows(tuple(range(1, self.spectrum.frequency.size + 1)), "point")
        out = {row for finding in self.findings for row in finding.rows}
        kept = np.array([row not in out for row in rows.numbers])
        points = np.flatnonzero(~kept)
        if not len(points):
            return self
        words = f"{len(points)} of {len(kept)} points as outliers: {rows.named(points, self.spectrum.frequency)}"
        if 2 * len(points) >= len(kept):
            raise InputError(self.spectrum.origin.source or "recording", "without_outliers", words,
                             "fewer than half of the points; the recording as a whole is in doubt")
        spectrum = self.spectrum.at(kept)
        spectrum = replace(spectrum, origin=replace(spectrum.origin, settings={
            **spectrum.origin.settings, LEFT_OUT: words}))
        rest = Rows(rows.of(np.flatnonzero(kept)), rows.word)
        others = tuple(finding for finding in self.findings if finding.code not in _EXAMINED)
        said = Finding("left_out", f"left out {words}")
        return Reading(spectrum, (*others, said, *examine(spectrum, rows=rest)), rest)


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
    gain = columns is not None and columns.quantity.kind == "gain"
    reading = Reading(found.spectrum, (*found.findings, *examine(found.spectrum, rows=found.rows, shunt_gain=gain)),
                      found.rows)
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
