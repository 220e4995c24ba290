"""How far an effect reaches over the radius of a layer: from its rim inwards, or from a hole outwards, to an edge.

One number says where the edge is. Integrals are taken over fixed rings, each affected as a whole, in part or not at
all, so that a model stays one sum of fixed matrices: exact where the edge is that of a ring, and an area between two.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

from workbench.physics.term import Admissible, ConstantLaw, Formula, FreeParameter

#: Widths up to the edges of the rings, relative to the layer's radius: rings are narrow beside what they add to. Meshes
#: have a line of nodes at each (`geometry.mesh_size.MeshSize.radii`): where the gel of a chip of 3 mm ends within an
#: element, 3 to 22 % are wrong in Z, with lines there 0.1 %.
WIDTHS = (0.02, 0.05, 0.09, 0.14, 0.2, 0.28)

#: Up to this width a rim has edges of its own where another one has some nearby.
NEAR = 0.05

#: A ring beside an edge that was found is so wide, and an edge that moves by less than the second has been found. The
#: law between edges draws it a hundredth of the width outwards: 0.158 for 0.160, also with a half and a tenth of these.
ASIDE, FOUND = 0.01, 0.002

#: How far an effect may reach from a rim.
LIMIT = 0.38

#: The symbol of a law for the share of a ring that is affected.
SHARE = "share"


@dataclass(frozen=True)
class Rim:
    """The rings of a layer that are affected, up to an edge that the number ``<name>.width`` places.

    They begin at the share ``begin`` of the layer's outer radius, and go inwards, or ``outwards``, by the width, in
    shares of that radius, at most ``limit``; rings are up to the ``widths``.

    Raises:
        ValueError: it goes beyond the layer.
    """

    name: str
    begin: float = 1.0
    limit: float = LIMIT
    outwards: bool = False
    widths: tuple[float, ...] = WIDTHS

    def __post_init__(self) -> None:
        end = self.begin + (self.limit if self.outwards else -self.limit)
        if not (self.limit > 0.0 and min(self.begin, end) >= 0.0 and max(self.begin, end) <= 1.0):
            raise ValueError(f"rim {self.name!r} from {self.begin:g} to {end:g} of a radius: expected two shares of 0 "
                             "to 1, the second inwards or, if said so, outwards")

    @property
    def number(self) -> str:
        """The full name of the width."""
        return f"{self.name}.width"

    def free(self) -> tuple[FreeParameter, ...]:
        """The width, zero where nothing is affected."""
        return (FreeParameter(self.number, 0.0,
                              Admissible(0.0, self.limit, "1", "of the radius: from nowhere to what would be "
                                                           "seen at once")),)

    @cached_property
    def edges(self) -> tuple[float, ...]:
        """Of the rings, in shares of the layer's radius, rising."""
        widths = (0.0, *(width for width in self.widths if width < self.limit), self.limit)
        return tuple(sorted(self.begin + (width if self.outwards else -width) for width in widths))

    def widths_from(self, begin: float) -> tuple[float, ...]:
        """The widths of a rim that goes outwards from `begin` and further away has the edges of this one."""
        near = [width for width in WIDTHS if width <= NEAR]
        return (*near, *(edge - begin for edge in self.edges if edge - begin > near[-1] + near[0]))

    def about(self, width: float) -> Rim:
        """The same with an edge at `width`, and rings of :data:`ASIDE` beside it in place of all others."""
        near = (width - ASIDE, width, width + ASIDE)
        return replace(self, widths=tuple(each for each in near if 0.0 < each < self.limit))

    def affected(self, ring: int, width: float) -> tuple[float, float]:
        """The share of the area of a ring that lies within the `width`, and its derivative."""
        inner, outer = self.edges[ring], self.edges[ring + 1]
        edge = self.begin + (width if self.outwards else -width)
        area = outer**2 - inner**2
        share = ((edge**2 - inner**2) if self.outwards else (outer**2 - edge**2)) / area
        # Where two rings meet, the one that a larger width goes on in.
        moves = inner <= edge < outer if self.outwards else inner < edge <= outer
        return min(max(share, 0.0), 1.0), 2.0 * edge / area if moves else 0.0

    def coefficients(
        self, law: ConstantLaw, symbols: tuple[tuple[str, str], ...], omega_power: int = 0
    ) -> Iterator[tuple[float, Formula]]:
        """What to integrate beyond which share of the radius, for a `law` of the share of a ring that is affected.

        The law is zero at a share of zero; `symbols` as of `Formula`, without the share.
        """
        for at, edge in enumerate(self.edges):
            if edge < 1.0:
                yield edge, Formula(Step(law, self, at), ((_WIDTH, self.number), *symbols), omega_power)


@runtime_checkable
class OfRim(Protocol):
    """What has the rings of a rim."""

    @property
    def rim(self) -> Rim: ...


def hindered(share: complex, halfway: float) -> tuple[complex, complex]:
    """What a thin layer lacks where a share f of a ring is without it, and its derivative: 1 - s c / (1 - (1 - s) c).

    c = 1 - f is what is left of it, and s = `halfway` so much of the layer as does half of what all of it does.
    """
    below = 1.0 - (1.0 - halfway) * (1.0 - share)
    return share / below, halfway / below**2


_WIDTH = "width"


@dataclass(frozen=True)
class Step:
    """A law just beyond the edge of that index less the law just within it: what is integrated beyond an edge adds up
    over the edges."""

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
            found, by = self.law({**v, SHARE: complex(share)})
            value += sign * found
            for name in v:
                slopes[name] += sign * (by[SHARE] * by_width if name == _WIDTH else by[name])
        return value, slopes
