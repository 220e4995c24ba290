"""``workbench mesh``."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip, read_chip
from geometry.mesh import elements_per_wavelength
from workbench.commands.asked import Asked, asked_accuracy, asked_model, output_folder
from workbench.commands.states import run_state
from workbench.commands.terminal import Show, print_line, print_table, progress_bars
from workbench.files.errors import InputError
from workbench.model.discretisation import ROWS, discretisation
from workbench.model.problem import build, fill
from workbench.report.page import Block, Picture, TextTable, number_text, write_json, write_report
from workbench.simulation.run import Simulation

Real = NDArray[np.float64]

if TYPE_CHECKING:
    from rich.console import Console

#: The mesh that those of the table are compared with has elements smaller than the finest of them by this factor.
FINER = 1.5


def run_mesh(options: argparse.Namespace, console: Console) -> int:
    """``workbench mesh``: the mesh of a chip, and what the accuracies it can be made for are worth."""
    chip = read_chip(options.chip)
    asked, state = asked_model(options, chip), chip.state(options.state).name
    problem = build(fill(chip, state, asked.registry), band=asked.band, accuracy=asked.accuracy)
    made = discretisation(asked.accuracy)
    speeds = {region: material.slowest_wave_speed() for region, material in problem.materials.items()}
    counts = elements_per_wavelength(problem.mesh, speeds, asked.band[1])
    cells = {region: len(problem.mesh.mesh.subdomains[region]) for region in problem.mesh.section.regions}
    table = TextTable(("region", "cells", "elements per wavelength"), tuple(
        (region, str(count), f"{counts[region]:.1f}" if region in counts else "empty")
        for region, count in cells.items()))
    print_table(f"{chip.name}, {state}: {sum(cells.values())} cells of order {made.order} at "
                f"{asked.band[1] / 1e6:.4g} MHz", table)
    if not options.converge:
        return 0
    return _converge(options, console, chip, state, asked)


def _converge(options: argparse.Namespace, console: Console, chip: Chip, state: str, asked: Asked) -> int:
    """The meshes of every accuracy against one finer than all; whether the one asked for is as accurate as that."""
    wanted = asked_accuracy(options)
    accuracies = sorted({*ROWS, wanted}, reverse=True)
    made = {f"{100.0 * accuracy:g} %": discretisation(accuracy) for accuracy in accuracies}
    made["finer"] = ROWS[min(ROWS)].refined(FINER)
    runs: dict[str, Simulation] = {}
    with progress_bars(console) as show:
        for label, one in made.items():
            runs[label] = run_state(chip, state, replace(asked, accuracy=one), partial(_renamed, show, label))
            show(label, "done", 1.0)
    finest = runs["finer"]
    rows = []
    for run in runs.values():
        if run.figures is None:
            raise InputError(str(options.chip), "band", f"{asked.band[0]:g} to {asked.band[1]:g} Hz",
                             f"a band with a resonance in it ({run.no_resonance})")
        estimated = run.mesh_error.rms if run.mesh_error else math.nan
        rows.append((run.unknowns, run.figures.f0, run.figures.z_min, run.figures.q, estimated,
                     _difference(run, finest)))
    columns = ("accuracy", "unknowns", "f0 (MHz)", "Z_min (ohm)", "Q", "error (%)", "estimate")
    table = TextTable(columns, tuple(
        (label, str(size), f"{f0 / 1e6:.5f}", number_text(z), number_text(q),
         "" if runs[label] is finest else f"{100.0 * error:.4f}", f"{100.0 * estimated:.4f}")
        for label, (size, f0, z, q, estimated, error) in zip(runs, rows, strict=True)))
    print_table(f"meshes of {chip.name}, {state}", table)
    error = dict(zip(accuracies, (row[-1] for row in rows), strict=False))[wanted]
    print_line(f"{'accurate' if error <= wanted else 'NOT accurate'}: Z is {100.0 * error:.2g} % rms off the finer "
               f"mesh, {100.0 * wanted:g} % asked")
    if options.output is not None:
        sizes = np.array([_mean_element(run) for run in runs.values()][:-1])
        _write_convergence(output_folder(options.output), chip, state, accuracies, rows, sizes, table)
    return 0 if error <= wanted else 1


def _difference(run: Simulation, finest: Simulation) -> float:
    """Rms of ln Z of one spectrum against another."""
    if run is finest:
        return 0.0
    ratio = run.spectrum.impedance / finest.spectrum.impedance
    return float(np.sqrt(np.mean(np.abs(np.log(ratio)) ** 2)))


def _mean_element(run: Simulation) -> float:
    """Root of the mean area of an element, metres."""
    section = run.problem.mesh.section
    return math.sqrt(sum(section.area(region) for region in section.regions) / run.problem.mesh.mesh.t.shape[1])


def _renamed(show: Show, label: str, _state: str, activity: str, fraction: float) -> None:
    show(label, activity, fraction)


def _write_convergence(
    folder: Path, chip: Chip, state: str, accuracies: list[float],
    rows: list[tuple[int, float, float, float, float, float]], sizes: Real, table: TextTable
) -> None:
    from workbench.render.plots import draw_convergence

    figures_of = np.array(rows)
    errors = {"f0": np.abs(figures_of[:-1, 1] / figures_of[-1, 1] - 1.0),
              "Z_min": np.abs(figures_of[:-1, 2] / figures_of[-1, 2] - 1.0), "Z, rms": figures_of[:-1, 5],
              "Z, rms, estimated": figures_of[:-1, 4]}
    path = draw_convergence(sizes, errors, folder / "convergence.png",
                            title=f"{chip.name}, {state}: difference from the finest mesh")
    blocks: list[Block] = [table, Picture(path, "difference from the finest mesh against the mean size of the "
                                                "elements, whose order is not the same everywhere")]
    columns = ["accuracy", "unknowns", "f0_hz", "z_min_ohm", "q", "estimated_rms_error", "rms_error"]
    named = [*accuracies, math.nan]
    write_json(folder / "convergence.json", {"columns": columns, "rows": [
        [None if math.isnan(accuracy) else accuracy, *row] for accuracy, row in zip(named, rows, strict=True)]})
    write_report(folder / "report.html", f"{chip.name}, {state}: accuracy of meshes", [("Accuracy", blocks)])
