"""The statistics of a diagnosis on recordings that are linear in the parameters, against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_explanations import LinearCampaign, made_explanation, made_problem
from numpy.typing import NDArray
from scipy.stats import multivariate_normal

from workbench.campaign.state import state_fit
from workbench.catalogue.effect import Effect
from workbench.diagnosis.conclusion import conclude, evidence, unexplained_as_stated
from workbench.diagnosis.decision import AT_ODDS, EXPLAINED, NO_MISMATCH, UNEXPLAINED
from workbench.diagnosis.device import Model
from workbench.diagnosis.estimates import pulls
from workbench.diagnosis.findings import Found, Refitted
from workbench.diagnosis.inference import WITHIN, DiagnosisSearch
from workbench.diagnosis.likelihood import Explanation, Hypothesis, Likelihood
from workbench.diagnosis.odds import Criteria
from workbench.diagnosis.ranking import Score, Tangents, groups_of, ranked_beside
from workbench.diagnosis.refit import predictions, with_held_out
from workbench.fitting.parameter import Parameter
from workbench.model.numbers import Stated

Real = NDArray[np.float64]


def number(name: str, prior: float | None = None, **more: Any) -> Parameter:
    """A parameter about zero, without a prior by default."""
    return Parameter(name, 0.0, -200.0, 200.0, None if prior is None else Stated(prior), "1", **more)


def effect(*names: str, freed: tuple[str, ...] = ()) -> Effect:
    return Effect(names[0], "bench", "bench", "", tuple(map(number, names if not freed else ())), freed)


KNOWN = (number("a", 1.0), number("b", 2.0))
EFFECTS = tuple(map(effect, "hkqr"))
EVERY = (*KNOWN, *map(number, "hkqr"))
#: The third and the fourth do what the first does.
ALIKE = {"q": "h", "r": "h"}


def stated_fits(model: Model, *likelihoods: Likelihood) -> tuple[Any, ...]:
    """All states as they are stated."""
    every = [(state, log) for each in likelihoods for state, log in zip(
        each.states, each.data(Hypothesis(), model.stated).log_ratio, strict=True)]
    return tuple(state_fit(state.name, log, np.exp(log), state.noise) for state, log in every)


def tangents_at(likelihood: Likelihood, x: Real) -> Tangents:
    found = likelihood.objective(x, deviation=likelihood.point_deviations())
    return Tangents(x, found.jacobian, found.vector)


# --------------------------------------------------------------------------------------------------------------------
# What is explained


@pytest.mark.parametrize(("off", "refuted"), [(0.0, False), (30.0, True)])
def test_a_state_held_out_is_tested_against_its_stated_noise(off: float, refuted: bool) -> None:
    """With the parameters of the others and numbers of its own; its weight is not what it shows itself."""
    own = number("own", 3.0, recordings=("state 1",))
    # A number that acts in it alone is fitted to it; one that nothing knows of is a mismatch.
    campaign = LinearCampaign((*KNOWN, own, number("h", recordings=("state 1",))), {"a": 1.0, "own": 7.0, "h": off},
                              (effect("h"),), held_out=True)
    model, fitted, held = campaign.made()
    found = fitted.refit(Hypothesis(), model.stated)
    joined = with_held_out(held, found, np.zeros((140, 0)))
    predicted, = predictions(held, found, joined)
    tangents, residual = tangents_at(held, joined.likeliest).jacobian[:, :3], joined.log_ratio[1] / 0.01
    residual = np.concatenate([residual.real, residual.imag])
    information = found.local.tangents * found.local.root[:, None]
    covariance = np.linalg.inv(information.T @ information + np.diag([1.0, 0.25, 1.0 / 9.0]))
    whole = np.eye(60) + tangents @ covariance @ tangents.T
    # Directions of less than 3 % of the noise are left out.
    assert predicted.reduced == pytest.approx(residual @ np.linalg.solve(whole, residual) / 60.0, rel=1e-3)
    told = evidence(model, Refitted(found, joined, (predicted,)), stated_fits(model, fitted, held), Criteria())
    assert told.refuted_by == told.leaves == (("state 1",) if refuted else ())
    # A gain of its own takes what is of the gain.
    assert refuted or abs(joined.likeliest[2] - 7.0) < 3.0


@pytest.mark.parametrize("size", [0.0, 3.0])
def test_the_prediction_of_a_state_allows_for_inhomogeneity_that_the_others_show(size: float) -> None:
    """Chi-square has its expectation over draws of noise, parameters and inhomogeneity: 1, to four standard errors."""
    rng = np.random.default_rng(3)
    fitted, held = 60, 40
    tangents, parts = rng.standard_normal((fitted + held, 2)), rng.standard_normal((fitted + held, 5))
    state = SimpleNamespace(noise=np.ones(held // 2), data=2)
    design = np.column_stack([tangents, size * parts])[:fitted]
    prior = np.eye(2 if size == 0.0 else 7)
    reduced = []
    for _ in range(100):
        parameters, amplitudes = rng.standard_normal(2), size * rng.standard_normal(5)
        data = tangents @ parameters + parts @ amplitudes + rng.standard_normal(fitted + held)
        # At the optimum of the fitted states.
        acting = design[:, :len(prior)]
        x = -np.linalg.solve(acting.T @ acting + prior, acting.T @ data[:fitted])[:2]
        local, both = (made_problem(data[:rows] + tangents[:rows] @ x, tangents[:rows], np.ones(2), offset=x,
                                    parts=parts[:rows], inhomogeneities=(size,)) for rows in (fitted, fitted + held))
        found, joined = (made_explanation(each, x, impedances=(None, None)) for each in (local, both))
        prediction, = predictions(SimpleNamespace(states=(state,), places=[slice(0, held)]), found, joined)
        reduced.append(prediction.reduced)
    assert np.mean(reduced) == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / held / 100))


@pytest.mark.parametrize(("true", "expected"), [(0.0, 1.0), (2.0, 1.0), (40.0, None)])
def test_a_fitted_state_is_tested_with_the_inhomogeneity_of_usual_devices(true: float, expected: float | None) -> None:
    """Its chi-square has the expectation 1, to four standard errors; beyond the range, it is that of the noise."""
    rng, size, sizes = np.random.default_rng(5), 120, tuple(np.logspace(-1.0, 1.0, 7))
    states = tuple(SimpleNamespace(noise=np.ones(size // 4), data=2, observation=None) for _ in range(2))
    reduced = []
    for _ in range(40):
        parts = rng.standard_normal((size, 6))
        residual = parts @ (true * rng.standard_normal(6)) + rng.standard_normal(size)
        local = made_problem(residual, np.zeros((size, 1)), np.ones(1), offset=np.zeros(1), parts=parts,
                             inhomogeneities=sizes)
        log = [each[:size // 4] + 1j * each[size // 4:] for each in np.split(residual, 2)]
        found = made_explanation(local, np.zeros(1), states=states, log_ratio=log)
        plain = [float(np.mean(np.abs(each) ** 2)) / 2.0 for each in log]
        if expected is None:
            assert local.is_unusually_uneven
            assert found.reduced_chi_squares == pytest.approx(plain)
        reduced += found.reduced_chi_squares
    if expected is not None:
        assert np.mean(reduced) == pytest.approx(expected, abs=4.0 * math.sqrt(2.0 / (size // 2) / len(reduced)) + 0.05)


def test_stated_numbers_that_leave_noise_are_no_mismatch_however_many_they_are() -> None:
    """Pulls are those of chance: the sum of their squares is about as large as they are many."""
    known = tuple(number(f"n{k}", 1.0) for k in range(40))

    def verdict(**truth: float) -> str:
        model, fitted, _ = LinearCampaign((*known, number("h")), truth, (effect("h"),)).made()
        base = Refitted(fitted.refit(Hypothesis(), model.stated))
        assert sum(pull**2 for pull in pulls(model, base.explanation).values()) > 10.0
        return conclude(model, Found(base, (base,), stated_fits(model, fitted))).verdict

    assert verdict() == NO_MISMATCH
    assert verdict(n0=9.0) == AT_ODDS


def test_known_numbers_explain_within_their_uncertainties_and_only_what_they_do() -> None:
    campaign = LinearCampaign((number("a", 10.0), number("b", 2.0), number("h")), {"a": 15.0}, (effect("h"),))
    model, fitted, _ = campaign.made()
    base, stated = Refitted(fitted.refit(Hypothesis(), model.stated)), stated_fits(model, fitted)
    assert unexplained_as_stated(model, stated, Criteria()) == ["state 0", "state 1"]
    assert conclude(model, Found(base, (base,), stated)).verdict == EXPLAINED
    # One state alone is left by what no known number does.
    own = replace(campaign, truth={"a": 15.0, "h": 12.0}, parameters=(
        *campaign.parameters[:2], number("h", recordings=("state 1",))))
    model, fitted, _ = own.made()
    base = Refitted(fitted.refit(Hypothesis(), model.stated))
    decision = conclude(model, Found(base, (base,), stated_fits(model, fitted)))
    assert (decision.verdict, decision.chosen.leaves) == (UNEXPLAINED, ("state 1",))


# --------------------------------------------------------------------------------------------------------------------
# Estimates and priors


def test_pulls_have_unit_variance_over_draws_of_devices() -> None:
    """Of numbers that the data tell well, as well as the prior, and hardly. Of 4000 draws a variance is right to 2.2 %.
    """
    random = np.random.default_rng(3)
    tangents, prior = random.standard_normal((40, 3)) / np.sqrt(40.0) * [5.0, 1.0, 0.2], np.array([1.0, 1.0, 1.0])
    found = made_explanation(made_problem(np.zeros(40), tangents, 1.0 / prior), np.zeros(3))
    covariance = np.linalg.inv(tangents.T @ tangents + np.eye(3))
    truths = random.standard_normal((4000, 3)) * prior
    data = truths @ tangents.T + random.standard_normal((4000, 40))
    estimates = data @ tangents @ covariance
    drawn = np.array([[replace(found, likeliest=x).pull(i, number("n", 1.0)) for i in range(3)] for x in estimates])
    assert np.mean(drawn**2, axis=0) == pytest.approx(np.ones(3), rel=0.08)
    # Nothing is said of one that the data tell nothing of.
    unseen = made_explanation(made_problem(np.zeros(40), 1e-3 * tangents, 1.0 / prior), np.full(3, 5.0))
    assert unseen.pull(0, number("n", 1.0)) == 0.0


def test_correlated_constants_are_so_in_search_evidence_and_scores() -> None:
    """Two constants that a fit left correlated by 0.9."""
    correlation = np.array([[1.0, 0.9], [0.9, 1.0]])
    prior = np.outer([1.0, 2.0], [1.0, 2.0]) * correlation
    campaign = LinearCampaign(EVERY[:3], {"a": 1.0, "h": 9.0}, EFFECTS[:1], correlations={("a", "b"): 0.9},
                              points=(40,))
    model, fitted, _ = campaign.made()
    here = tangents_at(fitted, model.stated)
    own, residual = here.jacobian[:, :2], here.residual
    # The search, with the stated noise.
    search = fitted.search(Hypothesis())
    end = search.minimise(model.stated, fitted.point_deviations(), tolerance=1e-9)
    hessian = own.T @ own + np.linalg.inv(prior)
    assert end.x[:2] == pytest.approx(np.linalg.solve(hessian, -own.T @ residual), rel=1e-5)
    # The evidence, over that of white noise of unit size at zero.
    found, whole = fitted.explanation(Hypothesis(), end.x), np.eye(80) + own @ prior @ own.T
    density = multivariate_normal.logpdf(residual, cov=whole) + 40.0 * math.log(2.0 * math.pi)
    assert found.log_evidence == pytest.approx(density, abs=1e-6)
    # The score: the fall of chi-square of the generalised least squares.
    score, = ranked_beside(model, tangents_at(fitted, end.x), found)
    column = np.linalg.solve(whole, here.jacobian[:, 2])
    slope, curvature = column @ residual, column @ here.jacobian[:, 2]
    assert score.amplitude[0] == pytest.approx(-slope / curvature, rel=1e-6)
    assert score.error[0] == pytest.approx(curvature**-0.5, rel=1e-6)


# --------------------------------------------------------------------------------------------------------------------
# Scores


def refitted(fitted: Likelihood, base: Explanation, *effects: Effect) -> float:
    """The log evidence that effects bring, by the weights of the explanation without."""
    found = fitted.refit(Hypothesis((*base.hypothesis.effects, *effects)), base.x)
    return found.weighted(base.weighting).log_evidence - base.log_evidence


@pytest.mark.parametrize("size", [0.0, 5.0, 12.0])
def test_a_refit_brings_what_a_score_promised(size: float) -> None:
    """Of the likeliest noise scales a score knows the largest likelihood, and an evidence the mean: 0.7 for each of two
    recordings; amplitudes by other weights of the points make a few hundredths of the rest."""
    model, fitted, _ = LinearCampaign(EVERY, {"a": 0.5, "h": size}, EFFECTS).made()
    base = fitted.refit(Hypothesis(), model.stated)
    scores = ranked_beside(model, tangents_at(fitted, base.likeliest), base)
    assert (scores[0].effect is EFFECTS[0]) == bool(size)
    for score in scores:
        margin = 1.6 + 0.05 * abs(score.evidence)
        assert refitted(fitted, base, score.effect) == pytest.approx(score.evidence, abs=margin)


def test_nothing_is_promised_beside_an_explanation_that_took_all() -> None:
    """Neither because the tangents there are of another mesh, nor because a prior is far that the explanation released
    (a lid five per cent thinner)."""
    thinner = effect("thinner", freed=("b",))
    campaign = LinearCampaign(EVERY, {"a": 2.0, "b": 80.0}, (thinner, *EFFECTS), size={"a": 40.0, "b": 20.0, "h": 20.0},
                              alike={"h": "b"})
    model, fitted, _ = campaign.made()
    found = fitted.refit(Hypothesis((thinner,)), model.stated)
    here = tangents_at(fitted, found.likeliest)
    scores = ranked_beside(model, here, found)
    assert [each.effect.name for each in scores if each.evidence > 0.0] == []
    for score in scores:
        assert refitted(fitted, found, score.effect) == pytest.approx(score.evidence, abs=1.6)
    # A mesh on which tangents of the numbers are one per cent off, and so is what they explain.
    off = 0.01 * np.random.default_rng(1).standard_normal((here.residual.size, 2)) * here.jacobian[:, :2]
    other = Tangents(here.x, np.column_stack([here.jacobian[:, :2] + off, here.jacobian[:, 2:]]),
                     here.residual + off @ here.x[:2])
    again = {each.effect.name: each.evidence for each in ranked_beside(model, other, found)}
    assert again == pytest.approx({each.effect.name: each.evidence for each in scores}, abs=1e-9)


def test_a_null_hypothesis_without_further_starts_keeps_its_optimum() -> None:
    """One that fits only from the last starts, and does not explain the recordings, ends no search."""
    model, *_ = LinearCampaign(EVERY, {"h": 60.0}, EFFECTS, alike=ALIKE).made()
    search, null = DiagnosisSearch(model), SimpleNamespace(fits=True)
    base = SimpleNamespace(hypothesis=Hypothesis())
    vars(search)["further_starts"] = iter(())
    vars(search)["is_explained"] = lambda _: False
    assert search.null_elsewhere(base, [], null) == (base, null)  # type: ignore[arg-type]


def test_collinear_effects_are_one_group_and_none_of_them_is_capped() -> None:
    model, fitted, _ = LinearCampaign(EVERY, {"h": 9.0}, EFFECTS, alike=ALIKE).made()
    base = fitted.refit(Hypothesis(), model.stated)
    scores = ranked_beside(model, tangents_at(fitted, base.likeliest), base)
    assert [sorted(each.effect.name for each in group) for group in groups_of(scores)] == [["h", "q", "r"], ["k"]]
    search = DiagnosisSearch(model)

    def promised(*worths: float) -> int:
        none = np.zeros(1)
        return len(search.promising([Score(EFFECTS[0], worth, worth, none, none) for worth in worths]))

    assert promised(*(60.0 - 0.9 * WITHIN / 8.0 * k for k in range(9)), 60.0 - 1.1 * WITHIN) == 9
    # Of scores so large that they are no predictions, the first three are looked at in any case.
    assert promised(600.0, 300.0, 200.0, 190.0) == 3


@pytest.mark.parametrize("size", [0.0, 6.0, 60.0])
def test_no_score_promises_more_than_an_explanation_to_the_noise_would_bring(size: float) -> None:
    """ln of the noise scale for each datum, and nearly all of it where one effect is all that is missing."""
    model, fitted, _ = LinearCampaign(EVERY, {"h": size}, EFFECTS, alike=ALIKE).made()
    base = fitted.refit(Hypothesis(), model.stated)
    best = max(each.evidence for each in ranked_beside(model, tangents_at(fitted, base.likeliest), base))
    print(size, best, base.gain_of_full_explanation)
    assert best < base.gain_of_full_explanation + 1.0
    assert best > 0.8 * base.gain_of_full_explanation - 10.0


# --------------------------------------------------------------------------------------------------------------------
# Ends of loops


def test_a_loop_that_ends_at_its_limit_is_named() -> None:
    campaign = LinearCampaign(KNOWN, {"a": 1.0}, bent=0.2, points=(40,))
    model, fitted, _ = campaign.made()
    start = np.array([5.0, 0.0])
    assert fitted.refit(Hypothesis(), model.stated).unconverged == ()
    short = fitted.refit(Hypothesis(), start, limit=1)
    assert [each.split(":")[0] for each in short.unconverged] == ["the weights of least squares", "least squares"]
    assert short.not_converged("least squares").not_converged("another").unconverged[-1] == "another"
