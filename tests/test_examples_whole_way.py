"""examples/11_whole_way.py without its computations: its files, its commands, and what it says of the outcome."""

import importlib.util
import json
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from simulated_bench import FILES, NOISE, Bench

from geometry.chip import read_chip
from materials.registry import Registry
from workbench.bench.setup import read_bench
from workbench.commands.options import COMMANDS, command_parser
from workbench.fitting.parameter import POLYMER_FOUR, TRANSDUCER_TEN
from workbench.model.numbers import real_part

_SPEC = importlib.util.spec_from_file_location(
    "whole_way", Path(__file__).resolve().parents[1] / "examples" / "11_whole_way.py")
example = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(example)


@pytest.fixture
def commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The output folder and every command the example gives, none of them run."""
    given = []

    @contextmanager
    def served(bench: Any, *held: Any) -> Any:
        given.append(("bench", "simulate", *held, *NOISE))
        yield

    monkeypatch.setattr(Bench, "_served", served)
    monkeypatch.setattr(Bench, "run", lambda bench, *command: given.append(command))
    monkeypatch.setattr(Bench, "has", lambda bench, command: command in COMMANDS)
    monkeypatch.setattr(example, "outcome", lambda folder: None)
    example.whole_way(tmp_path / "out")
    return tmp_path / "out", given


def test_every_command_of_the_whole_way_is_one(commands: Any) -> None:
    _, given = commands
    for command in given:
        command_parser().parse_args(command)
    stages = [command[0] for command in given if command[0] != "bench"]
    assert stages[:11] == ["measure"] * 4 + ["fit", "measure", "fit", "materials", "simulate", "measure", "compare"]
    # What only the bench may see is named to nothing else.
    assert all("truth" not in word for command in given if command[0] != "bench" for word in command)


def test_the_files_are_read_and_the_gel_is_not_what_they_say(commands: Any) -> None:
    folder, given = commands
    for name, thickness in (("disc_on_pla.toml", 24e-6), ("chip.toml", 15e-6)):
        said, true = (read_chip(folder / place / name).dimensions() for place in (".", "truth"))
        assert said["couplant.thickness"].value == pytest.approx(20e-6)
        assert true["couplant.thickness"].value == pytest.approx(thickness)
        assert {key: d.value for key, d in said.items() if key != "couplant.thickness"} == {
            key: d.value for key, d in true.items() if key != "couplant.thickness"}
    standards, device = (read_bench(folder / f"bench_{name}.toml") for name in ("open", "disc"))
    assert standards.standards.load is None
    assert device.standards.load_resistance == 50.0
    assert replace(device, path="", text="", standards=standards.standards, metadata={}) == replace(
        standards, path="", text="", metadata={})
    for command in given:
        for word in command:
            if word.endswith((".toml", "truth")):
                assert (folder / word).exists(), word


def test_the_truth_is_not_what_the_fits_begin_with() -> None:
    registry = Registry((FILES / "truth",))
    for true, start, free in (("pzt_bench/disc", "pzt4/comsol_nominal", TRANSDUCER_TEN),
                              ("pla_bench/print", "pla/acevedo_2026", POLYMER_FOUR)):
        values, begun = registry.load(true).parameters(), registry.load(start).parameters()
        for key in values.keys() - {"density"}:
            for name in (key, f"{key}.loss"):
                value, other = real_part(values, name), real_part(begun, name)
                if name in free:
                    assert abs(value - other) > 0.01 * abs(value), name
                else:
                    assert value == other, name


def test_the_outcome_tells_what_lies_outside(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "truth").symlink_to(FILES / "truth")
    entries = {"fit_disc": [("pzt4/comsol_nominal.c33", 119.2e9, 119.0e9, 119.4e9),
                            ("pzt4/comsol_nominal.c33.loss", -0.50e9, -0.55e9, -0.45e9)],
               "fit_sample": [("pla/acevedo_2026.shear_modulus", 1.00e9, 0.99e9, 1.02e9),
                              ("couplant.thickness", 23.5e-6, 23e-6, 24.5e-6)]}
    for name, rows in entries.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "fit.json").write_text(json.dumps({"parameters": [
            dict(zip(("name", "value", "low", "high"), row, strict=True)) for row in rows]}))
    example.outcome(tmp_path)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] + " " + line.split()[-1] for line in lines[1:5]] == [
        "c33 inside", "c33.loss OUTSIDE", "shear_modulus inside", "couplant.thickness inside"]
    assert lines[5] == "3 of 4 intervals hold the truth"
