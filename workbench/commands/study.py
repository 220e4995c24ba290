"""``workbench study``."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from workbench.commands.parsed_options import executor_option, output_folder
from workbench.commands.terminal import by_rows, print_table, progress_bars, say_finding
from workbench.design.plan import read_study
from workbench.design.study import study
from workbench.design.study_folder import study_outputs
from workbench.model.problem import fill
from workbench.report.study import confirmed_table, draw_study, statistics_table, write_study_report

if TYPE_CHECKING:
    from rich.console import Console


def run_study(options: argparse.Namespace, console: Console) -> int:
    """``workbench study``: every point of a study, with pictures and report."""
    plan = read_study(options.study, materials=options.materials, inviscid=options.inviscid)
    folder = output_folder(options, study_outputs(plan, options.output), inputs=[plan.chip.file])
    for text in dict.fromkeys(text for state in plan.states for text in fill(plan.chip, state, plan.registry).findings):
        say_finding(text, console)
    console.print(f"{plan.size} points over {', '.join(axis.name for axis in plan.axes)}", markup=False)
    with executor_option(options) as (executor, jobs), progress_bars(console) as show:
        found = study(plan, options.run_folder, jobs=jobs, executor=executor, overwrite=options.overwrite,
                      progress=by_rows(show))
        show("report", "pictures", 0.0)
        pictures = draw_study(found, folder)
        show("report", "done", 1.0)
    write_study_report(found, pictures, folder)
    print_table(plan.name, statistics_table(found))
    if found.confirmations:
        print_table("by full solves", confirmed_table(found))
    for each in found.statistics:
        if each.count < each.points:
            console.print(f"{each.figure}, {each.state}: missing at {each.points - each.count} of {each.points} "
                          "points; the table gives the reasons", style="yellow", markup=False)
    return 0
