"""Elastic and viscoelastic isotropic solids: polymers, glass, metal."""

from __future__ import annotations

from dataclasses import dataclass

from workbench.physics.term import Condition, Integral, Monomial, Product, Term


@dataclass(frozen=True)
class IsotropicSolid(Term):
    """Isotropic solid in a region, complex bulk and shear modulus constant over the band.

        K tr(eps(v)) tr(eps(u)) + 2 G dev(eps(v)) : dev(eps(u)) - rho w^2 u.v

    (Acevedo-Espinosa et al. (RP-UEIS), eqs. 4 and 17). Parameters ``<material>.bulk_modulus``, ``.shear_modulus``
    (Pa; loss is a negative imaginary part) and ``.density`` (kg/m^3).
    """

    region: str
    material: str

    @property
    def unknowns(self) -> tuple[tuple[str, str], ...]:
        return tuple((component, self.region) for component in ("u_r", "u_z"))

    def integrals(self) -> tuple[Integral, ...]:
        def of(name: str, *products: Product, scale: float = 1.0, omega_power: int = 0) -> Integral:
            return Integral(Monomial(scale, omega_power, ((f"{self.material}.{name}", 1),)), self.region, products)

        return (
            of("bulk_modulus", Product("dilatation", "dilatation")),
            of(
                "shear_modulus",
                Product("strain_rr", "strain_rr", 2.0),
                Product("strain_tt", "strain_tt", 2.0),
                Product("strain_zz", "strain_zz", 2.0),
                Product("strain_rz", "strain_rz"),
                Product("dilatation", "dilatation", -2.0 / 3.0),
            ),
            of("density", Product("u_r", "u_r"), Product("u_z", "u_z"), scale=-1.0, omega_power=2),
        )

    def conditions(self) -> tuple[Condition, ...]:
        return (Condition("u_r", "axis"),)
