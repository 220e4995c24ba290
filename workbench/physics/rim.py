"""Effects that reach from the rim of a layer inwards, or from a hole outwards, to an edge that one number places.

Integrals are taken over fixed rings, each affected as a whole, in part or not at all, so that a model stays one sum of
fixed matrices. The result is exact if the edge is that of a ring; between two edges it is an interpolation by area.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from workbench.physics.term import Admissible, ConstantLaw, Formula, FreeParameter, Term

#: Widths up to the edges of the rings, relative to the layer's radius; each ring is narrow beside the width it adds to.
#: Meshes have a line of nodes at each (`geometry.mesh_size.MeshSize.radii`): if the gel of a chip of 3 mm ends within
#: an element, Z is wrong by 3 to 22 %, with lines there by 0.1 %.
WIDTHS = (0.02, 0.05, 0.09, 0.14, 0.2, 0.28)

#: Largest width, relative to the radius, up to which a rim keeps edges of its own when another rim has edges nearby.
NEAR_WIDTH = 0.05

#: Width of a ring beside an edge that was found, and the largest step at which an edge counts as found, both relative
#: to the radius. Interpolation between edges draws the edge outwards by a hundredth of the width: 0.158 for 0.160, and
#: no more or less with half and a tenth of these numbers.
ASIDE, FOUND = 0.01, 0.002

#: Largest width of a rim, relative to the radius.
LARGEST_WIDTH = 0.38

#: The symbol of a law for the affected share of a ring.
SHARE = "share"

#: The symbol of a law for the width of a ring, in shares of the radius, height or area.
RING = "ring"

#: Measures that the sizes of a rim are shares of, with the name of its number.
MEASURES: Mapping[str, str] = {"radius": "width", "height": "depth", "area": "area"}


@dataclass(frozen=True)
class Rim:
    """The affected rings of a layer, up to an edge that the number ``<name>.width`` places.

    They begin at the share ``begin`` of the layer's outer radius and go inwards, or ``outwards``, by the width. All
    widths are relative to that radius, at most ``limit``; ``widths`` are those of the edges of the rings.

    With another ``measure`` all of these are shares of the layer's height, counted from its lower face, or of the area
    of its outline, counted from its axis: slabs ``<name>.depth`` deep, or a disc of the area ``<name>.area``.

    Raises:
        ValueError: it extends beyond the layer, or has no such measure.
    """

    name: str
    begin: float = 1.0
    limit: float = LARGEST_WIDTH
    outwards: bool = False
    widths: tuple[float, ...] = WIDTHS
    measure: str = "radius"

    def __post_init__(self) -> None:
        if self.measure not in MEASURES:
            raise ValueError(f"rim {self.name!r} in shares of the {self.measure}: expected {', '.join(MEASURES)}")
        end = self.begin + (self.limit if self.outwards else -self.limit)
        if not (self.limit > 0.0 and min(self.begin, end) >= 0.0 and max(self.begin, end) <= 1.0):
            raise ValueError(f"rim {self.name!r} from {self.begin:g} to {end:g} of a radius: expected two shares of 0 "
                             "to 1, the second inwards or, if said so, outwards")

    @property
    def number(self) -> str:
        """The full name of the width, depth or area."""
        return f"{self.name}.{MEASURES[self.measure]}"

    def free(self) -> tuple[FreeParameter, ...]:
        """The width as a free parameter; it is zero if nothing is affected."""
        return (FreeParameter(self.number, 0.0,
                              Admissible(0.0, self.limit, "1", f"of the {self.measure}: from nowhere to what would "
                                         "be seen at once")),)

    @cached_property
    def edges(self) -> tuple[float, ...]:
        """Radii of the edges of the rings, relative to the layer's radius, ascending."""
        widths = (0.0, *(width for width in self.widths if width < self.limit), self.limit)
        return tuple(sorted(self.begin + (width if self.outwards else -width) for width in widths))

    def widths_from(self, begin: float) -> tuple[float, ...]:
        """Widths for a rim that goes outwards from `begin`: its own nearby, and the edges of this rim further away."""
        near = [width for width in WIDTHS if width <= NEAR_WIDTH]
        return (*near, *(edge - begin for edge in self.edges if edge - begin > near[-1] + near[0]))

    def about(self, width: float) -> Rim:
        """A copy with an edge at `width` and rings of :data:`ASIDE` beside it, without other edges."""
        near = (width - ASIDE, width, width + ASIDE)
        return replace(self, widths=tuple(each for each in near if 0.0 < each < self.limit))

    def affected(self, ring: int, width: float) -> tuple[float, float]:
        """The share of a ring's area, or of a slab's height, that lies within the `width`, and its derivative by the
        width."""
        inner, outer = self.edges[ring], self.edges[ring + 1]
        edge = self.begin + (width if self.outwards else -width)
        power = 2 if self.measure == "radius" else 1
        area = outer**power - inner**power
        share = ((edge**power - inner**power) if self.outwards else (outer**power - edge**power)) / area
        # At the edge between two rings, the derivative is that in the ring into which a larger width grows.
        moves = inner <= edge < outer if self.outwards else inner < edge <= outer
        return min(max(share, 0.0), 1.0), power * edge ** (power - 1) / area if moves else 0.0

    def coefficients(
        self, law: ConstantLaw, symbols: tuple[tuple[str, str], ...], omega_power: int = 0
    ) -> Iterator[tuple[float, Formula]]:
        """Pairs (radius fraction, coefficient): integrals to add from each fraction outwards, for a `law` of the
        affected share.

        The law is zero at a share of zero; `symbols` are those of `Formula`, without the share. It is also told how
        wide each ring is, as :data:`RING`.
        """
        for at, edge in enumerate(self.edges):
            if edge < 1.0:
                yield edge, Formula(Step(law, self, at), ((_WIDTH, self.number), *symbols), omega_power)


class OfRim(Term):
    """A term whose effect is confined to the rings of a rim."""

    rim: Rim

    @property
    def needs_axis(self) -> bool:
        # The shares of its rings are those of rings about an axis; slabs have none.
        return self.rim.measure != "height"

    def free(self) -> tuple[FreeParameter, ...]:
        return self.rim.free()


def hindered(share: complex, halfway: float) -> tuple[complex, complex]:
    """The share a thin layer loses if it is missing over a share f of a ring, and the derivative of this share by f.

    It is 1 - s c / (1 - (1 - s) c). c = 1 - f is the remaining share of area; s = `halfway` is the share of the layer
    that has half the effect of all of it.
    """
    below = 1.0 - (1.0 - halfway) * (1.0 - share)
    return share / below, halfway / below**2


_WIDTH = "width"


@dataclass(frozen=True)
class Step:
    """A law just outside an edge less the law just inside it. Integrals from each edge outwards then add up to the law
    in every ring; ``at`` is the index of the edge."""

    law: ConstantLaw
    rim: Rim
    at: int

    def __call__(self, v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
        width = v[_WIDTH].real
        value, slopes = 0j, dict.fromkeys(v, 0j)
        for ring, sign in ((self.at, 1.0), (self.at - 1, -1.0)):
            if not 0 <= ring < len(self.rim.edges) - 1:
                continue
            share, by_width = self.rim.affected(ring, width)
            wide = self.rim.edges[ring + 1] - self.rim.edges[ring]
            found, by = self.law({**v, SHARE: complex(share), RING: complex(wide)})
            value += sign * found
            for name in v:
                slopes[name] += sign * (by[SHARE] * by_width if name == _WIDTH else by[name])
        return value, slopes
