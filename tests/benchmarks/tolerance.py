"""Sensitivities against differences of full solves, and the yield on the range model against full solves of the same
samples.

    .venv/bin/python tests/benchmarks/tolerance.py [--chip printed|reference] [--samples 200] [--seed 0]
                                                   [--accuracy 5e-3] [--only sensitivities|yield]

A small chip as it comes from a printer, filled, with beads of 10 um and tolerances in its file; or the filled reference
chip with the same tolerances, whose full solves take five times as long. Sensitivities are compared with central
differences of fourth order of full solves at displaced numbers, on one mesh that lengths stretch: between meshes of
their own, figures jump by some 1e-7, and differences over a small step by far more. Every sample of the yield is solved
in full on a mesh of its own, and the two yields are compared sample by sample. Prints both with their intervals.
"""

from __future__ import annotations

import argparse
import sys
import time
import tomllib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import Measurements, measurements, with_json  # noqa: E402

from geometry.chip import Chip, parse_chip, read_chip  # noqa: E402
from workbench.design.evaluation import Evaluation, Operation  # noqa: E402
from workbench.design.input_uncertainty import numbers_of  # noqa: E402
from workbench.design.model import _evaluated, full_evaluation  # noqa: E402
from workbench.design.tolerance import Tolerance, tolerance  # noqa: E402
from workbench.design.yields import passed_share  # noqa: E402
from workbench.model.dimensions import parametrised  # noqa: E402
from workbench.model.numbers import ParameterName, placed  # noqa: E402
from workbench.model.problem import build, fill  # noqa: E402

PRINTED = """
[chip]
name = "printed chip"
band = ["0.98 MHz", "1.12 MHz"]

[[layers]]
role = "transducer"
material = "pzt4/acevedo_2026_fitted"
thickness = { value = "2 mm", tolerance = "10 um" }
radius = "5 mm"

[[layers]]
role = "substrate"
material = "pmma"
thickness = { value = "1 mm", tolerance = "20 um" }
radius = "5 mm"

[[layers]]
role = "sidewall"
material = "pmma"
thickness = { value = "0.72 mm", tolerance = "20 um" }
radius = "5 mm"
cavity_radius = { value = "2.5 mm", tolerance = "50 um" }

[[layers]]
role = "superstrate"
material = "soda_lime_glass"
thickness = { value = "1 mm", tolerance = "20 um" }
radius = "5 mm"

[states.filled]
cavity = "water"
temperature = "25 degC"
particle = "polystyrene"
particle_radius = "5 um"
"""
STATE = "filled"


@dataclass(frozen=True)
class Case:
    """A chip, what is uncertain of it beyond its file, what is required, and the numbers whose sensitivities are
    compared: lengths of every kind, and numbers of every kind of material."""

    chip: Chip
    uncertain: tuple[str, ...]
    required: tuple[str, ...]
    figures: tuple[str, ...]
    compared: tuple[str, ...]


CASES = {
    "printed": lambda: Case(
        parse_chip(tomllib.loads(PRINTED), source="printed"),
        ("pmma.shear_modulus = 2 %", "pmma.shear_modulus.loss = 20 %"),
        ("f0 within 8 kHz", "q >= 60", "e_ac >= 12 J/m^3 at 10 Vpp", "trap_offset within 10 um of 0 um"),
        ("f0", "z_min", "q", "e_ac", "trap_offset", "trap_depth"),
        ("transducer.thickness", "substrate.thickness", "sidewall.thickness", "superstrate.thickness", "cavity.radius",
         "pmma/acevedo_2026.shear_modulus", "pmma/acevedo_2026.shear_modulus.loss", "pzt4/acevedo_2026_fitted.c33",
         "water/iapws_2011.sound_speed")),
    "reference": lambda: Case(
        read_chip(ROOT / "geometry" / "chips" / "reference_chip.toml"),
        ("substrate.thickness = 20 um", "sidewall.thickness = 20 um", "superstrate.thickness = 20 um",
         "couplant.thickness = 5 um", "cavity.radius = 50 um", "pla.shear_modulus = 3 %"),
        ("f0 within 3 kHz", "q >= 135", "e_ac >= 1450 J/m^3 at 10 Vpp"), ("f0", "z_min", "q", "e_ac"),
        ("substrate.thickness", "sidewall.thickness", "superstrate.thickness", "couplant.thickness", "cavity.radius",
         "pla/acevedo_2026.shear_modulus", "pla/acevedo_2026.shear_modulus.loss", "pzt4/acevedo_2026_fitted.c33",
         "water/iapws_2011.sound_speed")),
}
#: Step of the differences, relative: their truncation is of its fourth power.
STEP = 5e-4
#: Central differences of fourth order: displacement in steps and weight.
STENCIL = {-2.0: 1.0 / 12.0, -1.0: -8.0 / 12.0, 1.0: 8.0 / 12.0, 2.0: -1.0 / 12.0}


def evaluated(case: Case, values: Mapping[str, float], accuracy: float, *, gradient: bool = False) -> Evaluation:
    return full_evaluation(case.chip, STATE, values, figures=case.figures, accuracy=accuracy, gradient=gradient)


def compare_sensitivities(case: Case, accuracy: float, kept: Measurements) -> None:
    device = fill(case.chip, STATE)
    known = numbers_of(device)
    values = {name: known[name] for name in case.compared}
    radii = [name for name in case.compared if ParameterName.parse(name).is_radius]
    problem = parametrised(build(device, accuracy=accuracy), case.chip, radii)

    def solved(numbers: Mapping[str, float]) -> Evaluation:
        # What `full_evaluation` does once its mesh is made, which here stays; gradients make it follow the lengths.
        there = replace(problem, values=placed(problem.values, numbers))
        return _evaluated(device, there, numbers, case.figures, Operation(), None, 161, True)

    exact = evaluated(case, values, accuracy, gradient=True)
    assert exact.gradient is not None
    worst = 0.0
    for index, (name, number) in enumerate(values.items()):
        step = STEP * abs(number)
        moved = {k: solved({**values, name: number + k * step}) for k in STENCIL}
        for figure in case.figures:
            slope = sum(weight * moved[k].figures[figure] for k, weight in STENCIL.items()) / step
            # The figure's own scale: its change with the number, or the figure over the number where that is more.
            scale = max(abs(slope), abs(exact.figures[figure] / number))
            off = abs(exact.gradient[figure][index] - slope) / scale
            worst = max(worst, off)
            print(f"{figure:11s} by {name:36s} exact {exact.gradient[figure][index]:+.7e}, differences {slope:+.7e}, "
                  f"off by {off:.1e}", flush=True)
    kept.add("sensitivities off from differences", worst, "1")
    print(f"sensitivities and differences of full solves differ by {worst:.1e} at most, of the figure's own scale")


def compare_yields(case: Case, arguments: argparse.Namespace, kept: Measurements) -> None:
    started = time.perf_counter()
    found = tolerance(case.chip, STATE, case.required, uncertainty=case.uncertain, samples=arguments.samples,
                      accuracy=arguments.accuracy, figures=case.figures, seed=arguments.seed)
    assert found.yields is not None
    assert found.outcomes is not None
    assert found.model is not None
    print(f"model and {arguments.samples} samples: {time.perf_counter() - started:.0f} s, rank {found.model.rank}, "
          f"off by {100.0 * found.model.error:.2g} %", flush=True)
    started = time.perf_counter()
    solved = []
    for number, point in enumerate(found.outcomes.points, 1):
        figures = evaluated(case, found.uncertainty.values(point), arguments.accuracy).figures
        solved.append([figures[name] for name in case.figures])
        if number % 20 == 0:
            print(f"{number} full evaluations, {time.perf_counter() - started:.0f} s", flush=True)
    full = dict(zip(case.figures, np.array(solved).T, strict=True))
    for name in case.figures:
        # Of a trap's offset, which may be zero, in units of its spread.
        scale = np.nanstd(full[name]) if name == "trap_offset" else np.abs(full[name])
        off = np.abs(found.outcomes.column(name) - full[name]) / scale
        kept.add(f"{name} off, largest", float(np.nanmax(off)), "1")
        print(f"{name}: the model is off by {np.nanmedian(off):.1e} (median), {np.nanmax(off):.1e} at most")
    tell_yields(found, full, kept)


def tell_yields(found: Tolerance, full: Mapping[str, NDArray[np.float64]], kept: Measurements) -> None:
    assert found.yields is not None
    assert found.outcomes is not None
    met = [np.array([each.met(values[each.label]) for each in found.bounds])
           for values in ({name: found.outcomes.column(name) for name in full}, full)]
    rows = [*zip(found.yields.each, *met, strict=True), (found.yields.together, *(each.all(axis=0) for each in met))]
    for each, by_model, by_full in rows:
        exact = passed_share(by_full)
        inside = each.sampled.low <= exact.value <= each.sampled.high
        print(f"{each.name}: model {each.sampled}, full solves {exact}, {int((by_model != by_full).sum())} samples "
              f"differ, {'within' if inside else 'OUTSIDE'} the interval; linear {100.0 * each.linear:.1f} %")
        kept.add(f"yield, {each.name}, model", each.sampled.value, "1")
        kept.add(f"yield, {each.name}, full solves", exact.value, "1")
        kept.add(f"yield, {each.name}, linear", each.linear, "1")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chip", choices=tuple(CASES), default="printed")
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--accuracy", type=float, default=5e-3)
    parser.add_argument("--only", choices=("sensitivities", "yield"))
    with_json(parser)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    case = CASES[arguments.chip]()
    with measurements(arguments.json) as kept:
        if arguments.only != "yield":
            compare_sensitivities(case, arguments.accuracy, kept)
        if arguments.only != "sensitivities":
            compare_yields(case, arguments, kept)


if __name__ == "__main__":
    main()
