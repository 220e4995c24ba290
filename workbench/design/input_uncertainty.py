"""Input uncertainty of a chip, from its file, materials, fits and statements.

Each source replaces those before it: the tolerances of the chip file, the uncertainties of its materials, fits, and the
user's own statements. A statement is a text, ``superstrate.thickness = 20 um``: the limits of a length, or the standard
uncertainty of a coefficient. A final ``uniform`` or ``normal`` makes it a limit, ``standard`` a standard uncertainty.
Per cents are of the number itself. ``exact`` makes it certain, and ``assumed`` gives a length the uncertainty of its
role (`geometry.assumed`), such as a factor of three of a film of gel. In a TOML file the statements are a table::

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

#: The parameters of a fluid in the model; its losses follow from others.
FLUID_NUMBERS = ("density", "sound_speed")

_STATEMENT = re.compile(r"\s*(?P<name>[^=\s]+)\s*=\s*(?P<amount>.*?)\s*")
#: An amount, and the word after its unit: a word after a bare number is a unit.
_AMOUNT = re.compile(r"(?P<amount>.*?)(?:(?<=[^\d\s])\s+(?P<word>[A-Za-z]{5,}))?")
_WORDS = (*get_args(Law), "standard")


@dataclass(frozen=True)
class Statement:
    """A user's statement of the uncertainty of a number.

    ``name`` and ``amount`` are as written, in ``field`` of ``source``.
    """

    name: str
    amount: str
    source: str
    field: str


def parse_statement(text: str, *, source: str = "command line", field: str = "--uncertainty") -> Statement:
    """Parse the statement ``name = amount``.

    Raises:
        InputError: it has no name or no amount.
    """
    found = _STATEMENT.fullmatch(text)
    if found is None or not found["amount"]:
        raise InputError(source, field, text, 'a name and its uncertainty, such as "superstrate.thickness = 20 um"')
    return Statement(found["name"], found["amount"], source, f"{field} {found['name']}")


def read_statements(path: Path) -> tuple[Statement, ...]:
    """Read the table ``[uncertainty]`` of a TOML file.

    Raises:
        InputError: no such file or table, or an amount that is not a text.
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
        law: "uniform" if a tolerance is a limit, "normal" if it is three standard deviations.
        statements: the user's own, which replace everything else.
        posteriors: files ``fit.json`` of fits with intervals. Their numbers, uncertainties and correlations replace
            those of the chip file and of the registry.

    Raises:
        InputError: a tolerance, a posterior or a statement that cannot be used.
    """
    device = fill(chip, state, registry)
    given = [parse_statement(each) if isinstance(each, str) else each for each in statements]
    found = _Collected.of_files(device, law)
    for path in posteriors:
        found.take_posterior(Path(path))
    for each in given:
        found.take_statement(each)
    said = {found.name_of(each) for each in given}
    for name, number in found.felt.items():
        if number.stated is None and number.is_dimension and is_film(name) and name not in {*found.inputs, *said}:
            found.notes.append(f"{name} is taken as exact, since the chip file states no tolerance, but "
                               f"{number.known.assumed}: \"{name} = {ASSUMED}\" counts with that")
    return found.uncertainty


def uncertainty_of_files(device: FilledChip, law: Law = "uniform") -> Uncertainty:
    """The uncertainty stated by the chip's file and its materials.

    It has tolerances, uncertainties and their correlations.

    Raises:
        InputError: a tolerance or an uncertainty that cannot be used.
    """
    return _Collected.of_files(device, law).uncertainty


def numbers_of(device: FilledChip) -> dict[str, float]:
    """Every number (SI) that figures depend on, by name.

    These are lengths (radii that coincide once), moduli, densities and losses. Losses of zero are included, but not the
    losses of densities and of fluids.
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
    """The uncertain numbers of a ``device``, collected from several sources.

    ``felt`` are all numbers that figures depend on, by name, and ``inputs`` the uncertain ones among them. ``law`` is
    that of a tolerance. ``correlations`` are those of pairs of inputs. ``notes`` name the numbers that are left out.
    """

    device: FilledChip
    law: Law
    felt: dict[str, Number]
    inputs: dict[str, Number] = field(default_factory=dict)
    correlations: dict[tuple[str, str], float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    @classmethod
    def of_files(cls, device: FilledChip, law: Law) -> _Collected:
        """The tolerances of the chip file and the uncertainties of its materials."""
        numbers = device_numbers(device.chip, device.materials.values())
        found = cls(device, law, {name: each for name, each in numbers.items() if _is_felt(each, device)})
        for each in numbers.values():
            if each.is_dimension and each.tolerance and each.name not in found.felt:
                found.notes.append(f"{each.name}: no figure depends on it")
            elif each.is_dimension and each.tolerance:
                found.put(each, Stated.within(each.half_width, law, origin=each.origin))
        for material in {each.name: each for each in device.materials.values()}.values():
            left_out = []
            for real, value in material.values.items():
                for key, spread in ((real, value.uncertainty), (real + LOSS, value.loss_uncertainty)):
                    number = found.felt.get(f"{material.name}.{key}")
                    if number is not None and number.stated is not None:
                        found.put(number, number.stated)
                    elif spread:
                        left_out.append(key)
            if left_out:
                found.notes.append(f"{material.name}: the uncertainty of {', '.join(left_out)} is left out: no number "
                                   "of the model")
            if material.fit is not None and material.fit.correlation is not None:
                stored = material.fit.correlation
                found.correlate([f"{material.name}.{name.replace(' loss', LOSS)}" for name in stored.names],
                                stored.rows)
        return found

    def put(self, number: Number, stated: Stated, ends: tuple[float, float] | None = None) -> None:
        """Add an uncertain number; it replaces the present input and its correlations.

        Lengths stay within `ends` (m), by default within the range where the chip stays valid.
        """
        self.drop(number.name)
        if ends is None and number.is_dimension:
            ends = admissible_range(self.device.chip, number.name)
        self.inputs[number.name] = known_as(number, stated, ends)

    def drop(self, name: str) -> None:
        """Remove an input and its correlations."""
        self.inputs.pop(name, None)
        self.correlations = {pair: each for pair, each in self.correlations.items() if name not in pair}

    def correlate(self, names: Sequence[str], rows: Sequence[Sequence[float]]) -> None:
        """Add the correlations between inputs from a matrix.

        It has a row and a column for each of the `names`.
        """
        self.correlations |= {
            (one, other): rows[i][j] for i, one in enumerate(names) for j, other in enumerate(names)
            if i != j and one in self.inputs and other in self.inputs}

    @property
    def uncertainty(self) -> Uncertainty:
        names = list(self.inputs)
        matrix = np.eye(len(names))
        for (one, other), each in self.correlations.items():
            matrix[names.index(one), names.index(other)] = each
        lossy = {ParameterName.parse(name).owner for name in names if name.endswith(LOSS)}
        return Uncertainty(tuple(self.inputs.values()), matrix,
                           {each.name: each for each in self.device.materials.values()
                            if each.name in lossy and not isinstance(each, Fluid)},
                           tuple(dict.fromkeys(self.notes)))

    def take_posterior(self, path: Path) -> None:
        """Add the numbers, standard uncertainties and correlations of a fit.

        Numbers of the fit's bench are averaged over.
        """
        table = _read_fit(path)
        names, rows = _correlation(table)
        own = table.text("material", ""), table.content.get("saved_as")
        here = dict.fromkeys(names, "")
        for each in table.tables("parameters", expected="the parameters of a fit"):
            stated, mean = each.text("name"), each.optional_number("value")
            spread = each.optional_number("standard_error")
            name = "" if stated.startswith(BENCH) else self._name_here(stated, own)
            if not name:
                continue
            if mean is None or spread is None or not spread > 0.0:
                raise each.error("standard_error", f"a standard uncertainty of {stated}: a fit with intervals, which "
                                 "those of the paper's algorithms are not")
            if stated not in names:
                raise InputError(table.source, "correlation.names", stated, "a row for every parameter of the fit")
            choose(name, self.felt, source=table.source, field=each.field)
            self.put(_at(self.felt[name], mean), Stated(spread, origin=str(path)))
            here[stated] = name
        if not any(here.values()):
            raise InputError(table.source, "parameters", own[0], "a fit of a material of the chip: "
                             + ", ".join(sorted({m.name for m in self.device.materials.values()})))
        self.correlate([here[name] for name in names], rows)

    def _name_here(self, stated: str, own: tuple[str, Any]) -> str:
        """The name that a number of a fit has on this chip.

        The fit's material may be present under its saved name. The name is empty if the chip has no such number.
        """
        parsed, present = ParameterName.parse(stated), {each.name for each in self.device.materials.values()}
        if parsed.is_dimension:
            if stated in self.device.chip.dimensions():
                return canonical_names(self.device.chip).get(stated, stated)
        elif parsed.owner in present:
            return stated
        elif parsed.owner == own[0] and own[1] in present:
            return f"{own[1]}.{parsed.local}"
        self.notes.append(f"{stated}: the chip has no such number, it is averaged over")
        return ""

    def take_statement(self, each: Statement) -> None:
        """Add a user's statement; it replaces every other source."""
        name = self.name_of(each)
        known = self.felt[name]
        number = _at(known, self.inputs.get(name, known).value)
        match = _AMOUNT.fullmatch(each.amount)
        assert match is not None
        amount, word = match["amount"], match["word"] or (self.law if number.is_dimension else "standard")
        if any(name in pair for pair in self.correlations):
            self.notes.append(f"{name}: {each.source} replaces the values of a fit, correlations included")
        if each.amount == "exact":
            self.drop(name)
            return
        if each.amount == ASSUMED:
            if not number.is_dimension:
                raise InputError(each.source, each.field, each.amount, f"an uncertainty of {name}: only lengths have "
                                 "one that is assumed by the role of their layer")
            length = replace(known, stated=None).known
            self.put(number, assumed_by_role(name, known.value, known.material),
                     admissible_range(self.device.chip, name, length.low, length.high))
            return
        choose(word, _WORDS, source=each.source, field=each.field)
        relative = amount.endswith("%")
        spread = parse_quantity(amount, "dimensionless" if relative else number.parsed.quantity, source=each.source,
                                field=each.field) * (abs(number.value) if relative else 1.0)
        if not spread > 0.0:
            raise InputError(each.source, each.field, each.amount, 'an amount above zero, or "exact"'
                             + (": the number is 0, give an amount with its unit" if number.value == 0.0 else ""))
        self.put(number, Stated(spread, origin=each.source) if word == "standard" else Stated.within(
            spread, "normal" if word == "normal" else "uniform", origin=each.source))

    def name_of(self, each: Statement) -> str:
        """The name of the number that a statement describes.

        A material may be named without its source if only one material has that name.
        """
        name = canonical_names(self.device.chip).get(each.name, each.name)
        if name in self.felt:
            return name
        full = full_names(name, (m.name for m in self.device.materials.values()))
        if len(full) == 1 and full[0] in self.felt:
            return full[0]
        if len(full) > 1:
            raise InputError(each.source, each.field, each.name, f"one of {', '.join(full)}")
        short = {one.partition("/")[0] + "." + one.partition(".")[2]: one for one in self.felt if "/" in one}
        near = nearest_names(each.name, [*self.felt, *short])
        raise InputError(each.source, each.field, each.name, "a number that figures depend on: " + ", ".join(self.felt),
                         tuple(dict.fromkeys(short.get(one, one) for one in near)))


def _at(number: Number, value: float) -> Number:
    """A number with another value."""
    low, high = limits(number.name, value)
    return replace(number, value=value, low=low, high=high)


def _read_fit(path: Path) -> FileTable:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise InputError(str(path), "file", str(error), "a fit.json of workbench fit") from None
    content = parse_json(text, source=str(path), expected="a fit.json of workbench fit")
    return FileTable.of(content, source=str(path), field="", expected="a fit.json of workbench fit")


def _correlation(table: FileTable) -> tuple[tuple[str, ...], list[list[float]]]:
    """The names and rows of a fit's correlation matrix.

    It is made symmetric with ones on the diagonal.

    Raises:
        InputError: it is not a matrix of finite numbers.
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


@dataclass(frozen=True)
class CentredRegistry(Registry):
    """A registry with other ``numbers`` (SI, by parameter name) for its materials."""

    numbers: Mapping[str, float] = field(default_factory=dict)

    def load(self, name: str, *, temperature: float | None = None, notes: list[str] | None = None) -> Material:
        """Load the material `name`, with ``numbers`` in place of its own."""
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
    """`chip` and `registry` with `numbers` (SI) in place of their own.

    `numbers` are by parameter name.
    """
    known = chip.dimensions()
    lengths = {name: number for name, number in numbers.items()
               if ParameterName.parse(name).is_dimension and number != known[name].value}
    others = {name: number for name,
              number in numbers.items() if not ParameterName.parse(name).is_dimension}
    moved = chip.with_dimensions(all_of_one_length(chip, lengths)) if lengths else chip
    registry = registry or Registry()
    return moved, CentredRegistry(registry.folders, registry.assumed_losses, registry.inviscid, others)
