"""The bench as one object: both instruments, their ranges, and the drive that must not be left on.

The generator cannot be asked for its amplitude and has no output switch, so a process that dies leaves its drive on.
Before the drive is first switched on a marker is written beside the run; it is removed once the drive is known to be
off again. Whoever opens the port next sends the safe state first, marker or not; the marker informs people, and lets
the next run record the event. The oscilloscope shows that the drive is off, if its last capture at the present drive
showed it well; otherwise the reply of the generator has to suffice.
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

#: Number of attempts to open the bench anew to switch the drive off, and the pause (s) between them.
_ATTEMPTS_OFF, _PAUSE_OFF = 5, 1.0

#: Divisions of the screen from top to bottom that a sine may fill, and below which a finer scale is worth setting. The
#: scales follow each other by up to 2.5, so the first must exceed the second by more than that.
_FULL, _SPARSE = 7.2, 2.6

#: Least peak-to-peak size, in converter steps, of a capture that shows the drive well, and the share of it that may
#: remain when the drive is off.
_TELLING, _LEFT = 20.0, 0.5

#: Largest number of steps of auto-ranging.
_RANGINGS = 12


class DriveLeftOn(InstrumentError):
    """The drive could not be switched off: the generator must be switched off by hand."""


def marker_path(run: Path) -> Path:
    """The file that marks a drive that may be on."""
    return run.with_name(run.name + ".drive-on")


class Rig:
    """Owner of both instruments; a context manager that leaves the drive off, whatever happens inside."""

    def __init__(self, setup: BenchSetup, marker: Path, *, sleep: Callable[[float], None] = time.sleep) -> None:
        self.setup = setup
        self.marker = marker
        self.identities: dict[str, str] = {}
        self._sleep = sleep
        self._generator: Generator | None = None
        self._oscilloscope: Oscilloscope | None = None
        self._state: tuple[float, float] | None = None  # frequency and amplitude of the generator
        self._scales: dict[int, float] = {}
        self._shown: Waveform | None = None  # the total channel as last captured in this state

    def __enter__(self) -> Rig:
        self.connect()
        return self

    def __exit__(self, *_error: object) -> None:
        try:
            self.make_safe()
        finally:
            self.disconnect()

    def connect(self) -> None:
        """Open both instruments with the drive off. Their settings are not known, so everything is set anew."""
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
        """Give the ports back as they are. An instrument that has gone away is no reason to keep the other."""
        instruments = self._generator, self._oscilloscope
        self._generator = self._oscilloscope = None
        self._state = self._shown = None
        self._scales.clear()
        for instrument in instruments:
            if instrument is not None:
                with contextlib.suppress(InstrumentError, OSError):
                    instrument.close()

    def make_safe(self) -> None:
        """Switch the drive off, through a new connection if need be, and check it with the oscilloscope if possible.

        Raises DriveLeftOn if the generator cannot be reached, or does not obey, and was last seen driving; the marker
        stays.
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
        """Set the generator to `frequency` (Hz) and `amplitude` (V peak to peak, open circuit), and let it settle."""
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
        """Capture once across device and resistor, and across the resistor, on the present ranges."""
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
        """Capture with both channels on ranges that they fill well, found by trying.

        A channel that clips on the coarsest range, or is small on the finest, is returned as it is, to be flagged.
        """
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
        """Whether the oscilloscope still shows the drive after it was switched off; no if it cannot tell."""
        before = self._shown
        if before is None or np.ptp(before.volts) < _TELLING * before.volts_per_count:
            return False
        try:
            now, _ = self.capture()
        except (InstrumentError, OSError):
            return False
        return bool(np.ptp(now.volts) > _LEFT * np.ptp(before.volts))

    def _prepare(self) -> None:
        """Set averages, first scales and the time base of the middle of the band, which need not follow."""
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
            # Above the coarsest scale: it is kept, and clipping is flagged.
            if channel not in self._scales:
                raise

    def _opened(self) -> tuple[Generator, Oscilloscope]:
        if self._generator is None or self._oscilloscope is None:
            raise InstrumentError(f"the bench at {self.setup.generator.port} and {self.setup.oscilloscope.port} is not "
                                  "connected")
        return self._generator, self._oscilloscope


def _better_scale(waveform: Waveform, scale: float) -> float | None:
    """The volts per division to set, or None if `scale` is good enough."""
    height = float(waveform.volts.max() - waveform.volts.min())
    if waveform.clipped:
        return 1.5 * scale  # rounded up by the instrument to the next of its 1-2-5 steps
    if height < _SPARSE * scale:
        return max(height, 2.0 * waveform.volts_per_count) / _FULL
    return None
