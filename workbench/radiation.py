"""What sound does to a particle: Gor'kov potential, radiation force, and both in a plane standing wave.

Formulas and time factor as in `workbench.particles`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.nodal import FloatArray
from workbench.particles import (
    FluidProperties,
    Particle,
    Scattering,
    boundary_layer_thickness,
    compressibility,
    viscosity,
)


def acoustic_energy_density(pressure_amplitude: float, fluid: FluidProperties) -> float:
    """Energy density (J/m^3), mean over time and space, of a standing wave of that amplitude (Pa): p0^2/(4 rho c^2)."""
    return pressure_amplitude**2 * compressibility(fluid) / 4.0


def gorkov_potential(
    particle: Particle,
    fluid: FluidProperties,
    *,
    scattering: Scattering,
    pressure: NDArray[Any],
    velocity: NDArray[Any],
) -> FloatArray:
    """U = V [ (f1/2) kappa <p^2> - (3/4) Re f2 rho <v^2> ] in J.

    `pressure` (...) in Pa and `velocity` (..., d) in m/s are complex amplitudes, so <p^2> = |p|^2/2.
    """
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
    """Time-averaged radiation force (..., d) in N, standing and travelling parts (Settnes & Bruus 2012).

        F = -pi a^3 [ (2 kappa/3) Re(f1* p* grad p) - rho Re(f2* (v* . grad) v) ]

    Complex amplitudes: `pressure` (...) Pa, `pressure_gradient` (..., d) Pa/m, `velocity` (..., d) m/s and
    `velocity_gradient` (..., d, d) 1/s, the direction of differentiation before the component. It is -grad U for a
    standing wave; in a travelling one the imaginary part of f2 pushes the particle along.
    """
    from_pressure = np.real(scattering.monopole * np.conj(pressure)[..., None] * pressure_gradient)
    convected = np.einsum("...j,...ji->...i", np.conj(velocity), velocity_gradient)
    from_velocity = np.real(np.conj(scattering.dipole) * convected)
    force: FloatArray = -math.pi * particle.radius**3 * (
        2.0 / 3.0 * compressibility(fluid) * from_pressure - fluid.density * from_velocity
    )
    return force


def standing_wave_force(
    particle: Particle,
    fluid: FluidProperties,
    *,
    scattering: Scattering,
    frequency: float,
    energy_density: float,
    position: float,
) -> float:
    """Force (N) along z in p = p0 cos(k z), at `position` z (m): 4 pi Phi k a^3 E_ac sin(2 k z)."""
    wavenumber = 2.0 * math.pi * frequency / fluid.sound_speed
    peak = 4.0 * math.pi * scattering.contrast_factor * wavenumber * particle.radius**3 * energy_density
    return peak * math.sin(2.0 * wavenumber * position)


def standing_wave_focus_time(
    particle: Particle,
    fluid: FluidProperties,
    *,
    scattering: Scattering,
    frequency: float,
    energy_density: float,
    start: float,
    stop: float,
) -> float:
    """Time (s) from `start` to `stop` (m from the pressure antinode) in a plane standing wave, against Stokes drag.

    t = 3 eta / (4 Phi (k a)^2 E_ac) ln[ tan(k stop) / tan(k start) ].

    Raises:
        ValueError: the force does not carry the particle from `start` to `stop` within one quarter wavelength.
    """
    wavenumber = 2.0 * math.pi * frequency / fluid.sound_speed
    quarter = math.pi / 2.0 / wavenumber
    contrast = scattering.contrast_factor
    if not (0.0 < start < quarter and 0.0 < stop < quarter) or (stop - start) * contrast <= 0.0:
        raise ValueError(
            f"from {start} m to {stop} m with contrast factor {contrast:.4g}; expected two places between 0 and a "
            f"quarter wavelength, {quarter:.4g} m, in the direction of the force"
        )
    prefactor = 3.0 * viscosity(fluid) / (4.0 * contrast * (wavenumber * particle.radius) ** 2 * energy_density)
    return prefactor * math.log(math.tan(wavenumber * stop) / math.tan(wavenumber * start))


def rayleigh_streaming_speed(fluid: FluidProperties, energy_density: float) -> float:
    """Largest speed (m/s) of the streaming a standing wave drives along a plane wall: (3/8) v0^2 / c (Rayleigh 1884).

    v0 is the velocity amplitude of the wave, E_ac = rho v0^2 / 4.
    """
    return 3.0 / 8.0 * 4.0 * energy_density / fluid.density / fluid.sound_speed


def crossover_radius(fluid: FluidProperties, *, frequency: float, contrast_factor: float) -> float:
    """Radius (m) below which Rayleigh streaming drags a particle faster than radiation force: delta sqrt(9/(8 Phi))."""
    return boundary_layer_thickness(fluid, frequency) * math.sqrt(3.0 * 3.0 / 8.0 / abs(contrast_factor))
