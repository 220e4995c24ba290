"""Tables of named instruments: their place in the file. The headings give the meaning of the columns.

Layouts: Gamry's DTA and ZPlot's .z as in the samples of impedance.py (ECSHackWeek), EC-Lab's .mpt as in those and in
yadg's documentation; Bode Analyzer Suite and Hioki IM3570/IM3536 as their users publish them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
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

    def recognises(self, text: RecordingText) -> bool:
        """Whether a text is of this instrument."""
        return any(re.search(self.sign, line) for line in text.lines[:self.lines]) and headed.recognises_headed(text)

    def parse(self, text: RecordingText) -> Recorded:
        """Read the table.

        Raises:
            InputError: no table of this instrument, a faulty row, or headings that leave a doubt.
        """
        if self.above:
            above = next((index for index, line in enumerate(text.lines) if re.match(self.above, line)), None)
            if above is None:
                raise InputError(text.path, "table", text.lines[0][:80], f"a line like {self.above!r} above the table "
                                 f"of a {self.name} file")
            text = replace(text, lines=tuple("" if index <= above else line for index, line in enumerate(text.lines)))
        return headed.parse_headed(text, instrument=self.name)


INSTRUMENTS: Mapping[str, Instrument] = {
    "bode100": Instrument("Omicron Lab Bode 100", r"(?i)bode ?(100|500|analyzer)", 30),
    "gamry": Instrument("Gamry", r"EXPLAIN\b", 3, r"Z\w*CURVE\s+TABLE"),
    "biologic": Instrument("BioLogic EC-Lab", r"(BT|EC)-Lab ASCII FILE", 3),
    "zplot": Instrument("Scribner ZPlot", r"(?i)\"?(ZPLOT2? ASCII|ZPlotW? Data File|ZView|Z60W Data File)", 3),
    "hioki": Instrument("Hioki", r"(?i)hioki|\bIM3(5[37]\d|590)", 20),
}
