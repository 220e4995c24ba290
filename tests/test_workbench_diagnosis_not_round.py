"""A part beside the axis and a taper in a diagnosis: their orders, the search for them, and their words."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from concealed.feature_trial import ATTACHED_MASS, make_feature_trial

from workbench.campaign.campaign import read_campaign
from workbench.diagnosis import appraisal, not_round
from workbench.diagnosis.device import device_model
from workbench.diagnosis.local_models import LocalModels
from workbench.diagnosis.not_round import (
    NULL,
    Joint,
    PartFound,
    TaperFound,
    Without,
    can_be_located,
    located,
    robust,
)
from workbench.diagnosis.odds import Criteria
from workbench.fem.operators import assemble
from workbench.fem.patch import Patch
from workbench.fem.solve import solve_full
from workbench.jobs.progress import no_progress
from workbench.simulation.features import (
    OrdersNotConverged,
    RigidPart,
    charge_change,
    compliance_of,
    driven_displacements,
)

PART = PartFound(50.0, 20.0, 31.0, 1.02, 128, 1.5e-3, 2e-6, 1e-3, 0.0)
MASS = 2e-6


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, float]]:
    """A bare disc with a mass, and its truth."""
    folder = tmp_path_factory.mktemp("part") / "0001"
    truth = make_feature_trial(1004, (ATTACHED_MASS,), folder)
    return folder / "campaign.toml", truth.effects[0].parameters


@pytest.fixture(scope="module")
def joint(trial: tuple[Path, dict[str, float]]) -> tuple[Joint, Any]:
    """A fit of three places on the disc of the trial, and its known parameters without a part."""
    models = LocalModels(device_model(read_campaign(trial[0])))
    model = models.model
    likelihood = models.near(NULL, model.stated, np.array([each.prior or 0.0 for each in model.parameters]))
    x, _ = robust(likelihood, model.stated)
    return Joint.of(model, likelihood, x, np.array([1.5e-3, 1.6e-3, 1.7e-3]), 0.0), x


def test_orders_by_modes_are_the_change_by_a_part(joint: tuple[Joint, Any]) -> None:
    """Against the orders of `simulation.features`, which are solved at every frequency."""
    fit, x = joint
    state = fit.orders[0]
    assert isinstance(state, not_round._StateOrders)
    posed, frequency = state.modes.model.problem, state.modes.model.frequencies[::20]
    part = RigidPart(Patch("transducer", True, 1.6e-3, 0.5e-3), mass=MASS)
    operators = assemble(posed.mesh, posed.terms)
    solved = solve_full(operators, frequency, posed.values)
    between = compliance_of(posed, [part.patch], np.zeros(1), frequency)
    change = charge_change([part], frequency, driven_displacements(operators, [part], solved.states), between.total)
    expected = np.conj(-np.log1p(change / solved.charge))
    found = state.change(fit.model, x, np.array([math.log(MASS), 0.0, 0.0, 1.0]), np.zeros(0, dtype=int))[0][::20]
    off = np.abs(found - expected).max() / np.abs(expected).max()
    print(f"change of ln Z up to {np.abs(expected).max():.2f}, off by {off:.2%} of it")
    # Each compliance is good for 5e-3, and modes of the loaded disc amplify that.
    assert np.abs(expected).max() > 0.1
    assert off < 0.02


def test_derivatives_of_a_fit_are_those_of_differences(joint: tuple[Joint, Any]) -> None:
    fit, x = joint
    search = fit.likelihood.search(NULL)
    z = np.array([math.log(MASS), 0.1, 0.2, 0.9])
    slopes = fit.residuals(search, x, z)[0][1]
    at, scale = np.concatenate([x[search.free], z]), np.concatenate([search.scale[search.free], [0.3, 1.0, 1.0, 1.0]])
    for i in range(at.size):
        residuals = []
        for sign in (1.0, -1.0):
            moved = at.copy()
            moved[i] += sign * 1e-3 * scale[i]
            residuals.append(fit.residuals(search, *not_round._split(x, search.free, moved))[0][0])
        by_difference = (residuals[0] - residuals[1]) / (2e-3 * scale[i])
        # The difference quotients of both are good for the square of their steps.
        assert np.abs(slopes[:, i] - by_difference).max() <= 1e-3 * np.abs(by_difference).max()


def test_derivatives_with_a_taper_are_those_of_differences(joint: tuple[Joint, Any]) -> None:
    fit, x = joint
    own = Joint.of_taper(fit.model, fit.likelihood, x)
    search, z = fit.likelihood.search(NULL), np.array([0.004])
    slopes = own.residuals(search, x, z)[0][1]
    at, scale = np.concatenate([x[search.free], z]), np.concatenate([search.scale[search.free], [1e-3]])
    for i in range(at.size):
        step = 1e-3 * scale * (np.arange(at.size) == i)
        above, below = (own.residuals(search, *not_round._split(x, search.free, at + sign * step))[0][0]
                        for sign in (1.0, -1.0))
        by_difference = (above - below) / (2e-3 * scale[i])
        # The difference quotients of both are good for the square of their steps.
        assert np.abs(slopes[:, i] - by_difference).max() <= 1e-3 * np.abs(by_difference).max()


@pytest.mark.slow
def test_a_part_is_found_at_its_place(trial: tuple[Path, dict[str, float]], monkeypatch: pytest.MonkeyPatch) -> None:
    """A coarse grid is enough where a part is strong but not heavy."""
    monkeypatch.setattr(not_round, "DISTANCES", 8)
    monkeypatch.setattr(not_round, "CONTINUED", ((4, 2, False), (1, 8, True)))
    monkeypatch.setattr(not_round, "PROJECTED", 1)
    model = device_model(read_campaign(trial[0]))
    assert can_be_located(model)
    found = located(Without.of(LocalModels(model), model.stated))
    assert found.distance == pytest.approx(trial[1]["distance"], rel=0.02)
    assert found.mass == pytest.approx(trial[1]["mass"], rel=0.25)
    assert found.is_accepted(Criteria(), 1.2)


@pytest.mark.parametrize(("gain", "projected"), [(1.0, 0), (100.0, 2)])
def test_a_search_ends_early_if_no_place_is_evident(
    trial: tuple[Path, dict[str, float]], monkeypatch: pytest.MonkeyPatch, gain: float, projected: int
) -> None:
    models, went_on, costs = LocalModels(device_model(read_campaign(trial[0]))), list[object](), list[float]()
    places = iter(range(10**6))

    def optimum(x: Any, z: Any, *_: object, **__: object) -> not_round._End:
        return not_round._End(x, np.array([*z[:3], float(next(places))]), costs[0] - gain, 1.0)

    def known(*given: Any) -> Any:
        costs.append(robust(*given)[1])
        return robust(*given)

    def projected_there(*given: Any) -> Any:
        went_on.append(given)
        return given[2], given[3]

    monkeypatch.setattr(not_round, "robust", known)
    monkeypatch.setattr(not_round, "Joint", SimpleNamespace(of=lambda *_: SimpleNamespace(optimum=optimum)))
    monkeypatch.setattr(not_round, "_gain_held_out", lambda *_: 0.0)
    monkeypatch.setattr(not_round, "_projected", projected_there)
    assert located(Without.of(models, models.model.stated)).gain == pytest.approx(gain)
    assert len(went_on) == projected


@pytest.mark.parametrize(("changed", "is_accepted"), [
    ({}, True),
    ({"after": 1.5}, True),
    ({"after": 4.0}, False),
    ({"gain": 7.0}, False),
    ({"held_out": -0.1}, False),
])
def test_a_part_is_named_by_its_odds_its_residual_and_the_states_held_out(
    changed: dict[str, float], is_accepted: bool
) -> None:
    assert replace(PART, **changed).is_accepted(Criteria(), 1.2) is is_accepted


def test_a_part_is_the_headline_only_if_it_is_named() -> None:
    assert "2 mg on the transducer, 1.50 mm from its axis and 1.00 mm wide, explains 99.9 % of the res" in PART.in_words
    assert "too little to name it" in PART.finding
    assert "31 to 1.02" in replace(PART, named=True).finding


def test_a_search_that_fails_is_not_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> PartFound:
        raise OrdersNotConverged("too many orders matter")

    taper = TaperFound(50.0, 20.0, 31.0, 2.0, 4, 20e-6)
    monkeypatch.setattr(appraisal, "located", fails)
    monkeypatch.setattr(appraisal, "Without", SimpleNamespace(of=lambda *_: object()))
    monkeypatch.setattr(appraisal, "tapered", lambda *_: taper)
    monkeypatch.setattr(appraisal, "replace", lambda old, **new: SimpleNamespace(**{**vars(old), **new}))
    null = SimpleNamespace(hypothesis=NULL, explanation=SimpleNamespace(x=np.zeros(1)))
    diagnosis: Any = SimpleNamespace(
        found=SimpleNamespace(not_tried=(), final=[null]), campaign=SimpleNamespace(
            fitted=[SimpleNamespace(data=1.0, noise=np.full(200, 1e-3))]), criteria=Criteria(most=1.0), decision=None)
    ended: Any = appraisal.with_cause_not_round(diagnosis, LocalModels.__new__(LocalModels), no_progress)
    assert ended.not_round == (taper,)
    assert ended.found.not_tried[0].reason == "too many orders matter"
