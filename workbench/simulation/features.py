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
from geometry.dimension import millimetres
from geometry.features import Feature
from geometry.panels import CLOSEST_RADII
from workbench.fem.gap import BESIDE_EDGE, Gap, gap_forms, prescribing
from workbench.fem.half_space import FITTED, HalfSpace, half_space_constants, order_factors
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.patch import ALONG, AWAY, UP, Patch, patch_forms
from workbench.fem.solve import System
from workbench.files.errors import InputError
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


@dataclass(frozen=True)
class ElectrodeGap:
    """A gap in an electrode at an ``angle`` (rad)."""

    patch: Gap
    angle: float = 0.0

    def dynamic_stiffness(self, frequencies: Real) -> Complex:
        """One (n,): the charges in a gap are zero, at any potential."""
        return np.ones(frequencies.size, dtype=complex)


#: A feature of the model.
Part = RigidPart | ElectrodeGap


def part_of(feature: Feature) -> Part:
    """The rigid part of a chip's feature, or its gap."""
    if feature.kind == "gap":
        gap = Gap(feature.region, feature.face == "top", feature.distance, 0.5 * feature.diameter)
        return ElectrodeGap(gap, feature.angle)
    patch = Patch(feature.region, feature.face == "top", feature.distance, 0.5 * feature.diameter)
    return RigidPart(patch, feature.angle, feature.mass, feature.stiffness * (1.0 - 1j * feature.loss))


def mesh_lines(chip: Chip, parts: Sequence[Part]) -> tuple[list[float], list[float]]:
    """Radii and heights (m) of the lines of nodes for features.

    Raises
    ------
    InputError : a gap is too small for the lines about its edge.
    """
    radii, levels, outer = set[float](), set[float](), max(layer.outer_radius for layer in chip.layers)
    for i, (feature, part) in enumerate(zip(chip.features, parts, strict=True)):
        radii |= set(part.patch.radii)
        if isinstance(part, ElectrodeGap):
            least, edges = CLOSEST_RADII * outer, part.patch.edges(CLOSEST_RADII * outer)
            if not edges:
                smallest = 2.0 * least / BESIDE_EDGE[0]
                raise InputError(chip.file, f"features[{i}].diameter", millimetres(feature.diameter),
                                 f"above {millimetres(smallest)}: the mesh of a section with a radius of "
                                 f"{millimetres(outer)} has no finer lines")
            radii |= set(edges)
            layer = next(layer for layer in chip.layers if layer.region == feature.region)
            for share in BESIDE_EDGE:
                depth = min(share * part.patch.radius, 0.5 * layer.thickness.value)
                levels.add(layer.z_top - depth if feature.face == "top" else layer.z_bottom + depth)
    return sorted(radius for radius in radii if radius < outer), sorted(levels)


def spectrum_with(
    chip: Chip, parts: Sequence[Part], posed: Problem, found: SolvedSpectrum, progress: Progress
) -> tuple[SolvedSpectrum, tuple[str, ...]]:
    """The spectrum with the `parts` of the chip's features, and findings.

    Raises
    ------
    NotConverged, ResponseNotConverged, OrdersNotConverged : see :func:`compliance_of`.
    """
    assert found.model is not None
    assert found.solution is not None
    driven = driven_on(posed, found.model.full, parts, found.model.basis @ found.solution.states, found.frequency)
    between = compliance_of(posed, [part.patch for part in parts], np.array([part.angle for part in parts]),
                            found.frequency, progress=progress)
    change = charge_change(parts, found.frequency, driven, between.total)
    charge = found.solution.charge
    changed = replace(found, impedance=found.impedance * charge / (charge + change))
    listed = "; ".join(map(str, chip.features))
    return changed, (
        f"{listed}: {changed.change_from(found)} ({between.orders} orders, the last ones moved the compliance by "
        f"{100.0 * between.moved:.1g} %)",
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


#: The direction of the potentials of a gap, besides those of :class:`~workbench.fem.patch.Patch`.
POTENTIAL = 3


def directions_of(patches: Sequence[Patch]) -> NDArray[np.int64]:
    """The directions (k,) in which `patches` move. A single one does not move along the circumference."""
    return np.concatenate([[POTENTIAL] * rows_of(patch, patches).size if isinstance(patch, Gap)
                           else rows_of(patch, patches) for patch in patches])


def rows_of(patch: Patch, patches: Sequence[Patch]) -> NDArray[np.int64]:
    """The directions of one of the `patches`, or its functions.

    Those with the sine do not occur in a single gap.
    """
    if isinstance(patch, Gap):
        return np.arange(sum(len(patches) > 1 or not is_sine for *_, is_sine in patch.functions))
    return np.array([AWAY, UP, ALONG] if len(patches) > 1 else [AWAY, UP])


def owners_of(patches: Sequence[Patch]) -> NDArray[np.int64]:
    """The patch (k,) of every direction."""
    return np.repeat(np.arange(len(patches)), [rows_of(patch, patches).size for patch in patches])


def is_odd_of(patches: Sequence[Patch]) -> NDArray[np.bool_]:
    """Whether fields of each direction (k,) are odd.

    They then have the parity of those along the circumference.
    """
    return np.concatenate([np.array([is_sine for *_, is_sine in patch.functions])[rows_of(patch, patches)]
                           if isinstance(patch, Gap) else rows_of(patch, patches) == ALONG for patch in patches])


def driven_displacements(operators: FullOperators, parts: Sequence[Part], states: Complex) -> list[Complex]:
    """The mean displacements (3, n) of the patch of each part.

    They are those of order 0 in `states` (size, n), in m at 1 V.
    """
    return [patch_forms(operators, part.patch, 0).T @ states for part in parts]


def driven_on(
    posed: Problem, operators: FullOperators, parts: Sequence[Part], states: Complex, frequencies: Real
) -> list[Complex]:
    """The mean displacements (3, n) of patches, or charges of gaps.

    Charges (k, n) are by function. They are those of order 0 in `states` (size, n) at frequencies (n,) in Hz, per V.
    """
    own = prescribing(operators, [part.patch for part in parts if isinstance(part, ElectrodeGap)])
    system, held = System(own, posed.values), np.flatnonzero(own.numbering["phi"] >= operators.size - 1)
    # Circles of the gap have the potential of the electrode.
    before = operators.numbering["phi"][held]
    share = operators.shares.get("phi", np.ones(operators.numbering["phi"].size))[held]
    whole = np.vstack([states[:-1], np.zeros((own.prescribed, states.shape[1]))])
    whole[own.numbering["phi"][held]] = np.where(before >= 0, share, 0.0)[:, None] * states[-1]
    whole[-1] = states[-1]
    result = []
    for part in parts:
        if isinstance(part, RigidPart):
            result += driven_displacements(operators, [part], states)
            continue
        forms = gap_forms(own, part.patch, 0)
        result.append(-sum(factor * (group.times(forms).T @ whole)
                           for factor, group in zip(system.factors(frequencies), system.groups, strict=True)))
    return result


def compliance_of(
    posed: Problem, patches: Sequence[Patch], angles: Real, frequencies: Real, *, tolerance: float = TOLERANCE,
    keep: Callable[[FullOperators, Complex], Complex] | None = None, progress: Progress = no_progress,
) -> Compliance:
    """The compliance between patches at `angles` (rad) of a round chip.

    The frequencies (n,) are in Hz, and the `tolerance` is relative, at every frequency. At a single one, `keep` returns
    the part of the fields (free, k) under unit forces that is kept of every order. Each force acts at the angle 0,
    and fields of those along the circumference vary with sin(m t) where the others vary with cos(m t).

    Raises
    ------
    NotConverged, ResponseNotConverged : a solve of an order fails.
    OrdersNotConverged : too many orders matter.
    """
    directions, is_odd, owners = directions_of(patches), is_odd_of(patches), owners_of(patches)
    orders, error = _Orders(posed, patches, frequencies, tolerance, keep), 0.0
    total: Complex = np.zeros((frequencies.size, owners.size, owners.size), dtype=complex)
    space = HalfSpace.of(patches, angles) if any(patch.distance for patch in patches) else None
    # The rows of the half-space; motions in several directions have equal ones.
    first = np.cumsum([0, *(len(patch.functions) if isinstance(patch, Gap) else 1 for patch in patches)])
    at = np.concatenate([first[k] + (rows_of(patch, patches) if isinstance(patch, Gap) else 0 * rows_of(patch, patches))
                         for k, patch in enumerate(patches)])
    is_same = directions[:, None] == directions
    is_gap, is_kept, held = directions == POTENTIAL, np.zeros(owners.size, dtype=bool), np.zeros((), dtype=complex)
    # Patches about the axis move with few orders.
    most = max(max(q for _, q, _ in patch.functions) if isinstance(patch, Gap) else 1 for patch in patches)
    last, spaces, sums, fields = list[Complex](), list[Real](), list[Complex](), list[Complex]()
    for order in range(MOST_ORDERS):
        own, off, kept = orders.compliance(order)
        fields += [] if kept is None else [kept]
        total, error = total + own * order_factors(order, angles[owners], is_odd), max(error, off)
        progress("orders of the features", order / (order + 20.0))
        if space is None:
            if order == most:
                return Compliance(np.asarray(total), most + 1, 0.0, error, tuple(fields))
            continue
        last = [*last[1 - FITTED:], np.diagonal(own, axis1=1, axis2=2)]
        spaces = [*spaces[1 - FITTED:], np.diagonal(space.order(order), axis1=1, axis2=2)[:, at]]
        space = space.without(order)
        if order < FITTED:
            continue
        constants = half_space_constants(np.array(last), np.array(spaces))
        pairs = 0.5 * (constants[:, :, :, None] + constants[:, :, None])
        sums = [*sums[-FITTED:], total + np.einsum("pnij,pij->nij", pairs, is_same * space.total[:, at[:, None], at])]
        # A gap keeps its converged sum: the mesh is too coarse for its potentials in orders that a part may need.
        sums[-1] = held = np.where(is_kept[:, None] & is_kept, held, sums[-1])
        if len(sums) > FITTED:
            is_kept = is_kept | np.isin(owners, [owner for owner in set(owners[is_gap & ~is_kept].tolist())
                                                 if _moved(sums, owners == owner) <= tolerance])
        moved = _moved(sums, np.ones(owners.size, dtype=bool))
        if len(sums) > FITTED and moved <= tolerance:
            return Compliance(sums[-1], order + 1, moved, error, tuple(fields))
    raise OrdersNotConverged(f"the total of {MOST_ORDERS} orders still moves by {moved:.1e}")


def _moved(sums: Sequence[Complex], some: NDArray[np.bool_]) -> float:
    """The relative change of the compliance in the last sums.

    It is that between some directions (k,).
    """
    last, *before = [each[:, some][:, :, some] for each in reversed(sums)]
    size = np.linalg.norm(last, axis=(1, 2))
    return max((float((np.linalg.norm(last - each, axis=(1, 2)) / size).max()) for each in before), default=0.0)


def charge_change(parts: Sequence[Part], frequencies: Real, driven: Sequence[Complex], total: Complex) -> Complex:
    """The change of the charge (n,) by rigid `parts`.

    It is in C at 1 V. See :func:`forces_of` for the arguments.
    """
    y = _all_driven(parts, driven)
    return np.asarray(np.einsum("in,ni->n", y, forces_of(parts, frequencies, driven, total)))


def forces_of(parts: Sequence[Part], frequencies: Real, driven: Sequence[Complex], total: Complex) -> Complex:
    """The forces (n, k) of rigid `parts`, and potentials of gaps.

    They are in N, or in units of `workbench.fem.gap`, at 1 V. `driven` are the mean displacements (3, n) in m at 1 V of
    the patch of each part, without the parts, and the charges of gaps. `total` is the compliance of the patches.
    """
    owners = owners_of([part.patch for part in parts])
    d = np.array([part.dynamic_stiffness(frequencies) for part in parts])[owners].T
    own = np.diag(np.array([isinstance(part, RigidPart) for part in parts])[owners].astype(float))
    coupling = own + d[:, :, None] * total
    return np.asarray(-np.linalg.solve(coupling, (d * _all_driven(parts, driven).T)[:, :, None])[:, :, 0])


def _all_driven(parts: Sequence[Part], driven: Sequence[Complex]) -> Complex:
    """Displacements and charges (k, n) of the parts in all directions."""
    patches = [part.patch for part in parts]
    return np.vstack([each[rows_of(patch, patches)] for patch, each in zip(patches, driven, strict=True)])


@dataclass(frozen=True, eq=False)
class _Orders:
    """The compliances of patches in some directions, by order."""

    posed: Problem
    patches: Sequence[Patch]
    frequencies: Real
    tolerance: float
    keep: Callable[[FullOperators, Complex], Complex] | None

    def compliance(self, order: int) -> tuple[Complex, float, Complex | None]:
        """The compliance (n, k, k) of an order at equal angles.

        Its relative error and the fields to keep follow.
        """
        found, error, kept = self._part(order, self._operators(order))
        if order == 0 and ALONG in directions_of(self.patches):
            # Torsion: fields along s that do not vary along it. Their mean square is one, not a half.
            torsion, off, _ = self._part(0, self._operators(2), is_torsion=True)
            return found + 0.5 * torsion, max(error, off), kept
        return found, error, kept

    def _part(
        self, order: int, operators: FullOperators, *, is_torsion: bool = False
    ) -> tuple[Complex, float, Complex | None]:
        system = System(operators, {**self.posed.values, ORDER: float(order)})
        forms = np.hstack([(gap_forms(operators, patch, order) if isinstance(patch, Gap) else patch_forms(
            operators, patch, order))[:, rows_of(patch, self.patches)] for patch in self.patches])
        acting = forms.any(axis=0) & (is_odd_of(self.patches) == is_torsion if order == 0 else True)
        result = np.zeros((self.frequencies.size, acting.size, acting.size), dtype=complex)
        fields = np.zeros((operators.free, acting.size), dtype=complex)
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
        gaps = [patch for patch in self.patches if isinstance(patch, Gap)]
        return tuple(prescribing(assemble(self.posed.mesh, terms), gaps) for terms in (self.posed.terms, *(
            terms_of_order(self.posed.terms, is_first=is_first) for is_first in (True, False))))
