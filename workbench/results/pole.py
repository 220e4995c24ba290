"""Pole of one resonance, fitted to a spectrum.

Y = A / (f - fp) + a background that is linear in f and complex; Q = Re fp / (2 Im fp). The other modes only have to
vary slowly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.results.brief import Brief
from workbench.results.circuit import FittedNumber, covariance_of, least_squares_of, residual_size
from workbench.results.merit import Figures, figures
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
    if band is None:
        reach = REACH * (start.f2 - start.f1)
        seen = seen.restricted(start.f0 - reach, start.f0 + reach)
    return _fit(seen, start)


def _fit(spectrum: Spectrum, start: Figures) -> PoleFit:
    """Fit the pole p of Y = A/(x-p) + b + cx. x is the frequency from f0 in half-power half widths."""
    half = 0.5 * (start.f2 - start.f1)
    x = (spectrum.frequency - start.f0) / half
    measured = spectrum.admittance
    # Without an uncertainty all points of Y have equal weight, so that the peak dominates. In a relative residual the
    # points of least admittance would dominate, and with them the neighbouring modes.
    if spectrum.uncertainty is None:
        scale = np.full(len(x), start.z_min)
    else:
        scale = spectrum.magnitude**2 / spectrum.uncertainty

    def basis(pole: complex) -> NDArray[np.complex128]:
        return np.column_stack([1.0 / (x - pole), np.ones_like(x), x])

    def admittance(vector: NDArray[np.float64]) -> NDArray[np.complex128]:
        return np.asarray(basis(complex(vector[0], vector[1])) @ (vector[2::2] + 1j * vector[3::2]))

    def residual(vector: NDArray[np.float64]) -> NDArray[np.float64]:
        error = admittance(vector) - measured
        return np.concatenate([scale * error.real, scale * error.imag])

    def jacobian(vector: NDArray[np.float64]) -> NDArray[np.float64]:
        pole = complex(vector[0], vector[1])
        by_pole = complex(vector[2], vector[3]) / (x - pole) ** 2
        linear = basis(pole)
        columns = [by_pole, 1j * by_pole]
        for column in linear.T:
            columns += [column, 1j * column]
        slope = scale[:, None] * np.column_stack(columns)
        return np.vstack([slope.real, slope.imag])

    if len(x) < 5:
        raise ValueError(f"{len(x)} points about {start.f0:.9g} Hz do not determine a pole; at least 5 are needed")
    # In e^{+j w t} a decaying mode has Im f > 0; the half-power half width is its imaginary part.
    amplitudes = np.linalg.lstsq(scale[:, None] * basis(1j), scale * measured, rcond=None)[0]
    linear = np.column_stack([amplitudes.real, amplitudes.imag]).ravel()
    vector, found, squares = least_squares_of(residual, jacobian, np.array([0.0, 1.0, *linear]))
    covariance = covariance_of(found, squares, known=spectrum.uncertainty is not None)[:2, :2] * half**2
    pole = complex(start.f0 + half * vector[0], half * vector[1])
    if pole.imag <= 0.0:
        raise ValueError(f"the fitted pole {pole:.6g} Hz does not decay: this is no passive resonance")
    q = pole.real / (2.0 * pole.imag)
    slope = np.array([0.5 / pole.imag, -q / pole.imag])
    impedance = 1.0 / admittance(vector)
    return PoleFit(FittedNumber(pole.real, math.sqrt(covariance[0, 0])),
                   FittedNumber(q, math.sqrt(slope @ covariance @ slope)), Spectrum(spectrum.frequency, impedance),
                   *residual_size(spectrum, impedance, len(vector)))
