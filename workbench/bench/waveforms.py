"""Waveforms saved by an oscilloscope, one or all channels per file.

`workbench.instruments.waveform_table` reads tables of time and channels; this module reads the CSV of the TDS1000 and
TDS2000 series of Tektronix, and ISF. CSV: settings are in columns 1 and 2 of the first rows, beside the samples (time
in column 4, volts in column 5), without headings. Numbers may look like ``-00.018940000000``, and a line may have been
added by hand. ISF: a header ``:WFMPRE:NR_PT 2500;...`` in long or short words, then the binary block of CURVE.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError, file_error
from workbench.instruments.instrument import Waveform
from workbench.instruments.waveform_table import READ, UNNAMED, decoded, read_table, signal_unit, waveform_table

_PAIR = re.compile(r"CH(\d)", re.IGNORECASE)
#: The channel in a name of LeCroy's: C1Trace00000.csv.
_SHORT = re.compile(r"(?<![A-Za-z0-9])C([1-8])(?!\d)", re.IGNORECASE)

_A_NAME = "a name with the channel in it, such as F0003CH1.CSV or C1Trace00000.csv"

#: Steps of the converter per division, in all files seen.
_STEPS_PER_DIVISION = 25.0

#: Ratio of the number of samples at a crest to that of a sine above which the waveform is clipped.
_FLAT = 3.0


def read_waveform(path: Path) -> Waveform:
    """The only waveform in a file.

    Raises:
        InputError: as :func:`read_channels`, or several channels.
    """
    found = read_channels(path)
    if len(found) != 1:
        raise InputError(str(path), "channels", ", ".join(f"CH{number}" for number in found), "one channel")
    return next(iter(found.values()))


def read_channels(path: Path, *, wanted: Collection[int] | None = None) -> dict[int, Waveform]:
    """The waveforms of a file by channel, in any of the formats.

    From a table only the `wanted` ones are read, if given.

    Raises:
        InputError: an unknown format, a truncated file, a unit other than volts or amperes, an envelope, or uneven time
            steps.
    """
    path = Path(path)
    data = _content(path)
    if data[:6].upper().startswith((b":WFMP", b"WFMP")):
        found = _read_isf(str(path), data)
    elif _is_tds(data):
        found = _read_csv(str(path), data)
    else:
        lines = decoded(data)
        table = waveform_table(lines)
        if table is None:
            raise InputError(str(path), "format", next((line[:60] for line in lines if line.strip()), ""), READ)
        waveforms = read_table(str(path), lines, table, wanted=wanted)
        if UNNAMED in waveforms:
            named = _channel_of(path)
            if named is None:
                raise InputError(str(path), "file", path.name, _A_NAME)
            waveforms = {int(named[1]): replace(waveforms[UNNAMED], channel=int(named[1]))}
        return {number: replace(each, clipped=_flat_topped(each.raw.astype(float)))
                for number, each in waveforms.items()}
    return {found.channel: found}


def _channel_of(path: Path) -> re.Match[str] | None:
    return _PAIR.search(path.name) or _SHORT.search(path.name)


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise file_error(path, f"a readable file ({error.strerror})") from None


def _is_tds(data: bytes) -> bool:
    """Whether it is CSV of the TDS1000 and TDS2000. Its settings are beside samples in columns 4 and 5."""
    return b"Record Length," in data[:2000] and any(
        re.match(rb'"?(Record Length|Sample Interval)"?,[^,]*,\s*,\s*"?[-+.\d][^,]*,\s*"?[-+.\d]', line)
        for line in data[:4000].splitlines()[:12])


def pair_files(paths: Sequence[Path], *, total: int, reference: int) -> dict[str, tuple[Path, Path]]:
    """Files in pairs (total, reference), by the common part of their names.

    A folder means its files. Names must differ only in the channel: F0003CH1.CSV and F0003CH2.CSV. A file with several
    channels is a pair with itself.

    Raises:
        InputError: an incomplete pair, or a name without a channel for a file without both.
    """
    given: dict[str, dict[int, Path]] = {}
    for path in _files(paths):
        contained = _channels_in(path)
        channel = _channel_of(path)
        if len(contained) > 1 or (contained and contained != (UNNAMED,) and channel is None):
            for wanted in (total, reference):
                if wanted not in contained:
                    raise InputError(str(path), "channels", ", ".join(f"CH{number}" for number in contained),
                                     f"CH{wanted} among them; --total and --reference select them")
            given[str(path)] = dict.fromkeys(contained, path)
            continue
        if channel is None:
            _content(path)  # raises if there is no such file
            raise InputError(str(path), "file", path.name, f"a table with all channels in it (time, CH1, CH2), or "
                             f"{_A_NAME}")
        name = path.name[:channel.start()] + path.name[channel.end():]
        given.setdefault(str(path.parent / name), {})[int(channel.group(1))] = path
    pairs: dict[str, tuple[Path, Path]] = {}
    for name, channels in sorted(given.items()):
        for wanted in (total, reference):
            if wanted not in channels:
                raise InputError(name, f"channel {wanted}", ", ".join(str(p) for p in channels.values()),
                                 f"a file of channel {wanted} beside it")
        called = Path(name).stem.strip("_- ") or Path(name).parent.name
        if called in pairs:  # of another folder, or of another format
            called = name
        pairs[called] = channels[total], channels[reference]
    return pairs


def _channels_in(path: Path) -> tuple[int, ...]:
    """The channels in the head of a table, () for other files."""
    try:
        with path.open("rb") as file:
            head = file.read(8192)
    except OSError:
        return ()
    table = None if _is_tds(head) else waveform_table(decoded(head))
    return () if table is None else tuple(table.channels)


def _files(paths: Sequence[Path]) -> list[Path]:
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = [file for file in sorted(path.iterdir())
                      if file.suffix.lower() in (".csv", ".isf", ".txt") and (
                          _channels_in(file) or (file.suffix.lower() != ".txt" and _PAIR.search(file.name)))]
            if not inside:
                raise InputError(str(path), "folder", path.name, "a folder with waveforms such as F0003CH1.CSV, or "
                                 "with tables of all channels")
            found += inside
        else:
            found.append(path)
    return found


def _read_csv(path: str, data: bytes) -> Waveform:
    lines = data.decode("utf-8", "replace").splitlines()
    settings: dict[str, str] = {}
    times: list[float] = []
    volts: list[float] = []
    for number, line in enumerate(lines, start=1):
        cells = [cell.strip().strip('"') for cell in line.split(",")]
        if len(cells) < 5:
            if any(cells):
                raise InputError(path, f"line {number}", line[:60], "setting, value, blank, time, volts")
            continue
        if cells[0]:
            settings[cells[0]] = cells[1]
        if number <= 2 and not _is_number(cells[3]) and not cells[0]:
            continue  # headings added by hand
        if not (_is_number(cells[3]) and _is_number(cells[4])):
            raise InputError(path, f"line {number}", line[:60], "time in column 4 and volts in column 5")
        times.append(float(cells[3]))
        volts.append(float(cells[4]))
    declared = round(_setting(path, settings, "Record Length"))
    if len(times) != declared:
        raise InputError(path, "rows", f"{len(times)} samples", f"the {declared} of 'Record Length'; the file is cut "
                         "short or was edited")
    unit, factor = signal_unit(path, "Vertical Units", settings.get("Vertical Units", "V"))
    if settings.get("Pt Fmt", "Y") != "Y":
        raise InputError(path, "Pt Fmt", settings["Pt Fmt"], "Y: samples, not an envelope of peak detection")
    step = _setting(path, settings, "Sample Interval")
    time = np.array(times)
    # The file has twelve decimals of a second.
    wrong = np.abs(np.diff(time) - step) > 0.01 * step + 2e-12
    if np.any(wrong):
        index = int(np.argmax(wrong))
        raise InputError(path, f"sample {index + 2}", float(time[index + 1]), f"{step:g} s after the one before it")
    quantum = factor * _setting(path, settings, "Vertical Scale") / _STEPS_PER_DIVISION
    signal = factor * np.array(volts)
    raw = np.round(signal / quantum)
    source = settings.get("Source", "")
    named = _PAIR.fullmatch(source) or _PAIR.search(Path(path).name)
    if named is None:
        raise InputError(path, "Source", source, "CH1 to CH4: a channel, not a calculated trace")
    return Waveform(int(named.group(1)), signal, raw.astype(np.int16), float(time[0]), step, quantum,
                    _flat_topped(raw), unit)


def _is_number(cell: str) -> bool:
    try:
        return bool(np.isfinite(float(cell)))
    except ValueError:
        return False


def _setting(path: str, settings: Mapping[str, str], name: str) -> float:
    text = settings.get(name)
    if text is None or not _is_number(text) or not float(text) > 0.0:
        raise InputError(path, name, text, "a number above zero")
    return float(text)


def _read_isf(path: str, data: bytes) -> Waveform:
    """The only record of samples in the file. Some firmware appends an envelope of the same acquisition."""
    samples, others, place = [], [], 0
    while place < len(data):
        header, block, place = _next_record(path, data, place)
        if _word(path, header, "PT_FMT") == "Y":
            samples.append((header, block))
        else:
            others.append(_word(path, header, "PT_FMT"))
        place = len(data) - len(data[place:].lstrip(b"\r\n; "))
    if len(samples) != 1:
        kinds = ", ".join(others) or "none"
        raise InputError(path, "PT_FMT", f"{len(samples)} records of samples (others: {kinds})",
                         "one record with PT_FMT Y; an envelope has extremes only, so no phase")
    header, block = samples[0]
    if _word(path, header, "ENCDG")[:3] != "BIN":
        raise InputError(path, "ENCDG", _word(path, header, "ENCDG"), "BINARY")
    width = round(_value(path, header, "BYT_NR"))
    kind = {"RI": "i", "RP": "u"}.get(_word(path, header, "BN_FMT"))
    order = {"MSB": ">", "LSB": "<"}.get(_word(path, header, "BYT_OR"))
    if width not in (1, 2) or kind is None or order is None:
        raise InputError(path, "BYT_NR, BN_FMT, BYT_OR",
                         [_word(path, header, word) for word in ("BYT_NR", "BN_FMT", "BYT_OR")],
                         "1 or 2 bytes, RI or RP, MSB or LSB")
    raw = np.frombuffer(block, dtype=f"{order}{kind}{width}").astype(float)
    points = round(_value(path, header, "NR_PT"))
    if len(raw) != points:
        raise InputError(path, "CURVE", f"{len(raw)} samples", f"the {points} of NR_PT")
    unit, factor = signal_unit(path, "YUNIT", _word(path, header, "YUNIT"))
    channel = re.search(r"Ch(\d)", _word(path, header, "WFID"))
    if channel is None:
        raise InputError(path, "WFID", _word(path, header, "WFID"), "a channel, not a calculated trace")
    quantum, step = factor * _value(path, header, "YMULT"), _value(path, header, "XINCR")
    volts = (raw - _value(path, header, "YOFF")) * quantum + factor * _value(path, header, "YZERO")
    start = _value(path, header, "XZERO") - _value(path, header, "PT_OFF") * step
    if kind == "u":
        raw -= 128.0 if width == 1 else 32768.0
    return Waveform(int(channel.group(1)), volts, raw.astype(np.int16), start, step, quantum, _flat_topped(raw),
                    unit)


def _next_record(path: str, data: bytes, place: int) -> tuple[dict[str, str], bytes, int]:
    """Header and block of the record at `place`, and its end."""
    found = re.compile(rb":?CURVE?\s+#").search(data, place)
    if found is None:
        raise InputError(path, "CURVE", data[place:place + 40].decode("latin-1"), "a binary block after the header")
    text = data[place:found.start()].decode("latin-1")
    # Quoted values contain commas and blanks, but no semicolons in any file seen.
    header = {}
    for item in re.split(r";(?=(?:[^\"]*\"[^\"]*\")*[^\"]*$)", text):
        word, _, value = item.strip().lstrip(":").partition(" ")
        header[word.rpartition(":")[2].upper()] = value.strip().strip('"')
    digits = data[found.end():found.end() + 1]
    if not digits.isdigit() or digits == b"0" or not data[found.end() + 1:found.end() + 1 + int(digits)].isdigit():
        raise InputError(path, "CURVE", data[found.start():found.end() + 12].decode("latin-1"),
                         "#, the number of digits, a length")
    begin = found.end() + 1 + int(digits)
    length = int(data[found.end() + 1:begin])
    if begin + length > len(data):
        raise InputError(path, "CURVE", f"{len(data) - begin} bytes",
                         f"the {length} that the block announces; the file is cut short")
    return header, data[begin:begin + length], begin + length


def _word(path: str, header: Mapping[str, str], name: str) -> str:
    """The value of a header word, which a file may shorten."""
    found = next((value for word, value in header.items() if len(word) >= 3 and name.startswith(word)), None)
    if found is None:
        raise InputError(path, name, None, "this word in the header, which has " + ", ".join(header))
    return "ENV" if name == "PT_FMT" and found.upper().startswith("ENV") else found


def _value(path: str, header: Mapping[str, str], name: str) -> float:
    text = _word(path, header, name)
    if not _is_number(text):
        raise InputError(path, name, text, "a number")
    return float(text)


def _flat_topped(raw: NDArray[np.float64]) -> bool:
    """Whether a crest is far flatter than that of a sine. The file does not state the edge of the screen. A share
    arccos(1 - 1 / a) / pi of the samples of a sine of amplitude a steps is within one step of a crest."""
    amplitude = 0.5 * float(np.ptp(raw))
    if amplitude < 10.0:
        return False
    share = float(np.arccos(1.0 - 1.0 / amplitude)) / np.pi
    crests = np.mean(raw >= raw.max() - 0.5), np.mean(raw <= raw.min() + 0.5)
    return bool(max(crests) > _FLAT * share)
