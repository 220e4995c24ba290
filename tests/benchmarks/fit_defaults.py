"""Fits of ceramics by their defaults: do they end at the noise, and do their 95 % intervals hold the truth?

    .venv/bin/python tests/benchmarks/fit_defaults.py run FOLDER --trials 40 --seed 1     resumes
    .venv/bin/python tests/benchmarks/fit_defaults.py table FOLDER

A trial is a free disc, in turn in its first two radial modes and about its thickness mode, of a ceramic of the registry
whose constants are off: stiffnesses by 4 %, piezoelectric constants by 6 %, permittivities by 8 % (standard
deviations), losses by a factor of up to two. The spectrum is the model's own on a finer mesh with a noise of 0.3 %. It
is fitted as ``workbench fit pzt`` does without options, from the entry whose constants lie nearest to the truth, or
nearest of the other ceramics (``--start other``): lengths and density are known, nothing else is.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT)]

from geometry.chip import read_chip  # noqa: E402
from materials.assumed import with_assumed_loss  # noqa: E402
from materials.kinds import Piezoelectric  # noqa: E402
from materials.passivity import smallest_dissipation  # noqa: E402
from materials.registry import Registry  # noqa: E402
from workbench.fem.operators import assemble  # noqa: E402
from workbench.fitting.parameter import DATA_SHEET  # noqa: E402
from workbench.fitting.recordings import fit  # noqa: E402
from workbench.model.numbers import real_part  # noqa: E402
from workbench.model.problem import build, fill  # noqa: E402
from workbench.reduced.at_point import reduce  # noqa: E402
from workbench.results.spectrum import Spectrum  # noqa: E402

#: Ceramics that truths are made of.
PARENTS = ("pzt5a/freefem_2020", "pz26/ferroperm", "pzt5h/morgan_tp226", "pzt4/acevedo_2026_initial", "pic255/plutho",
           "pzt4/comsol_nominal")

#: Standard deviation of the truth's constants from those of its parent, as a share of the uncertainty of a data sheet.
OFF = 0.4

NOISE, POINTS = 0.003, 401

#: A fit ends at the noise if it leaves no more than this many times the noise.
AT_NOISE = 1.2


def entries() -> dict[str, Piezoelectric]:
    """The ceramics of the package, lossless ones with the losses of their class."""
    registry, found = Registry(), {}
    for name in registry.names():
        material = registry.load(name, notes=[])
        if isinstance(material, Piezoelectric):
            whole = with_assumed_loss(material)[0]
            assert isinstance(whole, Piezoelectric)
            found[name] = whole
    return found


def distance(one: Piezoelectric, other: Piezoelectric) -> float:
    """The rms difference of the constants of two ceramics, in uncertainties of a data sheet."""
    known, wanted = one.parameters(), other.parameters()
    return float(np.sqrt(np.mean([((known[key].real / wanted[key].real - 1.0) / _uncertainty(key)) ** 2
                                  for key in known if key != "density"])))


def _uncertainty(key: str) -> float:
    return next(DATA_SHEET[prefix] for prefix in ("eps", "e", "c") if key.startswith(prefix))


def drawn(parent: Piezoelectric, random: np.random.Generator) -> Piezoelectric:
    """A ceramic like its parent that stores energy and makes none."""
    while True:
        mechanical, dielectric = 2.0 ** random.uniform(-1.0, 1.0, 2)
        changed: dict[str, Any] = {}
        for key, value in parent.parameters().items():
            if key == "density":
                continue
            off = 1.0 + OFF * _uncertainty(key) * random.standard_normal()
            loss = value.imag / value.real * (dielectric if key.startswith("eps") else mechanical)
            changed[key] = value.real * off * (1.0 + 1j * loss)
        found = replace(parent, **changed)
        stiff = np.array([[(found.c11 + found.c12).real, math.sqrt(2.0) * complex(found.c13).real],
                          [math.sqrt(2.0) * complex(found.c13).real, complex(found.c33).real]])
        if smallest_dissipation(found) >= 0.0 and np.linalg.eigvalsh(stiff)[0] > 0.0 and found.c66.real > 0.0:
            return found


def chip_text(truth: Piezoelectric, kind: str, material: str, random: np.random.Generator) -> str:
    """The chip file of a disc with a band about its radial or its thickness modes."""
    c11, c13, c33, e33 = (complex(getattr(truth, key)).real for key in ("c11", "c13", "c33", "e33"))
    if kind == "radial":
        radius = random.uniform(5e-3, 15e-3)
        thickness = radius * random.uniform(0.1, 0.2)
        first = 2.05 * math.sqrt((c11 - c13**2 / c33) / truth.density) / (2.0 * math.pi * radius)
        band = 0.8 * first, 2.9 * first
    else:
        thickness = random.uniform(0.8e-3, 2e-3)
        radius = thickness * random.uniform(2.5, 4.5)
        through = math.sqrt((c33 + e33**2 / truth.absolute_eps33.real) / truth.density) / (2.0 * thickness)
        band = 0.85 * through, 1.15 * through
    return f"""[chip]
name = "{kind} disc"
band = ["{band[0]:.6g} Hz", "{band[1]:.6g} Hz"]
[[layers]]
role = "transducer"
material = "{material}"
density = "{truth.density:g} kg/m^3"
thickness = "{thickness:.6g} m"
radius = "{radius:.6g} m"
"""


def trial(folder: Path, number: int, seed: int, start: str) -> dict[str, Any]:
    """One disc, fitted; what came of it."""
    random = np.random.default_rng([seed, number])
    known, parent = entries(), PARENTS[(number // 2) % len(PARENTS)]
    kind = ("radial", "thickness")[number % 2]
    truth = drawn(known[parent], random)
    others = [name for name in known if start == "nearest" or name.split("/")[0] != parent.split("/")[0]]
    begin = min(others, key=lambda name: distance(known[name], truth))
    path = folder / f"{number:03d}.toml"
    path.write_text(chip_text(truth, kind, begin, random))
    chip = read_chip(path)
    frequency = np.linspace(*chip.band, POINTS)
    problem = build(fill(chip, None, Registry()), band=chip.band, accuracy=2e-4)
    values = {**problem.values, **{f"{begin}.{key}": value for key, value in truth.parameters().items()}}
    model = reduce(assemble(problem.mesh, problem.terms), frequency, values, tolerance=1e-5)
    impedance = np.conj(model.solve(frequency, values).impedance)
    noise = NOISE / math.sqrt(2.0) * (random.standard_normal(POINTS) + 1j * random.standard_normal(POINTS))
    begun = time.process_time()
    found = fit(Spectrum(frequency, impedance * (1.0 + noise)), chip)
    match = found.result.recordings[0]
    return {
        "kind": kind, "truth": parent, "start": begin, "rms": match.after.rms_log_residual,
        "against": found.reasons_against, "seconds": time.process_time() - begun,
        "descents": len(found.result.starts), "converged": found.result.converged,
        "estimates": {e.parameter.parsed.local: {
            "value": e.value, "low": e.low, "high": e.high, "determined": e.determined, "method": e.method,
            "held": e.held / e.standard_error, "error": e.standard_error, "bound": e.at_bound,
            "truth": real_part(values, e.parameter.name)} for e in found.result.estimates}}


def run(arguments: argparse.Namespace) -> None:
    """Make and fit the discs that are not there yet."""
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for number in track(range(arguments.first, arguments.trials), description="fitting"):
        path = arguments.folder / f"{number:03d}.json"
        if path.is_file():
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = trial(arguments.folder, number, arguments.seed, arguments.start)
        path.write_text(json.dumps(found, indent=1))


def is_held(each: Mapping[str, Any]) -> bool:
    """Whether the interval of an estimate holds the truth."""
    return bool(each["low"] <= each["truth"] <= each["high"])


def table(arguments: argparse.Namespace) -> None:
    """What became of every trial, and of all together."""
    found = {path.stem: json.loads(path.read_text()) for path in sorted(arguments.folder.glob("[0-9]*.json"))}
    print("| disc | modes | truth | start | left (%) | verdict | descents | s | free | intervals that miss the truth |")
    print("|" + " --- |" * 10)
    for name, one in found.items():
        missed = [key for key, each in one["estimates"].items() if not is_held(each)]
        print(f"| {name} | {one['kind']} | {one['truth']} | {one['start']} | {100.0 * one['rms']:.3f} | "
              f"{'saved' if not one['against'] else 'refused'} | {one['descents']} | {one['seconds']:.0f} | "
              f"{len(one['estimates'])} | {', '.join(missed)} |")
    at_noise = [one["rms"] <= AT_NOISE * NOISE and not one["against"] for one in found.values()]
    print(f"\n{sum(at_noise)} of {len(found)} end at the noise and are accepted; "
          f"{np.mean([one['seconds'] for one in found.values()]):.1f} s of processor each")
    for label, chosen in (("all numbers", lambda _: True), ("determined", lambda each: each["determined"]),
                          ("not determined", lambda each: not each["determined"])):
        held = [is_held(each) for one in found.values() for each in one["estimates"].values() if chosen(each)]
        if held:
            print(f"{label}: {100.0 * np.mean(held):.1f} % of {len(held)} intervals hold the truth")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("run", "table"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--start", choices=("nearest", "other"), default="nearest")
    arguments = parser.parse_args()
    {"run": run, "table": table}[arguments.command](arguments)


if __name__ == "__main__":
    main()
