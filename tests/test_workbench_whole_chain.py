"""A recording, the fit that is saved of it, and a campaign that is diagnosed with the saved material: by the command.

A version of a saved material (``pzt_real/disc@1``) goes by one name all the way.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from workbench.cli import main

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("tables_fit")]

DISC = """[chip]
name = "disc"
band = ["0.9 MHz", "1.15 MHz"]
[[layers]]
role = "transducer"
material = "{}"
thickness = "2 mm"
radius = "4 mm"
"""
#: A material by its full name, by its name alone, and without its version; losses that are stated as none, and as less
#: than their uncertainty, lie at the ends of what they may be.
CAMPAIGN = """[campaign]
materials = "mine"
[states.disc]
chip = "mine.toml"
recording = "simulated/spectrum.csv"
noise = "0.5 %"
[known]
"pzt_real/disc@1.c11" = "0.1 %"
"pzt_real.c33" = "0.1 %"
"pzt_real/disc.c11.loss" = "0.4 GPa"
"pzt_real/disc@1.c33.loss" = "3 GPa"
"pzt_real.c44.loss" = "0.1 GPa"
"""
LOOSE = ["--accuracy", "1 %"]


def test_a_recording_becomes_a_material_that_a_diagnosis_knows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "none"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    Path("disc.toml").write_text(DISC.format("pzt4"))
    Path("mine.toml").write_text(DISC.format("pzt_real/disc"))
    Path("campaign.toml").write_text(CAMPAIGN)
    fit = ["fit", "pzt", "simulated/spectrum.csv", "--chip", "disc.toml", *LOOSE, "--materials", "mine"]
    assert main(["simulate", "disc.toml", "--points", "81", *LOOSE, "-o", "simulated"]) == 0
    # Where nothing is saved, a folder that does not exist is a mistake.
    assert main([*fit, "-o", "fit"]) == 2
    assert "expected an existing folder of materials" in capsys.readouterr().err
    assert main([*fit, "--save", "pzt_real/disc", "-o", "fit"]) == 0
    assert Path("mine/pzt_real/disc@1.toml").is_file()
    assert main(["diagnose", "campaign.toml", *LOOSE, "--jobs", "1", "-o", "diagnosed"]) == 0
    found = json.loads(Path("diagnosed/diagnosis.json").read_text(encoding="utf-8"))
    assert (found["verdict"], found["undone"], found["not_tried"]) == ("no_mismatch", [], [])
    taken = {each["name"]: each for each in found["taken"]}
    # What the campaign says of it, in the place of what the saved material says.
    assert taken["pzt_real/disc@1.c11.loss"]["uncertainty"] == pytest.approx(4e8)
    assert taken["pzt_real/disc@1.c44.loss"]["unit"] == "Pa"
    assert taken["pzt_real/disc@1.c11"]["uncertainty"] == pytest.approx(1.37e8, rel=1e-2)
    assert taken["pzt_real/disc@1.e33"]["source"].endswith("uncertainty")
    assert "bench.gain[disc]" not in taken  # one state: what all share and what it adds are one
    # As it is stated it is the fit: no loss begins elsewhere than where it is stated.
    assert found["before"]["disc"]["rms_log_residual"] < 0.005
    moved = {each["name"]: each for each in found["moved_parameters"]}
    for name in ("c11", "c33", "c44"):
        assert moved[f"pzt_real/disc@1.{name}.loss"]["to"] <= 0.0


def test_a_file_in_the_way_of_a_folder_of_materials_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine").write_text("")
    Path("disc.toml").write_text(DISC.format("pzt4"))
    fit = ["fit", "pzt", "none.csv", "--chip", "disc.toml", "--materials", "mine", "--save", "a/b", "-o", "x"]
    assert main(fit) == 2
    assert "a folder to save materials in; a file is in the way" in capsys.readouterr().err
