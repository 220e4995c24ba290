"""The photograph
==============

The paper ends with a photograph: polystyrene beads of 10 um gathered in the middle of the cavity. These are the beads
of its chip from above after 5 s, 1, 5 and 30 min, at two energy densities (of a standing wave as high as the largest
pressure). After 5 s they have hardly moved to the side: they rise or sink to the pressure node. After 1 min at
45 J/m^3, and after 5 min at 15, some are gathered on the axis; at the end there is a dense middle, a ring of 2 mm, and
beads on the floor where the field is too weak to lift them. The flow that the heat of the losses drives carries some of
those that radiation would bring to the middle out to the ring.

Reference number: at 15 J/m^3 the liquid carries beads with 1.7 um/s rms and the chip warms by 4 K; of the beads 22 %
are within 1 mm of the axis after half an hour, and 28 % if the liquid stays at rest.
"""

from pathlib import Path

import workbench as wb

CHIPS = Path(wb.__file__).resolve().parent.parent / "geometry" / "chips"
OUT = Path("out") / "the_photograph"

chip = wb.read_chip(CHIPS / "acevedo_2026_chip.toml")
OUT.mkdir(parents=True, exist_ok=True)
at_one_volt = wb.snapshot(chip, "filled", 1.0305e6, drive=wb.parse_drive("1 Vpp"), accuracy=5e-3)
middle = wb.Window(outer=1e-3)
for energy_density in (15.0, 45.0):
    volts = (energy_density / at_one_volt.traps.excitation.energy_density) ** 0.5
    shot = wb.snapshot(chip, "filled", 1.0305e6, drive=wb.parse_drive(f"{volts:.4f} Vpp"), accuracy=5e-3)
    liquid = wb.liquid_motion(shot)
    print(f"{energy_density:g} J/m^3, {volts:.2f} Vpp: the liquid carries beads with "
          f"{1e6 * liquid.streaming.rms_speed:.2g} um/s rms; the chip warms by {liquid.heat.peak:.2g} K")
    for words, flow in (("with the flow", liquid.velocity), ("at rest", None)):
        found = wb.trajectories(shot, 1800.0, particles=300, seed=1, flow=flow)
        share = wb.light_curve(found, middle)
        print(f"  liquid {words}: within 1 mm of the axis at first {100 * share[0]:.0f} %, after 30 min "
              f"{100 * share[-1]:.0f} %")
        if flow is not None:
            for seconds in (5.0, 60.0, 300.0, 1800.0):
                name = f"above_{energy_density:g}_{seconds:g}s.png"
                print(wb.draw_from_above(found, OUT / name, at=seconds))
