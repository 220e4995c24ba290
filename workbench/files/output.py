"""The output folder of a command, which never replaces a user's file.

    with begin(path, Outputs("simulate", names=("report.html", "spectrum_*.csv"))) as folder:
        write_atomic(folder.path / "report.html", text)

Only one run at a time uses a folder. Files that any thread or process of it writes are entered in the folder's manifest
(`workbench.files.ownership`), which the next run reads.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from workbench.files.errors import InputError
from workbench.files.ownership import (
    HEADER,
    LOCK,
    MANIFEST,
    NEW,
    RUN,
    STATE,
    Manifest,
    Outputs,
    digest_of,
    entry,
    in_the_way,
    is_state,
    lines,
    matches,
)
from workbench.files.writing import REMEDIES, remedy, write_atomic

#: The file in an output folder that marks its results as incomplete.
MARK = "INCOMPLETE.txt"

#: The first line of a mark of the versions without a manifest.
OLD_MARK = re.compile(r"\d+ is the process that writes the results in this folder\.\n")

#: Free bytes on disk that a command needs: a report with its pictures. Doubled, a nearly full disk is rejected sooner.
ROOM = 20e6

#: Names in a message; further ones are counted.
LISTED = 12

#: Attempts to lock, and seconds between them: another process that tests the lock takes it for a moment.
ATTEMPTS, PAUSE = 5, 0.02


@dataclass(frozen=True)
class Leftovers:
    """Files of earlier runs in a folder. ``removed`` are gone; ``remaining`` are (name, command) of the others."""

    removed: tuple[str, ...]
    remaining: tuple[tuple[str, str], ...]

    def __str__(self) -> str:
        # All names, since these files are gone.
        parts = [f"removed {', '.join(self.removed)} of an earlier run"] if self.removed else []
        for command in dict.fromkeys(command for _, command in self.remaining):
            names = [name for name, each in self.remaining if each == command]
            parts.append(f"{enumerated(names)} {'are' if len(names) > 1 else 'is'} of an earlier `workbench {command}`")
        return "; ".join(parts)


class OutputFolder:
    """The folder ``path`` of a run, locked until :meth:`finish`. The end of a ``with`` block finishes it. A run that
    fails and has written nothing removes the folders it ``made``."""

    def __init__(
        self, path: Path, outputs: Outputs, lock: int, inputs: frozenset[str], made: Sequence[Path] = ()
    ) -> None:
        self.path, self.outputs, self._lock, self._inputs = path, outputs, lock, inputs
        #: Files and folders that :func:`begin` created, the innermost first.
        self._made = made
        #: Whether a mark of another run, or one changed by the user, remains although the results are complete.
        self.has_mark = False
        manifest = Manifest(path)
        self._before = {name: command for name, command in manifest.commands.items()
                        if manifest.owns(name, outputs.working)}
        # A new manifest begins with the present files; the lines of this run follow.
        write_atomic(path / STATE / MANIFEST, HEADER + "".join(
            entry(name, digest_of(path / name), command) for name, command in self._before.items()))
        mark, self._earlier_mark = path / MARK, None
        if not outputs.marked:
            return
        self._earlier_mark = mark.read_text(encoding="utf-8") if mark.is_file() else None
        if self._earlier_mark is not None and MARK not in self._before:
            mark.unlink()
        write_atomic(mark, f"`workbench {outputs.command}` (process {os.getpid()}, begun {now()}) writes the results "
                     "in this folder.\nThey are not complete: it is still at work, or it was interrupted or failed.\n")

    def __fspath__(self) -> str:
        return str(self.path)

    def __enter__(self) -> OutputFolder:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
                 ) -> None:
        self.finish(complete=error is None)

    def finish(self, *, complete: bool) -> None:
        """Unlock the folder, and remove its mark if the results are `complete`. The mark is also removed if nothing was
        written. The mark of an earlier incomplete run is restored, unless this run of the same command is complete."""
        if self._lock < 0:
            return
        written, mark, earlier = self._written(), self.path / MARK, self._earlier_mark
        done = complete and (earlier is None or marking(earlier) in ("", self.outputs.command))
        if earlier is not None and not done and (complete or not written):
            write_atomic(mark, earlier)
        elif self.outputs.marked and (complete or not written) and Manifest(self.path).owns(MARK):
            mark.unlink()
        self.has_mark = complete and mark.exists()
        clear(self.path)
        (self.path / STATE / RUN).unlink(missing_ok=True)
        if not complete and not written:
            _unmake(self._made)
        os.close(self._lock)
        self._lock = -1

    def tidy(self) -> Leftovers:
        """Remove files of the command's earlier runs, except those written again. Only for a complete run."""
        manifest, written = Manifest(self.path), self._written()
        removed, remaining = [], []
        for name, command in self._before.items():
            if name in written or name in self._inputs or name == MARK or not manifest.owns(name):
                continue
            if command != self.outputs.command:
                remaining.append((name, command))
            elif not matches(name, (*self.outputs.kept, *self.outputs.working)):
                path = self.path / name
                path.unlink()
                removed.append(name)
                with suppress(OSError):
                    # A folder that is empty now was created for its files.
                    for folder in path.relative_to(self.path).parents[:-1]:
                        (self.path / folder).rmdir()
        return Leftovers(tuple(removed), tuple(remaining))

    def _written(self) -> set[str]:
        entered = list(lines(self.path / STATE / MANIFEST))[1 + len(self._before):]
        return {str(line.get("file")) for line in entered} - {MARK}


def begin(
    path: Path, outputs: Outputs, *, source: str, field: str, room: float = 0.0, inputs: Sequence[Path] = ()
) -> OutputFolder:
    """Lock the folder for results, and create it if needed.

    Until :meth:`OutputFolder.finish`, the file :data:`MARK` marks it as incomplete, so that partial results are
    recognised after any end of the program.

    Args:
        room: free bytes that the results need on its disk.
        inputs: files that the run reads, which are neither replaced nor removed.

    Raises:
        InputError: it contains files of the user under names that the run writes, another run is at work in it, it
            cannot be created or written to, or its disk is too full.
    """
    if path.name == STATE:
        raise InputError(source, field, str(path), f"a folder of another name: {STATE} holds the manifest of a run")
    made = [each for each in (path / STATE / LOCK, path / STATE, path, *path.parents) if not os.path.lexists(each)]
    try:
        path.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(path).free
        if free < room:
            raise InputError(source, field, str(path), f"a folder on a disk with {room / 1e6:.3g} MB of room for the "
                             f"results; {free / 1e6:.3g} MB are free: make room, or choose a folder on another disk")
        lock = _locked(path, source, field)
        try:
            _refuse_others(path, outputs, source, field)
            read = _refuse_inputs(path, outputs, inputs, source, field)
            write_atomic(path / STATE / RUN, json.dumps({
                "command": outputs.command, "process": os.getpid(), "begun": now(), "named": outputs.named,
                "working": outputs.working}) + "\n")
            return OutputFolder(path, outputs, lock, read, made)
        except BaseException:
            os.close(lock)
            raise
    except InputError:
        _unmake(made)
        raise
    except OSError as error:
        _unmake(made)
        expected = REMEDIES.get(error.errno or 0, remedy(error))
        raise InputError(source, field, str(path), f"a folder that can be written to; {expected}") from None


@contextmanager
def run_folder(path: Path | OutputFolder, outputs: Outputs, *, source: str) -> Iterator[OutputFolder]:
    """The folder, locked already or for this block."""
    if isinstance(path, OutputFolder):
        yield path
        return
    with begin(path, outputs, source=source, field="folder") as folder:
        yield folder


def marking(mark: str) -> str:
    """The command in a mark; "" for marks of earlier versions."""
    found = re.match(r"`workbench ([^`]*)`", mark)
    return found.group(1) if found else ""


def clear(folder: Path) -> None:
    """Remove files that an interrupted run was writing."""
    for begun in (folder / STATE).glob(f"{NEW}*"):
        shutil.rmtree(begun, ignore_errors=True)


def enumerated(names: Sequence[str]) -> str:
    """Names with commas between them, at most :data:`LISTED`."""
    more = f" and {len(names) - LISTED} more files" if len(names) > LISTED else ""
    return ", ".join(names[:LISTED]) + more


def now() -> str:
    """The local time, to the second."""
    return time.strftime("%Y-%m-%d %H:%M:%S")


def _locked(path: Path, source: str, field: str) -> int:
    """A handle with the lock of a folder."""
    state = path / STATE
    with suppress(FileExistsError):
        state.mkdir()
    if not is_state(state):
        raise InputError(source, field, str(path), f"a folder whose {STATE} is of the workbench; move {state} away, or "
                         "choose another folder")
    for attempt in range(ATTEMPTS):
        # Never written to or truncated: in a folder of somebody else it may be a hard link to another file.
        handle = os.open(state / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.lexists(state / LOCK) and os.fstat(handle).st_ino == (state / LOCK).lstat().st_ino:
                return handle
        except BlockingIOError:
            pass
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)
        if attempt < ATTEMPTS - 1:
            time.sleep(PAUSE)
    run = next(lines(state / RUN), {})
    holder = (f"process {run.get('process')} (workbench {run.get('command')}, begun {run.get('begun')})" if run else
              "another process")
    raise InputError(source, field, str(path), f"a folder in which no other run is at work; {holder} holds it: wait "
                     "for it, or choose another folder")


def _refuse_others(path: Path, outputs: Outputs, source: str, field: str) -> None:
    """Raise if the run would write over files of the user."""
    clear(path)
    manifest = Manifest(path)
    theirs = [name for name in in_the_way(path, (*outputs.names, *([MARK] if outputs.marked else [])))
              if not manifest.owns(name, outputs.working) and not (name == MARK and _is_old_mark(path / MARK))]
    if theirs:
        raise InputError(
            source, field, str(path), f"a folder in which `workbench {outputs.command}` replaces no file of yours; no "
            f"run of the workbench wrote {enumerated(theirs)} as {'it is' if len(theirs) == 1 else 'they are'} now: "
            f"choose another folder, or move {'it' if len(theirs) == 1 else 'them'} away")


def _refuse_inputs(
    path: Path, outputs: Outputs, inputs: Sequence[Path], source: str, field: str
) -> frozenset[str]:
    """The relative paths of inputs in the folder."""
    real = Path(os.path.realpath(path))
    inside = {each: Path(os.path.realpath(each)) for each in inputs}
    names = {each: at.relative_to(real).as_posix() for each, at in inside.items() if at.is_relative_to(real)}
    for each, name in names.items():
        if matches(name, outputs.names):
            raise InputError(source, field, str(path), f"another folder: `workbench {outputs.command}` reads {each}, "
                             "and would write a result under its name")
    return frozenset(names.values())


def _is_old_mark(mark: Path) -> bool:
    return not mark.is_symlink() and mark.is_file() and OLD_MARK.match(mark.read_text(errors="replace")) is not None


def _unmake(made: Sequence[Path]) -> None:
    for each in made:
        with suppress(OSError):
            if each.name == LOCK:
                each.unlink()
            elif each.name == STATE:
                shutil.rmtree(each)
            else:
                each.rmdir()
