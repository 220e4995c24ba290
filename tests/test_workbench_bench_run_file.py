"""workbench.bench.run_file: nothing that was written is lost, wherever the writing stopped."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from workbench.bench.run_file import Event, Journal, RunPoint, exists, journal_path, new_run, read_run, write_run
from workbench.files.errors import InputError

INSTRUMENTS = {"generator": "FY3224S", "oscilloscope": "TEKTRONIX,TDS 2024B,0,CF:91.1CT FV:v22.11"}


def point(sequence: Any, *, samples: int = 40) -> Any:
    rng = np.random.default_rng(sequence)
    return RunPoint(
        sequence, 1e6 + 500.0 * sequence, 5.0, 4.5, sequence % 2, 1.7e9 + sequence,
        raw=rng.integers(-100, 100, (2, 2, samples)).astype(np.int16), volts_per_count=rng.random((2, 2)),
        volts_at_zero=rng.random((2, 2)), start=rng.random(2), step=4e-9,
        voltage=rng.random((2, 2)) + 1j * rng.random((2, 2)), voltage_uncertainty=rng.random((2, 2)),
        fitted_frequency=1e6 + rng.random(2), impedance=complex(*rng.random(2)), uncertainty=0.01,
        flags=("low signal: 3 steps, of \u00b5V",) if sequence == 1 else (),
    )


def same(first: Any, second: Any) -> None:
    for field in dataclasses.fields(RunPoint):
        a, b = getattr(first, field.name), getattr(second, field.name)
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
        else:
            assert a == b, field.name


def started(path: Path, points: int = 3) -> Any:
    journal = Journal(path, new_run('[generator]\nport = "x"\n', INSTRUMENTS, 1.7e9))
    for sequence in range(points):
        journal.add(point(sequence))
    return journal


def test_what_was_added_is_read_back_bit_for_bit(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    assert not exists(path)
    with started(path) as journal:
        journal.add(Event(1.7e9, "resumed"))
        for run in (read_run(path), journal.fold(complete=True), read_run(path)):
            assert len(run.points) == 3
            for sequence, found in enumerate(run.points):
                same(found, point(sequence))
            assert run.events == (Event(1.7e9, "resumed"),)
            assert (run.instruments, run.setup_text) == (INSTRUMENTS, '[generator]\nport = "x"\n')
    assert run.complete
    assert [p.name for p in tmp_path.iterdir()] == ["run.h5"]


def test_a_journal_cut_anywhere_keeps_every_whole_point(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    started(path).close()
    beside = journal_path(path)
    whole = beside.read_bytes()
    ends = []
    with started(tmp_path / "other.h5", points=0) as journal:
        ends.append(journal_path(journal.path).stat().st_size)
        for sequence in range(3):
            journal.add(point(sequence))
            ends.append(journal_path(journal.path).stat().st_size)
    for cut in sorted({*range(0, len(whole), 97), *ends, *(end - 1 for end in ends), len(whole)}):
        beside.write_bytes(whole[:cut])
        expected = sum(end <= cut for end in ends) - 1
        if expected < 0:
            assert not exists(path)
            continue
        run = read_run(path)
        assert len(run.points) == expected, cut
        with Journal(path, run) as journal:
            journal.add(point(expected))
        again = read_run(path)
        assert [p.sequence for p in again.points] == list(range(expected + 1))
        same(again.points[-1], point(expected))


def test_a_flipped_bit_ends_the_journal_there(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    started(path).close()
    data = bytearray(journal_path(path).read_bytes())
    data[-100] ^= 4
    journal_path(path).write_bytes(bytes(data))
    assert len(read_run(path).points) == 2


def test_nothing_behind_a_spoilt_record_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    started(path, points=4).close()
    data = bytearray(journal_path(path).read_bytes())
    record = data.rfind(b"WBR1", 0, data.rfind(b"WBR1"))
    data[record + 500] ^= 4
    journal_path(path).write_bytes(bytes(data))
    with Journal(path, read_run(path)) as journal:
        # As long as the spoilt one, so that the whole one behind it would fit on again.
        journal.add(point(2))
    assert [p.sequence for p in read_run(path).points] == [0, 1, 2]


class _Interrupted:
    """A stream that is interrupted halfway through a record, or behind a `whole` one before the writer hears of it."""

    def __init__(self, stream: Any, whole: bool) -> None:
        self._stream, self._whole = stream, whole

    def write(self, data: Any) -> Any:
        if self._whole:
            self._stream.write(data)
        if self._whole or len(data) < 200:
            raise KeyboardInterrupt
        return self._stream.write(data[:len(data) // 2])

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@pytest.mark.parametrize("whole", [False, True])
def test_an_interrupted_write_leaves_a_whole_record_or_none(tmp_path: Path, whole: bool) -> None:
    path = tmp_path / "run.h5"
    with started(path) as journal:
        stream = journal._stream
        journal._stream = _Interrupted(stream, whole)
        with pytest.raises(KeyboardInterrupt):
            journal.add(point(3))
        journal._stream = stream
        journal.add(Event(1.0, "interrupted"))
        run = journal.fold(complete=False)
    assert len(run.points) == (4 if whole else 3)
    if whole:
        same(run.points[3], point(3))
    assert run.events[-1].text == "interrupted"


def test_a_point_that_is_whole_stays_when_an_interrupt_comes_behind_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.h5"
    with started(path) as journal:
        def interrupted(handle: Any) -> None:
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr("workbench.bench.run_file.os.fsync", interrupted)
            with pytest.raises(KeyboardInterrupt):
                journal.add(point(3))
        journal.add(Event(1.0, "interrupted"))
        run = journal.fold(complete=False)
    assert len(run.points) == 4
    same(run.points[3], point(3))


def test_folded_and_taken_up_again(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with started(path) as journal:
        journal.fold(complete=False)
    with Journal(path, read_run(path)) as journal:
        journal.add(point(3))
    run = read_run(path)
    assert [p.sequence for p in run.points] == [0, 1, 2, 3]
    # Killed between putting RUN.h5 in its place and removing the journal: both hold point 3, it counts once.
    write_run(run, path)
    assert [p.sequence for p in read_run(path).points] == [0, 1, 2, 3]


def test_results_of_single_numbers_are_written(tmp_path: Path) -> None:
    """A bench without compensation has a scalar among its results, of which HDF5 has no checksum."""
    path = tmp_path / "run.h5"
    with started(path) as journal:
        run = journal.fold(complete=True)
    write_run(run, path, results={"5Vpp": {"common": np.array(0.01), "noise": np.ones(3), "none": np.zeros(0)}})
    assert [p.sequence for p in read_run(path).points] == [p.sequence for p in run.points]


def test_files_that_are_no_runs_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with pytest.raises(InputError, match="a run file"):
        read_run(path)
    path.write_text("nothing of the kind")
    with pytest.raises(InputError, match="a run file"):
        read_run(path)
    path.unlink()
    with started(path) as journal:
        journal.fold(complete=True)
    with started(tmp_path / "other.h5") as journal:
        pass
    journal_path(journal.path).rename(journal_path(path))
    with pytest.raises(InputError, match="the run of"):
        read_run(path)


def test_every_changed_byte_of_a_run_file_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    run = started(path, points=1).fold(complete=True)
    whole = path.read_bytes()
    for place in [*range(0, len(whole), 101), *range(len(whole) - 75, len(whole))]:
        path.write_bytes(whole[:place] + bytes([whole[place] ^ (1 << place % 8)]) + whole[place + 1:])
        with pytest.raises(InputError, match=r"run\.h5: (content|file): received"):
            read_run(path)
    for length in range(0, len(whole), 997):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"run\.h5: (content|file): received"):
            read_run(path)
    path.write_bytes(whole)
    same(read_run(path).points[0], run.points[0])


def test_other_programs_read_a_run_file_and_its_checksums(tmp_path: Path) -> None:
    import h5py

    path = tmp_path / "run.h5"
    started(path, points=2).fold(complete=True)
    whole = path.read_bytes()
    with h5py.File(path, "r") as file:
        for name in ("points/frequency", "points/impedance", "captures/000001/raw"):
            assert file[name].fletcher32, name
        place = file["points/frequency"].id.get_chunk_info(0).byte_offset
    path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1:])
    with h5py.File(path, "r") as file, pytest.raises(OSError, match=r"Fletcher32|filter returned failure"):
        file["points/frequency"][()]
    # A program that writes into the file removes the digest.
    path.write_bytes(whole)
    with h5py.File(path, "r+") as file:
        file.attrs["complete"] = False
    with pytest.raises(InputError, match=r"run\.h5: content: received"):
        read_run(path)


def test_a_run_file_of_an_earlier_version_is_read_and_its_damages_are_named(tmp_path: Path) -> None:
    import h5py

    path = tmp_path / "run.h5"
    run = started(path, points=1).fold(complete=True)
    with h5py.File(path, "r+") as file:
        # As it was before files had a digest: without the attribute, and without the line at the end.
        del file.attrs["sealed"]
    data = path.read_bytes()
    end = data.rfind(b"\nsha256 ")
    path.write_bytes(data[:end] if end > 0 else data)
    same(read_run(path).points[0], run.points[0])
    for name, content in (("instruments", "{"), ("instruments", "3"), ("created", "never"),
                          ("format", "workbench run 9")):
        with h5py.File(path, "r+") as file:
            kept = file.attrs[name]
            file.attrs[name] = content
        with pytest.raises(InputError, match=r"run\.h5: (file|format): received"):
            read_run(path)
        with h5py.File(path, "r+") as file:
            file.attrs[name] = kept
    with h5py.File(path, "r+") as file:
        file.move("captures/000000/raw", "captures/000000/rare")
    with pytest.raises(InputError, match=r"run\.h5: file: received 'run\.h5'; expected a run file .* restore a copy"):
        read_run(path)
