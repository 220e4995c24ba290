"""Design a chip
=============

Three design tasks, each a goal file in ``design``, each answered by `workbench design` after a minute or two:

**half_wave_chip**: the strongest field of a chip that is printed in PLA, lid included, on a disc of 1 MHz: thicknesses
in layers of 20 um, the trap within 50 um of mid-height, f0 in the band of the amplifier.

**stock_glass**: a lid of glass, which comes in 0.15, 0.5 and 1 mm. Each is searched on a model of its own, with what is
printed below it free.

**beads_at_one_watt**: the fastest focusing of beads of 10 um that a watt buys while nothing gets warmer than 5 K: the
loss budget times thermal resistances that the goal states.

Reference number: half_wave_chip from 245 to 624 J/m^3 at 10 Vpp, by a cavity of 0.82 mm under a lid of 0.58 mm;
stock_glass 1766 J/m^3 in place of 1331, by the glass of 1 mm above 0.77 mm of PLA; beads_at_one_watt 0.056 s from 90 to
10 % of a quarter wavelength in place of 0.087 s, held by the 5 K.

    python examples/16_design_a_chip.py [half_wave_chip stock_glass beads_at_one_watt] [-o out/design]

Leaves a folder with the report, the chip file and the solids for every task.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

GOALS = Path(__file__).resolve().parent / "design"
TASKS = ("half_wave_chip", "stock_glass", "beads_at_one_watt")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="*", default=TASKS, metavar="TASK", help=f"of {', '.join(TASKS)} (default all)")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/design"), help="folder for the reports")
    options = parser.parse_args()
    status = 0
    for task in options.tasks:
        command = [sys.executable, "-m", "workbench", "design", str(GOALS / f"{task}.toml"),
                   "-o", str(options.output / task)]
        status = max(status, subprocess.run(command).returncode)
    return status


if __name__ == "__main__":
    sys.exit(main())
