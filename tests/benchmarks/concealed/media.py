"""What fills the cells of a section: coefficients of the weak form as functions of the angular frequency.

Time factor e^{-i w t}, SI units. Each medium names the integrals of :mod:`elements` that it has and gives their
coefficients (n,) at the angular frequencies (n,). Frozen, so that two states can be seen to be the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Coefficients = Mapping[str, Any]  # (n,) complex, or one number for all

VACUUM_PERMITTIVITY = 8.8541878128e-12


@dataclass(frozen=True)
class Solid:
    """Transversely isotropic about z.

    ``fractional`` is (strength, exponent, angular frequency w0): it adds to the shear modulus G = c44 the fractional
    element s G [(-i w / w0)^a / cos(pi a / 2) - 1], whose real part vanishes at w0 and which obeys Kramers-Kronig.
    """

    density: complex
    c11: complex
    c12: complex
    c13: complex
    c33: complex
    c44: complex
    fractional: tuple[float, float, float] | None = None

    kind = "solid"

    @classmethod
    def isotropic(cls, density: complex, bulk: complex, shear: complex, *,
                  fractional: tuple[float, float, float] | None = None) -> Solid:
        """A solid of bulk and shear modulus (Pa)."""
        long, cross = bulk + 4.0 * shear / 3.0, bulk - 2.0 * shear / 3.0
        return cls(density, long, cross, cross, long, shear, fractional)

    def coefficients(self, omega: Real) -> Coefficients:
        extra: Complex | complex = 0.0
        if self.fractional is not None:
            strength, exponent, reference = self.fractional
            power = (-1j * omega / reference) ** exponent / np.cos(0.5 * np.pi * exponent)
            extra = strength * self.c44.real * (power - 1.0)
        stiffness = {"c11": self.c11 + 4.0 * extra / 3.0, "c12": self.c12 - 2.0 * extra / 3.0,
                     "c13": self.c13 - 2.0 * extra / 3.0, "c33": self.c33 + 4.0 * extra / 3.0, "c44": self.c44 + extra}
        return {**stiffness, "density": -self.density * omega**2 + 0j}


@dataclass(frozen=True)
class Piezo:
    """Poled along z, stress-charge form; permittivities relative to that of free space."""

    density: complex
    c11: complex
    c12: complex
    c13: complex
    c33: complex
    c44: complex
    e31: complex
    e33: complex
    e15: complex
    eps11: complex
    eps33: complex

    kind = "piezo"

    def coefficients(self, omega: Real) -> Coefficients:
        names = ("c11", "c12", "c13", "c33", "c44", "e31", "e33", "e15")
        found = {name: complex(getattr(self, name)) for name in names}
        return {**found, "eps11": -self.eps11 * VACUUM_PERMITTIVITY, "eps33": -self.eps33 * VACUUM_PERMITTIVITY,
                "density": -self.density * omega**2 + 0j}


@dataclass(frozen=True)
class Bubbles:
    """Gas of a volume fraction in bubbles of one radius (m), in a liquid of ``viscosity`` at a ``temperature`` (K).

    The response of one bubble is solved from the heat equation inside it and the equation of motion of the liquid
    around it (Prosperetti 1977, J. Acoust. Soc. Am. 61, 17; mixture by Foldy). Radius 0 stands for bubbles far below
    their resonance with adiabatic gas (Wood 1930).
    """

    fraction: float
    radius: float
    density: float
    sound_speed: float
    viscosity: float

    def compressibility(self, omega: Real) -> Complex:
        """What they add to the compressibility of the liquid (1/Pa)."""
        pressure, gamma, tension, diffusivity = 101325.0, 1.4, 0.07197, 2.194e-5
        liquid = 1.0 / (self.density * self.sound_speed**2)
        if self.radius == 0.0:
            return np.full(omega.shape, self.fraction * (1.0 / (gamma * pressure) - liquid), dtype=complex)
        inside = pressure + 2.0 * tension / self.radius
        # Gas pressure per relative volume, with y coth y by the thermal wave in the sphere.
        y = (1.0 - 1.0j) * self.radius * np.sqrt(omega / (2.0 * diffusivity))
        exchange = (y / np.tanh(y) - 1.0) / y**2
        gas = 3.0 * gamma * inside / (1.0 + 3.0 * (gamma - 1.0) * exchange)
        inertia = self.density * omega**2 * self.radius**2
        radiation = 1j * inertia * omega * self.radius / self.sound_speed
        per_radius = gas - 2.0 * tension / self.radius - inertia - 4j * omega * self.viscosity - radiation
        return 3.0 * self.fraction / per_radius


@dataclass(frozen=True)
class Liquid:
    """A fluid without shear as a pressure field. ``diffusivity`` of sound in m^2/s."""

    density: complex
    sound_speed: complex
    diffusivity: float = 0.0
    bubbles: Bubbles | None = None

    kind = "liquid"

    def coefficients(self, omega: Real) -> Coefficients:
        # To first order in the absorption, K = rho (c^2 - i w delta).
        own = 1.0 / (self.density * (self.sound_speed**2 - 1j * omega * self.diffusivity))
        added = 0.0 if self.bubbles is None else self.bubbles.compressibility(omega)
        return {"inertia": 1.0 / (self.density * omega**2) + 0j, "compressibility": -(own + added)}


@dataclass(frozen=True)
class Viscous:
    """A viscous, compressible fluid as displacement and pressure; viscosities in Pa s."""

    density: complex
    sound_speed: complex
    shear_viscosity: float
    bulk_viscosity: float
    bubbles: Bubbles | None = None

    kind = "viscous"

    def coefficients(self, omega: Real) -> Coefficients:
        own = 1.0 / (self.density * self.sound_speed**2 - 1j * omega * self.bulk_viscosity)
        added = 0.0 if self.bubbles is None else self.bubbles.compressibility(omega)
        return {"shear": -1j * omega * self.shear_viscosity, "dilatation": -1.0 + 0j,
                "compressibility": -(own + added), "density": -self.density * omega**2 + 0j}


@dataclass(frozen=True)
class Load:
    """Normal and tangential impedance (Pa s/m) of an outer face."""

    normal: complex
    tangential: complex

    def coefficients(self, omega: Real) -> Coefficients:
        return {"normal": -1j * omega * self.normal, "tangential": -1j * omega * self.tangential}


@dataclass(frozen=True)
class Hold:
    """Normal and tangential stiffness (Pa/m) of what holds an outer face."""

    normal: complex
    tangential: complex

    def coefficients(self, omega: Real) -> Coefficients:
        return {"normal": complex(self.normal), "tangential": complex(self.tangential)}


@dataclass(frozen=True)
class Necks:
    """Openings in the wall of a fluid: share of the wall, length (m) and resistance (Pa s/m) of the necks,
    stiffness (Pa/m) of what is behind; the displacement into them per pressure is share / (K - w^2 m - i w R)."""

    share: float
    density: float
    length: float
    resistance: float
    stiffness: float

    def coefficients(self, omega: Real) -> Coefficients:
        mass = self.density * self.length
        return {"admittance": -self.share / (self.stiffness - omega**2 * mass - 1j * omega * self.resistance)}


@dataclass(frozen=True)
class Contact:
    """Pressure on a solid wall."""

    def coefficients(self, omega: Real) -> Coefficients:
        return {"contact": np.ones(omega.shape, dtype=complex)}


Medium = Solid | Piezo | Liquid | Viscous
Surface = Load | Hold | Necks | Contact
Anything = Medium | Surface
