"""Line numbers of errors in files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from workbench.files.errors import InputError

_HEADER = re.compile(r"""^\s*\[{1,2}([\w\s."'-]+)\]{1,2}\s*(?:#.*)?$""")
_KEY = re.compile(r"""^\s*([\w."'-]+)\s*=""")


@contextmanager
def with_line_number(path: Path) -> Iterator[None]:
    """Add the line number to an error about the file at `path`.

    A missing statement has no line; the error then names the last line of the file, which reveals a truncated file.

    Raises:
        InputError: the original error, with the line in its ``source``.
    """
    try:
        yield
    except InputError as error:
        if error.source != str(path) or not path.is_file():
            raise
        place = _place(path.read_text(encoding="utf-8", errors="replace"), error)
        raise InputError(f"{path}{place}", error.field, error.value, error.expected, error.nearest) from None


def _place(text: str, error: InputError) -> str:
    missing = error.value in (None, "nothing") or "at end of document" in str(error.value)
    line = line_of(text, error.field, whole=missing)
    if line is not None:
        return f", line {line}"
    return f" (ends at line {len(text.splitlines())})" if missing else ""


def line_of(text: str, field: str, *, whole: bool = False) -> int | None:
    """The line (from 1) of a TOML text that states `field`. An example of a field is ``fit.band``. Without the field,
    it is the line of the innermost table around it, or None; with `whole`, only the field counts."""
    best, best_length, table, inside_text = None, 0, "", False
    for number, line in enumerate(text.splitlines(), start=1):
        opens = (line.count('"""') + line.count("'''")) % 2 == 1
        if not inside_text:
            header, key = _HEADER.match(line), _KEY.match(line)
            here = ""
            if header:
                here = table = header.group(1).replace('"', "").replace("'", "").strip()
            elif key:
                here = ".".join(filter(None, (table, key.group(1).strip("\"'"))))
            matches = here == field or (not whole and bool(here) and field.startswith((f"{here}.", f"{here}[")))
            if matches and len(here) > best_length:
                best, best_length = number, len(here)
        inside_text ^= opens
    return best
