"""Tables of focusing over frequency: times, rates or energy densities.

The headings state the columns and their units; a voltage and an uncertainty may stand beside. A table with an impedance
is none. Commas, semicolons or tabs divide the columns, and decimal commas are read with the latter two.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.files.quantities import UNITS
from workbench.readers.headings import understand
from workbench.readers.tables import Table
from workbench.readers.text import (
    RecordingText,
    cells,
    holds_no_value,
    is_cell,
    is_number,
    load_text,
    uncommented,
    value_of,
)
from workbench.results.energy_recording import ENERGY_DENSITY, FOCUSING_TIME, EnergyRecording

#: Lines in which headings are looked for. Doubled, a recording of impedance takes a hundredth of a second longer.
HEADED_WITHIN = 50

Real = NDArray[np.float64]

#: The end of the message about a cell that holds no time or energy density.
REMEDY = '; where particles did not focus, leave the cell empty, or write inf or "no focus"'

_SECONDS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
#: Factors to SI of the units of every column, in the spelling of :func:`_unit`.
UNITS_OF: Mapping[str, Mapping[str, float]] = {
    "frequency": UNITS["frequency"],
    "time": _SECONDS,
    "rate": {spelling: 1.0 / factor for unit, factor in _SECONDS.items() for spelling in (f"1/{unit}", f"{unit}-1")},
    "energy": {"J/m3": 1.0, "Jm-3": 1.0, "mJ/m3": 1e-3, "kJ/m3": 1e3, "Pa": 1.0, "kPa": 1e3},
    "voltage": {"Vpp": 1.0, "mVpp": 1e-3},
}
#: Names of the columns and of their units, for messages.
_NAMES: Mapping[str, tuple[str, str]] = {
    "frequency": ("frequency", "Hz, kHz, MHz or GHz"), "time": ("focusing time", "s, ms, us or min"),
    "rate": ("rate of focusing", "1/s, 1/ms or 1/min"),
    "energy": ("energy density", "J/m^3, mJ/m^3, kJ/m^3 or Pa, or one of these per Vpp^2"),
    "voltage": ("voltage", "Vpp or mVpp, peak to peak at the electrodes"), "uncertainty": ("uncertainty", "%"),
}
#: The columns that hold focusing, of which a table has one.
_FOCUS = ("time", "rate", "energy")
_FOCUSING = (r"t ?\*|t ?foc(?:us(?:s?ing)?)?|focus(?:s?ing)?(?: time| duration)?(?: t ?\*?)?|"
             r"time (?:to|of|for) focus(?:s?ing)?|fokussier(?:ungs)?zeit")
#: Words of a column by its role. The second pattern counts with a unit of the role, beside columns that are all known.
_WORDS: Mapping[str, tuple[str, str]] = {
    "time": (_FOCUSING, "t|time|zeit"),
    "rate": (rf"1 ?/ ?\(?(?:{_FOCUSING})\)?|focus(?:s?ing)? rate|rate of focus(?:s?ing)?", "1 ?/ ?t|rate"),
    "energy": ("(?:mean |average |acoustic |sound )*(?:e ?ac|energy density(?: e ?ac)?|energiedichte)", "e|<e>"),
    "voltage": ("(?:applied |drive |driving |transducer |electrode )?(?:voltage|u|v|spannung)(?: [uv])?"
                "(?: ?pp| ?p-p| peak[ -]to[ -]peak)?", "amplitude"),
}
_UNCERTAIN = re.compile(r"\b(?:uncertainty|sigma|sd|std|stdev|stddev|error|err|deviation|unsicherheit|fehler)\b|±|σ")
_PER_SQUARE_VOLT = re.compile(r" ?(?:/|per) ?\(?[uv] ?(?:pp)? ?2\)?$")
_UNIT_PER_SQUARE_VOLT = re.compile("(.*?)(?:/|per)?Vpp-?2")
_BRACKETED = re.compile(r"(.*?)\s*[(\[{](.*)[)\]}]\s*")
_UNIT_BEHIND = re.compile(r"\s*/\s*|\s+in\s+|[\s_,]+")
_NO_FOCUS = re.compile(r"(?:no|not|none|never|kein)\b.*|[-–]*", re.IGNORECASE)
_ZERO = re.compile(r"[+-]?[0.,]+(?:[eE].*)?")


@dataclass(frozen=True)
class _Meaning:
    """The role, the unit and the certainty that a heading states."""

    role: str
    unit: str
    is_certain: bool = True
    per_square_volt: bool = False


@dataclass(frozen=True)
class _Headed:
    """A table, and the meaning of its columns by place."""

    table: Table
    columns: Mapping[int, _Meaning]

    def refused(self, place: int, expected: str) -> InputError:
        """The error about a heading."""
        return self.table.text.error(self.table.line + 1, place + 1, self.table.headings[place], expected)

    def only(self, *roles: str) -> int | None:
        """The one column (from 0) of the `roles`, or the certain one."""
        places = [place for place, each in self.columns.items() if each.role in roles]
        certain = [place for place in places if self.columns[place].is_certain]
        if len(places) > 1 and len(certain) != 1:
            others = ", ".join(f'"{self.table.headings[place]}"' for place in places[1:])
            raise self.refused(places[0], f"one column of {' or '.join(_NAMES[role][0] for role in roles)}, not "
                               f"{others} besides: delete the others")
        return next(iter(certain or places), None)

    def factor(self, place: int) -> float:
        """The factor of a column to SI."""
        column = self.columns[place]
        if column.unit not in UNITS_OF[column.role]:
            name, units = _NAMES[column.role]
            raise self.refused(place, f"the unit of the {name} in brackets: {units}")
        return UNITS_OF[column.role][column.unit]


def recognises_energy(text: RecordingText) -> bool:
    """Whether a text is a table of focusing over frequency."""
    return _find(text) is not None


def read_energy_recording(path: Path | str) -> EnergyRecording:
    """Read a table of focusing times, rates or energy densities.

    A column "U (Vpp)" is the voltage at the electrodes, by whose square the rate is divided. An uncertainty column
    holds standard deviations, in "%" or in the unit of the values. Rows without focusing ("inf", "no focus", an empty
    cell, an energy density of 0) are left out with a finding.

    Raises:
        InputError: no such table, a heading without its unit, a cell that is no number, or fewer than five frequencies.
    """
    text = load_text(Path(path))
    found = _find(text)
    frequency, value = (None, None) if found is None else (found.only("frequency"), found.only(*_FOCUS))
    if found is None or frequency is None or value is None:
        first = [line[:80] for line in text.lines if line.strip()][:2]
        raise InputError(text.path, "headings", first, "a frequency and a focusing time or energy density with their "
                         'units, such as "frequency (MHz), focusing time (s)" or "f (MHz); E_ac (J/m^3); U (Vpp)"')
    voltage, uncertainty, meant = found.only("voltage"), found.only("uncertainty"), found.columns[value]
    if meant.per_square_volt and voltage is not None:
        raise found.refused(voltage, "no voltage beside an energy density per Vpp^2, or E_ac itself in J/m^3")
    factors = {place: found.factor(place) for place in (frequency, value, voltage) if place is not None}
    is_share = False
    if uncertainty is not None:
        unit = found.columns[uncertainty].unit
        density = _UNIT_PER_SQUARE_VOLT.fullmatch(unit)
        # Without a unit of its own it has that of the values.
        unit = (density[1] if density is not None and meant.per_square_volt else unit) or meant.unit
        is_share = unit == "%"
        if not is_share and unit not in UNITS_OF[meant.role]:
            raise found.refused(uncertainty, f"the unit of the uncertainty in brackets: %, or {_NAMES[meant.role][1]}")
        factors[uncertainty] = 1e-2 if is_share else UNITS_OF[meant.role][unit]
    numbers, unfocused, skipped = _rows(found, factors, frequency, value)
    values, spread = numbers[value], None if uncertainty is None else numbers[uncertainty]
    if spread is not None and is_share:
        spread = spread * values
    if meant.role == "rate":
        values, spread = 1.0 / values, None if spread is None else spread / values**2
    volts = np.ones(values.size) if meant.per_square_volt else None if voltage is None else numbers[voltage]
    findings = [] if not unfocused else [
        f"left out {len(unfocused)} of {len(unfocused) + values.size} points, at which particles did not focus: "
        f"{', '.join(unfocused)}"]
    findings += [] if not skipped else [f"left out {', '.join(skipped)}, without a number"]
    used = [place for place in (frequency, value, voltage, uncertainty) if place is not None]
    meanings = [f'"{found.table.headings[place]}" is the {_NAMES[found.columns[place].role][0]}' for place in used]
    rest = [f'"{name}"' for place, name in enumerate(found.table.headings) if place not in used and name]
    return EnergyRecording(
        numbers[frequency], values, ENERGY_DENSITY if meant.role == "energy" else FOCUSING_TIME, spread, volts,
        text.path, f"by its headings: {', '.join(meanings)}" + (f"; not used: {', '.join(rest)}" if rest else ""),
        tuple(findings))


def _rows(
    found: _Headed, factors: Mapping[int, float], frequency: int, value: int
) -> tuple[dict[int, Real], list[str], list[str]]:
    """The columns (n,) in SI of rows with focusing, and other rows."""
    table, decimal = found.table, found.table.decimal_mark()
    rows, unfocused, skipped = list[list[float]](), list[str](), list[str]()
    for line, content, short in table.content:
        row = short + [""] * (table.width - len(short))
        if len(row) > table.width:
            raise table.wrong_width(line, content, row, ": divide the columns by semicolons")
        if not any(is_number(cell, decimal) for cell in row):
            skipped.append(f"line {line}")
        elif _NO_FOCUS.fullmatch(row[value]) or holds_no_value(row[value], decimal) or (
                is_number(row[value], decimal) and _ZERO.fullmatch(row[value])
                and found.columns[value].role != "time"):
            unfocused.append(f"line {line} ({row[frequency]})")
        else:
            rows.append([])
            for place in factors:
                number = value_of(row[place], decimal)
                if number is None or not number > 0.0:
                    raise table.text.error(line, place + 1, row[place],
                                           f"a positive number{REMEDY if place == value else ''}")
                rows[-1].append(number)
    columns = np.array(rows).reshape(len(rows), len(factors)).T
    return {place: column * factor for (place, factor), column in zip(factors.items(), columns, strict=True)}, \
        unfocused, skipped


# --------------------------------------------------------------------------------------------------------------------
# Headings.


def _find(text: RecordingText) -> _Headed | None:
    """The headings of a table of focusing, if the text has any."""
    for index, line in enumerate(text.lines[:HEADED_WITHIN]):
        tables = [_with_units(Table(text, tuple(names), index, index + 1, delimiter, len(names)))
                  for delimiter in "\t;," if len(names := cells(uncommented(line), delimiter)) > 1]
        found = max(filter(_is_energy, tables), key=lambda each: each.table.width, default=None)
        if found is not None:
            return found
    return None


def _is_energy(found: _Headed) -> bool:
    values = [each for each in found.columns.values() if each.role in _FOCUS]
    strangers = [name for place, name in enumerate(found.table.headings) if place not in found.columns]
    # An impedance beside a time is one that changes.
    if not any(each.role == "frequency" for each in found.columns.values()) or any(map(understand, strangers)):
        return False
    return any(each.is_certain for each in values) or (bool(values) and not strangers)


def _with_units(table: Table) -> _Headed:
    """The columns, with the units from a line below the headings."""
    own = _Headed(table, _meanings(table.headings))
    below = cells(uncommented(table.text.lines[table.start]), table.delimiter) if (
        table.start < len(table.text.lines)) else []
    if len(below) != table.width or any(map(is_cell, below)):
        return own
    names = tuple(name if not unit or (place in own.columns and own.columns[place].unit) else
                  f"{name} ({unit.strip('()[]')})" for place, (name, unit) in enumerate(zip(
                      table.headings, below, strict=True)))
    found = _Headed(replace(table, headings=names, start=table.start + 1), _meanings(names))
    return found if any(each.unit for each in found.columns.values()) else own


def _meanings(headings: tuple[str, ...]) -> dict[int, _Meaning]:
    return {place: meaning for place, name in enumerate(headings) if (meaning := _meaning(name)) is not None}


def _meaning(heading: str) -> _Meaning | None:
    """The meaning of a heading."""
    known = understand(heading)
    if known is not None and known.part == "frequency":
        return _Meaning("frequency", known.unit or known.strange_unit)
    text = unicodedata.normalize("NFKC", heading).replace("−", "-").strip()
    words, unit = _split(re.sub(r"^u\s*\([^()]*\)", "uncertainty", text))
    words = " ".join(re.sub(r"[_^]", " ", words).split()).casefold()
    if _UNCERTAIN.search(words):
        return _Meaning("uncertainty", unit)
    bare = _PER_SQUARE_VOLT.sub("", words)
    density = _UNIT_PER_SQUARE_VOLT.fullmatch(unit)
    if density is None and bare != words and "pp" not in words[len(bare):]:
        # The square of an amplitude is four times smaller.
        unit = f"{unit}, per square of a voltage that is not Vpp"
    for role, (certain, perhaps) in _WORDS.items():
        name, of_role = (bare, density[1] if density else unit) if role == "energy" else (words, unit)
        if role == "voltage" and of_role in ("V", "mV", "") and re.search("pp$|p-p$|peak$", name):
            # "Vpp" is its own unit.
            of_role = f"{of_role or ('V' if name.startswith('v') else '')}pp"
        is_certain = re.fullmatch(certain, name) is not None
        if is_certain or (of_role in UNITS_OF[role] and re.fullmatch(perhaps, name)):
            return _Meaning(role, of_role, is_certain, role == "energy" and (bare != words or density is not None))
    return None


def _split(text: str) -> tuple[str, str]:
    """The words of a heading and its unit."""
    bracketed = _BRACKETED.fullmatch(text)
    if bracketed is not None and bracketed[1]:
        return bracketed[1], _unit(bracketed[2])
    for found in _UNIT_BEHIND.finditer(text):
        unit = _unit(text[found.end():])
        density = _UNIT_PER_SQUARE_VOLT.fullmatch(unit)
        if found.start() and any((density[1] if density else unit) in units for units in UNITS_OF.values()):
            return text[:found.start()], unit
    return text, ""


def _unit(text: str) -> str:
    """One spelling of a unit."""
    return re.sub(r"[\s^*·_()\[\]]", "", text).replace("μ", "u").replace("Vp-p", "Vpp").replace("Vpk-pk", "Vpp")
