"""``workbench sensitivity``."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from geometry.chip import Chip, read_chip
from geometry.names import TRANSDUCER
from workbench.commands.parsed_options import model_options, output_folder
from workbench.commands.terminal import print_line, print_table, progress_bars
from workbench.files.errors import InputError
from workbench.files.ownership import Outputs
from workbench.files.quantities import parse_quantity
from workbench.files.writing import write_json
from workbench.model.numbers import ParameterName
from workbench.model.problem import Problem, build, fill
from workbench.report.sensitivity import local_name, ranking_table, sensitivity_record, write_sensitivity_report
from workbench.reproduction.sensitivity import (
    LOSS_THRESHOLD,
    REAL_THRESHOLD,
    TABLE_ONE,
    sensitivity,
)

if TYPE_CHECKING:
    from rich.console import Console
#: Files of `sensitivity`.
OUTPUTS = Outputs("sensitivity", names=("report.html", "sensitivity.json", "ranking.png", "costs_real.png",
                                        "costs_imaginary.png"))


def run_sensitivity(options: argparse.Namespace, console: Console) -> int:
    """``workbench sensitivity``: Algorithm 1 of the paper, with its Table 2."""
    chip = read_chip(options.chip)
    if options.density is not None:
        chip = _with_density(chip, parse_quantity(options.density, "density", source="command line", field="--density"))
    model = model_options(options, chip)
    state = chip.state(options.state).name
    problem = build(fill(chip, state, model.registry), band=model.band,
                    accuracy=model.accuracy)
    baseline = _baseline(problem, options.loss)
    folder = output_folder(options, OUTPUTS)
    with progress_bars(console) as show:
        found = sensitivity(
            problem, np.linspace(*model.band, options.points), baseline=baseline, scalings=options.scalings,
            progress=lambda part, share: show(state, local_name(part), share))
        show(state, "done", 1.0)
    print_table(f"{chip.name}, {problem.materials[TRANSDUCER].name}", ranking_table(found))
    print_line(f"kept at {REAL_THRESHOLD:.0%} and {LOSS_THRESHOLD:.0%}: {', '.join(map(local_name, found.kept()))}")
    if found.undetermined:
        console.print(f"zero in the baseline, so they have no rank (--loss sets a loss): "
                      f"{', '.join(map(local_name, found.undetermined))}", style="yellow", markup=False)
    console.print(f"{found.spectra} spectra in {found.seconds:.1f} s, {found.solves} full solves", markup=False)
    write_json(folder / "sensitivity.json", {
        "chip": chip.name, "chip_file": str(options.chip), "state": state,
        "material": problem.materials[TRANSDUCER].name, "density_kg_m3": problem.materials[TRANSDUCER].density,
        "band_hz": list(model.band), "points": options.points, **sensitivity_record(found)})
    write_sensitivity_report(chip.name, found, folder)
    return 0


def _with_density(chip: Chip, density: float) -> Chip:
    return replace(chip, layers=tuple(
        replace(layer, density=density) if layer.region == TRANSDUCER else layer for layer in chip.layers))


def _baseline(problem: Problem, share: float) -> dict[str, complex]:
    """Losses that the material does not state, relative to the real part."""
    if not 0.0 <= share < 1.0:
        raise InputError("command line", "--loss", share, "a share of the real part, from 0 to below 1")
    material, result = problem.materials[TRANSDUCER].name, {}
    for name in TABLE_ONE:
        parsed = ParameterName.parse(f"{material}.{name}")
        if parsed.is_loss:
            key = parsed.key
            value = complex(problem.values[key])
            if value.imag == 0.0 and share:
                # The loss of a permittivity is a positive imaginary part, that of a stiffness a negative one.
                result[key] = complex(value.real, share * value.real * (1.0 if ".eps" in key else -1.0))
    return result


