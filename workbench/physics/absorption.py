"""Bulk absorption of sound in a fluid.

Its causes are viscosity and heat conduction, or suspended matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.physics.term import Admissible, FreeParameter, Integral, Monomial, Product, Term, free_of

#: Admissible absorption of a liquid.
ADMISSIBLE: Mapping[str, Admissible] = {
    "diffusivity_of_sound": Admissible(
        0.0, 3e-2, "m^2/s",
        "from a pure liquid (water: 4e-6) to a loss factor of 0.1 at 1 MHz, a suspension or a gel"),
}


@dataclass(frozen=True)
class BulkAbsorption(Term):
    """Classical absorption of sound in a fluid.

    The compressibility becomes (1 + i w delta / c^2) / (rho c^2), e^{-i w t}:

        - i w delta / (rho c^4) p q

    so that the wavenumber is w / c + i w^2 delta / (2 c^3) to first order (Pierce, Acoustics, 1989, section 10-2). In
    water it is a loss factor of 1e-5 at 1 MHz. In a gas-filled cavity it makes the resonances finite. Parameters:
    ``<material>.density``, ``.sound_speed`` and ``.diffusivity_of_sound`` (m^2/s; see :data:`ADMISSIBLE`).
    """

    region: str
    material: str

    def free(self) -> tuple[FreeParameter, ...]:
        return free_of(self.material, ADMISSIBLE, {"diffusivity_of_sound": 0.0})

    def integrals(self) -> tuple[Integral, ...]:
        factors = ((f"{self.material}.diffusivity_of_sound", 1), (f"{self.material}.density", -1),
                   (f"{self.material}.sound_speed", -4))
        return (Integral(Monomial(-1j, 1, factors), self.region, (Product("p", "p"),)),)
