"""``workbench modes``."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.chip import read_chip
from workbench.commands.parsed_options import common_band, model_options, output_folder, reading_option
from workbench.commands.terminal import print_line, print_table, progress_bars, say_finding
from workbench.files.errors import InputError
from workbench.files.ownership import Outputs
from workbench.files.quantities import parse_quantity
from workbench.files.writing import write_json
from workbench.render.along import draw_dispersion
from workbench.render.mode_above import draw_mode_above, has_view_above
from workbench.render.sections import animate_mode, draw_mode
from workbench.report.modes import (
    dispersion_record,
    dispersion_table,
    matched_record,
    matched_table,
    modes_record,
    modes_table,
)
from workbench.results.resonances import resonances_of
from workbench.simulation.dispersion import WAVE_NUMBERS, check_channel, dispersion
from workbench.simulation.matched_modes import MatchedMode, matched_modes
from workbench.simulation.modes import ChipModes, modes

if TYPE_CHECKING:
    from rich.console import Console

#: Files of a run.
OUTPUTS = Outputs("modes", names=("modes.json", "dispersion.png", "mode_*.png", "mode_*.gif"))


def run_modes(options: argparse.Namespace, console: Console) -> int:
    """``workbench modes``: the modes of a chip, as table, record and pictures."""
    chip = read_chip(options.chip)
    model, name = model_options(options, chip), chip.state(options.state).name
    orders = [_order(each) for each in options.orders.split(",") if each.strip()]
    wavelengths = [parse_quantity(each, "length", source="command line", field="--wavelengths")
                   for each in options.wavelengths.split(",") if each.strip()]
    if options.draw < 0:
        raise InputError("command line", "--draw", options.draw, "a number of pictures, 0 or more")
    followed = _followed(options)
    if followed is not None:
        check_channel(chip)
        if orders != [0]:
            raise InputError("command line", "--orders", options.orders, "no orders of a straight chip")
    reading, band = None, model.band
    if options.recording is not None:
        reading = reading_option(options, options.recording, console)
        band = common_band(options, band, reading.spectrum.frequency)
    folder = output_folder(options, OUTPUTS)
    with progress_bars(console) as show:
        waves = None if followed is None else dispersion(
            chip, name, band=band, least_q=options.least_q, accuracy=model.accuracy, registry=model.registry,
            progress=partial(show, name), shortest=followed[0], points=followed[1])
        found = modes(chip, name, orders=orders, wavelengths=wavelengths, band=band, least_q=options.least_q,
                      accuracy=model.accuracy, registry=model.registry, progress=partial(show, name))
        show(name, "pictures", 1.0)
        matched: tuple[MatchedMode, ...] = ()
        content = modes_record(found)
        if reading is not None:
            fit = resonances_of(reading.spectrum.restricted(*band))
            matched = matched_modes(() if fit is None else fit.resonances, found.modes)
            content["recording"] = {"file": str(options.recording), "read_as": reading.read_as or None,
                                    "findings": [finding.message for finding in reading.findings],
                                    "resonances": matched_record(matched)}
        if waves is not None:
            content["dispersion"] = dispersion_record(waves)
        paths = [write_json(folder / "modes.json", content),
                 *([] if waves is None else [draw_dispersion(waves, folder / "dispersion.png")]),
                 *_drawn(found, options.draw, folder, animated=options.animate)]
        show(name, "done", 1.0)
    print_table(f"{chip.name}, {name}: {len(found.modes)} modes", modes_table(found))
    if waves is not None:
        print_table(f"{chip.name}, {name}: {len(waves.branches)} waves along the channel", dispersion_table(waves))
        if waves.finding:
            say_finding(waves.finding, console)
    if reading is not None:
        print_table(f"{options.recording.name} beside them", matched_table(matched))
        for finding in reading.findings:
            say_finding(finding.message, console)
    for path in paths:
        print_line(str(path))
    return 0


def _followed(options: argparse.Namespace) -> tuple[float | None, int] | None:
    """Shortest wavelength (m) and number of wave numbers of ``--dispersion``.

    The wavelength is None if not stated, and both are without the option.

    Raises:
        InputError: one of them without ``--dispersion``, or outside its range.
    """
    for field, given in (("--shortest", options.shortest), ("--wave-numbers", options.wave_numbers)):
        if given is not None and not options.dispersion:
            raise InputError("command line", field, given, "--dispersion beside it")
    if not options.dispersion:
        return None
    count = WAVE_NUMBERS if options.wave_numbers is None else options.wave_numbers
    if count < 2:
        raise InputError("command line", "--wave-numbers", count, "a number of wave numbers, 2 or more")
    if options.shortest is None:
        return None, count
    shortest = parse_quantity(options.shortest, "length", source="command line", field="--shortest")
    if not shortest > 0.0:
        raise InputError("command line", "--shortest", options.shortest, 'a wavelength above zero, such as "1 mm"')
    return shortest, count


def _order(text: str) -> int:
    """An order of the command line.

    Raises:
        InputError: no whole number, or one below 0.
    """
    if not text.strip().isdigit():
        raise InputError("command line", "--orders", text.strip(), "whole numbers of waves around the axis, such as "
                         '"0,1,2"')
    return int(text)


def _drawn(found: ChipModes, most: int, folder: Path, *, animated: bool) -> Iterator[Path]:
    """Pictures of the modes with most coupling, or energy in the liquid."""
    leading = sorted(found.modes, key=lambda mode: -max(mode.k_eff, mode.liquid))[:most]
    for mode in sorted(leading, key=lambda mode: mode.frequency):
        kind = f"{1e3 * mode.wavelength:.6g}_mm" if math.isfinite(mode.wavelength) else f"order_{mode.order}"
        name = f"mode_{mode.frequency / 1e6:.6f}_MHz_{kind}"
        yield draw_mode(found.nodes, mode, folder / f"{name}.png")
        if has_view_above(mode):
            yield draw_mode_above(found.nodes, mode, folder / f"{name}_above.png")
        if animated:
            yield animate_mode(found.nodes, mode, folder / f"{name}.gif")
