"""A parametric study: the height of the cavity
============================================

How the height of the cavity moves the resonance of the filled chip. Ten lines do the study; the rest draws it.

Reference number: from 0.70 to 0.74 mm f0 falls from 1.0291 to 1.0225 MHz.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import workbench as wb

CHIPS = Path(wb.__file__).resolve().parent.parent / "geometry" / "chips"

chip = wb.read_chip(CHIPS / "reference_chip.toml")
heights = np.array([0.70e-3, 0.74e-3])
found = {}
for height in heights:
    changed = replace(chip.with_dimensions({"sidewall.thickness": height}), name=f"{height * 1e3:.2f} mm")
    found[changed.name] = wb.simulate(changed, "filled", accuracy=5e-3, points=121)
    merit = found[changed.name].figures
    print(f"height {changed.name}: " + (f"f0 {merit.f0 / 1e6:.4f} MHz, Z_min {merit.z_min:.2f} ohm, Q {merit.q:.0f}"
                                        if merit else "no resonance in the band"))

if __name__ == "__main__":
    out = Path("out")
    out.mkdir(exist_ok=True)
    print(wb.draw_spectra({name: run.spectrum for name, run in found.items()}, out / "cavity_height.png",
                          title="height of the sidewall, filled"))
