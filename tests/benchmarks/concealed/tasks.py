"""What is done for a trial in a process of its own: it is made, or diagnosed."""

from __future__ import annotations

import json
import os
import shutil
import time
from pathlib import Path

from concealed.running import claimed
from concealed.trial import make_trial

from workbench.diagnosis.appraisal import diagnose
from workbench.diagnosis.campaign import read_campaign
from workbench.files.writing import write_atomic
from workbench.report.diagnosis import diagnosis_record

#: A diagnosis begins nothing new after so many minutes, and says what it knows by then.
MINUTES = 8.0


def make_one(folder: Path, number: int, seed: int, mechanism: tuple[str, ...]) -> str:
    """Write a trial, unless it is there or somebody else is at it; what is to be said of it."""
    trial, truth = folder / "trials" / f"{number:04d}", folder / "truth" / f"{number:04d}.json"
    if trial.exists() or not claimed(folder / "making", number):
        return ""
    started = time.perf_counter()
    unfinished = folder / "making" / f"{number:04d}.{os.getpid()}"
    shutil.rmtree(unfinished, ignore_errors=True)
    found = make_trial(1000 * seed + number, mechanism, unfinished)
    truth.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(truth, json.dumps(found.to_dict(), indent=1) + "\n")
    trial.parent.mkdir(parents=True, exist_ok=True)
    unfinished.rename(trial)
    return (f"{number:04d} {' and '.join(mechanism)}: {found.detectability:.1f} sigmas, "
            f"{time.process_time():.0f} s of CPU, {time.perf_counter() - started:.0f} s")


def diagnose_one(trial: Path, result: Path) -> str:
    """Diagnose a trial into a file."""
    found = diagnose(read_campaign(trial / "campaign.toml"), minutes=MINUTES)
    write_atomic(result, json.dumps(diagnosis_record(found), indent=1) + "\n")
    return ""
