"""Sections in the (r, z) plane: rectangles, electrodes and breaks.

Lengths are in metres, the axis is r = 0 and z points upwards (Acevedo-Espinosa et al. (RP-UEIS), Fig. 1).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.dimension import SAME_LENGTH
from geometry.measure import ABOUT_AXIS, Axisymmetric, Measure, Parity, Straight
from geometry.names import (
    CAVITY,
    ELECTRODE_GROUND,
    ELECTRODE_IDLE,
    ELECTRODE_LIVE,
    ELECTRODE_REVERSED,
    TRANSDUCER,
    interface,
    outside,
)
from geometry.parts import ElectrodeDisc, Electrodes, Layer, further_cavities
from workbench.files.errors import choose

#: Marks an empty cell of :meth:`Section.grid`.
VOID = -1

#: Further names of the halves of a live electrode, by their sign.
_BY_SIGN = {"-": ELECTRODE_REVERSED, "0": ELECTRODE_IDLE}


@dataclass(frozen=True)
class Rectangle:
    """Part of a region, between two radii and two heights (m)."""

    region: str
    r_inner: float
    r_outer: float
    z_bottom: float
    z_top: float


@dataclass(frozen=True)
class Electrode:
    """An electrode: a line at the height ``z`` (m). It runs from ``r_inner`` to ``r_outer`` (m)."""

    name: str
    r_inner: float
    r_outer: float
    z: float


@dataclass(frozen=True)
class Section:
    """The section: rectangles that do not overlap, and electrodes on them.

    Coordinates of one line are the same float (see :func:`cut_section`), so they compare exactly. ``measure`` is that
    of the section. In a straight section, radii are places x (m), which may be negative, an electrode may have several
    pieces, and a half of the live electrode at minus the voltage or at ground has a second name.

    Raises:
        ValueError: an axisymmetric section with negative radii, or a live electrode that reaches a plane of odd
            symmetry, where its potential is zero.
    """

    rectangles: tuple[Rectangle, ...]
    electrodes: tuple[Electrode, ...]
    measure: Measure = ABOUT_AXIS

    def __post_init__(self) -> None:
        if isinstance(self.measure, Axisymmetric) and self.r_breaks[0] < 0.0:
            raise ValueError(f"an axisymmetric section begins at r = {self.r_breaks[0]:g} m; expected 0 or more")
        if isinstance(self.measure, Straight):
            odd = {place for name, place in self.measure.ends(self.r_breaks).items()
                   if self.measure.planes[name] is Parity.ODD}
            if any({each.r_inner, each.r_outer} & odd for each in self.electrodes if each.name == ELECTRODE_LIVE):
                raise ValueError("the live electrode reaches a plane of odd symmetry, where its potential is zero")

    @cached_property
    def regions(self) -> tuple[str, ...]:
        """Names of the regions, in the order of the rectangles."""
        return tuple(dict.fromkeys(rectangle.region for rectangle in self.rectangles))

    @cached_property
    def r_breaks(self) -> tuple[float, ...]:
        """Increasing radii (m) at which a rectangle or electrode begins or ends."""
        pieces: tuple[Rectangle | Electrode, ...] = (*self.rectangles, *self.electrodes)
        return tuple(sorted({r for piece in pieces for r in (piece.r_inner, piece.r_outer)}))

    @cached_property
    def z_breaks(self) -> tuple[float, ...]:
        """Increasing heights (m) at which a rectangle or electrode begins or ends."""
        lines = {z for rectangle in self.rectangles for z in (rectangle.z_bottom, rectangle.z_top)}
        return tuple(sorted(lines | {electrode.z for electrode in self.electrodes}))

    def grid(self) -> NDArray[np.int64]:
        """The region of each cell between the breaks.

        Returns:
            (len(z_breaks) - 1, len(r_breaks) - 1) indices into ``regions``, :data:`VOID` for an empty cell.
        """
        cells = np.full((len(self.z_breaks) - 1, len(self.r_breaks) - 1), VOID, dtype=np.int64)
        for rectangle in self.rectangles:
            rows = slice(self.z_breaks.index(rectangle.z_bottom), self.z_breaks.index(rectangle.z_top))
            columns = slice(self.r_breaks.index(rectangle.r_inner), self.r_breaks.index(rectangle.r_outer))
            if (cells[rows, columns] != VOID).any():
                raise ValueError(f"the rectangles of the section overlap in {rectangle}")
            cells[rows, columns] = self.regions.index(rectangle.region)
        return cells

    def area(self, region: str) -> float:
        """Area of the region in the section, m^2.

        Raises:
            InputError: unknown region.
        """
        return sum((p.r_outer - p.r_inner) * (p.z_top - p.z_bottom) for p in self._pieces(region))

    def volume(self, region: str) -> float:
        """Volume that the region stands for by the measure, m^3.

        Raises:
            InputError: unknown region.
        """
        return sum(self.measure.volume(p.r_inner, p.r_outer, p.z_top - p.z_bottom) for p in self._pieces(region))

    def _pieces(self, region: str) -> list[Rectangle]:
        choose(region, self.regions, source="section", field="region")
        return [rectangle for rectangle in self.rectangles if rectangle.region == region]

    def boundary_names(self) -> tuple[str, ...]:
        """Sorted names of all boundaries of this section. An electrode has a name besides that of its boundary:
        ``electrode_live`` is also part of ``transducer|outside`` or of the interface with the next layer."""
        # A frame of void around the cells makes every outer edge an edge between two cells.
        cells = np.pad(self.grid(), 1, constant_values=VOID)
        # Columns of the vertical edges on the lines of symmetry.
        ends = {self.r_breaks.index(place): name for name, place in self.measure.ends(self.r_breaks).items()}
        names = {electrode.name for electrode in self.electrodes}
        for one, other, vertical in ((cells[:, :-1], cells[:, 1:], True), (cells[:-1], cells[1:], False)):
            for column, (a, b) in zip(
                np.nonzero(one != other)[1], zip(one[one != other], other[one != other], strict=True), strict=True
            ):
                if vertical and column in ends:
                    names.add(ends[int(column)])
                else:
                    names.add(boundary_name(self.regions, int(a), int(b)))
        return tuple(sorted(names))


def boundary_name(regions: tuple[str, ...], a: int, b: int) -> str:
    """Name of the boundary between regions by index; one may be :data:`VOID`."""
    if VOID in (a, b):
        return outside(regions[max(a, b)])
    return interface(regions[a], regions[b])


def cut_section(chip: Chip) -> Section:
    """The section of a chip with its cavity and without ports. Breaks within 1 nm of each other, the rounding of sums
    of thicknesses, become one."""
    return section_of_layers(chip.layers, chip.electrodes, chip.measure)


def section_of_layers(
    layers: Sequence[Layer], electrodes: Electrodes, measure: Measure = ABOUT_AXIS
) -> Section:
    """The section of layers as discs and rings, whatever their profile. A straight section without a plane of symmetry
    is whole: every layer extends to both sides of its middle."""
    is_whole = measure.is_whole
    start = -math.inf if is_whole else 0.0
    rectangles = [Rectangle(layer.region, left, right, layer.z_bottom, layer.z_top)
                  for layer in layers for left, right in _between(layer, start)]
    rectangles += [Rectangle(CAVITY, max(left, start), right, hole.z_bottom, hole.z_top)
                   for hole in layers if hole.cavity_radius is not None for left, right in hole.holes if right > start]
    rectangles += [Rectangle(region, max(left, start), right, layer.z_bottom, layer.z_top)
                   for region, around in further_cavities(layers).items() for layer in around
                   for left, right in layer.holes if right > start]
    lines = [piece for layer in layers if layer.role == TRANSDUCER for each in _faces(layer, electrodes)
             for piece in (_whole(each, layer.offset) if is_whole else [each])]
    if electrodes.halves is not None:
        halves = [piece for piece in lines if piece.name == ELECTRODE_LIVE]
        lines += [replace(piece, name=_BY_SIGN[sign])
                  for piece, sign in zip(halves, electrodes.halves[-len(halves):], strict=True) if sign in _BY_SIGN]
    pieces: tuple[Rectangle | Electrode, ...] = (*rectangles, *lines)
    radii = _merged(r for piece in pieces for r in (piece.r_inner, piece.r_outer))
    heights = _merged(z for rectangle in rectangles for z in (rectangle.z_bottom, rectangle.z_top))
    return Section(
        tuple(
            Rectangle(p.region, radii[p.r_inner], radii[p.r_outer], heights[p.z_bottom], heights[p.z_top])
            for p in rectangles
        ),
        tuple(Electrode(e.name, radii[e.r_inner], radii[e.r_outer], heights[e.z]) for e in lines),
        measure,
    )


def _faces(transducer: Layer, electrodes: Electrodes) -> list[Electrode]:
    """The live and the ground electrode of a transducer. The lowest transducer has the chip's `electrodes`."""
    own = electrodes if transducer.live is None else Electrodes(transducer.live)

    def face(name: str, part: ElectrodeDisc, *, on_top: bool) -> Electrode:
        inner = transducer.inner_radius if part.inner_radius is None else part.inner_radius.value
        outer = transducer.outer_radius if part.radius is None else part.radius.value
        return Electrode(name, inner, outer, transducer.z_top if on_top else transducer.z_bottom)

    return [face(ELECTRODE_LIVE, own.live_disc, on_top=own.live == "top"),
            face(ELECTRODE_GROUND, own.ground_disc, on_top=own.live != "top")]


def _between(layer: Layer, start: float) -> Iterator[tuple[float, float]]:
    """The sides of a layer's pieces beside its holes, left to right. They begin at `start` (m)."""
    left, right = max(layer.sides[0], start), layer.sides[1]
    for low, high in layer.holes:
        if low > left:
            yield left, low
        left = max(left, high)
    yield left, right


def _whole(half: Electrode, middle: float) -> list[Electrode]:
    """An electrode and its mirror image, left to right. The `middle` (m) is that of its plate. They are one piece if
    they touch."""
    if half.r_inner == 0.0:
        return [replace(half, r_inner=middle - half.r_outer, r_outer=middle + half.r_outer)]
    return [replace(half, r_inner=middle - half.r_outer, r_outer=middle - half.r_inner),
            replace(half, r_inner=middle + half.r_inner, r_outer=middle + half.r_outer)]


def _merged(values: Iterable[float]) -> dict[float, float]:
    """Every value, mapped to the first equal one, within rounding."""
    merged: dict[float, float] = {}
    first = -math.inf
    for value in sorted(set(values)):
        if value - first >= SAME_LENGTH:
            first = value
        merged[value] = first
    return merged
