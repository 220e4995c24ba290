"""Sensitivities against differences of full solves, and the yield on the range model against full solves of the same
samples.

    .venv/bin/python tests/benchmarks/tolerance.py [--samples 200] [--seed 0] [--accuracy 5e-3]
                                                   [--only sensitivities|yield]

The filled reference chip as it comes from a printer: thicknesses of substrate, sidewall and lid within 20 um, that of
the gel within 5 um, the cavity's radius within 50 um, PLA's shear modulus known to 3 %. Sensitivities are compared with
central differences of fourth order of `full_evaluation` at displaced numbers, each on a mesh of its own: cells stay the
same in number for so small a step, so that the meshes are one mesh stretched. Every sample of the yield is solved in
full on its own mesh too, and the two yields are compared sample by sample. Prints both with their intervals.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import Measurements, measurements, with_json  # noqa: E402

from geometry.chip import read_chip  # noqa: E402
from workbench.design.evaluation import Evaluation  # noqa: E402
from workbench.design.model import full_evaluation  # noqa: E402
from workbench.design.stated import numbers_of  # noqa: E402
from workbench.design.tolerance import Tolerance, tolerance  # noqa: E402
from workbench.design.yields import share  # noqa: E402
from workbench.problem import fill  # noqa: E402

CHIP = ROOT / "geometry" / "chips" / "reference_chip.toml"
STATE = "filled"
UNCERTAIN = ("substrate.thickness = 20 um", "sidewall.thickness = 20 um", "superstrate.thickness = 20 um",
             "couplant.thickness = 5 um", "cavity.radius = 50 um", "pla.shear_modulus = 3 %", "water.density = exact",
             "water.sound_speed = exact")
REQUIRED = ("f0 within 3 kHz", "q >= 135", "e_ac >= 1450 J/m^3 at 10 Vpp")
FIGURES = ("f0", "z_min", "q", "e_ac")
#: What sensitivities are compared for: lengths of every kind, and numbers of every kind of material.
COMPARED = ("substrate.thickness", "sidewall.thickness", "superstrate.thickness", "couplant.thickness", "cavity.radius",
            "pla/acevedo_2026.shear_modulus", "pla/acevedo_2026.shear_modulus.loss", "pzt4/acevedo_2026_fitted.c33",
            "water/iapws_2011.sound_speed")
#: Step of the differences, relative: their truncation is of its fourth power.
STEP = 5e-4
#: Central differences of fourth order: displacement in steps and weight.
STENCIL = {-2.0: 1.0 / 12.0, -1.0: -8.0 / 12.0, 1.0: 8.0 / 12.0, 2.0: -1.0 / 12.0}


def evaluated(values: Mapping[str, float], accuracy: float, *, gradient: bool = False) -> Evaluation:
    return full_evaluation(read_chip(CHIP), STATE, values, figures=FIGURES, accuracy=accuracy, gradient=gradient)


def compare_sensitivities(accuracy: float, kept: Measurements) -> None:
    known = numbers_of(fill(read_chip(CHIP), STATE))
    values = {name: known[name] for name in COMPARED}
    exact = evaluated(values, accuracy, gradient=True)
    assert exact.gradient is not None
    worst = 0.0
    for index, (name, number) in enumerate(values.items()):
        step = STEP * abs(number)
        moved = {k: evaluated({**values, name: number + k * step}, accuracy) for k in STENCIL}
        for figure in FIGURES:
            slope = sum(weight * moved[k].figures[figure] for k, weight in STENCIL.items()) / step
            # The figure's own scale: its change with the number, or the figure over the number where that is more.
            scale = max(abs(slope), abs(exact.figures[figure] / number))
            off = abs(exact.gradient[figure][index] - slope) / scale
            worst = max(worst, off)
            print(f"{figure:6s} by {name:36s} exact {exact.gradient[figure][index]:+.7e}, differences {slope:+.7e}, "
                  f"off by {off:.1e}", flush=True)
    kept.add("sensitivities off from differences", worst, "1")
    print(f"sensitivities and differences of full solves differ by {worst:.1e} at most, of the figure's own scale")


def compare_yields(arguments: argparse.Namespace, kept: Measurements) -> None:
    started = time.perf_counter()
    found = tolerance(read_chip(CHIP), STATE, REQUIRED, uncertainty=UNCERTAIN, samples=arguments.samples,
                      accuracy=arguments.accuracy, figures=FIGURES[3:], seed=arguments.seed)
    assert found.yields is not None
    assert found.outcomes is not None
    assert found.model is not None
    print(f"model and {arguments.samples} samples: {time.perf_counter() - started:.0f} s, rank {found.model.rank}, "
          f"off by {100.0 * found.model.error:.2g} %", flush=True)
    started = time.perf_counter()
    solved = []
    for number, point in enumerate(found.outcomes.points, 1):
        solved.append([evaluated(found.uncertainty.values(point), arguments.accuracy).figures[f] for f in FIGURES])
        if number % 20 == 0:
            print(f"{number} full evaluations, {time.perf_counter() - started:.0f} s", flush=True)
    full = dict(zip(FIGURES, np.array(solved).T, strict=True))
    for name in FIGURES:
        off = np.abs(found.outcomes.column(name) / full[name] - 1.0)
        kept.add(f"{name} off, largest", float(np.nanmax(off)), "1")
        print(f"{name}: the model is off by {np.nanmedian(off):.1e} (median), {np.nanmax(off):.1e} at most")
    tell_yields(found, full, kept)


def tell_yields(found: Tolerance, full: Mapping[str, NDArray[np.float64]], kept: Measurements) -> None:
    assert found.yields is not None
    assert found.outcomes is not None
    met = [np.array([each.met(values[each.label]) for each in found.bounds])
           for values in ({name: found.outcomes.column(name) for name in FIGURES}, full)]
    rows = [*zip(found.yields.each, *met, strict=True), (found.yields.together, *(each.all(axis=0) for each in met))]
    for each, by_model, by_full in rows:
        exact = share(by_full)
        inside = each.sampled.low <= exact.value <= each.sampled.high
        print(f"{each.name}: model {each.sampled}, full solves {exact}, {int((by_model != by_full).sum())} samples "
              f"differ, {'within' if inside else 'OUTSIDE'} the interval; linear {100.0 * each.linear:.1f} %")
        kept.add(f"yield, {each.name}, model", each.sampled.value, "1")
        kept.add(f"yield, {each.name}, full solves", exact.value, "1")
        kept.add(f"yield, {each.name}, linear", each.linear, "1")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--accuracy", type=float, default=5e-3)
    parser.add_argument("--only", choices=("sensitivities", "yield"))
    with_json(parser)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    with measurements(arguments.json) as kept:
        if arguments.only != "yield":
            compare_sensitivities(arguments.accuracy, kept)
        if arguments.only != "sensitivities":
            compare_yields(arguments, kept)


if __name__ == "__main__":
    main()
