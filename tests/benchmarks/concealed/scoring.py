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

#: Verdicts that name an effect, those that call all explained, of what nothing explains, of a diagnosis cut short, and
#: the word for one that gave no verdict.
CLAIMS, UNEXPLAINED, NOT_FINISHED, FAILED = ("missing_physics", "ambiguous"), "unexplained", "not_finished", "failed"
EXPLAINED = (*CLAIMS, "parameters_explain", "parameters_at_odds", "no_mismatch")

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
        case "held rim":
            return {f"{region} held at its rim"}
        case name if name.startswith(HOLDS):
            return {f"{_short(name.removeprefix(HOLDS))} in the cavity"}
        case name if name.startswith("sidewall of "):
            return {_short(name)}
        case name if name.startswith("bench "):
            return {BENCH_ELEMENTS[name.removeprefix("bench ").replace(" ", "_")].text}
        case name:
            return {CALLED.get(name, name)}


def _short(name: str) -> str:
    """A name without the source of a material, in words."""
    return name.partition("/")[0].replace("_", " ")


#: Name of an effect of another liquid, before that of the liquid.
HOLDS = "cavity holds "

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
    "cavity filled to a height": "cavity filled up to a height",
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
        case "cavity filled to a height":
            return {"free surface.depth": 1.0 - told["fill.share"]}
        case "bubble under the lid":
            # An area about the axis; an annulus has none.
            share = (told["bubble.outer"] / values["cavity.radius"]) ** 2
            return {} if told["bubble.inner"] else {"bubble under the lid.area": share}
        case "held rim":
            # One stiffness there, a normal and a tangential one here.
            return {f"{effect['region']} held at its rim.loss_factor": told["held.loss_factor"]}
        case name if name.startswith((HOLDS, "sidewall of ")):
            return {f"{called}.share": 1.0 for called in right_names(effect)}
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
    ``part`` is the part of the corpus, ``seconds`` are those of the processor, ``wall`` those that passed, ``memory``
    MB at the peak."""

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
    seconds: float
    commit: str
    wall: float
    some: bool
    memory: float
    part: str

    @property
    def kind(self) -> str:
        """One of :data:`KINDS`, whether it is detectable or not."""
        if self.mechanism == NONE:
            return "nothing"
        return "two effects" if " and " in self.mechanism else "outside" if self.mechanism in OUTSIDE else "one effect"

    @property
    def is_seen_outside(self) -> bool:
        """Whether it is outside the catalogue and detectable."""
        return self.group == "foreign" and self.detectability > DETECTABLE


def outcome(number: str, truth: Mapping[str, Any], found: Mapping[str, Any], commit: str) -> Outcome:
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
    # Other names of the finding, and rivals.
    rivals = [*map(set, found.get("alike", ())), *(set(r["effects"]) for r in found["rivals"])]
    regions = {TOUCHING.get(effect["region"], effect["region"]) for effect in effects}
    where = [e["region"] for e in found["effects"]] or [e["region"] for e in found["location"][:1]]
    intervals = {n: p for e in found["effects"] for n, p in e["parameters"].items()}
    covered = tuple(intervals[n]["low"] <= value <= intervals[n]["high"] for effect in seen
                    for n, value in true_values(truth, effect).items() if n in intervals)
    held = [s.get("predicted_reduced_chi_square", s["after"]["reduced_chi_square"]) for s in found["held_out"].values()]
    return Outcome(
        number, " and ".join(truth["mechanism"]), group, truth["detectability"], found["verdict"],
        " and ".join(sorted(said)), " and ".join(dict.fromkeys(where)), right(said),
        right(said) or any(map(right, rivals)),
        any(TOUCHING.get(r, r) in regions for r in where),
        found["verdict"] in CLAIMS, len(said - there), len(rivals), len(covered), sum(covered),
        max(held, default=math.nan), found["cpu_seconds"], commit, found["wall_seconds"],
        any(said & known for known in names), found.get("peak_megabytes", math.nan), truth.get("part", ""))


def score(folder: Path, truth: Path, into: Path | None) -> None:
    """Compare the outcomes in a folder, called as the commit that was tried, with a file of what was concealed, print
    that, and write a line a trial to a file.

    Raises:
        SystemExit: no outcomes.
    """
    known = json.loads(truth.read_text())
    outcomes = [outcome(path.stem, known[path.stem], json.loads(path.read_text()), folder.resolve().name)
                for path in sorted(folder.glob("*.json"))]
    if not outcomes:
        raise SystemExit(f"{folder}: no outcomes NNNN.json; expected the folder of a commit that `run` has written")
    if into is not None:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(field.name for field in fields(Outcome))
        writer.writerows(map(astuple, outcomes))
        write_atomic(into, text.getvalue())
    table(outcomes)


def read_outcomes(path: Path) -> list[Outcome]:
    """The outcomes that were kept in a file."""
    kinds: Mapping[str, Callable[[str], Any]] = {"int": int, "float": float, "bool": "True".__eq__, "str": str}
    with path.open(newline="") as file:
        # Older files have not all of the columns.
        rows = [{"wall": "nan", "memory": "nan", "part": "", "some": row["first"], **row}
                for row in csv.DictReader(file)]
    return [Outcome(**{field.name: kinds[str(field.type)](row[field.name]) for field in fields(Outcome)})
            for row in rows]


def table(outcomes: Sequence[Outcome]) -> None:
    """Print outcome after outcome, and the rates the diagnosis is judged by, of each part and of all."""
    for o in outcomes:
        print(f"{o.number} {o.group:8} {o.detectability:7.1f} {'first' if o.first else 'among' if o.among else '-':5} "
              f"{'region' if o.region else '-':6} {o.held_out:5.2f} {o.rivals} {o.mechanism:32} {o.verdict:18} "
              f"{o.said or o.place}")
    parts = dict.fromkeys(o.part for o in outcomes)
    columns = {part: [o for o in outcomes if o.part == part] for part in parts} if len(parts) > 1 else {}
    columns["all"] = list(outcomes)
    print()
    rates(columns)
    print()
    times(columns)
    print()
    confusion(outcomes)
    print(f"\ncommits: {', '.join(dict.fromkeys(o.commit for o in outcomes))}")


#: The rates: a label, of which outcomes, and which of these count.
RATES: tuple[tuple[str, Callable[[Outcome], bool], Callable[[Outcome], bool]], ...] = (
    ("one effect, detectable: named first", lambda o: o.group == "single", lambda o: o.first and o.claimed),
    ("one effect, detectable: in the set that is named", lambda o: o.group == "single",
     lambda o: o.among and o.claimed),
    ("one effect, detectable: right region", lambda o: o.group == "single", lambda o: o.region),
    ("one effect, detectable: held-out chi-square at most 1.3", lambda o: o.group == "single",
     lambda o: o.held_out <= HELD),
    ("two effects: all that is detectable named", lambda o: o.group == "pair", lambda o: o.first and o.claimed),
    ("two effects: one or both named, and none that is not there", lambda o: o.group == "pair",
     lambda o: o.some and not o.wrong),
    ("one or two, detectable: an effect named that is not there", lambda o: o.group in ("single", "pair"),
     lambda o: o.wrong > 0),
    ("nothing concealed: false alarm", lambda o: o.group == "nothing", lambda o: o.claimed),
    ("nothing concealed: unexplained", lambda o: o.group == "nothing", lambda o: o.verdict == UNEXPLAINED),
    ("not detectable: claimed", lambda o: o.group == "below", lambda o: o.claimed),
    ("not detectable: an effect named that is not there", lambda o: o.group == "below", lambda o: o.wrong > 0),
    ("outside, detectable: laid to an effect of the catalogue", lambda o: o.is_seen_outside, lambda o: o.claimed),
    ("outside, detectable: not called explained", lambda o: o.is_seen_outside, lambda o: o.verdict not in EXPLAINED),
    ("outside, detectable: right region", lambda o: o.is_seen_outside, lambda o: o.region),
    ("claimed: a held-out state beyond 1.3", lambda o: o.claimed, lambda o: not o.held_out <= HELD),
    ("claimed: with rivals", lambda o: o.claimed, lambda o: o.rivals > 0),
    ("failed, or not done in time", lambda o: True, lambda o: o.verdict in (NOT_FINISHED, FAILED)),
)


def rates(columns: Mapping[str, Sequence[Outcome]]) -> None:
    """Print the rates, each with its count and its 95 % interval (Wilson 1927)."""
    print(f"{'%':60}" + "".join(f"{name:>30}" for name in columns))
    for label, of, counts in RATES:
        cells = ([counts(o) for o in outcomes if of(o)] for outcomes in columns.values())
        print(f"{label:60}" + "".join(f"{cell(sum(each), len(each)):>30}" for each in cells))
    named = [[o for o in outcomes if o.first] for outcomes in columns.values()]
    print(f"{'95 % intervals of what is named that hold the truth':60}" + "".join(
        f"{cell(sum(o.covered for o in each), sum(o.intervals for o in each)):>30}" for each in named))


def cell(count: int, total: int) -> str:
    """A rate in percent with its count and its 95 % interval."""
    if not total:
        return "-"
    low, high = wilson(count, total)
    return f"{count}/{total} {100.0 * count / total:5.1f} ({100.0 * low:.0f} to {100.0 * high:.0f})"


def wilson(count: int, total: int) -> tuple[float, float]:
    """The 95 % interval of a probability of which `count` of `total` are seen."""
    z, share = 1.959964, count / total
    middle = share + z**2 / (2.0 * total)
    half = z * math.sqrt(share * (1.0 - share) / total + z**2 / (4.0 * total**2))
    return max(0.0, middle - half) / (1.0 + z**2 / total), (middle + half) / (1.0 + z**2 / total)


def times(columns: Mapping[str, Sequence[Outcome]]) -> None:
    """Print processor time by what was concealed, wall time and memory: how many, median, largest."""
    def row(label: str, figures: Sequence[Sequence[float]]) -> None:
        print(f"{label:60}" + "".join(f"{_spread([x for x in each if math.isfinite(x)]):>30}" for each in figures))

    print(f"{'number: median, largest':60}" + "".join(f"{name:>30}" for name in columns))
    for kind in (*KINDS, "all"):
        row(f"processor time, s: {kind}", [[o.seconds for o in outcomes if kind in ("all", o.kind)]
                                           for outcomes in columns.values()])
    row("wall time, s", [[o.wall for o in outcomes] for outcomes in columns.values()])
    row("memory, MB", [[o.memory for o in outcomes] for outcomes in columns.values()])


def _spread(known: Sequence[float]) -> str:
    return f"{len(known)}: {np.median(known):.0f}, {max(known):.0f}" if known else "-"


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


