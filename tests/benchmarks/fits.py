"""The workbench's own fit: what it recovers, how honest its intervals are, where it ends from, what it costs.

    .venv/bin/python tests/benchmarks/fits.py recovery   reference disc from the nominal data sheet, ten parameters
    .venv/bin/python tests/benchmarks/fits.py coverage   the same under noise: how often the intervals hold the truth
    .venv/bin/python tests/benchmarks/fits.py starts     the same from random starts
    .venv/bin/python tests/benchmarks/fits.py polymer    disc, gel and PLA from PMMA's moduli, and the gel study
    .venv/bin/python tests/benchmarks/fits.py recording --recordings DIR     a real disc from several data sheets
    .venv/bin/python tests/benchmarks/fits.py speed      fits against one full-order spectrum, one run

The reference data come from an independent solver (see tests/validation). Tables are Markdown.
"""

from __future__ import annotations

import argparse
import copy
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.progress import track

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import measurements, with_json  # noqa: E402
from paper_algorithms import Case, cases, disc_of  # noqa: E402

from geometry.chip import read_chip  # noqa: E402
from materials.registry import Registry  # noqa: E402
from workbench.fem.operators import assemble  # noqa: E402
from workbench.fem.solve import sweep  # noqa: E402
from workbench.fitting.gel import gel_study  # noqa: E402
from workbench.fitting.joint import FINE, FitResult, fit_parameters, reweighted_descent  # noqa: E402
from workbench.fitting.objective import Objective  # noqa: E402
from workbench.fitting.prepare import prepare  # noqa: E402
from workbench.fitting.search import COARSE, FitSearch  # noqa: E402
from workbench.fitting.uncertainty import estimate_uncertainty  # noqa: E402
from workbench.model.discretisation import ACCURACY  # noqa: E402
from workbench.readers import read_recording  # noqa: E402
from workbench.results.spectrum import Spectrum  # noqa: E402

#: Data sheets the real disc is fitted from. The first is the registry entry that the priors are centred on.
DATA_SHEETS = ("pzt4/acevedo_2026_initial", "pzt5a/erturk_2011", "pic255/plutho", "pzt5h/erturk_2011")

#: All real constants, and the losses that a disc with electrodes on its faces can show.
SIXTEEN = ("c11", "c12", "c13", "c33", "c44", "e31", "e33", "e15", "eps11", "eps33",
           "c11.loss", "c12.loss", "c13.loss", "c33.loss", "c44.loss", "eps33.loss")

#: The paper's wall times on its own machine (Acevedo-Espinosa et al. (RP-UEIS)), hours.
PUBLISHED_HOURS = {"sensitivity": 50.0 / 60.0, "transducer": 4.0, "polymer": 0.5}


def table(rows: list[list[str]]) -> None:
    """A Markdown table, its first row the head."""
    head, *body = rows
    print("\n| " + " | ".join(head) + " |\n|" + "---|" * len(head))
    for row in body:
        print("| " + " | ".join(row) + " |")
    print(flush=True)


def short(name: str) -> str:
    return name.split("/")[-1].split(".", 1)[-1]


def keep(result: FitResult, label: str, arguments: argparse.Namespace) -> None:
    """Figures of one fit for ``--json``."""
    for name, value, unit in (("wall time", result.seconds, "s"), ("full solves", result.full_solves, "1"),
                              ("MAPE", result.recordings[0].after.mape_percent, "%")):
        arguments.kept.add(f"{label}, {name}", value, unit)


def estimates(result: FitResult, case: Case) -> None:
    rows = [["parameter", "start", "fitted", "95 % interval", "truth", "off", "holds the truth", "remark"]]
    for found in result.estimates:
        name = short(found.parameter.name)
        truth = case.truth.get(name)
        rows.append([
            name, f"{found.parameter.start:.5g}", f"{found.value:.6g}", f"{found.low:.6g} to {found.high:.6g}",
            "" if truth is None else f"{truth:.6g}",
            "" if truth is None else f"{100 * (found.value / truth - 1):+.3f} %",
            "" if truth is None else ("yes" if found.low <= truth <= found.high else "NO"),
            "; ".join(filter(None, [found.at_bound, "" if found.determined else "not determined"])),
        ])
    table(rows)
    for match in result.recordings:
        print(f"{match.name}: MAPE {match.before.mape_percent:.2f} % -> {match.after.mape_percent:.4f} %, rms of "
              f"|ln ratio| {100 * match.after.rms_log_residual:.4f} %")
    print(f"{result.seconds:.1f} s, {result.full_solves} full solves, {len(result.starts)} descents; reduced model "
          f"{result.check[0]:.1e} off full solves")
    for finding in result.findings:
        print(" -", finding)


def recovery(arguments: argparse.Namespace) -> None:
    case = cases(arguments)["disc"]
    prepared = case.prepare()
    result = fit_parameters(prepared.recordings, prepared.parameters, coarse=prepared.coarse)
    keep(result, case.label, arguments)
    estimates(result, case)


def polymer(arguments: argparse.Namespace) -> None:
    case = cases(arguments)["polymer"]
    prepared = case.prepare()
    result = fit_parameters(prepared.recordings, prepared.parameters, coarse=prepared.coarse)
    keep(result, case.label, arguments)
    estimates(result, case)
    study = gel_study(prepared, Registry(), numbers={e.parameter.name: e.value for e in result.estimates},
                      thicknesses=(5e-6, 20e-6, 50e-6), accuracy=arguments.accuracy)
    published = {5e-6: 26.2, 20e-6: 25.9, 50e-6: 32.8}
    table([["gel", "MAPE", "MAPE of the paper against its own recording"],
           *([f"{1e6 * c.thickness:g} um", f"{c.comparison.mape_percent:.3g} %", f"{published[c.thickness]} %"]
             for c in study)])


def measured_as(objective: Objective, spectrum: Spectrum) -> Objective:
    """The same of another spectrum at the same frequencies, sharing what the predictor has learnt."""
    other = copy.copy(objective)
    other.recordings = (replace(objective.recordings[0], measured=spectrum),)
    return other


def coverage(arguments: argparse.Namespace) -> None:
    """Noise of a constant relative level on magnitude and phase; fitted again from the optimum each time.

    The optimum itself is found from the nominal data sheet, whose values are the centre of the prior throughout.
    """
    case = cases(arguments)["disc"]
    prepared = case.prepare()
    exact = prepared.recordings[0].measured
    first = fit_parameters(prepared.recordings, prepared.parameters, coarse=prepared.coarse, bands=0, profiles=False)
    optimum = np.array([e.value for e in first.estimates])
    objective = Objective.of(prepared.recordings, prepared.parameters, tolerance=FINE)
    coarser = Objective.of(prepared.coarse, prepared.parameters, tolerance=COARSE)
    random = np.random.default_rng(arguments.seed)
    rows = [["noise", "parameter", "inside", "of", "rms of (fitted - truth) / standard error", "determined"]]
    for level in arguments.noise:
        inside = {p.name: 0 for p in prepared.parameters}
        pulls: dict[str, list[float]] = {p.name: [] for p in prepared.parameters}
        determined = dict.fromkeys(inside, True)
        for _ in track(range(arguments.draws), description=f"noise {100 * level:g} %"):
            noise = level * (random.standard_normal(exact.frequency.size)
                             + 1j * random.standard_normal(exact.frequency.size))
            measured = Spectrum(exact.frequency, exact.impedance * np.exp(noise))
            search = FitSearch(measured_as(objective, measured))
            minimum, found_noise = reweighted_descent(search, optimum)
            estimated = estimate_uncertainty(search, minimum, found_noise, profiles=True, coarser=coarser)
            for found in estimated.estimates:
                name = found.parameter.name
                truth = case.truth[short(name)]
                inside[name] += found.low <= truth <= found.high
                pulls[name].append((found.value - truth) / found.standard_error)
                determined[name] &= found.determined
        rows += [[f"{100 * level:g} %", short(name), str(count), str(arguments.draws),
                  f"{np.sqrt(np.mean(np.square(pulls[name]))):.2f}", "yes" if determined[name] else "no"]
                 for name, count in inside.items()]
    table(rows)


def starts(arguments: argparse.Namespace) -> None:
    """Every run is a whole search that knows nothing but its own start, about which its prior is centred too."""
    case = cases(arguments)["disc"]
    prepared = case.prepare()
    random = np.random.default_rng(arguments.seed)
    rows = [["start", "MAPE at the start", "MAPE", "largest |off| of a real constant", "descents", "last", "solves",
             "s"]]
    reached = 0
    for number in range(arguments.count):
        factors = 1.0 + 0.15 * random.uniform(-1.0, 1.0, len(prepared.parameters))
        moved = [replace(p, value=p.start * f) for p, f in zip(prepared.parameters, factors, strict=True)]
        result = fit_parameters(prepared.recordings, moved, coarse=prepared.coarse, bands=0, profiles=False)
        off = max(abs(e.value / case.truth[short(e.parameter.name)] - 1.0)
                  for e in result.estimates if not e.parameter.is_loss)
        reached += off < 0.01
        match = result.recordings[0]
        rows.append([str(number + 1), f"{match.before.mape_percent:.0f} %", f"{match.after.mape_percent:.4f} %",
                     f"{100 * off:.3f} %", str(len(result.starts)), result.starts[-1].label,
                     str(result.full_solves), f"{result.seconds:.0f}"])
        print(rows[-1], flush=True)
    table(rows)
    print(f"{reached} of {arguments.count} starts ended with every real constant within 1 % of the truth")


def recording(arguments: argparse.Namespace) -> None:
    if arguments.recordings is None:
        sys.exit("--recordings: the folder that holds the real disc is needed")
    measured = read_recording(arguments.recordings / "unibas-disc-20x2/MODULOFASEMODOTHICKNES.CSV").spectrum
    rows = [["data sheet", "MAPE at the start", "MAPE", "rms", "descents", "s", *SIXTEEN]]
    for sheet in arguments.sheets:
        chip = disc_of(read_chip(ROOT / "geometry/chips/disc_20x2.toml"), sheet)
        prepared = prepare(chip, Registry(), kind="pzt", name="disc", measured=measured, free=SIXTEEN,
                           accuracy=arguments.accuracy)
        result = fit_parameters(prepared.recordings, prepared.parameters, coarse=prepared.coarse)
        match = result.recordings[0]
        keep(result, sheet, arguments)
        rows.append([sheet, f"{match.before.mape_percent:.0f} %", f"{match.after.mape_percent:.3f} %",
                     f"{100 * match.after.rms_log_residual:.3f} %", str(len(result.starts)), f"{result.seconds:.0f}",
                     *(f"{e.value:.4g}" for e in result.estimates)])
        print(rows[-1], "full solves:", result.full_solves)
        for finding in result.findings:
            print(" -", finding, flush=True)
    table(rows)


def speed(arguments: argparse.Namespace) -> None:
    rows = [["", "s", "share of one full-order spectrum", "the paper on its machine"]]
    every = cases(arguments)
    for name, parameters, paper in (("disc", "ten", "transducer"), ("polymer", "four", "polymer")):
        case = every[name]
        prepared = case.prepare()
        problem, frequency = prepared.recordings[0].problem, prepared.recordings[0].measured.frequency
        operators = assemble(problem.mesh, problem.terms)
        chosen = np.linspace(frequency[0], frequency[-1], arguments.points)
        started = time.perf_counter()
        for _ in track(sweep(operators, chosen, problem.values), total=chosen.size, description="full order"):
            pass
        full = (time.perf_counter() - started) * frequency.size / chosen.size
        rows.append([f"{case.label}: {operators.size} unknowns, full-order spectrum of {frequency.size} frequencies"
                     + (f" (from {chosen.size})" if chosen.size < frequency.size else ""), f"{full:.1f}", "1", ""])
        for bands, text in ((0, "intervals included"), (3, "and three bands left out and predicted")):
            result = fit_parameters(prepared.recordings, prepared.parameters, coarse=prepared.coarse, bands=bands)
            keep(result, f"{case.label}, {text}", arguments)
            rows.append([f"{case.label}: {parameters} parameters, {text}", f"{result.seconds:.1f}",
                         f"{result.seconds / full:.3f}", "" if bands else f"{PUBLISHED_HOURS[paper]:g} h"])
        print(f"{case.label}: MAPE {result.recordings[0].after.mape_percent:.4f} %, {result.full_solves} full solves")
    table(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    works = {work.__name__: work for work in (recovery, coverage, starts, polymer, recording, speed)}
    parser.add_argument("work", choices=works)
    parser.add_argument("--recordings", type=Path, help="folder of the real recordings")
    parser.add_argument("--sheets", nargs="+", default=DATA_SHEETS, help="data sheets that `recording` starts from")
    parser.add_argument("--accuracy", type=float, default=ACCURACY)
    parser.add_argument("--draws", type=int, default=100, help="noise draws of `coverage`")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.005, 0.02], help="relative levels of `coverage`")
    parser.add_argument("--count", type=int, default=20, help="random starts of `starts`")
    parser.add_argument("--points", type=int, default=25, help="full solves that `speed` measures")
    parser.add_argument("--seed", type=int, default=0)
    with_json(parser)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    with measurements(arguments.json) as arguments.kept:
        works[arguments.work](arguments)


if __name__ == "__main__":
    main()
