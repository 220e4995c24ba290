"""Which parts of a mesh the shapes of a chip's layers move, and the moved meshes that their forms are interpolated
between (see `workbench.physics.shaped`)."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement, product
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.mesh import SectionMesh
from geometry.names import moved_by
from geometry.shapes import ShapeReach, possible, reach
from geometry.stretch import Piece
from workbench.fem.elements import Lagrange
from workbench.fem.places import SIDES, areas, mapped_nodes
from workbench.files.errors import InputError
from workbench.model.shaped_mesh import coordinates_of, shaped
from workbench.physics.shaped import Amplitude, InterpolationGrid, MovableLength, Moves, Ratio, ShapeScale
from workbench.physics.term import Term

Real = NDArray[np.float64]
Integers = NDArray[np.int64]
Range = tuple[float, float]

#: Most powers of one size. More are asked for where a layer is moved by about its own thickness.
POWERS = 16

#: Where lengths change as well, forms are interpolated as far as so much is left of the area of every cell, and
#: extrapolated beyond: a bow of half the bond that it compresses, as thin as that can get. A quarter takes twice as
#: many nodes.
LEFT = 0.5

#: No length between two others is taken to shrink to less than this share.
LEAST = 0.1


#: Shares of a range at which the interpolation is checked, from -1 to 1: none is near a node.
CHECKED = (-0.87, -0.36, 0.29, 0.71)


@dataclass(frozen=True)
class Interpolation:
    """How well forms follow shapes.

    ``error`` is the largest relative one of what forms are made of, anywhere in a part. What a size is relative to the
    lengths about it is covered while each of these changes by a factor of ``followed`` at most, even where it may move
    further, and extrapolated beyond. ``aside`` is the error for terms that are nothing on the mesh: what a shape does
    to them is of second order. Where ``carried``, a parabola over a radius that moves is carried along with the cells,
    which is off by the product of both moves; it is refused else.
    """

    error: float = 1e-8
    followed: float = 1.0 / LEAST
    carried: bool = False
    aside: float = 0.0

    def of(self, terms: Sequence[Term], asides: Collection[Term]) -> Iterator[tuple[list[Term], Interpolation]]:
        """Terms with how well they follow, those that are nothing on the mesh apart."""
        loose = set(asides)
        yield [term for term in terms if term not in loose], self
        yield [term for term in terms if term in loose], replace(self, error=max(self.error, self.aside))


#: As far below the errors of meshes and solves as what stretches exactly.
TO_ROUNDING = Interpolation()


@dataclass(frozen=True)
class LayerShape:
    """A shape of a layer: its name among the dimensions of the chip, the ``layer`` that has it, how points follow it,
    its size, and the range of that (m or rad)."""

    name: str
    layer: str
    reach: ShapeReach
    size: MovableLength
    range: Range

    @property
    def amplitudes(self) -> Range:
        """The range of what points are moved in proportion to, on the mesh as it is."""
        low, high = map(self.scale.of, self.range)
        return low, high

    @property
    def scale(self) -> ShapeScale:
        return ShapeScale.TANGENT if self.reach.angle else ShapeScale.PROPORTIONAL


def shapes_of(chip: Chip, ranges: Mapping[str, Range]) -> tuple[LayerShape, ...]:
    """The shapes of a chip, but for those that stay at 0; those with `ranges` by name are parameters."""
    found = []
    for name, (region, shape) in possible(chip).items():
        size = getattr(chip.layer(region), shape)
        if size is not None and (size.value or name in ranges):
            found.append(LayerShape(name, region, reach(chip.layer(region), shape),
                                    MovableLength(size.value, name if name in ranges else ""),
                                    ranges.get(name, (size.value, size.value))))
    return tuple(found)


@dataclass(eq=False)
class MovedMeshes:
    """The mesh of a chip's straight section moved by its shapes, as often as is asked for.

    ``lengths`` are the ranges (m) of the thicknesses and radii that are parameters, by name; ``nominal`` the thickness
    (m) of every layer. ``variants`` holds the coordinates that parts need, by the name they are called.
    """

    straight: SectionMesh
    chip: Chip
    shapes: tuple[LayerShape, ...]
    lengths: Mapping[str, Range]
    nominal: Mapping[str, float]
    interpolation: Interpolation = TO_ROUNDING
    variants: dict[str, Real] = field(default_factory=dict)
    _known: dict[tuple[tuple[str, float], ...], Real | None] = field(default_factory=dict)

    def check(self) -> None:
        """Refuse ranges that fold a cell.

        Raises:
            MeshError: a size within its range does.
        """
        moving = [shape for shape in self.shapes if shape.size.parameter]
        for ends in product(*(sorted(set(shape.range)) for shape in moving)):
            shaped(self.straight, self.chip.with_dimensions(
                dict(zip((shape.name for shape in moving), ends, strict=True))))

    def at(self, sizes: Mapping[LayerShape, float]) -> Real | None:
        """Coordinates (2, nodes, cells) by the amplitudes of some shapes, all others at nothing; None where the chip
        cannot be so."""
        key = tuple((shape.name, value) for shape, value in sizes.items())
        if key not in self._known:
            values = {shape.name: 0.0 for shape in self.shapes} | {
                shape.name: shape.scale.size(value) for shape, value in sizes.items()}
            try:
                self._known[key] = coordinates_of(self.straight, self.chip.with_dimensions(values))
            except InputError:
                self._known[key] = None
        return self._known[key]

    def named(self, sizes: Mapping[LayerShape, float]) -> str:
        """The name of the coordinates for these amplitudes, which are kept under it."""
        name = ", ".join(f"{shape.name} {value!r}" for shape, value in sizes.items())
        coordinates = self.at(sizes)
        assert coordinates is not None
        self.variants[name] = coordinates
        return name

    def moves(self, piece: Piece, shapes: Sequence[LayerShape], cells: Cells, column: Ratio | None,
              side: MovableLength | None) -> Moves:
        """How `shapes` move a piece of a place, ``column`` being the ratio along r that the piece is stretched by.

        Raises:
            InputError: the range of a size is too wide for the thickness of what it moves.
        """
        amplitudes = tuple(self._amplitude(shape, piece, cells, column, side) for shape in shapes)
        inner = [shape.amplitudes for shape in shapes]
        outer, followed = ([self._range(shape, amplitude, most) for shape, amplitude in zip(
            shapes, amplitudes, strict=True)] for most in (1.0 / LEAST, self.interpolation.followed))
        bounds = self._unfolded(shapes, cells, inner, followed)
        metric = Metric(self, shapes, cells)
        start = [shape.scale.of(shape.size.nominal) for shape in shapes]
        grid = interpolation_grid(metric, tuple(bounds), start, tuple(outer), self.chip)
        return Moves(amplitudes, grid, tuple(self.named(dict(zip(shapes, node, strict=True))) for node in grid.nodes),
                     side)

    def _thickness(self, layer: str) -> Ratio:
        return Ratio(MovableLength(self.nominal[layer], f"{layer}.thickness"))

    def _amplitude(self, shape: LayerShape, piece: Piece, cells: Cells, column: Ratio | None,
                   side: MovableLength | None) -> Amplitude:
        grown = self._thickness(shape.layer) if shape.reach.angle else None
        if cells.facets:
            stretched = column if side is None else self._thickness(piece.layer)
        else:
            stretched = column if shape.reach.upright else self._thickness(piece.layer)
        if grown == stretched:
            grown = stretched = None
        return Amplitude(shape.size, shape.scale, grown, stretched)

    def _range(self, shape: LayerShape, amplitude: Amplitude, most: float) -> Range:
        """What an amplitude can be while its size and the lengths that it follows move within their ranges, and their
        ratios from one over `most` to that."""
        ends = list(shape.amplitudes)
        for ratio, power in ((amplitude.grown, 1), (amplitude.stretched, -1)):
            if ratio is not None:
                (low, high), (below, above) = (
                    (min(each.nominal, least), max(each.nominal, greatest)) for each in (ratio.outer, ratio.inner)
                    for least, greatest in [self.lengths.get(each.parameter, (each.nominal,) * 2)])
                width = ratio.outer.nominal - ratio.inner.nominal
                ends = [end * min(max((out - within) / width, 1.0 / most), most) ** power for end in ends
                        for out, within in ((low, above), (high, below))]
        return min(ends), max(ends)

    def _unfolded(self, shapes: Sequence[LayerShape], cells: Cells, inner: Sequence[Range],
                  outer: Sequence[Range]) -> list[Range]:
        """The widest ranges between two that leave something of every cell."""
        straight = self.at(dict.fromkeys(shapes, 0.0))
        assert straight is not None
        least = LEFT * cells.areas(straight)
        for share in (1.0, 0.8, 0.6, 0.4, 0.2, 0.0):
            ranges = [tuple(a + share * (b - a) for a, b in zip(*both, strict=True))
                      for both in zip(inner, outer, strict=True)]
            corners = (self.at(dict(zip(shapes, corner, strict=True))) for corner in product(*ranges))
            if share == 0.0 or all(each is not None and (cells.areas(each) > least).all() for each in corners):
                break
        return [(low, high) for low, high in ranges]


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of a mesh; where ``facets``, one side of each (the fixed local coordinate, 0 or 1, and where).

    ``radius`` (m) is the one that the first of these sides begins at: of sides that stand, that of all.
    """

    mesh: SectionMesh
    indices: Integers
    facets: tuple[tuple[int, int], ...] = ()
    radius: float = 0.0

    @classmethod
    def of_facets(cls, mesh: SectionMesh, facets: Integers) -> Cells:
        owners = mesh.mesh.f2t[0, facets]
        sides = np.argmax(mesh.mesh.t2f[:, owners] == facets, axis=0)
        return cls(mesh, owners, tuple(SIDES[side][:2] for side in sides),
                   float(mesh.mesh.p[0, mesh.mesh.facets[0, facets[0]]]))

    def nodes(self, coordinates: Real) -> Real:
        """Coordinates (2, k, cells) of the nodes that matter."""
        own = coordinates[:, :, self.indices]
        if not self.facets:
            return own
        order = math.isqrt(own.shape[1]) - 1
        along = np.array(Lagrange(order).indices)
        return np.stack([own[:, along[:, fixed] == end * order, k] for k, (fixed, end) in enumerate(self.facets)],
                        axis=-1)

    def areas(self, coordinates: Real) -> Real:
        """What an area in local coordinates is multiplied by at the nodes (cells, nodes)."""
        return areas(self._slopes(coordinates, np.array(Lagrange(self.mesh.order).doflocs).T)[1])

    def _slopes(self, coordinates: Real, points: Real) -> tuple[Real, Real]:
        return mapped_nodes(coordinates[:, :, self.indices], points)

    def forms(self, coordinates: Real) -> list[Real]:
        """What every form over them is made of, at a few points: arrays (cells, points, parts)."""
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


class Size(Protocol):
    """A size that moves cells: its name, and its range (m or rad)."""

    @property
    def name(self) -> str: ...

    @property
    def range(self) -> Range: ...


Sized = TypeVar("Sized", bound=Size)


def taken_apart(
    place: str, indices: Integers, moving: NDArray[np.bool_], sizes: Sequence[Sized]
) -> list[tuple[str, Integers, tuple[Sized, ...]]]:
    """The parts of a place that the same of some `sizes` move, `moving` (sizes, n) each of its cells or facets (n,).

    Returns:
        name, cells or facets, and sizes of every part; the place itself where there is one.
    """
    patterns = np.unique(moving, axis=1)
    found = []
    for pattern in patterns.T:
        own = tuple(sizes[int(k)] for k in np.flatnonzero(pattern))
        name = place if patterns.shape[1] == 1 else moved_by(place, (size.name for size in own))
        found.append((name, indices[(moving == pattern[:, None]).all(axis=0)], own))
    return found


def moved_pieces(mesh: SectionMesh, pieces: Sequence[Piece], meshes: MovedMeshes) -> tuple[
        SectionMesh, list[tuple[Piece, tuple[LayerShape, ...]]]]:
    """Pieces of a region taken apart further by the shapes that move their cells; the mesh names all of them."""
    regions = dict(mesh.mesh.subdomains)
    found: list[tuple[Piece, tuple[LayerShape, ...]]] = []
    for piece in pieces:
        indices = np.asarray(regions[piece.name])
        for name, own, shapes in taken_apart(piece.name, indices, _moving(meshes, Cells(mesh, indices)), meshes.shapes):
            regions[name] = own
            found.append((replace(piece, name=name), shapes))
    return replace(mesh, mesh=mesh.mesh.with_subdomains(regions)), found


def joined_meshes(meshes: Sequence[SectionMesh]) -> SectionMesh:
    """One of several meshes that are the same but for the parts they name and the variants they have: with all."""
    first = meshes[0]
    regions = {name: cells for mesh in meshes for name, cells in mesh.mesh.subdomains.items()}
    variants = {name: coordinates for mesh in meshes for name, coordinates in mesh.variants.items()}
    if len(regions) == len(first.mesh.subdomains) and len(variants) == len(first.variants):
        return first
    return replace(first, mesh=first.mesh.with_subdomains(regions), variants=variants)


def shapes_that_move(meshes: MovedMeshes, cells: Cells) -> tuple[LayerShape, ...]:
    """Those that move any of some cells, or of sides of cells."""
    return tuple(meshes.shapes[k] for k in np.flatnonzero(_moving(meshes, cells).any(axis=1)))


def _moving(meshes: MovedMeshes, cells: Cells) -> NDArray[np.bool_]:
    """Which shapes move which cells: (shapes, cells)."""
    straight = meshes.at({})
    assert straight is not None
    before = cells.nodes(straight)
    found = []
    for shape in meshes.shapes:
        # So small that no cell folds, and any layer can have it.
        size = 1e-3 * meshes.nominal[shape.layer]
        after = meshes.at({shape: 1e-3 if shape.reach.angle else size})
        assert after is not None
        found.append(np.abs(cells.nodes(after) - before).max(axis=(0, 1)) > 1e-9 * size)
    return np.array(found).reshape(len(found), cells.indices.size)


class Meshes(Protocol):
    """What gives the coordinates of a mesh for other sizes, and how well forms are to follow them."""

    @property
    def interpolation(self) -> Interpolation: ...

    def at(self, sizes: Mapping[Any, float]) -> Real | None: ...


class Metric:
    """What the forms over some cells are made of, by the amplitudes of the shapes that move them."""

    def __init__(self, meshes: Meshes, shapes: Sequence[Size], cells: Cells) -> None:
        self.meshes, self.shapes, self.cells = meshes, shapes, cells
        self._known: dict[tuple[float, ...], list[Real]] = {}

    def __call__(self, point: tuple[float, ...]) -> list[Real]:
        if point not in self._known:
            coordinates = self.meshes.at(dict(zip(self.shapes, point, strict=True)))
            assert coordinates is not None
            self._known[point] = self.cells.forms(coordinates)
        return self._known[point]

    def error(self, grid: InterpolationGrid, points: Iterator[tuple[float, ...]]) -> float:
        """The largest error of the interpolation on a grid at some points, relative to each cell's own size."""
        at_nodes = [self(node) for node in grid.nodes]
        worst = 0.0
        for point in points:
            weights, _ = grid.polynomials(point)
            for number, exact in enumerate(self(point)):
                found = sum(weight * each[number] for weight, each in zip(weights, at_nodes, strict=True))
                size = np.abs(exact).max(axis=(1, 2))
                worst = max(worst, float((np.abs(found - exact).max(axis=(1, 2)) / size).max()))
        return worst


def interpolation_grid(metric: Metric, bounds: tuple[Range, ...], start: Sequence[float], limits: tuple[Range, ...],
          chip: Chip) -> InterpolationGrid:
    """The smallest grid that interpolates as well as wanted."""
    free = [high > low for low, high in bounds]

    def made(degrees: Sequence[int]) -> InterpolationGrid:
        if max(degrees, default=0) > POWERS:
            names = " and ".join("{} from {:.4g} to {:.4g}".format(shape.name, *shape.range) for shape in metric.shapes)
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
        while metric.error(made(alone), iter(points)) > metric.meshes.interpolation.error:
            alone[k] += 1
        degrees[k] = alone[k]
    if sum(free) > 1:
        points = [at([CHECKED[(k + turn * (j + 1)) % len(CHECKED)] for j in range(len(bounds))])
                  for k in range(len(CHECKED)) for turn in (1, 2)]
        while metric.error(made(degrees), iter(points)) > metric.meshes.interpolation.error:
            degrees = [degree + 1 if degree else 0 for degree in degrees]
    return made(degrees)
