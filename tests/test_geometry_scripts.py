"""A chip file with a script is a program: it is named before it runs, lies beside the chip file, and can be refused."""

from __future__ import annotations

import argparse
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from support import DISC

from geometry.chip import read_chip
from geometry.chip_file import write_chip
from geometry.chip_section import chip_section
from geometry.scripts import NO_SCRIPTS, ScriptWarning
from workbench.cli import main
from workbench.commands.options import command_parser
from workbench.files.errors import InputError

#: Says that it runs, and leaves a file.
SCRIPT = """
import pathlib
import sys

pathlib.Path(__file__).with_name("EXECUTED").touch()
print("the script is running", file=sys.stderr)


def disc(radius):
    raise ValueError("no solid")
"""
PROFILE = '\n[layers.profile]\nscript = "{script}"\nfunction = "disc"\n'

#: Files that name a chip file, as far as they are read until the chip is.
NAMING = {
    "study.toml": '[study]\nchip = "chip.toml"\nfigures = ["f0"]\n',
    "goal.toml": '[goal]\nchip = "chip.toml"\n',
    "campaign.toml": '[campaign]\nname = "one"\n[states.disc]\nchip = "chip.toml"\nrecording = "disc.csv"\n',
    "batch.toml": '[[recordings]]\nname = "one"\nfile = "disc.csv"\nchip = "chip.toml"\nkind = "pzt"\n',
    "disc.csv": "frequency (Hz),resistance (ohm),reactance (ohm)\n300000,10,-100\n350000,11,-90\n400000,12,-80\n",
}


@pytest.fixture(autouse=True)
def _allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(NO_SCRIPTS, raising=False)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A chip file beside its script, and files that name the chip file; the current folder."""
    there = tmp_path / "chips"
    (there / "below").mkdir(parents=True)
    for path in (there / "disc.py", there / "below" / "disc.py", tmp_path / "disc.py"):
        path.write_text(SCRIPT, encoding="utf-8")
    with_script(there, "disc.py")
    for name, text in NAMING.items():
        (there / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(there)
    return there


def with_script(folder: Path, script: str) -> Path:
    path = folder / "chip.toml"
    path.write_text(DISC + PROFILE.format(script=script), encoding="utf-8")
    return path


def test_the_script_is_named_before_it_runs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["mesh", "chip.toml"]) == 2
    said = capsys.readouterr().err
    digest = hashlib.sha256(SCRIPT.encode()).hexdigest()[:12]
    named = f"warning: chip.toml runs the script disc.py (sha256 {digest}), a program with all your rights"
    assert said.count(named) == 1
    assert said.index(named) < said.index("the script is running")
    assert (folder / "EXECUTED").exists()


@pytest.mark.parametrize("asked", [
    ["mesh", "chip.toml"], ["simulate", "chip.toml", "-o", "out"], ["export", "chip.toml", "-o", "out"],
    ["app", "chip.toml", "--no-browser"], ["study", "study.toml", "-o", "out"], ["design", "goal.toml", "-o", "out"],
    ["diagnose", "campaign.toml", "-o", "out"], ["fit", "batch", "batch.toml", "-o", "out"],
    ["bench", "simulate", "chip.toml"]])
@pytest.mark.parametrize("by", ["option", "environment"])
def test_a_refused_script_is_named_and_does_not_run(
    asked: list[str], by: str, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if by == "environment":
        monkeypatch.setenv(NO_SCRIPTS, "1")
    assert main([*asked, "--no-scripts"] if by == "option" else asked) == 2
    said = capsys.readouterr().err
    assert "chip.toml: transducer, layers[0].profile.script: received 'disc.py'; expected no script: scripts" in said
    assert "running" not in said
    assert "Traceback" not in said
    assert not (folder / "EXECUTED").exists()
    # The refusal is of this command alone.
    assert os.environ.get(NO_SCRIPTS) == ("1" if by == "environment" else None)


def test_every_command_that_reads_a_chip_can_refuse_scripts() -> None:
    def parsers(command: argparse.ArgumentParser, name: str) -> Iterator[tuple[str, argparse.ArgumentParser]]:
        within = [a for a in command._actions if isinstance(a, argparse._SubParsersAction)]
        for action in within:
            for word, parser in action.choices.items():
                yield from parsers(parser, f"{name} {word}")
        if not within:
            yield name, command

    reading = {"chip", "goal", "study", "diagnosed", "campaign", "device"}
    seen = set()
    for name, parser in parsers(command_parser(), "workbench"):
        names = {action.dest for action in parser._actions}
        if names & reading or name == "workbench fit batch":
            seen.add(name)
            assert "no_scripts" in names, name
    assert len(seen) >= 14


def test_in_python_a_script_is_warned_of_or_refused(folder: Path) -> None:
    with pytest.warns(ScriptWarning, match=r"chip\.toml runs the script .*disc\.py \(sha256"):
        read_chip(folder / "chip.toml")
    with pytest.raises(InputError, match=r"layers\[0\]\.profile\.script: received 'disc\.py'; expected no script"):
        read_chip(folder / "chip.toml", scripts=False)
    assert not (folder / "EXECUTED").exists()


@pytest.mark.parametrize("script", [
    "../disc.py", "below/../../disc.py", "/ELSEWHERE/disc.py", "link.py", "linked/disc.py"])
def test_a_script_elsewhere_is_refused(script: str, folder: Path) -> None:
    (folder / "link.py").symlink_to(folder.parent / "disc.py")
    (folder / "linked").symlink_to(folder.parent)
    path = with_script(folder, script.replace("/ELSEWHERE", str(folder.parent)))
    with pytest.raises(InputError, match=r"profile\.script: .*expected a script beside the chip file .*copy .* to "):
        read_chip(path)


@pytest.mark.parametrize("script", ["disc.py", "below/disc.py", "below/../disc.py", "own.py"])
def test_a_script_beside_or_below_is_read(script: str, folder: Path) -> None:
    (folder / "own.py").symlink_to(folder / "below" / "disc.py")
    read_chip(with_script(folder, script))
    with_script(folder, str(folder / "disc.py"))
    read_chip("chip.toml")


def test_only_the_script_that_was_named_runs(folder: Path) -> None:
    chip = read_chip(folder / "chip.toml")
    (folder / "disc.py").write_text(SCRIPT + "# changed\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"disc\.py: script: received 'sha256 .*it has changed since"):
        chip_section(chip)
    (folder / "disc.py").unlink()
    with pytest.raises(InputError, match=r"disc\.py: script: .*a readable file"):
        chip_section(chip)
    assert not (folder / "EXECUTED").exists()


def test_a_chip_written_elsewhere_takes_its_script_along(folder: Path, tmp_path: Path) -> None:
    chip, out = read_chip(folder / "chip.toml"), tmp_path / "out"
    digest = hashlib.sha256(SCRIPT.encode()).hexdigest()[:12]
    again = read_chip(write_chip(chip, out / "best.toml"))
    assert {each.name for each in out.iterdir()} == {"best.toml", f"disc-{digest}.py"}
    # From there elsewhere under the same name, and beside the script none is copied.
    write_chip(again, tmp_path / "further" / "best.toml")
    assert (tmp_path / "further" / f"disc-{digest}.py").read_text(encoding="utf-8") == SCRIPT
    write_chip(chip, folder / "best.toml")
    write_chip(chip, folder.parent / "best.toml")
    assert not list(folder.glob("disc-*")) + list(folder.parent.glob("disc-*"))
    (out / f"disc-{digest}.py").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match="a copy of the script, or no file; move it away"):
        write_chip(chip, out / "best.toml")
    assert (out / f"disc-{digest}.py").read_text(encoding="utf-8") == "mine"


def test_a_pipe_is_no_script(folder: Path) -> None:
    os.mkfifo(folder / "pipe.py")
    with pytest.raises(InputError, match=r"profile\.script: received 'pipe\.py'; expected a readable file"):
        read_chip(with_script(folder, "pipe.py"))
