"""The measure of a section: the volume of an area element.

An axisymmetric section turns about its axis, with the weight 2 pi r dr dz. A straight one extends into the paper, with
the weight length dx dz, in plane strain. In a straight section, r and u_r stand for x and u_x, and x may be negative.
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

#: Largest distance from the axis of a place on it, as a share of the largest radius.
AT_AXIS = 1e-9


class Parity(Enum):
    """Symmetry of the fields at the end of a straight section."""

    EVEN = "even"
    ODD = "odd"
    NONE = "none"


#: Length (m) of a straight section whose length is not stated.
PER_METRE = 1.0


@dataclass(frozen=True)
class Axisymmetric:
    """The section turned about the axis r = 0. Its weight is 2 pi r dr dz; its hoop strain is u_r / r."""

    #: Names of a distance from the axis, and of twice it, in a chip.
    across, doubled = "radius", "diameter"
    #: Symbol of the coordinate across the section, and the word for its origin.
    symbol, middle = "r", "axis"
    #: Directions in the section, across and up.
    directions = ("radial", "axial")
    #: Directions in which particles focus within seconds: up, since the cavities of round chips are flat.
    focusing = (1,)
    #: Decimals of a position in a cavity, in millimetres.
    decimals = 2
    #: Sign of scalar fields in the image on the other side of the axis.
    mirror = 1
    #: Power of the distance from the axis to which the volume within it is proportional.
    power = 2
    #: Number of pieces of a layer around a cavity.
    sides = 1
    #: Whether the section shows the device on both sides of its middle.
    is_whole = False

    def depth(self, r: Real) -> Real:
        """Circumference (m) at radii `r` (m)."""
        return np.asarray(2.0 * np.pi * r)

    def over_r(self, value: Real, r: Real) -> Real:
        """Values divided by the radius, for the hoop strain."""
        return np.asarray(value / r)

    def turned(self, value: Real, r: Real) -> Real:
        """Slopes along the circumference, over the order m."""
        return np.asarray(value / r)

    def hoop(self, across: NDArray[Any], slope: NDArray[Any], r: Real) -> NDArray[Any]:
        """Hoop strain u_r / r, and du_r / dr on the axis. It may be a rate. `across` is the displacement along r and
        `slope` its derivative by r."""
        on_axis = r <= AT_AXIS * r.max()
        return np.where(on_axis, slope, across / np.where(on_axis, 1.0, r))

    def evenly(self, share: Real, low: float, high: float) -> Real:
        """Radii (n,) in m below which lies a `share` (n,) of volume. The volume is that between `low` and `high`."""
        return np.asarray(np.sqrt(low**2 + share * (high**2 - low**2)))

    def spatial(self, r: Real, turn: Real, strip: float) -> tuple[Real, Real]:
        """Places x, y (m) from above, at radii `r` and azimuths `turn`."""
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
        """Volume (m^3) from the first `moment` (m^3), by Pappus's theorem."""
        return 2.0 * math.pi * moment

    def device_volume(self, inner: float, outer: float, height: float) -> float:
        """Volume (m^3) of the device between two distances (m) from the axis."""
        return self.volume(inner, outer, height)

    def ends(self, breaks: tuple[float, ...]) -> Mapping[str, float]:
        """Places (m) of the symmetry lines that end the section, by name."""
        return {AXIS: 0.0} if breaks[0] == 0.0 else {}


@dataclass(frozen=True)
class Straight:
    """The section of a straight body of ``length`` (m) into the paper.

    ``left`` and ``right`` are the parities of the planes of symmetry at its ends. A section with one plane is half of
    the device, so the weight length dx dz is doubled. A section between two planes is half a cell of a row of equal
    devices and counts once. ``assumed`` names the keys ``length`` and ``symmetry`` that the chip file does not state.

    Raises:
        InputError: a length that is not above zero.
    """

    length: float = PER_METRE
    left: Parity = Parity.NONE
    right: Parity = Parity.NONE
    assumed: tuple[str, ...] = field(default=(), compare=False, repr=False)

    #: Names of a distance from the plane x = 0, and of twice it, in a chip.
    across, doubled = "half_width", "width"
    #: Symbol of the coordinate across the section, and the word for its origin.
    symbol, middle = "x", "middle"
    #: Directions in the section, across and up.
    directions = ("lateral", "vertical")
    #: Directions in which particles focus within seconds: both, since channels are as wide as high.
    focusing = (0, 1)
    #: Decimals of a position in a cavity, in millimetres: a channel is some hundred micrometres wide.
    decimals = 3
    #: Power of the distance from the middle to which the volume within it is proportional.
    power = 1

    def __post_init__(self) -> None:
        if not 0.0 < self.length < math.inf:
            raise InputError("section", "length", self.length, "a length above zero (m)")

    @property
    def planes(self) -> dict[str, Parity]:
        """The parities of the planes of symmetry, by boundary name."""
        both = {PLANE_LEFT: self.left, PLANE_RIGHT: self.right}
        return {name: parity for name, parity in both.items() if parity is not Parity.NONE}

    @property
    def is_whole(self) -> bool:
        """True if the section includes both sides of the middle."""
        return not self.planes

    @property
    def copies(self) -> int:
        """Number of images of the section that make up the device."""
        return 2 if len(self.planes) == 1 else 1

    @property
    def sides(self) -> int:
        """Number of walls beside a channel. It is one in half a cell of a row of devices."""
        return 1 if len(self.planes) == 2 else 2

    @property
    def mirror(self) -> int:
        """Sign of mirrored scalar fields beyond the left end. It is 0 without a plane there."""
        return {Parity.EVEN: 1, Parity.ODD: -1, Parity.NONE: 0}[self.left]

    def depth(self, r: Real) -> Real:
        """Depth (m) of the body: its length times its images."""
        return np.full(np.shape(r), self.copies * self.length)

    def over_r(self, value: Real, r: Real) -> Real:
        """Zero: there is no hoop strain."""
        return np.zeros(np.broadcast_shapes(np.shape(value), np.shape(r)))

    def turned(self, value: Real, r: Real) -> Real:
        """Slopes along y, over the wave number k."""
        return np.broadcast_to(value, np.broadcast_shapes(np.shape(value), np.shape(r)))

    def hoop(self, across: NDArray[Any], slope: NDArray[Any], r: Real) -> NDArray[Any]:
        """Zero: there is no hoop strain."""
        return np.zeros_like(across)

    def evenly(self, share: Real, low: float, high: float) -> Real:
        """Places (n,) in m below which lies a `share` (n,) of volume. The volume is that between `low` and `high`."""
        return np.asarray(low + share * (high - low))

    def spatial(self, r: Real, turn: Real, strip: float) -> tuple[Real, Real]:
        """Places x, y (m) from above, in a `strip` (m). Azimuths `turn`, from 0 to 2 pi, become places along the strip.
        If the device is mirrored at the left end, they also select the image."""
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
        """A range of distances (m) from the middle, in words."""
        return f"within {1e3 * outer:.3g} mm of the middle"

    def volume(self, inner: float, outer: float, height: float) -> float:
        """Volume (m^3) of a rectangle between two places (m), all images."""
        return self.copies * self.length * (outer - inner) * height

    def body(self, area: float, moment: float) -> float:
        """Volume (m^3) of a part of this `area` (m^2), all images."""
        return self.copies * self.length * area

    def device_volume(self, inner: float, outer: float, height: float) -> float:
        """Volume (m^3) between two distances (m) from the middle, all sides."""
        return self.sides * self.length * (outer - inner) * height

    def ends(self, breaks: tuple[float, ...]) -> Mapping[str, float]:
        """Places (m) of the planes of symmetry that end the section."""
        places = {PLANE_LEFT: breaks[0], PLANE_RIGHT: breaks[-1]}
        return {name: places[name] for name in self.planes}


#: The measures of a section, and the default one.
Measure = Axisymmetric | Straight
ABOUT_AXIS = Axisymmetric()
