"""A wall of a cavity that lets the fluid move through it: ports, a leak, a compliant seal.

It damps and shifts the resonances of the cavity, in the filled state alone and only with the tubing at the ports. Where
the chip's own mode stands across the cavity, a leak in the sidewall hardly shows: 5 % of it open is -0.2 % of Z_min in
a chip of 25 mm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.physics.term import Admissible, FreeParameter, Integral, Monomial, Product, Term, free_of

#: Admissible real parts, averaged over the wall.
ADMISSIBLE: Mapping[str, Admissible] = {
    "admittance": Admissible(
        0.0, 6.8e-7, "m/(Pa s)", "from a tight wall to one that is all opening into long tubes of water, 1 / (rho c)"),
    "compliance": Admissible(
        0.0, 4.6e-13, "m/Pa", "from a rigid wall to one that gives way like 1 mm of water, 1 mm / (rho c^2)"),
}


@dataclass(frozen=True)
class WallAdmittance(Term):
    """Fluid that passes the wall with the velocity Y p and the displacement C p along its normal, e^{-i w t}.

        - (i Y / w + C) p q        over the wall

    next to `fluid.Fluid` (Kinsler et al., Fundamentals of Acoustics, 2000, section 10.8). The effect of the solid wall
    itself remains. A real Y takes energy away: a port of area A_p that feeds a long tube, spread over a wall of area A,
    is Y = A_p / (A rho c). Y and C are constant over the band. Rotational symmetry spreads a port around the axis.
    `name` tells walls apart: parameters ``<name>.admittance`` (m/(Pa s)) and ``<name>.compliance`` (m/Pa; see
    :data:`ADMISSIBLE`).
    """

    boundary: str
    solid: str
    fluid: str
    name: str

    def free(self) -> tuple[FreeParameter, ...]:
        return free_of(self.name, ADMISSIBLE, dict.fromkeys(ADMISSIBLE, 0.0))

    def integrals(self) -> tuple[Integral, ...]:
        return tuple(
            Integral(Monomial(scale, power, ((f"{self.name}.{kind}", 1),)), self.boundary, (Product("p", "p"),),
                     self.solid, self.fluid)
            for kind, scale, power in (("admittance", -1j, -1), ("compliance", -1.0, 0))
        )
