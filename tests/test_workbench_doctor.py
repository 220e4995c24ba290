"""``workbench doctor``: it finds planted faults, names their remedies, and needs no library itself."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import subprocess
import sys
from collections import namedtuple
from pathlib import Path

import pytest

from workbench.cli import main
from workbench.commands import doctor
from workbench.installation import check, libraries, machine, ports
from workbench.installation.check import Check, Defect, in_own_process, run_checks
from workbench.instruments.opening import FoundPort

Usage = namedtuple("Usage", "free")


def defect(name: str) -> Defect:
    """The defect that a check of the command finds."""
    with pytest.raises(Defect) as caught:
        doctor.checks()[name]()
    return caught.value


def plant(folder: Path, monkeypatch: pytest.MonkeyPatch, files: dict[str, str]) -> None:
    """Modules that processes find before the installed ones."""
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    monkeypatch.syspath_prepend(folder)


@pytest.mark.parametrize(("name", "module"), [
    ("cadquery", "cadquery"), ("gmsh", "gmsh"), ("vtk", "vtkmodules"), ("trame", "trame")])
def test_a_package_that_cannot_be_imported_is_a_fault(
    name: str, module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(tmp_path, monkeypatch, {f"{module}.py": f"raise ImportError('no {name} here')"})
    found = defect(name)
    assert str(found) == f"ImportError: no {name} here"
    assert found.status == "fault"
    assert found.remedy.startswith(f"run ./setup, or pip install '{name}")


def test_a_missing_library_of_the_system_has_its_debian_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(tmp_path, monkeypatch, {"gmsh.py": "raise OSError('libGLU.so.1: cannot open shared object file')"})
    assert defect("gmsh").remedy == "apt-get install libglu1-mesa (or ./setup)"


def test_every_library_of_setup_has_its_debian_package() -> None:
    text = (machine.ROOT / "setup").read_text(encoding="utf-8")
    for library, debian in check.LIBRARIES.items():
        assert f" {library}." in text
        assert f" {debian}" in text


def test_an_old_numpy_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plant(tmp_path, monkeypatch, {
        "numpy.py": "", "numpy-1.26.4.dist-info/METADATA": "Metadata-Version: 2.1\nName: numpy\nVersion: 1.26.4\n"})
    assert str(defect("numpy")) == "1.26.4 is older than 2.0"
    assert defect("numpy").remedy == "run ./setup, or pip install 'numpy>=2.0'"


def test_a_package_without_metadata_is_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plant(tmp_path, monkeypatch, {"of_a_distribution.py": ""})
    assert libraries.package("of-a-distribution", "2.0") == "of unknown version"


def test_the_bounds_are_those_of_the_project() -> None:
    assert libraries.required().items() >= {("numpy", "2.0"), ("gmsh", "4.13"), ("trame-vuetify", "2.6"), ("vtk", "")}


def test_a_process_that_crashes_or_hangs_is_a_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(Defect, match=r"^crashed with SIGABRT: before$"):
        in_own_process("print('\\x1b[33mbefore\\x1b[0m', file=sys.stderr, flush=True); import os; os.abort()", "")
    monkeypatch.setattr(check, "LONGEST_PROCESS", 0.5)
    monkeypatch.setattr(check, "LINE_PERIOD", 0.1)
    lines = list[str]()
    slow, fine = run_checks({"slow": lambda: in_own_process("import time; time.sleep(60)", "install it again"),
                             "fine": lambda: "here"}, jobs=2, waiting=lines.append)
    assert (slow.status, fine.status) == ("warning", "ok")
    assert slow.words == "no result within 0.5 s: a slow or busy machine, or a library that hangs"
    assert slow.remedy.endswith("if the warning stays, install it again")
    assert len(lines) >= 2
    assert re.fullmatch(r"waiting for slow \(\d s; at most 0\.5 s each\)", lines[-1])


def test_no_egl_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sitecustomize.py").write_text("import ctypes.util\nctypes.util.find_library = lambda name: None\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.delenv("DISPLAY", raising=False)
    found = defect("off screen")
    assert "no display and no EGL library" in str(found)
    assert "libegl1" in found.remedy


def test_no_font_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plant(tmp_path, monkeypatch, {"matplotlib/__init__.py": "", "matplotlib/font_manager.py": (
        "FontProperties = dict\n"
        "def findfont(font, fallback_to_default): raise ValueError('Failed to find font sans-serif')\n")})
    assert str(defect("font")) == "ValueError: Failed to find font sans-serif"
    assert "matplotlib" in defect("font").remedy


def test_an_unwritable_data_folder_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "data").write_text("a file in the way")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    found = defect("data folder")
    assert str(tmp_path / "data" / "acoustofluidic-chip-workbench") in str(found)
    assert "cannot be written to: Not a directory" in str(found)
    assert found.remedy.endswith("or set XDG_DATA_HOME to a folder of your own")


def test_a_full_disk_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine.shutil, "disk_usage", lambda path: Usage(3e6))
    assert "its disk has 3 MB free; a command needs 20 MB" in str(defect("current folder"))

    def full(**_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(machine.tempfile, "TemporaryFile", full)
    assert defect("temporary folder").remedy == (
        "the disk is full: make room, or choose a folder on another disk, or set TMPDIR to a folder of your own")


def found_port(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Make a port the only one of this computer."""
    monkeypatch.setattr("workbench.instruments.opening.found_ports", lambda: [FoundPort(name, "USB Serial")])


def test_a_port_is_ready_or_in_use(monkeypatch: pytest.MonkeyPatch) -> None:
    own, other = os.openpty()
    name = os.ttyname(other)
    found_port(monkeypatch, name)
    assert ports.serial_ports() == f"{name} (USB Serial): ready"
    fcntl.flock(other, fcntl.LOCK_EX)
    found = defect("ports")
    os.close(own)
    os.close(other)
    assert (str(found), found.status) == (f"{name} (USB Serial): in use", "warning")
    assert found.remedy == "end the other program that uses the port"


def test_a_port_without_permission_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(path: str, flags: int) -> int:
        raise PermissionError(errno.EACCES, "Permission denied", path)

    (tmp_path / "ttyUSB0").touch()
    found_port(monkeypatch, str(tmp_path / "ttyUSB0"))
    monkeypatch.setattr(ports.os, "open", denied)
    found = defect("ports")
    assert (str(found), found.status) == (f"{tmp_path / 'ttyUSB0'} (USB Serial): not permitted", "fault")
    assert found.remedy == f"sudo usermod -aG {(tmp_path / 'ttyUSB0').group()} $USER, then log in again"
    monkeypatch.setattr(ports, "BUILT_IN", str(tmp_path))
    assert defect("ports").status == "warning"


@pytest.mark.parametrize(("value", "threads"), [("64", 2), ("0", 2), ("many", 2), ("2", 64)])
def test_too_many_threads_of_linear_algebra_are_a_warning(
    value: str, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine, "processors", lambda: 2)
    for name in machine.ONE_THREAD:
        monkeypatch.setenv(name, "2")
    monkeypatch.setattr(machine, "in_own_process", lambda code, remedy: "openblas 0.3.30, threads: 2")
    assert machine.linear_algebra() == "openblas 0.3.30, threads: 2"
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", value)
    monkeypatch.setattr(machine, "in_own_process", lambda code, remedy: f"openblas 0.3.30, threads: {threads}")
    found = defect("linear algebra")
    assert f"threads: {threads}" in str(found)
    assert str(found).endswith("on 2 processors")
    assert (f"OPENBLAS_NUM_THREADS={value}" in str(found)) == (threads == 2)
    assert found.status == "warning"
    assert found.remedy.startswith("set OPENBLAS_NUM_THREADS")


def test_processors_are_those_of_the_control_group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "GROUPS", tmp_path)
    monkeypatch.setattr(machine.os, "sched_getaffinity", lambda process: set(range(8)))
    assert machine.processors() == 8
    for text, count in (("max 100000", 8), ("150000 100000", 2), ("50000 100000", 1)):
        (tmp_path / "cpu.max").write_text(text)
        assert machine.processors() == count


@pytest.mark.parametrize(("size", "status", "text"), [
    ("3e8", "fault", "300 MB, a process' share"), ("1e9", "warning", "pictures need 2 GB")])
def test_little_memory_is_a_problem(size: str, status: str, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WORKBENCH_MEMORY_OF_PROCESS", size)
    found = defect("memory")
    assert found.status == status
    assert text in str(found)
    assert "raise the limit" in found.remedy


def test_the_self_test_finds_a_wrong_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    solved = " ".join(map(str, libraries.REFERENCE)) + " 0.5"
    monkeypatch.setattr(libraries, "in_own_process", lambda code, remedy: solved)
    assert libraries.solved_disc() == "relative difference 0.0e+00 at 5 frequencies, 0.5 s"
    for factor in (1.0 + 1e-6, 1.0 - 1e-6j, float("nan")):
        monkeypatch.setattr(libraries, "REFERENCE", (*libraries.REFERENCE[:-1], factor * libraries.REFERENCE[-1]))
        assert "expected at most 1e-08" in str(defect("self-test"))


def test_the_self_test_agrees_here() -> None:
    assert libraries.solved_disc().startswith("relative difference ")


def test_a_check_that_fails_is_a_fault() -> None:
    def broken() -> str:
        raise ModuleNotFoundError("No module named\n'serial'")

    fine, failed = run_checks({"fine": lambda: "here", "ports": broken}, jobs=2)
    assert fine == Check("fine", "ok", "here")
    assert (failed.name, failed.status) == ("ports", "fault")
    assert failed.words == "the check failed: ModuleNotFoundError: No module named 'serial'"


def warned() -> str:
    raise Defect("64 threads", "set it to 1", "warning")


def faulty() -> str:
    raise Defect("not\tfound", "install it")


def test_the_command_prints_lines_and_a_record(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "checks", lambda: {"a": lambda: "1.0", "b": warned})
    assert main(["doctor"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "ok       a                 1.0", "warning  b                 64 threads",
        "         remedy            set it to 1", "2 checks, faults: 0, warnings: 1"]
    monkeypatch.setattr(doctor, "checks", lambda: {"b": warned, "c": faulty})
    assert main(["doctor", "--json"]) == 1
    assert json.loads(capsys.readouterr().out) == {"faults": 1, "warnings": 1, "checks": [
        {"name": "b", "status": "warning", "words": "64 threads", "remedy": "set it to 1"},
        {"name": "c", "status": "fault", "words": "not found", "remedy": "install it"}]}


def test_the_command_loads_no_library() -> None:
    code = ("import sys; from workbench.commands import doctor; doctor.checks(); "
            "print({'numpy', 'scipy', 'cadquery', 'gmsh', 'vtkmodules', 'trame', 'serial', 'rich'} & set(sys.modules))")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
