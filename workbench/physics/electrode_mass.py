"""The mass of the metal on the two faces of the transducer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.physics.term import Admissible, Integral, Monomial, Product, Term

#: Density of silver, kg/m^3 (CRC Handbook of Chemistry and Physics, 97th edition, section 4).
SILVER_DENSITY = 10490.0

#: Mass per area of one face.
ADMISSIBLE: Mapping[str, Admissible] = {
    "surface_density": Admissible(
        0.01, 0.19, "kg/m^2",
        "from sputtered 0.05 um of chromium and 0.5 um of gold to twice the nominal 8.9 um of fired silver; nominal "
        "figures of Piezo Technologies, Tolerances and capabilities",
    ),
}


@dataclass(frozen=True)
class ElectrodeMass(Term):
    """Inertia of thin electrodes that follow the faces they lie on; their own stiffness is left out.

        - m w^2 u.v        on both electrodes, m = density times thickness of the metal

    A free plate of surface density M loses the share 2 m / M of the frequency of its half-wave thickness resonance
    (Sauerbrey 1959, Z. Phys. 155, 206; both faces). Parameter ``electrodes.surface_density`` (kg/m^2; see
    :data:`ADMISSIBLE`), the same on both.
    """

    live: str
    ground: str
    transducer: str

    def integrals(self) -> tuple[Integral, ...]:
        coefficient = Monomial(-1.0, 2, (("electrodes.surface_density", 1),))
        motion = (Product("u_r", "u_r"), Product("u_z", "u_z"))
        return tuple(Integral(coefficient, face, motion, self.transducer) for face in (self.live, self.ground))
