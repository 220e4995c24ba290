"""A drop of solder beside the axis
===================================

A disc is round; 50 mg of solder 10.5 mm from its axis are not. They move the radial resonance and couple modes of other
orders, which become narrow side peaks.

Reference number: the solder changes ln Z by up to 226 %.
"""

from dataclasses import replace
from pathlib import Path

import workbench as wb

CHIPS = Path(wb.__file__).resolve().parent.parent / "geometry" / "chips"

disc = wb.read_chip(CHIPS / "free_disc_25x2.toml")
solder = wb.Feature("mass", "transducer", "top", distance=10.5e-3, diameter=3e-3, mass=50e-6)
soldered = replace(disc, features=(solder,))
runs = {name: wb.simulate(chip, band=(35e3, 100e3), points=521) for name, chip in (
    ("round", disc), ("with 50 mg of solder", soldered))}
print(runs["with 50 mg of solder"].findings[0])

if __name__ == "__main__":
    out = Path("out")
    out.mkdir(exist_ok=True)
    print(wb.draw_spectra({name: run.spectrum for name, run in runs.items()}, out / "solder.png",
                          title="a disc with and without solder"))
