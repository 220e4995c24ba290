"""The refusal of a table whose headings leave a doubt, and the column map that it proposes.

No heading is contradicted: one that names a part or a quantity is proposed as that, or not at all.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from workbench.files.errors import InputError
from workbench.readers.columns import PART_WORDS, ColumnMap, Contradiction, contradiction, map_text
from workbench.readers.headings import SYMBOLS, Heading, hint
from workbench.readers.layouts import Body, TableLayout, handle
from workbench.readers.pairs import HeadedTable, Pair, find_pairs, stated_ports
from workbench.readers.quantities import MAGNITUDE_UNITS, PHASE_UNITS, RecordedQuantity
from workbench.readers.text import RecordingText

OPTION = "--columns MAP.toml"

#: Units of quantities that are no half of an impedance: voltage, current, power, time, temperature.
_FOREIGN = re.compile(r"(?:[(/\[]|\bin |_)\s*(?:[munpkM]|μ|µ)?(?:V|A|W|s|sec|°?C|degC|K|dBm|dBV)"
                      r"(?:pp|rms|_?RMS)?\s*[)\]]?\s*$")
_GAIN = "(?i)gain|ratio|math"

#: Columns (from 0) of the frequency and of both halves, entries of the quantity, and choices by key that are open.
_Proposed = tuple[tuple[int, int, int], dict[str, object], dict[str, str]]


def headings_in_doubt(
    text: RecordingText, table: HeadedTable, why: str, pair: Pair | None = None,
    doubts: Mapping[str, str] = MappingProxyType({}), select: Mapping[str, str] = MappingProxyType({}),
) -> InputError:
    """The error about headings that leave a doubt, with the column map to be looked through."""
    layout = table.layout
    text_of_map = proposal(table, pair, {**doubts, **(pair.doubts if pair else {})}, select)
    line = (layout.line if layout.headings else layout.start) + 1
    remedy = (f"Look through this map, save it as MAP.toml and give {OPTION} (in a file that names the recording: "
              f'columns = "MAP.toml"):\n\n{text_of_map}\n') if text_of_map else (
                  "No column map helps: save magnitude and phase, or real and imaginary part, from the instrument")
    return text.error(line, None, text.lines[line - 1].strip()[:200],
                      f"headings that state the quantity of every column; {why}. {remedy}")


def proposal(
    table: HeadedTable, pair: Pair | None, doubts: Mapping[str, str], select: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """The text of the most likely column map; "" if any map would contradict a heading.

    Headings that are not understood count by their apparent meaning (:func:`hint`). `select` asks for one state.
    """
    layout, body, known = table.layout, table.body, table.known
    seen = replace(table, known=[heading or (hint(layout.headings[p]) if layout.headings else None)
                                 for p, heading in enumerate(known)], reference=None)
    place = _frequency(table, seen)
    if pair is None and layout.headings and not any(re.search(_GAIN, heading) for heading in layout.headings):
        pairs = [each for each in find_pairs(seen) if place not in (each.first, each.second)]
        pair = min(pairs, key=lambda each: len(each.doubts), default=None)
        if pair is not None:
            columns = (("frequency", place, "frequency", ""), *(
                (key, of, part, kind) for key, of, (part, kind, _) in zip(
                    ("first", "second"), (pair.first, pair.second), pair.quantity.columns, strict=False)))
            strangers = {key: f"is it {PART_WORDS.get(part, kind)}?" for key, of, part, kind in columns
                         if known[of] is None}
            doubts = {**strangers, **pair.doubts, **doubts}
    second_file = pair is None and layout.width < 3 and not body.complexes
    proposed = _stated(pair, place, doubts) if pair is not None else (
        _first_half(seen, place) if second_file else _guess(seen, place))
    if proposed is None:
        return ""
    places, quantity, asked = proposed
    doubts = {**asked, **doubts}
    frequency = seen.known[place]
    stated = frequency.unit if frequency is not None and frequency.part == "frequency" else ""
    if known[place] is None or sum(heading is not None and heading.part == "frequency" for heading in known) > 1:
        doubts = {"frequency": "a heading, or the number of the column",
                  **({} if stated else {"frequency_unit": "Hz, kHz or MHz"}), **doubts}
    unit = stated or "Hz"
    against = None if second_file or not layout.headings else _against(layout, places, quantity, unit)
    if against is not None and not against.unit:
        return ""
    names = [place + 1 if against is not None and layout.headings[place] == against.heading else handle(layout, place)
             for place in places]
    head: dict[str, object] = {"frequency": names[0], "first": names[1]}
    if quantity["form"] != "complex":
        head["second"] = 2 if second_file else names[2]
    head |= {"frequency_unit": unit, "delimiter": layout.delimiter, "decimal": body.decimal}
    head |= {"second_file": "SECOND.csv"} if second_file else {}
    head |= {"select": dict(select)} if select else {}
    return map_text(head, quantity, doubts)


def _frequency(table: HeadedTable, seen: HeadedTable) -> int:
    """The column of the frequency: by its heading, or else the first one that no heading explains."""
    for place, heading in (*enumerate(table.known), *enumerate(seen.known)):
        if heading and heading.part == "frequency":
            return place
    strangers = [place for place, heading in enumerate(table.known) if heading is None]
    return _rising(table.body) if len(strangers) == len(table.known) else [*strangers, 0][0]


def _against(
    layout: TableLayout, places: tuple[int, int, int], quantity: Mapping[str, object], unit: str
) -> Contradiction | None:
    """The contradiction of a quantity, and of the `unit` of the frequency, to the headings of its columns."""
    resistance = {"reference_resistance": 1.0} if "reference_resistance" in quantity else {}
    frequency, first, second = (layout.headings[place] for place in places)
    if len({frequency, first, second}) < len(set(places)):
        # Headings that occur twice are counted, and have no say.
        return None
    proposed = RecordedQuantity(**{**quantity, **resistance})  # type: ignore[arg-type]
    return contradiction(ColumnMap(frequency, first, None if proposed.form == "complex" else second, proposed, unit))


def _stated(pair: Pair, place: int, doubts: Mapping[str, str]) -> _Proposed:
    """The proposal of a pair beside the frequency at `place`; a sign in doubt is written out."""
    quantity = pair.quantity
    entries = {"kind": quantity.kind, "form": quantity.form, "unit": quantity.unit,
               "phase_unit": quantity.phase_unit if quantity.form == "polar" else None,
               "second_unit": quantity.second_unit or None, "reference_resistance": quantity.reference_resistance,
               "configuration": quantity.configuration or None,
               "negated": quantity.negated if quantity.negated or "negated" in {**pair.doubts, **doubts} else None}
    return (place, pair.first, pair.second), {key: each for key, each in entries.items() if each is not None}, {}


def _first_half(seen: HeadedTable, place: int) -> _Proposed | None:
    """The proposal of one column beside the frequency at `place`: the other half may be in a file of its own."""
    heading = seen.known[1 - place]
    if heading is not None and heading.part in ("scalar", "element"):
        return None
    return (place, 1 - place, 1 - place), _half(heading), {
        "second": "its column in the second file", "kind": "impedance, admittance ...", "form": "polar or rectangular",
        "second_file": "the file that holds the other half, in the folder of this one"}


def _rising(body: Body) -> int:
    """The first column that rises or falls throughout, as a frequency does; the first one if none does."""
    for place in range(body.values.shape[1]):
        steps = np.diff(body.values[:, place])
        # A count of rows rises by one.
        if (np.all(steps > 0.0) or np.all(steps < 0.0)) and not np.all(np.abs(steps) == 1.0):
            return place
    return 0


def _half(heading: Heading | None) -> dict[str, object]:
    """The quantity of which a heading names one half."""
    kind = heading.kind if heading and heading.kind in SYMBOLS else "impedance"
    form = "rectangular" if heading and heading.part in ("real", "imaginary") else "polar"
    usual = next(iter(MAGNITUDE_UNITS[kind]))
    unit = heading.unit if heading and heading.unit in (*MAGNITUDE_UNITS[kind], "dB") else usual
    more, _ = stated_ports(kind, None)
    return {"kind": kind, "form": form, "unit": unit, **({"phase_unit": "deg"} if form == "polar" else {}), **more}


def _guess(table: HeadedTable, frequency: int) -> _Proposed | None:
    """The proposal if no pair was found: a gain if one is named, else the existing halves of pairs; None if too few
    columns are left."""
    layout, body, seen = table.layout, table.body, table.known
    asked = {"first": "magnitude or real part", "second": "phase or imaginary part",
             "kind": "impedance, admittance, reflection, circuit or gain", "form": "polar or rectangular",
             "unit": "ohm, S, dB ...; 1 for a gain", "reference_resistance": "ohm, of the resistor in series",
             "inverse": "true if the gain is that of both over the resistor"}
    others = [place for place in range(layout.width) if place != frequency]

    def places_of(*parts: str) -> list[int]:
        return [p for p in others if (heading := seen[p]) is not None and heading.part in parts]

    whole = next((p for p in others if p in body.complexes), None)
    if whole is not None:
        half = _half(seen[whole])
        half.pop("phase_unit", None)
        return (frequency, whole, whole), {**half, "form": "complex"}, asked
    gain = next((p for p in others if layout.headings and re.search(_GAIN, layout.headings[p])), None)
    sizes, phases, real, imaginary = (places_of(*parts) for parts in (
        ("magnitude", "whole"), ("phase",), ("real",), ("imaginary",)))
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
        first = _beside(layout, seen, [p for p in others if p != second], parts[0])
    if second is None:
        # Without any other clue, the second half of a pair is beside the first.
        second = _beside(layout, seen, sorted((p for p in others if p != first), key=lambda p: (
            first is not None and p < first, p)), parts[1])
    if first is None or second is None:
        return None
    named = [heading for heading in (seen[first], seen[second]) if heading and heading.kind in SYMBOLS]
    if len({heading.kind for heading in named}) > 1:
        return None
    quantity = {**_half(next(iter(named), None)), "form": "rectangular" if rectangular else "polar"}
    own = seen[second]
    if not rectangular:
        quantity["phase_unit"] = own.unit if own and own.unit in PHASE_UNITS else "deg"
    else:
        quantity.pop("phase_unit", None)
        if quantity["unit"] == "dB":
            quantity["unit"] = next(iter(MAGNITUDE_UNITS[str(quantity["kind"])]))
    if gain is not None:
        quantity |= {"kind": "gain", "unit": "dB" if "db" in layout.headings[first].casefold() else "1",
                     "reference_resistance": 0.0, "inverse": False}
    if own is not None and own.negated:
        quantity["negated"] = True
    return (frequency, first, second), quantity, asked


def _beside(layout: TableLayout, seen: Sequence[Heading | None], places: Sequence[int], part: str) -> int | None:
    """The first of `places` whose heading is not known to be something else than `part`."""
    for place in places:
        heading = seen[place]
        if (heading is None and not (layout.headings and _FOREIGN.search(layout.headings[place]))) or (
                heading is not None and heading.part == part):
            return place
    return None
