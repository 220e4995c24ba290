"""What the rows of `workbench.model.discretisation.ROWS` are worth: error of Z, unknowns and time, chip by chip.

    python tests/benchmarks/discretisation.py                       # the rows, all chips and states (8 minutes)
    python tests/benchmarks/discretisation.py --accuracy 5e-4       # one row
    python tests/benchmarks/discretisation.py --try 4 1.8 0.12 8 1.5 0.6   # a row that is not in the table
    python tests/benchmarks/discretisation.py --held-out            # cases that no row was chosen on
    python tests/benchmarks/discretisation.py --straight            # the straight chips, of which only corners were

The error is the rms of ln Z over the chip's band against the workbench's own converged solution: order 6, elements
half as large, graded more steeply. Beside it the error that `workbench.simulation.mesh_error` estimates. The held-out
cases are the chips with all dimensions changed by up to 10 %, in bands below and above their own, and a disc with an
electrode that covers a part of it.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
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

from geometry.chip import Chip, Dimension, read_chip  # noqa: E402
from geometry.measure import Axisymmetric, Straight  # noqa: E402
from materials.registry import Registry  # noqa: E402
from workbench.fem.operators import assemble  # noqa: E402
from workbench.files.errors import InputError  # noqa: E402
from workbench.model.discretisation import ROWS, Discretisation  # noqa: E402
from workbench.model.problem import build, fill  # noqa: E402
from workbench.reduced.at_point import reduce  # noqa: E402
from workbench.simulation.mesh_error import estimate  # noqa: E402

Complex = NDArray[np.complex128]

#: Frequencies of every band.
POINTS = 121

#: What counts as converged: another such solution, of elements smaller by 1.25, is within 0.006 % of it.
CONVERGED = Discretisation(6, 2.5, corner_refinement=0.01, growth=5.0, transducer_finer=1.2, gas_finer=1.0)


def solved(
    chip: Chip, state: str, band: tuple[float, float], made: Discretisation, tolerance: float
) -> tuple[Complex, int, float, float, float]:
    """Z, unknowns, processor time of assembly and reduced model, estimated error of the mesh, and time of that."""
    problem = build(fill(chip, state, Registry()), band=band, accuracy=made)
    frequency = np.linspace(*band, POINTS)
    start = time.process_time()
    operators = assemble(problem.mesh, problem.terms)
    model = reduce(operators, frequency, problem.values, tolerance=tolerance)
    impedance = model.solve(frequency, problem.values).impedance
    between = time.process_time()
    estimated = estimate(model, frequency, problem.values).rms
    return impedance, operators.size, between - start, estimated, time.process_time() - between


def converged(chip: Chip, state: str, band: tuple[float, float], folder: Path) -> Complex:
    """Z of the converged solution, kept in `folder`."""
    key = hashlib.sha256(repr((dataclasses.replace(chip, file=""), state, band, CONVERGED)).encode()).hexdigest()[:16]
    path = folder / f"{key}.npy"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        np.save(path, solved(chip, state, band, CONVERGED, 1e-6)[0])
    found: Complex = np.load(path)
    return found


def chips(straight: bool = False) -> Iterator[tuple[str, Chip, str, tuple[float, float]]]:
    """The round chips and states that the rows are chosen on, or the straight ones."""
    for path in sorted((ROOT / "geometry" / "chips").glob("*.toml")):
        chip = read_chip(path)
        for state in chip.states if isinstance(chip.measure, Straight if straight else Axisymmetric) else ():
            yield f"{path.stem} {state.name}", chip, state.name, chip.band


def held_out() -> Iterator[tuple[str, Chip, str, tuple[float, float]]]:
    """Others: dimensions changed, other bands, an electrode that ends on the disc."""
    generator = np.random.default_rng(20)
    for name, chip, state, (low, high) in chips():
        lengths = {key: value.value * (1.0 + generator.uniform(-0.1, 0.1)) for key, value in chip.dimensions().items()}
        # Radii that are equal stay so.
        of = {value.value: lengths[key] for key, value in chip.dimensions().items()}
        moved = chip.with_dimensions({key: of[value.value] for key, value in chip.dimensions().items()})
        yield f"{name}, moved", moved, state, (low, high)
        shift = 0.35 if generator.random() < 0.5 else 1.6
        yield f"{name}, {shift:g} of its band", chip, state, (low * shift, high * shift)
        if len(chip.layers) == 1:
            live = dataclasses.replace(chip.electrodes.live_disc, radius=Dimension(0.6 * chip.transducer.outer_radius))
            part = dataclasses.replace(chip.electrodes, live_disc=live)
            yield f"{name}, part of an electrode", dataclasses.replace(chip, electrodes=part), state, (low, high)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--accuracy", type=float, action="append", help="only this row (default: all)")
    parser.add_argument("--try", dest="tried", nargs=6, type=float, action="append", default=[],
                        metavar=("ORDER", "ELEMENTS", "CORNER", "GROWTH", "TRANSDUCER", "GAS"))
    parser.add_argument("--held-out", action="store_true")
    parser.add_argument("--straight", action="store_true", help="straight chips in place of the round ones")
    parser.add_argument("--only", default="", help="cases whose name holds this")
    parser.add_argument("--keep", type=Path, default=ROOT / "out" / "converged", help="folder of converged spectra")
    with_json(parser)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    with measurements(arguments.json) as kept:
        measure(arguments, kept)


def measure(arguments: argparse.Namespace, kept: Measurements) -> None:
    rows = {f"{100 * accuracy:g} %": ROWS[accuracy] for accuracy in arguments.accuracy or ROWS}
    if arguments.tried:
        rows = {" ".join(f"{x:g}" for x in one): Discretisation(int(one[0]), one[1], corner_refinement=one[2],
                growth=one[3], transducer_finer=one[4], gas_finer=one[5]) for one in arguments.tried}
    for label, made in rows.items():
        print(f"{label}: {made}")
        print(f"{'':44}{'unknowns':>9}{'error %':>9}{'estimate':>9}{'model s':>9}{'est. s':>8}")
        worst = 0.0
        for name, chip, state, band in held_out() if arguments.held_out else chips(arguments.straight):
            if arguments.only not in name:
                continue
            try:
                exact = converged(chip, state, band, arguments.keep)
                found, size, seconds, estimated, more = solved(chip, state, band, made, 1e-5)
            except InputError as error:
                print(f"{name:44} {error}")
                continue
            error_of = float(np.sqrt(np.mean(np.abs(np.log(found / exact)) ** 2)))
            worst = max(worst, error_of)
            for figure, value, unit in (("error", error_of, "1"), ("unknowns", size, "1"), ("model", seconds, "s")):
                kept.add(f"{label}, {name}, {figure}", value, unit)
            print(f"{name:44}{size:9d}{100 * error_of:9.4f}{100 * estimated:9.4f}{seconds:9.2f}{more:8.2f}", flush=True)
        print(f"{'worst':44}{'':9}{100 * worst:9.4f}", flush=True)
        kept.add(f"{label}, worst error", worst, "1")


if __name__ == "__main__":
    main()
