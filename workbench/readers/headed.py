"""A table of text with clear headings, read without a column map.

Values settle an open question of the headings only if they admit one answer: a frequency without a unit by the range of
analysers, a phase without a unit by values no phase in radians can have. Everything else is refused, with a column map
to be checked and handed back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.files.quantities import UNITS
from workbench.readers.columns import ColumnMap, column_map_text, recorded
from workbench.readers.findings import PLAUSIBLE_HZ, examine
from workbench.readers.headings import Heading, understand
from workbench.readers.layouts import Body, TableLayout, body_of, column_name, find_layout, handle
from workbench.readers.pairs import Pair, agree, find_pairs, reference_of
from workbench.readers.proposals import proposal
from workbench.readers.sweep import Recorded
from workbench.readers.text import RecordingText

OPTION = "--columns MAP.toml"

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

    def refused(why: str, pair: Pair | None = None, doubts: Mapping[str, str] | None = None) -> InputError:
        text_of_map = proposal(layout, body, known, pair, {**(doubts or {}), **(pair.doubts if pair else {})})
        line = (layout.line if layout.headings else layout.start) + 1
        remedy = (f"Look through this map, save it as MAP.toml and give {OPTION} (in a file that names the recording: "
                  f'columns = "MAP.toml"):\n\n{text_of_map}\n') if text_of_map else (
                      "No column map helps: save magnitude and phase, or real and imaginary part, from the instrument")
        return text.error(line, None, text.lines[line - 1].strip()[:200],
                          f"headings that say what every column is; {why}. {remedy}")

    if not layout.headings:
        raise refused("there are none above the numbers")
    if len(frequencies) != 1:
        raise refused(f"{len(frequencies) or 'none'} of them {'are frequencies' if frequencies else 'is a frequency'}")
    place = frequencies[0]
    unit, note = _frequency_unit(known[place], body.values[:, place])
    pairs = find_pairs(layout, known, body, reference_of(text, layout))
    if not unit:
        raise refused(f"{column_name(layout, place)}: {note}", next(iter(pairs), None),
                      {"frequency_unit": "UNCLEAR: Hz, kHz, MHz or GHz"})
    clear = [pair for pair in pairs if not pair.doubts]
    hertz = body.values[:, place] * UNITS["frequency"][unit]
    if not clear:
        # The pair that is nearest to being clear is proposed.
        best = min(pairs, key=lambda pair: len(pair.doubts), default=None)
        why = "; ".join(best.notes[place] for place in best.notes) if best else _lacking(layout, known)
        raise refused(why, best)
    pair = clear[0]
    if not agree(clear, body.values, hertz):
        raise refused("two pairs of columns hold different impedances", pair, {"first": "UNCLEAR: of which pair?"})
    found = _read(text, layout, body, pair, frequency=(place, unit, note), instrument=instrument)
    if pair.primed and any(finding.code == "conjugated" for finding in examine(found.spectrum)):
        # Foster's theorem contradicts the sign, and the sign of Z'' varies between authors.
        other = replace(pair, quantity=replace(pair.quantity, negated=not pair.quantity.negated),
                        doubts={"negated": "UNCLEAR: true if the column is minus the imaginary part"})
        raise refused(f"{column_name(layout, pair.second)} as it is written would be the reactance of nothing passive: "
                      "is it of the other sign?", other)
    return found


def _read(
    text: RecordingText, layout: TableLayout, body: Body, pair: Pair, *, frequency: tuple[int, str, str],
    instrument: str
) -> Recorded:
    """The spectrum in a pair of columns; `frequency` is its column (from 0), its unit and the reason for the unit."""
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
    values = [body.rows.column(text, place, width=layout.width, decimal=body.decimal)]
    if whole:
        values += body.rows.complex_column(text, pair.first, width=layout.width, decimal=body.decimal)
    else:
        values += [body.rows.column(text, one, width=layout.width, decimal=body.decimal) for one in places[1:]]
    return recorded(text, body.rows, columns, values=values, column=place + 1, instrument=instrument,
                     read_as=f"by its headings, {read_as}")


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


def _lacking(layout: TableLayout, known: Sequence[Heading | None]) -> str:
    """The halves of a pair that are present, and a note that the others are missing."""
    names = {"magnitude": "a magnitude", "whole": "a magnitude", "phase": "a phase", "real": "a real part",
             "imaginary": "an imaginary part"}
    there = [f"{column_name(layout, place)} is {names[heading.part]}" + ("" if heading.kind or heading.part == "phase"
             else " of nothing that is named") for place, heading in enumerate(known)
             if heading and heading.part in names]
    there += [f"{column_name(layout, place)} is {heading.kind} of an equivalent circuit" for place, heading
              in enumerate(known) if heading and heading.part == "element"]
    there += [f"{column_name(layout, place)} is a ratio or loss without a phase, from which no impedance follows: save "
              "S11 as real and imaginary part" for place, heading in enumerate(known)
              if heading and heading.part == "scalar"]
    strangers = [column_name(layout, place) for place, heading in enumerate(known) if heading is None]
    return "; ".join([*there, *([f"not understood: {', '.join(strangers)}"] if strangers else []),
                      "no two columns together are one magnitude and phase, one real and imaginary part, or one "
                      "circuit, of an impedance or admittance"])
