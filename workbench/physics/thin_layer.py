"""An imperfect bond: a thin solid layer that gives way more than its material does.

Along the normal it lowers f0, the empty chip's more, and moves Z_min either way; along the layer it raises Z_min and
lowers Q, the filled chip's more. In all states with the bond, and in no free disc. In a chip of 25 mm with 0.1 mm of
epoxy, 2e-14 m/Pa along the normal are -11 kHz empty and -6 kHz filled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.physics.term import Admissible, Formula, Integral, Product, Term

_SPRING = (
    "from a perfect bond to a hundred times the compliance of 0.1 mm of the epoxy of Acevedo-Espinosa et al. "
    "(RP-UEIS), where the two sides hardly hold each other; springs for bonds: Baik and Thompson 1984, J. Nondestr. "
    "Eval. 4, 177")

#: Real parts; a passive bond has Im >= 0 (a lossy spring K, Im K <= 0, is the compliance 1 / K).
ADMISSIBLE: Mapping[str, Admissible] = {
    "normal_compliance": Admissible(0.0, 1.7e-12, "m/Pa", _SPRING),
    "tangential_compliance": Admissible(0.0, 11e-12, "m/Pa", _SPRING),
}


@dataclass(frozen=True)
class ImperfectBond(Term):
    """Springs of compliance s_n and s_t per area in series with a layer of thickness d, spread over it.

        - s_n / (d + c33 s_n) sigma_zz(v) sigma_zz(u) - s_t / (d + G s_t) sigma_rz(v) sigma_rz(u)

    next to `solid.IsotropicSolid` on the same region, with its own sigma_zz = c33 eps_zz + c13 (eps_rr + eps_tt) and
    sigma_rz = 2 G eps_rz, c33 = K + 4 G / 3, c13 = K - 2 G / 3. Together they are a layer of c33 / (1 + c33 s_n / d),
    c13 / (1 + c33 s_n / d) and G / (1 + G s_t / d): stress is the same in layer and springs, strains add up (Backus
    1962, J. Geophys. Res. 67, 4427; springs for bonds: Baik and Thompson 1984). Where the layer is thin against the
    wavelength in the softened layer it does not matter where in the layer the springs are. Parameters
    ``<region>.normal_compliance``, ``.tangential_compliance`` (m/Pa; see :data:`ADMISSIBLE`), ``.thickness`` (m);
    ``<material>.bulk_modulus`` and ``.shear_modulus``.
    """

    region: str
    material: str

    def integrals(self) -> tuple[Integral, ...]:
        moduli = (("K", f"{self.material}.bulk_modulus"), ("G", f"{self.material}.shear_modulus"))
        thickness = ("d", f"{self.region}.thickness")
        normal = (("s", f"{self.region}.normal_compliance"), thickness, *moduli)
        tangential = (("s", f"{self.region}.tangential_compliance"), thickness, moduli[1])
        return (
            Integral(Formula(_axial, normal), self.region, (Product("strain_zz", "strain_zz"),)),
            Integral(Formula(_mixed, normal), self.region, (Product("strain_plane", "strain_zz", 2.0),)),
            Integral(Formula(_plane, normal), self.region, (Product("strain_plane", "strain_plane"),)),
            Integral(Formula(_shear, tangential), self.region, (Product("strain_rz", "strain_rz"),)),
        )


#: How c33 and c13 follow from K and G: the factor of G; that of K is one.
_C33, _C13 = 4.0 / 3.0, -2.0 / 3.0


def _axial(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    return _normal(v, _C33, _C33)


def _mixed(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    return _normal(v, _C33, _C13)


def _plane(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    return _normal(v, _C13, _C13)


def _normal(v: Mapping[str, complex], first: float, second: float) -> tuple[complex, Mapping[str, complex]]:
    """-s / (d + c33 s) a b for two stiffnesses a = K + first G and b = K + second G, and its derivatives."""
    a, b = v["K"] + first * v["G"], v["K"] + second * v["G"]
    total = v["d"] + (v["K"] + _C33 * v["G"]) * v["s"]
    share = v["s"] / total
    return -share * a * b, {
        "s": -v["d"] / total**2 * a * b,
        "d": share / total * a * b,
        "K": share**2 * a * b - share * (a + b),
        "G": share**2 * _C33 * a * b - share * (first * b + second * a),
    }


def _shear(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """-s G^2 / (d + G s) and its derivatives."""
    modulus, total = v["G"], v["d"] + v["G"] * v["s"]
    share = v["s"] / total
    return -share * modulus**2, {
        "s": -v["d"] / total**2 * modulus**2,
        "d": share / total * modulus**2,
        "G": share**2 * modulus**2 - 2.0 * share * modulus,
    }
