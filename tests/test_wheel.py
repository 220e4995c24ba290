"""The wheel holds chips, materials and templates, and runs outside the checkout; the source archive holds the rest."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
#: Files that are no modules, by the folders that hold them.
DATA = {"geometry/chips": "**/*.*", "materials/data": "**/*.toml", "workbench/readers": "*.toml",
        "workbench/report/templates": "*.html"}
#: A program of a user without a checkout.
PROGRAM = """
import workbench as wb
from workbench.commands.chips import SHIPPED
chip = wb.read_chip(SHIPPED / "free_disc_25x2.toml")
run = wb.simulate(chip, points=21, accuracy=1e-2)
print(run.figures, wb.__file__)
"""


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of the wheel in a folder, as pip places them."""
    folder = tmp_path_factory.mktemp("wheel")
    # A build leaves files beside its sources.
    for name in ("workbench", "geometry", "materials"):
        shutil.copytree(ROOT / name, folder / "source" / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder / "source" / name)
    subprocess.run([sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation",
                    "--disable-pip-version-check", "-w", str(folder), str(folder / "source")], check=True,
                   capture_output=True, timeout=300)
    (wheel,) = folder.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(folder / "site")
    return folder / "site"


def test_the_wheel_has_all_data(unpacked: Path) -> None:
    for folder, pattern in DATA.items():
        expected = {path.relative_to(ROOT) for path in (ROOT / folder).glob(pattern)}
        assert expected, folder
        assert {path.relative_to(unpacked) for path in (unpacked / folder).glob(pattern)} == expected
    tops = {path.name for path in unpacked.iterdir() if not path.name.endswith(".dist-info")}
    assert tops == {"workbench", "geometry", "materials"}


def test_the_wheel_runs_outside_the_checkout(unpacked: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(unpacked), "XDG_DATA_HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", PROGRAM], cwd=tmp_path, env=environment,
                          capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert str(unpacked) in done.stdout


def test_the_source_archive_holds_every_file_of_the_checkout() -> None:
    done = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        pytest.skip("no checkout: the files of a source archive are not under git")
    named = {word for line in (ROOT / "MANIFEST.in").read_text(encoding="utf-8").splitlines()
             if line.startswith(("graft", "include")) for word in line.split()[1:]}
    tops = {name.split("/")[0] for name in done.stdout.splitlines()}
    # Packages, and the file of the build, are in every archive; .ci is of one forge.
    assert tops - {"workbench", "geometry", "materials", "pyproject.toml", "MANIFEST.in", ".ci"} == named
