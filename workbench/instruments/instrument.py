"""Interfaces of a generator and of an oscilloscope of any make, as the bench uses them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class InstrumentError(RuntimeError):
    """A failure of an instrument or its link; the message names the port, and the sent, expected and received text."""


class Silence(InstrumentError):
    """Nothing came, or not all of it, within the time-out."""


@dataclass(frozen=True)
class GeneratorSettings:
    """Address and identity of the generator.

    ``port`` is a serial port; ``model`` its expected identification (a key of ``feeltech.MODELS``); ``timeout`` (s) the
    limit for a reply; ``pause`` (s) follows every command, because settings are not acknowledged.
    """

    port: str
    model: str = "FY3224S"
    baud: int = 9600
    timeout: float = 1.0
    pause: float = 0.1


@dataclass(frozen=True)
class OscilloscopeSettings:
    """Address and identity of the oscilloscope, and the assignment of its channels.

    ``port`` is a serial port, a USBTMC device file (``/dev/usbtmc0``) or a VISA resource (``USB0::...::INSTR``).
    ``channel_total`` measures across device and reference resistor, ``channel_reference`` across the resistor alone;
    the probe factors (1 or 10) are those of the probes on them. ``trigger`` is "CH1" to "CH4" or "EXT". ``timeout`` (s)
    is for one reply, ``acquisition_timeout`` (s) for one whole acquisition, averages included.
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

    ``volts`` (n,) V at the probe's tip, or A of a current probe; ``unit`` "V", "A" or "" if not stated; ``raw`` (n,)
    as the converter gave it, signed 8 bit; ``start`` (s) the time of the first sample relative to the trigger; ``step``
    (s) per sample; ``volts_per_count`` the quantisation step, in the unit; ``clipped`` whether any sample stands at the
    limit of the converter or of the screen.
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
    """A sine generator with one driven output. A value out of range raises ValueError before anything is written."""

    def identify(self) -> str:
        """The model as the instrument answers. Raises InstrumentError if it is another instrument."""

    def set_frequency(self, frequency: float) -> None:
        """Set the frequency (Hz, a whole number of 0.01 Hz) and check it by reading it back."""

    def set_amplitude(self, volts_peak_to_peak: float) -> None:
        """Set the open-circuit amplitude (V peak to peak, a whole number of 0.01 V)."""

    def off(self) -> None:
        """Set the safe state: amplitude zero."""

    def close(self) -> None:
        """Give the port back. Does not change the output; call :meth:`off` first."""


class Oscilloscope(Protocol):
    """A digital oscilloscope whose channels are captured together."""

    def identify(self) -> str:
        """The identification as the instrument answers. Raises InstrumentError if it is another instrument."""

    def set_scale(self, channel: int, volts_per_division: float) -> float:
        """Choose the 1-2-5 step at or above `volts_per_division` (V at the probe's tip), and return it."""

    def set_timebase(self, seconds_per_division: float) -> float:
        """Choose the 1-2.5-5 step at or above `seconds_per_division`, and return it."""

    def set_averages(self, count: int) -> None:
        """Set 1 (single capture), 4, 16, 64 or 128 averaged captures."""

    def capture(self, channels: Sequence[int]) -> dict[int, Waveform]:
        """Make one new acquisition, and return every channel of `channels` from it."""

    def close(self) -> None:
        """Give the port back."""
