"""Export of a chip's solids as STEP and STL, in millimetres."""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from geometry.chip import Chip
from geometry.solid import chip_solids
from workbench.files.writing import replacing


def export_step(chip: Chip, path: Path) -> Path:
    """Write the assembled chip as STEP, every part under its region name. The cavity's fluid is included.

    Raises:
        SolidError: CadQuery is not installed, or the solids are not those of the chip.
    """
    shapes = chip_solids(chip)
    from cadquery import Assembly

    assembly = Assembly(name=chip.name)
    for name, shape in shapes.items():
        assembly.add(shape, name=name)
    with replacing(path) as whole:
        assembly.export(str(whole), exportType="STEP")
    return path


def export_stl(chip: Chip, folder: Path, *, deviation: float = 1e-5) -> dict[str, Path]:
    """Write every part to ``<folder>/<region>.stl``, within `deviation` (m) of the true surface.

    A substrate and a sidewall of one material are one part, ``substrate.stl``.

    Raises:
        SolidError: CadQuery is not installed, or the solids are not those of the chip.
    """
    written = {}
    for name, shape in chip_solids(chip).items():
        written[name] = folder / f"{name}.stl"
        # The kernel cannot write STL to a path with a colon.
        with replacing(written[name]) as whole, TemporaryDirectory() as plain:
            draft = Path(plain) / f"{name}.stl"
            # Only the deviation limits the facets: the angle (radians) is wide.
            shape.exportStl(str(draft), tolerance=1e3 * deviation, angularTolerance=0.5, relative=False)
            shutil.copyfile(draft, whole)
    return written
