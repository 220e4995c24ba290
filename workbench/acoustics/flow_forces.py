"""Steady forces of sound and gravity on a liquid.

::

    f = -1/4 |p|^2 grad kappa - 1/4 |v|^2 grad rho + (rho - rho0) g          in a liquid of nonuniform temperature
        + (w^2 D / c^4) <p v>                                                in an absorbing liquid (Eckart)

The first line is Karlsen, Augustsson and Bruus, Phys. Rev. Lett. 117, 114504 (2016), with kappa = 1/(rho c^2) and rho
linear in the temperature (Joergensen and Bruus, J. Acoust. Soc. Am. 149, 3599, 2021). D is the diffusivity of sound;
the second line is 2 alpha I / c with the absorption alpha = w^2 D / (2 c^3) and the intensity I. Gradients of
potentials are omitted: the pressure balances them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workbench.acoustics.nodal import FloatArray, NodalArray
from workbench.model.particles import GRAVITY, FluidProperties, compressibility


@dataclass(frozen=True, kw_only=True)
class TemperatureSlopes:
    """Temperature slopes of density, kg/(m^3 K), and sound speed, m/(s K)."""

    density: float
    sound_speed: float


def thermoacoustic_force(
    fluid: FluidProperties, slopes: TemperatureSlopes, *, pressure: NodalArray, velocity: NodalArray,
    temperature: FloatArray, temperature_gradient: FloatArray, gravity: float = GRAVITY,
) -> FloatArray:
    """Force (N, 2) in N/m^3 on a liquid of nonuniform temperature.

    `temperature` (N,) in K above ambient, with its gradient (N, 2) in K/m. `pressure` (N,) Pa and `velocity` (N, 2) m/s
    are complex amplitudes. Gravity acts along -z.
    """
    relative = slopes.density / fluid.density + 2.0 * slopes.sound_speed / fluid.sound_speed
    from_pressure = 0.25 * np.abs(pressure) ** 2 * compressibility(fluid) * relative
    from_velocity = -0.25 * (np.abs(velocity) ** 2).sum(axis=1) * slopes.density
    force: FloatArray = (from_pressure + from_velocity)[:, None] * temperature_gradient
    force[:, 1] -= slopes.density * temperature * gravity
    return force


def absorption_force(
    fluid: FluidProperties, diffusivity: float, frequency: float, *, pressure: NodalArray, velocity: NodalArray
) -> FloatArray:
    """Force (N, 2) in N/m^3 on an absorbing liquid. It takes momentum from the wave; the `diffusivity` of sound is in
    m^2/s."""
    intensity = 0.5 * np.real(np.conj(pressure)[:, None] * velocity)
    strength = (2.0 * np.pi * frequency) ** 2 * diffusivity / fluid.sound_speed**4
    return np.asarray(strength * intensity)
