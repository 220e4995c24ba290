"""A solid whose stiffness or density differs along the radius: a homogeneous disc is one of few spectra.

A resonance moves with the mean of the stiffness over its strain energy and of the density over its kinetic energy.
Where that moves it by its width, the spectrum is no longer linear in the change.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

from workbench.physics.term import OPERATORS, Integral, Monomial, Product, RadialCosine, Term

#: Owner of the amplitudes of all waves.
OWNER = "inhomogeneity"


class UnevenProperty(Enum):
    """A property that differs along the radius, by the power of the angular frequency in its integrals."""

    STIFFNESS = 0.0
    DENSITY = 2.0


@dataclass(frozen=True)
class UnevenSolid(Term):
    """One cosine wave along the radius in the stiffness or the density of a solid.

        a cos(pi n r / radius) [eps(v) : C : eps(u)]    or    - a cos(pi n r / radius) rho w^2 u.v

    next to the solid itself on the same region, with n ``half_waves`` up to the ``radius`` (m) of the mesh. C and rho,
    real and as they are stated, are the weights of the ``products``: any difference is of second order. Parameter
    ``inhomogeneity.<property>_<n>`` a, relative.
    """

    region: str
    uneven: UnevenProperty
    half_waves: int
    radius: float
    products: tuple[Product, ...]

    @classmethod
    def of(cls, integrals: Iterable[Integral], uneven: UnevenProperty, half_waves: int, radius: float,
           values: Mapping[str, complex]) -> UnevenSolid:
        """The wave in a solid of these `integrals` over one region, with the `values` of their constants."""
        products, regions = [], set()
        for integral in integrals:
            coefficient = integral.coefficient
            components = {component for p in integral.products for name in (p.row, p.column)
                          for component, _, _ in OPERATORS[name]}
            if isinstance(coefficient, Monomial) and coefficient.omega_power == uneven.value and (
                    components <= {"u_r", "u_z"}):
                value = coefficient.constant(values).real
                products += [Product(p.row, p.column, p.weight * value) for p in integral.products]
                regions.add(integral.place)
        (region,) = regions
        return cls(region, uneven, half_waves, radius, tuple(products))

    @property
    def amplitude(self) -> str:
        """The full name of the amplitude."""
        return f"{OWNER}.{self.uneven.name.lower()}_{self.half_waves}"

    def integrals(self) -> tuple[Integral, ...]:
        return (Integral(Monomial(1.0, self.uneven.value, ((self.amplitude, 1),)), self.region, self.products,
                         radial=RadialCosine(self.half_waves, self.radius)),)
