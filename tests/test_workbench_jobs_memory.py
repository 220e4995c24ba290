"""Limits of memory: how much a process may take, one line where it is not enough, and never a hang."""

from __future__ import annotations

import errno
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from workbench import cli
from workbench.commands import export as export_command
from workbench.commands import fit as fit_command
from workbench.fem import factorisation, solve
from workbench.files.errors import InputError
from workbench.jobs import memory, process
from workbench.jobs.memory import PROCESS_VARIABLE, free_memory, is_shortage
from workbench.jobs.process import WorkerEnded
from workbench.jobs.workers import Processes
from workbench.model.job_size import MEMORY_SHARE, check_points

ROOT = Path(__file__).resolve().parent.parent
DISC = ROOT / "geometry/chips/disc_20x2.toml"
MEMINFO = "MemTotal: 99000000 kB\nMemAvailable: 8000000 kB\n"
#: A limit that no machine has.
UNLIMITED = "9223372036854771712\n"


def files(folder: Path, content: dict[str, str]) -> Path:
    for name, text in content.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


# --- how much there is ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("cgroup", "groups", "size", "words"), [
    ("0::/\n", {}, 8.192e9, "free here"),
    # Version 2: the group of the process, the one around it, the root of a container; the lower of max and high.
    ("0::/job/step\n", {"job/step/memory.max": "3000000000", "job/step/memory.current": "1000000000"}, 2e9,
     "group .cgroup., which may take 3 GB"),
    ("0::/job/step\n", {"job/step/memory.max": "max\n", "job/step/memory.current": "1", "job/memory.max": "2000000000",
                        "job/memory.current": "500000000"}, 1.5e9, "2 GB"),
    ("0::/job\n", {"job/memory.max": "4000000000", "job/memory.high": "2000000000", "job/memory.current": "0"}, 2e9,
     "2 GB"),
    ("0::/only/the/host/knows\n", {"memory.max": "1000000000", "memory.current": "0"}, 1e9, "1 GB"),
    # Files that the system keeps in memory for nobody are free; more than the limit is none.
    ("0::/job\n", {"job/memory.max": "3000000000", "job/memory.current": "2500000000",
                   "job/memory.stat": "anon 1\ninactive_file 2000000000\n"}, 2.5e9, "3 GB"),
    ("0::/job\n", {"job/memory.max": "1000", "job/memory.current": "2000"}, 0.0, "cgroup"),
    # Version 1, alone and beside version 2.
    ("5:cpu:/x\n4:memory:/batch/7\n", {"memory/batch/7/memory.limit_in_bytes": "2000000000",
                                       "memory/batch/7/memory.usage_in_bytes": "500000000",
                                       "memory/batch/7/memory.stat": "inactive_file 7\ntotal_inactive_file 100000000\n",
                                       "memory/memory.limit_in_bytes": UNLIMITED,
                                       "memory/memory.usage_in_bytes": "1"}, 1.6e9, "2 GB"),
    ("4:memory:/batch\n0::/\n", {"memory/batch/memory.limit_in_bytes": UNLIMITED,
                                 "memory/batch/memory.usage_in_bytes": "9", "cgroup.procs": ""}, 8.192e9, "free here"),
])
def test_free_memory_is_that_of_the_tightest_group(
    cgroup: str, groups: dict[str, str], size: float, words: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    proc = files(tmp_path / "proc", {"meminfo": MEMINFO, "self/cgroup": cgroup, "self/statm": "1000 1\n"})
    (tmp_path / "sys").mkdir()
    monkeypatch.setattr(memory, "PROC", proc)
    monkeypatch.setattr(memory, "GROUPS", files(tmp_path / "sys", groups))
    room = free_memory()
    assert room.size == pytest.approx(size)
    assert re.search(words, room.limit)


def test_the_address_space_is_each_process_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    proc = files(tmp_path, {"meminfo": MEMINFO, "self/statm": f"{1_000_000_000 // resource.getpagesize()} 1\n"})
    monkeypatch.setattr(memory, "address_limit", lambda: 3e9)
    monkeypatch.setattr(memory, "PROC", proc)
    monkeypatch.setattr(memory, "GROUPS", tmp_path)
    room = free_memory()
    assert room.size == pytest.approx(2e9, rel=1e-4)
    assert "rest of the 3 GB of address space that ulimit -v allows" in room.limit
    # A share of the rest of the machine, which processes have together, may be less.
    monkeypatch.setenv(PROCESS_VARIABLE, "1e9")
    room = free_memory()
    assert (room.size, "less with more --jobs" in room.limit) == (1e9, True)


def test_workers_share_the_memory_that_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("workbench.jobs.workers.shared_memory", lambda: 12e9)
    for size, beside, share in ((2, 0, 6e9), (2, 1, 4e9)):
        workers = Processes(size, beside=beside)
        try:
            assert float(workers.map([share_of_process])[0]) == share
        finally:
            workers.close()


def share_of_process() -> str:
    return os.environ[PROCESS_VARIABLE]


def test_an_estimate_above_the_limit_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("workbench.model.job_size.free_memory", lambda: memory.Room(1e9, "the rest of 2 GB"))
    check_points(int(MEMORY_SHARE * 1e9 / 5e3) - 1, source="x")
    with pytest.raises(InputError, match=r"of 900 MB, the rest of 2 GB .WORKBENCH_MEMORY states another amount."):
        check_points(int(MEMORY_SHARE * 1e9 / 5e3) + 1, source="x")


# --- what is said -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("error", "short"), [
    (MemoryError(), True), (OSError(errno.ENOMEM, "Cannot allocate memory"), True),
    (RuntimeError("can't start new thread"), True), (RuntimeError("SUPERLU_MALLOC fails for expanders"), True),
    (ImportError("libx.so: failed to map segment from shared object"), True), (Exception("std::bad_alloc"), True),
    (RuntimeError("Factor is exactly singular"), False), (OSError(errno.ENOSPC, "No space left on device"), False),
    (InputError("malloc.toml", "malloc", "out of memory", "x"), False), (ValueError("malloc"), False),
])
def test_which_errors_come_of_too_little(error: Exception, short: bool) -> None:
    assert is_shortage(error) is short
    wrapped = KeyError("x")
    wrapped.__cause__ = error
    assert is_shortage(wrapped) is short


def raising(error: Exception) -> Callable[..., int]:
    def run(*_arguments: object) -> int:
        raise error

    return run


@pytest.mark.parametrize("error", [
    MemoryError("Unable to allocate 5 GiB"), RuntimeError("can't start new thread"), OSError(errno.ENOMEM, "no memory"),
])
def test_a_command_says_it_in_one_line(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    error.add_note("pzt_mine/k@1 is saved")
    monkeypatch.setattr(export_command, "run_export", raising(error))
    assert cli.main(["export", str(DISC), "-o", str(tmp_path / "out")]) == 1
    line = capfd.readouterr().err
    assert re.fullmatch(r"memory was not enough: .*Fewer --jobs, a coarser .*; pzt_mine/k@1 is saved\n", line)
    assert str(error) in line


def test_a_factorisation_without_memory_is_not_called_singular(monkeypatch: pytest.MonkeyPatch) -> None:
    from scipy import sparse

    def fails(_data: object) -> Callable[..., object]:
        raise RuntimeError("SUPERLU_MALLOC fails for expanders")

    with pytest.raises(RuntimeError, match="SUPERLU_MALLOC"):
        solve.factorise(sparse.eye_array(3, format="csc") * 1.0, 1e6, fails)
    monkeypatch.setattr(memory, "address_limit", lambda: 1e9)
    monkeypatch.setattr(factorisation, "PLANNED", 1e12)
    from workbench.fem.factorisation import Ldlt

    pytest.importorskip("rslab")
    made = Ldlt(sparse.eye_array(3, format="csc"))
    with pytest.raises(MemoryError, match="of address space were not there for a factorisation"):
        made(sparse.eye_array(3, format="csc").data.astype(complex))


def test_a_process_that_cannot_be_begun_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_arguments: object, **_named: object) -> None:
        raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")

    monkeypatch.setattr(process.subprocess, "Popen", refused)
    workers = Processes(1)
    try:
        with pytest.raises(MemoryError, match="no further process could be begun"):
            workers.map([os.getpid])
    finally:
        workers.close()


def test_an_answer_that_does_not_fit_ends_the_wait() -> None:
    class Huge:
        """A stream with a message that no memory is enough for."""

        def read(self, _size: int) -> bytes:
            raise MemoryError

        readline = read

        def __enter__(self) -> Huge:
            return self

        def __exit__(self, *_: object) -> None: ...

    ended: list[bool] = []
    assert process.messages(Huge(), lambda: ended.append(True)).get(timeout=10.0) is None  # type: ignore[arg-type]
    assert ended


# --- under a real limit -----------------------------------------------------------------------------------------------


def limited(megabytes: float, *words: str) -> subprocess.CompletedProcess[str]:
    """A command in a process whose address space is limited; a hang is a failure."""
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (int(1e6 * megabytes),) * 2)

    return subprocess.run([sys.executable, *words], capture_output=True, text=True, timeout=100.0, cwd=ROOT,
                          preexec_fn=limit, check=False)


@pytest.mark.parametrize(("megabytes", "status", "words"), [
    (200, 1, "memory was not enough: 420 MB of address space were not there for the libraries"),
    (560, 2, "MB, the rest of the 560 MB of address space that ulimit -v allows a process"),
    (1500, 0, "done in"),
])
def test_a_limited_simulation_ends(megabytes: float, status: int, words: str, tmp_path: Path) -> None:
    done = limited(megabytes, "-m", "workbench", "simulate", str(DISC), "--accuracy", "2 %", "--points", "41",
                   "--no-pictures", "--no-cad", "-o", str(tmp_path / "out"))
    assert done.returncode == status, done.stderr
    assert words in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(("death", "words"), [
    ("os.abort()", "signal 6 ended the command"), ("os.kill(os.getpid(), signal.SIGSEGV)", "signal 11 ended"),
    ("np.ones(10**9)", "Unable to allocate 7.45 GiB"), ("np.linalg.inv(np.eye(2))", ""),
    ("[threading.Thread(target=time.sleep, args=(9,), daemon=True).start() for _ in range(900)]", "start new thread"),
])
def test_whatever_a_library_does_is_one_line(death: str, words: str, tmp_path: Path) -> None:
    code = ("import os, signal, sys, threading, time\nimport workbench.cli as cli\n"
            "from workbench.jobs import memory\n"
            "def run(command, options, console, interrupted):\n"
            f"    import numpy as np\n    {death}\n    return 0\n"
            f"cli._run = run\nsys.argv[1:] = ['export', {str(DISC)!r}, '-o', {str(tmp_path / 'out')!r}]\n"
            "sys.exit(cli.main())\n")
    done = limited(1500, "-c", code)
    assert done.returncode == (1 if words else 0), done.stderr
    assert done.stderr.count("\n") == (1 if words else 0)
    assert words in done.stderr
    assert not words or done.stderr.startswith("memory was not enough: ")


# --- workers that die -------------------------------------------------------------------------------------------------


def dying(*_arguments: object, **_named: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.fixture
def killed(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Kills each worker process as soon as it has been given a task."""
    call = process.WorkerProcess.call
    kills: list[float] = []

    def killing(self: process.WorkerProcess, task: Callable[..., object], seconds: float | None = None) -> object:
        os.kill(self._process.pid, signal.SIGKILL)
        kills.append(time.monotonic())
        return call(self, task, seconds)

    monkeypatch.setattr(process.WorkerProcess, "call", killing)
    return kills


STUDY = """
[study]
chip = "{chip}"
figures = ["f0"]
accuracy = "2 %"
relative_error = "5 %"
confirm = 0
[sample]
method = "sobol"
points = 2
seed = 1
[vary]
"transducer.thickness" = {{ tolerance = "2 um" }}
"""


def test_a_study_whose_worker_is_killed_says_so(
    killed: list[float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "study.toml").write_text(STUDY.format(chip=DISC))
    assert cli.main(["study", str(tmp_path / "study.toml"), "--jobs", "2", "-o", str(tmp_path / "out")]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "a worker process ended before its work was done (signal 9): it was killed, or the memory was not" in said
    assert "2 of 2 points remain" in said
    assert killed


def test_a_solid_model_whose_process_is_killed_says_so(
    killed: list[float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["simulate", str(DISC), "--accuracy", "2 %", "--points", "11", "--no-pictures", "-o",
                     str(tmp_path / "out")]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "the solid model was not made; --no-cad leaves it out (a worker process ended" in said
    assert killed


def test_a_batch_of_fits_names_those_whose_worker_is_killed(killed: list[float], tmp_path: Path) -> None:
    from workbench.fitting.batch import Job, Settings

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fit_command, "_fitted", dying)
        workers = Processes(2)
        try:
            failed = fit_command.fit_all([Job("a", ()), Job("b", ())], Settings(), tmp_path, workers, lambda *_: None)
        finally:
            workers.close()
    assert sorted(failed) == ["a", "b"]
    assert all(words.startswith("WorkerEnded: a worker process ended") for words in failed.values())
    assert len(killed) == 2


def test_a_work_of_the_live_view_that_is_killed_says_so(killed: list[float]) -> None:
    from functools import partial

    from workbench.app.background import Background
    from workbench.jobs.process import stream

    said: list[tuple[str, bool]] = []
    works = Background(lambda _kind, words, at_work: said.append((words, at_work)))
    started = works.start("model", lambda _say, _stopped: str(list(stream(partial(dying)))))
    assert started is not None
    started.result(timeout=60.0)
    works.close()
    assert said[-1] == ("WorkerEnded: a worker process ended before its work was done (signal 9): it was killed, or "
                        "the memory was not enough", False)
    short = works_of(MemoryError("no room"))
    assert short == "MemoryError: no room"
    assert issubclass(WorkerEnded, RuntimeError)


def works_of(error: Exception) -> str:
    """The last words of a work that raises an error."""
    from workbench.app.background import Background

    said: list[str] = []
    works = Background(lambda _kind, words, _at_work: said.append(words))
    started = works.start("model", raising(error))  # type: ignore[arg-type]
    assert started is not None
    started.result(timeout=60.0)
    works.close()
    return said[-1]
