"""A bond over part of its radius. Glue is missing at the edge, or a joint has delaminated.

An annulus of the superstrate is free and bends separately: f0 and Z_min rise, Z_min more in the filled chip, and
resonances of the annulus appear. It acts in all states with the bond, and not in a free disc. In a chip of 25 mm with
0.1 mm of epoxy, an open millimetre at the outer edge is +1.7 kHz and +0.1 ohm empty, +0.5 kHz and +1.2 ohm filled;
around the cavity it is +2.4 kHz and +1.3 ohm empty, +3.6 kHz and +3.5 ohm filled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from workbench.physics.annulus import SHARE, Annulus, AnnulusTerm, hindered
from workbench.physics.term import Integral, isotropic_solid, times

#: Share of stiffness and mass that remains in the open part of the layer, so that its unknowns have an equation. Air,
#: gamma p_0 = 1.4e5 Pa, has 2e-5 of epoxy's 6 GPa. Ten times this share changes nothing.
STIFFNESS_FLOOR = 1e-7

#: Share of the layer's stiffness that supports a ring about half as well as the whole layer. For half-open rings of 0.1
#: to 0.5 mm, shares of 0.05 to 0.3 fit best.
HALFWAY = 0.15

#: Thickness of the joint of two solids that touch without a layer, as a share of one solid's thickness, at its face.
SKIN = 0.02


@dataclass(frozen=True)
class OpenBond(AnnulusTerm):
    """A layer that transmits nothing in an annulus.

    In a ring in which the share f of the area is open,

        - g [K tr(eps(v)) tr(eps(u)) + 2 G dev(eps(v)) : dev(eps(u)) - rho w^2 u.v],
        1 - g = l + (1 - l) s c / (1 - (1 - s) c),    c = 1 - f,    l = STIFFNESS_FLOOR, s = HALFWAY,

    in addition to `solid.IsotropicSolid` on the same region: K, G and rho are multiplied by 1 - g. f = 1 is a gap.
    Rings are integrated exactly, even if they begin within an element. A positive `skin` makes the layer that share of
    the region at its upper face, a negative one at its lower face (`geometry.mesh_size.MeshSize.skins`): the joint of
    two solids without a layer between. The open part contains gas, and neither closes nor rubs during vibration.
    Parameters ``<annulus>.width`` (see `annulus.Annulus`), ``<material>.bulk_modulus``, ``.shear_modulus``,
    ``.density``.
    """

    region: str
    material: str
    annulus: Annulus
    skin: float = 0.0

    def integrals(self) -> tuple[Integral, ...]:
        return tuple(
            replace(integral, coefficient=times(integral.coefficient, opened), radius_fraction=edge, skin=self.skin)
            for edge, opened in self.annulus.coefficients(_opened, ())
            for integral in isotropic_solid(self.region, self.material)
        )


def _opened(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """The law -g and its derivative."""
    lacks, slope = hindered(v[SHARE], HALFWAY)
    return -(1.0 - STIFFNESS_FLOOR) * lacks, {SHARE: -(1.0 - STIFFNESS_FLOOR) * slope}
