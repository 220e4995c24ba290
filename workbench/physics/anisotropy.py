"""Printed polymers with another stiffness along the build direction z.

The axial excess moves f0 equally in the empty and the filled chip: 4 % is +2 kHz in a chip of 25 mm. The shear excess
moves radial modes, and Z_min and Q of the empty chip. Both act in all states with the polymer, equally in every print
of one kind, and not in a free disc.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.physics.term import Admissible, FreeParameter, Integral, Monomial, Product, Term, free_of

_PRINT = ("five times the 4 % due to 2 % of speed difference between along and across the layers, the largest in "
          "prints of PLA, ABS and a resin (Anisotropic behavior of ultrasonic waves in 3D printed materials); layers "
          "can bond worse than in those")

#: Relative excesses of a printed polymer.
ADMISSIBLE: Mapping[str, Admissible] = {
    "axial_excess": Admissible(-0.2, 0.2, "1", _PRINT),
    "shear_excess": Admissible(-0.2, 0.2, "1", _PRINT),
    "lateral_excess": Admissible(-0.2, 0.2, "1", _PRINT),
}


@dataclass(frozen=True)
class TransverseIsotropy(Term):
    """Relative excesses of c33, c44 and c13 of an isotropic solid.

    The quadratic form is

        x_33 (K + 4 G / 3) eps_zz eps_zz + x_44 G (2 eps_rz)^2 + 2 x_13 (K - 2 G / 3) (eps_rr + eps_tt) eps_zz

    in addition to `solid.IsotropicSolid` on the same region: transverse isotropy about z (Auld, Acoustic Fields and
    Waves in Solids, 1973, section 3D), with c11 and c12 unchanged. Speeds along z: longitudinal sqrt(c33 (1 + x_33) /
    rho), shear sqrt(G (1 + x_44) / rho). The loss factor of each constant stays. The stiffness is positive definite if
    c33 (1 + x_33) (K + G / 3) > c13^2 (1 + x_13)^2. Parameters ``<material>.axial_excess``, ``.shear_excess`` and
    ``.lateral_excess`` (see :data:`ADMISSIBLE`), ``.bulk_modulus`` and ``.shear_modulus``.
    """

    region: str
    material: str

    def free(self) -> tuple[FreeParameter, ...]:
        return free_of(self.material, ADMISSIBLE, {"axial_excess": 0.0, "shear_excess": 0.0})

    def fixed(self) -> Mapping[str, float]:
        return {f"{self.material}.lateral_excess": 0.0}

    def integrals(self) -> tuple[Integral, ...]:
        def of(excess: str, modulus: str, scale: float, product: Product) -> Integral:
            factors = ((f"{self.material}.{excess}_excess", 1), (f"{self.material}.{modulus}_modulus", 1))
            return Integral(Monomial(scale, 0, factors), self.region, (product,))

        axial, lateral = Product("strain_zz", "strain_zz"), Product("strain_plane", "strain_zz", 2.0)
        return (
            of("axial", "bulk", 1.0, axial),
            of("axial", "shear", 4.0 / 3.0, axial),
            of("shear", "shear", 1.0, Product("strain_rz", "strain_rz")),
            of("lateral", "bulk", 1.0, lateral),
            of("lateral", "shear", -2.0 / 3.0, lateral),
        )
