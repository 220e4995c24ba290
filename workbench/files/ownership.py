"""Files that runs of the workbench wrote in an output folder.

    DIR/.workbench/lock            locked (flock) by the run at work, never written to
    DIR/.workbench/run.json        that run: its command, process, begin, and the names that it writes
    DIR/.workbench/manifest.jsonl  a line for each file that a run wrote, entered before the file takes its place
    DIR/.workbench/new-*           files that are being written; the next run removes them

A file that is not in the manifest with its present digest belongs to the user: no run replaces or removes it.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

STATE, LOCK, RUN, MANIFEST, NEW = ".workbench", "lock", "run.json", "manifest.jsonl", "new-"

#: First line of a manifest.
HEADER = '{"format": "files of the workbench, 1"}\n'

#: Levels of folders above a file that are searched for its run. Doubled, files may lie deeper in an output folder.
DEPTH = 4

#: Message for a file of the user.
FOREIGN = "a file that no run of the workbench wrote"


@dataclass(frozen=True)
class Outputs:
    """The files that a ``command`` writes.

    ``names`` are patterns of relative paths; ``*`` is part of one name. A run removes files of the command's earlier
    runs that it does not write again. Exceptions are ``kept`` files (results of their own) and ``working`` files (a run
    continues with them). A working file is known by its name, so that a damaged one is written again. The folder does
    not own files that the user ``named``. A folder is ``marked`` as incomplete until the run ends.
    """

    command: str
    names: tuple[str, ...] = ()
    kept: tuple[str, ...] = ()
    working: tuple[str, ...] = ()
    named: tuple[str, ...] = ()
    marked: bool = True


def matches(name: str, patterns: Iterable[str]) -> bool:
    """Whether a relative path is one of `patterns`."""
    parts = name.split("/")
    return any(len(parts) == len(wanted) and all(map(fnmatchcase, parts, wanted))
               for wanted in (pattern.split("/") for pattern in patterns))


def in_the_way(folder: Path, patterns: Iterable[str]) -> Iterator[str]:
    """Relative paths of entries in a folder with one of the names. Also of a file or link in the place of a folder.
    Hidden entries are left out; links and other folders are not followed."""
    wanted = [pattern.split("/") for pattern in patterns]
    for here, folders, files in os.walk(folder, followlinks=False):
        above = () if Path(here) == folder else Path(here).relative_to(folder).parts
        entered = []
        for name in sorted((*folders, *files)):
            if name.startswith("."):
                continue
            parts = (*above, name)
            close = [each for each in wanted if all(map(fnmatchcase, parts, each))]
            is_folder = name in folders and not (Path(here) / name).is_symlink()
            if any(len(each) == len(parts) or (len(each) > len(parts) and not is_folder) for each in close):
                yield "/".join(parts)
            elif is_folder and any(len(each) > len(parts) for each in close):
                entered.append(name)
        folders[:] = entered


class Manifest:
    """The files that runs wrote in a folder. ``digests`` and ``commands`` are by relative path; the command is that
    which wrote the file last."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.digests: dict[str, set[str]] = {}
        self.commands: dict[str, str] = {}
        for line in lines(folder / STATE / MANIFEST):
            name, digest = str(line.get("file", "")), str(line.get("sha256"))
            if stays_inside(name):
                self.digests.setdefault(name, set()).add(digest)
                self.commands[name] = str(line.get("command"))

    def owns(self, name: str, working: Iterable[str] = ()) -> bool:
        """Whether a relative path is an unchanged file of a run. A file that matches `working` may be changed."""
        path = self.folder / name
        if name not in self.digests or link_above(self.folder, path) is not None or not path.is_file():
            return False
        return matches(name, working) or digest_of(path) in self.digests[name]


def entry(name: str, digest: str, command: str) -> str:
    """The line of a file in a manifest."""
    return json.dumps({"file": name, "sha256": digest, "command": command}) + "\n"


def lines(path: Path) -> Iterator[Mapping[str, Any]]:
    """Entries of a manifest; an incomplete line is skipped. Its file never took its place."""
    if not path.is_file():
        return
    for line in path.read_bytes().split(b"\n"):
        try:
            entry = json.loads(line)
        except (ValueError, RecursionError):
            continue
        if isinstance(entry, dict):
            yield entry


def is_state(path: Path) -> bool:
    """Whether a path is the state folder of the workbench alone."""
    if path.is_symlink() or not path.is_dir():
        return False
    for each in path.iterdir():
        if each.is_symlink() or not (each.name in (LOCK, RUN, MANIFEST) or each.name.startswith(NEW)):
            return False
        # The lock is always empty.
        begins = {LOCK: b"", RUN: b'{"command"', MANIFEST: HEADER.encode()}.get(each.name)
        if begins is not None and (not each.is_file() or each.stat().st_size < len(begins)
                                   or _beginning(each, max(1, len(begins))) != begins):
            return False
    return True


def _beginning(path: Path, size: int) -> bytes:
    with path.open("rb") as stream:
        return stream.read(size)


def stays_inside(name: str) -> bool:
    """Whether a relative path stays in its folder."""
    return bool(name) and not name.startswith("/") and ".." not in name.split("/")


def link_above(folder: Path, path: Path) -> Path | None:
    """The first link among a path and its folders, or None. Only folders within `folder` are checked."""
    return next((each for each in (path, *path.parents) if folder in each.parents and each.is_symlink()), None)


def digest_of(path: Path) -> str:
    """The SHA-256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@dataclass(frozen=True)
class Claim:
    """A file ``name`` in a ``folder`` that the run ``run`` has locked."""

    folder: Path
    name: str
    run: Mapping[str, Any]

    @property
    def path(self) -> Path:
        return self.folder / self.name

    def enter(self, whole: Path) -> None:
        """Enter the file in the manifest before `whole` takes its place.

        Raises:
            OSError: the file exists, and no run wrote it.
        """
        self.check()
        line = entry(self.name, digest_of(whole), str(self.run.get("command")))
        handle = os.open(self.folder / STATE / MANIFEST, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            os.write(handle, line.encode())
        finally:
            os.close(handle)

    def check(self) -> None:
        """Raise if a user's file or a link is in the place.

        Raises:
            OSError: so it is; the error names the file.
        """
        link = link_above(self.folder, self.path)
        if link is not None or (os.path.lexists(self.path)
                                and not Manifest(self.folder).owns(self.name, self.run.get("working", ()))):
            raise OSError(errno.EEXIST, FOREIGN, str(link or self.path))


def claim_of(path: Path) -> Claim | None:
    """The claim of the run at work on a file. None for a file outside the folder of a run, or that the user named. The
    lock on the disk shows whether a run is at work, so its threads and processes need no message."""
    here = Path(os.path.abspath(path))
    for folder in list(here.parents)[:DEPTH]:
        if folder.name == STATE:
            return None
        run = run_at_work(folder)
        if run is not None:
            name = here.relative_to(folder).as_posix()
            return None if name in run.get("named", ()) else Claim(folder, name, run)
    return None


def run_at_work(folder: Path) -> Mapping[str, Any] | None:
    """The run that has locked a folder, or None."""
    try:
        handle = os.open(folder / STATE / LOCK, os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        return None
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return next(lines(folder / STATE / RUN), {})
    finally:
        os.close(handle)
    return None


def discard(path: Path) -> None:
    """Remove a file that a run wrote, if it exists.

    Raises:
        OSError: it belongs to the user; the error names it.
    """
    claim = claim_of(path)
    if claim is not None:
        claim.check()
    path.unlink(missing_ok=True)
