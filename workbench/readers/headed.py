"""A table of text whose headings say what its columns are, read without a column map.

What the headings leave open is decided by the values only where these admit one answer: a frequency without a unit by
what analysers reach, a phase without a unit by values no phase in radians can have. Everything else is refused, with a
column map to be looked through and handed back.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.files.quantities import UNITS
from workbench.readers.columns import COMMENTS, ColumnMap, in_words, map_text, spectrum, table_rows, uncommented
from workbench.readers.findings import PLAUSIBLE_HZ, examine
from workbench.readers.headings import SYMBOLS, Heading, is_unit, understand
from workbench.readers.quantities import MAGNITUDE_UNITS, PHASE_UNITS, Quantity
from workbench.readers.text import RecordingText, Rows, cells
from workbench.spectrum import Spectrum

OPTION = "--columns MAP.toml"

#: What bench analysers of this kind reach (E4990A data sheet: 120 MHz): a unit that takes a sweep beyond is wrong.
HIGHEST_HZ = 120e6
#: Rounded, and beyond what a phase in radians can be (pi).
LARGEST_RAD = 3.2
#: Two pairs of columns that differ by more than this (rms, of |Z|) do not hold one impedance: digits are rounded to
#: three or more.
AGREEMENT = 0.01

#: Lines in which headings are looked for where no rows of numbers follow.
SEARCHED = 1000

_DELIMITERS = ("\t", ";", ",", " ")
_CELL = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?")
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")


@dataclass(frozen=True)
class Layout:
    """Where a table is: its ``headings`` (none: no line of them), their ``line`` (index), the index ``start`` of its
    first row, its ``delimiter`` and number of columns; ``plain`` if the headings are cells of that one line."""

    headings: tuple[str, ...]
    line: int
    start: int
    delimiter: str
    width: int
    plain: bool


@dataclass(frozen=True)
class Pair:
    """Two columns (from 0) that hold an impedance or admittance, what they are, and what is not clear about them.

    ``doubts`` by key of a column map; ``notes`` by column, how their unit was found.
    """

    first: int
    second: int
    quantity: Quantity
    doubts: Mapping[str, str]
    notes: Mapping[int, str]
    primed: bool = False


def recognises(text: RecordingText) -> bool:
    """Whether the file holds a table of three or more columns, understood or not."""
    return _layout(text) is not None


def parse(text: RecordingText) -> Spectrum:
    """Read the file; the origin's setting ``columns.READ_AS`` says what each column was taken for, and why.

    Raises:
        InputError: no table, a faulty row, or headings that leave a doubt; the message ends with a column map.
    """
    layout = _layout(text)
    if layout is None:
        raise InputError(text.path, "rows", text.lines[0][:80],
                         f"a table of three columns or more; {OPTION} names them")
    decimal = _decimal(text, layout)
    rows = table_rows(text, layout.start, width=layout.width, delimiter=layout.delimiter, decimal=decimal)
    if len(rows.lines) < 2:
        raise text.error(layout.start, None, f"{len(rows.lines)} rows of numbers", "at least 2; the file may be cut "
                         "short")
    known = [understand(heading) for heading in layout.headings] or [None] * layout.width

    def refused(why: str, pair: Pair | None = None, doubts: Mapping[str, str] | None = None) -> InputError:
        proposal = _proposal(layout, decimal, known, pair, {**(doubts or {}), **(pair.doubts if pair else {})})
        line = (layout.line if layout.headings else layout.start) + 1
        return text.error(line, None, text.lines[line - 1].strip()[:200],
                          f"headings that say what every column is; {why}. Look through this map, save it as MAP.toml "
                          f"and give {OPTION} (in a file that names the recording: columns = \"MAP.toml\"):\n\n"
                          f"{proposal}\n")

    if not layout.headings:
        raise refused("there are none above the numbers")
    frequencies = [place for place, heading in enumerate(known) if heading and heading.part == "frequency"]
    if len(frequencies) != 1:
        raise refused(f"{len(frequencies) or 'none'} of them {'are frequencies' if frequencies else 'is a frequency'}")
    place = frequencies[0]
    unit, note = _frequency_unit(known[place], rows.values[:, place])
    if not unit:
        raise refused(f"{_named(layout, place)}: {note}", next(iter(_pairs(layout, known, rows)), None),
                      {"frequency_unit": "UNCLEAR: Hz, kHz or MHz"})
    pairs = _pairs(layout, known, rows)
    clear = [pair for pair in pairs if not pair.doubts]
    if not clear:
        # What is nearest to being clear is proposed.
        best = min(pairs, key=lambda pair: len(pair.doubts), default=None)
        why = "; ".join(best.notes.values()) if best else _lacking(layout, known)
        raise refused(why, best)
    pair = clear[0]
    if not _agree(clear, rows):
        raise refused("two pairs of columns hold different impedances", pair, {"first": "UNCLEAR: of which pair?"})
    places = (place, pair.first, pair.second)
    columns = ColumnMap(_handle(layout, place), _handle(layout, pair.first), _handle(layout, pair.second),
                        pair.quantity, unit, layout.delimiter, decimal)
    notes = {_handle(layout, one): why for one, why in {place: note, **pair.notes}.items() if why}
    called = {_handle(layout, one): f'heading "{layout.headings[one]}"' for one in places
              if isinstance(_handle(layout, one), int)}
    read_as = in_words(columns, {name: ", ".join(filter(None, (called.get(name), notes.get(name))))
                                 for name in {**called, **notes}})
    rest = [f'"{heading}"' for other, heading in enumerate(layout.headings) if other not in places and heading]
    read_as += f"; not used: {', '.join(rest)}" if rest else ""
    found = spectrum(text, rows, columns, places=places, read_as=f"by its headings, {read_as}")
    if pair.primed and any(finding.code == "conjugated" for finding in examine(found)):
        # Foster's theorem speaks against the sign, and the sign of Z'' is a matter of taste.
        other = replace(pair, quantity=replace(pair.quantity, negated=not pair.quantity.negated),
                        doubts={"negated": "UNCLEAR: true if the column is minus the imaginary part"})
        raise refused(f"{_named(layout, pair.second)} as it is written would be the reactance of nothing passive: is "
                      "it of the other sign?", other)
    return found


# --------------------------------------------------------------------------------------------------------------------
# Where the table is.


def _layout(text: RecordingText) -> Layout | None:
    """The first table of three columns or more, by its headings or, if none are understood, by its numbers."""
    numbered = _numbers(text)
    headed: Layout | None = None
    for index, line in enumerate(text.lines[:SEARCHED if numbered is None else numbered.start]):
        if not line.strip():
            continue
        if headed is not None and not line.startswith(COMMENTS) and _is_number(
                cells(line, headed.delimiter)[0]):
            break
        headed = _headings(text, index) or headed
    return headed or numbered


def _headings(text: RecordingText, index: int) -> Layout | None:
    """The layout that the line `index` gives if it is understood as headings; of several delimiters, the best."""
    line = uncommented(text.lines[index])
    below = next((row for row in text.lines[index + 1:] if row.strip() and not row.startswith(COMMENTS)), "")
    best: tuple[int, Layout] | None = None
    for delimiter in _DELIMITERS:
        for plain, names in ((True, cells(line, delimiter)), *(
                [(False, re.split(r"\s{2,}", line.strip()))] if delimiter == " " else [])):
            # Blanks stand in sentences too, of which a word or two may be understood.
            if len(names) < 3 or (delimiter == " " and len(cells(below, delimiter)) != len(names)):
                continue
            known = [understand(name) for name in names]
            count = sum(heading is not None for heading in known)
            if count < 2 or not any(heading and heading.part == "frequency" for heading in known):
                continue
            # Where several will do, the one that leaves fewest cells unexplained.
            score = 2 * count - len(names)
            if best is None or score > best[0]:
                best = score, _with_units(text, Layout(tuple(names), index, index + 1, delimiter, len(names), plain))
    return None if best is None else best[1]


def _with_units(text: RecordingText, layout: Layout) -> Layout:
    """The layout, with the units that a line below the headings gives."""
    if layout.start >= len(text.lines):
        return layout
    units = cells(uncommented(text.lines[layout.start]), layout.delimiter)
    if len(units) != layout.width or not any(units) or not all(is_unit(unit) or not unit for unit in units):
        return layout
    names = tuple(f"{name} ({unit.strip('()[]')})" if unit else name
                  for name, unit in zip(layout.headings, units, strict=True))
    return replace(layout, headings=names, start=layout.start + 1, plain=False)


def _numbers(text: RecordingText) -> Layout | None:
    """The layout of the first two rows of three numbers or more, with what stands above them as headings."""
    lines = [(index, line) for index, line in enumerate(text.lines) if line.strip()]
    bare = [(index, line) for index, line in lines if not line.startswith(COMMENTS)]
    for (index, line), (_, following) in pairwise(bare):
        for delimiter in _DELIMITERS:
            row, second = cells(line, delimiter), cells(following, delimiter)
            if len(row) == len(second) > 2 and all(map(_is_number, (*row, *second))):
                above = max((i for i, _ in lines if i < index), default=None)
                if above is not None:
                    names = cells(uncommented(text.lines[above]), delimiter)
                    if len(names) == len(row):
                        return Layout(tuple(names), above, index, delimiter, len(row), plain=True)
                return Layout((), index, index, delimiter, len(row), plain=False)
    return None


def _is_number(cell: str) -> bool:
    return _CELL.fullmatch(cell) is not None


def _decimal(text: RecordingText, layout: Layout) -> str:
    """"," if the rows have decimal commas.

    Raises:
        InputError: some have commas and some points.
    """
    if layout.delimiter == ",":
        return "."
    commas: int | None = None
    for index, line in enumerate(text.lines[layout.start:], layout.start):
        if line.strip() and not line.startswith(COMMENTS):
            for cell in cells(line, layout.delimiter):
                if _COMMA.fullmatch(cell):
                    commas = index if commas is None else commas
    if commas is None:
        return "."
    for index, line in enumerate(text.lines[layout.start:], layout.start):
        if not line.startswith(COMMENTS) and "." in line:
            raise text.error(index + 1, None, line, f"decimal commas, as on line {commas + 1}, or points, not both")
    return ","


# --------------------------------------------------------------------------------------------------------------------
# What the columns are.


def _frequency_unit(heading: Heading | None, values: NDArray[np.float64]) -> tuple[str, str]:
    """The unit of a frequency and how it was found; no unit, and why, where that is not clear."""
    assert heading is not None
    if heading.unit:
        return heading.unit, ""
    if heading.strange_unit:
        return "", f"its unit {heading.strange_unit!r} is not one of {', '.join(UNITS['frequency'])}"
    highest = float(np.max(values))
    possible = [unit for unit, factor in UNITS["frequency"].items()
                if PLAUSIBLE_HZ <= highest * factor <= HIGHEST_HZ]
    if len(possible) == 1:
        return possible[0], f"no unit given, and up to {highest:g} nothing else is within an analyser's reach"
    return "", f"a frequency without a unit, and up to {highest:g} it may be in {' or '.join(possible) or 'none'}"


def _pairs(layout: Layout, known: Sequence[Heading | None], rows: Rows) -> list[Pair]:
    """Every two columns that may hold the impedance, those of the first columns first."""
    found = []
    for kind in SYMBOLS:
        real, imaginary = _of(known, "real", kind), _of(known, "imaginary", kind)
        if len(real) == len(imaginary) == 1:
            found.append(_pair(layout, known, rows, kind, "rectangular", (real[0], imaginary[0])))
        # A bare Z beside a phase is the magnitude, and a phase that does not say of what is that of what is there.
        other = next(name for name in SYMBOLS if name != kind)
        magnitude = _of(known, "magnitude", kind) or _of(known, "whole", kind)
        alone = not (_of(known, "magnitude", other) or _of(known, "whole", other))
        phase = _of(known, "phase", kind) or (_of(known, "phase", "") if alone else [])
        if len(magnitude) == len(phase) == 1:
            found.append(_pair(layout, known, rows, kind, "polar", (magnitude[0], phase[0])))
    return sorted(found, key=lambda pair: (min(pair.first, pair.second), pair.first))


def _of(known: Sequence[Heading | None], part: str, kind: str) -> list[int]:
    """The columns of that part of that quantity."""
    return [place for place, heading in enumerate(known) if heading and (heading.part, heading.kind) == (part, kind)]


def _pair(
    layout: Layout, known: Sequence[Heading | None], rows: Rows, kind: str, form: str, places: tuple[int, int]
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

    def doubt(key: str, place: int, comment: str, why: str) -> None:
        doubts[key] = f"UNCLEAR: {comment}"
        notes[place] = f"{_named(layout, place)}: {why}"

    for place, heading in zip(places, (one, two), strict=True):
        if heading.strange_unit:
            angle = heading.part == "phase"
            doubt("phase_unit" if angle else "unit", place, ", ".join(PHASE_UNITS) if angle else choice,
                  f"its unit {heading.strange_unit!r} is not known")
    if not one.unit and not one.strange_unit:
        notes[places[0]] = f"no unit given, hence {usual}"
    if form == "rectangular":
        if one.unit != two.unit and "unit" not in doubts:
            doubt("unit", places[1], choice, f"its unit is not that of {_named(layout, places[0])}")
        elif not two.unit and not two.strange_unit:
            notes[places[1]] = f"no unit given, hence {usual}"
    else:
        largest = float(np.max(np.abs(rows.values[:, places[1]])))
        if two.unit == "rad" and largest > LARGEST_RAD:
            doubt("phase_unit", places[1], "deg or rad", f"a phase in radians does not reach {largest:g}")
        elif two.unit:
            phase_unit = two.unit
        elif not two.strange_unit and largest > LARGEST_RAD:
            notes[places[1]] = f"no unit given, and a phase in radians does not reach {largest:g}"
        elif not two.strange_unit:
            doubt("phase_unit", places[1], "deg or rad", f"a phase without a unit, and up to {largest:g} it may be in "
                  "degrees or in radians")
        if unit != "dB" and np.min(rows.values[:, places[0]]) < 0.0:
            doubt("form", places[0], "polar or rectangular", "taken for a magnitude, and has values below zero")
    return Pair(*places, Quantity(kind, form, unit, phase_unit, negated=two.negated), doubts, notes, two.primed)


def _agree(pairs: Sequence[Pair], rows: Rows) -> bool:
    """Whether all pairs of columns give one impedance."""
    first, *others = (pair.quantity.impedance(rows.values[:, pair.first], rows.values[:, pair.second])
                      for pair in pairs)
    scale = np.sqrt(np.mean(np.abs(first) ** 2))
    with np.errstate(invalid="ignore"):
        return all(np.sqrt(np.mean(np.abs(other - first) ** 2)) <= AGREEMENT * scale for other in others)


def _lacking(layout: Layout, known: Sequence[Heading | None]) -> str:
    """Which halves of a pair are there, and that the others are not."""
    names = {"magnitude": "a magnitude", "whole": "a magnitude", "phase": "a phase", "real": "a real part",
             "imaginary": "an imaginary part"}
    there = [f"{_named(layout, place)} is {names[heading.part]}" + ("" if heading.kind or heading.part == "phase"
             else " of nothing that is named") for place, heading in enumerate(known)
             if heading and heading.part in names]
    strangers = [_named(layout, place) for place, heading in enumerate(known) if heading is None]
    return "; ".join([*there, *([f"not understood: {', '.join(strangers)}"] if strangers else []),
                      "no two columns together are one magnitude and phase, or one real and imaginary part, of an "
                      "impedance or admittance"])


# --------------------------------------------------------------------------------------------------------------------
# What a column map would say.


def _named(layout: Layout, place: int) -> str:
    return f'column {place + 1} "{layout.headings[place]}"'


def _handle(layout: Layout, place: int) -> str | int:
    """What a column map calls a column: its heading where that is found and tells it apart, otherwise its number."""
    if layout.plain and layout.headings.count(layout.headings[place]) == 1 and layout.headings[place]:
        return layout.headings[place]
    return place + 1


def _proposal(
    layout: Layout, decimal: str, known: Sequence[Heading | None], pair: Pair | None, doubts: Mapping[str, str]
) -> str:
    """The column map that is most likely meant."""
    strangers = [p for p, heading in enumerate(known) if heading is None]
    place = next((p for p, heading in enumerate(known) if heading and heading.part == "frequency"), [*strangers, 0][0])
    quantity: dict[str, object]
    doubts = dict(doubts)
    if pair is not None:
        places = (place, pair.first, pair.second)
        quantity = {"kind": pair.quantity.kind, "form": pair.quantity.form, "unit": pair.quantity.unit}
        if pair.quantity.form == "polar":
            quantity["phase_unit"] = pair.quantity.phase_unit
        if pair.quantity.negated or "negated" in doubts:
            quantity["negated"] = pair.quantity.negated
    else:
        places, quantity = _guess(layout, known, place)
        doubts = {"first": "UNCLEAR: magnitude or real part", "second": "UNCLEAR: phase or imaginary part",
                  "kind": "UNCLEAR: impedance, admittance or gain", "form": "UNCLEAR: polar or rectangular",
                  "unit": "UNCLEAR: ohm, S, dB ...; 1 for a gain",
                  "reference_resistance": "UNCLEAR: ohm, of the resistor in series",
                  "inverse": "UNCLEAR: true if the gain is that of both over the resistor", **doubts}
        if not any(heading and heading.part == "frequency" for heading in known):
            doubts = {"frequency": "UNCLEAR: a heading, or the number of the column",
                      "frequency_unit": "UNCLEAR: Hz, kHz or MHz", **doubts}
    frequency = known[place]
    head: dict[str, object] = dict(zip(("frequency", "first", "second"), (_handle(layout, p) for p in places),
                                       strict=True))
    head["frequency_unit"] = frequency.unit if frequency and frequency.part == "frequency" and frequency.unit else "Hz"
    head |= {"delimiter": layout.delimiter, "decimal": decimal}
    return map_text(head, quantity, doubts)


def _guess(
    layout: Layout, known: Sequence[Heading | None], frequency: int
) -> tuple[tuple[int, int, int], dict[str, object]]:
    """Columns and quantity where no pair was found: a gain if one is named, else what halves of a pair there are."""
    others = [place for place in range(layout.width) if place != frequency]

    def place_of(*parts: str) -> int | None:
        return next((p for p in others if (heading := known[p]) is not None and heading.part in parts), None)

    gain = next((p for p in others if layout.headings and re.search("(?i)gain|ratio|math", layout.headings[p])), None)
    form = "polar" if gain is not None or place_of("real", "imaginary") is None else "rectangular"
    halves = [place_of("magnitude", "whole"), place_of("phase")] if form == "polar" else [
        place_of("real"), place_of("imaginary")]
    first, second = halves if gain is None else (gain, halves[1])
    if first is None:
        first = next(p for p in others if p != second)
    if second is None:
        # Where nothing is known of it, the second half of a pair stands beside the first.
        second = min((p for p in others if p != first), key=lambda p: (p < first, p))
    quantity: dict[str, object] = {"kind": "impedance", "form": form, "unit": "ohm"}
    if form == "polar":
        quantity["phase_unit"] = "deg"
    if gain is not None:
        quantity |= {"kind": "gain", "unit": "dB" if "db" in layout.headings[first].casefold() else "1",
                     "reference_resistance": 0.0, "inverse": False}
    return (frequency, first, second), quantity
