"""BENCH.toml: instruments, resistor, frequencies, and limits of the drive.

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

Other keys have defaults, given with the classes below.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.files.names import check_title
from workbench.files.quantities import frequency_text, parse_quantity
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
    """The resistor in series with the device. ``resistance`` is in ohm, ``tolerance`` are limits, as a fraction."""

    resistance: float
    tolerance: float = 0.0


@dataclass(frozen=True)
class SweepPlan:
    """The frequencies of a sweep, from ``low`` to ``high`` (Hz).

    ``kind`` "linear" uses every ``step`` (Hz). "adaptive" uses at most ``points``, at places of curvature, until the
    interpolation between them is known to ``resolution`` (relative error of Z) or to the noise. ``direction`` "both" is
    up and then down. Each direction has ``repeats`` passes; further passes visit the frequencies of the first.
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
        """The settable frequencies (n,) Hz of a linear sweep, rising."""
        count = math.floor((self.high - self.low) / self.step + 1e-9)
        at = self.low + self.step * np.arange(count + 1)
        return np.round(at / FREQUENCY_RESOLUTION) * FREQUENCY_RESOLUTION


@dataclass(frozen=True)
class Limits:
    """Largest peak-to-peak ``device_voltage`` (V) and ``device_current`` (A)."""

    device_voltage: float = 20.0
    device_current: float = 0.4


@dataclass(frozen=True)
class Acquisition:
    """The acquisition of a point.

    After ``settle`` (s) there are ``captures``, each of about ``periods`` periods and averaged ``averages`` times by
    the oscilloscope. Several captures are better than averages: an averaged record also has only 8 bit, and lacks the
    noise that resolves amplitudes below a step of the converter. After a failure of an instrument, a point is repeated
    up to ``attempts`` times. ``gain_accuracy`` (limits, as a fraction) is that of a channel of the oscilloscope, 3 % by
    the maker's data sheet; load compensation removes it.
    """

    averages: int = 1
    captures: int = 4
    periods: int = 10
    settle: float = 0.05
    attempts: int = 6
    gain_accuracy: float = 0.03


@dataclass(frozen=True)
class Standards:
    """Recordings (run files or spectra) of open, short and load. ``load_resistance`` (ohm) and ``load_tolerance``
    (limits, a fraction) are those of the load; ``columns`` is a column map."""

    open: Path | None = None
    short: Path | None = None
    load: Path | None = None
    load_resistance: float | None = None
    load_tolerance: float = 0.0
    columns: Path | None = None


@dataclass(frozen=True)
class BenchSetup:
    """The content of BENCH.toml. ``levels`` are in V peak to peak (open circuit), ``metadata`` are texts."""

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
        """The open-circuit amplitude (Vpp) within the limits for any passive device. The device has at most all of this
        voltage, and the current is limited by the source resistance."""
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


#: Kinds of fields by name: whole numbers between limits, quantities above zero, shares, times, choices. Any other field
#: is one line of text.
_WHOLE = {"baud": (1, 10_000_000), "averages": (1, 128), "captures": (1, 1000), "periods": (2, 250),
          "attempts": (1, 100), "points": (16, 10_000), "repeats": (1, 1000),
          **dict.fromkeys(("channel_total", "channel_reference"), (1, 4)),
          **dict.fromkeys(("probe_total", "probe_reference"), (1, 10))}
_POSITIVE = {"resistance": "resistance", "device_voltage": "peak-to-peak voltage", "device_current": "current",
             "step": "frequency"}
_SHARES = ("tolerance", "resolution", "gain_accuracy")
_SECONDS = ("timeout", "pause", "acquisition_timeout", "settle")
_CHOICES = {"kind": KINDS, "direction": DIRECTIONS, "trigger": ("CH1", "CH2", "CH3", "CH4", "EXT")}


def _values(table: FileTable, kind: type[Any], *, but: Collection[str] = ()) -> dict[str, Any]:
    """The fields of the dataclass `kind`, except those in `but`."""
    values: dict[str, Any] = {}
    for field in fields(kind):
        key = field.name
        default: Any = None if field.default is MISSING else field.default
        if key in but:
            continue
        if key in _WHOLE:
            values[key] = table.whole(key, default, low=_WHOLE[key][0], high=_WHOLE[key][1])
        elif key in _POSITIVE:
            values[key] = _positive(table, key, _POSITIVE[key], default)
        elif key in _SHARES:
            values[key] = _fraction(table, key, default)
        elif key in _SECONDS:
            values[key] = table.quantity(key, "time", default)
            if values[key] < 0.0:
                raise table.error(key, "a time not below zero")
        elif key in _CHOICES:
            values[key] = table.choice(key, _CHOICES[key], default)
        else:
            values[key] = _line(table, key, default)
    return values


def _line(table: FileTable, key: str, default: str | None = None) -> str:
    text = table.text(key, default, expected="one line of text").strip()
    return check_title(text, source=table.source, field=table.at(key))


def _path(table: FileTable, key: str, folder: Path) -> Path | None:
    return folder / _line(table, key) if key in table else None


def read_bench(path: Path | str) -> BenchSetup:
    """Read BENCH.toml; paths in it are relative to its folder.

    Raises:
        InputError: a missing, unknown or invalid key, or a value beyond an instrument's range.
    """
    path = Path(path)
    root = FileTable.read(path).only(_TABLES)

    def table(name: str, keys: type[Any] | tuple[str, ...]) -> FileTable:
        known = keys if isinstance(keys, tuple) else tuple(field.name for field in fields(keys))
        return root.table(name, expected=f"a table, [{name}]").only(known)

    acquisition = table("acquisition", Acquisition)
    acquired = Acquisition(**_values(acquisition, Acquisition))
    if acquired.averages not in AVERAGES:
        raise acquisition.error("averages", "one of " + ", ".join(map(str, AVERAGES)))
    device = table("device", _METADATA)
    return BenchSetup(
        path=root.source, text=path.read_text(encoding="utf-8"),
        generator=GeneratorSettings(**_values(table("generator", GeneratorSettings), GeneratorSettings)),
        oscilloscope=_oscilloscope(table("oscilloscope", OscilloscopeSettings)),
        reference=ReferenceResistor(**_values(table("reference", ReferenceResistor), ReferenceResistor)),
        sweep=_sweep(table("sweep", ("centre", "span", "from", "to", "kind", "step", "points", "resolution",
                                     "direction", "repeats"))),
        levels=_levels(table("drive", ("amplitude",))), limits=Limits(**_values(table("limits", Limits), Limits)),
        acquisition=acquired, standards=_standards(table("compensation", Standards), path.parent),
        metadata={key: _line(device, key) for key in device},
    )


def _oscilloscope(table: FileTable) -> OscilloscopeSettings:
    settings = OscilloscopeSettings(**_values(table, OscilloscopeSettings))
    if settings.channel_total == settings.channel_reference:
        raise table.error("channel_reference", "another channel than channel_total")
    for key in ("probe_total", "probe_reference"):
        if getattr(settings, key) not in PROBES:
            raise table.error(key, " or ".join(map(str, PROBES)))
    return settings


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
    values = _values(table, SweepPlan, but=("low", "high"))
    if not high - low >= values["step"]:
        raise InputError(table.source, "sweep", frequency_text(low, high),
                         f"a rising band of {frequency_text(values['step'])} or more")
    return SweepPlan(low, high, **values)


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
