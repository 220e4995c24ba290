"""The command line itself: help, exit status, warnings, and what is told apart from a defect."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from workbench.cli import main
from workbench.commands import export as export_command
from workbench.commands.options import command_parser
from workbench.fem.solve import NotConverged
from workbench.files.errors import InputError
from workbench.jobs.workers import check_jobs
from workbench.physics.term import ModelError

CHIP = str(Path(__file__).resolve().parent.parent / "geometry" / "chips" / "disc_20x2.toml")
COMMANDS = ("simulate", "compare", "mesh", "export", "render", "sensitivity", "materials", "measure", "import", "bench",
            "doctor", "modes", "along")


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


def text_of_help(command: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as caught:
        main([*command, "--help"])
    assert caught.value.code == 0
    return " ".join(capsys.readouterr().out.split())


def test_help_lists_the_commands_and_the_status(capsys: pytest.CaptureFixture[str]) -> None:
    text = text_of_help([], capsys)
    assert all(command in text for command in COMMANDS)
    assert "130 interrupted" in text


def every_action(command: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Those of the parsers within a parser too."""
    for action in command._actions:
        if isinstance(action, argparse._SubParsersAction):
            for within in action.choices.values():
                yield from every_action(within)
        yield action


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_says_what_it_is_for_and_its_default(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "400")
    assert command in text_of_help([command], capsys)
    (subparsers,) = (a for a in command_parser()._actions if isinstance(a, argparse._SubParsersAction))
    for action in every_action(subparsers.choices[command]):
        if action.option_strings and "--help" not in action.option_strings:
            assert action.help, action.option_strings
            # A flag's default is the opposite of its effect.
            flag = isinstance(action, argparse._StoreTrueAction | argparse._StoreFalseAction)
            assert action.required or flag or "default" in action.help, action.option_strings
            if isinstance(action.default, int | float) and not flag:
                assert f"{action.default:g}".replace("e-05", "e-5") in action.help, action.option_strings


@pytest.fixture
def outcome(monkeypatch: pytest.MonkeyPatch) -> Callable[[BaseException | int], int]:
    """The status of a command that ends in an exception or a status."""

    def end(result: BaseException | int) -> int:
        def export(_options: argparse.Namespace, _console: object) -> int:
            if isinstance(result, BaseException):
                raise result
            return result

        monkeypatch.setattr(export_command, "run_export", export)
        return main(["export", CHIP, "-o", "out"])

    return end


@pytest.mark.parametrize(("result", "status", "text"), [
    (0, 0, "done in 0.0 s; see out"), (1, 1, ""),
    (InputError("a.toml", "layers", 1, "two"), 2, "error: a.toml: layers: received 1; expected two"),
    (KeyboardInterrupt(), 130, "interrupted"),
    (NotConverged(1e6, 1.0, np.zeros(1)), 1, "NotConverged: the solve at 1 MHz"),
    (ModelError("no electrode [bold]"), 1, "ModelError: no electrode [bold]"),
    (OSError(28, "No space left on device"), 1, "error: out: No space left on device; the disk is full: make room, or"),
    (PermissionError(13, "Permission denied", "a.csv"), 1, "error: a.csv: Permission denied; you may not write there"),
])
def test_an_end_has_its_status_and_its_words(
    result: BaseException | int, status: int, text: str, outcome: Callable[[BaseException | int], int],
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert outcome(result) == status
    assert text in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("defect", [KeyError("x"), ValueError("x"), TypeError("x"), ZeroDivisionError("x")])
def test_a_defect_of_the_program_is_not_dressed_up(
    defect: Exception, outcome: Callable[[BaseException | int], int]
) -> None:
    with pytest.raises(type(defect)):
        outcome(defect)


def test_our_warnings_are_shown_once_and_others_are_not(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def export(_options: argparse.Namespace, _console: object) -> int:
        for _ in range(2):
            warnings.warn_explicit("mesh [too] coarse", UserWarning, export_command.__file__, 1)
        warnings.warn_explicit("overflow met", RuntimeWarning, export_command.__file__, 1)
        warnings.warn_explicit("use something newer", DeprecationWarning, export_command.__file__, 1)
        warnings.warn_explicit("somebody else's", UserWarning, np.__file__, 1)
        return 0

    monkeypatch.setattr(export_command, "run_export", export)
    assert main(["export", CHIP, "-o", "out"]) == 0
    said = capsys.readouterr().err
    assert said.count("warning: mesh [too] coarse") == 1
    assert "overflow met" in said
    assert "newer" not in said
    assert "somebody" not in said


def test_a_lost_imaginary_part_is_a_defect(monkeypatch: pytest.MonkeyPatch) -> None:
    def export(_options: argparse.Namespace, _console: object) -> int:
        np.zeros(1)[0] = np.array([1.0 + 1j])[0]
        np.zeros(1)[:] = np.array([1.0 + 1j])
        return 0

    monkeypatch.setattr(export_command, "run_export", export)
    with pytest.raises(np.exceptions.ComplexWarning):
        main(["export", CHIP, "-o", "out"])


def test_help_does_not_wait_for_the_numerical_libraries() -> None:
    code = ("import sys; from workbench.cli import main\n"
            "try: main(['--help'])\nexcept SystemExit: pass\n"
            "sys.exit(', '.join({'numpy', 'scipy', 'skfem', 'cadquery', 'gmsh', 'pyvista', 'matplotlib', 'rich'}"
            " & set(sys.modules)) or 0)")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_command_in_a_process_of_its_own(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "workbench.cli"]
    shown = subprocess.run([*command, "materials", "show", "water"], capture_output=True, text=True, check=False)
    assert shown.returncode == 0
    assert "water/iapws_2011" in shown.stdout
    wrong = subprocess.run([*command, "mesh", str(tmp_path / "none.toml")], capture_output=True, text=True, check=False)
    assert wrong.returncode == 2
    assert "an existing file" in wrong.stderr
    assert "Traceback" not in wrong.stderr


def test_a_script_without_a_guard_may_call_the_command(tmp_path: Path) -> None:
    """The solid model is made by another process, which must not run the caller's script again."""
    pytest.importorskip("cadquery")
    chip = tmp_path / "disc.toml"
    chip.write_text('[chip]\nname = "disc"\nband = ["300 kHz", "450 kHz"]\n[[layers]]\nrole = "transducer"\n'
                    'material = "pzt4/acevedo_2026_initial"\nthickness = "2 mm"\nradius = "3 mm"\n')
    script = tmp_path / "script.py"
    script.write_text("import workbench.render.gallery as gallery\nfrom workbench.cli import main\n"
                      "gallery.draw_state = lambda *a, **k: []\nprint('once')\n"
                      f"status = main(['simulate', {str(chip)!r}, '-o', {str(tmp_path / 'out')!r}, '--points', '11',"
                      " '--accuracy', '0.5 %'])\nraise SystemExit(status)\n")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("once") == 1
    # Nothing that another library has to say to programmers.
    assert "Warning" not in done.stderr
    assert (tmp_path / "out" / "cad.png").is_file()


def test_more_jobs_than_the_machine_can_hold_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    campaign = str(Path(CHIP).parent / "small_campaign" / "campaign.toml")
    assert main(["diagnose", campaign, "--jobs", "100000", "-o", str(tmp_path / "out")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "--jobs: received 100000; expected at most 8, 4 for each core of this machine" in said
    assert not (tmp_path / "out").exists()
    check_jobs(100, source="study", elsewhere=True)


def test_a_pipe_is_no_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    assert main(["compare", str(tmp_path / "pipe.csv"), CHIP, "-o", str(tmp_path / "out")]) == 2
    assert "this is a pipe or a device, which can be read only once: save its content" in " ".join(
        capsys.readouterr().err.split())


@pytest.mark.parametrize("command", [["study"], ["design"], ["diagnose"], ["tolerance"], ["fit", "batch"]])
def test_the_former_name_of_jobs_is_answered_with_the_new_one(
    command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main([*command, "file.toml", "--workers", "2", "-o", "out"])
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith(f"usage: workbench {' '.join(command)} ")
    assert "--workers is --jobs now" in said
