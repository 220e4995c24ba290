"""Your own shape
==============

A chip whose lid is drawn by a CadQuery script (``examples/shapes/domed_lid.py``): glass, hollowed to a shallow dome
over the cavity. The chip file names the script and states its parameters, with units and tolerances; from there
everything is as of any chip: spectrum, fields, traps. How deep the hollow is, ``superstrate.hollow``, is a dimension
like others, so it can be changed by its name.

Reference number: below a dome of 0.1 mm the cavity of 4 mm radius and 0.82 mm height holds 43.73 mm^3 (a cylinder and
a spherical cap).
"""

from pathlib import Path

import workbench as wb

EXAMPLES = Path(wb.__file__).resolve().parent.parent / "examples"

chip = wb.read_chip(EXAMPLES / "shapes" / "domed_lid.toml")
print("the lid's own dimensions:", *(name for name in chip.dimensions() if name.startswith("superstrate.")))

run = wb.simulate(chip, "filled", accuracy=5e-3, points=121)
print(f"cavity {1e9 * run.problem.mesh.section.volume('cavity'):.2f} mm^3, f0 {run.figures.f0 / 1e6:.4f} MHz")

# The same drive at the same frequency under a flatter dome.
flatter = wb.snapshot(chip.with_dimensions({"superstrate.hollow": 0.05e-3}), "filled", run.figures.f0, accuracy=5e-3)
for name, shot in (("0.10 mm", run), ("0.05 mm", flatter)):
    trap = shot.traps.traps[0]
    print(f"dome of {name}: deepest trap at {trap}")

out = Path("out") / "your_own_shape"
out.mkdir(parents=True, exist_ok=True)
for picture in wb.draw_state(run, out, only=("mesh", "pressure")):
    print(picture.path)
