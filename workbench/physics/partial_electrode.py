"""An electrode that ends before the rim of the transducer: etched back, worn off, or never printed there.

It lowers the clamped capacitance by the bare share of the area, and stiffens the ring below, which is in open circuit.
It acts in all states alike, the free disc included.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.physics.rim import SHARE, OfRim, Rim, hindered
from workbench.physics.term import Integral, Product

#: Thickness of the insulating skin below the electrode, as a share of the transducer's: thin beside any ring that
#: shows.
SKIN = 0.01

#: Share of the skin's permittivity with which it hinders the field of a ring about half as much as a skin with none.
HALFWAY = 0.1


@dataclass(frozen=True)
class PartialElectrode(OfRim):
    """A face of the transducer that is bare outside the edge of a rim.

    In a ring of which the share f is bare,

        - q [eps(v) (e31, e33)^T d_z(phi) + d_z(psi) (e31, e33) eps(u)] + q eps33 d_z(psi) d_z(phi),
        1 - q = s c / (1 - (1 - s) c),  c = 1 - f,  s = HALFWAY,

    over a skin of the region that takes the share :data:`SKIN` of its thickness, next to `piezoelectric.Piezoelectric`
    on the same region. The electrode stays, and the coupling and permittivity of the skin below it are removed.
    Complete removal, f = 1, leaves D_z = 0 there, as air beside a ceramic does. Since the field leaves its edge at an
    angle, an electrode that ends 1.2 skin thicknesses further in has the same effect. The mesh must have the skin
    (`geometry.mesh_size.MeshSize.skins`): the upper one or the lower one. Parameters ``<rim>.width`` (see `rim.Rim`),
    ``<material>.e31``, ``.e33`` and ``.eps33``.
    """

    region: str
    material: str
    rim: Rim
    upper: bool

    def integrals(self) -> tuple[Integral, ...]:
        return tuple(
            Integral(coefficient, self.region, (product,), radius_fraction=edge, skin=SKIN if self.upper else -SKIN)
            for constant, law, product in (
                ("e31", _uncoupled, Product("strain_plane", "grad_phi_z", 2.0)),
                ("e33", _uncoupled, Product("strain_zz", "grad_phi_z", 2.0)),
                ("eps33", _insulating, Product("grad_phi_z", "grad_phi_z")),
            )
            for edge, coefficient in self.rim.coefficients(law, (("constant", f"{self.material}.{constant}"),))
        )


def _uncoupled(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    return _taken(v, -1.0)


def _insulating(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    return _taken(v, VACUUM_PERMITTIVITY)


def _taken(v: Mapping[str, complex], scale: float) -> tuple[complex, Mapping[str, complex]]:
    """The product of q and a constant, times `scale`, and its derivatives."""
    taken, slope = hindered(v[SHARE], HALFWAY)
    return scale * taken * v["constant"], {SHARE: scale * slope * v["constant"], "constant": scale * taken}
