"""Trials of the diagnosis on devices in which an effect is concealed: how often it is right, how often it is fooled.

    .venv/bin/python tests/benchmarks/trials.py make FOLDER [--trials 300] [--first 0] [--seed 1] [--jobs 2] [--shapes]
    .venv/bin/python tests/benchmarks/trials.py run FOLDER [--jobs 2] [--minutes 10]
    .venv/bin/python tests/benchmarks/trials.py score FOLDER [--commit COMMIT] [--into OUTCOMES.csv]
    .venv/bin/python tests/benchmarks/trials.py table OUTCOMES.csv [--commit COMMIT]

`make` writes FOLDER/trials/NNNN (a campaign) and FOLDER/truth/NNNN.json; `run` diagnoses every campaign into
FOLDER/found/COMMIT/NNNN.json and never opens the truth; `score` alone compares the two and prints the tables. The first
two do so many trials at a time, each in a process of its own with one thread; they can be stopped at any time and go on
where they were, and several of them may work on one folder. A diagnosis that fails or takes longer than so many minutes
is an outcome "failed" with its reason; remove its file to try it again. Outcomes are kept apart by the commit that was
tried: `run` wants a checkout without changes (`--uncommitted` lets it do without) and stops when the checkout moves on;
`score` takes one commit, and `--into` adds to a file of that commit only, a line a trial. `table` prints the tables of
such a file; tests/data/trials holds those of docs/validation.md, by their seeds. With `--shapes`, trials conceal shapes
of layers alone, or nothing; with `--conceal NAME` that alone.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "benchmarks")]

from concealed.mechanisms import CATALOGUED, CLASHING, MECHANISMS, NONE, OUTSIDE, SHAPES  # noqa: E402
from concealed.running import claimed, release, work  # noqa: E402
from concealed.scoring import FAILED, read_outcomes, score, table  # noqa: E402
from concealed.tasks import diagnose_one, make_one  # noqa: E402

from workbench.files.writing import write_atomic  # noqa: E402
from workbench.jobs.workers import Task  # noqa: E402

#: In one round every mechanism of the catalogue is hidden once, and so many times nothing, something outside the
#: catalogue, and two effects at once: of 300 trials at least 40 with nothing and 30 with two effects.
NOTHING, FOREIGN, PAIRS = 7, 6, 5

#: Minutes that making a trial may take.
MAKING = 60.0


def schedule(seed: int, *, shapes: bool = False, conceal: str = "") -> Iterator[tuple[str, ...]]:
    """Mechanisms of trial after trial, in random order within each round; `shapes` each once in a round, and nothing
    once; or one that is to be concealed in all of them."""
    while conceal:
        yield (conceal,)
    rng = np.random.default_rng(seed)
    while shapes:
        yield from ((str(name),) for name in rng.permutation([NONE, *SHAPES]))
    outside = list(OUTSIDE)
    number = 0
    while True:
        foreign = [outside[(number * FOREIGN + k) % len(outside)] for k in range(FOREIGN)]
        entries = [*((name,) for name in (*CATALOGUED, *[NONE] * NOTHING, *foreign)),
                   *(_pair(rng) for _ in range(PAIRS))]
        yield from (entries[k] for k in rng.permutation(len(entries)))
        number += 1


def _pair(rng: np.random.Generator) -> tuple[str, ...]:
    while True:
        found = tuple(map(str, rng.choice(list(CATALOGUED), 2, replace=False)))
        if set(found) not in CLASHING:
            return found


def make(folder: Path, first: int, trials: int, seed: int, jobs: int, *, shapes: bool = False, conceal: str = ""
         ) -> None:
    """Write those of the trials from number `first` on that are not there yet."""
    mechanisms = enumerate(schedule(seed, shapes=shapes, conceal=conceal))
    pieces = ((f"{number:04d}", partial(make_one, folder, number, seed, mechanism))
              for number, mechanism in islice(mechanisms, first, first + trials)
              if not (folder / "trials" / f"{number:04d}").exists())
    for ended in work(pieces, jobs, 60.0 * MAKING):
        if ended.reason or ended.words:
            print(f"{ended.name}: {ended.reason}" if ended.reason else ended.words, flush=True)


# --------------------------------------------------------------------------------------------------------------------
# Diagnosing


def commit_of() -> str:
    """The commit of the checkout, with "-dirty" where files have changed since."""
    return subprocess.run(["git", "describe", "--always", "--dirty", "--exclude=*"], cwd=ROOT, capture_output=True,
                          text=True, check=True).stdout.strip()


def run(folder: Path, jobs: int, minutes: float, *, uncommitted: bool = False,
        diagnosing: Callable[[Path, Path], str] = diagnose_one, commit: Callable[[], str] = commit_of) -> None:
    """Diagnose the trials that are not diagnosed at this commit yet; `diagnosing` diagnoses one into a file.

    Raises:
        SystemExit: the checkout has changes that are not committed, or moves on meanwhile.
    """
    tried = commit()
    if tried.endswith("-dirty") and not uncommitted:
        raise SystemExit(f"{ROOT} is at {tried}: outcomes are those of a commit; commit the changes, or say "
                         "--uncommitted")
    results, unfinished = folder / "found" / tried, folder / "running" / tried
    results.mkdir(parents=True, exist_ok=True)

    def pieces() -> Iterator[tuple[str, Task[str]]]:
        for trial in sorted((folder / "trials").iterdir()):
            done = results / f"{trial.name}.json"
            if done.exists() or not claimed(unfinished, int(trial.name)):
                continue
            if done.exists():
                # Somebody else ended it between the two questions.
                release(unfinished, int(trial.name))
                continue
            now = commit()
            if now != tried:
                raise SystemExit(f"the checkout has moved from {tried} to {now}: outcomes are those of one commit")
            yield trial.name, partial(diagnosing, trial, unfinished / f"{trial.name}.json")

    for ended in work(pieces(), jobs, 60.0 * minutes):
        name = f"{ended.name}.json"
        said = (json.loads((unfinished / name).read_text()) if not ended.reason else
                {"verdict": FAILED, "reason": ended.reason, "effects": [], "rivals": [], "location": [], "held_out": {},
                 "scores": []})
        said |= {"cpu_seconds": ended.seconds, "wall_seconds": ended.wall, "commit": tried}
        write_atomic(results / name, json.dumps(said, indent=1) + "\n")
        (unfinished / name).unlink(missing_ok=True)
        release(unfinished, int(ended.name))
        print(f"{ended.name} {said['verdict']} "
              f"{ended.reason or ' and '.join(e['name'] for e in said['effects'])} {ended.wall:.0f} s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("job", choices=("make", "run", "score", "table"))
    parser.add_argument("folder", type=Path, help="of the trials; for `table`, a file of outcomes")
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1, help="trials at a time")
    parser.add_argument("--shapes", action="store_true", help="conceal shapes of layers alone, or nothing")
    parser.add_argument("--conceal", default="", choices=["", *MECHANISMS], metavar="NAME",
                        help="conceal this alone, in every trial")
    parser.add_argument("--minutes", type=float, default=10.0, help="that a diagnosis may take")
    parser.add_argument("--uncommitted", action="store_true", help="run with changes that are not committed")
    parser.add_argument("--into", type=Path, help="file of outcomes that `score` adds to")
    parser.add_argument("--commit", help="what `score` and `table` are of")
    options = parser.parse_args()
    # What runs is stopped with this process, not left behind.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    match options.job:
        case "make":
            make(options.folder, options.first, options.trials, options.seed, options.jobs, shapes=options.shapes,
                 conceal=options.conceal)
        case "run":
            run(options.folder, options.jobs, options.minutes, uncommitted=options.uncommitted)
        case "score":
            score(options.folder, options.commit, options.into)
        case "table":
            table([o for o in read_outcomes(options.folder) if options.commit in (None, o.commit)])


if __name__ == "__main__":
    main()
