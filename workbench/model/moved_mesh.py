"""A mesh moved by sizes of a chip, and interpolated forms.

See `workbench.physics.shaped`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.mesh import SectionMesh
from geometry.names import moved_by
from workbench.fem.elements import Lagrange
from workbench.fem.places import CELL_SIDES, areas, mapped_nodes
from workbench.files.errors import InputError
from workbench.physics.shaped import Amplitude, InterpolationGrid, MovableLength, Moves, ShapeScale
from workbench.physics.term import Term

Real = NDArray[np.float64]
Integers = NDArray[np.int64]
Range = tuple[float, float]

#: Largest degree in one size. Layers that move by about their own thickness would need more.
POWERS = 16

#: Smallest share to which a length between two others may shrink.
LEAST = 0.1

#: Shares of a range, from -1 to 1, of the checks of the interpolation: none is near a node.
CHECKED = (-0.87, -0.36, 0.29, 0.71)

#: Displacements below this share of the largest one are rounding.
STILL = 1e-9


@dataclass(frozen=True)
class Interpolation:
    """Accuracy of forms as functions of shapes.

    ``error`` is the largest relative error of the factors of forms, anywhere in a part. A size relative to the lengths
    about it is covered for changes of each of these by a factor of at most ``followed``, and extrapolated beyond.
    ``neutral`` is the error for terms that are zero on the mesh, on which a shape has an effect of second order. If
    ``carried``, the cells carry a parabola over a moving radius along, with an error of the product of both moves;
    otherwise this raises.
    """

    error: float = 1e-8
    followed: float = 1.0 / LEAST
    carried: bool = False
    neutral: float = 0.0

    def of(self, terms: Sequence[Term], neutral: Collection[Term]) -> Iterator[tuple[list[Term], Interpolation]]:
        """Terms with the interpolation of their forms; neutral terms are separate."""
        loose = set(neutral)
        yield [term for term in terms if term not in loose], self
        yield [term for term in terms if term in loose], replace(self, error=max(self.error, self.neutral))


#: An error as far below those of meshes and solves as that of exact stretching.
TO_ROUNDING = Interpolation()


@dataclass(frozen=True)
class MovedSize:
    """A size of the chip that moves points of a mesh.

    ``name`` is that among the chip's dimensions. ``nominal`` is its size on the mesh of the problem, ``rest`` that on
    the mesh whose points are moved. Forms are polynomials in it on its ``scale``. It is fixed if it is not a
    ``parameter``.
    """

    name: str
    nominal: float
    range: Range
    scale: ShapeScale
    rest: float
    parameter: bool = True

    @property
    def start(self) -> float:
        """Its nominal size on its scale."""
        return self.scale.of(self.nominal)

    @property
    def bounds(self) -> Range:
        """Its range on its scale."""
        low, high = map(self.scale.of, self.range)
        return low, high

    @property
    def length(self) -> MovableLength:
        """Its nominal size and the parameter that moves it."""
        return MovableLength(self.nominal, self.name if self.parameter else "")

    def at(self, value: float) -> float:
        """The size (m or rad) that is `value` on its scale."""
        return self.nominal if value == self.start else self.scale.size(value)


@dataclass(eq=False)
class MovedMesh:
    """The mesh of a chip moved by its sizes, cached.

    ``coordinates`` gives those (2, nodes, cells) of the mesh for sizes (m or rad) by name, with all others at rest:
    None for an impossible chip. ``variants`` has the coordinates that parts need, by name.
    """

    chip: Chip
    coordinates: Callable[[Mapping[str, float]], Real | None]
    interpolation: Interpolation
    variants: dict[str, Real] = field(default_factory=dict)
    _known: dict[tuple[tuple[str, float], ...], Real | None] = field(default_factory=dict)

    def at(self, values: Mapping[MovedSize, float]) -> Real | None:
        """Coordinates (2, nodes, cells) for scaled `values`, others at rest.

        Raises:
            InputError, MeshError: as in ``coordinates``.
        """
        sizes = {size.name: size.at(value) for size, value in values.items() if size.at(value) != size.rest}
        key = tuple(sorted(sizes.items()))
        if key not in self._known:
            self._known[key] = self.coordinates(sizes)
        return self._known[key]

    def existing(self, values: Mapping[MovedSize, float]) -> Real:
        """The coordinates of :meth:`at` for a possible chip."""
        found = self.at(values)
        assert found is not None
        return found

    def moving(self, cells: Cells, sizes: Sequence[MovedSize]) -> NDArray[np.bool_]:
        """Mask (sizes, cells) of the sizes that deform or shift cells. A uniform shift along z does not count. Cells
        may be sides of cells."""
        found = np.zeros((len(sizes), cells.indices.size), dtype=bool)
        for number, size in enumerate(sizes):
            for end in size.bounds:
                everywhere = self.existing({size: end}) - self.existing({})
                shift = cells.nodes(everywhere)
                shift[1] -= shift[1].mean(axis=0)
                found[number] |= np.abs(shift).max(axis=(0, 1)) > STILL * np.abs(everywhere).max()
        return found

    def moves(
        self, cells: Cells, sizes: Sequence[MovedSize], amplitudes: Sequence[Amplitude], bounds: Sequence[Range],
        limits: Sequence[Range], side: MovableLength | None = None,
    ) -> Moves:
        """The motion of cells by `sizes`, interpolated within `bounds`.

        Raises:
            InputError: the range of a size is too wide for the cells.
        """
        metric = Metric(self, sizes, cells)
        grid = interpolation_grid(metric, tuple(bounds), [size.start for size in sizes], tuple(limits), self.chip)
        return Moves(tuple(amplitudes), grid, tuple(
            self._named(dict(zip(sizes, node, strict=True))) for node in grid.nodes), side)

    def _named(self, values: Mapping[MovedSize, float]) -> str:
        """The name of the coordinates for these values, stored as a variant."""
        name = ", ".join(f"{size.name} {value!r}" for size, value in values.items())
        self.variants[name] = self.existing(values)
        return name


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of a mesh, or one side of each cell. ``facets`` are the fixed local coordinate, 0 or 1, and its value.
    ``radius`` (m) is that of the first side's begin; vertical sides all have it."""

    mesh: SectionMesh
    indices: Integers
    facets: tuple[tuple[int, int], ...] = ()
    radius: float = 0.0

    @classmethod
    def of_facets(cls, mesh: SectionMesh, facets: Integers) -> Cells:
        owners = mesh.mesh.f2t[0, facets]
        sides = np.argmax(mesh.mesh.t2f[:, owners] == facets, axis=0)
        return cls(mesh, owners, tuple(CELL_SIDES[side][:2] for side in sides),
                   float(mesh.mesh.p[0, mesh.mesh.facets[0, facets[0]]]))

    def nodes(self, coordinates: Real) -> Real:
        """Coordinates (2, k, cells) of the relevant nodes."""
        own = coordinates[:, :, self.indices]
        if not self.facets:
            return own
        order = math.isqrt(own.shape[1]) - 1
        along = np.array(Lagrange(order).indices)
        return np.stack([own[:, along[:, fixed] == end * order, k] for k, (fixed, end) in enumerate(self.facets)],
                        axis=-1)

    def areas(self, coordinates: Real) -> Real:
        """Factor of an area in local coordinates at the nodes (cells, nodes)."""
        return areas(self._slopes(coordinates, np.array(Lagrange(self.mesh.order).doflocs).T)[1])

    def _slopes(self, coordinates: Real, points: Real) -> tuple[Real, Real]:
        return mapped_nodes(coordinates[:, :, self.indices], points)

    def forms(self, coordinates: Real) -> list[Real]:
        """The factors of every form over them: arrays (cells, points, parts)."""
        at = 0.5 * (1.0 + np.array([-0.9, 0.0, 0.9]))
        if not self.facets:
            r, ((r_along, r_across), (z_along, z_across)) = self._slopes(
                coordinates, np.stack([each.ravel() for each in np.meshgrid(at, at)]))
            area = r_along * z_across - r_across * z_along
            slopes = np.stack([z_across, -z_along, -r_across, r_along], axis=-1)
            pairs = np.stack([slopes[..., i] * slopes[..., j] for i, j in combinations_with_replacement(range(4), 2)],
                             axis=-1) / area[..., None]
            return [(r * area)[..., None], area[..., None], (area / r)[..., None], r[..., None] * slopes, slopes,
                    r[..., None] * pairs, pairs]
        found: list[list[Real]] = []
        for fixed, end in dict.fromkeys(self.facets):
            own = self.indices[[side == (fixed, end) for side in self.facets]]
            r, slopes = mapped_nodes(coordinates[:, :, own], np.insert(at[None], fixed, float(end), axis=0))
            tangent = slopes[:, 1 - fixed]
            length = np.hypot(*tangent)
            parts = [length, *tangent, *(tangent[i] * tangent[j] / length for i, j in ((0, 0), (0, 1), (1, 1)))]
            found.append([np.stack([each * r**power for each in group], axis=-1)
                          for power in (0, 1) for group in (parts, [1.0 / length])])
        return [np.concatenate(group) for group in zip(*found, strict=True)]


Size = TypeVar("Size", bound=MovedSize)


def split_by_sizes(
    place: str, indices: Integers, moving: NDArray[np.bool_], sizes: Sequence[Size]
) -> list[tuple[str, Integers, tuple[Size, ...]]]:
    """The parts of a place with equal subsets of moving `sizes`.

    `moving` (sizes, n) is the mask of its cells or facets (n,).

    Returns:
        name, cells or facets, and sizes of every part; a single part has the place's name.
    """
    patterns = np.unique(moving, axis=1)
    found = []
    for pattern in patterns.T:
        own = tuple(sizes[int(k)] for k in np.flatnonzero(pattern))
        name = place if patterns.shape[1] == 1 else moved_by(place, (size.name for size in own))
        found.append((name, indices[(moving == pattern[:, None]).all(axis=0)], own))
    return found


def joined_meshes(meshes: Sequence[SectionMesh]) -> SectionMesh:
    """One mesh with the parts and variants of several. The meshes are otherwise equal."""
    first = meshes[0]
    regions = {name: cells for mesh in meshes for name, cells in mesh.mesh.subdomains.items()}
    variants = {name: coordinates for mesh in meshes for name, coordinates in mesh.variants.items()}
    if len(regions) == len(first.mesh.subdomains) and len(variants) == len(first.variants):
        return first
    return replace(first, mesh=first.mesh.with_subdomains(regions), variants=variants)


class Metric:
    """The factors of the forms over cells, by the scaled sizes."""

    def __init__(self, mesh: MovedMesh, sizes: Sequence[MovedSize], cells: Cells) -> None:
        self.mesh, self.sizes, self.cells = mesh, sizes, cells
        self._known: dict[tuple[float, ...], list[Real]] = {}

    def __call__(self, point: tuple[float, ...]) -> list[Real]:
        if point not in self._known:
            self._known[point] = self.cells.forms(self.mesh.existing(dict(zip(self.sizes, point, strict=True))))
        return self._known[point]

    def error(self, grid: InterpolationGrid, points: Iterator[tuple[float, ...]]) -> float:
        """The largest relative error of the interpolation at points. Each cell has its own size."""
        at_nodes = [self(node) for node in grid.nodes]
        worst = 0.0
        for point in points:
            weights, _ = grid.polynomials(point)
            for number, exact in enumerate(self(point)):
                found = sum(weight * each[number] for weight, each in zip(weights, at_nodes, strict=True))
                size = np.abs(exact).max(axis=(1, 2))
                worst = max(worst, float((np.abs(found - exact).max(axis=(1, 2)) / size).max()))
        return worst


def interpolation_grid(
    metric: Metric, bounds: tuple[Range, ...], start: Sequence[float], limits: tuple[Range, ...], chip: Chip
) -> InterpolationGrid:
    """The smallest grid with the required accuracy."""
    free = [high > low for low, high in bounds]

    def made(degrees: Sequence[int]) -> InterpolationGrid:
        if max(degrees, default=0) > POWERS:
            names = " and ".join("{} from {:.4g} to {:.4g}".format(size.name, *size.range) for size in metric.sizes)
            raise InputError(chip.file, "range of a shape", names, "a narrower range: it moves cells by about their "
                             "own size")
        return InterpolationGrid(bounds, tuple(start), tuple(degrees), limits)

    def at(shares: Sequence[float]) -> tuple[float, ...]:
        return tuple(0.5 * (low + high) + 0.5 * (high - low) * share
                     for share, (low, high) in zip(shares, bounds, strict=True))

    degrees = [0] * len(bounds)
    for k in map(int, np.flatnonzero(free)):
        alone, points = [0] * len(bounds), [(*start[:k], at([share] * len(bounds))[k], *start[k + 1 :])
                                            for share in CHECKED]
        alone[k] = 1
        while metric.error(made(alone), iter(points)) > metric.mesh.interpolation.error:
            alone[k] += 1
        degrees[k] = alone[k]
    if sum(free) > 1:
        points = [at([CHECKED[(k + turn * (j + 1)) % len(CHECKED)] for j in range(len(bounds))])
                  for k in range(len(CHECKED)) for turn in (1, 2)]
        while metric.error(made(degrees), iter(points)) > metric.mesh.interpolation.error:
            degrees = [degree + 1 if degree else 0 for degree in degrees]
    return made(degrees)
