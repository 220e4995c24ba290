"""Trials of the diagnosis on devices in which an effect is concealed: how often it is right, how often it is fooled.

    .venv/bin/python tests/benchmarks/trials.py make FOLDER [--trials 150] [--first 0] [--seed 1] [--jobs 2]
    .venv/bin/python tests/benchmarks/trials.py run FOLDER [--jobs 2] [--minutes 10]
    .venv/bin/python tests/benchmarks/trials.py score FOLDER [--commit COMMIT] [--into OUTCOMES.csv]
    .venv/bin/python tests/benchmarks/trials.py table OUTCOMES.csv [--commit COMMIT]

`make` writes FOLDER/trials/NNNN (a campaign) and FOLDER/truth/NNNN.json; `run` diagnoses every campaign into
FOLDER/found/COMMIT/NNNN.json and never opens the truth; `score` alone compares the two and prints the tables. `table`
prints the tables of a file of outcomes; tests/data/trials holds those of docs/validation.md, by their seeds.

A round is 75 trials in random order: every mechanism of the catalogue once (36, shapes of layers among them), nothing
14 times, every mechanism outside the catalogue 3 times (15), and 10 pairs of mechanisms of the catalogue. So 150 trials
are 72 with one effect, 28 with nothing, 30 outside the catalogue and 20 with two effects. With `--conceal NAME` trials
conceal that alone.

`make` and `run` do `--jobs` trials at a time, each in a process of its own with one thread and a time limit. That
process writes its file itself, so that whoever stops them (Ctrl-C, SIGTERM) loses nothing that is finished; they go on
where they were, and several of them may work on one folder. A diagnosis that fails or takes too long is an outcome
"failed" with its reason; remove its file to try it again. Outcomes are kept apart by the commit that was tried: `run`
wants a checkout without changes (`--uncommitted` lets it do without) and stops when the checkout moves on; `score`
takes one commit, and `--into` adds to a file of that commit only, a line a trial.

With `--dask ADDRESS` the workers of a Dask cluster do the same. They need this checkout and FOLDER at the same paths,
on a file system that all share, and are begun in the checkout:

    PYTHONPATH=.:tests/benchmarks .venv/bin/dask worker ADDRESS --nworkers 1 --nthreads 2

Dask cannot stop what a worker has begun: a trial that is at work goes on after Ctrl-C to its end or its time limit, and
writes its file.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "benchmarks")]

from concealed.mechanisms import CATALOGUED, CLASHING, MECHANISMS, NONE, OUTSIDE  # noqa: E402
from concealed.scoring import read_outcomes, score, table  # noqa: E402
from concealed.tasks import diagnose_into, diagnose_one, failed, make_one, write_outcome  # noqa: E402
from factorisation import seconds_of_one  # noqa: E402

from workbench.jobs.cluster import dask_cluster  # noqa: E402
from workbench.jobs.process import WorkerEnded  # noqa: E402
from workbench.jobs.workers import Task, Workers, begin_workers, check_jobs  # noqa: E402

#: How often a round conceals nothing, each mechanism outside the catalogue, and two effects at once. Of 28 trials with
#: nothing, one false alarm is 4 %; of 30 outside the catalogue about 20 are detectable, and one is 5 % of these.
NOTHING, FOREIGN, PAIRS = 14, 3, 10

#: Minutes that making a trial may take.
MAKING = 60.0


def schedule(seed: int, *, conceal: str = "") -> Iterator[tuple[str, ...]]:
    """Mechanisms of trial after trial, in random order within each round; or one that all trials `conceal`."""
    while conceal:
        yield (conceal,)
    rng = np.random.default_rng(seed)
    while True:
        entries = [*((name,) for name in (*CATALOGUED, *[NONE] * NOTHING, *[*OUTSIDE] * FOREIGN)),
                   *(_pair(rng) for _ in range(PAIRS))]
        yield from (entries[k] for k in rng.permutation(len(entries)))


def _pair(rng: np.random.Generator) -> tuple[str, ...]:
    while True:
        found = tuple(map(str, rng.choice(list(CATALOGUED), 2, replace=False)))
        if set(found) not in CLASHING:
            return found


@contextmanager
def workers_for(minutes: float, jobs: int | None, address: str | None = None) -> Iterator[Workers]:
    """Workers, of this machine or of the Dask cluster at an address, for so many `jobs` at a time (1, or one for each
    thread of the cluster, if None), each of which has a process of its own and so many `minutes`.

    Raises:
        InputError: no jobs, or nobody answers at the address.
        RuntimeError: Dask is not installed, or the cluster has no workers.
    """
    check_jobs(1 if jobs is None else jobs, source="command line", field="--jobs")
    with ExitStack() as stack:
        executor, threads = (None, 1) if address is None else stack.enter_context(dask_cluster(address))
        yield stack.enter_context(begin_workers(jobs or threads, executor, seconds=60.0 * minutes))


def make(folder: Path, first: int, trials: int, seed: int, workers: Workers, *, conceal: str = "") -> None:
    """Write those of the trials from number `first` on that are not there yet."""
    mechanisms = enumerate(schedule(seed, conceal=conceal))
    pieces = ((f"{number:04d}", partial(make_one, folder.resolve(), number, seed, mechanism))
              for number, mechanism in islice(mechanisms, first, first + trials)
              if not (folder / "trials" / f"{number:04d}").exists())
    for name, done in workers.completed(pieces):
        try:
            words = done.result()
        except Exception as error:
            # The others are made.
            words = f"{name}: {type(error).__name__}: {error}"
        if words:
            print(words, flush=True)


# --------------------------------------------------------------------------------------------------------------------
# Diagnosing


def commit_of() -> str:
    """The commit of the checkout, with "-dirty" where files have changed since."""
    return subprocess.run(["git", "describe", "--always", "--dirty", "--exclude=*"], cwd=ROOT, capture_output=True,
                          text=True, check=True).stdout.strip()


def run(folder: Path, workers: Workers, *, uncommitted: bool = False,
        diagnosing: Callable[[Path], dict[str, Any]] = diagnose_one, timing: Callable[[], float] = seconds_of_one,
        commit: Callable[[], str] = commit_of) -> None:
    """Diagnose the trials that are not diagnosed at this commit yet; `diagnosing` makes the record of one, and `timing`
    tells before, in the same process, how long (s) one factorisation takes.

    Raises:
        SystemExit: the checkout has changes that are not committed, or moves on meanwhile.
    """
    tried = commit()
    if tried.endswith("-dirty") and not uncommitted:
        raise SystemExit(f"{ROOT} is at {tried}: outcomes are those of a commit; commit the changes, or say "
                         "--uncommitted")
    folder = folder.resolve()
    results, marks = folder / "found" / tried, folder / "running" / tried
    results.mkdir(parents=True, exist_ok=True)
    began: dict[str, float] = {}

    def pieces() -> Iterator[tuple[str, Task[str]]]:
        for trial in sorted((folder / "trials").iterdir()):
            result = results / f"{trial.name}.json"
            if result.exists():
                continue
            now = commit()
            if now != tried:
                raise SystemExit(f"the checkout has moved from {tried} to {now}: outcomes are those of one commit")
            began[trial.name] = time.monotonic()
            yield trial.name, partial(diagnose_into, result, marks / f"{trial.name}.lock", tried, trial, diagnosing,
                                      timing)

    for name, done in workers.completed(pieces()):
        try:
            words = done.result()
        except WorkerEnded as error:
            # Its process could not write that itself.
            words = write_outcome(results / f"{name}.json", failed(str(error)) | {
                "cpu_seconds": error.processor, "wall_seconds": time.monotonic() - began[name], "commit": tried})
        if words:
            print(words, flush=True)


def _stop(number: int, _frame: object) -> None:
    """End at a signal; processes of trials end with this one."""
    print(f"stopped by {signal.Signals(number).name}: what is finished is kept", file=sys.stderr, flush=True)
    sys.exit(128 + number)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("job", choices=("make", "run", "score", "table"))
    parser.add_argument("folder", type=Path, help="of the trials; for `table`, a file of outcomes")
    parser.add_argument("--trials", type=int, default=150)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, help="trials at a time (default: 1, or one for each thread of the cluster)")
    parser.add_argument("--dask", metavar="ADDRESS", help="of the scheduler of a Dask cluster, whose workers share the "
                        "checkout and the folder (default: processes of this machine)")
    parser.add_argument("--conceal", default="", choices=["", *MECHANISMS], metavar="NAME",
                        help="conceal this alone, in every trial")
    parser.add_argument("--minutes", type=float, default=40.0, help="that a diagnosis may take (default 40)")
    parser.add_argument("--uncommitted", action="store_true", help="run with changes that are not committed")
    parser.add_argument("--into", type=Path, help="file of outcomes that `score` adds to")
    parser.add_argument("--commit", help="what `score` and `table` are of")
    options = parser.parse_args()
    for each in (signal.SIGTERM, signal.SIGINT):
        signal.signal(each, _stop)
    match options.job:
        case "make":
            with workers_for(MAKING, options.jobs, options.dask) as workers:
                make(options.folder, options.first, options.trials, options.seed, workers, conceal=options.conceal)
        case "run":
            with workers_for(options.minutes, options.jobs, options.dask) as workers:
                run(options.folder, workers, uncommitted=options.uncommitted)
        case "score":
            score(options.folder, options.commit, options.into)
        case "table":
            table([o for o in read_outcomes(options.folder) if options.commit in (None, o.commit)])


if __name__ == "__main__":
    main()
