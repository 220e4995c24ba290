"""The sweep: each point is on disk before the next.

The drive is off at every end. Every failure of an instrument (no answer, a wrong answer, unplugged, lost settings) has
one remedy: the bench is reopened, which switches the drive off and sets everything again, and the point is repeated. If
that does not help, the run ends in good order and can be resumed.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from workbench.bench.impedance import impedance
from workbench.bench.plan import Target, expected_points, next_target
from workbench.bench.rig import Rig, marker_path
from workbench.bench.run_file import Event, Journal, Run, RunPoint, exists, new_run, read_run
from workbench.bench.setup import AMPLITUDE_RESOLUTION, SOURCE_RESISTANCE, BenchSetup
from workbench.bench.sine_fit import NoSine, SineFit, fit_sines
from workbench.files.errors import InputError
from workbench.instruments.instrument import InstrumentError, Waveform
from workbench.jobs.progress import Progress, no_progress

#: The pause (s) before the bench is reopened, doubled from one attempt to the next.
_PAUSE = 0.2

#: Least amplitude of a point without a flag, in converter steps and in units of its uncertainty. The rounding error is
#: equal in every capture: up to 1 % at 6 steps, 0.4 % at 12.
_FEW_STEPS, _NEAR_NOISE = 6.0, 20.0

#: Largest relative deviation of the signal's frequency from the set one, and largest factor between the amplitude
#: across the whole circuit and its expectation behind the generator's 50 ohm. Both instruments are specified to 1e-4
#: and 10 %; only gross faults exceed the limits (a setting that was not applied, a record of the previous point).
_FREQUENCY_OFF, _AMPLITUDE_OFF = 3e-4, 1.5

#: Factor above a limit at which it counts as exceeded: the uncertainty of the readings.
_OVER = 1.05


class BenchFailure(RuntimeError):
    """The sweep had to end. The message gives the reason, the data on the disk and the way to continue."""


class LimitExceeded(RuntimeError):
    """A limit in BENCH.toml was exceeded; the drive was switched off."""


class Implausible(InstrumentError):
    """The data from the instruments cannot belong to the requested point."""


def measure(
    setup: BenchSetup, path: Path | str, *, resume: bool = False, sleep: Callable[[float], None] = time.sleep,
    progress: Progress = no_progress, on_point: Callable[[Run], object] = lambda _run: None,
) -> Run:
    """Measure all points of `setup` into the run file `path`.

    With `resume` only missing points are measured. `on_point` is called with the run after every point. Every finished
    point is on the disk at any moment; the drive is off when this returns or raises.

    Raises:
        InputError: the run exists and `resume` is off, or it was made with another BENCH.toml.
        BenchFailure: an instrument failed more often than allowed (the run can be resumed).
        LimitExceeded: a limit of the device was exceeded.
    """
    path = Path(path)
    marker = marker_path(path)
    was_on = marker.exists()
    if not was_on:
        _existing(path, setup, resume=resume)  # a mistake is reported before the bench is touched
    with Rig(setup, marker, sleep=sleep) as rig:
        found = _existing(path, setup, resume=resume)
        run = found or new_run(setup.text, rig.identities, time.time())
        with Journal(path, run) as journal:
            if found is not None:
                _note(journal, f"resumed with {len(run.points)} points")
            if was_on:
                _note(journal, "the process before this one had left the drive on; it was switched off first")
            expected = expected_points(setup)
            try:
                while (target := next_target(setup, journal.run.points)) is not None:
                    journal.add(_insistently(setup, rig, journal, target, sleep))
                    progress("points", min(len(journal.run.points) / expected, 1.0))
                    on_point(journal.run)
            except BaseException as error:
                try:
                    rig.make_safe()
                finally:
                    _note(journal, f"ended early: {type(error).__name__}: {error}")
                    journal.fold(complete=False)
                raise
            rig.make_safe()
            return journal.fold(complete=True)


def _existing(path: Path, setup: BenchSetup, *, resume: bool) -> Run | None:
    """The run to resume, or None for a new one."""
    if not exists(path):
        return None
    if not resume:
        raise InputError(str(path), "run file", path.name, "a file that does not exist, or --resume to go on with it")
    run = read_run(path)
    if run.setup_text != setup.text:
        lines = zip(run.setup_text.splitlines(), setup.text.splitlines(), strict=False)
        different = next(((a, b) for a, b in lines if a != b), ("the end", "the end"))
        raise InputError(setup.path, "BENCH.toml", different[1],
                         f"the file that {path} was begun with, which has {different[0]!r} there")
    return run


def _note(journal: Journal, text: str) -> None:
    journal.add(Event(time.time(), text))


def _insistently(
    setup: BenchSetup, rig: Rig, journal: Journal, target: Target, sleep: Callable[[float], None]
) -> RunPoint:
    """The point, after up to the allowed number of attempts."""
    sequence = len(journal.run.points)
    for attempt in range(setup.acquisition.attempts):
        try:
            if attempt:
                sleep(_PAUSE * 2.0 ** (attempt - 1))
                rig.connect()
            return _point(setup, rig, target, sequence)
        except InstrumentError as error:
            _note(journal, f"{target.frequency:.2f} Hz, attempt {attempt + 1}: {error}")
            last = error
    raise BenchFailure(f"{target.frequency:.2f} Hz failed {setup.acquisition.attempts} times, last: {last}. The "
                       f"{sequence} points before it are in {journal.path}; --resume goes on from there")


def _point(setup: BenchSetup, rig: Rig, target: Target, sequence: int) -> RunPoint:
    """Set, settle, find the ranges, capture, fit."""
    started = time.time()
    amplitude = _allowed(setup, rig, target)
    rig.drive(target.frequency, amplitude)
    pairs = [rig.ranged_capture()]
    while len(pairs) < setup.acquisition.captures:
        pairs.append(rig.capture())
        for first, later in zip(pairs[0], pairs[-1], strict=True):
            if later.clipped and not first.clipped:
                raise Implausible(f"{setup.oscilloscope.port}: channel {later.channel} suddenly leaves the screen")
    fits = [_fitted(pair, target.frequency) for pair in pairs]
    found = impedance(fits, setup.reference.resistance)
    flags = _doubts(setup, pairs, fits, found.value, amplitude, target)
    if not math.isnan(found.scatter) and found.scatter > 3.0:
        flags.append(f"unsteady: captures differ by {found.scatter:.1f} times their noise")
    point = RunPoint(
        sequence, target.frequency, target.level, amplitude, target.pass_number, started,
        raw=np.stack([[w.raw for w in pair] for pair in pairs]),
        volts_per_count=np.array([[w.volts_per_count for w in pair] for pair in pairs]),
        volts_at_zero=np.array([[w.volts[0] - w.raw[0] * w.volts_per_count for w in pair] for pair in pairs]),
        start=np.array([pair[0].start for pair in pairs]), step=pairs[0][0].step,
        voltage=np.stack([fit.amplitude for fit in fits]),
        voltage_uncertainty=np.stack([fit.uncertainty for fit in fits]),
        fitted_frequency=np.array([fit.frequency for fit in fits]),
        impedance=found.value, uncertainty=found.random, flags=tuple(flags),
    )
    current = 2.0 * float(np.mean(np.abs(point.voltage[:, 1]))) / setup.reference.resistance
    if point.device_voltage > _OVER * setup.limits.device_voltage or current > _OVER * setup.limits.device_current:
        raise LimitExceeded(
            f"at {target.frequency:.2f} Hz and {amplitude:g} Vpp the device saw {point.device_voltage:.3g} Vpp and "
            f"{current:.3g} A peak to peak; allowed are {setup.limits.device_voltage:g} Vpp and "
            f"{setup.limits.device_current:g} A")
    return point


def _allowed(setup: BenchSetup, rig: Rig, target: Target) -> float:
    """The amplitude (Vpp, open circuit) within the limits of the device. It is at most the level of the target. If the
    level could exceed a limit with some passive device, the device is first measured below it."""
    safe = math.floor(setup.safe_amplitude / AMPLITUDE_RESOLUTION + 1e-9) * AMPLITUDE_RESOLUTION
    if target.level <= safe:
        return target.level
    if safe < AMPLITUDE_RESOLUTION:
        raise InputError(setup.path, "limits", setup.safe_amplitude, f"limits that the generator's smallest amplitude, "
                         f"{AMPLITUDE_RESOLUTION} Vpp, is sure to keep")
    rig.drive(target.frequency, round(safe, 2))
    pair = rig.ranged_capture()
    total, reference = _fitted(pair, target.frequency).amplitude
    voltage, current = 2.0 * abs(total - reference), 2.0 * abs(reference) / setup.reference.resistance
    most = safe * min(setup.limits.device_voltage / voltage, setup.limits.device_current / current)
    return min(target.level, math.floor(max(safe, most) / AMPLITUDE_RESOLUTION + 1e-9) * AMPLITUDE_RESOLUTION)


def _fitted(pair: tuple[Waveform, Waveform], frequency: float) -> SineFit:
    try:
        fit = fit_sines(pair, frequency=frequency)
    except NoSine as error:
        raise Implausible(f"no sine of {frequency:.2f} Hz: {error}") from error
    if abs(fit.frequency / frequency - 1.0) > _FREQUENCY_OFF:
        raise Implausible(f"the signals have {fit.frequency:.0f} Hz, set were {frequency:.2f} Hz")
    return fit


def _doubts(
    setup: BenchSetup, pairs: list[tuple[Waveform, Waveform]], fits: list[SineFit], value: complex, amplitude: float,
    target: Target,
) -> list[str]:
    """Doubts about a point; the part before the colon is the kind."""
    flags = []
    whole = value + setup.reference.resistance
    expected = 0.5 * amplitude * abs(whole / (whole + SOURCE_RESISTANCE))
    seen = float(np.mean([abs(fit.amplitude[0]) for fit in fits]))
    if not expected / _AMPLITUDE_OFF < seen < expected * _AMPLITUDE_OFF:
        raise Implausible(f"{seen:.3g} V across the circuit, where {amplitude:g} Vpp behind {SOURCE_RESISTANCE:g} ohm "
                          f"give {expected:.3g} V to {abs(whole):.3g} ohm: a setting was not taken, or a probe factor "
                          "in BENCH.toml is not that of the probe")
    for index, name in enumerate(("total", "reference")):
        if any(pair[index].clipped for pair in pairs):
            flags.append(f"clipped: the {name} channel leaves the screen")
        sizes = [abs(fit.amplitude[index]) for fit in fits]
        steps = min(size / pair[index].volts_per_count for size, pair in zip(sizes, pairs, strict=True))
        above = min(size / fit.uncertainty[index] for size, fit in zip(sizes, fits, strict=True))
        if steps < _FEW_STEPS:
            flags.append(f"low signal: the {name} channel has {steps:.1f} steps of the converter, {_FEW_STEPS:g} or "
                         "more are wanted: rounding to steps errs alike in every capture, which no average shows; "
                         "more drive, a larger reference resistor or a probe of factor 1 gives more")
        if above < _NEAR_NOISE:
            flags.append(f"low signal: the {name} channel has {above:.0f} times its uncertainty, {_NEAR_NOISE:g} or "
                         "more are wanted: it is near the noise; more drive or more averages help")
    if amplitude < target.level:
        flags.append(f"drive reduced: to {amplitude:.2f} Vpp, for the limits of the device")
    return flags
