"""Trials of the diagnosis on devices in which an effect is concealed: how often it is right, how often it is fooled.

    .venv/bin/python tests/benchmarks/trials.py run tests/corpus --into FOLDER [--commit HEAD] [--only 0012 0075]
    .venv/bin/python tests/benchmarks/trials.py score FOLDER/COMMIT --truth tests/corpus/truth.json [--csv OUTCOMES.csv]
    .venv/bin/python tests/benchmarks/trials.py table OUTCOMES.csv
    .venv/bin/python tests/benchmarks/trials.py make NEW [--seed 1] [--first 0] [--trials 75] [--part fresh]
    .venv/bin/python tests/benchmarks/trials.py seal NEW --truth ELSEWHERE/truth.json
    .venv/bin/python tests/benchmarks/trials.py check tests/corpus/unlabelled --truth truth.json

`run` puts the program as it is at a commit into FOLDER/COMMIT/program and diagnoses from there, so that the checkout
may change meanwhile, into FOLDER/COMMIT/NNNN.json; it never opens the truth. Each trial has a process of its own with
one thread and a time limit, `--jobs` at a time, and its outcome is written as soon as it is there: a run that is
stopped (Ctrl-C, SIGTERM) goes on where it was when it is begun again, and several of them may share the work. A
diagnosis that fails or takes too long is an outcome "failed" with its reason; remove its file to try it again.
`diagnose` does the same with the program of this checkout as it stands, changes included, into FOLDER itself.

`score` alone compares outcomes with the truth, prints the tables and keeps a line a trial; `table` prints those again.
tests/corpus holds the trials, tests/data/trials the outcomes of docs/validation.md.

`make` makes new trials. A round is 75 in random order: every mechanism of the catalogue once (41), nothing 13 times,
mechanisms outside the catalogue 13 times, and 8 pairs of mechanisms of the catalogue.

`seal` moves the truth of new trials to a file that is not published, and leaves salted hashes; `check` compares the
truth, once it is published, with these hashes.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "benchmarks")]

from concealed.commitment import contradictions, seal  # noqa: E402
from concealed.mechanisms import CATALOGUED, CLASHING, NONE, OUTSIDE  # noqa: E402
from concealed.scoring import read_outcomes, score, table  # noqa: E402
from concealed.tasks import diagnose_into, diagnose_one, failed, make_one, write_outcome  # noqa: E402
from concealed.trial import Truth, make_trial  # noqa: E402

from workbench.jobs.process import WorkerEnded  # noqa: E402
from workbench.jobs.workers import Task, begin_workers, check_jobs  # noqa: E402

#: How many trials of a round conceal nothing, something outside the catalogue, and two effects at once.
NOTHING, FOREIGN, PAIRS = 13, 13, 8

#: Minutes that making a trial may take, and a diagnosis unless told otherwise.
MAKING, DIAGNOSING = 60.0, 40.0

#: What a diagnosis needs of the program.
PROGRAM = ("geometry", "materials", "workbench", "tests/benchmarks")


def schedule(seed: int) -> Iterator[tuple[str, ...]]:
    """Mechanisms of trial after trial, in random order within each round."""
    rng = np.random.default_rng(seed)
    outside = cycle(OUTSIDE)
    while True:
        entries = [*((name,) for name in (*CATALOGUED, *[NONE] * NOTHING, *islice(outside, FOREIGN))),
                   *(_pair(rng) for _ in range(PAIRS))]
        yield from (entries[k] for k in rng.permutation(len(entries)))


def _pair(rng: np.random.Generator) -> tuple[str, ...]:
    while True:
        found = tuple(map(str, rng.choice(list(CATALOGUED), 2, replace=False)))
        if set(found) not in CLASHING:
            return found


def make(folder: Path, first: int, trials: int, seed: int, jobs: int, part: str, *,
         mechanisms: Callable[[int], Iterator[tuple[str, ...]]] = schedule,
         making: Callable[[int, tuple[str, ...], Path], Truth] = make_trial) -> None:
    """Write those of the trials from number `first` on that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    pieces = ((f"{number:04d}", partial(make_one, folder.resolve(), number, seed, mechanism, part, making))
              for number, mechanism in islice(enumerate(mechanisms(seed)), first, first + trials)
              if not (folder / f"{number:04d}").exists())
    with begin_workers(jobs, seconds=60.0 * MAKING) as workers:
        for name, done in workers.completed(pieces):
            try:
                words = done.result()
            except Exception as error:
                # The others are made.
                words = f"{name}: {type(error).__name__}: {error}"
            print(words, flush=True)


# --------------------------------------------------------------------------------------------------------------------
# Diagnosing


def frozen(commit: str, into: Path) -> Path:
    """The folder of a commit below `into`, in which the program is as it was then.

    Raises:
        SystemExit: there is no such commit.
    """
    named = subprocess.run(["git", "rev-parse", "--short", f"{commit}^{{commit}}"], cwd=ROOT, capture_output=True,
                           text=True)
    if named.returncode:
        raise SystemExit(f"--commit {commit}: {named.stderr.strip()}")
    folder = into / named.stdout.strip()
    program = folder / "program"
    if not program.exists():
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as unfinished, subprocess.Popen(
                ["git", "archive", folder.name, *PROGRAM], cwd=ROOT, stdout=subprocess.PIPE) as archive:
            assert archive.stdout is not None
            with tarfile.open(fileobj=archive.stdout, mode="r|") as files:
                files.extractall(Path(unfinished) / "program", filter="data")
            (Path(unfinished) / "program").rename(program)
    return folder


def diagnose_all(folder: Path, into: Path, *, only: Sequence[str] = (), jobs: int = 1, minutes: float = DIAGNOSING,
                 diagnosing: Callable[[Path], dict[str, Any]] = diagnose_one) -> None:
    """Diagnose the trials of a folder, or `only` some, that have no outcome in `into` yet; `diagnosing` makes the
    record of one."""
    into.mkdir(parents=True, exist_ok=True)
    began: dict[str, float] = {}

    def pieces() -> Iterator[tuple[str, Task[str]]]:
        for trial in sorted(path.parent for path in folder.resolve().glob("*/campaign.toml")):
            result = into / f"{trial.name}.json"
            if not result.exists() and (not only or trial.name in only):
                began[trial.name] = time.monotonic()
                yield trial.name, partial(diagnose_into, result, into / "running" / trial.name, trial, diagnosing)

    with begin_workers(jobs, seconds=60.0 * minutes) as workers:
        for name, done in workers.completed(pieces()):
            try:
                words = done.result()
            except WorkerEnded as error:
                # Its process could not write that itself.
                words = write_outcome(into / f"{name}.json", failed(str(error)) | {
                    "cpu_seconds": error.processor, "wall_seconds": time.monotonic() - began[name]})
            if words:
                print(words, flush=True)


def _stop(number: int, _frame: object) -> None:
    """End at a signal; processes of trials end with this one."""
    print(f"stopped by {signal.Signals(number).name}: what is finished is kept", file=sys.stderr, flush=True)
    sys.exit(128 + number)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("job", choices=("make", "run", "diagnose", "score", "table", "seal", "check"))
    parser.add_argument("path", type=Path, help="folder of trials; for `score` of outcomes; for `table` a file of them")
    parser.add_argument("--into", type=Path, help="folder of outcomes")
    parser.add_argument("--commit", default="HEAD", help="that `run` tries")
    parser.add_argument("--only", nargs="*", default=[], metavar="NNNN", help="trials to diagnose (default: all)")
    parser.add_argument("--minutes", type=float, default=DIAGNOSING, help="that a diagnosis may take")
    parser.add_argument("--jobs", type=int, default=1, help="trials at a time")
    parser.add_argument("--truth", type=Path, help="what is concealed, for `score`, `seal` and `check`")
    parser.add_argument("--csv", type=Path, help="file of outcomes that `score` writes")
    parser.add_argument("--trials", type=int, default=75, help="how many to make")
    parser.add_argument("--first", type=int, default=0, help="number of the first to make")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--part", default="", help="word that is kept with the truth: tables tell parts apart")
    options = parser.parse_args()
    for job, name in (("run", "into"), ("diagnose", "into"), *((job, "truth") for job in ("score", "seal", "check"))):
        if options.job == job and getattr(options, name) is None:
            parser.error(f"{job} needs --{name}")
    check_jobs(options.jobs, source="command line", field="--jobs")
    for each in (signal.SIGTERM, signal.SIGINT):
        signal.signal(each, _stop)
    match options.job:
        case "make":
            make(options.path, options.first, options.trials, options.seed, options.jobs, options.part)
        case "run":
            into = frozen(options.commit, options.into.resolve())
            # The same process goes on with the program of that commit.
            os.execv(sys.executable, [sys.executable, str(into / "program" / "tests" / "benchmarks" / "trials.py"),
                                      "diagnose", str(options.path.resolve()), "--into", str(into), "--jobs",
                                      str(options.jobs), "--minutes", str(options.minutes), "--only", *options.only])
        case "diagnose":
            diagnose_all(options.path, options.into, only=options.only, jobs=options.jobs, minutes=options.minutes)
        case "score":
            score(options.path, options.truth, options.csv)
        case "seal":
            seal(options.path, options.truth)
        case "check":
            if wrong := contradictions(options.path, options.truth):
                raise SystemExit(f"{options.truth} contradicts the hashes of {', '.join(wrong)}")
            print(f"{options.truth} has the hashes of {options.path}")
        case "table":
            table(read_outcomes(options.path))


if __name__ == "__main__":
    main()
