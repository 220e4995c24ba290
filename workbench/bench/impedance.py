"""From two voltages and a resistor to an impedance, with random and common uncertainty kept apart.

Eq. (25) of Acevedo-Espinosa et al. (RP-UEIS), Z = R dV / dV_R, with the device's voltage taken as the difference of the
two channels, dV = V - V_R: the resistor's own voltage is a quarter of the whole at a resonance of 2 ohm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from workbench.bench.sine_fit import SineFit


@dataclass(frozen=True)
class PointImpedance:
    """An impedance ``value`` (ohm), e^{+j w t}, with its random uncertainty.

    ``random`` (ohm) is the standard uncertainty from noise, of the real and of the imaginary part, each; ``scatter``
    the root of the reduced chi-square of the captures against their own uncertainties, or nan for one capture.
    """

    value: complex
    random: float
    scatter: float


def impedance(fits: Sequence[SineFit], resistance: float, *, probe: bool = False) -> PointImpedance:
    """The mean impedance (ohm) of several captures.

    In every fit the first amplitude is across device and resistor, the second across the resistor of so many ohm. With
    a current `probe` the first is across the device, the second is its current in units of 1 V / `resistance`. Raises
    ValueError without captures, or if the reference channel holds no signal at all.
    """
    if not fits:
        raise ValueError("no captures to take an impedance from")
    total, reference = (np.array([fit.amplitude[k] for fit in fits]) for k in (0, 1))
    if np.any(reference == 0.0):
        raise ValueError("the voltage across the reference resistor is zero")
    of_total, of_reference = (np.array([fit.uncertainty[k] for fit in fits]) for k in (0, 1))
    values = resistance * (total - (0.0 if probe else 1.0) * reference) / reference
    # dZ = (R / V_R) dV - (R V / V_R^2) dV_R; both are analytic, so real and imaginary part have equal uncertainties.
    single = resistance / np.abs(reference) * np.hypot(of_total, np.abs(total / reference) * of_reference)
    # The plain mean, not one weighted by its own uncertainties: captures of one point are equals.
    mean = complex(np.mean(values))
    expected = float(np.sqrt(np.mean(single**2)))
    captures = len(fits)
    if captures == 1:
        return PointImpedance(mean, expected, math.nan)
    spread = float(np.sqrt(np.sum(np.abs(values - mean) ** 2) / (2.0 * (captures - 1))))
    # Scatter beyond the noise of the records (hum, a contact, drift) counts in full. Chance exceeds the limit once in a
    # thousand times, so it seldom enlarges the uncertainty.
    freedom = 2 * (captures - 1)
    limit = float(chdtri(freedom, 1e-3)) / freedom
    excessive = (spread / expected) ** 2 > limit if expected > 0.0 else spread > 0.0
    return PointImpedance(mean, (spread if excessive else expected) / math.sqrt(captures),
                          spread / expected if expected > 0.0 else math.inf)


def common_uncertainty(tolerance: float, gain_accuracy: float) -> float:
    """Relative standard uncertainty that all points share: of the resistor, and of the ratio of two channels' gains.

    Both are limits, taken as uniform between them (JCGM 100:2008, 4.3.7).
    """
    return math.hypot(tolerance, math.sqrt(2.0) * gain_accuracy) / math.sqrt(3.0)
