"""A real disc
===========

What does the model of a real free disc leave unexplained?

    python examples/13_real_disc.py RECORDING [-o out/real_disc]

RECORDING is the E4990A sweep MODULOFASEMODOTHICKNES.CSV of M. P. Stolfi and E. Santangelo (course work, Universita
degli Studi della Basilicata, 2025; MIT licence; on GitHub in
NabboGamer/Sensori-Rivelatori-Dispositivi-Elettronici-Esercitazioni), of a disc of 20 by 2.013 mm whose material nobody
wrote down. What is known of it is in real_disc/campaign.toml; 1.04 to 1.07 MHz are held out. Leaves the report of
`workbench diagnose`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

CAMPAIGN = Path(__file__).resolve().parent / "real_disc" / "campaign.toml"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path, metavar="RECORDING")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/real_disc"), help="folder for the report")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    text = CAMPAIGN.read_text(encoding="utf-8").replace('"RECORDING"', f'"{options.recording.resolve().as_posix()}"')
    chips = (CAMPAIGN.parents[2] / "geometry" / "chips").as_posix()
    campaign = options.output / "campaign.toml"
    campaign.write_text(text.replace('"../../geometry/chips', f'"{chips}'), encoding="utf-8")
    command = [sys.executable, "-m", "workbench", "diagnose", str(campaign), "-o", str(options.output)]
    return subprocess.run(command).returncode


if __name__ == "__main__":
    sys.exit(main())
