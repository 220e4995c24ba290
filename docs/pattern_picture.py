"""Draw the picture of the page on features: a chip with 2 mg of solder beside its axis.

    .venv/bin/python docs/pattern_picture.py

The picture is written to ``docs/images/pattern.png``.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent))

import workbench as wb  # noqa: E402
from workbench.model.drive import VoltageDrive  # noqa: E402
from workbench.render.pattern import draw_pattern  # noqa: E402
from workbench.simulation.features import part_of  # noqa: E402
from workbench.simulation.pattern import cavity_pattern  # noqa: E402

SOLDER = wb.Feature("mass", "transducer", "bottom", 3e-3, 1e-3, angle=math.radians(30.0), mass=2e-6)


def main() -> None:
    """Draw the pattern at the resonance of the chip, and print its size and its traps."""
    chip = wb.read_chip(DOCS.parent / "geometry" / "chips" / "acevedo_2026_chip.toml")
    drive = VoltageDrive(10.0)
    shot = wb.snapshot(chip, "filled", 1.0304e6, drive=drive, accuracy=2e-2)
    assert shot.traps is not None
    pattern = cavity_pattern(shot.problem, shot.solution, [part_of(SOLDER)], drive, forces=shot.traps.forces)
    print(pattern)
    for trap in pattern.traps:
        angle = "a ring" if trap.angle is None else f"{math.degrees(trap.angle):.0f} deg"
        print(f"r {1e3 * trap.radius:.3f} mm, z {1e3 * trap.height:.3f} mm, {angle}, {1e15 * trap.potential:.3g} fJ")
    print(draw_pattern(pattern, DOCS / "images" / "pattern.png"))


if __name__ == "__main__":
    main()
