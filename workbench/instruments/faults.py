"""Faults of a bench, which a test can make happen at a chosen moment on the simulated one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from workbench.instruments.simulated_generator import SimulatedGenerator
from workbench.instruments.simulated_oscilloscope import SimulatedOscilloscope

GENERATOR, OSCILLOSCOPE = "generator", "oscilloscope"


class FaultKind(StrEnum):
    """Kinds of fault. The first ones can happen to both instruments, the others to the one they name."""

    SILENCE = "silence"  # done, but not answered
    DEAFNESS = "deafness"  # neither done nor answered
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
    HIDDEN = "hidden"  # oscilloscope: a channel is switched off just before its curve is asked for
    TRUNCATED_CURVE = "truncated_curve"  # oscilloscope: the curve breaks off
    WRONG_COUNT = "wrong_count"  # oscilloscope: the curve announces another number of bytes than come
    HEADERS = "headers"  # oscilloscope: every answer begins with its header
    NO_TRIGGER = "no_trigger"  # oscilloscope: an acquisition does not end
    IGNORED_RUN = "ignored_run"  # oscilloscope: an acquisition is not made, the records stay those of the one before


#: The kinds that can happen to each instrument.
KINDS = {
    GENERATOR: tuple(kind for kind in FaultKind if kind not in (
        FaultKind.CLIPPED, FaultKind.HIDDEN, FaultKind.TRUNCATED_CURVE, FaultKind.WRONG_COUNT, FaultKind.HEADERS,
        FaultKind.NO_TRIGGER,
        FaultKind.IGNORED_RUN)),
    OSCILLOSCOPE: tuple(kind for kind in FaultKind if kind not in (
        FaultKind.WRONG_FREQUENCY, FaultKind.IGNORED_FREQUENCY, FaultKind.IGNORED_AMPLITUDE)),
}

#: Identification of a wrong instrument, by the one that should be there.
STRANGERS = {GENERATOR: b"MHS-5200A\n", OSCILLOSCOPE: b"RIGOL TECHNOLOGIES,DS1052E,0,00.04.02\n"}


@dataclass(frozen=True)
class Fault:
    """One fault: it strikes the first `count` commands it fits, from command number `at` of this instrument on.

    The first command since the bench was opened has number 0. ``seconds`` is the duration of a disconnection.
    """

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
    """Whether a fault can strike this command."""
    query = line in (b"a", b"cf") or line.endswith(b"?")
    match kind:
        case FaultKind.WRONG_INSTRUMENT:
            return line in (b"a", b"*IDN?")
        case FaultKind.WRONG_FREQUENCY:
            return line == b"cf"
        case FaultKind.IGNORED_FREQUENCY:
            return line.startswith(b"bf")
        case FaultKind.IGNORED_AMPLITUDE:
            return line.startswith(b"ba")
        case FaultKind.CLIPPED | FaultKind.NO_TRIGGER | FaultKind.IGNORED_RUN:
            return line == b"ACQUIRE:STATE RUN"
        case FaultKind.HIDDEN | FaultKind.TRUNCATED_CURVE | FaultKind.WRONG_COUNT:
            return line == b"CURVE?"
        case FaultKind.DEAFNESS | FaultKind.RESTART | FaultKind.DISCONNECT | FaultKind.HEADERS:
            return True
        case _:
            return query


class FaultyInstrument:
    """A simulated instrument to which faults happen. ``struck`` lists those that have, with the command's number."""

    def __init__(
        self, name: str, instrument: SimulatedGenerator | SimulatedOscilloscope, *, random: np.random.Generator,
        disconnect: Callable[[float], None],
    ) -> None:
        self._name = name
        self._instrument = instrument
        self._random = random
        self._disconnect = disconnect
        self._pending: list[Fault] = []
        self._held = b""
        self.commands = 0
        self.struck: list[tuple[int, Fault]] = []

    def inject(self, fault: Fault) -> None:
        """Add a fault, which will happen at its time."""
        self._pending.append(fault)

    def respond(self, line: bytes) -> bytes:
        """The reply to one line, given without its LF."""
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
        if not answer:
            return b""
        held, self._held = self._held, b""
        return held + answer

    def _strike(self, fault: Fault, line: bytes) -> bytes:
        match fault.kind:
            case FaultKind.DEAFNESS | FaultKind.IGNORED_FREQUENCY | FaultKind.IGNORED_AMPLITUDE | FaultKind.IGNORED_RUN:
                return b""
            case FaultKind.DISCONNECT:
                self._disconnect(fault.seconds)
                return b""
            case FaultKind.RESTART:
                self._instrument.restart()
                return self._instrument.respond(line)
            case FaultKind.CLIPPED | FaultKind.NO_TRIGGER | FaultKind.HIDDEN | FaultKind.HEADERS:
                self._disturb(fault.kind)
                return self._instrument.respond(line)
            case _:
                return self._spoil(fault.kind, line, self._instrument.respond(line))

    def _disturb(self, kind: FaultKind) -> None:
        """Disturb the oscilloscope as a hand, or the signal, would."""
        oscilloscope = self._instrument
        if not isinstance(oscilloscope, SimulatedOscilloscope):
            raise TypeError(f"fault {kind!r} at an instrument that is no oscilloscope")
        match kind:
            case FaultKind.CLIPPED:
                oscilloscope.surge = 4.0
            case FaultKind.NO_TRIGGER:
                oscilloscope.blind = True
            case FaultKind.HIDDEN:
                oscilloscope.hide(oscilloscope.source())
            case _:
                oscilloscope.respond(b"HEADER ON")

    def _spoil(self, kind: FaultKind, line: bytes, answer: bytes) -> bytes:
        """The reply as it arrives, after the instrument has executed the command."""
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
                self._held += answer
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
                raise ValueError(f"fault {kind!r} does nothing to an answer")
