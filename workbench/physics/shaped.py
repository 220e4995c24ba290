"""Sizes of shapes (`geometry.shapes`) as parameters of the model, without remeshing.

A shape moves points x0 of the section to x0 + a d(x0), with a its size. The contribution of a part of the section is a
smooth function of the sizes of the shapes that move it, and is interpolated in them: matrices at the nodes of an
:class:`InterpolationGrid`, with its Lagrange polynomials as coefficients.

Thicknesses and radii stay exact. In a part that is stretched by s along r and by l along z, the points move to

    r = s (r0 + (a / s) d) + const,      z = l (z0 + (b / l) e) + const,

the stretched image of the part moved by the sizes a / s and b / l: its forms are those of `workbench.physics.stretched`
at these sizes, the :class:`Amplitude` of each shape. A vertical side is stretched by l in both directions (all its
shapes by a / l), a horizontal one by s: then every length along it scales equally and the normals stay. For the radius
R = l (r - r0) + R0 there are two matrices, of the measures r ds and ds, with r0 and R0 the radius of the straight side
on the mesh and now.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cache, cached_property, lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from workbench.physics.term import ModelError, Values, WithoutFrequency

Real = NDArray[np.float64]

#: Share of its range by which a variable may exceed it. At that distance, the error of the interpolation is a hundred
#: to a thousand times as large as within the range.
BEYOND = 0.25

#: Rounding tolerance of a sum of shares.
ROUNDING = 1e-9


@dataclass(frozen=True)
class MovableLength:
    """A length or place of the chip, and its parameter.

    ``nominal`` (m) is its value on the mesh; ``parameter`` is "" if none moves it. It moves ``by`` 1 or -1 times the
    parameter, whose value on the mesh is ``begin`` (m), by default the nominal length.
    """

    nominal: float
    parameter: str = ""
    by: int = 1
    begin: float | None = None

    def at(self, values: Values) -> float:
        return self.of(complex(values[self.parameter]).real) if self.parameter else self.nominal

    def of(self, value: float) -> float:
        """Its value (m) for a value of the parameter."""
        return value if self.begin is None else self.nominal + self.by * (value - self.begin)


@dataclass(frozen=True)
class Ratio:
    """The distance between two lengths, relative to its value on the mesh."""

    outer: MovableLength
    inner: MovableLength = MovableLength(0.0)

    def at(self, values: Values) -> tuple[float, dict[str, float]]:
        """Its value, and its derivatives by parameters."""
        nominal = self.outer.nominal - self.inner.nominal
        slopes: dict[str, float] = {}
        for each, sign in ((self.outer, 1.0), (self.inner, -1.0)):
            if each.parameter:
                slopes[each.parameter] = slopes.get(each.parameter, 0.0) + sign * each.by / nominal
        return (self.outer.at(values) - self.inner.at(values)) / nominal, slopes


class ShapeScale(Enum):
    """A scale on which forms are almost polynomials of a shape's size."""

    #: Points move in proportion to the size itself.
    PROPORTIONAL = "size"
    #: Points move in proportion to the tangent of an angle.
    TANGENT = "tan size"
    #: The contribution of cells between two faces depends on their distance and its inverse: both are smooth
    #: functions of the logarithm, over any range.
    LOGARITHM = "ln size"

    def of(self, size: float) -> float:
        """A size (m or rad) on this scale."""
        if self is ShapeScale.LOGARITHM:
            return math.log(size)
        return math.tan(size) if self is ShapeScale.TANGENT else size

    def size(self, value: float) -> float:
        """The size (m or rad) whose value on this scale is `value`."""
        if self is ShapeScale.LOGARITHM:
            return math.exp(value)
        return math.atan(value) if self is ShapeScale.TANGENT else value

    def slope(self, size: float) -> float:
        """The derivative of :meth:`of` by the size."""
        if self is ShapeScale.LOGARITHM:
            return 1.0 / size
        return 1.0 + math.tan(size) ** 2 if self is ShapeScale.TANGENT else 1.0


@dataclass(frozen=True)
class Amplitude:
    """The size of a shape in the coordinates of a part. It is ``size`` (m or rad) on its ``scale``, times the ratio
    ``grown`` and over the ratio ``stretched``."""

    size: MovableLength
    scale: ShapeScale = ShapeScale.PROPORTIONAL
    grown: Ratio | None = None
    stretched: Ratio | None = None

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        ends = [each for ratio in (self.grown, self.stretched) if ratio for each in (ratio.outer, ratio.inner)]
        return tuple(dict.fromkeys(each.parameter for each in (self.size, *ends) if each.parameter))

    def at(self, values: Values) -> tuple[float, dict[str, float]]:
        """Its value, and its derivatives by parameters."""
        size = self.size.at(values)
        value = self.scale.of(size)
        found = {self.size.parameter: self.scale.slope(size)} if self.size.parameter else {}
        for ratio, power in ((self.grown, 1), (self.stretched, -1)):
            if ratio is not None:
                factor, by = ratio.at(values)
                found = {name: slope * factor**power for name, slope in found.items()}
                for name, slope in by.items():
                    found[name] = found.get(name, 0.0) + value * power * factor ** (power - 1) * slope
                value *= factor**power
        return value, found


@dataclass(frozen=True)
class InterpolationGrid:
    """Nodes of a polynomial interpolation in several variables within ``bounds``.

    The first node is ``start``. The polynomials are the products of powers b of the variables with sum(b / degrees) <=
    1; variables of degree 0 stay at the start. Nodes are those of a Leja sequence in each variable, which make the
    interpolation unique on any such set (Chkifa, Cohen, Schwab 2014, doi:10.1007/s10208-013-9154-z). While a variable
    is at its start, all nodes elsewhere have weight exactly zero. ``limits`` are the admissible values of each
    variable. They are wider than the bounds if only combinations of extreme lengths reach them; polynomials are then
    constant from a little (:data:`BEYOND`) outside the bounds.
    """

    bounds: tuple[tuple[float, float], ...]
    start: tuple[float, ...]
    degrees: tuple[int, ...]
    limits: tuple[tuple[float, float], ...]

    @cached_property
    def sequences(self) -> tuple[tuple[float, ...], ...]:
        """The scaled nodes (degree + 1,) of every variable. They are from -1 to 1."""
        return tuple(_leja(self.scaled(k, start), degree + 1)
                     for k, (start, degree) in enumerate(zip(self.start, self.degrees, strict=True)))

    @cached_property
    def nodes(self) -> tuple[tuple[float, ...], ...]:
        """Values of the variables, node by node."""
        values = [(start, *(0.5 * (low + high) + 0.5 * (high - low) * each for each in sequence[1:]))
                  for start, sequence, (low, high) in zip(self.start, self.sequences, self.bounds, strict=True)]
        return tuple(tuple(own[b] for b, own in zip(powers, values, strict=True)) for powers in _powers(self.degrees))

    def scaled(self, variable: int, value: float) -> float:
        """A value scaled to -1 to 1 over its bounds. It is 0 for degree 0."""
        low, high = self.bounds[variable]
        return (value - 0.5 * (low + high)) / (0.5 * (high - low)) if self.degrees[variable] else 0.0

    def outside(self, point: tuple[float, ...]) -> int | None:
        """The index of the first variable beyond its limits, or None."""
        for variable, (value, (low, high)) in enumerate(zip(point, self.limits, strict=True)):
            further = BEYOND * (high - low) + ROUNDING * max(abs(low), abs(high))
            if not low - further <= value <= high + further:
                return variable
        return None

    def polynomials(self, point: tuple[float, ...]) -> tuple[Real, Real]:
        """The Lagrange polynomials (nodes,) at a point, and their slopes (variables, nodes)."""
        return _polynomials(self, point)


@lru_cache(maxsize=4096)
def _polynomials(grid: InterpolationGrid, point: tuple[float, ...]) -> tuple[Real, Real]:
    powers, inverse = np.array(_powers(grid.degrees)), _from_nodes(grid)
    tables = []
    for k, value in enumerate(point):
        free = grid.scaled(k, value)
        clipped = min(max(free, -1.0 - 2.0 * BEYOND), 1.0 + 2.0 * BEYOND)
        low, high = grid.bounds[k]
        newton, by = _newton(grid.sequences[k], clipped)
        tables.append((newton[powers[:, k]], by[powers[:, k]] * (
            2.0 / (high - low) if grid.degrees[k] and clipped == free else 0.0)))
    taken = np.array([values for values, _ in tables])
    slopes = [(by * np.delete(taken, k, axis=0).prod(axis=0)) @ inverse for k, (_, by) in enumerate(tables)]
    return taken.prod(axis=0) @ inverse, np.array(slopes)


def _newton(sequence: tuple[float, ...], x: float) -> tuple[Real, Real]:
    """Newton's polynomials (n,) of the nodes at x, and their slopes. Each polynomial is 0 at all nodes before its
    own."""
    values, slopes = [1.0], [0.0]
    for node in sequence[:-1]:
        slopes.append(slopes[-1] * (x - node) + values[-1])
        values.append(values[-1] * (x - node))
    return np.array(values), np.array(slopes)


@cache
def _powers(degrees: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
    """The powers of every polynomial; the set contains all lower ones."""
    return tuple(powers for powers in product(*(range(degree + 1) for degree in degrees))
                 if sum(b / degree for b, degree in zip(powers, degrees, strict=True) if degree) <= 1.0 + ROUNDING)


@lru_cache(maxsize=1024)
def _from_nodes(grid: InterpolationGrid) -> Real:
    """The matrix (n, n) from Newton products to Lagrange polynomials."""
    powers = np.array(_powers(grid.degrees))
    values = np.ones((len(powers), len(powers)))
    for k, sequence in enumerate(grid.sequences):
        table = np.array([_newton(sequence, node)[0] for node in sequence])
        values *= table[np.ix_(powers[:, k], powers[:, k])]
    # The matrix is triangular, since a polynomial is 0 at all nodes before its own.
    return np.asarray(solve_triangular(values, np.eye(len(powers)), lower=True))


@cache
def _leja(start: float, count: int) -> tuple[float, ...]:
    """The first points of a Leja sequence on [-1, 1] from `start`."""
    found = [start]
    candidates = np.linspace(-1.0, 1.0, 4001)
    while len(found) < count:
        distance = np.log(np.abs(candidates[:, None] - np.array(found)) + 1e-300).sum(axis=1)
        found.append(float(candidates[int(np.argmax(distance))]))
    return tuple(found)


class _OfLengths(WithoutFrequency):
    """A coefficient without frequency that computes value and derivatives together."""

    def at(self, values: Values) -> tuple[float, Mapping[str, float]]:
        """Its value, and its derivatives by parameters."""
        raise NotImplementedError

    def constant(self, values: Values) -> complex:
        return complex(self.at(values)[0])

    def constant_derivative(self, values: Values, name: str) -> complex:
        return complex(self.at(values)[1].get(name, 0.0))


@dataclass(frozen=True)
class GridPolynomial(_OfLengths):
    """The Lagrange polynomial of one node of a grid in some amplitudes."""

    grid: InterpolationGrid
    amplitudes: tuple[Amplitude, ...]
    number: int

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for each in self.amplitudes for name in each.parameters))

    def at(self, values: Values) -> tuple[float, Mapping[str, float]]:
        """Its value, and its derivatives by parameters.

        Raises:
            ModelError: a size outside the range of the model.
        """
        found = [each.at(values) for each in self.amplitudes]
        point = tuple(value for value, _ in found)
        outside = self.grid.outside(point)
        if outside is not None:
            one, scale = self.amplitudes[outside], self.amplitudes[outside].scale
            size, low, high = map(scale.size, (point[outside], *self.grid.limits[outside]))
            raise ModelError(f"{one.size.parameter or 'a shape'} of {size:.4g} (m or rad), relative to the lengths "
                             f"about it, is outside the range of this model, {low:.4g} to {high:.4g}")
        polynomials, slopes = self.grid.polynomials(point)
        by: dict[str, float] = {}
        for (_, own), slope in zip(found, slopes[:, self.number], strict=True):
            for name, each in own.items():
                by[name] = by.get(name, 0.0) + float(slope) * each
        return float(polynomials[self.number]), by


@dataclass(frozen=True)
class Receding(_OfLengths):
    """The difference R0 - l r0 (m) for a vertical side. It is the radius of the side minus that of its image stretched
    by the ratio l."""

    radius: MovableLength
    stretched: Ratio

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        return Amplitude(self.radius, stretched=self.stretched).parameters

    def at(self, values: Values) -> tuple[float, Mapping[str, float]]:
        ratio, slopes = self.stretched.at(values)
        by = {name: -slope * self.radius.nominal for name, slope in slopes.items()}
        if self.radius.parameter:
            by[self.radius.parameter] = by.get(self.radius.parameter, 0.0) + self.radius.by
        return self.radius.at(values) - ratio * self.radius.nominal, by


@dataclass(frozen=True)
class Moves:
    """The motion of a part of a place by shapes.

    ``variants`` are the names of the mesh's coordinates at the nodes of the ``grid`` in ``amplitudes``; ``side`` is the
    radius of vertical facets, None for cells and for horizontal facets.
    """

    amplitudes: tuple[Amplitude, ...]
    grid: InterpolationGrid
    variants: tuple[str, ...]
    side: MovableLength | None = None

    def nodes(self) -> Iterator[tuple[str, GridPolynomial | None]]:
        """The coordinates and coefficient of every node; None for a single node."""
        for number, variant in enumerate(self.variants):
            yield variant, GridPolynomial(self.grid, self.amplitudes, number) if len(self.variants) > 1 else None
