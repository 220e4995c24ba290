"""The parts of a chip: layers, electrodes, ports, states. Lengths are in metres.

Axisymmetric model of Acevedo-Espinosa et al. (RP-UEIS), Fig. 1: every layer is a disc or a ring about one axis. The
cavity is a cylindrical hole through neighbouring layers, closed below, and above unless it is a well.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from geometry.dimension import SAME_LENGTH, SHAPES, Dimension, millimetres
from geometry.names import CAVITY, ELECTRODE_GROUND, ELECTRODE_LIVE
from geometry.profile import Profile
from workbench.files.errors import InputError


@dataclass(frozen=True)
class ElectrodeDisc:
    """An electrode on one transducer face: a disc or ring. ``radius`` is None if it covers the face; it then follows
    the transducer's radius. A ring has an ``inner_radius``."""

    radius: Dimension | None = None
    inner_radius: Dimension | None = None


#: Potential of half of a split electrode, as a share of the voltage, by its sign in a chip file.
SIGNS: Mapping[str, float] = {"+": 1.0, "-": -1.0, "0": 0.0}

#: Wirings of two halves at opposite voltages: a centre-tapped transformer 1 : 1 + 1, an amplifier for each half, or one
#: amplifier between both.
TRANSFORMER, TWO_AMPLIFIERS, BETWEEN = "transformer", "two amplifiers", "between the halves"
WIRINGS = (TRANSFORMER, TWO_AMPLIFIERS, BETWEEN)


@dataclass(frozen=True)
class Electrodes:
    """The two electrodes; ``live`` names the transducer face at the drive voltage.

    The other face is at ground. ``halves`` are the signs (:data:`SIGNS`) of the left and the right half of a live
    electrode that is split in the middle of a straight chip. ``wiring`` of halves at opposite voltages is one of
    :data:`WIRINGS`.
    """

    live: Literal["top", "bottom"] = "top"
    live_disc: ElectrodeDisc = ElectrodeDisc()
    ground_disc: ElectrodeDisc = ElectrodeDisc()
    halves: tuple[str, str] | None = None
    wiring: str | None = None

    @property
    def share(self) -> float:
        """Voltage of a live half, as a share of the drive voltage."""
        return 0.5 if self.wiring == BETWEEN else 1.0


@dataclass(frozen=True)
class Layer:
    """One layer: a disc, or a ring around a hole.

    ``cavity_radius`` is the radius of the cavity, ``bore`` that of another hole, which is empty or part of a further
    cavity with a ``filling`` (a material). ``z_bottom`` in metres; ``density`` (kg/m^3) replaces the material's own if
    the part was weighed. ``draft`` (rad), ``barrel``, ``bow`` and ``dome`` (m) are deviations from a disc with plane
    faces and upright sides (`geometry.shapes`); ``taper`` (m) is the difference of a bare disc's thickness across its
    diameter. ``profile`` is an outline other than a rectangle (`geometry.profile`);
    ``thickness`` is then the distance from its bottom to the layer above. A transducer is ``poled`` up or down along z.
    Every transducer but the lowest has electrodes that cover its faces; ``live`` is the face at the drive voltage. In a
    straight chip, ``offset`` (m) is the distance of the layer's middle to the right of the chip's, ``cavity_offset``
    that of its ``channels``, whose middles are a ``pitch`` (m) apart.
    """

    region: str
    role: str
    material: str
    thickness: Dimension
    radius: Dimension
    z_bottom: float
    cavity_radius: Dimension | None = None
    density: float | None = None
    draft: Dimension | None = None
    barrel: Dimension | None = None
    bow: Dimension | None = None
    dome: Dimension | None = None
    taper: float = 0.0
    profile: Profile | None = None
    bore: Dimension | None = None
    filling: str | None = None
    poled: Literal["up", "down"] = "up"
    live: Literal["top", "bottom"] | None = None
    offset: float = 0.0
    cavity_offset: float = 0.0
    channels: int = 1
    pitch: float = 0.0

    @property
    def z_top(self) -> float:
        """Height of the upper face, metres."""
        return self.z_bottom + self.thickness.value

    @property
    def inner_radius(self) -> float:
        """Radius of the hole, metres; 0 for a full disc."""
        hole = self.bore if self.cavity_radius is None else self.cavity_radius
        return 0.0 if hole is None else hole.value

    @property
    def outer_radius(self) -> float:
        """Radius of the layer, metres."""
        return self.radius.value

    @property
    def sides(self) -> tuple[float, float]:
        """Places (m) of its outer sides in a straight chip."""
        return self.offset - self.outer_radius, self.offset + self.outer_radius

    @property
    def holes(self) -> tuple[tuple[float, float], ...]:
        """Left and right sides (m) of every hole, from left to right. The hole of a ring has its sides on both sides of
        the axis."""
        if not self.inner_radius:
            return ()
        first = self.cavity_offset - 0.5 * (self.channels - 1) * self.pitch
        middles = [first + k * self.pitch for k in range(self.channels)]
        return tuple((middle - self.inner_radius, middle + self.inner_radius) for middle in middles)

    @property
    def hole_sides(self) -> tuple[float, float]:
        """The outermost sides (m) of its holes, or its middle twice."""
        return (self.holes[0][0], self.holes[-1][1]) if self.holes else (self.offset, self.offset)

    def covers(self, other: Layer) -> bool:
        """Whether it reaches beyond the holes of another layer on both sides."""
        (left, right), (low, high) = self.sides, other.hole_sides
        return left <= low - SAME_LENGTH and right >= high + SAME_LENGTH

    @property
    def shapes(self) -> dict[str, Dimension]:
        """Its stated shapes, by the names of :data:`SHAPES`."""
        return {name: size for name in SHAPES if (size := getattr(self, name)) is not None}

    def with_shapes(self, sizes: Mapping[str, Dimension | None]) -> Layer:
        """A copy with other sizes of shapes, by the names of :data:`SHAPES`."""
        changed: dict[str, Any] = dict(sizes)
        return replace(self, **changed)


@dataclass(frozen=True)
class Ports:
    """Inlet and outlet: straight channels through the cavity wall. They are equally spaced in azimuth.

    Only the solid model has them; the axisymmetric section and mesh leave them out. ``height`` is that of the axis
    above the cavity floor, by default half the height of the tallest layer around the cavity. Fig. 3 of
    Acevedo-Espinosa et al. (RP-UEIS) shows both ports without a size.
    """

    diameter: Dimension
    height: Dimension | None = None
    count: int = 2


@dataclass(frozen=True)
class ReportedFigures:
    """Reported f0 (Hz), smallest impedance (ohm) and quality factor of a state."""

    label: str
    f0: float
    z_min: float
    q: float


@dataclass(frozen=True)
class State:
    """Contents of a chip during a measurement.

    ``cavity``: the material in the cavity, ``"vacuum"`` if empty, None for a chip without cavity. ``temperature`` in
    kelvin. ``materials`` replaces the material of single regions. ``particle`` is a material name, ``particle_radius``
    in metres.
    """

    name: str
    cavity: str | None = None
    temperature: float | None = None
    materials: Mapping[str, str] = field(default_factory=dict)
    particle: str | None = None
    particle_radius: float | None = None
    reported: tuple[ReportedFigures, ...] = ()


def largest_shape(layer: Layer, name: str) -> float:
    """Upper limit (m or rad) of the magnitude of a layer's shape."""
    if name == "draft":
        return math.pi / 4.0
    if name == "barrel":
        return 0.5 * (layer.outer_radius - layer.inner_radius)
    return 0.5 * layer.thickness.value


def stacked(layers: Iterable[Layer]) -> tuple[Layer, ...]:
    """The layers stacked without gaps; the bottom one keeps its height."""
    stack: list[Layer] = []
    for layer in layers:
        stack.append(replace(layer, z_bottom=stack[-1].z_top) if stack else layer)
    return tuple(stack)


def discs(electrodes: Electrodes) -> tuple[tuple[str, ElectrodeDisc], tuple[str, ElectrodeDisc]]:
    """The two discs with their boundary names, the live one first."""
    return (ELECTRODE_LIVE, electrodes.live_disc), (ELECTRODE_GROUND, electrodes.ground_disc)


def further_cavities(layers: Iterable[Layer]) -> dict[str, tuple[Layer, ...]]:
    """The layers around each further cavity, bottom to top, by its region."""
    groups: list[list[Layer]] = []
    before: Layer | None = None
    for layer in layers:
        if layer.filling is not None:
            if before is None or before.filling is None:
                groups.append([])
            groups[-1].append(layer)
        before = layer
    return {f"{CAVITY}_{number}": tuple(group) for number, group in enumerate(groups, 2)}


def hole_names(layers: Iterable[Layer], across: str = "radius") -> dict[str, str]:
    """Name of each hole's radius, by region. Equal holes share a name. `across` is ``radius`` or ``half_width``
    (`geometry.measure`)."""
    holes = {layer.region: layer.inner_radius for layer in layers if layer.cavity_radius is not None}
    if holes and max(holes.values()) - min(holes.values()) < SAME_LENGTH:
        return dict.fromkeys(holes, f"{CAVITY}.{across}")
    return {region: f"{region}.cavity_{across}" for region in holes}


def named_dimensions(
    layers: Sequence[Layer], electrodes: Electrodes, ports: Ports | None, across: str = "radius"
) -> Iterator[tuple[str, Dimension]]:
    """Names and lengths of a chip, in the order of the layers. See `geometry.chip.Chip.dimensions`. `across` is
    ``radius`` or ``half_width`` (`geometry.measure`)."""
    shared = hole_names(layers, across)
    for layer in layers:
        yield f"{layer.region}.thickness", layer.thickness
        yield f"{layer.region}.{across}", layer.radius
        if layer.bore is not None:
            yield f"{layer.region}.inner_{across}", layer.bore
        for shape, size in layer.shapes.items():
            yield f"{layer.region}.{shape}", size
        if layer.profile is not None:
            for name, size in layer.profile.parameters:
                yield f"{layer.region}.{name}", size
    # Reversed, so that the lowest hole gives the shared radius.
    for layer in reversed(layers):
        if layer.cavity_radius is not None:
            yield shared[layer.region], layer.cavity_radius
    for name, disc in discs(electrodes):
        if disc.radius is not None:
            yield f"{name}.{across}", disc.radius
        if disc.inner_radius is not None:
            yield f"{name}.inner_{across}", disc.inner_radius
    if ports is not None:
        yield "ports.diameter", ports.diameter
        if ports.height is not None:
            yield "ports.height", ports.height


def port_axis(ports: Ports | None, holes: Sequence[Layer], *, file: str) -> tuple[Layer, float]:
    """The layer around the ports, and the height (m) of their axes.

    `holes` are the layers with a hole, bottom to top; `file` is the name in error messages.

    Raises:
        InputError: there are no ports, or their height is outside the cavity.
    """
    if ports is None or not holes:
        raise InputError(file, "cavity.ports", None, "a chip with a cavity and ports")
    if ports.height is None:
        wall = max(holes, key=lambda hole: hole.thickness.value)
        return wall, 0.5 * (wall.z_bottom + wall.z_top)
    height = holes[0].z_bottom + ports.height.value
    for wall in holes:
        if wall.z_bottom <= height <= wall.z_top:
            return wall, height
    raise InputError(file, "cavity.ports.height", millimetres(ports.height.value),
                     f"a height inside the cavity, which is {millimetres(holes[-1].z_top - holes[0].z_bottom)} high")
