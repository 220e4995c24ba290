"""Effects in an annulus at the edge or hole of a layer.

One number places the edge of the annulus. Integrals are taken over fixed rings, each affected as a whole, in part or
not at all, so that a model stays one sum of fixed matrices. The result is exact if the edge is that of a ring; between
two edges it is an interpolation by area.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from workbench.physics.term import Admissible, ConstantLaw, Formula, FreeParameter, Term

#: Widths up to the edges of the rings, relative to the layer's radius. Meshes have a line of nodes at each
#: (`geometry.mesh_size.MeshSize.radii`): if the gel of a chip of 3 mm ends within an element, Z is wrong by 3 to 22 %,
#: with lines there by 0.1 %.
WIDTHS = (0.02, 0.05, 0.09, 0.14, 0.2, 0.28)

#: Largest relative width up to which an annulus has separate edges if another annulus has edges nearby.
NEAR_WIDTH = 0.05

#: Width of a ring beside a converged edge, and the largest step of a converged edge, both relative to the radius.
#: Interpolation between edges moves the edge outwards by a hundredth of the width: 0.158 for 0.160; half and a tenth of
#: these numbers give the same.
SIDE_WIDTH, EDGE_STEP = 0.01, 0.002

#: Largest width of an annulus, relative to the radius.
LARGEST_WIDTH = 0.38

#: The symbol in a law for the affected share of a ring.
SHARE = "share"

#: The symbol in a law for the width of a ring, as a share of the radius, height or area.
RING = "ring"

#: Measures of the shares of an annulus, with the name of its number.
MEASURES: Mapping[str, str] = {"radius": "width", "height": "depth", "area": "area"}


@dataclass(frozen=True)
class Annulus:
    """The affected rings of a layer, up to the edge at ``<name>.width``.

    They extend from the share ``begin`` of the layer's outer radius inwards, or ``outwards``, by the width. All widths
    are relative to that radius, at most ``limit``; ``widths`` are those of the edges of the rings.

    With another ``measure`` all of these are shares of the layer's height from its lower face, or of its area from its
    axis: slabs of depth ``<name>.depth``, or a disc of area ``<name>.area``.

    Raises:
        ValueError: it extends beyond the layer, or the measure is unknown.
    """

    name: str
    begin: float = 1.0
    limit: float = LARGEST_WIDTH
    outwards: bool = False
    widths: tuple[float, ...] = WIDTHS
    measure: str = "radius"

    def __post_init__(self) -> None:
        if self.measure not in MEASURES:
            raise ValueError(f"annulus {self.name!r} in shares of the {self.measure}: expected {', '.join(MEASURES)}")
        end = self.begin + (self.limit if self.outwards else -self.limit)
        if not (self.limit > 0.0 and min(self.begin, end) >= 0.0 and max(self.begin, end) <= 1.0):
            raise ValueError(f"annulus {self.name!r} from {self.begin:g} to {end:g} of a radius: expected two shares "
                             "of 0 to 1, the second inwards or, with outwards=True, outwards")

    @property
    def number(self) -> str:
        """The full name of the width, depth or area."""
        return f"{self.name}.{MEASURES[self.measure]}"

    def free(self) -> tuple[FreeParameter, ...]:
        """The width as a free parameter; zero means no effect."""
        return (FreeParameter(self.number, 0.0,
                              Admissible(0.0, self.limit, "1", f"of the {self.measure}: from zero to an extent that "
                                         "is visible")),)

    @cached_property
    def edges(self) -> tuple[float, ...]:
        """Edges of the rings, relative to the layer's radius, ascending."""
        widths = (0.0, *(width for width in self.widths if width < self.limit), self.limit)
        return tuple(sorted(self.begin + (width if self.outwards else -width) for width in widths))

    def widths_from(self, begin: float) -> tuple[float, ...]:
        """Widths for an outward annulus at `begin` that shares distant edges. Nearby edges are separate, distant ones
        are those of this annulus."""
        near = [width for width in WIDTHS if width <= NEAR_WIDTH]
        return (*near, *(edge - begin for edge in self.edges if edge - begin > near[-1] + near[0]))

    def about(self, width: float) -> Annulus:
        """A copy with edges only at `width` and :data:`SIDE_WIDTH` beside it."""
        near = (width - SIDE_WIDTH, width, width + SIDE_WIDTH)
        return replace(self, widths=tuple(each for each in near if 0.0 < each < self.limit))

    def affected(self, ring: int, width: float) -> tuple[float, float]:
        """The share of a ring within the `width`, and its derivative. The share is of the area, or of a slab's height;
        the derivative is by the width."""
        inner, outer = self.edges[ring], self.edges[ring + 1]
        edge = self.begin + (width if self.outwards else -width)
        power = 2 if self.measure == "radius" else 1
        area = outer**power - inner**power
        share = ((edge**power - inner**power) if self.outwards else (outer**power - edge**power)) / area
        # At the edge between two rings, the derivative is that in the ring into which a larger width extends.
        moves = inner <= edge < outer if self.outwards else inner < edge <= outer
        return min(max(share, 0.0), 1.0), power * edge ** (power - 1) / area if moves else 0.0

    def coefficients(
        self, law: ConstantLaw, symbols: tuple[tuple[str, str], ...], omega_power: int = 0
    ) -> Iterator[tuple[float, Formula]]:
        """Pairs (radius fraction, coefficient) of integrals from each fraction outwards.

        The `law` of the affected share is zero at a share of zero; `symbols` are those of `Formula`, without the share.
        The law also gets the width of each ring as :data:`RING`.
        """
        for at, edge in enumerate(self.edges):
            if edge < 1.0:
                yield edge, Formula(Step(law, self, at), ((_WIDTH, self.number), *symbols), omega_power)


class AnnulusTerm(Term):
    """A term whose effect is confined to an annulus."""

    annulus: Annulus

    @property
    def needs_axis(self) -> bool:
        # Shares of rings refer to an axis; slabs do not.
        return self.annulus.measure != "height"

    def free(self) -> tuple[FreeParameter, ...]:
        return self.annulus.free()


def hindered(share: complex, halfway: float) -> tuple[complex, complex]:
    """The lost effect of a thin layer that is partly missing. It is missing over a share f of a ring.

    It is 1 - s c / (1 - (1 - s) c), returned with its derivative by f. c = 1 - f is the remaining share of area; s =
    `halfway` is the share of the layer with half the effect of the whole.
    """
    below = 1.0 - (1.0 - halfway) * (1.0 - share)
    return share / below, halfway / below**2


_WIDTH = "width"


@dataclass(frozen=True)
class Step:
    """A law just outside an edge minus the law just inside it. Integrals from each edge outwards then add up to the law
    in every ring; ``at`` is the index of the edge."""

    law: ConstantLaw
    annulus: Annulus
    at: int

    def __call__(self, v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
        width = v[_WIDTH].real
        value, slopes = 0j, dict.fromkeys(v, 0j)
        for ring, sign in ((self.at, 1.0), (self.at - 1, -1.0)):
            if not 0 <= ring < len(self.annulus.edges) - 1:
                continue
            share, by_width = self.annulus.affected(ring, width)
            wide = self.annulus.edges[ring + 1] - self.annulus.edges[ring]
            found, by = self.law({**v, SHARE: complex(share), RING: complex(wide)})
            value += sign * found
            for name in v:
                slopes[name] += sign * (by[SHARE] * by_width if name == _WIDTH else by[name])
        return value, slopes
