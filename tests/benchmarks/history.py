"""Processor time and peak memory of named stages, as ratios to one factorisation, and a stored history of them.

    .venv/bin/python tests/benchmarks/history.py measure NOW.json [--only spectrum fit] [--repeat 3]
    .venv/bin/python tests/benchmarks/history.py compare tests/data/benchmarks/BASELINE.json NOW.json
    .venv/bin/python tests/benchmarks/history.py table tests/data/benchmarks/*.json
    .venv/bin/python tests/benchmarks/history.py check

Each stage runs in a process of its own with one thread. Its unit is the factorisation of the reference chip at 1.03 MHz
(default mesh), measured in the same process before and after the stage: a slow or busy machine slows both. The figure
is the smallest ratio of the repetitions, of processor time, not of the clock. `compare` ends with status 1 if a stage
takes over 20 % more time or memory than before. `check` measures one stage twice on this commit and once with 30 % of
work added: the first two must agree within 5 %, and the comparison must find the third.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import measurements  # noqa: E402

CHIPS, EXAMPLES = ROOT / "geometry/chips", ROOT / "examples"
#: A stage is slower from this ratio on; two runs on one commit agree within the second, relative.
SLOWER, AGREEMENT = 1.2, 0.05
#: Relative work that `check` adds to a stage, the stage, and its repetitions.
PLANTED, CHECKED, REPEAT = 0.3, "coarse spectrum", 5
#: Seconds by step of a stage; no step where there is one alone.
Steps = Mapping[str, float]


def factorisation() -> Callable[[], float]:
    """A function that factorises the system of the reference chip, and returns its processor time (s)."""
    from geometry.chip import read_chip
    from materials.registry import Registry
    from workbench.fem.operators import assemble
    from workbench.fem.solve import System
    from workbench.model.problem import build, fill

    problem = build(fill(read_chip(CHIPS / "reference_chip.toml"), "filled", Registry()), band=(0.95e6, 1.1e6))
    system, frequencies = System(assemble(problem.mesh, problem.terms), problem.values), iter(range(1000))
    system.factored(1.02e6)  # finds the pattern

    def once() -> float:
        frequency = 1.03e6 + next(frequencies)
        system.entries(frequency)
        began = time.process_time()
        system.factored(frequency)
        return time.process_time() - began

    return once


def coarse_spectrum() -> Steps:
    """The spectrum of a disc at an accuracy of 0.5 %."""
    import workbench as wb

    wb.simulate(wb.read_chip(CHIPS / "disc_20x2.toml"), accuracy=5e-3)
    return {}


def spectrum() -> Steps:
    """The spectrum of the filled reference chip at its default accuracy, 0.05 %."""
    import workbench as wb

    wb.simulate(wb.read_chip(CHIPS / "reference_chip.toml"), "filled", warm=None)
    return {}


def main_job() -> Steps:
    """The chip of the paper, filled, from files to fields, at 0.5 %; by step."""
    import workbench as wb

    return wb.simulate(wb.read_chip(CHIPS / "acevedo_2026_chip.toml"), "filled", accuracy=5e-3).seconds


def fit() -> Steps:
    """Four moduli of a print, from the recording of a small chip."""
    import workbench as wb

    chip = wb.read_chip(CHIPS / "small_campaign/chip.toml")
    recording = wb.read_recording(CHIPS / "small_campaign/empty.csv")
    wb.fit(recording, chip, "polymer", state="empty", region="substrate", accuracy=2e-3)
    return {}


def study() -> Steps:
    """1024 chips with two lids."""
    import workbench as wb

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(EXAMPLES / "small_study", folder, dirs_exist_ok=True)
        text = (folder / "study.toml").read_text(encoding="utf-8").replace("points = 64", "points = 1024")
        (folder / "study.toml").write_text(text, encoding="utf-8")
        wb.study(wb.read_study(folder / "study.toml"), folder / "out", jobs=1)
    return {}


def diagnosis() -> Steps:
    """The small campaign."""
    import workbench as wb

    wb.diagnose(wb.read_campaign(CHIPS / "small_campaign/campaign.toml"))
    return {}


def particles() -> Steps:
    """300 beads of the chip of the paper for ten minutes, with the flow of the liquid."""
    import workbench as wb

    chip = wb.read_chip(CHIPS / "acevedo_2026_chip.toml")
    shot = wb.snapshot(chip, "filled", 1.0305e6, drive=wb.parse_drive("1.5 Vpp"), accuracy=5e-3)
    wb.trajectories(shot, 600.0, particles=300, seed=1, flow=wb.liquid_motion(shot).velocity)
    return {}


def import_time() -> Steps:
    """A Python that loads everything that a simulation needs, and ends."""
    subprocess.run([sys.executable, "-c", "import workbench as wb; wb.read_chip, wb.simulate"], check=True)
    return {}


STAGES: dict[str, Callable[[], Steps]] = {
    "import": import_time, "coarse spectrum": coarse_spectrum, "spectrum": spectrum, "main job": main_job, "fit": fit,
    "study": study, "particles": particles, "diagnosis": diagnosis,
}


def processor() -> float:
    """Processor time (s) of this process and its ended children."""
    return sum(use.ru_utime + use.ru_stime for use in map(resource.getrusage, (
        resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)))


def memory() -> float:
    """Peak memory (bytes) of this process so far."""
    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def run_stage(name: str, planted: float) -> dict[str, float]:
    """Ratios to one factorisation, by figure: time of the stage, of its steps, and memory. In a process of its own."""
    warnings.simplefilter("ignore")
    # Steps of a simulation are timed by the clock; here by the processor.
    from workbench.jobs import progress

    progress.time = SimpleNamespace(perf_counter=time.process_time)  # type: ignore[assignment]
    unit = factorisation()
    least = min(unit() for _ in range(3))
    of_unit = memory()
    began = processor()
    steps = STAGES[name]()
    end = processor() + planted * (processor() - began)
    while processor() < end:
        pass
    taken = processor() - began
    least = min(least, *(unit() for _ in range(3)))
    found = {name: taken / least, **{f"{name}: {step}": seconds / least for step, seconds in steps.items()}}
    # The stage "import" is another process, whose memory is not in these figures.
    return found if name == "import" else found | {f"{name}, memory": memory() / of_unit}


def smallest(name: str, repeat: int, planted: float = 0.0) -> dict[str, float]:
    """The smallest of the figures of a stage over repetitions."""
    found: dict[str, float] = {}
    for _ in range(repeat):
        done = subprocess.run(
            [sys.executable, __file__, "stage", name, "--planted", str(planted)], stdout=subprocess.PIPE, text=True,
            check=True, env=os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"})
        one = json.loads(done.stdout.splitlines()[-1])
        found = {figure: min(value, found.get(figure, value)) for figure, value in one.items()}
    return found


def slower(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """Lines on the figures of `after` that are over 20 % above those of `before`. Steps are not compared: a small one
    varies by more."""
    return [f"{name}: {one['value']:.3g} before, {after[name]['value']:.3g} now"
            for name, one in before.items()
            if ":" not in name and name in after and after[name]["value"] > SLOWER * one["value"]]


def check() -> int:
    """Whether two runs agree and a planted slowdown is found."""
    first, second = (smallest(CHECKED, REPEAT)[CHECKED] for _ in range(2))
    planted = smallest(CHECKED, REPEAT, PLANTED)[CHECKED]
    apart = abs(second / first - 1.0)
    found = slower({CHECKED: {"value": min(first, second)}}, {CHECKED: {"value": planted}})
    print(f"{CHECKED}: {first:.3g} and {second:.3g} factorisations, {100 * apart:.1f} % apart; with "
          f"{100 * PLANTED:.0f} % of work added {planted:.3g}, {'found' if found else 'NOT FOUND'}")
    return int(apart > AGREEMENT or not found)


def table(files: Sequence[Path]) -> list[str]:
    """The figures of all files as a Markdown table, a column for each commit."""
    records = [json.loads(file.read_text(encoding="utf-8")) for file in files]
    lines = ["| factorisations | " + " | ".join(record["commit"] for record in records) + " |",
             "| --- |" + " ---: |" * len(records)]
    for name in dict.fromkeys(name for record in records for name in record["figures"]):
        values = (record["figures"].get(name) for record in records)
        cells = ("" if each is None else f"{each['value']:.3g}" for each in values)
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    jobs = parser.add_subparsers(dest="job", required=True)
    measure = jobs.add_parser("measure")
    measure.add_argument("file", type=Path)
    measure.add_argument("--only", nargs="*", choices=STAGES, default=list(STAGES))
    measure.add_argument("--repeat", type=int, default=3, help="processes for each stage")
    both = jobs.add_parser("compare")
    both.add_argument("before", type=Path)
    both.add_argument("after", type=Path)
    jobs.add_parser("table").add_argument("files", type=Path, nargs="+")
    jobs.add_parser("check")
    stage = jobs.add_parser("stage")
    stage.add_argument("name", choices=STAGES)
    stage.add_argument("--planted", type=float, default=0.0)
    options = parser.parse_args()
    match options.job:
        case "measure":
            with measurements(options.file) as kept:
                for name in options.only:
                    for figure, value in smallest(name, options.repeat).items():
                        kept.add(figure, value, "factorisations")
                        print(f"{figure:40}{value:10.3g}", flush=True)
        case "compare":
            before, after = (json.loads(file.read_text(encoding="utf-8"))["figures"]
                             for file in (options.before, options.after))
            lines = slower(before, after)
            print(*(lines or ["no stage is slower by 20 %"]), sep="\n")
            return int(bool(lines))
        case "table":
            print(*table(options.files), sep="\n")
        case "check":
            return check()
        case "stage":
            print(json.dumps(run_stage(options.name, options.planted)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
