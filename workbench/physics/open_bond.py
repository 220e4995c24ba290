"""A bond that holds on a part of its radius only: glue that did not reach the rim, or a joint that has come off.

It lets go of a ring of the superstrate, which bends on its own: f0 and Z_min rise, the filled chip's Z_min more, and
resonances of the ring enter. In all states with the bond, and in no free disc. In a chip of 25 mm with 0.1 mm of epoxy
a millimetre open at the rim is +1.7 kHz and +0.1 ohm empty, +0.5 kHz and +1.2 ohm filled; around the cavity +2.4 kHz
and +1.3 ohm empty, +3.6 kHz and +3.5 ohm filled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce
from operator import mul

from workbench.physics.term import Admissible, Formula, Free, Integral, Term, free_of, isotropic_solid, times

#: Share of the layer's stiffness and mass that stays where it is open, so that there is an equation for what is in the
#: gap. Of epoxy's 6 GPa air, gamma p_0 = 1.4e5 Pa, would leave 2e-5; ten times as much as here changes nothing.
LEFT = 1e-7

#: A layer with so much of its stiffness holds a ring about half as well as the whole layer does: rings of 0.1 to 0.5 mm
#: that are open over half of their area are best described with 0.05 to 0.3 of it.
HALFWAY = 0.15

#: Share of the thickness of a solid, at its face, that stands for the joint where two solids touch without a layer.
SKIN = 0.02

#: How much of a ring can be open.
ADMISSIBLE: Mapping[str, Admissible] = {
    "open_fraction": Admissible(0.0, 1.0, "1", "from a ring that holds all around to one that holds nowhere"),
}


@dataclass(frozen=True)
class Ring:
    """A ring from one share of a region's outer radius to another, and its name in parameters."""

    name: str
    begin: float
    end: float = 1.0


@dataclass(frozen=True)
class OpenBond(Term):
    """A layer that transmits less, or nothing, in rings: K, G and rho are times 1 - g there,

        - g [K tr(eps(v)) tr(eps(u)) + 2 G dev(eps(v)) : dev(eps(u)) - rho w^2 u.v]
        1 - g = l + (1 - l) s c / (1 - (1 - s) c),    c = (1 - f_1) (1 - f_2) ... ,    l = LEFT, s = HALFWAY,

    next to `solid.IsotropicSolid` on the same region; c is what those rings leave that hold a point. f = 1 is a gap.
    Rings lie in one another: rims all end at the layer's own, and what opens from a hole outwards all begins there. An
    edge between those of two rings is a part, 0 < f < 1, of the wider one and all of the other. They are integrated
    over exactly, also where they begin within an element. Where `skin` is given the layer is that share of the region
    at its upper face, or, where negative, at its lower one (`geometry.mesh_size.MeshSize.skins`): the joint of two
    solids without a layer between. What is open holds gas, and neither closes nor rubs while it vibrates. Parameters
    ``<ring>.open_fraction`` f (see :data:`ADMISSIBLE`), ``<material>.bulk_modulus``, ``.shear_modulus``, ``.density``.
    """

    region: str
    material: str
    rings: tuple[Ring, ...]
    skin: float = 0.0

    def free(self) -> tuple[Free, ...]:
        return tuple(each for ring in self.rings for each in free_of(ring.name, ADMISSIBLE, {"open_fraction": 0.0}))

    def integrals(self) -> tuple[Integral, ...]:
        edges = sorted({edge for ring in self.rings for edge in (ring.begin, ring.end) if edge < 1.0})
        return tuple(
            replace(integral, coefficient=times(integral.coefficient, self._opened(edge)), beyond=edge, skin=self.skin)
            for edge in edges for integral in isotropic_solid(self.region, self.material)
        )

    def _opened(self, edge: float) -> Formula:
        """-g just beyond an edge without -g just within: what is integrated beyond an edge adds up over the edges."""
        within = [ring for ring in self.rings if ring.begin < edge <= ring.end]
        beyond = [ring for ring in self.rings if ring.begin <= edge < ring.end]
        return Formula(_opening, tuple((f"{side} {ring.name}", f"{ring.name}.open_fraction")
                                       for side, rings in (("within", within), ("beyond", beyond)) for ring in rings))


def _opening(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """1 - g beyond an edge without 1 - g within it, and its derivatives."""
    value, slopes = 0j, {}
    for side, sign in (("within", LEFT - 1.0), ("beyond", 1.0 - LEFT)):
        held = {name: 1.0 - f for name, f in v.items() if name.startswith(side)}
        c = reduce(mul, held.values(), 1.0 + 0j)
        below = 1.0 - (1.0 - HALFWAY) * c
        value += sign * HALFWAY * c / below
        for name in held:
            others = reduce(mul, (x for other, x in held.items() if other != name), 1.0 + 0j)
            slopes[name] = -sign * HALFWAY / below**2 * others
    return value, slopes
