"""Pole of one resonance, fitted to a spectrum.

Y = A / (f - fp) + a background that is linear in f and complex; Q = Re fp / (2 Im fp). The other modes only have to
vary slowly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.files.quantities import frequency_text
from workbench.results.brief import Brief
from workbench.results.circuit import FittedNumber, least_squares_of, residual_size
from workbench.results.merit import figures
from workbench.results.spectrum import Spectrum

#: Half-power widths to either side of the resonance in a fit without a band. Doubled, the background of neighbouring
#: modes is no longer linear.
REACH = 5.0


@dataclass(frozen=True, eq=False, repr=False)
class PoleFit(Brief):
    """A pole fitted to a spectrum.

    ``frequency`` (Hz) and ``q`` are of the pole, ``model`` is the fitted spectrum at the points of the fit,
    ``rms_residual`` the root mean square of |Z_model / Z - 1|, ``reduced_chi_square`` None without an uncertainty of
    the spectrum. Standard errors assume independent noise: of the stated uncertainty or, without one, of the same size
    in Y at every point, estimated from the residual.
    """

    frequency: FittedNumber
    q: FittedNumber
    model: Spectrum
    rms_residual: float
    reduced_chi_square: float | None


def fit_pole(
    spectrum: Spectrum, *, near: float | None = None, band: tuple[float, float] | None = None
) -> PoleFit:
    """Fit the pole of one resonance, started from :func:`~workbench.results.merit.figures`.

    The fit is over `band` (Hz), by default :data:`REACH` half-power widths to either side.

    Raises:
        NoResonance: there is none to start from.
        ValueError: too few points, or the fit did not converge.
    """
    seen = spectrum if band is None else spectrum.restricted(*band)
    start = figures(seen, near=near)
    half = 0.5 * (start.f2 - start.f1)
    if band is None:
        seen = seen.restricted(start.f0 - 2.0 * REACH * half, start.f0 + 2.0 * REACH * half)
    # Frequency from f0 in half-power half widths.
    x = (seen.frequency - start.f0) / half
    if len(x) < 5:
        raise ValueError(f"{len(x)} points about {frequency_text(start.f0)} do not determine a pole; at least "
                         "5 are needed")
    # Without an uncertainty all points of Y have equal weight, so that the peak dominates. In a relative residual the
    # points of least admittance would dominate, and with them the neighbouring modes.
    scale = np.full(len(x), start.z_min) if seen.uncertainty is None else seen.magnitude**2 / seen.uncertainty

    def columns(pole: complex) -> NDArray[np.complex128]:
        return np.column_stack([scale / (x - pole), scale + 0j, scale * x])

    def misfit(vector: NDArray[np.float64]) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        pole, *amplitudes = vector[:4] + 1j * vector[4:]
        linear = columns(pole)
        slopes = np.column_stack([amplitudes[0] * linear[:, 0] / (x - pole), linear])
        return linear @ amplitudes - scale * seen.admittance, np.hstack([slopes, 1j * slopes])

    # In e^{+j w t} a decaying mode has Im f > 0; the half-power half width is its imaginary part.
    first = np.append(1j, np.linalg.lstsq(columns(1j), scale * seen.admittance, rcond=None)[0])
    vector, covariance, _ = least_squares_of(misfit, np.append(first.real, first.imag),
                                             known=seen.uncertainty is not None)
    pole = complex(start.f0 + half * vector[0], half * vector[4])
    if pole.imag <= 0.0:
        raise ValueError(f"the fitted pole {pole:.6g} Hz does not decay: this is no passive resonance")
    # Both parts of the pole have this error, and no correlation.
    error, q = half * math.sqrt(covariance[0, 0]), pole.real / (2.0 * pole.imag)
    impedance = 1.0 / (seen.admittance + misfit(vector)[0] / scale)
    return PoleFit(FittedNumber(pole.real, error), FittedNumber(q, error * math.hypot(0.5, q) / pole.imag),
                   Spectrum(seen.frequency, impedance), *residual_size(seen, impedance, len(vector)))
