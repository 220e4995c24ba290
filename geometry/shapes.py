"""Layers that are no discs with plane faces and upright sides: how much each line of the section is moved.

The section of a chip is cut by its breaks into rectangles. A shape moves points of some of their sides, along r those
of an upright side and along z those of a level one, and what is inside follows: between its two upright sides a point
moves along r as they do at its height, in linear interpolation, and likewise along z. Neighbouring rectangles share a
side, so nothing tears, and where nothing is moved all stays exactly as it is.

- ``draft`` of a layer around the cavity: the angle by which its hole grows wider upwards; what continues the hole above
  moves along.
- ``barrel`` of a layer: how far its outer side bulges at mid-height, in a parabola.
- ``bow`` of a layer: how much higher its axis is than its rim, in a parabola; both its faces.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.curves import Arc, Curve
from geometry.dimension import SAME_LENGTH
from geometry.mesh import SectionMesh
from geometry.section import Section, cut_section

Real = NDArray[np.float64]
Moved = Callable[[Real], Real]


@dataclass(frozen=True)
class Side:
    """How far (m) the points of a line of the section are moved across it, from `begin` to `end` (m) along it.

    An upright line at the radius ``at`` along r as a function of z, a level one at the height ``at`` along z as a
    function of r.
    """

    upright: bool
    at: float
    begin: float
    end: float
    moved: Moved

    def across(self, along: Real) -> Real:
        """By how much points of cells (nodes, cells) are moved at some places along the line (m), nothing where a cell
        lies beyond its ends."""
        middle = along.mean(axis=0)
        inside = (middle > self.begin) & (middle < self.end)
        return np.where(inside, self.moved(along), 0.0)


def sides(chip: Chip) -> Iterator[Side]:
    """The sides that the shapes of a chip's layers move."""
    for number, layer in enumerate(chip.layers):
        low, high = layer.z_bottom, layer.z_top
        if layer.draft is not None:
            slope = math.tan(layer.draft.value)
            yield Side(True, layer.inner_radius, low, high, _sloping(slope, low))
            shift = slope * (high - low)
            for above in chip.layers[number + 1:]:
                goes_on = above.cavity_radius is not None and (
                    abs(above.inner_radius - layer.inner_radius) < SAME_LENGTH)
                bottom, top = above.z_bottom, above.z_top
                # Where the hole ends the line is led back within what is above, of which it bounds nothing.
                yield Side(True, layer.inner_radius, bottom, top,
                           _sloping(0.0, bottom, shift) if goes_on else _sloping(shift / (bottom - top), top))
                if not goes_on:
                    break
        if layer.barrel is not None:
            yield Side(True, layer.outer_radius, low, high, _bulging(layer.barrel.value, low, high))
        if layer.bow is not None:
            rim = layer.outer_radius
            for face in (low, high):
                yield Side(False, face, 0.0, rim, _bulging(layer.bow.value, -rim, rim))


def _sloping(slope: float, begin: float, size: float = 0.0) -> Moved:
    """A straight line through that size at the beginning."""
    return lambda along: size + slope * (along - begin)


def _bulging(size: float, begin: float, end: float) -> Moved:
    """A parabola of that size in the middle, and nothing at both ends."""
    return lambda along: 4.0 * size * (along - begin) * (end - along) / (end - begin) ** 2


def moved(mesh: SectionMesh, chip: Chip, local: Real) -> Real | None:
    """Coordinates (2, nodes, cells) in metres of the nodes of a mesh of a chip's straight section as its layers are
    shaped; None where none of them is.

    Args:
        local: (2, nodes) coordinates of the nodes within a cell, 0 to 1 along r and along z.
    """
    found = list(sides(chip))
    if not found or not isinstance(mesh.section, Section):
        return None
    corners = mesh.mesh.p[:, mesh.mesh.t]
    low, high = corners[:, 0], corners[:, 2]
    return _moved(found, mesh.section, *(low[axis] + local[axis][:, None] * (high - low)[axis] for axis in (0, 1)))


def _moved(found: Sequence[Side], section: Section, r: Real, z: Real) -> Real:
    """Where points (nodes, cells) of cells of a section get to: (2, nodes, cells)."""
    return np.stack([_along(own, across, along, breaks) for own, across, along, breaks in (
        ([side for side in found if side.upright], r, z, section.r_breaks),
        ([side for side in found if not side.upright], z, r, section.z_breaks))])


def outlines(chip: Chip) -> list[tuple[str, list[Arc]]]:
    """The outline of every layer, and of the cavity in every layer, anticlockwise, by region: lines and parabolas."""
    section, found = cut_section(chip), list(sides(chip))
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
    """Corners, middles of the sides and middle of a cell between the breaks, as they are moved: (2, 3, 3)."""
    ends = (section.r_breaks[column:column + 2], section.z_breaks[row:row + 2])
    r, z = np.meshgrid(*([low, 0.5 * (low + high), high] for low, high in ends), indexing="ij")
    return _moved(found, section, r.reshape(9, 1), z.reshape(9, 1)).reshape(2, 3, 3)


def _through(points: Real) -> Arc:
    """The line or parabola through three points (2, 3)."""
    a, m, b = ((float(r), float(z)) for r, z in points.T)
    parabola = Arc(Curve.parabola(a, m, b))
    return Arc(Curve.line(a, b)) if parabola.is_straight else parabola


def _along(found: Sequence[Side], across: Real, along: Real, breaks: Sequence[float]) -> Real:
    """Where points (nodes, cells) at places `across` some lines and `along` them get to across the lines."""
    lines = np.array(breaks)
    before = np.clip(np.searchsorted(lines, across.mean(axis=0)) - 1, 0, lines.size - 2)
    share = (across - lines[before]) / (lines[before + 1] - lines[before])
    result = across.copy()
    for side in found:
        at = int(np.argmin(np.abs(lines - side.at)))
        weight = np.where(before == at, 1.0 - share, 0.0) + np.where(before + 1 == at, share, 0.0)
        result += weight * side.across(along)
    return result
