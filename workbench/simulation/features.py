"""The orders of a round chip, coupled by features beside its axis.

A rigid part on a small patch adds the dynamic stiffness d (-w^2 m of a mass m) times the square of the patch's mean
displacement l^T x. The chip without it has one system A_m for each order m, and only order 0 is driven. With the
compliance G, the sum over all orders of l^T A_m^-1 l, and the mean displacement y = l^T x_0 of the driven chip, the
charge changes by

    Q - Q_0 = y^T f ,    f = -(1 + D G)^-1 D y ,

with the forces f of the parts on their patches. Parts at several angles couple through cos and sin of m times their
differences. The sum over high orders is that of an elastic half-space, fitted to the last ones
(`workbench.fem.half_space`). Orders are added until this total stays.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.features import Feature
from workbench.fem.half_space import FITTED, HalfSpace, half_space_constants
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.patch import ALONG, AWAY, UP, Patch, patch_forms
from workbench.fem.solve import System
from workbench.jobs.progress import Progress, no_progress
from workbench.model.problem import Problem
from workbench.physics.orders import ORDER, terms_of_order
from workbench.reduced.response import response
from workbench.simulation.solved_spectrum import SolvedSpectrum

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Relative error of a compliance, and with it of the change of the charge by a part.
TOLERANCE = 1e-3

#: Most orders.
MOST_ORDERS = 200


class OrdersNotConverged(RuntimeError):
    """The sum over orders is not converged after :data:`MOST_ORDERS`."""


@dataclass(frozen=True)
class RigidPart:
    """A rigid part on a patch.

    The ``patch`` is at an ``angle`` (rad). The part has a ``mass`` (kg) and a ``stiffness`` (N/m) to a fixed point,
    complex with a loss, e^{-i w t}.
    """

    patch: Patch
    angle: float = 0.0
    mass: float = 0.0
    stiffness: complex = 0.0

    def dynamic_stiffness(self, frequencies: Real) -> Complex:
        """Force over displacement (n,) in N/m at frequencies (n,) in Hz."""
        return np.asarray(self.stiffness - (2.0 * np.pi * frequencies) ** 2 * self.mass)


def part_of(feature: Feature) -> RigidPart:
    """The rigid part of a chip's feature."""
    patch = Patch(feature.region, feature.face == "top", feature.distance, 0.5 * feature.diameter)
    return RigidPart(patch, feature.angle, feature.mass, feature.stiffness * (1.0 - 1j * feature.loss))


def spectrum_with(
    chip: Chip, parts: Sequence[RigidPart], posed: Problem, found: SolvedSpectrum, progress: Progress
) -> tuple[SolvedSpectrum, tuple[str, ...]]:
    """The spectrum with the `parts` of the chip's features, and findings.

    Raises
    ------
    NotConverged, ResponseNotConverged, OrdersNotConverged : see :func:`compliance_of`.
    """
    assert found.model is not None
    assert found.solution is not None
    driven = driven_displacements(found.model.full, parts, found.model.basis @ found.solution.states)
    between = compliance_of(posed, [part.patch for part in parts], np.array([part.angle for part in parts]),
                            found.frequency, progress=progress)
    change = charge_change(parts, found.frequency, driven, between.total)
    before, charge = found.impedance, found.solution.charge
    impedance = before * charge / (charge + change)
    changes = 100.0 * np.abs(np.log(impedance / before))
    at = int(changes.argmax())
    listed = "; ".join(map(str, chip.features))
    return replace(found, impedance=impedance), (
        f"{listed}: ln Z changes by {changes[at]:.3g} % at {found.frequency[at] / 1e6:.6g} MHz and less at the other "
        f"frequencies ({between.orders} orders, the last ones moved the compliance by {100.0 * between.moved:.1g} %)",
        "the fields of the section, energies, traps, heat and the modes of peaks are those of the chip without its "
        "features")


@dataclass(frozen=True, eq=False)
class Compliance:
    """The compliance between patches of a round chip.

    ``total`` (n, k, k) is the sum over all orders in m/N, by patch and direction (:func:`directions_of`). ``orders`` is
    the number of orders that were computed, ``moved`` the relative change of the total in the last ones, ``error`` the
    largest relative error of an order. ``fields`` are those of unit forces by order, if kept.
    """

    total: Complex
    orders: int
    moved: float
    error: float
    fields: tuple[Complex, ...] = ()


def directions_of(count: int) -> list[int]:
    """The directions in which `count` parts move. A single one does not move along the circumference."""
    return [AWAY, UP, ALONG] if count > 1 else [AWAY, UP]


def along_circumference(count: int) -> NDArray[np.bool_]:
    """Whether each motion (k,) of `count` parts is along the circumference."""
    return np.tile(np.array(directions_of(count)) == ALONG, count)


def driven_displacements(operators: FullOperators, parts: Sequence[RigidPart], states: Complex) -> list[Complex]:
    """The mean displacements (3, n) of the patch of each part.

    They are those of order 0 in `states` (size, n), in m at 1 V.
    """
    return [patch_forms(operators, part.patch, 0).T @ states for part in parts]


def compliance_of(
    posed: Problem, patches: Sequence[Patch], angles: Real, frequencies: Real, *, tolerance: float = TOLERANCE,
    keep: Callable[[FullOperators, Complex], Complex] | None = None, progress: Progress = no_progress,
) -> Compliance:
    """The compliance between patches at `angles` (rad) of a round chip.

    The frequencies (n,) are in Hz, and the `tolerance` is relative, at every frequency. At a single one, `keep` returns
    the part of the fields (size - 1, k) under unit forces that is kept of every order. Each force acts at the angle 0,
    and fields of those along the circumference vary with sin(m t) where the others vary with cos(m t).

    Raises
    ------
    NotConverged, ResponseNotConverged : a solve of an order fails.
    OrdersNotConverged : too many orders matter.
    """
    directions = directions_of(len(patches))
    size = len(directions)
    is_along = along_circumference(len(patches))
    turn = np.kron(angles[:, None] - angles, np.ones((size, size)))
    orders, total, error = _Orders(posed, patches, directions, frequencies, tolerance, keep), 0.0, 0.0
    space = HalfSpace.of(patches, angles) if any(patch.distance for patch in patches) else None
    last, spaces, sums, fields = list[Complex](), list[Real](), list[Complex](), list[Complex]()
    for order in range(MOST_ORDERS):
        own, off, kept = orders.compliance(order)
        fields += [] if kept is None else [kept]
        # Fields of forces along the circumference have the other parity.
        factor = np.where(is_along[:, None] == is_along, np.cos(order * turn),
                          np.where(is_along, 1.0, -1.0) * np.sin(order * turn))
        total, error = total + own * factor, max(error, off)
        progress("orders of the features", order / (order + 20.0))
        if space is None:
            if order == 1:
                # Patches about the axis move with the first two orders alone.
                return Compliance(np.asarray(total), 2, 0.0, error, tuple(fields))
            continue
        last = [*last[1 - FITTED:], np.diagonal(own, axis1=1, axis2=2)]
        spaces = [*spaces[1 - FITTED:], np.repeat(np.diagonal(space.order(order), axis1=1, axis2=2), size, axis=1)]
        space = space.without(order)
        if order < FITTED:
            continue
        constants = half_space_constants(np.array(last), np.array(spaces))
        pairs = 0.5 * (constants[:, :, :, None] + constants[:, :, None])
        sums = [*sums[-FITTED:], total + np.einsum("pnij,pij->nij", pairs, np.kron(space.total, np.eye(size)))]
        moved = max(float((np.linalg.norm(sums[-1] - each, axis=(1, 2)) / np.linalg.norm(sums[-1], axis=(1, 2))).max())
                    for each in sums)
        if len(sums) > FITTED and moved <= tolerance:
            return Compliance(sums[-1], order + 1, moved, error, tuple(fields))
    raise OrdersNotConverged(f"the total of {MOST_ORDERS} orders still moves by {moved:.1e}")


def charge_change(parts: Sequence[RigidPart], frequencies: Real, driven: Sequence[Complex], total: Complex) -> Complex:
    """The change of the charge (n,) by rigid `parts`.

    It is in C at 1 V. See :func:`forces_of` for the arguments.
    """
    y = np.vstack([each[directions_of(len(parts))] for each in driven])
    return np.asarray(np.einsum("in,ni->n", y, forces_of(parts, frequencies, driven, total)))


def forces_of(parts: Sequence[RigidPart], frequencies: Real, driven: Sequence[Complex], total: Complex) -> Complex:
    """The forces (n, k) of rigid `parts` on their patches.

    They are in N at 1 V. `driven` are the mean displacements (3, n) in m at 1 V of the patch of each part, without the
    parts, and `total` is the compliance of the patches.
    """
    directions = directions_of(len(parts))
    y = np.vstack([each[directions] for each in driven]).T
    d = np.repeat(np.array([part.dynamic_stiffness(frequencies) for part in parts]), len(directions), axis=0).T
    coupling = np.eye(y.shape[1]) + d[:, :, None] * total
    return np.asarray(-np.linalg.solve(coupling, (d * y)[:, :, None])[:, :, 0])


@dataclass(frozen=True, eq=False)
class _Orders:
    """The compliances of patches in some directions, by order."""

    posed: Problem
    patches: Sequence[Patch]
    directions: list[int]
    frequencies: Real
    tolerance: float
    keep: Callable[[FullOperators, Complex], Complex] | None

    def compliance(self, order: int) -> tuple[Complex, float, Complex | None]:
        """The compliance (n, k, k) of an order at equal angles.

        Its relative error and the fields to keep follow.
        """
        found, error, kept = self._part(order, self._operators(order))
        if order == 0 and ALONG in self.directions:
            # Torsion: fields along s that do not vary along it. Their mean square is one, not a half.
            torsion, off, _ = self._part(0, self._operators(2), is_torsion=True)
            return found + 0.5 * torsion, max(error, off), kept
        return found, error, kept

    def _part(
        self, order: int, operators: FullOperators, *, is_torsion: bool = False
    ) -> tuple[Complex, float, Complex | None]:
        system = System(operators, {**self.posed.values, ORDER: float(order)})
        forms = np.hstack([patch_forms(operators, patch, order)[:, self.directions] for patch in self.patches])
        is_along = along_circumference(len(self.patches))
        acting = forms.any(axis=0) & (is_along == is_torsion if order == 0 else True)
        result = np.zeros((self.frequencies.size, acting.size, acting.size), dtype=complex)
        fields = np.zeros((operators.size - 1, acting.size), dtype=complex)
        error, at = 0.0, np.flatnonzero(acting)
        if at.size:
            found = response(system, forms[:, acting], self.frequencies, self.tolerance)
            result[:, at[:, None], at], error = found.compliance, found.error
            fields[:, at] = found.fields(0)
        return result, error, None if self.keep is None else self.keep(operators, fields)

    def _operators(self, order: int) -> FullOperators:
        return self._assembled[min(order, 2)]

    @cached_property
    def _assembled(self) -> tuple[FullOperators, ...]:
        """The operators of order 0, of the first and of higher ones."""
        return tuple(assemble(self.posed.mesh, terms) for terms in (self.posed.terms, *(
            terms_of_order(self.posed.terms, is_first=is_first) for is_first in (True, False))))
