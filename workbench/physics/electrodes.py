"""The two electrodes of the transducer: one grounded, one live at a common voltage."""

from __future__ import annotations

from dataclasses import dataclass

from workbench.physics.term import Condition, Term


@dataclass(frozen=True)
class ElectrodePotential(Term):
    """phi = 0 on the grounded electrode; phi = V, one unknown, on the live one.

    The charge of the live electrode is the work conjugate of V, that is the flux of the whole
    D = e eps + epsilon E (the paper's eq. 22 drops e eps).
    """

    live: str
    ground: str

    def conditions(self) -> tuple[Condition, ...]:
        return (Condition("phi", self.ground), Condition("phi", self.live, live=True))


@dataclass(frozen=True)
class ShortCircuit(Term):
    """phi = 0 on a ``boundary`` of a piezoelectric layer that is not driven: all of its surface is one electrode, at
    ground.

    Inside, the layer is piezoelectric in full: a wave whose field turns its sign across it is stiffened, one that is
    uniform over its thickness meets the stiffness at constant field. Without piezoelectric constants the potential is
    zero and the layer a transversely isotropic elastic solid.
    """

    boundary: str

    def conditions(self) -> tuple[Condition, ...]:
        return (Condition("phi", self.boundary),)
