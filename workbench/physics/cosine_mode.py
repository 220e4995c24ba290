"""A solid with a stiffness or density that varies along the radius.

A resonance moves with the mean of the stiffness over its strain energy and of the density over its kinetic energy. A
shift of more than the resonance's width is not linear in the amplitude any more.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

from workbench.physics.term import OPERATORS, Integral, Monomial, Product, RadialCosine, Term

#: Owner of the amplitudes of all cosine modes.
OWNER = "inhomogeneity"


class VaryingProperty(Enum):
    """A property that varies along the radius. The value is the power of the angular frequency in its integrals."""

    STIFFNESS = 0.0
    DENSITY = 2.0


@dataclass(frozen=True)
class CosineMode(Term):
    """One cosine mode along the radius of a solid's stiffness or density.

        a cos(pi n r / radius) [eps(v) : C : eps(u)]    or    - a cos(pi n r / radius) rho w^2 u.v

    in addition to the solid itself on the same region, with n ``half_waves`` up to the ``radius`` (m) of the mesh. C
    and rho, real and as stated, are the weights of the ``products``: any difference is of second order. Parameter
    ``inhomogeneity.<property>_<n>`` a, relative.
    """

    region: str
    varying: VaryingProperty
    half_waves: int
    radius: float
    products: tuple[Product, ...]

    @classmethod
    def of(cls, integrals: Iterable[Integral], varying: VaryingProperty, half_waves: int, radius: float,
           values: Mapping[str, complex]) -> CosineMode:
        """The mode in a solid with these `integrals` and constants' `values`."""
        products, regions = [], set()
        for integral in integrals:
            coefficient = integral.coefficient
            components = {component for p in integral.products for name in (p.row, p.column)
                          for component, _, _ in OPERATORS[name]}
            if isinstance(coefficient, Monomial) and coefficient.omega_power == varying.value and (
                    components <= {"u_r", "u_z"}):
                value = coefficient.constant(values).real
                products += [Product(p.row, p.column, p.weight * value) for p in integral.products]
                regions.add(integral.place)
        (region,) = regions
        return cls(region, varying, half_waves, radius, tuple(products))

    @property
    def amplitude(self) -> str:
        """The full name of the amplitude."""
        return f"{OWNER}.{self.varying.name.lower()}_{self.half_waves}"

    def integrals(self) -> tuple[Integral, ...]:
        return (Integral(Monomial(1.0, self.varying.value, ((self.amplitude, 1),)), self.region, self.products,
                         radial=RadialCosine(self.half_waves, self.radius)),)
