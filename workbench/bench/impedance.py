"""Impedance from two voltages and a resistor, with its uncertainty.

Eq. (25) of Acevedo-Espinosa et al. (RP-UEIS), Z = R dV / dV_R. The device's voltage is the difference of the two
channels, dV = V - V_R: the resistor's own voltage is a quarter of the whole at a resonance of 2 ohm. Random and common
uncertainty are separate.
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

    ``random`` (ohm) is the standard uncertainty from noise, of the real and of the imaginary part, each; ``scatter`` is
    the root of the reduced chi-square of the captures against their own uncertainties, or nan for one capture.
    """

    value: complex
    random: float
    scatter: float


def impedance(fits: Sequence[SineFit], resistance: float, *, probe: bool = False) -> PointImpedance:
    """The mean impedance (ohm) of several captures.

    In every fit the first amplitude is across device and resistor, the second across the resistor of `resistance` ohm.
    With a current `probe` the first is across the device, and the second is its current in units of 1 V / `resistance`.

    Raises:
        ValueError: no captures, or a reference channel without any signal.
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
    # The unweighted mean, since captures of one point have equal uncertainties.
    mean = complex(np.mean(values))
    expected = float(np.sqrt(np.mean(single**2)))
    captures = len(fits)
    if captures == 1:
        return PointImpedance(mean, expected, math.nan)
    spread = float(np.sqrt(np.sum(np.abs(values - mean) ** 2) / (2.0 * (captures - 1))))
    # Scatter beyond the noise of the records (hum, a contact, drift) replaces it. Noise exceeds the limit with a
    # probability of 1e-3, so it seldom enlarges the uncertainty.
    freedom = 2 * (captures - 1)
    limit = float(chdtri(freedom, 1e-3)) / freedom
    excessive = (spread / expected) ** 2 > limit if expected > 0.0 else spread > 0.0
    return PointImpedance(mean, (spread if excessive else expected) / math.sqrt(captures),
                          spread / expected if expected > 0.0 else math.inf)


def common_uncertainty(tolerance: float, gain_accuracy: float) -> float:
    """Relative standard uncertainty that all points share. It is of the resistor, and of the ratio of two channels'
    gains. Both are limits of uniform laws (JCGM 100:2008, 4.3.7)."""
    return math.hypot(tolerance, math.sqrt(2.0) * gain_accuracy) / math.sqrt(3.0)
