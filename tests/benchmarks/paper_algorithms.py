"""The paper's algorithms on reference spectra and, if given, on a real recording: what they cost and what they find.

    .venv/bin/python tests/benchmarks/paper_algorithms.py [--points 12] [--recording FILE.csv] [--only sensitivity]

*Full-order spectrum*: 481 frequencies one by one with tuned, symmetrically scaled SuperLU on one thread. With fewer
--points its time is scaled up to 481 and the table says so. Prints Markdown tables for the README.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from geometry.chip import Chip, read_chip  # noqa: E402
from materials.registry import Registry  # noqa: E402
from workbench.fit.objective import Recording  # noqa: E402
from workbench.fit.paper import PaperFit, fit_polymer, fit_transducer  # noqa: E402
from workbench.fit.parameter import LOSS, POLYMER_FOUR, TRANSDUCER_TEN  # noqa: E402
from workbench.fit.sensitivity import TABLE_TWO, sensitivity  # noqa: E402
from workbench.operators import assemble  # noqa: E402
from workbench.problem import Problem, build  # noqa: E402
from workbench.readers import read  # noqa: E402
from workbench.solve import sweep  # noqa: E402

INITIAL, FITTED = "pzt4/acevedo_2026_initial", "pzt4/acevedo_2026_fitted"

#: What the paper says its own runs took, on other machines and with another solver.
PAPER = {"transducer": "4 h", "polymer": "about 1 h"}


def disc_of(chip: Chip, material: str, density: float | None = None) -> Chip:
    """The chip with another transducer."""
    layers = [replace(layer, material=material, density=layer.density if density is None else density)
              if layer.role == "transducer" else layer for layer in chip.layers]
    return replace(chip, layers=tuple(layers))


def say(text: str, cost: float) -> None:
    print(f"\r{text}: {cost:.6g}      ", end="", file=sys.stderr, flush=True)


def full_order(problem: Problem, frequencies: np.ndarray, points: int) -> tuple[float, str]:
    """Seconds of a full-order spectrum of 481 frequencies, and how they were found."""
    operators = assemble(problem.mesh, problem.terms)
    chosen = frequencies[np.unique(np.linspace(0, frequencies.size - 1, min(points, 481)).round().astype(int))]
    started = time.perf_counter()
    for _ in sweep(operators, chosen, problem.values):
        pass
    seconds = (time.perf_counter() - started) * 481 / chosen.size
    scaled = "" if chosen.size == 481 else f", scaled from {chosen.size} points"
    return seconds, f"{operators.size} unknowns, 481 frequencies{scaled}"


def ranking(arguments: argparse.Namespace) -> None:
    chip = read_chip(ROOT / "geometry/chips/free_disc_25x2.toml")
    frequencies = np.arange(1.03e6 * 0.88, 1.03e6 * 1.12, 500.0)
    columns: dict[str, Mapping[str, float]] = {}
    for label, density, fineness, scalings in (
        ("7500 kg/m^3", 7500.0, arguments.elements_per_wavelength, 100),
        ("7862 kg/m^3", 7862.0, arguments.elements_per_wavelength, 50),
        ("7500 kg/m^3, coarser mesh", 7500.0, 0.7 * arguments.elements_per_wavelength, 50),
    )[:1 if arguments.brief else 3]:
        disc = disc_of(chip, INITIAL, density)
        problem = build(disc, disc.states[0].name, Registry(), elements_per_wavelength=fineness)
        seconds, how = full_order(problem, frequencies, arguments.points)
        found = sensitivity(problem, frequencies, scalings=scalings, progress=say)
        print(f"\n\nAlgorithm 1, {label}: {found.spectra} perturbed spectra of {frequencies.size} frequencies in "
              f"{found.seconds:.0f} s ({found.solves} full solves, largest estimated error {found.error:.1e}); one "
              f"full-order spectrum ({how}) {seconds:.0f} s: {found.seconds / seconds:.2f} of it\n", flush=True)
        short = [name.removeprefix(f"{INITIAL}.") for name in found.names]
        columns[label] = dict(zip(short, found.normalised(found.slopes()), strict=True))
        if not columns.keys() - {label}:
            columns["within 2 % of 1"] = dict(zip(short, found.normalised(found.slopes(reach=0.02)), strict=True))
            columns["gradient squared"] = dict(zip(short, found.normalised(found.local**2), strict=True))
            print("kept: " + ", ".join(name.removeprefix(f"{INITIAL}.") for name in found.kept()))
            print("zero in the baseline: "
                  + ", ".join(name.removeprefix(f"{INITIAL}.") for name in found.undetermined) + "\n")
    print("| part | Table 2 | " + " | ".join(columns) + " |\n| --- |" + " ---: |" * (len(columns) + 1))
    first = next(iter(columns.values()))
    for name in sorted(first, key=lambda name: (name.endswith(LOSS), -first[name])):
        printed = f"{TABLE_TWO[name]:.3f}" if name in TABLE_TWO else "dropped"
        print(f"| {name} | {printed} | " + " | ".join(f"{column[name]:.3f}" for column in columns.values()) + " |")


def report(title: str, found: PaperFit, names: tuple[str, ...], truth: Mapping[str, float] | None, paper: str) -> None:
    print(f"\n\n**{title}**: {found.spectra} spectra, {found.solves} full solves, {found.seconds:.0f} s (the paper: "
          f"{paper}, another machine); MAPE of |Z| {found.mape_percent:.2f} % over {found.frequency.size} points; "
          f"{found.inadmissible} points rejected, {found.unpredicted} without a spectrum; ended: {found.reason}\n")
    print("costs " + ", ".join(f"{cost:.4g}" for cost in found.costs)
          + "; changes " + ", ".join(f"{100 * change:.3g} %" for change in found.changes) + "\n")
    print("| parameter | start | fitted | truth | off (%) |\n| --- | ---: | ---: | ---: | ---: |")
    for name in names:
        value, start = (next(v for k, v in values.items() if k.endswith("." + name))
                        for values in (found.values, found.start))
        known = ("", "") if truth is None else (f"{truth[name]:.5g}", f"{100 * (value / truth[name] - 1):.2f}")
        print(f"| {name} | {start:.5g} | {value:.5g} | {known[0]} | {known[1]} |", flush=True)


def parts(material: str, names: tuple[str, ...]) -> dict[str, float]:
    """Real numbers of the registry by parameter name."""
    values = Registry().load(material).parameters()
    return {name: complex(values[name.removesuffix(LOSS)]).imag if name.endswith(LOSS) else complex(values[name]).real
            for name in names}


def problem_of(chip: Chip, arguments: argparse.Namespace) -> Problem:
    return build(chip, chip.states[0].name, Registry(), elements_per_wavelength=arguments.elements_per_wavelength)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=12)
    parser.add_argument("--elements-per-wavelength", type=float, default=10.0)
    parser.add_argument("--recording", type=Path, help="a recording of the disc in geometry/chips/disc_20x2.toml")
    parser.add_argument("--only", choices=("sensitivity", "transducer", "polymer", "recording"))
    parser.add_argument("--brief", action="store_true", help="Algorithm 1 without other densities and meshes")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")

    def wanted(part: str) -> bool:
        return arguments.only in (None, part)

    if wanted("sensitivity"):
        ranking(arguments)
    if wanted("transducer"):
        chip = disc_of(read_chip(ROOT / "geometry/chips/free_disc_25x2.toml"), INITIAL, 7500.0)
        measured = read(ROOT / "tests/data/reference/free_disc_fitted_rho7500.csv").spectrum
        found = fit_transducer(Recording("free disc", problem_of(chip, arguments), measured, chip), progress=say)
        report("Algorithm 2, reference free disc", found, TRANSDUCER_TEN, parts(FITTED, TRANSDUCER_TEN),
               PAPER["transducer"])
    if wanted("polymer"):
        chip = read_chip(ROOT / "geometry/chips/disc_gel_pla.toml")
        measured = read(ROOT / "tests/data/reference/disc_gel_PLA.csv").spectrum
        recording = Recording("disc, gel, PLA", problem_of(chip, arguments), measured, chip)
        for other in ("pmma/acevedo_2026", "abs/acevedo_2026"):
            found = fit_polymer(recording, "pla/acevedo_2026", start=parts(other, POLYMER_FOUR), progress=say)
            report(f"Polymer fit, reference PLA from {other}", found, POLYMER_FOUR,
                   parts("pla/acevedo_2026", POLYMER_FOUR), PAPER["polymer"])
    if wanted("recording") and arguments.recording is not None:
        chip = read_chip(ROOT / "geometry/chips/disc_20x2.toml")
        measured = read(arguments.recording).spectrum
        found = fit_transducer(Recording("real disc", problem_of(chip, arguments), measured, chip), progress=say)
        report(f"Algorithm 2, {arguments.recording.name}", found, TRANSDUCER_TEN, None, PAPER["transducer"])


if __name__ == "__main__":
    main()
