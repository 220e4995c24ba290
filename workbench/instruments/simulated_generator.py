"""A simulated FeelTech FY3200S, which processes lines byte by byte."""

from __future__ import annotations

import re
from dataclasses import dataclass

#: Length of the longest command without its LF.
LONGEST = 14

#: Frequency (0.01 Hz) and amplitude (0.01 V peak to peak) after switching on. They are not zero, so that tests notice a
#: drive that stays on.
SWITCHED_ON = (1_000_000, 500)

_SETTING = re.compile(r"([bd])([a-z])([+-]?\d*)(?:\.(\d*))?")


@dataclass
class Output:
    """One channel, in hundredths of Hz and of V peak to peak. Waveform 0 is sine."""

    frequency: int
    amplitude: int
    offset: int = 0
    waveform: int = 0


class SimulatedGenerator:
    """The two channels on the serial line.

    Settings have no answer; a line is read up to the first invalid character, and the part before it is used. Only the
    model, the main channel's frequency, duty and sweep time and the counter have answers.
    """

    def __init__(self, model: str) -> None:
        self.model = model
        self.restart()

    def restart(self) -> None:
        """Restore the state after switching off and on."""
        self.main = Output(*SWITCHED_ON)
        self.deputy = Output(*SWITCHED_ON)

    @property
    def frequency(self) -> float:
        """Frequency of the main channel, Hz."""
        return self.main.frequency / 100

    @property
    def amplitude(self) -> float:
        """Open-circuit amplitude (Vpp) of the main channel's sine. It is 0 for another waveform."""
        return self.main.amplitude / 100 if self.main.waveform == 0 else 0.0

    def respond(self, line: bytes) -> bytes:
        """The reply to one line without its LF; empty for a setting."""
        text = line[:LONGEST].decode("latin-1")
        answers = {"a": self.model, "cf": f"cf{self.main.frequency:010d}", "cd": "cd500", "ct": "ct10",
                   "ce": "ce0000000000", "cc": "cc0000000000"}
        if text in answers:
            return f"{answers[text]}\n".encode()
        self._set(text)
        return b""

    def _set(self, text: str) -> None:
        read = _SETTING.match(text)
        if read is None or read[3] in ("", "+", "-"):
            return
        output = self.main if read[1] == "b" else self.deputy
        whole = int(read[3])
        hundredths = abs(whole) * 100 + int(f"{read[4] or ''}00"[:2])
        match read[2]:
            case "f":
                output.frequency = abs(whole)
            case "a":
                output.amplitude = min(hundredths, 2000)
            case "o":
                output.offset = -hundredths if read[3].startswith("-") else hundredths
            case "w":
                output.waveform = abs(whole)
