"""Layers with sloping, bulging or curved sides: displacements of the section's lines.

The breaks cut the section into rectangles. A shape displaces points of some of their sides: of upright sides along r,
of level sides along z. Points inside follow by linear interpolation between two opposite sides. Neighbouring rectangles
share a side, so the section stays connected, and rectangles without displaced sides stay unchanged.

- ``draft`` of a layer around the cavity: the angle by which its hole widens upwards; continuations of the hole above
  move along.
- ``barrel`` of a layer: the parabolic bulge of its outer side at mid-height; breaks within the layer move along, in
  proportion to their distance from its hole or axis.
- ``bow`` of a layer: the height of its middle above its edge, as a parabola, of both faces.
- ``dome`` of a layer: the excess thickness of its middle over its edge, as a parabola of the upper face; the layer
  above, usually a gel, fills the gap.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.curves import Arc, Curve
from geometry.dimension import SAME_LENGTH, SHAPES, Dimension
from geometry.mesh import SectionMesh
from geometry.parts import Layer
from geometry.section import Section, cut_section
from workbench.files.errors import choose

Real = NDArray[np.float64]
Moved = Callable[[Real], Real]


@dataclass(frozen=True)
class Side:
    """Displacements (m) across a section line from `begin` to `end` (m).

    An upright line at the radius ``at`` moves along r as a function of z, a level line at the height ``at`` along z as
    a function of r. The displacement decreases linearly to zero at the lines ``reach`` (m), by default the next breaks.
    """

    upright: bool
    at: float
    begin: float
    end: float
    moved: Moved
    reach: tuple[float, float] | None = None

    def across(self, along: Real) -> Real:
        """Displacements (nodes, cells) at places `along` the line (m). They are zero beyond its ends."""
        middle = along.mean(axis=0)
        inside = (middle > self.begin) & (middle < self.end)
        return np.where(inside, self.moved(along), 0.0)


@dataclass(frozen=True)
class ShapeReach:
    """Dependence of the displaced points on the shape's size and on lengths.

    Points move along r if ``upright``, else along z. The displacement is proportional to the size in metres; for an
    ``angle``, to its tangent and the layer's thickness. ``within`` (m) is the radius over which the displacement
    varies; 0 if it is uniform.
    """

    upright: bool
    angle: bool
    within: float


def reach(layer: Layer, shape: str) -> ShapeReach:
    """The :class:`ShapeReach` of a shape of a layer."""
    match shape:
        case "draft":
            return ShapeReach(True, True, 0.0)
        case "barrel":
            return ShapeReach(True, False, 0.0)
        case "bow" | "dome":
            return ShapeReach(False, False, layer.outer_radius)
        case _:
            raise KeyError(f"unknown shape {shape!r}; known: {', '.join(SHAPES)}")


def possible(chip: Chip) -> dict[str, tuple[str, str]]:
    """Every possible shape of a chip: layer and shape by dimension. A chip with profiles has none."""
    layers = () if chip.is_profiled else chip.layers
    return {f"{layer.region}.{shape}": (layer.region, shape) for layer in layers for shape in SHAPES
            if shape != "draft" or layer.cavity_radius is not None}


def with_shapes(chip: Chip, names: Sequence[str]) -> Chip:
    """A copy with these shapes among its dimensions. Their size is 0 if not stated.

    Raises:
        InputError: no layer can have such a shape.
    """
    known = possible(chip)
    stated: dict[str, dict[str, Dimension]] = {}
    for name in names:
        region, shape = known[choose(name, known, source=chip.file, field="shape")]
        if shape not in chip.layer(region).shapes:
            stated.setdefault(region, {})[shape] = Dimension(0.0)
    if not stated:
        return chip
    return replace(chip, layers=tuple(layer.with_shapes(stated.get(layer.region, {})) for layer in chip.layers))


def sides(chip: Chip, section: Section) -> Iterator[Side]:
    """The sides that the shapes of layers displace in `section`. In a whole section, the left sides mirror the right
    ones."""
    for number, layer in enumerate(chip.layers):
        low, high = layer.z_bottom, layer.z_top
        if layer.draft is not None:
            for place in range(len(layer.holes)):
                yield from _drafted(chip, section, number, place, math.tan(layer.draft.value))
        if layer.barrel is not None:
            for hole, side in zip(layer.hole_sides, layer.sides, strict=True):
                for radius in section.r_breaks:
                    share = (radius - hole) / (side - hole)
                    if SAME_LENGTH < share * abs(side - hole) < abs(side - hole) + SAME_LENGTH:
                        outwards = math.copysign(share, side - hole)
                        yield Side(True, radius, low, high, _bulging(outwards * layer.barrel.value, low, high))
        begin, end = layer.sides
        if layer.bow is not None:
            for face in (low, high):
                yield Side(False, face, begin, end, _bulging(layer.bow.value, begin, end))
        if layer.dome is not None:
            yield Side(False, high, begin, end, _bulging(layer.dome.value, begin, end))


def _drafted(chip: Chip, section: Section, number: int, place: int, outwards: float) -> Iterator[Side]:
    """The sides that a draft displaces, `outwards` by its height. They are the walls of hole number `place` in the
    section, and their continuation above."""
    layer = chip.layers[number]
    low, high = layer.z_bottom, layer.z_top
    for side, sign in enumerate((-1.0, 1.0)):
        at, slope = layer.holes[place][side], sign * outwards
        if at < 0.0 and not chip.measure.is_whole:
            continue
        goes_on = [above.cavity_radius is not None and abs(above.holes[place][side] - at) < SAME_LENGTH
                   for above in chip.layers[number + 1:]]
        last = next((k for k, each in enumerate(goes_on) if not each), len(goes_on) - 1)
        end = chip.layers[number + 1 + last].z_top if goes_on else high
        reach = _reach(section, at, (low, end), high - low)
        yield Side(True, at, low, high, _sloping(slope, low), reach)
        shift = slope * (high - low)
        for above, further in zip(chip.layers[number + 1:number + 2 + last], goes_on, strict=False):
            bottom, top = above.z_bottom, above.z_top
            # Above the end of the hole the displacement decreases to zero within the next layer.
            yield Side(True, at, bottom, top,
                       _sloping(0.0, bottom, shift) if further else _sloping(shift / (bottom - top), top), reach)


def _reach(section: Section, at: float, heights: tuple[float, float], room: float) -> tuple[float, float]:
    """The lines (m) beside an upright line where its displacement ends. They are the next breaks. Breaks without a
    boundary between two `heights` (m) are skipped if they are nearer than `room` (m)."""
    breaks, grid = section.r_breaks, section.grid()
    rows = [j for j, z in enumerate(section.z_breaks[:-1]) if heights[0] - SAME_LENGTH < z < heights[1] - SAME_LENGTH]
    here = min(range(len(breaks)), key=lambda k: abs(breaks[k] - at))
    found = []
    for step in (-1, 1):
        k = min(max(here + step, 0), len(breaks) - 1)
        while 0 < k < len(breaks) - 1 and abs(breaks[k] - at) < room and (
                grid[rows, k - 1] == grid[rows, k]).all():
            k += step
        found.append(breaks[k])
    return found[0], found[1]


def _sloping(slope: float, begin: float, size: float = 0.0) -> Moved:
    """A straight line with the value `size` at `begin`."""
    return lambda along: size + slope * (along - begin)


def _bulging(size: float, begin: float, end: float) -> Moved:
    """A parabola: `size` in the middle, zero at both ends."""
    return lambda along: 4.0 * size * (along - begin) * (end - along) / (end - begin) ** 2


def moved(mesh: SectionMesh, chip: Chip, local: Real) -> Real | None:
    """Node coordinates (2, nodes, cells) in metres, displaced by the layers' shapes.

    None if no layer has a shape.

    Args:
        local: (2, nodes) node coordinates within a cell, 0 to 1 along r and along z.
    """
    if not isinstance(mesh.section, Section):
        return None
    found = list(sides(chip, mesh.section))
    if not found:
        return None
    corners = mesh.mesh.p[:, mesh.mesh.t]
    low, high = corners[:, 0], corners[:, 2]
    return _moved(found, mesh.section, *(low[axis] + local[axis][:, None] * (high - low)[axis] for axis in (0, 1)))


def _moved(found: Sequence[Side], section: Section, r: Real, z: Real) -> Real:
    """Displaced coordinates (2, nodes, cells) of points (nodes, cells)."""
    return np.stack([_along(own, across, along, breaks) for own, across, along, breaks in (
        ([side for side in found if side.upright], r, z, section.r_breaks),
        ([side for side in found if not side.upright], z, r, section.z_breaks))])


def outlines(chip: Chip) -> list[tuple[str, list[Arc]]]:
    """Anticlockwise outlines of every layer and cavity, by region. They are lines and parabolas."""
    section = cut_section(chip)
    found = list(sides(chip, section))
    result = []
    for each in section.rectangles:
        columns = range(section.r_breaks.index(each.r_inner), section.r_breaks.index(each.r_outer))
        rows = range(section.z_breaks.index(each.z_bottom), section.z_breaks.index(each.z_top))
        chains = [*(_cell(found, section, i, rows[0])[:, :, 0] for i in columns),
                  *(_cell(found, section, columns[-1], j)[:, 2] for j in rows),
                  *(_cell(found, section, i, rows[-1])[:, ::-1, 2] for i in reversed(columns)),
                  *(_cell(found, section, columns[0], j)[:, 0, ::-1] for j in reversed(rows))]
        result.append((each.region, [_through(chain) for chain in chains]))
    return result


def _cell(found: Sequence[Side], section: Section, column: int, row: int) -> Real:
    """Displaced points (2, 3, 3) of a cell. They are its corners, side middles and middle."""
    ends = (section.r_breaks[column:column + 2], section.z_breaks[row:row + 2])
    r, z = np.meshgrid(*([low, 0.5 * (low + high), high] for low, high in ends), indexing="ij")
    return _moved(found, section, r.reshape(9, 1), z.reshape(9, 1)).reshape(2, 3, 3)


def _through(points: Real) -> Arc:
    """The line or parabola through three points (2, 3)."""
    a, m, b = ((float(r), float(z)) for r, z in points.T)
    parabola = Arc(Curve.parabola(a, m, b))
    return Arc(Curve.line(a, b)) if parabola.is_straight else parabola


def _along(found: Sequence[Side], across: Real, along: Real, breaks: Sequence[float]) -> Real:
    """Displaced coordinates across lines, of points (nodes, cells) at `across` and `along`."""
    lines, middle = np.array(breaks), across.mean(axis=0)
    result = across.copy()
    for side in found:
        k = int(np.argmin(np.abs(lines - side.at)))
        at = lines[k]
        low, high = (lines[max(k - 1, 0)], lines[min(k + 1, lines.size - 1)]) if side.reach is None else side.reach
        with np.errstate(divide="ignore", invalid="ignore"):
            weight = np.where(middle < at, (across - low) / (at - low), (high - across) / (high - at))
        result += np.where((middle > low) & (middle < high), weight, 0.0) * side.across(along)
    return result
