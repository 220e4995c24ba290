"""The workbench's own file, written by :func:`workbench.results.spectrum.write_spectrum`.

The origin's lines may be missing. A spreadsheet's copy is read too: semicolons or tabs between the columns, decimal
commas, empty cells behind a line.
"""

from __future__ import annotations

from collections.abc import Sequence

from workbench.files.errors import InputError, nearest_names
from workbench.readers.findings import Finding
from workbench.readers.sweep import Reading, in_order
from workbench.readers.tables import Table
from workbench.readers.text import RecordingText, cells
from workbench.results.spectrum import CSV_COLUMNS, ORIGIN_KINDS, ROWS, SHARED_UNCERTAINTY, UNCERTAINTY_COLUMN, Origin

#: Signs that a spreadsheet puts between columns instead of commas.
_REWRITTEN = (";", "\t")
_ORIGIN_KEYS = ("kind", "source", "sha256", "instrument", "date")


def recognises_workbench_csv(text: RecordingText) -> bool:
    """Whether the first line without ``#`` holds the names of the columns."""
    header = next((line for line in text.lines if not line.startswith("#") and line.strip()), "")
    names = cells(header, _delimiter(header))
    # Another program may use this name for its frequency; its other columns tell.
    return names[0].startswith(CSV_COLUMNS[0]) and (len(names) < 3 or not set(names).isdisjoint(CSV_COLUMNS[1:]))


def _delimiter(header: str) -> str:
    """The sign between the columns, by default a comma."""
    return next((sign for sign in _REWRITTEN if sign in header), ",")


def parse_workbench_csv(text: RecordingText) -> Reading:
    """Read the file.

    Raises:
        InputError: a metadata key, column name or row that :func:`~workbench.results.spectrum.write_spectrum` would not
        write.
    """
    start = next((index for index, line in enumerate(text.lines) if line.strip() and not line.startswith("#")), None)
    if start is None:
        raise text.error(len(text.lines), None, text.lines[-1], "the column names and rows; the file is cut short")
    delimiter = _delimiter(text.lines[start])
    padding = "" if delimiter == "," else delimiter
    comments = [(line, content, content[1:].partition(":")[0].strip(), content.partition(":")[2].strip())
                for line, content in ((line, content.rstrip(padding) if padding else content)
                                      for line, content in enumerate(text.lines, 1)) if content.startswith("#")]
    origin, shared = _origin(text, [each for each in comments if each[2] not in (SHARED_UNCERTAINTY, ROWS)]), 0.0
    names = tuple(cells(text.lines[start], delimiter))
    if names not in (CSV_COLUMNS, (*CSV_COLUMNS, UNCERTAINTY_COLUMN)):
        wanted = ",".join(CSV_COLUMNS)
        raise text.error(start + 1, None, text.lines[start], f"{wanted} or {wanted},{UNCERTAINTY_COLUMN}")
    table = Table(text, names, start, start + 1, delimiter, len(names), comments=("#",)).with_rows(
        0, "." if delimiter == "," else "", strict=True)
    frequency, real, imaginary, *uncertainty = table.numbers(range(len(names)))
    for line, value in zip(table.lines, *uncertainty, strict=True) if uncertainty else ():
        if value <= 0.0:
            raise text.error(line, 4, float(value), "an uncertainty above zero")
    findings = []
    for line, content, key, value in comments:
        if key == SHARED_UNCERTAINTY:
            shared = _share(value)
            if not 0.0 <= shared < 1.0:
                raise text.error(line, None, content, "a share of Z from 0 to less than 1")
            if shared and not uncertainty:
                raise InputError(text.path, SHARED_UNCERTAINTY, shared, f"a column {UNCERTAINTY_COLUMN} that it is a "
                                 "part of")
        if key == ROWS:
            if not value.isdecimal():
                raise text.error(line, None, value, "the number of rows below the column names")
            if int(value) != len(table.lines):
                findings.append(Finding("rows", f"{len(table.lines)} rows, and line {line} states {value}: the file "
                                        "may have been cut off, or rows taken out"))
    if not text.ended and any(key == ROWS for _, _, key, _ in comments):
        findings.append(Finding("cut_off", f"line {len(text.lines)} has no end: the file may have been cut off",
                                table.lines[-1:]))
    return in_order(table, frequency, real + 1j * imaginary, values=(real, imaginary), column=1, origin=origin,
                    uncertainty=uncertainty[0] if uncertainty else None, shared_uncertainty=shared, findings=findings)


def _share(text: str) -> float:
    """The number in a text, -1 for any other."""
    try:
        return float(text)
    except ValueError:
        return -1.0


def _origin(text: RecordingText, comments: Sequence[tuple[int, str, str, str]]) -> Origin:
    """The origin that comments (line, content, key, value) state."""
    if not comments:
        return Origin("unknown", source=text.path, sha256=text.sha256)
    found: dict[str, str] = {}
    settings: dict[str, str] = {}
    for line, content, key, value in comments:
        target, name = (settings, key.removeprefix("setting ")) if key.startswith("setting ") else (found, key)
        if ":" not in content or (target is found and name not in _ORIGIN_KEYS):
            raise InputError(text.path, f"line {line}", content,
                             "'# key: value' with a key of " + ", ".join((*_ORIGIN_KEYS, "setting NAME")),
                             nearest_names(key, _ORIGIN_KEYS))
        if name in target:
            raise text.error(line, None, content, f"{key!r} only once")
        target[name] = value
    if found.get("kind", "unknown") not in ORIGIN_KINDS:
        raise InputError(text.path, "kind", found["kind"], "one of " + ", ".join(ORIGIN_KINDS))
    return Origin(**found, settings=settings)
