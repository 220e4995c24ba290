"""Particles are drawn where they are, with a scale bar and a time, and move in the animation."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from test_workbench_trajectories import NEUTRAL, RADIUS, report_of

from workbench.acoustics.captures import Window
from workbench.acoustics.trajectories import Trajectories, follow
from workbench.render import beads

#: The dots, as matplotlib draws the colour.
DOT = np.array([0xD5, 0x5E, 0x00]) / 255.0


@pytest.fixture(scope="module")
def found() -> Trajectories:
    starts = np.array([[1e-3, 0.6e-3], [3e-3, 0.1e-3]])
    moved = follow(report_of(NEUTRAL, across=7, up=3, radial=666.0, p0=4e5), np.linspace(0.0, 30.0, 31),
                   particles=starts)
    return replace(moved, azimuths=np.array([0.0, 0.5 * np.pi]))


def pixels(path: Path) -> np.ndarray:
    """(height, width, colours) in 0 to 1."""
    from matplotlib.image import imread

    return np.asarray(imread(path))


def test_from_above_dots_are_at_their_places_and_the_background_can_be_left_out(
    found: Trajectories, tmp_path: Path
) -> None:
    picture = pixels(beads.draw_from_above(found, tmp_path / "above.png", at=0.0))
    height, width = picture.shape[:2]
    assert height == width
    for x, y in ((1e-3, 0.0), (0.0, 3e-3)):
        row, column = (0.5 - 0.5 * y / RADIUS) * height, (0.5 + 0.5 * x / RADIUS) * width
        np.testing.assert_allclose(picture[round(row), round(column), :3], DOT, atol=0.02)
    # Two dots of a share of the width, and no others: the area of a disc, to a pixel along its edge.
    dots = (np.abs(picture[:, :, :3] - DOT).max(axis=2) < 0.1).sum()
    assert dots == pytest.approx(2 * np.pi / 4 * (beads.LEAST_DOT * width) ** 2, rel=0.5)
    assert picture[:, :, 3].min() == 1.0
    overlay = pixels(beads.draw_from_above(found, tmp_path / "overlay.png", at=30.0, transparent=True))
    assert overlay[height // 4, width // 3, 3] == 0.0
    # What is drawn moves towards the axis; the scale bar is as long as it says.
    # Left of it the wall crosses the row.
    bar = np.flatnonzero(picture[round(0.965 * height), round(0.7 * width):, :3].max(axis=1) < 0.3)
    assert np.ptp(bar) / width * 2 * RADIUS == pytest.approx(2e-3, rel=0.02)


def test_lengths_of_scale_bars_and_times_of_stamps() -> None:
    assert [beads.scale_bar_length(width) for width in (8e-3, 4e-3, 1e-3)] == pytest.approx([2e-3, 1e-3, 2e-4])
    assert [beads.time_text(t) for t in (0.0, 0.0556, 9.9, 12.3, 59.4, 90.0, 1800.0)] == [
        "0 s", "0.0556 s", "9.9 s", "12 s", "59 s", "1.5 min", "30 min"]


def test_from_the_side_and_over_time(found: Trajectories, tmp_path: Path) -> None:
    one = pixels(beads.draw_from_side(found, tmp_path / "one.png", at=(0.0,)))
    three = pixels(beads.draw_from_side(found, tmp_path / "three.png", at=(0.0, 5.0, 30.0)))
    assert three.shape[1] == one.shape[1]
    assert three.shape[0] > 1.5 * one.shape[0]
    assert three.std() > 0.1
    path = beads.draw_light_curves(found, [("r below 2 mm", Window(outer=2e-3))], tmp_path / "light.svg")
    text = path.read_text()
    assert "r below 2 mm" in text
    assert "time (s)" in text


def test_the_animation_has_its_frames(found: Trajectories, tmp_path: Path) -> None:
    from PIL import Image, ImageSequence

    path = beads.animate_beads(found, tmp_path / "new" / "beads.gif", frames=4)
    assert [each.name for each in path.parent.iterdir()] == ["beads.gif"]
    with Image.open(path) as animation:
        assert ImageSequence.Iterator(animation)[3] is not None
        with pytest.raises(IndexError):
            ImageSequence.Iterator(animation)[4]
        frames = []
        for number in range(4):
            animation.seek(number)
            frames.append(np.asarray(animation.convert("RGB"), dtype=float))
    assert all(np.abs(one - other).max() > 50 for one, other in pairwise(frames))
    with pytest.raises(ValueError, match=r"expected \.gif"):
        beads.animate_beads(found, tmp_path / "beads.mp4")


def test_another_voltage_is_said(found: Trajectories, tmp_path: Path) -> None:
    path = beads.draw_light_curves(replace(found, voltage_factor=2.0), [], tmp_path / "light.svg")
    assert found.forces.at_voltage(2.0).excitation.description in path.read_text()
