"""A design for energy per watt, against a scan of full solves about it; and a study of 2000 channels by the clock.

    python tests/benchmarks/energy_design.py [--accuracy 0.005] [--points 2000] [--processes 2]

The design is `examples/design/silicon_channel.toml`. Every chip of the scan is driven at the energy's peak of its own.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
import time
from pathlib import Path

import numpy as np

from geometry.chip import read_chip
from workbench.design.evaluation import Operation
from workbench.design.goal import read_goal
from workbench.design.model import full_evaluation
from workbench.design.optimisation import optimise
from workbench.design.plan import Study
from workbench.design.study import study
from workbench.model.drive import PowerDrive

ROOT = Path(__file__).resolve().parents[2]
#: Steps of the scan to either side of the optimum: shares of the ranges of width and lid.
STEPS = (-0.1, -0.05, 0.0, 0.05, 0.1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--accuracy", type=float, default=5e-3)
    parser.add_argument("--points", type=int, default=2000)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    goal = read_goal(ROOT / "examples" / "design" / "silicon_channel.toml")
    started = time.perf_counter()
    found = optimise(goal, accuracy=options.accuracy)
    assert found.best is not None, found.why_not
    lengths, after = found.best.candidate.lengths, found.best.after.figures
    print(f"design: {found.before.figures['mean_e_ac']:.5g} to {after['mean_e_ac']:.5g} J/m^3 at 1 W and "
          f"{after['peak_frequency'] / 1e6:.4f} MHz by {lengths} in {time.perf_counter() - started:.0f} s; "
          f"{found.best.statement}", flush=True)
    best, at = 0.0, {}
    ranges = {each.name: (each.low, each.high) for each in goal.lengths}
    for shares in itertools.product(STEPS, STEPS):
        values = {name: float(np.clip(lengths[name] + share * (high - low), low, high))
                  for share, (name, (low, high)) in zip(shares, ranges.items(), strict=True)}
        energy = full_evaluation(goal.chip, goal.state, values, figures=("mean_e_ac", "peak_frequency"),
                                 operation=Operation(PowerDrive(1.0), "energy"),
                                 accuracy=options.accuracy).figures["mean_e_ac"]
        if energy > best:
            best, at = energy, values
        print(f"  {values}: {energy:.5g}", flush=True)
    print(f"scan: {best:.5g} at {at}; the design is {100.0 * (after['mean_e_ac'] / best - 1.0):+.2f} % from it")
    chip = read_chip(ROOT / "geometry" / "chips" / "silicon_glass_channel.toml")
    plan = Study(chip, {name: {"from": low, "to": high} for name, (low, high) in ranges.items()},
                 figures=("peak_frequency", "peak_q", "mean_e_ac", "focus_time"), state="filled", drive="1 W",
                 frequency="energy", sample={"method": "sobol", "points": options.points, "seed": 1},
                 accuracy=options.accuracy, confirm=1)
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        table = study(plan, Path(folder) / "study", jobs=options.processes)
    print(f"study: {options.points} points in {time.perf_counter() - started:.1f} s; "
          f"{[(s.figure, s.count) for s in table.statistics]}")


if __name__ == "__main__":
    main()
