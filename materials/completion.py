"""Completion of a ceramic's constants that its data sheet does not print.

A constant is *printed*, *derived* from the rest of the sheet (:mod:`materials.ceramic_sheet`), or *assumed*. Only those
of shear along the poling may be assumed; they come from another ceramic, which the entry names::

    like = "pzt5a/erturk_2011"
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace

from materials import conversions
from materials.ceramic_sheet import (
    CONSTANTS,
    FIGURES,
    OF_SHEAR,
    Rule,
    Sheet,
    check_signs,
    check_sizes,
    contradictions,
    sheet_figures,
)
from materials.kinds import Material, Piezoelectric
from materials.loss import WORDS
from materials.value import RECORDING, Value
from workbench.files.errors import InputError
from workbench.files.quantities import UNITS, si_unit
from workbench.files.tables import FileTable


class SheetWarning(UserWarning):
    """A ceramic has derived or assumed constants, or contradicts its sheet."""


@dataclass(frozen=True)
class Library:
    """The materials that an entry may name: a loader and a list."""

    load: Callable[[str], Material]
    names: Callable[[], Iterable[str]]


@dataclass(frozen=True)
class StandIn:
    """The ceramic that an entry is ``like``. Its constants are in strain-charge form (real, SI)."""

    name: str
    source: str
    constants: Mapping[str, float]

    @classmethod
    def of(cls, ceramic: Piezoelectric) -> StandIn:
        """The constants of a loaded ceramic."""
        numbers = {name: number.real for name, number in ceramic.parameters().items() if name != "density"}
        found = {name: complex(number).real for name, number in conversions.strain_charge(**numbers).items()}
        return cls(ceramic.name, ceramic.source, found)

    def distance(self, numbers: Mapping[str, float]) -> float:
        """Root mean square of the logarithmic ratios of common constants."""
        ratios = [math.log(abs(numbers[name] / number)) ** 2 for name, number in self.constants.items()
                  if numbers.get(name, 0.0) and number]
        return math.sqrt(sum(ratios) / len(ratios)) if ratios else math.inf


def stand_in(table: FileTable, library: Library | None) -> StandIn | None:
    """The ceramic that an entry names under ``like``, or None.

    Raises:
        InputError: it is not a ceramic, has the other class, or needs another ceramic itself.
    """
    name = table.optional_text("like")
    if name is None:
        return None
    if library is None:
        raise table.error("like", "a ceramic that states all its constants: this one needs another ceramic itself")
    ceramic = library.load(name)
    if not isinstance(ceramic, Piezoelectric):
        raise table.error("like", "a piezoelectric material")
    own = table.text("ceramic", "")
    if own and ceramic.ceramic and own != ceramic.ceramic:
        raise table.error("like", f"a {own} ceramic, as this one; {ceramic.name} is {ceramic.ceramic}")
    return StandIn.of(ceramic)


def nearest(numbers: Mapping[str, float], table: FileTable, library: Library | None) -> StandIn | None:
    """The ceramic with constants nearest to `numbers`, or None. It has the class of the entry."""
    own, found = table.text("ceramic", ""), []
    for name in () if library is None else library.names():
        try:
            ceramic = library.load(name) if library is not None else None
        except InputError:
            continue
        if isinstance(ceramic, Piezoelectric) and ceramic.fit is None and own in ("", ceramic.ceramic):
            found.append(StandIn.of(ceramic))
    return min(found, key=lambda each: each.distance(numbers), default=None)


@dataclass(frozen=True)
class Completion:
    """The missing constants as ``entries`` of a file, and the ``finding``."""

    entries: Mapping[str, dict[str, object]]
    finding: str


def complete(
    table: FileTable, values: Mapping[str, Value], dimensions: Mapping[str, str], library: Library | None, *, name: str
) -> Completion:
    """The strain-charge constants that the sheet of a ceramic does not print.

    Args:
        table: the entry, called `name`.
        values: its numbers.
        dimensions: the dimensions of these.
        library: the materials that it may name.

    Raises:
        InputError: a constant is neither printed nor derivable, nor one of shear with a ceramic under ``like``; signs
            or sizes that no ceramic has; a printed loss beside derived constants.
    """
    printed = {key: value.value.real for key, value in values.items() if key in (*CONSTANTS, *FIGURES, "density")}
    shown = {key: shown_value(values[key], dimensions[key]) for key in printed}
    check_signs(printed, shown, table.source)
    sheet = Sheet(table.source, printed)
    for constant in sheet.missing(each for each in CONSTANTS if each not in OF_SHEAR):
        raise sheet.lacks(constant)
    lacking, like = sheet.missing(OF_SHEAR), stand_in(table, library)
    if lacking and like is None:
        near = nearest(sheet.numbers, table, library)
        named = "" if near is None else f'; like = "{near.name}" takes the nearest ceramic known'
        raise InputError(table.source, lacking[0], None, f"{', '.join(lacking)}, which only shear needs, or like "
                         f"= the name of a ceramic of this class to take {'it' if len(lacking) == 1 else 'them'} from"
                         f"{named}", () if near is None else (near.name,))
    if like is not None and not lacking:
        raise table.error("like", f"no such key: the sheet gives {', '.join(OF_SHEAR)}")
    assert like is not None or not lacking
    assumed = {each: like.constants[each] for each in lacking} if like is not None else {}
    derived = [each for each in CONSTANTS if each in sheet.derived]
    _refuse_losses(table, [*derived, *assumed])
    entries: dict[str, dict[str, object]] = {
        each: {"value": sheet.numbers[each], "unit": si_unit(CONSTANTS[each]),
               "note": f"derived: {_chain(sheet, each)}"}
        for each in derived}
    for each, number in assumed.items():
        assert like is not None
        cited = {} if like.source == RECORDING else {"source": like.source}
        entries[each] = {"value": number, "unit": si_unit(CONSTANTS[each]), "conditions": f"assumed: of {like.name}",
                         **cited}
    parts = [f"printed: {', '.join(each for each in CONSTANTS if each in printed)}"]
    if derived:
        parts.append("derived: " + "; ".join(
            f"{_chain(sheet, each)}, {_shown(sheet.numbers[each], CONSTANTS[each])}" for each in derived))
    if like is not None:
        parts.append(f"assumed as of {like.name}: {', '.join(assumed)}, which only shear needs; the spectrum of a disc "
                     "hardly changes with them")
    return Completion(entries, f"{name} is completed from its data sheet; " + ". ".join(parts))


def check_constants(file: str, values: Mapping[str, Value]) -> None:
    """Raise if strain-charge constants have signs or sizes that no ceramic has."""
    numbers = {key: values[key].value.real for key in CONSTANTS}
    shown = {key: shown_value(values[key], dimension) for key, dimension in CONSTANTS.items()}
    check_signs(numbers, shown, file)
    check_sizes(numbers, shown, file)


def doubts(ceramic: Piezoelectric, values: Mapping[str, Value], form: Collection[str]) -> str:
    """A sentence on contradictory figures and the sign of e31, or "". `values` are those of the entry; `form` names its
    constants."""
    constants, notes = StandIn.of(ceramic).constants, []
    if ceramic.fit is None and constants["d31"] < 0.0 < complex(ceramic.e31).real:
        notes.append(f"e31 is {complex(ceramic.e31).real:.4g} C/m^2 and lead zirconate titanates have e31 < 0 < e33: "
                     "sheets omit the minus sign")
    printed = {key: value for key, value in values.items() if key in FIGURES and key not in form}
    if printed:
        tolerances = {key: value.rounding + (value.uncertainty or 0.0) for key, value in printed.items()}
        found = contradictions({key: value.value.real for key, value in printed.items()}, tolerances,
                               sheet_figures(constants, ceramic.density))
        notes += ["figures of the sheet contradict its constants, which are used: " + "; ".join(found)] if found else []
    return f"{ceramic.name}: {'. '.join(notes)}" if notes else ""


def announce(findings: Iterable[str], notes: list[str] | None) -> None:
    """Append findings that are not empty to `notes`, or warn of them."""
    for finding in filter(None, findings):
        if notes is not None:
            notes.append(finding)
        else:
            warnings.warn(finding, SheetWarning, stacklevel=6)


def as_printed(values: Mapping[str, Value]) -> dict[str, Value]:
    """The values of a sheet before completion, noted as printed."""
    return {key: replace(value, note=f"printed; {value.note}".removesuffix("; ")) if key in CONSTANTS else value
            for key, value in values.items()}


def shown_value(value: Value, dimension: str) -> str:
    """A number in the unit of its file."""
    factor = UNITS[dimension].get(value.unit, 1.0)
    return f"{value.value.real / factor:.4g} {value.unit}".removesuffix(" 1")


def _shown(number: float, dimension: str) -> str:
    """A derived number in the usual unit of data sheets."""
    unit = {"compliance": "1/TPa", "piezoelectric charge": "pC/N"}.get(dimension, "1")
    return f"{number / UNITS[dimension][unit]:.4g} {unit}".removesuffix(" 1")


def _chain(sheet: Sheet, constant: str) -> str:
    """The rules for a constant and for the figures in them."""
    rules: list[Rule] = [sheet.derived[constant]]
    for rule in rules:
        rules += [sheet.derived[need] for need in rule.needs if need in sheet.derived and need not in CONSTANTS
                  and sheet.derived[need] not in rules]
    return ", ".join(map(str, rules))


def _refuse_losses(table: FileTable, made: list[str]) -> None:
    """Raise if a printed constant has a loss while others are derived."""
    for key in CONSTANTS if made else ():
        entry = table.content.get(key)
        if isinstance(entry, Mapping) and any(word in entry for word in WORDS):
            raise InputError(table.source, key, "a loss of its own", "mechanical_q and dielectric_loss_tangent for all "
                             f"constants, because {', '.join(made)} are not printed")
