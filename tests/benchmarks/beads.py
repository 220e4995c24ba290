"""Time to follow the particles of a chip, beside one factorisation of its matrix, and beside integrators of scipy.

    .venv/bin/python tests/benchmarks/beads.py [--chip CHIP.toml] [--state filled] [--at HZ] [--accuracy 5e-4]
        [--minutes 30] [--voltages 1 3 10] [--scipy]

Prints, for 200 and for 1000 start points and for every factor of the voltage, the seconds and how many factorisations
they are; and how far positions and capture fractions move with half of the tolerance. The forces grow with the square
of the voltage, and with them the stiffness.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.sparse import block_diag

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import Measurements, measurements, with_json  # noqa: E402

from geometry.chip import read_chip  # noqa: E402
from workbench.acoustics.trajectories import TOLERANCE, Fate, Trajectories, follow, record_times  # noqa: E402
from workbench.fem.operators import assemble  # noqa: E402
from workbench.fem.solve import System  # noqa: E402
from workbench.model.drive import parse_drive  # noqa: E402
from workbench.simulation.run import snapshot  # noqa: E402

#: Microns, for positions.
MICRON = 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chip", type=Path, default=ROOT / "geometry" / "chips" / "acevedo_2026_chip.toml")
    parser.add_argument("--state", default="filled")
    parser.add_argument("--at", type=float, default=1.0305e6)
    parser.add_argument("--accuracy", type=float, default=5e-4)
    parser.add_argument("--drive", default="10 Vpp")
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--voltages", type=float, nargs="+", default=[1.0, 3.0, 10.0])
    parser.add_argument("--scipy", action="store_true")
    with_json(parser)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    with measurements(arguments.json) as found:
        measure(arguments, found)


def measure(arguments: argparse.Namespace, kept: Measurements) -> None:
    chip = read_chip(arguments.chip)
    if chip.state(arguments.state).particle is None:
        chip = replace(chip, states=tuple(replace(state, particle="polystyrene", particle_radius=5e-6)
                                          if state.name == arguments.state else state for state in chip.states))
    started = time.perf_counter()
    shot = snapshot(chip, arguments.state, arguments.at, drive=parse_drive(arguments.drive),
                    accuracy=arguments.accuracy)
    print(f"snapshot with forces and traps: {time.perf_counter() - started:.2f} s")
    system = System(assemble(shot.problem.mesh, shot.problem.terms), shot.problem.values)
    system.factored(arguments.at)
    started = time.perf_counter()
    system.factored(1.001 * arguments.at)
    one = time.perf_counter() - started
    kept.add("one factorisation", one, "s")
    report = shot.traps
    assert report is not None
    print(f"{system.operators.size} unknowns, one factorisation with its matrix: {one:.2f} s; "
          f"{len(report.forces.mesh.cells)} cells of order {report.forces.mesh.order} in the cavity\n{report}")
    times = record_times(60.0 * arguments.minutes)
    for count in (200, 1000):
        for factor in arguments.voltages:
            started = time.perf_counter()
            found = follow(report, times, particles=count, voltage_factor=factor)
            seconds = time.perf_counter() - started
            half = follow(report, times, particles=count, voltage_factor=factor,
                          tolerance=0.5 * TOLERANCE * report.forces.fluid.sound_speed / arguments.at)
            changed = max(abs(a - b) for a, b in zip(_fractions(found), _fractions(half), strict=True))
            moved = MICRON * np.quantile(np.linalg.norm(found.positions[:, -1] - half.positions[:, -1], axis=1), 0.9)
            print(f"{count} particles, {factor:g} times the voltage: {seconds:.2f} s, {seconds / one:.2f} "
                  f"factorisations; half of the tolerance moves nine tenths by less than {moved:.2g} um and capture "
                  f"fractions by {100 * changed:.2g} %; {str(found).splitlines()[0]}")
            kept.add(f"{count} particles, {factor:g} times the voltage", seconds, "s")
    if arguments.scipy:
        beside_scipy(follow(report, times, particles=200), kept)


def _fractions(found: Trajectories) -> list[float]:
    return [float((found.fate == fate).mean()) for fate in Fate]


def beside_scipy(found: Trajectories, kept: Measurements) -> None:
    """The particles that no wall stops, in one system of scipy's with a common step, to the tolerance of a step."""
    free = np.isnan(found.stopped_at)
    starts = found.positions[free, 0]
    cell = np.maximum(found.velocity.cells_at(starts), 0)
    tolerance = TOLERANCE * found.report.forces.fluid.sound_speed / found.report.excitation.frequency

    def right(_: float, x: Any) -> Any:
        return found.velocity(x.reshape(-1, 2), cell)[0].ravel()

    def jacobian(_: float, x: Any) -> Any:
        return block_diag(list(found.velocity(x.reshape(-1, 2), cell, slopes=True)[1]), format="csc")

    for method in ("RK45", "LSODA", "Radau", "BDF"):
        options = {"jac": jacobian} if method in ("Radau", "BDF") else {}
        started = time.perf_counter()
        solved = solve_ivp(right, (0.0, found.times[-1]), starts.ravel(), method=method, rtol=1e-12, atol=tolerance,
                           t_eval=found.times, **options)
        seconds = time.perf_counter() - started
        apart = np.linalg.norm(solved.y[:, -1].reshape(-1, 2) - found.positions[free, -1], axis=1)
        print(f"scipy {method}: {len(starts)} particles that no wall stops, {seconds:.1f} s, {solved.nfev} values, "
              f"median {MICRON * np.median(apart):.2g}, nine tenths within {MICRON * np.quantile(apart, 0.9):.2g} "
              "um of ours")
        kept.add(f"scipy {method}", seconds, "s")


if __name__ == "__main__":
    main()
