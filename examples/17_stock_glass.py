"""A lid of stock glass
====================

Glass comes in 0.15, 0.5 and 1 mm. Each is searched on a model of its own, with what is printed below it free.

Reference number: the glass of 1 mm wins; 1766 J/m^3 at 10 Vpp in place of 1331, above 0.77 mm of PLA.

    python examples/17_stock_glass.py [-o out/stock_glass]

Leaves the report of `workbench design` after a minute or two.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from workbench.cli import main as workbench

GOAL = Path(__file__).resolve().parent / "design" / "stock_glass.toml"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/stock_glass"), help="folder for the report")
    options = parser.parse_args()
    return workbench(["design", str(GOAL), "-o", str(options.output)])


if __name__ == "__main__":
    sys.exit(main())
