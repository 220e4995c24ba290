"""Many pieces of work at once, each in a process of its own, that can be stopped and go on where they were."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

#: Processes share the machine by their number, not by their threads.
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

#: Seconds between looks at what is running.
PAUSE = 0.1


@dataclass(frozen=True)
class Piece:
    """A command, and the file ``log`` that takes what it prints."""

    name: str
    command: Sequence[str]
    log: Path


@dataclass(frozen=True)
class Ended:
    """A piece of work that ended: ``reason`` why it failed, empty if it did not; ``wall`` and processor ``seconds``."""

    piece: Piece
    reason: str
    wall: float
    seconds: float


@dataclass(eq=False)
class _Running:
    piece: Piece
    process: subprocess.Popen[bytes]
    started: float
    late: bool = False


def work(pieces: Iterable[Piece], jobs: int, seconds: float) -> Iterator[Ended]:
    """Do that many pieces at a time and yield each as it ends; one that takes longer than so many `seconds` is killed.
    Whoever stops asking for more kills what runs."""
    waiting, running = iter(pieces), list[_Running]()
    try:
        while True:
            while len(running) < jobs and (piece := next(waiting, None)) is not None:
                running.append(_begun(piece))
            if not running:
                return
            for each in tuple(running):
                pid, status, usage = os.wait4(each.process.pid, os.WNOHANG)
                wall = time.monotonic() - each.started
                if pid:
                    each.process.returncode = os.waitstatus_to_exitcode(status)
                    running.remove(each)
                    yield Ended(each.piece, _reason(each, seconds), wall, usage.ru_utime + usage.ru_stime)
                elif wall > seconds and not each.late:
                    each.late = True
                    each.process.kill()
            time.sleep(PAUSE)
    finally:
        for each in running:
            each.process.kill()
            each.process.wait()


def _begun(piece: Piece) -> _Running:
    piece.log.parent.mkdir(parents=True, exist_ok=True)
    with piece.log.open("wb") as log:
        # Of a session of its own: whoever interrupts this process does not make its trials fail.
        process = subprocess.Popen(piece.command, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                                   env={**os.environ, **ONE_THREAD}, start_new_session=True)
    return _Running(piece, process, time.monotonic())


def _reason(ended: _Running, seconds: float) -> str:
    if ended.late:
        return f"no answer within {seconds / 60.0:g} min"
    code = ended.process.returncode
    if code == 0:
        return ""
    said = [line for line in ended.piece.log.read_text(errors="replace").splitlines() if line.strip()]
    return said[-1].strip() if code > 0 and said else f"ended with {code}"


def claimed(folder: Path, number: int) -> bool:
    """Whether this process may do that piece of work: nobody alive has begun it."""
    folder.mkdir(parents=True, exist_ok=True)
    mark, own = folder / f"{number:04d}.pid", folder / f"by {os.getpid()}"
    own.write_text(str(os.getpid()))
    try:
        while True:
            try:
                # A link appears at once, with its owner in it.
                mark.hardlink_to(own)
                return True
            except FileExistsError:
                if Path(f"/proc/{mark.read_text()}").exists():
                    return False
                mark.unlink(missing_ok=True)
    finally:
        own.unlink()


def release(folder: Path, number: int) -> None:
    """Give a piece of work back that this process has claimed."""
    (folder / f"{number:04d}.pid").unlink(missing_ok=True)
