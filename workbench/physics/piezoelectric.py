"""The piezoelectric ceramic, poled along z, with complex constants (losses)."""

from __future__ import annotations

from dataclasses import dataclass

from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.physics.term import Condition, Integral, Monomial, Product, Term


@dataclass(frozen=True)
class PiezoelectricSolid(Term):
    """Transversely isotropic piezoelectric solid in a region.

        eps(v) : C : eps(u) - rho w^2 u.v + eps(v) e^T grad(phi) + grad(psi) e eps(u) - grad(psi) . epsilon grad(phi)

    with sigma = C eps - e^T E, D = e eps + epsilon E and E = -grad(phi) (Acevedo-Espinosa et al. (RP-UEIS), eqs. 10
    and 11, quasistatic, 6mm symmetry). Parameters ``<material>.c11 ... .eps33`` are those of
    `materials.Piezoelectric`; permittivities are relative and at constant strain. Time factor e^{-i w t}: a loss is a
    negative imaginary stiffness and a positive imaginary permittivity. ``poled_down`` is against z, which reverses e.
    """

    region: str
    material: str
    poled_down: bool = False

    @property
    def unknowns(self) -> tuple[tuple[str, str], ...]:
        return tuple((component, self.region) for component in ("u_r", "u_z", "phi"))

    def integrals(self) -> tuple[Integral, ...]:
        def of(name: str, *products: Product, scale: float = 1.0, omega_power: int = 0) -> Integral:
            factors = ((f"{self.material}.{name}", 1),)
            turned = -scale if self.poled_down and name.startswith("e") and not name.startswith("eps") else scale
            return Integral(Monomial(turned, omega_power, factors), self.region, products)

        return (
            of("c11", Product("strain_rr", "strain_rr"), Product("strain_tt", "strain_tt")),
            of("c12", Product("strain_rr", "strain_tt", 2.0)),
            of("c13", Product("strain_plane", "strain_zz", 2.0)),
            of("c33", Product("strain_zz", "strain_zz")),
            of("c44", Product("strain_rz", "strain_rz")),
            of("e31", Product("strain_plane", "grad_phi_z", 2.0)),
            of("e33", Product("strain_zz", "grad_phi_z", 2.0)),
            of("e15", Product("strain_rz", "grad_phi_r", 2.0)),
            of("eps11", Product("grad_phi_r", "grad_phi_r"), scale=-VACUUM_PERMITTIVITY),
            of("eps33", Product("grad_phi_z", "grad_phi_z"), scale=-VACUUM_PERMITTIVITY),
            of("density", Product("u_r", "u_r"), Product("u_z", "u_z"), scale=-1.0, omega_power=2),
        )

    def conditions(self) -> tuple[Condition, ...]:
        return (Condition("u_r", "axis"),)
