"""A silicon channel at a fixed frequency that its drive warms up, against full solves of one state after the other.

    .venv/bin/python tests/benchmarks/warm_channel.py [--at 1.94] [--volts 1 2 3 4 6]

Left: the fixed point of `wb.snapshot(..., warm=wb.WarmUp())`. Right: a damped iteration by hand, over the temperature
of the state, which is set to that which `wb.heating` computes, and solved anew.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT)]

import workbench as wb  # noqa: E402
from geometry.chip import Chip  # noqa: E402
from workbench.simulation.run import Snapshot  # noqa: E402

CHIP = ROOT / "geometry" / "chips" / "silicon_glass_channel.toml"
AMBIENT = 298.15
#: K by which the temperature still moves when the iteration ends.
SETTLED = 0.02


def at_temperature(chip: Chip, kelvin: float) -> Chip:
    """The chip with its filled state at a temperature (K)."""
    return replace(chip, states=tuple(replace(state, temperature=kelvin) if state.name == "filled" else state
                                      for state in chip.states))


def by_hand(chip: Chip, frequency: float, volts: float) -> tuple[float, Snapshot]:
    """The rise (K) and the state that the losses of the state keep."""
    rise = 0.0
    for _ in range(40):
        shot = wb.snapshot(at_temperature(chip, AMBIENT + rise), "filled", frequency,
                           drive=wb.parse_drive(f"{volts:g} Vpp"), accuracy=5e-3)
        aim = wb.heating(shot).parts["cavity"].mean
        if abs(aim - rise) < SETTLED:
            break
        rise = min(0.5 * (rise + aim), 24.9)
    return rise, shot


def main() -> None:
    """Print both, and the state of a chip that is kept cold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--at", type=float, default=1.94, metavar="MHz")
    parser.add_argument("--volts", type=float, nargs="+", default=[1.0, 2.0, 3.0, 4.0, 6.0], metavar="Vpp")
    options = parser.parse_args()
    chip = wb.read_chip(CHIP)
    sys.stdout.write(" Vpp   cold: K  J/m^3   warm: K  J/m^3   by hand: K  J/m^3   difference of E_ac\n")
    for volts in options.volts:
        found = wb.snapshot(chip, "filled", 1e6 * options.at, drive=wb.parse_drive(f"{volts:g} Vpp"), accuracy=5e-3,
                            warm=wb.WarmUp()).warm
        assert found is not None
        assert found.here is not None
        rise, shot = by_hand(chip, 1e6 * options.at, volts)
        energy = wb.channel_figures(shot).energy_density
        sys.stdout.write(f"{volts:4g} {found.cold.rise:10.2f} {found.cold.energy_density:6.1f} {found.here.rise:9.2f} "
                         f"{found.here.energy_density:6.2f} {rise:12.2f} {energy:6.2f} "
                         f"{100.0 * (found.here.energy_density / energy - 1.0):+16.2f} %\n")


if __name__ == "__main__":
    main()
