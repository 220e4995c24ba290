"""Pictures of a diagnosis: the right colours in the right places."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.acoustics.nodal import mesh_of
from workbench.render import diagnoses
from workbench.render.diagnoses import StatePicture, draw_shares, draw_states
from workbench.render.sections import draw_marked


def picture(path: Path) -> NDArray[np.float64]:
    """(height, width, 3) in 0 to 1."""
    from matplotlib.image import imread

    return np.asarray(imread(path))[:, :, :3]


def share_of(path: Path, colour: str) -> float:
    """Of the dots of a picture."""
    from matplotlib.colors import to_rgb

    return float(np.mean(np.all(np.abs(picture(path) - to_rgb(colour)) < 0.02, axis=2)))


def two_layers() -> Any:
    low, high = np.array([[0.0, 0.0], [0.0, 2e-3]]), np.array([[4e-3, 2e-3], [4e-3, 3e-3]])
    return mesh_of(low, high, np.array([0, 1]), ("transducer", "substrate"), order=2)


def test_the_marked_region_has_its_share_of_the_section(tmp_path: Path) -> None:
    lower = share_of(draw_marked(two_layers(), ["transducer"], tmp_path / "a.png", title=""), "#d55e00")
    upper = share_of(draw_marked(two_layers(), ["substrate"], tmp_path / "b.png", title=""), "#d55e00")
    assert lower / upper == pytest.approx(2.0, rel=0.03)  # of 2 and 1 mm, and a legend
    assert share_of(draw_marked(two_layers(), [], tmp_path / "c.png", title=""), "#d55e00") < 0.01
    with pytest.raises(ValueError, match="no region 'bond' to mark; expected one of transducer, substrate"):
        draw_marked(two_layers(), ["bond"], tmp_path / "d.png", title="")


def test_shares_are_as_long_as_they_are_large(tmp_path: Path) -> None:
    path = draw_shares({"leads": 0.6, "glass": 0.2}, tmp_path / "shares.png", title="")
    first, second = share_of(path, "#0072b2"), share_of(path, "#d55e00")
    assert first / second == pytest.approx(3.0, rel=0.1)
    for wrong in ({"leads": 1.2}, {"leads": -0.1}):
        with pytest.raises(ValueError, match="expected none below 0, and no more than 1"):
            draw_shares(wrong, tmp_path / "wrong.png", title="")


def test_every_state_has_a_panel(tmp_path: Path) -> None:
    frequency, flat = np.linspace(1e6, 2e6, 20), np.ones(20, dtype=complex)
    states = [StatePicture(name, frequency, flat, 1.1 * flat, 1.01 * flat, np.full(20, 0.01)) for name in "abcd"]
    one = picture(draw_states(states[:1], tmp_path / "one.png", before="before", after="after"))
    four = picture(draw_states(states, tmp_path / "four.png", before="before", after="after"))
    assert four.shape[1] == pytest.approx(3 * one.shape[1], abs=3)
    assert four.shape[0] > 1.8 * one.shape[0]
    # A panel for each: nothing is drawn in the corner where a fifth and a sixth would be.
    height, width = four.shape[:2]
    assert four[height // 2:, : width // 3].min() < 0.5
    assert four[height // 2 + 60:, width // 2:].min() > 0.99
    with pytest.raises(ValueError, match="no states"):
        draw_states([], tmp_path / "none.png", before="", after="")


def test_a_line_shows_below_the_other_where_both_coincide(tmp_path: Path) -> None:
    frequency, flat = np.linspace(1e6, 2e6, 20), np.ones(20, dtype=complex)
    state = StatePicture("a", frequency, flat, flat, flat, np.full(20, 0.01))
    path = draw_states([state], tmp_path / "a.png", before="before", after="after")
    drawn = picture(path)
    upper = drawn[drawn.shape[0] // 4:drawn.shape[0] // 2]
    rows = {colour: np.flatnonzero(np.mean(np.all(np.abs(upper - np.array(rgb)) < 0.1, axis=2), axis=1) > 0.3)
            for colour, rgb in (("before", (0.92, 0.70, 0.54)), ("after", (0.0, 0.45, 0.70)))}
    assert rows["after"].size
    assert rows["before"].min() < rows["after"].min() < rows["after"].max() < rows["before"].max()


@pytest.mark.parametrize(("before", "is_log"), [(0.03, False), (1.0, True)])
def test_a_difference_of_orders_is_drawn_on_a_logarithmic_scale(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: float, is_log: bool
) -> None:
    seen: list[tuple[str, tuple[float, float]]] = []
    monkeypatch.setattr(diagnoses, "tidy", lambda axes: seen.append((axes.get_yscale(), axes.get_ylim())))
    frequency, flat = np.linspace(1e6, 2e6, 20), np.ones(20, dtype=complex)
    state = StatePicture("a", frequency, flat, np.exp(before) * flat, np.exp(0.02) * flat, np.full(20, 0.01))
    draw_states([state], tmp_path / "a.png", before="before", after="after")
    _, (scale, (low, high)) = seen
    assert scale == ("log" if is_log else "linear")
    # Per cent of |Z|: before, after and the noise are on the scale.
    assert low < 2.0 < 100.0 * before < high
    assert (low == 0.0) is not is_log
