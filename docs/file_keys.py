"""Every key of bench.toml and of a campaign file, from the readers themselves.

A reader is run on an example while its tables note which keys they accept and how each is read: the unit, the range,
the choices and the default stand on the page as the code has them. The sentences are here. A key without a sentence, or
a sentence without a key, is an error: the pages cannot go stale.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

from workbench.bench.setup import read_bench
from workbench.campaign.campaign import read_campaign
from workbench.campaign.observation import OBSERVABLES
from workbench.files.quantities import UNITS
from workbench.files.tables import FileTable

ROOT = Path(__file__).resolve().parent.parent
BENCH_EXAMPLE = ROOT / "examples/whole_way/bench.toml"
CAMPAIGN_EXAMPLE = ROOT / "geometry/chips/small_campaign/campaign.toml"

#: What a key of bench.toml says, by table.
BENCH: Mapping[str, Mapping[str, str]] = {
    "The file": {
        "generator": "the generator", "oscilloscope": "the oscilloscope", "reference": "the resistor in series with "
        "the device", "sweep": "the frequencies", "drive": "voltage of the generator", "limits": "largest "
        "voltage and current of the device", "acquisition": "how a point is taken", "compensation": "recordings of the "
        "fixture, for its removal", "device": "notes on the device; all go into the run file",
    },
    "`[generator]`": {
        "port": "its serial port, such as `/dev/ttyUSB0`", "model": "text that its identity must contain",
        "baud": "speed of the serial port", "timeout": "longest time of a reply",
        "pause": "time after every command, because settings are not acknowledged",
    },
    "`[oscilloscope]`": {
        "port": "a serial port, a USBTMC device such as `/dev/usbtmc0`, or a VISA resource (`USB0::...::INSTR`)",
        "model": "text that its identity must contain", "baud": "speed of a serial port",
        "channel_total": "the channel across device and resistor together",
        "channel_reference": "the channel across the resistor alone",
        "probe_total": "factor of the probe on `channel_total`, 1 or 10",
        "probe_reference": "factor of the probe on `channel_reference`",
        "trigger": "source of the trigger", "timeout": "longest time of one reply",
        "acquisition_timeout": "longest time of a whole acquisition, averages included",
    },
    "`[reference]`": {
        "resistance": "resistance of the resistor in series with the device",
        "tolerance": "limits of the resistance; a recording of a load makes it irrelevant",
    },
    "`[sweep]`": {
        "centre": "middle of the band; or `from` and `to`",
        "span": "width of the band on either side of `centre`; `12 %` if not given",
        "from": "lower end of the band", "to": "upper end of the band",
        "kind": "`linear` takes every `step`, `adaptive` takes `points` where the spectrum bends",
        "step": "distance of two points of a linear sweep", "points": "largest number of points of an adaptive sweep",
        "resolution": "relative error of Z between the points of an adaptive sweep, at which it ends",
        "direction": "`both` is up and then down", "repeats": "passes in each direction",
    },
    "`[drive]`": {
        "amplitude": "open-circuit voltage; a list is a series of drive levels, each swept in turn",
    },
    "`[limits]`": {
        "device_voltage": "largest voltage of the device, peak to peak",
        "device_current": "largest current of the device, peak to peak",
    },
    "`[acquisition]`": {
        "averages": "number of averages in the oscilloscope: 1, 4, 16, 64 or 128; `captures` are the better way",
        "captures": "number of captures of one point, averaged afterwards",
        "periods": "approximate number of periods in one capture",
        "settle": "time between the setting of a frequency and its first capture",
        "attempts": "number of attempts at a point where an instrument fails",
        "gain_accuracy": "limits of a channel's gain, by the maker's data sheet; load compensation removes it",
    },
    "`[compensation]`": {
        "open": "run file or spectrum of the fixture with nothing in it",
        "short": "the same with its clips joined", "load": "the same with a known resistor",
        "load_resistance": "resistance of that resistor; with `load`, and only with it",
        "load_tolerance": "limits of that resistance",
        "columns": "a column map for spectra whose headings are not recognised",
    },
    "`[device]`": {
        "name": "name of the device", "state": "state of the device, such as `empty`",
        "temperature": "temperature as read off",
        "gel": "the couplant, and how it was put on",
        "operator": "name of the person who measured", "note": "anything else",
    },
}

#: What a key of a campaign file says, by table. NAME stands for names of the reader's.
CAMPAIGN: Mapping[str, Mapping[str, str]] = {
    "The file": {
        "campaign": "name and materials of the campaign",
        "states": "each under `[states.NAME]`; one at least is not held out",
        "known": "standard uncertainties of numbers that all states share",
        "between": "changes from one state to the next", "fixed": "parameters that are exact",
        "model": "accuracy of the model",
    },
    "`[campaign]`": {
        "name": "name of the device in reports", "materials": "a folder of materials, relative to the file",
        "known": "`stated`: tolerances and uncertainties in the files of chip and materials count too; `named`: "
                 "`[known]` alone",
    },
    "`[states.NAME]`": {
        "chip": "the chip file", "state": "state of that chip; needed where it has several",
        "recording": "the spectrum",
        "drive": "voltage at the electrodes, peak to peak", "temperature": "temperature of the cavity's fluid",
        "band": "band of the recording, if not all of the chip's band counts, such as `[\"0.95 MHz\", \"1.05 MHz\"]`",
        "noise": "standard deviation of a point relative to its impedance, where the recording states none",
        "held_out": "`true`: never fitted, only predicted",
        "columns": "a column map, where the recording's headings are not recognised",
        "without_outliers": "`true`: leaves out the points that the findings on the recording name (page Recordings)",
        "known": "known parameters of this state alone, by name as in `[known]`",
        "observations": "beside the impedance, by name: " + ", ".join(f"`{name}`" for name in OBSERVABLES)
                        + "; each with `value`, `uncertainty` (relative), `drive` and `frequency`, see above",
    },
    "`[known]`, `[states.NAME.known]`": {},
    "`[between]`": {
        "defaults": "`false` leaves out the changes of any bench between two recordings (table of offsets above)",
    },
    "`[fixed]`": {
        "names": "parameters that are exact, and that no hypothesis may move",
    },
    "`[model]`": {
        "inhomogeneity": "size of the relative changes of stiffness, mass and loss within parts; `0` for none; "
                         "an average over sizes if not given",
    },
}

#: What holds of tables whose keys are names.
NAMED: Mapping[str, str] = {
    "`[known]`, `[states.NAME.known]`": "The keys are names of parameters: a dimension (`couplant.thickness`), a "
    "coefficient of a material (`pla.shear_modulus`), an element of the bench (`bench.series_resistance`). The value "
    "is a standard uncertainty with its unit, or a percentage of the stated value.",
    "`[between]`": "The other keys are names of parameters, as in `[known]`.",
}


def _units(dimension: str) -> str:
    return "text with a unit: " + ", ".join(dict.fromkeys(UNITS[dimension]))


#: How a key is read where the table itself does not know: it reads it in a way of its own, or only where it is given.
TAKES: Mapping[str, str] = {
    **dict.fromkeys(("generator", "oscilloscope", "reference", "sweep", "drive", "limits", "acquisition",
                     "compensation", "device", "campaign", "states", "between", "fixed", "model"), "a table"),
    **dict.fromkeys(("centre", "from", "to"), _units("frequency")), "span": _units("dimensionless"),
    "amplitude": _units("peak-to-peak voltage") + "; or a list of them",
    **dict.fromkeys(("open", "short", "load", "columns", "chip", "recording", "materials"), "text: a path, relative to "
                    "this file"),
    "load_resistance": _units("resistance"),
    **dict.fromkeys(("name", "state", "gel", "operator", "note"), "one line of text"),
    "temperature": "one line of text", "band": "a list of two frequencies",
    "noise": _units("dimensionless"), "observations": "tables, one for each observable",
    "known": "a table",
}


@dataclass
class Readings:
    """What the tables of one file accept: by table, by key, how it is read and the default ("" for none)."""

    source: str
    accepted: dict[str, set[str]] = field(default_factory=dict)
    takes: dict[str, dict[str, tuple[str, str]]] = field(default_factory=dict)

    def note(self, table: FileTable, key: str, takes: str, default: str = "") -> None:
        if table.source == self.source:
            self.takes.setdefault(table.field, {}).setdefault(key, (takes, default))


def _quantity(dimension: str, default: float | None) -> tuple[str, str]:
    if default is None:
        said = ""
    elif dimension in ("dimensionless", "share"):
        said = f"{100.0 * default:g} %"
    else:
        said = f"{default:g} {next(unit for unit, factor in UNITS[dimension].items() if factor == 1.0)}"
    return _units(dimension), said


#: How each method of a table reads a key, from its arguments: what it takes, and the default.
METHODS: Mapping[str, Callable[[Mapping[str, Any]], tuple[str, str]]] = {
    "text": lambda given: ("one line of text", given["default"] or ""),
    "texts": lambda given: ("a list of texts", ""),
    "quantity": lambda given: _quantity(given["dimension"], given["default"]),
    "optional_quantity": lambda given: _quantity(given["dimension"], None),
    "whole": lambda given: (f"a whole number from {given['low']} to {given['high']}",
                            "" if given["default"] is None else str(given["default"])),
    "flag": lambda given: ("`true` or `false`", str(given["default"]).lower()),
    "choice": lambda given: ("one of " + ", ".join(f"`{name}`" for name in given["known"]), given["default"] or ""),
}


@contextmanager
def noted(source: str) -> Iterator[Readings]:
    """Tables of the file `source` note the keys that they are asked for, as long as the context is open."""
    found = Readings(source)

    def watching(name: str) -> Callable[..., Any]:
        method = getattr(FileTable, name)
        signature = inspect.signature(method)

        def watched(table: FileTable, *args: Any, **kwargs: Any) -> Any:
            given = signature.bind(table, *args, **kwargs)
            given.apply_defaults()
            found.note(table, given.arguments["key"], *METHODS[name](given.arguments))
            return method(table, *args, **kwargs)
        return watched

    only = FileTable.only

    def accepting(table: FileTable, keys: Any, **renamed: Any) -> FileTable:
        keys = tuple(keys)
        if table.source == source:
            found.accepted.setdefault(table.field, set()).update(keys)
        return only(table, keys, **renamed)

    with patch.multiple(FileTable, only=accepting, **{name: watching(name) for name in METHODS}):
        yield found


def _title(table: str) -> str:
    """The heading of a table's keys; the names of an example's states are the reader's own."""
    if not table:
        return "The file"
    parts = table.split(".")
    if parts[0] == "states" and len(parts) > 1:
        parts[1] = "NAME"
    name = f"`[{'.'.join(parts)}]`"
    return "`[known]`, `[states.NAME.known]`" if parts[-1] == "known" else name


def accepted(found: Readings) -> dict[str, dict[str, tuple[str, str]]]:
    """What a reader accepts: by heading, by key, how it is read and the default."""
    keys: dict[str, dict[str, tuple[str, str]]] = {}
    for table in {**found.accepted, **found.takes}:
        read = found.takes.get(table, {})
        listed = found.accepted.get(table)
        for key in read if listed is None else listed:
            # The list of states and the tables of known numbers have names for keys.
            if listed is not None or key == "defaults":
                # The states of the example's chip are no choice for others.
                own = None if key == "state" else read.get(key)
                keys.setdefault(_title(table), {}).setdefault(key, own or (TAKES.get(key, "text"), ""))
    return keys


def bench_keys() -> dict[str, dict[str, tuple[str, str]]]:
    """The keys of bench.toml as its reader accepts them."""
    with noted(str(BENCH_EXAMPLE)) as found:
        read_bench(BENCH_EXAMPLE)
    return accepted(found)


def campaign_keys() -> dict[str, dict[str, tuple[str, str]]]:
    """The keys of a campaign file as its reader accepts them."""
    with noted(str(CAMPAIGN_EXAMPLE)) as found:
        read_campaign(CAMPAIGN_EXAMPLE)
    return accepted(found)


def page(about: Mapping[str, Mapping[str, str]], read: Mapping[str, Mapping[str, tuple[str, str]]]) -> str:
    """A table of keys for every table of a file, in Markdown.

    Raises:
        ValueError: a key that nobody explained, or an explanation of a key that there is not.
    """
    parts = []
    for title in (*about, *(title for title in read if title not in about)):
        odd = about.get(title, {}).keys() ^ read.get(title, {}).keys()
        if odd:
            raise ValueError(f"docs/file_keys.py and the reader disagree on the keys {sorted(odd)} of {title}")
        lines = [f"### {title}\n"]
        if title in NAMED:
            lines += [NAMED[title], ""]
        if about[title]:
            lines += ["| key | takes | if not given | meaning |", "| --- | --- | --- | --- |"]
            for key, told in about[title].items():
                takes, default = read[title][key]
                lines.append(f"| `{key}` | {takes} | {f'`{default}`' if default else ''} | {told} |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def bench_page() -> str:
    """The keys of bench.toml, in Markdown."""
    return page(BENCH, bench_keys())


def campaign_page() -> str:
    """The keys of a campaign file, in Markdown."""
    return page(CAMPAIGN, campaign_keys())
