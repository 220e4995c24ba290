"""The measure of a section: what a small area of it stands for in three dimensions.

An axisymmetric section turns about its axis: 2 pi r dr dz. A straight one goes on into the paper for a length: length
dx dz, in plane strain. In a straight section, r and u_r stand for x and u_x, and x may be negative.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.names import AXIS, PLANE_LEFT, PLANE_RIGHT
from workbench.files.errors import InputError

Real = NDArray[np.float64]

#: Largest distance from the axis, as a share of the largest radius, at which a place is on it.
AT_AXIS = 1e-9


class Parity(Enum):
    """Behaviour of the fields at the end of a straight section: mirrored with or without a change of sign, or no plane
    of symmetry."""

    EVEN = "even"
    ODD = "odd"
    NONE = "none"


#: Length (m) of a straight section whose length is not stated.
PER_METRE = 1.0


@dataclass(frozen=True)
class Axisymmetric:
    """The section turned about the axis r = 0, with the weight 2 pi r dr dz and the hoop strain u_r / r."""

    #: Names of a distance from the axis, and of twice that, in a chip.
    across, doubled = "radius", "diameter"
    #: Symbol of the coordinate across the section, and the word for where it is zero.
    symbol, middle = "r", "axis"
    #: Directions in the section, across and up.
    directions = ("radial", "axial")
    #: Numbers of the directions in which particles focus within seconds: up, for the cavities of round chips are flat.
    focusing = (1,)
    #: Decimals of a length in millimetres that say where in a cavity something is.
    decimals = 2
    #: Sign of scalar fields in the image on the other side of the axis.
    mirror = 1
    #: The volume within a distance from the axis grows with this power of it.
    power = 2
    #: Number of pieces of a layer around a cavity.
    sides = 1
    #: Whether the section shows the device on both sides of its middle.
    is_whole = False

    def depth(self, r: Real) -> Real:
        """Depth (m) of the body into the paper at radii `r` (m), its circumference."""
        return np.asarray(2.0 * np.pi * r)

    def over_r(self, value: Real, r: Real) -> Real:
        """Values divided by the radius, for the hoop strain."""
        return np.asarray(value / r)

    def turned(self, value: Real, r: Real) -> Real:
        """The slope (1 / r) d/dt over the order m, for cos(m t) and sin(m t)."""
        return np.asarray(value / r)

    def hoop(self, across: NDArray[Any], slope: NDArray[Any], r: Real) -> NDArray[Any]:
        """Hoop strain (or its rate) of a motion `across` along r with its `slope` along r: u_r / r, and du_r / dr on
        the axis."""
        on_axis = r <= AT_AXIS * r.max()
        return np.where(on_axis, slope, across / np.where(on_axis, 1.0, r))

    def evenly(self, share: Real, low: float, high: float) -> Real:
        """Places (n,) in m across the section with that `share` (n,) of the volume from `low` to `high` below them."""
        return np.asarray(np.sqrt(low**2 + share * (high**2 - low**2)))

    def spatial(self, r: Real, turn: Real, strip: float) -> tuple[Real, Real]:
        """Places x, y (m) seen from above of radii `r` (m) at azimuths `turn` (radians); `strip` is not needed."""
        return r * np.cos(turn), r * np.sin(turn)

    def place_words(self, r: float) -> str:
        """A place across the section in words."""
        return "on the axis" if r == 0.0 else f"in a ring of radius {1e3 * r:.{self.decimals}f} mm"

    def wall_place_words(self, r: float) -> str:
        """A place across the floor or the lid in words."""
        return "on the axis" if r == 0.0 else f"at r = {1e3 * r:.{self.decimals}f} mm"

    def within_words(self, outer: float) -> str:
        """The part of a section within a radius (m) in words."""
        return f"r below {1e3 * outer:.3g} mm"

    def volume(self, inner: float, outer: float, height: float) -> float:
        """Volume (m^3) of a rectangle of the section between two radii (m)."""
        return math.pi * (outer**2 - inner**2) * height

    def body(self, area: float, moment: float) -> float:
        """Volume (m^3) of a part of the section with this `area` (m^2) and first `moment` (m^3) about the axis, by
        Pappus's theorem."""
        return 2.0 * math.pi * moment

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
    lies one half cell of a row of equal devices; it is counted once. ``assumed`` names the keys ``length`` and
    ``symmetry`` that the chip file does not state.

    Raises:
        InputError: a length that is not above zero.
    """

    length: float = PER_METRE
    left: Parity = Parity.NONE
    right: Parity = Parity.NONE
    assumed: tuple[str, ...] = field(default=(), compare=False, repr=False)

    #: Names of a distance from the plane x = 0, and of twice that, in a chip.
    across, doubled = "half_width", "width"
    #: Symbol of the coordinate across the section, and the word for where it is zero.
    symbol, middle = "x", "middle"
    #: Directions in the section, across and up.
    directions = ("lateral", "vertical")
    #: Numbers of the directions in which particles focus within seconds: both, since channels are as wide as high.
    focusing = (0, 1)
    #: Decimals of a length in millimetres that say where in a cavity something is: a channel is some hundred
    #: micrometres wide.
    decimals = 3
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
    def is_whole(self) -> bool:
        """Whether the section shows the device on both sides of its middle."""
        return not self.planes

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

    def turned(self, value: Real, r: Real) -> Real:
        """The slope d/dy over the wave number k, for cos(k y) and sin(k y)."""
        return np.broadcast_to(value, np.broadcast_shapes(np.shape(value), np.shape(r)))

    def hoop(self, across: NDArray[Any], slope: NDArray[Any], r: Real) -> NDArray[Any]:
        """Zero: there is no hoop strain."""
        return np.zeros_like(across)

    def evenly(self, share: Real, low: float, high: float) -> Real:
        """Places (n,) in m across the section with that `share` (n,) of the volume from `low` to `high` below them."""
        return np.asarray(low + share * (high - low))

    def spatial(self, r: Real, turn: Real, strip: float) -> tuple[Real, Real]:
        """Places x, y (m) seen from above of places `r` (m) across a `strip` (m) of the device.

        Azimuths `turn`, even from 0 to 2 pi, stand for the place along the strip and, where the device goes on beyond
        its left end, for the image that a place is in.
        """
        share = turn * self.copies / (2.0 * np.pi)
        image = np.floor(share)
        return np.where(image == 0.0, r, -r), np.broadcast_to(strip * (share - image - 0.5), np.shape(r)).copy()

    def place_words(self, r: float) -> str:
        """A place across the section in words."""
        distance = f"{1e3 * abs(r):.{self.decimals}f} mm"
        if float(distance.split()[0]) == 0.0:
            return "in the middle of the channel"
        side = "either side" if self.mirror else "the right" if r > 0.0 else "the left"
        return f"{distance} to {side} of the middle"

    def wall_place_words(self, r: float) -> str:
        """A place across the floor or the lid in words."""
        return self.place_words(r)

    def within_words(self, outer: float) -> str:
        """The part of a section within a distance (m) of its middle in words."""
        return f"within {1e3 * outer:.3g} mm of the middle"

    def volume(self, inner: float, outer: float, height: float) -> float:
        """Volume (m^3) of a rectangle of the section between two places (m), in all images."""
        return self.copies * self.length * (outer - inner) * height

    def body(self, area: float, moment: float) -> float:
        """Volume (m^3) of a part of the section with this `area` (m^2), in all images; its `moment` is not needed."""
        return self.copies * self.length * area

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
