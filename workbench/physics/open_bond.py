"""A bond that holds on a part of its radius only: glue that did not reach the rim, or a joint that has come off.

It lets go of a ring of the superstrate, which bends on its own: resonances of the ring enter, and the chip's own mode
moves either way. In all states with the bond, and in no free disc. In a chip of 25 mm with 0.1 mm of epoxy, a
millimetre of it open at the rim is @RIM@; open around the cavity, @CAVITY@.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.physics.term import Admissible, Formula, Free, Integral, Product, Term, free_of

#: Share of the layer's stiffness and mass that stays where it is open, so that there is an equation for what is in the
#: gap. Of epoxy's 6 GPa air, gamma p_0 = 1.4e5 Pa, would leave 2e-5; ten times as much as here changes nothing.
LEFT = 1e-7

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
    """A layer that transmits less, or nothing, in rings: K, G and rho there times 1 - g,

        - g [K tr(eps(v)) tr(eps(u)) + 2 G dev(eps(v)) : dev(eps(u)) - rho w^2 u.v]        in the rings,
        1 - g = l + (1 - l) (1 - f_1) (1 - f_2) ... ,    l = LEFT,

    next to `solid.IsotropicSolid` on the same region; the product is over the rings that hold a point. Where a share f
    of the area is open in patches that are wide beside the layer's thickness, stiffnesses and masses of unit area add.
    The rings lie in one another, the widest first: rims end at the region's radius, what is open from a hole outwards
    begins at its edge. An edge between those of two rings is a part, 0 < f < 1, of the wider one and all of the other.
    Rings are integrated over exactly, also where they begin within an element. Where `skin` is given the layer is that
    share of the region at its upper face, or, where negative, at its lower one (`geometry.mesh_size.MeshSize.skins`):
    the joint of two solids without a layer between. What is open neither closes nor rubs while it vibrates. Parameters
    ``<ring>.open_fraction`` f (see :data:`ADMISSIBLE`), ``<material>.bulk_modulus``, ``.shear_modulus``, ``.density``.
    """

    region: str
    material: str
    rings: tuple[Ring, ...]
    skin: float = 0.0

    def free(self) -> tuple[Free, ...]:
        return tuple(each for ring in self.rings for each in free_of(ring.name, ADMISSIBLE, {"open_fraction": 0.0}))

    def integrals(self) -> tuple[Integral, ...]:
        found = []
        for k, ring in enumerate(self.rings):
            opened = tuple((f"f{j}", f"{each.name}.open_fraction") for j, each in enumerate(self.rings[: k + 1]))
            # A ring is what is beyond its beginning without what is beyond its end.
            for beyond, sign in ((ring.begin, -1.0), (ring.end, 1.0)):
                if beyond < 1.0:
                    found += [
                        Integral(Formula(_taken, (*opened, ("constant", f"{self.material}.{constant}")), power),
                                 self.region, tuple(Product(p.row, p.column, sign * p.weight) for p in products),
                                 beyond=beyond, skin=self.skin)
                        for constant, power, products in _FORMS
                    ]
        return tuple(found)


#: The quadratic form of an isotropic solid: constant, power of w, and what they multiply.
_FORMS: tuple[tuple[str, float, tuple[Product, ...]], ...] = (
    ("bulk_modulus", 0, (Product("dilatation", "dilatation"),)),
    ("shear_modulus", 0, (
        Product("strain_rr", "strain_rr", 2.0), Product("strain_tt", "strain_tt", 2.0),
        Product("strain_zz", "strain_zz", 2.0), Product("strain_rz", "strain_rz"),
        Product("dilatation", "dilatation", -2.0 / 3.0))),
    ("density", 2, (Product("u_r", "u_r", -1.0), Product("u_z", "u_z", -1.0))),
)


def _taken(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """What the narrowest of some rings takes of a constant beyond what the wider ones take, and its derivatives."""
    *wider, last = [name for name in v if name != "constant"]

    def held(names: list[str]) -> complex:
        product = complex(1.0 - LEFT)
        for name in names:
            product *= 1.0 - v[name]
        return product

    constant, share = v["constant"], held(wider) * v[last]
    by = {name: -constant * v[last] * held([n for n in wider if n != name]) for name in wider}
    return share * constant, {**by, last: held(wider) * constant, "constant": share}
