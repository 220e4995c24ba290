"""Viscous and thermal boundary layers of a fluid at solid walls.

Their constants are those of the fluid, so nothing is fitted. Both follow Bach and Bruus 2018 (J. Acoust. Soc. Am. 144,
766) and Berggren, Bernland and Noreland 2018 (J. Comput. Phys. 371, 633): the layer is not meshed but is a condition on
the pressure at the wall. The conditions require a layer (half a micrometre in water at 1 MHz) that is thin against the
radius of curvature, the channel height and the wavelength, and a wall displacement that varies along the wall no faster
than the wave.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from workbench.physics.term import Admissible, Integral, Monomial, Product, Term

#: Admissible constants of the fluid. They are not fitted. A value outside this range indicates another effect.
ADMISSIBLE: Mapping[str, Admissible] = {
    "shear_viscosity": Admissible(0.28e-3, 1.8e-3, "Pa s", "liquid water from 100 to 0 degC, IAPWS SR6-08(2011)"),
    "heat_capacity_ratio": Admissible(1.0, 5.0 / 3.0, "1", "from an incompressible liquid to a monatomic ideal gas"),
}


@dataclass(frozen=True)
class ViscousBoundaryLayer(Term):
    """Dissipation and inertia of the slip between a fluid and a wall.

    The wall may move. Over the contact, e^{-i w t},

        - beta / (rho w^2) (grad_t p - rho w^2 u_t) . (grad_t q - rho w^2 v_t)        beta = (1 + i) delta / 2

    with delta = sqrt(2 eta / (rho w)); grad_t p / (rho w^2) is the displacement of the fluid just outside the layer. It
    is the weak form of

        d_n p = rho w^2 (u_n + beta div_t u_t) - beta lap_t p               n out of the fluid
        sigma n_s = -p n_s - beta grad_t p + rho w^2 beta u_t               n_s out of the solid

    in addition to `fluid.Fluid` and `fluid.SolidFluidContact` on the same boundary. Without swirl the tangent in the
    section is the only one. Parameters ``<material>.shear_viscosity`` (Pa s; see :data:`ADMISSIBLE`) and ``.density``.
    """

    boundary: str
    solid: str
    fluid: str
    material: str

    def integrals(self) -> tuple[Integral, ...]:
        def of(omega_power: float, density_power: float, product: Product) -> Integral:
            # beta = (1 + i) sqrt(eta / (2 rho w)) times the rest.
            factors = ((f"{self.material}.shear_viscosity", 0.5), (f"{self.material}.density", density_power - 0.5))
            coefficient = Monomial(-(1.0 + 1.0j) / math.sqrt(2.0), omega_power - 0.5, factors)
            return Integral(coefficient, self.boundary, (product,), self.solid, self.fluid)

        return (
            of(-2.0, -1.0, Product("grad_p_t", "grad_p_t")),
            of(0.0, 0.0, Product("grad_p_t", "u_t", -2.0)),
            of(2.0, 1.0, Product("u_t", "u_t")),
        )


@dataclass(frozen=True)
class ThermalBoundaryLayer(Term):
    """Isothermal compression near a wall that conducts heat well.

        - (gamma - 1) (1 + i) (delta_t / 2) / (rho c^2) p q        delta_t = sqrt(2 lambda / (rho c_p w))

    over the contact, e^{-i w t}. Its effect is below a hundredth of the viscous layer's in water (gamma - 1 = 0.01) and
    half of it in a gas. Parameters ``<material>.heat_capacity_ratio`` (see :data:`ADMISSIBLE`),
    ``.thermal_conductivity`` (W/(m K)), ``.heat_capacity`` (J/(kg K)), ``.density`` and ``.sound_speed``.
    """

    boundary: str
    solid: str
    fluid: str
    material: str

    def integrals(self) -> tuple[Integral, ...]:
        # gamma - 1 as the difference of two powers of gamma.
        shared = (("thermal_conductivity", 0.5), ("heat_capacity", -0.5), ("density", -1.5), ("sound_speed", -2.0))
        found = []
        for sign, power in ((-1.0, 1.0), (1.0, 0.0)):
            factors = tuple((f"{self.material}.{name}", exponent) for name, exponent in
                            (*shared, ("heat_capacity_ratio", power)) if exponent)
            coefficient = Monomial(sign * (1.0 + 1.0j) / math.sqrt(2.0), -0.5, factors)
            found.append(Integral(coefficient, self.boundary, (Product("p", "p"),), self.solid, self.fluid))
        return tuple(found)
