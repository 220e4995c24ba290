"""Waveforms that oscilloscopes save as one CSV table.

The table has the time, or its start and step, and a column per channel. It reads the files of Rigol (DS1000E, DS1000Z,
MSO5000), Siglent (SDS1000, SDS2000), Tektronix (DPO, MSO, MDO, TBS2000), Keysight InfiniiVision, LeCroy (one channel a
file, named by the file), and any table whose headings are a time and channels, each with its unit. If a step is stated
and the printed time agrees with it, the stated step is used, since some makers print the time in too few digits.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.instruments.instrument import Waveform

#: Number of lines of the search for headings; the longest head seen (Tektronix MSO) has 21.
HEAD_LINES = 60

#: Largest deviation of samples from equal steps, relative to a step and beyond the rounding of printed digits, in one
#: record. Doubled, a jump of 4 % of a step is accepted as rounding.
UNEVEN = 0.02

#: Largest relative uncertainty of a step from printed times, which is also that of every frequency.
COARSE_STEP = 1e-3

#: Voltage (V) above which a value marks a sample outside the screen.
OFF_SCREEN = 1e30

#: Largest difference, relative to the range of a signal, that is rounding and not a step of the converter (16 bit is
#: 1.5e-5).
SAME_VALUE = 5e-6

#: The readable files, for messages.
READ = ("a waveform in CSV of Tektronix (TDS, TBS, DPO, MSO, MDO), Rigol, Siglent, LeCroy or Keysight InfiniiVision, "
        "an ISF file, or a table headed time, CH1, CH2 with their units: Time (s),CH1 (V),CH2 (V)")

_TIMES = {"s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6,
          "ns": 1e-9, "ps": 1e-12}
_VOLTS = {"v": 1.0, "volt": 1.0, "volts": 1.0, "mv": 1e-3, "uv": 1e-6, "µv": 1e-6, "μv": 1e-6, "kv": 1e3}
_AMPERES = {"a": 1.0, "amp": 1.0, "amps": 1.0, "ampere": 1.0, "amperes": 1.0, "ma": 1e-3, "ua": 1e-6, "µa": 1e-6,
            "μa": 1e-6, "ka": 1e3}

#: The number of a channel that only the name of its file states, and the unit of samples without one.
UNNAMED = 0
UNSTATED = "unstated"

_UNIT = re.compile(r"(?P<name>.*?)\s*(?:[(\[]\s*(?P<bracket>[^()\[\]]+?)\s*[)\]]|\s+in\s+(?P<words>\S+)"
                   r"|\s*/\s*(?P<slash>[^\s/]+))?$")
_CHANNEL = re.compile(r"(?:CH(?:AN(?:NEL)?)?[\s_-]*(?P<number>[1-8A-H])|C(?P<short>[1-8]))(?P<rest>[\s_-].*)?",
                      re.IGNORECASE)
_TIME = re.compile(r"time|t|x|x-axis|in s|second", re.IGNORECASE)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?(?P<decimals>\d*)|\.(?P<after>\d+))(?:[eE](?P<exponent>[+-]?\d+))?")
_START, _STEP = (re.compile(rf"\b{word}\s*=\s*([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*(\w+)", re.IGNORECASE)
                 for word in ("t0", "tInc"))


@dataclass(frozen=True)
class WaveformColumn:
    """A column (from 0) and its unit ("" for none). ``envelope`` is whether it has extremes."""

    place: int
    unit: str
    envelope: bool = False


@dataclass(frozen=True)
class WaveformTable:
    """The place of the samples in a file, by its head.

    ``maker`` is in words; ``channels`` are by number; ``time`` is the column of time, or None if only ``start`` and
    ``step`` (s) are given; ``first`` is the index of the line after the head; ``settings`` are the lines above the
    headings.
    """

    maker: str
    channels: Mapping[int, tuple[WaveformColumn, ...]]
    time: WaveformColumn | None
    start: float | None
    step: float | None
    first: int
    delimiter: str
    settings: Mapping[str, tuple[str, ...]]


def decoded(data: bytes) -> tuple[str, ...]:
    """The lines of a text file in the encodings of instruments."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return tuple(data.decode("utf-16", "replace").lstrip("\ufeff").splitlines())
    try:
        return tuple(data.decode("utf-8-sig").splitlines())
    except UnicodeDecodeError:
        return tuple(data.decode("latin-1").splitlines())


def waveform_table(lines: Sequence[str]) -> WaveformTable | None:
    """The place of the samples in these `lines`. None if the head is not that of an oscilloscope's table."""
    for index, line in enumerate(lines[:HEAD_LINES]):
        for delimiter in (",", ";", "\t"):
            if len(_cells(line, delimiter)) < 2:
                continue
            for layout in (_by_step, _by_headings, _by_source, _by_file):
                table = layout(lines, index, delimiter)
                if table is not None:
                    return table
    return None


def recognised(lines: Sequence[str]) -> str:
    """A description of an oscilloscope's table; "" for other files."""
    found = waveform_table(lines)
    if found is None:
        return ""
    names = ", ".join(f"CH{number}" if number != UNNAMED else "one channel" for number in found.channels)
    return f"{found.maker}, {names} against time"


def signal_unit(path: str, field: str, unit: str) -> tuple[str, float]:
    """The unit of samples, and the factor to it.

    The unit is "V", "A", or "" if not stated.

    Raises:
        InputError: another unit.
    """
    if unit == UNSTATED:
        return "", 1.0
    name = "A" if unit.lower() in _AMPERES else "V"
    return name, _factor(path, field, unit, {**_VOLTS, **_AMPERES}, "V or mV, A or mA, in the headings or below them")


def read_table(
    path: str, lines: Sequence[str], table: WaveformTable, *, wanted: Collection[int] | None = None
) -> dict[int, Waveform]:
    """The waveforms by channel, optionally only the `wanted` ones.

    Raises:
        InputError: a wanted channel that is truncated, an envelope, in another unit, without a unit of time, or not on
            equal time steps.
    """
    if wanted is not None:
        table = replace(table, channels={number: each for number, each in table.channels.items()
                                         if number in (UNNAMED, *wanted)})
    for form in table.settings.get("point format", ()):
        if form and form.upper() != "Y":
            raise InputError(path, "Point Format", form, "Y: samples, not an envelope of peak detection")
    time, columns = _numbers(path, lines, table)
    _check_length(path, table, len(time))
    start, step = _time_axis(path, table, time)
    found = {}
    for number, values in columns.items():
        unit, factor = signal_unit(path, f"unit of CH{number}", table.channels[number][0].unit)
        signal = factor * values
        if np.any(np.abs(signal) > OFF_SCREEN):
            raise InputError(path, f"CH{number}", float(signal[np.argmax(np.abs(signal))]),
                             "voltages; this is how the instrument writes samples outside the screen")
        quantum = _quantum(signal)
        raw = np.round((signal - 0.5 * (signal.max() + signal.min())) / quantum)
        found[number] = Waveform(number, signal, raw.astype(np.int16), start, step, quantum, clipped=False,
                                 unit=unit)
    return found


def _cells(line: str, delimiter: str) -> list[str]:
    cells = [cell.strip().strip('"').strip() for cell in line.split(delimiter)]
    while len(cells) > 1 and not cells[-1]:
        cells.pop()
    return cells


def _channel(heading: str) -> tuple[int, str, bool] | None:
    """Number, unit and envelope flag of the channel in a heading."""
    inner = re.fullmatch(r"[XY]\((.*)\)", heading)
    if inner:
        heading = inner[1]
    parts = _UNIT.match(heading)
    assert parts is not None
    named = _CHANNEL.fullmatch(parts["name"])
    if named is None:
        return None
    text = (named["number"] or named["short"]).upper()
    number = int(text) if text.isdigit() else ord(text) - ord("A") + 1
    rest = (named["rest"] or "").strip().lower()
    if rest and "peak" not in rest and "min" not in rest and "max" not in rest:
        return None
    return number, parts["bracket"] or parts["words"] or parts["slash"] or "", bool(rest)


def _by_step(lines: Sequence[str], index: int, delimiter: str) -> WaveformTable | None:
    """Columns of channels, with start and step in the heading line. Example: CH1(V),CH2(V),t0 = ..., tInc."""
    start, step = _START.search(lines[index]), _STEP.search(lines[index])
    if start is None or step is None or start[2].lower() not in _TIMES or step[2].lower() not in _TIMES:
        return None
    channels = _channels(enumerate(_cells(lines[index], delimiter)), [])
    if not channels:
        return None
    return WaveformTable("an oscilloscope's CSV (Rigol)", channels, None, float(start[1]) * _TIMES[start[2].lower()],
                         float(step[1]) * _TIMES[step[2].lower()], index + 1, delimiter, {})


def _channels(
    headings: Iterable[tuple[int, str]], units: Sequence[str], *, bare: bool = False
) -> dict[int, tuple[WaveformColumn, ...]]:
    """The columns by channel, from places and headings. `units` are those of a line below; with `bare`, a number names
    a channel."""
    channels: dict[int, tuple[WaveformColumn, ...]] = {}
    for place, cell in headings:
        named = (int(cell), "", False) if bare and re.fullmatch("[1-8]", cell) else _channel(cell)
        if named:
            unit = named[1] or (units[place] if place < len(units) else "")
            channels[named[0]] = (*channels.get(named[0], ()), WaveformColumn(place, unit, named[2]))
    return channels


def _by_headings(lines: Sequence[str], index: int, delimiter: str) -> WaveformTable | None:
    """Headings of a time and channels, with units or above units."""
    cells = _cells(lines[index], delimiter)
    parts = _UNIT.match(cells[0])
    assert parts is not None
    if not (_TIME.fullmatch(cells[0]) or _TIME.fullmatch(parts["name"])):
        return None
    keysight = cells[0].lower() == "x-axis"
    units, first = _units_below(lines, index, delimiter)
    # A second time begins a second table beside the first, with digital lines.
    end = next((place for place, cell in enumerate(cells) if place and _TIME.fullmatch(cell)), len(cells))
    headings = list(enumerate(cells))[1:end]
    channels = _channels(headings, units, bare=keysight)
    if not channels:
        return None
    settings = _settings(lines[:index], delimiter)
    unit = "s" if cells[0].lower() == "in s" else (
        parts["bracket"] or parts["words"] or parts["slash"] or (units[0] if units else ""))
    if unit.lower() == "sequence":
        stated = {cell.lower(): units[place] for place, cell in headings if place < len(units)}
        numbers = [stated.get(name, "") for name in ("start", "increment")]
        if not all(_NUMBER.fullmatch(text) for text in numbers):
            return None
        return WaveformTable("an oscilloscope's CSV (Rigol)", channels, None, float(numbers[0]), float(numbers[1]),
                             first, delimiter, settings)
    unit = unit or settings.get("horizontal units", ("",))[0]
    vertical = settings.get("vertical units", ())
    if vertical:
        # One unit for every column of samples, in their order.
        channels = {number: tuple(replace(each, unit=each.unit or vertical[min(each.place, len(vertical)) - 1])
                                  for each in columns) for number, columns in channels.items()}
    maker = next((f" ({name})" for name, recognised in (
        ("Tektronix", "point format" in settings or "firmware version" in settings), ("Keysight", keysight),
        ("Rigol", cells[0].lower() == "x" or "X(" in lines[index].upper())) if recognised), "")
    return WaveformTable(f"an oscilloscope's CSV{maker}", channels, WaveformColumn(0, unit), None, None, first,
                         delimiter, settings)


def _by_source(lines: Sequence[str], index: int, delimiter: str) -> WaveformTable | None:
    """Headings that are units, with the channels above (Siglent). Example: Source,CH1,CH2 over Second,Volt,Volt."""
    cells = _cells(lines[index], delimiter)
    if cells[0].lower() not in _TIMES or not all(cell.lower() in {*_VOLTS, "value"} for cell in cells[1:]):
        return None
    settings = _settings(lines[:index], delimiter)
    names = [_channel(cell) for cell in settings.get("source", ())]
    if not names:  # converted from a binary file: the channels of the scales
        names = [_channel(f"CH{each}") for each in re.findall(
            r"\bCH([1-8])\s*:", ",".join(settings.get("vertical scale", ())), re.IGNORECASE)]
    found = [name[0] for name in names if name]
    if len(found) != len(cells) - 1:
        return None
    vertical = dict(re.findall(r"CH([1-8])\s*:\s*([^\s,]+)", ",".join(settings.get("vertical units", ())),
                               re.IGNORECASE))
    channels = {number: (WaveformColumn(place, vertical.get(str(number), "V") if cell.lower() == "value" else cell),)
                for place, (number, cell) in enumerate(zip(found, cells[1:], strict=True), start=1)}
    return WaveformTable("an oscilloscope's CSV (Siglent)", channels, WaveformColumn(0, cells[0]), None, None,
                         index + 1, delimiter, settings)


def _by_file(lines: Sequence[str], index: int, delimiter: str) -> WaveformTable | None:
    """The only channel, whose file is named after it (LeCroy). The head is LECROY..., then Time,Ampl."""
    if [cell.lower() for cell in _cells(lines[index], delimiter)] != ["time", "ampl"] or not lines[0].lstrip(
            '"').upper().startswith("LECROY"):
        return None
    return WaveformTable("an oscilloscope's CSV (LeCroy)", {UNNAMED: (WaveformColumn(1, UNSTATED),)},
                         WaveformColumn(0, "s"), None, None, index + 1, delimiter, _settings(lines[:index], delimiter))


def _units_below(lines: Sequence[str], index: int, delimiter: str) -> tuple[list[str], int]:
    """A line of units below the headings, and the head's end. The end is the index of the line after the head."""
    if index + 1 >= len(lines):
        return [], index + 1
    cells = [cell.strip("()[] ") for cell in _cells(lines[index + 1], delimiter)]
    if cells[0].lower() in {*_TIMES, "sequence"}:
        return cells, index + 2
    return [], index + 1


def _settings(lines: Sequence[str], delimiter: str) -> dict[str, tuple[str, ...]]:
    """The lines above the headings, by their first cell in lower case."""
    found = {}
    for line in lines:
        cells = _cells(line, delimiter)
        if len(cells) > 1 and cells[0]:
            found[cells[0].lower()] = tuple(cells[1:])
    return found


def _numbers(path: str, lines: Sequence[str], table: WaveformTable) -> tuple[list[str], dict[int, NDArray[np.float64]]]:
    """The time column as printed, and the samples of every channel. Times are "" without a column."""
    places = {number: columns[0].place for number, columns in table.channels.items()}
    extremes = {number: columns[1].place for number, columns in table.channels.items() if len(columns) > 1}
    for number, columns in table.channels.items():
        if columns[0].envelope:
            raise InputError(path, f"CH{number}", "a column of extremes only", "samples, not an envelope of peak "
                             "detection, which has no phase")

    def refused(index: int, expected: str) -> InputError:
        return InputError(path, f"line {index + 1}", lines[index][:60], expected)

    needed = 1 + max(*places.values(), *extremes.values(), 0)
    times: list[str] = []
    rows: list[list[float]] = []
    ended: int | None = None
    for index in range(table.first, len(lines)):
        if not lines[index].strip(f" {table.delimiter}"):
            continue
        cells = _cells(lines[index], table.delimiter)
        cells += [""] * (needed - len(cells))
        if table.delimiter != ",":
            cells = [cell.replace(",", ".") for cell in cells]
        row = [cells[place] for place in places.values()]
        if not any(row):
            ended = index if times else None  # rows with time only, before and after the record
            continue
        if ended is not None or not all(_NUMBER.fullmatch(cell) for cell in row):
            raise refused(index if ended is None else ended,
                          "a number for every channel: " + ", ".join(f"CH{number}" for number in places))
        for number, place in extremes.items():
            if cells[place]:
                raise refused(index, f"samples of CH{number}; an envelope of peak detection has extremes only, so no "
                              "phase")
        times.append("" if table.time is None else cells[table.time.place])
        if table.time is not None and not _NUMBER.fullmatch(times[-1]):
            raise refused(index, "a number for the time")
        rows.append([float(cell) for cell in row])
    if len(times) < 4:
        raise InputError(path, "rows", f"{len(times)} samples", "a record of samples; the file is cut short")
    return times, dict(zip(places, np.array(rows).T, strict=True))


def _check_length(path: str, table: WaveformTable, count: int) -> None:
    """Check the announced number of rows, unless a part was saved."""
    segments = dict(enumerate(table.settings.get("segments", ())))
    if segments.get(0, "1") != "1":
        raise InputError(path, "Segments", segments[0], "1: one record, not a sequence")
    if segments.get(2, "0").isdecimal() and int(segments.get(2, "0")) > count:
        raise InputError(path, "rows", f"{count} samples", f"the {segments[2]} of 'SegmentSize'; the file is cut short")
    stated = re.search(r"\d+(?:\.\d+)?(?:[eE][+-]?\d+)?", ",".join(table.settings.get("record length", ())))
    gating = table.settings.get("gating", ("0.0% to 100.0%",))[0].replace(" ", "")
    if stated is None or gating != "0.0%to100.0%":
        return
    if round(float(stated[0])) != count:
        raise InputError(path, "rows", f"{count} samples", f"the {round(float(stated[0]))} of 'Record Length'; the "
                         "file is cut short or was edited")


def _time_axis(path: str, table: WaveformTable, printed: Sequence[str]) -> tuple[float, float]:
    """The time of the first sample and the step (s)."""
    if table.time is None:
        assert table.start is not None
        assert table.step is not None
        if not table.step > 0.0:
            raise InputError(path, "time step", table.step, "a step above zero")
        return table.start, table.step
    unit = _factor(path, "unit of the time", table.time.unit, _TIMES, "s, ms, us or ns: in the headings, as in "
                   "'Time (s)', or in a line below them")
    time = unit * np.array([float(cell) for cell in printed])
    count = np.arange(len(time)) - 0.5 * (len(time) - 1)
    step = float(count @ time / (count @ count))
    digit = unit * float(np.median([_last_digit(cell) for cell in printed]))
    even = time.mean() + step * count
    apart = np.abs(time - even)
    if not step > 0.0 or np.any(apart > UNEVEN * step + digit):
        index = int(np.argmax(apart))
        raise InputError(path, f"time of sample {index + 1}", f"{time[index]:.9g} s",
                         f"even steps: {even[index]:.9g} s, at {step:.6g} s a sample")
    interval = re.search(r"(?:^|:)\s*([+-]?[\d.]+(?:[eE][+-]?\d+)?)", ",".join(
        table.settings.get("sample interval", ())[:1]))
    if interval and abs(float(interval[1]) - step) <= digit / (len(time) - 1) + 1e-6 * step:
        return float(even[0]), float(interval[1])
    # At least two standard deviations of the slope of a line through times that are rounded to a digit.
    uncertain = digit / len(time) ** 1.5
    if uncertain > COARSE_STEP * step:
        raise InputError(path, "time", f"{printed[0]} to {printed[-1]}", f"a time of more digits: of {len(time)} "
                         f"samples the step is known to {100.0 * uncertain / step:.2g} % only, and so is the frequency")
    return float(even[0]), step


def _last_digit(cell: str) -> float:
    """The value of the last digit of a printed number."""
    found = _NUMBER.fullmatch(cell)
    assert found is not None
    decimals = found["decimals"] if found["decimals"] is not None else found["after"]
    return float(10.0 ** (int(found["exponent"] or 0) - len(decimals or "")))


def _factor(path: str, field: str, unit: str, known: Mapping[str, float], expected: str) -> float:
    if unit.lower() not in known:
        raise InputError(path, field, unit or None, expected)
    return known[unit.lower()]


def _quantum(signal: NDArray[np.float64]) -> float:
    """The converter's step (V): the least difference of two values."""
    differences = np.diff(np.unique(signal))
    differences = differences[differences > SAME_VALUE * float(np.ptp(signal))] if differences.size else differences
    return float(differences.min()) if differences.size else 1.0
