"""A fixture known by its elements, from a recorded known resistor: it predicts other frequencies."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from workbench.bench.compensation import Load
from workbench.results.spectrum import Spectrum


@dataclass(frozen=True)
class Fixture:
    """A fixture known by its elements rather than point by point: the measured impedance is ``gain`` Z + j w
    ``inductance`` (henry). ``uncertainty`` of the gain and of the inductance, standard."""

    gain: complex
    inductance: float
    uncertainty: tuple[float, float]

    def remove(self, measured: Spectrum) -> Spectrum:
        """The device's spectrum without the fixture."""
        omega = 2.0 * np.pi * measured.frequency
        value = (measured.impedance - 1j * omega * self.inductance) / self.gain
        of_measured = 0.0 if measured.uncertainty is None else measured.uncertainty
        noise = np.sqrt((of_measured / abs(self.gain)) ** 2 + (omega * self.uncertainty[1] / abs(self.gain)) ** 2
                        + (np.abs(value) * self.uncertainty[0] / abs(self.gain)) ** 2)
        return Spectrum(measured.frequency, value, noise if np.all(noise > 0.0) else None, measured.origin)


def fixture_from_load(load: Load, *, band: tuple[float, float]) -> Fixture:
    """The gain and the series inductance of a fixture from a known resistor, recorded within `band` (Hz).

    It serves a recording whose load was not measured at the device's own frequencies: linear least squares over the
    points of the band, equally weighted, the uncertainties from the residual.

    Raises:
        ValueError: fewer than 4 points in the band.
    """
    inside = (load.recorded.frequency >= band[0]) & (load.recorded.frequency <= band[1])
    if np.count_nonzero(inside) < 4:
        raise ValueError(f"{np.count_nonzero(inside)} points from {band[0]:g} to {band[1]:g} Hz; at least 4 are needed")
    omega = 2.0 * np.pi * load.recorded.frequency[inside]
    z = load.recorded.impedance[inside]
    # Re Z = R Re g, Im Z = R Im g + w L; the inductance in units of its largest reactance keeps the system even.
    top = float(omega.max())
    zero, one = np.zeros_like(omega), np.ones_like(omega)
    design = np.vstack([np.column_stack([load.resistance * one, zero, zero]),
                        np.column_stack([zero, load.resistance * one, omega / top])])
    right = np.concatenate([z.real, z.imag])
    solution, *_ = np.linalg.lstsq(design, right, rcond=None)
    left = float(np.sum((right - design @ solution) ** 2)) / (len(right) - 3)
    covariance = left * np.linalg.inv(design.T @ design)
    relative = load.tolerance / math.sqrt(3.0)
    gain = complex(solution[0], solution[1])
    return Fixture(gain, float(solution[2] / top),
                   (math.hypot(math.sqrt(covariance[0, 0]), abs(gain) * relative), math.sqrt(covariance[2, 2]) / top))
