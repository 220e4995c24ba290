"""An electrode that ends before the rim of the transducer: etched back, worn off, or never printed there.

It lowers the clamped capacitance by the share of the area that is bare, and stiffens the ring below, which is open; in
all states alike, the free disc included.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.physics.term import Admissible, Formula, Free, Integral, Product, Term, free_of

#: Share of the transducer's thickness, below the electrode, that cuts it off: thin beside a ring that shows.
SKIN = 0.01

#: A skin with so much of its permittivity hinders the field of a ring about half as much as one with none.
HALFWAY = 0.1

#: What can be bare of the face in a ring.
ADMISSIBLE: Mapping[str, Admissible] = {
    "bare_fraction": Admissible(0.0, 1.0, "1", "from a full ring to none of it"),
}


@dataclass(frozen=True)
class PartialElectrode(Term):
    """A face of the transducer that is bare beyond some radius.

        - q [eps(v) (e31, e33)^T d_z(phi) + d_z(psi) (e31, e33) eps(u)] + q eps33 d_z(psi) d_z(phi),
        1 - q = s c / (1 - (1 - s) c),  c = (1 - f_1) (1 - f_2) ... ,  s = HALFWAY,

    over a skin of the region that takes the share :data:`SKIN` of its thickness, next to `piezoelectric.Piezoelectric`
    on the same region. The electrode stays where it is, and what lies below it in the skin is taken away: all of it,
    f = 1, leaves D_z = 0 there, as air does beside a ceramic. An electrode that ends further in by 1.2 thicknesses of
    the skin does the same: field leaves its edge at an angle. The rings, one in the other, begin at the shares `beyond`
    of the region's radius, in rising order; c is what those leave that hold a point. An edge between the beginnings of
    two rings is a part, 0 < f < 1, of the wider one and all of the other. The mesh must have the skin
    (`geometry.mesh_size.MeshSize.skins`): the upper one or the lower one. Parameters ``<ring>.bare_fraction`` f (see
    :data:`ADMISSIBLE`), ``<material>.e31``, ``.e33`` and ``.eps33``.
    """

    region: str
    material: str
    beyond: tuple[float, ...]
    rings: tuple[str, ...]
    upper: bool

    def free(self) -> tuple[Free, ...]:
        return tuple(each for ring in self.rings for each in free_of(ring, ADMISSIBLE, {"bare_fraction": 0.0}))

    def integrals(self) -> tuple[Integral, ...]:
        bare = tuple((f"f{k}", f"{ring}.bare_fraction") for k, ring in enumerate(self.rings))
        return tuple(
            Integral(Formula(law, (*bare[: k + 1], ("constant", f"{self.material}.{constant}"))), self.region,
                     (product,), beyond=beyond, skin=SKIN if self.upper else -SKIN)
            for k, beyond in enumerate(self.beyond)
            for constant, law, product in (
                ("e31", _uncoupled, Product("strain_plane", "grad_phi_z", 2.0)),
                ("e33", _uncoupled, Product("strain_zz", "grad_phi_z", 2.0)),
                ("eps33", _insulating, Product("grad_phi_z", "grad_phi_z")),
            )
        )


def _uncoupled(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    return _taken(v, -1.0)


def _insulating(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    return _taken(v, VACUUM_PERMITTIVITY)


def _taken(v: Mapping[str, complex], scale: float) -> tuple[complex, Mapping[str, complex]]:
    """What the innermost of some rings takes of a constant beyond what those that hold it take, and derivatives."""
    *held, last = [name for name in v if name != "constant"]
    outside = _product(v, held)
    covered = outside * (1.0 - v[last])
    (before, slope_before), (after, slope_after) = _removed(outside), _removed(covered)
    value, slope = after - before, scale * v["constant"]
    by = {name: slope * (slope_before * _product(v, [n for n in held if n != name])
                         - slope_after * _product(v, [n for n in (*held, last) if n != name])) for name in held}
    return slope * value, {**by, last: -slope * slope_after * outside, "constant": scale * value}


def _product(v: Mapping[str, complex], names: list[str]) -> complex:
    """What those of these names leave."""
    covered = 1.0 + 0.0j
    for name in names:
        covered *= 1.0 - v[name]
    return covered


def _removed(covered: complex) -> tuple[complex, complex]:
    """q of what is covered, c, and dq / dc."""
    below = 1.0 - (1.0 - HALFWAY) * covered
    return (1.0 - covered) / below, -HALFWAY / below**2
