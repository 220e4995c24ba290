"""Versions of a saved fit: names, files and withdrawal.

::

    pzt4/disc_7@1.toml          ->   "pzt4/disc_7@1", never changed
    pzt4/disc_7@1.withdrawn     ->   date and reason of the withdrawal of that version

A file is written to a temporary name and gets its own name by a hard link. A link is atomic and fails if the name
exists, so no reader sees a part of a file, and a version is never overwritten. If two runs need one number, the second
takes the next. A killed run leaves at most a temporary file that no reader opens. No lock is needed.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from materials.lines import with_line_number
from materials.value import date_text
from workbench.files.names import NUMBER_MARKS, check_name
from workbench.files.tables import FileTable
from workbench.files.toml import toml_lines

_VERSION = re.compile(r"([^/@]+/[^/@]+)@([1-9][0-9]{0,8})")


class WithdrawnWarning(UserWarning):
    """A withdrawn version is used by its full name."""


@dataclass(frozen=True)
class Withdrawal:
    """Date (ISO 8601) and reason of the withdrawal of a version."""

    date: str
    reason: str


def split_version(name: str) -> tuple[str, int] | None:
    """Split ``"pzt4/disc_7@2"`` into ``("pzt4/disc_7", 2)``; None for a name without version."""
    match = _VERSION.fullmatch(name)
    return None if match is None else (match.group(1), int(match.group(2)))


def versions_of(name: str, names: Iterable[str]) -> list[str]:
    """The versions of `name`, such as ``pzt4/disc_7``, among `names`; the oldest first."""
    found = {known: split for known in names if (split := split_version(known)) is not None and split[0] == name}
    return sorted(found, key=lambda known: found[known][1])


def check_saved_name(name: str, *, source: str = "materials", field: str = "name") -> str:
    """The `name` itself if a fit can be saved under it.

    `source` and `field` are its place, for messages.

    Raises:
        InputError: not ``material/name`` in letters, digits, ``_`` and ``-``; a name with a version.
    """
    return check_name(name, source=source, field=field, form="material/name", marks=NUMBER_MARKS)


def entry_file(folder: Path, name: str) -> Path:
    """The file of the entry called `name` in a folder of materials."""
    material, _, rest = name.partition("/")
    return folder / material / f"{rest}.toml"


def entry_name(path: Path) -> str:
    """The name of the entry in a materials file."""
    return f"{path.parent.name}/{path.stem}"


def withdrawal_file(entry: Path) -> Path:
    """The file beside an entry that marks it as withdrawn."""
    return entry.with_suffix(".withdrawn")


def withdrawal_text(withdrawal: Withdrawal) -> str:
    """The content of the file of a withdrawal."""
    return "\n".join([*toml_lines({"date": withdrawal.date, "reason": withdrawal.reason}), ""])


def read_withdrawal(entry: Path) -> Withdrawal | None:
    """The withdrawal of the entry in the file `entry`, or None.

    Raises:
        InputError: the record is damaged.
    """
    path = withdrawal_file(entry)
    if not path.is_file():
        return None
    with with_line_number(path):
        table = FileTable.read(path).only(("date", "reason"))
        return Withdrawal(date_text(table, "date"), table.text("reason"))


def put(content: bytes, paths: Iterable[Path]) -> Path:
    """Write `content` to the first of `paths` that does not exist. Return that path.

    All paths are in one folder, which is made if needed.

    Raises:
        FileExistsError: all of them exist.
        OSError: the disk is full, the folder is read-only, or its file system has no hard links.
    """
    paths = iter(paths)
    path = next(paths)
    path.parent.mkdir(parents=True, exist_ok=True)
    # No entry has this suffix, so no reader opens the file of a killed run.
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}.", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            # Otherwise a power cut may leave the name without the content.
            os.fsync(stream.fileno())
        os.chmod(temporary, 0o644)
        while True:
            try:
                os.link(temporary, path)
                break
            except FileExistsError:
                following = next(paths, None)
                if following is None:
                    raise
                path = following
    finally:
        Path(temporary).unlink(missing_ok=True)
    return path
