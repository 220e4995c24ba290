"""Every kind of fault, at several moments of a short measurement: what comes out is right, or an error says so."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support import Wire

from workbench.instruments import feeltech, tektronix
from workbench.instruments.circuit import IDEAL
from workbench.instruments.faults import GENERATOR, KINDS, OSCILLOSCOPE, Fault, FaultKind, fits
from workbench.instruments.instrument import Generator, InstrumentError, Oscilloscope, Silence, Waveform
from workbench.instruments.opening import open_bench
from workbench.instruments.simulated import SimulatedBench

FREQUENCIES = (1.00e6, 1.05e6)

#: Seconds. A bench that does not get its turn in that time is one more fault, which must do no harm either.
TIMEOUT = 0.05

#: Of eq. 25 on two records of 2500 points, no leads, exact gains: 0.5 steps of noise in 40 give, for each channel,
#: 0.5 / 40 * sqrt(2 / 2500) = 4e-4; together 5e-4, and six times that.
TOLERANCE = 3e-3

#: Errors after which a measurement is given up.
PATIENCE = 40


def device(frequency: float) -> complex:
    return (3.0 - 4.0j) * frequency / 1e6


def impedance(waveforms: dict[int, Waveform], frequency: float) -> complex:
    """Eq. 25 with R = 0.5 ohm, the amplitudes by least squares."""
    amplitude = {}
    for channel, waveform in waveforms.items():
        angle = 2 * np.pi * frequency * (waveform.start + waveform.step * np.arange(waveform.volts.size))
        columns = np.stack([np.cos(angle), -np.sin(angle)], axis=1)
        amplitude[channel] = complex(*np.linalg.lstsq(columns, waveform.volts, rcond=None)[0])
    return 0.5 * (amplitude[1] - amplitude[2]) / amplitude[2]


def directly(bench: SimulatedBench, name: str, **_settings: object) -> Wire:
    """An instrument of the bench without a terminal between."""
    return Wire(partial(bench._respond, Path(name).name))


def close(opened: tuple[Generator, Oscilloscope] | None) -> None:
    for instrument in opened or ():
        instrument.close()


def measured(bench: SimulatedBench) -> tuple[dict[float, complex], list[InstrumentError]]:
    """Two points, each tried again until it comes without an error, unclipped and with a signal; and the errors.

    After an error everything is opened anew, as somebody would who does not know what it was.
    """
    found: dict[float, complex] = {}
    errors: list[InstrumentError] = []
    opened = None
    while len(errors) < PATIENCE:
        try:
            if opened is None:
                opened = open_bench(*bench.settings(timeout=TIMEOUT))
                generator, oscilloscope = opened
                oscilloscope.set_timebase(1e-6)
                oscilloscope.set_scale(1, 0.2)
                oscilloscope.set_scale(2, 0.02)
                generator.set_amplitude(10.0)
            for frequency in (f for f in FREQUENCIES if f not in found):
                generator.set_frequency(frequency)
                waveforms = oscilloscope.capture([1, 2])
                if any(waveform.clipped for waveform in waveforms.values()) or np.ptp(waveforms[1].raw) < 20:
                    raise InstrumentError("clipped, or no signal: the amplitude did not reach the generator")
                found[frequency] = impedance(waveforms, frequency)
            generator.off()
            break
        except InstrumentError as error:
            errors.append(error)
            close(opened)
            opened = None
            time.sleep(0.01)  # for a port to come back
    close(opened)
    return found, errors


CASES = [(instrument, kind) for instrument, kinds in KINDS.items() for kind in kinds]


def test_there_are_many_kinds() -> None:
    assert len(FaultKind) == 20
    assert set(KINDS[GENERATOR]) | set(KINDS[OSCILLOSCOPE]) == set(FaultKind)


@pytest.mark.parametrize(("instrument", "kind"), CASES)
def test_nothing_wrong_comes_out_silently_and_the_drive_ends_off(instrument: str, kind: FaultKind) -> None:
    """Struck while opening and again while measuring (after 60 commands there is a capture under way)."""
    with SimulatedBench(device, circuit=IDEAL, frequency_error=0.0, seed=3) as bench:
        for at in {GENERATOR: (0, 9), OSCILLOSCOPE: (0, 60)}[instrument]:
            bench.inject(Fault(instrument, kind, at=at, seconds=0.05))
        found, _ = measured(bench)
        for frequency in FREQUENCIES:
            assert found[frequency] == pytest.approx(device(frequency), rel=TOLERANCE)
        assert bench.drive == 0.0
        # Once it is open, nobody asks the oscilloscope who it is.
        once = (instrument, kind) == (OSCILLOSCOPE, FaultKind.WRONG_INSTRUMENT)
        assert len(bench.struck(instrument)) == (1 if once else 2)


@pytest.mark.parametrize(("instrument", "kind", "error", "message"), [
    (GENERATOR, FaultKind.SILENCE, Silence, "nothing came within|nothing and nothing more"),
    (GENERATOR, FaultKind.WRONG_INSTRUMENT, InstrumentError, "MHS-5200A"),
    (OSCILLOSCOPE, FaultKind.WRONG_INSTRUMENT, InstrumentError, "RIGOL"),
    (GENERATOR, FaultKind.DEAFNESS, Silence, "nothing came within"),
    (OSCILLOSCOPE, FaultKind.GARBAGE, InstrumentError, r"sent '\*IDN\?'; expected TEKTRONIX,model"),
])
def test_what_lasts_is_reported_as_what_it_is(
    instrument: str, kind: FaultKind, error: type[InstrumentError], message: str
) -> None:
    with SimulatedBench(device, seed=3) as bench:
        bench.inject(Fault(instrument, kind, count=100))
        with pytest.raises(error, match=message):
            open_bench(*bench.settings(timeout=TIMEOUT))


def test_a_fault_that_is_over_is_only_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """None of these costs more than a repeated question: no error is seen from outside."""
    for instrument, kinds in KINDS.items():
        for kind in kinds:
            if kind in (FaultKind.SILENCE, FaultKind.GARBAGE, FaultKind.NOISE, FaultKind.PARTIAL, FaultKind.LATE,
                        FaultKind.ECHO):
                with SimulatedBench(device, circuit=IDEAL, frequency_error=0.0, seed=3) as bench:
                    bench.inject(Fault(instrument, kind, at=5))
                    # Answers that come at once, however busy the computer is: nothing else goes wrong.
                    for driver in (feeltech, tektronix):
                        monkeypatch.setattr(driver, "open_port", partial(directly, bench))
                    opened = open_bench(*bench.settings(timeout=TIMEOUT))
                    opened[0].set_frequency(1e6)
                    assert len(bench.struck(instrument)) == 1
                    close(opened)


def test_which_commands_a_fault_fits() -> None:
    assert fits(FaultKind.SILENCE, b"cf")
    assert not fits(FaultKind.SILENCE, b"bf100")
    assert fits(FaultKind.IGNORED_FREQUENCY, b"bf100")
    assert fits(FaultKind.HIDDEN, b"CURVE?")
    assert not fits(FaultKind.HIDDEN, b"WFMPRE?")
