"""Find the chip of the paper
==========================

Search the dimensions the paper does not print for the best agreement with the model columns of its Table 5.

Known: the transducer (25 x 2.02 mm), the gel (20 um), a pressure node at z = 3.25 mm, six numbers of Table 5. Unknown:
heights of substrate, sidewall, bond and glass, radius of the cavity and of the section. The node ties the substrate's
height to the cavity's, which leaves six lengths for six numbers.

    python examples/10_find_paper_chip.py [--samples 64] [--seed 1] [--polish 3]

A quasi-random sample on a coarse mesh, then least squares from the best few, the last steps on a finer one.
Every evaluated point is appended to ``out/paper_chip_search.csv`` at once, and a second run continues from there.
"""

from __future__ import annotations

import argparse
import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from paper_chip import RANGES, chip_with
from scipy.optimize import least_squares
from scipy.stats import qmc

import workbench as wb

CHIPS = Path(__file__).resolve().parent.parent / "geometry" / "chips"

#: Table 5, columns "Num": f0 (Hz), Z_min (ohm), Q.
TARGET = {"empty": (1028.6e3, 3.24, 114.29), "filled": (1030.6e3, 4.04, 103.06)}
#: What counts as one unit of disagreement: 0.5 kHz, 5 %, 5 %.
SCALE = (500.0, 0.05, 0.05)
BAND, POINTS = (1.005e6, 1.055e6), 201
#: Accuracy of Z of the sample and of the last steps.
COARSE, FINE = 5e-3, 5e-4


def evaluate(chip: wb.Chip, accuracy: float) -> dict[str, tuple[float, float, float]]:
    """f0, Z_min and Q of both states; not a number where there is no resonance."""
    found = {}
    for state in TARGET:
        merit = wb.simulate(chip, state, band=BAND, points=POINTS, accuracy=accuracy).figures
        found[state] = (math.nan,) * 3 if merit is None else (merit.f0, merit.z_min, merit.q)
    return found


def differences(found: dict[str, tuple[float, float, float]]) -> np.ndarray:
    """The six differences from Table 5 in units of :data:`SCALE`."""
    parts = []
    for state, (f0, z_min, q) in TARGET.items():
        a = found[state]
        parts += [(a[0] - f0) / SCALE[0], np.log(a[1] / z_min) / SCALE[1], np.log(a[2] / q) / SCALE[2]]
    return np.array(parts)


class Search:
    """Evaluates points and keeps every one of them on disk."""

    def __init__(self, path: Path, start: wb.Chip) -> None:
        self.path, self.start = path, start
        path.parent.mkdir(parents=True, exist_ok=True)
        self.known: dict[tuple[str, ...], np.ndarray] = {}
        if path.exists():
            with path.open() as stream:
                self.known = {tuple(row[:7]): np.array(row[7:13], dtype=float) for row in csv.reader(stream)}

    def __call__(self, point: np.ndarray, accuracy: float) -> np.ndarray:
        """The six differences at `point` (metres, in the order of :data:`RANGES`); 100 each where it is no chip."""
        key = (f"{accuracy:g}", *(f"{x:.5e}" for x in point))
        if key not in self.known:
            try:
                chip = chip_with(self.start, dict(zip(RANGES, point, strict=True)))
                self.known[key] = np.nan_to_num(differences(evaluate(chip, accuracy)), nan=100.0)
            except wb.InputError:
                self.known[key] = np.full(6, 100.0)
            with self.path.open("a") as stream:
                csv.writer(stream).writerow([*key, *(f"{x:.4f}" for x in self.known[key])])
        return self.known[key]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--polish", type=int, default=3)
    arguments = parser.parse_args()
    start = replace(wb.read_chip(CHIPS / "reference_chip.toml"), ports=None)
    search = Search(Path("out/paper_chip_search.csv"), start)
    low, high = np.array(list(RANGES.values())).T
    sample = qmc.Sobol(len(RANGES), seed=arguments.seed).random(arguments.samples)
    scores = []
    for k, point in enumerate(sample):
        scores.append(float(np.sqrt(np.mean(search(low + point * (high - low), COARSE) ** 2))))
        print(f"{k + 1}/{len(sample)}  {scores[-1]:.2f}  best {min(scores):.2f}", flush=True)
    for index in np.argsort(scores)[: arguments.polish]:
        best = sample[index]
        for mesh, step in ((COARSE, 0.02), (FINE, 0.005)):
            result = least_squares(lambda x, mesh=mesh: search(low + x * (high - low), mesh), best, bounds=(0.0, 1.0),
                                   diff_step=step, max_nfev=8, loss="soft_l1")
            best = result.x
            lengths = {n: f"{x * 1e3:.4f} mm" for n, x in zip(RANGES, low + best * (high - low), strict=True)}
            rms = np.sqrt(np.mean(result.fun**2))
            print(f"mesh {mesh:g}: {rms:.3f} {np.round(result.fun, 2)} {lengths}", flush=True)


if __name__ == "__main__":
    main()
