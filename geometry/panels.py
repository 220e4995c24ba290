"""Division of a section's intervals into panels of elements in geometric progression."""

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

#: Least distance of a requested radius from another line, as a share of the section's radius; a closer one is left out.
CLOSEST_RADII = 0.005


@dataclass(frozen=True)
class Panel:
    """Elements in geometric progression in part of an interval. Each of `count` elements is `ratio` times as long as
    the previous one."""

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
    """Panels of the intervals between `breaks`. Elements are no longer than `largest` and at least `minimum` in number,
    one value each per interval. They shrink towards the breaks in `graded`, to that share of the largest size, and to
    the length in `shortest` if it is smaller. Each of the `cuts` is also a line of nodes."""
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
                # gmsh places the nodes of a steeply graded line by numerical integration, which is too inaccurate for
                # the smallest.
                nodes = [panel.start, panel.end] if q == 1.0 else panel.nodes().tolist()
                panels += [Panel(i, low, high, n if q == 1.0 else 1, 1.0) for low, high in pairwise(nodes)]
    return panels


def apart(radii: Sequence[float], breaks: Sequence[float]) -> list[float]:
    """The radii that are not too close to breaks or smaller radii."""
    least, kept = CLOSEST_RADII * breaks[-1], list[float]()
    for radius in sorted(radii):
        if all(abs(radius - other) > least for other in (*breaks, *kept)):
            kept.append(radius)
    return kept


def _divide(
    length: float, largest: float, ends: tuple[float, float], growth: float, minimum: int
) -> tuple[list[float], list[int], list[float]]:
    """Lengths, counts and ratios of the panels of one interval.

    The interval is divided into at least `minimum` equal parts no longer than `largest`. A part next to a graded end,
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
    """Shares of a length at which elements end, as in :func:`_divide`."""
    lengths, counts, ratios = _divide(length, largest, ends, growth, minimum)
    steps = np.concatenate([part * ratio ** np.arange(count) / np.sum(ratio ** np.arange(count, dtype=float))
                            for part, count, ratio in zip(lengths, counts, ratios, strict=True)])
    shares = np.concatenate([[0.0], np.cumsum(steps) / steps.sum()])
    shares[-1] = 1.0
    return shares


def _graded(length: float, smallest: float, growth: float) -> int:
    """The number of elements whose first is at most `smallest`. Their length grows by `growth`."""
    count, total = 1, 1.0
    while length / total > smallest * (1.0 + 1e-12):
        total += growth**count
        count += 1
    return count


def _ceiling(quotient: float) -> int:
    """The least number of elements; rounding does not add one."""
    return max(1, math.ceil(quotient * (1.0 - 1e-12)))


def _reentrant(section: Section, *, fluids: bool) -> list[tuple[float, float]]:
    """Re-entrant corners (r, z) of the solids, or of all materials (`fluids`)."""
    # VOID is -1: the last entry.
    counts = np.array([fluids or role_of(region) not in FLUID_ROLES for region in section.regions] + [False])
    solid = counts[section.grid()]
    quarters = np.stack([solid[1:, 1:], solid[1:, :-1], solid[:-1, 1:], solid[:-1, :-1]])
    # Two solids in opposite quarters meet in an edge; side by side they have a plane face.
    opposite = (quarters.sum(axis=0) == 2) & (quarters[0] == quarters[3])
    found = np.argwhere((quarters.sum(axis=0) == 3) | opposite) + 1
    return [(section.r_breaks[i], section.z_breaks[j]) for j, i in found]


def _corners(section: Section, refinement: float) -> tuple[dict[float, float], dict[float, float]]:
    """Radii and heights of grading, with the relative element size.

    Fields are singular in re-entrant corners of the solids, and more strongly at the ends of electrodes, where the
    factor is the cube of `refinement`: with its first power Z of a disc was wrong by 0.65 %, with its square by 0.08 %.
    The compliant edge of a couplant is too thin for a field across it: only its radius is refined.
    """
    corners = _reentrant(section, fluids=False)
    radii, heights = ({place[axis]: refinement for place in corners} for axis in (0, 1))
    goes_on = set(section.measure.ends(section.r_breaks).values())
    for couplant in (p for p in section.rectangles if role_of(p.region) == COUPLANT):
        radii |= dict.fromkeys({couplant.r_inner, couplant.r_outer} - goes_on, refinement)
    outer_radii = {r for p in section.rectangles if role_of(p.region) == TRANSDUCER for r in (p.r_inner, p.r_outer)}
    for electrode in section.electrodes:
        ends = {electrode.r_inner, electrode.r_outer} - outer_radii
        radii |= dict.fromkeys(ends, refinement**3)
        heights |= {electrode.z: refinement**3} if ends else {}
    return radii, heights


def _local_lengths(section: Section, size: MeshSize) -> tuple[dict[float, float], dict[float, float]]:
    """Radii and heights of small corners, with the largest element (m).

    In corners of the cavity the size is `size.cavity_corner` times its longer side. The singular field in a corner of a
    cavity with sides a < b has a share a / b of the cavity's energy, and elements of size h miss a share of it that is
    proportional to h / a: the frequency error is proportional to h / b. At the end of a bond, the size is the bond's
    thickness, within which the field of its end decays.
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
    """The width (m) between two places, or from the axis between."""
    return right - left if left * right >= 0.0 else max(right, -left)


def divided(section: Section, size: MeshSize) -> tuple[list[Panel], list[Panel]]:
    """Panels along r and along z."""
    grid = section.grid()
    # VOID is -1: the last entry, which has no limit.
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
