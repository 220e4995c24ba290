"""``workbench study``."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from workbench.commands.asked import output_folder
from workbench.commands.study_tables import confirmed_table, extremes_table, missing_table, statistics_table
from workbench.commands.terminal import print_table, progress_bars, say_finding
from workbench.design.figures import figure_named
from workbench.design.plan import read_study
from workbench.design.study import study
from workbench.design.study_result import STATE, StudyResult
from workbench.design.variables import VariedNumber
from workbench.files.errors import InputError
from workbench.files.quantities import shown_factor, shown_unit
from workbench.model.problem import fill
from workbench.report.page import Block, Note, Picture, TextTable, write_report

if TYPE_CHECKING:
    from rich.console import Console

    from workbench.render.studies import StudyColumn


def run_study(options: argparse.Namespace, console: Console) -> int:
    """``workbench study``: every point of a study, its table, its pictures, and the report."""
    if options.jobs is not None and options.jobs < 1:
        raise InputError("command line", "--jobs", options.jobs, "one or more")
    plan = read_study(options.study, materials=options.materials)
    folder = output_folder(options.output)
    for text in dict.fromkeys(text for state in plan.states for text in fill(plan.chip, state, plan.registry).findings):
        say_finding(text, console)
    console.print(f"{plan.size} points over {', '.join(axis.name for axis in plan.axes)}", markup=False)
    with _executor(options.dask) as (executor, threads), progress_bars(console) as show:
        found = study(plan, folder, jobs=options.jobs or threads, executor=executor, overwrite=options.overwrite,
                      progress=show)
        show("report", "pictures", 0.0)
        pictures = draw(found, folder)
        show("report", "done", 1.0)
    _report(found, pictures, folder)
    print_table(plan.name, statistics_table(found))
    if found.confirmations:
        print_table("by full solves", confirmed_table(found))
    for each in found.statistics:
        if each.count < each.points:
            console.print(f"{each.figure}, {each.state}: missing at {each.points - each.count} of {each.points} "
                          "points; the table says why", style="yellow", markup=False)
    return 0


@contextmanager
def _executor(address: str | None) -> Iterator[tuple[Executor | None, int | None]]:
    """What the points are worked out by, and how many of them at a time; None leaves both to the study."""
    if address is None:
        yield None, None
        return
    from workbench.design.executors import dask_cluster

    with dask_cluster(address) as found:
        yield found


def draw(found: StudyResult, folder: Path) -> list[Picture]:
    """Pictures of every state: parallel coordinates, and every figure over what varies."""
    from workbench.render.studies import MOST_IN_PAIRS, MOST_LINES, draw_maps, draw_parallel, draw_slices, most_telling

    pictures: list[Picture] = []
    for state in found.study.states:
        parameters, figures = study_columns(found, state)
        known = [column for column in figures if np.isfinite(column.values).any()]
        if known:
            path = draw_parallel([*parameters, *known], known[0], folder / f"parallel_{state}.png", title=state)
            thinned = f", {MOST_LINES} of them" if len(found.study.sample) > MOST_LINES else ""
            pictures.append(Picture(path, f"{state}: every point a line{thinned}"))
        for name, column in zip(found.study.figures, figures, strict=True):
            if not np.isfinite(column.values).any():
                continue
            path = draw_slices(parameters, column, folder / f"slices_{state}_{name}.png", title=f"{name}, {state}")
            pictures.append(Picture(path, f"{state}: {name} over each parameter; line and band are the median and the "
                                    "range of 5 to 95 % over all others"))
            chosen = most_telling(parameters, column)
            if len(chosen) > 1:
                path = draw_maps(chosen, column, folder / f"maps_{state}_{name}.png", title=f"{name}, {state}")
                which = f", the {MOST_IN_PAIRS} it follows most" if len(chosen) < len(parameters) else ""
                pictures.append(Picture(path, f"{state}: {name} over pairs of parameters{which}, mean over all others"))
    return pictures


def study_columns(found: StudyResult, state: str) -> tuple[list[StudyColumn], list[StudyColumn]]:
    """What varies, and the figures, at the points of one state in the units they are shown in."""
    from workbench.render.studies import StudyColumn

    plan, there = found.study, found.columns[STATE] == state
    parameters = [
        StudyColumn(_label(axis.name, shown_unit(axis.unit)), plan.sample[:, at] * shown_factor(axis.unit))
        if isinstance(axis, VariedNumber) else StudyColumn(axis.name, plan.sample[:, at], axis.materials)
        for at, axis in enumerate(plan.axes)]
    figures = [StudyColumn(_label(name, figure_named(name).shown),
                           found.columns[name][there] / figure_named(name).factor)
               for name in plan.figures]
    return parameters, figures


def _label(name: str, unit: str) -> str:
    return f"{name} ({unit})" if unit else name


def _report(found: StudyResult, pictures: list[Picture], folder: Path) -> None:
    plan = found.study
    missing = missing_table(found)
    words = TextTable(("figure", "meaning"), tuple((name, figure_named(name).words) for name in plan.figures))
    asked: list[Block] = [
        f"{plan.size} points of {plan.chip.name} ({plan.sampling.method}), driven by {plan.operation.drive}.", words]
    confirmed: list[Block] = ["Points solved in full, on a mesh of their own, against the reduced model:",
                              confirmed_table(found)]
    if not found.confirmations:
        confirmed = [Note("No point was solved in full.")]
    write_report(folder / "report.html", plan.name, [
        ("Figures", [*asked, statistics_table(found), *([missing] if missing else [])]),
        ("Extremes", [extremes_table(found)]),
        ("Full solves", confirmed),
        ("Pictures", list(pictures)),
        ("Files", ["study.parquet and study.nc hold the table (SI units), study.json what was asked and the rest."]),
    ])
