"""Potentials of the transducer's electrodes: grounded, live, split or short-circuited."""

from __future__ import annotations

from dataclasses import dataclass

from workbench.physics.term import Condition, Term


@dataclass(frozen=True)
class ElectrodePotential(Term):
    """Potentials of the electrodes.

    phi = 0 on the grounded electrode; phi = V, one unknown, on the live one. The charge of the live electrode is the
    work conjugate of V, the flux of D = e eps + epsilon E (the paper's eq. 22 omits e eps).
    """

    live: str
    ground: str

    def conditions(self) -> tuple[Condition, ...]:
        return (Condition("phi", self.ground), Condition("phi", self.live, 1.0))


@dataclass(frozen=True)
class SplitElectrode(Term):
    """Potentials of a live electrode in parts.

    phi = a V on it, -a V on its part ``reversed``, 0 on its part ``idle``. V is one unknown, the voltage of the drive,
    and a the ``share`` of it on a part against ground. The work conjugate of V is the sum of the charges of the parts
    times their shares: V over the sum of the currents for a = 1 (a centre-tapped transformer), and for a = 1/2 the
    current of an amplifier between two halves. A part is None if it does not exist.
    """

    live: str
    ground: str
    reversed: str | None
    idle: str | None
    share: float = 1.0

    def conditions(self) -> tuple[Condition, ...]:
        # The first condition on a node applies.
        parts = ((self.ground, 0.0), (self.idle, 0.0), (self.reversed, -self.share), (self.live, self.share))
        return tuple(Condition("phi", boundary, share) for boundary, share in parts if boundary is not None)


@dataclass(frozen=True)
class ShortCircuit(Term):
    """Zero potential on the ``boundary`` of a piezoelectric layer without drive.

    Its whole surface is one grounded electrode. Inside, the layer is fully piezoelectric: a wave whose field changes
    its sign across the layer is stiffened; a wave that is uniform over the thickness meets the stiffness at constant
    field. Without piezoelectric constants the potential is zero and the layer is a transversely isotropic elastic
    solid.
    """

    boundary: str

    def conditions(self) -> tuple[Condition, ...]:
        return (Condition("phi", self.boundary),)
