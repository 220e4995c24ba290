"""A half-wave chip in PLA
=======================

The strongest field of a chip that is printed in PLA, lid included, on a disc of 1 MHz: thicknesses in layers of 20 um,
the trap within 50 um of mid-height, f0 in the band of the amplifier.

Reference number: from 245 to 624 J/m^3 at 10 Vpp, by a cavity of 0.82 mm under a lid of 0.58 mm.

    python examples/16_half_wave_chip.py [-o out/half_wave_chip]

Leaves the report of `workbench design` after a minute or two.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from workbench.cli import main as workbench

GOAL = Path(__file__).resolve().parent / "design" / "half_wave_chip.toml"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/half_wave_chip"), help="folder for the report")
    options = parser.parse_args()
    return workbench(["design", str(GOAL), "-o", str(options.output)])


if __name__ == "__main__":
    sys.exit(main())
