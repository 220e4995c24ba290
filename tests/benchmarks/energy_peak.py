"""Exact derivatives of a channel's energy peak against moved full solves, and the peak against a scan of full solves.

    python tests/benchmarks/energy_peak.py [--accuracy 0.005] [--only NAME ...]

Prints for every length and material constant of the silicon channel the relative derivative of the peak's frequency,
mean energy density and Q, and the largest difference from central differences of full solves on the same mesh,
stretched. Differences are relative to the derivative, or where that is small to the largest one of a unit's relative
change of any number.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

from geometry.chip import Chip, read_chip
from workbench.acoustics.sound_energy import SoundEnergy
from workbench.design.input_uncertainty import numbers_of
from workbench.design.resonance import Energy, Responding, find_resonance
from workbench.fem.linearised import FullSystem, ReducedSystem
from workbench.fem.operators import assemble
from workbench.fem.solve import one_thread
from workbench.model.dimensions import parametrised
from workbench.model.drive import Drive, PowerDrive, VoltageDrive
from workbench.model.numbers import LOSS, ParameterName, placed
from workbench.model.problem import build, fill
from workbench.reduced.at_point import reduced

CHIPS = Path(__file__).resolve().parents[2] / "geometry" / "chips"
#: Relative steps of numbers and of losses: the peak moves by a thousandth of its width.
STEP, OF_LOSS = 2e-5, 2e-3
FIGURES = ("frequency", "energy", "Q")


class Peak:
    """The energy peak of a chip on one mesh, as a function of its numbers."""

    def __init__(self, chip: Chip, state: str, drive: Drive, accuracy: float) -> None:
        device = fill(chip, state)
        self.names = tuple(name for name, value in numbers_of(device).items() if value)
        plain = build(device, accuracy=accuracy)
        radii = [n for n in self.names if ParameterName.parse(n).is_radius]
        self.problem = parametrised(plain, chip, radii)
        self.numbers = {name: value for name, value in numbers_of(device).items() if value}
        self.operators = assemble(self.problem.mesh, self.problem.terms)
        self.sound, self.response = SoundEnergy.of(self.operators), Energy(drive)
        frequency = np.linspace(*chip.band, 161)
        with one_thread():
            small, sweep = reduced(self.operators, frequency, self.problem.values, tolerance=1e-6, confirmed=False)
        self.rough = Responding(ReducedSystem(small.operators, self.problem.values), self.problem.values,
                                self.sound.on(small.basis))
        self.frequency, self.level = sweep.frequency, self.response.sampled(self.rough, sweep)

    def model(self, moved: dict[str, float]) -> Responding:
        """The full model at moved numbers."""
        values = placed(self.problem.values, moved)
        return Responding(FullSystem(self.operators, values), values, self.sound)

    def figures(self, moved: dict[str, float]) -> np.ndarray:
        """ln of frequency, energy and Q by Newton's method on full solves."""
        with one_thread():
            found = find_resonance(self.response, self.model(moved), self.frequency, self.level)
        return np.array([math.log(found.frequency.value), -2.0 * found.least.value, math.log(found.q.value)])

    def derivatives(self) -> np.ndarray:
        """(names, 3): relative derivatives by relative changes."""
        parsed = [ParameterName.parse(name) for name in self.names]
        turns = np.array([1j if each.is_loss else 1.0 for each in parsed])
        with one_thread():
            found = find_resonance(self.response, self.rough, self.frequency, self.level,
                                   tuple(each.key for each in parsed), turns, self.model(self.numbers))
        scale = np.array(list(self.numbers.values()))
        return np.column_stack([found.frequency.gradient / found.frequency.value, -2.0 * found.least.gradient,
                                found.q.gradient / found.q.value]) * scale[:, None]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--accuracy", type=float, default=5e-3)
    parser.add_argument("--only", nargs="*", default=[])
    options = parser.parse_args()
    chip = read_chip(CHIPS / "silicon_glass_channel.toml")
    for drive in (VoltageDrive(1.0), PowerDrive(1.0)):
        peak = Peak(chip, "filled", drive, options.accuracy)
        exact = peak.derivatives()
        own = np.exp(peak.figures(peak.numbers))
        print(f"{drive}: {own[0] / 1e6:.5f} MHz, {own[1]:.4g} J/m^3, Q {own[2]:.4g}")
        worst = np.zeros(3)
        for name, derivative in zip(peak.names, exact, strict=True):
            if options.only and name not in options.only:
                continue
            step = OF_LOSS if name.endswith(LOSS) else STEP
            value = peak.numbers[name]
            high, low = (peak.figures({**peak.numbers, name: value * (1.0 + sign * step)}) for sign in (1.0, -1.0))
            found = (high - low) / (2.0 * step)
            off = np.abs(found - derivative) / np.maximum(np.abs(derivative), 1e-3 * np.abs(exact).max(axis=0))
            worst = np.maximum(worst, off)
            print(f"  {name:48s} " + "  ".join(f"{d:+.6g} ({o:.1e})" for d, o in zip(derivative, off, strict=True)),
                  flush=True)
        print("  largest differences: " + ", ".join(f"{n} {w:.1e}" for n, w in zip(FIGURES, worst, strict=True)))


if __name__ == "__main__":
    main()
