"""Sections with layers of any shape: faces bounded by curves.

It corresponds to `geometry.section.Section` for rectangles. Regions may be cut into several faces for the mesh.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from geometry.curves import Arc
from geometry.dimension import SAME_LENGTH
from geometry.measure import ABOUT_AXIS, Measure
from geometry.names import interface, outside
from geometry.section import Electrode, Rectangle
from workbench.files.errors import choose

#: An edge of a loop: its number, and whether the loop has its direction.
Directed = tuple[int, bool]


def faces_beside(faces: Sequence[Sequence[Sequence[Directed]]], count: int) -> tuple[tuple[int, ...], ...]:
    """The one or two faces beside each of `count` edges."""
    found: list[list[int]] = [[] for _ in range(count)]
    for number, loops in enumerate(faces):
        for edge in (edge for loop in loops for edge, _ in loop):
            found[edge].append(number)
    return tuple(tuple(each) for each in found)


@dataclass(frozen=True)
class Face:
    """A face of a region, to the left of its loops. The outer loop is the first."""

    region: str
    loops: tuple[tuple[Directed, ...], ...]


@dataclass(frozen=True)
class FreeSection:
    """Faces that share their edges.

    ``points`` (r, z) in metres; ``edges`` with the numbers of their ``ends``; ``rectangles`` are the layers as discs
    and rings of their stated sizes; ``electrodes`` are lines on the transducer's faces. ``notes`` describe parts of
    solids that the section leaves out. ``cuts`` are the radii (m) of cuts beside steep or curved parts, by region.
    ``measure`` is as in `geometry.section.Section`.
    """

    points: tuple[tuple[float, float], ...]
    edges: tuple[Arc, ...]
    ends: tuple[tuple[int, int], ...]
    faces: tuple[Face, ...]
    electrodes: tuple[Electrode, ...]
    rectangles: tuple[Rectangle, ...] = ()
    notes: tuple[str, ...] = ()
    cuts: tuple[tuple[str, tuple[float, ...]], ...] = ()
    measure: Measure = ABOUT_AXIS

    @cached_property
    def regions(self) -> tuple[str, ...]:
        """Names of the regions, in the order of the faces."""
        return tuple(dict.fromkeys(face.region for face in self.faces))

    def arcs(self, loop: tuple[Directed, ...]) -> Iterator[Arc]:
        """The edges of a loop in its direction."""
        return (self.edges[number] if forwards else self.edges[number].back for number, forwards in loop)

    def area(self, region: str) -> float:
        """Area of the region in the half plane, m^2.

        Raises:
            InputError: unknown region.
        """
        return sum(arc.area for arc in self._around(region))

    def volume(self, region: str) -> float:
        """Volume that the region stands for by the measure, m^3.

        Raises:
            InputError: unknown region.
        """
        return self.measure.body(self.area(region), sum(arc.moment for arc in self._around(region)))

    def _around(self, region: str) -> Iterator[Arc]:
        choose(region, self.regions, source="section", field="region")
        return (arc for face in self.faces if face.region == region for loop in face.loops for arc in self.arcs(loop))

    @cached_property
    def beside(self) -> tuple[tuple[int, ...], ...]:
        """The faces, one or two, on the sides of every edge."""
        return faces_beside([face.loops for face in self.faces], len(self.edges))

    @cached_property
    def goes_on(self) -> Mapping[str, float]:
        """Places (m) of the symmetry lines that end the section, by name."""
        across = [r for r, _ in self.points]
        return self.measure.ends((min(across), max(across)))

    def name_of(self, regions: Sequence[str], arc: Arc) -> str | None:
        """Name of the boundary between `regions`, or None inside a region."""
        if len(regions) == 2:
            return interface(*regions) if regions[0] != regions[1] else None
        (begin, _), (end, _) = arc.ends
        for name, place in self.goes_on.items():
            if max(abs(begin - place), abs(end - place)) < SAME_LENGTH and arc.is_straight:
                return name
        return outside(regions[0])

    def name(self, edge: int) -> str | None:
        """Name of an edge's boundary; None inside a region."""
        return self.name_of([self.faces[face].region for face in self.beside[edge]], self.edges[edge])

    def boundary_names(self) -> tuple[str, ...]:
        """Sorted names of all boundaries, those of electrodes included."""
        names = {electrode.name for electrode in self.electrodes}
        names |= {name for edge in range(len(self.edges)) if (name := self.name(edge)) is not None}
        return tuple(sorted(names))
