"""What figures of a design cost on a reduced model, and how far they are off, on the filled reference chip.

    .venv/bin/python tests/benchmarks/design_model.py [--share 0.05] [--relative-error 1e-3] [--points 100] [--full 8]

Six lengths (thicknesses of couplant, substrate, sidewall, bond and lid, radius of the cavity), each within the share
given. Prints what the model takes, what one evaluation takes without and with all derivatives, beside one of
`full_evaluation` in the same run, and how far figures are off from full solves, on meshes of their own, at random
points.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import Measurements, measurements, with_json  # noqa: E402

from geometry.chip import read_chip  # noqa: E402
from workbench.design.model import design_model, full_evaluation  # noqa: E402

LENGTHS = ("couplant.thickness", "substrate.thickness", "sidewall.thickness", "bond.thickness",
           "superstrate.thickness", "cavity.radius")
FIGURES = ("f0", "z_min", "q", "p0", "e_ac", "mean_e_ac", "trap_height", "trap_offset", "axial_stiffness",
           "focus_time")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--share", type=float, default=0.05)
    parser.add_argument("--relative-error", type=float, default=1e-3)
    parser.add_argument("--points", type=int, default=100)
    parser.add_argument("--full", type=int, default=8)
    with_json(parser)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    with measurements(arguments.json) as found:
        measure(arguments, found)


def measure(arguments: argparse.Namespace, found: Measurements) -> None:
    read = read_chip(ROOT / "geometry" / "chips" / "reference_chip.toml")
    chip = replace(read, states=tuple(replace(state, particle="polystyrene", particle_radius=5e-6)
                                      if state.name == "filled" else state for state in read.states))
    known = chip.dimensions()
    ranges = {name: ((1.0 - arguments.share) * known[name].value, (1.0 + arguments.share) * known[name].value)
              for name in LENGTHS}
    started = time.perf_counter()
    model = design_model(chip, "filled", ranges, figures=FIGURES, relative_error=arguments.relative_error)
    made = model.range_model
    assert made is not None
    print(f"model of {len(ranges)} parameters: {time.perf_counter() - started:.0f} s, of which the range model "
          f"(rank {made.rank}) {made.seconds:.0f} s; ranks {model.bases.operating.size} and "
          f"{model.bases.sweeping.size}; full solves find {100 * model.bases.error:.3f} % in Z, "
          f"{100 * model.bases.pressure_error:.2f} % in the pressure")
    low, high = (np.array(ends) for ends in zip(*ranges.values(), strict=True))
    random = np.random.default_rng(1)
    points = [dict(zip(LENGTHS, map(float, x), strict=True))
              for x in low + (high - low) * random.random((arguments.points, low.size))]
    model(points[0])
    seconds = {}
    for label, gradient in (("figures", False), ("figures and derivatives", True)):
        started = time.perf_counter()
        for point in points:
            model(point, gradient=gradient)
        seconds[label] = (time.perf_counter() - started) / len(points)
        print(f"{label}: {1e3 * seconds[label]:.1f} ms")
        found.add(label, 1e3 * seconds[label], "ms")
    off: dict[str, list[float]] = {name: [] for name in FIGURES}
    started = time.perf_counter()
    exact = [full_evaluation(chip, "filled", point, figures=FIGURES) for point in points[: arguments.full]]
    each = (time.perf_counter() - started) / max(1, len(exact))
    print(f"full evaluation: {each:.1f} s, {each / seconds['figures']:.0f} times an evaluation")
    for point, full in zip(points, exact, strict=False):
        small = model(point)
        for name in FIGURES:
            scale = full.figures["trap_height" if name == "trap_offset" else name]
            off[name].append(abs(small.figures[name] - full.figures[name]) / scale)
    for name, values in off.items():
        print(f"{name}: off by at most {100 * max(values):.3f} %, {100 * float(np.median(values)):.3f} % in the middle"
              + (" (of the trap's height)" if name == "trap_offset" else ""))
        found.add(f"{name}, largest error", 100 * max(values), "%")


if __name__ == "__main__":
    main()
