"""Trials of the diagnosis on devices in which an effect is concealed: how often it is right, and how often it is fooled.

    .venv/bin/python tests/benchmarks/trials.py make FOLDER [--trials 300] [--seed 1]
    .venv/bin/python tests/benchmarks/trials.py run FOLDER
    .venv/bin/python tests/benchmarks/trials.py score FOLDER

`make` writes FOLDER/trials/NNNN (a campaign) and FOLDER/truth/NNNN.json; `run` diagnoses every campaign into
FOLDER/found/NNNN.json and never opens the truth; `score` alone compares the two and prints the tables. The first two
can be stopped at any time and go on where they were; several of them may work on one folder.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "benchmarks")]

from concealed.mechanisms import CATALOGUED, NONE, OUTSIDE  # noqa: E402
from concealed.trial import make_trial  # noqa: E402

from inputs import write_atomic  # noqa: E402
from workbench.commands.diagnose import record  # noqa: E402
from workbench.diagnose.campaign import read_campaign  # noqa: E402
from workbench.diagnose.device import model  # noqa: E402
from workbench.diagnose.verdict import diagnose  # noqa: E402

#: In one round every mechanism of the catalogue is hidden once, and so many times nothing, something outside the
#: catalogue, and two effects at once.
NOTHING, FOREIGN, PAIRS = 6, 6, 2


def schedule(seed: int) -> Iterator[tuple[str, ...]]:
    """Mechanisms of trial after trial, in random order within each round."""
    rng = np.random.default_rng(seed)
    outside = list(OUTSIDE)
    number = 0
    while True:
        foreign = [outside[(number * FOREIGN + k) % len(outside)] for k in range(FOREIGN)]
        pairs = [tuple(map(str, rng.choice(list(CATALOGUED), 2, replace=False))) for _ in range(PAIRS)]
        entries = [*((name,) for name in (*CATALOGUED, *[NONE] * NOTHING, *foreign)), *pairs]
        yield from (entries[k] for k in rng.permutation(len(entries)))
        number += 1


def make(folder: Path, trials: int, seed: int) -> None:
    """Write the trials that are not there yet."""
    for number, mechanism in zip(range(trials), schedule(seed), strict=False):
        trial, truth = folder / "trials" / f"{number:04d}", folder / "truth" / f"{number:04d}.json"
        if trial.exists() or not _claimed(folder / "making", number):
            continue
        started = time.perf_counter()
        unfinished = folder / "making" / f"{number:04d}.{os.getpid()}"
        shutil.rmtree(unfinished, ignore_errors=True)
        found = make_trial(1000 * seed + number, mechanism, unfinished)
        truth.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(truth, json.dumps(found.to_dict(), indent=1) + "\n")
        trial.parent.mkdir(parents=True, exist_ok=True)
        unfinished.rename(trial)
        print(f"{number:04d} {' and '.join(mechanism)}: {found.detectability:.1f} sigmas, "
              f"{time.perf_counter() - started:.0f} s", flush=True)


def run(folder: Path) -> None:
    """Diagnose the trials that are not diagnosed yet."""
    for trial in sorted((folder / "trials").iterdir()):
        result = folder / "found" / f"{trial.name}.json"
        if result.exists() or not _claimed(folder / "running", int(trial.name)):
            continue
        started = time.process_time()
        with threadpool_limits(limits=1):
            campaign = read_campaign(trial / "campaign.toml")
            found = diagnose(model(campaign))
        write_atomic(result, json.dumps({**record(found), "cpu_seconds": time.process_time() - started}, indent=1) + "\n")
        print(f"{trial.name} {found.verdict} {' and '.join(e.name for e in found.effects)} "
              f"{time.process_time() - started:.0f} s", flush=True)


def _claimed(folder: Path, number: int) -> bool:
    """Whether this process may do that piece of work: nobody alive has begun it."""
    folder.mkdir(parents=True, exist_ok=True)
    mark = folder / f"{number:04d}.pid"
    try:
        with mark.open("x") as file:
            file.write(str(os.getpid()))
    except FileExistsError:
        owner = mark.read_text()
        if owner and Path(f"/proc/{owner}").exists():
            return False
        mark.unlink(missing_ok=True)
        return _claimed(folder, number)
    return True


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("job", choices=("make", "run", "score"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    match options.job:
        case "make":
            make(options.folder, options.trials, options.seed)
        case "run":
            run(options.folder)


if __name__ == "__main__":
    main()
