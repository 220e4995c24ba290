"""The refusal of headings in doubt, and its proposal of a map.

No heading is contradicted: one that names a part or a quantity is proposed as that, or not at all.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from workbench.files.errors import InputError
from workbench.readers.columns import PART_WORDS, ColumnMap, contradiction, map_text
from workbench.readers.headings import SYMBOLS, Heading, apparent_meaning
from workbench.readers.pairs import HeadedTable, Pair, find_pairs, stated_ports
from workbench.readers.quantities import PHASE_UNITS, RecordedQuantity, units
from workbench.readers.tables import Table

OPTION = "--columns MAP.toml"

#: Units of quantities that are no half of an impedance: voltage, current, power, time, temperature.
_FOREIGN = re.compile(r"(?:[(/\[]|\bin |_)\s*(?:[munpkM]|μ|µ)?(?:V|A|W|s|sec|°?C|degC|K|dBm|dBV)"
                      r"(?:pp|rms|_?RMS)?\s*[)\]]?\s*$")
_GAIN = "(?i)gain|ratio|math"


def headings_in_doubt(
    headed: HeadedTable, why: str, pair: Pair | None = None, doubts: Mapping[str, str] = MappingProxyType({}),
    select: Mapping[str, str] = MappingProxyType({}),
) -> InputError:
    """The error about headings that leave a doubt, with a column map."""
    table = headed.table
    text_of_map = proposal(headed, pair, doubts, select)
    line = (table.line if table.headings else table.start) + 1
    remedy = (f"Look through this map, save it as MAP.toml and give {OPTION} (in a file that names the recording: "
              f'columns = "MAP.toml"):\n\n{text_of_map}\n') if text_of_map else (
                  "No column map helps: save magnitude and phase, or real and imaginary part, from the instrument")
    return table.text.error(line, None, table.text.lines[line - 1].strip()[:200],
                            f"headings that state the quantity of every column; {why}. {remedy}")


def proposal(headed: HeadedTable, pair: Pair | None, doubts: Mapping[str, str], select: Mapping[str, str]) -> str:
    """The text of the most likely column map, or "".

    No map contradicts a heading. Headings that are not understood count by their apparent meaning
    (:func:`apparent_meaning`). `select` is the entry for one state.
    """
    table, known, second_file = headed.table, headed.known, ""
    seen = replace(headed, known=[heading or (apparent_meaning(table.headings[place]) if table.headings else None)
                                  for place, heading in enumerate(known)], reference=None)
    place = _frequency(headed, seen)
    if pair is None and table.headings and not any(re.search(_GAIN, heading) for heading in table.headings):
        pair = min((each for each in find_pairs(seen) if place not in (each.first, each.second)),
                   key=lambda each: len(each.doubts), default=None)
        if pair is not None:
            columns = (("frequency", place, "frequency", ""), *(
                (key, of, part, kind) for key, of, (part, kind, _) in zip(
                    ("first", "second"), (pair.first, pair.second), pair.quantity.columns, strict=False)))
            doubts = {**{key: f"is it {PART_WORDS.get(part, kind)}?" for key, of, part, kind in columns
                         if known[of] is None}, **doubts}
    if pair is None and table.width < 3 and not table.complexes:
        second_file, pair = "SECOND.csv", _first_half(seen, place)
    elif pair is None:
        pair = _guess(seen, place)
    if pair is None:
        return ""
    doubts = {**doubts, **pair.doubts}
    heading = seen.known[place]
    stated = heading.unit if heading is not None and heading.part == "frequency" else ""
    if known[place] is None or sum(each is not None and each.part == "frequency" for each in known) > 1:
        doubts = {"frequency": "a heading, or the number of the column",
                  **({} if stated else {"frequency_unit": "Hz, kHz or MHz"}), **doubts}
    if second_file:
        return map_text(ColumnMap(table.handle(place), table.handle(pair.first), 1 if table.handle(place) == 2 else 2,
                                  pair.quantity, stated or "Hz", table.delimiter, table.decimal, second_file), doubts)
    proposed = replace(pair.column_map(table, place, stated or "Hz"), select=select)
    names: dict[str, Any] = {key: table.headings[of] for key, of in (("frequency", place), ("first", pair.first), (
        "second", pair.second)) if table.headings and (key != "second" or proposed.second is not None)}
    # Headings that occur twice are counted, and have no say.
    against = contradiction(replace(proposed, **names)) if names and len(set(names.values())) == len(names) else None
    if against is not None and not against.unit:
        return ""
    counted: dict[str, Any] = {key: table.headings.index(name) + 1 for key, name in names.items()
               if against is not None and name == against.heading}
    return map_text(replace(proposed, **counted), doubts)


def _frequency(headed: HeadedTable, seen: HeadedTable) -> int:
    """The column of the frequency: by heading, or the first stranger.

    Without any heading it is the first column that rises or falls throughout, as a frequency does.
    """
    for place, heading in (*enumerate(headed.known), *enumerate(seen.known)):
        if heading and heading.part == "frequency":
            return place
    strangers = [place for place, heading in enumerate(headed.known) if heading is None]
    if len(strangers) < len(headed.known):
        return [*strangers, 0][0]
    steps = np.diff(headed.table.values, axis=0)
    # A count of rows rises by one.
    rises = (np.all(steps > 0.0, axis=0) | np.all(steps < 0.0, axis=0)) & ~np.all(np.abs(steps) == 1.0, axis=0)
    return int(np.argmax(rises))


def _first_half(seen: HeadedTable, place: int) -> Pair | None:
    """One column beside the frequency; a second file has the other half."""
    heading = seen.known[1 - place]
    if heading is not None and heading.part in ("scalar", "element"):
        return None
    form = "rectangular" if heading and heading.part in ("real", "imaginary") else "polar"
    return Pair(1 - place, place, _quantity(heading, form), {
        "second": "its column in the second file", "kind": "impedance, admittance ...", "form": "polar or rectangular",
        "second_file": "the file that holds the other half, in the folder of this one"})


def _quantity(heading: Heading | None, form: str, **more: object) -> RecordedQuantity:
    """The quantity of a `form` of which a heading names one half."""
    kind = heading.kind if heading and heading.kind in SYMBOLS else "impedance"
    allowed = tuple(units("magnitude" if form == "polar" else "real", kind))
    unit = heading.unit if heading and heading.unit in allowed else allowed[0]
    ports, _ = stated_ports(kind, None)
    return RecordedQuantity(**{"kind": kind, "form": form, "unit": unit, **ports, **more})  # type: ignore[arg-type]


def _guess(table: HeadedTable, frequency: int) -> Pair | None:
    """A pair of halves by their parts and places, or None.

    A gain comes first if one is named.
    """
    headings, seen = table.table.headings, table.known
    asked = {"first": "magnitude or real part", "second": "phase or imaginary part",
             "kind": "impedance, admittance, reflection, circuit or gain", "form": "polar or rectangular",
             "unit": "ohm, S, dB ...; 1 for a gain"}
    others = [place for place in range(table.table.width) if place != frequency]
    whole = next((p for p in others if p in table.table.complexes), None)
    if whole is not None:
        return Pair(whole, whole, _quantity(seen[whole], "complex"), asked)
    gain = next((p for p in others if headings and re.search(_GAIN, headings[p])), None)
    sizes, phases, real, imaginary = (
        [p for p in others if (heading := seen[p]) is not None and heading.part in parts]
        for parts in (("magnitude", "whole"), ("phase",), ("real",), ("imaginary",)))
    if gain is not None:
        # The phase of a gain follows it.
        sizes, phases = [gain], sorted(phases, key=lambda p: (p < gain, p))
    elif not phases and len(sizes) > 1 and not (real or imaginary):
        real, imaginary, sizes = sizes[:1], sizes[1:2], []
    rectangular = gain is None and bool(real or imaginary) and not (phases and sizes)
    halves, parts = ((real, imaginary), ("real", "imaginary")) if rectangular else ((sizes, phases), (
        "magnitude", "phase"))
    first, second = (next(iter(places), None) for places in halves)
    if first is None:
        first = _beside(table.table, seen, [p for p in others if p != second], parts[0])
    if second is None:
        # Without any other clue, the second half of a pair is beside the first.
        second = _beside(table.table, seen, sorted((p for p in others if p != first), key=lambda p: (
            first is not None and p < first, p)), parts[1])
    if first is None or second is None:
        return None
    named = [heading for heading in (seen[first], seen[second]) if heading and heading.kind in SYMBOLS]
    if len({heading.kind for heading in named}) > 1:
        return None
    own, more = seen[second], dict[str, object]()
    if not rectangular:
        more["phase_unit"] = own.unit if own and own.unit in PHASE_UNITS else "deg"
    if gain is not None:
        more |= {"kind": "gain", "unit": "dB" if "db" in headings[first].casefold() else "1",
                 "reference_resistance": 1.0, "configuration": ""}
        asked |= {"reference_resistance": "ohm, of the resistor in series",
                  "inverse": "true if the gain is that of both over the resistor"}
    if own is not None and own.negated:
        more["negated"] = True
    form = "rectangular" if rectangular else "polar"
    return Pair(first, second, _quantity(next(iter(named), None), form, **more), asked)


def _beside(table: Table, seen: Sequence[Heading | None], places: Sequence[int], part: str) -> int | None:
    """The first of `places` that may be that `part`."""
    for place in places:
        heading = seen[place]
        if (heading is None and not (table.headings and _FOREIGN.search(table.headings[place]))) or (
                heading is not None and heading.part == part):
            return place
    return None
