"""A rim of the transducer that has lost its poling: heated by a solder joint, or not covered when it was poled.

It lowers the coupling: Z_min rises, f0 and antiresonance draw together, radial modes first; in all states alike, the
free disc included. Half a millimetre of a chip of 25 mm is +2.7 ohm and -1 kHz filled, +0.2 ohm and +1 kHz empty.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.physics.term import Admissible, Free, Integral, Monomial, Product, Term, free_of

#: What the poling of a rim can be.
ADMISSIBLE: Mapping[str, Admissible] = {
    "depoled_fraction": Admissible(0.0, 1.0, "1", "from poled to not poled at all"),
    "permittivity_excess": Admissible(
        -0.2, 0.2, "1", "twice the 10 % that the mean over all directions of the clamped permittivities of PZT-4, 730 "
        "and 635, is above that along the poling: Jaffe, Cook and Jaffe 1971, Piezoelectric Ceramics, table 7.1"),
}


@dataclass(frozen=True)
class DepoledRim(Term):
    """Piezoelectric constants (1 - f) e and permittivity (1 + x) eps33 at radii beyond a share `beyond` of the disc's.

        - f [eps(v) e^T grad(phi) + grad(psi) e eps(u)] - x eps33 d_z(psi) d_z(phi)

    next to `piezoelectric.Piezoelectric` on the same region. It is integrated over exactly that rim, also where it
    begins within an element; of several each adds to those it lies in. The stiffness, which poling changes by a few
    percent, stays. Parameters ``<rim>.depoled_fraction`` f and ``.permittivity_excess`` x (see
    :data:`ADMISSIBLE`), ``<material>.e31``, ``.e33``, ``.e15`` and ``.eps33``.
    """

    region: str
    material: str
    beyond: float
    rim: str

    def free(self) -> tuple[Free, ...]:
        return free_of(self.rim, ADMISSIBLE, {"depoled_fraction": 0.0})

    def fixed(self) -> Mapping[str, float]:
        return {f"{self.rim}.permittivity_excess": 0.0}

    def integrals(self) -> tuple[Integral, ...]:
        def of(amplitude: str, constant: str, scale: float, product: Product) -> Integral:
            factors = ((f"{self.rim}.{amplitude}", 1), (f"{self.material}.{constant}", 1))
            return Integral(Monomial(scale, 0, factors), self.region, (product,), beyond=self.beyond)

        return (
            of("depoled_fraction", "e31", -1.0, Product("strain_plane", "grad_phi_z", 2.0)),
            of("depoled_fraction", "e33", -1.0, Product("strain_zz", "grad_phi_z", 2.0)),
            of("depoled_fraction", "e15", -1.0, Product("strain_rz", "grad_phi_r", 2.0)),
            of("permittivity_excess", "eps33", -VACUUM_PERMITTIVITY, Product("grad_phi_z", "grad_phi_z")),
        )
