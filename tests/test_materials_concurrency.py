"""Saving from many processes at once, and being killed in the middle of it."""

from __future__ import annotations

import itertools
import subprocess
import sys
from pathlib import Path

import pytest

import materials
from materials import Registry, history
from materials.versions import put

ROOT = Path(materials.__file__).parent.parent

#: One process that saves `count` fits, each with a figure of its own, when all are ready.
SAVER = """
import sys
from dataclasses import replace
from pathlib import Path
from materials import Fit, RecordingSource, Registry, fitted, save_fit
folder, first, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
start = Registry().load("pzt5a/erturk_2011")
fit = Fit(recordings=(RecordingSource("disc.csv", "0" * 64, "disc.toml"),), algorithm="joint", software="x 1",
          date="2026-11-21", band=(910e3, 1155e3), mape_percent=0.0, rms_log_residual=0.005, confidence=0.95, free=())
def store(k):
    return save_fit(fitted(start, {}, fit=replace(fit, mape_percent=float(k))), "pzt4/disc_7", folder=folder)
"""


def test_200_saves_at_once_lose_nothing(tmp_path: Path) -> None:
    processes, each = 8, 25
    script = SAVER + """
print("ready", flush=True)
sys.stdin.readline()
for k in range(first, first + count):
    print(k, store(k), flush=True)
"""
    running = [subprocess.Popen([sys.executable, "-c", script, str(tmp_path), str(n * each), str(each)], cwd=ROOT,
                                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for n in range(processes)]
    for process in running:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    for process in running:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    said = [line.split() for process in running for line in process.communicate()[0].splitlines()]
    assert [process.returncode for process in running] == [0] * processes
    total = processes * each
    assert sorted(name for _, name in said) == sorted(f"pzt4/disc_7@{k + 1}" for k in range(total))
    # Who ran first must not have been alone: else this would hold of any way of saving.
    order = [int(k) // each for k, _ in sorted(said, key=lambda row: int(row[1].split("@")[1]))]
    assert sum(a != b for a, b in itertools.pairwise(order)) > processes
    versions = history(Registry((tmp_path,)), "pzt4/disc_7")
    assert [version.fault for version in versions] == [""] * total
    found = {version.name: version.material.fit.mape_percent for version in versions
             if version.material is not None and version.material.fit is not None}
    assert found == {name: float(k) for k, name in said}
    assert {path.suffix for path in (tmp_path / "pzt4").iterdir()} == {".toml"}


def test_a_save_killed_at_any_moment_leaves_a_readable_registry(tmp_path: Path) -> None:
    # One process makes children that save as fast as they can, and kills each after a random time. It is no thread's
    # and no library's business but its own, so it may fork.
    script = SAVER + """
import itertools, os, random, signal, time
random.seed(20261121)
store(0)
for round_ in range(10 * count):
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.write(writer, b"x")
        for k in itertools.count(1000 * (1 + round_)):
            store(k)
    os.read(reader, 1)
    time.sleep(random.uniform(0.0, 0.04))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    os.close(reader); os.close(writer)
    # Every name that is there is of an entry that can be read; and the newest one is found.
    registry = Registry((folder,))
    for name in [name for name in registry.names() if "disc_7" in name][-3:]:
        registry.load(name)
    registry.load("pzt4/disc_7")
    store(1 + round_)
    # Some of the kills came between the beginning and the end of a save, or nothing was tried.
    if round_ + 1 >= count and len(list((folder / "pzt4").glob(".*.part"))) >= 5:
        break
"""
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path), "0", "60"], cwd=ROOT, capture_output=True,
                          text=True, check=False)
    assert done.returncode == 0, done.stderr
    versions = history(Registry((tmp_path,)), "pzt4/disc_7")
    assert [version.fault for version in versions if version.fault] == []
    assert [int(version.name.split("@")[1]) for version in versions] == list(range(1, len(versions) + 1))
    assert len(versions) > 61
    assert len(list((tmp_path / "pzt4").glob(".*.part"))) >= 5


def test_a_save_killed_before_any_of_its_lines_leaves_a_readable_registry(tmp_path: Path) -> None:
    # What chance may miss: the child kills itself before the 1st, 2nd ... line of what saves, to the last.
    script = SAVER + """
import os, signal
from materials.versions import put
def dying(left):
    def line(frame, event, argument):
        nonlocal left
        left -= event == "line"
        if left < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return line
    own = save_fit.__code__, put.__code__
    return lambda frame, event, argument: line if frame.f_code in own else None
store(0)
registry, kills, status = Registry((folder,)), 0, 1
while status and kills < 200:
    child = os.fork()
    if child == 0:
        sys.settrace(dying(kills))
        try:
            store(1 + kills)
        finally:
            os._exit(0)
    status = os.waitpid(child, 0)[1]
    kills += 1
    registry.load("pzt4/disc_7")
print(kills)
"""
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path), "0", "0"], cwd=ROOT, capture_output=True,
                          text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert 25 < int(done.stdout) < 200
    versions = history(Registry((tmp_path,)), "pzt4/disc_7")
    assert [version.fault for version in versions if version.fault] == []
    # The first, those killed after their version was in place, and the last.
    assert 2 < len(versions) < 20


def test_a_half_written_file_is_nobodys(tmp_path: Path) -> None:
    (tmp_path / "pzt4").mkdir()
    (tmp_path / "pzt4" / ".disc_7@1.x.part").write_text('kind = "piezo')
    assert Registry((tmp_path,)).names() == Registry().names()


def test_a_name_that_exists_is_never_taken(tmp_path: Path) -> None:
    first, second = tmp_path / "a.toml", tmp_path / "b.toml"
    first.write_text("there")
    assert put(b"new", [first, second]) == second
    with pytest.raises(FileExistsError):
        put(b"newer", [first, second])
    assert (first.read_text(), second.read_text()) == ("there", "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.toml", "b.toml"]
