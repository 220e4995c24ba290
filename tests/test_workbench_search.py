"""Continuation, several starts and distinct optima, on functions whose minima are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.search.constrained import Minimum, minimise
from workbench.search.continuation import ContinuationStage, Schedule, TemperedMinimum, tempered
from workbench.search.multistart import StartPoint, Trial, multistart
from workbench.search.optimum import ERRORS, SHARE, distinct, is_same_optimum, separation, standard_errors

Real = NDArray[np.float64]

SCHEDULE = Schedule((ContinuationStage(1.0, 0.1), ContinuationStage(1.0, 0.01), ContinuationStage(1.0)))


@dataclass(frozen=True)
class Ripple:
    """The residuals x and sin(20 x) / 2, a bowl with ripples: minima near 0, 0.3 and so on. Smoothing takes the ripples
    away."""

    vector: Real
    jacobian: Real

    @classmethod
    def at(cls, x: Real, smoothing: float) -> Ripple:
        height = 0.5 * np.exp(-100.0 * smoothing)
        phase = 20.0 * x[0]
        return cls(np.array([x[0], height * np.sin(phase)]), np.array([[1.0], [20.0 * height * np.cos(phase)]]))


def solve(stage: ContinuationStage, x: Real) -> Minimum[Ripple]:
    one = np.ones(1)
    return minimise(lambda y: Ripple.at(y, stage.smoothing), x, low=-2.0 * one, high=2.0 * one, scale=0.1 * one,
                    limit=stage.limit, tolerance=stage.tolerance)


def test_stages_lead_past_minima_that_a_descent_alone_ends_in() -> None:
    begin = np.array([0.9])
    alone = solve(SCHEDULE.stages[-1], begin)
    assert alone.x[0] > 0.5
    told: list[float] = []
    found = tempered(SCHEDULE, solve, begin, progress=lambda _text, share: told.append(share))
    assert found.x[0] == pytest.approx(0.0, abs=1e-3)
    assert (found.ended, sorted(found.costs)) == (True, [0, 1, 2])
    assert found.begin[0] == 0.9
    assert told == pytest.approx([1.0 / 3.0, 2.0 / 3.0, 1.0])
    # A search that begins with the last stage is that descent.
    late = tempered(SCHEDULE, solve, begin, first=7)
    assert late.x == pytest.approx(alone.x, abs=0.0)
    assert sorted(late.costs) == [2]


def test_a_tempered_search_is_given_up_where_its_rival_is_better_but_not_at_the_last_stage() -> None:
    begin = np.array([0.9])
    best = tempered(SCHEDULE, solve, begin)

    def against(costs: dict[int, float], first: int = 0) -> TemperedMinimum[Ripple]:
        return tempered(SCHEDULE, solve, begin, first=first, rival=replace(best, costs=costs), worse=2.0)

    given_up = against({0: -1.0, 1: -1.0, 2: -1.0})
    assert (given_up.ended, sorted(given_up.costs)) == (False, [0])
    assert against({2: -1.0}).ended
    assert against({0: 1.0, 1: 1.0}).ended


def test_stages_are_those_that_points_can_show_and_may_hold_parameters_at_first() -> None:
    assert [each.smoothing for each in SCHEDULE.resolved(0.05).stages] == [0.1, 0.0]
    assert [each.held for each in SCHEDULE.holding((3,)).stages] == [(3,), (), ()]


def test_starts_are_tried_in_their_order_and_a_refused_one_has_no_end() -> None:
    def descend(start: StartPoint) -> float:
        if start.x[0] < 0.0:
            raise ArithmeticError("negative")
        return float(start.x[0])

    starts = [StartPoint(str(x), np.array([x])) for x in (2.0, -1.0, 3.0)]
    told: list[tuple[str, float]] = []
    trials = multistart(starts, descend, refused=(ArithmeticError,), progress=lambda *words: told.append(words))
    assert [(each.start.label, each.end, each.reason) for each in trials] == [
        ("2.0", 2.0, ""), ("-1.0", None, "ArithmeticError: negative"), ("3.0", 3.0, "")]
    assert [share for _, share in told] == pytest.approx([0.0, 1.0 / 3.0, 2.0 / 3.0])
    assert len(multistart(starts, descend, refused=(ArithmeticError,), tries=2)) == 2
    with pytest.raises(ArithmeticError, match="negative"):
        multistart(starts, descend, refused=())


def test_what_a_trial_finds_changes_the_starts_that_follow() -> None:
    def following(trial: Trial[float], waiting: Sequence[StartPoint]) -> Sequence[StartPoint]:
        if trial.end == 2.0:
            return [StartPoint("new", np.array([5.0])), *waiting]
        return () if trial.end == 3.0 else waiting

    starts = [StartPoint(str(x), np.array([x])) for x in (2.0, 3.0, 4.0)]
    trials = multistart(starts, lambda start: float(start.x[0]), refused=(), following=following)
    assert [each.start.label for each in trials] == ["2.0", "new", "3.0"]


def test_an_optimum_reaches_as_far_as_its_errors_or_its_share_of_what_was_known() -> None:
    errors, scale = np.array([1.0, 0.0, 0.0]), np.array([1.0, 100.0, 0.0])
    at = np.zeros(3)
    most = np.array([ERRORS, 100.0 * SHARE, 0.0])
    assert is_same_optimum(at, most, errors, scale)
    for step in np.diag([1.01 * ERRORS, -101.0 * SHARE, 1e-12]):
        assert not is_same_optimum(at, step, errors, scale)
        assert not is_same_optimum(step, at, errors, scale)
    assert separation(at, 0.5 * most, errors, scale) == pytest.approx([0.5, 0.5, 0.0])


def test_errors_do_not_depend_on_units_and_are_large_where_nothing_is_seen() -> None:
    jacobian = np.random.default_rng(1).standard_normal((9, 3))
    expected = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    units = np.array([1e11, 1.0, 1e-9])
    assert standard_errors(jacobian / units, units) == pytest.approx(units * expected, rel=1e-9)
    jacobian[:, 1] = 0.0
    assert standard_errors(jacobian, np.ones(3))[1] > 1e5


def test_ends_are_sorted_by_their_optima_best_first() -> None:
    ends = [(3.1, 5.0), (0.0, 1.0), (3.0, 4.0), (0.1, 2.0), (9.0, 3.0)]
    found = distinct(ends, lambda one, best: abs(one[0] - best[0]) < 0.5, lambda end: end[1])
    assert found == [[(0.0, 1.0), (0.1, 2.0)], [(9.0, 3.0)], [(3.0, 4.0), (3.1, 5.0)]]
