"""Sine fits to records of an oscilloscope, with a common frequency.

The four-parameter fit of IEEE Std 1057: x_k(t) = Re(V_k e^{j w (t - t_c)}) + offset_k for every channel k, with one w
for all and t_c the middle of the record, where the phase is least correlated with w.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.files.quantities import frequency_text
from workbench.instruments.instrument import Waveform

#: Largest number of Gauss-Newton steps. Three or four are enough for a frequency known to 1 % of a period.
_STEPS = 20


class NoSine(ValueError):
    """No sine could be fitted; the message gives the reason."""


@dataclass(frozen=True, eq=False)
class SineFit:
    """Sines of one frequency in the channels of one capture.

    ``frequency`` is in Hz; ``amplitude`` (channels,) in complex V, zero to peak, e^{+j w t}, at the middle of the
    record; ``uncertainty`` (channels,) V is the standard uncertainty of its real and of its imaginary part, each;
    ``offset`` and ``residual`` (rms) (channels,) are in V; ``noise`` (channels,) is the residual in quantisation steps.
    """

    frequency: float
    amplitude: NDArray[np.complex128]
    uncertainty: NDArray[np.float64]
    offset: NDArray[np.float64]
    residual: NDArray[np.float64]
    noise: NDArray[np.float64]


def fit_sines(waveforms: Sequence[Waveform], *, frequency: float | None = None) -> SineFit:
    """Fit all channels of one capture.

    `frequency` (Hz) is the generator's setting; without it, it is searched. Only whole periods are used, so that
    harmonics and a wrong offset do not affect the amplitude.

    Raises:
        NoSine: less than one period in the record, no common time axis, or no convergence.
    """
    first = waveforms[0]
    for other in waveforms[1:]:
        if len(other.volts) != len(first.volts) or not math.isclose(other.step, first.step, rel_tol=1e-9) or (
                abs(other.start - first.start) > 0.5 * first.step):
            raise NoSine(f"channels {first.channel} and {other.channel} have no common time axis: {len(first.volts)} "
                         f"samples of {first.step:.6g} s from {first.start:.6g} s against {len(other.volts)} of "
                         f"{other.step:.6g} s from {other.start:.6g} s")
    for w in waveforms:
        if np.ptp(w.volts) == 0.0:
            raise NoSine(f"channel {w.channel} is constant: there is no sine in it")
    signal = np.stack([w.volts for w in waveforms])
    if frequency is None:
        frequency = _search(signal, first.step)
    # The number of samples in the largest whole number of periods.
    whole = math.floor(len(first.volts) * first.step * frequency + 1e-9)
    used = min(len(first.volts), round(whole / (first.step * frequency)))
    if used == 0:
        raise NoSine(f"{len(first.volts)} samples of {first.step:.6g} s hold less than one period of "
                     f"{frequency_text(frequency)}")
    signal = signal[:, :used]
    time = np.asarray(first.step * (np.arange(used) - 0.5 * (used - 1)), dtype=np.float64)
    omega, parameters, residual = _settle(signal, time, 2.0 * np.pi * frequency)
    # The phase is reported at the middle of the whole record, which does not depend on the number of whole periods.
    shift = np.exp(1j * omega * first.step * 0.5 * (len(first.volts) - used))
    amplitude = (parameters[:, 0] - 1j * parameters[:, 1]) * shift
    freedom = used - 3 - 1 / len(signal)
    spread = np.sqrt(np.sum(residual**2, axis=1) / freedom)
    quantum = np.array([w.volts_per_count for w in waveforms])
    random = spread * math.sqrt(2.0 / used)
    steps = _quantisation(np.abs(amplitude) / quantum, spread / quantum) * quantum
    return SineFit(omega / (2.0 * np.pi), amplitude, np.hypot(random, steps), parameters[:, 2], spread,
                   spread / quantum)


def _settle(
    signal: NDArray[np.float64], time: NDArray[np.float64], omega: float
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Angular frequency, parameters (channels, 3), and residual (channels, n). Parameters are cosine, sine and offset.
    It is Gauss-Newton on the frequency alone: for each frequency the rest is linear, and is solved (IEEE Std 1057,
    4.1.4.3 takes all steps together; the solution is the same)."""
    reach = np.pi / (time[-1] - time[0])  # beyond it the residual has other minima
    begin = omega
    for _ in range(_STEPS):
        design = np.stack([np.cos(omega * time), np.sin(omega * time), np.ones_like(time)], axis=1)
        basis, upper = np.linalg.qr(design)
        inside = signal @ basis
        residual = signal - inside @ basis.T
        parameters = np.linalg.solve(upper, inside.T).T
        variance = np.maximum(np.sum(residual**2, axis=1), 1e-30 * np.sum(signal**2, axis=1) + 1e-300)
        slope = time * (parameters[:, 1:2] * design[:, 0] - parameters[:, 0:1] * design[:, 1])
        slope -= (slope @ basis) @ basis.T
        steepness = float(np.sum(np.sum(slope**2, axis=1) / variance))
        step = float(np.sum(np.sum(slope * residual, axis=1) / variance)) / steepness
        if abs(step) <= 1e-12 * omega:
            return omega, parameters, residual
        omega += step
        if not abs(omega - begin) < reach:
            raise NoSine(f"the fit ran from {frequency_text(begin / (2 * np.pi), omega / (2 * np.pi))}: there is no "
                         "sine of that frequency in the record")
    # With noise alone the last digits do not converge; a step that is still large is a defect of the record.
    if abs(step) > 1e-3 * reach:
        raise NoSine(f"the fit did not settle at {frequency_text(omega / (2 * np.pi))}; last step "
                     f"{frequency_text(step / (2 * np.pi))}")
    return omega, parameters, residual


def _search(signal: NDArray[np.float64], step: float) -> float:
    """An estimate of the frequency (Hz) of the common sine. It is the peak of the periodogram, refined by the least
    residual of three-parameter fits about it, since one to four periods in the record give a coarse periodogram."""
    centred = signal - signal.mean(axis=1, keepdims=True)
    scale = np.sqrt(np.mean(centred**2, axis=1))
    samples = signal.shape[1]
    power = np.sum(np.abs(np.fft.rfft(centred / scale[:, None], axis=1)) ** 2, axis=0)
    peak = int(np.argmax(power[1:])) + 1
    time = step * (np.arange(samples) - 0.5 * (samples - 1))
    trials = (peak + np.linspace(-0.9, 0.9, 37)) / (samples * step)

    def residual(frequency: float) -> float:
        phase = 2.0 * np.pi * frequency * time
        basis, _ = np.linalg.qr(np.stack([np.cos(phase), np.sin(phase), np.ones_like(time)], axis=1))
        return float(np.sum(((centred - (centred @ basis) @ basis.T) / scale[:, None]) ** 2))

    return float(min(trials, key=residual))


def _quantisation(amplitude: NDArray[np.float64], noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard error (in steps) of an amplitude due to rounding. The part in the residual is excluded. The fundamental
    of the error of rounding a sine of `amplitude` steps is (2 / pi) J_1(2 pi amplitude), to leading order, of size (2 /
    pi) / (pi sqrt(amplitude)) at its crests and a root of two less on average; Gaussian noise of s steps before the
    converter multiplies it by exp(-2 pi^2 s^2) (Widrow and Kollar, Quantization Noise, 2008, chapters 17 and 20). The
    residual contains 1/12 of a squared step of the rounding itself."""
    dither = np.maximum(noise**2 - 1.0 / 12.0, 0.0)
    crest = 2.0 / (np.pi**2 * np.sqrt(np.maximum(amplitude, 0.25)))
    return np.asarray(crest / math.sqrt(2.0) * np.exp(-2.0 * np.pi**2 * dither))
