"""Single crystals of cubic symmetry in a straight section: (100) silicon wafers."""

from __future__ import annotations

from dataclasses import dataclass

from workbench.physics.term import Condition, Integral, Monomial, Product, Term


@dataclass(frozen=True)
class CubicCrystal(Term):
    """Cubic crystal in a straight section, with a cube axis along z.

        c eps_xx(v) eps_xx(u) + c11 eps_zz(v) eps_zz(u) + c12 (eps_xx(v) eps_zz(u) + eps_zz(v) eps_xx(u))
        + c44 (2 eps_xz(v)) (2 eps_xz(u)) - rho w^2 u.v

    in plane strain. If the channel runs along <100>, c = c11. If it runs along <110>, the crystal is turned by 45
    degrees about z, and c = (c11 + c12) / 2 + c44 (Auld, Acoustic Fields and Waves in Solids, 1973, section 3D).
    Parameters ``<material>.c11``, ``.c12`` and ``.c44`` along the cube's axes (Pa; loss is a negative imaginary part)
    and ``.density`` (kg/m^3).
    """

    region: str
    material: str
    turned: bool

    @property
    def unknowns(self) -> tuple[tuple[str, str], ...]:
        return tuple((component, self.region) for component in ("u_r", "u_z"))

    def integrals(self) -> tuple[Integral, ...]:
        def of(name: str, *products: Product, scale: float = 1.0, omega_power: int = 0) -> Integral:
            return Integral(Monomial(scale, omega_power, ((f"{self.material}.{name}", 1),)), self.region, products)

        across, up, shear = (Product(name, name) for name in ("strain_rr", "strain_zz", "strain_rz"))
        in_plane = (of("c11", across, scale=0.5), of("c12", across, scale=0.5), of("c44", across)) if self.turned else (
            of("c11", across),)
        return (
            *in_plane,
            of("c11", up),
            of("c12", Product("strain_rr", "strain_zz", 2.0)),
            of("c44", shear),
            of("density", Product("u_r", "u_r"), Product("u_z", "u_z"), scale=-1.0, omega_power=2),
        )

    def conditions(self) -> tuple[Condition, ...]:
        return (Condition("u_r", "axis"),)
