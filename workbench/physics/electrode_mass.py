"""Mass and membrane stiffness of the metal on both transducer faces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.physics.term import Admissible, FreeParameter, Integral, Monomial, Product, Term, free_of

#: Density of silver, kg/m^3 (CRC Handbook of Chemistry and Physics, 97th edition, section 4).
SILVER_DENSITY = 10490.0

#: Poisson's ratio of silver (Kaye & Laby, Tables of Physical and Chemical Constants, section 2.2.2; gold 0.42, nickel
#: 0.31). The free stiffness compensates its small influence.
POISSON = 0.37

#: E / ((1 - nu^2) rho) of solid silver, m^2/s^2: 82.7 GPa (ibid.).
SILVER_STIFFNESS = 82.7e9 / (1.0 - POISSON**2) / SILVER_DENSITY

#: Admissible mass per area of one face, and stiffness of the metal divided by its density.
ADMISSIBLE: Mapping[str, Admissible] = {
    "surface_density": Admissible(
        0.01, 0.19, "kg/m^2",
        "from sputtered 0.05 um of chromium and 0.5 um of gold to twice the nominal 8.9 um of fired silver; nominal "
        "figures of Piezo Technologies, Tolerances and capabilities",
    ),
    "specific_stiffness": Admissible(
        0.0, 2.5e7, "m^2/s^2",
        "from a film of grains without cohesion to nickel (200 GPa, Kaye & Laby, section 2.2.2); solid silver "
        "9.1e6",
    ),
}


@dataclass(frozen=True)
class ElectrodeMass(Term):
    """Inertia and membrane stiffness of thin electrodes on the transducer faces.

        - m w^2 u.v + m s (e_rr(u) e_rr(v) + e_tt(u) e_tt(v) + nu (e_rr(u) e_tt(v) + e_tt(u) e_rr(v)))

    on both electrodes. m is density times thickness of the metal; s = E / ((1 - nu^2) density) is the square of the
    speed of extensional waves in it. A free plate of surface density M loses the share 2 m / M of the frequency of its
    half-wave thickness resonance (Sauerbrey 1959, Z. Phys. 155, 206; both faces), for any s. A radial resonance, of
    extensional speed c, loses about (m / M) (1 - s / c^2): the stiffness of solid silver compensates most of it. The
    film is rigid across its thickness. A compliant film, such as 5 um of porous silver of 11 GPa, would add 5 % to the
    compliance of 20 um of gel on it, like bubbles in the gel.

    Parameters ``electrodes.surface_density`` (m, kg/m^2) and ``electrodes.specific_stiffness`` (s, m^2/s^2), equal on
    both; see :data:`ADMISSIBLE`.
    """

    live: str
    ground: str
    transducer: str

    def free(self) -> tuple[FreeParameter, ...]:
        # A value between those of cohesive and of loose grains of silver.
        return free_of("electrodes", ADMISSIBLE,
                       {"surface_density": 0.0, "specific_stiffness": 0.4 * SILVER_STIFFNESS})

    def integrals(self) -> tuple[Integral, ...]:
        mass = ("electrodes.surface_density", 1)
        inertia = Monomial(-1.0, 2, (mass,))
        stretching = Monomial(1.0, 0, (mass, ("electrodes.specific_stiffness", 1)))
        motion = (Product("u_r", "u_r"), Product("u_z", "u_z"))
        stretch = (Product("strain_rr", "strain_rr"), Product("strain_tt", "strain_tt"),
                   Product("strain_rr", "strain_tt", 2.0 * POISSON))
        return tuple(Integral(coefficient, face, form, self.transducer) for face in (self.live, self.ground)
                     for coefficient, form in ((inertia, motion), (stretching, stretch)))
