"""The live view of straight chips: what is moved, its fields, and their pictures with the mirror image."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from support import quadratic
from test_geometry_straight import CHIP, chip

from geometry.chip import read_chip
from geometry.measure import Straight
from materials.registry import Registry
from workbench.app.controls import controls
from workbench.app.session import Session
from workbench.model.problem import build, fill
from workbench.render.live import live_pictures
from workbench.simulation.run import simulate, snapshot

COARSE = quadratic(2.0)
FREQUENCY = 1.97e6
MOVES = ("superstrate.thickness=0.49mm..0.51mm", "cavity.half_width=0.185mm..0.195mm")


def of_symmetry(name: str) -> str:
    split = CHIP.replace('live = "bottom"', 'live = "bottom", live_inner_half_width = "0.3 mm"')
    return split.replace('symmetry = "even"', f'symmetry = "{name}"').replace(
        '["1.5 MHz", "2.5 MHz"]', '["1.9 MHz", "2.1 MHz"]')


def test_the_half_width_of_the_channel_is_moved_by_default() -> None:
    there = chip()
    names = [each.name for each in controls(there, build(fill(there), accuracy=COARSE))]
    assert "cavity.half_width" in names
    assert "sidewall.thickness" in names
    assert not any("radius" in name for name in names)


@pytest.mark.parametrize("symmetry", ["even", "odd"])
def test_a_session_moves_a_straight_chip_and_has_its_fields(symmetry: str, tmp_path: Path) -> None:
    (tmp_path / "chip.toml").write_text(of_symmetry(symmetry))
    session = Session(read_chip(tmp_path / "chip.toml"), None, MOVES, registry=Registry(), points=31, accuracy=COARSE)
    assert "model ready" in list(session.grow())[-1]
    session.put({"superstrate.thickness": 0.508e-3, "cavity.half_width": 0.187e-3})
    session.save(tmp_path / "moved.toml")
    moved = read_chip(tmp_path / "moved.toml")
    assert moved.measure == Straight(0.02, session.chip.measure.left)
    assert moved.dimensions()["cavity.half_width"].value == pytest.approx(0.187e-3)
    found, run = session.section(FREQUENCY), simulate(moved, accuracy=COARSE, at=FREQUENCY)
    for name in ("displacement", "pressure"):
        one, other = (np.nanmax(np.abs(getattr(each, name))) for each in (found.fields, run.fields))
        # One per cent of the impedance, and a mesh of its own.
        assert one == pytest.approx(other, rel=5e-2)


def colours(png: bytes) -> NDArray[np.int64]:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


@pytest.mark.parametrize("symmetry", ["even", "odd", "none"])
def test_pictures_show_both_halves_with_their_signs(symmetry: str) -> None:
    shot = snapshot(chip(of_symmetry(symmetry)), None, FREQUENCY, accuracy=COARSE)
    found = {each.name: each for each in live_pictures(shot.fields, None)}
    assert set(found) == {"displacement", "pressure"}
    picture = found["pressure"]
    assert picture.window[:2] == pytest.approx((-0.19, 0.19))
    dots = colours(picture.png)
    mirrored = dots[:, ::-1]
    if symmetry == "odd":
        # Signed colours run from red to blue: the image has the other one.
        red, blue = dots[:, :, 0] - dots[:, :, 2], mirrored[:, :, 0] - mirrored[:, :, 2]
        assert np.corrcoef(red.ravel(), blue.ravel())[0, 1] < -0.95
    else:
        # Exactly in a half that is mirrored; the whole chip is its own image to the rounding of colours.
        assert np.abs(dots - mirrored).max() <= (0 if symmetry == "even" else 2)
