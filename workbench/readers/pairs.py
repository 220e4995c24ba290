"""The columns of a table that make up one impedance, from their headings and values, and the open questions on them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.readers.headings import SYMBOLS, Heading, is_series
from workbench.readers.layouts import Body, TableLayout, column_name
from workbench.readers.quantities import (
    CIRCUITS,
    CONFIGURATIONS,
    ELEMENT_UNITS,
    MAGNITUDE_UNITS,
    PHASE_UNITS,
    REFERENCE_OHM,
    THROUGH,
    RecordedQuantity,
)
from workbench.readers.text import RecordingText

#: Largest phase in radians, pi, rounded up.
LARGEST_RAD = 3.2
#: Largest difference (rms, of |Z|) between two pairs of columns that hold one impedance; digits are rounded to three or
#: more.
AGREEMENT = 0.01
#: Largest element of a circuit without a unit, in SI: the unit of a larger one was left out. Doubled, nothing changes.
LARGEST_ELEMENT: Mapping[str, float] = {"C": 1e-3, "L": 1.0}

#: A reference resistance among the lines above a table.
_REFERENCE = re.compile(r"(?i)\b(?:z0|z_0|r0|zref|reference (?:impedance|resistance)|system impedance)\b[^\d\n]{0,12}"
                        r"(\d+(?:[.]\d+)?)")


@dataclass(frozen=True)
class Pair:
    """Two columns (from 0) that hold an impedance, their meaning, and the open questions on them.

    ``doubts`` by key of a column map; ``notes`` by column, the reasons for their units. A complex number in one cell is
    both columns.
    """

    first: int
    second: int
    quantity: RecordedQuantity
    doubts: Mapping[str, str]
    notes: Mapping[int, str]
    primed: bool = False


def find_pairs(
    layout: TableLayout, known: Sequence[Heading | None], body: Body, reference: float | None
) -> list[Pair]:
    """Every two columns that may hold the impedance, pairs of the first columns first. Pairs of elements of an
    equivalent circuit are included only if there is no other."""
    found = []
    for kind in SYMBOLS:
        for place in quantity_columns(known, "whole", kind):
            if place in body.complexes:
                found.append(_whole(layout, known, kind, place, reference))
        real, imaginary = quantity_columns(known, "real", kind), quantity_columns(known, "imaginary", kind)
        if len(real) == len(imaginary) == 1:
            found.append(_pair(layout, known, body, kind, "rectangular", (real[0], imaginary[0]), reference))
        # A bare Z beside a phase is the magnitude; a phase of an unstated quantity is that of the one present.
        magnitude = quantity_columns(known, "magnitude", kind) or [
            place for place in quantity_columns(known, "whole", kind) if place not in body.complexes]
        alone = not any(quantity_columns(known, "magnitude", other)
                        or quantity_columns(known, "whole", other) for other in SYMBOLS
                        if other != kind)
        phase = quantity_columns(known, "phase", kind) or (quantity_columns(known, "phase", "") if alone else [])
        if len(magnitude) == len(phase) == 1:
            found.append(_pair(layout, known, body, kind, "polar", (magnitude[0], phase[0]), reference))
    found = [_at_one_port(layout, known, body, pair) for pair in found]
    if not any(not pair.doubts for pair in found):
        found += _circuits(layout, known, body)
    return sorted(found, key=lambda pair: (min(pair.first, pair.second), pair.first))


def reference_of(text: RecordingText, layout: TableLayout) -> float | None:
    """The reference resistance (ohm) that the lines above a table state."""
    found = [match for line in text.lines[:layout.start] for match in _REFERENCE.findall(line)]
    return float(found[0]) if found and float(found[0]) > 0.0 else None


def quantity_columns(known: Sequence[Heading | None], part: str, kind: str) -> list[int]:
    """The columns of that part of that quantity, at port 1 if it has ports."""
    return [place for place, heading in enumerate(known)
            if heading and (heading.part, heading.kind) == (part, kind) and (heading.port == 1
                                                                           or kind == "transmission")]


def stated_ports(kind: str, reference: float | None) -> tuple[dict[str, object], str]:
    """Entries of a quantity of ports besides its unit, and the reason for them."""
    if kind not in ("reflection", "transmission"):
        return {}, ""
    more: dict[str, object] = {"reference_resistance": REFERENCE_OHM if reference is None else reference}
    if kind == "transmission":
        more["configuration"] = CONFIGURATIONS[1]
    note = f"no reference resistance given, hence {REFERENCE_OHM:g} ohm" if reference is None else (
        f"reference resistance {reference:g} ohm from the lines above")
    return more, note


def _whole(
    layout: TableLayout, known: Sequence[Heading | None], kind: str, place: int, reference: float | None
) -> Pair:
    """A column of complex numbers with its unit."""
    heading = known[place]
    assert heading is not None
    usual = next(iter(MAGNITUDE_UNITS[kind]))
    more, note = stated_ports(kind, reference)
    notes, doubts = {place: note} if note else {}, {}
    if heading.strange_unit or heading.unit == "dB":
        doubts["unit"] = f"UNCLEAR: {', '.join(MAGNITUDE_UNITS[kind])}"
        notes[place] = f"{column_name(layout, place)}: its unit {(heading.strange_unit or 'dB')!r} is not known"
    elif not heading.unit and kind in ("impedance", "admittance"):
        notes[place] = f"no unit given, hence {usual}"
    unit = heading.unit if heading.unit in MAGNITUDE_UNITS[kind] else usual
    quantity = RecordedQuantity(kind, "complex", unit, **more)  # type: ignore[arg-type]
    return _unless_through(layout, Pair(place, place, quantity, doubts, notes))


def _unless_through(layout: TableLayout, pair: Pair) -> Pair:
    """The pair, with the doubt that a transmission always leaves."""
    if pair.quantity.kind != "transmission":
        return pair
    why = f"{column_name(layout, pair.first)}: a transmission does not say how the device is connected"
    return replace(pair, doubts={**pair.doubts, "configuration": "UNCLEAR: shunt (from the line to ground) or series"},
                   notes={**pair.notes, pair.first: why})


def _at_one_port(layout: TableLayout, known: Sequence[Heading | None], body: Body, pair: Pair) -> Pair:
    """The pair; a reflection beside a transmission that is not small is one of a device between two ports."""
    if pair.quantity.kind != "reflection":
        return pair
    for part in ("magnitude", "real", "imaginary", "whole"):
        for place in quantity_columns(known, part, "transmission"):
            heading = known[place]
            assert heading is not None
            values = np.abs(body.values[:, place])
            size = 10.0 ** (body.values[:, place] / 20.0) if heading.unit == "dB" else values
            if place not in body.complexes and np.nanmax(size, initial=0.0) > THROUGH:
                why = (f"{column_name(layout, place)} is not small: the reflection at port 1 is that of a device at "
                       "this port alone, and a device between the ports is known by its transmission and its "
                       "connection")
                return replace(pair, doubts={**pair.doubts, "kind": "UNCLEAR: reflection if the device is at port 1 "
                                             "alone"}, notes={**pair.notes, pair.first: why})
    return pair


def _circuits(layout: TableLayout, known: Sequence[Heading | None], body: Body) -> list[Pair]:
    """Pairs of columns that are elements of an equivalent circuit."""
    places: dict[str, list[int]] = {
        "Rs": quantity_columns(known, "real", "impedance"), "X": quantity_columns(known, "imaginary", "impedance"),
        "G": quantity_columns(known, "real", "admittance"), "B": quantity_columns(known, "imaginary", "admittance")}
    # The sign of a column that is minus a reactance is no part of a circuit.
    places = {symbol: [p for p in found if (heading := known[p]) is not None and not heading.negated]
              for symbol, found in places.items()}
    for place, heading in enumerate(known):
        if heading and heading.part == "element":
            places.setdefault(heading.kind, []).append(place)
    found = []
    for circuit in CIRCUITS:
        one, _, two = circuit.partition("-")
        for symbols, doubted in (((one, two), False), ((one[0], two), one[0] in LARGEST_ELEMENT),
                                 ((one[0], two.replace("Rp", "Rs")), one[0] in LARGEST_ELEMENT and two == "Rp")):
            if doubted == (symbols == (one, two)) or any(len(places.get(symbol, ())) != 1 for symbol in symbols):
                continue
            if two == "Rp" and symbols[1] == "Rs" and is_series(layout.headings[places["Rs"][0]]):
                continue
            found.append(_circuit(layout, known, body, circuit, (places[symbols[0]][0], places[symbols[1]][0]),
                                  doubted=doubted))
    return found


def _circuit(
    layout: TableLayout, known: Sequence[Heading | None], body: Body, circuit: str, places: tuple[int, int], *,
    doubted: bool,
) -> Pair:
    """A pair of elements with their units."""
    doubts: dict[str, str] = {}
    notes: dict[int, str] = {}
    units = []
    for key, symbol, place in zip(("unit", "second_unit"), circuit.split("-"), places, strict=True):
        heading = known[place]
        assert heading is not None
        allowed = ELEMENT_UNITS[symbol]
        usual = next(iter(allowed))
        size = float(np.nanmedian(np.abs(body.values[:, place]))) if np.any(
            np.isfinite(body.values[:, place])) else 0.0
        if heading.strange_unit or (heading.unit and heading.unit not in allowed):
            doubts[key] = f"UNCLEAR: {', '.join(allowed)}"
            strange = heading.strange_unit or heading.unit
            notes[place] = f"{column_name(layout, place)}: its unit {strange!r} is not known"
        elif not heading.unit and size > LARGEST_ELEMENT.get(symbol[0], np.inf):
            doubts[key] = f"UNCLEAR: {', '.join(allowed)}"
            notes[place] = f"{column_name(layout, place)}: no unit, and {size:g} {usual} is too much"
        elif not heading.unit and symbol[0] not in "DQ":
            notes[place] = f"no unit given, hence {usual}"
        units.append(heading.unit if heading.unit in allowed else usual)
    if doubted:
        doubts["form"] = "UNCLEAR: of a parallel (p) or a series circuit (s), as the meter was set"
        notes[places[0]] = f"{column_name(layout, places[0])}: series or parallel is not said"
    forward = places[0] < places[1]
    form = circuit if forward else "-".join(reversed(circuit.split("-")))
    one, two = (0, 1) if forward else (1, 0)
    if not forward:
        swapped = {"unit": "second_unit", "second_unit": "unit"}
        doubts = {swapped.get(key, key): text for key, text in doubts.items()}
    quantity = RecordedQuantity("circuit", form, units[one], second_unit=units[two])
    return Pair(places[one], places[two], quantity, doubts, notes)


def _pair(
    layout: TableLayout, known: Sequence[Heading | None], body: Body, kind: str, form: str, places: tuple[int, int],
    reference: float | None,
) -> Pair:
    """Two columns with their units, as far as these are clear."""
    one, two = (known[place] for place in places)
    assert one is not None
    assert two is not None
    doubts: dict[str, str] = {}
    notes: dict[int, str] = {}
    usual = next(iter(MAGNITUDE_UNITS[kind]))
    unit, phase_unit = one.unit or usual, "deg"
    choice = ", ".join((*MAGNITUDE_UNITS[kind], *(["dB"] if form == "polar" else [])))
    more, stated = stated_ports(kind, reference)

    def doubt(key: str, place: int, comment: str, why: str) -> None:
        doubts[key] = f"UNCLEAR: {comment}"
        notes[place] = f"{column_name(layout, place)}: {why}"

    for place, heading in zip(places, (one, two), strict=True):
        if heading.strange_unit:
            angle = heading.part == "phase"
            doubt("phase_unit" if angle else "unit", place, ", ".join(PHASE_UNITS) if angle else choice,
                  f"its unit {heading.strange_unit!r} is not known")
    if not one.unit and not one.strange_unit and not more:
        notes[places[0]] = f"no unit given, hence {usual}"
    smallest = float(np.nanmin(body.values[:, places[0]], initial=np.inf))
    if form == "rectangular":
        if one.unit != two.unit and "unit" not in doubts:
            doubt("unit", places[1], choice, f"its unit is not that of {column_name(layout, places[0])}")
        elif not two.unit and not two.strange_unit and not more:
            notes[places[1]] = f"no unit given, hence {usual}"
    else:
        largest = float(np.nanmax(np.abs(body.values[:, places[1]]), initial=0.0))
        if two.unit == "rad" and largest > LARGEST_RAD:
            doubt("phase_unit", places[1], "deg or rad", f"a phase in radians does not reach {largest:g}")
        elif two.unit:
            phase_unit = two.unit
        elif not two.strange_unit and largest > LARGEST_RAD:
            notes[places[1]] = f"no unit given, and a phase in radians does not reach {largest:g}"
        elif not two.strange_unit:
            doubt("phase_unit", places[1], "deg or rad", f"a phase without a unit, and up to {largest:g} it may be in "
                  "degrees or in radians")
        if more and not one.unit and smallest < 0.0:
            unit = "dB"
            notes[places[0]] = f"no unit given, and a magnitude below zero is one in dB; {stated}"
        elif unit != "dB" and smallest < 0.0:
            doubt("form", places[0], "polar or rectangular", "taken for a magnitude, and has values below zero")
    if stated and places[0] not in notes:
        notes[places[0]] = stated
    quantity = RecordedQuantity(kind, form, unit if unit in (*MAGNITUDE_UNITS[kind], "dB") else usual, phase_unit,
                                negated=two.negated, **more)  # type: ignore[arg-type]
    return _unless_through(layout, Pair(*places, quantity, doubts, notes, two.primed))


def agree(pairs: Sequence[Pair], values: NDArray[np.float64], frequency: NDArray[np.float64]) -> bool:
    """Whether all pairs of columns give one impedance; a complex column is not compared."""
    each = [pair.quantity.impedance(values[:, pair.first], values[:, pair.second], frequency) for pair in pairs
            if pair.quantity.form != "complex"]
    if len(each) < 2:
        return True
    first, *others = each
    use = np.isfinite(first) & (frequency > 0.0)
    scale = np.sqrt(np.mean(np.abs(first[use]) ** 2)) if np.any(use) else 0.0
    for other in others:
        both = use & np.isfinite(other)
        if np.any(both) and np.sqrt(np.mean(np.abs(other[both] - first[both]) ** 2)) > AGREEMENT * scale:
            return False
    return True
