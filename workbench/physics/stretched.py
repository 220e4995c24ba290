"""Lengths of a chip as exact parameters of the model, without remeshing.

A layer that grows from t0 to t stretches its elements along z by s = t / t0. In each integral over it, every derivative
along z is divided by s and the measure multiplied by s, so the parts of a form with no, one and two such derivatives
scale with s, 1 and 1 / s: three matrices with coefficients that are powers of t.

A column of the section between the radii a and b, moved to A and B, stretches along r by s = (B - A) / (b - a), to R =
A + s (r - a). Derivatives along r are divided by s, the measure r dr becomes R s dr, and u_r / r becomes u_r / R:

    no u_r / r       R s = s^2 r + s (A - s a)         two matrices, of the measures r dr and dr, by s^-(derivatives)
    one              s                                 one matrix
    u_r^2 / r^2      s r / R = r / (r + d)             d = (b - a) / k - a,  k = B / A - 1

In a straight section the measure dx becomes s dx and there is no u_r / r, so the parts of a form have one matrix, by
s^(1 - derivatives). With an axis the last is not a finite sum; it is interpolated in k between Chebyshev nodes, with an
error below :data:`INTERPOLATION` (Trefethen 2013, Approximation Theory and Approximation Practice, theorem 8.2). On a
boundary the same relations hold for facets along r and along z; facets at a radius that moves have R / r for the
measure, and 1 in a straight section.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from workbench.physics.shaped import MovableLength, Moves, Ratio, Receding
from workbench.physics.term import (
    OPERATORS,
    Coefficient,
    Condition,
    Constant,
    Integral,
    Kind,
    MeasureFactor,
    Monomial,
    Product,
    Radial,
    Term,
    Values,
    WithoutFrequency,
    parts_by_stretch,
    times,
)

#: Largest relative error of the interpolated hoop stiffness over the range of the radii.
INTERPOLATION = 1e-9

#: A product of operators with the kinds of both.
Sorted = Iterator[tuple[Kind, Product]]


@dataclass(frozen=True)
class RadialInterval:
    """A column of the section between two radii. `ratios` are the nodes of k = outer / inner - 1; none if it begins at
    the axis, or in a ``straight`` section between places x."""

    inner: MovableLength
    outer: MovableLength
    ratios: tuple[float, ...] = ()
    straight: bool = False

    @classmethod
    def between(cls, inner: MovableLength, outer: MovableLength, ranges: Mapping[str, tuple[float, float]], *,
                straight: bool = False) -> RadialInterval:
        """The column for radii within `ranges` (m), by parameter."""
        if straight or inner.nominal == 0.0:
            return cls(inner, outer, straight=straight)
        low, high = (ranges.get(each.parameter, (each.nominal, each.nominal)) for each in (inner, outer))
        return cls(inner, outer, nodes(high[0] / low[1] - 1.0, high[1] / low[0] - 1.0))

    def radial(self, kind: tuple[int, int]) -> Iterator[tuple[Radial | None, Constant]]:
        """Pairs of measure and coefficient into which a form splits. `kind` has the numbers of derivatives along r and
        of divisions by r."""
        slopes, divided = kind
        if self.straight:
            if not divided:
                yield None, Stretch(self, 1 - slopes)
        elif not self.ratios:
            power = 2 - slopes - divided
            name, nominal = self.outer.parameter, self.outer.nominal
            yield None, Monomial(nominal**-power, 0, ((name, power),) if power else ())
        elif divided == 0:
            yield None, Stretch(self, 2 - slopes)
            yield Radial(0, 0.0), Shift(self, 1 - slopes)
        elif divided == 1:
            yield None, Stretch(self, 1 - slopes)
        else:
            width = self.outer.nominal - self.inner.nominal
            for number, ratio in enumerate(self.ratios):
                yield Radial(1, width / ratio - self.inner.nominal), RadialPolynomial(self, number)


@dataclass(frozen=True)
class MovingRim:
    """Facets along z at a radius that moves. In a ``straight`` section it is a place x."""

    radius: MovableLength
    straight: bool = False

    def radial(self, kind: tuple[int, int]) -> Iterator[tuple[Radial | None, Constant]]:
        if self.straight:
            if not kind[1]:
                yield None, Monomial(1.0, 0)
            return
        power = 1 - kind[1]
        yield None, Monomial(self.radius.nominal**-power, 0, ((self.radius.parameter, power),) if power else ())


def nodes(low: float, high: float) -> tuple[float, ...]:
    """Chebyshev nodes in k that interpolate 1 / (1 + k x). x is from 0 to 1. The error is below
    :data:`INTERPOLATION`."""
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if half < 1e-12:
        return (middle,)
    # The nearest pole is at k = -1; the error of n nodes is below 4 rho^(1 - n) / (rho - 1).
    distance = (1.0 + middle) / half
    rho = distance + math.sqrt(distance**2 - 1.0)
    count = max(2, math.ceil(1.0 + math.log(4.0 / ((rho - 1.0) * INTERPOLATION)) / math.log(rho)))
    angles = np.pi * (np.arange(count) + 0.5) / count
    return tuple(float(middle + half * each) for each in np.cos(angles))


class _OfColumn(WithoutFrequency):
    """A coefficient that depends on the two radii of a column."""

    column: RadialInterval

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(each.parameter for each in (self.column.inner, self.column.outer) if each.parameter))

    def at(self, inner: float, outer: float) -> tuple[float, float, float]:
        """Its value at two radii (m), and its derivatives by them."""
        raise NotImplementedError

    def constant(self, values: Values) -> complex:
        return complex(self.at(self.column.inner.at(values), self.column.outer.at(values))[0])

    def constant_derivative(self, values: Values, name: str) -> complex:
        _, *slopes = self.at(self.column.inner.at(values), self.column.outer.at(values))
        return complex(sum(slope * each.by for slope, each in zip(
            slopes, (self.column.inner, self.column.outer), strict=True) if each.parameter == name))


@dataclass(frozen=True)
class Stretch(_OfColumn):
    """The stretch s to a power."""

    column: RadialInterval
    power: int

    def at(self, inner: float, outer: float) -> tuple[float, float, float]:
        width = self.column.outer.nominal - self.column.inner.nominal
        stretch = (outer - inner) / width
        slope = self.power * stretch ** (self.power - 1) / width
        return stretch**self.power, -slope, slope


@dataclass(frozen=True)
class Shift(_OfColumn):
    """The shift (A - s a) times s to a power."""

    column: RadialInterval
    power: int

    def at(self, inner: float, outer: float) -> tuple[float, float, float]:
        nominal, width = self.column.inner.nominal, self.column.outer.nominal - self.column.inner.nominal
        stretch = (outer - inner) / width
        shift, powered = inner - stretch * nominal, stretch**self.power
        by_stretch = (self.power * stretch ** (self.power - 1) * shift - nominal * powered) / width
        return shift * powered, powered - by_stretch, by_stretch


@dataclass(frozen=True)
class RadialPolynomial(_OfColumn):
    """The Lagrange polynomial in k of one node of a column."""

    column: RadialInterval
    number: int

    def at(self, inner: float, outer: float) -> tuple[float, float, float]:
        values, slopes = _lagrange(self.column.ratios, outer / inner - 1.0)
        slope = slopes[self.number]
        return values[self.number], -slope * outer / inner**2, slope / inner


@lru_cache(maxsize=256)
def _lagrange(nodes: tuple[float, ...], x: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The Lagrange polynomials of some nodes at x, and their derivatives."""
    values, slopes = [], []
    for number, node in enumerate(nodes):
        others = np.array([other for k, other in enumerate(nodes) if k != number])
        gaps, scale = x - others, float(np.prod(node - others))
        values.append(float(np.prod(gaps)) / scale)
        slopes.append(sum(float(np.prod(gaps[:k]) * np.prod(gaps[k + 1 :])) for k in range(gaps.size)) / scale)
    return tuple(values), tuple(slopes)


@dataclass(frozen=True)
class StretchedPart:
    """A part of a place and the lengths that move it. They are those of its layer, its column and its shapes. Its size
    follows the layer's thickness and the column's radii. "" and None mean no layer, no column and no motion."""

    name: str
    layer: str = ""
    across: RadialInterval | MovingRim | None = None
    moves: Moves | None = None


@dataclass(frozen=True)
class Stretched(Term):
    """A term whose integrals are functions of the chip's lengths.

    ``parts`` has the parts on the mesh of every place of the term (`geometry.stretch.split`); ``nominal`` the thickness
    (m) of each layer on the mesh. The term depends on the parameters ``<layer>.thickness`` (m) and on the radii of its
    columns (m).
    """

    term: Term
    parts: tuple[tuple[str, tuple[StretchedPart, ...]], ...]
    nominal: tuple[tuple[str, float], ...]

    @property
    def unknowns(self) -> tuple[tuple[str, str], ...]:
        return self.term.unknowns

    @property
    def needs_axis(self) -> bool:
        return self.term.needs_axis

    def conditions(self) -> tuple[Condition, ...]:
        return self.term.conditions()

    def integrals(self) -> tuple[Integral, ...]:
        parts, nominal = dict(self.parts), dict(self.nominal)
        result: list[Integral] = []
        for integral in self.term.integrals():
            across = parts.get(integral.opposite, ())
            for number, part in enumerate(parts[integral.place]):
                opposite = across[number].name if integral.opposite else ""
                placed = replace(integral, place=part.name, opposite=opposite)
                result += _stretched(placed, part, nominal)
        return tuple(result)


def _stretched(integral: Integral, part: StretchedPart, nominal: Mapping[str, float]) -> list[Integral]:
    """The integrals that replace one integral on a part of its place."""
    found: dict[tuple[MeasureFactor | None, tuple[Constant, ...]], list[Product]] = {}
    for radial, factors, product in (_moved_facets if part.moves and integral.on_boundary else _scaled)(
            integral, part, nominal):
        found.setdefault((radial, factors), []).append(product)
    result = []
    for variant, node in part.moves.nodes() if part.moves else [("", None)]:
        for (radial, factors), products in found.items():
            coefficient: Coefficient = integral.coefficient
            for factor in factors if node is None else (*factors, node):
                coefficient = times(coefficient, factor)
            result.append(replace(integral, coefficient=coefficient, products=tuple(products), radial=radial,
                                  variant=variant))
    return result


#: Products of operators with a factor of the measure and the coefficients of both.
Measured = Iterator[tuple[MeasureFactor | None, tuple[Constant, ...], Product]]


def _scaled(integral: Integral, part: StretchedPart, nominal: Mapping[str, float]) -> Measured:
    """Measures, coefficients and products of an integral over stretched cells or facets."""
    for (along_z, along_r, divided), product in _by_kinds(integral.products, radially=part.across is not None):
        high = _power(part.layer, 1 - along_z, nominal)
        if part.across is None:
            yield integral.radial, high, product
        else:
            for radial, across in part.across.radial((along_r, divided)):
                yield radial, (*high, across), product


def _moved_facets(integral: Integral, part: StretchedPart, nominal: Mapping[str, float]) -> Measured:
    """Measures, coefficients and products over facets that shapes move. All lengths along a facet scale equally, and
    operators are not split."""
    assert part.moves is not None
    side = part.moves.side
    for product in integral.products:
        slopes = sum(any(kind.startswith("d_") for _, kind, _ in OPERATORS[name])
                     for name in (product.row, product.column))
        if side is not None:
            stretched = Ratio(MovableLength(nominal[part.layer], f"{part.layer}.thickness"))
            yield None, _power(part.layer, 2 - slopes, nominal), product
            yield Radial(0, 0.0), (*_power(part.layer, 1 - slopes, nominal), Receding(side, stretched)), product
        elif isinstance(part.across, RadialInterval):
            for radial, across in part.across.radial((slopes, 0)):
                yield radial, (across,), product
        else:
            yield integral.radial, (), product


def _power(layer: str, power: int, nominal: Mapping[str, float]) -> tuple[Constant, ...]:
    """Factor of a stretched layer for integrals proportional to thickness^power."""
    if not layer or not power:
        return ()
    return (Monomial(nominal[layer] ** -power, 0, ((f"{layer}.thickness", power),)),)


def _by_kinds(products: tuple[Product, ...], *, radially: bool) -> Sorted:
    """The products split by kind. A kind has the numbers of derivatives and divisions of both operators together."""
    for product in products:
        for one, row in parts_by_stretch(product.row, radially=radially).items():
            for other, column in parts_by_stretch(product.column, radially=radially).items():
                kind = (one[0] + other[0], one[1] + other[1], one[2] + other[2])
                yield kind, replace(product, row=row, column=column)
