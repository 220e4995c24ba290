"""Files written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path of the same name to write to, whose file takes the place of `path` once it is whole.

    A reader sees either the old file or the new one, never a part of it, and a power cut leaves one of the two. A
    device or a pipe is written to, and stays what it is.
    """
    replaceable = path.is_file() or not path.exists()
    if replaceable:
        path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent if replaceable else None, prefix=f".{path.name}.") as folder:
        whole = Path(folder) / path.name
        yield whole
        if not replaceable:
            path.write_bytes(whole.read_bytes())
            return
        with whole.open("rb") as stream:
            os.fsync(stream.fileno())
        os.replace(whole, path)
        sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make a new name in a folder last."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_atomic(path: Path, content: str | bytes) -> None:
    """Write `content` to `path` so that a reader sees either the old file or the new one (:func:`replacing`)."""
    with replacing(path) as whole:
        whole.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
