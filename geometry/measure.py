"""The measure of a section: what a small area of it stands for in three dimensions.

An axisymmetric section turns about its axis: 2 pi r dr dz. A straight one goes on into the paper for a length: length
dx dz, in plane strain. In a straight section, r and u_r stand for x and u_x, and x may be negative.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from geometry.names import AXIS, PLANE_LEFT, PLANE_RIGHT
from workbench.files.errors import InputError

Real = NDArray[np.float64]


class Parity(Enum):
    """Behaviour of the fields at the end of a straight section: mirrored with or without a change of sign, or no plane
    of symmetry."""

    EVEN = "even"
    ODD = "odd"
    NONE = "none"


@dataclass(frozen=True)
class Axisymmetric:
    """The section turned about the axis r = 0, with the weight 2 pi r dr dz and the hoop strain u_r / r."""

    #: Names of a distance from the axis, and of twice that, in a chip.
    across, doubled = "radius", "diameter"
    #: Symbol of the coordinate across the section.
    symbol = "r"
    #: Sign of scalar fields in the image on the other side of the axis.
    mirror = 1
    #: The volume within a distance from the axis grows with this power of it.
    power = 2
    #: Number of pieces of a layer around a cavity.
    sides = 1

    def depth(self, r: Real) -> Real:
        """Depth (m) of the body into the paper at radii `r` (m), its circumference."""
        return np.asarray(2.0 * np.pi * r)

    def over_r(self, value: Real, r: Real) -> Real:
        """Values divided by the radius, for the hoop strain."""
        return np.asarray(value / r)

    def volume(self, inner: float, outer: float, height: float) -> float:
        """Volume (m^3) of a rectangle of the section between two radii (m)."""
        return math.pi * (outer**2 - inner**2) * height

    def device_volume(self, inner: float, outer: float, height: float) -> float:
        """Volume (m^3) of the device between two distances (m) from the axis."""
        return self.volume(inner, outer, height)

    def ends(self, breaks: tuple[float, ...]) -> Mapping[str, float]:
        """Places (m) of the lines at which a section with these breaks ends while the device goes on, by name."""
        return {AXIS: 0.0} if breaks[0] == 0.0 else {}


@dataclass(frozen=True)
class Straight:
    """The section of a body that is straight for a ``length`` (m) into the paper, with the weight length dx dz.

    ``left`` and ``right`` are the parities of the planes of symmetry at its ends. A section with one such plane is
    half of the device, and everything is counted for the whole of it: the weight is twice as large. Between two planes
    lies one half cell of a row of equal devices; it is counted once.

    Raises:
        InputError: a length that is not above zero.
    """

    length: float = 1.0
    left: Parity = Parity.NONE
    right: Parity = Parity.NONE

    #: Names of a distance from the plane x = 0, and of twice that, in a chip.
    across, doubled = "half_width", "width"
    #: Symbol of the coordinate across the section.
    symbol = "x"
    #: The volume within a distance from the middle grows with this power of it.
    power = 1

    def __post_init__(self) -> None:
        if not 0.0 < self.length < math.inf:
            raise InputError("section", "length", self.length, "a length above zero (m)")

    @property
    def planes(self) -> dict[str, Parity]:
        """The parities of the planes of symmetry, by the names of their boundaries."""
        both = {PLANE_LEFT: self.left, PLANE_RIGHT: self.right}
        return {name: parity for name, parity in both.items() if parity is not Parity.NONE}

    @property
    def copies(self) -> int:
        """Number of images of the section that make up the device."""
        return 2 if len(self.planes) == 1 else 1

    @property
    def sides(self) -> int:
        """Number of pieces of a layer around a channel: two walls, or one in a half cell of a row of devices."""
        return 1 if len(self.planes) == 2 else 2

    @property
    def mirror(self) -> int:
        """Sign of scalar fields in the image on the other side of the left end; 0 if there is no plane there."""
        return {Parity.EVEN: 1, Parity.ODD: -1, Parity.NONE: 0}[self.left]

    def depth(self, r: Real) -> Real:
        """Depth (m) of the body into the paper at places `r` (m), its length times the images of the section."""
        return np.full(np.shape(r), self.copies * self.length)

    def over_r(self, value: Real, r: Real) -> Real:
        """Zero: there is no hoop strain."""
        return np.zeros(np.broadcast_shapes(np.shape(value), np.shape(r)))

    def volume(self, inner: float, outer: float, height: float) -> float:
        """Volume (m^3) of a rectangle of the section between two places (m), in all images."""
        return self.copies * self.length * (outer - inner) * height

    def device_volume(self, inner: float, outer: float, height: float) -> float:
        """Volume (m^3) of the device between two distances (m) from its middle, on all of its sides."""
        return self.sides * self.length * (outer - inner) * height

    def ends(self, breaks: tuple[float, ...]) -> Mapping[str, float]:
        """Places (m) of the lines at which a section with these breaks ends while the device goes on, by name."""
        places = {PLANE_LEFT: breaks[0], PLANE_RIGHT: breaks[-1]}
        return {name: places[name] for name in self.planes}


#: The measures of a section, and that of one of which nothing else is said.
Measure = Axisymmetric | Straight
ABOUT_AXIS = Axisymmetric()
