"""Quantities derived from the moduli of a solid: the rows of Table 4 of Acevedo-Espinosa et al. (RP-UEIS), with
intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from materials import conversions
from workbench.fitting.parameter import POLYMER_FOUR
from workbench.fitting.uncertainty import DEVIATIONS
from workbench.model.numbers import real_part

Real = NDArray[np.float64]

#: Relative step of the central differences; the quantities are smooth, so what it leaves out is its square.
STEP = 1e-5


@dataclass(frozen=True)
class Derived:
    """One quantity that follows from fitted ones, SI or dB/m; `low` to `high` is its 95 % interval."""

    name: str
    unit: str
    value: float
    standard_error: float
    low: float
    high: float


#: Names and units, in the order of Table 4. Quantities that no passive solid can have below zero are marked.
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
    """The quantities of :data:`QUANTITIES` from K', K'', G', G'' (Pa, e^{-i w t}), kg/m^3 and Hz."""
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
    """The quantities that follow from the moduli of an isotropic solid, with linearly propagated intervals.

    Args:
        moduli: by the names of `parameter.POLYMER_FOUR`, Pa, losses negative.
        covariance: (4, 4) Pa^2 in that order; zero rows for what was held fixed.
        density: kg/m^3, known independently of the moduli with the standard error `density_error`.
        frequency: of the absorptions, Hz.
    """
    at = np.array([moduli[name] for name in POLYMER_FOUR])
    # A loss may be zero: it is stepped by a share of its modulus.
    sizes = np.abs([at[0], at[0], at[2], at[2]])
    values = moduli_quantities(at, density, frequency)
    slopes = _slopes(lambda x: moduli_quantities(x, density, frequency), at, STEP * sizes)
    by_density = _slopes(lambda x: moduli_quantities(at, float(x[0]), frequency), np.array([density]),
                         np.array([STEP * density]))[:, 0]
    variance = np.einsum("qi,ij,qj->q", slopes, covariance, slopes) + (by_density * density_error) ** 2
    errors = np.sqrt(np.maximum(variance, 0.0))
    result = []
    for (name, (unit, positive)), value, error in zip(QUANTITIES.items(), values, errors, strict=True):
        low, high = value - DEVIATIONS * error, value + DEVIATIONS * error
        result.append(Derived(name, unit, float(value), float(error), float(max(low, 0.0) if positive else low),
                              float(high)))
    return tuple(result)


def moduli_of(
    names: Sequence[str], values: Real, covariance: Real, fixed: Mapping[str, complex], material: str
) -> tuple[dict[str, float], Real]:
    """Moduli of a material and their covariance (4, 4) out of a fit's, what was held fixed from its start.

    Args:
        names: of the fit's parameters, with `values` (p,) and `covariance` (p, p).
        fixed: complex values by full name.
    """
    full = [f"{material}.{name}" for name in POLYMER_FOUR]
    moduli, chosen = {}, np.zeros((len(full), len(names)))
    for row, (short, name) in enumerate(zip(POLYMER_FOUR, full, strict=True)):
        if name in names:
            column = list(names).index(name)
            chosen[row, column] = 1.0
            moduli[short] = float(values[column])
        else:
            moduli[short] = real_part(fixed, name)
    return moduli, chosen @ covariance @ chosen.T


def _slopes(function: Callable[[Real], Real], at: Real, steps: Real) -> Real:
    """Central differences (q, p)."""
    columns = []
    for i, step in enumerate(steps):
        shift = np.zeros(at.size)
        shift[i] = step
        columns.append((function(at + shift) - function(at - shift)) / (2.0 * step))
    return np.stack(columns, axis=1)
