"""Division of the intervals between the breaks of a section: panels of elements in geometric progression."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from geometry.mesh_size import MeshSize
from geometry.names import CAVITY, TRANSDUCER, role_of
from geometry.section import Section
from workbench.files.errors import InputError

COUPLANT = "couplant"
BOND = "bond"

#: Roles of regions that hold a fluid, or nothing.
FLUID_ROLES = (CAVITY, COUPLANT)

#: Least distance of a radius where a layer may end from another line, as a share of the section's radius; a closer one
#: counts as that line. Doubled, more of them do.
CLOSEST_RADII = 0.005


@dataclass(frozen=True)
class Panel:
    """Part of an interval between two breaks: `count` elements, each `ratio` times as long as the one before."""

    interval: int
    start: float
    end: float
    count: int
    ratio: float

    def nodes(self) -> NDArray[np.float64]:
        """Coordinates (count + 1,) from start to end, both exact."""
        lengths = self.ratio ** np.arange(self.count)
        steps = np.concatenate([[0.0], np.cumsum(lengths)]) / lengths.sum()
        nodes: NDArray[np.float64] = self.start + (self.end - self.start) * steps
        nodes[-1] = self.end
        return nodes


def _panels(
    breaks: tuple[float, ...], largest: NDArray[np.float64], graded: Mapping[float, float], *, size: MeshSize,
    minimum: NDArray[np.int64], cuts: Sequence[float] = (), shortest: Mapping[float, float],
) -> list[Panel]:
    """Panels of the intervals between `breaks`: elements no longer than `largest`, at least `minimum` of them (one
    value per interval each).

    They are graded towards the breaks in `graded`, to elements of that share of the largest, and of the length in
    `shortest` where that is less. There is a line of nodes at each of the `cuts` too.
    """
    panels: list[Panel] = []
    for i, (start, end, limit, least) in enumerate(zip(breaks, breaks[1:], largest, minimum, strict=False)):
        inner = [cut for cut in sorted(cuts) if start < cut < end]
        for low, high in pairwise([start, *inner, end]):
            ends = (min(graded.get(low, 1.0), shortest.get(low, math.inf) / limit),
                    min(graded.get(high, 1.0), shortest.get(high, math.inf) / limit))
            lengths, counts, ratios = _divide(high - low, limit, ends, size.growth, 1 if inner else int(least))
            knots = low + np.concatenate([[0.0], np.cumsum(lengths)])
            knots[-1] = high
            for a, b, n, q in zip(knots, knots[1:], counts, ratios, strict=False):
                panel = Panel(i, float(a), float(b), n, q)
                # gmsh places the nodes of a steeply graded line by numerical integration, too roughly for the smallest.
                nodes = [panel.start, panel.end] if q == 1.0 else panel.nodes().tolist()
                panels += [Panel(i, low, high, n if q == 1.0 else 1, 1.0) for low, high in pairwise(nodes)]
    return panels


def apart(radii: Sequence[float], breaks: Sequence[float]) -> list[float]:
    """The radii that keep a distance from breaks and from smaller radii that elements need not be tiny for."""
    least, kept = CLOSEST_RADII * breaks[-1], list[float]()
    for radius in sorted(radii):
        if all(abs(radius - other) > least for other in (*breaks, *kept)):
            kept.append(radius)
    return kept


def _divide(
    length: float, largest: float, ends: tuple[float, float], growth: float, minimum: int
) -> tuple[list[float], list[int], list[float]]:
    """Lengths, counts and ratios of the panels of one interval.

    The interval is divided into equal parts no longer than `largest`, at least `minimum`. A part next to a graded end,
    or half of it if both ends are graded, is divided again: elements grow by `growth` from a first one no longer than
    the share of `largest` in `ends`. An end of 1 is not graded.
    """
    parts = max(minimum, _ceiling(length / largest))
    share = 0.5 if parts == 1 and max(ends) < 1.0 else 1.0
    piece = share * length / parts
    first, last = (_graded(piece, end * largest, growth) if end < 1.0 else 1 for end in ends)
    if first == last == 1:  # Too thin to be graded, or no graded end.
        return [length], [parts], [1.0]
    # A half that is too thin stays one element.
    graded = (first > 1 or share < 1.0, last > 1 or share < 1.0)
    rest = round(parts - share * sum(graded))
    pieces = [(piece, first, growth)] * graded[0]
    pieces += [(length - sum(graded) * piece, rest, 1.0)] * (rest > 0)
    pieces += [(piece, last, 1.0 / growth)] * graded[1]
    lengths, counts, ratios = zip(*pieces, strict=True)
    return list(lengths), list(counts), list(ratios)


def division(
    length: float, largest: float, ends: tuple[float, float], growth: float, minimum: int
) -> NDArray[np.float64]:
    """Shares of a length at which elements end, 0 and 1 included, as in :func:`_divide`."""
    lengths, counts, ratios = _divide(length, largest, ends, growth, minimum)
    steps = np.concatenate([part * ratio ** np.arange(count) / np.sum(ratio ** np.arange(count, dtype=float))
                            for part, count, ratio in zip(lengths, counts, ratios, strict=True)])
    shares = np.concatenate([[0.0], np.cumsum(steps) / steps.sum()])
    shares[-1] = 1.0
    return shares


def _graded(length: float, smallest: float, growth: float) -> int:
    """The number of elements, each `growth` times as long as the one before, that divide a length so that the first is
    no longer than `smallest`."""
    count, total = 1, 1.0
    while length / total > smallest * (1.0 + 1e-12):
        total += growth**count
        count += 1
    return count


def _ceiling(quotient: float) -> int:
    """Smallest number of elements; a quotient above a whole number by rounding only does not cost one more."""
    return max(1, math.ceil(quotient * (1.0 - 1e-12)))


def _reentrant(section: Section, *, fluids: bool) -> list[tuple[float, float]]:
    """Places r, z of the re-entrant corners of the solids, or if `fluids` of all that the section holds."""
    # VOID is -1: the last entry.
    counts = np.array([fluids or role_of(region) not in FLUID_ROLES for region in section.regions] + [False])
    solid = counts[section.grid()]
    quarters = np.stack([solid[1:, 1:], solid[1:, :-1], solid[:-1, 1:], solid[:-1, :-1]])
    # Two solids in opposite quarters meet in an edge; side by side they have a plane face.
    opposite = (quarters.sum(axis=0) == 2) & (quarters[0] == quarters[3])
    found = np.argwhere((quarters.sum(axis=0) == 3) | opposite) + 1
    return [(section.r_breaks[i], section.z_breaks[j]) for j, i in found]


def _corners(section: Section, refinement: float) -> tuple[dict[float, float], dict[float, float]]:
    """Radii and heights that the mesh is graded towards, and the relative size of the elements there.

    Fields are singular in re-entrant corners of the solids, and more so at the ends of electrodes, where elements are
    smaller by the cube of `refinement`: with its first power Z of a disc was wrong by 0.65 %, with its square by 0.08
    %. The compliant rim of a couplant is too thin for a field of its own across: its radius counts, not its heights.
    """
    corners = _reentrant(section, fluids=False)
    radii, heights = ({place[axis]: refinement for place in corners} for axis in (0, 1))
    goes_on = set(section.measure.ends(section.r_breaks).values())
    for couplant in (p for p in section.rectangles if role_of(p.region) == COUPLANT):
        radii |= dict.fromkeys({couplant.r_inner, couplant.r_outer} - goes_on, refinement)
    rims = {r for p in section.rectangles if role_of(p.region) == TRANSDUCER for r in (p.r_inner, p.r_outer)}
    for electrode in section.electrodes:
        ends = {electrode.r_inner, electrode.r_outer} - rims
        radii |= dict.fromkeys(ends, refinement**3)
        heights |= {electrode.z: refinement**3} if ends else {}
    return radii, heights


def _local_lengths(section: Section, size: MeshSize) -> tuple[dict[float, float], dict[float, float]]:
    """Radii and heights of the corners of something small, and the largest size (m) of the elements there.

    In those of the cavity it is a share, `size.cavity_corner`, of the longer of its two sides, that across from the
    axis or the middle. The singular field in a corner of a cavity of sides a < b holds a share a / b of the
    cavity's energy, of which elements of size h leave out what goes with h / a: its frequency is wrong in proportion to
    h / b. A channel is short against the wavelength, and elements that are short against the wavelength alone are not
    short in it. Where a bond ends in a step it is its thickness, within which the field of its end decays.
    """
    radii, heights = dict[float, float](), dict[float, float]()
    of_solids, of_all = (_reentrant(section, fluids=fluids) for fluids in (False, True))
    for cavity in (p for p in section.rectangles if role_of(p.region) == CAVITY):
        longer = max(reach_across(cavity.r_inner, cavity.r_outer), cavity.z_top - cavity.z_bottom)
        for r, z in of_solids:
            if r in (cavity.r_inner, cavity.r_outer) and z in (cavity.z_bottom, cavity.z_top):
                radii[r] = heights[z] = size.cavity_corner * longer
    for bond in (p for p in section.rectangles if role_of(p.region) == BOND and size.corner_refinement < 1.0):
        for r, z in of_all:
            if r in (bond.r_inner, bond.r_outer) and z in (bond.z_bottom, bond.z_top):
                radii[r] = min(radii.get(r, math.inf), bond.z_top - bond.z_bottom)
    return radii, heights


def reach_across(left: float, right: float) -> float:
    """The width (m) of something between two places, from the axis or the middle if it lies there."""
    return right - left if left * right >= 0.0 else max(right, -left)


def divided(section: Section, size: MeshSize) -> tuple[list[Panel], list[Panel]]:
    """Panels along r and along z."""
    grid = section.grid()
    # VOID is -1: it takes the last entry, no limit.
    limits = np.array([size.largest_element(region) for region in section.regions] + [math.inf])[grid]
    columns, rows = limits.min(axis=0), limits.min(axis=1)
    if math.isinf(max(columns.max(), rows.max())):
        raise InputError("mesh size", "slowest_wave", math.inf, "a finite speed in some region of every row and column")
    radii, heights = _corners(section, size.corner_refinement)
    shortest = _local_lengths(section, size)
    cuts = list(size.levels)
    for rectangle in section.rectangles:
        skin = size.skins.get(rectangle.region, 0.0) * (rectangle.z_top - rectangle.z_bottom)
        cuts += [rectangle.z_bottom + skin, rectangle.z_top - skin] if skin else []
    thick = np.diff(section.z_breaks) > 0.25 * size.elements_per_wavelength * rows
    least = np.maximum(size.minimum_through_thickness, np.where(thick, size.minimum_through_quarter_wave, 1))
    return (
        _panels(section.r_breaks, columns, radii, size=size, minimum=np.ones(len(columns), dtype=int),
                cuts=apart(size.radii, section.r_breaks), shortest=shortest[0]),
        _panels(section.z_breaks, rows, heights, size=size, minimum=least, cuts=cuts, shortest=shortest[1]),
    )
