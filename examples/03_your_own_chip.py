"""Your own chip
=============

A chip file from nothing: layers from bottom to top, every length with its unit, then the states. What may stand in
the file is listed in the documentation under "chip file"; a mistake is answered with the place, the value and the
remedy.

Reference number: the cavity is 0.72 mm high, half a wavelength in water (1482 m/s at 20 degC) at 1.03 MHz.
"""

import tempfile
from pathlib import Path

import workbench as wb

LAYERS = (("transducer", "pzt4/acevedo_2026_fitted", "2 mm", ""), ("couplant", "coupling_gel", "20 um", ""),
          ("substrate", "pmma", "1 mm", ""), ("sidewall", "pmma", "0.72 mm", "2.5 mm"),
          ("superstrate", "soda_lime_glass", "1 mm", ""))

text = """
[chip]
name = "my chip"
band = ["0.95 MHz", "1.15 MHz"]

[states.filled]
cavity = "water"
temperature = "20 degC"
particle = "polystyrene"
particle_radius = "5 um"
"""
for role, material, thickness, hole in LAYERS:
    text += f'\n[[layers]]\nrole = "{role}"\nmaterial = "{material}"\nthickness = "{thickness}"\nradius = "5 mm"\n'
    text += f'cavity_radius = "{hole}"\n' if hole else ""

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "my_chip.toml"
    path.write_text(text, encoding="utf-8")
    chip = wb.read_chip(path)
    # Every length has a name, by which it can be changed.
    print(*chip.dimensions())
    try:
        path.write_text(text.replace('"20 um"', '"20"'), encoding="utf-8")
        wb.read_chip(path)
    except wb.InputError as mistake:
        print("a mistake is answered:", mistake)

run = wb.simulate(chip, accuracy=5e-3, points=121)
print(run.figures or run.no_resonance)

out = Path("out") / "your_own_chip"
out.mkdir(parents=True, exist_ok=True)
for picture in wb.draw_state(run, out, only=("mesh", "pressure")):
    print(picture.path)
