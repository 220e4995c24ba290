"""Reduced against full, and the whole command against a full-order spectrum: ratios measured in one run.

    .venv/bin/python tests/benchmarks/reduced_model.py [--points 481] [--chip geometry/chips/reference_chip.toml]
    .venv/bin/python tests/benchmarks/reduced_model.py --sizes 10000 28000 75000 150000

*Full-order spectrum*: that many frequencies one by one with tuned, symmetrically scaled SuperLU on one thread. With
fewer --points its time is scaled up to 481 and the table says so. Prints a Markdown table for docs/validation.md.

With --sizes: how time and memory grow with the unknowns. The reference chip, filled, on meshes like the default one of
about so many unknowns; one full solve, its pattern's analysis included, and the reduced model of 481 frequencies, all
but the assembly counted, each in a process of its own. Memory is the largest resident set less what it is after the
imports; the last line holds the exponents, fitted to the logarithms.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from factorisation import factor_for, made

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import Measurements, measurements, with_json  # noqa: E402

from geometry.chip import read_chip  # noqa: E402
from materials.registry import Registry  # noqa: E402
from workbench.fem.factorisation import chosen as chosen_factorisation  # noqa: E402
from workbench.fem.operators import assemble  # noqa: E402
from workbench.fem.solve import System, solve_full, sweep  # noqa: E402
from workbench.model.discretisation import ACCURACY  # noqa: E402
from workbench.model.problem import build, fill  # noqa: E402
from workbench.reduced.at_point import reduce  # noqa: E402


def memory() -> float:
    """Largest resident memory so far, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def one(factor: float, what: str) -> dict[str, float]:
    """Unknowns, seconds and memory (MiB) of a full solve or of a reduced model, in this process."""
    imports = memory()
    started = time.perf_counter()
    problem, operators = made(factor)
    System(operators, problem.values)  # integrals are evaluated where they are first asked for
    between = time.perf_counter()
    frequencies = np.linspace(problem.band[0], problem.band[1], 481)
    if what == "full":
        solve_full(operators, frequencies[240:241], problem.values)
    else:
        reduce(operators, frequencies, problem.values, tolerance=1e-4).solve(frequencies, problem.values)
    return {"unknowns": operators.size, "assembly": between - started, "seconds": time.perf_counter() - between,
            "memory": memory() - imports}


def growth(sizes: list[int]) -> None:
    """Print the table of --sizes."""
    print(f"factorisation: {chosen_factorisation()}\n")
    print("| unknowns | assembly (s) | full solve (s) | MiB | reduced model (s) | MiB |")
    print("| ---: | ---: | ---: | ---: | ---: | ---: |")
    rows = []
    for size in sizes:
        found, factor = [], repr(factor_for(size))
        for what in ("full", "reduced"):
            command = [sys.executable, __file__, "--one", factor, what]
            done = subprocess.run(command, check=True, cwd=ROOT, capture_output=True, text=True)
            found.append(json.loads(done.stdout))
        full, reduced = found
        rows.append([full["unknowns"], full["assembly"], full["seconds"], full["memory"], reduced["seconds"],
                     reduced["memory"]])
        print("| {:.0f} | {:.2f} | {:.2f} | {:.0f} | {:.2f} | {:.0f} |".format(*rows[-1]), flush=True)
    if len(rows) < 2:
        return
    logarithms = np.log(np.array(rows))
    exponents = (np.polyfit(logarithms[:, 0], column, 1)[0] for column in logarithms.T[1:])
    print("| exponent | " + " | ".join(f"{exponent:.2f}" for exponent in exponents) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=481)
    parser.add_argument("--chip", type=Path, default=ROOT / "geometry/chips/reference_chip.toml")
    parser.add_argument("--state", default="filled")
    parser.add_argument("--accuracy", type=float, default=ACCURACY)
    parser.add_argument("--change", type=float, default=1.0, help="per cent by which the PLA moduli are changed")
    parser.add_argument("--no-command", action="store_true", help="leave out the whole `workbench simulate`")
    parser.add_argument("--sizes", type=int, nargs="+", help="unknowns, about: how time and memory grow with them")
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    with_json(parser)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    if arguments.one:
        print(json.dumps(one(float(arguments.one[0]), arguments.one[1])))
        return
    if arguments.sizes:
        growth(arguments.sizes)
        return
    with measurements(arguments.json) as kept:
        measure(arguments, kept)


def measure(arguments: argparse.Namespace, figures: Measurements) -> None:
    chip = read_chip(arguments.chip)
    frequencies = np.linspace(*chip.band, 481)

    started = time.perf_counter()
    problem = build(fill(chip, arguments.state, Registry()), accuracy=arguments.accuracy)
    operators = assemble(problem.mesh, problem.terms)
    model = reduce(operators, frequencies, problem.values, tolerance=1e-4)
    reduced = model.solve(frequencies, problem.values)
    everything = time.perf_counter() - started
    reduced_memory = memory()

    pla = {name: arguments.change / 100.0 * abs(value) for name, value in problem.values.items()
           if name.startswith("pla/") and name.endswith("modulus")}
    started = time.perf_counter()
    kept = reduce(operators, frequencies, problem.values, tolerance=1e-5, tangents=pla)
    with_tangents = time.perf_counter() - started
    changed = {**problem.values, **{name: problem.values[name] * (1.0 + arguments.change / 100.0) for name in pla}}
    started = time.perf_counter()
    changed_solution = kept.solve(frequencies, changed)
    changed_error = float(kept.error(changed_solution).max())
    online = time.perf_counter() - started
    some = frequencies[::60]
    exact = solve_full(operators, some, changed).impedance
    true_changed = float(np.abs(changed_solution.impedance[::60] / exact - 1.0).max())

    chosen = np.unique(np.linspace(0, 480, arguments.points).round().astype(int))
    started = time.perf_counter()
    full = np.array([s.impedance[0] for s in sweep(operators, frequencies[chosen], problem.values)])
    full_order = (time.perf_counter() - started) * 481 / len(chosen)
    error = float(np.abs(reduced.impedance[chosen] / full - 1.0).max())

    rows = [
        (f"full-order spectrum{'' if len(chosen) == 481 else f' (scaled from {len(chosen)} points)'}", full_order, ""),
        (f"reduced, all counted ({model.solves} solves, rank {model.basis.shape[1]})", everything, f"{error:.1e}"),
        (f"reduced with tangents of the PLA moduli ({kept.solves} solves, rank {kept.basis.shape[1]})", with_tangents,
         ""),
        (f"PLA moduli changed by {arguments.change:g} %, basis kept", online,
         f"{true_changed:.1e} (estimate {changed_error:.1e})"),
    ]
    if not arguments.no_command:
        with tempfile.TemporaryDirectory() as folder:
            started = time.perf_counter()
            command = [sys.executable, "-m", "workbench", "simulate", str(arguments.chip), "-o", folder]
            subprocess.run(command, check=True, cwd=ROOT, capture_output=True)
            rows.append(("`workbench simulate`, all states, CAD, mesh, fields, pictures, report",
                         time.perf_counter() - started, ""))
    print(f"{operators.size} unknowns, {problem.mesh.mesh.t.shape[1]} cells, {chip.name}, {arguments.state}; "
          f"largest memory {reduced_memory:.0f} MiB reduced, {memory():.0f} MiB in all\n")
    print("| | wall time (s) | ratio | largest relative error of Z |\n| --- | ---: | ---: | ---: |")
    for name, seconds, accuracy in rows:
        figures.add(name, seconds, "s")
        print(f"| {name} | {seconds:.3g} | {full_order / seconds:.3g} | {accuracy} |")


if __name__ == "__main__":
    main()
