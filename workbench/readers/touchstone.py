"""Touchstone files (.s1p, .y1p, .z1p, .s2p, .ts), versions 1.0 to 2.1; network analysers use e^{+j w t}, like a
spectrum.

The IBIS Open Forum's specification, versions 1.1 and 2.0 (2009) and 2.1 (2024), rules: options of the line ``#`` stand
in any order and default to GHz, S, MA and R 50; in version 1 all parameters are normalised to R, so that z = Z / R and
y = Y R; in version 2 Z is in ohm and Y in siemens. scikit-rf 1.x multiplies y by R where it must divide.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.files.quantities import UNITS
from workbench.readers.findings import Finding
from workbench.readers.quantities import THROUGH, RecordedQuantity
from workbench.readers.sweep import Recorded, in_order
from workbench.readers.text import RecordingText, cell_number, is_number
from workbench.results.spectrum import Origin

_FREQUENCIES: Mapping[str, float] = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9, "thz": 1e12}
_PARAMETERS = ("s", "y", "z", "g", "h")
#: Form and unit of two columns by the format of a file.
_FORMATS: Mapping[str, tuple[str, str]] = {"ri": ("rectangular", "ohm"), "ma": ("polar", "ohm"), "db": ("polar", "dB")}
_SUFFIX = re.compile(r"\.[syzgh](\d+)p")
_KEYWORD = re.compile(r"\[([^\]]*)\]\s*(.*)")

#: A frequency (Hz) no network analyser reaches: without a line of options a file is in gigahertz by the standard, and a
#: frequency above this shows that it is in hertz. Doubled, nothing changes.
_NO_ANALYSER_HZ = 3e12


@dataclass(frozen=True)
class Options:
    """Content of the line ``#`` and of the keywords: factor to hertz, parameter, format, reference resistance of every
    port (ohm), ``version`` (1 or 2), number of ``ports`` (0: not stated), and whether a line ``#`` ``stands`` there."""

    unit: float = 1e9
    parameter: str = "s"
    form: str = "ma"
    reference: tuple[float, ...] = (50.0,)
    version: int = 1
    ports: int = 0
    stands: bool = False
    frequencies: int | None = None
    matrix: str = "full"


def recognises_touchstone(text: RecordingText) -> bool:
    suffix = Path(text.path).suffix.casefold()
    if _SUFFIX.fullmatch(suffix):
        return True
    first = next((line.strip() for line in text.lines if line.strip() and not line.strip().startswith("!")), "")
    if first.casefold().startswith("[version]"):
        return True
    words = first[1:].split("!")[0].casefold().split() if first.startswith("#") else []
    known = (*_FREQUENCIES, *_PARAMETERS, *_FORMATS, "r")
    # A comment may begin with one of these letters; a line of options has no other words, and more than one.
    return len(words) > 1 and words[0] in known and all(word in known or is_number(word) for word in words)


def parse_touchstone(text: RecordingText) -> Recorded:
    """Read the file; of several ports, the impedance at port 1.

    Raises:
        InputError: an unknown option or keyword, hybrid parameters (G, H), mixed modes, rows of a wrong length or
            number, an impedance that is zero or infinite.
    """
    options, data = _options(text)
    suffix = _SUFFIX.fullmatch(Path(text.path).suffix.casefold())
    ports = options.ports or (int(suffix[1]) if suffix else 0) or (2 if data and len(data[0][1]) >= 9 else 1)
    if options.parameter in "gh":
        raise InputError(text.path, "Touchstone", options.parameter.upper(), "S, Y or Z: hybrid parameters (G, H) mix "
                         "the voltage of one port with the current of the other, and there is no impedance of one port "
                         "in them alone; export S, Y or Z")
    values, lines = _records(text, data, options, ports)
    if options.frequencies is not None and options.frequencies != len(lines):
        raise text.error(data[-1][0] if data else len(text.lines), None, f"{len(lines)} frequencies",
                         f"the {options.frequencies} of [Number of Frequencies]; the file may be cut short")
    frequency = values[:, 0] * options.unit
    if not options.stands and np.nanmax(frequency, initial=0.0) > _NO_ANALYSER_HZ:
        raise InputError(text.path, "Touchstone", f"frequencies to {np.max(values[:, 0]):g} and no line of options",
                         "a line such as '# HZ S RI R 50' above the rows: without one they are gigahertz, S as "
                         "magnitude and angle, and 50 ohm")
    impedance = _impedance(values[:, 1:3], options)
    notes = [line.lstrip(" !").strip() for line in text.lines if line.strip().startswith("!")]
    said = next((" ".join(line.strip()[1:].split("!")[0].split()) for line in text.lines
                 if line.strip().startswith("#")), "")
    settings = {"option line": said} | {f"comment {i}": note for i, note in enumerate(notes, 1) if note}
    origin = Origin("measured", text.path, text.sha256, settings={k: v for k, v in settings.items() if v})
    findings = []
    if not options.stands:
        findings.append(Finding("options", "no line of options (#): read by the standard's defaults as frequencies in "
                                "GHz and S as magnitude and angle in degrees, at 50 ohm"))
    if ports > 1:
        findings.append(_ports(values, options, ports))
    return in_order(text, frequency, impedance, lines=lines, column=1, origin=origin, cells=list(values.T[1:3]),
                    findings=findings)


def _ports(values: NDArray[np.float64], options: Options, ports: int) -> Finding:
    """The finding on a file of several ports."""
    letter = options.parameter.upper()
    ends = {"s": f"ended with {options.reference[-1]:g} ohm", "z": "open", "y": "shorted"}[options.parameter]
    rest = "port 2" if ports == 2 else "the other ports"
    words = f"{ports} ports: the impedance at port 1 was read from {letter}11, {rest} {ends}"
    if options.parameter == "s" and options.matrix == "full" and len(values):
        coupled = float(np.nanmax(np.abs(_complex(values[:, 3:5], options))))
        if coupled > THROUGH:
            form, unit = _FORMATS[options.form][0], "dB" if options.form == "db" else "1"
            words += f". |S21| reaches {coupled:.2g}: a device between the ports is not what S11 shows"
            factor = next((name for name, size in UNITS["frequency"].items() if size == options.unit), "")
            if ports == 2 and factor:
                words += (". For one in shunt with the line (or in series) give --columns MAP.toml with the lines "
                          f'frequency = 1; first = 4; second = 5; frequency_unit = "{factor}"; delimiter = " "; '
                          f'quantity = {{ kind = "transmission", form = "{form}", unit = "{unit}", '
                          f'reference_resistance = {options.reference[0]:g}, configuration = "shunt" }}')
    return Finding("ports", words)


def _options(text: RecordingText) -> tuple[Options, list[tuple[int, list[str]]]]:
    """The options, and the lines of data as words."""
    options, data = Options(), list[tuple[int, list[str]]]()
    wants_reference, information, noise = 0, False, False
    for line, raw in enumerate(text.lines, 1):
        content = raw.split("!")[0].strip()
        if not content:
            continue
        keyword = _KEYWORD.fullmatch(content)
        if keyword is not None:
            name, value = keyword[1].strip().casefold(), keyword[2].strip()
            information = name == "begin information" or (information and name != "end information")
            noise = noise or name == "noise data"
            if name == "end":
                break
            options = _keyword(text, line, options, name, value)
            wants_reference = 0
            if name == "reference":
                stated = _numbers(text, line, value.split())
                options = replace(options, reference=stated or options.reference)
                wants_reference = max(options.ports, 1) - len(stated)
        elif information or noise:
            continue
        elif content.startswith("#"):
            # The standard ignores a second line of options.
            options = options if options.stands else _option_line(text, line, options, content[1:].split())
        elif wants_reference > 0:
            more = _numbers(text, line, content.split())
            known = options.reference if wants_reference < max(options.ports, 1) else ()
            options = replace(options, reference=(*known, *more))
            wants_reference -= len(more)
        else:
            data.append((line, content.split()))
    return options, data


def _keyword(text: RecordingText, line: int, options: Options, name: str, value: str) -> Options:
    """The options, updated by a keyword of version 2."""
    match name:
        case "version":
            if not value.startswith(("1", "2")):
                raise text.error(line, None, value, "version 1.0, 1.1, 2.0 or 2.1")
            return replace(options, version=int(value[0]))
        case "number of ports" | "number of frequencies":
            if not value.isdigit() or int(value) < 1:
                raise text.error(line, None, value, "a whole number above zero")
            return replace(options, ports=int(value)) if name == "number of ports" else replace(
                options, frequencies=int(value))
        case "matrix format":
            if value.casefold() not in ("full", "lower", "upper"):
                raise text.error(line, None, value, "Full, Lower or Upper")
            return replace(options, matrix=value.casefold())
        case "mixed-mode order":
            raise text.error(line, None, value, "single-ended ports; a mixed mode is no impedance of one port")
        case "two-port data order" | "reference" | "network data" | "noise data" | "number of noise frequencies":
            # S11 stands first in either order.
            return options
        case "begin information" | "end information":
            return options
    # Information keywords and those of later versions change no number.
    return options


def _option_line(text: RecordingText, line: int, options: Options, words: Sequence[str]) -> Options:
    """The options of a line ``#``, which stand in any order."""
    found: dict[str, object] = {"stands": True}
    plain = [word.casefold() for word in words]
    index = 0
    while index < len(plain):
        word = plain[index]
        if word in _FREQUENCIES:
            found["unit"] = _FREQUENCIES[word]
        elif word in _PARAMETERS:
            found["parameter"] = word
        elif word in _FORMATS:
            found["form"] = word
        elif word == "r" or (word.startswith("r") and is_number(word[1:])):
            values = [word[1:]] if word != "r" else []
            while index + 1 < len(plain) and is_number(plain[index + 1]):
                index += 1
                values.append(plain[index])
            found["reference"] = _numbers(text, line, values)
            if not found["reference"]:
                raise text.error(line, None, " ".join(words), "a resistance in ohm behind R")
        else:
            raise text.error(line, None, words[index], "options: a unit (Hz, kHz, MHz, GHz), a parameter (S, Y, Z), a "
                             "format (RI, MA, DB) and R with a resistance in ohm")
        index += 1
    return replace(options, **found)  # type: ignore[arg-type]


def _numbers(text: RecordingText, line: int, words: Sequence[str]) -> tuple[float, ...]:
    """Resistances above zero."""
    found = tuple(cell_number(text, line, column, cell=word) for column, word in enumerate(words, 1))
    if not all(value > 0.0 for value in found):
        raise text.error(line, None, " ".join(words), "a resistance above zero")
    return found


def _records(
    text: RecordingText, data: Sequence[tuple[int, list[str]]], options: Options, ports: int
) -> tuple[NDArray[np.float64], list[int]]:
    """Rows (n, 1 + 2 entries) of frequency and parameters, and the line each begins on."""
    entries = ports * ports if options.matrix == "full" else ports * (ports + 1) // 2
    width = 1 + 2 * entries
    rows: list[list[float]] = []
    lines: list[int] = []
    for index, (line, words) in enumerate(data):
        row = [cell_number(text, line, column, cell=word) for column, word in enumerate(words, 1)]
        continued = bool(rows) and len(rows[-1]) < width
        if continued and (ports > 2 or options.version == 2):
            rows[-1] += row
        elif ports == 2 and len(row) == 5 and rows and row[0] <= rows[-1][0] and all(
                len(other) == 5 for _, other in data[index:]):
            # Noise parameters follow the network's, at a frequency that does not rise.
            break
        else:
            rows.append(row)
            lines.append(line)
        wraps = ports > 2 or options.version == 2
        if len(rows[-1]) > width or (len(rows[-1]) < width and not wraps):
            raise text.error(line, None, text.lines[line - 1], f"{width} columns; this row has {len(rows[-1])}")
    if rows and len(rows[-1]) < width:
        raise text.error(lines[-1], None, text.lines[lines[-1] - 1], f"{width} numbers; the file may be cut short")
    return np.array(rows).reshape(len(rows), width), lines


def _complex(pair: NDArray[np.float64], options: Options) -> NDArray[np.complex128]:
    """The parameter (n,) that two columns hold."""
    return RecordedQuantity("impedance", *_FORMATS[options.form]).impedance(pair[:, 0], pair[:, 1])


def _impedance(pair: NDArray[np.float64], options: Options) -> NDArray[np.complex128]:
    """Impedance Z (n,) ohm at port 1."""
    value, resistance = _complex(pair, options), options.reference[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        match options.parameter:
            case "s":
                return np.asarray(resistance * (1.0 + value) / (1.0 - value))
            case "z":
                return np.asarray(value * (resistance if options.version == 1 else 1.0))
            case _:
                return np.asarray((resistance if options.version == 1 else 1.0) / value)
