"""Atomic writing of files, and remedies for errors."""

from __future__ import annotations

import errno
import json
import math
import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from workbench.files.ownership import NEW, STATE, claim_of

#: Part of the names of temporary folders, beside the files that are being written.
UNFINISHED = ".unfinished-"

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
    """A temporary path to write to, which replaces `path` at the end.

    A reader sees either the old file or the new one, never a part of it, also after a power cut. A device or a pipe is
    written to directly. In the folder of a run the file is entered in the manifest, and replaces only a run's file.

    Raises:
        OSError: it cannot be written, or belongs to the user; the error names `path`.
    """
    with naming(path):
        replaceable = path.is_file() or not path.exists()
        claim = claim_of(path) if replaceable else None
        if claim is not None:
            claim.check()
        if replaceable:
            path.parent.mkdir(parents=True, exist_ok=True)
        place, prefix = ((claim.folder / STATE, NEW) if claim is not None else
                         (path.parent, NEW) if path.parent.name == STATE else
                         (path.parent if replaceable else None, f".{path.name}{UNFINISHED}"))
        with tempfile.TemporaryDirectory(dir=place, prefix=prefix) as folder:
            whole = Path(folder) / path.name
            yield whole
            if not replaceable:
                path.write_bytes(whole.read_bytes())
                return
            with whole.open("rb") as stream:
                os.fsync(stream.fileno())
            if claim is not None:
                claim.enter(whole)
            os.replace(whole, path)
            sync_folder(path.parent)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Make errors of the system in this block name the file `path`. Only if they name no file or a temporary one."""
    try:
        yield
    except OSError as error:
        number = _number(error)
        if number is not None and (error.filename is None or UNFINISHED in str(error.filename)
                                   or f"{STATE}/{NEW}" in str(error.filename)):
            raise OSError(number, os.strerror(number), str(path)) from error
        raise


def _number(error: OSError) -> int | None:
    """The system's number of an error, also from a library's message."""
    if error.errno is not None:
        return error.errno
    found = re.search(r"errno = (\d+)", str(error))
    return int(found[1]) if found else None


def remedy(error: OSError, output: Path | None = None) -> str:
    """A description of an error on a file, with a remedy. `output` is the folder that a command writes to, if any."""
    if error.errno is None:
        return str(error)
    where = error.filename if error.filename is not None else output
    words = error.strerror or type(error).__name__
    text = words if where is None else f"{where}: {words}"
    return f"{text}; {REMEDIES[error.errno]}" if error.errno in REMEDIES else text


def sync_folder(folder: Path) -> None:
    """Make a new name in a folder durable."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_atomic(path: Path, content: str | bytes) -> None:
    """Write `content` to `path`, atomically (:func:`replacing`).

    Raises:
        OSError: it cannot be written; the error names `path`.
    """
    with replacing(path) as whole:
        whole.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def _numbers(record: object, key: str = "") -> Iterator[tuple[str, float]]:
    """The floating-point numbers of a record with their keys. Keys are such as ``states.filled.q``."""
    if isinstance(record, float):
        yield key, record
    elif isinstance(record, Mapping):
        for name, each in record.items():
            yield from _numbers(each, f"{key}.{name}".lstrip("."))
    elif isinstance(record, list | tuple):
        for number, each in enumerate(record):
            yield from _numbers(each, f"{key}[{number}]")


def write_json(path: Path, record: Mapping[str, Any]) -> Path:
    """Write a record as JSON, atomically.

    Raises:
        ValueError: a number in it is infinite or NaN; the error names its key.
        OSError: it cannot be written; the error names `path`.
    """
    for key, value in _numbers(record):
        if not math.isfinite(value):
            raise ValueError(f"{path}: {key} is {value}, which JSON does not have")
    write_atomic(path, json.dumps(record, indent=2, allow_nan=False) + "\n")
    return path
