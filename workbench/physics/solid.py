"""Elastic and viscoelastic isotropic solids: polymers, glass, metal."""

from __future__ import annotations

from dataclasses import dataclass

from workbench.physics.term import Condition, Integral, Term, isotropic_solid


@dataclass(frozen=True)
class ElasticSolid(Term):
    """Isotropic solid in a region, with moduli constant over the band.

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
        return isotropic_solid(self.region, self.material)

    def conditions(self) -> tuple[Condition, ...]:
        return (Condition("u_r", "axis"),)
