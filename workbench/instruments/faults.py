"""Faults of the simulated bench at a chosen command."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from workbench.instruments.simulated_generator import SimulatedGenerator
from workbench.instruments.simulated_oscilloscope import SimulatedOscilloscope

GENERATOR, OSCILLOSCOPE = "generator", "oscilloscope"


class FaultKind(StrEnum):
    """Kinds of fault, of both instruments unless one is named."""

    SILENCE = "silence"  # the command is executed, without an answer
    DEAFNESS = "deafness"  # the command is ignored, without an answer
    GARBAGE = "garbage"  # random bytes in place of the answer
    NOISE = "noise"  # random bytes before the answer
    PARTIAL = "partial"  # the answer breaks off
    LATE = "late"  # the answer comes with the next one
    ECHO = "echo"  # the question comes back before the answer
    WRONG_INSTRUMENT = "wrong_instrument"  # another instrument identifies itself
    RESTART = "restart"  # switched off and on: all settings are lost
    DISCONNECT = "disconnect"  # the port goes away, and comes back after a while
    WRONG_FREQUENCY = "wrong_frequency"  # generator: another frequency is read back
    IGNORED_FREQUENCY = "ignored_frequency"  # generator: a frequency is not set
    IGNORED_AMPLITUDE = "ignored_amplitude"  # generator: an amplitude is not set
    CLIPPED = "clipped"  # oscilloscope: an acquisition runs off the screen
    HIDDEN = "hidden"  # oscilloscope: a channel is switched off just before the query of its curve
    TRUNCATED_CURVE = "truncated_curve"  # oscilloscope: the curve breaks off
    WRONG_COUNT = "wrong_count"  # oscilloscope: the curve announces a wrong number of bytes
    HEADERS = "headers"  # oscilloscope: every answer begins with its header
    NO_TRIGGER = "no_trigger"  # oscilloscope: an acquisition does not end
    IGNORED_RUN = "ignored_run"  # oscilloscope: an acquisition is not made, and the previous records stay


_GENERATOR_ONLY = (FaultKind.WRONG_FREQUENCY, FaultKind.IGNORED_FREQUENCY, FaultKind.IGNORED_AMPLITUDE)
_OSCILLOSCOPE_ONLY = tuple(FaultKind)[tuple(FaultKind).index(FaultKind.CLIPPED):]

#: The kinds that can happen to each instrument.
KINDS = {GENERATOR: tuple(kind for kind in FaultKind if kind not in _OSCILLOSCOPE_ONLY),
         OSCILLOSCOPE: tuple(kind for kind in FaultKind if kind not in _GENERATOR_ONLY)}

#: Identification of a wrong instrument, by the one that should be there.
STRANGERS = {GENERATOR: b"MHS-5200A\n", OSCILLOSCOPE: b"RIGOL TECHNOLOGIES,DS1052E,0,00.04.02\n"}

#: The commands that a kind can affect; other kinds affect queries.
_QUESTION = rb"a|cf|.*\?"
_STRUCK = {
    FaultKind.WRONG_INSTRUMENT: rb"a|\*IDN\?", FaultKind.WRONG_FREQUENCY: rb"cf",
    FaultKind.IGNORED_FREQUENCY: rb"bf.*", FaultKind.IGNORED_AMPLITUDE: rb"ba.*",
    **dict.fromkeys((FaultKind.CLIPPED, FaultKind.NO_TRIGGER, FaultKind.IGNORED_RUN), rb"ACQUIRE:STATE RUN"),
    **dict.fromkeys((FaultKind.HIDDEN, FaultKind.TRUNCATED_CURVE, FaultKind.WRONG_COUNT), rb"CURVE\?"),
    **dict.fromkeys((FaultKind.DEAFNESS, FaultKind.RESTART, FaultKind.DISCONNECT, FaultKind.HEADERS), rb".*"),
}


@dataclass(frozen=True)
class Fault:
    """One fault, of the first `count` matching commands of this instrument. It starts at command number `at`; the first
    command after opening the bench has number 0. ``seconds`` is the duration of a disconnection."""

    instrument: str
    kind: FaultKind
    at: int = 0
    count: int = 1
    seconds: float = 0.3

    def __post_init__(self) -> None:
        if self.instrument not in KINDS:
            raise ValueError(f"instrument {self.instrument!r}; expected one of {', '.join(KINDS)}")
        if self.kind not in KINDS[self.instrument]:
            raise ValueError(f"fault {self.kind!r} cannot happen to the {self.instrument}; expected one of "
                             f"{', '.join(KINDS[self.instrument])}")
        if self.at < 0 or self.count < 1 or self.seconds <= 0.0:
            raise ValueError(f"at {self.at!r}, count {self.count!r}, seconds {self.seconds!r}; expected at least 0, at "
                             "least 1 and above 0")


def fits(kind: FaultKind, line: bytes) -> bool:
    """Whether a fault can affect this command."""
    return re.fullmatch(_STRUCK.get(kind, _QUESTION), line, re.DOTALL) is not None


class FaultyInstrument:
    """A simulated instrument with faults. ``struck`` lists the faults that occurred, with the number of the command."""

    def __init__(
        self, name: str, instrument: SimulatedGenerator | SimulatedOscilloscope, *, random: np.random.Generator,
        disconnect: Callable[[float], None],
    ) -> None:
        self._name = name
        self._instrument = instrument
        self._random = random
        self._disconnect = disconnect
        self._pending: list[Fault] = []
        self._late = b""
        self.commands = 0
        self.struck: list[tuple[int, Fault]] = []

    def inject(self, fault: Fault) -> None:
        """Add a fault."""
        self._pending.append(fault)

    def respond(self, line: bytes) -> bytes:
        """The reply to one line, without its LF."""
        number, self.commands = self.commands, self.commands + 1
        fault = next((f for f in self._pending if f.at <= number and fits(f.kind, line)), None)
        if fault is None:
            answer = self._instrument.respond(line)
        else:
            self._pending.remove(fault)
            if fault.count > 1:
                self._pending.append(replace(fault, count=fault.count - 1))
            self.struck.append((number, fault))
            answer = self._strike(fault, line)
        if answer:
            answer, self._late = self._late + answer, b""
        return answer

    def _strike(self, fault: Fault, line: bytes) -> bytes:
        """The reply as it arrives, with a fault."""
        match fault.kind:
            case FaultKind.DEAFNESS | FaultKind.IGNORED_FREQUENCY | FaultKind.IGNORED_AMPLITUDE | FaultKind.IGNORED_RUN:
                return b""
            case FaultKind.DISCONNECT:
                self._disconnect(fault.seconds)
                return b""
            case FaultKind.RESTART:
                self._instrument.restart()
        if isinstance(self._instrument, SimulatedOscilloscope):
            _disturb(self._instrument, fault.kind)
        return self._spoil(fault.kind, line, self._instrument.respond(line))

    def _spoil(self, kind: FaultKind, line: bytes, answer: bytes) -> bytes:
        match kind:
            case FaultKind.SILENCE:
                return b""
            case FaultKind.GARBAGE:
                return self._random.bytes(max(len(answer) - 1, 1)).replace(b"\n", b"?") + b"\n"
            case FaultKind.NOISE:
                return self._random.bytes(4) + answer
            case FaultKind.PARTIAL | FaultKind.TRUNCATED_CURVE:
                return answer[: len(answer) // 2]
            case FaultKind.LATE:
                self._late += answer
                return b""
            case FaultKind.ECHO:
                return line + b"\n" + answer
            case FaultKind.WRONG_INSTRUMENT:
                return STRANGERS[self._name]
            case FaultKind.WRONG_FREQUENCY:
                return b"cf%010d\n" % (int(answer[2:]) + 100 if answer[2:].strip().isdigit() else 0)
            case FaultKind.WRONG_COUNT:
                return answer.replace(b"#42500", b"#42400", 1)
            case _:
                return answer


def _disturb(oscilloscope: SimulatedOscilloscope, kind: FaultKind) -> None:
    """Disturb the oscilloscope, as a person or the signal may do."""
    match kind:
        case FaultKind.CLIPPED:
            oscilloscope.surge = 4.0
        case FaultKind.NO_TRIGGER:
            oscilloscope.blind = True
        case FaultKind.HIDDEN:
            oscilloscope.hide(oscilloscope.source())
        case FaultKind.HEADERS:
            oscilloscope.respond(b"HEADER ON")
