"""Ports of a cavity as short necks in its side wall.

Plugs of liquid in the necks are driven by the cavity's pressure. They lower the pressure and dissipate energy, only in
the filled state. The impedance of a neck is its inertia, so the effect grows with the open share of the wall and with
shorter necks. It is small if the chip's mode stands across the cavity: in a chip of 25 mm, 5 % of the wall open in
necks of 0.5 mm is -0.1 % of Z_min, 20 % in necks of 0.2 mm is -1 %.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.physics.term import Admissible, Dispersion, FreeParameter, Integral, Product, Term, free_of

Complex = NDArray[np.complex128]

#: Admissible openings of a side wall.
ADMISSIBLE: Mapping[str, Admissible] = {
    "share": Admissible(
        0.0, 0.25, "1", "of the wall's area: from none to four bores of 1 mm in a cavity of 1 mm by 2 mm of radius"),
    "length": Admissible(
        5e-5, 5e-3, "m",
        "from the end corrections alone of a hole of 60 um, 16 a / (3 pi), to a bore through 5 mm of wall; Kinsler et "
        "al., Fundamentals of Acoustics, 2000, section 10.8"),
    "resistance": Admissible(
        0.0, 1.5e6, "Pa s/m", "from a plug of liquid without friction to a long tube of water behind it, rho c"),
}


@dataclass(frozen=True)
class PortNecks(Term):
    """Openings on a share s of a wall, with moving liquid.

    The liquid has the mass rho l per area and moves as one, e^{-i w t}:

        - s / (K - w^2 rho l - i w R) p q        over the wall

    in addition to `fluid.Fluid`: the displacement into the wall per pressure (Kinsler et al., Fundamentals of
    Acoustics, 2000, section 10.8, the neck of a Helmholtz resonator). l is the length with both end corrections. R is
    the resistance of friction and of the line behind the neck. K is the stiffness of the volume behind: rho c^2 A / V
    for a volume V behind an area A. The term holds for necks that are short and narrow against the wavelength.
    Rotational symmetry spreads them around the axis. The solid wall itself stays. `name` distinguishes walls:
    parameters ``<name>.share`` s, ``.length`` l (m), ``.resistance`` R (Pa s/m; see :data:`ADMISSIBLE`), ``.stiffness``
    K (Pa/m) and ``<material>.density``.
    """

    boundary: str
    solid: str
    fluid: str
    material: str
    name: str

    @property
    def needs_axis(self) -> bool:
        """Always true: the openings are spread around the axis. A straight channel has its ports at its ends."""
        return True

    def free(self) -> tuple[FreeParameter, ...]:
        return free_of(self.name, ADMISSIBLE, {"share": 0.0, "length": 5e-4, "resistance": 3e5})

    def fixed(self) -> Mapping[str, float]:
        # Open tubing, full of liquid like the cavity.
        return {f"{self.name}.stiffness": 0.0}

    def integrals(self) -> tuple[Integral, ...]:
        own = {"s": "share", "l": "length", "R": "resistance", "K": "stiffness"}
        symbols = (*((symbol, f"{self.name}.{name}") for symbol, name in own.items()),
                   ("rho", f"{self.material}.density"))
        return (Integral(Dispersion(_yielding, symbols), self.boundary, (Product("p", "p"),), self.solid, self.fluid),)


def _yielding(omega: NDArray[np.float64], v: Mapping[str, complex]) -> tuple[Complex, Mapping[str, Complex]]:
    """The coefficient of a neck and its derivatives. It is -s / (K - w^2 rho l - i w R)."""
    moving = np.asarray(v["K"] - omega**2 * v["rho"] * v["l"] - 1j * omega * v["R"], dtype=np.complex128)
    by_moving = v["s"] / moving**2
    inertia = -by_moving * omega**2
    return -v["s"] / moving, {"s": -1.0 / moving, "K": by_moving, "l": inertia * v["rho"], "rho": inertia * v["l"],
                              "R": -1j * omega * by_moving}
