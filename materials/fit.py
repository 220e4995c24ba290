"""The ``[fit]`` table of an entry: recordings, method and result::

    [fit.sample]                                # whatever is known of it, as text
    thickness = "2.02 mm"

    [fit.correlation]
    names = ["c33", "c33 loss"]
    rows = [[1.0, -0.12], [-0.12, 1.0]]

    [fit]
    recordings = [{ path = "disc_7.csv", sha256 = "...", chip = "disc_7.toml", chip_sha256 = "..." }]
    algorithm = "joint"
    software = "acoustofluidic-chip-workbench 0.1.0"
    start = "pzt4/comsol_nominal"               # optional: the material that the fit set out from
    band = ["910000 Hz", "1155000 Hz"]
    temperature = "296.15 K"                    # optional
    mape_percent = 0.41
    rms_log_residual = 0.0052
    confidence = 0.95                           # of the intervals low to high
    free = ["c33", "c33 loss"]
    fixed = ["eps11"]                           # optional
    notes = ["eps11 not determined"]            # optional
    forced = false                              # optional: stored although the fit was not accepted
    date = "2026-11-21T14:40:00+00:00"

In a saved file ``[fit]`` comes last and ``date``, which is required, is its last line. So a file that lost its end is
never read as a whole one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from materials.value import date_text
from workbench.files.errors import InputError
from workbench.files.tables import FileTable

_SHA256 = re.compile(r"[0-9a-f]{64}")
_KEYS = ("recordings", "algorithm", "software", "start", "band", "temperature", "mape_percent", "rms_log_residual",
         "confidence", "free", "fixed", "notes", "forced", "date", "sample", "correlation")


@dataclass(frozen=True)
class RecordingSource:
    """Names and SHA-256 of a recorded spectrum and its chip file. ``chip_sha256`` is empty if the chip has no file."""

    path: str
    sha256: str
    chip: str
    chip_sha256: str = ""


@dataclass(frozen=True)
class Correlation:
    """The correlation matrix of the determined free parameters. Row i belongs to name i."""

    names: tuple[str, ...]
    rows: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, kw_only=True)
class Fit:
    """The fit that gave the numbers of a material.

    ``band`` in Hz, ``temperature`` in K, ``density`` (kg/m^3) of the entry, ``confidence`` between 0 and 1, ``date`` as
    ISO 8601 text. ``mape_percent`` is the mean error of |Z|, ``rms_log_residual`` the root mean square of ln(Z_fit /
    Z_measured).
    """

    recordings: tuple[RecordingSource, ...]
    algorithm: str
    software: str
    date: str
    band: tuple[float, float]
    mape_percent: float
    rms_log_residual: float
    confidence: float
    free: tuple[str, ...]
    fixed: tuple[str, ...] = ()
    start: str = ""
    temperature: float | None = None
    sample: Mapping[str, str] = field(default_factory=dict)
    correlation: Correlation | None = None
    notes: tuple[str, ...] = ()
    forced: bool = False
    density: float | None = None


def parse_fit(table: object, *, density: float, source: str) -> Fit:
    """The :class:`Fit` in the ``[fit]`` table of a file.

    Args:
        table: content of the file under ``fit``.
        density: of the entry (kg/m^3).
        source: the file, for messages.

    Raises:
        InputError: a key that is unknown, missing or of the wrong kind.
    """
    entry = FileTable.of(table, source=source, field="fit", expected="a table [fit]").only(_KEYS)
    confidence = _figure(entry, "confidence")
    if not 0.0 < confidence < 1.0:
        raise InputError(entry.source, entry.at("confidence"), confidence, "a level between 0 and 1, such as 0.95")
    forced = entry.flag("forced")
    temperature = entry.optional_quantity("temperature", "temperature")
    sample = entry.table("sample", expected="a table of texts")
    return Fit(
        recordings=_recordings(entry),
        algorithm=entry.text("algorithm"),
        software=entry.text("software"),
        date=date_text(entry, "date"),
        band=_band(entry),
        mape_percent=_figure(entry, "mape_percent"),
        rms_log_residual=_figure(entry, "rms_log_residual"),
        confidence=confidence,
        free=entry.texts("free"),
        fixed=entry.texts("fixed", ()),
        start=entry.text("start", ""),
        temperature=temperature,
        sample={key: sample.text(key, "") for key in sample},
        correlation=_correlation(entry) if "correlation" in entry else None,
        notes=entry.texts("notes", ()),
        forced=forced,
        density=density,
    )


def _figure(entry: FileTable, key: str) -> float:
    found = entry.optional_number(key)
    if found is None or found < 0.0:
        raise InputError(entry.source, entry.at(key), found, "a number not below zero")
    return found


def _band(entry: FileTable) -> tuple[float, float]:
    expected = 'two rising frequencies, for example ["910 kHz", "1155 kHz"]'
    low, high = entry.quantities("band", "frequency", expected=expected)
    if not 0.0 < low < high:
        raise entry.error("band", expected)
    return low, high


def _recordings(entry: FileTable) -> tuple[RecordingSource, ...]:
    found = entry.content.get("recordings")
    if not isinstance(found, list) or not found:
        raise entry.error("recordings", "a list of recordings, at least one")
    return tuple(_recording(FileTable.of(item, source=entry.source, field=f"{entry.at('recordings')}[{k}]",
                                         expected="a table of path, sha256, chip, chip_sha256"))
                 for k, item in enumerate(found))


def _recording(table: FileTable) -> RecordingSource:
    table.only(("path", "sha256", "chip", "chip_sha256"))
    digests = {"sha256": table.text("sha256"), "chip_sha256": table.text("chip_sha256", "")}
    for key, digest in digests.items():
        if _SHA256.fullmatch(digest) is None and (digest or key == "sha256"):
            raise table.error(key, "a SHA-256: 64 hexadecimal digits")
    return RecordingSource(table.text("path"), digests["sha256"], table.text("chip"), digests["chip_sha256"])


def _correlation(entry: FileTable) -> Correlation:
    table = entry.table("correlation", expected="a table of names and rows").only(("names", "rows"))
    names, rows = table.texts("names"), table.content.get("rows")
    size = len(names)
    if not isinstance(rows, list) or len(rows) != size or any(not isinstance(r, list) or len(r) != size for r in rows):
        raise table.error("rows", f"{size} rows of {size} numbers, as there are names")
    field = table.at("rows")
    for number in (number for row in rows for number in row):
        if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number):
            raise InputError(table.source, field, number, "finite numbers")
    for i, row in enumerate(rows):
        for j, number in enumerate(row):
            # 1e-6 is the rounding of a badly scaled covariance.
            if abs(number - rows[j][i]) > 1e-6 or abs(number) > 1.0 + 1e-6 or (i == j and abs(number - 1.0) > 1e-6):
                raise InputError(table.source, field, f"{number!r} for {names[i]}, {names[j]}",
                                 "a symmetric matrix with 1 on its diagonal and no larger number beside it")
    return Correlation(names, tuple(tuple(float(number) for number in row) for row in rows))
