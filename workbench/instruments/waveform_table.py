"""Waveforms that oscilloscopes save as one CSV table: a column of time, or its start and step, and a column per
channel.

It reads the files of Rigol (DS1000E, DS1000Z, MSO5000), Siglent (SDS1000, SDS2000), Tektronix (DPO, MSO, MDO, TBS2000),
Keysight InfiniiVision, and any table whose headings are a time and channels, each with its unit. Layouts are those of
public readers and captures of these instruments. If a step is stated and the printed time agrees with it, the stated
step is used, since some makers print the time in too few digits.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.instruments.instrument import Waveform

#: Number of lines in which headings are looked for; the longest head seen (Tektronix MSO) has 21.
HEAD_LINES = 60

#: Largest deviation of samples from even steps, as a share of a step and beyond the rounding of printed digits, in one
#: record. Doubled, a jump of a twenty-fifth of a step is taken for rounding.
UNEVEN = 0.02

#: Largest relative uncertainty of a step from printed times; a coarser one is refused, since every frequency would be
#: wrong by as much.
COARSE_STEP = 1e-3

#: Voltage (V) above which a value marks a sample that left the screen.
OFF_SCREEN = 1e30

#: Largest difference, as a share of the range of a signal, that is rounding and not a step of the converter (16 bit is
#: 1.5e-5).
SAME_VALUE = 5e-6

#: The readable files, for messages.
READ = ("a waveform in CSV of Tektronix (TDS, TBS, DPO, MSO, MDO), Rigol, Siglent or Keysight InfiniiVision, an ISF "
        "file, or a table headed time, CH1, CH2 with their units: Time (s),CH1 (V),CH2 (V)")

_TIMES = {"s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6,
          "ns": 1e-9, "ps": 1e-12}
_VOLTS = {"v": 1.0, "volt": 1.0, "volts": 1.0, "mv": 1e-3, "uv": 1e-6, "µv": 1e-6, "μv": 1e-6, "kv": 1e3}

_UNIT = re.compile(r"(?P<name>.*?)\s*(?:[(\[]\s*(?P<bracket>[^()\[\]]+?)\s*[)\]]|\s+in\s+(?P<words>\S+)"
                   r"|\s*/\s*(?P<slash>[^\s/]+))?$")
_CHANNEL = re.compile(r"(?:CH(?:AN(?:NEL)?)?[\s_-]*(?P<number>[1-8A-H])|C(?P<short>[1-8]))(?P<rest>[\s_-].*)?",
                      re.IGNORECASE)
_TIME = re.compile(r"time|t|x|x-axis|in s|second", re.IGNORECASE)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?(?P<decimals>\d*)|\.(?P<after>\d+))(?:[eE](?P<exponent>[+-]?\d+))?")
_START = re.compile(r"\bt0\s*=\s*([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*(\w+)", re.IGNORECASE)
_STEP = re.compile(r"\btInc\s*=\s*([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*(\w+)", re.IGNORECASE)


@dataclass(frozen=True)
class WaveformColumn:
    """A column from 0 and the unit that the file gives it ("" for none); ``envelope`` if it holds extremes."""

    place: int
    unit: str
    envelope: bool = False


@dataclass(frozen=True)
class WaveformTable:
    """The place of the samples in a file, by its head.

    ``maker`` in words; ``channels`` by number; ``time`` the column of time, or None if only ``start`` and ``step`` (s)
    are given; ``first`` the index of the line after the head; ``settings`` the lines above the headings.
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
    """The lines of a text file in any encoding that instruments write."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return tuple(data.decode("utf-16", "replace").lstrip("\ufeff").splitlines())
    try:
        return tuple(data.decode("utf-8-sig").splitlines())
    except UnicodeDecodeError:
        return tuple(data.decode("latin-1").splitlines())


def waveform_table(lines: Sequence[str]) -> WaveformTable | None:
    """The place of the samples in a file of these `lines`, or None if its head is not that of an oscilloscope's table.
    """
    for index, line in enumerate(lines[:HEAD_LINES]):
        for delimiter in (",", ";", "\t"):
            cells = _cells(line, delimiter)
            if len(cells) < 2:
                continue
            found = _by_step(lines, index, delimiter) or _by_headings(lines, index, delimiter) or _by_source(
                lines, index, delimiter)
            if found is not None:
                return found
    return None


def recognised(lines: Sequence[str]) -> str:
    """A description of the file if it is a table of an oscilloscope; otherwise ""."""
    found = waveform_table(lines)
    if found is None:
        return ""
    return f"{found.maker}, {', '.join(f'CH{number}' for number in found.channels)} against time"


def read_table(path: str, lines: Sequence[str], table: WaveformTable) -> dict[int, Waveform]:
    """The waveforms by channel.

    Raises:
        InputError: cut short, an envelope, not in volts, without a unit of time, or not on even time steps.
    """
    for form in table.settings.get("point format", ()):
        if form and form.upper() != "Y":
            raise InputError(path, "Point Format", form, "Y: samples, not an envelope of peak detection")
    time, columns = _numbers(path, lines, table)
    _check_length(path, table, len(time))
    start, step = _time_axis(path, table, time)
    found = {}
    for number, values in columns.items():
        column = table.channels[number][0]
        volts = _factor(path, f"unit of CH{number}", column.unit, _VOLTS, "V or mV, in the headings or below them")
        signal = volts * values
        if np.any(np.abs(signal) > OFF_SCREEN):
            raise InputError(path, f"CH{number}", float(signal[np.argmax(np.abs(signal))]),
                             "voltages; this is how the instrument writes what left the screen")
        quantum = _quantum(signal)
        raw = np.round((signal - 0.5 * (signal.max() + signal.min())) / quantum)
        found[number] = Waveform(number, signal, raw.astype(np.int16), start, step, quantum, clipped=False)
    return found


# --------------------------------------------------------------------------------------------------------------------
# The head


def _cells(line: str, delimiter: str) -> list[str]:
    cells = [cell.strip().strip('"').strip() for cell in line.split(delimiter)]
    while len(cells) > 1 and not cells[-1]:
        cells.pop()
    return cells


def _channel(heading: str) -> tuple[int, str, bool] | None:
    """Number and unit of the channel that a heading names, and whether it is an envelope."""
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
    """A table with columns of channels alone, and start and step of the time in the heading line: CH1(V),CH2(V),t0 =
    ..., tInc."""
    start, step = _START.search(lines[index]), _STEP.search(lines[index])
    if start is None or step is None or start[2].lower() not in _TIMES or step[2].lower() not in _TIMES:
        return None
    channels: dict[int, tuple[WaveformColumn, ...]] = {}
    for place, cell in enumerate(_cells(lines[index], delimiter)):
        named = _channel(cell)
        if named:
            channels[named[0]] = (*channels.get(named[0], ()), WaveformColumn(place, named[1], named[2]))
    if not channels:
        return None
    return WaveformTable("an oscilloscope's CSV (Rigol)", channels, None, float(start[1]) * _TIMES[start[2].lower()],
                         float(step[1]) * _TIMES[step[2].lower()], index + 1, delimiter, {})


def _by_headings(lines: Sequence[str], index: int, delimiter: str) -> WaveformTable | None:
    """A table with headings of a time and channels, in one line with their units or above a line of units."""
    cells = _cells(lines[index], delimiter)
    parts = _UNIT.match(cells[0])
    assert parts is not None
    if not (_TIME.fullmatch(cells[0]) or _TIME.fullmatch(parts["name"])):
        return None
    keysight = cells[0].lower() == "x-axis"
    units, first = _units_below(lines, index, delimiter)
    channels: dict[int, tuple[WaveformColumn, ...]] = {}
    stated = {}
    for place, cell in enumerate(cells[1:], start=1):
        if _TIME.fullmatch(cell):
            break  # a second table beside the first, of digital lines
        if cell.lower() in ("start", "increment"):
            stated[cell.lower()] = units[place] if place < len(units) else ""
            continue
        named = (int(cell), "", False) if keysight and re.fullmatch("[1-8]", cell) else _channel(cell)
        if named:
            below = units[place] if place < len(units) else ""
            channels[named[0]] = (*channels.get(named[0], ()), WaveformColumn(place, named[1] or below, named[2]))
    if not channels:
        return None
    settings = _settings(lines[:index], delimiter)
    unit = "s" if cells[0].lower() == "in s" else (
        parts["bracket"] or parts["words"] or parts["slash"] or (units[0] if units else ""))
    if unit.lower() == "sequence":
        numbers = [stated.get(name, "") for name in ("start", "increment")]
        if not all(_NUMBER.fullmatch(text) for text in numbers):
            return None
        return WaveformTable("an oscilloscope's CSV (Rigol)", channels, None, float(numbers[0]), float(numbers[1]),
                             first, delimiter, settings)
    horizontal = settings.get("horizontal units", ())
    unit = unit or (horizontal[0] if horizontal else "")
    vertical = settings.get("vertical units", ())
    if vertical:
        # One for every column of samples, in their order.
        channels = {number: tuple(
            WaveformColumn(each.place, each.unit or vertical[min(each.place, len(vertical)) - 1], each.envelope)
            for each in columns) for number, columns in channels.items()}
    maker = ("an oscilloscope's CSV (Tektronix)" if "point format" in settings or "firmware version" in settings
             else "an oscilloscope's CSV (Keysight)" if keysight
             else "an oscilloscope's CSV (Rigol)" if cells[0].lower() == "x" or "X(" in lines[index].upper()
             else "an oscilloscope's CSV")
    return WaveformTable(maker, channels, WaveformColumn(0, unit), None, None, first, delimiter, settings)


def _by_source(lines: Sequence[str], index: int, delimiter: str) -> WaveformTable | None:
    """A table whose headings are units, with the channels named above: Source,CH1,CH2 over Second,Volt,Volt (Siglent).
    """
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
    channels = {}
    for place, number in enumerate(found, start=1):
        unit = cells[place] if cells[place].lower() != "value" else vertical.get(str(number), "V")
        channels[number] = (WaveformColumn(place, unit),)
    return WaveformTable("an oscilloscope's CSV (Siglent)", channels, WaveformColumn(0, cells[0]), None, None,
                         index + 1,
                         delimiter, settings)


def _units_below(lines: Sequence[str], index: int, delimiter: str) -> tuple[list[str], int]:
    """The cells of a line of units below the headings, and the index of the line after the head."""
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


# --------------------------------------------------------------------------------------------------------------------
# The samples


def _numbers(path: str, lines: Sequence[str], table: WaveformTable) -> tuple[list[str], dict[int, NDArray[np.float64]]]:
    """The cells of the time column as printed ("" if there is none), and the samples of every channel."""
    places = {number: columns[0].place for number, columns in table.channels.items()}
    extremes = {number: columns[1].place if len(columns) > 1 else None for number, columns in table.channels.items()}
    for number, columns in table.channels.items():
        if columns[0].envelope:
            raise InputError(path, f"CH{number}", "a column of extremes alone", "samples, not an envelope of peak "
                             "detection, from which no phase can be had")
    needed = max(places.values()) + 1
    times: list[str] = []
    values: dict[int, list[float]] = {number: [] for number in places}
    ended = 0
    for index in range(table.first, len(lines)):
        if not lines[index].strip(f" {table.delimiter}"):
            continue
        cells = _cells(lines[index], table.delimiter)
        cells += [""] * (needed - len(cells))
        if not any(cells[place] for place in places.values()):
            ended = index + 1 if times else 0  # rows of time alone, before and after the record
            continue
        row = [cells[place] if table.delimiter == "," else cells[place].replace(",", ".") for place in places.values()]
        if ended or not all(_NUMBER.fullmatch(cell) for cell in row):
            raise InputError(path, f"line {ended or index + 1}", lines[(ended or index + 1) - 1][:60],
                             "a number for every channel: " + ", ".join(f"CH{number}" for number in places))
        for number, place in extremes.items():
            if place is not None and place < len(cells) and cells[place]:
                raise InputError(path, f"line {index + 1}", lines[index][:60], f"samples of CH{number}; an envelope of "
                                 "peak detection holds extremes, from which no phase can be had")
        for number, cell in zip(places, row, strict=True):
            values[number].append(float(cell))
        if table.time is None:
            times.append("")
            continue
        cell = cells[table.time.place] if table.delimiter == "," else cells[table.time.place].replace(",", ".")
        if not _NUMBER.fullmatch(cell):
            raise InputError(path, f"line {index + 1}", lines[index][:60], "a number for the time")
        times.append(cell)
    if len(times) < 4:
        raise InputError(path, "rows", f"{len(times)} samples", "a record of samples; the file is cut short")
    return times, {number: np.array(each) for number, each in values.items()}


def _check_length(path: str, table: WaveformTable, count: int) -> None:
    """Check that the file has as many rows as it announces, unless a part of the record was saved."""
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
    stated = _stated_step(table)
    if stated is not None and abs(stated - step) <= digit / (len(time) - 1) + 1e-6 * step:
        return float(even[0]), stated
    # For a line through times that are each rounded to a digit, two standard deviations or more.
    uncertain = digit / len(time) ** 1.5
    if uncertain > COARSE_STEP * step:
        raise InputError(path, "time", f"{printed[0]} to {printed[-1]}", f"a time of more digits: of {len(time)} "
                         f"samples the step is known to {100.0 * uncertain / step:.2g} % only, and so is the frequency")
    return float(even[0]), step


def _stated_step(table: WaveformTable) -> float | None:
    """The step (s) that the head states, or None."""
    stated = re.search(r"(?:^|:)\s*([+-]?[\d.]+(?:[eE][+-]?\d+)?)", ",".join(
        table.settings.get("sample interval", ())[:1]))
    return float(stated[1]) if stated else None


def _last_digit(cell: str) -> float:
    """The weight of the last digit of a number as it is printed."""
    found = _NUMBER.fullmatch(cell)
    assert found is not None
    decimals = found["decimals"] if found["decimals"] is not None else found["after"]
    return float(10.0 ** (int(found["exponent"] or 0) - len(decimals or "")))


def _factor(path: str, what: str, unit: str, known: Mapping[str, float], expected: str) -> float:
    if unit.lower() not in known:
        raise InputError(path, what, unit or None, expected)
    return known[unit.lower()]


def _quantum(signal: NDArray[np.float64]) -> float:
    """The step of the converter (V): the least difference of two values in the record."""
    differences = np.diff(np.unique(signal))
    differences = differences[differences > SAME_VALUE * float(np.ptp(signal))] if differences.size else differences
    return float(differences.min()) if differences.size else 1.0
