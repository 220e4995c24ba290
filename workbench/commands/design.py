"""``workbench design``."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING

from geometry.chip_file import write_chip
from materials.registry import user_registry
from workbench.commands.export import solid_names
from workbench.commands.parsed_options import accuracy_option, executor_option, output_folder
from workbench.commands.states import field_files
from workbench.commands.terminal import by_rows, print_line, print_table, progress_bars, say_finding
from workbench.design.goal import read_goal
from workbench.design.modelling import ChipSolver
from workbench.design.optimisation import Design, optimise
from workbench.files.ownership import Outputs, discard
from workbench.files.writing import write_json
from workbench.model.problem import fill
from workbench.report.design import (
    active_table,
    before_after_table,
    design_record,
    draw_design,
    front_table,
    lengths_table,
    summary_lines,
    write_design_report,
)

if TYPE_CHECKING:
    from rich.console import Console

#: Files of the best chip by the model, during the search, and of the final one.
SO_FAR, BEST = "best_so_far.toml", "best.toml"


def run_design(options: argparse.Namespace, console: Console) -> int:
    """``workbench design``: the best chip for a goal, with CAD and report."""
    registry = replace(user_registry(options.materials, inviscid=options.inviscid), assumed_losses=True)
    accuracy = accuracy_option(options)
    goal = read_goal(options.goal, registry=registry)
    for text in fill(goal.chip, goal.state, registry).findings:
        say_finding(text, console)
    folder = output_folder(options, Outputs("design", names=(
        SO_FAR, BEST, "front/*.toml", "design.json", "report.html", "impedance.png", "convergence.png", "front.png",
        "cad.png", *solid_names(goal.chip), *(f"{folder}*-{12 * '?'}.py" for folder in ("", "front/")),
        *(f"{label}/{name}" for label in ("before", "after") for name in field_files(goal.state)))),
        inputs=[goal.chip.file])
    so_far = folder / SO_FAR
    with executor_option(options) as (executor, jobs), progress_bars(console) as show:
        found = optimise(goal, registry=registry, accuracy=accuracy, jobs=jobs, executor=executor,
                         progress=by_rows(show), keep=lambda chip, _point: write_chip(chip, so_far))
        if found.best is not None:
            write_chip(found.best.chip, folder / BEST)
        for index, member in enumerate(found.front):
            write_chip(member.chip, folder / "front" / f"{index + 1:02d}.toml")
        discard(so_far)
        write_json(folder / "design.json", design_record(found))
        show("report", "pictures", 0.0)
        pictures = draw_design(found, ChipSolver(goal, registry, accuracy), folder, with_cad=not options.no_cad)
        show("report", "done", 1.0)
    write_design_report(found, pictures, folder)
    _print_results(found)
    return 0 if found.best is not None else 1




def _print_results(found: Design) -> None:
    print_table(found.goal.chip.name, before_after_table(found))
    if found.best is not None:
        print_table("", lengths_table(found, found.best))
        if found.best.candidate.active:
            print_table("", active_table(found.best.candidate, found.goal.objectives[0]))
    if found.front:
        print_table(f"of {len(found.front)} chips between the objectives", front_table(found, confirmed_only=True))
    for line in summary_lines(found):
        print_line(line)
