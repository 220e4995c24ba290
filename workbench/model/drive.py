"""The drive of a device: the voltage at its electrodes.

The model has unit electrode voltage; a drive gives the actual voltage. It differs from a generator's open-circuit
voltage: fifty ohm in series with four ohm reduce it to a thirteenth. Lickert et al. (arXiv 2210.02311) find a constant
generator voltage unsuitable for comparing frequencies and recommend constant device voltage or constant power.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.parts import TWO_AMPLIFIERS
from geometry.straight import check_stated_length
from workbench.files.errors import InputError
from workbench.files.quantities import parse_quantity
from workbench.files.tables import FileTable


@runtime_checkable
class Drive(Protocol):
    """Interface of a drive: the voltage at a device."""

    def amplitude(self, impedance: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Voltage amplitude (V, zero to peak) at electrodes of this `impedance` (ohm)."""

    def __str__(self) -> str: ...


@dataclass(frozen=True)
class VoltageDrive:
    """A constant voltage at the electrodes, stated peak-to-peak (V)."""

    peak_to_peak: float = 10.0

    def amplitude(self, impedance: NDArray[np.complex128]) -> NDArray[np.complex128]:
        return np.full(np.shape(impedance), 0.5 * self.peak_to_peak, dtype=complex)

    def __str__(self) -> str:
        return f"{self.peak_to_peak:g} Vpp at the electrodes"


@dataclass(frozen=True)
class GeneratorDrive:
    """A generator of constant open-circuit voltage behind a resistance (ohm). The voltage is in V peak-to-peak. Each of
    several ``amplifiers`` is such a generator; they share the device's current equally."""

    open_circuit_peak_to_peak: float
    source_resistance: float = 50.0
    amplifiers: int = 1

    def amplitude(self, impedance: NDArray[np.complex128]) -> NDArray[np.complex128]:
        resistance = self.source_resistance / self.amplifiers
        return 0.5 * self.open_circuit_peak_to_peak * impedance / (impedance + resistance)

    def __str__(self) -> str:
        each = "" if self.amplifiers == 1 else f", each of {self.amplifiers} amplifiers"
        return f"{self.open_circuit_peak_to_peak:g} Vpp open circuit behind {self.source_resistance:g} ohm{each}"


@dataclass(frozen=True)
class PowerDrive:
    """A constant time-averaged electrical input power (W)."""

    power: float

    def amplitude(self, impedance: NDArray[np.complex128]) -> NDArray[np.complex128]:
        conductance = (1.0 / impedance).real
        return np.sqrt(2.0 * self.power / conductance).astype(complex)

    def __str__(self) -> str:
        return f"{self.power:g} W of electrical input power"


def drive_up_to(drive: Drive, factor: float) -> Drive | None:
    """The drive of `factor` times the amplitude, rounded down to two digits. None for a drive of another kind."""
    match drive:
        case VoltageDrive():
            return VoltageDrive(_down(factor * drive.peak_to_peak))
        case GeneratorDrive():
            return replace(drive, open_circuit_peak_to_peak=_down(factor * drive.open_circuit_peak_to_peak))
        case PowerDrive():
            return PowerDrive(_down(factor**2 * drive.power))
    return None


def _down(value: float) -> float:
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / digit) * digit:.2g}")


#: Smallest and largest plausible drive: V peak-to-peak, W, and ohm of a source. Doubled, a slip of the unit is still
#: outside.
PLAUSIBLE: Mapping[str, tuple[float, float, str]] = {
    "peak-to-peak voltage": (1e-3, 2e3, "1 mVpp to 2000 Vpp"), "power": (1e-9, 500.0, "1e-9 W to 500 W"),
    "resistance": (1e-3, 1e5, "1 mohm to 100 kohm")}

_LEVEL = re.compile(r"\s*(?P<dbm>[-+]?\d+(\.\d*)?)\s*dBm\s*(@\s*(?P<resistance>[^@]+?)\s*)?$")
_GENERATOR = re.compile(r"\s*(?P<voltage>[^@]*?)\s*@\s*(?P<resistance>[^@]*?)\s*$")


def parse_drive(text: str, *, source: str = "command line", field: str = "--drive") -> Drive:
    """A drive from a text.

    Examples: ``"10 Vpp"`` or ``"3.5 Vrms"`` (sine, at the electrodes), ``"10 Vpp @ 50 ohm"`` (generator), ``"0.1 W"``
    (power), and ``"20 dBm"`` or ``"20 dBm @ 75 ohm"``: a generator with this power into a load equal to its source
    resistance, by default 50 ohm.

    Raises:
        InputError: none of these, or a value that is not positive or not plausible.
    """
    def positive(part: str, dimension: str) -> float:
        value = parse_quantity(part, dimension, source=source, field=field)
        if value <= 0.0:
            raise InputError(source, field, text, "a drive above zero")
        low, high, shown = PLAUSIBLE[dimension]
        if not low <= value <= high:
            raise InputError(source, field, text, f"a plausible {dimension} of an amplifier for such a device, {shown}")
        return value

    level = _LEVEL.match(text)
    if level is not None:
        resistance = positive(level["resistance"] or "50 ohm", "resistance")
        power = positive(f"{1e-3 * 10.0 ** (0.1 * float(level['dbm'])):.15g} W", "power")
        # The open-circuit voltage is twice that at the matched load.
        return GeneratorDrive(math.sqrt(32.0 * power * resistance), resistance)
    generator = _GENERATOR.match(text)
    if generator is not None:
        return GeneratorDrive(
            positive(generator["voltage"], "peak-to-peak voltage"), positive(generator["resistance"], "resistance")
        )
    if text.rstrip().endswith("W"):
        return PowerDrive(positive(text, "power"))
    if text.rstrip().endswith(("Vpp", "Vrms")):
        return VoltageDrive(positive(text, "peak-to-peak voltage"))
    raise InputError(source, field, text, '"10 Vpp", "3.5 Vrms", "10 Vpp @ 50 ohm", "20 dBm" or "0.1 W"')


def wired(drive: Drive | None, chip: Chip) -> Drive:
    """The `drive` of a chip with its wiring, by default 10 Vpp.

    Raises:
        InputError: a generator or a power for a straight chip without a length.
    """
    if isinstance(drive, GeneratorDrive | PowerDrive):
        check_stated_length(chip.measure, chip.file, f"the voltage of {drive} at its electrodes")
    if isinstance(drive, GeneratorDrive) and chip.electrodes.wiring == TWO_AMPLIFIERS:
        return replace(drive, amplifiers=2)
    return VoltageDrive() if drive is None else drive


def check_drive(drive: object, *, source: str) -> None:
    """Check that a caller passed a drive, or None.

    Raises:
        InputError: anything else, such as the text of one.
    """
    if drive is not None and not isinstance(drive, Drive):
        text = drive if isinstance(drive, str) else "5 Vpp"
        raise InputError(source, "drive", drive, f'a drive, such as wb.parse_drive("{text}")')


def check_scaled(voltage: float, factor: float, *, source: str, field: str) -> None:
    """Check that `factor` times a `voltage` (V peak-to-peak) is plausible.

    Raises:
        InputError: it is not.
    """
    _, high, _ = PLAUSIBLE["peak-to-peak voltage"]
    if factor * voltage > high:
        raise InputError(source, field, factor, f"at most {high / voltage:.3g}, which gives {high:g} Vpp from "
                         f"{voltage:.3g} Vpp at the electrodes, the most that an amplifier for such a device has")


def read_drive(table: FileTable) -> Drive:
    """The drive under the key ``drive``, by default "10 Vpp".

    It is a text for :func:`parse_drive`, or a drive given by a program.

    Raises:
        InputError: as in :func:`parse_drive`.
    """
    given = table.content.get("drive")
    if isinstance(given, Drive):
        return given
    return parse_drive(table.text("drive", "10 Vpp"), source=table.source, field=table.at("drive"))
