"""Diagnosis of straight chips: states, hypotheses that need an axis, and one that is found."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from own_recordings import MATERIALS, PLATE, STACK, any_recordings, conceal
from test_geometry_straight import CHIP, chip

from geometry.chip_section import region_volumes, volumes
from workbench.catalogue.catalogue import NO_AXIS
from workbench.cli import main
from workbench.diagnosis.device import Model, device_model

CAMPAIGN = """
[campaign]
known = "named"

[states.plate]
chip = "plate.toml"
recording = "plate.csv"

[states.empty]
chip = "stack.toml"
state = "empty"
recording = "empty.csv"

[states.filled]
chip = "stack.toml"
state = "filled"
recording = "filled.csv"

[known]
"pzt/trial.c33" = "0.5 %"
"pzt/trial.c12" = "5 %"
"transducer.half_width" = "20 um"
"cavity.half_width" = "5 um"
"""
FREQUENCIES = np.linspace(0.9e6, 1.1e6, 21)
ACCURACY = 5e-2


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    folder = tmp_path_factory.mktemp("straight")
    return device_model(any_recordings(folder, {"plate.toml": PLATE, "stack.toml": STACK, "campaign.toml": CAMPAIGN},
                                       FREQUENCIES), accuracy=ACCURACY)


def test_hypotheses_that_need_an_axis_are_left_out_by_name(model: Model) -> None:
    names, left = {each.name for each in model.effects}, model.others
    print(sorted(names), left, sep="\n")
    assert {"thickness of the couplant", "half_width of the cavity", "load on the superstrate",
            "small bubbles in the cavity", "shear through the couplant", "electrode mass"} <= names
    assert {"draft of the sidewall", "bow of the superstrate", "dome of the transducer"} <= names
    for name in ("cavity not full", "port necks", "electrode that ends before the rim", "couplant missing at its rim",
                 "rim of the transducer without piezoelectricity"):
        assert name not in names
        assert f"{name}, {NO_AXIS}" in left


def test_all_hypotheses_act_together_and_each_moves_the_spectrum(model: Model) -> None:
    every = model.of(model.effects)
    x = every.stated
    found = every.whole.near(x, {}, 1e-6).with_every(x)(x, deviation=[0.01] * 3)
    still = {p.name for p, column in zip(every.parameters, found.jacobian.T, strict=True) if not column.any()}
    print("of no effect where nothing is missing:", sorted(still))
    assert "pzt/trial.c12" in still
    for effect in model.effects:
        assert set(effect.names) - still or not effect.names, effect.name


def test_heat_capacities_count_the_whole_chip() -> None:
    for symmetry in ("even", "none"):
        there = chip(CHIP.replace('"even"', f'"{symmetry}"'))
        assert region_volumes(there) == pytest.approx(volumes(there), rel=1e-12)


@pytest.mark.slow
@pytest.mark.usefixtures("tables_fit")
def test_gel_that_is_thicker_than_stated_is_found_in_a_straight_chip(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    text = CAMPAIGN.replace(CAMPAIGN[CAMPAIGN.index("[states.empty]"):CAMPAIGN.index("[states.filled]")], "").replace(
        '"cavity.half_width" = "5 um"', '"pzt/trial.eps33" = "1 %"')
    files = {"plate.toml": PLATE, "stack.toml": STACK, "campaign.toml": text}
    conceal(tmp_path, files, np.linspace(0.9e6, 1.1e6, 61), {"couplant.thickness": 75e-6}, accuracy=5e-3)
    assert main(["diagnose", str(tmp_path / "campaign.toml"), "--materials", str(MATERIALS), "--accuracy", "0.5 %",
                 "-o", str(tmp_path / "out")]) == 0
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    (effect,) = found["effects"]
    assert effect["name"] == "thickness of the couplant"
    interval = effect["parameters"]["couplant.thickness"]
    # A 95 % interval misses one in twenty: here it need only come within twice its half width.
    assert abs(interval["value"] - 75e-6) < interval["high"] - interval["low"] < 5e-6
    assert NO_AXIS in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
