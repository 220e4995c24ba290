"""``workbench mesh``."""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from geometry.chip import Chip, read_chip
from workbench.commands.parsed_options import ModelOptions, accuracy_option, model_options, output_folder
from workbench.commands.states import run_state
from workbench.commands.terminal import Show, print_line, print_table, progress_bars
from workbench.files.errors import InputError
from workbench.files.ownership import Outputs
from workbench.files.quantities import frequency_text
from workbench.files.writing import write_json
from workbench.model.discretisation import ROWS, Discretisation, discretisation
from workbench.model.problem import build, fill
from workbench.report.mesh import (
    MeshRow,
    cells_table,
    convergence_record,
    convergence_table,
    write_convergence_report,
)
from workbench.simulation.run import Simulation

if TYPE_CHECKING:
    from rich.console import Console

#: Ratio of the element sizes of the finest mesh in the table and the reference mesh.
FINER = 1.5

#: Files of `mesh --converge`.
OUTPUTS = Outputs("mesh", names=("report.html", "convergence.json", "convergence.png"))


def run_mesh(options: argparse.Namespace, console: Console) -> int:
    """``workbench mesh``: the mesh, and the error at each accuracy setting."""
    chip = read_chip(options.chip)
    model, state = model_options(options, chip), chip.state(options.state).name
    problem = build(fill(chip, state, model.registry), band=model.band, accuracy=model.accuracy)
    made = discretisation(model.accuracy)
    cells = problem.mesh.mesh.t.shape[1]
    print_table(f"{chip.name}, {state}: {cells} cells of order {made.order} at {model.band[1] / 1e6:.4g} MHz",
                cells_table(problem, model.band[1]))
    if not options.converge:
        return 0
    return _converge(options, console, chip, state, model)


def _converge(options: argparse.Namespace, console: Console, chip: Chip, state: str, model: ModelOptions) -> int:
    """Compare the meshes of every accuracy with a finer one. The exit status is whether the requested one meets its
    accuracy."""
    wanted = accuracy_option(options)
    folder = None if options.output is None else output_folder(options, OUTPUTS)
    accuracies = sorted({*ROWS, wanted}, reverse=True)
    made: dict[float | None, Discretisation] = {accuracy: discretisation(accuracy) for accuracy in accuracies}
    made[None] = ROWS[min(ROWS)].refined(FINER)
    runs: dict[float | None, Simulation] = {}
    with progress_bars(console) as show:
        for accuracy, one in made.items():
            label = "finer" if accuracy is None else f"{100.0 * accuracy:g} %"
            runs[accuracy] = run_state(chip, state, replace(model, accuracy=one), partial(_renamed, show, label))
            show(label, "done", 1.0)
    for run in runs.values():
        if run.figures is None:
            raise InputError(str(options.chip), "band", frequency_text(*model.band),
                             f"a band with a resonance in it ({run.no_resonance})")
    rows = [MeshRow.of(accuracy, run, runs[None]) for accuracy, run in runs.items()]
    title = f"{chip.name}, {state}"
    print_table(f"meshes of {title}", convergence_table(rows))
    error = next(row.error for row in rows if row.accuracy == wanted)
    print_line(f"{'accurate' if error <= wanted else 'NOT accurate'}: Z differs by {100.0 * error:.2g} % rms from the "
               f"finer mesh, {100.0 * wanted:g} % requested")
    if folder is not None:
        write_json(folder / "convergence.json", convergence_record(rows))
        write_convergence_report(title, rows, folder)
    return 0 if error <= wanted else 1


def _renamed(show: Show, label: str, _state: str, activity: str, fraction: float) -> None:
    show(label, activity, fraction)


