"""Ctrl-C at any moment: no traceback, status 130, and a sentence that names what is on disk."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support import visible

from workbench.cli import main
from workbench.commands import export as export_command
from workbench.files.output import MARK
from workbench.files.writing import write_atomic
from workbench.jobs.interruption import Interruption, heeded, on_disk

ROOT = Path(__file__).resolve().parent.parent
CHIP = str(ROOT / "geometry/chips/disc_20x2.toml")


def command(*words: str) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                            cwd=ROOT, start_new_session=True)


def test_while_libraries_are_loaded_it_ends_at_once(tmp_path: Path) -> None:
    # The first library that the command loads interrupts it as a terminal does.
    code = ("import os, signal, sys, types\n"
            "class Finder:\n"
            "    def find_spec(self, name, path=None, target=None):\n"
            "        if name == 'workbench.commands.simulate': os.killpg(0, signal.SIGINT)\n"
            "sys.meta_path.insert(0, Finder())\n"
            "from workbench.cli import main\n"
            f"sys.argv[1:] = ['simulate', {CHIP!r}, '-o', {str(tmp_path / 'out')!r}]\n"
            "sys.exit(main())\n")
    process = command("-c", code)
    said, _ = process.communicate(timeout=60.0)
    assert (process.returncode, said) == (
        130, f"interrupted: nothing was begun, and nothing written to {tmp_path / 'out'}\n")


@pytest.mark.parametrize("swallowed", [False, True])
def test_at_work_it_says_what_is_on_disk(swallowed: bool, tmp_path: Path) -> None:
    """Also where a destructor swallows the exception, which Python would print and forget."""
    code = ("import os, signal, sys, time\n"
            "from workbench.cli import main\n"
            "from workbench.commands import export\n"
            "from workbench.commands.parsed_options import output_folder\n"
            "from workbench.files.ownership import Outputs\n"
            "from workbench.files.writing import write_atomic\n"
            "class Gone:\n"
            "    def __del__(self): os.killpg(0, signal.SIGINT); time.sleep(0.2)\n"
            "def run(options, console):\n"
            "    write_atomic(output_folder(options, Outputs('export')) / 'chip.step', 'x')\n"
            + ("    Gone()\n" if swallowed else "    os.killpg(0, signal.SIGINT)\n") +
            "    time.sleep(30.0)\n"
            "export.run_export = run\n"
            f"sys.argv[1:] = ['export', {CHIP!r}, '-o', {str(tmp_path / 'out')!r}]\n"
            "sys.exit(main())\n")
    began = time.perf_counter()
    process = command("-c", code)
    said, _ = process.communicate(timeout=60.0)
    assert (process.returncode, said) == (
        130, f"interrupted: {tmp_path / 'out'} holds chip.step; {MARK} says that this is not all\n")
    assert time.perf_counter() - began < 25.0


@pytest.mark.parametrize(("end", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)])
def test_a_request_to_end_is_heeded_as_ctrl_c_and_ends_the_workers(end: signal.Signals, status: int, tmp_path: Path
                                                                   ) -> None:
    code = ("import os, sys, time\n"
            "from functools import partial\n"
            "from workbench.cli import main\n"
            "from workbench.commands import export\n"
            "from workbench.commands.parsed_options import output_folder\n"
            "from workbench.files.ownership import Outputs\n"
            "from workbench.files.writing import write_atomic\n"
            "from workbench.jobs.workers import begin_workers\n"
            "def run(options, console):\n"
            "    folder = output_folder(options, Outputs('export'))\n"
            "    with begin_workers(2) as workers:\n"
            "        write_atomic(folder / 'pid', str(workers.map([os.getpid])[0]))\n"
            "        workers.map([partial(time.sleep, 60.0)])\n"
            "export.run_export = run\n"
            f"sys.argv[1:] = ['export', {CHIP!r}, '-o', {str(tmp_path / 'out')!r}]\n"
            "sys.exit(main())\n")
    process = command("-c", code)
    pid = tmp_path / "out" / "pid"
    deadline = time.monotonic() + 60.0
    while not pid.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(end)  # to the command alone
    said, _ = process.communicate(timeout=60.0)
    assert (process.returncode, said) == (
        status, f"interrupted: {tmp_path / 'out'} holds pid; {MARK} says that this is not all\n")
    while Path(f"/proc/{pid.read_text()}").exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_signal_that_does_not_wake_the_main_thread_is_sent_again(tmp_path: Path) -> None:
    """As one that arrives just before the main thread falls asleep; here another thread takes it."""
    code = ("import signal, sys, threading, time\n"
            "from workbench.cli import main\n"
            "from workbench.commands import export\n"
            "def interrupt():\n"
            "    time.sleep(0.2)\n"
            "    signal.pthread_kill(threading.get_ident(), signal.SIGTERM)\n"
            "    time.sleep(30.0)\n"
            "def run(options, console):\n"
            "    threading.Thread(target=interrupt, daemon=True).start()\n"
            "    threading.Event().wait()\n"
            "export.run_export = run\n"
            f"sys.argv[1:] = ['export', {CHIP!r}, '-o', {str(tmp_path / 'out')!r}]\n"
            "sys.exit(main())\n")
    process = command("-c", code)
    try:
        said, _ = process.communicate(timeout=25.0)
    finally:
        process.kill()
    assert process.returncode == 143
    assert said.startswith("interrupted: ")


def test_a_hangup_that_is_ignored_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as under nohup
    try:
        with heeded(stays=False) as found:
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            assert signal.getsignal(signal.SIGTERM) == found.handle
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)


def test_what_a_library_makes_of_it_is_an_interruption_all_the_same(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def run(*_arguments: object) -> int:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError("module could not be initialised") from None
        return 0

    monkeypatch.setattr(export_command, "run_export", run)
    assert main(["export", CHIP, "-o", str(tmp_path / "out")]) == 130
    assert f"interrupted: {tmp_path / 'out'} holds nothing" in " ".join(capsys.readouterr().err.split())
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_an_interrupted_simulation_had_computed_is_written(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def interrupted(*_arguments: object, **_named: object) -> None:
        signal.raise_signal(signal.SIGINT)

    # After the spectrum, before the fields.
    monkeypatch.setattr("workbench.simulation.run._snapshot", interrupted)
    monkeypatch.setattr("workbench.commands.simulate.ThreadPoolExecutor", _Here)
    out = tmp_path / "out"
    assert main(["simulate", CHIP, "--accuracy", "0.5 %", "--points", "11", "--no-cad", "-o", str(out)]) == 130
    assert f"{out} holds spectrum_default.csv; {MARK}" in " ".join(capsys.readouterr().err.split())
    assert visible(out) == [MARK, "spectrum_default.csv"]


class _Here:
    """An executor that works where it is asked."""

    def __init__(self, **_named: object) -> None: ...

    def submit(self, work: object, *arguments: object, **named: object) -> object:
        return work(*arguments, **named)

    def shutdown(self, **_named: object) -> None: ...


def test_the_sentence_names_new_files_and_counts_old_ones(tmp_path: Path) -> None:
    now = time.time()
    write_atomic(tmp_path / "old.csv", "x")
    os.utime(tmp_path / "old.csv", (now - 100.0, now - 100.0))
    assert on_disk(tmp_path, now) == f"interrupted: {tmp_path} holds 1 file from before"
    write_atomic(tmp_path / "models" / "0.npz", "x")
    assert on_disk(tmp_path, now) == f"interrupted: {tmp_path} holds models/0.npz and 1 file from before"
    for number in range(20):
        write_atomic(tmp_path / f"{number:02d}.csv", "x")
    assert "10.csv, 11.csv and 9 more files and 1 file from before" in on_disk(tmp_path, now)
    # A command that writes a file, and its report beside it.
    write_atomic(tmp_path / "run.h5", "x")
    assert on_disk(tmp_path / "run.h5", now) == f"interrupted: {tmp_path} holds run.h5"
    other = tmp_path / "other.h5"
    assert on_disk(other, now) == f"interrupted: {other} holds nothing; nothing was finished"
    assert on_disk(None, now) == "interrupted: the command writes no files"


def test_a_second_press_at_the_same_moment_is_the_same_one() -> None:
    found = Interruption()
    found.stage = "working"
    with pytest.raises(KeyboardInterrupt):
        found.handle(signal.SIGINT, None)
    found.handle(signal.SIGINT, None)
    assert found.requested
    with heeded(stays=False) as other:
        assert signal.getsignal(signal.SIGINT) == other.handle
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
