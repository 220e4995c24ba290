"""Gas in a part of a cavity: above the surface of a liquid that does not fill it, or in a bubble under its lid.

Both act in the filled states alone. A cavity of half a wavelength between two walls that is full to a part of its
height resonates where that height is a quarter of a wavelength, and its lid moves freely: f0 and Z_min move by more
than most tolerances explain. A bubble under the lid lets the liquid move into it and takes the lid's load away.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from workbench.physics.rim import RING, SHARE, OfRim, Rim
from workbench.physics.term import Integral, Product

#: Share of a slab that counts as liquid where all of it is gas: in the gas the pressure decays within sqrt(LEFT / 3) of
#: the slab's depth. Ten times this share changes nothing.
LEFT = 1e-6

#: Extent of a patch without pressure beside that of its ring along r, for the liquid that flows into it. With 0.25,
#: discs that end within a ring are described to 0.04 of their effect, with 0.5 to 0.33 and with 0.15 to 0.17.
PATCH = 0.25


@dataclass(frozen=True)
class GasPocket(OfRim):
    """No pressure where gas takes the liquid's place, and so no force of the liquid on the walls there.

    In a slab of depth d of which the upper share f is gas,

        + 3 f / ((1 - f + LEFT) d^2) p q / (rho w^2)

    next to `fluid.AcousticFluid` on the same region. Gas is light: its pressure is 3e-4 of the liquid's, and is taken
    as none (Kinsler et al., Fundamentals of Acoustics, 2000, section 6.2). f = 1 makes p vanish in the slab, and exact
    where the mesh has a line of nodes at the surface. Between two edges, a slab of liquid that is thin beside the
    wavelength has p linear in its height; with the term it is as soft as one that ends at (1 - f) d. A full slab above
    which there is none is joined to its lid.

    With a `boundary`, the gas is a flat bubble there, under the layer `lid`: over the share f of a ring's area, beside
    `fluid.SolidFluidContact` on the same boundary,

        + f / ((1 - f + LEFT) d) p q / (rho w^2)

    with d the extent of the ring along r times PATCH, and the rim counts areas about the axis. The drag of the boundary
    layer on walls above the surface stays; it is a hundred thousandth of Z. `size` (m) is the height of the region, or
    under a lid its radius. Parameters: the rim's depth or area (see `rim.Rim`), ``<rim>.extent`` (m),
    ``<material>.density``.
    """

    region: str
    material: str
    rim: Rim
    size: float
    boundary: str = ""
    lid: str = ""

    def fixed(self) -> Mapping[str, float]:
        return {f"{self.rim.name}.extent": self.size}

    def integrals(self) -> tuple[Integral, ...]:
        symbols = (("rho", f"{self.material}.density"), ("extent", f"{self.rim.name}.extent"))
        form = (Product("p", "p"),)
        if not self.boundary:
            return tuple(Integral(coefficient, self.region, form, skin=1.0 - edge)
                         for edge, coefficient in self.rim.coefficients(_sunk, symbols, -2))
        return tuple(Integral(coefficient, self.boundary, form, self.lid, self.region,
                              radius_fraction=math.sqrt(edge))
                     for edge, coefficient in self.rim.coefficients(_patched, symbols, -2))


def _sunk(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """The law 3 f / ((1 - f + LEFT) rho d^2) of a slab and its derivatives."""
    return _released(v, 3.0 / v[RING] ** 2, 2)


def _patched(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """The law f / ((1 - f + LEFT) rho d) of a ring whose extent along r is taken as the root of its area."""
    return _released(v, 1.0 / (PATCH * v[RING] ** 0.5), 1)


def _released(v: Mapping[str, complex], scale: complex, power: int) -> tuple[complex, Mapping[str, complex]]:
    f, whole = v[SHARE], scale / (v["rho"] * v["extent"] ** power)
    kept = 1.0 - f + LEFT
    value = whole * f / kept
    return value, {SHARE: whole * (1.0 + LEFT) / kept**2, "rho": -value / v["rho"],
                   "extent": -power * value / v["extent"]}
