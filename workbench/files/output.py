"""The output folder of a command: one run at a time, and no file of the user replaced or removed.

    with begin(path, Outputs("simulate", names=("report.html", "spectrum_*.csv"))) as folder:
        write_atomic(folder.path / "report.html", text)

Files that are written in the folder meanwhile, by any thread or process, are entered in its manifest
(`workbench.files.ownership`), which the next run goes by.
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

#: Names that a message lists; of more there is a number.
LISTED = 12

#: Attempts to lock, this many seconds apart: a look at the lock holds it for a moment.
ATTEMPTS, PAUSE = 5, 0.02


@dataclass(frozen=True)
class Leftovers:
    """Files of earlier runs in a folder: those ``removed``, and those that remain, by the ``command`` of each."""

    removed: tuple[str, ...]
    remaining: tuple[tuple[str, str], ...]

    def __str__(self) -> str:
        said = [f"removed {enumerated(self.removed)} of an earlier run"] if self.removed else []
        for command in dict.fromkeys(command for _, command in self.remaining):
            names = [name for name, each in self.remaining if each == command]
            said.append(f"{enumerated(names)} {'are' if len(names) > 1 else 'is'} of an earlier `workbench {command}`")
        return "; ".join(said)


class OutputFolder:
    """The folder ``path`` of a run, held until :meth:`finish`; the end of a ``with`` block finishes it."""

    def __init__(self, path: Path, outputs: Outputs, lock: int, inputs: frozenset[str]) -> None:
        self.path, self.outputs, self._lock, self._inputs = path, outputs, lock, inputs
        #: Whether a mark is still there though the results are complete: of another run, or changed by the user.
        self.mark_stays = False
        manifest = Manifest(path)
        self._before = {name: command for name, command in manifest.commands.items()
                        if manifest.owns(name, outputs.working)}
        # The manifest begins anew with the files that are there; the lines of this run follow.
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
        """Let the folder go. Its mark stays unless the results are `complete`, or nothing was written.

        The mark of an earlier run that did not end is there again, unless this run of the same command is complete.
        """
        if self._lock < 0:
            return
        written, mark, earlier = self._written(), self.path / MARK, self._earlier_mark
        done = complete and (earlier is None or marking(earlier) in ("", self.outputs.command))
        if earlier is not None and not done and (complete or not written):
            write_atomic(mark, earlier)
        elif self.outputs.marked and (complete or not written) and Manifest(self.path).owns(MARK):
            mark.unlink()
        self.mark_stays = complete and mark.exists()
        clear(self.path)
        (self.path / STATE / RUN).unlink(missing_ok=True)
        os.close(self._lock)
        self._lock = -1

    def tidy(self) -> Leftovers:
        """Remove files of the command's earlier runs that this run, which is complete, has not written."""
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
                    # A folder that is empty now was made for the files in it.
                    for folder in path.relative_to(self.path).parents[:-1]:
                        (self.path / folder).rmdir()
        return Leftovers(tuple(removed), tuple(remaining))

    def _written(self) -> set[str]:
        """Relative paths of the files that this run has written."""
        entered = list(lines(self.path / STATE / MANIFEST))[1 + len(self._before):]
        return {str(line.get("file")) for line in entered} - {MARK}


def begin(
    path: Path, outputs: Outputs, *, source: str, field: str, room: float = 0.0, inputs: Sequence[Path] = ()
) -> OutputFolder:
    """Hold the folder for results, made if need be, with `room` (bytes) on its disk.

    `inputs` are files that the run reads: they are neither replaced nor removed.

    Until :meth:`OutputFolder.finish` it holds a file (:data:`MARK`) that marks it as incomplete: whatever ends the
    program, nobody takes half of the results for all.

    Raises:
        InputError: it holds files of the user under names that the run writes, another run is at work in it, it cannot
            be made or written to, or its disk is too full.
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
            return OutputFolder(path, outputs, lock, read)
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
def held(path: Path | OutputFolder, outputs: Outputs, *, source: str) -> Iterator[OutputFolder]:
    """The folder, as it is held already or as it is held in this block."""
    if isinstance(path, OutputFolder):
        yield path
        return
    with begin(path, outputs, source=source, field="folder") as folder:
        yield folder


def marking(mark: str) -> str:
    """The command that a mark is of; nothing for those of earlier versions."""
    found = re.match(r"`workbench ([^`]*)`", mark)
    return found.group(1) if found else ""


def clear(folder: Path) -> None:
    """Remove files that were being written in the folder when a run ended."""
    for begun in (folder / STATE).glob(f"{NEW}*"):
        shutil.rmtree(begun, ignore_errors=True)


def enumerated(names: Sequence[str]) -> str:
    """Names with commas between them, at most :data:`LISTED` of them."""
    more = f" and {len(names) - LISTED} more files" if len(names) > LISTED else ""
    return ", ".join(names[:LISTED]) + more


def now() -> str:
    """The local time, to the second."""
    return time.strftime("%Y-%m-%d %H:%M:%S")


def _locked(path: Path, source: str, field: str) -> int:
    """A handle that holds the lock of a folder.

    Raises:
        InputError: another run holds it, or the state of the folder is not of the workbench.
    """
    state = path / STATE
    with suppress(FileExistsError):
        state.mkdir()
    if not is_state(state):
        raise InputError(source, field, str(path), f"a folder whose {STATE} is of the workbench; move {state} away, or "
                         "choose another folder")
    for attempt in range(ATTEMPTS):
        # Never written to or emptied: a folder from somebody else may hold a hard link in its place.
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
    """Refuse a folder that holds files of the user under names that the run writes.

    Raises:
        InputError: so it does.
    """
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
    """The relative paths of inputs in the folder.

    Raises:
        InputError: the run would replace one of them.
    """
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
    """Remove folders that were made for a run that is refused."""
    for each in made:
        with suppress(OSError):
            if each.name == LOCK:
                each.unlink()
            elif each.name == STATE:
                shutil.rmtree(each)
            else:
                each.rmdir()
