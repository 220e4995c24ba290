"""A bond that holds on a part of its radius only: glue that did not reach the rim, or a joint that has come off.

It lets go of a ring of the superstrate, which bends on its own: f0 and Z_min rise, the filled chip's Z_min more, and
resonances of the ring enter. In all states with the bond, and in no free disc. In a chip of 25 mm with 0.1 mm of epoxy
a millimetre open at the rim is +1.7 kHz and +0.1 ohm empty, +0.5 kHz and +1.2 ohm filled; around the cavity +2.4 kHz
and +1.3 ohm empty, +3.6 kHz and +3.5 ohm filled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from workbench.physics.rim import SHARE, Rim, hindered
from workbench.physics.term import FreeParameter, Integral, Term, isotropic_solid, times

#: Share of the layer's stiffness and mass that stays where it is open, so that there is an equation for what is in the
#: gap. Of epoxy's 6 GPa air, gamma p_0 = 1.4e5 Pa, would leave 2e-5; ten times as much as here changes nothing.
LEFT = 1e-7

#: A layer with so much of its stiffness holds a ring about half as well as the whole layer does: rings of 0.1 to 0.5 mm
#: that are open over half of their area are best described with 0.05 to 0.3 of it.
HALFWAY = 0.15

#: Share of the thickness of a solid, at its face, that stands for the joint where two solids touch without a layer.
SKIN = 0.02


@dataclass(frozen=True)
class OpenBond(Term):
    """A layer that transmits nothing up to the edge of a rim. Of a ring in which the share f of the area is open,

        - g [K tr(eps(v)) tr(eps(u)) + 2 G dev(eps(v)) : dev(eps(u)) - rho w^2 u.v],
        1 - g = l + (1 - l) s c / (1 - (1 - s) c),    c = 1 - f,    l = LEFT, s = HALFWAY,

    next to `solid.IsotropicSolid` on the same region: K, G and rho are times 1 - g there. f = 1 is a gap. Rings are
    integrated over exactly, also where they begin within an element. Where `skin` is given the layer is that share of
    the region at its upper face, or, where negative, at its lower one (`geometry.mesh_size.MeshSize.skins`): the joint
    of two solids without a layer between. What is open holds gas, and neither closes nor rubs while it vibrates.
    Parameters ``<rim>.width`` (see `rim.Rim`), ``<material>.bulk_modulus``, ``.shear_modulus``, ``.density``.
    """

    region: str
    material: str
    rim: Rim
    skin: float = 0.0

    def free(self) -> tuple[FreeParameter, ...]:
        return self.rim.free()

    def integrals(self) -> tuple[Integral, ...]:
        return tuple(
            replace(integral, coefficient=times(integral.coefficient, opened), beyond=edge, skin=self.skin)
            for edge, opened in self.rim.coefficients(_opened, ())
            for integral in isotropic_solid(self.region, self.material)
        )


def _opened(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """-g and its derivative."""
    lacks, slope = hindered(v[SHARE], HALFWAY)
    return -(1.0 - LEFT) * lacks, {SHARE: -(1.0 - LEFT) * slope}
