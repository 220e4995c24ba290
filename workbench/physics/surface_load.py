"""Loads on the outside of a solid: impedances and springs.

A backing or the air is an impedance, a holder a spring.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from workbench.physics.term import Admissible, FreeParameter, Integral, Monomial, Product, Term, free_of

#: Admissible real part of a passive load, along the normal and along the surface. From dry air at 25 degC, 1.184 kg/m^3
#: times 346.1 m/s, to a heavily loaded backing; an imaginary part may be anything of that size.
ADMISSIBLE: Mapping[str, Admissible] = {
    "normal_impedance": Admissible(
        409.8, 15e6, "Pa s/m",
        "air: U.S. Standard Atmosphere, 1976; tungsten in epoxy, 3 to 15 MRayl: Passive materials for high frequency "
        "piezocomposite ultrasonic transducers, thesis, University of Birmingham, 2009",
    ),
    "tangential_impedance": Admissible(
        0.0, 10e6, "Pa s/m", "from air, which slips, to shear waves in the same backings, slower by a third or more"),
    "stiffness": Admissible(
        0.0, 1e15, "Pa/m", "from none, over 1 mm of rubber (K = 1.5 GPa, 1.5e12 Pa/m), to a clamp: ten times as stiff "
        "as 1 mm of glass, 7e13 Pa/m"),
    "loss_factor": Admissible(0.0, 0.3, "1", "from none to a rubber"),
}


@dataclass(frozen=True)
class SurfaceLoad(Term):
    """Traction proportional to the velocity of an outer boundary.

    sigma n = i w (Z_n u_n n + Z_t u_t), e^{-i w t}:

        - i w Z_n u_n v_n - i w Z_t u_t v_t        over the boundary

    A positive real part dissipates energy; a mass m per area is Z = -i w m, a stiffness K per area Z = i K / w. Z is
    constant over the band, which suits a wave that leaves without reflection (Z = rho c of the surroundings; Kinsler et
    al., Fundamentals of Acoustics, 2000, section 5.10), or a narrow band. `name` distinguishes loads: parameters
    ``<name>.normal_impedance`` and ``<name>.tangential_impedance`` (Pa s/m; see :data:`ADMISSIBLE`).
    """

    boundary: str
    solid: str
    name: str

    def free(self) -> tuple[FreeParameter, ...]:
        # The load of the air around a chip is negligible.
        limit = replace(ADMISSIBLE["normal_impedance"], lowest=0.0)
        return (FreeParameter(f"{self.name}.normal_impedance", 0.0, limit),)

    def fixed(self) -> Mapping[str, float]:
        return {f"{self.name}.tangential_impedance": 0.0}

    def integrals(self) -> tuple[Integral, ...]:
        return tuple(
            Integral(Monomial(-1.0j, 1, ((f"{self.name}.{kind}_impedance", 1),)), self.boundary,
                     (Product(motion, motion),), self.solid)
            for kind, motion in (("normal", "u_n"), ("tangential", "u_t"))
        )


@dataclass(frozen=True)
class SurfaceSpring(Term):
    """A compliant holder: springs on an outer boundary.

    sigma n = - k (1 - i eta) u with the stiffness k per area, e^{-i w t}:

        + k (1 - i eta) (u_n v_n + u_t v_t)        over the boundary

    The holder itself does not move. A k far above the stiffness of the solid is a clamp (Leissa, Vibration of Plates,
    1969, section 1.1). `name` distinguishes holders: parameters ``<name>.stiffness`` (Pa/m) and ``.loss_factor`` eta
    (see :data:`ADMISSIBLE`).
    """

    boundary: str
    solid: str
    name: str

    def free(self) -> tuple[FreeParameter, ...]:
        return free_of(self.name, ADMISSIBLE, {"stiffness": 0.0, "loss_factor": 0.1})

    def integrals(self) -> tuple[Integral, ...]:
        stiffness, loss = (f"{self.name}.stiffness", 1.0), (f"{self.name}.loss_factor", 1.0)
        form = (Product("u_n", "u_n"), Product("u_t", "u_t"))
        return tuple(Integral(Monomial(scale, 0, factors), self.boundary, form, self.solid)
                     for scale, factors in ((1.0, (stiffness,)), (-1.0j, (stiffness, loss))))
