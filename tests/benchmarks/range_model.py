"""What a model over ranges costs and how far it is off, on the filled reference chip.

    .venv/bin/python tests/benchmarks/range_model.py [--lengths 0.2] [--radii 0.1] [--moduli 0.1] [--losses 0.3]
                                                     [--tolerance 1e-3] [--limit 400] [--points 50]

Six lengths (thicknesses of couplant, substrate, sidewall and lid, the radii of cavity and chip) and eight constants
(both moduli of PLA with their losses, both of the glass, c33 and e33 of the transducer), each within the share given of
what the files state; a radius only as far as the next one lets it. Prints what the model takes, what one spectrum of
241 frequencies takes with its gradient by twelve of the parameters, and how far it is off from full solves at random
points of the ranges and of the band.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import Measurements, measurements, with_json  # noqa: E402

from geometry.chip import Chip, read_chip  # noqa: E402
from geometry.stretch import admissible_range  # noqa: E402
from materials.registry import Registry  # noqa: E402
from workbench.fem.solve import System, one_thread  # noqa: E402
from workbench.model.numbers import placed  # noqa: E402
from workbench.model.problem import Problem, build, fill  # noqa: E402
from workbench.reduced.ranges import NotCovered, range_model  # noqa: E402

THICK = ("couplant.thickness", "substrate.thickness", "sidewall.thickness", "superstrate.thickness")
WIDE = ("cavity.radius", "substrate.radius")


def ranges_of(chip: Chip, problem: Problem, arguments: argparse.Namespace) -> dict[str, tuple[float, float]]:
    def about(value: float, share: float) -> tuple[float, float]:
        low, high = sorted((value * (1.0 - share), value * (1.0 + share)))
        return low, high

    known = {name: each.value for name, each in chip.dimensions().items()}
    found = {name: about(known[name], arguments.lengths) for name in THICK}
    found |= {name: admissible_range(chip, name, *about(known[name], arguments.radii)) for name in WIDE}
    for key, value in problem.values.items():
        material, _, constant = key.rpartition(".")
        if material.startswith(("pla/", "soda_lime_glass/")) and constant.endswith("modulus"):
            found[key] = about(value.real, arguments.moduli)
            if value.imag:
                found[f"{key}.loss"] = about(value.imag, arguments.losses)
        if constant in ("c33", "e33"):
            found[key] = about(value.real, arguments.moduli)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("lengths", 0.2), ("radii", 0.1), ("moduli", 0.1), ("losses", 0.3), ("tolerance", 1e-3)):
        parser.add_argument(f"--{name}", type=float, default=default)
    parser.add_argument("--limit", type=int, default=400)
    parser.add_argument("--points", type=int, default=50)
    with_json(parser)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    with measurements(arguments.json) as kept:
        measure(arguments, kept)


def measure(arguments: argparse.Namespace, kept: Measurements) -> None:
    chip = read_chip(ROOT / "geometry/chips/reference_chip.toml")
    ranges = ranges_of(chip, build(fill(chip, "filled", Registry())), arguments)
    started = time.perf_counter()
    try:
        model = range_model(chip, "filled", ranges, relative_error=arguments.tolerance, limit=arguments.limit)
    except NotCovered as short:
        model = short.model
        print(short)
    making = time.perf_counter() - started
    for name, value, unit in (("making the model", making, "s"), ("rank", model.rank, "1"),
                              ("full solves", model.reduced.solves, "1"), ("error where checked", model.error, "1")):
        kept.add(name, value, unit)
    print(f"{len(ranges)} parameters: {making:.0f} s, {model.reduced.solves} full solves of "
          f"{model.reduced.full.size} unknowns, rank {model.rank}, off by {100.0 * model.error:.2g} % where checked "
          "last")
    random = np.random.default_rng(2026)
    twelve, seconds, off = tuple(ranges)[:12], [], []
    for number in range(arguments.points):
        numbers = {name: float(random.uniform(*ends)) for name, ends in ranges.items()}
        with one_thread():
            begun = time.perf_counter()
            found = model(numbers)
            found.gradient(twelve)
            seconds.append(time.perf_counter() - begun)
            index = int(random.integers(model.frequency.size))
            system = System(model.reduced.full, placed(model.problem.values, numbers))
            state, _ = system.solve(float(model.frequency[index]))
        charge = system.charge(float(model.frequency[index]), state)
        off.append(abs(found.prediction.solution.charge[index] / charge - 1.0))
        if number == 0:
            seconds.clear()  # what is summed up once is not counted
    kept.add("spectrum and gradient", float(np.median(seconds)), "s")
    for name, value in (("median", float(np.median(off))), ("largest", max(off))):
        kept.add(f"off at random points, {name}", value, "1")
    print(f"a spectrum of {model.frequency.size} frequencies with its gradient by {len(twelve)}: median "
          f"{1e3 * float(np.median(seconds)):.0f} ms")
    print(f"off from full solves at {len(off)} random points: median {100 * float(np.median(off)):.2g} %, 90 % below "
          f"{100 * float(np.quantile(off, 0.9)):.2g} %, largest {100 * max(off):.2g} %")


if __name__ == "__main__":
    main()
