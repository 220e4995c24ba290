"""The decision, without a solver: tables of evidences and the verdicts they come to."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from workbench.diagnosis.decision import (
    AMBIGUOUS,
    EXPLAINED,
    HINT,
    MISSING,
    NO_MISMATCH,
    UNEXPLAINED,
    Decision,
    Evidence,
    decide,
)
from workbench.diagnosis.odds import Criteria

NOTHING = Evidence("nothing", -1000.0)
#: Of fifty hypotheses each has a hundredth of the probability: ln 50 = 3.9 to be made up for against nothing.
COUNT, SHARE = 50, math.log(50.0)


def effect(name: str, gained: float, **away: float) -> Evidence:
    """One effect whose evidence is that much better than that of nothing."""
    return Evidence(name, NOTHING.log_evidence + gained, (name,), z_scores=away)


def verdict(
    *others: Evidence, stated: bool = False, criteria: Criteria | None = None, left: float = 1.0
) -> Decision:
    """The decision where the null hypothesis leaves `left` times the stated noise."""
    nothing = replace(NOTHING, inflation=left, misfit=left)
    return decide((nothing, *others), COUNT, stated_explains=stated, criteria=criteria)


def test_nothing_wrong_is_no_mismatch_or_what_known_parameters_explain() -> None:
    weak = effect("leads", 1.0)
    assert verdict(weak, stated=True).verdict == NO_MISMATCH
    found = verdict(weak)
    assert (found.verdict, found.chosen, found.rivals) == (EXPLAINED, NOTHING, ())
    assert verdict().verdict == EXPLAINED


def test_odds_are_what_the_evidence_gains_less_the_share_of_the_hypothesis() -> None:
    found = verdict(effect("leads", 7.0))
    assert found.log_odds == {"nothing": 0.0, "leads": pytest.approx(7.0 - SHARE, rel=1e-12)}


@pytest.mark.parametrize(("odds", "expected"), [(21.0, MISSING), (19.0, HINT), (1.1, HINT), (0.9, EXPLAINED)])
def test_one_effect_is_said_hinted_at_or_neither_by_its_odds(odds: float, expected: str) -> None:
    assert verdict(effect("leads", SHARE + math.log(odds))).verdict == expected


def test_many_weak_ones_together_say_that_something_is_wrong() -> None:
    each = [effect(f"effect {k}", SHARE + math.log(6.0)) for k in range(4)]
    found = verdict(*each)
    assert found.verdict == AMBIGUOUS
    assert len(found.rivals) == 4  # three of them, and nothing: odds of six rule nothing out


def test_a_rival_is_what_the_odds_cannot_rule_out() -> None:
    best, close, far = effect("leads", 40.0), effect("gain", 40.0 - math.log(19.0)), effect("glass", 36.9)
    found = verdict(far, close, best)
    assert (found.verdict, found.chosen, found.rivals) == (AMBIGUOUS, best, (close,))
    assert verdict(far, best).verdict == MISSING


def test_what_adds_only_redundant_parameters_is_no_rival() -> None:
    best = effect("dielectric loss", 40.0, eps33=8.0)
    more = effect("complex piezoelectric constant", 39.0, eps33=7.0, e33=0.4)
    assert verdict(best, more).verdict == MISSING
    # Its own parameter is not consistent with nothing: it says something else.
    assert verdict(best, replace(more, z_scores={"eps33": 7.0, "e33": 3.0})).verdict == AMBIGUOUS
    assert verdict(best, effect("leads", 39.0, resistance=4.0)).verdict == AMBIGUOUS


def test_an_effect_whose_numbers_are_all_consistent_with_nothing_is_not_said() -> None:
    idle, outside = effect("delay", 60.0, delay=1.4), Evidence("something in the disc", -960.0, outside=True)
    assert verdict(idle).verdict == EXPLAINED
    found = verdict(idle, outside, left=3.0)
    assert (found.verdict, found.chosen) == (UNEXPLAINED, outside)
    assert verdict(effect("delay", 60.0, delay=2.1), outside).verdict == MISSING


def test_of_those_that_say_the_same_the_one_that_says_least_is_named() -> None:
    least, more = effect("leads", 40.0, resistance=8.0), effect("leads and clips", 40.5, resistance=8.0, clips=1.0)
    found = verdict(more, least)
    assert (found.verdict, found.chosen, found.rivals) == (MISSING, least, ())
    # Not where the odds rule it out, and not where the further parameter says something.
    assert verdict(replace(more, log_evidence=-900.0), least).chosen.name == "leads and clips"
    assert verdict(replace(more, z_scores={"resistance": 8.0, "clips": 3.0}), least).verdict == AMBIGUOUS


def test_two_that_move_the_same_parameters_are_one() -> None:
    one, other = effect("bond", 40.0, stiffness=8.0), effect("bond again", 40.0, stiffness=8.0)
    found = verdict(one, other)
    assert (found.verdict, found.rivals) == (MISSING, ())


def test_states_held_out_enter_as_data_do() -> None:
    one, other = effect("leads", 45.0, resistance=9.0), effect("glass", 40.0, thickness=9.0)
    assert verdict(one, other).chosen == one
    predicts = replace(other, held_out=10.0)
    found = verdict(one, predicts)
    assert (found.verdict, found.chosen) == (MISSING, predicts)
    assert found.log_odds["glass"] == pytest.approx(50.0 - SHARE, rel=1e-12)
    assert verdict(replace(one, held_out=-44.0)).verdict == EXPLAINED


def test_a_tie_is_ambiguous_whatever_the_order() -> None:
    one, other = effect("leads", 40.0, resistance=9.0), effect("glass", 40.0, thickness=9.0)
    for order in ((one, other), (other, one)):
        found = verdict(*order)
        assert (found.verdict, {found.chosen.name, found.rivals[0].name}) == (AMBIGUOUS, {"leads", "glass"})


def test_what_leaves_more_than_noise_is_unexplained_though_nothing_is_named() -> None:
    for gained in (1.0, SHARE + math.log(5.0)):
        found = verdict(effect("leads", gained), left=3.0)
        assert (found.verdict, found.chosen.name, found.rivals) == (UNEXPLAINED, "nothing", ())
    assert verdict(effect("leads", 40.0), left=3.0).verdict == MISSING


def test_two_effects_have_to_earn_a_share_each() -> None:
    single = effect("leads", 40.0, resistance=9.0)
    pair = Evidence("leads and gain", NOTHING.log_evidence + 40.0, ("leads", "gain"),
                    z_scores={"resistance": 9.0, "gain": 5.0})
    both = verdict(single, replace(pair, log_evidence=single.log_evidence + SHARE + math.log(2.0) + math.log(21.0)))
    assert (both.verdict, both.chosen.effects) == (MISSING, ("leads", "gain"))
    assert verdict(single, replace(pair, log_evidence=single.log_evidence + 1.0)).chosen == single


def test_a_further_effect_passes_the_bar_of_the_first() -> None:
    """Odds of 20 against the best explanation without it; and it has to predict the states held out as well."""
    single = effect("leads", 40.0, resistance=9.0)
    pair = Evidence("leads and gain", single.log_evidence + SHARE + math.log(21.0), ("leads", "gain"),
                    z_scores={"resistance": 9.0, "gain": 5.0})
    assert verdict(single, pair).chosen == pair
    short = replace(pair, log_evidence=pair.log_evidence - math.log(21.0 / 19.0))
    found = verdict(single, short)
    assert (found.verdict, found.chosen, found.rivals) == (MISSING, single, ())
    for worse, chosen in ((19.0, "leads and gain"), (21.0, "leads")):
        lost = math.log(worse)
        assert verdict(single, replace(pair, log_evidence=pair.log_evidence + lost, held_out=-lost)
                       ).chosen.name == chosen
    # Numbers that are consistent with nothing are none, whatever else fits better with them.
    assert verdict(single, replace(pair, z_scores={"resistance": 9.0, "gain": 1.9})).chosen == single
    assert verdict(single, replace(pair, z_scores={"resistance": 9.0, "gain": 2.1})).chosen.name == "leads and gain"
    # Where no explanation without it is left, there is none to pass.
    assert verdict(short).chosen == short


def test_what_the_catalogue_does_not_have_is_unexplained() -> None:
    outside = Evidence("something in the substrate", NOTHING.log_evidence + 60.0, outside=True)
    found = verdict(effect("leads", 50.0), outside, left=3.0)
    assert (found.verdict, found.chosen) == (UNEXPLAINED, outside)
    # Something always follows noise: where no more is left, it is a hint.
    found = verdict(effect("leads", 50.0), outside)
    assert (found.verdict, found.chosen) == (HINT, NOTHING)
    # It is a rival of an effect like any other.
    assert verdict(effect("leads", 61.0), outside).verdict == AMBIGUOUS
    assert verdict(effect("leads", 70.0), outside).verdict == MISSING


@pytest.mark.parametrize(("changed", "others", "before", "after"), [
    (Criteria(accepted=100.0), (effect("leads", SHARE + math.log(50.0)),), MISSING, HINT),
    (Criteria(hinted=10.0), (effect("leads", SHARE + math.log(5.0)),), HINT, EXPLAINED),
    (Criteria(rival=2.0), (effect("leads", 40.0), effect("gain", 39.0)), AMBIGUOUS, MISSING),
    (Criteria(nothing_wrong=0.99), (effect("leads", SHARE + math.log(50.0)),), MISSING, EXPLAINED),
    (Criteria(redundant=0.5), (effect("a", 40.0, x=9.0), effect("b", 39.0, x=9.0, y=1.0)), MISSING, AMBIGUOUS),
])
def test_every_criterion_changes_a_verdict(
    changed: Criteria, others: tuple[Evidence, ...], before: str, after: str
) -> None:
    assert verdict(*others).verdict == before
    assert verdict(*others, criteria=changed).verdict == after


def test_the_noise_that_may_be_left_changes_a_verdict() -> None:
    assert verdict(left=3.0).verdict == UNEXPLAINED
    assert verdict(left=3.0, criteria=Criteria(inflated=4.0)).verdict == EXPLAINED


def test_an_observation_at_odds_is_not_explained() -> None:
    """However little is left of Z."""
    def found(distance: float, *others: Evidence) -> str:
        null = replace(NOTHING, observed=distance)
        return decide((null, *others), COUNT, stated_explains=True).verdict

    assert found(3.0) == NO_MISMATCH
    assert found(4.0) == UNEXPLAINED
    leads = effect("leads", 40.0)
    assert found(0.0, leads) == MISSING
    assert found(9.0, replace(leads, observed=8.0)) == UNEXPLAINED


def test_an_effect_that_takes_all_but_a_trace_is_said_whatever_the_trace_is() -> None:
    left = replace(effect("leads", 40.0), inflation=3.0, share=0.95)
    found = verdict(left)
    assert (found.verdict, found.chosen) == (MISSING, left)
    assert verdict(left, criteria=Criteria(most=0.96)).verdict == UNEXPLAINED


def test_an_effect_that_leaves_more_than_noise_and_no_trace_explains_nothing() -> None:
    left = replace(effect("leads", 40.0), inflation=3.0, share=0.85)
    found = verdict(left)
    assert (found.verdict, found.chosen, found.rivals) == (UNEXPLAINED, NOTHING, ())
    assert verdict(left, criteria=Criteria(inflated=4.0)).verdict == MISSING


@pytest.mark.parametrize("wrong", [
    {"accepted": 0.5}, {"hinted": 0.0}, {"rival": 1.0}, {"nothing_wrong": 1.0}, {"redundant": 0.0}, {"inflated": 0.9},
    {"at_odds": 0.0}, {"most": 0.0}, {"most": 1.1}])
def test_criteria_that_decide_nothing_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"odds above zero|between 0 and 1|uncertainties above zero"):
        Criteria(**wrong)


def test_evidences_without_the_one_that_nothing_is_wrong_are_refused() -> None:
    with pytest.raises(ValueError, match="received 0 evidences that nothing is wrong"):
        decide((effect("leads", 1.0),), COUNT, stated_explains=False)
    with pytest.raises(ValueError, match="2 of single hypotheses; expected one, and at most 1"):
        decide((NOTHING, effect("leads", 1.0), effect("gain", 1.0)), 1, stated_explains=False)


def test_deviations_that_explain_all_leave_nothing_unexplained() -> None:
    """A device within the inhomogeneity of its parts, whose numbers alone leave four times the noise."""
    nothing = replace(NOTHING, inflation=1.0, misfit=4.0)
    outside = Evidence("something in the bond", NOTHING.log_evidence + 40.0, outside=True)
    assert decide((nothing,), COUNT, stated_explains=False).verdict == EXPLAINED
    assert decide((nothing, outside), COUNT, stated_explains=False).verdict == UNEXPLAINED
    assert decide((replace(nothing, misfit=1.0), outside), COUNT, stated_explains=False).verdict == HINT
