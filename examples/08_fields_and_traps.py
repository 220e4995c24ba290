"""Fields and traps
=================

The filled chip at one frequency: pressure in the cavity, Gor'kov potential of a particle, the traps it has, and where
the power goes. :func:`workbench.snapshot` makes one solve and no spectrum.

Reference number: the paper's chip has its pressure node at z = 3.25 mm; the deepest trap lies within 0.05 mm of it.
"""

from pathlib import Path

import workbench as wb

CHIPS = Path(wb.__file__).resolve().parent.parent / "geometry" / "chips"

chip = wb.read_chip(CHIPS / "acevedo_2026_chip.toml")
# A generator of 10 Vpp behind 50 ohm leaves less at the electrodes than "10 Vpp" does.
for drive in ("10 Vpp", "10 Vpp @ 50 ohm"):
    shot = wb.snapshot(chip, "filled", 1.0305e6, drive=wb.parse_drive(drive), accuracy=5e-3)
    trap = shot.traps.traps[0]
    print(f"{drive:16} trap at {trap}; {shot.traps.excitation}")

total = sum(shot.losses.values())
print(*(f"{place}: {100 * power / total:.0f} % of the power" for place, power in shot.losses.items()), sep="\n")

out = Path("out") / "fields_and_traps"
out.mkdir(parents=True, exist_ok=True)
for picture in wb.draw_state(shot, out, only=("pressure", "gorkov", "cutaway", "losses")):
    print(picture.path)
