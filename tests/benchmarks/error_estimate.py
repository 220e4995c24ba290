"""How often and by how much the true error of a reduced model exceeds its estimate, and how far the estimate is above.

    .venv/bin/python tests/benchmarks/error_estimate.py [--chip geometry/chips/reference_chip.toml] [--points 12]

For every way that a basis is made (at a point over a band; about a point; over ranges), on the filled chip at its own
values and at values drawn near them, both are compared at frequencies that no model has seen. Points whose error is
below 1e-9 are left out: that is rounding. The last column of the table is what `workbench.reduced.estimate.SLACK`
stands on: the largest estimate in the band over the largest error there, the median over all models and values.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import Measurements, measurements, with_json  # noqa: E402

from geometry.chip import Chip, read_chip  # noqa: E402
from materials.registry import Registry  # noqa: E402
from workbench.fem.operators import assemble  # noqa: E402
from workbench.fem.solve import one_thread, solve_full  # noqa: E402
from workbench.model.numbers import placed  # noqa: E402
from workbench.model.problem import build, fill  # noqa: E402
from workbench.reduced.about_point import local_basis  # noqa: E402
from workbench.reduced.at_point import reduce  # noqa: E402
from workbench.reduced.model import ReducedModel  # noqa: E402
from workbench.reduced.ranges import RangeRequest, growing_model  # noqa: E402

Real = NDArray[np.float64]
Values = dict[str, complex]
ACCURACY = 5e-3
ROUNDING = 1e-9


def drawn(values: Values, names: list[str], reach: float, random: np.random.Generator) -> Values:
    return {**values, **{name: values[name] * (1.0 + reach * random.uniform(-1.0, 1.0)) for name in names}}


def cases(chip: Chip, arguments: argparse.Namespace) -> Iterator[tuple[str, ReducedModel, list[Values]]]:
    """Every maker with some models, and values to ask them at."""
    problem = build(fill(chip, "filled", Registry()), band=chip.band, accuracy=ACCURACY)
    operators, random = assemble(problem.mesh, problem.terms), np.random.default_rng(0)
    grid = np.linspace(*chip.band, 241)
    values, names = dict(problem.values), [name for name in problem.values if name.endswith(("modulus", "c33"))]
    moves = {name: 0.01 * abs(values[name]) for name in names}
    for tolerance in (1e-3, 1e-5):
        yield "at a point", reduce(operators, grid, values, tolerance=tolerance), [values]
        model = reduce(operators, grid, values, tolerance=tolerance, tangents=moves, confirmed=False)
        yield "at a point, moved", model, [drawn(values, names, reach, random) for reach in (0.003, 0.01, 0.03)]
    for tolerance in (1e-3, 1e-4, 1e-5):
        model = local_basis(operators, grid, values, moves, tolerance=tolerance).model
        yield "about a point", model, [values]
        yield "about a point, moved", model, [drawn(values, names, reach, random) for reach in (0.003, 0.01, 0.03)]
    known = {name: each.value for name, each in chip.dimensions().items()}
    ranges = {name: (0.95 * known[name], 1.05 * known[name]) for name in ("substrate.thickness", "sidewall.thickness")}
    for found in growing_model(RangeRequest(chip, "filled", ranges, points=61, relative_error=3e-3, accuracy=ACCURACY)):
        there = [placed(found.problem.values, {name: float(random.uniform(*ends)) for name, ends in ranges.items()})
                 for _ in range(3)]
        yield "over ranges", found.reduced, there


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chip", default=str(ROOT / "geometry/chips/reference_chip.toml"))
    parser.add_argument("--points", type=int, default=12)
    with_json(parser)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    with measurements(arguments.json) as kept, one_thread():
        measure(arguments, kept)


def measure(arguments: argparse.Namespace, kept: Measurements) -> None:
    started, chip = time.perf_counter(), read_chip(arguments.chip)
    random = np.random.default_rng(1)
    found: dict[str, tuple[list[Real], list[float]]] = {}
    for name, model, places in cases(chip, arguments):
        ratios, largest = found.setdefault(name, ([], []))
        for values in places:
            frequency = np.sort(random.uniform(*chip.band, arguments.points))
            solution = model.solve(frequency, values)
            exact = solve_full(model.full, frequency, values)
            error, estimate = np.abs(solution.charge / exact.charge - 1.0), model.error(solution)
            counted = error > ROUNDING
            ratios.append(estimate[counted] / error[counted])
            largest.append(float(estimate.max() / error.max()))
    print("| basis | points | error above its estimate | by a factor of at most | estimate / error, median "
          "| of the largest in the band |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    everything = np.concatenate([each for ratios, _ in found.values() for each in ratios])
    whole = [each for _, largest in found.values() for each in largest]
    for name, (ratios, largest) in [*found.items(), ("all", ([everything], whole))]:
        every = np.concatenate(ratios)
        print(f"| {name} | {every.size} | {100.0 * np.mean(every < 1.0):.2g} % | {max(1.0, 1.0 / every.min()):.2g} | "
              f"{np.median(every):.0f} | {min(largest):.0f} to {max(largest):.0f}, median {np.median(largest):.0f} |")
    kept.add("error above its estimate", 100.0 * float(np.mean(everything < 1.0)), "%")
    kept.add("largest estimate over largest error", float(np.median(whole)), "1")
    print(f"{time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
