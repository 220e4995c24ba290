"""What counts as an explanation."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from workbench.diagnose import verdict


def fit(reduced: float, good: bool = False, chi_square: float = 0.0) -> Any:
    return SimpleNamespace(reduced=reduced, good=good, chi_square=chi_square, correlation=1.0, cost_of_freedom=0.0)


@pytest.mark.parametrize(("before", "after", "good", "explained"), [
    (1.5, 1.05, True, True),   # nothing but noise is left
    (14.0, 1.5, False, True),  # a strong effect, described to 4 %
    (14.0, 3.0, False, False),
    (1.8, 1.2, False, False),  # a quarter is left of what is no noise
])
def test_what_is_left_decides_whether_a_fit_explains(before: float, after: float, good: bool, explained: bool) -> None:
    assert verdict._explains(fit(before), fit(after, good)) == explained


@pytest.mark.parametrize(("base", "best", "left", "complete"), [
    (fit(1.5, chi_square=1500.0), fit(1.05, True, 1050.0), 15.0, True),
    (fit(1.5, chi_square=1500.0), fit(1.05, True, 1050.0), 25.0, False),  # another would take much of what is noise
    (fit(14.0, chi_square=14000.0), fit(1.5, False, 1500.0), 1000.0, True),
    (fit(14.0, chi_square=14000.0), fit(1.5, False, 1500.0), 1300.0, False),  # and of what a strong effect explains
    (fit(14.0, chi_square=14000.0), fit(3.0, False, 3000.0), 0.0, False),
])
def test_nothing_else_may_take_much_of_what_an_explanation_leaves(
    base: Any, best: Any, left: float, complete: bool
) -> None:
    assert verdict._complete(base, best, left) == complete  # type: ignore[arg-type]


@pytest.mark.parametrize(("gain", "numbers", "correlation", "hint"), [
    (13.0, 1, 1.0, True),
    (12.0, 1, 1.0, False),
    (20.0, 1, 2.0, False),  # as many points as ten
    (20.0, 6, 1.0, False),  # six numbers gain six by chance, with a spread of three and a half
    (30.0, 6, 1.0, True),
])
def test_a_hint_is_what_noise_hardly_gives(gain: float, numbers: int, correlation: float, hint: bool) -> None:
    scored: Any = SimpleNamespace(gain=gain, error=np.array([*[0.1] * numbers, np.inf]))
    assert verdict._hints(scored, correlation) == hint
