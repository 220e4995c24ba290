"""Files that end in a digest, to detect changes and truncation.

The digest is a line at the end of the file, ``sha256 ...``; readers of HDF5 and of zip archives ignore it.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError, file_error
from workbench.files.writing import replacing

#: Beginning of the last line; the digest in hexadecimal digits and a line end follow.
_MARK = b"\nsha256 "

#: Bytes of the last line.
_SIZE = len(_MARK) + 64 + 1

#: Bytes that are read at a time. Doubled, it needs more memory, and no less time.
_BLOCK = 1 << 20

#: Name of the array with the JSON text of :func:`write_arrays`.
_CONTENT = "content"


def seal(path: Path) -> None:
    """Append the digest of a file to it."""
    digest, _ = _digest_and_end(path, 0)
    with path.open("ab") as stream:
        stream.write(_MARK + digest + b"\n")


def is_sealed(path: Path) -> bool:
    """Check the digest at the end of a file.

    False if there is none.

    Raises:
        InputError: the digest is of another content, or the file cannot be read.
    """
    try:
        digest, end = _digest_and_end(path, _SIZE)
    except OSError as error:
        raise file_error(path, f"a readable file ({error.strerror or error})") from error
    if not end.startswith(_MARK):
        return False
    if end != _MARK + digest + b"\n":
        stated = end[len(_MARK):].decode("ascii", "replace")
        raise InputError(str(path), "content", f"sha256 {digest[:12].decode()}",
                         f"{stated[:12]}, the digest at its end: the file was changed after it was written; restore a "
                         "copy, or make it again")
    return True


def _digest_and_end(path: Path, size: int) -> tuple[bytes, bytes]:
    """The digest of all but the last `size` bytes, and these bytes."""
    digest, remaining = hashlib.sha256(), max(path.stat().st_size - size, 0)
    with path.open("rb") as stream:
        while remaining > 0 and (block := stream.read(min(remaining, _BLOCK))):
            digest.update(block)
            remaining -= len(block)
        return digest.hexdigest().encode(), stream.read(size)


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], content: Mapping[str, Any] | None = None) -> None:
    """Write named arrays, and JSON `content`, as a sealed npz file.

    It is atomic.

    Raises:
        OSError: it cannot be written; the error names `path`.
    """
    text = np.frombuffer(json.dumps(dict(content or {})).encode(), dtype=np.uint8)
    with replacing(path) as whole:
        with whole.open("wb") as stream:
            np.savez(stream, **{_CONTENT: text, **arrays})  # type: ignore[arg-type]  # numpy's stub takes them for a flag
        seal(whole)


def read_arrays(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """The content and the arrays of a file of :func:`write_arrays`.

    No code in the file is executed.

    Raises:
        InputError: the file cannot be read, is damaged, or was written by another program.
    """
    if not is_sealed(path):
        raise InputError(str(path), "content", "no digest at its end", "a whole file of this version of the workbench: "
                         "this one was cut off, or written by something else; restore a copy, or make it again")
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        content = json.loads(arrays.pop(_CONTENT).tobytes())
        return dict(content), arrays
    except (OSError, ValueError, TypeError, KeyError, EOFError, RecursionError, zipfile.BadZipFile) as error:
        raise InputError(str(path), "file", repr(error), "arrays that the workbench wrote") from error
