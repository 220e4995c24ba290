"""Fits of recordings that the simulated bench made of devices whose numbers are known: are the right ones found, and
do intervals hold them?

    .venv/bin/python tests/benchmarks/bench_fits.py record FOLDER --kind films --trials 40 --seed 7    (or discs, exact)
    .venv/bin/python tests/benchmarks/bench_fits.py fit FOLDER --kind films                            resumes
    .venv/bin/python tests/benchmarks/bench_fits.py table FOLDER --kind films

``films``: printed samples of PLA on a known disc, with gels from 8 to 60 um that the chip file states as 20 um without
a tolerance. ``discs``: discs whose radius is 1 % off what the chip file states. ``exact``: discs of exact lengths, for
how often the 95 % intervals hold the truth.

Every device is simulated on a mesh of a fifth of the fit's error. Its recording goes through the whole bench: both
instruments, converters of 8 bits, leads, open, short and a load whose true value is drawn from its tolerance. A trial
is a folder: ``chip.toml``, ``recording.csv``, ``truth.json``, and after the fit ``fit.json``.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from bench import write_setup  # noqa: E402

from geometry.chip import read_chip  # noqa: E402
from materials.kinds import Piezoelectric  # noqa: E402
from materials.passivity import smallest_dissipation  # noqa: E402
from materials.registry import Registry  # noqa: E402
from workbench.bench.spectra import level_spectra, read_compensation  # noqa: E402
from workbench.bench.sweep import measure  # noqa: E402
from workbench.fem.operators import assemble  # noqa: E402
from workbench.fitting.parameter import DATA_SHEET  # noqa: E402
from workbench.fitting.recordings import fit  # noqa: E402
from workbench.instruments.circuit import Circuit, device_of, open_circuit, resistor  # noqa: E402
from workbench.instruments.simulated import SimulatedBench  # noqa: E402
from workbench.model.numbers import placed  # noqa: E402
from workbench.model.problem import build, fill  # noqa: E402
from workbench.readers import read_recording  # noqa: E402
from workbench.reduced.at_point import reduce  # noqa: E402
from workbench.results.spectrum import Spectrum, write_spectrum  # noqa: E402

#: What the chip files state, with the numbers that fits start from.
DISC, POLYMER = "pzt4/acevedo_2026_initial", "pla/acevedo_2026"
CHIPS: Mapping[str, str] = {
    "films": f"""[chip]
name = "sample of PLA"
band = ["0.9 MHz", "1.17 MHz"]
[[layers]]
role = "transducer"
material = "{DISC}"
density = "7600 kg/m^3"
thickness = {{ value = "2 mm", tolerance = "0 mm" }}
radius = {{ value = "5 mm", tolerance = "0 mm" }}
[[layers]]
role = "couplant"
material = "coupling_gel"
thickness = "20 um"
radius = "5 mm"
[[layers]]
role = "sample"
material = "{POLYMER}"
density = "1140 kg/m^3"
thickness = "1 mm"
radius = "5.5 mm"
""",
    "discs": f"""[chip]
name = "free disc"
band = ["0.9 MHz", "1.17 MHz"]
[[layers]]
role = "transducer"
material = "{DISC}"
density = "7600 kg/m^3"
thickness = "2 mm"
radius = "5 mm"
""",
}
CHIPS = {**CHIPS, "exact": CHIPS["discs"]}
FREE: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "films": ("polymer", ("default", "couplant.thickness", "bench.clock")),
    "discs": ("pzt", ("default", "transducer.radius", "bench.clock")),
    "exact": ("pzt", ("default", "bench.clock")),
}
GEL, RADIUS = "couplant.thickness", "transducer.radius"

#: Range (m) that the true gels are drawn from, and by how much the true radii are off.
GELS, RADIUS_OFF = (8e-6, 60e-6), 0.01

#: A fit has found the truth's optimum if every modulus and stiffness it determined is within so much of the truth, and
#: the film within so much; other optima that leave less than 10 % of Z are 3 to 30 % off.
FOUND, FOUND_FILM = 0.01, 0.03

#: The clock of the simulated generator, as `workbench.instruments.simulated` has it by default.
CLOCK = 5e-6

STEP = 1500.0


def drawn(kind: str, random: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
    """True constants of the materials (SI, by parameter name) that are other than stated, and true lengths (m)."""
    registry = Registry()
    if kind == "films":
        truth = {"bulk_modulus": random.uniform(2.6e9, 4.6e9), "shear_modulus": random.uniform(0.75e9, 1.3e9)}
        truth |= {"bulk_modulus.loss": -truth["bulk_modulus"] * random.uniform(0.005, 0.03),
                  "shear_modulus.loss": -truth["shear_modulus"] * random.uniform(0.02, 0.07)}
        gel = float(np.exp(random.uniform(*np.log(GELS))))
        return {f"{POLYMER}.{name}": value for name, value in truth.items()}, {GEL: gel}
    disc = registry.load(DISC)
    assert isinstance(disc, Piezoelectric)
    known = disc.parameters()
    while True:
        truth = {name: known[name].real * (1.0 + 0.3 * size * random.standard_normal())
                 for name, size in (("c11", 0.1), ("c13", 0.1), ("c33", 0.1), ("c44", 0.1), ("e15", 0.15),
                                    ("e33", 0.15), ("eps33", DATA_SHEET["eps"]))}
        truth |= {f"{name}.loss": known[name].imag * random.uniform(1.0, 4.0) for name in ("c11", "c13", "c33")}
        numbers = placed({f"{DISC}.{name}": value for name, value in known.items()},
                         {f"{DISC}.{name}": value for name, value in truth.items()})
        changed = {name.removeprefix(f"{DISC}."): value for name, value in numbers.items()}
        changed["density"] = changed["density"].real
        if smallest_dissipation(replace(disc, **changed)) >= 0.0:  # type: ignore[arg-type]
            break
    lengths = {RADIUS: 5e-3 * (1.0 + RADIUS_OFF * random.choice([-1.0, 1.0]))} if kind == "discs" else {}
    return {f"{DISC}.{name}": value for name, value in truth.items()}, lengths


def recorded(kind: str, truth: Mapping[str, float], lengths: Mapping[str, float], *, seed: int) -> Spectrum:
    """What the bench reads of that device."""
    random = np.random.default_rng([seed, 1])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "chip.toml").write_text(CHIPS[kind])
        chip = read_chip(folder / "chip.toml").with_dimensions(lengths)
        low, high = chip.band
        wide = np.linspace(low - 2e3, high + 2e3, 1101)
        problem = build(fill(chip, None, Registry()), band=(wide[0], wide[-1]), accuracy=1e-4)
        values = placed(problem.values, truth)
        model = reduce(assemble(problem.mesh, problem.terms), wide, values, tolerance=1e-5)
        device = device_of(Spectrum(wide, np.conj(model.solve(wide, values).impedance)))
        load = resistor(50.0 * (1.0 + random.uniform(-1e-3, 1e-3)))
        connected = {"open": open_circuit(), "short": resistor(0.0), "load": load, "device": device}
        sweep = f'from = "{low:g} Hz"\nto = "{high:g} Hz"\nstep = "{STEP:g} Hz"'
        with SimulatedBench(device, circuit=Circuit(reference_resistance=10.0), seed=seed,
                            frequency_error=CLOCK) as bench:
            for name, each in connected.items():
                bench.connect(each)
                setup = write_setup(bench, folder / f"{name}.toml", sweep=sweep, captures=4, reference="10 ohm",
                                    compensated=name == "device")
                run = measure(setup, folder / f"{name}.h5")
        return level_spectra(run, setup, read_compensation(setup.standards))[0].spectrum


def record(arguments: argparse.Namespace) -> None:
    """Make the recordings that are not there yet."""
    for trial in track(range(arguments.trials), description=f"recording {arguments.kind}"):
        folder = arguments.folder / arguments.kind / f"{trial:03d}"
        if (folder / "truth.json").is_file():
            continue
        folder.mkdir(parents=True, exist_ok=True)
        seed = 100_000 * arguments.seed + trial
        truth, lengths = drawn(arguments.kind, np.random.default_rng(seed))
        (folder / "chip.toml").write_text(CHIPS[arguments.kind])
        write_spectrum(recorded(arguments.kind, truth, lengths, seed=seed), folder / "recording.csv")
        (folder / "truth.json").write_text(json.dumps({**truth, **lengths, "bench.clock": CLOCK}, indent=1))


def fit_all(arguments: argparse.Namespace) -> None:
    """Fit the recordings that are not fitted yet."""
    folders = sorted(path.parent for path in (arguments.folder / arguments.kind).glob("*/truth.json"))
    kind, free = FREE[arguments.kind]
    for folder in track(folders[arguments.first:arguments.last], description=f"fitting {arguments.kind}"):
        if (folder / "fit.json").is_file():
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = fit(read_recording(folder / "recording.csv"), read_chip(folder / "chip.toml"), kind, free=free)
        match = found.result.recordings[0]
        (folder / "fit.json").write_text(json.dumps({
            "estimates": {e.parameter.name: {"value": e.value, "low": e.low, "high": e.high,
                                             "error": e.standard_error, "determined": e.determined}
                          for e in found.result.estimates},
            "rms": match.after.rms_log_residual, "ratio": match.noise.ratio, "against": found.reasons_against,
            "descents": [[s.label, s.rms, s.outcome] for s in found.result.starts],
            "seconds": found.result.seconds, "findings": found.findings}, indent=1))


def right(fitted: Mapping[str, Any], truth: Mapping[str, float]) -> bool:
    """Whether a fit ended in the truth's optimum."""
    far = {name: abs(each["value"] / truth[name] - 1.0) for name, each in fitted["estimates"].items()
           if name in truth and not name.endswith(".loss") and not name.startswith("bench.") and each["determined"]}
    return all(off <= (FOUND_FILM if name == GEL else FOUND) for name, off in far.items())


def table(arguments: argparse.Namespace) -> None:
    """What became of every trial, and of all together."""
    rows, inside = [], dict[str, list[bool]]()
    for path in sorted((arguments.folder / arguments.kind).glob("*/fit.json")):
        fitted, truth = json.loads(path.read_text()), json.loads((path.parent / "truth.json").read_text())
        film = fitted["estimates"].get(GEL, fitted["estimates"].get(RADIUS))
        true_film = truth.get(GEL, truth.get(RADIUS, 0.0))
        good = right(fitted, truth)
        rows.append((good, not fitted["against"], len(fitted["descents"]), fitted["seconds"]))
        for name, each in fitted["estimates"].items():
            if name in truth:
                inside.setdefault(name, []).append(each["low"] <= truth[name] <= each["high"])
        length = "" if film is None else f"{1e6 * true_film:.2f} | {1e6 * film['value']:.2f} | "
        print(f"| {path.parent.name} | {length}{100 * fitted['rms']:.3f} % | {fitted['ratio']:.2f} | "
              f"{'right' if good else 'WRONG'} | {'saved' if not fitted['against'] else 'refused'} | "
              f"{len(fitted['descents'])} | {fitted['seconds']:.0f} s |")
    count = len(rows)
    print(f"\n{count} fits: {sum(good for good, *_ in rows)} end in the truth's optimum; "
          f"{sum(saved and not good for good, saved, *_ in rows)} wrong ones are accepted, "
          f"{sum(good and not saved for good, saved, *_ in rows)} right ones refused; median of "
          f"{np.median([descents for *_, descents, _ in rows]):.0f} descents, "
          f"{np.median([seconds for *_, seconds in rows]):.0f} s")
    for name, found in inside.items():
        print(f"  {name}: {sum(found)} of {len(found)} intervals hold the truth")
    whole = [each for found in inside.values() for each in found]
    print(f"  all: {100 * np.mean(whole):.1f} % of {len(whole)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("record", "fit", "table"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--kind", choices=tuple(CHIPS), default="films")
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--first", type=int, default=0, help="first and last of the trials to fit")
    parser.add_argument("--last", type=int)
    arguments = parser.parse_args()
    {"record": record, "fit": fit_all, "table": table}[arguments.command](arguments)


if __name__ == "__main__":
    main()
