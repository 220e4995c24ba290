"""Pictures of fits: every one is drawn, and what must be seen in it is there."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from workbench.render import fits
from workbench.results.spectrum import Spectrum

FREQUENCY = np.linspace(0.9e6, 1.1e6, 60)


def spectrum(shift: float = 0.0) -> Spectrum:
    return Spectrum(FREQUENCY, 5.0 + 1j * (FREQUENCY - 1e6 - shift) / 1e3)


def drawn(path: Path) -> np.ndarray:
    """The picture as (height, width, 3), once it has been checked to be a PNG of a sensible size."""
    from matplotlib.image import imread

    data = path.read_bytes()
    assert data.startswith(b"\x89PNG")
    width, height = struct.unpack(">II", data[16:24])
    assert width > 400
    assert height > 200
    return np.asarray(imread(path))[:, :, :3]


def share(picture: np.ndarray, colour: str) -> float:
    """Share of the pixels of a picture that have a colour, within a hundredth."""
    wanted = np.array([int(colour[i:i + 2], 16) / 255.0 for i in (1, 3, 5)])
    return float(np.mean(np.all(np.abs(picture - wanted) < 0.01, axis=2)))


def test_a_fit_shows_recording_start_fit_and_residual(tmp_path: Path) -> None:
    path = fits.draw_fit(spectrum(), spectrum(2e4), spectrum(100.0), tmp_path / "fit.png", title="disc")
    picture = drawn(path)
    assert share(picture, fits.LINE_COLOURS[0]) > 1e-3
    assert share(picture, fits.LINE_COLOURS[2]) > 1e-4
    svg = fits.draw_fit(spectrum(), spectrum(2e4), spectrum(), tmp_path / "fit.svg").read_text()
    assert svg.count('id="axes_') == 4


def test_a_correlation_needs_a_name_for_every_row(tmp_path: Path) -> None:
    matrix = np.array([[1.0, -0.95], [-0.95, 1.0]])
    picture = drawn(fits.draw_correlation(["c11", "c33"], matrix, tmp_path / "c.png"))
    # Signed: red on the diagonal, blue beside it.
    assert share(picture, "#67001f") > 0.01
    assert np.mean((picture[:, :, 2] > 0.3) & (picture[:, :, 0] < 0.1)) > 0.01
    with pytest.raises(ValueError, match="1 names"):
        fits.draw_correlation(["c11"], matrix, tmp_path / "c.png")


def test_intervals_stand_against_their_priors(tmp_path: Path) -> None:
    wide = fits.Interval("c13", 77.0, 60.0, 95.0, 74.0, 15.0, "not determined")
    known = [fits.Interval("c33", 121.0, 120.0, 122.0, 115.0, 11.0), wide,
             fits.Interval("bench.series_resistance", 0.1, 0.05, 0.2, 0.0, 0.3),
             fits.Interval("c33.loss", -0.3, -0.31, -0.29, -0.12, None)]
    picture = drawn(fits.draw_intervals(known, tmp_path / "i.png"))
    assert share(picture, "#dddddd") > 0.01
    assert share(picture, fits.LINE_COLOURS[0]) > 1e-3


def test_what_a_ranking_drops_is_pale(tmp_path: Path) -> None:
    kept = drawn(fits.draw_sensitivity([("c33", 1.0, 1.0), ("c11", 0.6, None)], [("c33.loss", 1.0, None)],
                                       tmp_path / "s.png", thresholds=(0.1, 0.3)))
    assert share(kept, "#b8cfe0") == 0.0
    dropped = drawn(fits.draw_sensitivity([("c33", 1.0, 1.0), ("c11", 0.6, None)], [("c33.loss", 1.0, None)],
                                          tmp_path / "s.png", thresholds=(0.7, 0.3)))
    assert share(dropped, "#b8cfe0") > 0.01


def test_an_outlier_is_red(tmp_path: Path) -> None:
    ones = np.ones(3)
    values = {"c33 (GPa)": (100.0 * ones, 99.0 * ones, 101.0 * ones), "h (mm)": (ones, ones, np.array([1, np.nan, 2]))}
    devices = ["a", "b", "c"]
    assert share(drawn(fits.draw_batch(devices, values, {}, tmp_path / "b.png")), "#c00000") == 0.0
    marked = fits.draw_batch(devices, values, {"c33 (GPa)": ["b"]}, tmp_path / "b.png")
    assert share(drawn(marked), "#c00000") > 0.0


def test_gel_study_and_costs_are_drawn(tmp_path: Path) -> None:
    drawn(fits.draw_gel_study(spectrum(), {"5 µm": (spectrum(1e3), 3.0), "20 µm": (spectrum(), 0.0)},
                              tmp_path / "g.png", resonance=1e6))
    scalings = np.linspace(0.7, 1.3, 5)
    drawn(fits.draw_costs(scalings, {f"p{i}": i * (scalings - 1.0) ** 2 for i in range(9)}, tmp_path / "c.png"))


@pytest.mark.parametrize(
    "draw",
    [
        lambda path: fits.draw_intervals([], path),
        lambda path: fits.draw_sensitivity([], [], path, thresholds=(0.1, 0.3)),
        lambda path: fits.draw_costs(np.ones(2), {}, path),
        lambda path: fits.draw_gel_study(spectrum(), {}, path),
        lambda path: fits.draw_batch([], {}, {}, path),
    ],
)
def test_nothing_is_not_drawn(draw: Callable[[Path], Path], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no "):
        draw(tmp_path / "x.png")
