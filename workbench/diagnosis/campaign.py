"""A campaign: one device in several states, each with its recording, and what is known about the device.

    [states.empty]
    chip = "chip.toml"              # path relative to the campaign's file
    state = "empty"                 # of that chip; may be left out where there is one only
    recording = "empty.csv"
    drive = "1 Vpp"                 # at the electrodes
    temperature = "25 degC"         # of what fills the cavity
    band = ["0.95 MHz", "1.05 MHz"] # of the recording, where not all of the chip's band
    noise = "0.5 %"                 # of a point, where the recording brings no uncertainty
    held_out = true                 # never fitted, only predicted
    columns = "MAP.toml"            # of the recording, where its headings do not say what they are

    [known]                         # standard uncertainties: what is named here is free, nothing else is
    "pla/acevedo_2026.shear_modulus" = "3 %"
    "couplant.thickness" = "5 um"
    "bench.series_resistance" = "0.05 ohm"

    [fixed]
    names = ["transducer.density"]  # what no hypothesis may move

One device: what has one name is one number in all states.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from geometry.chip import Chip, read_chip
from geometry.names import CAVITY, TRANSDUCER
from geometry.stretch import tied
from materials.kinds import Fluid, Material
from materials.registry import Registry, user_registry
from workbench.files.errors import InputError, nearest_names
from workbench.files.quantities import parse_quantity
from workbench.files.tables import Table
from workbench.fitting.parameter import BENCH_ELEMENTS, UNITS
from workbench.fitting.prepare import check_device, in_band
from workbench.parameter_names import BENCH, Kind, ParameterName
from workbench.problem import FilledChip, fill
from workbench.readers import read_column_map, read_recording
from workbench.spectrum import Spectrum

STATE_KEYS = ("chip", "state", "recording", "drive", "temperature", "band", "noise", "held_out", "columns")

#: Which units an uncertainty may be written in, by the SI unit of what it is of.
DIMENSIONS: Mapping[str, str] = {
    "Pa": "pressure", "C/m^2": "piezoelectric", "1": "dimensionless", "kg/m^3": "density", "m/s": "speed",
    "m": "length", "ohm": "resistance", "H": "inductance", "F": "capacitance", "s": "time", "rad": "angle",
    "m^2/s": "diffusivity",
}


@dataclass(frozen=True, eq=False)
class DeviceState:
    """One state of the device and its recording.

    ``device`` is the chip in its state, with its materials; ``drive`` the voltage amplitude (V, zero to peak) at the
    electrodes, ``temperature`` in kelvin, both None where nobody said; ``noise`` (n,) the standard deviation of every
    point relative to |Z|, and ``stated`` whether the recording or the campaign states it (otherwise its own scatter
    does).
    """

    name: str
    device: FilledChip
    measured: Spectrum
    noise: np.ndarray[Any, np.dtype[np.float64]]
    stated: bool
    drive: float | None = None
    temperature: float | None = None
    held_out: bool = False

    @property
    def chip(self) -> Chip:
        return self.device.chip

    @property
    def materials(self) -> Mapping[str, Material]:
        """What fills each region."""
        return self.device.materials

    @property
    def fluid(self) -> Fluid | None:
        """What fills the cavity, if it is a fluid."""
        found = self.materials.get(CAVITY)
        return found if isinstance(found, Fluid) else None


@dataclass(frozen=True, eq=False)
class Campaign:
    """A device, its states, and what is known of it.

    ``known`` maps parameter names (see `workbench.fitting.parameter`) to standard uncertainties in SI; ``fixed`` names
    what may not move. Radii that coincide in a chip are one parameter, under the first of their names.
    """

    name: str
    file: str
    states: tuple[DeviceState, ...]
    known: Mapping[str, float]
    fixed: tuple[str, ...]
    registry: Registry

    @cached_property
    def tied(self) -> Mapping[str, tuple[str, ...]]:
        """The other names of every radius that stands for several."""
        first = tied(*(state.chip for state in self.states))
        found: dict[str, tuple[str, ...]] = {}
        for name, chosen in first.items():
            if name != chosen:
                found[chosen] = (*found.get(chosen, ()), name)
        return found

    @property
    def fitted(self) -> tuple[DeviceState, ...]:
        return tuple(state for state in self.states if not state.held_out)

    @property
    def held_out(self) -> tuple[DeviceState, ...]:
        return tuple(state for state in self.states if state.held_out)


def read_campaign(path: Path | str, *, materials: Sequence[Path] = ()) -> Campaign:
    """Read and check a campaign file, its chips and its recordings; `materials` are further folders of materials.

    Raises:
        InputError: a mistake in one of the files, a recording that cannot be of this device, a name that no state has,
            or two statements about one thing that contradict each other.
    """
    path = Path(path)
    table = Table.read(path).only(("campaign", "states", "known", "fixed"))
    source = table.source
    head = table.table("campaign", expected="a table [campaign]").only(("name", "materials"))
    folders = list(materials)
    if "materials" in head:
        said = str(head.content["materials"])
        folder = path.parent / said
        if not folder.is_dir():
            raise InputError(source, head.at("materials"), said, "a folder of materials beside the campaign's file")
        folders.append(folder)
    registry = user_registry(folders)
    listed = table.table("states", expected="a table [states]")
    if not listed.content:
        raise table.error("states", "a table [states]")
    states = tuple(_state(name, listed.table(name, expected=f"a table [states.{name}]"), path.parent, registry)
                   for name in listed)
    if not any(not state.held_out for state in states):
        raise InputError(source, "states", ", ".join(s.name for s in states) or "none",
                         "at least one state with a recording that is not held out")
    _check_one_device(states, source)
    known = _known(table.table("known", expected="a table [known]").content, states, source)
    fixed = tuple(_fixed(table.table("fixed", expected="a table [fixed]"), known, states))
    return Campaign(str(head.content.get("name", path.stem)), source, states, known, fixed, registry)


def _state(name: str, table: Table, folder: Path, registry: Registry) -> DeviceState:
    table.only(STATE_KEYS)
    chip = read_chip(_path(table, "chip", folder))
    if "state" in table:
        state = chip.state(table.text("state", expected="a state, as text"))
    elif len(chip.states) == 1:
        state = chip.states[0]
    else:
        raise InputError(table.source, table.at("state"), "nothing", "one of the chip's states: "
                         + ", ".join(s.name for s in chip.states))
    held_out = table.flag("held_out")
    temperature = table.optional_quantity("temperature", "temperature")
    if temperature is not None and state.cavity is not None:
        if state.temperature is not None and abs(state.temperature - temperature) > 0.5:
            raise table.error("temperature", f"the {state.temperature - 273.15:.1f} degC that {chip.file} gives its "
                              f"state {state.name!r}, or none there")
        state = replace(state, temperature=temperature)
        chip = replace(chip, states=tuple(state if s.name == state.name else s for s in chip.states))
    device = fill(chip, state.name, registry)
    recording = _path(table, "recording", folder)
    band = _band(table) if "band" in table else None
    columns = read_column_map(_path(table, "columns", folder)) if "columns" in table else None
    whole = read_recording(recording, columns=columns).spectrum
    measured = in_band(whole, chip, band, name=str(recording))
    noise, stated = _noise(measured, table)
    drive = table.optional_quantity("drive", "peak-to-peak voltage")
    if drive is not None and not drive > 0.0:
        raise table.error("drive", "a voltage above zero")
    found = DeviceState(name, device, measured, noise, stated,
                        None if drive is None else 0.5 * drive, temperature, held_out)
    if set(device.materials) == {TRANSDUCER}:
        # Loads shift resonances by more than this check allows for.
        check_device(in_band(whole, chip, None, name=str(recording)), chip, device.materials, name=str(recording))
    return found


def _path(table: Table, key: str, folder: Path) -> Path:
    return folder / table.text(key, expected=f"a {key}, as text")


def _band(table: Table) -> tuple[float, float]:
    low, high = table.quantities("band", "frequency", expected="two frequencies")
    if not low < high:
        raise table.error("band", "a lower and a higher frequency")
    return low, high


def _noise(measured: Spectrum, table: Table) -> tuple[np.ndarray[Any, np.dtype[np.float64]], bool]:
    """Relative standard deviation of every point, and whether anybody stated it."""
    stated = table.optional_quantity("noise", "dimensionless")
    if stated is not None and not stated > 0.0:
        raise InputError(table.source, table.at("noise"), stated, "a relative deviation above zero")
    if measured.uncertainty is not None:
        if stated is not None:
            raise InputError(table.source, table.at("noise"), stated,
                             "nothing: the recording brings its own uncertainties")
        return np.asarray(measured.uncertainty / measured.magnitude), True
    if stated is not None:
        return np.full(measured.frequency.size, stated), True
    return np.full(measured.frequency.size, scatter(measured)), False


def scatter(measured: Spectrum) -> float:
    """Relative standard deviation of a point from what a smooth curve leaves: third differences of ln Z.

    For white noise of that deviation in the real and in the imaginary part their variance is 20 times its square; the
    median keeps out sharp resonances.
    """
    third = np.diff(np.log(measured.impedance), 3)
    # The median of |x| of normal x is 0.6745 sigma.
    size = np.median(np.abs(np.concatenate([third.real, third.imag]))) / 0.6745
    return float(max(size / np.sqrt(20.0), 1e-6))


def _check_one_device(states: Sequence[DeviceState], source: str) -> None:
    """All states must agree on what they share: one name, one length."""
    for name, first, other in _pairs(states):
        a, b = first.chip.dimensions()[name].value, other.chip.dimensions()[name].value
        if abs(a - b) > 1e-9:
            raise InputError(source, f"states.{other.name}.chip", f"{name} of {1e3 * b:.6g} mm",
                             f"the {1e3 * a:.6g} mm of state {first.name!r}: the states are those of one device")
    transducers = {s.materials[TRANSDUCER].name for s in states}
    if len(transducers) > 1:
        raise InputError(source, "states", ", ".join(sorted(transducers)), "one transducer material: the states are "
                         "those of one device")


def _pairs(states: Sequence[DeviceState]) -> Iterator[tuple[str, DeviceState, DeviceState]]:
    first: dict[str, DeviceState] = {}
    for state in states:
        for name in state.chip.dimensions():
            # The gel below a sample and that below a chip are two layers, whatever they are called.
            if ParameterName.parse(name).owner == TRANSDUCER or _same_stack(first.get(name, state), state):
                if name in first:
                    yield name, first[name], state
                first.setdefault(name, state)


def _same_stack(one: DeviceState, other: DeviceState) -> bool:
    return [x.region for x in one.chip.layers] == [x.region for x in other.chip.layers]


def unit_of(name: str, states: Sequence[DeviceState]) -> str:
    """SI unit of a parameter; empty if there is no such parameter."""
    parsed = ParameterName.parse(name)
    if parsed.kind is Kind.BENCH:
        element = BENCH_ELEMENTS.get(parsed.coefficient)
        return "" if element is None else element.unit
    if parsed.kind is Kind.DIMENSION:
        return "m" if any(name in s.chip.dimensions() for s in states) else ""
    materials = [m for s in states for m in s.materials.values()]
    if any(m.name == parsed.owner and parsed.coefficient in m.parameters() for m in materials):
        return UNITS.get(parsed.coefficient, "1")
    return ""


def value_of(name: str, states: Sequence[DeviceState]) -> float:
    """The value that the chip files and materials give a parameter, SI; zero for a bench element."""
    parsed = ParameterName.parse(name)
    for state in states:
        known = state.chip.dimensions()
        if name in known:
            return known[name].value
        for found in state.materials.values():
            if found.name == parsed.owner:
                return parsed.part_of(found.parameters()[parsed.coefficient])
    return 0.0


def _known(table: Mapping[str, Any], states: Sequence[DeviceState], source: str) -> dict[str, float]:
    result: dict[str, float] = {}
    stated: dict[str, str] = {}
    first = tied(*(state.chip for state in states))
    for written, entry in table.items():
        field = f"known.{written}"
        own = _full_name(written, states)
        name = first.get(own, own)
        unit, kind = unit_of(name, states), ParameterName.parse(name).kind
        if not unit:
            raise InputError(source, field, written, "the name of a material's coefficient, a dimension of a chip or a "
                             "bench element that a state has", nearest_names(written, names(states)))
        if name in result and own not in first:
            raise InputError(source, field, written, f"each parameter once ({name})")
        before = result.get(name)
        if isinstance(entry, str) and entry.strip().endswith("%"):
            share = parse_quantity(entry, "dimensionless", source=source, field=field)
            size = abs(value_of(name, states))
            if size == 0.0 and kind is Kind.BENCH:
                size = 1.0 if unit in ("1", "rad") else 0.0
            if size == 0.0:
                raise InputError(source, field, entry, f"an uncertainty in {unit}: {name} is zero, so a percentage of "
                                 "it says nothing")
            result[name] = share * size
        else:
            result[name] = parse_quantity(entry, DIMENSIONS[unit], source=source, field=field)
        if before is not None and abs(result[name] - before) > 1e-9 * before:
            raise InputError(source, field, entry, f"the uncertainty that known.{stated[name]} has: the two radii "
                             f"coincide, so they are one parameter")
        stated[name] = written
        if not result[name] > 0.0:
            raise InputError(source, field, entry, "a standard uncertainty above zero; what is exact is left out")
        if kind is Kind.DIMENSION:
            for state in states:
                for each, length in state.chip.dimensions().items():
                    if first.get(each, each) == name and length.tolerance == 0.0:
                        raise InputError(source, field, entry, f"nothing: {state.chip.file} states {each} as exact "
                                         "(a tolerance of 0)")
    return result


def _full_name(written: str, states: Sequence[DeviceState]) -> str:
    """The name with the material's full name, ``water.sound_speed`` for ``water/iapws_2011.sound_speed``."""
    parsed = ParameterName.parse(written)
    full = {m.name for s in states for m in s.materials.values() if m.name.split("/")[0] == parsed.owner}
    return f"{full.pop()}.{parsed.local}" if len(full) == 1 and "/" not in parsed.owner else written


def names(states: Sequence[DeviceState]) -> tuple[str, ...]:
    """Every name that a parameter of the device may have."""
    found = [*(BENCH + key for key in BENCH_ELEMENTS)]
    for state in states:
        found += state.chip.dimensions()
        for material in state.materials.values():
            found += [f"{material.name}.{key}" for key in material.parameters()]
    return tuple(dict.fromkeys(found))


def _fixed(table: Table, known: Mapping[str, float], states: Sequence[DeviceState]) -> Iterator[str]:
    source = table.source
    for written in table.only(("names",)).texts("names", (), expected="a list of names"):
        parsed = ParameterName.parse(written)
        material = next((s.materials[parsed.owner].name for s in states if parsed.owner in s.materials), None)
        name = _full_name(written, states)
        name = tied(*(state.chip for state in states)).get(name, name)
        if parsed.local == "density" and material is not None:
            name = f"{material}.density"
        if not unit_of(name, states):
            raise InputError(source, "fixed.names", written, "the name of a parameter that a state has",
                             nearest_names(written, names(states)))
        if name in known:
            raise InputError(source, "fixed.names", written, f"a name that [known] does not free with an uncertainty "
                             f"of {known[name]:g}: it either may move or may not")
        yield name
