"""The columns that make up one impedance, and open questions on them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from workbench.readers.columns import ColumnMap
from workbench.readers.headings import RECTANGULAR, SYMBOLS, Heading, is_series, units_of
from workbench.readers.quantities import (
    CIRCUITS,
    CONFIGURATIONS,
    PHASE_UNITS,
    REFERENCE_OHM,
    THROUGH,
    RecordedQuantity,
    units,
)
from workbench.readers.tables import Table

#: Largest phase in radians, pi, rounded up.
LARGEST_RAD = 3.2
#: Largest element of a circuit without a unit, in SI: the unit of a larger one was left out. Doubled, nothing changes.
LARGEST_ELEMENT: Mapping[str, float] = {"C": 1e-3, "L": 1.0}
#: A reference resistance among the lines above a table.
_REFERENCE = re.compile(r"(?i)\b(?:z0|z_0|r0|zref|reference (?:impedance|resistance)|system impedance)\b[^\d\n]{0,12}"
                        r"(\d+(?:[.]\d+)?)")
#: Parts that a phase belongs to.
_SIZES = ("magnitude", "whole", "scalar")


@dataclass(frozen=True, eq=False)
class HeadedTable:
    """A table with the meaning of its columns, ``known`` by heading.

    ``reference`` is the resistance (ohm) that the lines above state.
    """

    table: Table
    known: Sequence[Heading | None]
    reference: float | None = None

    def columns(self, part: str, kind: str) -> list[int]:
        """The columns of a part of a quantity, at port 1."""
        return [place for place, heading in enumerate(self.known) if heading and (heading.part, heading.kind) == (
            part, kind) and (heading.port == 1 or kind == "transmission")]

    def owner(self, place: int) -> str:
        """The quantity whose size stands before a column, or behind it."""
        sizes = [(other > place, abs(other - place), heading.kind) for other, heading in enumerate(self.known)
                 if heading and heading.part in _SIZES]
        return min(sizes)[2] if sizes else ""


@dataclass(frozen=True)
class Pair:
    """Two columns (from 0) that hold an impedance, and open questions.

    ``doubts`` by key of a column map; ``notes`` by column, the reasons for their units. A complex number in one cell is
    both columns.
    """

    first: int
    second: int
    quantity: RecordedQuantity
    doubts: Mapping[str, str]
    notes: Mapping[int, str] = field(default_factory=dict)
    primed: bool = False

    def values(self, table: Table) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The two numbers (n,) of every row, NaN for none."""
        return table.parts(self.first) if self.first == self.second else (
            table.values[:, self.first], table.values[:, self.second])

    def column_map(self, table: Table, frequency: int, unit: str) -> ColumnMap:
        """The column map of the pair beside the column `frequency` (from 0)."""
        return ColumnMap(table.handle(frequency), table.handle(self.first), table.handle(self.second), self.quantity,
                         unit, table.delimiter, table.decimal)


@dataclass
class _Remarks:
    """The doubts and notes on a pair of columns."""

    table: HeadedTable
    doubts: dict[str, str] = field(default_factory=dict)
    notes: dict[int, str] = field(default_factory=dict)

    def doubt(self, key: str, place: int, choices: str, why: str) -> None:
        """Leave the entry `key` of a column map open between `choices`."""
        self.doubts[key] = choices
        self.notes[place] = f"{self.table.table.name(place)}: {why}"

    def unit(self, key: str, place: int, heading: Heading, allowed: Sequence[str], *, has_default: bool) -> str:
        """The unit of a column: its own, or the first `allowed`."""
        if heading.strange_unit or (heading.unit and heading.unit not in allowed):
            given = heading.strange_unit or heading.unit
            self.doubt(key, place, ", ".join(allowed), f"its unit {given!r} is not known")
        elif not heading.unit and not has_default:
            self.notes[place] = f"no unit given, hence {allowed[0]}"
        return heading.unit if heading.unit in allowed else allowed[0]

    def phase_unit(self, place: int, heading: Heading) -> str:
        """The unit of a phase: its own, or degrees beyond radians."""
        largest = float(np.nanmax(np.abs(self.table.table.values[:, place]), initial=0.0))
        if heading.strange_unit:
            self.doubt("phase_unit", place, ", ".join(PHASE_UNITS), f"its unit {heading.strange_unit!r} is not known")
        elif heading.unit == "rad" and largest > LARGEST_RAD:
            self.doubt("phase_unit", place, "deg or rad", f"a phase in radians does not reach {largest:g}")
        elif heading.unit:
            return heading.unit
        elif largest > LARGEST_RAD:
            self.notes[place] = f"no unit given, and a phase in radians does not reach {largest:g}"
        else:
            self.doubt("phase_unit", place, "deg or rad", f"a phase without a unit, and up to {largest:g} it may be in "
                       "degrees or in radians")
        return "deg"


def find_pairs(table: HeadedTable) -> list[Pair]:
    """Every two columns that may hold the impedance, first columns first.

    Pairs of elements of an equivalent circuit are included only if there is no other.
    """
    found = []
    for kind in SYMBOLS:
        whole = table.columns("whole", kind)
        bare = [place for place in whole if place not in table.table.complexes]
        # A bare Z beside a phase is the magnitude; a phase of an unstated quantity is that of the one present.
        halves = {"rectangular": (table.columns("real", kind), table.columns("imaginary", kind)),
                  "polar": (table.columns("magnitude", kind) or bare, table.columns("phase", kind)
                            or _unstated(table, kind))}
        found += [_pair(table, kind, "complex", place, place) for place in whole if place not in bare]
        found += [_pair(table, kind, form, first[0], second[0]) for form, (first, second) in halves.items()
                  if len(first) == len(second) == 1]
    if all(pair.doubts for pair in found):
        found += _circuits(table)
    return sorted(found, key=lambda pair: (min(pair.first, pair.second), pair.first))


def _unstated(table: HeadedTable, kind: str) -> list[int]:
    """The phases that do not state their quantity.

    The only one is that of the only quantity, others are those of the columns before them.
    """
    phases = table.columns("phase", "")
    if len(phases) > 1:
        return [place for place in phases if place and (before := table.known[place - 1]) is not None
                and before.part in _SIZES and before.kind == kind]
    others = (other for other in SYMBOLS if other != kind)
    return [] if any(table.columns(part, other) for other in others for part in _SIZES[:2]) else phases


def reference_of(table: Table) -> float | None:
    """The reference resistance (ohm) that the lines above a table state."""
    found = [match for line in table.text.lines[:table.start] for match in _REFERENCE.findall(line)]
    return float(found[0]) if found and float(found[0]) > 0.0 else None


def stated_ports(kind: str, reference: float | None) -> tuple[dict[str, object], str]:
    """Entries of a quantity of ports besides its unit, and their reason."""
    if kind not in ("reflection", "transmission"):
        return {}, ""
    more: dict[str, object] = {"reference_resistance": REFERENCE_OHM if reference is None else reference}
    if kind == "transmission":
        more["configuration"] = CONFIGURATIONS[1]
    return more, f"no reference resistance given, hence {REFERENCE_OHM:g} ohm" if reference is None else (
        f"reference resistance {reference:g} ohm from the lines above")


def _pair(table: HeadedTable, kind: str, form: str, first: int, second: int) -> Pair:
    """Two columns (or one of complex numbers) with their units."""
    one, two = table.known[first], table.known[second]
    assert one is not None
    assert two is not None
    remarks = _Remarks(table)
    more, stated = stated_ports(kind, table.reference)
    allowed = tuple(units("magnitude" if form == "polar" else "real", kind))
    unit = remarks.unit("unit", first, one, allowed, has_default=bool(more))
    phase_unit = "deg"
    if form == "rectangular":
        if one.unit and two.unit and one.unit != two.unit:
            more["second_unit"] = two.unit
        elif two.strange_unit or one.unit == two.unit:
            remarks.unit("unit", second, two, allowed, has_default=bool(more))
        elif "unit" not in remarks.doubts:
            remarks.doubt("unit", second, ", ".join(allowed), f"its unit is not that of {table.table.name(first)}")
    elif form == "polar":
        unit = "dB" if "dB" in units_of(one.strange_unit) else unit
        phase_unit = remarks.phase_unit(second, two)
        if np.nanmin(table.table.values[:, first], initial=np.inf) < 0.0:
            if more and not one.unit:
                unit = "dB"
                remarks.notes[first] = f"no unit given, and a magnitude below zero is one in dB; {stated}"
            elif unit != "dB":
                remarks.doubt("form", first, "polar or rectangular", "taken for a magnitude, and has values below zero")
    if stated:
        remarks.notes.setdefault(first, stated)
    if kind == "transmission":
        remarks.doubt("configuration", first, "shunt (from the line to ground) or series",
                      "a transmission does not say how the device is connected")
    through = _through(table) if kind == "reflection" else None
    if through is not None:
        remarks.doubt("kind", first, "reflection if the device is at port 1 alone", "the reflection at port 1 is that "
                      f"of a device at this port alone, and {table.table.name(through)} is not small: a device between "
                      "the ports is known by its transmission and its connection")
    quantity = RecordedQuantity(kind, form, unit, phase_unit, negated=two.negated, **more)  # type: ignore[arg-type]
    return Pair(first, second, quantity, remarks.doubts, remarks.notes, two.primed)


def _through(table: HeadedTable) -> int | None:
    """The column of a transmission that is not small, or None."""
    for place in (place for part in ("magnitude", "real", "imaginary", "whole")
                  for place in table.columns(part, "transmission") if place not in table.table.complexes):
        values, heading = table.table.values[:, place], table.known[place]
        size = 10.0 ** (values / 20.0) if heading is not None and heading.unit == "dB" else np.abs(values)
        if np.nanmax(size, initial=0.0) > THROUGH:
            return place
    return None


def _circuits(table: HeadedTable) -> list[Pair]:
    """Pairs of columns that are elements of an equivalent circuit."""
    places: dict[str, list[int]] = {}
    for place, heading in enumerate(table.known):
        # The sign of a column that is minus a reactance is no part of a circuit.
        if heading is not None and heading.port == 1 and not heading.negated:
            symbol = heading.kind if heading.part == "element" else RECTANGULAR.get(
                (heading.part, heading.kind), "")
            places.setdefault(symbol, []).append(place)
    found = []
    for circuit in CIRCUITS:
        one, two = circuit.split("-")
        # A bare "C" or "R" may be the element in series or in parallel.
        for first in (one, one[0]) if one[0] in LARGEST_ELEMENT else (one,):
            for second in (two, "Rs") if two == "Rp" else (two,):
                if any(len(places.get(symbol, ())) != 1 for symbol in (first, second)) or (
                        second != two and is_series(table.table.headings[places["Rs"][0]])):
                    continue
                found.append(_circuit(table, circuit, (places[first][0], places[second][0]),
                                      doubted=(first, second) != (one, two)))
    return found


def _circuit(table: HeadedTable, circuit: str, places: tuple[int, int], *, doubted: bool) -> Pair:
    """A pair of elements with units, in the order of columns."""
    remarks = _Remarks(table)
    (one, symbol), (other, second) = sorted(zip(places, circuit.split("-"), strict=True))
    own = []
    for key, place, element in (("unit", one, symbol), ("second_unit", other, second)):
        heading, allowed = table.known[place], tuple(units("element", element))
        assert heading is not None
        own.append(remarks.unit(key, place, heading, allowed, has_default=element in ("D", "Q")))
        sizes = np.abs(table.table.values[:, place])
        size = float(np.nanmedian(sizes)) if np.any(np.isfinite(sizes)) else 0.0
        if not (heading.unit or heading.strange_unit) and size > LARGEST_ELEMENT.get(element[0], np.inf):
            remarks.doubt(key, place, ", ".join(allowed), f"no unit, and {size:g} {allowed[0]} is too much")
    if doubted:
        remarks.doubt("form", places[0], "of a parallel (p) or a series circuit (s), as the meter was set",
                      "series or parallel is not said")
    quantity = RecordedQuantity("circuit", f"{symbol}-{second}", own[0], second_unit=own[1])
    return Pair(one, other, quantity, remarks.doubts, remarks.notes)
