"""``workbench design``."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geometry.chip import Chip
from geometry.chip_file import write_chip
from materials.registry import user_registry
from workbench.commands.asked import asked_accuracy, asked_jobs, output_folder
from workbench.commands.terminal import print_line, print_table, progress_bars, say_finding
from workbench.design.candidate import Confirmed, RoundedDesign
from workbench.design.design_report import (
    active_table,
    before_after_table,
    choices_table,
    design_record,
    front_table,
    lengths_table,
    models_table,
    optima_table,
    programme_figure,
    reported_figure,
    starts_text,
    summary_lines,
)
from workbench.design.goal import DesignObjective, read_goal
from workbench.design.modelling import ChipSolver
from workbench.design.optimisation import Design, optimise
from workbench.design.programme import KEPT
from workbench.model.problem import fill
from workbench.report.page import Block, Note, Picture, write_json, write_report

if TYPE_CHECKING:
    from rich.console import Console

#: The chip on the model, while the search goes on; ``best.toml`` takes its place.
SO_FAR = "best_so_far.toml"


def run_design(options: argparse.Namespace, console: Console) -> int:
    """``workbench design``: the best chip for a goal, its file, its CAD, its pictures, and the report."""
    jobs = asked_jobs(options)
    registry, accuracy = replace(user_registry(options.materials), assumed_losses=True), asked_accuracy(options)
    goal = read_goal(options.goal, registry=registry)
    for text in fill(goal.chip, goal.state, registry).findings:
        say_finding(text, console)
    folder = output_folder(options.output)
    so_far, best_file = folder / SO_FAR, folder / "best.toml"
    # Or the chip of an earlier run would pass for this one's.
    best_file.unlink(missing_ok=True)
    with progress_bars(console) as show:
        found = optimise(goal, registry=registry, accuracy=accuracy, jobs=jobs, report=show,
                         keep=lambda chip, _point: _keep(chip, so_far))
        if found.best is not None:
            write_chip(found.best.chip, best_file)
        for index, member in enumerate(found.front):
            write_chip(member.chip, folder / "front" / f"{index + 1:02d}.toml")
        so_far.unlink(missing_ok=True)
        write_json(folder / "design.json", design_record(found))
        show("report", "pictures", 0.0)
        pictures = _pictures(found, ChipSolver(goal, registry, accuracy), folder, with_cad=not options.no_cad)
        show("report", "done", 1.0)
    _report(found, pictures, folder)
    _tell(found)
    return 0 if found.best is not None else 1


def _keep(chip: Chip, path: Path) -> None:
    write_chip(chip, path)


def _pictures(found: Design, solver: ChipSolver, folder: Path, *, with_cad: bool) -> dict[str, list[Picture]]:
    """Pictures by section; the solids of the best chip are written on the way."""
    from workbench.render.plots import draw_spectra

    pictures: dict[str, list[Picture]] = {"spectra": [], "fields": [], "search": [], "front": [], "solids": []}
    if found.best is not None:
        spectra = {"before": solver.spectrum(found.goal.chip), "after": solver.spectrum(found.best.chip)}
        path = draw_spectra(spectra, folder / "impedance.png", title=found.goal.chip.name)
        pictures["spectra"].append(Picture(path, "impedance before and after"))
        for label, chip, evaluation in (("before", found.goal.chip, found.before),
                                        ("after", found.best.chip, found.best.after)):
            pictures["fields"] += _fields(label, chip, evaluation.frequency, solver, folder)
        if with_cad:
            pictures["solids"].append(_solids(found.best.chip, folder))
    if found.chosen.attempts:
        pictures["search"].append(_convergence(found, folder))
    if found.front:
        pictures["front"].append(_front(found, folder))
    return pictures


def _fields(label: str, chip: Chip, frequency: float, solver: ChipSolver, folder: Path) -> list[Picture]:
    """The potential of the particles in the cavity, or else the pressure there, at the frequency of the chip's figures.

    None without a fluid in it, or without a frequency.
    """
    from workbench.render.gallery import draw_state

    shot = solver.snapshot(chip, frequency) if math.isfinite(frequency) else None
    if shot is None:
        return []
    drawn = draw_state(shot, folder / label, only=("pressure",) if shot.traps is None else ("gorkov",))
    return [Picture(drawn[0].path, f"{label}, {drawn[0].caption}")]


def _solids(chip: Chip, folder: Path) -> Picture:
    from geometry.export import export_step, export_stl
    from workbench.render.gallery import draw_chip

    export_step(chip, folder / "chip.step")
    return draw_chip(chip, export_stl(chip, folder), folder / "cad.png")


def _convergence(found: Design, folder: Path) -> Picture:
    from workbench.render.designs import Course, draw_descents

    objective, chosen = found.goal.objectives[0], found.chosen
    factor = reported_figure(objective.figure).factor
    courses = []
    for attempt in chosen.attempts:
        path = np.array(attempt.best.path)
        values = np.exp(-path[:, 0] if objective.maximise else path[:, 0]) / factor
        number = next((k for k, one in enumerate(chosen.optima) if attempt.number in one.starts), len(chosen.optima))
        courses.append(Course(np.where(path[:, 1] <= KEPT, values, np.nan), number))
    drawn = draw_descents(courses, folder / "convergence.png", label=_label(objective), maximise=objective.maximise,
                          title=starts_text(chosen))
    return Picture(drawn, "the best descent of every start: the best chip so far that keeps all constraints")


def _front(found: Design, folder: Path) -> Picture:
    from workbench.render.designs import draw_front

    objectives = found.goal.objectives
    factors = np.array([reported_figure(each.figure).factor for each in objectives])

    def figures(each: Confirmed | RoundedDesign) -> list[float]:
        candidate = each.candidate if isinstance(each, Confirmed) else each
        return [programme_figure(o, v) for o, v in zip(objectives, candidate.objectives, strict=True)]

    confirmed = [[each.after.figures[o.figure] for o in objectives] for each in found.front
                 if isinstance(each, Confirmed)]
    present = np.array([found.before.figures[each.figure] for each in objectives])
    path = draw_front(np.array([figures(each) for each in found.front]) / factors, np.array(confirmed) / factors,
                      present / factors, folder / "front.png", labels=(_label(objectives[0]), _label(objectives[1])),
                      title=found.goal.chip.name)
    return Picture(path, "chips of which none is better in both")


def _label(objective: DesignObjective) -> str:
    shown = reported_figure(objective.figure).shown
    return f"{objective.figure} ({shown})" if shown else objective.figure


def _report(found: Design, pictures: dict[str, list[Picture]], folder: Path) -> None:
    goal, chosen, best = found.goal, found.chosen, found.best
    objectives = " and ".join(str(each) for each in goal.objectives)
    outcome: list[Block] = [f"Asked for: {objectives} at {goal.operation.drive}, state {goal.state}."]
    outcome += [Note(line) if found.best is None else line for line in summary_lines(found)]
    outcome += [Note(each.statement) for each in found.rejected]
    outcome.append(before_after_table(found))
    if best is not None:
        outcome.append(lengths_table(found, best))
    outcome += [*pictures["spectra"], *pictures["fields"]]
    sections: list[tuple[str, list[Block]]] = [("Before and after", outcome)]
    if best is not None and best.candidate.optimum is not None:
        held = active_table(best.candidate, goal.objectives[0])
        sections.append(("What holds the optimum", [
            "At the optimum between the steps that lengths come in; by the multipliers of the bounds, to first order.",
            held if held.rows else "Nothing: it lies within all bounds."]))
    if found.front:
        sections.append(("Between the objectives", [*pictures["front"], front_table(found)]))
    if chosen.optima:
        sections.append(("Starts and runners-up", [starts_text(chosen) + ".", *pictures["search"],
                                                   optima_table(found, chosen)]))
    if len(found.searched) > 1:
        sections.append(("Stock and materials", [choices_table(found)]))
    sections += [("The chip", list(pictures["solids"])), ("The models", [models_table(found)])]
    write_report(folder / "report.html", f"Design: {goal.chip.name}", [each for each in sections if each[1]])


def _tell(found: Design) -> None:
    print_table(found.goal.chip.name, before_after_table(found))
    if found.best is not None:
        print_table("", lengths_table(found, found.best))
        if found.best.candidate.active:
            print_table("", active_table(found.best.candidate, found.goal.objectives[0]))
    if found.front:
        print_table(f"of {len(found.front)} chips between the objectives", front_table(found, confirmed_only=True))
    for line in summary_lines(found):
        print_line(line)
