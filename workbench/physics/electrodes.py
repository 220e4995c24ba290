"""The electrodes of the transducer: one grounded, one live at a common voltage or with parts at their own."""

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
        return (Condition("phi", self.ground), Condition("phi", self.live, 1.0))


@dataclass(frozen=True)
class SplitElectrode(Term):
    """Potentials of a live electrode in parts: phi = a V on it, -a V on its part ``reversed``, 0 on its part ``idle``.

    V is one unknown, the voltage of the drive, and a the ``share`` of it that a part has against ground. The work
    conjugate of V is the sum of the charges of the parts times their shares: V over the sum of the currents for a = 1
    (a centre-tapped transformer), and for a = 1/2 the current that an amplifier between two halves gives. Names of
    boundaries; None for a part that there is not.
    """

    live: str
    ground: str
    reversed: str | None
    idle: str | None
    share: float = 1.0

    def conditions(self) -> tuple[Condition, ...]:
        # The first condition on a node counts.
        parts = ((self.ground, 0.0), (self.idle, 0.0), (self.reversed, -self.share), (self.live, self.share))
        return tuple(Condition("phi", boundary, share) for boundary, share in parts if boundary is not None)


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
