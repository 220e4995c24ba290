"""Impedance through a bench, log ratios of spectra, and their smoothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from workbench.model.numbers import BENCH

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


#: The clock of the generator, which makes (1 + clock) f of a frequency f.
CLOCK = BENCH + "clock"


def log_ratio(model: Complex, measured: Complex) -> Complex:
    """ln(model / measured) (n,), the phase as its principal value."""
    ratio = model / measured
    return np.asarray(np.log(np.abs(ratio)) + 1j * np.angle(ratio))


def rms(log_ratio: Complex) -> float:
    """The rms of |ln(model / measured)| (n,)."""
    return float(np.sqrt(np.mean(np.abs(log_ratio) ** 2)))


def through_bench(
    impedance: Complex, omega: Real, bench: Mapping[str, float], slope: Callable[[], Complex] | None = None
) -> tuple[Complex, Complex, dict[str, Complex]]:
    """The impedance (n,) that an instrument measures through its `bench`.

    The convention is e^{+j w t}. With a clock error, `impedance` is at the actual frequencies of the generator.

    Args:
        slope: d ln Z / d ln f (n,) of the impedance, called where the clock is named.

    Returns:
        the impedance seen (n,), d ln seen / d ln impedance (n,), and d ln seen / d element (n,) for every element; for
        the clock only where it is named and a slope given.
    """
    def element(name: str) -> float:
        return bench.get(BENCH + name, 0.0)

    parallel = impedance / (1.0 + 1j * omega * element("parallel_capacitance") * impedance)
    whole = element("series_resistance") + 1j * omega * element("series_inductance") + parallel
    gain = np.exp(element("gain") + 1j * (element("phase") - omega * element("delay")))
    one = np.ones(impedance.size, dtype=complex)
    slopes = {
        "series_resistance": 1.0 / whole,
        "series_inductance": 1j * omega / whole,
        "parallel_capacitance": -1j * omega * parallel**2 / whole,
        "gain": one,
        "phase": 1j * one,
        "delay": -1j * omega,
    }
    device = parallel**2 / (impedance * whole)
    if slope is not None and CLOCK in bench:
        slopes["clock"] = device * slope() / (1.0 + bench[CLOCK])
    return gain * whole, device, {BENCH + name: slope for name, slope in slopes.items()}


def lorentzian(frequency: Real, half_width: float) -> Real:
    """Weights (n, n) that smooth with a Lorentzian on any grid. `half_width` is in Hz; rows have the sum one."""
    spacing = np.gradient(frequency)
    weights = spacing[None, :] / ((frequency[:, None] - frequency[None, :]) ** 2 + half_width**2)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))
