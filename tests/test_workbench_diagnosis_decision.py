"""The decision, without a solver: tables of evidences and the verdicts they come to."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from workbench.diagnosis.decision import (
    AMBIGUOUS,
    AT_ODDS,
    EXPLAINED,
    HINT,
    MISSING,
    NO_MISMATCH,
    UNEXPLAINED,
    Decision,
    Evidence,
    Priors,
    decide,
)
from workbench.diagnosis.odds import Criteria

NOTHING = Evidence("nothing", -1000.0)
#: Forty-eight groups of the catalogue and two hypotheses outside it; two names are of one group.
NAMED = (("leads",), ("gain",), ("glass", "density of the glass"), ("delay",), ("clips",))
PRIORS = Priors((*NAMED, *((f"effect {k}",) for k in range(43))), 2, Criteria())
#: Of fifty hypotheses with 0.4 of the probability, nothing having 0.5: ln 62.5 has to be made up for.
SHARE = math.log(50.0 * 0.5 / 0.4)
#: Two effects have 0.1, of 1225 pairs.
PAIR = math.log(1225.0 * 0.5 / 0.1)


def effect(name: str, gained: float, **away: float) -> Evidence:
    """One effect whose evidence is that much better than that of nothing."""
    return Evidence(name, NOTHING.log_evidence + gained, (name,), z_scores=away)


def verdict(
    *others: Evidence, stated: bool = False, criteria: Criteria | None = None, null: Evidence = NOTHING
) -> Decision:
    return decide((null, *others), replace(PRIORS, criteria=criteria or Criteria()), stated_explains=stated,
                  criteria=criteria)


#: The null hypothesis where a state is not explained by it.
LEAVES = replace(NOTHING, leaves=("disc",))


def test_nothing_wrong_is_no_mismatch_or_known_parameters_explain() -> None:
    """However many parameters there are, and wherever within their priors an optimum has them."""
    weak = effect("leads", 1.0)
    assert verdict(weak, stated=True).verdict == NO_MISMATCH
    found = verdict(weak)
    assert (found.verdict, found.chosen, found.rivals) == (EXPLAINED, NOTHING, ())
    # What a search cannot fit is not explained because it was stated.
    assert verdict(weak, stated=True, null=LEAVES).verdict == UNEXPLAINED


def test_a_known_number_far_from_its_prior_is_a_verdict_of_its_own() -> None:
    moved = replace(NOTHING, at_odds=("glass.density",))
    found = verdict(effect("leads", 1.0), null=moved)
    assert (found.verdict, found.chosen, found.is_explained) == (AT_ODDS, moved, True)
    assert verdict(null=replace(moved, leaves=("disc",))).verdict == UNEXPLAINED
    # Where the stated numbers explain all, no optimum beside them is a finding.
    assert verdict(null=moved, stated=True).verdict == NO_MISMATCH


@pytest.mark.parametrize(("odds", "expected"), [(21.0, MISSING), (19.0, HINT), (1.1, HINT), (0.9, EXPLAINED)])
def test_one_effect_is_named_or_a_hint_by_its_odds(odds: float, expected: str) -> None:
    found = verdict(effect("leads", SHARE + math.log(odds)))
    assert found.verdict == expected
    assert found.log_odds == {"nothing": 0.0, "leads": pytest.approx(math.log(odds), rel=1e-9)}


def test_excluded_hypotheses_do_not_remain() -> None:
    """Neither one that a held-out state refutes nor one whose parameters are near neutral, whatever their odds."""
    hint = effect("leads", SHARE + math.log(5.0))
    refuted = replace(effect("gain", 40.0), refuted_by=("filled",))
    found = verdict(hint, refuted, effect("delay", 40.0, delay=1.0))
    assert (found.verdict, found.remaining) == (HINT, (hint,))


def test_many_weak_ones_together_say_that_something_is_wrong() -> None:
    found = verdict(*(effect(f"effect {k}", SHARE + math.log(6.0)) for k in range(4)))
    assert found.verdict == AMBIGUOUS
    assert len(found.rivals) == 4  # three of them, and nothing: odds of six rule nothing out


def test_prior_masses_are_by_number_of_effects_and_shared_by_groups() -> None:
    groups = (("a",), ("b1", "b2"), ("c",))
    priors = Priors(groups, 1, Criteria())
    names = [name for group in groups for name in group]
    single = sum(math.exp(priors.log_odds([name])) for name in names) + math.exp(priors.log_odds([], outside=True))
    assert single == pytest.approx(0.4 / 0.5)
    # Of four hypotheses there are six pairs, three of which the catalogue can make of different groups.
    pairs = sum(math.exp(priors.log_odds(pair)) for pair in itertools.combinations(names, 2)
                if set(pair) != {"b1", "b2"})
    assert pairs == pytest.approx(0.1 / 0.5 * 3 / 6)
    # Ten more names of one finding change no other.
    synonyms = Priors((("a",), ("b1", "b2", *(f"b{k}" for k in range(3, 13))), ("c",)), 1, Criteria())
    assert synonyms.log_odds(["a"]) == priors.log_odds(["a"])
    assert math.exp(synonyms.log_odds(["b1"])) == pytest.approx(math.exp(priors.log_odds(["b1"])) / 6.0)


def test_a_rival_is_one_that_the_odds_cannot_rule_out() -> None:
    best, close, far = effect("leads", 40.0), effect("gain", 40.0 - math.log(19.0)), effect("delay", 36.9)
    found = verdict(far, close, best)
    assert (found.verdict, found.chosen, found.rivals) == (AMBIGUOUS, best, (close,))
    assert verdict(far, best).verdict == MISSING
    # A tie is ambiguous whatever the order.
    tied = replace(close, log_evidence=best.log_evidence)
    assert {verdict(best, tied).verdict, verdict(tied, best).verdict} == {AMBIGUOUS}


def test_collinear_effects_are_one_finding_with_several_names() -> None:
    """No number of them is capped, and another group beside them is a rival as ever."""
    names = ("glass", "lid", "ports", "rim")
    priors = Priors((names, ("leads",)), 2, Criteria())
    four = [effect(name, 40.0 - 0.5 * k) for k, name in enumerate(names)]
    found = decide((NOTHING, *four), priors, stated_explains=False)
    assert (found.verdict, found.chosen, found.alike, found.rivals) == (MISSING, four[0], tuple(four[1:]), ())
    other = effect("leads", 37.0)
    found = decide((NOTHING, *four, other), priors, stated_explains=False)
    assert (found.verdict, (found.chosen, *found.alike), found.rivals) == (AMBIGUOUS, tuple(four), (other,))


def test_an_explanation_with_redundant_parameters_is_no_rival() -> None:
    best, more = effect("leads", 40.0, eps33=8.0), effect("gain", 39.0, eps33=7.0, e33=0.4)
    assert verdict(best, more).verdict == MISSING
    # Its own parameter is not consistent with nothing: it predicts something else.
    assert verdict(best, replace(more, z_scores={"eps33": 7.0, "e33": 3.0})).verdict == AMBIGUOUS
    assert verdict(best, effect("delay", 39.0, resistance=4.0)).verdict == AMBIGUOUS
    # The one of fewest parameters is named, unless the odds rule it out.
    larger = replace(more, log_evidence=best.log_evidence + 0.5)
    found = verdict(larger, best)
    assert (found.verdict, found.chosen, found.rivals) == (MISSING, best, ())
    assert verdict(replace(larger, log_evidence=-900.0), best).chosen.name == "gain"


def test_an_effect_whose_numbers_are_all_consistent_with_zero_is_not_named() -> None:
    idle, outside = effect("delay", 60.0, delay=1.4), Evidence("something in the disc", -960.0, outside=True)
    assert verdict(idle).verdict == EXPLAINED
    found = verdict(idle, outside, null=LEAVES)
    assert (found.verdict, found.chosen) == (UNEXPLAINED, outside)
    assert verdict(effect("delay", 60.0, delay=2.1), outside).verdict == MISSING


def test_states_held_out_enter_as_data_do() -> None:
    one, other = effect("leads", 45.0, resistance=9.0), effect("glass", 50.0, thickness=9.0)
    predicts = replace(other, log_evidence=-960.0, held_out=10.0)
    found = verdict(one, predicts)
    assert (found.verdict, found.chosen) == (MISSING, predicts)
    # One of two names of its group.
    assert found.log_odds["glass"] == pytest.approx(50.0 - SHARE - math.log(2.0), rel=1e-12)
    assert verdict(replace(one, held_out=-44.0)).verdict == EXPLAINED


def test_a_state_held_out_that_is_not_predicted_refutes() -> None:
    """However much better it fits the others: its weight is not taken from its own residual."""
    wrong = replace(effect("leads", 400.0), held_out=-1.0, share=0.99, leaves=("warm",), refuted_by=("warm",))
    right = effect("gain", 40.0)
    found = verdict(wrong, right, null=LEAVES)
    assert (found.verdict, found.chosen, found.rivals) == (MISSING, right, ())
    found = verdict(wrong, null=LEAVES)
    assert (found.verdict, found.chosen, found.is_explained) == (UNEXPLAINED, LEAVES, False)
    # Nor do the known parameters explain where they do not predict.
    assert verdict(null=replace(NOTHING, leaves=("warm",), refuted_by=("warm",))).verdict == UNEXPLAINED


def test_two_effects_share_a_mass_of_their_own() -> None:
    single = effect("leads", 40.0, resistance=9.0)
    pair = Evidence("leads and gain", single.log_evidence + PAIR - SHARE + math.log(21.0), ("leads", "gain"),
                    z_scores={"resistance": 9.0, "gain": 5.0})
    assert verdict(single, pair).chosen == pair
    # Odds of 20 against the best explanation without the further effect.
    found = verdict(single, replace(pair, log_evidence=pair.log_evidence - math.log(21.0 / 19.0)))
    assert (found.verdict, found.chosen, found.rivals) == (MISSING, single, ())
    for worse, chosen in ((19.0, "leads and gain"), (21.0, "leads")):
        lost = math.log(worse)
        assert verdict(single, replace(pair, log_evidence=pair.log_evidence + lost, held_out=-lost)
                       ).chosen.name == chosen
    # Numbers that are consistent with nothing are none, whatever else fits better with them.
    assert verdict(single, replace(pair, z_scores={"resistance": 9.0, "gain": 1.9})).chosen == single
    # Where no explanation without it is left, there is none to pass.
    assert verdict(pair).chosen == pair


def test_a_hypothesis_outside_the_catalogue_is_unexplained() -> None:
    outside = Evidence("something in the substrate", NOTHING.log_evidence + 60.0, outside=True)
    found = verdict(effect("leads", 50.0), outside, null=LEAVES)
    assert (found.verdict, found.chosen, found.is_explained) == (UNEXPLAINED, outside, False)
    # Something always follows noise: where no more is left, it is a hint.
    found = verdict(effect("leads", 50.0), outside)
    assert (found.verdict, found.chosen) == (HINT, NOTHING)
    # It is a rival of an effect like any other.
    assert verdict(effect("leads", 61.0), outside).verdict == AMBIGUOUS
    assert verdict(effect("leads", 70.0), outside).verdict == MISSING


def test_an_effect_that_leaves_a_state_is_named_only_if_the_rest_is_a_trace() -> None:
    """A cavity filled to 80 % is not small bubbles because they take 91 % and leave 44 times the noise."""
    for gained in (1.0, SHARE + math.log(5.0)):
        assert verdict(effect("leads", gained), null=LEAVES).verdict == UNEXPLAINED
    bubbles = replace(effect("leads", 400.0), leaves=("filled",), share=0.911)
    found = verdict(bubbles, null=LEAVES)
    assert (found.verdict, found.chosen, found.rivals, found.is_explained) == (UNEXPLAINED, LEAVES, (), False)
    trace = replace(bubbles, share=0.97)
    found = verdict(trace, null=LEAVES)
    assert (found.verdict, found.chosen, found.is_explained) == (MISSING, trace, False)
    whole = verdict(replace(bubbles, leaves=()), null=LEAVES)
    assert (whole.verdict, whole.is_explained) == (MISSING, True)


@pytest.mark.parametrize("data", [20, 402])
def test_white_noise_is_within_the_limit_as_often_as_stated(data: int) -> None:
    criteria = Criteria(fitted=1.0)
    squares = np.mean(np.random.default_rng(data).standard_normal((20000, data)) ** 2, axis=1)
    # Of 20000 draws a share of 0.02 is right to 0.001.
    assert np.mean(squares > criteria.limit(data, 0.01)) == pytest.approx(0.02, abs=0.004)
    assert Criteria().limit(data, 0.01, held_out=True) == pytest.approx(1.15 * chi2.ppf(0.98, data) / data)


@pytest.mark.parametrize(("changed", "others", "before", "after"), [
    (Criteria(accepted=100.0), (effect("leads", SHARE + math.log(50.0)),), MISSING, HINT),
    (Criteria(hinted=10.0), (effect("leads", SHARE + math.log(5.0)),), HINT, EXPLAINED),
    (Criteria(rival=2.0), (effect("leads", 40.0), effect("gain", 39.0)), AMBIGUOUS, MISSING),
    (Criteria(by_number=(0.989, 0.01, 0.001)), (effect("leads", SHARE + math.log(50.0)),), MISSING, EXPLAINED),
    (Criteria(redundant=0.5), (effect("leads", 40.0, x=9.0), effect("gain", 39.0, x=9.0, y=1.0)), MISSING, AMBIGUOUS),
    (Criteria(most=0.9), (replace(effect("leads", 40.0), leaves=("disc",), share=0.91),), UNEXPLAINED, MISSING),
])
def test_every_criterion_changes_a_verdict(
    changed: Criteria, others: tuple[Evidence, ...], before: str, after: str
) -> None:
    assert verdict(*others).verdict == before
    assert verdict(*others, criteria=changed).verdict == after


@pytest.mark.parametrize("wrong", [
    {"accepted": 0.5}, {"rival": 1.0}, {"level": 1.0}, {"fitted": 0.9}, {"most": 1.1}, {"at_odds": 0.0},
    {"by_number": (0.5, 0.4, 0.2)}])
def test_criteria_that_decide_nothing_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"odds of a rival|uncertainties above zero|add up to one"):
        Criteria(**wrong)


def test_evidences_without_the_null_hypothesis_are_refused() -> None:
    with pytest.raises(ValueError, match="received 0 evidences that nothing is wrong"):
        decide((effect("leads", 1.0),), PRIORS, stated_explains=False)
