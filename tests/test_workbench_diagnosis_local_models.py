"""The models that a search predicts with, against models made at the very point."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from own_recordings import DISC, DISC_RECORDED, any_recordings

from workbench.diagnosis.device import device_model
from workbench.diagnosis.levels import replaced
from workbench.diagnosis.likelihood import Hypothesis
from workbench.diagnosis.local_models import ROUGH, SEARCHED, LocalModels

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
