"""My chip, my recording
=====================

A chip file of your own beside the recordings of the chip: are they as near as their noise? Replace the two paths by
those of your files. Here they are of a small chip whose recordings have a noise of 0.5 % in each part of ln Z.

Reference number: the empty chip agrees to 0.36 %; the filled one to 3.15 % at the 25 degC of its file, and to 0.39 % at
the 28 degC that a thermometer shows.
"""

from dataclasses import replace
from pathlib import Path

import workbench as wb

FOLDER = Path(wb.__file__).resolve().parent.parent / "geometry" / "chips" / "small_campaign"

# %%
# The chip file states layers from bottom to top, and the states of the chip. A mistake in it is reported with file,
# field, received and expected value.
chip = wb.read_chip(FOLDER / "chip.toml")
for name, length in chip.dimensions().items():
    print(f"{name:24} {1e3 * length.value:.3f} mm")

# %%
# The recording may be a file of an impedance analyser or any table with headings. The meaning of its columns is stated.
recordings = {state.name: wb.read_recording(FOLDER / f"{state.name}.csv") for state in chip.states}
for name, recording in recordings.items():
    print(f"{name}: {recording.spectrum.frequency.size} points; {recording.read_as or 'a known format'}")

# %%
# Simulate every state and compare.
out = Path("out")
out.mkdir(exist_ok=True)
for name, recording in recordings.items():
    run = wb.simulate(chip, name, points=121, assumed_losses=False)
    print(f"{name}: |Z| differs by {wb.compare(recording, run).mape_percent:.2f} % on average")
    print(wb.draw_spectra({"recorded": recording.spectrum, "simulated": run.spectrum}, out / f"my_{name}.png",
                          measured=["recorded"], title=f"{chip.name}, {name}"))

# %%
# The empty chip agrees, the filled one does not: the difference is in the cavity. Test an idea by changing one number.
empty, filled = chip.states
warm = replace(chip, states=(empty, replace(filled, temperature=273.15 + 28.0)))
run = wb.simulate(warm, "filled", points=121, assumed_losses=False)
print(f"filled, 28 degC: |Z| differs by {wb.compare(recordings['filled'], run).mape_percent:.2f} % on average")
