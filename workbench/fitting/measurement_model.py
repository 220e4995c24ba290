"""The measurement model: the impedance that an instrument sees through its bench, and the comparison of spectra,
smoothed and by the logarithm of a ratio."""

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


def through_bench(
    impedance: Complex, omega: Real, bench: Mapping[str, float], slope: Callable[[], Complex] | None = None
) -> tuple[Complex, Complex, dict[str, Complex]]:
    """The impedance that an instrument sees of a device (n,), e^{+j w t}, through the elements named in `bench`.

    Where a clock is off, `impedance` is that of the device at the frequencies that the generator really makes.

    Args:
        slope: d ln Z / d ln f (n,) of the impedance, asked for where the clock is named.

    Returns:
        the impedance seen (n,), d ln seen / d ln impedance (n,), of the impedance at the generator's frequency, and
        d ln seen / d element (n,) for every element; for the clock only where it is named and a slope given.
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
    """Weights (n, n), rows of sum one, that smooth with a Lorentzian of that half width (Hz) on any grid."""
    spacing = np.gradient(frequency)
    weights = spacing[None, :] / ((frequency[:, None] - frequency[None, :]) ** 2 + half_width**2)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))
