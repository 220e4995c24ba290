"""The paper's chip with other dimensions, of which it prints few: what the examples search and draw from."""

from __future__ import annotations

from collections.abc import Mapping

import workbench as wb

#: Height (m) of the pressure node above the bottom of the transducer (section 4.4).
NODE = 3.25e-3

#: Ranges (m) of what is not printed. The height of the substrate follows from that of the node.
RANGES = {
    "sidewall.thickness": (0.40e-3, 1.00e-3),
    "bond.thickness": (0.01e-3, 0.30e-3),
    "superstrate.thickness": (0.10e-3, 3.0e-3),
    "cavity.radius": (1.5e-3, 12.0e-3),
    "section.radius": (12.5e-3, 20.0e-3),
    "node.offset": (-0.08e-3, 0.08e-3),
}


def chip_with(chip: wb.Chip, lengths: Mapping[str, float]) -> wb.Chip:
    """The chip with these lengths (m); the middle of the cavity lies `node.offset` above the printed node."""
    below = chip.transducer.thickness.value + lengths.get("couplant.thickness", chip.layer("couplant").thickness.value)
    height = lengths["sidewall.thickness"] + lengths["bond.thickness"]
    own = {name: value for name, value in lengths.items() if name.partition(".")[0] not in ("section", "node")}
    radii = {f"{region}.radius": lengths["section.radius"]
             for region in ("substrate", "sidewall", "bond", "superstrate")}
    return chip.with_dimensions(
        {**own, **radii, "substrate.thickness": NODE + lengths["node.offset"] - below - 0.5 * height})
