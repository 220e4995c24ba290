"""workbench.bench.sine_fit: sines of known amplitude, phase and frequency, and uncertainties that hold."""

from typing import Any

import numpy as np
import pytest

from workbench.bench.sine_fit import NoSine, fit_sines
from workbench.instruments.instrument import Waveform

STEP = 4e-9
SAMPLES = 2500
TIME = STEP * np.arange(SAMPLES)
MIDDLE = 0.5 * (SAMPLES - 1) * STEP


def waveform(channel: Any, volts: Any, *, quantum: float = 1e-6, start: float = 0.0, step: Any = STEP) -> Any:
    raw = np.zeros(len(volts), dtype=np.int16)
    return Waveform(channel, np.asarray(volts, dtype=float), raw, start, step, quantum, False)


def sine(amplitude: Any, frequency: Any, offset: float = 0.0) -> Any:
    """A sine whose complex amplitude at the middle of the record is `amplitude`."""
    return np.real(amplitude * np.exp(2j * np.pi * frequency * (TIME - MIDDLE))) + offset


def test_two_channels_of_a_common_frequency_are_recovered() -> None:
    frequency, total, reference = 1.02345e6, 2.0 - 0.7j, 0.01 + 0.02j
    fit = fit_sines([waveform(1, sine(total, frequency, 0.3), quantum=1e-12),
                     waveform(2, sine(reference, frequency, -0.1), quantum=1e-12)], frequency=1.0236e6)
    # Rounding of the samples alone: 1e-16 of 2500 of them; the phase loses what the frequency has.
    assert fit.frequency == pytest.approx(frequency, rel=1e-11)
    np.testing.assert_allclose(fit.amplitude, [total, reference], rtol=1e-9)
    np.testing.assert_allclose(fit.offset, [0.3, -0.1], rtol=1e-9)


@pytest.mark.parametrize("periods", [1.2, 1.5, 2.5, 3.7, 10.25, 24.0])
def test_a_frequency_nobody_told_is_found(periods: Any) -> None:
    frequency = periods / (SAMPLES * STEP)
    rng = np.random.default_rng(1)
    noise = 1e-3 * rng.normal(size=(2, SAMPLES))
    fit = fit_sines([waveform(1, sine(1.0j, frequency) + noise[0]), waveform(2, sine(0.5, frequency) + noise[1])])
    # Least variance of a frequency: sqrt(6) s / (pi A T sqrt(n)) (Rife and Boorstyn 1974), at the single whole period
    # that is used of the shortest record; five of them.
    used = np.floor(periods) / periods
    bound = np.sqrt(6.0) * 1e-3 / (np.pi * used * SAMPLES * STEP * np.sqrt(used * SAMPLES))
    assert abs(fit.frequency - frequency) < 10.0 * bound
    assert fit.amplitude[0] / fit.amplitude[1] == pytest.approx(2.0j, abs=2e-3)


def test_uncertainty_of_the_amplitude_covers_noise() -> None:
    rng = np.random.default_rng(2)
    amplitude = 0.8 * np.exp(0.4j)
    misses = []
    for _ in range(300):
        volts = sine(amplitude, 1.0e6) + 0.05 * rng.normal(size=SAMPLES)
        fit = fit_sines([waveform(1, volts)], frequency=1.0001e6)
        error = (fit.amplitude[0] - amplitude) / fit.uncertainty[0]
        misses += [error.real, error.imag]
    # 600 values: their root mean square is one within 1 / sqrt(1200) = 3 %, three times that allowed.
    assert np.sqrt(np.mean(np.square(misses))) == pytest.approx(1.0, abs=0.09)


@pytest.mark.parametrize(("steps", "noise"), [(8.3, 0.0), (60.7, 0.0), (8.3, 0.4)])
def test_uncertainty_of_the_amplitude_covers_rounding_to_steps(steps: Any, noise: Any) -> None:
    """Rounding distorts a clean sine by more than the residual says; noise of half a step takes that away."""
    rng = np.random.default_rng(3)
    errors, stated = [], []
    for _ in range(200):
        amplitude = steps * rng.uniform(0.95, 1.05) * np.exp(2j * np.pi * rng.random())
        exact = sine(amplitude, 1.0e6, rng.random()) + noise * rng.normal(size=SAMPLES)
        fit = fit_sines([waveform(1, np.round(exact), quantum=1.0)], frequency=1.0e6)
        errors.append(abs(fit.amplitude[0] - amplitude) / np.sqrt(2.0))
        stated.append(fit.uncertainty[0])
    ratio = np.sqrt(np.mean(np.square(errors))) / np.sqrt(np.mean(np.square(stated)))
    # Without noise the estimate is a leading order, good to a factor of two; with noise it is that of the residual.
    assert (0.4 < ratio < 1.3) if noise == 0.0 else ratio == pytest.approx(1.0, abs=0.2)


def test_harmonics_and_offset_do_not_leak() -> None:
    volts = sine(1.0, 0.93e6, 5.0) + 0.05 * np.cos(2 * np.pi * 3 * 0.93e6 * (TIME - MIDDLE))
    fit = fit_sines([waveform(1, volts)], frequency=0.93e6)
    # 9.3 periods in the record: of all of them the third harmonic would leak 1e-3. A fraction of a sample is left over.
    assert abs(fit.amplitude[0] - 1.0) < 1e-4


@pytest.mark.parametrize(("waveforms", "said"), [
    ([waveform(1, sine(1.0, 5e4))], "less than one period"),
    ([waveform(1, np.ones(SAMPLES))], "constant"),
    ([waveform(1, sine(1.0, 5e5))], "no sine of that frequency"),
    ([waveform(1, sine(1.0, 1e6)), waveform(2, sine(1.0, 1e6), step=2 * STEP)], "no common time axis"),
    ([waveform(1, sine(1.0, 1e6)), waveform(2, sine(1.0, 1e6), start=STEP)], "no common time axis"),
])
def test_what_is_no_sine_is_refused(waveforms: Any, said: Any) -> None:
    frequency = 5e4 if "period" in said else 1e6
    with pytest.raises(NoSine, match=said):
        fit_sines(waveforms, frequency=frequency)
