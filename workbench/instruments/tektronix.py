"""Tektronix TDS2000 series oscilloscopes (TDS2024B and relatives).

They have 8 bit and records of 2500 points. Every setting is read back. A capture is one single-sequence acquisition;
all channels are transferred from it, in binary. A channel that is not displayed gives no curve, so the channels are
switched on before every capture. Sources: the public drivers' common commands and real captures; Tektronix 077-0444 for
the format of the data.
"""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError, choose
from workbench.instruments.instrument import InstrumentError, OscilloscopeSettings, Waveform
from workbench.instruments.transport import Link, Query, open_port

#: Number of channels by model as ``*IDN?`` has it (with the space).
MODELS: Mapping[str, int] = {"TDS 2001C": 2, **{
    f"TDS {number}{series}": 4 if number % 10 == 4 else 2
    for series in ("", "B", "C") for number in (2002, 2004, 2012, 2014, 2022, 2024)}}

#: Volts per division at the input connector, 1-2-5.
SCALES = (2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1, 2e-1, 5e-1, 1.0, 2.0, 5.0)

#: Seconds per division, 1-2.5-5. Faster settings have fewer samples than points of the record; slower ones use a
#: rolling display.
TIMEBASES = (2.5e-7, 5e-7, 1e-6, 2.5e-6, 5e-6, 1e-5, 2.5e-5, 5e-5, 1e-4, 2.5e-4, 5e-4, 1e-3, 2.5e-3, 5e-3, 1e-2, 2.5e-2,
             5e-2)

#: Captures in one average; 1 is a single capture.
AVERAGES = (1, 4, 16, 64, 128)

PROBES = (1, 10)

#: Points in a record, divisions across the screen, converter steps per division, divisions from the middle of the
#: screen to its edge.
POINTS, DIVISIONS, COUNTS_PER_DIVISION, HALF_SCREEN = 2500, 10, 25, 4

#: Start of the record in divisions: half of the record is before the trigger.
RECORD_START = -5.0

#: Largest relative difference of two readings of one setting; the instrument prints 3 or more digits.
READBACK_TOLERANCE = 2e-3

#: Largest peak-to-peak value (counts) of records that may be equal by chance: a quiet input gives mostly zeros.
QUIET = 4

#: Seconds between two queries whether the acquisition has ended.
POLL = 0.02

#: Settings for the whole run, of the instrument and of each channel.
RUN_SETTINGS = (
    ("DATA:ENCDG", "RIBINARY"), ("DATA:WIDTH", "1"), ("DATA:START", "1"), ("DATA:STOP", str(POINTS)),
    ("HORIZONTAL:MAIN:POSITION", "0.0E0"), ("ACQUIRE:STOPAFTER", "SEQUENCE"), ("TRIGGER:MAIN:EDGE:SLOPE", "RISE"),
    ("TRIGGER:MAIN:LEVEL", "0.0E0"))
CHANNEL_SETTINGS = (("COUPLING", "DC"), ("POSITION", "0.0E0"), ("BANDWIDTH", "OFF"), ("INVERT", "OFF"))

_NUMBER = r"[+-]?\d+(?:\.\d*)?(?:E[+-]?\d+)?"
ONE_WORD = re.compile(r"[A-Z0-9.+-]+", re.IGNORECASE)
IDENTITY = Query("*IDN?", re.compile(r"TEKTRONIX,([^,]*),([^,]*),(.*)"), "TEKTRONIX,model,serial number,firmware")
RUNNING = Query("ACQUIRE:STATE?", re.compile(r"[01]"), "0 or 1 (0 has ended)")

#: BYT_NR;BIT_NR;ENCDG;BN_FMT;BYT_OR;NR_PT;WFID;PT_FMT;XINCR;PT_OFF;XZERO;XUNIT;YMULT;YZERO;YOFF;YUNIT
PREAMBLE = Query("WFMPRE?", re.compile(
    rf'1;8;BIN(?:ARY)?;RI;MSB;{POINTS};"Ch(?P<channel>\d),[^"]*";Y;(?P<step>{_NUMBER});(?P<point>{_NUMBER});'
    rf'(?P<zero>{_NUMBER});"s(?:econds)?";(?P<volts_per_count>{_NUMBER});(?P<volts_zero>{_NUMBER});'
    rf'(?P<offset>{_NUMBER});"V(?:olts)?"', re.IGNORECASE),
    f"the 16 fields of a waveform of {POINTS} signed bytes")


class Tektronix:
    """A TDS2000 series oscilloscope (see :func:`open_tektronix`)."""

    def __init__(self, link: Link, settings: OscilloscopeSettings) -> None:
        self._link = link
        self._settings = settings
        self._probes = {settings.channel_total: settings.probe_total,
                        settings.channel_reference: settings.probe_reference}
        #: The present volts per division by channel, and seconds per division.
        self._scales: dict[int, float] = {}
        self._timebase: float | None = None
        #: The last record of every channel, to notice a missing acquisition.
        self._last: dict[int, NDArray[np.int16]] = {}

    def identify(self) -> str:
        """The whole identification.

        Raises:
            InstrumentError: it is another model than expected.
        """
        found = self._link.synchronise()
        if found[1] != self._settings.model:
            raise InstrumentError(
                f"{self._link.name}: sent '*IDN?'; expected {self._settings.model}; {found[0]!r} came: another model "
                "(correct the model in the bench's file, or the port)")
        return found[0]

    def set_scale(self, channel: int, volts_per_division: float) -> float:
        """Set and return the 1-2-5 step at or above `volts_per_division`.

        Volts are at the probe's tip.

        Raises:
            ValueError: before writing, if there is no such step or channel.
            InstrumentError: it reads back another value.
        """
        probe = self._probe(channel)
        step = _step_above(volts_per_division, [probe * scale for scale in SCALES], "V per division")
        self._set(f"CH{channel}:SCALE", _number(step))
        self._scales[channel] = step
        return step

    def set_timebase(self, seconds_per_division: float) -> float:
        """Set and return the 1-2.5-5 step at or above `seconds_per_division`. Raises like :meth:`set_scale`."""
        step = _step_above(seconds_per_division, TIMEBASES, "s per division")
        self._set("HORIZONTAL:MAIN:SCALE", _number(step))
        self._timebase = step
        return step

    def set_averages(self, count: int) -> None:
        """Set a single capture (1), or a number of averages. They are 4, 16, 64 or 128, and need a trigger. Raises like
        :meth:`set_scale`."""
        if count not in AVERAGES:
            raise ValueError(f"averages {count!r}; expected one of {', '.join(map(str, AVERAGES))}")
        if count == 1:
            self._set("ACQUIRE:MODE", "SAMPLE")
            self._set("TRIGGER:MAIN:MODE", "AUTO")
        else:
            self._set("ACQUIRE:MODE", "AVERAGE")
            self._set("ACQUIRE:NUMAVG", str(count))
            # The average of records without a trigger would vanish.
            self._set("TRIGGER:MAIN:MODE", "NORMAL")

    def capture(self, channels: Sequence[int]) -> dict[int, Waveform]:
        """Make one acquisition, and return the waveforms of its `channels`.

        Raises:
            ValueError: no channel, or an unknown one.
            Silence: a channel gives no curve.
            InstrumentError: the acquisition does not end, or its records equal the previous ones or have other
                settings.
        """
        if not channels:
            raise ValueError("capture of no channel; expected at least one")
        for channel in channels:
            self._probe(channel)
            self._set(f"SELECT:CH{channel}", "1")
        self._link.send("ACQUIRE:STATE RUN")
        self._await_end()
        found = {channel: self._waveform(channel) for channel in channels}
        records = {channel: waveform.raw for channel, waveform in found.items()}
        if all(channel in self._last and np.ptp(raw) > QUIET and np.array_equal(raw, self._last[channel])
               for channel, raw in records.items()):
            raise InstrumentError(f"{self._link.name}: sent 'ACQUIRE:STATE RUN'; expected a new acquisition; the "
                                  "records of the one before came, to the last bit")
        self._last = self._last | records
        return found

    def set_up(self) -> None:
        """Make all settings for the whole run. They are formats, channels, trigger, and single sequence."""
        link, settings = self._link, self._settings
        link.send("HEADER OFF")
        link.synchronise()
        self._set("ACQUIRE:STATE", "0")
        for command, value in (*RUN_SETTINGS, ("TRIGGER:MAIN:EDGE:SOURCE", settings.trigger)):
            self._set(command, value)
        for channel, probe in self._probes.items():
            for item, value in (("PROBE", _number(probe)), *CHANNEL_SETTINGS):
                self._set(f"CH{channel}:{item}", value)
        self.set_averages(1)
        # A first capture is a test, and removes a previous owner's record from the screen.
        self.capture(tuple(self._probes))

    def close(self) -> None:
        """Close the port; the oscilloscope stays stopped."""
        self._link.close()

    def _probe(self, channel: int) -> int:
        if channel not in self._probes:
            raise ValueError(f"channel {channel!r}; expected one of {', '.join(map(str, self._probes))}, as in the "
                             "bench's settings")
        return self._probes[channel]

    def _set(self, command: str, value: str) -> None:
        """Make a setting, and compare it with its reading."""
        self._link.send(f"{command} {value}")
        found = self._link.ask(Query(f"{command}?", ONE_WORD, "one word or number"))[0]
        if not _same(found, value):
            raise InstrumentError(f"{self._link.name}: sent '{command} {value}'; expected {value} when read back; "
                                  f"{found!r} came")

    def _await_end(self) -> None:
        deadline = time.monotonic() + self._settings.acquisition_timeout
        while self._link.ask(RUNNING)[0] == "1":
            if time.monotonic() > deadline:
                raise InstrumentError(
                    f"{self._link.name}: sent 'ACQUIRE:STATE RUN'; expected the acquisition to end within "
                    f"{self._settings.acquisition_timeout:g} s; it runs on (no trigger from {self._settings.trigger}: "
                    "is the drive on, the source right, the scale fine enough?)")
            time.sleep(POLL)

    def _waveform(self, channel: int) -> Waveform:
        self._set("DATA:SOURCE", f"CH{channel}")
        preamble = self._link.ask(PREAMBLE)
        step, volts_per_count = float(preamble["step"]), float(preamble["volts_per_count"])
        expected: list[tuple[str, float, float]] = [("channel", float(preamble["channel"]), channel)]
        if channel in self._scales:
            expected.append(("V per count", volts_per_count, self._scales[channel] / COUNTS_PER_DIVISION))
        if self._timebase is not None:
            expected.append(("s per point", step, self._timebase * DIVISIONS / POINTS))
            expected.append(("start in s", float(preamble["zero"]), RECORD_START * self._timebase))
        for name, found, wanted in expected:
            if abs(found - wanted) > READBACK_TOLERANCE * abs(wanted):
                raise InstrumentError(f"{self._link.name}: sent 'WFMPRE?' for channel {channel}; expected {wanted:g} "
                                      f"for the {name}; {found:g} came")
        raw = np.frombuffer(self._link.ask_block("CURVE?", POINTS), dtype=np.int8).astype(np.int16)
        edge = HALF_SCREEN * COUNTS_PER_DIVISION
        return Waveform(
            channel=channel,
            volts=(raw.astype(np.float64) - float(preamble["offset"])) * volts_per_count
            + float(preamble["volts_zero"]),
            raw=raw,
            start=float(preamble["zero"]) - float(preamble["point"]) * step,
            step=step,
            volts_per_count=volts_per_count,
            clipped=bool(np.max(np.abs(raw)) >= edge),
        )


def open_tektronix(settings: OscilloscopeSettings) -> Tektronix:
    """Open the oscilloscope, set up for single captures.

    Raises:
        InputError: settings that the series does not have.
        InstrumentError: the port cannot be opened, or another instrument answers.
    """
    _check(settings)
    port = open_port(settings.port, baud=settings.baud, timeout=settings.timeout)
    oscilloscope = Tektronix(Link(port, hello=IDENTITY, timeout=settings.timeout, pause=0.0), settings)
    try:
        oscilloscope.identify()
        oscilloscope.set_up()
    except BaseException:
        oscilloscope.close()
        raise
    return oscilloscope


def _check(settings: OscilloscopeSettings) -> None:
    choose(settings.model, MODELS, source="oscilloscope", field="model")
    channels = range(1, MODELS[settings.model] + 1)
    pair = (settings.channel_total, settings.channel_reference)
    if pair[0] == pair[1] or not set(pair) <= set(channels):
        raise InputError("oscilloscope", "channel_total, channel_reference", pair,
                         f"two different channels from 1 to {channels[-1]}")
    for name, probe in (("probe_total", settings.probe_total), ("probe_reference", settings.probe_reference)):
        if probe not in PROBES:
            raise InputError("oscilloscope", name, probe, f"one of {', '.join(map(str, PROBES))}")
    choose(settings.trigger, [*(f"CH{channel}" for channel in channels), "EXT"], source="oscilloscope", field="trigger")
    if settings.timeout <= 0.0 or settings.acquisition_timeout <= 0.0:
        raise InputError("oscilloscope", "timeout, acquisition_timeout",
                         (settings.timeout, settings.acquisition_timeout), "above zero")


def _step_above(value: float, steps: Sequence[float], unit: str) -> float:
    """The first of rising `steps` at or above `value`, within rounding."""
    if value > 0.0:
        for step in steps:
            if value <= step * (1.0 + 1e-9):
                return step
    raise ValueError(f"{value!r} {unit} is out of range; expected above 0 and at most {steps[-1]:g}")


def _number(value: float) -> str:
    """A number in the instrument's format: 2.0E-1. All its settings have one or two digits."""
    mantissa, exponent = f"{value:.1E}".split("E")
    return f"{mantissa}E{int(exponent)}"


def _same(found: str, value: str) -> bool:
    """Whether a setting reads back as `value`. Words may be answered in their short form."""
    try:
        number = float(value)
    except ValueError:
        return len(found) >= 2 and value.upper().startswith(found.upper())
    try:
        return abs(float(found) - number) <= READBACK_TOLERANCE * abs(number)
    except ValueError:
        return False
