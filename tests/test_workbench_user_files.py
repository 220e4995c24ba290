"""Commands and the files of the user: none is replaced or removed, and no run passes for another one."""

from __future__ import annotations

import contextlib
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support import visible

from workbench.cli import main
from workbench.files.output import MARK, OutputFolder, begin
from workbench.files.ownership import STATE, Outputs
from workbench.files.writing import write_atomic

CHIPS = Path(__file__).resolve().parent.parent / "geometry/chips"
QUICK = ["--accuracy", "2 %", "--points", "21", "--no-cad", "--no-pictures"]

STUDY = """
[study]
chip = "disc.toml"
figures = ["f0"]
accuracy = "2 %"
relative_error = "1 %"
confirm = 1
[sample]
method = "sobol"
points = 4
seed = 1
[vary]
"transducer.thickness" = { tolerance = "10 um" }
"""

GOAL = """
[goal]
chip = "disc.toml"
maximise = "q"
[variables]
transducer.thickness = { from = "1.99 mm", to = "2.01 mm", step = "10 um" }
"""


@pytest.fixture
def here(tmp_path: Path) -> Path:
    """A folder of the user with a chip file, a study and a goal."""
    shutil.copy(CHIPS / "disc_20x2.toml", tmp_path / "disc.toml")
    (tmp_path / "study.toml").write_text(STUDY)
    (tmp_path / "goal.toml").write_text(GOAL)
    return tmp_path


def files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


COMMANDS = {
    "study": ["study", "study.toml", "--jobs", "1"],
    "simulate": ["simulate", "disc.toml", *QUICK],
    "design": ["design", "goal.toml", "--no-cad", "--jobs", "1"],
    "export": ["export", "disc.toml"],
    "render": ["render", "disc.toml", "--at", "1 MHz"],
    "tolerance": ["tolerance", "disc.toml"],
    "sensitivity": ["sensitivity", "disc.toml"],
    "mesh": ["mesh", "disc.toml", "--converge"],
    "compare": ["compare", "recording.csv", "disc.toml"],
    "fit": ["fit", "pzt", "recording.csv", "--chip", "disc.toml"],
    "fit batch": ["fit", "batch", "batch.toml"],
    "diagnose": ["diagnose", "recording.csv", "--chip", "disc.toml"],
    "particles": ["particles", "chip.toml", "--drive", "1 Vpp"],
}

BATCH = """
[[recordings]]
name = "one"
kind = "pzt"
file = "recording.csv"
chip = "disc.toml"
"""

#: Names of files of a user; some are those of results.
NAMES = ["report.html", "spectrum.csv", "merit.json", "begun.json", "models/0.npz", "points/survey.csv", "best.toml",
         "front/01.toml", "chip.step", "transducer.stl", "displacement_default.png", "fit.json", "one/fit.json",
         "recording_fitted.csv", "diagnosis.json", "tolerance.json", "ranking.png", "residual.png", "convergence.json",
         "trajectories.npz", "notes.txt", "models/chip.step", "one/notes.txt", ".hidden", MARK, f"{STATE}/notes.txt"]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that all commands read."""
    folder = tmp_path_factory.mktemp("inputs")
    root = CHIPS.parent.parent
    shutil.copy(CHIPS / "disc_20x2.toml", folder / "disc.toml")
    shutil.copy(root / "geometry/chips/small_campaign/chip.toml", folder / "chip.toml")
    shutil.copy(root / "tests/data/reference/free_disc_nominal_rho7500.csv", folder / "recording.csv")
    for name, text in (("study", STUDY), ("goal", GOAL), ("batch", BATCH)):
        (folder / f"{name}.toml").write_text(text)
    return folder


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(command=st.sampled_from(sorted(COMMANDS)), mine=st.lists(st.sampled_from(NAMES), max_size=3, unique=True),
       ends=st.sampled_from(["refused", "fails", "interrupted", "killed"]))
def test_files_of_the_user_are_what_they_were_after_any_command(
    inputs: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch, command: str,
    mine: list[str], ends: str
) -> None:
    """Every command begins for real, writes a file of each of its names, and ends early."""
    folder = tmp_path_factory.mktemp("user")
    for name in mine:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("mine")
    before = files(folder)
    begun: list[OutputFolder] = []

    def beginning(*arguments: Any, **named: Any) -> OutputFolder:
        found = begin(*arguments, **named)
        begun.append(found)
        for name in found.outputs.names:
            write_atomic(found.path / name.replace("*", "x").replace("?", "x"), "result")
        if ends == "killed":
            # As after a kill: the lock is free, and nothing was settled.
            os.close(found._lock)
            found._lock = -1
        if ends == "interrupted":
            raise KeyboardInterrupt
        raise RuntimeError("it fails")

    with monkeypatch.context() as patched, contextlib.chdir(inputs):
        patched.setattr("workbench.commands.parsed_options.begin", beginning)
        status = main([*COMMANDS[command], "-o", str(folder)])
    after = files(folder)
    if begun:
        assert status == (130 if ends == "interrupted" else 1)
        assert {name: after.get(name) for name in before} == before
        assert MARK in after
    else:
        assert status == 2
        assert after == before


@pytest.mark.parametrize(("words", "mine"), [
    (["study", "study.toml", "--jobs", "1"], ["models/my_model.step", "points/survey.csv"]),
    (["study", "study.toml", "--jobs", "1", "--overwrite"], ["models/my_model.step", "points/survey.csv"]),
    (["simulate", "disc.toml", *QUICK], ["spectrum.csv"]),
    (["simulate", "disc.toml", *QUICK], ["report.html", "merit.json"]),
    (["design", "goal.toml", "--no-cad", "--jobs", "1"], ["best.toml"]),
    (["design", "goal.toml", "--no-cad", "--jobs", "1"], ["front/01.toml"]),
    (["export", "disc.toml"], ["transducer.stl"]),
    (["render", "disc.toml", "--at", "1 MHz"], ["displacement_default.png"]),
    (["tolerance", "disc.toml"], ["tolerance.json"]),
    (["sensitivity", "disc.toml"], ["ranking.png"]),
    (["mesh", "disc.toml", "--converge"], ["convergence.json"]),
    (["compare", "recording.csv", "disc.toml"], ["residual.png"]),
    (["fit", "pzt", "recording.csv", "--chip", "disc.toml"], ["fit.json", "recording_fitted.csv"]),
    (["diagnose", "recording.csv", "--chip", "disc.toml"], ["diagnosis.json"]),
])
def test_a_folder_with_files_of_the_user_under_names_of_the_command_is_refused(
    here: Path, words: list[str], mine: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before anything is computed: each of these would take seconds."""
    shutil.copy(CHIPS.parent.parent / "tests/data/reference/free_disc_nominal_rho7500.csv", here / "recording.csv")
    for name in mine:
        (here / name).parent.mkdir(exist_ok=True)
        (here / name).write_text("mine")
    before = files(here)
    monkeypatch.chdir(here)
    assert main([*words, "-o", "."]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert all(name in said for name in mine)
    assert f"`workbench {words[0]}" in said
    assert files(here) == before


def test_other_files_of_the_user_may_lie_beside_the_results(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "notes.txt").write_text("mine")
    (here / ".lock").symlink_to(here / "notes.txt")
    before = files(here)
    monkeypatch.chdir(here)
    assert main(["study", "study.toml", "--jobs", "1", "-o", "."]) == 0
    assert main(["study", "study.toml", "--jobs", "1", "-o", "."]) == 0
    capsys.readouterr()
    # The report is the study's, so another command may replace it.
    assert main(["simulate", "disc.toml", *QUICK, "-o", "."]) == 0
    assert "begun.json, " in (said := " ".join(capsys.readouterr().err.split()))
    assert "are of an earlier `workbench study`" in said
    after = files(here)
    assert {name: after[name] for name in before} == before


def test_files_of_an_earlier_run_go_and_their_names_are_printed(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, chip = here / "out", str(CHIPS.parent.parent / "geometry/chips/small_campaign/chip.toml")
    assert main(["simulate", chip, "--state", "empty", *QUICK, "-o", str(out)]) == 0
    (out / "notes.txt").write_text("mine")
    capsys.readouterr()
    assert main(["simulate", chip, "--state", "filled", *QUICK, "-o", str(out)]) == 0
    assert "removed spectrum_empty.csv of an earlier run" in " ".join(capsys.readouterr().err.split())
    assert visible(out) == ["energy.png", "impedance.png", "merit.json", "notes.txt", "report.html", "spectrum.csv",
                            "spectrum_filled.csv", "warmth.png"]


def test_a_folder_in_which_another_command_is_at_work_is_refused(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = here / "out"
    with begin(out, Outputs("study"), source="x", field="y"):
        assert main(["simulate", str(here / "disc.toml"), *QUICK, "-o", str(out)]) == 2
        assert "(workbench study, begun" in " ".join(capsys.readouterr().err.split())
        assert visible(out) == [MARK]
    assert main(["simulate", str(here / "disc.toml"), *QUICK, "-o", str(out)]) == 0
    assert MARK not in visible(out)


def test_a_design_that_fails_keeps_the_best_chip_of_the_run_before(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = here / "out"
    with begin(out, Outputs("design", ("best.toml",)), source="x", field="y"):
        write_atomic(out / "best.toml", "of the run before")

    def failing(*_arguments: object, **_named: object) -> None:
        raise RuntimeError("killed")

    monkeypatch.setattr("workbench.commands.design.optimise", failing)
    assert main(["design", str(here / "goal.toml"), "--no-cad", "--jobs", "1", "-o", str(out)]) == 1
    assert (out / "best.toml").read_text() == "of the run before"


def test_a_measurement_replaces_no_table_of_the_user_beside_its_run_file(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(CHIPS.parent.parent / "examples/whole_way/bench.toml", here / "bench.toml")
    for name in ("run.csv", "run_5Vpp.csv", "run.html"):
        (here / name).write_text("mine")
    before = files(here)
    assert main(["measure", str(here / "bench.toml"), "-o", str(here / "run.h5")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert all(name in said for name in ("run.csv", "run_5Vpp.csv", "run.html"))
    assert files(here) == before


def test_materials_are_exported_over_an_export_only(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = here / "notes.json"
    path.write_text('{"mine": 1}')
    folder = here / "registry" / "glue"
    folder.mkdir(parents=True)
    package = CHIPS.parent.parent / "materials/data/pla"
    shutil.copy(next(package.glob("*.toml")), folder / "mine.toml")
    words = ["materials", "export", "glue/mine", "--materials", str(here / "registry"), "-o"]
    assert main([*words, str(path)]) == 2
    assert "file of exported materials" in " ".join(capsys.readouterr().err.split())
    assert path.read_text() == '{"mine": 1}'
    glue = here / "glue.json"
    assert main([*words, str(glue)]) == main([*words, str(glue)]) == 0
    glue.write_text(glue.read_text().replace('"format"', '"mine": 1, "format"', 1))
    (here / "link.json").symlink_to(glue)
    for changed in (glue, here / "link.json"):
        assert main([*words, str(changed)]) == 2
    assert '"mine"' in glue.read_text()
    assert STATE not in {each.name for each in here.iterdir()}
