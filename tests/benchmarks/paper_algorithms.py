"""The paper's algorithms beside the workbench's joint fit, on reference spectra and a real recording: cost and result.

    .venv/bin/python tests/benchmarks/paper_algorithms.py [--recordings DIR] [--only NAME ...] [--resume]

Every finished row is in the file of --output at once, so that a stop with Ctrl-C loses only the row in work; --resume
goes on from there, and prints the tables of what there is. *Full-order spectrum*: 481 frequencies one by one with
tuned, symmetrically scaled SuperLU on one thread, scaled up from --points of them. Prints Markdown tables for
docs/validation.md. Reference spectra are those of an independent solver (tests/data/reference), with densities of 7500
kg/m^3, which the published constants belong to; the real disc is the one of geometry/chips/disc_20x2.toml.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from geometry.chip import Chip, read_chip  # noqa: E402
from materials.registry import Registry  # noqa: E402
from workbench.commands.terminal import Show, progress_bars  # noqa: E402
from workbench.fem.operators import assemble  # noqa: E402
from workbench.fem.solve import sweep  # noqa: E402
from workbench.files.writing import write_json  # noqa: E402
from workbench.fitting.joint import fit_parameters  # noqa: E402
from workbench.fitting.parameter import POLYMER_FOUR, TRANSDUCER_TEN  # noqa: E402
from workbench.fitting.prepare import Prepared, material_starts, prepare  # noqa: E402
from workbench.model.discretisation import ACCURACY  # noqa: E402
from workbench.model.numbers import LOSS, real_part  # noqa: E402
from workbench.model.problem import Problem, build, fill  # noqa: E402
from workbench.readers import read_recording  # noqa: E402
from workbench.reproduction.fits import POLYMER_WINDOW, WINDOW, fit_polymer, fit_transducer  # noqa: E402
from workbench.reproduction.sensitivity import TABLE_TWO, sensitivity  # noqa: E402
from workbench.results.spectrum import Spectrum  # noqa: E402

INITIAL, FITTED, PLA, PMMA = (
    "pzt4/acevedo_2026_initial", "pzt4/acevedo_2026_fitted", "pla/acevedo_2026", "pmma/acevedo_2026")

#: Density (kg/m^3) the published constants reproduce the measured resonance with, and the one that is printed.
DENSITY, PRINTED_DENSITY = 7500.0, 7862.0

#: The folder of the real disc among the recordings, and its file.
DISC = Path("unibas-disc-20x2/MODULOFASEMODOTHICKNES.CSV")

Row = dict[str, Any]
Say = Callable[[str, float], None]


class _TimeIsUp(KeyboardInterrupt):
    """Ends a fit of the paper with the best point so far, as Ctrl-C does."""


@dataclass(frozen=True)
class Case:
    """Data to be fitted: what they are called, how they are prepared, and the truth where it is known."""

    label: str
    prepare: Callable[[], Prepared]
    truth: Mapping[str, float]


def disc_of(chip: Chip, material: str, density: float | None = None) -> Chip:
    """The chip with another transducer."""
    layers = [replace(layer, material=material, density=layer.density if density is None else density)
              if layer.role == "transducer" else layer for layer in chip.layers]
    return replace(chip, layers=tuple(layers))


def parts(material: str, names: tuple[str, ...]) -> dict[str, float]:
    """Real numbers of the registry by parameter name."""
    values = Registry().load(material).parameters()
    return {name: real_part(values, name) for name in names}


def free_disc(density: float, arguments: argparse.Namespace) -> Problem:
    chip = disc_of(read_chip(ROOT / "geometry/chips/free_disc_25x2.toml"), INITIAL, density)
    return build(fill(chip, chip.states[0].name, Registry()), accuracy=arguments.accuracy)


def cases(arguments: argparse.Namespace) -> dict[str, Case]:
    fineness = arguments.accuracy

    def disc() -> Prepared:
        chip = disc_of(read_chip(ROOT / "geometry/chips/free_disc_25x2.toml"), INITIAL, DENSITY)
        measured = read_recording(ROOT / "tests/data/reference/free_disc_fitted_rho7500.csv").spectrum
        return prepare(chip, Registry(), kind="pzt", name="free disc", measured=measured, free=TRANSDUCER_TEN,
                       accuracy=fineness)

    def polymer() -> Prepared:
        chip = read_chip(ROOT / "geometry/chips/disc_gel_pla.toml")
        measured = read_recording(ROOT / "tests/data/reference/disc_gel_PLA.csv").spectrum
        prepared = prepare(chip, Registry(), kind="polymer", name="PLA", measured=measured,
                           accuracy=fineness)
        # From the moduli of PMMA: those of the chip's own material are the truth.
        start = material_starts(prepared, Registry(), [PMMA])[PMMA]
        moved = tuple(replace(p, value=float(np.clip(x, p.low, p.high)))
                      for p, x in zip(prepared.parameters, start, strict=True))
        return replace(prepared, parameters=moved)

    def real() -> Prepared:
        measured = read_recording(arguments.recordings / DISC).spectrum
        return prepare(read_chip(ROOT / "geometry/chips/disc_20x2.toml"), Registry(), kind="pzt", name="real disc",
                       measured=measured, free=TRANSDUCER_TEN, accuracy=fineness)

    result = {
        "disc": Case("reference: free disc", disc, parts(FITTED, TRANSDUCER_TEN)),
        "polymer": Case("reference: disc, gel, PLA", polymer, parts(PLA, POLYMER_FOUR)),
    }
    if arguments.recordings is not None:
        result["recording"] = Case(f"measured: {DISC.parent.name}", real, {})
    return result


# --------------------------------------------------------------------------------------------------------------------
# What makes a row.


def full_order(arguments: argparse.Namespace, say: Say) -> Row:
    """Seconds of a full-order spectrum of 481 frequencies of the reference disc."""
    problem = free_disc(DENSITY, arguments)
    operators = assemble(problem.mesh, problem.terms)
    chosen = np.linspace(*problem.band, arguments.points)
    started = time.perf_counter()
    for i, _ in enumerate(sweep(operators, chosen, problem.values)):
        say(f"frequency {i + 1}", (i + 1) / chosen.size)
    seconds = time.perf_counter() - started
    return {"unknowns": operators.size, "points": chosen.size, "seconds": seconds * 481 / chosen.size}


def ranking(density: float, scalings: int, arguments: argparse.Namespace, say: Say) -> Row:
    """Algorithm 1 in the window and with the steps of the paper: 481 frequencies."""
    problem = free_disc(density, arguments)
    frequencies = np.linspace(0.88 * 1.03e6, 1.12 * 1.03e6, 481)
    found = sensitivity(problem, frequencies, scalings=scalings,
                        progress=lambda name, share: say(name.split(".", 1)[1], share))
    short = [name.removeprefix(f"{INITIAL}.") for name in found.names]

    def named(index: np.ndarray) -> dict[str, float]:
        return dict(zip(short, map(float, found.normalised(index)), strict=True))

    return {
        "density": density, "spectra": found.spectra, "solves": found.solves, "seconds": found.seconds,
        "error": found.error, "slopes": named(found.slopes()), "near": named(found.slopes(reach=0.02)),
        "gradient": named(found.local**2), "kept": [name.removeprefix(f"{INITIAL}.") for name in found.kept()],
        "undetermined": [name.removeprefix(f"{INITIAL}.") for name in found.undetermined],
    }


def published(case: Case, arguments: argparse.Namespace, say: Say) -> Row:
    """Algorithm 2 or the polymer fit."""
    prepared = case.prepare()
    recording, material = prepared.recordings[0], prepared.material.name
    started, calls = time.perf_counter(), 0

    def progress(text: str, cost: float) -> None:
        nonlocal calls
        calls += 1
        # Nobody knows how many it takes: the bar slows down.
        say(f"{text}, cost {cost:.4g}", calls / (calls + 1000.0))
        if time.perf_counter() - started > 60.0 * arguments.minutes:
            raise _TimeIsUp

    start = {p.name.removeprefix(f"{material}."): p.start for p in prepared.parameters}
    found = (fit_transducer(recording, start=start, progress=progress) if prepared.kind == "pzt"
             else fit_polymer(recording, material, start=start, progress=progress))
    reason = found.reason
    if reason.startswith("stopped"):
        if time.perf_counter() - started <= 60.0 * arguments.minutes:
            raise KeyboardInterrupt
        reason = reason.replace("stopped by the user", f"stopped after {arguments.minutes:g} min")
    return {
        "data": case.label, "kind": prepared.kind,
        "algorithm": "paper, Algorithm 2" if prepared.kind == "pzt" else "paper, polymer fit",
        "spectra": found.spectra, "solves": found.solves, "seconds": found.seconds,
        "mape": found.mape_percent, "points": found.frequency.size, "outcome": reason,
        "costs": list(found.costs), "strayed": [name.split(".", 1)[1] for name in found.strayed],
        "values": {name.split(".", 1)[1]: value for name, value in found.values.items()}, "start": start,
        "truth": dict(case.truth), "rejected": found.inadmissible, "unpredicted": found.unpredicted,
        "blocks": [f"{b.name}{b.iteration}: {b.start:.4g} to {b.cost:.4g}, {b.spectra} spectra, {b.reason}"
                   for b in found.blocks],
    }


def joint(case: Case, _arguments: argparse.Namespace, say: Say) -> Row:
    """The workbench's fit, asked as ``workbench fit`` asks it."""
    prepared = case.prepare()
    found = fit_parameters(prepared.recordings, prepared.parameters, coarse=prepared.coarse, progress=say)
    match, material = found.recordings[0], prepared.material.name
    window = WINDOW if prepared.kind == "pzt" else POLYMER_WINDOW
    mape, points = mape_about_resonance(match.measured, match.fitted, window)
    return {
        "data": case.label, "kind": prepared.kind, "algorithm": "joint", "spectra": None, "steps": found.iterations,
        "solves": found.full_solves, "seconds": found.seconds, "mape": mape, "points": points,
        "outcome": "converged" if found.converged else "not converged",
        "values": {e.parameter.name.removeprefix(f"{material}."): e.value for e in found.estimates},
        "intervals": {e.parameter.name.removeprefix(f"{material}."): [e.low, e.high] if np.isfinite(e.low) else None
                      for e in found.estimates},
        "start": {p.name.removeprefix(f"{material}."): p.start for p in prepared.parameters},
        "truth": dict(case.truth), "strayed": [],
    }


def mape_about_resonance(measured: Spectrum, fitted: Spectrum, window: float) -> tuple[float, int]:
    """MAPE (%) of |Z| in the window the paper's algorithm ends with, and its points."""
    f0 = measured.frequency[np.argmin(measured.magnitude)]
    inside = np.abs(measured.frequency / f0 - 1.0) <= window
    ratio = fitted.magnitude[inside] / measured.magnitude[inside]
    return 100.0 * float(np.mean(np.abs(ratio - 1.0))), int(inside.sum())


# --------------------------------------------------------------------------------------------------------------------
# Tables.


def print_ranking(rows: Mapping[str, Row]) -> None:
    spectrum = rows.get("full-order")
    found = {key: row for key, row in rows.items() if key.startswith("ranking")}
    if spectrum is not None:
        print(f"\nFull-order spectrum of the reference disc: {spectrum['unknowns']} unknowns, 481 frequencies in "
              f"{spectrum['seconds']:.0f} s (scaled from {spectrum['points']} of them; load {spectrum['load']:.1f})\n")
    for row in found.values():
        ratio = "" if spectrum is None else f", {row['seconds'] / spectrum['seconds']:.2f} of one full-order spectrum"
        print(f"Algorithm 1, {row['density']:g} kg/m^3: {row['spectra']} perturbed spectra of 481 frequencies in "
              f"{row['seconds']:.0f} s ({row['solves']} full solves, largest estimated error of Z {row['error']:.1e}, "
              f"load {row['load']:.1f}){ratio}; kept: {', '.join(row['kept'])}; zero in the baseline: "
              f"{', '.join(row['undetermined'])}\n")
    if not found:
        return
    first, *others = found.values()
    columns = {"eq. 30": first["slopes"], "within 2 % of 1": first["near"], "gradient squared": first["gradient"]}
    columns |= {f"eq. 30, {row['density']:g} kg/m^3, {row['spectra']} spectra": row["slopes"] for row in others}
    print("| part | Table 2 | " + " | ".join(columns) + " |\n| --- |" + " ---: |" * (len(columns) + 1))
    for name in sorted(first["slopes"], key=lambda name: (name.endswith(LOSS), -first["slopes"][name])):
        printed = f"{TABLE_TWO[name]:.3f}" if name in TABLE_TWO else "dropped"
        print(f"| {name} | {printed} | " + " | ".join(f"{column[name]:.3f}" for column in columns.values()) + " |")


def print_fits(rows: Mapping[str, Row]) -> None:
    fits = [row for row in rows.values() if "algorithm" in row]
    if not fits:
        return
    print("\n| data | algorithm | spectra | full solves | wall time (s) | load | MAPE (%) | points | ended |")
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | --- |")
    for row in fits:
        spectra = f"{row['steps']} steps" if row["spectra"] is None else row["spectra"]
        strayed = f"; ran off: {', '.join(row['strayed'])}" if row["strayed"] else ""
        print(f"| {row['data']} | {row['algorithm']} | {spectra} | {row['solves']} | {row['seconds']:.0f} | "
              f"{row['load']:.1f} | {row['mape']:.3g} | {row['points']} | {row['outcome']}{strayed} |")
    for data in dict.fromkeys(row["data"] for row in fits):
        same = [row for row in fits if row["data"] == data]
        truth = same[0]["truth"]
        heads = ["parameter", "start", *(["truth"] if truth else []), *(row["algorithm"] for row in same)]
        print(f"\n{data}\n\n| " + " | ".join(heads) + " |\n| --- |" + " ---: |" * (len(heads) - 1))
        for name, start in same[0]["start"].items():
            cells = [f"{start:.5g}", *([f"{truth[name]:.5g}"] if truth else [])]
            for row in same:
                off = f" ({100.0 * (row['values'][name] / truth[name] - 1.0):+.2f} %)" if truth else ""
                interval = (row.get("intervals") or {}).get(name)
                cells.append(f"{row['values'][name]:.5g}{off}"
                             + (f" [{interval[0]:.4g}, {interval[1]:.4g}]" if interval and not truth else ""))
            print(f"| {name} | " + " | ".join(cells) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=Path, help=f"folder that holds {DISC}")
    parser.add_argument("--points", type=int, default=25, help="frequencies of the full-order spectrum")
    parser.add_argument("--accuracy", type=float, default=ACCURACY)
    parser.add_argument("--minutes", type=float, default=60.0, help="after which a fit of the paper is stopped")
    parser.add_argument("--output", type=Path, default=Path("paper_algorithms.json"), help="rows, finished and kept")
    parser.add_argument("--resume", action="store_true", help="keep the rows there are and make the others")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="names of rows, or how they begin")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    tasks: dict[str, Callable[[Say], Row]] = {
        "full-order": lambda say: full_order(arguments, say),
        "ranking-50": lambda say: ranking(DENSITY, 50, arguments, say),
        # As many spectra as the printed loops run over.
        "ranking-100": lambda say: ranking(DENSITY, 100, arguments, say),
        "ranking-printed-density": lambda say: ranking(PRINTED_DENSITY, 50, arguments, say),
    }
    for name, case in cases(arguments).items():
        tasks[f"{name}-paper"] = lambda say, case=case: published(case, arguments, say)  # type: ignore[misc]
        tasks[f"{name}-joint"] = lambda say, case=case: joint(case, arguments, say)  # type: ignore[misc]
    rows: dict[str, Row] = {}
    if arguments.resume and arguments.output.is_file():
        rows = json.loads(arguments.output.read_text(encoding="utf-8"))
    wanted = [name for name in tasks if name not in rows
              and (arguments.only is None or name.startswith(tuple(arguments.only)))]
    try:
        with progress_bars(Console(stderr=True)) as show:
            for name in wanted:
                rows[name] = {**tasks[name](_said(show, name)), "load": os.getloadavg()[1]}
                show(name, "done", 1.0)
                write_json(arguments.output, rows)
    except KeyboardInterrupt:
        print(f"\nstopped; {len(rows)} rows are in {arguments.output}, --resume makes the others", file=sys.stderr)
    ordered = {name: rows[name] for name in tasks if name in rows}
    print_ranking(ordered)
    print_fits(ordered)


def _said(show: Show, name: str) -> Say:
    """What shows how far a row is."""
    return lambda text, share: show(name, text, share)


if __name__ == "__main__":
    main()
