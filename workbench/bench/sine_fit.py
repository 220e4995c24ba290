"""Sines in records of an oscilloscope: the four-parameter fit of IEEE Std 1057, for channels with a common frequency.

x_k(t) = Re(V_k e^{j w (t - t_c)}) + offset_k for every channel k, with one w for all and t_c the middle of the record,
where the phase is least correlated with w.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.instruments.instrument import Waveform

#: Largest number of Gauss-Newton steps; from a frequency known to a part in a hundred of a period it takes three or
#: four.
_STEPS = 20


class NoSine(ValueError):
    """No sine could be fitted; the message names the attempt and the obstacle."""


@dataclass(frozen=True, eq=False)
class SineFit:
    """Sines of one frequency in the channels of one capture.

    ``frequency`` Hz; ``amplitude`` (channels,) complex V, zero to peak, e^{+j w t}, at the middle of the record;
    ``uncertainty`` (channels,) V, the standard uncertainty of its real and of its imaginary part, each; ``offset`` and
    ``residual`` (channels,) V, the latter root mean square; ``noise`` (channels,) the residual in quantisation steps.
    """

    frequency: float
    amplitude: NDArray[np.complex128]
    uncertainty: NDArray[np.float64]
    offset: NDArray[np.float64]
    residual: NDArray[np.float64]
    noise: NDArray[np.float64]


def fit_sines(waveforms: Sequence[Waveform], *, frequency: float | None = None) -> SineFit:
    """Fit all channels of one capture; `frequency` (Hz) is the generator's setting, searched for if not given.

    Only whole periods are used, so that harmonics and a faulty offset do not leak into the amplitude. Raises NoSine for
    less than one period in the record, no common time axis, or no frequency the fit settles on.
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
    # The number of samples that hold the greatest whole number of periods.
    whole = math.floor(len(first.volts) * first.step * frequency + 1e-9)
    used = min(len(first.volts), round(whole / (first.step * frequency)))
    if used == 0:
        raise NoSine(f"{len(first.volts)} samples of {first.step:.6g} s hold less than one period of "
                     f"{frequency:.6g} Hz")
    signal = signal[:, :used]
    time = np.asarray(first.step * (np.arange(used) - 0.5 * (used - 1)), dtype=np.float64)
    omega, parameters, residual = _settle(signal, time, 2.0 * np.pi * frequency)
    # Reported at the middle of the whole record, which does not move with the number of whole periods.
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
    """Angular frequency, (channels, 3) cosine, sine and offset, and (channels, n) residual.

    It is Gauss-Newton on the frequency alone: for each frequency the rest is linear, and is solved (IEEE Std 1057,
    4.1.4.3 takes all steps together; the solution is the same).
    """
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
            raise NoSine(f"the fit ran from {begin / (2 * np.pi):.9g} Hz to {omega / (2 * np.pi):.9g} Hz: there is no "
                         "sine of that frequency in the record")
    # Noise alone keeps it from the last digits; a step that is still large is a defect of the record.
    if abs(step) > 1e-3 * reach:
        raise NoSine(f"the fit did not settle at {omega / (2 * np.pi):.9g} Hz; last step {step / (2 * np.pi):.3g} Hz")
    return omega, parameters, residual


def _search(signal: NDArray[np.float64], step: float) -> float:
    """The frequency (Hz) of the sine common to all channels, near enough for the fit.

    It is the peak of the periodogram, refined by the least residual of three-parameter fits about it, since one to four
    periods in the record leave a periodogram too coarse by itself.
    """
    centred = signal - signal.mean(axis=1, keepdims=True)
    scale = np.sqrt(np.mean(centred**2, axis=1))
    samples = signal.shape[1]
    power = np.sum(np.abs(np.fft.rfft(centred / scale[:, None], axis=1)) ** 2, axis=0)
    peak = int(np.argmax(power[1:])) + 1
    time = step * (np.arange(samples) - 0.5 * (samples - 1))
    trials = (peak + np.linspace(-0.9, 0.9, 37)) / (samples * step)

    def left(frequency: float) -> float:
        phase = 2.0 * np.pi * frequency * time
        basis, _ = np.linalg.qr(np.stack([np.cos(phase), np.sin(phase), np.ones_like(time)], axis=1))
        return float(np.sum(((centred - (centred @ basis) @ basis.T) / scale[:, None]) ** 2))

    return float(min(trials, key=left))


def _quantisation(amplitude: NDArray[np.float64], noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard error (in steps) of an amplitude due to rounding to whole steps, beyond the part in the residual.

    The fundamental of the error of rounding a sine of `amplitude` steps is (2 / pi) J_1(2 pi amplitude), to leading
    order, of size (2 / pi) / (pi sqrt(amplitude)) at its crests and a root of two less on average; Gaussian noise of s
    steps before the converter multiplies it by exp(-2 pi^2 s^2) (Widrow and Kollar, Quantization Noise, 2008, chapters
    17 and 20). The residual holds 1/12 of a squared step of the rounding itself.
    """
    dither = np.maximum(noise**2 - 1.0 / 12.0, 0.0)
    crest = 2.0 / (np.pi**2 * np.sqrt(np.maximum(amplitude, 0.25)))
    return np.asarray(crest / math.sqrt(2.0) * np.exp(-2.0 * np.pi**2 * dither))
