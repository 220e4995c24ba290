"""The spectrum of a chip
======================

A chip file describes the layers of a chip and the states it is used in. :func:`workbench.simulate` makes the impedance
spectrum of a state, its figures of merit and its fields. Here: the chip of the paper, filled with water.

Reference number: the paper's model has f0 = 1.0306 MHz (Table 5); this chip file gives 1.0305 MHz.
"""

from pathlib import Path

import workbench as wb

CHIPS = Path(wb.__file__).resolve().parent.parent / "geometry" / "chips"

chip = wb.read_chip(CHIPS / "acevedo_2026_chip.toml")
# A coarse mesh and few frequencies: a first look. Leave both out for the accuracy of 0.05 %.
run = wb.simulate(chip, "filled", accuracy=5e-3, points=241)

print(run.figures)
print(f"{run.unknowns} unknowns, estimated error of the mesh {100 * run.mesh_error.rms:.2g} % rms")

out = Path("out")
out.mkdir(exist_ok=True)
print(wb.draw_spectra({"filled": run.spectrum}, out / "first_spectrum.png", title=chip.name))
