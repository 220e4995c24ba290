"""Thicknesses of layers as parameters of the model, exactly: no remeshing, no new matrices when they change.

A layer that grows from t0 to t stretches its elements along z by s = t / t0. In each integral over it, every derivative
along z is then divided by s and the measure multiplied by s, so that the parts of a form with no, one and two such
derivatives scale with s, 1 and 1 / s: three matrices with coefficients that are powers of t. On a boundary the same
holds for its facets along z, while those across do not change.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.names import LEVEL
from workbench.physics.term import (
    Coefficient,
    Condition,
    Integral,
    Monomial,
    Product,
    Term,
    Values,
    parts_by_z,
)


@dataclass(frozen=True)
class Layered(Term):
    """A term whose integrals know how they change with the thicknesses of the layers they lie in.

    ``parts`` holds, for every place of the term, the names of its parts on the mesh and the layer that each lies in
    (`geometry.stretch.split_by_layers`); ``nominal`` the thickness (m) that the mesh has of each layer. Brings in the
    parameters ``<layer>.thickness`` (m).
    """

    term: Term
    parts: tuple[tuple[str, tuple[tuple[str, str], ...]], ...]
    nominal: tuple[tuple[str, float], ...]

    @property
    def unknowns(self) -> tuple[tuple[str, str], ...]:
        return self.term.unknowns

    def conditions(self) -> tuple[Condition, ...]:
        return self.term.conditions()

    def integrals(self) -> tuple[Integral, ...]:
        parts, nominal = dict(self.parts), dict(self.nominal)
        result: list[Integral] = []
        for integral in self.term.integrals():
            for name, layer in parts[integral.place]:
                if layer == LEVEL:
                    result.append(replace(integral, place=name))
                    continue
                for derivatives, products in enumerate(_by_derivatives(integral.products)):
                    if products:
                        power = 1 - derivatives
                        stretch = Monomial(nominal[layer] ** -power, 0, ((f"{layer}.thickness", power),))
                        coefficient = times(integral.coefficient, stretch) if power else integral.coefficient
                        result.append(replace(integral, coefficient=coefficient, place=name, products=products))
        return tuple(result)


@dataclass(frozen=True)
class Times:
    """The product of a coefficient and a monomial."""

    first: Coefficient
    second: Monomial

    @property
    def parameters(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.first.parameters, *self.second.parameters)))

    def __call__(self, omega: NDArray[np.float64], values: Values) -> NDArray[np.complex128]:
        return self.first(omega, values) * self.second(omega, values)

    def derivative(self, omega: NDArray[np.float64], values: Values, name: str) -> NDArray[np.complex128]:
        return (self.first.derivative(omega, values, name) * self.second(omega, values)
                + self.first(omega, values) * self.second.derivative(omega, values, name))


def times(first: Coefficient, second: Monomial) -> Coefficient:
    """The product of a coefficient and a monomial: a monomial where the first is one."""
    if not isinstance(first, Monomial):
        return Times(first, second)
    factors: dict[str, float] = dict(first.factors)
    for name, exponent in second.factors:
        factors[name] = factors.get(name, 0) + exponent
    kept = tuple((name, exponent) for name, exponent in factors.items() if exponent)
    return Monomial(first.scale * second.scale, first.omega_power + second.omega_power, kept)


def _by_derivatives(products: tuple[Product, ...]) -> tuple[tuple[Product, ...], ...]:
    """The products sorted by how many derivatives along z they hold: none, one, two."""
    found: Mapping[int, list[Product]] = {0: [], 1: [], 2: []}
    for product in products:
        for row, steep in zip(parts_by_z(product.row), (1, 0), strict=True):
            for column, steep_too in zip(parts_by_z(product.column), (1, 0), strict=True):
                if row and column:
                    found[steep + steep_too].append(replace(product, row=row, column=column))
    return tuple(tuple(found[count]) for count in range(3))
