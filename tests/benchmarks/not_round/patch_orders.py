"""The change of a round chip's spectrum by a rigid part, wherever it is and whatever the constants are.

The closed form is that of `workbench.simulation.features`. A search evaluates it hundreds of times: each order is
projected once on the fields under forces on all patches, and the small models follow the constants of the materials.
High orders are those of an elastic half-space, at the constants of the projection.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from workbench.fem.dense import chebyshev
from workbench.fem.half_space import FITTED, HalfSpace, half_space_constants
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.patch import AWAY, UP, Patch, patch_forms
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.solve import Solution, System, krylov, one_thread, solve_reduced
from workbench.model.problem import Problem
from workbench.physics.orders import ORDER, terms_of_order
from workbench.simulation.features import OrdersNotConverged

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Frequencies of a band that are factorised, mixtures of the loads whose Krylov vectors are added there, and the number
#: of these from each.
FACTORISED, MIXED, DEPTH = 3, 3, 8

#: Part of a vector outside the basis that is left out, relative to its own: a compliance is off by its square.
DEPENDENT = 1e-4

#: Relative change of every compliance by an order at which the sum ends, and the most orders.
TOLERANCE, MOST_ORDERS = 5e-3, 120

#: Relative change of frequency that an order without resonances does not notice, within the tolerance times it.
NEAR = 0.02


@dataclass(frozen=True, eq=False)
class _Order:
    """One order on a small basis. ``loads`` (k, r, 2) are the forms of the patches ``which`` (k,) there."""

    number: int
    operators: ReducedOperators
    loads: Real
    which: NDArray[np.int64]

    def at(self, values: Mapping[str, complex], frequencies: Real) -> _OrderAt:
        """The order at `values` of the constants, diagonalised about the middle of the frequencies (n,).

        Raises
        ------
        ValueError : the model is not one of stiffness and mass alone.
        """
        groups = self.operators.coefficients.groups(2.0 * np.pi * frequencies, {**values, ORDER: float(self.number)})
        if len(groups) != 2:
            raise ValueError(f"order {self.number}: {len(groups)} functions of frequency; expected stiffness and mass")
        rank = self.loads.shape[1]
        first, second = self.operators.combinations(np.array([constants for _, constants in groups]))[:, :rank, :rank]
        factors = np.array([h for h, _ in groups])
        middle = complex(np.median((factors[1] / factors[0]).real))
        whole = scipy.linalg.lu_factor(first + middle * second, check_finite=False)
        roots, vectors = np.linalg.eig(scipy.linalg.lu_solve(whole, middle * second, check_finite=False))
        count, _, width = self.loads.shape
        right = scipy.linalg.lu_solve(whole, self.loads.transpose(1, 0, 2).reshape(rank, -1) + 0j, check_finite=False)
        inside = np.linalg.solve(vectors, right).reshape(-1, count, width)
        works = np.einsum("kri,rm,mkj->kijm", self.loads, vectors, inside, optimize=True)
        return _OrderAt(self, groups[0][0].real[0], float(np.median(frequencies**2)), roots, works)


@dataclass(frozen=True, eq=False)
class _OrderAt:
    """One order at values of the constants, by its eigenvectors.

    The pencil is the ``scale`` times K - f^2 M, diagonalised at the square ``middle`` (Hz^2): (1 + s L) with s = f^2 /
    middle - 1. ``works`` (k, 2, 2, roots) are the parts of the compliances.
    """

    order: _Order
    scale: float
    middle: float
    roots: Complex
    works: Complex

    def compliance(self, frequencies: Real, only: NDArray[np.int64]) -> Complex:
        """The compliances (n, k, 2, 2) of `only` some (k,) of its patches, each alone."""
        damped = 1.0 / (1.0 + np.outer(self.roots, frequencies**2 / self.middle - 1.0))
        return np.asarray((self.works[only] @ (damped / self.scale)).transpose(3, 0, 1, 2))


@dataclass(frozen=True, eq=False)
class PatchOrders:
    """The compliances of patches of one round chip, and the displacements of the driven chip there.

    ``patches`` (k,) are alternatives: only one of them carries a part. ``orders`` are projected at the constants of
    ``problem``; ``high`` (n, k, 2, 2) is the compliance of all higher ones at ``frequencies`` (n,) in Hz, and ``local``
    (n, k, 2) that of a half-space for the wave number 1/m.
    """

    problem: Problem
    patches: tuple[Patch, ...]
    frequencies: Real
    orders: tuple[_Order, ...]
    high: Complex
    local: Complex

    @classmethod
    def of(cls, problem: Problem, patches: Sequence[Patch], frequencies: Real) -> PatchOrders:
        """The orders of a chip, until their sum over each patch has converged.

        Raises
        ------
        NotConverged : a solve fails.
        OrdersNotConverged : too many orders matter.
        """
        with one_thread():
            return _converged(problem, tuple(patches), frequencies)

    def at(self, values: Mapping[str, complex]) -> PatchConstants:
        """The orders at `values` of the constants; others are those of the problem."""
        every = {**self.problem.values, **{k: v for k, v in values.items() if k in self.problem.values}}
        with one_thread():
            return PatchConstants(self, tuple(each.at(every, self.frequencies) for each in self.orders),
                                  solve_reduced(self.orders[0].operators, self.frequencies, {**every, ORDER: 0.0}))


@dataclass(frozen=True, eq=False)
class PatchConstants:
    """The orders of a chip at values of its constants, and the ``driven`` states of order 0."""

    model: PatchOrders
    orders: tuple[_OrderAt, ...]
    driven: Solution

    def response(self, shift: float = 0.0, place: float | None = None) -> PatchResponse:
        """The response of the chip whose compliances lie higher by a relative `shift` of frequency.

        It is that of all patches (k,), or of one at a `place` between them, an index: a parabola through the nearest
        three.
        """
        frequencies = self.model.frequencies / (1.0 + shift)
        count = len(self.model.patches)
        first = 0 if place is None else min(max(round(place) - 1, 0), count - 3)
        chosen = np.arange(count) if place is None else np.arange(first, first + 3)
        total = self.model.high[:, chosen]
        for each in self.orders:
            here = np.flatnonzero(np.isin(each.order.which, chosen))
            if here.size:
                total[:, np.isin(chosen, each.order.which)] += each.compliance(frequencies, here)
        displacements = np.einsum("kri,rn->nki", self.model.orders[0].loads[chosen], self.driven.states[:-1])
        radii = np.array([self.model.patches[k].radius for k in chosen])[:, None]
        local = 16.0 / (3.0 * np.pi) / radii * self.model.local[:, chosen]
        if place is not None:
            apart = place - first - 1.0
            weights = np.array([[0.5 * apart * (apart - 1.0), 1.0 - apart**2, 0.5 * apart * (apart + 1.0)]])
            total = np.einsum("ak,nkij->naij", weights, total)
            displacements, local = (np.einsum("ak,nki->nai", weights, each) for each in (displacements, local))
        return PatchResponse(self.model.frequencies, total, local, displacements, self.driven.charge)


@dataclass(frozen=True, eq=False)
class PatchResponse:
    """The response of a chip at patches, at ``frequencies`` (n,) in Hz and e^{-i w t}.

    ``compliance`` (n, k, 2, 2) in m/N, ``displacements`` (n, k, 2) in m at 1 V of the driven chip, by the directions
    away from the axis and up; ``charge`` (n,) in C at 1 V. ``local`` (n, k, 2) is the part of the compliance that goes
    with one over the radius of the patch: the mean displacement of a half-space under a uniform pressure.
    """

    frequencies: Real
    compliance: Complex
    local: Complex
    displacements: Complex
    charge: Complex

    def log_change(self, dynamic_stiffness: Complex, size: float = 1.0) -> Complex:
        """The change (n, k) of ln Z, e^{-i w t}, by a part on each patch.

        `dynamic_stiffness` (n,) is in N/m; the radius of the part is `size` times that of the patch.
        """
        d = dynamic_stiffness[:, None, None]
        compliance = self.compliance + ((1.0 / size - 1.0) * self.local)[..., None] * np.eye(2)
        coupling = np.eye(2) + d[..., None] * compliance
        forces = -np.linalg.solve(coupling, (d * self.displacements)[..., None])[..., 0]
        change = np.sum(self.displacements * forces, axis=-1)
        return np.asarray(-np.log1p(change / self.charge[:, None]))


def _converged(problem: Problem, patches: tuple[Patch, ...], frequencies: Real) -> PatchOrders:
    """See :meth:`PatchOrders.of`."""
    assembled = [assemble(problem.mesh, problem.terms), *(
        assemble(problem.mesh, terms_of_order(problem.terms, is_first=is_first)) for is_first in (True, False))]
    open_ones, high = [_Sum.of(patch, k) for k, patch in enumerate(patches)], dict[int, tuple[Complex, Complex]]()
    orders = list[_Order]()
    for number in range(MOST_ORDERS):
        which = np.array([each.index for each in open_ones])
        orders.append(_order(problem, assembled[min(number, 2)], patches, which, frequencies, number))
        own = orders[-1].at(problem.values, frequencies).compliance(frequencies, np.arange(which.size))
        for place, each in enumerate(open_ones):
            each.add(number, own[:, place])
        high.update({each.index: (each.rest, each.local) for each in open_ones if each.has_converged})
        open_ones = [each for each in open_ones if each.index not in high]
        if not open_ones:
            rest, local = (np.stack([high[k][part] for k in range(len(patches))], axis=1) for part in (0, 1))
            return _with_few(PatchOrders(problem, patches, frequencies, tuple(orders), rest, local))
    raise OrdersNotConverged(f"the compliance of {len(open_ones)} of {len(patches)} patches still moves by more than "
                             f"{TOLERANCE} after {MOST_ORDERS} orders")


def _with_few(found: PatchOrders) -> PatchOrders:
    """The orders from which on none has a resonance near the band are added to the high ones, as they are."""
    frequencies, values = found.frequencies, found.problem.values
    each = [(order, order.at(values, frequencies)) for order in found.orders]
    every = [np.arange(order.which.size) for order in found.orders]
    here, there = ([at.compliance(f, which) for (_, at), which in zip(each, every, strict=True)]
                   for f in (frequencies, frequencies * (1.0 + NEAR)))
    size = np.abs(found.high + sum(_placed(found, order, own) for (order, _), own in zip(each, here, strict=True)))
    moved = [float((np.abs(_placed(found, order, b - a)) / size.max(axis=(2, 3), keepdims=True)).max())
             for (order, _), a, b in zip(each, here, there, strict=True)]
    last = max((k for k, change in enumerate(moved) if change > TOLERANCE * NEAR), default=0) + 1
    high = found.high + sum(_placed(found, order, own) for order, own in zip(found.orders[last:], here[last:],
                                                                             strict=True))
    return replace(found, orders=found.orders[:last], high=high)


def _placed(found: PatchOrders, order: _Order, compliance: Complex) -> Complex:
    """The compliance (n, k, 2, 2) of an order among all patches."""
    whole = np.zeros_like(found.high)
    whole[:, order.which] = compliance
    return whole


@dataclass(eq=False)
class _Sum:
    """The sum over orders of the compliance of one patch. ``last`` are the last orders, ``sums`` the last totals."""

    index: int
    space: HalfSpace
    total: Complex
    rest: Complex
    local: Complex
    last: list[tuple[Complex, Real]]
    sums: list[Complex]

    @classmethod
    def of(cls, patch: Patch, index: int) -> _Sum:
        """The empty sum."""
        return cls(index, HalfSpace.of([patch], np.zeros(1)), np.zeros(1, dtype=complex), np.zeros(1),
                   np.zeros(1), [], [])

    def add(self, number: int, compliance: Complex) -> None:
        """Add the `compliance` (n, 2, 2) of the next order."""
        self.total = self.total + compliance
        self.last = [*self.last[1 - FITTED:], (compliance, self.space.order(number)[:, 0, 0])]
        self.space = self.space.without(number)
        if number >= FITTED:
            own, shares = (np.array(each) for each in zip(*self.last, strict=True))
            self.rest, self.local = _rest(own, shares, self.space.total[:, 0, 0])
            self.sums = [*self.sums[-FITTED:], self.total + self.rest]

    @property
    def has_converged(self) -> bool:
        """Whether the last orders moved the total by no more than the tolerance."""
        if len(self.sums) <= FITTED:
            return False
        size = np.linalg.norm(self.sums[-1], axis=(1, 2))
        return all((np.linalg.norm(self.sums[-1] - each, axis=(1, 2)) <= TOLERANCE * size).all() for each in self.sums)


def _rest(compliances: Complex, orders: Real, total: Real) -> tuple[Complex, Complex]:
    """The compliance (n, 2, 2) of the orders that are left, as of a half-space, and its static constants (n, 2).

    `compliances` (m, n, 2, 2) are those of the last orders, `orders` (m, 2) their shares of a half-space, and `total`
    (2,) is the share of the orders that are left.
    """
    diagonal = np.diagonal(compliances, axis1=2, axis2=3)
    constants = half_space_constants(diagonal, np.repeat(orders[:, :, None], 2, axis=2))
    return np.einsum("pni,p,ij->nij", constants, total, np.eye(2)), constants[0]


def _order(
    problem: Problem, operators: FullOperators, patches: Sequence[Patch], which: NDArray[np.int64], frequencies: Real,
    number: int,
) -> _Order:
    """One order, projected on fields at a few frequencies of the band."""
    system = System(operators, {**problem.values, ORDER: float(number)})
    forms = np.stack([patch_forms(operators, patches[k], number)[:-1][:, [AWAY, UP]] for k in which])
    loads = np.hstack(list(forms))
    acting = loads[:, loads.any(axis=0)]
    mixture = np.random.default_rng(number).normal(size=(acting.shape[1], MIXED))
    basis, scale = np.zeros((len(loads), 0)), np.ones((len(loads), 1))
    for frequency in frequencies[chebyshev(frequencies.size, FACTORISED)]:
        electrode, factor = system.factored(float(frequency))
        if not basis.size:
            scale = factor.scale[:, None]
        states = factor.scale[:, None] * factor.solve_scaled(factor.scale[:, None] * (acting + 0j))
        starts = list((states @ mixture).T)
        if number == 0:
            driven = factor.solve(-electrode[:-1])[0]
            states, starts = np.column_stack([states, driven]), [*starts, driven]
        change = system.change(float(frequency), float(frequency) * 1.01)
        vectors = [states, *(krylov(factor, change, np.append(each, 1.0 if each is starts[-1] and number == 0 else 0.0),
                                    DEPTH) for each in starts)]
        basis = np.hstack([basis, _outside(np.hstack(vectors) / scale, basis)])
    whole = np.zeros((len(loads) + 1, basis.shape[1] + 1))
    whole[:-1, :-1], whole[-1, -1] = scale * basis, 1.0
    reduced = ReducedOperators(operators.integrals, operators.coefficients, operators.project(whole), operators.forms)
    return _Order(number, reduced, np.stack([whole[:-1, :-1].T @ form for form in forms]), which)


def _outside(vectors: Complex, basis: Real) -> Real:
    """Orthonormal real directions of complex vectors outside a basis."""
    vectors = vectors / np.linalg.norm(vectors, axis=0)
    parts = np.hstack([vectors.real, vectors.imag])
    for _ in range(2):
        parts = parts - basis @ (basis.T @ parts)
    columns, sizes, _ = np.linalg.svd(parts, full_matrices=False)
    return np.asarray(columns[:, sizes > DEPENDENT])
