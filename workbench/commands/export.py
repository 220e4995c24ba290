"""``workbench export``."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from geometry.chip import read_chip
from workbench.commands.asked import output_folder
from workbench.commands.terminal import print_line

if TYPE_CHECKING:
    from rich.console import Console


def run_export(options: argparse.Namespace, _console: Console) -> int:
    """``workbench export``: STEP of the assembly, STL of every part."""
    from geometry.export import export_step, export_stl

    chip, folder = read_chip(options.chip), output_folder(options.output)
    for path in (export_step(chip, folder / "chip.step"), *export_stl(chip, folder).values()):
        print_line(str(path))
    return 0
