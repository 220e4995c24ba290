"""The tables of a chip file: layers, electrodes, ports, states, band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

from geometry.checks import naming_layers
from geometry.dimension import SAME_LENGTH, SHAPES, Dimension, millimetres, read_dimension, read_radius
from geometry.limits import CLOSED, FILL_KEYS, NOT_KEYS
from geometry.measure import Measure, Straight
from geometry.names import ROLES, TRANSDUCER, region_names
from geometry.parts import ElectrodeDisc, Electrodes, Layer, Ports, ReportedFigures, State
from geometry.plausible import FILL_KEY, check_length
from geometry.profile import AXES, Profile, StepPart, read_profile, step_profiles
from geometry.straight import MOST_CHANNELS, read_halves, refuse_round_keys
from workbench.files.errors import InputError, choose
from workbench.files.tables import FileTable

_LAYER_KEYS = ("role", "material", "density", "thickness", "radius", "diameter", "cavity_radius", "cavity_diameter",
               "inner_radius", "inner_diameter", "filling", "bottom", "profile", *SHAPES)
_TRANSDUCER_KEYS = ("electrodes", "poled")
_STRAIGHT_LAYER_KEYS = ("role", "material", "density", "thickness", "half_width", "width", "cavity_half_width",
                        "cavity_width", "inner_half_width", "inner_width", "filling", "bottom", "offset",
                        "cavity_offset", "channels", "pitch", "profile", *SHAPES)


def read_text(table: FileTable, key: str) -> str:
    """A text that is not blank."""
    text = table.text(key)
    if not text.strip():
        raise table.error(key, "a text")
    return text


def _optional_text(table: FileTable, key: str) -> str | None:
    return read_text(table, key) if key in table else None


def _quantity(table: FileTable, key: str, dimension: str) -> float:
    table.required(key, f"a {dimension} with its unit")
    return table.quantity(key, dimension)


def _optional_dimension(table: FileTable, key: str) -> Dimension | None:
    return read_dimension(table, key) if key in table else None


def _optional_radius(table: FileTable, key: str, diameter: str) -> Dimension | None:
    return read_radius(table, key, diameter) if key in table or diameter in table else None


def read_band(head: FileTable) -> tuple[float, float]:
    """The two ends (Hz) of the frequencies a chip is meant for."""
    low, high = head.quantities("band", "frequency", numbered=True,
                                expected='two frequencies with their units, for example ["0.91 MHz", "1.155 MHz"]')
    if not 0.0 < low < high:
        raise head.error("band", "two frequencies above zero, the lower one first")
    return low, high


def read_layers(root: FileTable, measure: Measure, *, scripts: bool = True) -> tuple[tuple[Layer, ...], Electrodes]:
    """The layers from bottom to top, and the electrodes. A layer without a stated bottom lies on the one below.
    `scripts` allows layers drawn by a script."""
    expected = "a list of layers from bottom to top, each under [[layers]]"
    tables = root.tables("layers", expected=expected)
    if not tables:
        raise root.error("layers", expected)
    with naming_layers(region_names(str(table.content.get("role", "")) for table in tables)):
        return _read_layers(tables, measure, scripts=scripts)


def _read_layers(
    tables: Sequence[FileTable], measure: Measure, *, scripts: bool
) -> tuple[tuple[Layer, ...], Electrodes]:
    across, doubled = measure.across, measure.doubled
    roles = [choose(table.required("role", "a role"), ROLES, source=table.source, field=table.at("role"))
             for table in tables]
    profiles = []
    for table, role in zip(tables, roles, strict=True):
        if isinstance(measure, Straight):
            refuse_round_keys(table)
            table.only([*_STRAIGHT_LAYER_KEYS, *_TRANSDUCER_KEYS] if role == TRANSDUCER else _STRAIGHT_LAYER_KEYS)
        else:
            _refuse_not_round(table)
            table.only([*_LAYER_KEYS, *_TRANSDUCER_KEYS, "taper"] if role == TRANSDUCER else _LAYER_KEYS)
        for key in ("channels", "pitch"):
            if key in table and not {f"cavity_{across}", f"cavity_{doubled}"} & {*table}:
                raise table.error(key, f"none without the cavity_{doubled} of the channels")
        profiles.append(read_profile(table.table("profile"), measure, scripts=scripts) if "profile" in table else None)
    sections = _measured(step_profiles(profiles))
    layers: list[Layer] = []
    electrodes = Electrodes()
    for table, region, role, profile in zip(tables, region_names(roles), roles, profiles, strict=True):
        bottom = table.optional_quantity("bottom", "length")
        measured = sections.get(profile, {}) if profile is not None else {}
        layer = Layer(
            region=region,
            role=role,
            material=read_text(table, "material"),
            thickness=_dimension_or(table, "thickness", measured),
            radius=_radius_or(table, across, doubled, measured),
            z_bottom=bottom if bottom is not None else measured["bottom"] if measured else (
                layers[-1].z_top if layers else 0.0),
            cavity_radius=(_radius_or(table, f"cavity_{across}", f"cavity_{doubled}", measured)
                           if {f"cavity_{across}", f"cavity_{doubled}"} & {*table, *measured} else None),
            density=table.optional_quantity("density", "density"),
            profile=profile,
            bore=_optional_radius(table, f"inner_{across}", f"inner_{doubled}"),
            filling=_optional_text(table, "filling"),
            poled="down" if _either(table, "poled", "up", "down") == "down" else "up",
            taper=table.quantity("taper", "length", 0.0),
            offset=table.quantity("offset", "length", 0.0),
            cavity_offset=table.quantity("cavity_offset", "length", 0.0),
            channels=table.whole("channels", 1, low=1, high=MOST_CHANNELS),
            pitch=table.quantity("pitch", "length", 0.0),
            live=_further_live(table) if role == TRANSDUCER and region != TRANSDUCER else None,
            **{shape: read_dimension(table, shape, kind) for shape, kind in SHAPES.items() if shape in table},
        )
        if region == TRANSDUCER:
            electrodes = _electrodes(table.table("electrodes"), layer.outer_radius, measure)
        if measured and layers and layer.z_top < layers[-1].z_bottom + SAME_LENGTH and isinstance(
                layers[-1].profile and layers[-1].profile.source, StepPart):
            raise InputError(table.source, table.at("profile"), f"a part that ends at z = {millimetres(layer.z_top)}, "
                             f"below {layers[-1].region!r}, which begins at {millimetres(layers[-1].z_bottom)}",
                             "layers from bottom to top: list them the other way round, or, where the file is upside "
                             "down, turn it over by axis in every profile: "
                             + (f'"{_other_way(profile)}"' if profile else ""))
        layers.append(layer)
    return tuple(layers), electrodes


def _measured(profiles: tuple[Profile, ...]) -> dict[Profile, dict[str, float]]:
    """Measures (m) of parts of STEP files, by profile."""
    if not profiles:
        return {}
    from geometry.cad import section_measures, step_sections  # CadQuery takes seconds to import

    return {profile: section_measures(drawn) for profile, drawn in step_sections(profiles).items()}


def _further_live(table: FileTable) -> Literal["top", "bottom"] | None:
    """The live face of an upper transducer; None if not stated."""
    own = table.table("electrodes").only(("live",))
    return _live(own) if "live" in own else None


def _live(table: FileTable) -> Literal["top", "bottom"]:
    """The live face of a transducer, by default the top."""
    return "top" if _either(table, "live", "top", "bottom") == "top" else "bottom"


def _either(table: FileTable, key: str, one: str, other: str) -> str:
    """One of two words, by default the first."""
    return choose(table.text(key, one), (one, other), source=table.source, field=table.at(key))


def read_well(
    table: FileTable, layers: tuple[Layer, ...], measure: Measure, unusual: Sequence[str] = ()
) -> tuple[tuple[Layer, ...], bool]:
    """The layers of a well, cut at the liquid surface. The flag tells whether the cavity is open.

    Walls above the surface become rings around an empty bore.

    Raises:
        InputError: the fill is outside the cavity, has no usual depth and is not `unusual`, or the cavity is closed.
    """
    is_open = table.flag("open", default="fill" in table)
    if "fill" not in table:
        return layers, is_open
    if not is_open:
        raise table.error("fill", "no fill where open = false: a fill has a free surface")
    holes = [layer for layer in layers if layer.cavity_radius is not None]
    depth = table.quantity("fill", "length")
    if depth > 0.0 and holes:
        check_length(FILL_KEY, depth, source=table.source, field=table.at("fill"), unusual=unusual)
    height = holes[-1].z_top - holes[0].z_bottom if holes else 0.0
    if not 0.0 < depth < height + SAME_LENGTH:
        raise table.error("fill", f"a depth of the liquid above zero and at most the height of the cavity, "
                          f"{millimetres(height)}" if holes else f"no fill: no layer has a cavity_{measure.across}")
    surface, found = holes[0].z_bottom + depth, list[Layer]()
    for layer in layers:
        if layer.cavity_radius is None or layer.z_top < surface + SAME_LENGTH:
            found.append(layer)
            continue
        dry = replace(layer, cavity_radius=None, bore=layer.cavity_radius)
        if layer.z_bottom > surface - SAME_LENGTH:
            found.append(dry)
            continue
        if layer.shapes or layer.profile is not None:
            raise table.error("fill", f"a depth that ends at the top of {layer.region!r}, which is no plain ring")
        wet = surface - layer.z_bottom
        found += [replace(layer, thickness=Dimension(wet)),
                  replace(dry, z_bottom=surface, thickness=Dimension(layer.thickness.value - wet))]
    names = region_names(layer.role for layer in found)
    return tuple(replace(layer, region=name) for layer, name in zip(found, names, strict=True)), is_open


def _other_way(profile: Profile) -> str:
    """The opposite direction of a profile's axis, as written in a file."""
    reverse = tuple(-each + 0.0 for each in profile.placement.axis)
    return next((name for name, axis in AXES.items() if axis == reverse), str(list(reverse)))


def _refuse_not_round(table: FileTable) -> None:
    """Raise for keys of parts that are not round."""
    for key in table:
        if key.casefold() in NOT_KEYS:
            raise InputError(table.source, table.at(key), table.content[key], NOT_KEYS[key.casefold()])


def _dimension_or(table: FileTable, key: str, measured: Mapping[str, float]) -> Dimension:
    """A dimension from the file, or else from a measured part."""
    return read_dimension(table, key) if key in table or key not in measured else Dimension(measured[key])


def _radius_or(table: FileTable, key: str, diameter: str, measured: Mapping[str, float]) -> Dimension:
    """A radius from the file, half a diameter, or a measured part."""
    if key in table or diameter in table or key not in measured:
        return read_radius(table, key, diameter)
    return Dimension(measured[key])


def _electrodes(table: FileTable, outer: float, measure: Measure) -> Electrodes:
    if isinstance(measure, Straight):
        refuse_round_keys(table)
        table.only(("live", "live_half_width", "live_inner_half_width", "ground_half_width", "ground_inner_half_width",
                    "live_width", "live_inner_width", "ground_width", "ground_inner_width", "halves", "wiring"))
    else:
        table.only(("live", "live_radius", "live_inner_radius", "ground_radius", "ground_inner_radius",
                    "live_diameter", "live_inner_diameter", "ground_diameter", "ground_inner_diameter"))
    live = _live(table)
    live_disc, ground_disc = (_disc(table, name, outer, measure) for name in ("live", "ground"))
    return Electrodes(live, live_disc, ground_disc, *read_halves(table))


def _disc(table: FileTable, name: str, outer: float, measure: Measure) -> ElectrodeDisc:
    across, doubled = f"{name}_{measure.across}", f"{name}_{measure.doubled}"
    radius = _optional_radius(table, across, doubled)
    if radius is not None and radius.value > outer + SAME_LENGTH:
        key = across if across in table else doubled
        size = f"{key.removeprefix(name)[1:].replace('_', ' ')}, {millimetres(outer if key == across else 2.0 * outer)}"
        raise InputError(table.source, table.at(key), radius.typed, f"at most the transducer's {size}")
    # An electrode as wide as its disc covers the face and follows the disc's radius.
    covers = radius is None or abs(radius.value - outer) <= SAME_LENGTH
    return ElectrodeDisc(None if covers else radius,
                         _optional_radius(table, f"{name}_inner_{measure.across}", f"{name}_inner_{measure.doubled}"))


def read_ports(table: FileTable) -> Ports:
    """The inlet and the outlet."""
    table.only(("diameter", "height", "count"))
    count = table.whole("count", 2, low=1, high=8)
    return Ports(read_dimension(table, "diameter"), _optional_dimension(table, "height"), count)


def read_states(states: FileTable) -> tuple[State, ...]:
    """The states in file order; by default one, ``default``."""
    if not states.content:
        return (State("default"),)
    return tuple(_state(name, states.table(name)) for name in states)


def _state(name: str, table: FileTable) -> State:
    for key in FILL_KEYS:
        if key in table:
            raise table.error(key, CLOSED)
    table.only(("cavity", "temperature", "materials", "particle", "particle_radius", "particle_diameter", "reported"))
    particle = _optional_radius(table, "particle_radius", "particle_diameter")
    if particle is not None and not particle.value > 0.0:
        key = "particle_radius" if "particle_radius" in table else "particle_diameter"
        raise table.error(key, "a length above zero")
    materials = table.table("materials")
    return State(
        name=name,
        cavity=_optional_text(table, "cavity"),
        temperature=table.optional_quantity("temperature", "temperature"),
        materials={region: read_text(materials, region) for region in materials},
        particle=_optional_text(table, "particle"),
        particle_radius=None if particle is None else particle.value,
        reported=tuple(_reported(row) for row in table.tables(
            "reported", expected="a list of tables with label, f0, z_min and q")),
    )


def _reported(table: FileTable) -> ReportedFigures:
    table.only(("label", "f0", "z_min", "q"))
    figures = ReportedFigures(read_text(table, "label"), _quantity(table, "f0", "frequency"),
                              _quantity(table, "z_min", "resistance"), _quantity(table, "q", "dimensionless"))
    for key in ("f0", "z_min", "q"):
        if not getattr(figures, key) > 0.0:
            raise table.error(key, "a value above zero")
    return figures
