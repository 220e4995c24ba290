"""``workbench render``."""

from __future__ import annotations

import argparse
from functools import partial
from typing import TYPE_CHECKING

from geometry.chip import read_chip
from workbench.commands.parsed_options import model_options, output_folder
from workbench.commands.states import SIMULATED, field_files, run_state, simulated, write_fields
from workbench.commands.terminal import print_line, progress_bars
from workbench.files.errors import choose
from workbench.files.ownership import Outputs
from workbench.simulation.run import Simulation, snapshot

if TYPE_CHECKING:
    from rich.console import Console


def run_render(options: argparse.Namespace, console: Console) -> int:
    """``workbench render``: the fields at one frequency."""
    from workbench.render.gallery import FIELDS, draw_state

    for name in options.field or []:
        choose(name, FIELDS, source="command line", field="--field")
    chip = read_chip(options.chip)
    model, name = model_options(options, chip), chip.state(options.state).name
    # Several runs may draw fields into one folder.
    folder = output_folder(options, Outputs("render", field_files(name), kept=tuple(field_files("*"))))
    with progress_bars(console) as show:
        shot = snapshot(chip, name, model.at, registry=model.registry, band=model.band, drive=model.drive,
                        accuracy=model.accuracy, warm=model.warm, progress=partial(simulated, show, name)) \
            if isinstance(model.at, float) else run_state(chip, name, model, show)
        show(name, "pictures", SIMULATED)
        paths = [picture.path for picture in draw_state(shot, folder, only=options.field)]
        if options.vtu:
            paths.append(write_fields(shot, folder))
        show(name, "done", 1.0)
    for path in paths:
        print_line(str(path))
    if isinstance(shot, Simulation):
        print_line(str(shot.operating))
    if shot.warm is not None:
        print_line(str(shot.warm))
    if shot.traps is not None:
        print_line(str(shot.traps))
    return 0
