"""How the height of the cavity moves the resonance of the filled chip. Ten lines do the study; the rest draws it.

For comparison: 2 % more height (14 um) lowers f0 of a chip like this by about 3.7 kHz.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import geometry
from geometry.chip import read_chip
from workbench.simulation import simulate

chip = read_chip(Path(geometry.__file__).parent / "chips" / "reference_chip.toml")
heights = np.linspace(0.68e-3, 0.76e-3, 5)
found = {}
for height in heights:
    changed = replace(chip.with_dimensions({"sidewall.thickness": height}), name=f"{height * 1e3:.2f} mm")
    found[changed.name] = simulate(changed, "filled", accuracy=5e-3, points=241)
    merit = found[changed.name].figures
    print(f"height {changed.name}: " + (f"f0 {merit.f0 / 1e6:.4f} MHz, Z_min {merit.z_min:.2f} ohm, Q {merit.q:.0f}"
                                        if merit else "no resonance in the band"))

if __name__ == "__main__":
    from workbench.render.plots import draw_spectra

    out = Path("out")
    out.mkdir(exist_ok=True)
    print(draw_spectra({name: run.spectrum for name, run in found.items()}, out / "cavity_height.png",
                       title="height of the sidewall, filled"))
