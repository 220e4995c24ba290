"""The two electrodes of the transducer: one grounded, one live at a common voltage."""

from __future__ import annotations

from dataclasses import dataclass

from workbench.physics.term import Condition, Term


@dataclass(frozen=True)
class ElectrodePotential(Term):
    """Potentials of the electrodes: phi = 0 on the grounded one; phi = V, one unknown, on the live one.

    The charge of the live electrode is the work conjugate of V, that is the flux of the whole D = e eps + epsilon E
    (the paper's eq. 22 drops e eps).
    """

    live: str
    ground: str

    def conditions(self) -> tuple[Condition, ...]:
        return (Condition("phi", self.ground), Condition("phi", self.live, live=True))


@dataclass(frozen=True)
class ShortCircuit(Term):
    """Potential zero on a ``boundary`` of a piezoelectric layer that is not driven: its whole surface is one grounded
    electrode.

    Inside, the layer is fully piezoelectric: a wave whose field changes its sign across the layer is stiffened, and one
    that is uniform over the thickness meets the stiffness at constant field. Without piezoelectric constants the
    potential is zero and the layer is a transversely isotropic elastic solid.
    """

    boundary: str

    def conditions(self) -> tuple[Condition, ...]:
        return (Condition("phi", self.boundary),)
