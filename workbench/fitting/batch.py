"""Many recordings at once: the file that lists them, fits in parallel that lose nothing, and their statistics.

    [batch]
    name = "four discs"

    [[recordings]]
    name = "disc 1"                     # also the folder of its results
    file = "disc_1.csv"                 # paths are relative to this file
    chip = "disc.toml"
    kind = "pzt"                        # or "polymer"
    state = "default"                   # optional, as are all below
    material = "pzt4/comsol_nominal"    # to start from, in place of the chip's
    region = "substrate"                # whose material is free, in place of transducer or sample
    free = ["default", "bench.series_resistance"]
    band = ["0.91 MHz", "1.15 MHz"]
    columns = "columns.toml"
    format = "e4990a"
    correction = "conjugate"
    without_outliers = true             # leaves out the points that the findings on the recording name
    save = "pzt4/disc_1"

    [[joint]]                           # recordings fitted together: parameters of one name are shared
    name = "disc 1 and 2"
    recordings = ["disc 1", "disc 2"]
    own = ["transducer.thickness"]      # dimensions and bench elements that each has for itself
    save = "pzt4/batch_7"

A recording of a joint group is not fitted by itself.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from materials.versions import check_saved_name
from workbench.files.errors import InputError, choose
from workbench.files.names import check_name, check_title
from workbench.files.tables import FileTable
from workbench.fitting.prepare import DEFAULT, KINDS
from workbench.fitting.record import file_digest, software
from workbench.model.discretisation import ACCURACY, Discretisation
from workbench.model.numbers import ParameterName

Real = NDArray[np.float64]

#: An outlier lies this many standard deviations from the median, the deviation judged from the median absolute one
#: (Iglewicz and Hoaglin 1993, How to detect and handle outliers).
OUTLIER = 3.5

#: Standard deviation of a normal law over its median absolute deviation.
MAD_TO_SIGMA = 1.4826

#: With fewer devices nobody can say which of them is the odd one.
ENOUGH = 4

_RECORDING_KEYS = ("name", "file", "chip", "kind", "state", "material", "region", "free", "band", "columns", "format",
                   "correction", "without_outliers", "save")


@dataclass(frozen=True)
class BatchMember:
    """One recording to be fitted; see the module for the fields, `prepare.prepare` for their meaning."""

    name: str
    recording: Path
    chip: Path
    kind: str
    state: str | None = None
    material: str | None = None
    region: str | None = None
    free: tuple[str, ...] = (DEFAULT,)
    band: tuple[float | None, float | None] = (None, None)
    columns: Path | None = None
    format: str | None = None
    correction: str | None = None
    without_outliers: bool = False


@dataclass(frozen=True)
class Job:
    """A fit of a batch: one recording, or several that share parameters."""

    name: str
    members: tuple[BatchMember, ...]
    own: tuple[str, ...] = ()
    save: str | None = None


@dataclass(frozen=True)
class Settings:
    """Settings of every job: folders of materials, whether chips are inviscid, mesh, algorithm, further starts, and
    whether to insist."""

    materials: tuple[Path, ...] = ()
    inviscid: bool = False
    accuracy: float | Discretisation = ACCURACY
    algorithm: str = "joint"
    starts: tuple[str, ...] = ()
    tries: int = 32
    force: bool = False
    gel_thicknesses: tuple[float, ...] = ()


@dataclass(frozen=True)
class Batch:
    """A list of jobs, and its name."""

    name: str
    jobs: tuple[Job, ...]


def read_batch(path: Path) -> Batch:
    """The batch that a TOML file describes.

    Raises:
        InputError: the file is not as the module says; file, field, value and remedy.
    """
    table = FileTable.read(path).only(("batch", "recordings", "joint"))
    head = table.table("batch", expected="a table [batch]").only(("name",))
    name = check_title(head.content.get("name", path.stem), source=table.source, field=head.at("name"))
    members: dict[str, BatchMember] = {}
    saves: dict[str, str | None] = {}
    for row in table.tables("recordings", expected="tables [[recordings]]"):
        member = _member(row.only(_RECORDING_KEYS), path.parent)
        if member.name in members:
            raise row.error("name", "a name of its own")
        members[member.name] = member
        saves[member.name] = _save(row)
    if not members:
        raise InputError(table.source, "recordings", "none", "at least one table [[recordings]]")
    groups: list[Job] = []
    grouped: set[str] = set()
    for row in table.tables("joint", expected="tables [[joint]]"):
        wanted = row.only(("name", "recordings", "own", "save")).texts("recordings", ())
        for one in wanted:
            choose(one, members, source=row.source, field=row.at("recordings"))
            if one in grouped:
                raise InputError(row.source, row.at("recordings"), one, "each recording in one group only")
            grouped.add(one)
        if len(wanted) < 2:
            raise InputError(row.source, row.at("recordings"), list(wanted), "two recordings or more")
        groups.append(Job(_name(row), tuple(members[one] for one in wanted), row.texts("own", ()),
                          _save(row)))
    jobs = [Job(member.name, (member,), save=saves[member.name]) for member in members.values()
            if member.name not in grouped] + groups
    for job in jobs:
        if [other.name for other in jobs].count(job.name) > 1:
            raise InputError(table.source, "joint.name", job.name, "a name that no recording has")
    return Batch(name, tuple(jobs))


def _member(row: FileTable, folder: Path) -> BatchMember:
    band: tuple[float | None, float | None] = (None, None)
    if "band" in row:
        low, high = row.quantities("band", "frequency",
                                   expected='two frequencies, for example ["910 kHz", "1155 kHz"]')
        if not 0.0 < low < high:
            raise row.error("band", "two rising frequencies")
        band = low, high
    correction = row.optional_text("correction")
    return BatchMember(
        _name(row), _path(row, "file", folder), _path(row, "chip", folder), row.choice("kind", KINDS),
        row.optional_text("state"), row.optional_text("material"), row.optional_text("region"),
        row.texts("free", (DEFAULT,)), band, _path(row, "columns", folder) if "columns" in row else None,
        row.optional_text("format"), None if correction is None else row.choice("correction", ("negate", "conjugate")),
        row.flag("without_outliers"),
    )


def _path(row: FileTable, key: str, folder: Path) -> Path:
    found = folder / row.text(key)
    if not found.is_file():
        raise InputError(row.source, row.at(key), str(found), "an existing file")
    return found


def _save(row: FileTable) -> str | None:
    found = row.optional_text("save")
    return None if found is None else check_saved_name(found, source=row.source, field=row.at("save"))


def _name(row: FileTable) -> str:
    return check_name(row.required("name", "a name"), source=row.source, field=row.at("name"))


# --------------------------------------------------------------------------------------------------------------------
# Running.


def content_key(job: Job, settings: Settings, filling: Sequence[Mapping[str, object]]) -> str:
    """A digest of all that decides a result: contents of the files, materials with their values, options, version.

    Args:
        filling: for every member the materials of its chip by region.
    """
    files = [(file_digest(m.recording), file_digest(m.chip), "" if m.columns is None else file_digest(m.columns))
             for m in job.members]
    members = [(m.name, m.kind, m.state, m.material, m.region, m.free, m.band, m.format, m.correction,
                m.without_outliers) for m in job.members]
    options = (settings.accuracy, settings.algorithm, settings.starts, settings.tries,
               settings.gel_thicknesses)
    values = [sorted((region, repr(material)) for region, material in one.items()) for one in filling]
    deciding = repr((files, members, job.name, job.own, job.save, options, values, software()))
    return hashlib.sha256(deciding.encode()).hexdigest()


def finished(folder: Path, key: str) -> dict[str, Any] | None:
    """The ``fit.json`` of a folder if it is whole and of that `key`; None otherwise."""
    try:
        record = json.loads((folder / "fit.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if isinstance(record, dict) and record.get("key") == key else None


# --------------------------------------------------------------------------------------------------------------------
# Summary.


@dataclass(frozen=True, eq=False)
class BatchColumn:
    """One parameter over the devices.

    ``values``, ``low`` and ``high`` (d,) in ``unit``; ``mean``, ``deviation`` (standard, of the sample, NaN for one),
    ``dispersion_percent`` the range over the mean; ``outliers`` names of the devices beyond :data:`OUTLIER`.
    """

    name: str
    unit: str
    devices: tuple[str, ...]
    values: Real
    low: Real
    high: Real
    mean: float
    deviation: float
    dispersion_percent: float
    outliers: tuple[str, ...]


def summarise(records: Mapping[str, Mapping[str, Any]]) -> tuple[BatchColumn, ...]:
    """Statistics over the fits of several devices: by parameter, for those that two devices or more have.

    Args:
        records: ``fit.json`` by device. Materials are left out of the parameters' names, so that c33 of one disc stands
            beside c33 of another. A parameter of a joint group that each recording has for itself is a device each.
    """
    found: dict[str, dict[str, tuple[float, ...]]] = {}
    units: dict[str, str] = {}

    def add(name: str, unit: str, device: str, entry: Mapping[str, Any]) -> None:
        # Without an interval (see `record`): the value alone.
        found.setdefault(name, {})[device] = tuple(
            entry["value"] if entry.get(key) is None else entry[key] for key in ("value", "low", "high"))
        units[name] = unit

    for device, record in records.items():
        shown = [p["name"] for p in record["parameters"] if not p["recordings"]]
        short = {name: _short(name) for name in shown}
        # A free disc and a sample fitted together: both have a density.
        short = {name: text if list(short.values()).count(text) == 1 else name for name, text in short.items()}
        for parameter in record["parameters"]:
            own = parameter["recordings"]
            add(parameter["name"] if own else short[parameter["name"]], parameter["unit"],
                f"{device}: {own[0]}" if own else device, parameter)
        for one in record["recordings"]:
            merit = one["figures"]["measured"]
            for name, key, unit in (("f0", "f0_hz", "Hz"), ("Z_min", "z_min_ohm", "ohm"), ("Q", "q", "1")):
                if merit.get(key) is not None:
                    label = device if len(record["recordings"]) == 1 else f"{device}: {one['name']}"
                    add(f"measured {name}", unit, label, {"value": merit[key]})
        for quantity in record.get("derived", []):
            add(quantity["name"], quantity["unit"], device, quantity)
    return tuple(_column(name, units[name], rows) for name, rows in found.items() if len(rows) > 1)


def _short(name: str) -> str:
    """The name of a parameter without its material: c33 of one disc beside c33 of another."""
    parsed = ParameterName.parse(name)
    return parsed.local if parsed.is_material else name


def _column(name: str, unit: str, rows: Mapping[str, tuple[float, ...]]) -> BatchColumn:
    table = np.array(list(rows.values()))
    values, devices = table[:, 0], tuple(rows)
    mean = float(values.mean())
    return BatchColumn(
        name, unit, devices, values, table[:, 1], table[:, 2], mean, float(values.std(ddof=1)),
        100.0 * float(np.ptp(values)) / abs(mean) if mean else float("nan"),
        tuple(device for device, out in zip(devices, outlying(values), strict=True) if out))


def outlying(values: Real) -> NDArray[np.bool_]:
    """Which values (d,) lie further than :data:`OUTLIER` robust standard deviations from the median.

    None of fewer than :data:`ENOUGH`. Where more than half agree exactly, whatever differs by more than rounding lies
    outside.
    """
    if values.size < ENOUGH:
        return np.zeros(values.size, dtype=bool)
    away = np.abs(values - np.median(values))
    sigma = MAD_TO_SIGMA * float(np.median(away))
    return np.asarray(away > max(OUTLIER * sigma, 1e-9 * abs(float(np.median(values)))))
