"""The spectrum of a bare disc whose thickness varies as cos t.

A taper couples every order of the fields around the axis with the next one (`workbench.fem.taper`), so that modes of
order 1 become side peaks. Each order is reduced to its fields at some frequencies: those of order 0 under the voltage,
and of every further one under the load of the one before, and back. The charge is -x^T A x of the coupled fields at
1 V.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.dimension import millimetres
from workbench.fem.dense import chebyshev, directions_outside
from workbench.fem.forms import bilinear
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.solve import Factor, System, krylov, one_thread
from workbench.fem.taper import TaperForms
from workbench.jobs.progress import Progress, no_progress
from workbench.model.problem import Problem
from workbench.physics.orders import ORDER, terms_of_order
from workbench.simulation.solved_spectrum import SolvedSpectrum

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Values = Mapping[str, complex]

#: Change of ln Q by twice as many frequencies, or one more order, at which both are enough.
TOLERANCE = 1e-3

#: Frequencies of the first bases, and the most of them; Krylov vectors of each.
FIRST, MOST, DEPTH = 2, 64, 4

#: Orders of the first chain, and the most.
FEWEST_ORDERS, MOST_ORDERS = 3, 12

#: Part of a field that is left out of a basis, relative to its own: a charge is off by its square.
DEPENDENT = 1e-4

#: Frequencies that are solved together, to fit the memory.
TOGETHER = 64


class TaperNotConverged(RuntimeError):
    """The orders or the bases of a tapered disc are too many."""


@dataclass(frozen=True, eq=False)
class TaperedDisc:
    """A bare disc with coupled orders on small bases.

    ``orders`` are its models by order, on bases (r,), the voltage last in order 0. ``couplings`` (q, r, r) are those of
    each order with the next one for a unit share, by integral of order 0, and ``square`` (q, r, r) is the change of
    order 0 for a unit square of it.
    """

    orders: tuple[ReducedOperators, ...]
    couplings: tuple[Real, ...]
    square: Real

    @classmethod
    def of(cls, problem: Problem, frequencies: Real, share: float, progress: Progress = no_progress) -> TaperedDisc:
        """The orders of a disc, converged at a `share` of its thickness.

        Raises
        ------
        NotConverged : a solve fails.
        TaperNotConverged : too many orders or fields matter.
        """
        with one_thread():
            count, orders = FIRST, FEWEST_ORDERS
            chain = _Chain(problem)
            before = chain.reduced(frequencies, share, count, orders).charge(problem.values, frequencies, share)
            while True:
                progress("orders of the taper", count / (count + 2.0 * FIRST))
                found = chain.reduced(frequencies, share, 2 * count, orders)
                after = found.charge(problem.values, frequencies, share)
                fewer = replace(found, orders=found.orders[:-1], couplings=found.couplings[:-1]).charge(
                    problem.values, frequencies, share)
                if _change(after, fewer) > TOLERANCE and orders < MOST_ORDERS:
                    orders += 1
                elif _change(after, before) <= TOLERANCE:
                    return found
                elif 2 * count >= MOST or orders >= MOST_ORDERS:
                    raise TaperNotConverged(f"{2 * count} frequencies and {orders} orders: the charge still moves by "
                                            f"{max(_change(after, before), _change(after, fewer)):.1e}")
                else:
                    count *= 2
                before = after

    @property
    def plane(self) -> TaperedDisc:
        """Its order 0 alone, which has the charge without a taper."""
        return replace(self, orders=self.orders[:1], couplings=())

    def charge(self, values: Values, frequencies: Real, share: float) -> Complex:
        """The charge (n,) in C at 1 V, e^{-i w t}."""
        return self.response(values, frequencies, share).charge

    def response(self, values: Values, frequencies: Real, share: float) -> TaperResponse:
        """The response at `values` and for a `share` of the thickness."""
        omega = 2.0 * np.pi * frequencies
        constants = self.constants(values, omega)
        some = [slice(begin, begin + TOGETHER) for begin in range(0, omega.size, TOGETHER)]
        each_states = [self._states([own[each] for own in constants], share) for each in some]
        parts = [np.hstack(each) for each in zip(*each_states, strict=True)]
        return TaperResponse(self, share, omega, tuple(constants), tuple(
            each.quadratic(part, part) for each, part in zip(self.orders, parts, strict=True)), tuple(
            np.einsum("kn,qkl,ln->nq", above, coupling, below, optimize=True)
            for coupling, below, above in zip(self.couplings, parts[:-1], parts[1:], strict=True)),
            bilinear(self.square, parts[0], parts[0]))

    def _states(self, constants: Sequence[Complex], share: float) -> list[Complex]:
        """The fields (r, n) of every order at 1 V.

        Orders are eliminated from the highest one.
        """
        below, whole = list[Complex](), np.zeros(0, dtype=complex)
        for k in reversed(range(len(self.orders))):
            upper = whole
            whole = np.tensordot(self.orders[k].by_form(constants[k]), self.orders[k].matrices, axes=1)
            if k < len(self.couplings):
                coupling = share * np.tensordot(constants[0], self.couplings[k], axes=1)
                below.insert(0, np.asarray(np.linalg.solve(upper, coupling), dtype=np.complex128))
                whole = whole - coupling.transpose(0, 2, 1) @ below[0]
        whole = whole + share**2 * np.tensordot(constants[0], self.square, axes=1)
        first = np.linalg.solve(whole[:, :-1, :-1], -whole[:, :-1, -1:])[..., 0]
        states = [np.column_stack([first, np.ones(len(first))])]
        for each in below:
            states.append(-(each @ states[-1][..., None])[..., 0])
        return [each.T for each in states]

    def constants(self, values: Values, omega: Real) -> list[Complex]:
        """Coefficients (n, integrals) of every order."""
        return [each.coefficients(omega, {**values, ORDER: float(k)}) for k, each in enumerate(self.orders)]


@dataclass(frozen=True, eq=False)
class TaperResponse:
    """The response of a tapered disc at 1 V.

    ``forms`` (n, integrals) are those of its fields by order, ``coupled`` (n, q) those of each order with the next one,
    and ``squared`` (n, q) those of the square within order 0.
    """

    disc: TaperedDisc
    share: float
    omega: Real
    constants: tuple[Complex, ...]
    forms: tuple[Complex, ...]
    coupled: tuple[Complex, ...]
    squared: Complex

    @property
    def charge(self) -> Complex:
        """The charge (n,) in C."""
        return self._charge(self.constants)

    @property
    def by_share(self) -> Complex:
        """The derivative (n,) of the charge by the share."""
        forms = self.share * self.squared + sum(self.coupled)
        return -2.0 * (self.constants[0] * forms).sum(axis=1)

    def by_values(self, below: Values, above: Values) -> Complex:
        """The change (n,) of the charge between two sets of values.

        It is that of first order, from `below` to `above`.
        """
        one, other = (self.disc.constants(values, self.omega) for values in (below, above))
        return self._charge([b - a for a, b in zip(one, other, strict=True)])

    def _charge(self, constants: Sequence[Complex]) -> Complex:
        own = sum((each * form).sum(axis=1) for each, form in zip(constants, self.forms, strict=True))
        coupled = 2.0 * self.share * sum(self.coupled) + self.share**2 * self.squared
        return -np.asarray(own + (constants[0] * coupled).sum(axis=1))


class _Chain:
    """The full orders of a problem with their couplings."""

    def __init__(self, problem: Problem) -> None:
        self._problem, self._systems, self._couplings = problem, list[System](), list[TaperForms]()
        self._operators = list[FullOperators]()

    def reduced(self, frequencies: Real, share: float, count: int, orders: int) -> TaperedDisc:
        """The disc on its fields at `count` of the frequencies."""
        self._extend(orders)
        base = self._operators[0].coefficients
        fields: list[list[Complex]] = [[] for _ in range(orders)]
        for frequency in map(float, frequencies[chebyshev(frequencies.size, count)]):
            constants = base(np.array([2.0 * np.pi * frequency]), self._problem.values)[0]
            found = [each.factored(frequency) for each in self._systems[:orders]]
            factors, chain = [factor for _, factor in found], list[Complex]()
            for k, (system, factor) in enumerate(zip(self._systems, factors, strict=False)):
                states = factor.solve(-found[0][0][:-1])[0][:, None] if k == 0 else _loaded(
                    factor, self._couplings[k - 1].load(constants, chain[-1], upwards=True))
                voltage = 1.0 if k == 0 else 0.0
                further = krylov(factor, system.change(frequency, 1.01 * frequency),
                                 np.append(states[:, 0], voltage), DEPTH)
                states = np.vstack([np.hstack([states, further]), np.zeros(states.shape[1] + DEPTH)])
                states[-1, 0] = voltage
                fields[k].append(states)
                chain.append(states[:, : DEPTH + 1])
            for k in range(orders - 1):
                load = self._couplings[k].load(constants, chain[k + 1], upwards=False)
                fields[k].append(np.vstack([_loaded(factors[k], load), np.zeros(load.shape[1])]))
        scales = [each.scale for each in factors]
        bases = [scale[:, None] * directions_outside(np.hstack(each)[:-1] / scale[:, None], np.zeros((scale.size, 0)),
                                                     DEPENDENT) for each, scale in zip(fields, scales, strict=True)]
        bases = [np.vstack([each, np.zeros(each.shape[1])]) for each in bases]
        bases[0] = np.column_stack([bases[0], np.eye(len(bases[0]))[:, -1]])
        models = [ReducedOperators(each.integrals, each.coefficients, each.project(basis), each.forms)
                  for each, basis in zip(self._operators, bases, strict=False)]
        return TaperedDisc(tuple(models), tuple(each.projected(above, below) for each, below, above in zip(
            self._couplings, bases[:-1], bases[1:], strict=False)), self._square.projected(bases[0], bases[0]))

    def _extend(self, orders: int) -> None:
        for k in range(len(self._systems), orders):
            terms = terms_of_order(self._problem.terms, is_first=k == 1) if k else self._problem.terms
            self._operators.append(self._operators[2] if k > 2 else assemble(self._problem.mesh, terms))
            self._systems.append(System(self._operators[k], {**self._problem.values, ORDER: float(k)}))
            if k:
                self._couplings.append(TaperForms.coupling(self._operators[k - 1], self._operators[k], k - 1,
                                                           self._operators[0].integrals))

    @cached_property
    def _square(self) -> TaperForms:
        return TaperForms.square(self._operators[0], self._operators[0].integrals)


def _loaded(factor: Factor, loads: Complex) -> Complex:
    """The fields (size - 1, n) under loads (size, n)."""
    scale = factor.scale[:, None]
    return -scale * factor.solve_scaled(scale * loads[:-1])


def _change(one: Complex, other: Complex) -> float:
    return float(np.abs(np.log(one / other)).max())


def spectrum_with_taper(
    chip: Chip, problem: Problem, found: SolvedSpectrum, progress: Progress
) -> tuple[SolvedSpectrum, str]:
    """The spectrum with the taper of a chip's disc, and a finding.

    Raises
    ------
    NotConverged, TaperNotConverged : see :meth:`TaperedDisc.of`.
    """
    layer = chip.transducer
    share = 0.5 * layer.taper / layer.thickness.value
    disc = TaperedDisc.of(problem, found.frequency, share, progress)
    plain = disc.plane.charge(problem.values, found.frequency, 0.0)
    changed = replace(found, impedance=found.impedance * plain / disc.charge(problem.values, found.frequency, share))
    return changed, (
        f"the thickness of {layer.region} varies by {millimetres(layer.taper)} across it: {changed.change_from(found)} "
        f"({len(disc.orders)} orders); the fields are those of the plane-parallel disc")
