"""``workbench chips``."""

from __future__ import annotations

import argparse
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import geometry
from geometry.chip import read_chip
from workbench.commands.terminal import print_line, print_table
from workbench.files.errors import InputError, choose
from workbench.files.writing import REMEDIES, remedy
from workbench.report.page import table

if TYPE_CHECKING:
    from rich.console import Console

#: Folder of the chip files of the package.
SHIPPED = Path(geometry.__file__).parent / "chips"


def run_chips(options: argparse.Namespace, _console: Console) -> int:
    """``workbench chips``: list the chip files of the package, or copy one.

    A folder is a chip, ``chip.toml``, with its recordings.
    """
    shipped = {path.stem: path for path in sorted(SHIPPED.iterdir())}
    if options.action == "list":
        chips = [read_chip(path / "chip.toml" if path.is_dir() else path) for path in shipped.values()]
        print_table("chips of the package", table("name | title | states", [
            (name, chip.name, ", ".join(state.name for state in chip.states))
            for name, chip in zip(shipped, chips, strict=True)]))
        return 0
    name = choose(options.name, shipped, source="command line", field="NAME")
    target = Path(options.target)
    if target.is_dir() or options.target.endswith(("/", os.sep)):
        target = target / shipped[name].name
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        if shipped[name].is_dir():
            shutil.copytree(shipped[name], target)
        else:
            with target.open("x", encoding="utf-8") as file:
                file.write(shipped[name].read_text(encoding="utf-8"))
    except FileExistsError:
        raise InputError("command line", "-o", str(target), "a path that does not exist yet") from None
    except OSError as error:
        expected = REMEDIES.get(error.errno or 0, remedy(error))
        raise InputError("command line", "-o", str(target), f"a file that can be written; {expected}") from None
    print_line(str(target))
    return 0
