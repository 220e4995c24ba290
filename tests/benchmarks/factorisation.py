"""SuperLU and rslab's LDL^T on the matrices of the reference chip: time, stored entries and residual, in one run.

    python tests/benchmarks/factorisation.py [--sizes 10000 50000 150000]

The filled chip near its resonance on the default mesh, and on others of its kind of about so many unknowns, without the
electrode and scaled to a diagonal of ones, as a solve factorises it. *COLAMD* is what scipy does unless told
otherwise; *SuperLU* and *rslab* are those of `workbench.fem.factorisation`. *First*: with what is found of the pattern
alone; *second*: with other values of that pattern, at a frequency nearby. Seconds are those of the wall clock on one
thread, the others times what they are for *SuperLU*; each is the shortest of the repetitions. The residual is that of
one solve without refinement, relative to the right-hand side. Run it on a quiet machine. `rslab` has to be installed:
without it the table holds the other two. COLAMD is left out above 60 000 unknowns.
"""

from __future__ import annotations

import argparse
import importlib.util
import inspect
import math
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import Measurements, measurements, with_json  # noqa: E402

from geometry.chip import read_chip  # noqa: E402
from materials.registry import Registry  # noqa: E402
from workbench.fem.factorisation import KNOWN  # noqa: E402
from workbench.fem.operators import FullOperators, assemble  # noqa: E402
from workbench.fem.solve import System, one_thread  # noqa: E402
from workbench.fem.sparsity import both_triangles  # noqa: E402
from workbench.model.discretisation import ACCURACY, discretisation  # noqa: E402
from workbench.model.problem import Problem, build, fill  # noqa: E402

Complex = NDArray[np.complex128]

CHIP = ROOT / "geometry" / "chips" / "reference_chip.toml"
STATE, FREQUENCY, NEARBY = "filled", 1.0305e6, 1.0405e6

#: Right-hand sides that a factorisation serves at once: the states of a reduced model at one frequency are as many.
TOGETHER = 12

#: Unknowns from which on COLAMD takes minutes and gigabytes.
LARGEST_COLAMD = 60_000


class Colamd:
    """SuperLU as scipy calls it by default: columns ordered by COLAMD, partial pivoting, nothing kept."""

    def __init__(self, triangle: sparse.csc_array) -> None:
        self._triangle = triangle

    def __call__(self, data: Complex) -> Callable[[Complex], Complex]:
        triangle = self._triangle
        upper = sparse.csc_array((data, triangle.indices, triangle.indptr), shape=triangle.shape)
        factor = splu(both_triangles(upper).tocsc())

        def solve(right: Complex) -> Complex:
            return np.asarray(factor.solve(right))

        return solve


@dataclass(frozen=True)
class Found:
    """Seconds of the steps, stored entries of the factors, scaled residual of a solve."""

    first: float
    second: float
    one: float
    many: float
    entries: int
    residual: float


def scaled(problem: Problem, operators: FullOperators, frequency: float) -> sparse.csc_array:
    """The upper triangle of what a solve at a frequency (Hz) factorises."""
    return System(operators, problem.values).factored(frequency)[1].triangle


def made(factor: float) -> tuple[Problem, FullOperators]:
    """The chip on the default mesh with elements smaller by `factor`."""
    how = discretisation(ACCURACY)
    problem = build(fill(read_chip(CHIP), STATE, Registry()), accuracy=how if factor == 1.0 else how.refined(factor))
    return problem, assemble(problem.mesh, problem.terms)


def factor_for(size: int) -> float:
    """By what the elements are smaller than those of the default mesh for about `size` unknowns."""
    factor = 1.0
    # Layers one element thick make it less than quadratic: a third step is within a few per cent.
    for _ in range(3):
        found = made(factor)[1].size
        if abs(found / size - 1.0) < 0.1:
            break
        factor *= math.sqrt(size / found)
    return factor


def measured(kind: Callable[[sparse.csc_array], Any], matrices: list[sparse.csc_array], repeat: int) -> Found:
    """One factorisation on two matrices of one pattern."""
    random = np.random.default_rng(3)
    right = random.normal(size=(matrices[0].shape[0], TOGETHER)) + 1j * random.normal(
        size=(matrices[0].shape[0], TOGETHER))
    seconds = np.full((repeat, 4), np.inf)
    for taken in seconds:
        marks = [time.perf_counter()]
        ready = kind(matrices[0])
        ready(matrices[0].data)
        marks.append(time.perf_counter())
        solve = ready(matrices[1].data)
        marks.append(time.perf_counter())
        one = solve(right[:, 0])
        marks.append(time.perf_counter())
        solve(right)
        marks.append(time.perf_counter())
        taken[:] = np.diff(marks)
    factor = inspect.getclosurevars(solve).nonlocals["factor"]
    entries = factor.nnz if hasattr(factor, "nnz") else factor.factor_nnz
    residual = float(np.linalg.norm(right[:, 0] - both_triangles(matrices[1]) @ one) / np.linalg.norm(right[:, 0]))
    first, second, alone, many = seconds.min(axis=0)
    return Found(first, second, alone, many, entries, residual)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[10_000, 0, 50_000, 150_000],
                        help="unknowns, about; 0 is the default mesh")
    parser.add_argument("--repeat", type=int, default=2)
    with_json(parser)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    with measurements(arguments.json) as kept:
        measure(arguments, kept)


def seconds_of_one(repeat: int = 3) -> float:
    """Processor time (s) of one factorisation of the filled chip's matrix on the default mesh, the shortest of
    `repeat`; its pattern is analysed before. Times of other machines are compared in units of it."""
    problem, operators = made(1.0)
    system, taken = System(operators, problem.values), []
    with one_thread():
        for frequency in np.linspace(FREQUENCY, NEARBY, repeat + 1):
            began = time.process_time()
            system.factored(float(frequency))
            taken.append(time.process_time() - began)
    return min(taken[1:])


def measure(arguments: argparse.Namespace, kept: Measurements) -> None:
    kinds = {"COLAMD": Colamd, "SuperLU": KNOWN["superlu"]}
    if importlib.util.find_spec("rslab") is not None:
        kinds["rslab"] = KNOWN["rslab"]
    print(f"{'unknowns':>8}  {'':8}{'first':>9}{'second':>9}{'1 solve':>9}{f'{TOGETHER} solves':>10}{'entries':>11}"
          f"{'residual':>11}")
    for size in arguments.sizes:
        problem, operators = made(factor_for(size) if size else 1.0)
        matrices = [scaled(problem, operators, frequency) for frequency in (FREQUENCY, NEARBY)]
        with one_thread():
            found = {name: measured(kind, matrices, arguments.repeat) for name, kind in kinds.items()
                     if name != "COLAMD" or operators.size < LARGEST_COLAMD}
        for name, each in found.items():
            kept.add(f"{operators.size} unknowns, {name}, first factorisation", each.first, "s")
            kept.add(f"{operators.size} unknowns, {name}, further factorisation", each.second, "s")
        base = found["SuperLU"]
        print(f"{operators.size:8d}  {'SuperLU':8}{base.first:7.3f} s{base.second:7.3f} s{base.one:7.3f} s"
              f"{base.many:8.3f} s{base.entries:11d}{base.residual:11.1e}")
        for name, each in found.items():
            if each is not base:
                first, second, one, many, entries, _ = np.divide(astuple(each), astuple(base))
                print(f"{'':8}  {name:8}{first:9.2f}{second:9.2f}{one:9.2f}{many:10.2f}{entries:11.2f}"
                      f"{each.residual:11.1e}", flush=True)


if __name__ == "__main__":
    main()
