"""Trials of the diagnosis on devices in which an effect is concealed: how often it is right, how often it is fooled.

    .venv/bin/python tests/benchmarks/trials.py make FOLDER [--trials 300] [--first 0] [--seed 1]
    .venv/bin/python tests/benchmarks/trials.py run FOLDER
    .venv/bin/python tests/benchmarks/trials.py score FOLDER [--into OUTCOMES.csv]
    .venv/bin/python tests/benchmarks/trials.py table OUTCOMES.csv

`make` writes FOLDER/trials/NNNN (a campaign) and FOLDER/truth/NNNN.json; `run` diagnoses every campaign into
FOLDER/found/NNNN.json and never opens the truth; `score` alone compares the two and prints the tables. The first two
can be stopped at any time and go on where they were; several of them may work on one folder. Hundreds of trials take
many hours: `--into` adds what was scored to a file of outcomes, a line a trial with the commit that was tried, and
`table` prints the tables of such a file; tests/data/trials holds those of docs/validation.md, by their seeds.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import os
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "benchmarks")]

from concealed.device import GEL, PLA, PZT, REFERENCE_TEMPERATURE, WATER, water  # noqa: E402
from concealed.mechanisms import CATALOGUED, NONE, OUTSIDE  # noqa: E402
from concealed.trial import make_trial  # noqa: E402

from workbench.diagnosis.campaign import read_campaign  # noqa: E402
from workbench.diagnosis.procedure import diagnose  # noqa: E402
from workbench.diagnosis.record import record  # noqa: E402
from workbench.files.writing import write_atomic  # noqa: E402
from workbench.fitting.parameter import BENCH_ELEMENTS  # noqa: E402

#: In one round every mechanism of the catalogue is hidden once, and so many times nothing, something outside the
#: catalogue, and two effects at once.
NOTHING, FOREIGN, PAIRS = 6, 6, 2


def schedule(seed: int) -> Iterator[tuple[str, ...]]:
    """Mechanisms of trial after trial, in random order within each round."""
    rng = np.random.default_rng(seed)
    outside = list(OUTSIDE)
    number = 0
    while True:
        foreign = [outside[(number * FOREIGN + k) % len(outside)] for k in range(FOREIGN)]
        pairs = [tuple(map(str, rng.choice(list(CATALOGUED), 2, replace=False))) for _ in range(PAIRS)]
        entries = [*((name,) for name in (*CATALOGUED, *[NONE] * NOTHING, *foreign)), *pairs]
        yield from (entries[k] for k in rng.permutation(len(entries)))
        number += 1


def make(folder: Path, first: int, trials: int, seed: int) -> None:
    """Write those of the trials from number `first` on that are not there yet."""
    for number, mechanism in islice(enumerate(schedule(seed)), first, first + trials):
        trial, truth = folder / "trials" / f"{number:04d}", folder / "truth" / f"{number:04d}.json"
        if trial.exists() or not _claimed(folder / "making", number):
            continue
        started = time.perf_counter()
        unfinished = folder / "making" / f"{number:04d}.{os.getpid()}"
        shutil.rmtree(unfinished, ignore_errors=True)
        found = make_trial(1000 * seed + number, mechanism, unfinished)
        truth.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(truth, json.dumps(found.to_dict(), indent=1) + "\n")
        trial.parent.mkdir(parents=True, exist_ok=True)
        unfinished.rename(trial)
        print(f"{number:04d} {' and '.join(mechanism)}: {found.detectability:.1f} sigmas, "
              f"{time.perf_counter() - started:.0f} s", flush=True)


def run(folder: Path) -> None:
    """Diagnose the trials that are not diagnosed yet."""
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True,
                            check=True).stdout.strip()
    for trial in sorted((folder / "trials").iterdir()):
        result = folder / "found" / f"{trial.name}.json"
        if result.exists() or not _claimed(folder / "running", int(trial.name)):
            continue
        started = time.process_time()
        with threadpool_limits(limits=1):
            campaign = read_campaign(trial / "campaign.toml")
            found = diagnose(campaign)
        said = {**record(found), "cpu_seconds": time.process_time() - started, "commit": commit}
        write_atomic(result, json.dumps(said, indent=1) + "\n")
        print(f"{trial.name} {found.verdict} {' and '.join(e.name for e in found.effects)} "
              f"{time.process_time() - started:.0f} s", flush=True)


# --------------------------------------------------------------------------------------------------------------------
# Scoring: the only place that opens the truth


def right_names(effect: Mapping[str, Any]) -> set[str]:
    """What the catalogue calls a concealed effect: any of these is right."""
    parameters, region = effect["parameters"], effect["region"]
    moved = next(iter(parameters))
    match effect["name"]:
        case "stiffness loss":
            return {f"loss of {moved.removesuffix('.loss').rpartition('.')[2]} of the transducer"}
        case "wrong dimension":
            return {f"{moved.rpartition('.')[2]} of the {region}"}
        case "wrong density":
            return {"density of the transducer" if region == "transducer" else f"density of {PLA}"}
        case "surface load":
            return {"load on the face of the transducer" if region == "transducer" else "load on the superstrate"}
        case "imperfect bond":
            # At which face is told by the parameters.
            return {"imperfect bond at the sidewall", "imperfect bond at the superstrate"}
        case name if name.startswith("bench "):
            return {BENCH_ELEMENTS[name.removeprefix("bench ").replace(" ", "_")].text}
        case name:
            return {CALLED.get(name, name)}


#: Names of effects that are not those of the catalogue.
CALLED: Mapping[str, str] = {
    "gel viscosity": "shear through the couplant",
    "gel thickness": "thickness of the couplant",
    "partial coverage": "couplant missing at its rim",
    "fractional loss": f"fractional loss of {PLA}",
    "anisotropic polymer": f"anisotropy of {PLA}",
    "water uptake": f"liquid taken up by {PLA}",
    "partial electrode": "electrode that ends before the rim",
    "depoled rim": "rim of the transducer without piezoelectricity",
    "softening": "softening with the drive",
}

#: Parts that touch along a face: what sits in a polymer may be laid to either of them.
TOUCHING = {"sidewall": "substrate"}


def true_values(truth: Mapping[str, Any], effect: Mapping[str, Any]) -> dict[str, float]:
    """The true numbers of an effect under the names of the catalogue, of those that have one."""
    told, values = effect["parameters"], truth["values"]
    match effect["name"]:
        case "fluid absorption":
            known = water(REFERENCE_TEMPERATURE)
            return {f"{WATER}.diffusivity_of_sound": told["diffusivity_of_sound"] + (known.diffusivity_of_sound or 0.0)}
        case "small bubbles in the cavity":
            return {"wood.void_fraction": told["cavity.void_fraction"]}
        case "resonant bubbles in the cavity":
            return {"bubbles.void_fraction": told["cavity.void_fraction"],
                    "bubbles.radius": told["cavity.bubble_radius"]}
        case "fluid temperature":
            return {f"{WATER}.temperature_offset": told["temperature.offset"]}
        case "bubbles in the couplant":
            return {"couplant bubbles.void_fraction": told["gel.void_fraction"]}
        case "gel viscosity":
            return {f"{GEL}.gel_viscosity_root": told["gel.viscosity"] ** 0.5}
        case "anisotropic polymer":
            return {f"{PLA}.axial_excess": told["anisotropy.c33"], f"{PLA}.shear_excess": told["anisotropy.c44"]}
        case "water uptake":
            return {f"{PLA}, wet.density": told["uptake.fraction"] * values[f"{PLA}.density"],
                    f"{PLA}, wet.shear_modulus": -told["uptake.softening"] * values[f"{PLA}.shear_modulus"],
                    f"{PLA}, wet.shear_modulus.loss": -told["uptake.loss"] * values[f"{PLA}.shear_modulus"]
                    - told["uptake.softening"] * values[f"{PLA}.shear_modulus.loss"]}
        case "imperfect bond":
            where = f"bond at the {'sidewall' if told['bond.below'] else 'superstrate'}"
            loss = told["bond.loss_factor"]
            return {**{f"{where}.{kind}_compliance": 1.0 / (told[f"bond.{kind}_stiffness"] * (1.0 + loss**2))
                       for kind in ("normal", "tangential")}, f"{where}.loss_factor": loss}
        case "softening":
            # Told per squared 8 V peak to peak, found per squared volt of amplitude.
            return {f"{PZT}.{name}": told[f"softening.{key}"] / 4.0**2
                    for name, key in (("softening", "stiffness"), ("drive_loss", "loss"))}
        case "electrode mass":
            return {"electrodes.surface_density": told["surface_density"]}
        case "surface load":
            names = {"clamp.normal": "backing", "lid.normal": "load on the superstrate"}
            return {f"{names[key]}.normal_impedance": value for key, value in told.items()}
        case _:
            return {name: value for name, value in told.items() if name.partition(".")[0] in OWN}


#: What the names of true numbers begin with that are those of a campaign.
OWN = (PZT.partition(".")[0], PLA, "bench", "transducer", "couplant", "substrate", "sidewall", "superstrate", "cavity")


@dataclass(frozen=True)
class Outcome:
    """One trial: what was concealed, what was said, and whether that is right."""

    number: str
    mechanism: str
    group: str
    detectability: float
    verdict: str
    said: str
    place: str
    first: bool
    among: bool
    region: bool
    claimed: bool
    wrong: int
    rivals: int
    intervals: int
    covered: int
    held_out: float
    best_score: bool
    seconds: float
    commit: str


def outcome(number: str, truth: Mapping[str, Any], found: Mapping[str, Any]) -> Outcome:
    """Compare what was found with the truth."""
    effects = truth["effects"]
    seen = [e for e in effects if e["detectability"] > DETECTABLE]
    group = ("nothing" if not effects else "foreign" if not all(e["catalogued"] for e in effects)
             else "below" if not seen else "pair" if len(effects) > 1 else "single")
    names = [right_names(effect) for effect in seen]

    def right(claimed: set[str]) -> bool:
        return bool(names) and all(claimed & known for known in names)

    said = {e["name"] for e in found["effects"]}
    rivals = [set(r["effects"]) for r in found["rivals"]]
    regions = {TOUCHING.get(effect["region"], effect["region"]) for effect in effects}
    where = [e["region"] for e in found["effects"]] or [e["region"] for e in found["location"][:1]]
    intervals = {n: p for e in found["effects"] for n, p in e["parameters"].items()}
    covered = tuple(intervals[n]["low"] <= value <= intervals[n]["high"] for effect in seen
                    for n, value in true_values(truth, effect).items() if n in intervals)
    return Outcome(
        number, " and ".join(truth["mechanism"]), group, truth["detectability"], found["verdict"],
        " and ".join(sorted(said)), " and ".join(dict.fromkeys(where)), right(said),
        right(said) or any(map(right, rivals)),
        any(TOUCHING.get(r, r) in regions for r in where),
        found["verdict"] in CLAIMS, len(said - set().union(*names)), len(rivals), len(covered), sum(covered),
        max(s["after"]["reduced_chi_square"] for s in found["held_out"].values()),
        found["scores"][0]["effect"] in said, found["cpu_seconds"], found["commit"])


#: Verdicts that name an effect.
CLAIMS = ("missing_physics", "ambiguous")


def score(folder: Path, into: Path | None) -> None:
    """Compare what was concealed and what was said, print that, and add it to a file of outcomes."""
    outcomes = []
    for path in sorted((folder / "found").glob("*.json")):
        truth = json.loads((folder / "truth" / path.name).read_text())
        outcomes.append(outcome(path.stem, truth, json.loads(path.read_text())))
    if into is not None:
        outcomes = sorted({o.number: o for o in (*read_outcomes(into), *outcomes)}.values(), key=lambda o: o.number)
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(field.name for field in fields(Outcome))
        writer.writerows(map(astuple, outcomes))
        write_atomic(into, text.getvalue())
    table(outcomes)


def read_outcomes(path: Path) -> list[Outcome]:
    """The outcomes that were kept in a file; none if there is no such file."""
    if not path.exists():
        return []
    kinds: Mapping[str, Callable[[str], Any]] = {"int": int, "float": float, "bool": "True".__eq__, "str": str}
    with path.open(newline="") as file:
        return [Outcome(**{field.name: kinds[str(field.type)](row[field.name]) for field in fields(Outcome)})
                for row in csv.DictReader(file)]


def table(outcomes: Sequence[Outcome]) -> None:
    """Print outcome after outcome, and the rates the diagnosis is judged by."""
    for o in outcomes:
        print(f"{o.number} {o.group:8} {o.detectability:7.1f} {'first' if o.first else 'among' if o.among else '-':5} "
              f"{'region' if o.region else '-':6} {o.held_out:5.2f} {o.rivals} {o.mechanism:32} {o.verdict:18} "
              f"{o.said or o.place}")

    def rate(label: str, group: Sequence[Outcome], right: Callable[[Outcome], bool]) -> None:
        count = sum(right(o) for o in group)
        print(f"{label:62} {count:3} of {len(group):3}" + (f"  {100.0 * count / len(group):5.1f} %" if group else ""))

    by = {name: [o for o in outcomes if o.group == name] for name in ("single", "pair", "below", "nothing", "foreign")}
    seen = by["single"]
    print()
    rate("detectable: right effect first", seen, lambda o: o.first and o.claimed)
    rate("detectable: right effect in the rival set", seen, lambda o: o.among and o.claimed)
    rate("detectable: right effect first, whatever the verdict", seen, lambda o: o.first)
    rate("detectable: an effect named that is not there", seen, lambda o: o.wrong > 0)
    rate("detectable: right region", seen, lambda o: o.region)
    first = [o for o in seen if o.first]
    print(f"{'intervals of its parameters that hold the truth':62} {sum(o.covered for o in first):3} of "
          f"{sum(o.intervals for o in first):3}")
    rate("detectable: held-out chi-square at most 1.3", seen, lambda o: o.held_out <= HELD)
    rate("score test names what the refits end with", [o for o in seen if o.claimed], lambda o: o.best_score)
    rate("an explanation accepted: with rivals", [o for o in outcomes if o.claimed], lambda o: o.rivals > 0)
    rate("two at once: both found", by["pair"], lambda o: o.first)
    rate("nothing concealed: false alarm", by["nothing"], lambda o: o.claimed)
    rate("not detectable: claimed", by["below"], lambda o: o.claimed)
    foreign = [o for o in by["foreign"] if o.detectability > DETECTABLE]
    rate("outside the catalogue: not attributed", foreign, lambda o: not o.claimed)
    rate("outside the catalogue: right region", foreign, lambda o: o.region)
    if outcomes:
        print(f"CPU time of a diagnosis: median {np.median([o.seconds for o in outcomes]):.0f} s")
    print()
    confusion(outcomes)


def confusion(outcomes: Sequence[Outcome]) -> None:
    """Print what was said of what was concealed, in Markdown: a row a mechanism, of what is detectable and what not."""
    columns = ("concealed", "detectable", "named", "a rival", "another named", "unexplained", "no claim",
               "not detectable", "claimed")
    print(f"| {' | '.join(columns)} |")
    print("| --- |" + " ---: |" * (len(columns) - 1))
    for label, rows in _by_mechanism(outcomes):
        seen = [o for o in rows if o.detectability > DETECTABLE]
        hidden = [o for o in rows if not o.detectability > DETECTABLE]
        named = [o for o in seen if o.claimed]
        others = Counter(o.said for o in named if not o.among)
        cells = [len(seen), sum(o.first for o in named), sum(o.among and not o.first for o in named),
                 "; ".join(f"{said} ({count})" if count > 1 else said for said, count in others.items()),
                 sum(o.verdict == "unexplained" for o in seen),
                 sum(not o.claimed and o.verdict != "unexplained" for o in seen),
                 len(hidden), sum(o.claimed for o in hidden)]
        print(f"| {label} | " + " | ".join(str(cell) if cell else "" for cell in cells) + " |")


def _by_mechanism(outcomes: Sequence[Outcome]) -> Iterator[tuple[str, list[Outcome]]]:
    """Outcomes by what was concealed, in the order of the mechanisms; two at once together."""
    for name in (*CATALOGUED, *OUTSIDE, NONE, "two at once"):
        rows = [o for o in outcomes if (o.mechanism if " and " not in o.mechanism else "two at once") == name]
        if rows:
            yield name.replace("_", " ") + (" (not in the catalogue)" if name in OUTSIDE else ""), rows


#: An effect of more standard deviations than this is detectable; a held-out state is back to noise below that.
DETECTABLE, HELD = 5.0, 1.3


def _claimed(folder: Path, number: int) -> bool:
    """Whether this process may do that piece of work: nobody alive has begun it."""
    folder.mkdir(parents=True, exist_ok=True)
    mark, own = folder / f"{number:04d}.pid", folder / f"by {os.getpid()}"
    own.write_text(str(os.getpid()))
    try:
        while True:
            try:
                # A link appears at once, with its owner in it.
                mark.hardlink_to(own)
                return True
            except FileExistsError:
                if Path(f"/proc/{mark.read_text()}").exists():
                    return False
                mark.unlink(missing_ok=True)
    finally:
        own.unlink()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("job", choices=("make", "run", "score", "table"))
    parser.add_argument("folder", type=Path, help="of the trials; for `table`, a file of outcomes")
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--into", type=Path, help="file of outcomes that `score` adds to")
    parser.add_argument("--commit", help="of what `table` prints, outcomes of this commit only")
    options = parser.parse_args()
    match options.job:
        case "make":
            make(options.folder, options.first, options.trials, options.seed)
        case "run":
            run(options.folder)
        case "score":
            score(options.folder, options.into)
        case "table":
            table([o for o in read_outcomes(options.folder) if options.commit in (None, o.commit)])


if __name__ == "__main__":
    main()
