"""Fluids as pressure fields: Helmholtz equation, contact with solids, free edges."""

from __future__ import annotations

from dataclasses import dataclass

from workbench.physics.term import Condition, Integral, Monomial, Product, Term


@dataclass(frozen=True)
class AcousticFluid(Term):
    """Compressible fluid at rest in a region. The Helmholtz equation divided by rho w^2 is

        (1 / (rho w^2)) grad(p) . grad(q) - (1 / (rho c^2)) p q

    (Acevedo-Espinosa et al. (RP-UEIS), eq. 15). The velocity is grad(p) / (i w rho) for e^{-i w t}; the paper's eq. 16
    has the other sign. Parameters ``<material>.density`` (kg/m^3) and ``.sound_speed`` (m/s).
    """

    region: str
    material: str

    @property
    def unknowns(self) -> tuple[tuple[str, str], ...]:
        return (("p", self.region),)

    def integrals(self) -> tuple[Integral, ...]:
        density, sound_speed = f"{self.material}.density", f"{self.material}.sound_speed"
        inertia = Monomial(1.0, -2, ((density, -1),))
        compressibility = Monomial(-1.0, 0, ((density, -1), (sound_speed, -2)))
        return (
            Integral(inertia, self.region, (Product("grad_p_r", "grad_p_r"), Product("grad_p_z", "grad_p_z"))),
            Integral(compressibility, self.region, (Product("p", "p"),)),
        )


@dataclass(frozen=True)
class SolidFluidContact(Term):
    """Continuity of normal displacement and traction between solid and fluid.

        p (v . n_s) + q (u . n_s)        n_s out of the solid

    (Acevedo-Espinosa et al. (RP-UEIS), eq. 23, with the displacement in place of the velocity.)
    """

    boundary: str
    solid: str
    fluid: str

    def integrals(self) -> tuple[Integral, ...]:
        form = (Product("p", "u_n", 2.0),)
        return (Integral(Monomial(1.0, 0), self.boundary, form, self.solid, self.fluid),)


@dataclass(frozen=True)
class PressureRelease(Term):
    """Zero pressure on a free edge of a fluid layer. Acevedo-Espinosa et al. (RP-UEIS), eq. 24."""

    boundary: str

    def conditions(self) -> tuple[Condition, ...]:
        return (Condition("p", self.boundary),)
