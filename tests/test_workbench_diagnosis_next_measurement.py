"""The next measurement: information and odds against closed forms of two hypotheses, without a solver."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_explanations import made_explanation, made_problem
from numpy.typing import NDArray

from workbench.diagnosis.likelihood import Explanation, Hypothesis
from workbench.diagnosis.next_measurement import next_measurement_text, options
from workbench.diagnosis.odds import REGION_SIZES
from workbench.fitting.parameter import Parameter
from workbench.model.numbers import Stated
from workbench.physics.softening import DRIVE_SQUARED

Real = NDArray[np.float64]

#: Points of each of two states.
POINTS = 3
ROWS = 2 * POINTS
#: A state's own gain, a lead, and a number that a hypothesis brings.
PARAMETERS = (Parameter("bench.gain[two]", 0.0, -0.5, 0.5, Stated(0.1), "1", recordings=("two",), offset=True),
              Parameter("bench.series_resistance", 0.0, -1.0, 1.0, Stated(0.3), "ohm"),
              Parameter("softening", 0.0, 0.0, 1.0, None, "1/V^2"))


def model() -> Any:
    states = tuple(SimpleNamespace(name=name, noise=np.ones(POINTS), drive=1.0, observation=None, fluid=None)
                   for name in ("one", "two"))
    return SimpleNamespace(campaign=SimpleNamespace(fitted=states), parameters=PARAMETERS, stated=np.zeros(3),
                           index=[p.name for p in PARAMETERS].index)


def explanation(
    one: float, two: float = 0.0, *, tangents: Real | None = None, x: tuple[float, ...] = (0.0, 0.0, 0.0),
    free: tuple[int, ...] = (0,), error: float = 1e-9, effects: tuple[Any, ...] = (), outside: Real | None = None,
) -> Explanation:
    """One that leaves the same at every point of each state, in units of the noise; `error` of all numbers."""
    own = np.zeros((2 * ROWS, 3)) if tangents is None else tangents
    local = made_problem(np.repeat([one, two], ROWS), own[:, free], np.full(len(free), 1.0 / error), outside=outside)
    return made_explanation(local, np.array(x), hypothesis=Hypothesis(effects), free=free)


def shares(*found: Explanation) -> dict[str, tuple[float, float, int]]:
    chosen = options(model(), [(each, 0.0) for each in found], 20.0)
    return {option.name: (option.share, option.odds, option.times) for option in chosen}


def test_information_and_odds_are_those_of_two_gaussians() -> None:
    found = shares(explanation(0.0), explanation(0.5))
    distance = ROWS * 0.25
    information = math.log(2.0) - math.log1p(math.exp(-distance / 8.0))
    # ln 20 = 3.0 takes four times 0.75, two times 1.5: 4 of the recordings are expected to give odds of e^3.
    assert found["record one again"] == (pytest.approx(information / math.log(2.0), rel=1e-12),
                                         pytest.approx(math.exp(0.5 * 4 * distance), rel=1e-12), 4)
    assert found["record two again"] == (pytest.approx(0.0, abs=1e-12), pytest.approx(1.0), 64)
    assert next(iter(found)) == "record one again"


def test_what_every_recording_draws_anew_and_what_is_uncertain_hides_a_difference() -> None:
    tangents = np.zeros((2 * ROWS, 3))
    tangents[ROWS:, 0] = 10.0
    plain = shares(explanation(0.0, 0.0), explanation(0.0, 1.0))["record two again"]
    drawn = shares(*(explanation(0.0, two, tangents=tangents) for two in (0.0, 1.0)))["record two again"]
    # Along the tangent of a gain of 0.1 a deviation is one of noise and ROWS of the gain's.
    distance = ROWS / (1.0 + ROWS)
    assert drawn[0] == pytest.approx((math.log(2.0) - math.log1p(math.exp(-distance / 8.0))) / math.log(2.0), rel=1e-9)
    assert drawn[0] < 0.3 * plain[0]
    # An offset of the recording there is does not come again.
    gone = shares(explanation(0.0, 0.0, tangents=tangents), explanation(0.0, 1.0, tangents=tangents, x=(0.1, 0.0, 0.0)))
    assert gone["record two again"][0] == pytest.approx(0.0, abs=1e-12)


def test_what_a_change_in_a_region_accounts_for_comes_again() -> None:
    """Of a misfit that it may make 30 times as large, both predict what was measured."""
    outside = np.zeros((2 * ROWS, 1))
    outside[:ROWS] = 30.0 / REGION_SIZES[0]
    found = shares(explanation(0.0, outside=outside), explanation(0.5, outside=outside))
    assert found["record one again"][0] < 1e-3


def test_a_higher_drive_tells_what_grows_with_it_apart() -> None:
    integral = SimpleNamespace(coefficient=SimpleNamespace(parameters=(DRIVE_SQUARED,)))
    term = SimpleNamespace(integrals=lambda: [integral])
    softening: Any = SimpleNamespace(name="softening", names=("softening",), terms={"one": (term,)})
    tangents = np.zeros((2 * ROWS, 3))
    tangents[:ROWS, 2] = 2.0
    there = explanation(0.2, tangents=tangents, x=(0.0, 0.0, 0.1), free=(0, 2), effects=(softening,))
    found = shares(there, explanation(0.0))
    # Twice the drive: three times more of 0.2.
    distance = ROWS * 0.8**2
    assert found["record one at 4 Vpp"][0] == pytest.approx(
        (math.log(2.0) - math.log1p(math.exp(-distance / 8.0))) / math.log(2.0), rel=1e-9)
    assert found["record one at 4 Vpp"][0] > found["record one again"][0] > found["record one at 1 Vpp"][0]
    assert "record two at 4 Vpp" not in found


def test_the_leads_are_measured_where_hypotheses_differ_by_them() -> None:
    found = shares(explanation(0.0, free=(0, 1)), explanation(0.0, x=(0.0, 0.1, 0.0), free=(0, 1)))
    distance = (0.1 / 0.02) ** 2
    assert found["measure open, short and load of the leads"] == (
        pytest.approx((math.log(2.0) - math.log1p(math.exp(-distance / 8.0))) / math.log(2.0), rel=1e-9),
        pytest.approx(math.exp(0.5 * distance)), 1)
    # Not known better than to 0.2 ohm, the leads of either explanation may be those of the other.
    unsure = shares(*(explanation(0.0, x=(0.0, lead, 0.0), free=(0, 1), error=0.2) for lead in (0.0, 0.1)))
    assert unsure["measure open, short and load of the leads"][0] < 0.1


def test_it_is_said_in_numbers() -> None:
    found = options(model(), [(explanation(0.0), 0.0), (explanation(0.5), 0.0)], 20.0)
    text = next_measurement_text(found, ("leads", "glass"), 20.0)
    assert text.startswith("Record one again, 4 times: the expected odds between leads and glass are 20.1.")
    # 1 - ln(1 + exp(-1.5 / 8)) / ln 2
    assert "removed by one measurement: record one again 13 %, record two again 0 %." in text
    assert "Not compared: another temperature" in text
    text = next_measurement_text(found[1:], ("leads", "glass"), 20.0)
    assert text.startswith("No number of further recordings decides with odds of 20. Record two again, 64 times")
    assert next_measurement_text([], (), 20.0) == ""
