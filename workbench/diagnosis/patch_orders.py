"""The change of a round chip's spectrum by a rigid part.

The closed form is that of `workbench.simulation.features`. A search evaluates it hundreds of times: each order is
projected once on the fields under forces on all patches, and the small models follow the constants of the materials.
High orders are those of an elastic half-space, at the constants of the projection.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from workbench.fem.dense import chebyshev, directions_outside
from workbench.fem.half_space import FITTED, HalfSpace, half_space_constants
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.patch import AWAY, UP, Patch, patch_forms
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.solve import System, krylov, one_thread
from workbench.model.problem import Problem
from workbench.physics.orders import ORDER, terms_of_order
from workbench.simulation.features import OrdersNotConverged

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Values = Mapping[str, complex]

#: Frequencies of a band that are factorised, mixtures of the loads whose Krylov vectors are added there, and the number
#: of these from each.
FACTORISED, MIXED, DEPTH = 3, 3, 8

#: Part of a vector outside the basis that is left out, relative to its own: a compliance is off by its square.
DEPENDENT = 1e-4

#: Relative change of every compliance by an order at which the sum ends, and the most orders.
TOLERANCE, MOST_ORDERS = 5e-3, 120

#: Times the band's end that the resonance of a mode is far: its compliance is taken as that where it was made.
FAR = 2.0

#: Relative change of frequency that an order without resonances does not notice, within the tolerance times it.
NEAR = 0.02


@dataclass(frozen=True, eq=False)
class _Order:
    """One order on a small basis. ``loads`` (k, r, 2) are the forms of the patches ``which`` (k,) there."""

    number: int
    operators: ReducedOperators
    loads: Real
    which: NDArray[np.int64]

    def constants(self, values: Values, number: int | None = None) -> Complex:
        """Constants (2, forms) of stiffness and mass.

        Their factors are 1 and w^2. They are those of another `number` if it is given.

        Raises
        ------
        ValueError : the model is not one of stiffness and mass alone.
        """
        omega = np.array([1.0, 2.0])
        groups = self.operators.coefficients.groups(omega, {
            **values, ORDER: float(self.number if number is None else number)})
        if [list(h) for h, _ in groups] != [[1.0, 1.0], [1.0, 4.0]]:
            raise ValueError(f"order {self.number}: {len(groups)} functions of frequency; expected stiffness and mass")
        return np.asarray(np.array([constants for _, constants in groups]) @ self._gather)

    @cached_property
    def _gather(self) -> Real:
        """The form (integrals, forms) of every integral."""
        return np.eye(len(self.operators.matrices))[self.operators.forms]

    def at(self, values: Values, middle: float) -> _OrderModes:
        """The order by its eigenvectors at `values`, about a frequency `middle` (Hz)."""
        rank, square = self.loads.shape[1], (2.0 * np.pi * middle) ** 2
        matrices = self.operators.matrices
        first, second = np.tensordot(self.constants(values), matrices[:, :rank, :rank], axes=1)
        whole = scipy.linalg.lu_factor(first + square * second, check_finite=False)
        roots, vectors = np.linalg.eig(scipy.linalg.lu_solve(whole, square * second, check_finite=False))
        resonances = middle * np.sqrt(np.maximum((1.0 - 1.0 / roots).real, 0.0))
        forms = np.einsum("qij,jm,im->qm", matrices[:, :rank, :rank], vectors, vectors, optimize=True)
        drive = np.einsum("qi,im->qm", matrices[:, :rank, rank], vectors)
        return _OrderModes(self, resonances, forms, np.einsum("kri,rm->kim", self.loads, vectors), drive)


@dataclass(frozen=True, eq=False)
class _OrderModes:
    """One order by its eigenvectors at some values.

    At other values, their mixing is omitted.

    ``resonances`` (r,) are in Hz, ``forms`` (q, r) the forms of the eigenvectors, ``shapes`` (k, 2, r) their mean
    displacements of the patches, and ``drive`` (q, r) their forms with the electrode's voltage.
    """

    order: _Order
    resonances: Real
    forms: Complex
    shapes: Complex
    drive: Complex

    def among(self, chosen: NDArray[np.bool_]) -> _OrderModes:
        """A copy with the `chosen` (r,) modes."""
        return replace(self, resonances=self.resonances[chosen], forms=self.forms[:, chosen],
                       shapes=self.shapes[..., chosen], drive=self.drive[:, chosen])

    def compliance(self, values: Values, frequencies: Real) -> Complex:
        """The compliance (n, k, 2, 2) of the patches of the order."""
        return _ModalPart(self.shapes, self.order.constants(values) @ self.forms, _factors(frequencies),
                          np.zeros((0, 2, 0), dtype=complex), np.ones(len(self.shapes), dtype=bool)).compliance

    def stiffness(self, constants: Complex, factors: Real) -> Complex:
        """The dynamic stiffness (n, r) of every mode, for `factors` (n, 2)."""
        return np.asarray(factors @ (constants @ self.forms))


@dataclass(frozen=True, eq=False)
class PatchOrders:
    """The compliances of patches of one round chip, by orders.

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
        """The orders of a chip, until the sums have converged.

        Raises
        ------
        NotConverged : a solve fails.
        OrdersNotConverged : too many orders matter.
        """
        with one_thread():
            return _converged(problem, tuple(patches), frequencies)

    def at(self, values: Values) -> PatchModes:
        """The orders at some `values`; the others are those of the problem."""
        every, middle = self.all_values(values), float(np.median(self.frequencies))
        near, high = list[_OrderModes](), self.high.copy()
        with one_thread():
            for modes in (each.at(every, middle) for each in self.orders):
                is_near = ((modes.resonances > self.frequencies.min() / FAR) & (
                    modes.resonances < FAR * self.frequencies.max())) | (modes.order.number == 0)
                near.append(modes.among(is_near))
                high[:, modes.order.which] += modes.among(~is_near).compliance(every, self.frequencies)
        return PatchModes(self, tuple(near), high)

    def all_values(self, values: Values) -> dict[str, complex]:
        """The constants of the problem, with those of `values` that it has."""
        return {**self.problem.values, **{k: v for k, v in values.items() if k in self.problem.values}}


@dataclass(frozen=True, eq=False)
class PatchModes:
    """The orders of a chip by their eigenvectors at some values.

    ``orders`` have the modes near the band; ``high`` (n, k, 2, 2) is the compliance of all others.
    """

    model: PatchOrders
    orders: tuple[_OrderModes, ...]
    high: Complex

    def response(self, values: Values, slopes: Sequence[tuple[Values, Values]] = (), shift: float = 0.0,
                 chosen: slice = slice(None)) -> PatchResponse:
        """The response at `values` of the constants.

        Its orders lie higher by a relative `shift` of frequency.
                Each of the `slopes` is a pair of values below and above, whose difference quotients are the
                derivatives. It is that of the `chosen` patches.
        """
        own = self.model.frequencies
        factors = _factors(own / (1.0 + shift))
        constants = self._constants(values)
        by_number = [[above - below for below, above in zip(*map(self._constants, pair), strict=True)]
                     for pair in slopes]
        patches = np.arange(len(self.model.patches))[chosen]
        total, parts = self.high[:, patches], list[_ModalPart]()
        for place, each in enumerate(self.orders):
            here = np.flatnonzero((each.order.which >= patches[0]) & (each.order.which <= patches[-1]))
            by = np.array([every[place] for every in by_number]).reshape(len(slopes), *constants[place].shape)
            if each.order.number == 0:
                driven = _Driven.of(each, constants[place], by, _factors(own), patches)
            if here.size:
                where = np.isin(patches, each.order.which)
                part = _ModalPart(each.shapes[here], constants[place] @ each.forms, factors, by @ each.forms, where)
                total[:, where] += part.compliance
                parts.append(part)
        radii = np.array([self.model.patches[k].radius for k in patches])[:, None]
        local = 16.0 / (3.0 * np.pi) / radii * self.model.local[:, patches]
        return PatchResponse(own, shift, total, local, driven, tuple(parts))

    def _constants(self, values: Values) -> list[Complex]:
        """The constants (2, forms) of every order. They are polynomials of the second degree in its number."""
        every = self.model.all_values(values)
        orders = [each.order for each in self.orders]
        known = [order.constants(every) for order in orders[:2]]
        three = [orders[2].constants(every, number) for number in (2, 3, 4)] if len(orders) > 2 else []
        for order in orders[2:]:
            known.append(np.asarray(np.tensordot(parabola(order.number - 3.0), three, axes=1)))
        return known


@dataclass(frozen=True, eq=False)
class _ModalPart:
    """The part of one order in the compliance of patches (k,).

    The patches are those that are true in ``where``.     ``constants`` (2, r) are stiffness and mass of the modes with
    ``shapes`` (k, 2, r), for the ``factors`` (n, 2), and ``by_number`` (p, 2, r) their derivatives.
    """

    shapes: Complex
    constants: Complex
    factors: Real
    by_number: Complex
    where: NDArray[np.bool_]

    @cached_property
    def softness(self) -> Complex:
        """One over the dynamic stiffness (n, r) of the modes."""
        return np.asarray(1.0 / (self.factors @ self.constants))

    @property
    def compliance(self) -> Complex:
        """The compliance (n, k, 2, 2)."""
        works = np.stack([self.shapes[:, i] * self.shapes[:, j] for i, j in ((0, 0), (0, 1), (1, 0), (1, 1))], axis=1)
        whole = self.softness @ works.reshape(4 * len(works), works.shape[-1]).T
        return whole.reshape(-1, len(self.shapes), 2, 2)


@dataclass(frozen=True, eq=False)
class _Driven:
    """The driven chip by its modes of order 0.

    It has a ``charge`` (n,) in C at 1 V, and a ``force`` (n, r) on the modes.
        ``by_charge`` (n, p), and ``by_force`` and ``by_stiffness`` (p, 2, r), are derivatives by numbers.
    """

    shapes: Complex
    factors: Real
    stiffness: Complex
    force: Complex
    charge: Complex
    by_charge: Complex
    by_force: Complex
    by_stiffness: Complex

    @classmethod
    def of(cls, order: _OrderModes, constants: Complex, by_number: Complex, factors: Real,
           patches: NDArray[np.int64]) -> _Driven:
        """The driven chip by the modes of order 0."""
        stiffness, force = order.stiffness(constants, factors), factors @ (constants @ order.drive)
        capacity = order.order.operators.matrices[:, -1, -1]
        answer = force / stiffness
        by_force, by_stiffness = by_number @ order.drive, by_number @ order.forms
        charge = np.sum(force * answer, axis=1) - factors @ (constants @ capacity)
        by_charge = sum(factors[:, g, None] * (2.0 * answer @ by_force[:, g].T - answer**2 @ by_stiffness[:, g].T
                                               - (by_number @ capacity)[:, g]) for g in (0, 1))
        return cls(order.shapes[patches], factors, stiffness, force, charge, np.asarray(by_charge), by_force,
                   by_stiffness)

    @property
    def displacements(self) -> Complex:
        """Mean displacements (n, k, 2) of the patches, m at 1 V."""
        return -np.einsum("kim,nm->nki", self.shapes, self.force / self.stiffness)


@dataclass(frozen=True, eq=False)
class PatchResponse:
    """The response of a chip at patches (k,), e^{-i w t}.

    ``frequencies`` (n,) are in Hz, ``compliance`` (n, k, 2, 2) in m/N, of the ``parts``, which lie higher by a relative
    ``shift`` of frequency, and of higher orders; ``local`` (n, k, 2) is the part of it that goes with one over the
    radius of the patch: the mean displacement of a half-space under a uniform pressure.
    """

    frequencies: Real
    shift: float
    compliance: Complex
    local: Complex
    driven: _Driven
    parts: tuple[_ModalPart, ...]

    @cached_property
    def displacements(self) -> Complex:
        """Displacements (n, k, 2) of the driven chip, m at 1 V."""
        return self.driven.displacements

    def log_change(self, dynamic_stiffness: Complex, size: float, weights: Real) -> tuple[Complex, Complex]:
        """The change (n,) of ln Z, and the forces (n, 2).

        `dynamic_stiffness` (n,) is in N/m; the radius of the part is `size` times that of the patch. The part is
        between the patches, by their `weights` (k,).
        """
        compliance = weights @ (self.compliance + ((1.0 / size - 1.0) * self.local)[..., None]
                                * np.eye(2)).reshape(self.frequencies.size, weights.size, 4)
        coupling = compliance.reshape(-1, 2, 2) + np.eye(2) / dynamic_stiffness[:, None, None]
        displacements = np.einsum("k,nki->ni", weights, self.displacements)
        forces = np.linalg.solve(coupling, displacements[..., None])[..., 0]
        change = -np.sum(displacements * forces, axis=-1)
        return np.asarray(-np.log1p(change / self.driven.charge)), np.asarray(forces)

    def slopes(self, forces: Complex, weights: Real) -> Complex:
        """Derivatives (n, p + 1) of the change of ln Z.

        They are those by the numbers and the shift, at the `forces` (n, 2) of :meth:`log_change`.
        """
        driven = self.driven
        slopes = np.zeros((self.frequencies.size, driven.by_charge.shape[1] + 1), dtype=complex)
        for part in self.parts:
            motion = (forces @ part.shapes[:, :, :]).transpose(1, 0, 2) ** 2
            squares = np.tensordot(motion, weights[part.where], axes=(1, 0)) * part.softness**2
            for g in (0, 1):
                slopes[:, :-1] -= part.factors[:, g, None] * (squares @ part.by_number[:, g].T)
            slopes[:, -1] += 2.0 / (1.0 + self.shift) * part.factors[:, 1] * (squares @ part.constants[1])
        motion = forces @ np.tensordot(weights, driven.shapes, axes=1) / driven.stiffness
        for g in (0, 1):
            slopes[:, :-1] += 2.0 * driven.factors[:, g, None] * (
                motion @ driven.by_force[:, g].T
                - (motion * driven.force / driven.stiffness) @ driven.by_stiffness[:, g].T)
        displacements = np.einsum("k,nki->ni", weights, self.displacements)
        change, charge = -np.sum(displacements * forces, axis=-1)[:, None], driven.charge[:, None]
        slopes[:, :-1] -= change * driven.by_charge / charge
        return -slopes / (charge + change)


def parabola(place: float) -> Real:
    """Weights (3,) of the points -1, 0 and 1 at a place."""
    return np.array([0.5 * place * (place - 1.0), 1.0 - place**2, 0.5 * place * (place + 1.0)])


def _factors(frequencies: Real) -> Real:
    """The factors (n, 2) of stiffness and mass."""
    return np.stack([np.ones_like(frequencies), (2.0 * np.pi * frequencies) ** 2], axis=1)


def _converged(problem: Problem, patches: tuple[Patch, ...], frequencies: Real) -> PatchOrders:
    """See :meth:`PatchOrders.of`."""
    assembled = [assemble(problem.mesh, problem.terms), *(
        assemble(problem.mesh, terms_of_order(problem.terms, is_first=is_first)) for is_first in (True, False))]
    open_ones, high = [_Sum.of(patch, k) for k, patch in enumerate(patches)], dict[int, tuple[Complex, Complex]]()
    orders = list[_Order]()
    for number in range(MOST_ORDERS):
        which = np.array([each.index for each in open_ones])
        orders.append(_order(problem, assembled[min(number, 2)], patches, which, frequencies, number))
        own = _compliance(orders[-1], problem.values, frequencies, frequencies)
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
    """A copy whose high orders include those without resonances nearby."""
    frequencies, values = found.frequencies, found.problem.values
    here, there = ([_compliance(order, values, frequencies, f) for order in found.orders]
                   for f in (frequencies, frequencies * (1.0 + NEAR)))
    size = np.abs(found.high + sum(_placed(found, order, own) for order, own in zip(found.orders, here, strict=True)))
    moved = [float((np.abs(_placed(found, order, b - a)) / size.max(axis=(2, 3), keepdims=True)).max())
             for order, a, b in zip(found.orders, here, there, strict=True)]
    last = max((k for k, change in enumerate(moved) if change > TOLERANCE * NEAR), default=0) + 1
    high = found.high + sum(_placed(found, order, own) for order, own in zip(found.orders[last:], here[last:],
                                                                             strict=True))
    return replace(found, orders=found.orders[:last], high=high)


def _placed(found: PatchOrders, order: _Order, compliance: Complex) -> Complex:
    """The compliance (n, k, 2, 2) of an order among all patches."""
    whole = np.zeros_like(found.high)
    whole[:, order.which] = compliance
    return whole


def _compliance(order: _Order, values: Values, frequencies: Real, asked: Real) -> Complex:
    """The compliance (n, k, 2, 2) of an order at frequencies `asked`."""
    return order.at(values, float(np.median(frequencies))).compliance(values, asked)


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
        nothing = np.zeros(1, dtype=complex)
        return cls(index, HalfSpace.of([patch], np.zeros(1)), nothing, nothing, nothing, [], [])

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
        """Whether the last orders moved the total within the tolerance."""
        if len(self.sums) <= FITTED:
            return False
        size = np.linalg.norm(self.sums[-1], axis=(1, 2))
        return all((np.linalg.norm(self.sums[-1] - each, axis=(1, 2)) <= TOLERANCE * size).all() for each in self.sums)


def _rest(compliances: Complex, orders: Real, total: Real) -> tuple[Complex, Complex]:
    """The compliance (n, 2, 2) of higher orders, and constants (n, 2).

    It is that of a half-space.

    `compliances` (m, n, 2, 2) are those of the last orders, `orders` (m, 2) their shares of a half-space, and `total`
    (2,) is the share of the higher orders.
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
        basis = np.hstack([basis, directions_outside(np.hstack(vectors) / scale, basis, DEPENDENT)])
    whole = np.zeros((len(loads) + 1, basis.shape[1] + 1))
    whole[:-1, :-1], whole[-1, -1] = scale * basis, 1.0
    reduced = ReducedOperators(operators.integrals, operators.coefficients, operators.project(whole), operators.forms)
    return _Order(number, reduced, np.stack([whole[:-1, :-1].T @ form for form in forms]), which)
