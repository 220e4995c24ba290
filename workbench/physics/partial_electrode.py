"""An electrode that ends inside the edge of the transducer.

It may be etched back, worn off, or never printed there. It lowers the clamped capacitance by the bare share of the
area, and stiffens the annulus below, which is in open circuit. It acts equally in all states, the free disc included.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.physics.annulus import SHARE, Annulus, AnnulusTerm, hindered
from workbench.physics.term import Integral, Product

#: Thickness of the insulating skin below the electrode, as a share of the transducer's: thin against any visible
#: annulus.
SKIN = 0.01

#: Share of the skin's permittivity that blocks the field of a ring about half as well as a skin without permittivity.
HALFWAY = 0.1


@dataclass(frozen=True)
class PartialElectrode(AnnulusTerm):
    """A transducer face that is bare in an annulus.

    In a ring of which the share f is bare,

        - q [eps(v) (e31, e33)^T d_z(phi) + d_z(psi) (e31, e33) eps(u)] + q eps33 d_z(psi) d_z(phi),
        1 - q = s c / (1 - (1 - s) c),  c = 1 - f,  s = HALFWAY,

    over a skin with the share :data:`SKIN` of the region's thickness, in addition to `piezoelectric.Piezoelectric` on
    the same region. The electrode stays; the coupling and permittivity of the skin below it are removed. Complete
    removal, f = 1, gives D_z = 0 there, like air beside a ceramic. Since the field spreads at its edge, an electrode
    that ends 1.2 skin thicknesses further in has the same effect. The mesh must have the skin
    (`geometry.mesh_size.MeshSize.skins`): the upper one or the lower one. Parameters ``<annulus>.width`` (see
    `annulus.Annulus`), ``<material>.e31``, ``.e33`` and ``.eps33``.
    """

    region: str
    material: str
    annulus: Annulus
    upper: bool

    def integrals(self) -> tuple[Integral, ...]:
        return tuple(
            Integral(coefficient, self.region, (product,), radius_fraction=edge, skin=SKIN if self.upper else -SKIN)
            for constant, law, product in (
                ("e31", _uncoupled, Product("strain_plane", "grad_phi_z", 2.0)),
                ("e33", _uncoupled, Product("strain_zz", "grad_phi_z", 2.0)),
                ("eps33", _insulating, Product("grad_phi_z", "grad_phi_z")),
            )
            for edge, coefficient in self.annulus.coefficients(law, (("constant", f"{self.material}.{constant}"),))
        )


def _uncoupled(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    return _scaled(v, -1.0)


def _insulating(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    return _scaled(v, VACUUM_PERMITTIVITY)


def _scaled(v: Mapping[str, complex], scale: float) -> tuple[complex, Mapping[str, complex]]:
    """The product of q and a constant, times `scale`, and its derivatives."""
    removed, slope = hindered(v[SHARE], HALFWAY)
    return scale * removed * v["constant"], {SHARE: scale * slope * v["constant"], "constant": scale * removed}
