"""The kinds of material: one frozen dataclass for each physics.

Numbers are SI. Losses have the time factor e^{-i w t}: negative imaginary stiffness, positive imaginary permittivity.
``parameters()`` gives a solver its numbers by field name; ``values`` has every number as its source states it.
``temperature`` (K) is set if the numbers depend on it. ``fit`` describes the fit of the numbers, None for numbers from
the literature.

:func:`dataclasses.replace` changes a number. The changed field then has no entry in ``values``, because its source does
not apply any more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from materials.fit import Fit
from materials.value import Value
from workbench.files.errors import choose
from workbench.files.quantities import VACUUM_PERMITTIVITY

#: Classes of ceramics by their losses: hard is US Navy types I and III, soft is types II and VI.
CERAMICS = ("hard", "soft")

#: Directions of a channel in the plane of a (100) wafer: along its flat, or at 45 degrees to it.
CHANNELS = ("<110>", "<100>")


def _unchanged(values: Mapping[str, Value], fields: Mapping[str, complex]) -> dict[str, Value]:
    """The `values` that agree with the field of their name."""
    return {name: value for name, value in values.items() if name not in fields or value.value == fields[name]}


@dataclass(frozen=True, kw_only=True)
class SolidMaterial:
    """The density, thermal constants and source of a solid. A thermal constant is None if not stated.

    Density in kg/m^3, thermal conductivity in W/(m K), heat capacity in J/(kg K), linear thermal expansion in 1/K. The
    acoustic model does not use thermal constants, so they are not parameters.
    """

    PARAMETERS: ClassVar[tuple[str, ...]] = ("density",)
    THERMAL: ClassVar[tuple[str, ...]] = ("thermal_conductivity", "heat_capacity", "thermal_expansion")

    name: str
    density: float
    thermal_conductivity: float | None = field(default=None, repr=False)
    heat_capacity: float | None = field(default=None, repr=False)
    thermal_expansion: float | None = field(default=None, repr=False)
    temperature: float | None = None
    source: str = ""
    values: Mapping[str, Value] = field(default_factory=dict, compare=False, repr=False)
    fit: Fit | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        known = {**self.parameters(), **self.thermal()}
        stated = {name: value for name, value in self.values.items() if name in known or name not in self.THERMAL}
        object.__setattr__(self, "values", _unchanged(stated, known))

    def parameters(self) -> dict[str, complex]:
        """Every number by its field name."""
        return {name: complex(getattr(self, name)) for name in self.PARAMETERS}

    def thermal(self) -> dict[str, complex]:
        """Every known thermal constant by its field name."""
        found = {name: getattr(self, name) for name in self.THERMAL}
        return {name: complex(number) for name, number in found.items() if number is not None}


@dataclass(frozen=True, kw_only=True)
class Piezoelectric(SolidMaterial):
    """A transversely isotropic piezoelectric solid poled along z, in stress-charge form.

    Density in kg/m^3, stiffness at constant electric field in Pa, piezoelectric constants in C/m^2, permittivity at
    constant strain relative to that of free space. Acevedo-Espinosa et al. (RP-UEIS), eqs. 6 to 12. ``ceramic`` is one
    of :data:`CERAMICS`, or empty if not stated.
    """

    PARAMETERS: ClassVar[tuple[str, ...]] = (
        "density", "c11", "c12", "c13", "c33", "c44", "e31", "e33", "e15", "eps11", "eps33",
    )

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
    ceramic: str = ""

    @property
    def c66(self) -> complex:
        """Stiffness (Pa) for shear in the plane normal to the poling."""
        return (self.c11 - self.c12) / 2

    @property
    def absolute_eps33(self) -> complex:
        """Permittivity (F/m) at constant strain along the poling."""
        return self.eps33 * VACUUM_PERMITTIVITY

    def slowest_wave_speed(self) -> float:
        """Speed (m/s) of the slower shear wave, without piezoelectric stiffening."""
        return math.sqrt(min(complex(self.c44).real, complex(self.c66).real) / self.density)


@dataclass(frozen=True, kw_only=True)
class IsotropicSolid(SolidMaterial):
    """An isotropic, possibly viscoelastic solid, or the material of a particle.

    Density in kg/m^3, adiabatic bulk and shear modulus in Pa; a particle such as a cell may have no shear modulus, a
    layer must. Acevedo-Espinosa et al. (RP-UEIS), eq. 17. ``softening_temperature`` (K) is the glass transition of a
    polymer, above which it is softer and more lossy than stated; None if unknown.
    """

    THERMAL: ClassVar[tuple[str, ...]] = (*SolidMaterial.THERMAL, "softening_temperature")

    PARAMETERS: ClassVar[tuple[str, ...]] = ("density", "bulk_modulus", "shear_modulus")

    bulk_modulus: complex
    shear_modulus: complex
    softening_temperature: float | None = field(default=None, repr=False)

    @property
    def compressibility(self) -> float:
        """Compressibility (1/Pa) of the bulk, 1 / K."""
        return 1.0 / complex(self.bulk_modulus).real

    def slowest_wave_speed(self) -> float:
        """Speed (m/s) of shear waves."""
        return math.sqrt(complex(self.shear_modulus).real / self.density)


@dataclass(frozen=True, kw_only=True)
class CubicSolid(SolidMaterial):
    """A single crystal of cubic symmetry, cut as a (100) wafer.

    Density in kg/m^3, stiffness along the axes of the cube in Pa. A cube axis is normal to the wafer. ``channel`` is
    the direction of the channel in its plane, one of :data:`CHANNELS`. Only a straight chip may have such a layer.
    """

    PARAMETERS: ClassVar[tuple[str, ...]] = ("density", "c11", "c12", "c44")

    c11: complex
    c12: complex
    c44: complex
    channel: str

    def __post_init__(self) -> None:
        choose(self.channel, CHANNELS, source=self.name, field="channel")
        super().__post_init__()

    @property
    def bulk_modulus(self) -> complex:
        """Bulk modulus (Pa), which is the same in all directions."""
        return (self.c11 + 2.0 * self.c12) / 3.0

    @property
    def shear_modulus(self) -> complex:
        """Shear modulus (Pa) of the polycrystal: mean of Voigt and Reuss bounds."""
        soft, hard = self.c11 - self.c12, self.c44
        return 0.5 * ((soft + 3.0 * hard) / 5.0 + 5.0 * soft * hard / (4.0 * hard + 3.0 * soft))

    @property
    def stiffness(self) -> tuple[complex, complex]:
        """In-plane stiffnesses (Pa) across the channel. They relate a strain across the channel to the stresses across
        and along it."""
        if self.channel == "<100>":
            return self.c11, self.c12
        mean = 0.5 * (self.c11 + self.c12)
        return mean + self.c44, mean - self.c44

    def slowest_wave_speed(self) -> float:
        """Speed (m/s) of the slowest shear wave in the section."""
        return math.sqrt(min(complex(self.c44).real, 0.5 * complex(self.c11 - self.c12).real) / self.density)


@dataclass(frozen=True, kw_only=True)
class Fluid:
    """A compressible fluid at one temperature. Density in kg/m^3, sound speed in m/s, viscosities in Pa s, thermal
    conductivity in W/(m K), heat capacity at constant pressure in J/(kg K). A number is None if not stated."""

    PARAMETERS: ClassVar[tuple[str, ...]] = (
        "density", "sound_speed", "shear_viscosity", "bulk_viscosity", "heat_capacity_ratio", "thermal_conductivity",
        "heat_capacity",
    )

    name: str
    density: float
    sound_speed: float
    shear_viscosity: float | None = None
    bulk_viscosity: float | None = None
    heat_capacity_ratio: float | None = None
    thermal_conductivity: float | None = None
    heat_capacity: float | None = None
    temperature: float | None = None
    source: str = ""
    values: Mapping[str, Value] = field(default_factory=dict, compare=False, repr=False)
    fit: Fit | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        # A field set to None is not in parameters(), so its Value is dropped by name.
        known = self.parameters()
        stated = {name: value for name, value in self.values.items() if name in known}
        object.__setattr__(self, "values", _unchanged(stated, known))

    @property
    def is_gas(self) -> bool:
        """Whether the density is below 100 kg/m^3, between gases and liquids."""
        return self.density < 100.0

    @property
    def compressibility(self) -> float:
        """Isentropic compressibility (1/Pa): 1 / (density sound_speed^2)."""
        return 1.0 / (self.density * self.sound_speed**2)

    @property
    def diffusivity_of_sound(self) -> float | None:
        """Diffusivity of sound in m^2/s, or None without a viscosity.

        It is [4/3 eta + eta_b + (gamma - 1) lambda / c_p] / rho; the classical absorption of sound is omega^2 / (2 c^3)
        times it (Pierce, Acoustics, 1989, section 10-2). Heat conduction counts if its three numbers are known; in
        water it is a thousandth of the whole. If a source states only the absorption, the bulk viscosity represents all
        of it. Without bulk viscosity it is a lower bound (:attr:`absorbs_more`).
        """
        viscous = 4.0 / 3.0 * (self.shear_viscosity or 0.0) + (self.bulk_viscosity or 0.0)
        if viscous == 0.0:
            return None
        if self.heat_capacity_ratio is None or self.thermal_conductivity is None or self.heat_capacity is None:
            return viscous / self.density
        thermal = (self.heat_capacity_ratio - 1.0) * self.thermal_conductivity / self.heat_capacity
        return (viscous + thermal) / self.density

    @property
    def absorbs_more(self) -> bool:
        """Whether the diffusivity of sound is a lower bound, without bulk viscosity."""
        return self.bulk_viscosity is None and self.shear_viscosity is not None

    def parameters(self) -> dict[str, complex]:
        """Every stated number by its field name."""
        found = {name: getattr(self, name) for name in self.PARAMETERS}
        return {name: complex(number) for name, number in found.items() if number is not None}

    def slowest_wave_speed(self) -> float:
        """Speed (m/s) of sound."""
        return self.sound_speed


Solid = Piezoelectric | IsotropicSolid | CubicSolid
Material = Solid | Fluid
