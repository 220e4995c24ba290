"""Input uncertainty of a chip: tolerances of its file, uncertainties of its materials, fits, and a person's own
statements, each taking the place of those before it.

A statement is a text, ``superstrate.thickness = 20 um``: of a length its limits, of a coefficient its standard
uncertainty. ``uniform`` or ``normal`` behind it make either a limit, ``standard`` a standard uncertainty; per cents are
of the number itself, ``exact`` leaves it certain, and ``assumed`` gives a length the uncertainty of its role
(`geometry.assumed`), such as a factor of three of a film of gel. In a TOML file the statements stand in a table::

    [uncertainty]
    "superstrate.thickness" = "20 um"
    "pla/acevedo_2026.shear_modulus" = "5 %"
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from geometry.assumed import is_film
from geometry.chip import Chip
from geometry.stretch import admissible_range, canonical_names
from materials.assumed import with_assumed_loss
from materials.kinds import Fluid, Material
from materials.registry import Registry
from workbench.design.model import all_of_one_length
from workbench.design.uncertainty import Uncertainty, known_as
from workbench.design.variables import flat_entries
from workbench.files.errors import InputError, choose, nearest_names
from workbench.files.quantities import parse_quantity
from workbench.files.tables import FileTable, parse_json
from workbench.model.device_numbers import ASSUMED, assumed_by_role, device_numbers, full_names
from workbench.model.numbers import BENCH, LOSS, Law, Number, ParameterName, Stated, limits, placed
from workbench.model.problem import FilledChip, fill

#: Of a fluid, what the model holds as a number of its own; its losses follow from others.
FLUID_NUMBERS = ("density", "sound_speed")

_STATEMENT = re.compile(r"\s*(?P<name>[^=\s]+)\s*=\s*(?P<amount>.*?)\s*")
#: An amount, and the word behind its unit: what follows a bare number is a unit.
_AMOUNT = re.compile(r"(?P<amount>.*?)(?:(?<=[^\d\s])\s+(?P<word>[A-Za-z]{5,}))?")
_WORDS = (*get_args(Law), "standard")


@dataclass(frozen=True)
class Statement:
    """A person's word on the uncertainty of a number: its ``name`` and ``amount`` as written, and where."""

    name: str
    amount: str
    source: str
    field: str


def parse_statement(text: str, *, source: str = "command line", field: str = "--uncertainty") -> Statement:
    """The statement ``name = amount``.

    Raises:
        InputError: it has no name or no amount.
    """
    found = _STATEMENT.fullmatch(text)
    if found is None or not found["amount"]:
        raise InputError(source, field, text, 'a name and its uncertainty, such as "superstrate.thickness = 20 um"')
    return Statement(found["name"], found["amount"], source, f"{field} {found['name']}")


def read_statements(path: Path) -> tuple[Statement, ...]:
    """The statements of the ``[uncertainty]`` table of a TOML file.

    Raises:
        InputError: no such file or table, or an amount that is no text.
    """
    root = FileTable.read(path).only(("uncertainty",))
    root.required("uncertainty", "a table [uncertainty] of names and amounts")
    found = []
    for name, amount in flat_entries(root.table("uncertainty").content, of_tables=False):
        if not isinstance(amount, str):
            raise InputError(str(path), f"uncertainty.{name}", amount, 'a text, such as "20 um"')
        found.append(Statement(name, amount, str(path), f"uncertainty.{name}"))
    return tuple(found)


def stated_uncertainty(
    chip: Chip,
    state: str | None = None,
    *,
    registry: Registry | None = None,
    law: Law = "uniform",
    statements: Sequence[Statement | str] = (),
    posteriors: Sequence[Path | str] = (),
) -> Uncertainty:
    """The input uncertainty of a chip in a state.

    Args:
        law: what a tolerance is: the limits of a uniform law, or three standard deviations of a normal one.
        statements: a person's own word, which goes before everything else.
        posteriors: files ``fit.json`` of fits with intervals, whose numbers, uncertainties and correlations go before
            those of the chip file and of the registry.

    Raises:
        InputError: a tolerance, a posterior or a statement that cannot be used.
    """
    device = fill(chip, state, registry)
    given = [parse_statement(each) if isinstance(each, str) else each for each in statements]
    known = device_numbers(chip, device.materials.values())
    found = _of_files(device, known, law)
    known = {name: each for name, each in known.items() if _is_felt(each, device)}
    for path in posteriors:
        _posterior(Path(path), device, known, found)
    for each in given:
        _say(each, device, known, law, found)
    said = {_meant(each, device, known) for each in given}
    for name, number in known.items():
        if number.stated is None and number.is_dimension and is_film(name) and name not in {*found.inputs, *said}:
            found.notes.append(f"{name} is taken as exact, since the chip file states no tolerance, but "
                               f"{number.known.assumed}: \"{name} = {ASSUMED}\" counts with that")
    return found.uncertainty(device)


def uncertainty_of_files(device: FilledChip, law: Law = "uniform") -> Uncertainty:
    """The uncertainty that the chip's file and its materials state: tolerances, uncertainties and their correlations.

    Raises:
        InputError: a tolerance or an uncertainty that cannot be used.
    """
    return _of_files(device, device_numbers(device.chip, device.materials.values()), law).uncertainty(device)


def _of_files(device: FilledChip, numbers: Mapping[str, Number], law: Law) -> _Collected:
    found = _Collected()
    for each in numbers.values():
        if each.is_dimension and each.tolerance and each.name.startswith("ports."):
            found.notes.append(f"{each.name}: no figure depends on it")
        elif each.is_dimension and each.tolerance:
            found.put(known_as(each, Stated.within(each.half_width, law, origin=each.origin),
                               admissible_range(device.chip, each.name)))
    for material in {each.name: each for each in device.materials.values()}.values():
        _coefficients(material, device, numbers, found)
    return found


def numbers_of(device: FilledChip) -> dict[str, float]:
    """Every number (SI) that figures depend on, by name: lengths, radii that coincide once; moduli, densities, losses.

    A loss that is zero is there, but those of densities and of fluids are not.
    """
    return {name: each.value for name, each in device_numbers(device.chip, device.materials.values()).items()
            if _is_felt(each, device)}


def _is_felt(number: Number, device: FilledChip) -> bool:
    """Whether figures depend on a number."""
    if number.is_dimension:
        return not number.name.startswith("ports.")
    if any(isinstance(each, Fluid) and each.name == number.parsed.owner for each in device.materials.values()):
        return number.parsed.local in FLUID_NUMBERS
    return number.parsed.local != f"density{LOSS}"


@dataclass
class _Collected:
    """Inputs by name, the correlations between pairs of them, and notes on numbers left out."""

    inputs: dict[str, Number] = field(default_factory=dict)
    correlations: dict[tuple[str, str], float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def put(self, new: Number) -> None:
        """Take an input in the place of the one there was, correlations included."""
        self.drop(new.name)
        self.inputs[new.name] = new

    def drop(self, name: str) -> None:
        """Forget an input and its correlations."""
        self.inputs.pop(name, None)
        self.correlations = {pair: each for pair, each in self.correlations.items() if name not in pair}

    def correlate(self, names: Sequence[str], rows: Sequence[Sequence[float]]) -> None:
        """Take the correlations between inputs, of a matrix with a row and a column for each name."""
        self.correlations |= {
            (one, other): rows[i][j] for i, one in enumerate(names) for j, other in enumerate(names)
            if i != j and one in self.inputs and other in self.inputs}

    def uncertainty(self, device: FilledChip) -> Uncertainty:
        names = list(self.inputs)
        matrix = np.eye(len(names))
        for (one, other), each in self.correlations.items():
            matrix[names.index(one), names.index(other)] = each
        lossy = {ParameterName.parse(name).owner for name in names if name.endswith(LOSS)}
        return Uncertainty(tuple(self.inputs.values()), matrix,
                           {each.name: each for each in device.materials.values()
                            if each.name in lossy and not isinstance(each, Fluid)},
                           tuple(dict.fromkeys(self.notes)))


def _coefficients(
    material: Material, device: FilledChip, numbers: Mapping[str, Number], found: _Collected
) -> None:
    """The uncertainties of a registry entry, with the correlation that a fit left among its numbers."""
    left_out = []
    for real, value in material.values.items():
        for key, spread in ((real, value.uncertainty), (real + LOSS, value.loss_uncertainty)):
            number = numbers.get(f"{material.name}.{key}")
            if number is not None and number.stated is not None and _is_felt(number, device):
                found.put(known_as(number, number.stated))
            elif spread:
                left_out.append(key)
    if left_out:
        found.notes.append(f"{material.name}: the uncertainty of {', '.join(left_out)} is left out: no number of the "
                           "model")
    if material.fit is not None and material.fit.correlation is not None:
        stored = material.fit.correlation
        found.correlate([f"{material.name}.{name.replace(' loss', LOSS)}" for name in stored.names], stored.rows)


def _posterior(path: Path, device: FilledChip, known: Mapping[str, Number], found: _Collected) -> None:
    """The numbers, standard uncertainties and correlations of a fit; what belongs to its bench is averaged over."""
    table = _read_fit(path)
    names, rows = _correlation(table)
    own = table.text("material", ""), table.content.get("saved_as")
    here = dict.fromkeys(names, "")
    for each in table.tables("parameters", expected="the parameters of a fit"):
        stated, mean, spread = each.text("name"), each.optional_number("value"), each.optional_number("standard_error")
        if stated.startswith(BENCH):
            continue
        name = _name_here(stated, own, device, found)
        if not name:
            continue
        if mean is None or spread is None or not spread > 0.0:
            raise each.error("standard_error", f"a standard uncertainty of {stated}: a fit with intervals, which those "
                             "of the paper's algorithms are not")
        if stated not in names:
            raise InputError(table.source, "correlation.names", stated, "a row for every parameter of the fit")
        choose(name, known, source=table.source, field=each.field)
        ends = admissible_range(device.chip, name) if known[name].is_dimension else None
        found.put(known_as(_at(known[name], mean), Stated(spread, origin=str(path)), ends))
        here[stated] = name
    if not any(here.values()):
        raise InputError(table.source, "parameters", own[0], "a fit of a material of the chip: "
                         + ", ".join(sorted({m.name for m in device.materials.values()})))
    found.correlate([here[name] for name in names], rows)


def _read_fit(path: Path) -> FileTable:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise InputError(str(path), "file", str(error), "a fit.json of workbench fit") from None
    content = parse_json(text, source=str(path), expected="a fit.json of workbench fit")
    return FileTable.of(content, source=str(path), field="", expected="a fit.json of workbench fit")


def _correlation(table: FileTable) -> tuple[tuple[str, ...], list[list[float]]]:
    """Names and rows of the correlation of a fit, symmetric with ones on the diagonal.

    Raises:
        InputError: no matrix of finite numbers.
    """
    inner = table.table("correlation")
    names, rows = inner.texts("names"), inner.content.get("rows")
    try:
        matrix = np.array(rows, dtype=float)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != (len(names), len(names)) or not np.isfinite(matrix).all():
        raise inner.error("rows", f"{len(names)} rows of {len(names)} finite numbers: a fit with intervals")
    matrix = np.clip(0.5 * (matrix + matrix.T), -1.0, 1.0)
    np.fill_diagonal(matrix, 1.0)
    return names, matrix.tolist()


def _name_here(stated: str, own: tuple[str, Any], device: FilledChip, found: _Collected) -> str:
    """The name that a number of a fit has on this chip, whose material may be there as it was saved. Empty where the
    chip has no such number."""
    parsed, present = ParameterName.parse(stated), {each.name for each in device.materials.values()}
    if parsed.is_dimension:
        first = canonical_names(device.chip)
        if stated in device.chip.dimensions():
            return first.get(stated, stated)
    elif parsed.owner in present:
        return stated
    elif parsed.owner == own[0] and own[1] in present:
        return f"{own[1]}.{parsed.local}"
    found.notes.append(f"{stated}: the chip has no such number, it is averaged over")
    return ""


def _at(number: Number, value: float) -> Number:
    """A number with another value."""
    low, high = limits(number.name, value)
    return replace(number, value=value, low=low, high=high)


def _say(each: Statement, device: FilledChip, known: Mapping[str, Number], law: Law, found: _Collected) -> None:
    name = _meant(each, device, known)
    number = _at(known[name], found.inputs[name].value if name in found.inputs else known[name].value)
    match = _AMOUNT.fullmatch(each.amount)
    assert match is not None
    amount, word = match["amount"], match["word"] or (law if number.is_dimension else "standard")
    if any(name in pair for pair in found.correlations):
        found.notes.append(f"{name}: {each.source} goes before what a fit says of it, correlations included")
    if each.amount == "exact":
        found.drop(name)
        return
    if each.amount == ASSUMED:
        if not number.is_dimension:
            raise InputError(each.source, each.field, each.amount, f"an uncertainty of {name}: only lengths have one "
                             "that is assumed by the role of their layer")
        length = replace(known[name], stated=None).known
        found.put(known_as(number, assumed_by_role(name, known[name].value, known[name].material),
                           admissible_range(device.chip, name, length.low, length.high)))
        return
    choose(word, _WORDS, source=each.source, field=each.field)
    if amount.endswith("%"):
        spread = parse_quantity(amount, "dimensionless", source=each.source, field=each.field) * abs(number.value)
    else:
        spread = parse_quantity(amount, number.parsed.quantity, source=each.source, field=each.field)
    if not spread > 0.0:
        raise InputError(each.source, each.field, each.amount, 'an amount above zero, or "exact"'
                         + (": the number is 0, give an amount with its unit" if number.value == 0.0 else ""))
    stated = Stated(spread, origin=each.source) if word == "standard" else Stated.within(
        spread, "normal" if word == "normal" else "uniform", origin=each.source)
    found.put(known_as(number, stated, admissible_range(device.chip, name) if number.is_dimension else None))


def _meant(each: Statement, device: FilledChip, known: Mapping[str, Number]) -> str:
    """The number that a statement is about: a material may be named without its source where it is the only one."""
    first = canonical_names(device.chip)
    name = first.get(each.name, each.name)
    if name in known:
        return name
    full = full_names(name, (m.name for m in device.materials.values()))
    if len(full) == 1 and full[0] in known:
        return full[0]
    if len(full) > 1:
        raise InputError(each.source, each.field, each.name, f"one of {', '.join(full)}")
    short = {one.partition("/")[0] + "." + one.partition(".")[2]: one for one in known if "/" in one}
    near = nearest_names(each.name, [*known, *short])
    raise InputError(each.source, each.field, each.name, "a number that figures depend on: " + ", ".join(known),
                     tuple(dict.fromkeys(short.get(one, one) for one in near)))


@dataclass(frozen=True)
class CentredRegistry(Registry):
    """A registry whose materials have other ``numbers`` (SI, by parameter name) than their entries."""

    numbers: Mapping[str, float] = field(default_factory=dict)

    def load(self, name: str, *, temperature: float | None = None, notes: list[str] | None = None) -> Material:
        """The material called `name`, with the numbers that are stated of it in the place of its own."""
        material = super().load(name, temperature=temperature, notes=notes)
        if self.assumed_losses:  # the numbers are those of the ceramic as it is simulated
            material, _ = with_assumed_loss(material)
        mine = {key: number for key, number in self.numbers.items() if ParameterName.parse(key).owner == material.name}
        before = {f"{material.name}.{key}": value for key, value in material.parameters().items()}
        after = placed(before, mine)
        changed: dict[str, Any] = {}
        for key, value in after.items():
            if value != before[key]:
                coefficient = key.removeprefix(f"{material.name}.")
                kept_real = isinstance(getattr(material, coefficient), float)
                changed[coefficient] = value.real if kept_real else value
        return replace(material, **changed) if changed else material


def centred_chip(chip: Chip, registry: Registry | None, numbers: Mapping[str, float]) -> tuple[Chip, Registry]:
    """`chip` and `registry` with `numbers` (SI, by parameter name) in the place of their own."""
    known = chip.dimensions()
    lengths = {name: number for name, number in numbers.items()
               if ParameterName.parse(name).is_dimension and number != known[name].value}
    others = {name: number for name,
              number in numbers.items() if not ParameterName.parse(name).is_dimension}
    moved = chip.with_dimensions(all_of_one_length(chip, lengths)) if lengths else chip
    registry = registry or Registry()
    return moved, CentredRegistry(registry.folders, registry.assumed_losses, registry.inviscid, others)
