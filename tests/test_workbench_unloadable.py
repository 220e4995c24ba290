"""Without VTK, CadQuery, gmsh or trame: the rest works, and messages name the missing package."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support import pot

from geometry.chip import read_chip
from geometry.chip_file import write_chip

ROOT = Path(__file__).resolve().parent.parent
CHIP = str(ROOT / "geometry/chips/free_disc_25x2.toml")
STACK = ROOT / "geometry/chips/small_campaign/chip.toml"
#: Modules that cannot be imported, by package.
MODULES = {"VTK": ("vtk", "vtkmodules"), "pyvista": ("pyvista",), "CadQuery": ("cadquery", "OCP"), "gmsh": ("gmsh",),
           "trame": ("trame", "trame_client", "trame_server"), "trame-vuetify": ("trame_vuetify",)}
#: What works without all of them.
PROGRAM = f"""
import workbench as wb
chip = wb.read_chip({CHIP!r})
run = wb.simulate(chip, points=41, accuracy=1e-2)
print("f0", round(run.figures.f0, -3), wb.Registry().load("water").sound_speed)
recording = wb.read_recording({str(ROOT / "tests/data/spectra/e4990a_z_theta.csv")!r})
print("read", recording.spectrum.frequency.size)
stack = wb.read_chip({str(STACK)!r})
empty = wb.read_recording({str(ROOT / "geometry/chips/small_campaign/empty.csv")!r})
found = wb.fit(empty, stack, "polymer", state="empty", region="substrate", accuracy=1e-2)
print("fitted", len(found.result.estimates))
"""


def run(folder: Path, missing: tuple[str, ...], *words: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a folder; the modules of the `missing` packages cannot be imported, in child processes either."""
    names = [name for package in missing for name in MODULES[package]]
    (folder / "sitecustomize.py").write_text(
        f"import sys; sys.modules.update(dict.fromkeys({names}))", encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)]), "COLUMNS": "300",
                   "XDG_DATA_HOME": str(folder / "data")}
    return subprocess.run([sys.executable, "-W", "ignore", *words], cwd=folder, env=environment, capture_output=True,
                          text=True, timeout=300)


def test_spectra_fits_readers_and_materials_work_without_all_of_them(tmp_path: Path) -> None:
    done = run(tmp_path, tuple(MODULES), "-c", PROGRAM)
    assert done.returncode == 0, done.stderr
    assert [line.split()[0] for line in done.stdout.splitlines()] == ["f0", "read", "fitted"]
    for command in (("materials", "list"), ("simulate", CHIP, "--points", "41", "--accuracy", "1 %", "--no-cad",
                                            "--no-pictures", "-o", "out")):
        done = run(tmp_path, tuple(MODULES), "-m", "workbench.cli", *command)
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "report.html").is_file()
    assert (tmp_path / "out" / "spectrum.csv").is_file()


@pytest.mark.parametrize(("package", "words", "command"), [
    ("VTK", "need VTK", ("render", CHIP, "--accuracy", "1 %", "--at", "1.03 MHz", "-o", "out")),
    ("pyvista", "the package pyvista cannot be loaded", (
        "render", CHIP, "--accuracy", "1 %", "--at", "1.03 MHz", "--vtu", "-o", "out")),
    ("CadQuery", "need CadQuery", ("export", CHIP, "-o", "out")),
    ("gmsh", "needs gmsh", ("mesh", "pot.toml")),
    ("trame", "trame", ("app", CHIP)),
    ("trame-vuetify", "trame-vuetify", ("app", CHIP)),
])
def test_a_message_names_the_package(package: str, words: str, command: tuple[str, ...], tmp_path: Path) -> None:
    # Rounded edges need gmsh; layers with straight sides do not.
    write_chip(pot(read_chip(STACK), fillet=0.2e-3), tmp_path / "pot.toml")
    done = run(tmp_path, (package,), "-m", "workbench.cli", *command)
    message = " ".join(done.stderr.split())
    assert done.returncode == 1, message
    assert words in message
    assert "Traceback" not in message
