"""An observation of a state beside its impedance, from a campaign file.

    [states.filled.observations]
    focusing_time = { value = "2.3 s", uncertainty = "10 %", drive = "10 Vpp", frequency = "1.0263 MHz" }
    temperature_rate = { value = "0.16 K/s", uncertainty = "10 %", drive = "10 Vpp @ 50 ohm", frequency = "1.03 MHz" }
    temperature_rise = { value = "4 K", uncertainty = "20 %", drive = "10 Vpp", frequency = "1.03 MHz" }
    ring_radii = { value = ["1.6 mm", "3.1 mm"], uncertainty = "3 %", frequency = "1.03 MHz" }

``uncertainty`` is the standard uncertainty relative to the value. ``drive`` is as for `workbench simulate`; rings have
none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from geometry.chip_section import outer_boundaries
from geometry.names import CAVITY
from materials.kinds import Fluid
from workbench.acoustics.heat import STILL_AIR
from workbench.files.errors import choose
from workbench.files.quantities import parse_quantity
from workbench.files.tables import FileTable
from workbench.model.drive import Drive, VoltageDrive, parse_drive
from workbench.model.problem import FilledChip

FOCUSING_TIME, TEMPERATURE_RATE, TEMPERATURE_RISE, RING_RADII = (
    "focusing_time", "temperature_rate", "temperature_rise", "ring_radii")

#: The dimension of each observable, and its unit.
OBSERVABLES: Mapping[str, tuple[str, str]] = {
    FOCUSING_TIME: ("time", "s"), TEMPERATURE_RATE: ("temperature rate", "K/s"),
    TEMPERATURE_RISE: ("temperature difference", "K"), RING_RADII: ("length", "m")}

#: Observables of a particle in a liquid.
OF_PARTICLE = (FOCUSING_TIME, RING_RADII)

#: Required keys of every observation, except that rings need no drive, since their radii do not depend on it; and the
#: optional keys of a temperature rise.
OBSERVATION_KEYS = ("value", "uncertainty", "drive", "frequency")
OF_RISE = ("part", "convection", "holder")

#: Relative standard uncertainty above which an observation has no information. Doubled, a factor of e is one sigma.
VAGUEST = 0.5


@dataclass(frozen=True)
class Cooling:
    """The part whose mean temperature rises, and its heat loss. ``convection`` is in W/(m^2 K). The boundary
    ``holder``, if any, is at ambient temperature."""

    part: str
    convection: float = STILL_AIR
    holder: str | None = None


@dataclass(frozen=True, eq=False)
class Observation:
    """An observed ``value`` (SI) of the ``kind`` in a ``state``.

    ``uncertainty`` is its relative standard uncertainty, ``frequency`` is in Hz. ``number`` counts several of one kind
    from 1; 0 is the only one. ``cooling`` is for a temperature rise.
    """

    kind: str
    state: str
    value: float
    uncertainty: float
    drive: Drive
    frequency: float
    number: int = 0
    cooling: Cooling | None = None

    @property
    def name(self) -> str:
        """The state and the observable, in words."""
        words = f"ring {self.number}" if self.kind == RING_RADII else self.kind.replace("_", " ")
        return f"{self.state}, {words}"

    @property
    def unit(self) -> str:
        return OBSERVABLES[self.kind][1]


def read_observations(
    table: FileTable, state: str, device: FilledChip, band: tuple[float, float]
) -> tuple[Observation, ...]:
    """The observations in the table of a state, () by default.

    Args:
        band: of the state's recording (Hz); predictions are limited to it.

    Raises:
        InputError: an unknown observable, a missing key, a value that is not positive, a frequency outside the band, or
            a device without this observable.
    """
    listed = table.table("observations")
    for kind in listed:
        choose(kind, OBSERVABLES, source=table.source, field=listed.at(kind))
    expected = "a table with " + ", ".join(OBSERVATION_KEYS)
    return tuple(each for kind in listed
                 for each in _read(listed.table(kind, expected=expected), kind, state, device, band))


def _read(
    table: FileTable, kind: str, state: str, device: FilledChip, band: tuple[float, float]
) -> list[Observation]:
    table.only((*OBSERVATION_KEYS, *(OF_RISE if kind == TEMPERATURE_RISE else ())))
    example = f"1 {OBSERVABLES[kind][1]}"
    for key, text in zip(OBSERVATION_KEYS, (example, "10 %", "10 Vpp", "1 MHz"), strict=True):
        if (kind, key) != (RING_RADII, "drive"):
            table.required(key, f'the {key} of the observation, such as "{text}"')
    values, frequency = _values(table, kind), table.quantity("frequency", "frequency")
    uncertainty = table.quantity("uncertainty", "share")
    if not min(values) > 0.0:
        raise table.error("value", "a value above zero")
    if not 0.0 < uncertainty <= VAGUEST:
        raise table.error("uncertainty", f"a relative standard uncertainty above zero and at most {VAGUEST:.0%}")
    if not band[0] <= frequency <= band[1]:
        nearest = band[0] if frequency < band[0] else band[1]
        raise table.error("frequency", f"a frequency in the band of the recording, {band[0] / 1e6:.6g} to "
                          f"{band[1] / 1e6:.6g} MHz, in which the model is right; the nearest is "
                          f'"{nearest / 1e6:.6g} MHz"')
    given = table.content.get("drive", VoltageDrive())
    drive = given if isinstance(given, Drive) else parse_drive(table.text("drive"), source=table.source,
                                                               field=table.at("drive"))
    if kind in OF_PARTICLE:
        _check_particle(table, kind, values, device)
    else:
        _check_heat(table, kind, device)
    cooling = _cooling(table, device) if kind == TEMPERATURE_RISE else None
    return [Observation(kind, state, value, uncertainty, drive, frequency, number if kind == RING_RADII else 0, cooling)
            for number, value in enumerate(values, 1)]


def _values(table: FileTable, kind: str) -> list[float]:
    dimension = OBSERVABLES[kind][0]
    if kind != RING_RADII:
        return [table.quantity("value", dimension)]
    expected = 'the radii of one ring or more, such as ["1.6 mm", "3.1 mm"]'
    entries = table.entries("value", expected=expected)
    found = [parse_quantity(each, dimension, source=table.source, field=f"{table.at('value')}[{i}]")
             for i, each in enumerate(entries)]
    if not found or len(set(found)) < len(found):
        raise table.error("value", expected + ", each once")
    return found


def _cooling(table: FileTable, device: FilledChip) -> Cooling:
    regions = [*device.materials]
    part = table.choice("part", regions, CAVITY if CAVITY in regions else None)
    holder = table.choice("holder", outer_boundaries(device.chip)) if "holder" in table else None
    convection = table.quantity("convection", "heat transfer coefficient", STILL_AIR)
    if not convection >= 0.0 or (convection == 0.0 and holder is None):
        raise table.error("convection", "a heat transfer coefficient above zero, or a holder that takes the heat")
    return Cooling(part, convection, holder)


def _check_particle(table: FileTable, kind: str, values: list[float], device: FilledChip) -> None:
    if not isinstance(device.materials.get(CAVITY), Fluid):
        raise table.error("value", "an observation of a state with a liquid in its cavity")
    if device.particle is None:
        raise table.error("value", f"a state that names its particle; {device.chip.file} needs lines such as "
                          f'particle = "polystyrene" and particle_radius = "5 um" in [states.{device.state.name}]')
    widest = max(hole.inner_radius for hole in device.chip.holes)
    if kind == RING_RADII and not max(values) < widest:
        raise table.error("value", f"radii below that of the cavity, {1e3 * widest:.6g} mm")


def _check_heat(table: FileTable, kind: str, device: FilledChip) -> None:
    for material in device.materials.values():
        if material.heat_capacity is None:
            raise table.error("value", f"materials with a heat_capacity, which {material.name} does not state: the "
                              "rate is the power over the heat capacity")
        if kind == TEMPERATURE_RISE and material.thermal_conductivity is None:
            raise table.error("value", f"materials with a thermal_conductivity, which {material.name} does not state")
