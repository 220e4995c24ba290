"""``workbench sensitivity``."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geometry.chip import Chip, read_chip
from geometry.names import TRANSDUCER
from workbench.commands.asked import asked_model, output_folder
from workbench.commands.terminal import print_line, print_table, progress_bars
from workbench.files.errors import InputError
from workbench.files.quantities import parse_quantity
from workbench.model.numbers import ParameterName
from workbench.model.problem import Problem, build, fill
from workbench.report.page import Block, Note, Picture, TextTable, number_text, write_json, write_report
from workbench.reproduction.sensitivity import (
    LOSS_THRESHOLD,
    REAL_THRESHOLD,
    TABLE_ONE,
    TABLE_TWO,
    Sensitivity,
    sensitivity,
)

if TYPE_CHECKING:
    from rich.console import Console

#: "Near zero variation" in the caption of Table 2: intervals of the scaling whose middle is this near to one.
NEAR = 0.02


def run_sensitivity(options: argparse.Namespace, console: Console) -> int:
    """``workbench sensitivity``: Algorithm 1 of the paper for the transducer of a chip, beside its Table 2."""
    chip = read_chip(options.chip)
    if options.density is not None:
        chip = _with_density(chip, parse_quantity(options.density, "density", source="command line", field="--density"))
    asked = asked_model(options, chip)
    if options.points < 2:
        raise InputError("command line", "--points", options.points, "two frequencies or more")
    state = chip.state(options.state).name
    problem = build(fill(chip, state, asked.registry), band=asked.band,
                    accuracy=asked.accuracy)
    baseline = _baseline(problem, options.loss)
    folder = output_folder(options.output)
    with progress_bars(console) as show:
        found = sensitivity(
            problem, np.linspace(*asked.band, options.points), baseline=baseline, scalings=options.scalings,
            progress=lambda part, share: show(state, _short(part), share))
        show(state, "done", 1.0)
    table = _ranking_table(found)
    print_table(f"{chip.name}, {problem.materials[TRANSDUCER].name}", table)
    kept = [_short(name) for name in found.kept()]
    print_line(f"kept at {REAL_THRESHOLD:.0%} and {LOSS_THRESHOLD:.0%}: {', '.join(kept)}")
    if found.undetermined:
        console.print(f"zero in the baseline, so nothing can be said of them (--loss gives them one): "
                      f"{', '.join(map(_short, found.undetermined))}", style="yellow", markup=False)
    console.print(f"{found.spectra} spectra in {found.seconds:.1f} s, {found.solves} full solves", markup=False)
    write_json(folder / "sensitivity.json", {
        "chip": chip.name, "chip_file": str(options.chip), "state": state,
        "material": problem.materials[TRANSDUCER].name, "density_kg_m3": problem.materials[TRANSDUCER].density,
        "band_hz": list(asked.band), "points": options.points,
        "scalings": [float(x) for x in found.scalings], "kept": kept, "spectra": found.spectra,
        "full_solves": found.solves, "wall_seconds": found.seconds, "largest_estimated_error": found.error,
        "parameters": [
            {"name": _short(name), "baseline": float(value), "slope": float(slope), "slope_near_one": float(near),
             "gradient": float(local), "published": TABLE_TWO.get(_short(name)), "costs": [float(c) for c in costs]}
            for name, value, slope, near, local, costs in zip(
                found.names, found.baseline, found.normalised(found.slopes()),
                found.normalised(found.slopes(reach=_near(found))), found.normalised(found.local), found.costs,
                strict=True)],
    })
    _write(folder / "report.html", chip, found, table)
    return 0


def _with_density(chip: Chip, density: float) -> Chip:
    return replace(chip, layers=tuple(
        replace(layer, density=density) if layer.region == TRANSDUCER else layer for layer in chip.layers))


def _baseline(problem: Problem, share: float) -> dict[str, complex]:
    """Losses that the material does not state, as a share of the real part."""
    if not 0.0 <= share < 1.0:
        raise InputError("command line", "--loss", share, "a share of the real part, from 0 to below 1")
    material, result = problem.materials[TRANSDUCER].name, {}
    for name in TABLE_ONE:
        parsed = ParameterName.parse(f"{material}.{name}")
        if parsed.is_loss:
            key = parsed.key
            value = complex(problem.values[key])
            if value.imag == 0.0 and share:
                # A permittivity loses with a positive imaginary part, a stiffness with a negative one.
                result[key] = complex(value.real, share * value.real * (1.0 if ".eps" in key else -1.0))
    return result


def _near(found: Sensitivity) -> float:
    """The reach of :data:`NEAR`, or of the two innermost intervals where the scalings are coarser."""
    return max(NEAR, float(np.diff(found.scalings).max()))


def _short(name: str) -> str:
    return ParameterName.parse(name).local


def _ranking_table(found: Sensitivity) -> TextTable:
    """Table 2 with the published slopes beside ours."""
    near = dict(zip(found.names, found.normalised(found.slopes(reach=_near(found))), strict=True))
    local = dict(zip(found.names, found.normalised(found.local), strict=True))
    rows = []
    for rank in found.ranking():
        known = TABLE_TWO.get(_short(rank.name))
        nothing = rank.name in found.undetermined
        rows.append((_short(rank.name), *("zero" if nothing else number_text(x, 3)
                                          for x in (rank.slope, near[rank.name], local[rank.name])),
                     "" if known is None else f"{known:.3f}", "yes" if rank.kept else ""))
    heads = ("parameter", "slope, eq. 30", "near no variation", "exact gradient", "published", "kept")
    return TextTable(heads, tuple(rows))


def _write(path: Path, chip: Chip, found: Sensitivity, table: TextTable) -> None:
    from workbench.render import fits

    kinds = []
    for loss in (False, True):
        kinds.append([(_short(r.name), r.slope, TABLE_TWO.get(_short(r.name))) for r in found.ranking()
                      if ParameterName.parse(r.name).is_loss == loss and r.name not in found.undetermined])
    blocks: list[Block] = []
    if found.undetermined:
        blocks.append(Note(f"Zero in the baseline, so that no scaling moves them: "
                           f"{', '.join(map(_short, found.undetermined))}."))
    blocks += [
        table,
        "Slopes over the largest of the real and of the imaginary parts. Eq. 30 takes the steepest of all scalings, "
        "the caption of Table 2 those near no variation; the gradient is the norm over the band of d ln|Z| by the "
        "relative change of a part, exactly.",
        Picture(fits.draw_sensitivity(kinds[0], kinds[1], path.parent / "ranking.png",
                                      thresholds=(REAL_THRESHOLD, LOSS_THRESHOLD), title=chip.name),
                "ranking, with what Table 2 of the paper prints"),
    ]
    for loss, label in ((False, "real parts"), (True, "imaginary parts")):
        costs = {_short(name): row for name, row in zip(found.names, found.costs, strict=True)
                 if ParameterName.parse(name).is_loss == loss and name not in found.undetermined}
        if costs:
            file = path.parent / f"costs_{'imaginary' if loss else 'real'}.png"
            blocks.append(Picture(fits.draw_costs(found.scalings, costs, file, title=label), f"costs of the {label}"))
    effort = TextTable(("spectra", "full solves", "wall time (s)", "largest estimated error of Z"), (
        (str(found.spectra), str(found.solves), f"{found.seconds:.1f}", f"{found.error:.1e}"),))
    write_report(path, f"{chip.name}: what the spectrum depends on", [("Ranking", blocks), ("Effort", [effort])])
