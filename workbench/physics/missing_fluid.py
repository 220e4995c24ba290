"""An annulus of gas instead of fluid in a region.

In a couplant it moves f0 and Z_min in either direction, as the loaded area shrinks. It acts in all states with the
couplant, differs after each mounting, and does not act in a free disc. Half a millimetre of a chip of 25 mm is +0.3 kHz
and -0.1 ohm empty. In a cavity that is not full, with gas beside its ports all around, the liquid ends at a free
surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.physics.annulus import SHARE, Annulus, AnnulusTerm, hindered
from workbench.physics.term import Integral, Product

#: Share s of the layer's stiffness and mass that supports a ring about half as well as the whole layer. In rings of 0.1
#: to 0.3 mm it locates the edge within 0.005 of the radius; s = 1 (patches that are wide against the layer) puts the
#: edge 0.003 to 0.015 too far inwards.
HALFWAY = 0.3


@dataclass(frozen=True)
class MissingFluid(AnnulusTerm):
    """Gas in place of the fluid in an annulus.

    In a ring in which the share f of the area is gas,

        (1 / rho_f - 1 / rho) / w^2 grad(p) . grad(q) - (1 / K_f - 1 / K) p q,
        rho_f = h rho + (1 - h) rho_g,  K_f = h K + (1 - h) K_g,  K = rho c^2,
        h = s c / (1 - (1 - s) c),  c = 1 - f,  s = HALFWAY,

    in addition to `fluid.Fluid` on the same region. f = 1 is the gas itself, and exact if the mesh has a line of nodes
    at the edge; between two edges the law is an interpolation. s = 1 is the law of patches that are wide against the
    layer's thickness: the walls move each patch equally, so stiffnesses and masses per area add, and p is the mean
    stress. Parameters ``<annulus>.width`` (see `annulus.Annulus`), ``<material>.density`` and ``.sound_speed``,
    ``<gas>.density`` and ``.sound_speed``.
    """

    region: str
    material: str
    gas: str
    annulus: Annulus

    def integrals(self) -> tuple[Integral, ...]:
        densities = (("rho", f"{self.material}.density"), ("rho_g", f"{self.gas}.density"))
        speeds = (("c", f"{self.material}.sound_speed"), ("c_g", f"{self.gas}.sound_speed"))
        return (
            *(Integral(lightness, self.region, (Product("grad_p_r", "grad_p_r"), Product("grad_p_z", "grad_p_z")),
                       radius_fraction=edge)
              for edge, lightness in self.annulus.coefficients(_lightness, densities, -2)),
            *(Integral(squeezed, self.region, (Product("p", "p"),), radius_fraction=edge)
              for edge, squeezed in self.annulus.coefficients(_squeezed, (*densities, *speeds))),
        )


def _lightness(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """The difference 1 / rho_f - 1 / rho and its derivatives."""
    value, by_f, by_whole, by_gas = _mixed(v[SHARE], v["rho"], v["rho_g"])
    return value, {SHARE: by_f, "rho": by_whole, "rho_g": by_gas}


def _squeezed(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """The difference -(1 / K_f - 1 / K) and its derivatives."""
    stiff, soft = v["rho"] * v["c"] ** 2, v["rho_g"] * v["c_g"] ** 2
    value, by_f, by_whole, by_gas = _mixed(v[SHARE], stiff, soft)
    return -value, {SHARE: -by_f, "rho": -by_whole * v["c"] ** 2, "c": -by_whole * 2.0 * v["rho"] * v["c"],
                    "rho_g": -by_gas * v["c_g"] ** 2, "c_g": -by_gas * 2.0 * v["rho_g"] * v["c_g"]}


def _mixed(f: complex, whole: complex, gas: complex) -> tuple[complex, complex, complex, complex]:
    """A difference of inverse moduli and its derivatives. It is 1 / (h whole + (1 - h) gas) - 1 / whole. Its
    derivatives are by f, `whole` and `gas`."""
    lacks, slope = hindered(f, HALFWAY)
    mixed = (1.0 - lacks) * whole + lacks * gas
    return (1.0 / mixed - 1.0 / whole, slope * (whole - gas) / mixed**2,
            -(1.0 - lacks) / mixed**2 + 1.0 / whole**2, -lacks / mixed**2)
