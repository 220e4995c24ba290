"""The sides of a section's faces and their divisions (`geometry.free_mesh`).

A division of one side of a four-sided face also divides the opposite side, from face to face.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from geometry.curves import Arc
from geometry.dimension import SAME_LENGTH
from geometry.dissection import CORNER, four_sides, turned
from geometry.free_section import Directed, FreeSection, faces_beside
from geometry.mesh import MeshError
from geometry.mesh_size import MeshSize
from geometry.names import CAVITY, TRANSDUCER, role_of
from geometry.panels import BOND, COUPLANT, FLUID_ROLES, apart, division, reach_across

Real = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Places closer than this share of a side's length are equal.
SAME_PLACE = 1e-6

#: Largest angle (rad) by which the side of an element turns; in a face that gmsh fills, before it is cut.
LARGEST_TURN = math.radians(30.0)

#: Largest ratio of the lengths of neighbouring elements on the sides of a face that gmsh fills.
GROWTH = 2.0

#: Least solid angle (degrees) of a re-entrant corner, and of a point inside solids: 180 and 360, with a margin for
#: curves.
REENTRANT, ALL_AROUND = 190.0, 350.0

#: Most rounds in which divisions pass from face to face; more than the number of faces in a row.
MOST_ROUNDS = 200


@dataclass
class SectionLayout:
    """The edges of a section, further divided, and their faces.

    ``loops`` has the loops of every face. ``sides`` has the four sides of four-sided faces: bottom and top in one
    direction, left and right in one direction. ``lines`` are the edges divided at a requested height or radius, with
    the shares.
    """

    edges: list[Arc]
    ends: list[tuple[int, int]]
    points: list[tuple[float, float]]
    regions: list[str]
    loops: list[list[list[Directed]]]
    sides: dict[int, list[list[Directed]]] = field(default_factory=dict)
    lines: list[tuple[int, float]] = field(default_factory=list)

    def beside(self) -> tuple[tuple[int, ...], ...]:
        """The faces, one or two, on the sides of every edge."""
        return faces_beside(self.loops, len(self.edges))

    def around_transducer(self) -> Iterator[Directed]:
        """The edges of the loops of the transducer's faces."""
        return (each for face, loops in enumerate(self.loops) if self.regions[face] == TRANSDUCER
                for loop in loops for each in loop)

    def heights(self, region: str) -> tuple[float, float]:
        """The lowest and the highest z (m) of a region's corners."""
        found = [self.points[end][1] for face, loops in enumerate(self.loops) if self.regions[face] == region
                 for loop in loops for edge, _ in loop for end in self.ends[edge]]
        return min(found), max(found)

    def arc(self, directed: Directed) -> Arc:
        number, forwards = directed
        return self.edges[number] if forwards else self.edges[number].back

    def split(self, number: int, share: float) -> None:
        """Divide an edge at a share of the way."""
        arc, (begin, end) = self.edges[number], self.ends[number]
        first, second = arc.part(0.0, share), arc.part(share, 1.0)
        self.points.append(first.ends[1])
        middle, other = len(self.points) - 1, len(self.edges)
        self.edges[number], self.ends[number] = first, (begin, middle)
        self.edges.append(second)
        self.ends.append((middle, end))
        for chain in (chain for chains in (*self.loops, *self.sides.values()) for chain in chains):
            for place, (edge, forwards) in enumerate(chain):
                if edge == number:
                    chain[place:place + 1] = ([(number, True), (other, True)] if forwards
                                              else [(other, False), (number, False)])
                    break

    def places(self, side: Sequence[Directed]) -> list[float]:
        """Positions of the ends of a side's edges, as shares. The extent is in r for a side more level than steep, else
        in z. A division then divides the opposite side straight above or beside it."""
        corners = [self.points[self.ends[number][0 if forwards else 1]] for number, forwards in side]
        last, forwards = side[-1]
        corners.append(self.points[self.ends[last][1 if forwards else 0]])
        axis, start, length = self._along(side)
        return [(corner[axis] - start) / length for corner in corners]

    def _along(self, side: Sequence[Directed]) -> tuple[int, float, float]:
        """The coordinate (0 r, 1 z), start (m) and length (m)."""
        (first, forwards), (last, along) = side[0], side[-1]
        start = self.points[self.ends[first][0 if forwards else 1]]
        end = self.points[self.ends[last][1 if along else 0]]
        axis = 0 if abs(end[0] - start[0]) > abs(end[1] - start[1]) else 1
        return axis, start[axis], end[axis] - start[axis]

    def divide(self, side: Sequence[Directed], place: float) -> None:
        """Divide the edge of a side at a position."""
        places = self.places(side)
        number = next(k for k in range(len(side)) if places[k] < place < places[k + 1])
        axis, start, length = self._along(side)
        edge, _ = side[number]
        share = self.edges[edge].share_of(axis, start + place * length)
        assert share is not None
        self.split(edge, share)


# --------------------------------------------------------------------------------------------------------------------
# Sides


def laid_out(section: FreeSection, size: MeshSize, like: SectionLayout | None = None) -> SectionLayout:
    """The layout of a section. Edges are divided at electrodes, at requested lines and opposite other divisions.

    Requested divisions are at the same shares of edges as in the layout `like`, if given.

    Raises:
        MeshError: sides divide each other without an end.
    """
    layout = SectionLayout(list(section.edges), list(section.ends), list(section.points),
                     [face.region for face in section.faces],
                     [[list(loop) for loop in face.loops] for face in section.faces])
    for number, face in enumerate(section.faces):
        found = four_sides(list(section.arcs(face.loops[0]))) if len(face.loops) == 1 else None
        if found is not None:
            bottom, right, top, left = ([face.loops[0][k] for k in side] for side in found)
            layout.sides[number] = [bottom, right, _reversed(top), _reversed(left)]
    for electrode in section.electrodes:
        for radius in (electrode.r_inner, electrode.r_outer):
            _break(layout, TRANSDUCER, 0, radius)
    if like is None:
        layout.lines = _lines(layout, size)
    else:
        for edge, share in like.lines:
            layout.split(edge, share)
        layout.lines = list(like.lines)
    for _ in range(MOST_ROUNDS):
        # All faces are examined in every round.
        changed = [_matched(layout, one, other) for sides in layout.sides.values()
                   for one, other in ((sides[0], sides[2]), (sides[1], sides[3]))]
        if not any(changed):
            return layout
    raise MeshError("the sides of the section's faces divide each other without an end")


def _lines(layout: SectionLayout, size: MeshSize) -> list[tuple[int, float]]:
    """Divide edges at requested heights and radii. Return them with the shares."""
    found = []
    regions = dict.fromkeys(layout.regions)
    for height in size.levels:
        for region in regions:
            found += _break(layout, region, 1, height)
    for region, share in size.skins.items():
        low, high = layout.heights(region)
        for height in (low + share * (high - low), high - share * (high - low)):
            found += _break(layout, region, 1, height)
    for radius in apart(size.radii, sorted({r for r, _ in layout.points})):
        for region in regions:
            found += _break(layout, region, 0, radius)
    return found


def _reversed(side: Sequence[Directed]) -> list[Directed]:
    return [(number, not forwards) for number, forwards in reversed(side)]


def _break(layout: SectionLayout, region: str, axis: int, value: float) -> list[tuple[int, float]]:
    """Divide four-sided faces where a coordinate (0 r, 1 z) is `value`.

    Returns the divided edges with the shares.
    """
    divided = []
    for number, sides in list(layout.sides.items()):
        if layout.regions[number] != region:
            continue
        for side in sides:
            for edge, _ in list(side):
                arc = layout.edges[edge]
                (r0, z0), (r1, z1) = arc.ends
                share = arc.share_of(axis, value) if (abs(r1 - r0) > abs(z1 - z0)) == (axis == 0) else None
                if share is not None and min(share, 1.0 - share) * arc.length > SAME_LENGTH:
                    layout.split(edge, share)
                    divided.append((edge, share))
    return divided


def _matched(layout: SectionLayout, one: list[Directed], other: list[Directed]) -> bool:
    """Divide two opposite sides equally. Return whether a division was new."""
    changed = False
    for side, opposite in ((one, other), (other, one)):
        for place in layout.places(side)[1:-1]:
            if min(abs(place - each) for each in layout.places(opposite)) > SAME_PLACE:
                layout.divide(opposite, place)
                changed = True
    return changed


# --------------------------------------------------------------------------------------------------------------------
# Divisions


def divisions(layout: SectionLayout, section: FreeSection, size: MeshSize) -> list[Real]:
    """Shares at which every edge is divided, ends included."""
    count = len(layout.edges)
    beside = layout.beside()
    limits = {region: size.largest_element(region) for region in set(layout.regions)}
    largest = [min(limits[layout.regions[face]] for face in faces) for faces in beside]
    graded, shortest = (_all_along(layout, found) for found in (
        _graded(layout, section, size), _local_lengths(layout, size)))
    group, runs = _groups(layout)
    members: dict[int, list[int]] = {}
    for edge, each in enumerate(group):
        members.setdefault(each, []).append(edge)
    result: list[Real] = [np.empty(0)] * count
    for edges in members.values():
        limit = min(largest[edge] for edge in edges)
        if math.isinf(limit):
            limit = max(layout.edges[edge].length for edge in edges)
        least, begin, end = 1, 1.0, 1.0
        free = any(face not in layout.sides for edge in edges for face in beside[edge])
        for edge in edges:
            arc = layout.edges[edge]
            ends = [min(graded.get((point, _level(arc)), 1.0), shortest.get((point, _level(arc)), math.inf) / limit)
                    for point in layout.ends[edge]]
            ends = ends if runs[edge] else ends[::-1]
            begin, end = min(begin, ends[0]), min(end, ends[1])
            least = max(least, _least(layout, size, edge, beside[edge]),
                        (2 if free else 1) * math.ceil(arc.turning / LARGEST_TURN - 1e-9))
        length = max(layout.edges[edge].length for edge in edges)
        if free:
            coarse = division(length, 2.0 * limit, (begin, end), min(size.growth, GROWTH), math.ceil(0.5 * least))
            shares = np.insert(coarse, np.arange(1, coarse.size), 0.5 * (coarse[:-1] + coarse[1:]))
        else:
            shares = division(length, limit, (begin, end), size.growth, least)
        for edge in edges:
            result[edge] = shares if runs[edge] else 1.0 - shares[::-1]
    return result


def _level(arc: Arc) -> bool:
    (r0, z0), (r1, z1) = arc.ends
    return abs(z1 - z0) < abs(r1 - r0)


def _least(layout: SectionLayout, size: MeshSize, edge: int, faces: Sequence[int]) -> int:
    """The least number of elements along an edge across a layer."""
    least, arc = 1, layout.edges[edge]
    for face in faces:
        sides = layout.sides.get(face)
        if sides is None or _level(arc) or not any(len(side) == 1 and side[0][0] == edge for side in sides):
            continue
        least = max(least, size.minimum_through_thickness)
        if arc.length > 0.25 * size.elements_per_wavelength * size.largest_element(layout.regions[face]):
            least = max(least, size.minimum_through_quarter_wave)
    return least


def _groups(layout: SectionLayout) -> tuple[list[int], list[bool]]:
    """The groups of equally divided edges, and whether directions agree."""
    count = len(layout.edges)
    parent, same = list(range(count)), [True] * count

    def root(edge: int) -> tuple[int, bool]:
        alike = True
        while parent[edge] != edge:
            alike = alike == same[edge]
            edge = parent[edge]
        return edge, alike

    for sides in layout.sides.values():
        for one, other in ((sides[0], sides[2]), (sides[1], sides[3])):
            for (a, forwards), (b, along) in zip(one, other, strict=True):
                (first, alike), (second, also) = root(a), root(b)
                wanted = (forwards == along) == (alike == also)
                if first != second:
                    parent[second], same[second] = first, wanted
                elif not wanted:
                    raise MeshError("the sides of the section's faces run in a ring that is turned over")
    found = [root(edge) for edge in range(count)]
    return [each for each, _ in found], [alike for _, alike in found]


def _angles(layout: SectionLayout, *, fluids: bool) -> dict[int, float]:
    """The angle (degrees) filled by solids, or `fluids`, about every corner."""
    found: dict[int, float] = {}
    for face, loops in enumerate(layout.loops):
        if fluids or role_of(layout.regions[face]) not in FLUID_ROLES:
            for point, angle in _corners(layout, loops):
                found[point] = found.get(point, 0.0) + angle
    return found


def _corners(layout: SectionLayout, loops: Sequence[Sequence[Directed]]) -> Iterator[tuple[int, float]]:
    """The corners of a face with the angles (degrees) inside it."""
    for loop in loops:
        for before, after in zip([loop[-1], *loop], loop, strict=False):
            yield layout.ends[after[0]][0 if after[1] else 1], 180.0 - turned(layout.arc(before), layout.arc(after))


def _graded(layout: SectionLayout, section: FreeSection, size: MeshSize) -> dict[tuple[int, bool], float]:
    """Relative element size at singular points, by point and level edge. As for rectangles, these points are re-entrant
    corners of solids, edges of a couplant and ends of electrodes. The tip of a crack, where a fillet meets its
    neighbour, is one too."""
    wet: set[int] = set()
    edge_points: set[int] = set()
    goes_on = set(section.goes_on.values())
    for face, loops in enumerate(layout.loops):
        region = layout.regions[face]
        corners = [point for point, _ in _corners(layout, loops)]
        if role_of(region) in FLUID_ROLES:
            wet.update(corners)
        if role_of(region) == COUPLANT:
            across = [layout.points[point][0] for point in corners]
            sides = {min(across), max(across)} - goes_on
            edge_points |= {point for point in corners if any(
                abs(layout.points[point][0] - side) < SAME_LENGTH for side in sides)}
    found: dict[tuple[int, bool], float] = {}
    for point, angle in _angles(layout, fluids=False).items():
        # An angle of 360 degrees is the tip of a crack if a fluid touches it, else a point inside solids.
        if angle > REENTRANT and (angle < ALL_AROUND or point in wet):
            sharp = 1 if angle < ALL_AROUND else 3
            found[point, True] = found[point, False] = size.corner_refinement**sharp
    for point in edge_points:
        found[point, True] = min(found.get((point, True), 1.0), size.corner_refinement)
    for point in _ends_of_electrodes(layout, section):
        found[point, True] = size.corner_refinement**3
        # The rows beside the whole face are thin.
        level = [other for other, (_, z) in enumerate(layout.points) if abs(z - layout.points[point][1]) < SAME_LENGTH]
        found |= {(other, False): size.corner_refinement**3 for other in level}
    return found


def _all_along(layout: SectionLayout, sizes: dict[tuple[int, bool], float]) -> dict[tuple[int, bool], float]:
    """Sizes extended to the ends of the sides of the points. The edges across a side have the same division all along
    it, and they begin at its ends."""
    found = dict(sizes)
    for side in (side for sides in layout.sides.values() for side in sides):
        points = [layout.ends[edge][0 if forwards else 1] for edge, forwards in side]
        last, forwards = side[-1]
        points.append(layout.ends[last][1 if forwards else 0])
        across = not _level(layout.edges[side[0][0]])
        least = min((sizes[point, across] for point in points[1:-1] if (point, across) in sizes), default=math.inf)
        for end in (points[0], points[-1]) if least < math.inf else ():
            found[end, across] = min(found.get((end, across), math.inf), least)
    return found


def _local_lengths(layout: SectionLayout, size: MeshSize) -> dict[tuple[int, bool], float]:
    """The largest element size (m) at cavity corners and bond ends. It is as for rectangles (`geometry.panels`), by
    point and whether the edge is level."""
    found: dict[tuple[int, bool], float] = {}
    solid, filled = (_angles(layout, fluids=fluids) for fluids in (False, True))
    for region in dict.fromkeys(layout.regions):
        loops = [loop for face, own in enumerate(layout.loops) if layout.regions[face] == region for loop in own]
        corners = [point for point, angle in _corners(layout, loops) if angle < 180.0 - CORNER]
        across, up = zip(*(layout.points[end] for loop in loops for edge, _ in loop for end in layout.ends[edge]),
                         strict=True)
        if role_of(region) == CAVITY:
            length = size.cavity_corner * max(reach_across(min(across), max(across)), max(up) - min(up))
            own = [point for point in corners if solid.get(point, 0.0) > REENTRANT]
        elif role_of(region) == BOND and size.corner_refinement < 1.0:
            length = max(up) - min(up)
            own = [point for point in corners if REENTRANT < filled[point] < ALL_AROUND]
        else:
            continue
        found |= {(point, level): length for point in own for level in (True, False)}
    return found


def _ends_of_electrodes(layout: SectionLayout, section: FreeSection) -> set[int]:
    """The points where an electrode ends on a face of the transducer."""
    covered = under_electrodes(layout, section)
    around: dict[int, set[tuple[str, ...] | None]] = {}
    for directed in layout.around_transducer():
        arc, edge = layout.arc(directed), directed[0]
        if _level(arc):
            for point in layout.ends[edge]:
                around.setdefault(point, set()).add(covered.get(edge))
    return {point for point, names in around.items() if len(names) > 1 and None in names}


def under_electrodes(layout: SectionLayout, section: FreeSection) -> dict[int, tuple[str, ...]]:
    """The transducer edges under electrodes, with the names of these."""
    highest = max((electrode.z for electrode in section.electrodes), default=0.0)
    found: dict[int, tuple[str, ...]] = {}
    for directed in layout.around_transducer():
        (r0, z0), (r1, z1) = layout.arc(directed).ends
        if abs(z1 - z0) >= abs(r1 - r0):
            continue
        for electrode in section.electrodes:
            # A loop runs towards the axis along the upper face.
            if (r1 < r0) == (electrode.z == highest) and (
                    electrode.r_inner - SAME_LENGTH < min(r0, r1) and max(r0, r1) < electrode.r_outer + SAME_LENGTH):
                found[directed[0]] = (*found.get(directed[0], ()), electrode.name)
    # An edge inside the transducer is a cut of its face.
    beside = layout.beside()
    return {edge: names for edge, names in found.items()
            if [layout.regions[face] for face in beside[edge]].count(TRANSDUCER) == 1}


def numbers_along(side: Sequence[Directed], along: Sequence[Integers]) -> Integers:
    """The points along a side."""
    parts = [along[number] if forwards else along[number][::-1] for number, forwards in side]
    return np.concatenate([*(part[:-1] for part in parts), parts[-1][-1:]])
