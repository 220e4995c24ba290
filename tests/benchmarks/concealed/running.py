"""Many trials at once, each in a process of its own, that can be stopped and go on where they were."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from workbench.jobs.process import WorkerEnded
from workbench.jobs.workers import Processes, Task


@dataclass(frozen=True)
class Ended:
    """A piece of work that ended, by its ``name``: its result in words, or the ``reason`` why it failed, empty if it
    did not; ``wall`` and processor ``seconds``."""

    name: str
    words: str
    reason: str
    wall: float
    seconds: float


def work(pieces: Iterable[tuple[str, Task[str]]], jobs: int, seconds: float) -> Iterator[Ended]:
    """Do that many pieces at a time and yield each as it ends; one that takes longer than so many `seconds` is killed.
    Whoever stops asking for more kills what runs."""
    began: dict[str, float] = {}

    def tasks() -> Iterator[tuple[str, Task[tuple[str, str, float]]]]:
        for name, piece in pieces:
            began[name] = time.monotonic()
            yield name, partial(_timed, piece)

    with closing(Processes(jobs, seconds=seconds, fresh=True)) as workers:
        for name, done in workers.completed(tasks()):
            wall = time.monotonic() - began[name]
            try:
                words, reason, processor = done.result()
            except WorkerEnded as error:
                words, reason, processor = "", str(error), error.processor
            yield Ended(name, words, reason, wall, processor)


def _timed(piece: Task[str]) -> tuple[str, str, float]:
    """The words of a piece of work, or why it failed, and the processor seconds of this process, begun for it."""
    words = reason = ""
    try:
        words = piece()
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
    return words, reason, time.process_time()


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
