"""What counts as an explanation."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.diagnosis import basins, criteria, procedure, refit, verdict
from workbench.diagnosis.locate import MODE, Place
from workbench.diagnosis.score import Score, promising


def fit(reduced: float, good: bool = False, chi_square: float = 0.0, prior_pull: float = 1.0) -> Any:
    return SimpleNamespace(reduced=reduced, good=good, chi_square=chi_square, prior_pull=prior_pull, correlation=1.0,
                           occam_factor=0.0, evidence=chi_square)


def score(gain: float, numbers: int = 1, effect: str = "") -> Any:
    """The score of a hypothesis of one parameter more than the data see."""
    error = np.array([*[0.1] * numbers, np.inf])
    return Score(effect, gain, gain, np.zeros(numbers + 1), error, np.zeros((0, 0)), 0.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(("before", "after", "explained", "said"), [
    (fit(1.5), fit(1.05, True), True, "a further hypothesis would take 30.0"),  # nothing but noise is left
    (fit(14.0), fit(1.5), True, "a further hypothesis would take 30.0"),  # a strong effect, described to 4 %
    # By known parameters that are elsewhere; and where the base has strained them much more.
    (fit(14.0), fit(1.5, prior_pull=3.0), False, "lie 3 standard uncertainties"),
    (fit(14.0, prior_pull=40.0), fit(1.5, prior_pull=3.0), True, "take 30.0"),
    (fit(14.0), fit(3.0), False, "reduced chi-square of 3, more than noise and than 10 %"),
    (fit(1.8), fit(1.2), False, "more than noise"),  # a quarter is left of what is no noise
])
def test_what_is_left_decides_whether_a_fit_explains(before: Any, after: Any, explained: bool, said: str) -> None:
    """And what is said of a fit of which a further hypothesis would take 30."""
    assert criteria.explains(before, after) == explained
    assert said in verdict._lacking(before, after, 30.0)


@pytest.mark.parametrize(("best", "asked"), [
    (fit(1.05, True, 1050.0), True),
    (fit(1.3, False, 1300.0), False),  # explains nothing
    (fit(1.05, True, 1495.0), False),  # gains next to nothing
])
def test_the_best_single_is_looked_for_in_other_basins_where_it_still_hints_at_something(
    monkeypatch: pytest.MonkeyPatch, best: Any, asked: bool
) -> None:
    """Before the base is asked for where it led: from a wrong basin no way leads to the base's right one."""
    base, second, hopped = fit(1.5, chi_square=1500.0), fit(1.5, chi_square=1499.0), fit(1.0, True, 1000.0)
    best.x = np.zeros(1)
    monkeypatch.setattr(procedure, "further_scores", lambda *_of: [score(42.0)])
    monkeypatch.setattr(procedure, "rebuilt_in_another_basin", lambda _model, of, _x: hopped if of is best else None)
    monkeypatch.setattr(procedure, "rebuild_and_refine", lambda _model, of, _scores: of)
    model: Any = None
    found = procedure._hopped(model, base, [second, best], lambda *_of: None)
    assert found == sorted([second, hopped if asked else best], key=lambda each: each.chi_square)


def test_nothing_is_looked_for_in_other_basins_where_no_hypothesis_was_refitted() -> None:
    model: Any = None
    assert procedure._hopped(model, fit(1.5), [], lambda *_of: None) == []


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
    assert criteria.is_complete(base, best, left) == complete


def test_a_mode_besides_outdoes_an_effect_that_explains_less() -> None:
    base, best = fit(1.2, chi_square=1200.0), fit(1.1, True, 1180.0)
    mode, loss = Place("transducer", MODE, 6.0), Place("bond", "loss", 5.0)
    assert criteria.has_mode_besides(base, best, (mode, loss))
    # Its square must be ahead of the gain of 20 by 6; patterns of other kinds are what an effect looks like.
    assert not criteria.has_mode_besides(base, best, (mode._replace(sigmas=5.0), loss))
    assert not criteria.has_mode_besides(base, best, (loss._replace(sigmas=7.0), mode))
    assert not criteria.has_mode_besides(base, best, ())
    # A third of both is 12 and 7.
    best.correlation = 3.0
    assert not criteria.has_mode_besides(base, best, (mode, loss))


@pytest.mark.parametrize(("gain", "numbers", "correlation", "hint"), [
    (13.0, 1, 1.0, True),
    (12.0, 1, 1.0, False),
    (20.0, 1, 2.0, False),  # as many points as ten
    (20.0, 6, 1.0, False),  # six numbers gain six by chance, with a spread of three and a half
    (30.0, 6, 1.0, True),
])
def test_a_hint_is_what_noise_hardly_gives(gain: float, numbers: int, correlation: float, hint: bool) -> None:
    assert criteria.is_hint(score(gain, numbers), correlation) == hint


def test_a_further_hypothesis_of_many_numbers_takes_some_by_chance() -> None:
    """Twenty by one number and 35.8 by seven are as rare."""
    best = fit(1.02)
    best.effects = ("rim",)
    assert criteria.remaining_gain(best, [score(20.0)]) == pytest.approx(20.0)
    assert criteria.remaining_gain(best, [score(12.0), score(36.0, 7)]) == pytest.approx(20.2, abs=0.1)


def test_what_a_further_hypothesis_takes_is_asked_of_the_refit_where_there_is_one() -> None:
    best, pair = fit(1.02, chi_square=1000.0), fit(1.01, chi_square=988.0)
    best.effects, pair.effects = ("rim",), ("rim", "load")
    further = [score(9.0, effect="mass"), score(25.0, effect="load")]
    assert criteria.remaining_gain(best, further) == pytest.approx(25.0)
    assert criteria.remaining_gain(best, further, [pair]) == pytest.approx(12.0)
    pair.effects = ("gap", "load")
    assert criteria.remaining_gain(best, further, [pair]) == pytest.approx(25.0)


@pytest.mark.parametrize(("gain", "numbers", "rare"), [(14.0, 1, False), (16.5, 1, True), (16.5, 2, False),
                                                       (19.5, 2, True)])
def test_four_sigmas_of_one_number_are_rare(gain: float, numbers: int, rare: bool) -> None:
    assert criteria.is_rare(gain, numbers, criteria.CLEAR) == rare


@pytest.mark.parametrize(("gains", "count", "least", "kept"), [
    ((28.0, 1.0, 29.0), 8, 0.0, (28.0, 29.0)),  # far down for its number of parameters, and no worse
    ((28.0, 1.0, 29.0), 1, 0.0, (28.0,)),
    ((100.0, 31.0, 29.0), 8, 0.0, (100.0, 31.0)),  # a third of what the best one does
    ((9.0, 8.0), 8, 10.0, ()), ((), 8, 0.0, ()),
])
def test_what_promises_much_is_refitted_in_the_order_of_evidence(
    gains: tuple[float, ...], count: int, least: float, kept: tuple[float, ...]
) -> None:
    scores: Any = [SimpleNamespace(gain=gain) for gain in gains]
    assert tuple(scored.gain for scored in promising(scores, count, least)) == kept


def test_what_leaves_little_and_hints_at_something_is_not_quiet() -> None:
    """A wrong basin of a thin layer's thickness: chi-square 1.00, and a hypothesis that gains 42."""
    weak, strong = score(8.0), score(42.0)
    assert criteria.is_quiet(fit(1.0, True), [weak])
    assert not criteria.is_quiet(fit(1.0, True), [weak, strong])
    assert not criteria.is_quiet(fit(1.3), [weak])


def test_basins_that_cost_about_the_same_are_compared_where_the_data_weigh_more() -> None:
    asked: list[float] = []

    def minimise(x: NDArray[np.float64], *_: Any, **__: Any) -> Any:
        asked.append(float(x[0]))
        return SimpleNamespace(x=x + 0.01, cost={0.0: 5.0, 2.0: 3.0}[float(x[0])])

    search: Any = SimpleNamespace(scale=np.array([2.0]), objective=SimpleNamespace(recordings=[None]),
                                  minimise=minimise)
    # The third is the first one's basin, the last costs too much.
    ends: Any = [SimpleNamespace(x=np.array([place]), cost=cost)
                 for place, cost in ((0.0, 1.0), (2.0, 1.2), (0.4, 1.1), (4.0, 2.0))]
    end, there = basins._compared(search, ends, [0])
    assert end is ends[1]
    assert there == pytest.approx([2.01])
    assert asked == [0.0, 2.0]
    assert basins._compared(search, ends[:1], [0]) == (ends[0], ends[0].x)
    assert asked == [0.0, 2.0]  # nothing to compare


def test_basins_far_off_are_looked_for_in_all_that_a_layer_may_be() -> None:
    search: Any = SimpleNamespace(low=np.array([2e-6]), high=np.array([1e-4]), centre=np.array([2e-5]),
                                  scale=np.array([3e-6]))
    near, far = (np.array(basins._places(search, 0, far)) for far in (False, True))
    assert np.abs(near - 2e-5).max() == pytest.approx(6e-6)
    # A basin is about as wide as its layer is thick.
    steps = np.diff(np.log([2e-6, *far, 1e-4]))
    assert 0.0 < steps.min() <= steps.max() <= np.log(2.0)
    negative: Any = SimpleNamespace(low=-search.high, high=-search.low)
    assert basins._places(negative, 0, True) == pytest.approx(-far[::-1])


def test_parameters_that_end_at_a_bound_are_told() -> None:
    parameters = [SimpleNamespace(name=name, low=-5.0, high=5.0) for name in ("inside", "held", "low", "high")]
    ended: Any = SimpleNamespace(search=SimpleNamespace(parameters=parameters, free=[0, 2, 3]),
                                 x=np.array([4.9, 5.0, -4.9999, 5.0]))
    assert refit.Refit.at_bounds.fget(ended) == ["low", "high"]  # type: ignore[attr-defined]


def predicting(*states: NDArray[np.complex128]) -> Any:
    """An objective whose states are scaled by 1 + x."""
    return SimpleNamespace(predict=lambda x, index: ((1.0 + x[0]) * states[index],))


def test_the_next_measurement_is_where_the_rivals_differ_most() -> None:
    one = np.full(50, 10.0 + 5.0j)
    loud, quiet = np.full(50, 0.01), np.full(50, 0.002)
    campaign = SimpleNamespace(fitted=[SimpleNamespace(name="empty", noise=loud)],
                               held_out=[SimpleNamespace(name="filled", noise=quiet)])
    model: Any = SimpleNamespace(campaign=campaign, fitted=predicting(one), held_out=predicting(one))
    effects = [SimpleNamespace(name=name) for name in ("bubbles", "a gap")]
    best, other = (SimpleNamespace(name=effect.name, effects=(effect,), x=np.array([shift]))
                   for effect, shift in zip(effects, (0.0, 4e-4), strict=True))
    tangent = np.eye(4)[:, :1]
    scores: Any = [SimpleNamespace(effect=effect, tangent=tangent) for effect in effects]
    rival: Any = verdict.Rival(other, 2.0, False)  # type: ignore[arg-type]
    said = verdict._next(model, best, [rival], scores)  # type: ignore[arg-type]
    # 50 points of 4e-4 over 0.002: a chi-square of 2, a twelfth of what tells two apart twice over.
    assert said.startswith("Record filled again: bubbles and a gap differ most there, by a chi-square of 2.0; 6 times")
    assert "cosine of 1.000" in said
    assert verdict._next(model, best, [], scores) == ""  # type: ignore[arg-type]


@pytest.mark.parametrize(("chi_square", "parameters", "effects", "held", "as_well"), [
    (105.0, "x", 1, 0.0, True),
    (107.0, "x", 1, 0.0, False),
    (105.0, "x", 1, 2.0, False),   # it predicts the states held out worse
    (103.0, "xy", 1, 0.0, True),
    (105.0, "xy", 1, 0.0, False),  # no better than chance for a further parameter
    (97.0, "ab", 1, 0.0, True),
    (99.0, "ab", 1, 0.0, False),   # the best with one parameter more, which it does not need
    (50.0, "xy", 2, 0.0, False),   # two effects always fit better than one
])
def test_what_fits_as_well_is_a_rival_whatever_its_ranges_cost(
    chi_square: float, parameters: str, effects: int, held: float, as_well: bool
) -> None:
    best: Any = SimpleNamespace(chi_square=100.0, estimate={"a": 1.0}, effects=("one",))
    other: Any = SimpleNamespace(chi_square=chi_square, estimate=dict.fromkeys(parameters, 1.0),
                                 effects=("one", "two")[:effects])
    assert criteria.fits_as_well(other, best, held) == as_well
