"""Both instruments of the bench, their ranges, and a safe drive.

The generator cannot report its amplitude and has no output switch, so its drive stays on after a process dies. Before
the drive is first switched on, a marker is written beside the run; it is removed when the drive is off again. Every
connection first sends the safe state, with or without a marker; the marker informs people, and lets the next run record
the event. The oscilloscope confirms that the drive is off, if its last capture showed the drive well; otherwise the
reply of the generator is enough.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from workbench.bench.setup import BenchSetup
from workbench.files.writing import write_atomic
from workbench.instruments.feeltech import open_feeltech
from workbench.instruments.instrument import Generator, InstrumentError, Oscilloscope, Waveform
from workbench.instruments.opening import open_bench
from workbench.instruments.tektronix import DIVISIONS

#: Number of attempts to reopen the bench to switch the drive off, and the pause (s) between them.
_ATTEMPTS_OFF, _PAUSE_OFF = 5, 1.0

#: Largest peak-to-peak height of a sine in divisions, and the height below which a finer scale is set. Scales differ by
#: factors of up to 2.5, so the first must exceed the second by more than that.
_FULL, _SPARSE = 7.2, 2.6

#: Least peak-to-peak size, in converter steps, of a capture that shows the drive well, and the largest share of it when
#: the drive is off.
_VISIBLE, _REMAINING = 20.0, 0.5

#: Largest number of steps of auto-ranging.
_RANGINGS = 12


class DriveLeftOn(InstrumentError):
    """The drive could not be switched off; do it by hand."""


def marker_path(run: Path) -> Path:
    """The file that marks a drive that may be on."""
    return run.with_name(run.name + ".drive-on")


class Rig:
    """Both instruments, as a context manager that ends with the drive off."""

    def __init__(self, setup: BenchSetup, marker: Path, *, sleep: Callable[[float], None] = time.sleep) -> None:
        self.setup = setup
        self.marker = marker
        self.identities: dict[str, str] = {}
        self._sleep = sleep
        self._generator: Generator | None = None
        self._oscilloscope: Oscilloscope | None = None
        self._state: tuple[float, float] | None = None  # frequency and amplitude of the generator
        self._scales: dict[int, float] = {}
        self._shown: Waveform | None = None  # the last capture of the total channel in this state

    def __enter__(self) -> Rig:
        self.connect()
        return self

    def __exit__(self, *_error: object) -> None:
        try:
            self.make_safe()
        finally:
            self.disconnect()

    def connect(self) -> None:
        """Open both instruments with the drive off. Their settings are unknown, so everything is set again."""
        self.disconnect()
        try:
            self._generator, self._oscilloscope = open_bench(self.setup.generator, self.setup.oscilloscope)
            self._generator.off()
            self.marker.unlink(missing_ok=True)
            self.identities = {"generator": self._generator.identify(), "oscilloscope": self._oscilloscope.identify()}
        except BaseException:
            self.disconnect()
            raise

    def disconnect(self) -> None:
        """Close the ports, also if one instrument does not answer."""
        instruments = self._generator, self._oscilloscope
        self._generator = self._oscilloscope = None
        self._state = self._shown = None
        self._scales.clear()
        for instrument in instruments:
            if instrument is not None:
                with contextlib.suppress(InstrumentError, OSError):
                    instrument.close()

    def make_safe(self) -> None:
        """Switch the drive off, and check it with the oscilloscope if possible.

        It reconnects if needed.

        Raises:
            DriveLeftOn: the generator cannot be reached or does not obey, and its drive was on; the marker stays.
        """
        last: Exception | None = None
        for attempt in range(_ATTEMPTS_OFF):
            try:
                if self._generator is None:
                    self._sleep(_PAUSE_OFF if attempt else 0.0)
                    self._generator = open_feeltech(self.setup.generator)
                self._generator.off()
                self._state = None
                if self._still_driven():
                    last = InstrumentError(f"{self.setup.oscilloscope.port}: the oscilloscope still shows the drive")
                    continue
                self._shown = None
                self.marker.unlink(missing_ok=True)
                return
            except (InstrumentError, OSError) as error:
                last = error
                self.disconnect()
        if self.marker.exists():
            raise DriveLeftOn(f"the drive at {self.setup.generator.port} may still be on: switch the generator off by "
                              f"hand ({last})")

    def drive(self, frequency: float, amplitude: float) -> None:
        """Set `frequency` (Hz) and `amplitude` (Vpp, open circuit), and wait to settle."""
        generator, _ = self._opened()
        if self._state == (frequency, amplitude):
            return
        before, self._state = self._state, None
        self._shown = None
        if before is not None and amplitude < before[1]:
            # The amplitude first: the device may tolerate less at the new frequency.
            generator.set_amplitude(amplitude)
            before = before[0], amplitude
        if before is None or before[0] != frequency:
            generator.set_frequency(frequency)
        if before is None or before[1] != amplitude:
            if amplitude > 0.0 and not self.marker.exists():
                write_atomic(self.marker, json.dumps({"port": self.setup.generator.port, "process": os.getpid(),
                                                      "time": time.time()}) + "\n")
            generator.set_amplitude(amplitude)
        self._state = frequency, amplitude
        self._sleep(self.setup.acquisition.settle)

    def capture(self) -> tuple[Waveform, Waveform]:
        """Capture both channels once, on the present ranges. The first is across device and resistor, the second across
        the resistor."""
        _, oscilloscope = self._opened()
        total, reference = self.setup.oscilloscope.channel_total, self.setup.oscilloscope.channel_reference
        captured = oscilloscope.capture((total, reference))
        missing = [channel for channel in (total, reference) if channel not in captured]
        if missing:
            raise InstrumentError(f"{self.setup.oscilloscope.port}: a capture of channels {(total, reference)} came "
                                  f"without {missing}")
        if self._state is not None:
            self._shown = captured[total]
        return captured[total], captured[reference]

    def ranged_capture(self) -> tuple[Waveform, Waveform]:
        """Capture with suitable ranges of both channels, found by trying. A channel that clips on the coarsest range,
        or is small on the finest, is returned unchanged, and flagged later."""
        if not self._scales:
            self._prepare()
        pair = self.capture()
        for _ in range(_RANGINGS):
            before = dict(self._scales)
            for waveform in pair:
                wanted = _better_scale(waveform, self._scales[waveform.channel])
                if wanted is not None:
                    self._set_scale(waveform.channel, wanted)
            if self._scales == before:
                break
            pair = self.capture()
        return pair

    def _still_driven(self) -> bool:
        """True if the oscilloscope still shows the drive."""
        before = self._shown
        if before is None or np.ptp(before.volts) < _VISIBLE * before.volts_per_count:
            return False
        try:
            now, _ = self.capture()
        except (InstrumentError, OSError):
            return False
        return bool(np.ptp(now.volts) > _REMAINING * np.ptp(before.volts))

    def _prepare(self) -> None:
        """Set averages, first scales, and the time base for mid-band."""
        _, oscilloscope = self._opened()
        setup = self.setup
        oscilloscope.set_averages(setup.acquisition.averages)
        middle = 0.5 * (setup.sweep.low + setup.sweep.high)
        oscilloscope.set_timebase(setup.acquisition.periods / (DIVISIONS * middle))
        for channel in (setup.oscilloscope.channel_total, setup.oscilloscope.channel_reference):
            self._set_scale(channel, min(setup.levels) / _FULL)

    def _set_scale(self, channel: int, volts_per_division: float) -> None:
        try:
            self._scales[channel] = self._opened()[1].set_scale(channel, volts_per_division)
        except ValueError:
            # Above the coarsest scale: the scale stays, and clipping is flagged.
            if channel not in self._scales:
                raise

    def _opened(self) -> tuple[Generator, Oscilloscope]:
        if self._generator is None or self._oscilloscope is None:
            raise InstrumentError(f"the bench at {self.setup.generator.port} and {self.setup.oscilloscope.port} is not "
                                  "connected")
        return self._generator, self._oscilloscope


def _better_scale(waveform: Waveform, scale: float) -> float | None:
    """The better volts per division, or None if `scale` is good enough."""
    height = float(waveform.volts.max() - waveform.volts.min())
    if waveform.clipped:
        return 1.5 * scale  # rounded up by the instrument to the next of its 1-2-5 steps
    if height < _SPARSE * scale:
        return max(height, 2.0 * waveform.volts_per_count) / _FULL
    return None
