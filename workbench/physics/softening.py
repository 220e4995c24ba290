"""A ceramic that softens and loses more at stronger drive.

Both effects are quadratic in the drive; f0 and Q fall in every state. The Rayleigh law of a ferroelectric is linear in
the strain amplitude for loss and stiffness; heating is quadratic in it. Over the few drive levels of a campaign a
quadratic law represents both (PZT below 1 MV/m: Hall 2001, J. Mater. Sci. 36, 4575).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.physics.term import Admissible, FreeParameter, Integral, Monomial, Product, Term, free_of

#: Relative change of c33 per squared volt (amplitude) at the electrodes.
ADMISSIBLE: Mapping[str, Admissible] = {
    "softening": Admissible(
        0.0, 1e-2, "1/V^2", "from none to 1 % at 1 V, beyond which a ceramic of 1 mm would depole at 100 V"),
    "drive_loss": Admissible(0.0, 1e-2, "1/V^2", "as large as the softening: the Rayleigh law ties the two"),
}

#: Name of the parameter for the squared voltage amplitude at the electrodes (V^2) of a state.
DRIVE_SQUARED = "drive.squared"


@dataclass(frozen=True)
class Softening(Term):
    """Softening of c33 with the squared drive. The factor is 1 - (a + i b) V^2.

    V is the amplitude at the electrodes, e^{-i w t}. Parameters ``<material>.softening`` a and
    ``<material>.drive_loss`` b (1/V^2; see :data:`ADMISSIBLE`), ``<material>.c33`` and :data:`DRIVE_SQUARED`.
    """

    region: str
    material: str

    def free(self) -> tuple[FreeParameter, ...]:
        return free_of(self.material, ADMISSIBLE, {"softening": 0.0, "drive_loss": 0.0})

    def integrals(self) -> tuple[Integral, ...]:
        return tuple(
            Integral(Monomial(scale, 0, ((f"{self.material}.{name}", 1), (f"{self.material}.c33", 1),
                                         (DRIVE_SQUARED, 1))), self.region, (Product("strain_zz", "strain_zz"),))
            for name, scale in (("softening", -1.0), ("drive_loss", -1.0j))
        )
