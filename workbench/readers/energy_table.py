"""Tables of focusing over frequency: a column of frequencies beside one of focusing times, rates or energy densities.

The headings state the columns and their units; a voltage and an uncertainty may stand beside. A table with an impedance
is none. Commas, semicolons or tabs divide the columns, and decimal commas are read with the latter two.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.files.quantities import UNITS
from workbench.readers.columns import uncommented
from workbench.readers.headings import understand
from workbench.readers.layouts import TableLayout, decimal_mark, is_cell
from workbench.readers.text import (
    COMMENTS,
    RecordingText,
    cell_number,
    cells,
    holds_no_value,
    is_number,
    load_text,
)
from workbench.results.energy_recording import ENERGY_DENSITY, FOCUSING_TIME, EnergyRecording

#: Lines in which headings are looked for. Doubled, a recording of impedance takes a hundredth of a second longer.
HEADED_WITHIN = 50

Real = NDArray[np.float64]

#: The end of the message about a cell that holds no time or energy density.
REMEDY = '; where particles did not focus, leave the cell empty, or write inf or "no focus"'

_DELIMITERS = ("\t", ";", ",")

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


@dataclass(frozen=True)
class _Column:
    """The meaning of a heading: its role (a key of `_NAMES`), its unit, and whether its words leave no doubt."""

    role: str
    unit: str
    is_certain: bool = True
    per_square_volt: bool = False


@dataclass(frozen=True)
class _Headed:
    """The place of a table, and the meaning of its columns, None where it has none."""

    layout: TableLayout
    columns: tuple[_Column | None, ...]

    def places(self, *roles: str) -> list[int]:
        return [place for place, each in enumerate(self.columns) if each is not None and each.role in roles]


def recognises_energy(text: RecordingText) -> bool:
    """Whether the headings of a text are those of a table of focusing over frequency."""
    return _find(text) is not None


def read_energy_recording(path: Path | str) -> EnergyRecording:
    """Read a table of focusing times, rates of focusing or energy densities over frequency.

    A column "U (Vpp)" is the voltage at the electrodes, by whose square the rate is divided. An uncertainty column
    holds standard deviations, in "%" or in the unit of the values. Rows without focusing ("inf", "no focus", an empty
    cell, an energy density of 0) are left out with a finding.

    Raises:
        InputError: no such table, a heading without its unit, a cell that is no number, or fewer than five frequencies.
    """
    text = load_text(Path(path))
    found = _find(text)
    frequency, value = (None, None) if found is None else (
        _only(text, found, "frequency"), _only(text, found, "time", "rate", "energy"))
    if found is None or frequency is None or value is None:
        first = [line[:80] for line in text.lines if line.strip()][:2]
        raise InputError(text.path, "headings", first, "a frequency and a focusing time or energy density with their "
                         'units, such as "frequency (MHz), focusing time (s)" or "f (MHz); E_ac (J/m^3); U (Vpp)"')
    voltage, uncertainty, meant = _only(text, found, "voltage"), _only(text, found, "uncertainty"), found.columns[value]
    assert meant is not None
    if meant.per_square_volt and voltage is not None:
        raise _refused(text, found, voltage, "no voltage beside an energy density per Vpp^2, or E_ac itself in J/m^3")
    factor = {place: _factor(text, found, place) for place in (frequency, value, voltage) if place is not None}
    share, of_spread = (False, 1.0) if uncertainty is None else _relative(text, found, uncertainty, value)
    rows = _rows(text, found, frequency=frequency, value=value,
                 others=[place for place in (voltage, uncertainty) if place is not None])
    values, spread = rows.numbers[value] * factor[value], None
    if uncertainty is not None:
        spread = rows.numbers[uncertainty] * of_spread * (values if share else 1.0)
    if meant.role == "rate":
        values, spread = 1.0 / values, None if spread is None else spread / values**2
    volts = np.ones(values.size) if meant.per_square_volt else None
    if voltage is not None:
        volts = rows.numbers[voltage] * factor[voltage]
    findings = [] if not rows.unfocused else [
        f"left out {len(rows.unfocused)} of {len(rows.unfocused) + values.size} points, at which particles did not "
        f"focus: {', '.join(rows.unfocused)}"]
    findings += [] if not rows.skipped else [f"left out {', '.join(rows.skipped)}, without a number"]
    return EnergyRecording(
        rows.numbers[frequency] * factor[frequency], values,
        ENERGY_DENSITY if meant.role == "energy" else FOCUSING_TIME, spread, volts, text.path,
        _read_as(found, (frequency, value, voltage, uncertainty)), tuple(findings))


def _find(text: RecordingText) -> _Headed | None:
    """The headings of a table of focusing over frequency, if the text has any."""
    for index, line in enumerate(text.lines[:HEADED_WITHIN]):
        best: _Headed | None = None
        for delimiter in _DELIMITERS:
            names = cells(uncommented(line), delimiter) if delimiter in line else []
            if len(names) > 1:
                layout = TableLayout(tuple(names), index, index + 1, delimiter, len(names), plain=True)
                found = _with_units(text, layout)
                best = found if _is_energy(found) and (best is None or len(names) > best.layout.width) else best
        if best is not None:
            return best
    return None


def _is_energy(found: _Headed) -> bool:
    values = [found.columns[place] for place in found.places("time", "rate", "energy")]
    strangers = [name for name, column in zip(found.layout.headings, found.columns, strict=True) if column is None]
    # An impedance beside a time is one that changes.
    if not found.places("frequency") or any(understand(name) is not None for name in strangers):
        return False
    return any(each is not None and each.is_certain for each in values) or (bool(values) and not strangers)


def _with_units(text: RecordingText, layout: TableLayout) -> _Headed:
    """The meaning of the columns, with the units from a line below the headings."""
    below = cells(uncommented(text.lines[layout.start]), layout.delimiter) if layout.start < len(text.lines) else []
    own = _Headed(layout, tuple(map(_column, layout.headings)))
    if len(below) != layout.width or any(map(is_cell, below)):
        return own
    names = tuple(name if (column is not None and column.unit) or not unit else f"{name} ({unit.strip('()[]')})"
                  for name, column, unit in zip(layout.headings, own.columns, below, strict=True))
    under = TableLayout(names, layout.line, layout.start + 1, layout.delimiter, layout.width, plain=True)
    found = _Headed(under, tuple(map(_column, names)))
    return found if any(each is not None and each.unit for each in found.columns) else own


def _column(heading: str) -> _Column | None:
    """The meaning of a heading."""
    known = understand(heading)
    if known is not None and known.part == "frequency":
        return _Column("frequency", known.unit or known.strange_unit)
    text = unicodedata.normalize("NFKC", heading).replace("−", "-").strip()
    words, unit = _split(re.sub(r"^u\s*\([^()]*\)", "uncertainty", text))
    words = " ".join(re.sub(r"[_^]", " ", words).split()).casefold()
    if _UNCERTAIN.search(words):
        return _Column("uncertainty", unit)
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
            return _Column(role, of_role, is_certain, role == "energy" and (bare != words or density is not None))
    return None


def _split(text: str) -> tuple[str, str]:
    """The words of a heading and its unit: in brackets, or a known one behind a slash, "in", a blank or a line."""
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


# --------------------------------------------------------------------------------------------------------------------
# Columns and rows.


def _name(found: _Headed, place: int) -> str:
    column = found.columns[place]
    assert column is not None
    return _NAMES[column.role][0]


def _refused(text: RecordingText, found: _Headed, place: int, expected: str) -> InputError:
    """The error about a heading."""
    return text.error(found.layout.line + 1, place + 1, found.layout.headings[place], expected)


def _only(text: RecordingText, found: _Headed, *roles: str) -> int | None:
    """The column (from 0) of one of the `roles`; of several, the one whose words are certain."""
    places = found.places(*roles)
    certain = [place for place in places if (column := found.columns[place]) and column.is_certain]
    if len(places) > 1 and len(certain) != 1:
        others = ", ".join(f'"{found.layout.headings[place]}"' for place in places[1:])
        raise _refused(text, found, places[0], f"one column of {' or '.join(_NAMES[role][0] for role in roles)}, not "
                       f"{others} besides: delete the others")
    best = certain or places
    return best[0] if best else None


def _factor(text: RecordingText, found: _Headed, place: int) -> float:
    """The factor of a column to SI."""
    column = found.columns[place]
    assert column is not None
    if column.unit not in UNITS_OF[column.role]:
        name, units = _NAMES[column.role]
        raise _refused(text, found, place, f"the unit of the {name} in brackets: {units}")
    return UNITS_OF[column.role][column.unit]


def _relative(text: RecordingText, found: _Headed, place: int, value: int) -> tuple[bool, float]:
    """Whether an uncertainty is a share of the value, and its factor to SI or to 1."""
    column, of = found.columns[place], found.columns[value]
    assert column is not None
    assert of is not None
    density = _UNIT_PER_SQUARE_VOLT.fullmatch(column.unit)
    unit = density[1] if density is not None and of.per_square_volt else column.unit
    if unit == "%":
        return True, 1e-2
    # Without a unit of its own it has that of the values.
    if (unit or of.unit) not in UNITS_OF[of.role]:
        raise _refused(text, found, place, f"the unit of the uncertainty in brackets: %, or {_NAMES[of.role][1]}")
    return False, UNITS_OF[of.role][unit or of.unit]


@dataclass(frozen=True)
class _Rows:
    """The rows of a table: the numbers of each column (n,) by its place, and the rows left out, in words."""

    numbers: Mapping[int, Real]
    unfocused: tuple[str, ...]
    skipped: tuple[str, ...]


def _rows(text: RecordingText, found: _Headed, *, frequency: int, value: int, others: list[int]) -> _Rows:
    """The rows in which particles focus."""
    layout, decimal = found.layout, decimal_mark(text, found.layout)
    rows, unfocused, skipped = list[dict[int, float]](), list[str](), list[str]()
    for line, content in enumerate(text.lines[layout.start:], layout.start + 1):
        if not content.strip() or content.startswith(COMMENTS):
            continue
        row = cells(content, layout.delimiter)
        if len(row) > layout.width:
            raise text.error(line, None, content, f"{layout.width} columns; this row has {len(row)}" + (
                ", as if its decimal commas divided it: divide the columns by semicolons"
                if layout.delimiter == "," else ""))
        row += [""] * (layout.width - len(row))
        if not any(is_number(cell, decimal) for cell in row):
            skipped.append(f"line {line}")
            continue
        cell = row[value]
        no_focus = _NO_FOCUS.fullmatch(cell) is not None or holds_no_value(cell, decimal)
        if no_focus or (is_number(cell, decimal) and _is_zero(cell) and found.places("rate", "energy")):
            unfocused.append(f"line {line} ({row[frequency]})")
            continue
        rows.append({place: _number(text, line, place, row[place], decimal=decimal, remedy=REMEDY if place == value
                                    else "") for place in (frequency, value, *others)})
    return _Rows({place: np.array([row[place] for row in rows]) for place in (frequency, value, *others)},
                 tuple(unfocused), tuple(skipped))


def _is_zero(cell: str) -> bool:
    return re.fullmatch(r"[+-]?[0.,]+(?:[eE].*)?", cell) is not None


def _number(text: RecordingText, line: int, place: int, cell: str, *, decimal: str, remedy: str) -> float:
    """The positive number in a cell."""
    no_value = holds_no_value(cell, decimal) or not is_number(cell, decimal)
    number = np.nan if no_value else cell_number(text, line, place + 1, cell=cell, decimal=decimal)
    if not number > 0.0:
        raise text.error(line, place + 1, cell, f"a positive number{remedy}")
    return number


def _read_as(found: _Headed, places: tuple[int | None, ...]) -> str:
    """The meaning of the columns, in words."""
    meant = [f'"{found.layout.headings[place]}" is the {_name(found, place)}' for place in places if place is not None]
    rest = [f'"{name}"' for place, name in enumerate(found.layout.headings) if place not in places and name]
    return f"by its headings: {', '.join(meant)}" + (f"; not used: {', '.join(rest)}" if rest else "")
