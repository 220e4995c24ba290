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
from workbench.readers.agreement import disagreement
from workbench.readers.columns import column_map_text, recorded
from workbench.readers.findings import PLAUSIBLE_HZ, examine
from workbench.readers.headings import Heading, understand
from workbench.readers.pairs import HeadedTable, find_pairs, reference_of
from workbench.readers.proposals import OPTION, headings_in_doubt
from workbench.readers.states import select_of, telling_columns, values_in_words
from workbench.readers.sweep import Reading
from workbench.readers.tables import find_table
from workbench.readers.text import RecordingText

#: Highest frequency (Hz) of bench analysers of this kind (E4990A data sheet: 120 MHz): a unit that takes a sweep beyond
#: is wrong.
ANALYSERS_UP_TO_HZ = 120e6
#: Share of the rows that may differ as faulty readings do, with a finding. Doubled, a sign lost within a narrow
#: resonance is a finding where it should be refused.
FAULTY = 0.05


def parse_headed(
    text: RecordingText, *, instrument: str = "", date: str = "", how: str = "by its headings"
) -> Reading:
    """Read the file; the origin states the meaning of each column.

    Raises:
        InputError: no table, a faulty row, or headings that leave a doubt; the message ends with a column map.
    """
    table = find_table(text)
    if table is None:
        raise InputError(text.path, "rows", text.lines[0][:80],
                         f"a table of three columns or more; {OPTION} names them")
    known = [understand(heading) for heading in table.headings] or [None] * table.width
    frequencies = [place for place, heading in enumerate(known) if heading and heading.part == "frequency"]
    table = table.with_rows(frequencies[0] if frequencies else 0)
    if not table.lines and table.content:
        line, content, _ = table.content[0]
        raise text.error(line, None, content.strip()[:80], f"{table.width} columns of plain numbers, such as 9.5e5: "
                         "units stand in the headings")
    if len(table.lines) < 2:
        raise text.error(table.start, None, f"{len(table.lines)} rows of numbers", "at least 2; the file may be cut "
                         "short")
    headed = HeadedTable(table, known, reference_of(table))
    refused = partial(headings_in_doubt, headed)
    if not table.headings:
        raise refused("there are none above the numbers")
    if len(frequencies) != 1:
        raise refused(f"{len(frequencies) or 'none'} of them {'are frequencies' if frequencies else 'is a frequency'}")
    place, pairs = frequencies[0], find_pairs(headed)
    unit, note = _frequency_unit(known[place], table.values[:, place])
    if not unit:
        raise refused(f"{table.name(place)}: {note}", next(iter(pairs), None),
                      {"frequency_unit": "Hz, kHz, MHz or GHz"})
    clear = [pair for pair in pairs if not pair.doubts]
    hertz = table.values[:, place] * UNITS["frequency"][unit]
    if not clear:
        # The pair that is nearest to being clear is proposed.
        best = min(pairs, key=lambda pair: len(pair.doubts), default=None)
        raise refused("; ".join(best.notes.values()) if best else _lacking(headed), best)
    pair = clear[0]
    against = disagreement(headed, pair, hertz)
    if against is not None and len(against[0].rows) > FAULTY * len(table.lines):
        other = clear[1] if against[1] and len(clear) > 1 else pair
        raise refused(f"its columns hold different impedances: {against[0].message}", other,
                      {"first": "of which pair?"})
    telling = telling_columns(table, (place, pair.first, pair.second), hertz,
                              pair.quantity.impedance(*pair.values(table), hertz))
    if telling:
        raise refused(f"it holds sweeps of several devices or states, told apart by {values_in_words(telling, table)}",
                      pair, {"select": "which of them?"}, select_of(telling, table))
    columns = pair.column_map(table, place, unit)
    places = [place, pair.first, *([pair.second] if columns.second is not None else [])]
    notes = {}
    for one in places:
        called = f'heading "{table.headings[one]}"' if isinstance(table.handle(one), int) else ""
        if why := ", ".join(filter(None, (called, note if one == place else pair.notes.get(one, "")))):
            notes[table.handle(one)] = why
    rest = [f'"{heading}"' for other, heading in enumerate(table.headings) if other not in places and heading]
    read_as = f"{how}, {column_map_text(columns, notes)}" + (f"; not used: {', '.join(rest)}" if rest else "")
    found = recorded(table, columns, table.numbers(places, last_is_complex=columns.second is None), place,
                     text.origin(instrument, date, read_as=read_as))
    if pair.primed and any(finding.code == "conjugated" for finding in examine(found.spectrum)):
        # Foster's theorem contradicts the sign, and the sign of Z'' varies between authors.
        turned = replace(pair, quantity=replace(pair.quantity, negated=not pair.quantity.negated),
                         doubts={"negated": "true if the column is minus the imaginary part"})
        raise refused(f"{table.name(pair.second)} as it is written would be the reactance of nothing passive: "
                      "is it of the other sign?", turned)
    return found if against is None else replace(found, findings=(*found.findings, against[0]))


def _frequency_unit(heading: Heading | None, values: NDArray[np.float64]) -> tuple[str, str]:
    """The unit of a frequency ("": in doubt) and the reason."""
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


def _lacking(headed: HeadedTable) -> str:
    """The halves of a pair that are present, in words."""
    names = {"magnitude": "a magnitude", "whole": "a magnitude", "phase": "a phase", "real": "a real part",
             "imaginary": "an imaginary part", "element": "{} of an equivalent circuit",
             "scalar": "a ratio or loss without a phase, from which no impedance follows: save S11 as real and "
                       "imaginary part"}
    there = [f"{headed.table.name(place)} is {names[heading.part].format(heading.kind)}" + (
        "" if heading.kind or heading.part == "phase" else " of nothing that is named")
        for place, heading in enumerate(headed.known) if heading and heading.part in names]
    strangers = [headed.table.name(place) for place, heading in enumerate(headed.known) if heading is None]
    return "; ".join([*there, *([f"not understood: {', '.join(strangers)}"] if strangers else []),
                      "no two columns together are one magnitude and phase, one real and imaginary part, or one "
                      "circuit, of an impedance or admittance"])
