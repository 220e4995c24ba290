"""A particle in a fluid: contrast factor, drag and weight.

A particle is a compressible sphere much smaller than the wavelength, alone and away from walls: a bead, a droplet, a
cell. The formulas use its density and compressibility. They are those of Settnes & Bruus, Phys. Rev. E 85, 016327
(2012), and without viscosity of Gor'kov (1962), which for a sphere of fluid are those of Yosioka & Kawasima (1955);
time factor e^{-i w t}. The surrounding fluid is viscous. The surface of a droplet is immobile, like one with
surfactant: circulation inside a clean droplet is neglected in the dipole and in the drag (which it lowers by a third at
most).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

#: Standard gravity, m/s^2; it acts along -z.
GRAVITY = 9.80665


class FluidProperties(Protocol):
    """Interface of a fluid: density kg/m^3, sound speed m/s, viscosity Pa s."""

    @property
    def density(self) -> float: ...
    @property
    def sound_speed(self) -> float: ...
    @property
    def shear_viscosity(self) -> float | None: ...


#: Share of the breathing frequency of a sphere up to which its compression is static: at this share the monopole is
#: larger by its square, a tenth. Doubled, by two thirds.
STIFF = 0.3


class ParticleMaterial(Protocol):
    """Interface of a particle's material: name, density kg/m^3, compressibility 1/Pa."""

    @property
    def name(self) -> str: ...
    @property
    def density(self) -> float: ...
    @property
    def compressibility(self) -> float: ...


@dataclass(frozen=True, kw_only=True)
class Particle:
    """A sphere: name, radius m, density kg/m^3, compressibility 1/Pa.

    The compressibility is one over the *bulk* modulus.

    Raises:
        ValueError: a radius or density that is not positive, or a negative compressibility.
    """

    name: str
    radius: float
    density: float
    compressibility: float

    def __post_init__(self) -> None:
        for label, value in (("radius", self.radius), ("density", self.density)):
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"particle {self.name!r}: {label} is {value}; expected a positive number")
        if not (math.isfinite(self.compressibility) and self.compressibility >= 0.0):
            raise ValueError(f"particle {self.name!r}: compressibility is {self.compressibility}; expected 0 or more")

    @property
    def volume(self) -> float:
        """Volume in m^3."""
        return 4.0 / 3.0 * math.pi * self.radius**3


@dataclass(frozen=True)
class Scattering:
    """Response of a small sphere: monopole coefficient f1, dipole coefficient f2. f1 belongs to the pressure, f2 to the
    velocity. Both are dimensionless. Viscosity makes f2 complex; with e^{-i w t} a passive particle has Im f2 >= 0."""

    monopole: float
    dipole: complex

    @property
    def contrast_factor(self) -> float:
        """Contrast factor f1/3 + Re f2/2: positive for particles at pressure nodes."""
        return self.monopole / 3.0 + complex(self.dipole).real / 2.0


def particle_from(material: ParticleMaterial, radius: float) -> Particle:
    """A sphere of `radius` (m) of a `material` of the registry."""
    return Particle(
        name=material.name, radius=radius, density=material.density, compressibility=material.compressibility
    )


def compressibility(fluid: FluidProperties) -> float:
    """Compressibility (1/Pa) of the fluid: 1 / (rho c^2)."""
    return 1.0 / (fluid.density * fluid.sound_speed**2)


def viscosity(fluid: FluidProperties) -> float:
    """Shear viscosity (Pa s) of the fluid.

    Raises:
        ValueError: the fluid has none.
    """
    if fluid.shear_viscosity is None or not fluid.shear_viscosity > 0.0:
        raise ValueError(f"shear viscosity of {fluid} is {fluid.shear_viscosity}; expected a positive number")
    return fluid.shear_viscosity


def boundary_layer_thickness(fluid: FluidProperties, frequency: float) -> float:
    """Thickness (m) of the viscous boundary layer, sqrt(2 eta / (rho w))."""
    return math.sqrt(2.0 * viscosity(fluid) / (fluid.density * 2.0 * math.pi * frequency))


def monopole(particle: Particle, fluid: FluidProperties) -> float:
    """Monopole coefficient 1 - kappa_p / kappa_f (Settnes & Bruus 2012)."""
    return 1.0 - particle.compressibility / compressibility(fluid)


def viscous_dipole(particle: Particle, fluid: FluidProperties, frequency: float) -> complex:
    """Dipole coefficient f2 (Settnes & Bruus 2012). f2 = 2 (1 - g)(r - 1) / (2 r + 1 - 3 g) with g = -(3/2) [1 + i (1 +
    d)] d, d = delta / a, and r the ratio of densities."""
    ratio = particle.density / fluid.density
    layer = boundary_layer_thickness(fluid, frequency) / particle.radius
    drag = -1.5 * (1.0 + 1j * (1.0 + layer)) * layer
    return 2.0 * (1.0 - drag) * (ratio - 1.0) / (2.0 * ratio + 1.0 - 3.0 * drag)


def viscous_scattering(particle: Particle, fluid: FluidProperties, frequency: float) -> Scattering:
    """Coefficients of a sphere in a viscous fluid, for any boundary layer."""
    return Scattering(monopole(particle, fluid), viscous_dipole(particle, fluid, frequency))


def breathing_frequency(particle: Particle, fluid: FluidProperties) -> float:
    """Frequency (Hz) at which a sphere of fluid pulsates in another fluid. It is sqrt(3 / (rho_f kappa_p)) / (2 pi a),
    Minnaert's frequency for a gas bubble; infinite for an incompressible particle."""
    if particle.compressibility == 0.0:
        return math.inf
    return math.sqrt(3.0 / (fluid.density * particle.compressibility)) / (2.0 * math.pi * particle.radius)


def drag_coefficient(particle: Particle, fluid: FluidProperties) -> float:
    """Stokes drag per speed, 6 pi eta a, in N s/m."""
    return 6.0 * math.pi * viscosity(fluid) * particle.radius


def net_weight(particle: Particle, fluid: FluidProperties) -> float:
    """Weight minus buoyancy (N), positive along -z."""
    return particle.volume * (particle.density - fluid.density) * GRAVITY
