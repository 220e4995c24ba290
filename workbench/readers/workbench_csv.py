"""The workbench's own file, written by :func:`workbench.results.spectrum.write_spectrum`.

The origin's lines may be missing.
"""

from __future__ import annotations

from workbench.files.errors import InputError, nearest_names
from workbench.readers.findings import Finding
from workbench.readers.sweep import Recorded, in_order
from workbench.readers.text import RecordingText, cells, numbers
from workbench.results.spectrum import CSV_COLUMNS, ORIGIN_KINDS, ROWS, SHARED_UNCERTAINTY, UNCERTAINTY_COLUMN, Origin

_ORIGIN_KEYS = ("kind", "source", "sha256", "instrument", "date")


def recognises_workbench_csv(text: RecordingText) -> bool:
    header = next((line for line in text.lines if not line.startswith("#") and line.strip()), "")
    names = cells(header, ",")
    # Another program may use this name for its frequency; its other columns tell.
    return names[0].startswith(CSV_COLUMNS[0]) and (len(names) < 3 or not set(names).isdisjoint(CSV_COLUMNS[1:]))


def parse_workbench_csv(text: RecordingText) -> Recorded:
    """Read the file.

    Raises:
        InputError: a metadata key, column name or row that :func:`~workbench.results.spectrum.write_spectrum` would not
        write.
    """
    numbered = [(index + 1, line) for index, line in enumerate(text.lines) if line.strip()]
    comments = [(line, content) for line, content in numbered if content.startswith("#")]
    table = [(line, content) for line, content in numbered if not content.startswith("#")]
    if not table:
        raise text.error(len(text.lines), None, text.lines[-1], "the column names and rows; the file is cut short")
    shared = _shared_uncertainty(text, comments)
    origin = _origin(text, [each for each in comments if _key(each[1]) not in (SHARED_UNCERTAINTY, ROWS)])
    header_line, header = table[0]
    names = tuple(cells(header, ","))
    if names not in (CSV_COLUMNS, (*CSV_COLUMNS, UNCERTAINTY_COLUMN)):
        wanted = ",".join(CSV_COLUMNS)
        raise text.error(header_line, None, header, f"{wanted} or {wanted},{UNCERTAINTY_COLUMN}")
    rows = numbers(text, table[1:], delimiter=",", columns=len(names))
    impedance = rows.values[:, 1] + 1j * rows.values[:, 2]
    uncertainty = None
    if len(names) == 4:
        uncertainty = rows.values[:, 3]
        for line, value in zip(rows.lines, uncertainty, strict=True):
            if value <= 0.0:
                raise text.error(line, 4, float(value), "an uncertainty above zero")
    if shared and uncertainty is None:
        raise InputError(text.path, SHARED_UNCERTAINTY, shared, f"a column {UNCERTAINTY_COLUMN} that it is a part of")
    stated = [(line, content.partition(":")[2].strip()) for line, content in comments if _key(content) == ROWS]
    findings = []
    for line, number in stated:
        if not number.isdecimal():
            raise text.error(line, None, number, "the number of rows below the column names")
        if int(number) != len(table) - 1:
            findings.append(Finding("rows", f"{len(table) - 1} rows, and line {line} states {number}: the file may "
                                    "have been cut off, or rows taken out"))
    if stated and not text.ended:
        findings.append(Finding("cut_off", f"line {len(text.lines)} has no end: the file may have been cut off",
                                (table[-1][0],)))
    return in_order(text, rows.values[:, 0], impedance, lines=rows.lines, column=1, origin=origin,
                    cells=list(rows.values.T[1:3]), uncertainty=uncertainty, shared_uncertainty=shared,
                    findings=findings)


def _key(comment: str) -> str:
    return comment[1:].partition(":")[0].strip()


def _shared_uncertainty(text: RecordingText, comments: list[tuple[int, str]]) -> float:
    """The uncertainty that all points share, from its line; 0 without one."""
    found = 0.0
    for line, content in comments:
        if _key(content) == SHARED_UNCERTAINTY:
            try:
                found = float(content.partition(":")[2])
            except ValueError:
                found = -1.0
            if not 0.0 <= found < 1.0:
                raise text.error(line, None, content, "a share of Z from 0 to less than 1")
    return found


def _origin(text: RecordingText, comments: list[tuple[int, str]]) -> Origin:
    if not comments:
        return Origin("unknown", source=text.path, sha256=text.sha256)
    found: dict[str, str] = {}
    settings: dict[str, str] = {}
    for line, content in comments:
        key, colon, value = content[1:].partition(":")
        key, value = key.strip(), value.strip()
        target, name = (settings, key.removeprefix("setting ")) if key.startswith("setting ") else (found, key)
        if not colon or (target is found and name not in _ORIGIN_KEYS):
            raise InputError(text.path, f"line {line}", content,
                             "'# key: value' with a key of " + ", ".join((*_ORIGIN_KEYS, "setting NAME")),
                             nearest_names(key, _ORIGIN_KEYS))
        if name in target:
            raise text.error(line, None, content, f"{key!r} only once")
        target[name] = value
    if found.get("kind", "unknown") not in ORIGIN_KINDS:
        raise InputError(text.path, "kind", found["kind"], "one of " + ", ".join(ORIGIN_KINDS))
    return Origin(**found, settings=settings)
