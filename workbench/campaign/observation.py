"""An observation of a state beside its impedance, as a table of a campaign file gives it.

    [states.filled.observations]
    focusing_time = { value = "2.3 s", uncertainty = "10 %", drive = "10 Vpp", frequency = "1.0263 MHz" }
    temperature_rate = { value = "0.16 K/s", uncertainty = "10 %", drive = "10 Vpp @ 50 ohm", frequency = "1.03 MHz" }

``uncertainty`` is the standard one, relative to the value. ``drive`` is as of `workbench simulate`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from geometry.names import CAVITY
from materials.kinds import Fluid
from workbench.files.errors import choose
from workbench.files.tables import FileTable
from workbench.model.drive import Drive, parse_drive
from workbench.model.problem import FilledChip

FOCUSING_TIME, TEMPERATURE_RATE = "focusing_time", "temperature_rate"

#: The dimension of each observable, and its unit.
OBSERVABLES: Mapping[str, tuple[str, str]] = {
    FOCUSING_TIME: ("time", "s"), TEMPERATURE_RATE: ("temperature rate", "K/s")}

#: The keys of an observation, all of them required.
OBSERVATION_KEYS = ("value", "uncertainty", "drive", "frequency")

#: Relative standard uncertainty above which an observation says nothing. Doubled, a factor of e passes for one of it.
VAGUEST = 0.5


@dataclass(frozen=True, eq=False)
class Observation:
    """A value of an observable of the ``kind`` in a ``state``: ``value`` (SI) with its relative standard
    ``uncertainty``, under a ``drive`` at a ``frequency`` (Hz)."""

    kind: str
    state: str
    value: float
    uncertainty: float
    drive: Drive
    frequency: float

    @property
    def name(self) -> str:
        """The state and the observable, in words."""
        return f"{self.state}, {self.kind.replace('_', ' ')}"

    @property
    def unit(self) -> str:
        return OBSERVABLES[self.kind][1]


def read_observations(
    table: FileTable, state: str, device: FilledChip, band: tuple[float, float]
) -> tuple[Observation, ...]:
    """The observations of a state from the table of that state; none where it has no ``observations``.

    Args:
        band: of the state's recording (Hz), outside of which nothing is predicted.

    Raises:
        InputError: an unknown observable, a key that is missing, a value that is not positive, a frequency outside the
            band, or a device that cannot be observed so.
    """
    listed = table.table("observations")
    for kind in listed:
        choose(kind, OBSERVABLES, source=table.source, field=listed.at(kind))
    return tuple(_read(listed.table(kind, expected="a table with " + ", ".join(OBSERVATION_KEYS)), kind, state, device,
                       band) for kind in listed)


def _read(table: FileTable, kind: str, state: str, device: FilledChip, band: tuple[float, float]) -> Observation:
    table.only(OBSERVATION_KEYS)
    for key, example in zip(OBSERVATION_KEYS, (f"1 {OBSERVABLES[kind][1]}", "10 %", "10 Vpp", "1 MHz"), strict=True):
        table.required(key, f'the {key} of the observation, such as "{example}"')
    value, frequency = table.quantity("value", OBSERVABLES[kind][0]), table.quantity("frequency", "frequency")
    uncertainty = table.quantity("uncertainty", "share")
    if not value > 0.0:
        raise table.error("value", "a value above zero")
    if not 0.0 < uncertainty <= VAGUEST:
        raise table.error("uncertainty", f"a relative standard uncertainty above zero and at most {VAGUEST:.0%}")
    if not band[0] <= frequency <= band[1]:
        nearest = band[0] if frequency < band[0] else band[1]
        raise table.error("frequency", f"a frequency in the band of the recording, {band[0] / 1e6:.6g} to "
                          f"{band[1] / 1e6:.6g} MHz, in which the model is right; the nearest is "
                          f'"{nearest / 1e6:.6g} MHz"')
    given = table.content["drive"]
    drive = given if isinstance(given, Drive) else parse_drive(table.text("drive"), source=table.source,
                                                               field=table.at("drive"))
    if kind == FOCUSING_TIME:
        if not isinstance(device.materials.get(CAVITY), Fluid):
            raise table.error("value", "an observation of a state with a liquid in its cavity")
        if device.particle is None:
            raise table.error("value", f"a state that names its particle; {device.chip.file} needs lines such as "
                              f'particle = "polystyrene" and particle_radius = "5 um" in [states.{device.state.name}]')
    else:
        _check_heat(table, device)
    return Observation(kind, state, value, uncertainty, drive, frequency)


def _check_heat(table: FileTable, device: FilledChip) -> None:
    for material in device.materials.values():
        if material.heat_capacity is None:
            raise table.error("value", f"materials with a heat_capacity, which {material.name} does not state: the "
                              "rate is the power over the heat capacity")
