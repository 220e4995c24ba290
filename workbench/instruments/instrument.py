"""Interfaces of a generator and of an oscilloscope for the bench."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class InstrumentError(RuntimeError):
    """A failure of an instrument or its link. The message names the port, and the sent, expected and received text."""


class Silence(InstrumentError):
    """The reply is missing or incomplete at the time-out."""


@dataclass(frozen=True)
class GeneratorSettings:
    """Address and identity of the generator.

    ``port`` is a serial port; ``model`` is its expected identification (a key of ``feeltech.MODELS``); ``timeout`` (s)
    is the limit for a reply; ``pause`` (s) follows every command, because settings are not acknowledged.
    """

    port: str
    model: str = "FY3224S"
    baud: int = 9600
    timeout: float = 1.0
    pause: float = 0.1


@dataclass(frozen=True)
class OscilloscopeSettings:
    """Address and identity of the oscilloscope, and its channels.

    ``port`` is a serial port, a USBTMC device file (``/dev/usbtmc0``) or a VISA resource (``USB0::...::INSTR``).
    ``channel_total`` is across device and reference resistor, ``channel_reference`` across the resistor alone; the
    probe factors (1 or 10) are those of the probes on them. ``trigger`` is "CH1" to "CH4" or "EXT". ``timeout`` (s) is
    for one reply, ``acquisition_timeout`` (s) for one whole acquisition, averages included.
    """

    port: str
    model: str = "TDS 2024B"
    baud: int = 9600
    channel_total: int = 1
    channel_reference: int = 2
    probe_total: int = 10
    probe_reference: int = 10
    trigger: str = "CH1"
    timeout: float = 5.0
    acquisition_timeout: float = 30.0


@dataclass(frozen=True, eq=False)
class Waveform:
    """One channel of one capture.

    ``volts`` (n,) are V at the probe's tip, or A of a current probe; ``unit`` is "V", "A" or "" if not stated; ``raw``
    (n,) are the converter's values, signed 8 bit; ``start`` (s) is the time of the first sample relative to the
    trigger, ``step`` (s) that between samples; ``volts_per_count`` is the quantisation step, in the unit; ``clipped``
    is whether any sample is at the limit of the converter or of the screen.
    """

    channel: int
    volts: NDArray[np.float64]
    raw: NDArray[np.int16]
    start: float
    step: float
    volts_per_count: float
    clipped: bool
    unit: str = "V"


class Generator(Protocol):
    """A sine generator with one output. A value out of range raises ValueError before anything is written."""

    def identify(self) -> str:
        """The model. Raises InstrumentError for another instrument."""

    def set_frequency(self, frequency: float) -> None:
        """Set the frequency (Hz, in steps of 0.01) and read it back."""

    def set_amplitude(self, volts_peak_to_peak: float) -> None:
        """Set the open-circuit amplitude (Vpp, in steps of 0.01)."""

    def off(self) -> None:
        """Set the safe state: amplitude zero."""

    def close(self) -> None:
        """Close the port. It does not change the output; call :meth:`off` first."""


class Oscilloscope(Protocol):
    """A digital oscilloscope whose channels are captured together."""

    def identify(self) -> str:
        """The identification. Raises InstrumentError for another instrument."""

    def set_scale(self, channel: int, volts_per_division: float) -> float:
        """Set and return the 1-2-5 step at or above `volts_per_division`. Volts are at the probe's tip."""

    def set_timebase(self, seconds_per_division: float) -> float:
        """Set and return the 1-2.5-5 step at or above `seconds_per_division`."""

    def set_averages(self, count: int) -> None:
        """Set 1 (single capture), 4, 16, 64 or 128 averaged captures."""

    def capture(self, channels: Sequence[int]) -> dict[int, Waveform]:
        """Make one new acquisition, and return its `channels`."""

    def close(self) -> None:
        """Close the port."""
