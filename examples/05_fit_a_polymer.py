"""Fit a printed polymer
======================

The moduli of a printed sample on a transducer that is known. What is found is kept as a material in a folder, which a
registry then reads: every chip file may name it.

Reference number: the sample has G' = 0.93 GPa, K' = 3.57 GPa (``tests/data/reference/disc_gel_PLA.json``).
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import workbench as wb

ROOT = Path(wb.__file__).resolve().parent.parent

recorded = wb.read_recording(ROOT / "tests" / "data" / "reference" / "disc_gel_PLA.csv")
stack = wb.read_chip(ROOT / "geometry" / "chips" / "disc_gel_pla.toml")
# The sample was weighed. Its moduli are not known: the fit starts from those of another polymer.
weighed = replace(stack, layers=(*stack.layers[:-1], replace(stack.layer("sample"), density=1131.7)))
found = wb.fit(recorded, weighed, "polymer", material="pmma/acevedo_2026", accuracy=2e-3)
for estimate in found.result.estimates:
    print(f"{estimate.parameter.name:40}{estimate.value:12.5g}   95 %: {estimate.low:.5g} to {estimate.high:.5g}")

with tempfile.TemporaryDirectory() as folder:
    # Without a folder it is kept among your own materials. Refused is what is not to be believed.
    name = found.save("pla_mine/print_1", folder=Path(folder)) if not found.reasons_against else ""
    print("kept as", name, *found.reasons_against)
    if name:
        print(wb.Registry((Path(folder),)).load(name).shear_modulus)

out = Path("out")
out.mkdir(exist_ok=True)
print(wb.draw_spectra({"recorded": recorded.spectrum, "fitted": found.spectrum}, out / "fit_a_polymer.png",
                      measured=["recorded"], title="disc, gel and printed sample"))
