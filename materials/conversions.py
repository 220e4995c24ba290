"""Conversions of a material's constants. SI units, time factor e^{-i w t}.

A modulus M = M' + i M'' of a passive solid has M'' <= 0. The loss tangents here are positive for a passive solid, -M''
/ M', as in Table 4 of Acevedo-Espinosa et al. (RP-UEIS); its text below eq. 18 omits the sign.
"""

from __future__ import annotations

import math

from materials.loss import NEPERS_PER_DECIBEL
from workbench.files.quantities import VACUUM_PERMITTIVITY


def young_and_poisson(bulk_modulus: complex, shear_modulus: complex) -> tuple[complex, complex]:
    """Young's modulus (Pa) and Poisson's ratio from two moduli (Pa)."""
    denominator = 3 * bulk_modulus + shear_modulus
    return 9 * bulk_modulus * shear_modulus / denominator, (3 * bulk_modulus - 2 * shear_modulus) / (2 * denominator)


def bulk_and_shear(youngs_modulus: complex, poisson_ratio: complex) -> tuple[complex, complex]:
    """Bulk and shear moduli (Pa) from Young's modulus (Pa) and Poisson's ratio."""
    return youngs_modulus / (3 * (1 - 2 * poisson_ratio)), youngs_modulus / (2 * (1 + poisson_ratio))


def shear_from_longitudinal(longitudinal_modulus: complex, poisson_ratio: complex) -> complex:
    """Shear modulus (Pa) from the longitudinal modulus and Poisson's ratio. The longitudinal modulus is K + 4 G / 3
    (Pa)."""
    return longitudinal_modulus * (1 - 2 * poisson_ratio) / (2 * (1 - poisson_ratio))


def wave_modulus(speed: complex, *, density: float) -> complex:
    """The modulus (Pa) of a wave from its complex speed (m/s).

    The real part of `speed` is the phase speed w / Re k. The imaginary part is the loss: the modulus is rho (w / k)^2
    with w / k = v^2 / conj(speed) for the phase speed v (see :mod:`materials.loss`).
    """
    phase = complex(speed).real
    return density * (phase**2 / complex(speed).conjugate()) ** 2 if complex(speed).imag else density * speed**2


def wave_speeds(bulk_modulus: complex, shear_modulus: complex, *, density: float) -> tuple[float, float]:
    """Longitudinal and shear wave speeds (m/s) for weak absorption. Eq. 18a of the RP-UEIS paper."""
    longitudinal = complex(bulk_modulus + 4 * shear_modulus / 3)
    return math.sqrt(longitudinal.real / density), math.sqrt(complex(shear_modulus).real / density)


def loss_tangents(bulk_modulus: complex, shear_modulus: complex) -> tuple[float, float]:
    """Loss tangents of longitudinal and shear waves, positive for a passive solid."""
    longitudinal, shear = complex(bulk_modulus + 4 * shear_modulus / 3), complex(shear_modulus)
    return -longitudinal.imag / longitudinal.real, -shear.imag / shear.real


def attenuations(
    bulk_modulus: complex, shear_modulus: complex, *, density: float, frequency: float
) -> tuple[float, float]:
    """Attenuations (Np/m) of longitudinal and shear waves, for weak absorption.

    alpha = (k' / 2) tan delta, at `frequency` (Hz). Eq. 18b of the RP-UEIS paper prints k'' in place of k', but its
    Table 4 was computed with k' (the wavenumber w / c), which is also the weak-absorption expansion of k.
    """
    omega = 2 * math.pi * frequency
    speeds = wave_speeds(bulk_modulus, shear_modulus, density=density)
    tangents = loss_tangents(bulk_modulus, shear_modulus)
    return omega / speeds[0] * tangents[0] / 2, omega / speeds[1] * tangents[1] / 2


def decibels_per_metre(nepers_per_metre: float) -> float:
    """An absorption in dB/m from one in Np/m."""
    return nepers_per_metre / NEPERS_PER_DECIBEL


def nepers_per_metre(decibels_per_metre: float) -> float:
    """An absorption in Np/m from one in dB/m."""
    return decibels_per_metre * NEPERS_PER_DECIBEL


def _inverted(
    matrix: tuple[complex, ...], rows: tuple[complex, ...]
) -> tuple[tuple[complex, ...], tuple[complex, ...]]:
    """Inverse of a 6mm matrix, and products of rows with it. The matrix has the entries (11, 12, 13, 33, 44), the rows
    (31, 33, 15)."""
    (a11, a12, a13, a33, a44), (r31, r33, r15) = matrix, rows
    determinant = (a11 + a12) * a33 - 2 * a13**2
    b33, b13 = (a11 + a12) / determinant, -a13 / determinant
    plane_sum, plane_difference = a33 / determinant, 1 / (a11 - a12)
    b11, b12, b44 = (plane_sum + plane_difference) / 2, (plane_sum - plane_difference) / 2, 1 / a44
    return ((b11, b12, b13, b33, b44),
            (r31 * plane_sum + r33 * b13, 2 * r31 * b13 + r33 * b33, r15 * b44))


def stress_charge(
    *,
    s11: complex,
    s12: complex,
    s13: complex,
    s33: complex,
    s44: complex,
    d31: complex,
    d33: complex,
    d15: complex,
    free_eps11: complex,
    free_eps33: complex,
) -> dict[str, complex]:
    """Stress-charge constants of a ceramic from the strain-charge constants of data sheets.

    Args are the compliances at constant field (1/Pa), charge constants (C/N = m/V) and relative permittivities at
    constant stress. Returns c11 c12 c13 c33 c44 (Pa), e31 e33 e15 (C/m^2) and eps11 eps33 (relative, constant strain):
    c = s^-1, e = d c, eps = eps^T - d e^t.
    """
    (c11, c12, c13, c33, c44), (e31, e33, e15) = _inverted((s11, s12, s13, s33, s44), (d31, d33, d15))
    return {
        "c11": c11, "c12": c12, "c13": c13, "c33": c33, "c44": c44, "e31": e31, "e33": e33, "e15": e15,
        "eps11": free_eps11 - d15 * e15 / VACUUM_PERMITTIVITY,
        "eps33": free_eps33 - (2 * d31 * e31 + d33 * e33) / VACUUM_PERMITTIVITY,
    }  # fmt: skip


def strain_charge(
    *,
    c11: complex,
    c12: complex,
    c13: complex,
    c33: complex,
    c44: complex,
    e31: complex,
    e33: complex,
    e15: complex,
    eps11: complex,
    eps33: complex,
) -> dict[str, complex]:
    """Strain-charge constants of a poled ceramic from its stress-charge constants. The inverse of
    :func:`stress_charge`: s = c^-1, d = e s, eps^T = eps + d e^t."""
    (s11, s12, s13, s33, s44), (d31, d33, d15) = _inverted((c11, c12, c13, c33, c44), (e31, e33, e15))
    return {
        "s11": s11, "s12": s12, "s13": s13, "s33": s33, "s44": s44, "d31": d31, "d33": d33, "d15": d15,
        "free_eps11": eps11 + d15 * e15 / VACUUM_PERMITTIVITY,
        "free_eps33": eps33 + (2 * d31 * e31 + d33 * e33) / VACUUM_PERMITTIVITY,
    }  # fmt: skip
