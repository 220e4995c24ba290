"""Shapes of layers as parameters: the moved parts of the section.

Thicknesses and radii stretch the section exactly in addition (see `workbench.physics.shaped`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.mesh import SectionMesh
from geometry.shapes import ShapeReach, possible, reach
from geometry.stretch import Piece
from workbench.files.errors import InputError
from workbench.model.moved_mesh import LEAST, Cells, Interpolation, MovedMesh, MovedSize, split_by_sizes
from workbench.model.shaped_mesh import coordinates_of, shaped
from workbench.physics.shaped import Amplitude, MovableLength, Moves, Ratio, ShapeScale

Real = NDArray[np.float64]
Range = tuple[float, float]

#: If lengths change as well, forms are interpolated down to this share of the area of every cell, and extrapolated
#: beyond: a bow of half the bond that it compresses at its thinnest. A quarter takes twice as many nodes.
LEAST_AREA_SHARE = 0.5


@dataclass(frozen=True, kw_only=True)
class LayerShape(MovedSize):
    """A shape of a ``layer``, and the way points follow it."""

    layer: str
    reach: ShapeReach


def shapes_of(chip: Chip, ranges: Mapping[str, Range]) -> tuple[LayerShape, ...]:
    """The shapes of a chip, except those fixed at 0. Those with `ranges` by name are parameters."""
    found = []
    for name, (region, shape) in possible(chip).items():
        size, followed = getattr(chip.layer(region), shape), reach(chip.layer(region), shape)
        if size is not None and (size.value or name in ranges):
            scale = ShapeScale.TANGENT if followed.angle else ShapeScale.PROPORTIONAL
            found.append(LayerShape(name, size.value, ranges.get(name, (size.value, size.value)), scale, 0.0,
                                    name in ranges, layer=region, reach=followed))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class ShapedLayers:
    """The straight section of a chip moved by its shapes. ``lengths`` are the ranges (m) of the thicknesses and radii
    that are parameters, by name; ``nominal`` the thickness (m) of every layer."""

    mesh: MovedMesh
    shapes: tuple[LayerShape, ...]
    lengths: Mapping[str, Range]
    nominal: Mapping[str, float]

    @classmethod
    def of(
        cls, straight: SectionMesh, chip: Chip, shapes: tuple[LayerShape, ...], lengths: Mapping[str, Range],
        nominal: Mapping[str, float], interpolation: Interpolation,
    ) -> ShapedLayers:
        """The `straight` mesh of a chip with its shapes.

        Raises:
            MeshError: a size within its range folds a cell.
        """
        at_rest = {shape.name: shape.rest for shape in shapes}

        def coordinates(sizes: Mapping[str, float]) -> Real | None:
            try:
                return coordinates_of(straight, chip.with_dimensions({**at_rest, **sizes}))
            except InputError:
                return None

        moving = [shape for shape in shapes if shape.parameter]
        for ends in product(*(sorted(set(shape.range)) for shape in moving)):
            shaped(straight, chip.with_dimensions(dict(zip((shape.name for shape in moving), ends, strict=True))))
        return cls(MovedMesh(chip, coordinates, interpolation), shapes, lengths, nominal)

    def following(self, interpolation: Interpolation) -> ShapedLayers:
        """A copy with the accuracy of that `interpolation`."""
        return replace(self, mesh=replace(self.mesh, interpolation=interpolation))

    def pieces(self, mesh: SectionMesh, pieces: Sequence[Piece]) -> tuple[
            SectionMesh, list[tuple[Piece, tuple[LayerShape, ...]]]]:
        """Pieces of a region split by the shapes that move them. The mesh names all of them."""
        regions = dict(mesh.mesh.subdomains)
        found: list[tuple[Piece, tuple[LayerShape, ...]]] = []
        for piece in pieces:
            indices = np.asarray(regions[piece.name])
            moving = self.mesh.moving(Cells(mesh, indices), self.shapes)
            for name, own, shapes in split_by_sizes(piece.name, indices, moving, self.shapes):
                regions[name] = own
                found.append((replace(piece, name=name), shapes))
        return replace(mesh, mesh=mesh.mesh.with_subdomains(regions)), found

    def moving(self, cells: Cells) -> tuple[LayerShape, ...]:
        """The shapes that move any of some cells or sides."""
        return tuple(self.shapes[k] for k in np.flatnonzero(self.mesh.moving(cells, self.shapes).any(axis=1)))

    def moves(self, piece: Piece, shapes: Sequence[LayerShape], cells: Cells, column: Ratio | None,
              side: MovableLength | None) -> Moves:
        """The motion of a piece of a place by `shapes`.

        ``column`` is its stretch ratio along r.

        Raises:
            InputError: the range of a size is too wide for the thickness of the moved layers.
        """
        amplitudes = [self._amplitude(shape, piece, cells, column, side) for shape in shapes]
        outer, followed = ([self._range(shape, amplitude, most) for shape, amplitude in zip(
            shapes, amplitudes, strict=True)] for most in (1.0 / LEAST, self.mesh.interpolation.followed))
        bounds = self._unfolded(shapes, cells, [shape.bounds for shape in shapes], followed)
        return self.mesh.moves(cells, shapes, amplitudes, bounds, outer, side)

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
        return Amplitude(shape.length, shape.scale, grown, stretched)

    def _range(self, shape: LayerShape, amplitude: Amplitude, most: float) -> Range:
        """The range of an amplitude over ranges of size and lengths. Ratios of lengths are limited to between one over
        `most` and `most`."""
        ends = list(shape.bounds)
        for ratio, power in ((amplitude.grown, 1), (amplitude.stretched, -1)):
            if ratio is not None:
                (low, high), (below, above) = (
                    (min(each.nominal, least), max(each.nominal, greatest)) for each in (ratio.outer, ratio.inner)
                    for least, greatest in [self._ends(each)])
                width = ratio.outer.nominal - ratio.inner.nominal
                ends = [end * min(max((out - within) / width, 1.0 / most), most) ** power for end in ends
                        for out, within in ((low, above), (high, below))]
        return min(ends), max(ends)

    def _ends(self, length: MovableLength) -> Range:
        """The least and the greatest value (m) of a length."""
        if length.parameter not in self.lengths:
            return length.nominal, length.nominal
        low, high = sorted(map(length.of, self.lengths[length.parameter]))
        return low, high

    def _unfolded(self, shapes: Sequence[LayerShape], cells: Cells, inner: Sequence[Range],
                  outer: Sequence[Range]) -> list[Range]:
        """The widest ranges between two at which every cell keeps enough area."""
        least = LEAST_AREA_SHARE * cells.areas(self.mesh.existing({}))
        for share in (1.0, 0.8, 0.6, 0.4, 0.2, 0.0):
            ranges = [tuple(a + share * (b - a) for a, b in zip(*both, strict=True))
                      for both in zip(inner, outer, strict=True)]
            corners = (self.mesh.at(dict(zip(shapes, corner, strict=True))) for corner in product(*ranges))
            if share == 0.0 or all(each is not None and (cells.areas(each) > least).all() for each in corners):
                break
        return [(low, high) for low, high in ranges]
