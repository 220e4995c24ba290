"""All coefficients of a model: factors, values, and derivatives by parameters.

A coefficient is a product of a function of frequency, powers of parameters, and functions of parameters. A model has
thousands of coefficients but few distinct factors, so each factor is evaluated once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from workbench.physics.term import Coefficient, Constant, Formula, Integral, Monomial, Times, Values

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

#: A model as few matrices, one per frequency dependence: pairs of h(w) (n,) and constants (integrals,).
Groups = tuple[tuple[Complex, Complex], ...]


@dataclass(frozen=True)
class FrequencyLaw:
    """The frequency dependence of a coefficient. It is w^``power``, a general ``coefficient``, or the derivative of
    that coefficient by the parameter ``name``."""

    power: float = 0.0
    coefficient: Coefficient | None = None
    name: str = ""

    def __call__(self, omega: Real, values: Values) -> Complex:
        """Values (n,) at angular frequencies (n,)."""
        if self.coefficient is None:
            return np.asarray(omega.astype(complex) ** self.power)
        if self.name:
            return self.coefficient.derivative(omega, values, self.name)
        return self.coefficient(omega, values)


#: A factor that does not depend on frequency: a parameter to a power, or a function of parameters.
Factor = tuple[str, float] | Constant


@dataclass(frozen=True, eq=False)
class Coefficients:
    """The factorised coefficients of ``count`` integrals.

    g_q(w, theta) = scale_q shape_q(w) product_k factor_qk. ``shapes`` and ``factors`` are the distinct ones; ``shape``
    (count,) and ``factor`` (count, m) are indices into them. An index equal to the number of factors means a factor of
    one.
    """

    scale: Complex
    shapes: tuple[FrequencyLaw, ...]
    shape: Indices
    factors: tuple[Factor, ...]
    factor: Indices

    @classmethod
    def of(cls, integrals: Sequence[Integral]) -> Coefficients:
        """The coefficients of a model's integrals."""
        shapes: dict[FrequencyLaw, int] = {}
        factors: dict[Factor, int] = {}
        scale, shape, rows = [], [], []
        for integral in integrals:
            size, where, parts = _factorised(integral.coefficient)
            scale.append(size)
            shape.append(shapes.setdefault(where, len(shapes)))
            rows.append([factors.setdefault(part, len(factors)) for part in parts])
        factor = np.full((len(rows), max((len(row) for row in rows), default=0)), len(factors))
        for q, row in enumerate(rows):
            factor[q, : len(row)] = row
        return cls(np.array(scale, dtype=complex), tuple(shapes), np.array(shape, dtype=int), tuple(factors), factor)

    @property
    def count(self) -> int:
        return self.scale.size

    def groups(self, omega: Real, values: Values) -> Groups:
        """Pairs of h(w) (n,) and constants (count,) that sum to the coefficients.

        `omega` (n,) is in rad/s. Coefficients with equal frequency dependence share a pair. Zero pairs are omitted.

        Raises:
            KeyError: a parameter without a value.
        """
        constants = self.scale * self._factor_values(values)[self.factor].prod(axis=1)
        found = []
        for k, shape in enumerate(self.shapes):
            own = np.where(self.shape == k, constants, 0.0)
            # The test uses one fixed frequency, so that the groups do not depend on `omega`: a thick layer underflows
            # at some.
            if own.any() and (shape.coefficient is None or shape(np.ones(1), values).any()):
                found.append((shape(omega, values), own))
        return tuple(found)

    def __call__(self, omega: Real, values: Values) -> Complex:
        """Coefficients g_q (n, count) at angular frequencies (n,)."""
        return summed(self.groups(omega, values), omega.size, self.count)

    def slopes(self, values: Values, names: Sequence[str]) -> tuple[dict[FrequencyLaw, Complex], ...]:
        """Derivatives of the coefficients by complex parameters.

        For each parameter, they are constants (count,) by shape.

        Raises:
            KeyError: a parameter without a value.
        """
        factors = self._factor_values(values)
        return tuple(self._slopes(values, name, factors) for name in names)

    def _slopes(self, values: Values, name: str, factors: Complex) -> dict[FrequencyLaw, Complex]:
        """Derivatives by one parameter, as in :meth:`slopes`; `factors` are those of :meth:`_factor_values`."""
        found: dict[FrequencyLaw, Complex] = {}

        def add(shape: FrequencyLaw, members: Indices, constants: Complex) -> None:
            if constants.any():
                known = found.setdefault(shape, np.zeros(self.count, dtype=complex))
                known[members] += constants

        depending = [k for k, each in enumerate(self.factors) if name in _parameters(each)]
        if depending:
            slopes = np.zeros(len(self.factors) + 1, dtype=complex)
            slopes[depending] = [_slope(self.factors[k], values, name) for k in depending]
            members = np.flatnonzero(np.isin(self.factor, depending).any(axis=1))
            of = factors[self.factor[members]]
            constants = np.zeros(members.size, dtype=complex)
            for k in range(of.shape[1]):
                others = np.delete(of, k, axis=1).prod(axis=1)
                constants += slopes[self.factor[members, k]] * others
            constants *= self.scale[members]
            for k in np.unique(self.shape[members]):
                own = self.shape[members] == k
                add(self.shapes[k], members[own], constants[own])
        for k, shape in enumerate(self.shapes):
            if shape.coefficient is not None and name in shape.coefficient.parameters:
                members = np.flatnonzero(self.shape == k)
                add(FrequencyLaw(coefficient=shape.coefficient, name=name), members,
                    self.scale[members] * factors[self.factor[members]].prod(axis=1))
        return found

    def acting(self, values: Values) -> NDArray[np.bool_]:
        """Mask (count,) of coefficients with a nonzero value or first derivative.

        Raises:
            KeyError: a parameter without a value.
        """
        found = np.zeros(self.count, dtype=bool)
        every = [*(constants for _, constants in self.groups(np.ones(1), values)),
                 *(each for slopes in self.slopes(values, sorted(self.parameters)) for each in slopes.values())]
        for constants in every:
            found |= constants != 0.0
        return found

    @cached_property
    def parameters(self) -> frozenset[str]:
        """Names of all parameters that a coefficient depends on."""
        shapes = [shape.coefficient.parameters for shape in self.shapes if shape.coefficient is not None]
        return frozenset().union(*shapes, *map(_parameters, self.factors))

    def _factor_values(self, values: Values) -> Complex:
        """Values of the factors and, last, 1."""
        return np.array([*(complex(values[each[0]]) ** each[1] if isinstance(each, tuple) else each.constant(values)
                           for each in self.factors), 1.0], dtype=complex)


def summed(groups: Groups, frequencies: int, count: int) -> Complex:
    """Coefficients (frequencies, count) as the sum of `groups`."""
    result = np.zeros((frequencies, count), dtype=complex)
    for h, constants in groups:
        result += np.outer(h, constants)
    return result


def _factorised(coefficient: Coefficient) -> tuple[complex, FrequencyLaw, list[Factor]]:
    """Scale, shape and factors of one coefficient."""
    scale, factors = 1.0 + 0.0j, list[Factor]()
    parts: list[Constant] = []
    while isinstance(coefficient, Times):
        parts.append(coefficient.second)
        coefficient = coefficient.first
    shape = FrequencyLaw(coefficient=coefficient)
    if isinstance(coefficient, Monomial | Formula):
        shape = FrequencyLaw(coefficient.omega_power)
        parts.append(coefficient)
    for part in parts:
        if isinstance(part, Monomial):
            scale *= part.scale
            factors += part.factors
        else:
            factors.append(part)
    return scale, shape, factors


def _parameters(factor: Factor) -> tuple[str, ...]:
    return (factor[0],) if isinstance(factor, tuple) else factor.parameters


def _slope(factor: Factor, values: Values, name: str) -> complex:
    if isinstance(factor, tuple):
        return factor[1] * complex(values[name]) ** (factor[1] - 1)
    return factor.constant_derivative(values, name)
