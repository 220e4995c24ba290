"""Commands and the files of the user: none is replaced or removed, and no run passes for another one."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from support import visible

from workbench.cli import main
from workbench.files.output import MARK, begin
from workbench.files.ownership import STATE, Outputs

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


def test_files_of_an_earlier_run_go_and_their_names_are_printed(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, chip = here / "out", str(CHIPS.parent.parent / "examples/small_campaign/chip.toml")
    assert main(["simulate", chip, "--state", "empty", *QUICK, "-o", str(out)]) == 0
    (out / "notes.txt").write_text("mine")
    capsys.readouterr()
    assert main(["simulate", chip, "--state", "filled", *QUICK, "-o", str(out)]) == 0
    assert "removed spectrum_empty.csv of an earlier run" in " ".join(capsys.readouterr().err.split())
    assert visible(out) == ["impedance.png", "merit.json", "notes.txt", "report.html", "spectrum.csv",
                            "spectrum_filled.csv"]


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


def test_a_design_that_fails_keeps_the_best_chip_of_the_run_before(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = here / "out"
    with begin(out, Outputs("design", ("best.toml",)), source="x", field="y"):
        from workbench.files.writing import write_atomic

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
    assert "a file of exported materials" in " ".join(capsys.readouterr().err.split())
    assert path.read_text() == '{"mine": 1}'
    assert main([*words, str(here / "glue.json")]) == main([*words, str(here / "glue.json")]) == 0
    assert STATE not in {each.name for each in here.iterdir()}
