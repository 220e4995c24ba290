"""``workbench mesh``."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geometry.chip import Chip, read_chip
from geometry.mesh import elements_per_wavelength, user_cache
from inputs import InputError
from workbench.commands.asked import Asked, asked_band, asked_model, output_folder
from workbench.commands.states import run_state
from workbench.commands.terminal import Show, print_line, print_table, progress_bars
from workbench.problem import build, mesh_speeds
from workbench.report import Block, Picture, Table, number, write_json, write_report
from workbench.simulate import state_name

if TYPE_CHECKING:
    from rich.console import Console


def run(options: argparse.Namespace, console: Console) -> int:
    """``workbench mesh``: the mesh of a chip, and the paper's refinement study."""
    chip = read_chip(options.chip)
    asked, state, band = asked_model(options, chip), state_name(chip, options.state), asked_band(options, chip)
    if options.converge and options.refinements < 2:
        raise InputError("command line", "--refinements", options.refinements, "at least 2 meshes to compare")
    if options.converge and not options.limit > 0.0:
        raise InputError("command line", "--limit", options.limit, "a change in per cent above zero")
    problem = build(chip, state, asked.registry, band=band, elements_per_wavelength=asked.elements_per_wavelength,
                    cache=user_cache())
    speeds = {r: c for r, c in mesh_speeds(problem.mesh.section.regions, problem.materials).items() if math.isfinite(c)}
    counts = elements_per_wavelength(problem.mesh, speeds, band[1])
    cells = {region: len(problem.mesh.mesh.subdomains[region]) for region in problem.mesh.section.regions}
    table = Table(("region", "cells", "elements per wavelength"), tuple(
        (region, str(count), f"{counts[region]:.1f}" if region in counts else "empty")
        for region, count in cells.items()))
    print_table(f"{chip.name}, {state}: {sum(cells.values())} cells at {band[1] / 1e6:.4g} MHz", table)
    if not options.converge:
        return 0
    return _converge(options, console, chip, state, asked)


def _converge(options: argparse.Namespace, console: Console, chip: Chip, state: str, asked: Asked) -> int:
    """Refine by sqrt(2) until f0 and Z_min change by less than the limit (Acevedo-Espinosa et al. (RP-UEIS), 3.2)."""
    rows: list[tuple[float, int, float, float, float]] = []
    status = 1
    with progress_bars(console) as show:
        for step in range(options.refinements):
            finer = replace(asked, elements_per_wavelength=asked.elements_per_wavelength * math.sqrt(2.0) ** step)
            label = f"mesh {step + 1}"
            run = run_state(chip, state, finer, partial(_renamed, show, label))
            show(label, "done", 1.0)
            if run.figures is None:
                raise InputError(str(options.chip), "band", f"{asked.band[0]:g} to {asked.band[1]:g} Hz",
                                 f"a band with a resonance in it ({run.no_resonance})")
            merit = run.figures
            rows.append((finer.elements_per_wavelength, run.unknowns, merit.f0, merit.z_min, merit.q))
            if len(rows) > 1:
                last, now = rows[-2], rows[-1]
                change = 100.0 * max(abs(now[2] / last[2] - 1.0), abs(now[3] / last[3] - 1.0))
                if change < options.limit:
                    status = 0
                    break
    columns = ("elements per wavelength", "unknowns", "f0 (MHz)", "change (%)", "Z_min (ohm)", "change (%)", "Q")
    table = Table(columns, tuple(
        (f"{n:.1f}", str(size), f"{f0 / 1e6:.5f}", f"{100 * (f0 / rows[k - 1][2] - 1):+.4f}" if k else "",
         number(z), f"{100 * (z / rows[k - 1][3] - 1):+.3f}" if k else "", number(q))
        for k, (n, size, f0, z, q) in enumerate(rows)))
    print_table(f"refinement of {chip.name}, {state}", table)
    print_line(f"{'converged' if status == 0 else 'NOT converged'}: limit {options.limit:g} % in f0 and Z_min")
    if options.output is not None:
        _write_convergence(output_folder(options.output), chip, state, rows, table)
    return status


def _renamed(show: Show, label: str, _state: str, activity: str, fraction: float) -> None:
    show(label, activity, fraction)


def _write_convergence(
    folder: Path, chip: Chip, state: str, rows: list[tuple[float, int, float, float, float]], table: Table
) -> None:
    from workbench.render.plots import draw_convergence

    blocks: list[Block] = [table]
    if len(rows) > 1:
        figures_of = np.array(rows)
        errors = {"f0": np.abs(figures_of[:-1, 2] / figures_of[-1, 2] - 1.0),
                  "Z_min": np.abs(figures_of[:-1, 3] / figures_of[-1, 3] - 1.0)}
        path = draw_convergence(1.0 / figures_of[:-1, 0], errors, folder / "convergence.png",
                                title=f"{chip.name}, {state}: difference from the finest mesh")
        blocks.append(Picture(path, "element size in wavelengths against the difference from the finest mesh"))
    columns = ["elements_per_wavelength", "unknowns", "f0_hz", "z_min_ohm", "q"]
    write_json(folder / "convergence.json", {"columns": columns, "rows": [list(row) for row in rows]})
    write_report(folder / "report.html", f"{chip.name}, {state}: mesh refinement", [("Refinement", blocks)])
