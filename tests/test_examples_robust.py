"""examples/17_robust_by_measurement.py without its computations: its files, its commands, and what it says."""

from __future__ import annotations

import importlib.util
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
from support import with_fields

from geometry.chip import read_chip
from geometry.chip_file import write_chip
from materials.registry import Registry
from workbench.commands.options import command_parser
from workbench.design.goal import read_goal

_SPEC = importlib.util.spec_from_file_location(
    "robust", Path(__file__).resolve().parents[1] / "examples" / "17_robust_by_measurement.py")
example = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(example)


def test_every_command_is_one_and_the_goals_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[tuple[str, ...]] = []
    monkeypatch.setattr(example.Bench, "run", lambda bench, *command: given.append(command))
    monkeypatch.setattr(example.Bench, "measure", lambda bench, *held, **options: None)
    monkeypatch.setattr(example, "outcome", lambda folder: None)
    example.robust_by_measurement(tmp_path / "out")
    for command in given:
        command_parser().parse_args(command)
    assert [command[0] for command in given] == ["fit", "fit", *(["design", "tolerance"] * 2)]
    known = Registry((tmp_path / "out" / "truth",))
    goals = {name: read_goal(tmp_path / "out" / f"{name}.toml", registry=known) for name in ("nominal", "robust")}
    # They ask the same of the same chip, but for what is uncertain.
    assert goals["nominal"].robust is None
    assert goals["robust"].robust.materials
    assert with_fields(goals["robust"], robust=None, source="", bounds=()) == with_fields(
        goals["nominal"], source="", bounds=(), chip=goals["robust"].chip)
    assert {bound.text for bound in goals["robust"].bounds} == {example.REQUIRED}


def test_what_is_said_of_both_designs(tmp_path: Path, capsys: Any) -> None:
    files = Path(example.__file__).parent / "whole_way"
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    chip = read_chip(tmp_path / "chip.toml")
    for name, share in (("nominal", 0.5), ("robust", 0.95)):
        for folder in (name, f"{name}_judged"):
            (tmp_path / folder).mkdir()
        write_chip(chip, tmp_path / name / "best.toml")
        (tmp_path / f"{name}_judged" / "tolerance.json").write_text(json.dumps({
            "figures": {"mean_e_ac": {"nominal": 2.0}},
            "yield": {"requirements": [{"yield": share, "low": share - 0.01, "high": share + 0.01}]}}))
        pandas.DataFrame({"mean_e_ac": np.linspace(1.0, 2.0, 101)}).to_parquet(
            tmp_path / f"{name}_judged" / "tolerance.parquet")
    example.outcome(tmp_path)
    said = capsys.readouterr().out.splitlines()
    assert " ".join(said[1].split()) == "nominal 0.7200 mm 2.000 J/m^3 1.050 J/m^3 50.0 % (49.0 to 51.0 %)"
    assert said[2].split()[:1] == ["robust"]
