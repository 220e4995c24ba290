"""One HDF5 file per run, and a crash-safe journal during the run.

HDF5 rewrites its tables in place: a killed process may produce a file that cannot be opened. So every point is written
to ``RUN.h5.journal`` first, with its length and checksum, and is on the disk (fsync) before the next one is measured.
When the run ends, is interrupted in an orderly way, or is resumed, the journal is merged into RUN.h5, which is replaced
atomically. RUN.h5 ends in a digest of its content, which is checked before HDF5 reads the file: on damaged files the
library may crash. An incomplete record after a kill or a power cut is recognised and dropped: that point is measured
again.
"""

from __future__ import annotations

import io
import json
import os
import struct
import uuid
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.files.sealed import is_sealed, seal
from workbench.files.writing import replacing, sync_folder
from workbench.results.brief import Brief

FORMAT = "workbench run 1"

#: Attribute of a file that ends in a digest; files of earlier versions have neither.
_SEALED = "sealed"

_RECORD = struct.Struct("<4sII")
_MAGIC = b"WBR1"


@dataclass(frozen=True, eq=False)
class RunPoint:
    """One frequency at one drive level on one pass.

    ``sequence`` counts points from zero; ``frequency`` is in Hz as set; ``level`` (V peak to peak, open circuit) as
    requested and ``amplitude`` as set, which is smaller if a limit of the device required it; ``started`` is in seconds
    since 1970.

    ``raw`` (captures, 2, n) are the converter's values, first across device and resistor, then across the resistor;
    ``volts_per_count`` and ``volts_at_zero`` (captures, 2) V convert them to volts at the probe's tip; ``start``
    (captures,) s is from the trigger to the first sample, ``step`` in s.

    ``voltage`` (captures, 2) is in complex V zero to peak, e^{+j w t}; ``voltage_uncertainty`` (captures, 2) in V;
    ``fitted_frequency`` (captures,) in Hz. ``impedance`` is in ohm without compensation; ``uncertainty`` in ohm, of the
    noise alone, of its real and of its imaginary part, each. ``flags`` are doubts, in words.
    """

    sequence: int
    frequency: float
    level: float
    amplitude: float
    pass_number: int
    started: float
    raw: NDArray[np.int16]
    volts_per_count: NDArray[np.float64]
    volts_at_zero: NDArray[np.float64]
    start: NDArray[np.float64]
    step: float
    voltage: NDArray[np.complex128]
    voltage_uncertainty: NDArray[np.float64]
    fitted_frequency: NDArray[np.float64]
    impedance: complex
    uncertainty: float
    flags: tuple[str, ...]

    @property
    def device_voltage(self) -> float:
        """V peak to peak at the device."""
        return 2.0 * float(np.mean(np.abs(self.voltage[:, 0] - self.voltage[:, 1])))


_ARRAYS = ("raw", "volts_per_count", "volts_at_zero", "start", "voltage", "voltage_uncertainty", "fitted_frequency")
_NUMBERS = ("sequence", "frequency", "level", "amplitude", "pass_number", "started", "step", "uncertainty")


@dataclass(frozen=True)
class Event:
    """An incident of the run; ``time`` is in seconds since 1970."""

    time: float
    text: str


@dataclass(frozen=True, eq=False, repr=False)
class Run(Brief):
    """A run on disk. ``setup_text`` is the text of BENCH.toml; ``instruments`` are their identifications; ``complete``
    is whether every requested point was measured."""

    run_id: str
    created: float
    setup_text: str
    instruments: Mapping[str, str]
    points: tuple[RunPoint, ...] = ()
    events: tuple[Event, ...] = ()
    complete: bool = False


def journal_path(path: Path) -> Path:
    return path.with_name(path.name + ".journal")


class Journal:
    """A run that is being written. An added entry is on the disk when :meth:`add` returns."""

    def __init__(self, path: Path, run: Run) -> None:
        """Open the journal of `run` after its last complete record.

        Raises:
            InputError: the journal at `path` belongs to another run.
        """
        self.path = path
        self.run = run
        beside = journal_path(path)
        good = 0
        if beside.exists():
            records, good = _records(beside)
            if records and records[0].get("run_id") != run.run_id:
                raise InputError(str(beside), "run", records[0].get("run_id"), f"the run of {path}, {run.run_id}")
        self._stream = beside.open("r+b" if beside.exists() else "w+b", buffering=0)
        self._stream.truncate(good)
        self._stream.seek(good)
        if good == 0:
            self._write({"kind": "run", "run_id": run.run_id, "created": run.created, "setup_text": run.setup_text,
                         "instruments": dict(run.instruments)}, {})
            sync_folder(beside.parent)

    def add(self, entry: RunPoint | Event) -> None:
        """Write a point or an event to the disk."""
        if isinstance(entry, Event):
            self._write({"kind": "event", "time": entry.time, "text": entry.text}, {})
            self.run = replace(self.run, events=(*self.run.events, entry))
            return
        text = {"kind": "point", "impedance": [entry.impedance.real, entry.impedance.imag], "flags": entry.flags,
                **{name: getattr(entry, name) for name in _NUMBERS}}
        self._write(text, {name: getattr(entry, name) for name in _ARRAYS})
        self.run = replace(self.run, points=(*self.run.points, entry))

    def fold(self, *, complete: bool) -> Run:
        """Write all entries to RUN.h5, and remove the journal."""
        # Read from the disk, because an interrupt may have come between writing a point and adding it to `run`.
        self.run = replace(read_run(self.path), complete=complete)
        write_run(self.run, self.path)
        self._stream.close()
        journal_path(self.path).unlink()
        return self.run

    def close(self) -> None:
        """Close the journal without merging it."""
        self._stream.close()

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def _write(self, text: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        stream = io.BytesIO()
        np.savez(stream, text=np.frombuffer(json.dumps(text).encode("utf-8"), dtype=np.uint8),
                 **arrays)  # type: ignore[arg-type]  # numpy's stub takes every keyword for its flag
        payload = stream.getvalue()
        place = self._stream.tell()
        record = memoryview(_RECORD.pack(_MAGIC, len(payload), zlib.crc32(payload)) + payload)
        try:
            while (written := self._stream.tell() - place) < len(record):
                self._stream.write(record[written:])
            os.fsync(self._stream.fileno())
        except BaseException:
            # Remove an incomplete record, but not a complete one. The stream's position shows which it is, also after
            # an interrupt between the system's call and its result.
            if self._stream.tell() - place < len(record):
                self._stream.truncate(place)
                self._stream.seek(place)
            raise


def new_run(setup_text: str, instruments: Mapping[str, str], created: float) -> Run:
    """A run without points."""
    return Run(uuid.uuid4().hex, created, setup_text, dict(instruments))


def exists(path: Path) -> bool:
    """Whether `path` has a run file, or a journal with records."""
    return path.exists() or (journal_path(path).exists() and bool(_records(journal_path(path))[0]))


def read_run(path: Path) -> Run:
    """The run at `path`, including entries only in its journal.

    Raises:
        InputError: there is no run file.
    """
    path = Path(path)
    beside = journal_path(path)
    run = _read_hdf5(path) if path.exists() else None
    if beside.exists():
        records, _ = _records(beside)
        for record in records:
            if record["kind"] == "run":
                if run is None:
                    run = Run(record["run_id"], record["created"], record["setup_text"], record["instruments"])
                elif run.run_id != record["run_id"]:
                    raise InputError(str(beside), "run", record["run_id"], f"the run of {path}, {run.run_id}")
            elif run is not None:
                run = _with(run, record)
    if run is None:
        raise InputError(str(path), "file", path.name, "a run file, or the journal of one")
    return run


def _with(run: Run, record: Mapping[str, Any]) -> Run:
    """The run with a record of its journal, added at most once. A kill between merging and unlinking makes
    duplicates."""
    if record["kind"] == "event":
        event = Event(record["time"], record["text"])
        return run if event in run.events else replace(run, events=(*run.events, event))
    if any(point.sequence == record["sequence"] for point in run.points):
        return run
    real, imaginary = record["impedance"]
    point = RunPoint(impedance=complex(real, imaginary), flags=tuple(record["flags"]),
                     **{name: record[name] for name in _NUMBERS}, **{name: record[name] for name in _ARRAYS})
    return replace(run, points=(*run.points, point), complete=False)


def _records(path: Path) -> tuple[list[dict[str, Any]], int]:
    """The complete records of a journal, and the end of the last."""
    data = path.read_bytes()
    found: list[dict[str, Any]] = []
    place = 0
    while place + _RECORD.size <= len(data):
        magic, length, checksum = _RECORD.unpack_from(data, place)
        payload = data[place + _RECORD.size:place + _RECORD.size + length]
        if magic != _MAGIC or len(payload) < length or zlib.crc32(payload) != checksum:
            break
        with np.load(io.BytesIO(payload), allow_pickle=False) as arrays:
            found.append({**json.loads(arrays["text"].tobytes()), **{n: arrays[n] for n in arrays if n != "text"}})
        place += _RECORD.size + length
    return found, place


def write_run(run: Run, path: Path, *, results: Mapping[str, Mapping[str, NDArray[Any]]] | None = None) -> None:
    """Write the HDF5 file atomically.

    `results` are arrays by group and name. Layout: the attributes of ``/`` are the run's; ``/points`` has one dataset
    for each number of a point (n,), e.g. ``impedance``; ``/captures/000000`` and so on the arrays of one point, ``raw``
    compressed; ``/events`` time and text; ``/results`` results for other programs, which are not read back. Tables and
    ``raw`` have checksums (fletcher32); a line with the digest of the whole file follows the HDF5 content.
    """
    import h5py

    def add(name: str, values: NDArray[Any], **packed: Any) -> None:
        # HDF5 has no checksums of empty datasets, single numbers and texts. Those of a few numbers for each capture
        # would double the file.
        checked = values.ndim > 0 and values.size > 0 and values.dtype.kind != "O" and (
            packed or not name.startswith("captures/"))
        file.create_dataset(name, data=values, **packed, **({"fletcher32": True} if checked else {}))

    with replacing(path) as whole:
        with h5py.File(whole, "w") as file:
            file.attrs.update({"format": FORMAT, "run_id": run.run_id, "created": run.created,
                               "setup": run.setup_text, "instruments": json.dumps(dict(run.instruments)),
                               "complete": run.complete, _SEALED: True})
            for name in _NUMBERS:
                add(f"points/{name}", np.array([getattr(point, name) for point in run.points]))
            add("points/impedance", np.array([point.impedance for point in run.points], dtype=np.complex128))
            add("points/flags", np.array([json.dumps(each.flags) for each in run.points], dtype=h5py.string_dtype()))
            file.require_group("captures")
            for point in run.points:
                for name in _ARRAYS:
                    packed = {"compression": "gzip", "shuffle": True} if name == "raw" else {}
                    add(f"captures/{point.sequence:06d}/{name}", getattr(point, name), **packed)
            add("events/time", np.array([event.time for event in run.events]))
            add("events/text", np.array([event.text for event in run.events], dtype=h5py.string_dtype()))
            for group_name, arrays in (results or {}).items():
                for name, values in arrays.items():
                    add(f"results/{group_name}/{name}", np.asarray(values))
        seal(whole)


def _read_hdf5(path: Path) -> Run:
    import h5py

    sealed = is_sealed(path)
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != FORMAT:
                raise InputError(str(path), "format", file.attrs.get("format"), f"{FORMAT!r}")
            if _SEALED in file.attrs and not sealed:
                raise InputError(str(path), "content", "no digest at its end", "the run file as it was written: "
                                 "another program changed it, or its end is cut off; restore a copy")
            return _run_of(file)
    except InputError:
        raise
    # A file without a digest, of an earlier version, may be damaged anywhere.
    except (OSError, ValueError, TypeError, LookupError, AttributeError, RuntimeError) as error:
        raise InputError(str(path), "file", path.name, "a run file of the workbench: restore a copy of it if it is "
                         f"damaged ({error})") from None


def _run_of(file: Any) -> Run:
    table = file["points"]
    numbers = {name: table[name][()] for name in (*_NUMBERS, "impedance")}
    flags = [tuple(json.loads(text)) for text in table["flags"].asstr()[()]]
    points = []
    for index, kept in enumerate(flags):
        group = file["captures"][f"{int(numbers['sequence'][index]):06d}"]
        points.append(RunPoint(impedance=complex(numbers["impedance"][index]), flags=kept,
                               **{name: numbers[name][index].item() for name in _NUMBERS},
                               **{name: group[name][()] for name in _ARRAYS}))
    events = [Event(float(time), text) for time, text in
              zip(file["events/time"][()], file["events/text"].asstr()[()], strict=True)]
    return Run(str(file.attrs["run_id"]), float(file.attrs["created"]), str(file.attrs["setup"]),
               dict(json.loads(file.attrs["instruments"])), tuple(points), tuple(events), bool(file.attrs["complete"]))
