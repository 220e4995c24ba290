"""Quantities derived from the moduli of a solid, with intervals. They are the rows of Table 4 of Acevedo-Espinosa et
al. (RP-UEIS)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from materials import conversions
from workbench.fitting.parameter import POLYMER_FOUR
from workbench.fitting.uncertainty import DEVIATIONS
from workbench.model.numbers import real_part

Real = NDArray[np.float64]

#: Relative step of the central differences; the quantities are smooth, so what it leaves out is its square.
STEP = 1e-5


@dataclass(frozen=True)
class Derived:
    """A derived quantity, SI or dB/m, with its 95 % interval."""

    name: str
    unit: str
    value: float
    standard_error: float
    low: float
    high: float


#: Units, in the order of Table 4, and whether no passive solid can have the quantity below zero.
QUANTITIES: Mapping[str, tuple[str, bool]] = {
    "Young's modulus": ("Pa", True),
    "Young's modulus, loss": ("Pa", False),
    "Poisson's ratio": ("1", False),
    "Poisson's ratio, loss": ("1", False),
    "longitudinal speed": ("m/s", True),
    "shear speed": ("m/s", True),
    "longitudinal loss tangent": ("1", True),
    "shear loss tangent": ("1", True),
    "longitudinal absorption": ("dB/m", True),
    "shear absorption": ("dB/m", True),
}


def moduli_quantities(moduli: Real, density: float, frequency: float) -> Real:
    """:data:`QUANTITIES` from K', K'', G', G'' (Pa), density (kg/m^3) and frequency (Hz)."""
    bulk, shear = complex(moduli[0], moduli[1]), complex(moduli[2], moduli[3])
    young, poisson = conversions.young_and_poisson(bulk, shear)
    decibels = [conversions.decibels_per_metre(alpha) for alpha in
                conversions.attenuations(bulk, shear, density=density, frequency=frequency)]
    return np.array([young.real, young.imag, poisson.real, poisson.imag,
                     *conversions.wave_speeds(bulk, shear, density=density), *conversions.loss_tangents(bulk, shear),
                     *decibels])


def derived_moduli(
    moduli: Mapping[str, float], covariance: Real, *, density: float, frequency: float, density_error: float = 0.0
) -> tuple[Derived, ...]:
    """The derived quantities of an isotropic solid, with linearly propagated intervals.

    Args:
        moduli: by the names of `parameter.POLYMER_FOUR`, Pa, losses negative.
        covariance: (4, 4) Pa^2 in that order; zero rows for fixed moduli.
        density: kg/m^3, known independently of the moduli with the standard error `density_error`.
        frequency: of the absorptions, Hz.
    """
    def quantities(x: Real) -> Real:
        return moduli_quantities(x[:4], float(x[4]), frequency)

    at = np.array([*(moduli[name] for name in POLYMER_FOUR), density])
    # A loss may be zero: it is stepped by a share of its modulus.
    steps = STEP * np.abs(at[[0, 0, 2, 2, 4]])
    changes = [quantities(at + step) - quantities(at - step) for step in np.diag(steps)]
    slopes = np.stack(changes, axis=1) / (2.0 * steps)
    variances = np.einsum("qi,ij,qj->q", slopes, block_diag(covariance, density_error**2), slopes)
    result = []
    for (name, (unit, positive)), value, error in zip(
            QUANTITIES.items(), quantities(at).tolist(), np.sqrt(np.maximum(variances, 0.0)).tolist(), strict=True):
        low = value - DEVIATIONS * error
        result.append(Derived(name, unit, value, error, max(low, 0.0) if positive else low, value + DEVIATIONS * error))
    return tuple(result)


def moduli_of(
    names: Sequence[str], values: Real, covariance: Real, fixed: Mapping[str, complex], material: str
) -> tuple[dict[str, float], Real]:
    """Moduli of a material and their covariance (4, 4), from a fit. The `fixed` ones, by full name, have none.

    Args:
        names: of the fit's parameters, with `values` (p,) and `covariance` (p, p).
    """
    full = [f"{material}.{name}" for name in POLYMER_FOUR]
    chosen = np.array([[float(name == other) for other in names] for name in full])
    free = dict(zip(names, values.tolist(), strict=True))
    moduli = [free[name] if name in free else real_part(fixed, name) for name in full]
    return dict(zip(POLYMER_FOUR, moduli, strict=True)), chosen @ covariance @ chosen.T
