"""The goal of a design, from GOAL.toml: objectives, variables and constraints.

    [goal]
    chip = "chip.toml"                  # where the search starts; the path is relative to this file
    state = "filled"
    frequency = "energy"                # or "f0", or a frequency, as of a study
    drive = "10 Vpp"                    # or "1 W": a figure per volt or per watt is the figure at that drive
    maximise = "e_ac"                   # or minimise = "focus_time"; two of them give a Pareto front
    constraints = ["trap_offset within 50 um of 0 um", "heating <= 5 K",
                   "substrate.radius - cavity.radius >= 0.8 mm"]

    [variables]
    substrate.thickness = { from = "0.7 mm", to = "1.0 mm", step = "20 um" }    # layers of a printer
    sidewall.thickness = { from = "0.65 mm", to = "0.8 mm" }
    superstrate.thickness = { values = ["0.15 mm", "0.5 mm", "1.0 mm"] }        # stock
    superstrate.material = { materials = ["soda_lime_glass", "borosilicate_glass"] }

    [thermal]
    all = "12 K/W"                      # or of single regions: kelvin per watt lost there

    [search]
    starts = 10
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from geometry.chip import Chip, read_chip
from geometry.operating_point import AT_ENERGY
from geometry.plausible import check_length
from geometry.stretch import moving_together
from materials.registry import Registry
from workbench.design.evaluation import Operation
from workbench.design.figures import FIGURES, LOSS_SHARE, with_parts
from workbench.design.plan import band_key, frequency_key
from workbench.design.requirement import Bound, parse_bounds
from workbench.design.thermal import read_thermal
from workbench.design.variables import (
    MATERIAL,
    MaterialChoice,
    Variable,
    VariedNumber,
    first_name,
    flat_entries,
    read_materials,
)
from workbench.files.errors import InputError, choose, expect
from workbench.files.quantities import ProgramSource, parse_quantity
from workbench.files.tables import FileTable
from workbench.model.drive import Drive, read_drive
from workbench.model.numbers import Law
from workbench.model.problem import fill

#: The objective "largest common factor of all tolerances with which 95 % of the chips satisfy every bound of a figure".
TOLERANCE = "tolerance"

#: Figures of either sign, which can have bounds but not be objectives.
SIGNED = ("trap_offset", "trap_radius")

#: Most combinations of stock lengths and materials that are searched one by one, each on a model of its own. Twice as
#: many take twice the time. With more, stock lengths need one model that covers them all.
ENUMERATED = 12

_EXAMPLE = '{ from = "0.7 mm", to = "1 mm" }, { values = [...] } or { materials = [...] }'


@dataclass(frozen=True)
class DesignObjective:
    """A figure to maximise or minimise."""

    figure: str
    maximise: bool

    def __str__(self) -> str:
        return f"{'largest' if self.maximise else 'smallest'} {self.figure}"


@dataclass(frozen=True)
class SearchOptions:
    """Options of the search for the optimum.

    Each of the ``starts`` evaluates ``looked_at`` random points (the first start also the present chip). Descents begin
    at the best ``descended`` of them, with at most ``evaluations`` each. ``reach`` is the half-width of a model,
    relative to the length in its middle. Within wider bounds models are moved, at most ``moves`` times.
    ``relative_error`` is that of the impedance on them. ``evolutionary`` makes one model over all bounds, stock lengths
    included; ``population`` is the number of chips on a front, and with ``generations`` of an evolution without
    gradients.
    """

    starts: int = 10
    looked_at: int = 32
    descended: int = 3
    seed: int = 0
    evaluations: int = 60
    reach: float = 0.1
    moves: int = 3
    relative_error: float = 1e-3
    evolutionary: bool = False
    population: int = 24
    generations: int = 20


@dataclass(frozen=True)
class Robust:
    """Statistics that replace a figure under the uncertainty of the chip.

    They are its ``quantile`` on the bad side (0.05: the figure that 95 % of the chips reach), or its mean if that is
    None, over ``samples`` draws. The draws are of the tolerances of the chip file, with ``law``; of the uncertainties
    of the ``materials`` if stated; and of the uncertainties from fits, by their files (``posteriors``).
    """

    quantile: float | None = 0.05
    samples: int = 32
    law: Law = "uniform"
    materials: bool = False
    posteriors: tuple[Path, ...] = ()


@dataclass(frozen=True, init=False)
class Goal:
    """A design task with a checked description.

    ``chip`` in ``state`` is the initial one. ``operation`` has its drive and thermal resistances. ``objectives`` are
    one, or two for a Pareto front; ``bounds`` are the constraints. The resonance is searched within ``band`` (Hz).
    Errors are reported under ``source``: the name of the file, or "Goal".
    """

    source: str
    chip: Chip
    state: str
    operation: Operation
    objectives: tuple[DesignObjective, ...]
    variables: tuple[Variable, ...]
    bounds: tuple[Bound, ...]
    band: tuple[float, float] | None
    robust: Robust | None
    search: SearchOptions

    def __init__(
        self,
        chip: Chip,
        variables: Mapping[str, Any],
        *,
        maximise: str | Sequence[str] = (),
        minimise: str | Sequence[str] = (),
        constraints: Sequence[str] = (),
        state: str | None = None,
        drive: Drive | str = "10 Vpp",
        frequency: float | str | None = None,
        band: Sequence[float | str] | None = None,
        thermal: Mapping[str, Any] | None = None,
        robust: Mapping[str, Any] | None = None,
        search: Mapping[str, Any] | None = None,
        registry: Registry | None = None,
        source: str = ProgramSource("Goal"),
    ) -> None:
        """Make a goal from a chip and values of a goal file.

        Numbers without units are SI. `variables`, `thermal`, `robust` and `search` are the tables of the file
        (:mod:`workbench.design.goal`). Alternative materials are looked up in `registry`.

        Raises:
            InputError: the values do not describe a goal.
        """
        expect(chip, Chip, reader="read_chip", source=source, field="chip")
        root = FileTable.made(source, {
            "goal": {"maximise": maximise, "minimise": minimise, "constraints": constraints, "state": state,
                     "drive": drive, "frequency": frequency, "band": band},
            "variables": variables, "thermal": thermal, "robust": robust, "search": search})
        head = root.table("goal")
        chosen = chip.state(None).name
        if "state" in head:
            chosen = head.choice("state", (each.name for each in chip.states))
        options = _search(root.table("search"))
        unknown = tuple(_variables(root.table("variables"), chip, registry or Registry()))
        if not unknown:
            raise root.error("variables",
                             'at least one, such as substrate.thickness = { from = "0.7 mm", to = "1 mm" }')
        driven = read_drive(head)
        first = {name: first_name(chip, name) for name in chip.dimensions()}
        bounds = tuple(bound for index, text in enumerate(head.texts("constraints", ())) for bound in parse_bounds(
            text, first, chip.regions, driven, source=source, field=f"goal.constraints[{index}]"))
        within = band_key(head, chip)
        thermal_resistance = read_thermal(root, chip, (), states=(chosen,), band=within, registry=registry)
        self.__dict__.update(
            source=source, chip=chip, state=chosen, variables=unknown, bounds=bounds, search=options,
            operation=Operation(driven, frequency_key(head, within or chip.band), thermal_resistance).of(
                fill(chip, chosen, registry)),
            objectives=_objectives(head, chip), band=within,
            robust=_robust(root.table("robust")) if "robust" in root else None)
        _check(self)

    @property
    def lengths(self) -> tuple[VariedNumber, ...]:
        return tuple(each for each in self.variables if isinstance(each, VariedNumber) and not each.values)

    @property
    def unknowns(self) -> tuple[VariedNumber, ...]:
        """The lengths that a model varies.

        They include the stock lengths, from end to end, if one model covers all bounds.
        """
        stock = self.stock if self.search.evolutionary else ()
        return (*self.lengths, *(replace(each, values=()) for each in stock))

    @property
    def stock(self) -> tuple[VariedNumber, ...]:
        return tuple(each for each in self.variables if isinstance(each, VariedNumber) and each.values)

    @property
    def figures(self) -> tuple[str, ...]:
        """The figures needed: the resonance, the objectives, and those with bounds."""
        resonance = "peak_frequency" if self.operation.frequency == AT_ENERGY else "f0"
        asked = [resonance, *(each.figure for each in self.objectives if each.figure != TOLERANCE),
                 *(each.figure for each in self.bounds if not each.of_lengths)]
        return tuple(dict.fromkeys(asked))


def read_goal(path: Path | str, *, registry: Registry | None = None) -> Goal:
    """Read the goal described by a TOML file.

    Raises:
        InputError: the file or its chip cannot be read, or does not describe a goal.
    """
    path = Path(path)
    root = FileTable.read(path).only(("goal", "variables", "thermal", "robust", "search"))
    head = root.table("goal").only(("chip", "state", "drive", "frequency", "maximise", "minimise", "constraints",
                                    "band"))
    chip = read_chip(head.path("chip", path.parent, expected="the path of a chip file"))
    said = {key: value for key, value in head.content.items() if key != "chip"}
    tables: dict[str, Any] = {key: root.content.get(key) for key in ("thermal", "robust", "search")}
    return Goal(chip, root.content.get("variables", {}), **said, **tables, registry=registry, source=root.source)


def _objectives(head: FileTable, chip: Chip) -> tuple[DesignObjective, ...]:
    found = []
    known = [*FIGURES, TOLERANCE, *(LOSS_SHARE + region for region in chip.regions)]
    for key in ("maximise", "minimise"):
        value = head.content.get(key, [])
        for name in [value] if isinstance(value, str) else head.texts(key, ()):
            choose(name, known, source=head.source, field=head.at(key))
            if name in SIGNED:
                raise head.error(key, f"a figure that is above zero; bound {name} among the constraints instead")
            found.append(DesignObjective(name, key == "maximise"))
    if len(found) not in (1, 2):
        raise InputError(head.source, head.field, [str(each) for each in found],
                         'maximise = "e_ac" or minimise = "focus_time"; two figures give a Pareto front')
    if len({each.figure for each in found}) < len(found):
        raise InputError(head.source, head.field, found[0].figure, "two different figures")
    if TOLERANCE in (each.figure for each in found) and (len(found) > 1 or not found[0].maximise):
        raise InputError(head.source, head.field, TOLERANCE, f'maximise = "{TOLERANCE}" alone')
    return tuple(found)


def _variables(table: FileTable, chip: Chip, registry: Registry) -> Iterator[Variable]:
    lengths = chip.dimensions()
    known = [*lengths, *(layer.region + MATERIAL for layer in chip.layers)]
    seen: dict[str, str] = {}
    for name, value in flat_entries(table.content):
        inner = FileTable.of(value, source=table.source, field=table.at(name), expected=_EXAMPLE)
        choose(name, known, source=table.source, field=table.at(name))
        for alike in moving_together(chip, name) if name in lengths else (name,):
            if alike in seen:
                raise InputError(table.source, table.at(name), name,
                                 f"one of the two: it coincides with {seen[alike]}, and they change together")
            seen[alike] = name
        inner.only(("from", "to", "step", "values", "materials"))
        if name.endswith(MATERIAL):
            yield MaterialChoice(chip.layer(name.removesuffix(MATERIAL)).region, tuple(read_materials(inner, registry)))
        else:
            found = _length(inner, first_name(chip, name))
            for each in found.values or (found.low, found.high):
                check_length(found.name, each, source=inner.source, field=inner.field, unusual=chip.unusual)
            yield found


def _length(table: FileTable, name: str) -> VariedNumber:
    if "values" in table:
        table.only(("values",))
        listed = table.entries("values", expected='lengths such as ["0.15 mm", "1 mm"]')
        values = [parse_quantity(each, "length", source=table.source, field=table.at(f"values[{index}]"))
                  for index, each in enumerate(listed)]
        if len(set(values)) < max(2, len(values)) or min(values) <= 0.0:
            raise table.error("values", "two or more different lengths above zero")
        return VariedNumber.listed(name, sorted(values))
    table.only(("from", "to", "step"))
    low, high = (table.quantity(key, "length") for key in ("from", "to"))
    if not 0.0 < low < high:
        raise table.error("to", f"a length above that of 'from', {1e3 * low:g} mm, and both above zero")
    step = table.optional_quantity("step", "length")
    if step is not None and not 0.0 < step <= high - low:
        raise table.error("step", f"a step above zero and at most {1e3 * (high - low):g} mm, from end to end")
    return VariedNumber(name, low, high, step)


def _robust(table: FileTable) -> Robust:
    table.only(("quantile", "mean", "samples", "law", "materials", "posteriors"))
    samples = table.whole("samples", Robust.samples, low=8, high=4096)
    if table.flag("mean") and "quantile" in table:
        raise table.error("quantile", "either mean = true or a quantile")
    quantile = None if table.flag("mean") else table.quantity("quantile", "dimensionless", Robust.quantile)
    if quantile is not None and not 1.0 / samples <= quantile <= 0.5:
        raise table.error("quantile", f"a share from {100.0 / samples:.2g} % (one of {samples} samples) to 50 %")
    law: Law = "normal" if table.choice("law", ("uniform", "normal"), "uniform") == "normal" else "uniform"
    folder = Path(table.source).parent
    return Robust(quantile, samples, law, table.flag("materials"),
                  tuple(folder / name for name in table.texts("posteriors", (), expected="files fit.json of fits")))


def _search(table: FileTable) -> SearchOptions:
    table.only(SearchOptions.__dataclass_fields__, renamed={"tolerance": "relative_error"})
    reach, error = (table.quantity(key, "share", getattr(SearchOptions, key)) for key in ("reach", "relative_error"))
    if not 0.0 < reach < 1.0:
        raise table.error("reach", "a share of a length between 0 and 100 %")
    if not 1e-5 <= error <= 0.1:
        raise table.error("relative_error", "a relative error from 0.001 % to 10 %")
    whole: Mapping[str, tuple[int, int]] = {
        "starts": (1, 1000), "looked_at": (1, 4096), "descended": (1, 64), "seed": (0, 2**31 - 1),
        "evaluations": (5, 10_000), "moves": (0, 100), "population": (4, 1000), "generations": (1, 10_000)}
    numbers: dict[str, Any] = {key: table.whole(key, getattr(SearchOptions, key), low=low, high=high)
                               for key, (low, high) in whole.items()}
    return SearchOptions(**numbers, reach=reach, relative_error=error, evolutionary=table.flag("evolutionary"))


def _check(goal: Goal) -> None:
    """Check that the parts of a goal are consistent.

    Raises:
        InputError: heating without thermal resistance, an evolutionary search without lengths, or too many choices.
    """
    asked = set(goal.figures)
    if "heating" in with_parts(asked) and not goal.operation.thermal_resistance:
        raise InputError(goal.source, "thermal", None, 'the resistances that "heating" needs, such as all = "12 K/W"')
    state = goal.chip.state(goal.state)
    trapped = sorted(name for name in asked if name.startswith(("trap_", "axial_", "radial_", "focus_")))
    if trapped and state.particle is None:
        raise InputError(goal.source, "goal.state", goal.state, f"a state that names a particle, for {trapped[0]}")
    if goal.objectives[0].figure == TOLERANCE:
        if all(bound.of_lengths for bound in goal.bounds):
            raise InputError(goal.source, "goal.constraints", None, "figures that the tolerances must leave in bounds")
        if not goal.search.evolutionary:
            raise InputError(goal.source, "search.evolutionary", False, f'true: "{TOLERANCE}" has no slope to follow')
    stock = () if goal.search.evolutionary else goal.stock
    choices = math.prod([len(each.materials) for each in goal.variables if isinstance(each, MaterialChoice)]
                        + [len(each.values) for each in stock])
    if choices > ENUMERATED:
        raise InputError(goal.source, "variables", f"{choices} choices of stock lengths and materials",
                         f"at most {ENUMERATED}; of stock lengths alone more, with evolutionary = true in [search]")
    if len(goal.objectives) > 1 and not goal.search.evolutionary:
        raise InputError(goal.source, "search.evolutionary", False, "true, for a front between two objectives")
    if goal.search.evolutionary and not goal.unknowns:
        raise InputError(goal.source, "search.evolutionary", True, "lengths to vary, besides materials")
