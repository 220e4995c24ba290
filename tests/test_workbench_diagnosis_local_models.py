"""The models that a search predicts with, against models made at the very point."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from own_recordings import DISC, DISC_RECORDED, any_recordings

from workbench.diagnosis.device import device_model
from workbench.diagnosis.levels import replaced
from workbench.diagnosis.likelihood import Hypothesis
from workbench.diagnosis.local_models import ROUGH, SEARCHED, LocalModels
from workbench.fem.operators import FullOperators

Real = NDArray[np.float64]

FREQUENCIES = np.linspace(0.9e6, 1.1e6, 41)

CAMPAIGN = DISC_RECORDED + """
[known]
"pzt/trial.c33" = "0.5 %"
"pzt/trial.eps33" = "1 %"
"""

LOAD, RIM = "load on the face of the transducer", "electrode that ends before the rim"


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> LocalModels:
    folder = tmp_path_factory.mktemp("disc")
    campaign = any_recordings(folder, {"disc.toml": DISC, "campaign.toml": CAMPAIGN}, FREQUENCIES)
    return LocalModels(device_model(campaign, accuracy=1e-3))


def test_a_search_is_on_coarse_meshes_unless_coarser_ones_are_asked_for(models: LocalModels) -> None:
    assert models.rough.accuracy == SEARCHED
    assert models.rough.effects == models.model.effects
    assert models.rough.fitted.predictors[0].every.size < models.model.fitted.predictors[0].every.size
    assert LocalModels(models.rough).rough is models.rough


@pytest.mark.parametrize(("name", "size", "serves"), [(LOAD, 1e5, True), (RIM, 0.1, False)])
def test_models_towards_a_hypothesis_are_right_where_it_is_led(
    models: LocalModels, name: str, size: float, serves: bool
) -> None:
    """On the bases of the null hypothesis where the mesh is one that these serve on."""
    effect = models.rough.effect(name)
    own = models.rough.of([effect])
    # Beside the bases of the null hypothesis, of which none fits where a rim has lines of nodes.
    assert (own.fitted.on_bases_of(models.over_prior.objective) is not None) == serves
    x = replaced(models.prior.x, [own.index(number) for number in effect.names], size)
    found = models.towards(Hypothesis((effect,)), [x]).impedances(x)[0]
    exact = own.fitted.near(x, {}, 1e-7, only=(), enriches=False).predict(x, 0, ())[0]
    assert np.abs(found / exact - 1.0).max() < 10.0 * ROUGH
    null = models.over_prior.impedances(models.prior.x)[0]
    assert np.abs(null / exact - 1.0).max() > 100.0 * ROUGH


@pytest.mark.parametrize("name", [LOAD, RIM])
def test_the_model_of_one_state_is_that_of_all(models: LocalModels, name: str) -> None:
    """Same parameters, same mesh, same spectrum: a scan of one state needs no model of the others."""
    effect = models.rough.effect(name)
    whole, alone = models.rough.of([effect]), models.rough.in_state([effect], "disc")
    assert [p.name for p in alone.parameters] == [p.name for p in whole.parameters]
    assert [r.name for r in alone.fitted.recordings] == ["disc"]
    x = replaced(models.prior.x, [whole.index(number) for number in effect.names], 0.1)
    one, other = (each.fitted.near(x, {}, 1e-7, only=(), enriches=False).predict(x, 0, ())[0]
                  for each in (whole, alone))
    np.testing.assert_allclose(one, other, rtol=1e-10)


def test_forms_that_two_models_share_are_projected_once(models: LocalModels, monkeypatch: pytest.MonkeyPatch) -> None:
    """A model with one more term projects the forms of that term alone, and predicts as if it had projected all."""
    effect = models.rough.effect(LOAD)
    own = models.rough.of([effect])
    base = models.over_prior.objective
    projected: list[int] = []
    project = FullOperators.project

    def counting(self: FullOperators, *given: Any) -> Any:
        projected.append(len(self.distinct_forms))
        return project(self, *given)

    monkeypatch.setattr(FullOperators, "project", counting)
    shared = own.fitted.on_bases_of(base)
    assert shared is not None
    every = len(own.fitted.predictors[0].every.distinct_forms)
    assert sum(projected) < 0.5 * every  # waves in the transducer do not act in the null hypothesis
    with monkeypatch.context() as patch:
        patch.setattr(FullOperators, "has_form_of", lambda self, other, form: False)
        anew = own.fitted.on_bases_of(base)
    assert anew is not None
    assert projected[-1] == every
    x = models.prior.x
    np.testing.assert_allclose(shared.predict(x, 0, ())[0], anew.predict(x, 0, ())[0], rtol=1e-9)
