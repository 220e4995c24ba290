"""Conditions at the lines where a section ends. These are the axis or planes of symmetry.

On the axis, u_r is zero. At a plane of symmetry, the fields of the other half are mirror images: with even parity, all
scalars and the displacement along the plane are equal on both sides and u_x changes its sign; with odd parity, as
between electrodes at +V and -V, all signs are opposite.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from geometry.measure import Axisymmetric, Measure, Parity
from geometry.names import AXIS
from workbench.physics.term import Condition

#: The components that are zero at a plane of symmetry; the others have zero slope across it.
ZERO_AT_PLANE: Mapping[Parity, tuple[str, ...]] = {
    Parity.EVEN: ("u_r",), Parity.ODD: ("u_z", "phi", "p", "u_s"), Parity.NONE: ()}


def conditions_at_ends(
    stated: Iterable[Condition], measure: Measure, boundaries: Iterable[str]
) -> tuple[Condition, ...]:
    """The conditions of terms, with those at the ends of a section.

    A term states u_r = 0 on the axis. Without an axis among the `boundaries`, that condition is dropped. Planes of
    symmetry of a straight section have conditions of their own. Odd planes come first, since the electrodes do not
    reach them.
    """
    kept = list(dict.fromkeys(stated))
    if AXIS not in boundaries:
        kept = [condition for condition in kept if condition.boundary != AXIS]
    if isinstance(measure, Axisymmetric):
        return tuple(kept)
    return (*(Condition(component, plane) for plane, parity in measure.planes.items()
              for component in ZERO_AT_PLANE[parity]), *kept)
