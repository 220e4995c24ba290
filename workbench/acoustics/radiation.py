"""Effect of sound on a particle: energy density, Gor'kov potential, radiation force.

Formulas and time factor are those of `workbench.model.particles`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.acoustics.nodal import FloatArray
from workbench.model.particles import FluidProperties, Particle, Scattering, compressibility


def acoustic_energy_density(pressure_amplitude: float, fluid: FluidProperties) -> float:
    """Mean energy density (J/m^3) of a standing wave of an amplitude (Pa). It is p0^2/(4 rho c^2), the mean over time
    and space."""
    return pressure_amplitude**2 * compressibility(fluid) / 4.0


def gorkov_potential(
    particle: Particle,
    fluid: FluidProperties,
    *,
    scattering: Scattering,
    pressure: NDArray[Any],
    velocity: NDArray[Any],
) -> FloatArray:
    """Gor'kov potential (J) of a particle. U = V [ (f1/2) kappa <p^2> - (3/4) Re f2 rho <v^2> ]. `pressure` (...) in Pa
    and `velocity` (..., d) in m/s are complex amplitudes, so <p^2> = |p|^2/2."""
    mean_pressure = np.abs(pressure) ** 2 / 2.0
    mean_velocity = (np.abs(velocity) ** 2).sum(axis=-1) / 2.0
    potential: FloatArray = particle.volume * (
        scattering.monopole / 2.0 * compressibility(fluid) * mean_pressure
        - 0.75 * complex(scattering.dipole).real * fluid.density * mean_velocity
    )
    return potential


def radiation_force(
    particle: Particle,
    fluid: FluidProperties,
    *,
    scattering: Scattering,
    pressure: NDArray[Any],
    pressure_gradient: NDArray[Any],
    velocity: NDArray[Any],
    velocity_gradient: NDArray[Any],
) -> FloatArray:
    """Time-averaged radiation force (..., d) in N (Settnes & Bruus 2012).

    It includes standing and travelling parts:

        F = -pi a^3 [ (2 kappa/3) Re(f1* p* grad p) - rho Re(f2* (v* . grad) v) ]

    Complex amplitudes: `pressure` (...) Pa, `pressure_gradient` (..., d) Pa/m, `velocity` (..., d) m/s and
    `velocity_gradient` (..., d, d) 1/s, the direction of differentiation before the component. The force is -grad U in
    a standing wave; in a travelling one the imaginary part of f2 pushes the particle along.
    """
    from_pressure = np.real(scattering.monopole * np.conj(pressure)[..., None] * pressure_gradient)
    convected = np.einsum("...j,...ji->...i", np.conj(velocity), velocity_gradient)
    from_velocity = np.real(np.conj(scattering.dipole) * convected)
    force: FloatArray = -math.pi * particle.radius**3 * (
        2.0 / 3.0 * compressibility(fluid) * from_pressure - fluid.density * from_velocity
    )
    return force
