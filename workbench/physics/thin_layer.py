"""An imperfect bond: a thin solid layer more compliant than its material.

Normal compliance lowers f0, more in the empty chip, and moves Z_min in either direction. Tangential compliance raises
Z_min and lowers Q, more in the filled chip. Both act in all states with the bond, and not in a free disc. In a chip of
25 mm with 0.1 mm of epoxy, a normal compliance of 2e-14 m/Pa is -11 kHz empty and -6 kHz filled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.physics.term import Admissible, ConstantLaw, Formula, FreeParameter, Integral, Product, Term, free_of

_SPRING = (
    "from a perfect bond to a hundred times the compliance of 0.1 mm of the epoxy of Acevedo-Espinosa et al. "
    "(RP-UEIS), which almost decouples the two sides; springs for bonds: Baik and Thompson 1984, J. Nondestr. "
    "Eval. 4, 177")

#: Thickness of the compliant skin at one face, as a share of the layer's: thin beside the layer, thick enough to mesh.
SKIN = 0.05

#: Admissible springs of a bond.
ADMISSIBLE: Mapping[str, Admissible] = {
    "normal_compliance": Admissible(0.0, 1.7e-12, "m/Pa", _SPRING),
    "tangential_compliance": Admissible(0.0, 11e-12, "m/Pa", _SPRING),
    "loss_factor": Admissible(0.0, 0.3, "1", "from none to a rubber"),
}


@dataclass(frozen=True)
class ImperfectBond(Term):
    """Springs of compliance s_n and s_t in series with a layer. They are per area.

    The springs are at its upper or lower face:

        - s_n / (d + c33 s_n) sigma_zz(v) sigma_zz(u) - s_t / (d + G s_t) sigma_rz(v) sigma_rz(u)

    over a skin with the share :data:`SKIN` of the layer's thickness, d thick, in addition to `solid.IsotropicSolid` on
    the same region, with its sigma_zz = c33 eps_zz + c13 (eps_rr + eps_tt) and sigma_rz = 2 G eps_rz, c33 = K + 4 G /
    3, c13 = K - 2 G / 3. Together they are a skin of c33 / (1 + c33 s_n / d), c13 / (1 + c33 s_n / d) and G / (1 + G
    s_t / d): stress is the same in skin and springs, strains add up (Backus 1962, J. Geophys. Res. 67, 4427; springs
    for bonds: Baik and Thompson 1984). The springs have a loss: s is the stated compliance times 1 + i eta, e^{-i w t}.
    The mesh must have the skin (`geometry.mesh_size.MeshSize.skins`). `name` distinguishes bonds: parameters
    ``<name>.normal_compliance``, ``.tangential_compliance`` (m/Pa) and ``.loss_factor`` eta (see :data:`ADMISSIBLE`),
    ``<region>.thickness`` (m); ``<material>.bulk_modulus`` and ``.shear_modulus``.
    """

    region: str
    material: str
    name: str
    upper: bool

    def free(self) -> tuple[FreeParameter, ...]:
        return free_of(self.name, ADMISSIBLE, dict.fromkeys(ADMISSIBLE, 0.0))

    def integrals(self) -> tuple[Integral, ...]:
        moduli = (("K", f"{self.material}.bulk_modulus"), ("G", f"{self.material}.shear_modulus"))
        shared = (("t", f"{self.region}.thickness"), ("eta", f"{self.name}.loss_factor"))
        normal = (("s", f"{self.name}.normal_compliance"), *shared, *moduli)
        tangential = (("s", f"{self.name}.tangential_compliance"), *shared, moduli[1])

        def of(law: ConstantLaw, symbols: tuple[tuple[str, str], ...], product: Product) -> Integral:
            return Integral(Formula(law, symbols), self.region, (product,), skin=SKIN if self.upper else -SKIN)

        return (
            of(_axial, normal, Product("strain_zz", "strain_zz")),
            of(_mixed, normal, Product("strain_plane", "strain_zz", 2.0)),
            of(_plane, normal, Product("strain_plane", "strain_plane")),
            of(_shear, tangential, Product("strain_rz", "strain_rz")),
        )


#: Factors of K and G in c33, c13 and G.
_C33, _C13, _SHEAR = {"K": 1.0, "G": 4.0 / 3.0}, {"K": 1.0, "G": -2.0 / 3.0}, {"G": 1.0}


def _axial(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    return _given(v, _C33, _C33, _C33)


def _mixed(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    return _given(v, _C33, _C33, _C13)


def _plane(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    return _given(v, _C33, _C13, _C13)


def _shear(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    return _given(v, _SHEAR, _SHEAR, _SHEAR)


def _given(
    v: Mapping[str, complex], own: Mapping[str, float], first: Mapping[str, float], second: Mapping[str, float]
) -> tuple[complex, Mapping[str, complex]]:
    """The coefficient of a skin and its derivatives. It is -s / (d + m s) a b. m is the modulus of the skin, a and b
    are two moduli."""
    m, a, b = (sum(factor * v[name] for name, factor in factors.items()) for factors in (own, first, second))
    lossy = 1.0 + 1j * v["eta"]
    d, s = SKIN * v["t"], v["s"] * lossy
    total = d + m * s
    share = s / total
    by_s = -d / total**2 * a * b
    return -share * a * b, {
        "s": by_s * lossy, "eta": by_s * 1j * v["s"], "t": SKIN * share / total * a * b,
        **{name: share**2 * own[name] * a * b - share * (first[name] * b + second[name] * a) for name in own},
    }
