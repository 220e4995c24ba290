"""What is done for a trial in a process of its own: it is made, or diagnosed into a file."""

from __future__ import annotations

import fcntl
import json
import os
import resource
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from concealed.scoring import FAILED
from concealed.trial import Truth, make_trial

from workbench.campaign.campaign import read_campaign
from workbench.diagnosis.appraisal import diagnose
from workbench.files.writing import write_atomic
from workbench.report.diagnosis import diagnosis_record

#: The file of what is concealed, in a folder of trials.
TRUTH = "truth.json"

#: A diagnosis begins nothing new after so many minutes of its processor's time, and says what it knows by then.
MINUTES = 20.0


@contextmanager
def claimed(mark: Path) -> Iterator[bool]:
    """Whether the piece of work that the file `mark` stands for is this process's alone, for the block.

    The system gives the claim back where the process ends, however it ends.
    """
    mark.parent.mkdir(parents=True, exist_ok=True)
    with mark.open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_mine = True
        except BlockingIOError:
            is_mine = False
        yield is_mine


def make_one(folder: Path, number: int, seed: int, mechanism: tuple[str, ...], part: str,
             making: Callable[[int, tuple[str, ...], Path], Truth] = make_trial) -> str:
    """Write a trial and its truth, unless it is there; returns a line about it."""
    trial, unfinished = folder / f"{number:04d}", folder / f".{number:04d}"
    started = time.perf_counter()
    shutil.rmtree(unfinished, ignore_errors=True)
    found = making(1000 * seed + number, mechanism, unfinished)
    add_truth(folder / TRUTH, trial.name, {"part": part, **found.to_dict()})
    unfinished.rename(trial)
    return (f"{number:04d} {' and '.join(mechanism)}: {found.detectability:.1f} sigmas, "
            f"{time.process_time():.0f} s of CPU, {time.perf_counter() - started:.0f} s")


def add_truth(path: Path, name: str, truth: dict[str, Any]) -> None:
    """Add the truth of a trial to the file of all; several processes may do so."""
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        known = json.loads(path.read_text()) if path.exists() else {}
        lines = [f'"{key}": {json.dumps(value)}' for key, value in sorted({**known, name: truth}.items())]
        write_atomic(path, "{\n" + ",\n".join(lines) + "\n}\n")
    finally:
        os.close(folder)


def diagnose_one(trial: Path) -> dict[str, Any]:
    """The record of the diagnosis of a trial."""
    return diagnosis_record(diagnose(read_campaign(trial / "campaign.toml"), minutes=MINUTES,
                                     clock=time.process_time))


def diagnose_into(result: Path, mark: Path, trial: Path, diagnosing: Callable[[Path], dict[str, Any]]) -> str:
    """Write what `diagnosing` records of a trial, or why it failed, unless that is there or another process is at it.

    Returns a line about the outcome, or nothing. Processor time and memory are those of this process, begun for this.
    """
    with claimed(mark) as is_mine:
        if not is_mine or result.exists():
            return ""
        started = time.perf_counter()
        try:
            said = diagnosing(trial)
        except Exception as error:
            said = failed(f"{type(error).__name__}: {error}")
        return write_outcome(result, said | {
            "cpu_seconds": time.process_time(), "wall_seconds": time.perf_counter() - started,
            "peak_megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0})


def failed(reason: str) -> dict[str, Any]:
    """The record of a diagnosis that came to no end."""
    return {"verdict": FAILED, "reason": reason, "effects": [], "rivals": [], "location": [], "held_out": {},
            "scores": []}


def write_outcome(result: Path, said: dict[str, Any]) -> str:
    """Write an outcome; returns a line about it."""
    write_atomic(result, json.dumps(said, indent=1) + "\n")
    named = said.get("reason") or " and ".join(e["name"] for e in said["effects"])
    return f"{result.stem} {said['verdict']} {named} {said['wall_seconds']:.0f} s"
