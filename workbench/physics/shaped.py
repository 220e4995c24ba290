"""Sizes of shapes (`geometry.shapes`) as parameters of the model: no remeshing, no new matrices when they change.

A shape moves points x0 of the section to x0 + a d(x0), a its size. What a part of the section contributes is a smooth
function of the sizes of the shapes that move it, and is interpolated in them: matrices at the nodes of a
:class:`Grid`, coefficients its Lagrange polynomials.

Thicknesses and radii stay exact. In a part that is stretched by s along r and by l along z, the points have got to

    r = s (r0 + (a / s) d) + const,      z = l (z0 + (b / l) e) + const,

which is the stretched image of the part moved by the sizes a / s and b / l: forms are those of
`workbench.physics.stretched` at these, the :class:`Amplitude` of each shape. A side that stands is stretched by l in
both directions (all its shapes by a / l), one that lies by s: then every length along it scales alike, the normals
stay, and of the radius R = l (r - r0) + R0 there are two matrices, of the measures r ds and ds, with r0 and R0 the
radius of the straight side on the mesh and now.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from itertools import product

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from workbench.physics.term import ModelError, Values

Real = NDArray[np.float64]

#: Share of its range by which a variable may leave it. At the end of that, the error of the interpolation is a hundred
#: to a thousand times as large.
BEYOND = 0.25

#: What rounding leaves of the sum of shares that make one.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Length:
    """A length of the chip: what it is on the mesh (m) and the parameter that moves it, "" if none does."""

    nominal: float
    parameter: str = ""

    def at(self, values: Values) -> float:
        return complex(values[self.parameter]).real if self.parameter else self.nominal


@dataclass(frozen=True)
class Ratio:
    """What is between two lengths of the chip, relative to what it is on the mesh."""

    outer: Length
    inner: Length = Length(0.0)

    def at(self, values: Values) -> tuple[float, dict[str, float]]:
        """Its value, and its derivatives by parameters."""
        nominal = self.outer.nominal - self.inner.nominal
        slopes = {each.parameter: sign / nominal for each, sign in ((self.outer, 1.0), (self.inner, -1.0))
                  if each.parameter}
        return (self.outer.at(values) - self.inner.at(values)) / nominal, slopes


@dataclass(frozen=True)
class Amplitude:
    """The size of a shape as a part of the section sees it: ``size`` (m; rad where it is an ``angle``, of which it is
    the tangent) times the ratio ``grown`` and over the ratio ``stretched``."""

    size: Length
    angle: bool = False
    grown: Ratio | None = None
    stretched: Ratio | None = None

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        ends = [each for ratio in (self.grown, self.stretched) if ratio for each in (ratio.outer, ratio.inner)]
        return tuple(dict.fromkeys(each.parameter for each in (self.size, *ends) if each.parameter))

    def at(self, values: Values) -> tuple[float, dict[str, float]]:
        """Its value, and its derivatives by parameters."""
        size = self.size.at(values)
        value, slopes = (math.tan(size), 1.0 + math.tan(size) ** 2) if self.angle else (size, 1.0)
        found = {self.size.parameter: slopes} if self.size.parameter else {}
        for ratio, power in ((self.grown, 1), (self.stretched, -1)):
            if ratio is not None:
                factor, by = ratio.at(values)
                found = {name: slope * factor**power for name, slope in found.items()}
                for name, slope in by.items():
                    found[name] = found.get(name, 0.0) + value * power * factor ** (power - 1) * slope
                value *= factor**power
        return value, found


@dataclass(frozen=True)
class Grid:
    """Nodes of a polynomial interpolation in several variables within ``bounds``.

    The polynomials are the products of powers b of the variables with sum(b / degrees) <= 1; variables of degree 0 stay
    in the middle. Nodes are those of a Leja sequence in each variable, which make the interpolation unique on any such
    set (Chkifa, Cohen, Schwab 2014, doi:10.1007/s10208-013-9154-z). ``limits`` are those that a value may have, further
    apart where it is no chip any more with lengths at the ends of their ranges as well: there, all stays as it is a
    little (:data:`BEYOND`) outside the bounds.
    """

    bounds: tuple[tuple[float, float], ...]
    degrees: tuple[int, ...]
    limits: tuple[tuple[float, float], ...]

    @cached_property
    def nodes(self) -> tuple[tuple[float, ...], ...]:
        """Values of the variables, node by node."""
        sequence = _leja(max(self.degrees, default=0) + 1)
        return tuple(tuple(0.5 * (low + high) + 0.5 * (high - low) * (sequence[b] if degree else 0.0)
                           for b, degree, (low, high) in zip(powers, self.degrees, self.bounds, strict=True))
                     for powers in _powers(self.degrees))

    def polynomials(self, point: tuple[float, ...]) -> tuple[Real, Real]:
        """The Lagrange polynomials (nodes,) of all nodes at values of the variables, and their slopes (variables,
        nodes).

        Raises:
            ModelError: a value outside its limits.
        """
        for value, (low, high) in zip(point, self.limits, strict=True):
            further = BEYOND * (high - low) + ROUNDING * max(abs(low), abs(high))
            if not low - further <= value <= high + further:
                raise ModelError(f"a shape of {value:.4g} (m, or a slope), as the lengths about it have it, is outside "
                                 f"the range that the model was made for, {low:.4g} to {high:.4g}")
        return _polynomials(self, point)


@lru_cache(maxsize=256)
def _polynomials(grid: Grid, point: tuple[float, ...]) -> tuple[Real, Real]:
    powers = np.array(_powers(grid.degrees))
    free = [2.0 * (x - low) / (high - low) - 1.0 if degree else 0.0
            for x, degree, (low, high) in zip(point, grid.degrees, grid.bounds, strict=True)]
    scaled = [min(max(x, -1.0 - 2.0 * BEYOND), 1.0 + 2.0 * BEYOND) for x in free]
    inverse = _from_nodes(grid.degrees)
    tables = [_chebyshev(x, degree) for x, degree in zip(scaled, grid.degrees, strict=True)]
    taken = np.array([values[powers[:, k]] for k, (values, _) in enumerate(tables)]).reshape(len(tables), -1)
    slopes = []
    for k, ((_, by), degree, (low, high)) in enumerate(zip(tables, grid.degrees, grid.bounds, strict=True)):
        own = by[powers[:, k]] * (2.0 / (high - low) if degree and scaled[k] == free[k] else 0.0)
        slopes.append((own * np.delete(taken, k, axis=0).prod(axis=0)) @ inverse)
    return taken.prod(axis=0) @ inverse, np.array(slopes)


def _chebyshev(x: float, degree: int) -> tuple[Real, Real]:
    """Chebyshev's polynomials (degree + 1,) at x and their slopes."""
    unit = np.eye(degree + 1)
    slopes = chebyshev.chebval(x, chebyshev.chebder(unit)) if degree else np.zeros(1)
    return np.asarray(chebyshev.chebval(x, unit)), np.asarray(slopes)


@cache
def _powers(degrees: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
    """The powers of every polynomial; with each also those of all lower ones."""
    return tuple(powers for powers in product(*(range(degree + 1) for degree in degrees))
                 if sum(b / degree for b, degree in zip(powers, degrees, strict=True) if degree) <= 1.0 + ROUNDING)


@cache
def _from_nodes(degrees: tuple[int, ...]) -> Real:
    """What brings products of Chebyshev's polynomials (n,) into the Lagrange polynomials of the nodes: (n, n)."""
    powers = np.array(_powers(degrees))
    table = _chebyshev_at(np.array(_leja(max(degrees, default=0) + 1)), max(degrees, default=0))
    middle = _chebyshev_at(np.zeros(1), 0)
    values = np.ones((len(powers), len(powers)))
    for k, degree in enumerate(degrees):
        values *= (table if degree else middle)[np.ix_(powers[:, k], powers[:, k])]
    return np.asarray(np.linalg.inv(values))


def _chebyshev_at(x: Real, degree: int) -> Real:
    """(points, degree + 1)."""
    return np.asarray(chebyshev.chebvander(x, degree))


@cache
def _leja(count: int) -> tuple[float, ...]:
    """The first points of a Leja sequence on [-1, 1] that begins in the middle."""
    found = [0.0, 1.0, -1.0]
    candidates = np.linspace(-1.0, 1.0, 4001)
    while len(found) < count:
        distance = np.log(np.abs(candidates[:, None] - np.array(found)) + 1e-300).sum(axis=1)
        found.append(float(candidates[int(np.argmax(distance))]))
    return tuple(found[:count])


class _OfLengths:
    """A coefficient without frequency that knows its value and all its derivatives at once."""

    def at(self, values: Values) -> tuple[float, Mapping[str, float]]:
        """Its value, and its derivatives by parameters."""
        raise NotImplementedError

    def constant(self, values: Values) -> complex:
        return complex(self.at(values)[0])

    def constant_derivative(self, values: Values, name: str) -> complex:
        return complex(self.at(values)[1].get(name, 0.0))

    def __call__(self, omega: NDArray[np.float64], values: Values) -> NDArray[np.complex128]:
        return np.full(np.shape(omega), self.constant(values))

    def derivative(self, omega: NDArray[np.float64], values: Values, name: str) -> NDArray[np.complex128]:
        return np.full(np.shape(omega), self.constant_derivative(values, name))


@dataclass(frozen=True)
class Node(_OfLengths):
    """The Lagrange polynomial of one node of a grid in some amplitudes."""

    grid: Grid
    amplitudes: tuple[Amplitude, ...]
    number: int

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for each in self.amplitudes for name in each.parameters))

    def at(self, values: Values) -> tuple[float, Mapping[str, float]]:
        found = [each.at(values) for each in self.amplitudes]
        polynomials, slopes = self.grid.polynomials(tuple(value for value, _ in found))
        by: dict[str, float] = {}
        for (_, own), slope in zip(found, slopes[:, self.number], strict=True):
            for name, each in own.items():
                by[name] = by.get(name, 0.0) + float(slope) * each
        return float(polynomials[self.number]), by


@dataclass(frozen=True)
class Receding(_OfLengths):
    """R0 - l r0 (m): what the radius of a side that stands is beyond its image stretched by the ratio l."""

    radius: Length
    stretched: Ratio

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        return Amplitude(self.radius, stretched=self.stretched).parameters

    def at(self, values: Values) -> tuple[float, Mapping[str, float]]:
        ratio, slopes = self.stretched.at(values)
        by = {name: -slope * self.radius.nominal for name, slope in slopes.items()}
        if self.radius.parameter:
            by[self.radius.parameter] = by.get(self.radius.parameter, 0.0) + 1.0
        return self.radius.at(values) - ratio * self.radius.nominal, by


@dataclass(frozen=True)
class Moves:
    """How shapes move a part of a place: the names of the mesh's coordinates at the nodes of a grid in amplitudes.

    ``side`` is the radius of facets along z; None for cells and for facets that lie.
    """

    amplitudes: tuple[Amplitude, ...]
    grid: Grid
    variants: tuple[str, ...]
    side: Length | None = None

    def nodes(self) -> Iterator[tuple[str, Node | None]]:
        """The coordinates and the coefficient of every node; no coefficient where there is one node."""
        for number, variant in enumerate(self.variants):
            yield variant, Node(self.grid, self.amplitudes, number) if len(self.variants) > 1 else None
