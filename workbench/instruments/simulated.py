"""The simulated bench: both instruments on pseudo-terminals, with a device.

    with SimulatedBench(device_of(spectrum), seed=1) as bench:
        generator, oscilloscope = open_bench(*bench.settings())

A thread serves each instrument, which only sees the bytes on its line. One seed reproduces all noise, if the same
commands come in the same order. There is no waiting unless requested (``pace``), but the simulated clock advances as if
there were, and the device drifts with it.
"""

from __future__ import annotations

import contextlib
import os
import select
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from workbench.instruments.circuit import TYPICAL, Circuit, Device
from workbench.instruments.faults import GENERATOR, OSCILLOSCOPE, Fault, FaultyInstrument
from workbench.instruments.instrument import GeneratorSettings, OscilloscopeSettings
from workbench.instruments.simulated_generator import SimulatedGenerator
from workbench.instruments.simulated_oscilloscope import Errors, SimulatedOscilloscope, Tone

#: Simulated duration of a command in seconds.
COMMAND_TIME = 0.05

#: Seconds between two checks whether a line should end, and until unread bytes are dropped.
SLICE, PATIENCE = 0.05, 1.0

USUAL_ERRORS = Errors()


@dataclass(frozen=True)
class Drift:
    """Relative change per second of a device's frequencies and impedance. A transducer that becomes warmer has about
    -1e-7 in frequency."""

    frequency: float = 0.0
    impedance: float = 0.0


NO_DRIFT = Drift()


class SimulatedBench:
    """A generator, an oscilloscope and a device between them.

    The channels are 1 (total) and 2 (reference), with 10:1 probes. ``device`` is the connected device;
    ``frequency_error`` (relative) is that of the generator's clock. ``folder`` contains the two ports as ``generator``
    and ``oscilloscope`` (default: a temporary folder). ``pace`` is the number of real seconds for one simulated second.
    It is a context manager: the ports exist within the ``with``. It needs pseudo-terminals, which Windows does not
    have.
    """

    def __init__(
        self, device: Device, *, circuit: Circuit = TYPICAL, errors: Errors = USUAL_ERRORS, drift: Drift = NO_DRIFT,
        frequency_error: float = 5e-6, generator_model: str = "FY3224S", oscilloscope_model: str = "TDS 2024B",
        probes: tuple[int, int] = (10, 10), seed: int = 0, pace: float = 0.0, folder: Path | str | None = None,
    ) -> None:
        self._device = device
        self._circuit = circuit
        self._drift = drift
        self._frequency_error = frequency_error
        self._probes = probes
        self._pace = pace
        self._folder = None if folder is None else Path(folder)
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._clock = 0.0
        self._lock = threading.RLock()
        of_noise, of_faults = (np.random.default_rng([seed, n]) for n in (0, 1))
        self._generator = SimulatedGenerator(generator_model)
        self._oscilloscope = SimulatedOscilloscope(
            oscilloscope_model, self._tones, probes={1: probes[0], 2: probes[1]}, errors=errors, random=of_noise,
            wait=self._pass_time)
        self._instruments = {
            name: FaultyInstrument(name, instrument, random=of_faults, disconnect=partial(self.disconnect, name))
            for name, instrument in ((GENERATOR, self._generator), (OSCILLOSCOPE, self._oscilloscope))}
        self._lines: dict[str, _Line] = {}

    def __enter__(self) -> SimulatedBench:
        folder = self._folder
        if folder is None:
            self._temporary = tempfile.TemporaryDirectory(prefix="workbench-bench-")
            folder = Path(self._temporary.name)
        folder.mkdir(parents=True, exist_ok=True)
        for name in self._instruments:
            self._lines[name] = _Line(folder / name, partial(self._respond, name))
        return self

    def __exit__(self, *_error: object) -> None:
        for line in self._lines.values():
            line.close()
        self._lines.clear()
        if self._temporary is not None:
            self._temporary.cleanup()

    @property
    def generator_port(self) -> str:
        """The name of the generator's port."""
        return str(self._lines[GENERATOR].path)

    @property
    def oscilloscope_port(self) -> str:
        """The name of the oscilloscope's port."""
        return str(self._lines[OSCILLOSCOPE].path)

    @property
    def drive(self) -> float:
        """The generator's present open-circuit amplitude (Vpp); 0 is the safe state."""
        return self._generator.amplitude

    @property
    def frequency(self) -> float:
        """The generator's present frequency, Hz."""
        return self._generator.frequency

    @property
    def clock(self) -> float:
        """Simulated seconds since the bench was created."""
        return self._clock

    def struck(self, instrument: str) -> list[tuple[int, Fault]]:
        """The faults of an instrument so far, with their commands' numbers."""
        return list(self._instruments[instrument].struck)

    def commands(self, instrument: str) -> int:
        """The number of commands sent to an instrument."""
        return self._instruments[instrument].commands

    def settings(self, *, timeout: float = 0.25) -> tuple[GeneratorSettings, OscilloscopeSettings]:
        """Settings for the simulated instruments, without pauses. `timeout` (s) is short for tests."""
        return (
            GeneratorSettings(self.generator_port, self._generator.model, timeout=timeout, pause=0.0),
            OscilloscopeSettings(self.oscilloscope_port, self._oscilloscope.model, probe_total=self._probes[0],
                                 probe_reference=self._probes[1], timeout=timeout, acquisition_timeout=2.0 * timeout),
        )

    def truth(self, frequency: float) -> complex:
        """The present impedance (ohm, e^{+j w t}) of the connected device."""
        change = self._drift.frequency * self._clock
        return self._device(frequency / (1.0 + change)) * (1.0 + self._drift.impedance * self._clock)

    def connect(self, device: Device) -> None:
        """Connect another device."""
        with self._lock:
            self._device = device

    def inject(self, fault: Fault) -> None:
        """Add a fault."""
        with self._lock:
            self._instruments[fault.instrument].inject(fault)

    def disconnect(self, instrument: str, seconds: float) -> None:
        """Disconnect an instrument's port for some seconds."""
        self._lines[instrument].drop(seconds)

    def _respond(self, instrument: str, line: bytes) -> bytes:
        with self._lock:
            self._pass_time(COMMAND_TIME)
            return self._instruments[instrument].respond(line)

    def _pass_time(self, seconds: float) -> None:
        self._clock += seconds
        if self._pace:
            time.sleep(seconds * self._pace)

    def _tones(self) -> Mapping[int, Tone]:
        frequency = self._generator.frequency * (1.0 + self._frequency_error)
        responses = self._circuit.responses(frequency, self.truth(frequency))
        volts = 0.5 * self._generator.amplitude
        return {channel: Tone(volts * response, frequency) for channel, response in enumerate(responses, start=1)}


class _Line:
    """A named pseudo-terminal, with a thread that answers line by line."""

    def __init__(self, path: Path, respond: Callable[[bytes], bytes]) -> None:
        self.path = path
        self._respond = respond
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f"simulated {path.name}", daemon=True)
        self._plug_in()
        self._thread.start()

    def drop(self, seconds: float) -> None:
        """Disconnect for a while, as soon as the current line is answered."""
        self._away = seconds

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        if self._plugged_in:
            self._unplug()

    def _plug_in(self) -> None:
        import tty

        self._ours, self._theirs = os.openpty()
        # Raw bytes, no echo; and our end never waits for a reader.
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        # The link of an earlier bench; a link to anything else belongs to the user.
        if self.path.is_symlink() and os.readlink(self.path).startswith("/dev/"):
            self.path.unlink()
        self.path.symlink_to(os.ttyname(self._theirs))
        self._received, self._away, self._plugged_in = b"", 0.0, True

    def _unplug(self) -> None:
        self._plugged_in = False
        self.path.unlink(missing_ok=True)
        os.close(self._ours)
        os.close(self._theirs)

    def _serve(self) -> None:
        import fcntl
        import termios

        while not self._ended.is_set():
            if self._away:
                self._unplug()
                if not self._ended.wait(self._away):
                    self._plug_in()
                continue
            # The terminal stays open here, so a killed owner's exclusive lock would stay, unlike on a real port.
            fcntl.ioctl(self._theirs, termios.TIOCNXCL)
            if not select.select([self._ours], [], [], SLICE)[0]:
                continue
            self._received += os.read(self._ours, 4096)
            *lines, self._received = self._received.split(b"\n")
            for line in lines:
                answer = self._respond(line)
                if self._away:
                    break
                self._send(answer)

    def _send(self, data: bytes) -> None:
        """Send bytes; those that nobody reads are lost, as on a wire."""
        deadline = time.monotonic() + PATIENCE
        while data and time.monotonic() < deadline and not self._ended.is_set():
            with contextlib.suppress(BlockingIOError):
                data = data[os.write(self._ours, data):]
                continue
            select.select([], [self._ours], [], SLICE)
