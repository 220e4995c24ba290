"""Files written whole or not at all, and the remedies if one cannot be written."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from workbench.files.errors import InputError

#: Part of the names of folders, beside the files, in which these are written before they take their place.
UNFINISHED = ".unfinished-"

#: The file in a folder of results that marks them as incomplete.
MARK = "INCOMPLETE.txt"

#: Lines of a mark that are of the process at work; those of an interrupted one before it follow.
OWN_LINES = 2

#: Remedies for errors of the system.
REMEDIES = {
    errno.ENOSPC: "the disk is full: make room, or choose a folder on another disk",
    errno.EDQUOT: "your share of the disk is used up: make room, or choose a folder on another disk",
    errno.EROFS: "the disk can only be read: choose a folder on another one",
    errno.EACCES: "you may not write there: choose a folder of your own, or have its permissions changed",
    errno.EPERM: "you may not write there: choose a folder of your own, or have its permissions changed",
    errno.ENOTDIR: "a file is in the way: choose another folder, or move the file",
    errno.EEXIST: "a file is in the way: choose another folder, or move the file",
    errno.EISDIR: "a folder is in the way: choose another name, or move the folder",
    errno.ENAMETOOLONG: "the name is too long: choose a shorter one",
    errno.EIO: "the disk does not answer as it should: choose another one",
    errno.EMFILE: "too many files are open: close other programs, or raise the limit (ulimit -n)",
}


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path of the same name to write to; its file takes the place of `path` once it is whole.

    A reader sees either the old file or the new one, never a part of it, and a power cut leaves one of the two. A
    device or a pipe is written to directly, and stays as it is.

    Raises:
        OSError: it cannot be written; the error names `path`.
    """
    with naming(path):
        replaceable = path.is_file() or not path.exists()
        if replaceable:
            path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent if replaceable else None,
                                         prefix=f".{path.name}{UNFINISHED}") as folder:
            whole = Path(folder) / path.name
            yield whole
            if not replaceable:
                path.write_bytes(whole.read_bytes())
                return
            with whole.open("rb") as stream:
                os.fsync(stream.fileno())
            os.replace(whole, path)
            sync_folder(path.parent)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Let an error of the system in this block name the file to be written, if it names none or a temporary one."""
    try:
        yield
    except OSError as error:
        number = _number(error)
        if number is not None and (error.filename is None or UNFINISHED in str(error.filename)):
            raise OSError(number, os.strerror(number), str(path)) from error
        raise


def _number(error: OSError) -> int | None:
    """The system's number of an error; libraries that wrap one state it in their message."""
    found = re.search(r"errno = (\d+)", str(error)) if error.errno is None else None
    return int(found.group(1)) if found else error.errno


def remedy(error: OSError, output: Path | None = None) -> str:
    """A description of an error on a file, with a remedy; `output` is the folder a command writes to, if any."""
    if error.errno is None:
        return str(error)
    where = error.filename if error.filename is not None else output
    words = error.strerror or type(error).__name__
    what = words if where is None else f"{where}: {words}"
    return f"{what}; {REMEDIES[error.errno]}" if error.errno in REMEDIES else what


def writable_folder(path: Path, *, source: str, field: str, room: float = 0.0) -> Path:
    """The folder for results, made if need be, with `room` (bytes) on its disk.

    Until :func:`settle_folder` it holds a file (:data:`MARK`) that marks it as incomplete: whatever ends the program,
    nobody takes half of the results for all.

    Raises:
        InputError: a file is in the way, it cannot be made or written to, or the disk is too full.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path, prefix=f".try{UNFINISHED}"):
            pass
        free = shutil.disk_usage(path).free
    except OSError as error:
        expected = REMEDIES.get(error.errno or 0, error.strerror or str(error))
        raise InputError(source, field, str(path), f"a folder that can be written to; {expected}") from None
    if free < room:
        raise InputError(source, field, str(path), f"a folder on a disk with {room / 1e6:.3g} MB of room for the "
                         f"results; {free / 1e6:.3g} MB are free: make room, or choose a folder on another disk")
    mark = path / MARK
    if _marked_by(mark) is None:
        try:
            write_atomic(mark, f"{os.getpid()} is the process that writes the results in this folder.\n"
                         "They are not complete: it is still at work, or it was interrupted or failed.\n"
                         + "".join(_lines(mark)[:OWN_LINES]))
        except OSError as error:
            raise InputError(source, field, str(path), f"a folder that can be written to; {remedy(error)}") from None
    return path


def settle_folder(path: Path, *, complete: bool) -> None:
    """Remove the mark that :func:`writable_folder` set in a folder, if the results are `complete` or nothing was
    written since; then an earlier process' mark is there again."""
    mark = path / MARK
    if _marked_by(mark) != os.getpid():
        return
    began = mark.stat().st_mtime
    written = [each for each in path.iterdir() if each != mark and not each.name.startswith(".")
               and each.stat().st_mtime >= began]
    earlier = _lines(mark)[OWN_LINES:]
    if not complete and not written and earlier:
        write_atomic(mark, "".join(earlier))
    elif complete or not written:
        mark.unlink(missing_ok=True)


def _lines(mark: Path) -> list[str]:
    """The lines of a mark; none where there is no mark."""
    return mark.read_text(encoding="utf-8").splitlines(keepends=True) if mark.is_file() else []


def _marked_by(mark: Path) -> int | None:
    """The process that set a mark, if it is alive."""
    try:
        number = int(mark.read_text(encoding="utf-8").split()[0])
        os.kill(number, 0)
    except (OSError, ValueError, IndexError):
        return None
    return number


def sync_folder(folder: Path) -> None:
    """Make a new name in a folder durable."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_atomic(path: Path, content: str | bytes) -> None:
    """Write `content` to `path` so that a reader sees either the old file or the new one (:func:`replacing`).

    Raises:
        OSError: it cannot be written; the error names `path`.
    """
    with replacing(path) as whole:
        whole.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def write_json(path: Path, record: Mapping[str, Any]) -> Path:
    """Write a record as JSON, whole or not at all.

    Raises:
        ValueError: a number in it is infinite or none.
        OSError: it cannot be written; the error names `path`.
    """
    write_atomic(path, json.dumps(record, indent=2, allow_nan=False) + "\n")
    return path
