"""A simulated Tektronix TDS2024B, which processes lines byte by byte.

Its records follow the rules of real captures: YMULT = V/div / 25, YOFF = 25 x position, XINCR = 10 x s/div / 2500,
XZERO = -5 x s/div.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.instruments.tektronix import POINTS

CHANNELS = (1, 2, 3, 4)

#: Steps of the converter, at the input connector (V per division) and in time (s per division).
VOLTS_STEPS = tuple(m * 10.0**e for e in range(-3, 1) for m in (1, 2, 5) if 2e-3 <= m * 10.0**e <= 5.0)
SECONDS_STEPS = tuple(m * 10.0**e for e in range(-9, 2) for m in (1, 2.5, 5) if 2.5e-9 <= m * 10.0**e <= 50.0)

#: Least amplitude of a signal for a trigger, in divisions.
TRIGGER_DIVISIONS = 0.2


@dataclass(frozen=True)
class Tone:
    """A sine at the probe's tip. ``amplitude`` is complex (V, e^{+j w t}), ``frequency`` in Hz."""

    amplitude: complex
    frequency: float


@dataclass(frozen=True)
class Errors:
    """Errors of the oscilloscope, rms. Noise is of the converter (counts) and at the tip (V), jitter of the trigger (s;
    common to all channels of one capture)."""

    noise_counts: float = 0.4
    noise_volts: float = 0.0
    jitter: float = 0.3e-9


@dataclass(frozen=True)
class Item:
    """A setting: name, initial value, and legal values. The short form of names and words is in capitals. ``legal`` has
    words, or steps to which a number is rounded; it is empty for any number."""

    name: str
    initial: str | float
    legal: tuple[str, ...] | tuple[float, ...] = ()


_ON_OFF = ("OFF", "ON")
ITEMS = (
    Item("HEADer", 1.0, (0.0, 1.0)), Item("VERBose", 1.0, (0.0, 1.0)),
    Item("ACQuire:MODe", "SAMPLE", ("SAMple", "PEAKdetect", "AVErage")),
    Item("ACQuire:NUMAVg", 16.0, (4.0, 16.0, 64.0, 128.0)),
    Item("ACQuire:STOPAfter", "RUNSTOP", ("RUNSTop", "SEQuence")),
    Item("DATa:ENCdg", "ASCII", ("ASCIi", "RIBinary")), Item("DATa:WIDth", 1.0, (1.0, 2.0)),
    Item("DATa:STARt", 1.0, tuple(float(n) for n in range(1, POINTS + 1))),
    Item("DATa:STOP", float(POINTS), tuple(float(n) for n in range(1, POINTS + 1))),
    Item("DATa:SOUrce", "CH1", tuple(f"CH{c}" for c in CHANNELS)),
    Item("HORizontal:MAIn:SCAle", 5e-4, SECONDS_STEPS), Item("HORizontal:MAIn:POSition", 0.0),
    Item("TRIGger:MAIn:MODe", "AUTO", ("AUTO", "NORMal")), Item("TRIGger:MAIn:LEVel", 0.0),
    Item("TRIGger:MAIn:EDGE:SOUrce", "CH1", (*(f"CH{c}" for c in CHANNELS), "EXT", "EXT5", "LINE")),
    Item("TRIGger:MAIn:EDGE:SLOpe", "RISE", ("RISe", "FALL")),
    *(item for c in CHANNELS for item in (
        Item(f"SELect:CH{c}", 1.0 if c == 1 else 0.0, (0.0, 1.0)), Item(f"CH{c}:SCAle", 1.0, VOLTS_STEPS),
        Item(f"CH{c}:PRObe", 10.0, (1.0, 10.0, 100.0, 1000.0)), Item(f"CH{c}:POSition", 0.0),
        Item(f"CH{c}:COUPling", "DC", ("DC", "AC", "GND")), Item(f"CH{c}:BANdwidth", "OFF", _ON_OFF),
        Item(f"CH{c}:INVert", "OFF", _ON_OFF))),
)

#: Settings whose value the instrument prints without a point.
WHOLE = ("HEADer", "VERBose", "ACQuire:NUMAVg", "DATa:WIDth", "DATa:STARt", "DATa:STOP",
         *(f"SELect:CH{c}" for c in CHANNELS))


@dataclass(frozen=True, eq=False)
class Record:
    """One channel of the last acquisition. ``raw`` (2500,) are its samples, the others its settings."""

    raw: NDArray[np.int64]
    volts_per_division: float
    position: float
    seconds_per_division: float
    start: float
    averages: int
    coupling: str


class SimulatedOscilloscope:
    """Four channels, two of which show `tones`.

    `tones` is called at every acquisition and returns tones by channel. ``probes`` are the factors of the real probes,
    by channel. ``wait`` is called with the duration of an acquisition in seconds.
    """

    def __init__(
        self, model: str, tones: Callable[[], Mapping[int, Tone]], *, probes: Mapping[int, int], errors: Errors,
        random: np.random.Generator, wait: Callable[[float], None],
    ) -> None:
        self.model = model
        self._tones = tones
        self._probes = probes
        self._errors = errors
        self._random = random
        self._wait = wait
        #: Offset of the next acquisition in divisions, and whether it never gets a trigger.
        self.surge = 0.0
        self.blind = False
        self.restart()

    def restart(self) -> None:
        """Restore the state after switching off and on."""
        self._values: dict[str, str | float] = {item.name: item.initial for item in ITEMS}
        self._records: dict[int, Record] = {}
        self._events: list[tuple[int, str]] = []
        self._running = self._forced = self._blinded = False

    def hide(self, channel: int) -> None:
        """Switch a channel off, as with its button."""
        self._values[f"SELect:CH{channel}"] = 0.0
        self._records.pop(channel, None)

    def source(self) -> int:
        """The channel whose data are requested."""
        return int(self._word("DATa:SOUrce")[2:])

    def respond(self, line: bytes) -> bytes:
        """The answers to the queries in one line without its LF."""
        answers: list[bytes] = []
        path = ""
        for text in filter(None, (command.strip() for command in line.decode("latin-1").split(";"))):
            # After a semicolon the beginning of the last header is implied, unless there is a colon or a star.
            absolute = text[0] in ":*" or not path or _item(text.split()[0].rstrip("?")) is not None
            whole = text.lstrip(":") if absolute else path + text
            path = "".join(whole.split()[0].rpartition(":")[:2])
            answer = self._command(whole)
            if answer is not None:
                answers.append(answer)
        return b";".join(answers) + b"\n" if answers else b""

    def _command(self, text: str) -> bytes | None:
        """The answer to one command; None for a setting or no curve."""
        header, _, argument = text.partition(" ")
        query = header.endswith("?")
        name = header.rstrip("?").upper()
        match name, query:
            case "*IDN", True:
                return f"TEKTRONIX,{self.model},0,CF:91.1CT FV:v22.11".encode()
            case "*OPC", True:
                self._finish()
                return b"1"
            case "*ESR", True:
                return b"32" if self._events else b"0"
            case ("ALLEV" | "ALLE"), True:
                events, self._events = self._events or [(0, "No events to report")], []
                return ",".join(f'{number},"{words}"' for number, words in events).encode()
        if _fits(name, "WFMPre") and query:
            return self._preamble()
        if _fits(name, "CURVe") and query:
            return self._curve()
        if _fits(name, "ACQuire:STATE"):
            if query:
                self._finish()
                return self._headed("ACQUIRE:STATE", "1" if self._running else "0")
            self._run(argument.strip().upper() in ("RUN", "ON", "1"))
            return None
        if _fits(name, "TRIGger") and argument.strip().upper() in ("FORCE", "FORC"):
            self._forced = True
            return None
        item = _item(name)
        if item is None:
            self._events.append((113, f"Undefined header; {name}"))
            return None
        if query:
            return self._headed(item.name.upper(), self._printed(item))
        self._set(item, argument.strip())
        return None

    def _set(self, item: Item, argument: str) -> None:
        given = argument.upper()
        words = [str(word) for word in item.legal if isinstance(word, str)]
        switches = {"ON": 1.0, "OFF": 0.0} if item.legal == (0.0, 1.0) else {}
        read = None if words else re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)(E[+-]?\d+)?", given)
        word = next((word.upper() for word in words if _fits(given, word)), None)
        if word is not None:
            self._values[item.name] = word
        elif read is not None or given in switches:
            value = switches[given] if read is None else float(read[0])
            if re.fullmatch(r"CH\d:SCAle", item.name):
                value /= self._number(f"{item.name[:3]}:PRObe")
            steps = [float(step) for step in item.legal]
            self._values[item.name] = _nearest(value, steps) if steps else value
        else:
            self._events.append((102, f"Syntax error; {argument}"))

    def _printed(self, item: Item) -> str:
        value = self._values[item.name]
        if isinstance(value, str):
            if self._number("VERBose"):
                return value
            short = next(str(word) for word in item.legal if str(word).upper() == value)
            return re.sub("[a-z]", "", short)
        if re.fullmatch(r"CH\d:SCAle", item.name):
            value *= self._number(f"{item.name[:3]}:PRObe")
        return str(int(value)) if item.name in WHOLE else _scientific(value)

    def _headed(self, header: str, value: str) -> bytes:
        return (f":{header} {value}" if self._number("HEADer") else value).encode()

    def _number(self, name: str) -> float:
        return float(self._values[name])

    def _word(self, name: str) -> str:
        return str(self._values[name])

    def _averages(self) -> int:
        return int(self._number("ACQuire:NUMAVg")) if self._word("ACQuire:MODe") == "AVERAGE" else 1

    def _run(self, on: bool) -> None:
        self._running, self._forced = on, False
        self._blinded, self.blind = self.blind, False
        self._finish()

    def _finish(self) -> None:
        """Finish the running acquisition on a trigger; a sequence then stops."""
        if self._running and self._acquire():
            self._running = self._word("ACQuire:STOPAfter") != "SEQUENCE"

    def _acquire(self) -> bool:
        """Fill the records of the displayed channels; False without a trigger."""
        tones = self._tones()
        start = self._trigger(tones)
        patient = self._word("TRIGger:MAIn:MODe") == "NORMAL" and not self._forced
        if self._blinded or (start is None and patient):
            return False
        count = self._averages()
        seconds = self._number("HORizontal:MAIn:SCAle")
        first = self._number("HORizontal:MAIn:POSition") - 5.0 * seconds
        times = first + np.arange(POINTS) * (10.0 * seconds / POINTS)
        late = (self._random.uniform(0.0, 1.0, (count, 1)) if start is None  # at any moment of the signal
                else start + self._errors.jitter * self._random.standard_normal((count, 1)))
        for channel in CHANNELS:
            if self._number(f"SELect:CH{channel}"):
                self._records[channel] = self._record(channel, tones.get(channel), times + late, seconds, first)
        self.surge = 0.0
        self._wait(count * (10.0 * seconds + 0.02))
        return True

    def _trigger(self, tones: Mapping[int, Tone]) -> float | None:
        """The time (s) of the trigger for the tones, or None."""
        source = self._word("TRIGger:MAIn:EDGE:SOUrce")
        if not source.startswith("CH"):
            # The generator's own pulse.
            return 0.0 if tones else None
        channel = int(source[2:])
        tone, level = tones.get(channel), self._number("TRIGger:MAIn:LEVel")
        if tone is None or abs(tone.amplitude) <= max(
                abs(level), TRIGGER_DIVISIONS * self._tip_scale(channel)):
            return None
        # Re(a exp(j w t)) rises through the level where its argument is -arccos(level / |a|).
        turn = -np.arccos(level / abs(tone.amplitude))
        if self._word("TRIGger:MAIn:EDGE:SLOpe") == "FALL":
            turn = -turn
        return float((turn - np.angle(tone.amplitude)) / (2.0 * np.pi * tone.frequency))

    def _tip_scale(self, channel: int) -> float:
        """V per division at the tip of the real probe."""
        return self._number(f"CH{channel}:SCAle") * self._probes.get(channel, 1)

    def _record(
        self, channel: int, tone: Tone | None, times: NDArray[np.float64], seconds: float, start: float
    ) -> Record:
        """Sample at `times` (captures, 2500), convert, average and round. Conversion to 8 bit is capture by capture."""
        scale, position = self._tip_scale(channel), self._number(f"CH{channel}:POSition")
        coupling = self._word(f"CH{channel}:COUPling")
        volts = np.zeros_like(times)
        if tone is not None and coupling != "GND":
            volts = abs(tone.amplitude) * np.cos(2.0 * np.pi * tone.frequency * times + np.angle(tone.amplitude))
        if self._errors.noise_volts:
            volts = volts + self._errors.noise_volts * self._random.standard_normal(times.shape)
        if self._word(f"CH{channel}:INVert") == "ON":
            volts = -volts
        counts = 25.0 * (volts / scale + position + self.surge)
        counts = counts + self._errors.noise_counts * self._random.standard_normal(times.shape)
        converted = np.clip(np.rint(counts), -128, 127)
        raw = np.rint(converted.mean(axis=0)).astype(np.int64)
        shown = self._number(f"CH{channel}:SCAle") * self._number(f"CH{channel}:PRObe")
        return Record(raw, shown, position, seconds, start, len(times), coupling)

    def _selected(self) -> Record | None:
        """The requested record. None, and two events, if its channel is not displayed."""
        if self._running and self._word("ACQuire:STOPAfter") == "RUNSTOP":
            self._acquire()
        channel = self.source()
        if not self._number(f"SELect:CH{channel}") or channel not in self._records:
            self._events += [(2244, "Source waveform is not active"), (420, "Query UNTERMINATED")]
            return None
        return self._records[channel]

    def _slice(self) -> slice:
        return slice(int(self._number("DATa:STARt")) - 1, int(self._number("DATa:STOP")))

    def _preamble(self) -> bytes | None:
        channel, record = self.source(), self._selected()
        if record is None:
            return None
        width = int(self._number("DATa:WIDth"))
        fine = 256**(width - 1)
        binary = self._word("DATa:ENCdg") != "ASCII"
        mode = "Sample mode" if record.averages == 1 else "Average mode"
        points = len(record.raw[self._slice()])
        fields = (
            ("BYT_NR", str(width)), ("BIT_NR", str(8 * width)), ("ENCDG", "BIN" if binary else "ASC"), ("BN_FMT", "RI"),
            ("BYT_OR", "MSB"), ("NR_PT", str(points)),
            ("WFID", f'"Ch{channel}, {record.coupling} coupling, {_scientific(record.volts_per_division)} V/div, '
                     f'{_scientific(record.seconds_per_division)} s/div, {points} points, {mode}"'),
            ("PT_FMT", "Y"), ("XINCR", _scientific(10.0 * record.seconds_per_division / POINTS)), ("PT_OFF", "0"),
            ("XZERO", _scientific(record.start)), ("XUNIT", '"s"'),
            ("YMULT", _scientific(record.volts_per_division / 25.0 / fine)), ("YZERO", "0.0E0"),
            ("YOFF", _scientific(25.0 * record.position * fine)), ("YUNIT", '"Volts"'),
        )
        if self._number("HEADer"):
            return (":WFMPRE:" + ";".join(f"{name} {value}" for name, value in fields)).encode()
        return ";".join(value for _, value in fields).encode()

    def _curve(self) -> bytes | None:
        record = self._selected()
        if record is None:
            return None
        width = int(self._number("DATa:WIDth"))
        raw = record.raw[self._slice()] * 256**(width - 1)
        if self._word("DATa:ENCdg") == "ASCII":
            data = ",".join(map(str, raw)).encode()
        else:
            payload = raw.astype(">i2" if width == 2 else np.int8).tobytes()
            length = str(len(payload))
            data = f"#{len(length)}{length}".encode() + payload
        return b":CURVE " + data if self._number("HEADer") else data


def _fits(name: str, full: str) -> bool:
    """Whether `name` (capitals) abbreviates `full`. The short form is the capitals in `full`."""
    given, parts = name.split(":"), full.split(":")
    if len(given) != len(parts):
        return False
    return all(
        part.upper().startswith(word) and len(word) >= len(re.sub("[a-z]", "", part))
        for word, part in zip(given, parts, strict=True))


def _item(name: str) -> Item | None:
    return next((item for item in ITEMS if _fits(name.upper(), item.name)), None)


def _nearest(value: float, steps: tuple[float, ...] | list[float]) -> float:
    return min(steps, key=lambda step: abs(step - value))


def _scientific(value: float) -> str:
    """A number as the instrument prints it: 2.0E-1, 1.25E-5."""
    mantissa, exponent = f"{value:.6E}".split("E")
    whole, decimals = mantissa.split(".")
    return f"{whole}.{decimals.rstrip('0') or '0'}E{int(exponent)}"
