"""BENCH.toml: the instruments, the resistor, the frequencies, and the limits of the drive.

::

    [generator]
    port = "/dev/ttyUSB0"
    model = "FY3224S"

    [oscilloscope]
    port = "/dev/usbtmc0"
    channel_total = 1                # across device and reference resistor
    channel_reference = 2            # across the reference resistor alone
    probe_total = 10
    probe_reference = 1

    [reference]
    resistance = "0.5 ohm"
    tolerance = "1 %"

    [sweep]
    centre = "1.03 MHz"              # or from = "0.9 MHz", to = "1.1 MHz"
    span = "12 %"                    # either side
    step = "500 Hz"

    [drive]
    amplitude = "5 Vpp"              # open circuit; a list is a series of drive levels, each swept in turn

    [limits]
    device_voltage = "5 Vpp"
    device_current = "100 mA"        # peak to peak

Everything else has a default, given with the classes below.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.files.names import check_title
from workbench.files.quantities import parse_quantity
from workbench.files.tables import FileTable
from workbench.instruments.instrument import GeneratorSettings, OscilloscopeSettings
from workbench.instruments.tektronix import AVERAGES, PROBES

#: Resolution of the generator: hertz and volt peak to peak.
FREQUENCY_RESOLUTION = 0.01
AMPLITUDE_RESOLUTION = 0.01

#: Source resistance of the generator (ohm), which limits the current of a passive device.
SOURCE_RESISTANCE = 50.0

KINDS = ("linear", "adaptive")
DIRECTIONS = ("up", "down", "both")


@dataclass(frozen=True)
class ReferenceResistor:
    """The resistor in series with the device: ``resistance`` (ohm), ``tolerance`` (limits, as a fraction)."""

    resistance: float
    tolerance: float = 0.0


@dataclass(frozen=True)
class SweepPlan:
    """The frequencies of a sweep, from ``low`` to ``high`` (Hz).

    ``kind`` "linear" takes every ``step`` (Hz). "adaptive" takes at most ``points``, where the spectrum bends, until
    the interpolation between them is known to ``resolution`` (relative error of Z) or to the noise. ``direction``
    "both" is up and then down; every further pass, and there are ``repeats`` of each, visits the frequencies of the
    first.
    """

    low: float
    high: float
    kind: str = "linear"
    step: float = 500.0
    points: int = 100
    resolution: float = 2e-3
    direction: str = "up"
    repeats: int = 1

    @property
    def passes(self) -> int:
        return self.repeats * (2 if self.direction == "both" else 1)

    def grid(self) -> NDArray[np.float64]:
        """The frequencies of a linear sweep (n,) Hz, in rising order, as the generator can be set to them."""
        count = math.floor((self.high - self.low) / self.step + 1e-9)
        at = self.low + self.step * np.arange(count + 1)
        return np.round(at / FREQUENCY_RESOLUTION) * FREQUENCY_RESOLUTION


@dataclass(frozen=True)
class Limits:
    """Limits of the load on the device: ``device_voltage`` (V) and ``device_current`` (A), both peak to peak."""

    device_voltage: float = 20.0
    device_current: float = 0.4


@dataclass(frozen=True)
class Acquisition:
    """The acquisition of a point.

    ``captures`` are made after ``settle`` (s), of about ``periods`` periods each, averaged ``averages`` times by the
    oscilloscope. Single captures averaged afterwards are the better way: an averaged record comes over the wire with
    only 8 bit as well, and without the noise that lets the fit see between two steps of the converter. A point at which
    an instrument fails is tried ``attempts`` times. ``gain_accuracy`` (limits, as a fraction) is that of a channel of
    the oscilloscope, 3 % by the maker's data sheet; load compensation removes it.
    """

    averages: int = 1
    captures: int = 4
    periods: int = 10
    settle: float = 0.05
    attempts: int = 6
    gain_accuracy: float = 0.03


@dataclass(frozen=True)
class Standards:
    """Recordings (run files or spectra) of the fixture open, shorted and loaded.

    ``load_resistance`` (ohm) and ``load_tolerance`` (limits, as a fraction) are those of the load; ``columns`` is a
    column map for spectra with unclear headings.
    """

    open: Path | None = None
    short: Path | None = None
    load: Path | None = None
    load_resistance: float | None = None
    load_tolerance: float = 0.0
    columns: Path | None = None


@dataclass(frozen=True)
class BenchSetup:
    """The content of BENCH.toml.

    ``levels`` (V peak to peak, open circuit); ``metadata`` is device, state, temperature, gel, operator and note as
    they were written.
    """

    path: str
    text: str
    generator: GeneratorSettings
    oscilloscope: OscilloscopeSettings
    reference: ReferenceResistor
    sweep: SweepPlan
    levels: tuple[float, ...]
    limits: Limits
    acquisition: Acquisition
    standards: Standards
    metadata: Mapping[str, str]

    @property
    def safe_amplitude(self) -> float:
        """The open-circuit amplitude (V peak to peak) that cannot exceed a limit with any passive device.

        The device sees at most all of it, and draws at most the current that the source resistance admits.
        """
        return min(self.limits.device_voltage, self.limits.device_current * SOURCE_RESISTANCE)


_TABLES = ("generator", "oscilloscope", "reference", "sweep", "drive", "limits", "acquisition", "compensation",
           "device")
_METADATA = ("name", "state", "temperature", "gel", "operator", "note")


def _positive(table: FileTable, key: str, dimension: str, default: float | None = None) -> float:
    if default is None and key not in table:
        raise table.error(key, "to be given")
    value = table.quantity(key, dimension, default)
    if value <= 0.0:
        raise table.error(key, f"{'a current' if dimension == 'current' else 'a value'} above zero")
    return value


def _fraction(table: FileTable, key: str, default: float) -> float:
    value = table.quantity(key, "share", default)
    if not 0.0 <= value < 1.0:
        raise table.error(key, 'from "0 %" to less than "100 %"')
    return value


def _seconds(table: FileTable, key: str, default: float) -> float:
    value = table.quantity(key, "time", default)
    if value < 0.0:
        raise table.error(key, "a time not below zero")
    return value


def _line(table: FileTable, key: str, default: str | None = None) -> str:
    text = table.text(key, default, expected="one line of text").strip()
    return check_title(text, source=table.source, field=table.at(key))


def _path(table: FileTable, key: str, folder: Path) -> Path | None:
    return folder / _line(table, key) if key in table else None


def read_bench(path: Path | str) -> BenchSetup:
    """Read BENCH.toml; paths in it are relative to its folder.

    Raises:
        InputError: anything missing, unknown, or beyond an instrument.
    """
    path = Path(path)
    root = FileTable.read(path).only(_TABLES)

    def table(name: str, keys: tuple[str, ...]) -> FileTable:
        return root.table(name, expected=f"a table, [{name}]").only(keys)

    sweep = _sweep(table("sweep", ("centre", "span", "from", "to", "kind", "step", "points", "resolution", "direction",
                                   "repeats")))
    reference = table("reference", ("resistance", "tolerance"))
    limits = table("limits", ("device_voltage", "device_current"))
    acquisition = table("acquisition", tuple(f.name for f in fields(Acquisition)))
    averages = acquisition.whole("averages", 1, low=1, high=128)
    if averages not in AVERAGES:
        raise acquisition.error("averages", "one of " + ", ".join(map(str, AVERAGES)))
    default = Acquisition()
    device = table("device", _METADATA)
    return BenchSetup(
        path=root.source, text=path.read_text(encoding="utf-8"),
        generator=_generator(table("generator", tuple(f.name for f in fields(GeneratorSettings)))),
        oscilloscope=_oscilloscope(table("oscilloscope", tuple(f.name for f in fields(OscilloscopeSettings)))),
        reference=ReferenceResistor(_positive(reference, "resistance", "resistance"),
                                    _fraction(reference, "tolerance", 0.0)),
        sweep=sweep, levels=_levels(table("drive", ("amplitude",))),
        limits=Limits(_positive(limits, "device_voltage", "peak-to-peak voltage", Limits.device_voltage),
                      _positive(limits, "device_current", "current", Limits.device_current)),
        acquisition=Acquisition(
            averages=averages, captures=acquisition.whole("captures", default.captures, low=1, high=1000),
            periods=acquisition.whole("periods", default.periods, low=2, high=250),
            settle=_seconds(acquisition, "settle", default.settle),
            attempts=acquisition.whole("attempts", default.attempts, low=1, high=100),
            gain_accuracy=_fraction(acquisition, "gain_accuracy", default.gain_accuracy),
        ),
        standards=_standards(table("compensation", tuple(f.name for f in fields(Standards))), path.parent),
        metadata={key: _line(device, key) for key in device},
    )


def _generator(table: FileTable) -> GeneratorSettings:
    default = {f.name: f.default for f in fields(GeneratorSettings) if f.default is not MISSING}
    return GeneratorSettings(
        port=_line(table, "port"), model=_line(table, "model", str(default["model"])),
        baud=table.whole("baud", GeneratorSettings.baud, low=1, high=10_000_000),
        timeout=_seconds(table, "timeout", GeneratorSettings.timeout),
        pause=_seconds(table, "pause", GeneratorSettings.pause),
    )


def _oscilloscope(table: FileTable) -> OscilloscopeSettings:
    channels = {key: table.whole(key, default, low=1, high=4)
                for key, default in (("channel_total", 1), ("channel_reference", 2))}
    if channels["channel_total"] == channels["channel_reference"]:
        raise table.error("channel_reference", "another channel than channel_total")
    probes = {key: table.whole(key, 10, low=1, high=10) for key in ("probe_total", "probe_reference")}
    for key, factor in probes.items():
        if factor not in PROBES:
            raise table.error(key, " or ".join(map(str, PROBES)))
    return OscilloscopeSettings(
        port=_line(table, "port"), model=_line(table, "model", OscilloscopeSettings.model),
        baud=table.whole("baud", OscilloscopeSettings.baud, low=1, high=10_000_000), **channels, **probes,
        trigger=table.choice("trigger", ("CH1", "CH2", "CH3", "CH4", "EXT"), "CH1"),
        timeout=_seconds(table, "timeout", OscilloscopeSettings.timeout),
        acquisition_timeout=_seconds(table, "acquisition_timeout", OscilloscopeSettings.acquisition_timeout),
    )


def _sweep(table: FileTable) -> SweepPlan:
    given = {key for key in ("centre", "span", "from", "to") if key in table}
    if given == {"from", "to"}:
        low, high = _positive(table, "from", "frequency"), _positive(table, "to", "frequency")
    elif given in ({"centre"}, {"centre", "span"}):
        centre, span = _positive(table, "centre", "frequency"), _fraction(table, "span", 0.12)
        low, high = centre * (1.0 - span), centre * (1.0 + span)
    else:
        raise InputError(table.source, "sweep", sorted(given), "centre (and span), or from and to")
    low, high = (round(f / FREQUENCY_RESOLUTION) * FREQUENCY_RESOLUTION for f in (low, high))
    step = _positive(table, "step", "frequency", SweepPlan.step)
    if not high - low >= step:
        raise InputError(table.source, "sweep", f"{low:g} Hz to {high:g} Hz", f"a rising band of {step:g} Hz or more")
    return SweepPlan(
        low, high, kind=table.choice("kind", KINDS, "linear"), step=step,
        points=table.whole("points", SweepPlan.points, low=16, high=10_000),
        resolution=_fraction(table, "resolution", SweepPlan.resolution),
        direction=table.choice("direction", DIRECTIONS, "up"), repeats=table.whole("repeats", 1, low=1, high=1000),
    )


def _levels(table: FileTable) -> tuple[float, ...]:
    given = table.content.get("amplitude")
    listed = given if isinstance(given, list) else [given]
    levels = []
    for text in listed:
        level = parse_quantity(text, "peak-to-peak voltage", source=table.source, field="drive.amplitude")
        steps = level / AMPLITUDE_RESOLUTION
        if level <= 0.0 or abs(steps - round(steps)) > 1e-6:
            raise InputError(table.source, "drive.amplitude", text, f"above zero, in steps of {AMPLITUDE_RESOLUTION} V")
        levels.append(round(level, 2))
    if not levels or len(set(levels)) != len(levels):
        raise InputError(table.source, "drive.amplitude", given, "one amplitude, or a list without one twice")
    return tuple(levels)


def _standards(table: FileTable, folder: Path) -> Standards:
    found = Standards(
        open=_path(table, "open", folder), short=_path(table, "short", folder), load=_path(table, "load", folder),
        load_resistance=_positive(table, "load_resistance", "resistance") if "load_resistance" in table else None,
        load_tolerance=_fraction(table, "load_tolerance", 0.0), columns=_path(table, "columns", folder),
    )
    if (found.load is None) != (found.load_resistance is None):
        raise table.error("load_resistance", "to be given with load, and only with it")
    return found
