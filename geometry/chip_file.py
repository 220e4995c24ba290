"""Writing of chip files, which `geometry.chip.read_chip` reads back to an equal chip."""

from __future__ import annotations

import math
import os
from pathlib import Path

from geometry.chip import Chip
from geometry.dimension import SHAPES, Dimension
from geometry.features import feature_keys
from geometry.measure import Straight
from geometry.names import TRANSDUCER
from geometry.parts import Electrodes, Layer, Ports, ReportedFigures, State, discs
from geometry.profile import ASYMMETRY, AXES, Corner, Outline, Placement, Profile, Size, StepPart
from geometry.scripts import Script, lies_below, script_bytes
from geometry.straight import head_keys
from workbench.files.errors import InputError
from workbench.files.quantities import format_quantity
from workbench.files.toml import TomlEntry, toml_heading, toml_table
from workbench.files.writing import write_atomic


def write_chip(chip: Chip, path: Path | str) -> Path:
    """Write `chip` to `path` as a chip file, atomically.

    Comments of an earlier file are lost. A script outside the folder is copied beside the file, under a name with its
    digest.

    Raises:
        InputError: a script has changed since the chip was read, or another file has the name of its copy.
        OSError: the file cannot be written.
    """
    path = Path(path)
    for layer in chip.layers:
        if layer.profile is not None and isinstance(layer.profile.source, Script):
            _copy(layer.profile.source, path.parent)
    write_atomic(path, chip_text(chip, path.parent))
    return path


def chip_text(chip: Chip, folder: Path = Path()) -> str:
    """The text of a chip file in `folder`. Numbers keep all digits."""
    head: dict[str, TomlEntry] = {"name": chip.name}
    head |= {key: text for key, text in (("description", chip.description), ("source", chip.source)) if text}
    head["band"] = [format_quantity(end, "frequency", ("MHz", "kHz", "Hz")) for end in chip.band]
    head |= head_keys(chip.measure)
    if isinstance(chip.measure, Straight) and "length" not in chip.measure.assumed:
        head["length"] = _length(chip.measure.length)
    head |= {"unusual": list(chip.unusual)} if chip.unusual else {}
    if chip.operating_point is not None:
        head["operating_point"] = chip.operating_point if isinstance(chip.operating_point, str) else format_quantity(
            chip.operating_point, "frequency", ("MHz", "kHz", "Hz"))
    parts = [toml_table("[chip]", head)]
    for layer, below in zip(chip.layers, (None, *chip.layers), strict=False):
        # A bottom is written only if the layer does not start exactly at the end of the one below.
        resting = (0.0 if below is None else below.z_top) == layer.z_bottom
        parts.append(toml_table("[[layers]]", _layer(layer, chip, folder, with_bottom=not resting)))
    cavity: dict[str, TomlEntry] = {"open": True} if chip.is_open else {}
    if chip.ports is not None:
        cavity["ports"] = _ports(chip.ports)
    if cavity:
        parts.append(toml_table("[cavity]", cavity))
    parts += [toml_table("[[features]]", feature_keys(feature)) for feature in chip.features]
    parts += [toml_table(toml_heading("states", state.name), _state(state)) for state in chip.states]
    return "\n".join(parts)


def _length(value: float) -> str:
    # Micrometres for films and gels, millimetres otherwise.
    return format_quantity(value, "length", ("um", "mm", "m") if abs(value) < 1e-4 else ("mm", "um", "m"))


def _angle(value: float) -> str:
    return format_quantity(value, "angle", ("deg", "rad"))


def _dimension(dimension: Dimension, kind: str = "length") -> TomlEntry:
    written = _angle if kind == "angle" else _length
    table: dict[str, TomlEntry] = {"value": written(dimension.value)}
    if dimension.tolerance is not None:
        table["tolerance"] = written(dimension.tolerance)
    if dimension.assumed:
        table["assumed"] = True
    if dimension.note:
        table["note"] = dimension.note
    return table if len(table) > 1 else table["value"]


def _layer(layer: Layer, chip: Chip, folder: Path, *, with_bottom: bool) -> dict[str, TomlEntry]:
    found: dict[str, TomlEntry] = {"role": layer.role, "material": layer.material}
    if layer.density is not None:
        found["density"] = format_quantity(layer.density, "density", ("kg/m^3",))
    found |= {"thickness": _dimension(layer.thickness), chip.measure.across: _dimension(layer.radius)}
    if layer.cavity_radius is not None:
        found[f"cavity_{chip.measure.across}"] = _dimension(layer.cavity_radius)
    if layer.bore is not None:
        found[f"inner_{chip.measure.across}"] = _dimension(layer.bore)
    if layer.filling is not None:
        found["filling"] = layer.filling
    found |= {shape: _dimension(size, SHAPES[shape]) for shape, size in layer.shapes.items()}
    if with_bottom:
        found["bottom"] = _length(layer.z_bottom)
    if layer.profile is not None:
        found["profile"] = _profile(layer.profile, folder)
    found |= {key: _length(size) for key, size in (
        ("taper", layer.taper), ("offset", layer.offset), ("cavity_offset", layer.cavity_offset),
        ("pitch", layer.pitch)) if size}
    found |= {"channels": layer.channels} if layer.channels != 1 else {}
    if layer.poled != "up":
        found["poled"] = layer.poled
    if layer.region == TRANSDUCER:
        found["electrodes"] = _electrodes(chip.electrodes, chip.measure.across)
    elif layer.live is not None:
        found["electrodes"] = {"live": layer.live}
    return found


def _profile(profile: Profile, folder: Path) -> TomlEntry:
    found: dict[str, TomlEntry] = {}
    match profile.source:
        case Outline(corners):
            found["points"] = [_corner(corner) for corner in corners]
        case Script() as script:
            found |= {"script": _script(script, folder), "function": script.function}
        case StepPart(path, part, scale):
            found |= {"step": _beside(path, folder), "part": part}
            found |= {"scale": _length(scale)} if scale != 1e-3 else {}
    if profile.parameters:
        found["parameters"] = {name: _dimension(size, "angle" if name in profile.angles else "length")
                               for name, size in profile.parameters}
    found |= placement_keys(profile.placement)
    return found | ({"asymmetry": profile.asymmetry} if profile.asymmetry != ASYMMETRY else {})


def placement_keys(placement: Placement) -> dict[str, TomlEntry]:
    """The keys that place a profile's solid, without those at their default."""
    found: dict[str, TomlEntry] = {}
    if placement.axis != AXES["z"]:
        named = next((name for name, axis in AXES.items() if axis == placement.axis), None)
        found["axis"] = named or [*placement.axis]
    if any(placement.origin):
        found["origin"] = [_length(each) for each in placement.origin]
    if placement.sector != 2.0 * math.pi:
        found["sector"] = _angle(placement.sector)
    return found


def _script(script: Script, folder: Path) -> str:
    """The path of a script in a chip file in `folder`. A script outside the folder is referred to by its copy beside
    the file."""
    if lies_below(script.path, folder):
        return _beside(script.path, folder)
    digest = f"-{script.content[:12]}"
    return f"{script.path.stem.removesuffix(digest)}{digest}{script.path.suffix}"


def _copy(script: Script, folder: Path) -> None:
    """Copy a script to the place of :func:`_script`, unless it is there."""
    there = folder / _script(script, folder)
    if lies_below(script.path, folder):
        return
    data = script_bytes(script)
    if there.exists() and there.read_bytes() != data:
        raise InputError(str(there), "script", there.name, "a copy of the script, or no file; move it away")
    if not there.exists():
        write_atomic(there, data)


def _beside(path: Path, folder: Path) -> str:
    """A path relative to `folder`."""
    return Path(os.path.relpath(path, folder)).as_posix()


def _corner(corner: Corner) -> TomlEntry:
    def size(value: Size) -> TomlEntry:
        return value if isinstance(value, str) else _length(value)

    def point(values: tuple[Size, Size]) -> TomlEntry:
        return [size(each) for each in values]

    found: dict[str, TomlEntry] = {"at": point(corner.at)}
    if corner.fillet is not None:
        found["fillet"] = size(corner.fillet)
    if corner.through:
        found["through"] = [point(each) for each in corner.through]
    if corner.arc is not None:
        found["arc"] = point(corner.arc)
    return found if len(found) > 1 else found["at"]


def _electrodes(electrodes: Electrodes, across: str) -> TomlEntry:
    found: dict[str, TomlEntry] = {"live": electrodes.live}
    for prefix, (_, disc) in zip(("live", "ground"), discs(electrodes), strict=True):
        for key, dimension in ((f"{prefix}_{across}", disc.radius), (f"{prefix}_inner_{across}", disc.inner_radius)):
            if dimension is not None:
                found[key] = _dimension(dimension)
    found |= {"halves": list(electrodes.halves)} if electrodes.halves is not None else {}
    return found | ({"wiring": electrodes.wiring} if electrodes.wiring is not None else {})


def _ports(ports: Ports) -> TomlEntry:
    height: dict[str, TomlEntry] = {} if ports.height is None else {"height": _dimension(ports.height)}
    return {"diameter": _dimension(ports.diameter), **height, "count": ports.count}


def _state(state: State) -> dict[str, TomlEntry]:
    found: dict[str, TomlEntry] = {}
    if state.cavity is not None:
        found["cavity"] = state.cavity
    if state.temperature is not None:
        found["temperature"] = format_quantity(state.temperature, "temperature", ("degC", "K"))
    if state.materials:
        found["materials"] = dict(state.materials)
    if state.particle is not None:
        found["particle"] = state.particle
    if state.particle_radius is not None:
        found["particle_radius"] = _length(state.particle_radius)
    if state.reported:
        found["reported"] = [_reported(each) for each in state.reported]
    return found


def _reported(figures: ReportedFigures) -> TomlEntry:
    return {"label": figures.label, "f0": format_quantity(figures.f0, "frequency", ("MHz", "kHz", "Hz")),
            "z_min": format_quantity(figures.z_min, "resistance", ("ohm",)), "q": figures.q}
