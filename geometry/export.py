"""Files of the solids of a chip for other programs: STEP with part names, and one STL a part. Millimetres."""

from __future__ import annotations

import tempfile
from pathlib import Path

from geometry.chip import Chip
from geometry.solid import solids
from inputs import write_atomic


def export_step(chip: Chip, path: Path) -> Path:
    """Write the assembled chip to `path`, every part under its region name, the cavity's fluid included.

    Raises:
        SolidError: CadQuery is not installed, or the solids are not those of the chip.
    """
    shapes = solids(chip)
    from cadquery import Assembly

    assembly = Assembly(name=chip.name)
    for name, shape in shapes.items():
        assembly.add(shape, name=name)
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / "chip.step"
        assembly.export(str(draft))
        write_atomic(path, draft.read_bytes())
    return path


def export_stl(chip: Chip, folder: Path, *, deviation: float = 1e-5) -> dict[str, Path]:
    """Write every part to ``<folder>/<region>.stl``, flat triangles within `deviation` (metres) of the true surface.

    Raises:
        SolidError: CadQuery is not installed, or the solids are not those of the chip.
    """
    written = {}
    with tempfile.TemporaryDirectory() as drafts:
        for name, shape in solids(chip).items():
            draft = Path(drafts) / f"{name}.stl"
            # The facets are bounded by the deviation alone: the angle, in radians, is left wide.
            shape.exportStl(str(draft), tolerance=1e3 * deviation, angularTolerance=0.5, relative=False)
            written[name] = folder / draft.name
            write_atomic(written[name], draft.read_bytes())
    return written
