"""Gas in a cavity above a liquid, or under the lid.

Both act only in filled states. In a cavity of half a wavelength that is filled to a part of its height, that height is
a quarter wavelength at resonance, and the lid moves freely: f0 and Z_min move by more than most tolerances explain. The
liquid moves into a bubble under the lid, which removes the load on the lid.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from workbench.physics.annulus import RING, SHARE, Annulus, AnnulusTerm
from workbench.physics.term import Integral, Product

#: Liquid share of a slab that is all gas: there the pressure decays within sqrt(LIQUID_FLOOR / 3) of the slab's
#: depth. Ten times this share changes nothing.
LIQUID_FLOOR = 1e-6

#: Extent of a patch without pressure relative to that of its ring along r, for the flow of liquid into it. With 0.25,
#: discs that end within a ring have an error of 0.04 of their effect, with 0.5 an error of 0.33 and with 0.15 one of
#: 0.17.
PATCH = 0.25


@dataclass(frozen=True)
class GasPocket(AnnulusTerm):
    """Zero pressure where gas replaces the liquid.

    The liquid then exerts no force on the walls there. In a slab of depth d of which the upper share f is gas,

        + 3 f / ((1 - f + LIQUID_FLOOR) d^2) p q / (rho w^2)

    in addition to `fluid.AcousticFluid` on the same region. The pressure of the light gas is 3e-4 of the liquid's and
    is neglected (Kinsler et al., Fundamentals of Acoustics, 2000, section 6.2). f = 1 makes p vanish in the slab, and
    is exact if the mesh has a line of nodes at the surface. Between two edges, p is linear in the height of a thin slab
    of liquid; with the term it is as soft as a slab that ends at (1 - f) d. A full slab with none above is joined to
    its lid.

    With a `boundary`, the gas is a flat bubble there, under the layer `lid`: over the share f of a ring's area, in
    addition to `fluid.SolidFluidContact` on the same boundary,

        + f / ((1 - f + LIQUID_FLOOR) d) p q / (rho w^2)

    with d the extent of the ring along r times PATCH; the annulus measures areas about the axis. The drag of the
    boundary layer on walls above the surface stays; it is 1e-5 of Z. `size` (m) is the height of the region, or its
    radius under a lid. Parameters: the depth or area (see `annulus.Annulus`), ``<annulus>.extent`` (m),
    ``<material>.density``.
    """

    region: str
    material: str
    annulus: Annulus
    size: float
    boundary: str = ""
    lid: str = ""

    def fixed(self) -> Mapping[str, float]:
        return {f"{self.annulus.name}.extent": self.size}

    def integrals(self) -> tuple[Integral, ...]:
        symbols = (("rho", f"{self.material}.density"), ("extent", f"{self.annulus.name}.extent"))
        form = (Product("p", "p"),)
        if not self.boundary:
            return tuple(Integral(coefficient, self.region, form, skin=1.0 - edge)
                         for edge, coefficient in self.annulus.coefficients(_sunk, symbols, -2))
        return tuple(Integral(coefficient, self.boundary, form, self.lid, self.region,
                              radius_fraction=math.sqrt(edge))
                     for edge, coefficient in self.annulus.coefficients(_patched, symbols, -2))


def _sunk(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """The law of a slab and its derivatives. It is 3 f / ((1 - f + LIQUID_FLOOR) rho d^2)."""
    return _law(v, 3.0 / v[RING] ** 2, 2)


def _patched(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """The law of a ring and its derivatives. It is f / ((1 - f + LIQUID_FLOOR) rho d). The extent of a ring along r is
    the root of its area."""
    return _law(v, 1.0 / (PATCH * v[RING] ** 0.5), 1)


def _law(v: Mapping[str, complex], scale: complex, power: int) -> tuple[complex, Mapping[str, complex]]:
    f, whole = v[SHARE], scale / (v["rho"] * v["extent"] ** power)
    kept = 1.0 - f + LIQUID_FLOOR
    value = whole * f / kept
    return value, {SHARE: whole * (1.0 + LIQUID_FLOOR) / kept**2, "rho": -value / v["rho"],
                   "extent": -power * value / v["extent"]}
