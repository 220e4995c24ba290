"""Beads of 10 um at one watt
==========================

The fastest focusing that a watt buys while nothing gets warmer than 5 K: the loss budget times thermal resistances that
the goal states.

Reference number: 0.056 s from 90 to 10 % of a quarter wavelength in place of 0.087 s, held by the 5 K.

    python examples/18_beads_at_one_watt.py [-o out/beads_at_one_watt]

Leaves the report of `workbench design` after a minute or two.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from workbench.cli import main as workbench

GOAL = Path(__file__).resolve().parent / "design" / "beads_at_one_watt.toml"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/beads_at_one_watt"),
                        help="folder for the report")
    options = parser.parse_args()
    return workbench(["design", str(GOAL), "-o", str(options.output)])


if __name__ == "__main__":
    sys.exit(main())
