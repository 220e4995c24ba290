"""Scoring of trials: the only place that opens the truth. Whether what was said is right, and the rates of that."""

from __future__ import annotations

import csv
import io
import json
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from concealed.device import GEL, PLA, PZT, REFERENCE_TEMPERATURE, WATER, water
from concealed.mechanisms import DRAWS, NONE, OUTSIDE

from workbench.files.writing import write_atomic
from workbench.model.numbers import BENCH_ELEMENTS

#: An effect of more standard deviations than this is detectable; a held-out state is back to noise below that.
DETECTABLE, HELD = 5.0, 1.3

#: Verdicts that name an effect, the verdict of a diagnosis cut short, and the word for one that gave no verdict.
CLAIMS, NOT_FINISHED, FAILED = ("missing_physics", "ambiguous"), "not_finished", "failed"

#: Kinds of trials whose times are told apart, by what was concealed.
KINDS = ("nothing", "one effect", "outside", "two effects")


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
    "partial bond": "superstrate bonded on a part of its radius",
    "density gauge": "density that the constants were fitted with",
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
        case "cavity not full":
            return {"cavity rim.width": 1.0 - told["meniscus.radius"] / values["cavity.radius"]}
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
        case "density gauge":
            # All that follows from it is not told of twice.
            return {"transducer.gauge": told["transducer.gauge"]}
        case "port necks":
            return dict(told)
        case "surface load":
            names = {"clamp.normal": "backing", "lid.normal": "load on the superstrate"}
            return {f"{names[key]}.normal_impedance": value for key, value in told.items()}
        case _:
            return {name: value for name, value in told.items() if name.partition(".")[0] in OWN}


#: What the names of true numbers begin with that are those of a campaign.
OWN = (PZT.partition(".")[0], PLA, "bench", "transducer", "couplant", "substrate", "sidewall", "superstrate", "cavity")


@dataclass(frozen=True)
class Outcome:
    """One trial: what was concealed, what was said, and whether that is right: ``first`` all that is detectable named,
    ``some`` at least one of it, ``among`` in a set of rivals; ``wrong`` counts what was named and is not there.
    ``seconds`` are those of the processor, ``wall`` those that passed, ``factorisation`` those that one factorisation
    of the filled chip's matrix took in the same process (`factorisation.seconds_of_one`)."""

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
    wall: float
    some: bool
    factorisation: float

    @property
    def kind(self) -> str:
        """One of :data:`KINDS`, whether it is detectable or not."""
        if self.mechanism == NONE:
            return "nothing"
        return "two effects" if " and " in self.mechanism else "outside" if self.mechanism in OUTSIDE else "one effect"

    @property
    def adds(self) -> bool:
        """Whether an effect that is not there was named beside another one."""
        return self.wrong > (0 if self.some else 1)


def outcome(number: str, truth: Mapping[str, Any], found: Mapping[str, Any]) -> Outcome:
    """Compare what was found with the truth."""
    effects = truth["effects"]
    seen = [e for e in effects if e["detectability"] > DETECTABLE]
    group = ("nothing" if not effects else "foreign" if not all(e["catalogued"] for e in effects)
             else "below" if not seen else "pair" if len(effects) > 1 else "single")
    names = [right_names(effect) for effect in seen]
    there = set().union(*map(right_names, effects))

    def right(claimed: set[str]) -> bool:
        return bool(names) and all(claimed & known for known in names)

    said = {e["name"] for e in found["effects"]}
    rivals = [set(r["effects"]) for r in found["rivals"]]
    regions = {TOUCHING.get(effect["region"], effect["region"]) for effect in effects}
    where = [e["region"] for e in found["effects"]] or [e["region"] for e in found["location"][:1]]
    intervals = {n: p for e in found["effects"] for n, p in e["parameters"].items()}
    covered = tuple(intervals[n]["low"] <= value <= intervals[n]["high"] for effect in seen
                    for n, value in true_values(truth, effect).items() if n in intervals)
    held = [s["after"]["reduced_chi_square"] for s in found["held_out"].values()]
    return Outcome(
        number, " and ".join(truth["mechanism"]), group, truth["detectability"], found["verdict"],
        " and ".join(sorted(said)), " and ".join(dict.fromkeys(where)), right(said),
        right(said) or any(map(right, rivals)),
        any(TOUCHING.get(r, r) in regions for r in where),
        found["verdict"] in CLAIMS, len(said - there), len(rivals), len(covered), sum(covered),
        max(held, default=math.nan), bool(found["scores"]) and found["scores"][0]["effect"] in said,
        found["cpu_seconds"], found["commit"], found.get("wall_seconds", math.nan),
        any(said & known for known in names), found.get("factorisation_seconds", math.nan))


def score(folder: Path, commit: str | None, into: Path | None) -> None:
    """Compare what was concealed with what was said at a commit (the only one there is, unless given), print that, and
    add it to a file of outcomes.

    Raises:
        SystemExit: several commits to choose from, none, or outcomes of another one in the file.
    """
    there = sorted(path.name for path in (folder / "found").glob("*") if path.is_dir())
    if (commit or (there[0] if len(there) == 1 else None)) not in there:
        raise SystemExit(f"--commit {commit}: {folder / 'found'} holds outcomes of {', '.join(there) or 'no commit'}; "
                         "expected one of these")
    outcomes = []
    for path in sorted((folder / "found" / (commit or there[0])).glob("*.json")):
        truth = json.loads((folder / "truth" / path.name).read_text())
        outcomes.append(outcome(path.stem, truth, json.loads(path.read_text())))
    if into is not None:
        before = read_outcomes(into)
        others = {o.commit for o in before} - {o.commit for o in outcomes}
        if others:
            raise SystemExit(f"--into {into}: it holds outcomes of {', '.join(sorted(others))}, these are of "
                             f"{commit or there[0]}; expected a file of one commit")
        merged = sorted({o.number: o for o in (*before, *outcomes)}.values(), key=lambda o: o.number)
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(field.name for field in fields(Outcome))
        writer.writerows(map(astuple, merged))
        write_atomic(into, text.getvalue())
        outcomes = merged
    table(outcomes)


def read_outcomes(path: Path) -> list[Outcome]:
    """The outcomes that were kept in a file; none if there is no such file."""
    if not path.exists():
        return []
    kinds: Mapping[str, Callable[[str], Any]] = {"int": int, "float": float, "bool": "True".__eq__, "str": str}
    with path.open(newline="") as file:
        # Older files have no wall time, no time of a factorisation, and no column for one of two.
        rows = [{"wall": "nan", "factorisation": "nan", "some": row["first"], **row} for row in csv.DictReader(file)]
    return [Outcome(**{field.name: kinds[str(field.type)](row[field.name]) for field in fields(Outcome)})
            for row in rows]


def table(outcomes: Sequence[Outcome]) -> None:
    """Print outcome after outcome, and the rates the diagnosis is judged by."""
    for o in outcomes:
        print(f"{o.number} {o.group:8} {o.detectability:7.1f} {'first' if o.first else 'among' if o.among else '-':5} "
              f"{'region' if o.region else '-':6} {o.held_out:5.2f} {o.rivals} {o.mechanism:32} {o.verdict:18} "
              f"{o.said or o.place}")

    print()
    rates(outcomes)
    print()
    confusion(outcomes)


def rates(outcomes: Sequence[Outcome]) -> None:
    """Print the rates the diagnosis is judged by, each with its count."""
    def share(label: str, count: int, total: int) -> None:
        print(f"{label:62} {count:3} of {total:3}" + (f"  {100.0 * count / total:5.1f} %" if total else ""))

    def rate(label: str, group: Sequence[Outcome], right: Callable[[Outcome], bool]) -> None:
        share(label, sum(right(o) for o in group), len(group))

    by = {name: [o for o in outcomes if o.group == name] for name in ("single", "pair", "below", "nothing", "foreign")}
    seen, pairs = by["single"], by["pair"]
    foreign = [o for o in by["foreign"] if o.detectability > DETECTABLE]
    first = [o for o in seen if o.first]
    rate("detectable: right effect first", seen, lambda o: o.first and o.claimed)
    rate("detectable: right effect in the rival set", seen, lambda o: o.among and o.claimed)
    rate("detectable: right effect first, whatever the verdict", seen, lambda o: o.first)
    rate("detectable: an effect named that is not there", seen, lambda o: o.wrong > 0)
    rate("detectable: right region", seen, lambda o: o.region)
    share("detectable: 95 % intervals that cover the truth", sum(o.covered for o in first),
          sum(o.intervals for o in first))
    rate("detectable: held-out chi-square at most 1.3", seen, lambda o: o.held_out <= HELD)
    rate("score test names what the refits end with", [o for o in seen if o.claimed], lambda o: o.best_score)
    rate("an explanation accepted: with rivals", [o for o in outcomes if o.claimed], lambda o: o.rivals > 0)
    rate("two at once: all that is detectable found", pairs, lambda o: o.first)
    rate("two at once: at least one found and none that is not there", pairs, lambda o: o.some and not o.wrong)
    rate("nothing concealed: false alarm", by["nothing"], lambda o: o.claimed)
    rate("not detectable: claimed", by["below"], lambda o: o.claimed)
    rate("outside the catalogue: laid to an effect of the catalogue", foreign, lambda o: o.claimed)
    rate("outside the catalogue: right region", foreign, lambda o: o.region)
    rate("detectable, one or two: a second effect that is not there", [*seen, *pairs], lambda o: o.adds)
    rate("failed, or not done in time", outcomes, lambda o: o.verdict in (NOT_FINISHED, FAILED))
    times(outcomes)
    commits = Counter(o.commit for o in outcomes)
    print("commits: " + ", ".join(f"{commit} ({count})" for commit, count in commits.items()))


def times(outcomes: Sequence[Outcome]) -> None:
    """Print the processor time by what was concealed, in seconds and in factorisations of the filled chip's matrix
    (where these were timed), and the wall time: median, 90 % quantile, largest."""
    def row(label: str, known: Sequence[float]) -> None:
        known = [value for value in known if math.isfinite(value)]
        if known:
            cells = (np.median(known), np.quantile(known, 0.9), max(known))
            print(f"{label:46} {len(known):3}" + "".join(f"{cell:8.0f}" for cell in cells))

    print(f"{'':46}    {'median':>8}{'90 %':>8}{'largest':>8}")
    for kind in (*KINDS, "all"):
        those = [o for o in outcomes if kind in ("all", o.kind)]
        row(f"processor time, s: {kind}", [o.seconds for o in those])
        row(f"processor time, factorisations: {kind}", [o.seconds / o.factorisation for o in those])
    row("wall time, s: all", [o.wall for o in outcomes])
    known = [o.factorisation for o in outcomes if math.isfinite(o.factorisation)]
    if known:
        print(f"one factorisation: median {np.median(known):.3f} s, {min(known):.3f} to {max(known):.3f} s")


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
    for name in (*DRAWS, NONE, "two at once"):
        rows = [o for o in outcomes if (o.mechanism if " and " not in o.mechanism else "two at once") == name]
        if rows:
            yield name.replace("_", " ") + (" (not in the catalogue)" if name in OUTSIDE else ""), rows


