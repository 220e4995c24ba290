"""The tables of a chip file: layers with the electrodes, ports, states, band."""

from __future__ import annotations

from collections.abc import Mapping

from geometry.dimension import SAME_LENGTH, SHAPES, Dimension, millimetres, read_dimension
from geometry.names import ROLES, TRANSDUCER, region_names
from geometry.parts import ElectrodeDisc, Electrodes, Layer, Ports, ReportedFigures, State
from geometry.profile import StepPart, read_profile
from workbench.files.errors import InputError, choose
from workbench.files.tables import Table

_LAYER_KEYS = ("role", "material", "density", "thickness", "radius", "cavity_radius", "bottom", "profile", *SHAPES)


def read_text(table: Table, key: str) -> str:
    """A text that is not blank."""
    text = table.text(key)
    if not text.strip():
        raise table.error(key, "a text")
    return text


def _optional_text(table: Table, key: str) -> str | None:
    return read_text(table, key) if key in table else None


def _quantity(table: Table, key: str, dimension: str) -> float:
    table.required(key, f"a {dimension} with its unit")
    return table.quantity(key, dimension)


def _optional_dimension(table: Table, key: str) -> Dimension | None:
    return read_dimension(table, key) if key in table else None


def read_band(head: Table) -> tuple[float, float]:
    """The two ends (Hz) of the frequencies a chip is meant for."""
    return head.quantities("band", "frequency", numbered=True,
                           expected='two frequencies with their units, for example ["0.91 MHz", "1.155 MHz"]')


def read_layers(root: Table) -> tuple[tuple[Layer, ...], Electrodes]:
    """The layers from bottom to top, each on the one below unless it says where its bottom is, and the electrodes."""
    expected = "a list of layers from bottom to top, each under [[layers]]"
    tables = root.tables("layers", expected=expected)
    if not tables:
        raise root.error("layers", expected)
    roles = [choose(table.required("role", "a role"), ROLES, source=table.source, field=table.at("role"))
             for table in tables]
    layers: list[Layer] = []
    electrodes = Electrodes()
    for table, region, role in zip(tables, region_names(roles), roles, strict=True):
        table.only([*_LAYER_KEYS, "electrodes"] if role == TRANSDUCER else _LAYER_KEYS)
        bottom = table.optional_quantity("bottom", "length")
        profile = read_profile(table.table("profile")) if "profile" in table else None
        measured: dict[str, float] = {}
        if profile is not None and isinstance(profile.source, StepPart):
            from geometry.cad import measured_part  # CadQuery takes seconds to import

            measured = measured_part(profile.source, profile.asymmetry)
        layer = Layer(
            region=region,
            role=role,
            material=read_text(table, "material"),
            thickness=_dimension_or(table, "thickness", measured),
            radius=_dimension_or(table, "radius", measured),
            z_bottom=bottom if bottom is not None else measured["bottom"] if measured else (
                layers[-1].z_top if layers else 0.0),
            cavity_radius=(_dimension_or(table, "cavity_radius", measured)
                           if "cavity_radius" in table or "cavity_radius" in measured else None),
            density=table.optional_quantity("density", "density"),
            profile=profile,
            **{shape: read_dimension(table, shape, kind) for shape, kind in SHAPES.items() if shape in table},
        )
        if role == TRANSDUCER:
            electrodes = _electrodes(table.table("electrodes"), layer.outer_radius)
        layers.append(layer)
    return tuple(layers), electrodes


def _dimension_or(table: Table, key: str, measured: Mapping[str, float]) -> Dimension:
    """A dimension of the file, or of a part that was measured."""
    return read_dimension(table, key) if key in table or key not in measured else Dimension(measured[key])


def _electrodes(table: Table, rim: float) -> Electrodes:
    table.only(("live", "live_radius", "live_inner_radius", "ground_radius", "ground_inner_radius"))
    live = choose(table.text("live", "top"), ("top", "bottom"), source=table.source, field=table.at("live"))
    return Electrodes("top" if live == "top" else "bottom", _disc(table, "live", rim), _disc(table, "ground", rim))


def _disc(table: Table, name: str, rim: float) -> ElectrodeDisc:
    radius = _optional_dimension(table, f"{name}_radius")
    if radius is not None and radius.value > rim + SAME_LENGTH:
        raise InputError(table.source, table.at(f"{name}_radius"), millimetres(radius.value),
                         f"at most the transducer's radius, {millimetres(rim)}")
    # An electrode as wide as its disc covers the face and follows the disc when its radius is changed.
    covers = radius is None or abs(radius.value - rim) <= SAME_LENGTH
    return ElectrodeDisc(None if covers else radius, _optional_dimension(table, f"{name}_inner_radius"))


def read_ports(table: Table) -> Ports:
    """The inlet and the outlet."""
    table.only(("diameter", "height", "count"))
    count = table.whole("count", 2, low=1, high=8)
    return Ports(read_dimension(table, "diameter"), _optional_dimension(table, "height"), count)


def read_states(states: Table) -> tuple[State, ...]:
    """The states in the order of the file; one called ``default`` where it has none."""
    if not states.content:
        return (State("default"),)
    return tuple(_state(name, states.table(name)) for name in states)


def _state(name: str, table: Table) -> State:
    table.only(("cavity", "temperature", "materials", "particle", "particle_radius", "reported"))
    materials = table.table("materials")
    return State(
        name=name,
        cavity=_optional_text(table, "cavity"),
        temperature=table.optional_quantity("temperature", "temperature"),
        materials={region: read_text(materials, region) for region in materials},
        particle=_optional_text(table, "particle"),
        particle_radius=table.optional_quantity("particle_radius", "length"),
        reported=tuple(_reported(row) for row in table.tables(
            "reported", expected="a list of tables with label, f0, z_min and q")),
    )


def _reported(table: Table) -> ReportedFigures:
    table.only(("label", "f0", "z_min", "q"))
    figures = ReportedFigures(read_text(table, "label"), _quantity(table, "f0", "frequency"),
                              _quantity(table, "z_min", "resistance"), _quantity(table, "q", "dimensionless"))
    for key in ("f0", "z_min", "q"):
        if not getattr(figures, key) > 0.0:
            raise table.error(key, "a value above zero")
    return figures
