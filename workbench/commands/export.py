"""``workbench export``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.chip import Chip, read_chip
from workbench.commands.parsed_options import output_folder
from workbench.commands.terminal import print_line, say_finding
from workbench.files.ownership import Outputs

if TYPE_CHECKING:
    from rich.console import Console


def run_export(options: argparse.Namespace, console: Console) -> int:
    """``workbench export``: STEP of the assembly, STL of every part."""
    chip = read_chip(options.chip)
    assembly, parts = export_solids(chip, output_folder(options, Outputs("export", solid_names(chip))))
    for path in (assembly, *parts.values()):
        print_line(str(path))
    if chip.not_round:
        say_finding(f"the solids are those of the layers, without {'; '.join(chip.not_round)}", console)
    return 0


def solid_names(chip: Chip) -> tuple[str, ...]:
    """The names of the files of a chip's solids."""
    return ("chip.step", *(f"{region}.stl" for region in chip.regions))


def export_solids(chip: Chip, folder: Path) -> tuple[Path, dict[str, Path]]:
    """Write the solids of a chip as STEP, and STL by part."""
    from geometry.export import export_step, export_stl

    return export_step(chip, folder / "chip.step"), export_stl(chip, folder)
