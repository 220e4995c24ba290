"""``workbench along``."""

from __future__ import annotations

import argparse
from functools import partial
from typing import TYPE_CHECKING

from geometry.chip import read_chip
from workbench.commands.parsed_options import model_options, output_folder
from workbench.commands.terminal import print_line, print_table, progress_bars, say_finding
from workbench.files.errors import InputError
from workbench.files.ownership import Outputs
from workbench.files.writing import write_json
from workbench.render.along import draw_along, draw_between_ends
from workbench.report.along import along_record, along_table
from workbench.simulation.finite_length import finite_length, stated_measure

if TYPE_CHECKING:
    from rich.console import Console

#: Files of a run.
OUTPUTS = Outputs("along", names=("along.json", "along.png", "between_ends.png"))

#: Peaks of the energy with a profile.
SHOWN = 3


def run_along(options: argparse.Namespace, console: Console) -> int:
    """``workbench along``: a chip of its length between its ends, with pictures."""
    chip = read_chip(options.chip)
    model, name = model_options(options, chip), chip.state(options.state).name
    stated_measure(chip)
    if isinstance(model.at, str):
        raise InputError("command line", "--at", options.at, 'a frequency, such as "1.94 MHz"')
    folder = output_folder(options, OUTPUTS)
    with progress_bars(console) as show:
        found = finite_length(chip, name, band=model.band, points=model.points, accuracy=model.accuracy,
                              registry=model.registry, progress=partial(show, name))
        show(name, "pictures", 1.0)
        profiles = [] if found.cavity is None else [found.profile(at) for at in (
            found.peaks[:SHOWN] or (None,) if model.at is None else (model.at,))]
        paths = [write_json(folder / "along.json", along_record(found, profiles)),
                 draw_between_ends(found, folder / "between_ends.png")]
        if profiles:
            paths.append(draw_along(found, profiles, folder / "along.png"))
        show(name, "done", 1.0)
    if profiles:
        print_table(f"{chip.name}, {name}: {1e3 * found.length:.4g} mm, {len(found.parts)} wave numbers",
                    along_table(found, profiles))
    if not profiles:
        say_finding("the state has no liquid in its cavity: impedances alone", console)
    elif not found.peaks and model.at is None:
        say_finding("the energy has no peak in the band: the maxima are those at its largest value, at "
                    f"{profiles[0].frequency / 1e6:.6g} MHz", console)
    for path in paths:
        print_line(str(path))
    return 0
