"""Touchstone files (.s1p, .y1p, .z1p, .s2p, .ts), versions 1.0 to 2.1.

Network analysers use e^{+j w t}, like a spectrum. The IBIS Open Forum's specification, versions 1.1 and 2.0 (2009) and
2.1 (2024), rules: options of the line ``#`` stand in any order and default to GHz, S, MA and R 50; in version 1 all
parameters are normalised to R, so that z = Z / R and y = Y R; in version 2 Z is in ohm and Y in siemens. scikit-rf 1.x
multiplies y by R where it must divide.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.files.quantities import UNITS
from workbench.readers.columns import ColumnMap, map_text, recorded
from workbench.readers.findings import Finding
from workbench.readers.quantities import MAGNITUDE_UNITS, THROUGH, RecordedQuantity
from workbench.readers.sweep import Reading
from workbench.readers.tables import Table
from workbench.readers.text import RecordingText, cell_number, is_number

_FREQUENCIES: Mapping[str, float] = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9, "thz": 1e12}
#: Kind of a parameter; hybrid ones have none.
_PARAMETERS: Mapping[str, str] = {"s": "reflection", "y": "admittance", "z": "impedance", "g": "", "h": ""}
_FORMS: Mapping[str, str] = {"ri": "rectangular", "ma": "polar", "db": "polar"}
_SUFFIX = re.compile(r"\.[syzgh](\d+)p")
#: Keywords of sections that hold no parameters of the network.
_NOT_READ = ("begin information", "noise data")
_KEYWORD = re.compile(r"\[([^\]]*)\]\s*(.*)")

#: A frequency (Hz) no network analyser reaches: without a line of options a file is in gigahertz by the standard, and a
#: frequency above this shows that it is in hertz. Doubled, nothing changes.
_NO_ANALYSER_HZ = 3e12


@dataclass
class Options:
    """Content of the line ``#`` and of the keywords.

    Factor to hertz, parameter, format, reference resistance of every port (ohm), ``version`` (1 or 2), number of
    ``ports`` (0: not stated), and whether a line ``#`` ``stands`` there.
    """

    unit: float = 1e9
    parameter: str = "s"
    form: str = "ma"
    reference: tuple[float, ...] = (50.0,)
    version: int = 1
    ports: int = 0
    stands: bool = False
    frequencies: int | None = None
    matrix: str = "full"

    def quantity(self, kind: str, **more: object) -> RecordedQuantity:
        """The quantity of that kind in the format of the file."""
        unit = "dB" if self.form == "db" else next(iter(MAGNITUDE_UNITS[kind]))
        return RecordedQuantity(kind, _FORMS[self.form], unit, **more)  # type: ignore[arg-type]


def recognises_touchstone(text: RecordingText) -> bool:
    """Whether a file is of Touchstone, by name or first line."""
    first = next((line.strip() for line in text.lines if line.strip() and not line.strip().startswith("!")), "")
    if _SUFFIX.fullmatch(Path(text.path).suffix.casefold()) or first.casefold().startswith("[version]"):
        return True
    words = first[1:].split("!")[0].casefold().split() if first.startswith("#") else []
    known = (*_FREQUENCIES, *_PARAMETERS, *_FORMS, "r")
    # A comment may begin with one of these letters; a line of options has no other words, and more than one.
    return len(words) > 1 and words[0] in known and all(word in known or is_number(word) for word in words)


def parse_touchstone(text: RecordingText) -> Reading:
    """Read the file; of several ports, the impedance at port 1.

    Raises:
        InputError: an unknown option or keyword, hybrid parameters (G, H), mixed modes, rows of a wrong length or
            number, an impedance that is zero or infinite.
    """
    options, data = _content(text)
    suffix = _SUFFIX.fullmatch(Path(text.path).suffix.casefold())
    ports = options.ports or (int(suffix[1]) if suffix else 0) or (2 if data and len(data[0][1]) >= 9 else 1)
    kind, reference = _PARAMETERS[options.parameter], options.reference[0]
    if not kind:
        raise InputError(text.path, "Touchstone", options.parameter.upper(), "S, Y or Z: hybrid parameters (G, H) mix "
                         "the voltage of one port with the current of the other, and there is no impedance of one port "
                         "in them alone; export S, Y or Z")
    values, lines = _records(text, data, options, ports)
    if options.frequencies is not None and options.frequencies != len(lines):
        raise text.error(data[-1][0] if data else len(text.lines), None, f"{len(lines)} frequencies",
                         f"the {options.frequencies} of [Number of Frequencies]; the file may be cut short")
    findings = []
    if not options.stands:
        if np.nanmax(values[:, 0] * options.unit, initial=0.0) > _NO_ANALYSER_HZ:
            raise InputError(text.path, "Touchstone", f"frequencies to {np.max(values[:, 0]):g} and no line of options",
                             "a line such as '# HZ S RI R 50' above the rows: without one they are gigahertz, S as "
                             "magnitude and angle, and 50 ohm")
        findings.append(Finding("options", "no line of options (#): read by the standard's defaults as frequencies in "
                                "GHz and S as magnitude and angle in degrees, at 50 ohm"))
    if ports > 1:
        findings.append(_ports(values, options, ports))
    stripped = [line.strip() for line in text.lines]
    said = next((" ".join(line[1:].split("!")[0].split()) for line in stripped if line.startswith("#")), "")
    notes = [line.lstrip(" !") for line in stripped if line.startswith("!")]
    settings = {"option line": said, **{f"comment {i}": note for i, note in enumerate(notes, 1)}}
    quantity = options.quantity(kind, **({"reference_resistance": reference} if kind == "reflection" else {}))
    return recorded(Table(text, (), 0, 0, " ", 3, lines=tuple(lines)), ColumnMap(1, 2, 3, quantity),
                    [values[:, 0] * options.unit, values[:, 1], values[:, 2]], 0,
                    text.origin(settings={key: each for key, each in settings.items() if each}),
                    scale=reference if options.version == 1 and kind != "reflection" else 1.0, findings=findings)


def _ports(values: NDArray[np.float64], options: Options, ports: int) -> Finding:
    """The finding on a file of several ports."""
    letter = options.parameter.upper()
    ends = {"s": f"ended with {options.reference[-1]:g} ohm", "z": "open", "y": "shorted"}[options.parameter]
    rest = "port 2" if ports == 2 else "the other ports"
    words = f"{ports} ports: the impedance at port 1 was read from {letter}11, {rest} {ends}"
    if options.parameter == "s" and options.matrix == "full" and len(values):
        coupled = float(np.nanmax(np.abs(options.quantity("impedance").impedance(values[:, 3], values[:, 4]))))
        if coupled > THROUGH:
            words += f". |S21| reaches {coupled:.2g}: a device between the ports is not what S11 shows"
            unit = next((name for name, size in UNITS["frequency"].items() if size == options.unit), "")
            if ports == 2 and unit:
                through = ColumnMap(1, 4, 5, options.quantity(
                    "transmission", reference_resistance=options.reference[0], configuration="shunt"), unit, " ")
                words += (". For one in shunt with the line (or in series) give --columns MAP.toml with the lines "
                          + "; ".join(map_text(through).splitlines()))
    return Finding("ports", words)


def _content(text: RecordingText) -> tuple[Options, list[tuple[int, list[str]]]]:
    """The options, and the lines of data as words."""
    options, data, section = Options(), list[tuple[int, list[str]]](), ""
    for line, raw in enumerate(text.lines, 1):
        content = raw.split("!")[0].strip()
        words, keyword = content.split(), _KEYWORD.fullmatch(content)
        if keyword is not None:
            name, value = keyword[1].strip().casefold(), keyword[2].strip()
            # Keywords of an information section are in it.
            section = section if section == "begin information" and name != "end information" else name
            if name == "end":
                break
            _keyword(text, line, options, name, value)
            words = value.split() if name == "reference" else []
        if section in _NOT_READ or not (words or keyword):
            continue
        if content.startswith("#"):
            # The standard ignores a second line of options.
            if not options.stands:
                _option_line(text, line, options, content[1:].split())
        elif section == "reference":
            options.reference = (*(() if keyword else options.reference), *_resistances(text, line, words))
        elif words:
            data.append((line, words))
    options.reference = options.reference or (50.0,)
    return options, data


def _keyword(text: RecordingText, line: int, options: Options, name: str, value: str) -> None:
    """Update the options by a keyword of version 2, if it matters."""
    match name:
        case "version":
            if not value.startswith(("1", "2")):
                raise text.error(line, None, value, "version 1.0, 1.1, 2.0 or 2.1")
            options.version = int(value[0])
        case "number of ports" | "number of frequencies":
            if not value.isdigit() or int(value) < 1:
                raise text.error(line, None, value, "a whole number above zero")
            setattr(options, name.removeprefix("number of "), int(value))
        case "matrix format":
            if value.casefold() not in ("full", "lower", "upper"):
                raise text.error(line, None, value, "Full, Lower or Upper")
            options.matrix = value.casefold()
        case "mixed-mode order":
            raise text.error(line, None, value, "single-ended ports; a mixed mode is no impedance of one port")


def _option_line(text: RecordingText, line: int, options: Options, words: Sequence[str]) -> None:
    """Update the options by a line ``#``, in any order."""
    options.stands = True
    resistances: list[list[str]] = []
    for word in words:
        plain = word.casefold()
        if plain in _FREQUENCIES:
            options.unit = _FREQUENCIES[plain]
        elif plain in _PARAMETERS:
            options.parameter = plain
        elif plain in _FORMS:
            options.form = plain
        elif plain == "r" or (plain.startswith("r") and is_number(plain[1:])):
            resistances.append([plain[1:]] if plain != "r" else [])
        elif resistances and is_number(plain):
            resistances[-1].append(plain)
        else:
            raise text.error(line, None, word, "options: a unit (Hz, kHz, MHz, GHz), a parameter (S, Y, Z), a format "
                             "(RI, MA, DB) and R with a resistance in ohm")
    if not all(resistances):
        raise text.error(line, None, " ".join(words), "a resistance in ohm behind R")
    if resistances:
        options.reference = _resistances(text, line, resistances[-1])


def _resistances(text: RecordingText, line: int, words: Sequence[str]) -> tuple[float, ...]:
    """Resistances above zero."""
    found = tuple(cell_number(text, line, column, cell=word) for column, word in enumerate(words, 1))
    if not all(value > 0.0 for value in found):
        raise text.error(line, None, " ".join(words), "a resistance above zero")
    return found


def _records(
    text: RecordingText, data: Sequence[tuple[int, list[str]]], options: Options, ports: int
) -> tuple[NDArray[np.float64], list[int]]:
    """Rows (n, 1 + 2 entries) of numbers, and their lines."""
    width = 1 + 2 * (ports * ports if options.matrix == "full" else ports * (ports + 1) // 2)
    wraps = ports > 2 or options.version == 2
    rows: list[list[float]] = []
    lines: list[int] = []
    for index, (line, words) in enumerate(data):
        row = [cell_number(text, line, column, cell=word) for column, word in enumerate(words, 1)]
        if wraps and rows and len(rows[-1]) < width:
            rows[-1] += row
        elif ports == 2 and len(row) == 5 and rows and row[0] <= rows[-1][0] and all(
                len(other) == 5 for _, other in data[index:]):
            # Noise parameters follow the network's, at a frequency that does not rise.
            break
        else:
            rows.append(row)
            lines.append(line)
        if len(rows[-1]) > width or (len(rows[-1]) < width and not wraps):
            raise text.error(line, None, text.lines[line - 1], f"{width} columns; this row has {len(rows[-1])}")
    if rows and len(rows[-1]) < width:
        raise text.error(lines[-1], None, text.lines[lines[-1] - 1], f"{width} numbers; the file may be cut short")
    return np.array(rows).reshape(len(rows), width), lines
