"""A table of text with clear headings, read without a column map.

Values settle an open question of the headings only if they admit one answer: a frequency without a unit by the range of
analysers, a phase without a unit by values no phase in radians can have. Everything else is refused, with a column map
to be checked and handed back.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.files.quantities import UNITS
from workbench.readers.agreement import FAULTY, disagreement, impedance_of
from workbench.readers.columns import ColumnMap, column_map_text, recorded
from workbench.readers.findings import PLAUSIBLE_HZ, Finding, examine
from workbench.readers.headings import Heading, understand
from workbench.readers.layouts import body_of, find_layout, handle
from workbench.readers.pairs import HeadedTable, Pair, find_pairs, reference_of
from workbench.readers.proposals import OPTION, headings_in_doubt
from workbench.readers.states import select_of, telling_columns, values_in_words
from workbench.readers.sweep import Recorded
from workbench.readers.text import RecordingText

#: Highest frequency (Hz) of bench analysers of this kind (E4990A data sheet: 120 MHz): a unit that takes a sweep beyond
#: is wrong.
ANALYSERS_UP_TO_HZ = 120e6


def recognises_headed(text: RecordingText) -> bool:
    """Whether the file holds a table of columns, understood or not."""
    return find_layout(text) is not None


def parse_headed(text: RecordingText, *, instrument: str = "") -> Recorded:
    """Read the file; the origin's setting ``columns.READ_AS`` states the meaning of each column, with reasons.

    Raises:
        InputError: no table, a faulty row, or headings that leave a doubt; the message ends with a column map.
    """
    layout = find_layout(text)
    if layout is None:
        raise InputError(text.path, "rows", text.lines[0][:80],
                         f"a table of three columns or more; {OPTION} names them")
    known = [understand(heading) for heading in layout.headings] or [None] * layout.width
    frequencies = [place for place, heading in enumerate(known) if heading and heading.part == "frequency"]
    body = body_of(text, layout, frequencies[0] if frequencies else 0)
    table = HeadedTable(layout, body, known, reference_of(text, layout))

    refused = partial(headings_in_doubt, text, table)
    if not layout.headings:
        raise refused("there are none above the numbers")
    if len(frequencies) != 1:
        raise refused(f"{len(frequencies) or 'none'} of them {'are frequencies' if frequencies else 'is a frequency'}")
    place = frequencies[0]
    unit, note = _frequency_unit(known[place], body.values[:, place])
    pairs = find_pairs(table)
    if not unit:
        raise refused(f"{table.name(place)}: {note}", next(iter(pairs), None),
                      {"frequency_unit": "Hz, kHz, MHz or GHz"})
    clear = [pair for pair in pairs if not pair.doubts]
    hertz = body.values[:, place] * UNITS["frequency"][unit]
    if not clear:
        # The pair that is nearest to being clear is proposed.
        best = min(pairs, key=lambda pair: len(pair.doubts), default=None)
        why = "; ".join(best.notes[place] for place in best.notes) if best else _lacking(table)
        raise refused(why, best)
    pair = clear[0]
    against = disagreement(table, pair, hertz)
    if against is not None and against.share > FAULTY:
        other = clear[1] if against.unsigned and len(clear) > 1 else pair
        raise refused(f"its columns hold different impedances: {against.words}", other, {
            "first": "of which pair?"})
    telling = telling_columns(body.rows, layout.headings, (place, pair.first, pair.second), hertz,
                              impedance_of(body, pair, hertz))
    if telling:
        raise refused("it holds sweeps of several devices or states, told apart by "
                      f"{values_in_words(telling, layout.headings)}", pair, {
                          "select": "which of them?"}, select_of(telling, layout.headings))
    found = _read(table, pair, frequency=(place, unit, note), instrument=instrument)
    if against is not None:
        rows = tuple(body.rows.lines[int(row)] for row in against.rows)
        found = replace(found, findings=(*found.findings, Finding("columns", against.words, rows)))
    if pair.primed and any(finding.code == "conjugated" for finding in examine(found.spectrum)):
        # Foster's theorem contradicts the sign, and the sign of Z'' varies between authors.
        other = replace(pair, quantity=replace(pair.quantity, negated=not pair.quantity.negated),
                        doubts={"negated": "true if the column is minus the imaginary part"})
        raise refused(f"{table.name(pair.second)} as it is written would be the reactance of nothing passive: "
                      "is it of the other sign?", other)
    return found


def _read(table: HeadedTable, pair: Pair, *, frequency: tuple[int, str, str], instrument: str) -> Recorded:
    """The spectrum in a pair of columns; `frequency` is its column (from 0), its unit and the reason for the unit."""
    layout, body = table.layout, table.body
    place, unit, note = frequency
    whole = pair.quantity.form == "complex"
    places = (place, pair.first) if whole else (place, pair.first, pair.second)
    columns = ColumnMap(handle(layout, place), handle(layout, pair.first),
                        None if whole else handle(layout, pair.second), pair.quantity, unit, layout.delimiter,
                        body.decimal)
    notes = {handle(layout, one): why for one, why in {place: note, **pair.notes}.items() if why}
    called = {handle(layout, one): f'heading "{layout.headings[one]}"' for one in places
              if isinstance(handle(layout, one), int)}
    read_as = column_map_text(columns, {name: ", ".join(filter(None, (called.get(name), notes.get(name))))
                                        for name in {**called, **notes}})
    rest = [f'"{heading}"' for other, heading in enumerate(layout.headings) if other not in places and heading]
    read_as += f"; not used: {', '.join(rest)}" if rest else ""
    return recorded(body.rows, columns, values=body.rows.numbers(places, last_is_complex=whole), column=place + 1,
                    instrument=instrument, read_as=f"by its headings, {read_as}")


def _frequency_unit(heading: Heading | None, values: NDArray[np.float64]) -> tuple[str, str]:
    """The unit of a frequency and its reason; "" and the reason of the doubt if it is not clear."""
    assert heading is not None
    if heading.unit:
        return heading.unit, ""
    if heading.strange_unit:
        return "", f"its unit {heading.strange_unit!r} is not one of {', '.join(UNITS['frequency'])}"
    highest = float(np.nanmax(values, initial=0.0))
    possible = [unit for unit, factor in UNITS["frequency"].items()
                if PLAUSIBLE_HZ <= highest * factor <= ANALYSERS_UP_TO_HZ]
    if len(possible) == 1:
        return possible[0], f"no unit given, and up to {highest:g} nothing else is within an analyser's reach"
    return "", f"a frequency without a unit, and up to {highest:g} it may be in {' or '.join(possible) or 'none'}"


def _lacking(table: HeadedTable) -> str:
    """The halves of a pair that are present, and a note that the others are missing."""
    names = {"magnitude": "a magnitude", "whole": "a magnitude", "phase": "a phase", "real": "a real part",
             "imaginary": "an imaginary part"}
    there = [f"{table.name(place)} is {names[heading.part]}" + ("" if heading.kind or heading.part == "phase"
             else " of nothing that is named") for place, heading in enumerate(table.known)
             if heading and heading.part in names]
    there += [f"{table.name(place)} is {heading.kind} of an equivalent circuit" for place, heading
              in enumerate(table.known) if heading and heading.part == "element"]
    there += [f"{table.name(place)} is a ratio or loss without a phase, from which no impedance follows: save "
              "S11 as real and imaginary part" for place, heading in enumerate(table.known)
              if heading and heading.part == "scalar"]
    strangers = [table.name(place) for place, heading in enumerate(table.known) if heading is None]
    return "; ".join([*there, *([f"not understood: {', '.join(strangers)}"] if strangers else []),
                      "no two columns together are one magnitude and phase, one real and imaginary part, or one "
                      "circuit, of an impedance or admittance"])
