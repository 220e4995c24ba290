"""Couplant that does not reach the rim: a ring with gas in its place.

It moves f0 and Z_min by what the loaded area loses, either way; in all states with the couplant, different after each
mounting, and in no free disc. Half a millimetre of a chip of 25 mm is +0.3 kHz and -0.1 ohm empty.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.physics.term import Admissible, Integral, Monomial, Product, Term

#: What can be missing of the couplant in the ring.
ADMISSIBLE: Mapping[str, Admissible] = {
    "missing_fraction": Admissible(0.0, 1.0, "1", "from a full ring to none of it"),
}


@dataclass(frozen=True)
class MissingCouplant(Term):
    """A fraction f of the fluid at radii beyond `beyond` (metres) replaced by a gas, in patches.

        f (1 / rho_g - 1 / rho) / w^2 grad(p) . grad(q) - f (1 / (rho_g c_g^2) - 1 / (rho c^2)) p q

    next to `fluid.Fluid` on the same region: where patches are small, volumes add up in the compressibility (Wood 1930,
    A Textbook of Sound) and paths along the layer in the mobility 1 / rho. f = 1 is the gas itself, which differs from
    a couplant that ends at `beyond` by a thousandth of the effect; a tenth of gas differs from that by a hundredth, so
    f says little but whether there is a ring. How wide it is is no parameter: take several, of which each adds to those
    it lies in. It is integrated over exactly that ring, also where it begins within an element. A couplant missing
    elsewhere than at the rim is another geometry. Parameters ``<ring>.missing_fraction`` (see :data:`ADMISSIBLE`),
    ``<material>.density`` and ``.sound_speed``, ``<gas>.density`` and ``.sound_speed``.
    """

    region: str
    material: str
    gas: str
    beyond: float
    ring: str

    def integrals(self) -> tuple[Integral, ...]:
        flow = (Product("grad_p_r", "grad_p_r"), Product("grad_p_z", "grad_p_z"))
        found = []
        for fluid, sign in ((self.gas, 1.0), (self.material, -1.0)):
            shared = ((f"{self.ring}.missing_fraction", 1), (f"{fluid}.density", -1))
            squeezed = Monomial(-sign, 0, (*shared, (f"{fluid}.sound_speed", -2)))
            found.append(Integral(Monomial(sign, -2, shared), self.region, flow, beyond=self.beyond))
            found.append(Integral(squeezed, self.region, (Product("p", "p"),), beyond=self.beyond))
        return tuple(found)
