"""A chip as a person describes it: layers from bottom to top, a cavity through some of them, and its states.

:func:`read_chip` reads a TOML file; every length carries its unit, every mistake is answered by an
`InputError` that names the file, the field, the value and the remedy. Materials are only names here.

Axisymmetric model of Acevedo-Espinosa et al. (RP-UEIS), Fig. 1: every layer is a disc of its own radius about one
axis, and the cavity is a cylindrical hole through one or more neighbouring layers, closed below and above.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from geometry.names import (
    CAVITY,
    ELECTRODE_GROUND,
    ELECTRODE_LIVE,
    ROLES,
    TRANSDUCER,
    VACUUM,
    region_names,
)
from workbench.files.errors import InputError, choose, nearest_names
from workbench.files.quantities import parse_quantity
from workbench.files.tables import read_toml, refuse_unknown_keys

#: Lengths closer than this are the same length (metres): far below any tolerance, far above rounding.
SAME_LENGTH = 1e-9


@dataclass(frozen=True)
class Dimension:
    """One length of a chip.

    ``value`` and ``tolerance`` in metres (``None``: nobody said how exact), ``assumed`` when it was not measured or
    published but chosen, ``note`` where it comes from.
    """

    value: float
    tolerance: float | None = None
    assumed: bool = False
    note: str = ""


@dataclass(frozen=True)
class ElectrodeDisc:
    """An electrode on one face of the transducer: a disc, or a ring when ``inner_radius`` is above zero.

    ``radius`` is ``None`` when it covers the face to the rim; it then follows the transducer's radius.
    """

    radius: Dimension | None = None
    inner_radius: Dimension | None = None


@dataclass(frozen=True)
class Electrodes:
    """The two electrodes; ``live`` names the face of the transducer at the drive voltage, the other one is ground."""

    live: Literal["top", "bottom"] = "top"
    live_disc: ElectrodeDisc = ElectrodeDisc()
    ground_disc: ElectrodeDisc = ElectrodeDisc()


@dataclass(frozen=True)
class Layer:
    """One layer: a disc, or a ring around the cavity when ``cavity_radius`` is given.

    ``z_bottom`` in metres; ``density`` in kg/m^3 replaces the material's own when a person weighed the part.
    """

    region: str
    role: str
    material: str
    thickness: Dimension
    radius: Dimension
    z_bottom: float
    cavity_radius: Dimension | None = None
    density: float | None = None

    @property
    def z_top(self) -> float:
        """Height of the upper face, metres."""
        return self.z_bottom + self.thickness.value

    @property
    def inner_radius(self) -> float:
        """Radius of the hole, metres; 0 for a full disc."""
        return 0.0 if self.cavity_radius is None else self.cavity_radius.value

    @property
    def outer_radius(self) -> float:
        """Radius of the layer, metres."""
        return self.radius.value


@dataclass(frozen=True)
class Ports:
    """Inlet and outlet of the cavity: straight channels from its wall to the outer surface, evenly round the axis.

    Only the solid model has them; the section and the mesh are axisymmetric and leave them out. ``diameter`` of the
    channel and ``height`` of its axis above the cavity floor; without a height the channel runs at mid-height of the
    tallest layer around the cavity. Fig. 3 of Acevedo-Espinosa et al. (RP-UEIS) shows both ports without a size.
    """

    diameter: Dimension
    height: Dimension | None = None
    count: int = 2


@dataclass(frozen=True)
class ReportedFigures:
    """Figures of merit somebody reported for a state: f0 in Hz, smallest impedance in ohm, quality factor."""

    label: str
    f0: float
    z_min: float
    q: float


@dataclass(frozen=True)
class State:
    """What a chip holds while it is measured.

    ``cavity``: material in the cavity, ``"vacuum"`` for nothing, ``None`` for a chip without cavity. ``temperature`` in
    kelvin. ``materials`` replaces the material of single regions. ``particle`` is a material name,
    ``particle_radius`` in metres.
    """

    name: str
    cavity: str | None = None
    temperature: float | None = None
    materials: Mapping[str, str] = field(default_factory=dict)
    particle: str | None = None
    particle_radius: float | None = None
    reported: tuple[ReportedFigures, ...] = ()


@dataclass(frozen=True)
class Chip:
    """A chip whose description has been checked.

    ``layers`` from bottom to top, ``band`` the two ends (Hz) of the frequencies it is meant for, ``states`` in the
    order of the file, ``source`` where the description comes from, ``file`` the name errors are reported under.

    Raises:
        InputError: the layers do not make a chip (see the checks below), whether read from a file or made in code.
    """

    name: str
    layers: tuple[Layer, ...]
    band: tuple[float, float]
    states: tuple[State, ...] = (State("default"),)
    electrodes: Electrodes = Electrodes()
    ports: Ports | None = None
    description: str = ""
    source: str = ""
    file: str = "chip"

    def __post_init__(self) -> None:
        for check in (_check_dimensions, _check_cavity, _check_stack, _check_electrodes, _check_ports, _check_states):
            check(self)

    @cached_property
    def holes(self) -> tuple[Layer, ...]:
        """The layers with a hole, bottom to top; empty for a chip without cavity."""
        return tuple(layer for layer in self.layers if layer.cavity_radius is not None)

    @property
    def regions(self) -> tuple[str, ...]:
        """Names of the layers from bottom to top, then ``cavity`` if there is one."""
        return tuple(layer.region for layer in self.layers) + ((CAVITY,) if self.holes else ())

    @property
    def transducer(self) -> Layer:
        """The piezoelectric layer."""
        return self.layer(TRANSDUCER)

    def layer(self, region: str) -> Layer:
        """The layer of that region.

        Raises:
            InputError: no layer of that name (the cavity is a region but not a layer).
        """
        layers = {layer.region: layer for layer in self.layers}
        return layers[choose(region, layers, source=self.file, field="region")]

    def state(self, name: str) -> State:
        """The state of that name.

        Raises:
            InputError: the chip has no such state.
        """
        states = {state.name: state for state in self.states}
        return states[choose(name, states, source=self.file, field="state")]

    def materials(self, state: str) -> dict[str, str]:
        """Material name of every region in that state, ``"vacuum"`` for an empty cavity.

        Raises:
            InputError: the chip has no such state.
        """
        chosen = self.state(state)
        names = {layer.region: layer.material for layer in self.layers} | dict(chosen.materials)
        return names if chosen.cavity is None else names | {CAVITY: chosen.cavity}

    def volumes(self) -> dict[str, float]:
        """Volume of every region in cubic metres, from the dimensions alone; ports are not counted."""
        rings = {
            layer.region: math.pi * (layer.outer_radius**2 - layer.inner_radius**2) * layer.thickness.value
            for layer in self.layers
        }
        if not self.holes:
            return rings
        return rings | {CAVITY: sum(math.pi * hole.inner_radius**2 * hole.thickness.value for hole in self.holes)}

    def dimensions(self) -> dict[str, Dimension]:
        """Every length that can be changed by name, in the order of the layers.

        ``<region>.thickness`` and ``<region>.radius``; ``cavity.radius`` when all holes are equally wide, otherwise
        ``<region>.cavity_radius`` each; ``electrode_live.radius``, ``electrode_live.inner_radius`` and the same of the
        ground electrode where they are not the whole face; ``ports.diameter`` and ``ports.height`` where given.
        """
        return dict(_named_dimensions(self))

    def with_dimensions(self, values: Mapping[str, float]) -> Chip:
        """The same chip with other lengths (metres), by the names of :meth:`dimensions`; layers above move along.

        The tolerance of a length was that of its old value, and goes with it.

        Raises:
            InputError: unknown name, or the new lengths do not make a chip.
        """
        known = self.dimensions()
        for name in values:
            choose(name, known, source=self.file, field="dimension")

        def changed(name: str, old: Dimension | None) -> Dimension | None:
            return None if old is None else always(name, old)

        def always(name: str, old: Dimension) -> Dimension:
            if name not in values or values[name] == old.value:
                return old
            return replace(old, value=float(values[name]), tolerance=None)

        hole_names = _hole_names(self.layers)
        layers = tuple(
            replace(
                layer,
                thickness=always(f"{layer.region}.thickness", layer.thickness),
                radius=always(f"{layer.region}.radius", layer.radius),
                cavity_radius=changed(hole_names.get(layer.region, ""), layer.cavity_radius),
            )
            for layer in self.layers
        )
        live, ground = (
            ElectrodeDisc(changed(f"{name}.radius", disc.radius), changed(f"{name}.inner_radius", disc.inner_radius))
            for name, disc in _discs(self.electrodes)
        )
        ports = self.ports and replace(
            self.ports,
            diameter=always("ports.diameter", self.ports.diameter),
            height=changed("ports.height", self.ports.height),
        )
        return replace(
            self,
            layers=_stacked(layers),
            electrodes=replace(self.electrodes, live_disc=live, ground_disc=ground),
            ports=ports,
        )


def _stacked(layers: Iterable[Layer]) -> tuple[Layer, ...]:
    """The layers moved so that each rests on the one below; the bottom one stays where it is."""
    stack: list[Layer] = []
    for layer in layers:
        stack.append(replace(layer, z_bottom=stack[-1].z_top) if stack else layer)
    return tuple(stack)


def _discs(electrodes: Electrodes) -> tuple[tuple[str, ElectrodeDisc], tuple[str, ElectrodeDisc]]:
    return (ELECTRODE_LIVE, electrodes.live_disc), (ELECTRODE_GROUND, electrodes.ground_disc)


def _hole_names(layers: Iterable[Layer]) -> dict[str, str]:
    """Name of the dimension that holds the hole's radius, by region: shared while all holes are equally wide."""
    holes = {layer.region: layer.inner_radius for layer in layers if layer.cavity_radius is not None}
    if holes and max(holes.values()) - min(holes.values()) < SAME_LENGTH:
        return dict.fromkeys(holes, f"{CAVITY}.radius")
    return {region: f"{region}.cavity_radius" for region in holes}


def _named_dimensions(chip: Chip) -> Iterator[tuple[str, Dimension]]:
    hole_names = _hole_names(chip.layers)
    for layer in chip.layers:
        yield f"{layer.region}.thickness", layer.thickness
        yield f"{layer.region}.radius", layer.radius
    # Reversed, so that the lowest hole speaks for the shared radius.
    for layer in reversed(chip.holes):
        if layer.cavity_radius is not None:
            yield hole_names[layer.region], layer.cavity_radius
    for name, disc in _discs(chip.electrodes):
        if disc.radius is not None:
            yield f"{name}.radius", disc.radius
        if disc.inner_radius is not None:
            yield f"{name}.inner_radius", disc.inner_radius
    if chip.ports is not None:
        yield "ports.diameter", chip.ports.diameter
        if chip.ports.height is not None:
            yield "ports.height", chip.ports.height


# --------------------------------------------------------------------------------------------------------------------
# Checks. Each raises the InputError of the first mistake it finds; lengths in messages are in millimetres.


def _mm(length: float) -> str:
    return f"{1e3 * length:.6g} mm"


def _check_dimensions(chip: Chip) -> None:
    low, high = chip.band
    if not 0.0 < low < high:
        raise InputError(chip.file, "chip.band", [low, high], "two frequencies in Hz above zero, the lower one first")
    places = [
        (f"layers[{i}].{name}", dimension)
        for i, layer in enumerate(chip.layers)
        for name, dimension in (
            ("thickness", layer.thickness),
            ("radius", layer.radius),
            ("cavity_radius", layer.cavity_radius),
        )
        if dimension is not None
    ]
    places += [(name, d) for name, d in chip.dimensions().items() if name.startswith(("electrode_", "ports."))]
    for place, dimension in places:
        if not (math.isfinite(dimension.value) and dimension.value > 0.0):
            raise InputError(chip.file, place, _mm(dimension.value), "a length above zero")
        tolerance = dimension.tolerance
        if tolerance is not None and not 0.0 <= tolerance < dimension.value:
            raise InputError(
                chip.file,
                f"{place}.tolerance",
                _mm(tolerance),
                f"zero or more and below the value, {_mm(dimension.value)}",
            )
    for i, layer in enumerate(chip.layers):
        if layer.density is not None and not (math.isfinite(layer.density) and layer.density > 0.0):
            raise InputError(chip.file, f"layers[{i}].density", layer.density, "a density above zero")


def _check_cavity(chip: Chip) -> None:
    # A hole is only ever as wide as its neighbours reach, so no ring is left resting on nothing either.
    places = [i for i, layer in enumerate(chip.layers) if layer.cavity_radius is not None]
    for i in places:
        layer = chip.layers[i]
        if layer.role == TRANSDUCER:
            raise InputError(
                chip.file, f"layers[{i}].cavity_radius", _mm(layer.inner_radius), "no hole through the transducer"
            )
        if layer.inner_radius > layer.outer_radius - SAME_LENGTH:
            raise InputError(
                chip.file,
                f"layers[{i}].cavity_radius",
                _mm(layer.inner_radius),
                f"a hole narrower than its layer, below {_mm(layer.outer_radius)}",
            )
        for j, side in ((i - 1, "below"), (i + 1, "above")):
            if not 0 <= j < len(chip.layers):
                raise InputError(
                    chip.file,
                    f"layers[{i}].cavity_radius",
                    _mm(layer.inner_radius),
                    f"a closed cavity: a layer {side} {layer.region!r}",
                )
            if chip.layers[j].outer_radius < layer.inner_radius + SAME_LENGTH:
                raise InputError(
                    chip.file,
                    f"layers[{i}].cavity_radius",
                    _mm(layer.inner_radius),
                    f"a closed cavity: {chip.layers[j].region!r} {side} reaches only "
                    f"{_mm(chip.layers[j].outer_radius)}",
                )
    if places and places != list(range(places[0], places[-1] + 1)):
        gap = next(i for i in range(places[0], places[-1]) if i not in places)
        raise InputError(
            chip.file,
            f"layers[{gap}].cavity_radius",
            None,
            f"a hole through {chip.layers[gap].region!r} too: the holes of a cavity are in neighbouring layers",
        )


def _check_stack(chip: Chip) -> None:
    roles = [layer.role for layer in chip.layers]
    for i, layer in enumerate(chip.layers):
        choose(layer.role, ROLES, source=chip.file, field=f"layers[{i}].role")
    if roles.count(TRANSDUCER) != 1:
        raise InputError(
            chip.file, "layers", f"{roles.count(TRANSDUCER)} layers with role 'transducer'", "exactly one transducer"
        )
    for i, (layer, region) in enumerate(zip(chip.layers, region_names(roles), strict=True)):
        if layer.region != region:
            raise InputError(
                chip.file, f"layers[{i}].region", layer.region, f"{region!r}, its role numbered from below"
            )
        if i == 0:
            continue
        below = chip.layers[i - 1]
        distance = layer.z_bottom - below.z_top
        if abs(distance) > SAME_LENGTH:
            fault = "leaves a gap above" if distance > 0 else "overlaps"
            raise InputError(
                chip.file,
                f"layers[{i}].bottom",
                _mm(layer.z_bottom),
                f"{_mm(below.z_top)}, the top of {below.region!r}, which it {fault} by {_mm(abs(distance))}; "
                "leave 'bottom' out to stack the layers",
            )


def _check_electrodes(chip: Chip) -> None:
    choose(chip.electrodes.live, ("top", "bottom"), source=chip.file, field="electrodes.live")
    rim = chip.transducer.outer_radius
    for name, disc in _discs(chip.electrodes):
        radius = rim if disc.radius is None else disc.radius.value
        if radius > rim + SAME_LENGTH:
            raise InputError(chip.file, f"{name}.radius", _mm(radius), f"at most the transducer's radius, {_mm(rim)}")
        if disc.inner_radius is not None and disc.inner_radius.value > radius - SAME_LENGTH:
            raise InputError(
                chip.file, f"{name}.inner_radius", _mm(disc.inner_radius.value), f"below its radius, {_mm(radius)}"
            )


def _check_ports(chip: Chip) -> None:
    if chip.ports is None:
        return
    if not chip.holes:
        raise InputError(chip.file, "cavity.ports", "ports", "no ports: no layer has a cavity_radius")
    if not 1 <= chip.ports.count <= 8:
        raise InputError(chip.file, "cavity.ports.count", chip.ports.count, "a whole number from 1 to 8")
    wall, height = port_axis(chip)
    radius = 0.5 * chip.ports.diameter.value
    if radius > min(height - wall.z_bottom, wall.z_top - height) + SAME_LENGTH or radius >= wall.inner_radius:
        raise InputError(
            chip.file,
            "cavity.ports",
            f"diameter {_mm(2 * radius)}, axis {_mm(height - chip.holes[0].z_bottom)} above the cavity floor",
            f"a channel inside the wall {wall.region!r}, which is {_mm(wall.thickness.value)} high, "
            f"and narrower than the cavity, {_mm(2 * wall.inner_radius)}",
        )
    if 2.0 * wall.inner_radius * math.sin(math.pi / chip.ports.count) < 2.0 * radius and chip.ports.count > 1:
        raise InputError(
            chip.file,
            "cavity.ports.count",
            chip.ports.count,
            "fewer or narrower ports: they overlap at the cavity wall",
        )


def port_axis(chip: Chip) -> tuple[Layer, float]:
    """The layer the ports of `chip` run through and the height of their axes (metres, in the chip's own z).

    Raises:
        InputError: the chip has no ports, or their height lies beside the cavity.
    """
    if chip.ports is None or not chip.holes:
        raise InputError(chip.file, "cavity.ports", None, "a chip with a cavity and ports")
    if chip.ports.height is None:
        wall = max(chip.holes, key=lambda hole: hole.thickness.value)
        return wall, 0.5 * (wall.z_bottom + wall.z_top)
    height = chip.holes[0].z_bottom + chip.ports.height.value
    for wall in chip.holes:
        if wall.z_bottom <= height <= wall.z_top:
            return wall, height
    raise InputError(
        chip.file,
        "cavity.ports.height",
        _mm(chip.ports.height.value),
        f"a height inside the cavity, which is {_mm(chip.holes[-1].z_top - chip.holes[0].z_bottom)} high",
    )


def _check_states(chip: Chip) -> None:
    if not chip.states:
        raise InputError(chip.file, "states", None, "at least one state")
    for state in chip.states:
        place = f"states.{state.name}"
        if chip.holes and state.cavity is None:
            raise InputError(chip.file, f"{place}.cavity", None, f'what fills the cavity: a material or "{VACUUM}"')
        if not chip.holes and state.cavity is not None:
            raise InputError(
                chip.file, f"{place}.cavity", state.cavity, "no cavity entry: no layer has a cavity_radius"
            )
        if state.temperature is not None and not (math.isfinite(state.temperature) and state.temperature > 0.0):
            raise InputError(chip.file, f"{place}.temperature", state.temperature, "a temperature above absolute zero")
        for region in state.materials:
            layers = (layer.region for layer in chip.layers)
            choose(region, layers, source=chip.file, field=f"{place}.materials")
        if (state.particle is None) != (state.particle_radius is None):
            missing = "particle" if state.particle is None else "particle_radius"
            raise InputError(chip.file, f"{place}.{missing}", None, "both 'particle' and 'particle_radius', or neither")
        if state.particle_radius is None:
            continue
        if not chip.holes or state.cavity == VACUUM:
            raise InputError(chip.file, f"{place}.particle", state.particle, "no particle without a fluid to carry it")
        room = min(min(hole.inner_radius for hole in chip.holes), 0.5 * (chip.holes[-1].z_top - chip.holes[0].z_bottom))
        if not 0.0 < state.particle_radius < room:
            raise InputError(
                chip.file,
                f"{place}.particle_radius",
                _mm(state.particle_radius),
                f"above zero and below {_mm(room)}, or it does not fit the cavity",
            )


# --------------------------------------------------------------------------------------------------------------------
# Reading


@dataclass(frozen=True)
class _Table:
    """A table of the file together with its place in it, so that every complaint can say where."""

    content: Mapping[str, Any]
    place: str
    file: str

    def at(self, key: str) -> str:
        return f"{self.place}.{key}" if self.place else key

    def only(self, *keys: str) -> None:
        refuse_unknown_keys(self.content, keys, source=self.file, field=self.place)

    def required(self, key: str, expected: str) -> Any:
        if key not in self.content:
            raise InputError(self.file, self.at(key), None, expected, nearest_names(key, self.content))
        return self.content[key]

    def text(self, key: str, default: str | None = None) -> str:
        value = self.required(key, "a text") if default is None else self.content.get(key, default)
        if not isinstance(value, str) or (default is None and not value.strip()):
            raise InputError(self.file, self.at(key), value, "a text")
        return value

    def optional_text(self, key: str) -> str | None:
        return self.text(key) if key in self.content else None

    def quantity(self, key: str, dimension: str) -> float:
        value = self.required(key, f"a {dimension} with its unit")
        return parse_quantity(value, dimension, source=self.file, field=self.at(key))

    def optional_quantity(self, key: str, dimension: str) -> float | None:
        return self.quantity(key, dimension) if key in self.content else None

    def table(self, key: str) -> _Table:
        value = self.content.get(key, {})
        if not isinstance(value, dict):
            raise InputError(self.file, self.at(key), value, "a table")
        return _Table(value, self.at(key), self.file)

    def dimension(self, key: str) -> Dimension:
        """``"2.02 mm"`` or ``{ value = "2.02 mm", tolerance = "20 um", assumed = true, note = "..." }``."""
        if not isinstance(self.required(key, 'a length with its unit, for example "2.02 mm"'), dict):
            return Dimension(self.quantity(key, "length"))
        table = self.table(key)
        table.only("value", "tolerance", "assumed", "note")
        assumed = table.content.get("assumed", False)
        if not isinstance(assumed, bool):
            raise InputError(self.file, table.at("assumed"), assumed, "true or false")
        return Dimension(
            table.quantity("value", "length"),
            table.optional_quantity("tolerance", "length"),
            assumed,
            table.text("note", ""),
        )

    def optional_dimension(self, key: str) -> Dimension | None:
        return self.dimension(key) if key in self.content else None


def read_chip(path: Path | str) -> Chip:
    """The chip described by a TOML file.

    Raises:
        InputError: the file is missing, is not TOML, or does not describe a chip.
    """
    return parse_chip(read_toml(Path(path)), source=str(path))


def parse_chip(content: Mapping[str, Any], *, source: str) -> Chip:
    """The chip described by the content of a chip file; `source` is the name its mistakes are reported under.

    Raises:
        InputError: the content does not describe a chip.
    """
    root = _Table(content, "", source)
    root.only("chip", "layers", "cavity", "states")
    head = root.table("chip")
    head.only("name", "description", "source", "band")
    layers, electrodes = _read_layers(root)
    cavity = root.table("cavity")
    cavity.only("ports")
    return Chip(
        name=head.text("name"),
        layers=layers,
        band=_read_band(head),
        states=_read_states(root.table("states")),
        electrodes=electrodes,
        ports=_read_ports(cavity.table("ports")) if "ports" in cavity.content else None,
        description=head.text("description", ""),
        source=head.text("source", ""),
        file=source,
    )


def _read_band(head: _Table) -> tuple[float, float]:
    expected = 'two frequencies with their units, for example ["0.91 MHz", "1.155 MHz"]'
    band = head.required("band", expected)
    if not isinstance(band, list) or len(band) != 2:
        raise InputError(head.file, head.at("band"), band, expected)
    low, high = (
        parse_quantity(end, "frequency", source=head.file, field=f"{head.at('band')}[{i}]")
        for i, end in enumerate(band)
    )
    return low, high


def _read_layers(root: _Table) -> tuple[tuple[Layer, ...], Electrodes]:
    entries = root.required("layers", "a list of layers from bottom to top, each under [[layers]]")
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(root.file, "layers", entries, "a list of layers from bottom to top, each under [[layers]]")
    tables = [_Table(entry, f"layers[{i}]", root.file) for i, entry in enumerate(entries)]
    roles = [
        choose(table.required("role", "a role"), ROLES, source=root.file, field=table.at("role")) for table in tables
    ]
    layers: list[Layer] = []
    electrodes = Electrodes()
    for table, region, role in zip(tables, region_names(roles), roles, strict=True):
        keys = ["role", "material", "density", "thickness", "radius", "cavity_radius", "bottom"]
        table.only(*keys, *(["electrodes"] if role == TRANSDUCER else []))
        bottom = table.optional_quantity("bottom", "length")
        layer = Layer(
            region=region,
            role=role,
            material=table.text("material"),
            thickness=table.dimension("thickness"),
            radius=table.dimension("radius"),
            z_bottom=bottom if bottom is not None else layers[-1].z_top if layers else 0.0,
            cavity_radius=table.optional_dimension("cavity_radius"),
            density=table.optional_quantity("density", "density"),
        )
        if role == TRANSDUCER:
            electrodes = _read_electrodes(table.table("electrodes"), layer.outer_radius)
        layers.append(layer)
    return tuple(layers), electrodes


def _read_electrodes(table: _Table, rim: float) -> Electrodes:
    table.only("live", "live_radius", "live_inner_radius", "ground_radius", "ground_inner_radius")
    live = choose(table.text("live", "top"), ("top", "bottom"), source=table.file, field=table.at("live"))

    def disc(name: str) -> ElectrodeDisc:
        radius = table.optional_dimension(f"{name}_radius")
        if radius is not None and radius.value > rim + SAME_LENGTH:
            raise InputError(
                table.file,
                table.at(f"{name}_radius"),
                _mm(radius.value),
                f"at most the transducer's radius, {_mm(rim)}",
            )
        # An electrode as wide as its disc covers the face and follows the disc when its radius is changed.
        whole = radius is None or abs(radius.value - rim) <= SAME_LENGTH
        return ElectrodeDisc(None if whole else radius, table.optional_dimension(f"{name}_inner_radius"))

    return Electrodes("top" if live == "top" else "bottom", disc("live"), disc("ground"))


def _read_ports(table: _Table) -> Ports:
    table.only("diameter", "height", "count")
    count = table.content.get("count", 2)
    if not isinstance(count, int) or isinstance(count, bool):
        raise InputError(table.file, table.at("count"), count, "a whole number from 1 to 8")
    return Ports(table.dimension("diameter"), table.optional_dimension("height"), count)


def _read_states(states: _Table) -> tuple[State, ...]:
    if not states.content:
        return (State("default"),)
    read = []
    for name in states.content:
        table = states.table(name)
        table.only("cavity", "temperature", "materials", "particle", "particle_radius", "reported")
        materials = table.table("materials")
        read.append(
            State(
                name=name,
                cavity=table.optional_text("cavity"),
                temperature=table.optional_quantity("temperature", "temperature"),
                materials={region: materials.text(region) for region in materials.content},
                particle=table.optional_text("particle"),
                particle_radius=table.optional_quantity("particle_radius", "length"),
                reported=_read_reported(table),
            )
        )
    return tuple(read)


def _read_reported(state: _Table) -> tuple[ReportedFigures, ...]:
    entries = state.content.get("reported", [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(state.file, state.at("reported"), entries, "a list of tables with label, f0, z_min and q")
    read = []
    for index, entry in enumerate(entries):
        table = _Table(entry, f"{state.at('reported')}[{index}]", state.file)
        table.only("label", "f0", "z_min", "q")
        figures = ReportedFigures(table.text("label"), table.quantity("f0", "frequency"),
                                  table.quantity("z_min", "resistance"), table.quantity("q", "dimensionless"))
        for key in ("f0", "z_min", "q"):
            if not getattr(figures, key) > 0.0:
                raise InputError(table.file, table.at(key), entry[key], "a value above zero")
        read.append(figures)
    return tuple(read)
