"""Versions of a saved fit: their names, their files, and their withdrawal.

    pzt4/disc_7@1.toml          ->   "pzt4/disc_7@1", never changed once it is there
    pzt4/disc_7@1.withdrawn     ->   date and reason of the withdrawal of that version

A file is put in place whole, by a hard link to a temporary file that was written before: the system makes a link
completely or not at all, and refuses a name that exists. So no reader ever sees a part of a file, and a version is
never overwritten. Of two runs that want one number, one gets it and the other takes the next. A run killed at any
moment leaves at most a temporary file that nobody reads. A lock would add nothing, and could be left behind.
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
    """A withdrawn version is used, by its full name."""


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
    """The `name` itself if a fit can be saved under it; `source` and `field` are its place, for messages.

    Raises:
        InputError: anything but ``material/name`` in letters, digits, ``_`` and ``-``, such as a version, which is
            counted.
    """
    return check_name(name, source=source, field=field, form="material/name", marks=NUMBER_MARKS)


def entry_file(folder: Path, name: str) -> Path:
    """The file of the entry called `name` in a folder of materials."""
    material, _, rest = name.partition("/")
    return folder / material / f"{rest}.toml"


def entry_name(path: Path) -> str:
    """The name of the entry in a file of a folder of materials."""
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
        InputError: somebody has spoiled the record.
    """
    path = withdrawal_file(entry)
    if not path.is_file():
        return None
    with with_line_number(path):
        table = FileTable.read(path).only(("date", "reason"))
        return Withdrawal(date_text(table, "date"), table.text("reason"))


def put(content: bytes, paths: Iterable[Path]) -> Path:
    """Put `content` at the first of `paths` that does not exist yet, all in one folder, and return that path.

    The folder is made if need be.

    Raises:
        FileExistsError: all of them exist.
        OSError: the disk is full, the folder is read-only, or its file system has no hard links.
    """
    paths = iter(paths)
    path = next(paths)
    path.parent.mkdir(parents=True, exist_ok=True)
    # No entry has this suffix: nobody reads the file that a killed run leaves behind.
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}.", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            # Otherwise a power cut might leave the name without the content.
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
