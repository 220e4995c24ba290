"""The column map that is proposed if headings leave a doubt.

No heading is contradicted: one that names a part or a quantity is proposed as that, or not at all.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from workbench.readers.columns import ColumnMap, contradiction, map_text
from workbench.readers.headings import SYMBOLS, Heading, hint, is_series
from workbench.readers.layouts import Body, TableLayout, handle
from workbench.readers.pairs import Pair, stated_ports
from workbench.readers.quantities import CIRCUITS, ELEMENT_UNITS, MAGNITUDE_UNITS, PHASE_UNITS, RecordedQuantity

#: Units of quantities that are no half of an impedance: voltage, current, power, time, temperature.
_FOREIGN = re.compile(r"(?:[(/\[]|\bin |_)\s*(?:[munpkM]|μ|µ)?(?:V|A|W|s|sec|°?C|degC|K|dBm|dBV)"
                      r"(?:pp|rms|_?RMS)?\s*[)\]]?\s*$")


def proposal(
    layout: TableLayout, body: Body, known: Sequence[Heading | None], pair: Pair | None, doubts: Mapping[str, str]
) -> str:
    """The text of the most likely column map; "" if any map would contradict a heading."""
    strangers = [p for p, heading in enumerate(known) if heading is None]
    place = next((p for p, heading in enumerate(known) if heading and heading.part == "frequency"), [*strangers, 0][0])
    if all(heading is None for heading in known):
        place = _rising(body)
    quantity: dict[str, object]
    doubts = dict(doubts)
    second_file = False
    if pair is not None:
        places = (place, pair.first, pair.second)
        quantity = _as_table(pair.quantity, negated="negated" in doubts)
    elif layout.width < 3 and not body.complexes:
        # The other half may be in a file of its own.
        places, second_file = (place, 1 - place, 1 - place), True
        heading = known[1 - place] or hint(layout.headings[1 - place] if layout.headings else "")
        if heading is not None and heading.part in ("scalar", "element"):
            return ""
        quantity = _half(heading)
        doubts = {"second": "UNCLEAR: its column in the second file", "second_file": "UNCLEAR: the file that holds the "
                  "other half, in the folder of this one", "kind": "UNCLEAR: impedance, admittance ...",
                  "form": "UNCLEAR: polar or rectangular", **doubts}
    else:
        guessed = _guess(layout, body, known, place)
        if guessed is None:
            return ""
        places, quantity = guessed
        doubts = {"first": "UNCLEAR: magnitude or real part", "second": "UNCLEAR: phase or imaginary part",
                  "kind": "UNCLEAR: impedance, admittance, reflection, circuit or gain",
                  "form": "UNCLEAR: polar or rectangular",
                  "unit": "UNCLEAR: ohm, S, dB ...; 1 for a gain",
                  "reference_resistance": "UNCLEAR: ohm, of the resistor in series",
                  "inverse": "UNCLEAR: true if the gain is that of both over the resistor", **doubts}
        if quantity["kind"] == "circuit":
            doubts |= {"first": "UNCLEAR: which element", "second": "UNCLEAR: which element",
                       "form": "UNCLEAR: one of " + ", ".join(CIRCUITS), "unit": "UNCLEAR: of the first column",
                       "second_unit": "UNCLEAR: of the second column"}
        if not any(heading and heading.part == "frequency" for heading in known):
            doubts = {"frequency": "UNCLEAR: a heading, or the number of the column",
                      "frequency_unit": "UNCLEAR: Hz, kHz or MHz", **doubts}
    frequency = known[place]
    head: dict[str, object] = {"frequency": handle(layout, places[0]), "first": handle(layout, places[1])}
    if second_file:
        head["second"] = 2
    elif quantity["form"] != "complex":
        head["second"] = handle(layout, places[2])
    head["frequency_unit"] = frequency.unit if frequency and frequency.part == "frequency" and frequency.unit else "Hz"
    head |= {"delimiter": layout.delimiter, "decimal": body.decimal}
    if second_file:
        head["second_file"] = "SECOND.csv"
    elif layout.headings and _contradicts(layout, places, quantity):
        return ""
    return map_text(head, quantity, doubts)


def _contradicts(layout: TableLayout, places: tuple[int, int, int], quantity: Mapping[str, object]) -> bool:
    """Whether a quantity contradicts the headings of its columns."""
    resistance = {"reference_resistance": 1.0} if "reference_resistance" in quantity else {}
    frequency, first, second = (layout.headings[place] for place in places)
    if len({frequency, first, second}) < len(set(places)):
        # Headings that occur twice are counted, and have no say.
        return False
    proposed = RecordedQuantity(**{**quantity, **resistance})  # type: ignore[arg-type]
    return contradiction(ColumnMap(frequency, first, None if proposed.form == "complex" else second,
                                   proposed)) is not None


def _as_table(quantity: RecordedQuantity, *, negated: bool) -> dict[str, object]:
    """The entries of a quantity in a column map."""
    found: dict[str, object] = {"kind": quantity.kind, "form": quantity.form, "unit": quantity.unit}
    if quantity.form == "polar":
        found["phase_unit"] = quantity.phase_unit
    if quantity.kind == "circuit":
        found["second_unit"] = quantity.second_unit
    if quantity.reference_resistance is not None:
        found["reference_resistance"] = quantity.reference_resistance
    if quantity.configuration:
        found["configuration"] = quantity.configuration
    if quantity.negated or negated:
        found["negated"] = quantity.negated
    return found


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


def _guess(
    layout: TableLayout, body: Body, known: Sequence[Heading | None], frequency: int
) -> tuple[tuple[int, int, int], dict[str, object]] | None:
    """Columns and quantity if no pair was found: a gain if one is named, else the existing halves of pairs; None if too
    few columns are left."""
    others = [place for place in range(layout.width) if place != frequency]
    seen = [heading or (hint(layout.headings[place]) if layout.headings else None)
            for place, heading in enumerate(known)]

    def place_of(*parts: str) -> int | None:
        return next((p for p in others if (heading := seen[p]) is not None and heading.part in parts), None)

    whole = next((p for p in others if p in body.complexes), None)
    if whole is not None:
        half = _half(seen[whole])
        half.pop("phase_unit", None)
        return (frequency, whole, whole), {**half, "form": "complex"}
    gain = next((p for p in others if layout.headings and re.search("(?i)gain|ratio|math", layout.headings[p])), None)
    elements = [p for p in others if (heading := seen[p]) is not None and heading.part == "element"]
    if elements and gain is None and place_of("magnitude", "whole") is None:
        found = _guessed_circuit(layout, seen, others, elements[0])
        if found is not None:
            return (frequency, *found[0]), found[1]
    rectangular = place_of("real", "imaginary") is not None and (
        place_of("phase") is None or place_of("magnitude", "whole") is None)
    form = "rectangular" if gain is None and rectangular else "polar"
    phase = place_of("phase")
    if gain is not None:
        # The phase of a gain follows it.
        angles = [p for p in others if (heading := seen[p]) is not None and heading.part == "phase"]
        phase = min(angles, key=lambda p: (p < gain, p), default=None)
    halves = [place_of("magnitude", "whole"), phase] if form == "polar" else [
        place_of("real"), place_of("imaginary")]
    first, second = halves if gain is None else (gain, halves[1])
    parts: tuple[tuple[str, ...], tuple[str, ...]] = (("magnitude", "whole"), ("phase",)) if form == "polar" else (
        ("real",), ("imaginary",))
    if first is None:
        first = _beside(layout, seen, [p for p in others if p != second], parts[0])
    if second is None:
        # Without any other clue, the second half of a pair is beside the first.
        second = _beside(layout, seen, sorted((p for p in others if p != first), key=lambda p: (
            first is not None and p < first, p)), parts[1])
    if first is None or second is None:
        return None
    kinds = {heading.kind for heading in (seen[first], seen[second]) if heading and heading.kind in SYMBOLS}
    if len(kinds) > 1:
        return None
    quantity = _half(next((h for h in (seen[first], seen[second]) if h and h.kind in SYMBOLS), None))
    quantity["form"] = form
    if form == "polar":
        own = seen[second]
        quantity["phase_unit"] = own.unit if own and own.unit in PHASE_UNITS else "deg"
    else:
        quantity.pop("phase_unit", None)
        if quantity["unit"] == "dB":
            quantity["unit"] = next(iter(MAGNITUDE_UNITS[str(quantity["kind"])]))
    if gain is not None:
        quantity |= {"kind": "gain", "unit": "dB" if "db" in layout.headings[first].casefold() else "1",
                     "reference_resistance": 0.0, "inverse": False}
    own = seen[second]
    if own is not None and own.negated:
        quantity["negated"] = True
    return (frequency, first, second), quantity


def _beside(
    layout: TableLayout, seen: Sequence[Heading | None], places: Sequence[int], parts: Sequence[str]
) -> int | None:
    """The first of `places` whose heading is not known to be something else than one of `parts`."""
    for place in places:
        heading = seen[place]
        if (heading is None and not (layout.headings and _FOREIGN.search(layout.headings[place]))) or (
                heading is not None and heading.part in parts):
            return place
    return None


def _guessed_circuit(
    layout: TableLayout, seen: Sequence[Heading | None], others: Sequence[int], place: int
) -> tuple[tuple[int, int], dict[str, object]] | None:
    """A circuit with the element in the column `place`, and the column beside it as the other element."""
    def symbol(of: int) -> str:
        heading = seen[of]
        if heading is None or heading.part not in ("element", "real", "imaginary"):
            return ""
        rectangular = {("real", "impedance"): "Rs", ("imaginary", "impedance"): "X", ("real", "admittance"): "G",
                       ("imaginary", "admittance"): "B"}
        return heading.kind if heading.part == "element" else rectangular.get((heading.part, heading.kind), "")

    one = symbol(place)
    for other in sorted((p for p in others if p != place), key=lambda p: (p < place, p)):
        two = symbol(other)
        series = {two: is_series(layout.headings[other]), one: is_series(layout.headings[place])}.get("Rs", False)
        for circuit in CIRCUITS:
            for names in (circuit.split("-"), circuit.split("-")[::-1]):
                # A letter alone, or a resistance beside a capacitance of the other circuit, leaves this open.
                fits = all(name[0] == said[:1] and (len(said) == 1 or said in (name, "Rs"))
                           for name, said in zip(names, (one, two), strict=True))
                if fits and not (series and "Rp" in names):
                    units = [heading.unit if heading and heading.unit in ELEMENT_UNITS[name] else
                             next(iter(ELEMENT_UNITS[name])) for name, heading in zip(names, (
                                 seen[place], seen[other]), strict=True)]
                    return (place, other), {"kind": "circuit", "form": "-".join(names), "unit": units[0],
                                            "second_unit": units[1]}
    return None
