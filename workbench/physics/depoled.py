"""A depoled annulus of the transducer.

A solder joint may have heated it, or it was not covered during poling. It lowers the coupling: Z_min rises, and f0 and
the antiresonance move closer, radial modes first. It acts equally in all states, the free disc included. Half a
millimetre of a chip of 25 mm is +2.7 ohm and -1 kHz filled, +0.2 ohm and +1 kHz empty.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.physics.annulus import SHARE, Annulus, AnnulusTerm
from workbench.physics.term import Admissible, Integral, Product

#: Admissible excess of the permittivity of a depoled annulus.
EXCESS = Admissible(
    -0.2, 0.2, "1", "twice the 10 % by which the mean over all directions of the clamped permittivities of PZT-4, 730 "
    "and 635, exceeds that along the poling: Jaffe, Cook and Jaffe 1971, Piezoelectric Ceramics, table 7.1")


@dataclass(frozen=True)
class DepoledAnnulus(AnnulusTerm):
    """A depoled annulus: zero piezoelectric constants, permittivity (1 + x) eps33.

    In a ring in which the share f of the area is not poled,

        - f [eps(v) e^T grad(phi) + grad(psi) e eps(u)] - f x eps33 d_z(psi) d_z(phi)

    in addition to `piezoelectric.Piezoelectric` on the same region. Rings are integrated exactly, even if they begin
    within an element. The stiffness, which poling changes by a few percent, stays. Parameters ``<annulus>.width`` (see
    `annulus.Annulus`) and ``.permittivity_excess`` x (see :data:`EXCESS`), ``<material>.e31``, ``.e33``, ``.e15`` and
    ``.eps33``.
    """

    region: str
    material: str
    annulus: Annulus

    def fixed(self) -> Mapping[str, float]:
        return {f"{self.annulus.name}.permittivity_excess": 0.0}

    def integrals(self) -> tuple[Integral, ...]:
        excess = ("x", f"{self.annulus.name}.permittivity_excess")
        found = []
        for constant, law, symbols, product in (
            ("e31", _lost, (), Product("strain_plane", "grad_phi_z", 2.0)),
            ("e33", _lost, (), Product("strain_zz", "grad_phi_z", 2.0)),
            ("e15", _lost, (), Product("strain_rz", "grad_phi_r", 2.0)),
            ("eps33", _gained, (excess,), Product("grad_phi_z", "grad_phi_z")),
        ):
            whole = (("constant", f"{self.material}.{constant}"), *symbols)
            found += [Integral(coefficient, self.region, (product,), radius_fraction=edge)
                      for edge, coefficient in self.annulus.coefficients(law, whole)]
        return tuple(found)


def _lost(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """The law -f e and its derivatives."""
    return -v[SHARE] * v["constant"], {SHARE: -v["constant"], "constant": -v[SHARE]}


def _gained(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """The law -f x eps33 and its derivatives."""
    f, x, permittivity = v[SHARE], v["x"], VACUUM_PERMITTIVITY * v["constant"]
    return -f * x * permittivity, {SHARE: -x * permittivity, "x": -f * permittivity,
                                   "constant": -f * x * VACUUM_PERMITTIVITY}
