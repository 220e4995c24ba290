"""Tables of named instruments: their place in the file. The headings give the meaning of the columns.

Layouts: Gamry's DTA and ZPlot's .z as in the samples of impedance.py (ECSHackWeek), EC-Lab's .mpt as in those and in
yadg's documentation; Bode Analyzer Suite and Hioki IM3570/IM3536 as their users publish them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from workbench.files.errors import InputError
from workbench.readers import headed
from workbench.readers.sweep import Recorded
from workbench.readers.text import RecordingText


@dataclass(frozen=True)
class Instrument:
    """An instrument's file: its ``name``, a pattern ``sign`` of one of its first ``lines``, and a pattern of the line
    ``above`` its table ("": the table is found by its headings)."""

    name: str
    sign: str
    lines: int
    above: str = ""


INSTRUMENTS: Mapping[str, Instrument] = {
    "bode100": Instrument("Omicron Lab Bode 100", r"(?i)bode ?(100|500|analyzer)", 30),
    "gamry": Instrument("Gamry", r"EXPLAIN\b", 3, r"Z\w*CURVE\s+TABLE"),
    "biologic": Instrument("BioLogic EC-Lab", r"(BT|EC)-Lab ASCII FILE", 3),
    "zplot": Instrument("Scribner ZPlot", r"(?i)\"?(ZPLOT2? ASCII|ZPlotW? Data File|ZView|Z60W Data File)", 3),
    "hioki": Instrument("Hioki", r"(?i)hioki|\bIM3(5[37]\d|590)", 20),
}


def recogniser(name: str) -> Callable[[RecordingText], bool]:
    """A test whether a text is of the instrument `name`, a key of :data:`INSTRUMENTS`."""
    instrument = INSTRUMENTS[name]

    def recognises(text: RecordingText) -> bool:
        named = any(re.search(instrument.sign, line) for line in text.lines[:instrument.lines])
        return named and headed.recognises_headed(text)

    return recognises


def instrument_parser(name: str) -> Callable[[RecordingText], Recorded]:
    """A parser of files of the instrument `name`, a key of :data:`INSTRUMENTS`."""
    instrument = INSTRUMENTS[name]

    def parse(text: RecordingText) -> Recorded:
        """Read the table.

        Raises:
            InputError: no table of this instrument, a faulty row, or headings that leave a doubt.
        """
        if instrument.above:
            above = next((index for index, line in enumerate(text.lines) if re.match(instrument.above, line)), None)
            if above is None:
                raise InputError(text.path, "table", text.lines[0][:80], f"a line like {instrument.above!r} above the "
                                 f"table of a {instrument.name} file")
            text = replace(text, lines=tuple("" if index <= above else line for index, line in enumerate(text.lines)))
        return headed.parse_headed(text, instrument=instrument.name)

    return parse
