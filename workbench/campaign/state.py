"""A state of a device and its recording, from a campaign file."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip, read_chip
from geometry.names import CAVITY, TRANSDUCER
from geometry.straight import check_stated_length
from materials.kinds import Fluid, Material
from materials.registry import Registry
from workbench.campaign.observation import Observation, read_observations
from workbench.files.errors import InputError
from workbench.files.quantities import ProgramSource
from workbench.files.tables import FileTable
from workbench.fitting.measurement_model import rms
from workbench.fitting.noise import correlation_length
from workbench.fitting.prepare import check_device, in_band
from workbench.model.device_numbers import bench_number, device_numbers
from workbench.model.numbers import BENCH_ELEMENTS, Number
from workbench.model.problem import FilledChip, fill
from workbench.readers import Reading, read_column_map, read_recording
from workbench.results.observed_value import ObservedValue
from workbench.results.spectrum import Origin, Spectrum, scatter, spectrum_of

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Keys of a state in a campaign file. `workbench.campaign.knowledge` reads ``known``.
STATE_KEYS = ("chip", "state", "recording", "drive", "temperature", "band", "noise", "held_out", "columns",
              "without_outliers", "known", "observations")

#: Relative standard deviation of a point above which a recording has no information, so the value is a mistake.
#: Doubled, "0.4" without its percent sign is accepted as 40 %.
NOISIEST = 0.2


@dataclass(frozen=True, eq=False)
class DeviceState:
    """One state of the device and its recording.

    ``device`` is the chip in its state, with its materials. ``drive`` is the voltage amplitude (V, zero to peak) at the
    electrodes and ``temperature`` is in kelvin; both are None if not stated. ``noise`` (n,) is the standard deviation
    of every point relative to |Z|; ``stated`` is False if it was estimated from the recording's scatter. ``findings``
    are those of the recording's reader. ``observations`` are beside the impedance. A state made from an observation
    (:attr:`observed`) has it as ``observation``, its value as ``measured`` and its uncertainty as ``noise``.
    """

    name: str
    device: FilledChip
    measured: Spectrum
    noise: np.ndarray[Any, np.dtype[np.float64]]
    stated: bool
    drive: float | None = None
    temperature: float | None = None
    held_out: bool = False
    observations: tuple[Observation, ...] = ()
    observation: Observation | None = None
    findings: tuple[str, ...] = ()

    @cached_property
    def observed(self) -> tuple[DeviceState, ...]:
        """One state for each of its observations."""
        return tuple(
            replace(self, name=each.name, measured=ObservedValue(np.array([each.frequency]), np.array([each.value])),
                    noise=np.array([each.uncertainty]), stated=True, drive=None, observations=(), observation=each,
                    findings=())
            for each in self.observations)

    @cached_property
    def numbers(self) -> Mapping[str, Number]:
        """The parameters of the device and the bench, by each name."""
        found = (*device_numbers(self.chip, self.materials.values()).values(), *map(bench_number, BENCH_ELEMENTS))
        return {name: each for each in found for name in each.names}

    @property
    def data(self) -> int:
        """Real data per point: 2 for an impedance, 1 for an observation."""
        return 2 if self.observation is None else 1

    @property
    def chip(self) -> Chip:
        return self.device.chip

    @property
    def materials(self) -> Mapping[str, Material]:
        """The material of each region."""
        return self.device.materials

    @property
    def fluid(self) -> Fluid | None:
        """The fluid in the cavity, if any."""
        found = self.materials.get(CAVITY)
        return found if isinstance(found, Fluid) else None


@dataclass(frozen=True, eq=False)
class StateFit:
    """The fit of one state under one hypothesis. ``reduced`` is the reduced chi-square, ``rms`` that of ln(Z /
    Z_measured), ``correlation`` the correlation length of the residuals in points, ``impedance`` (n,) in ohm."""

    name: str
    reduced: float
    rms: float
    correlation: float
    impedance: Complex


def data_rows(states: Sequence[DeviceState]) -> list[slice]:
    """The rows of each state in stacked data: real, then imaginary parts."""
    ends = np.cumsum([0, *(2 * state.noise.size for state in states)]).tolist()
    return list(itertools.starmap(slice, itertools.pairwise(ends)))


def reduced_chi_square(log: Complex, noise: Real, data: int) -> float:
    """Reduced chi-square of ln(Z_model / Z_measured) (n,). `data` is the number of real data per point
    (`DeviceState.data`)."""
    return float(np.mean(np.abs(log / noise) ** 2) / data)


def state_fit(name: str, log: Complex, impedance: Complex, noise: Real, *, data: int = 2) -> StateFit:
    """The fit of a state with residuals `log` (n,), ln(Z_model / Z_measured). `data` is the number of real data per
    point (`DeviceState.data`)."""
    return StateFit(name, reduced_chi_square(log, noise, data), rms(log), correlation_length(log / noise), impedance)


def rms_of_impedance(states: Sequence[DeviceState], log: Sequence[Complex]) -> float:
    """The rms of ln(Z / Z_measured) (n,) over all states, without observations."""
    return rms(np.concatenate([each for state, each in zip(states, log, strict=True) if state.observation is None]))


def fitted_spectrum(fit: StateFit, state: DeviceState) -> Spectrum:
    """The fitted spectrum of a state."""
    return Spectrum(state.measured.frequency, fit.impedance, origin=Origin("simulated"))


def read_state(name: str, table: FileTable, folder: Path, registry: Registry) -> DeviceState:
    """Read a state from its table; paths are relative to `folder`.

    From a program, the chip may be a value, and the recording a spectrum or an object with one.

    Raises:
        InputError: a mistake in the table or in one of its files, or a recording that cannot be of this device.
    """
    table.only(STATE_KEYS)
    chip = table.content.get("chip")
    if not isinstance(chip, Chip):
        chip = read_chip(folder / table.text("chip", expected=_expected(table, "a Chip", "file")))
    check_stated_length(chip.measure, chip.file, "the impedance, which is compared with the recording,")
    if "state" in table:
        state = chip.state(table.choice("state", [each.name for each in chip.states]))
    elif len(chip.states) == 1:
        state = chip.states[0]
    else:
        raise InputError(table.source, table.at("state"), None, "one of the chip's states: "
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
    whole, recording, findings = _recording(table, folder)
    band = _band(table) if "band" in table else None
    measured = in_band(whole, chip, band, name=recording)
    noise, stated = _noise(measured, table)
    drive = table.optional_quantity("drive", "peak-to-peak voltage")
    if drive is not None and not drive > 0.0:
        raise table.error("drive", "a voltage above zero")
    found = DeviceState(name, device, measured, noise, stated,
                        None if drive is None else 0.5 * drive, temperature, held_out,
                        read_observations(table, name, device, (float(measured.frequency[0]),
                                                                float(measured.frequency[-1]))), findings=findings)
    if set(device.materials) == {TRANSDUCER}:
        # Loads shift resonances by more than this check allows for.
        check_device(in_band(whole, chip, None, name=recording), chip, device.materials, name=recording)
    return found


def _recording(table: FileTable, folder: Path) -> tuple[Spectrum, str, tuple[str, ...]]:
    """The spectrum, its name in error messages, and its reader's findings."""
    given, without = table.content.get("recording"), table.flag("without_outliers")
    if given is not None and not isinstance(given, str):
        if without and not isinstance(given, Reading):
            raise table.error("without_outliers", "a recording that is read from a file")
        given = given.without_outliers() if isinstance(given, Reading) and without else given
        findings = tuple(each.message for each in given.findings) if isinstance(given, Reading) else ()
        try:
            return spectrum_of(given), table.at("recording"), findings
        except TypeError:
            raise table.error("recording", _expected(table, "a Spectrum", "recording")) from None
    path = folder / table.text("recording", expected=_expected(table, "a Spectrum", "recording"))
    columns = None
    if "columns" in table:
        columns = read_column_map(folder / table.text("columns", expected="the path of a column map"))
    reading = read_recording(path, columns=columns, without_outliers=without)
    return reading.spectrum, str(path), tuple(each.message for each in reading.findings)


def _expected(table: FileTable, value: str, file: str) -> str:
    path = f"the path of its {file}"
    return f"{value} or {path}" if isinstance(table.source, ProgramSource) else path


def _band(table: FileTable) -> tuple[float, float]:
    low, high = table.quantities("band", "frequency", expected="two frequencies")
    if not low < high:
        raise table.error("band", "a lower and a higher frequency")
    return low, high


def _noise(measured: Spectrum, table: FileTable) -> tuple[np.ndarray[Any, np.dtype[np.float64]], bool]:
    """Relative standard deviation of every point, and whether it was stated."""
    stated = table.optional_quantity("noise", "share")
    if stated is not None and not stated > 0.0:
        raise table.error("noise", "a relative deviation above zero")
    if stated is not None and stated > NOISIEST:
        raise table.error("noise", f"the standard deviation of a point, of {100.0 * NOISIEST:g} % at most: one that is "
                          f'larger explains any recording; "{stated:g} %", or a cleaner recording?')
    if measured.uncertainty is not None:
        if stated is not None:
            raise table.error("noise", "nothing: the recording brings its own uncertainties")
        return np.asarray(measured.uncertainty / measured.magnitude), True
    if stated is not None:
        return np.full(measured.frequency.size, stated), True
    return np.full(measured.frequency.size, scatter(measured)), False
