"""How the numbers of an entry were fitted: the ``[fit]`` table of its file.

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

In a saved file ``[fit]`` comes last and ``date``, which must be there, is its last line: so no file that lost its end
reads as a whole one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from materials.value import date_text, number, text
from workbench.files.errors import InputError
from workbench.files.quantities import parse_quantity
from workbench.files.tables import refuse_unknown_keys

_SHA256 = re.compile(r"[0-9a-f]{64}")
_KEYS = ("recordings", "algorithm", "software", "start", "band", "temperature", "mape_percent", "rms_log_residual",
         "confidence", "free", "fixed", "notes", "forced", "date", "sample", "correlation")


@dataclass(frozen=True)
class Recording:
    """A recorded spectrum and the chip file it was fitted with: their names, and the SHA-256 of their contents.

    ``chip_sha256`` is empty where the chip is no file.
    """

    path: str
    sha256: str
    chip: str
    chip_sha256: str = ""


@dataclass(frozen=True)
class Correlation:
    """The correlation matrix of the free parameters that the data determine; row i belongs to name i."""

    names: tuple[str, ...]
    rows: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, kw_only=True)
class Fit:
    """How the numbers of a material were fitted.

    ``band`` in Hz, ``temperature`` in K, ``density`` (kg/m^3) that of the entry itself, ``confidence`` between 0 and 1,
    ``date`` in ISO 8601. ``mape_percent`` is the mean error of |Z|, ``rms_log_residual`` the root mean square of
    ln(Z_fit / Z_measured).
    """

    recordings: tuple[Recording, ...]
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
    """The :class:`Fit` stated by the ``[fit]`` table of a file.

    Args:
        table: what the file has under ``fit``.
        density: of the entry (kg/m^3).
        source: the file, for messages.

    Raises:
        InputError: an unknown key, something missing, or of the wrong kind.
    """
    if not isinstance(table, Mapping):
        raise InputError(source, "fit", table, "a table [fit]")
    refuse_unknown_keys(table, _KEYS, source=source, field="fit")
    confidence = _figure(table, "confidence", source=source)
    if not 0.0 < confidence < 1.0:
        raise InputError(source, "fit.confidence", confidence, "a level between 0 and 1, such as 0.95")
    forced = table.get("forced", False)
    if not isinstance(forced, bool):
        raise InputError(source, "fit.forced", forced, "true or false")
    temperature = None
    if "temperature" in table:
        temperature = parse_quantity(table["temperature"], "temperature", source=source, field="fit.temperature")
    return Fit(
        recordings=_recordings(table.get("recordings"), source=source),
        algorithm=text(table, "algorithm", source=source, field="fit"),
        software=text(table, "software", source=source, field="fit"),
        date=date_text(table, "date", source=source, field="fit"),
        band=_band(table.get("band"), source=source),
        mape_percent=_figure(table, "mape_percent", source=source),
        rms_log_residual=_figure(table, "rms_log_residual", source=source),
        confidence=confidence,
        free=_texts(table.get("free"), "fit.free", source=source),
        fixed=_texts(table.get("fixed", []), "fit.fixed", source=source),
        start=text(table, "start", source=source, field="fit", default=""),
        temperature=temperature,
        sample=_sample(table.get("sample", {}), source=source),
        correlation=_correlation(table["correlation"], source=source) if "correlation" in table else None,
        notes=_texts(table.get("notes", []), "fit.notes", source=source),
        forced=forced,
        density=density,
    )


def _figure(table: Mapping[str, object], key: str, *, source: str) -> float:
    found = number(table, key, source=source, field="fit")
    if found is None or found < 0.0:
        raise InputError(source, f"fit.{key}", found, "a number not below zero")
    return found


def _texts(found: object, name: str, *, source: str) -> tuple[str, ...]:
    if not isinstance(found, list) or not all(isinstance(item, str) for item in found):
        raise InputError(source, name, found, "a list of texts")
    return tuple(found)


def _band(found: object, *, source: str) -> tuple[float, float]:
    if isinstance(found, list) and len(found) == 2:
        low, high = (parse_quantity(end, "frequency", source=source, field="fit.band") for end in found)
        if 0.0 < low < high:
            return low, high
    raise InputError(source, "fit.band", found, 'two rising frequencies, for example ["910 kHz", "1155 kHz"]')


def _sample(found: object, *, source: str) -> dict[str, str]:
    if not isinstance(found, Mapping):
        raise InputError(source, "fit.sample", found, "a table of texts")
    return {str(key): text(found, key, source=source, field="fit.sample", default="") for key in found}


def _recordings(found: object, *, source: str) -> tuple[Recording, ...]:
    if not isinstance(found, list) or not found:
        raise InputError(source, "fit.recordings", found, "a list of recordings, at least one")
    return tuple(_recording(item, f"fit.recordings[{k}]", source=source) for k, item in enumerate(found))


def _recording(found: object, name: str, *, source: str) -> Recording:
    if not isinstance(found, Mapping):
        raise InputError(source, name, found, "a table of path, sha256, chip, chip_sha256")
    refuse_unknown_keys(found, ("path", "sha256", "chip", "chip_sha256"), source=source, field=name)
    digests = {key: text(found, key, source=source, field=name, default=None if key == "sha256" else "")
               for key in ("sha256", "chip_sha256")}
    for key, digest in digests.items():
        if _SHA256.fullmatch(digest) is None and (digest or key == "sha256"):
            raise InputError(source, f"{name}.{key}", digest, "a SHA-256: 64 hexadecimal digits")
    return Recording(text(found, "path", source=source, field=name), digests["sha256"],
                     text(found, "chip", source=source, field=name), digests["chip_sha256"])


def _correlation(found: object, *, source: str) -> Correlation:
    name = "fit.correlation"
    if not isinstance(found, Mapping):
        raise InputError(source, name, found, "a table of names and rows")
    refuse_unknown_keys(found, ("names", "rows"), source=source, field=name)
    names, rows = _texts(found.get("names"), f"{name}.names", source=source), found.get("rows")
    size = len(names)
    if not isinstance(rows, list) or len(rows) != size or any(not isinstance(r, list) or len(r) != size for r in rows):
        raise InputError(source, f"{name}.rows", rows, f"{size} rows of {size} numbers, as there are names")
    for entry in (entry for row in rows for entry in row):
        if isinstance(entry, bool) or not isinstance(entry, int | float) or not math.isfinite(entry):
            raise InputError(source, f"{name}.rows", entry, "finite numbers")
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            # 1e-6: what the rounding of a badly scaled covariance leaves, far below what anybody reads from it.
            if abs(entry - rows[j][i]) > 1e-6 or abs(entry) > 1.0 + 1e-6 or (i == j and abs(entry - 1.0) > 1e-6):
                raise InputError(source, f"{name}.rows", f"{entry!r} for {names[i]}, {names[j]}",
                                 "a symmetric matrix with 1 on its diagonal and nothing larger beside it")
    return Correlation(names, tuple(tuple(float(entry) for entry in row) for row in rows))
