"""Peaks, prominences and widths are those of scipy.signal."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from workbench.results.peaks import find_peaks, half_widths


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("digits", [1, 6])
def test_peaks_are_those_of_scipy(seed: int, digits: int) -> None:
    """With one digit there are flat tops, also at the ends."""
    random = np.random.default_rng(seed)
    values = np.round(np.convolve(random.standard_normal(200), np.ones(5) / 5.0, mode="same"), digits)
    places, found = find_peaks(values, 0.3)
    expected, properties = signal.find_peaks(values, prominence=0.3)
    assert places.tolist() == expected.tolist()
    assert found == pytest.approx(properties["prominences"], rel=1e-15)
    widths = signal.peak_widths(values, expected, rel_height=0.5)[0]
    assert half_widths(values, places) == pytest.approx(widths, rel=1e-12)


@pytest.mark.parametrize("values", [[1.0, 2.0], [2.0, 1.0, 2.0], [1.0, 1.0, 1.0], [1.0]])
def test_no_end_and_no_level_is_a_peak(values: list[float]) -> None:
    assert find_peaks(np.array(values), 0.0)[0].size == 0
