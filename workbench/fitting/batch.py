"""Batches of recordings: the list file, the cache, and statistics.

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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import median_abs_deviation

from materials.versions import check_saved_name
from workbench.files.errors import InputError, choose
from workbench.files.names import check_name, check_title
from workbench.files.tables import FileTable
from workbench.fitting.multistart import TRIES
from workbench.fitting.prepare import DEFAULT, KINDS
from workbench.fitting.record import file_digest, software
from workbench.model.discretisation import ACCURACY, Discretisation
from workbench.model.numbers import ParameterName

Real = NDArray[np.float64]

#: An outlier lies this many standard deviations from the median, the deviation judged from the median absolute one
#: (Iglewicz and Hoaglin 1993, How to detect and handle outliers).
OUTLIER = 3.5

#: Fewer devices do not determine an outlier.
ENOUGH = 4


@dataclass(frozen=True)
class BatchMember:
    """One recording to fit; fields as in the module and `recordings.fit`."""

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
    """Settings of every job. `materials` are folders, and `force` saves a rejected fit."""

    materials: tuple[Path, ...] = ()
    inviscid: bool = False
    accuracy: float | Discretisation = ACCURACY
    algorithm: str = "joint"
    starts: tuple[str, ...] = ()
    tries: int = TRIES
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
    alone: dict[str, Job] = {}
    for row in table.tables("recordings", expected="tables [[recordings]]"):
        member = _member(row, path.parent)
        if member.name in alone:
            raise row.error("name", "a name of its own")
        alone[member.name] = Job(member.name, (member,), save=_save(row))
    if not alone:
        raise InputError(table.source, "recordings", "none", "at least one table [[recordings]]")
    groups: list[Job] = []
    grouped: set[str] = set()
    for row in table.tables("joint", expected="tables [[joint]]"):
        wanted = row.only(("name", "recordings", "own", "save")).texts("recordings", ())
        for one in wanted:
            choose(one, alone, source=row.source, field=row.at("recordings"))
            if one in grouped:
                raise InputError(row.source, row.at("recordings"), one, "each recording in one group only")
            grouped.add(one)
        if len(wanted) < 2:
            raise InputError(row.source, row.at("recordings"), list(wanted), "two recordings or more")
        groups.append(Job(_name(row), tuple(alone[one].members[0] for one in wanted), row.texts("own", ()), _save(row)))
    jobs = (*(job for job in alone.values() if job.name not in grouped), *groups)
    for job in jobs:
        if [other.name for other in jobs].count(job.name) > 1:
            raise InputError(table.source, "joint.name", job.name, "a name that no recording has")
    return Batch(name, jobs)


def _member(row: FileTable, folder: Path) -> BatchMember:
    row.only(("name", "file", "chip", "kind", "state", "material", "region", "free", "band", "columns", "format",
              "correction", "without_outliers", "save"))
    band: tuple[float | None, float | None] = (None, None)
    if "band" in row:
        low, high = row.quantities("band", "frequency",
                                   expected='two frequencies, for example ["910 kHz", "1155 kHz"]')
        if not 0.0 < low < high:
            raise row.error("band", "two rising frequencies")
        band = low, high
    if "correction" in row:
        row.choice("correction", ("negate", "conjugate", "signs"))
    texts = {key: row.optional_text(key) for key in ("state", "material", "region", "format", "correction")}
    return BatchMember(
        _name(row), row.path("file", folder, expected="a recording"), row.path("chip", folder, expected="a chip file"),
        row.choice("kind", KINDS),
        free=row.texts("free", (DEFAULT,)), band=band, without_outliers=row.flag("without_outliers"),
        columns=row.path("columns", folder, expected="a column map") if "columns" in row else None, **texts)


def _save(row: FileTable) -> str | None:
    name = row.optional_text("save")
    return None if name is None else check_saved_name(name, source=row.source, field=row.at("save"))


def _name(row: FileTable) -> str:
    return check_name(row.required("name", "a name"), source=row.source, field=row.at("name"))


def content_key(job: Job, settings: Settings, filling: Sequence[Mapping[str, object]]) -> str:
    """A digest of files, materials with values, options and version.

    Args:
        filling: for every member the materials of its chip by region.
    """
    files = [[path and file_digest(path) for path in (m.recording, m.chip, m.columns)] for m in job.members]
    # Files and materials count by their content.
    members = tuple(replace(m, recording=Path(), chip=Path(), columns=None) for m in job.members)
    options = replace(settings, materials=(), inviscid=False, force=False)
    values = [sorted((region, repr(material)) for region, material in one.items()) for one in filling]
    deciding = repr((files, replace(job, members=members), options, values, software()))
    return hashlib.sha256(deciding.encode()).hexdigest()


def finished(folder: Path, key: str) -> dict[str, Any] | None:
    """The complete ``fit.json`` of a folder with that `key`; else None."""
    try:
        record = json.loads((folder / "fit.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if isinstance(record, dict) and record.get("key") == key else None


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
    """Statistics over the fits of several devices, by parameter.

    Args:
        records: ``fit.json`` by device. Parameters are compared without the name of their material, if two devices or
            more have them. Each recording's own parameter in a joint group is a device of its own.
    """
    by_device: dict[tuple[str, str], dict[str, list[float]]] = {}

    def add(name: str, unit: str, device: str, entry: Mapping[str, Any]) -> None:
        # Without an interval (see `record`): the value alone.
        by_device.setdefault((name, unit), {})[device] = [
            entry["value"] if entry.get(key) is None else entry[key] for key in ("value", "low", "high")]

    for device, record in records.items():
        parsed = [ParameterName.parse(p["name"]) for p in record["parameters"] if not p["recordings"]]
        short = {str(name): name.local if name.is_material else str(name) for name in parsed}
        # A free disc and a sample fitted together: both have a density.
        short = {name: text if list(short.values()).count(text) == 1 else name for name, text in short.items()}
        for parameter in record["parameters"]:
            own, name = parameter["recordings"], parameter["name"]
            add(name if own else short[name], parameter["unit"], f"{device}: {own[0]}" if own else device, parameter)
        for one in record["recordings"]:
            label = device if len(record["recordings"]) == 1 else f"{device}: {one['name']}"
            for name, key, unit in (("f0", "f0_hz", "Hz"), ("Z_min", "z_min_ohm", "ohm"), ("Q", "q", "1")):
                if (value := one["figures"]["measured"].get(key)) is not None:
                    add(f"measured {name}", unit, label, {"value": value})
        for quantity in record.get("derived", []):
            add(quantity["name"], quantity["unit"], device, quantity)
    columns = []
    for (name, unit), rows in by_device.items():
        if len(rows) > 1:
            values, low, high = np.array(list(rows.values())).T
            mean = float(values.mean())
            columns.append(BatchColumn(
                name, unit, tuple(rows), values, low, high, mean, float(values.std(ddof=1)),
                100.0 * float(np.ptp(values)) / abs(mean) if mean else float("nan"),
                tuple(device for device, out in zip(rows, outlying(values), strict=True) if out)))
    return tuple(columns)


def outlying(values: Real) -> NDArray[np.bool_]:
    """Outliers among values (d,), beyond :data:`OUTLIER` robust standard deviations.

    The distance is from the median, and above rounding. Fewer than :data:`ENOUGH` values have none.
    """
    middle = float(np.median(values))
    least = max(OUTLIER * float(median_abs_deviation(values, scale="normal")), 1e-9 * abs(middle))
    return np.asarray((np.abs(values - middle) > least) & (values.size >= ENOUGH))
