"""Effects of any size: a strong one leaves least in its own size, though nothing near explains the recordings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from own_recordings import DISC, DISC_RECORDED, conceal

from workbench.diagnosis.device import device_model
from workbench.diagnosis.findings import InitialOptimum
from workbench.diagnosis.inference import DiagnosisSearch
from workbench.diagnosis.levels import LEVELS
from workbench.diagnosis.likelihood import Hypothesis
from workbench.diagnosis.profile_scan import (
    HALVINGS,
    MODELLED,
    SCAN_POINTS,
    SIZES,
    _is_local_optimum,
    _lowest,
    corners,
    scan_profiles,
    search_directions,
)
from workbench.diagnosis.ranking import ranked_at_level

Real = NDArray[np.float64]

FREQUENCIES = np.linspace(0.9e6, 1.1e6, 81)

CAMPAIGN = DISC_RECORDED + """
[known]
"pzt/trial.c33" = "0.5 %"
"pzt/trial.eps33" = "1 %"
"""

WIDTH = "bare rim.width"


def searched(folder: Path, values: Mapping[str, float]) -> DiagnosisSearch:
    """A search on a disc that was recorded with other values."""
    campaign, _ = conceal(folder, {"disc.toml": DISC, "campaign.toml": CAMPAIGN}, FREQUENCIES, values, accuracy=5e-4)
    return DiagnosisSearch(device_model(campaign))


def test_a_strong_effect_leaves_least_of_all_and_in_its_own_size(tmp_path: Path) -> None:
    """A fifth of the radius without an electrode."""
    search = searched(tmp_path, {WIDTH: 0.2})
    found = {each.name: search.scan_effect(each.name, "disc") for each in search.model.effects}
    ordered = sorted((name for name, places in found.items() if places), key=lambda name: found[name][0].cost)
    best = found["electrode that ends before the rim"]
    print([(name, round(found[name][0].cost, 1)) for name in ordered[:3]])
    assert ordered[0] == "electrode that ends before the rim"
    index = search.model.index(WIDTH)
    # The distance of the coarse sizes about it, halved so many times.
    step = (SIZES[4] - SIZES[3]) * search.model.parameters[index].high / 2**HALVINGS
    assert abs(best[0].x[index] - 0.2) <= step
    assert [each.cost for each in best] == sorted(each.cost for each in best)
    # No tangent at nothing asks for that much.
    scores = ranked_at_level(search.model, search.tangents(search.models.prior.x), search.model.campaign.fitted,
                             LEVELS[0])
    (score,) = (each for each in scores if each.effect.name == ordered[0])
    print("score", score.amplitude)
    assert abs(score.amplitude[0] - 0.2) > 0.1


def test_a_basin_is_found_behind_another_one_that_costs_less_on_the_coarse_sizes() -> None:
    """As of a film that carries waves: an optimum near nothing, and a better one between two coarse sizes."""
    def tried(size: float) -> InitialOptimum:
        basin = 30.0 - 25.0 * np.exp(-0.5 * ((size - 0.17) / 0.0425) ** 2)
        return InitialOptimum(np.array([size]), float(min(12.0 + 400.0 * size, basin)), np.zeros(1))

    profile = {size: tried(size) for size in SIZES}
    assert min(profile, key=lambda size: profile[size].cost) == SIZES[0]
    assert [size for size in SIZES if _is_local_optimum(profile, size)] == [0.1]
    best = _lowest(profile, 0.1, tried)
    assert abs(best.x[0] - 0.17) <= (SIZES[3] - SIZES[2]) / 2**HALVINGS
    assert best.cost < profile[SIZES[0]].cost


def test_known_numbers_make_up_for_what_they_can_to_first_order(tmp_path: Path) -> None:
    """The cost of a size is the least that the linear data leave, with what is known of the numbers."""
    search = searched(tmp_path, {WIDTH: 0.1})
    own = search.model.effect("electrode that ends before the rim")
    at = search.models.prior.x
    likelihood = search.models.towards(Hypothesis((own,)), corners(search.model, own, at))
    best = scan_profiles(likelihood, own, at)[0]
    problem = likelihood.search(Hypothesis((own,)))
    here = problem.evaluate(best.x, likelihood.point_deviations(LEVELS[0]))
    free = [i for i in problem.free if search.model.parameters[i].name != WIDTH]
    step = np.linalg.lstsq(here.jacobian[:, free], -here.vector, rcond=None)[0]
    least = 0.5 * float(np.sum((here.vector + here.jacobian[:, free] @ step) ** 2))
    # There on every point, in the search on every second one.
    every = likelihood.objective.recordings[0].step(SCAN_POINTS)
    assert best.cost * every == pytest.approx(least, rel=0.1)
    assert best.cost * every < 0.5 * float(here.vector @ here.vector)


def test_the_ways_go_to_all_that_each_number_may_be_and_to_all_at_once(tmp_path: Path) -> None:
    search = searched(tmp_path, {})
    device, own = search.model, search.model.effect("complex piezoelectric constant")
    indices = [device.index(name) for name in own.names]
    low, high = device.bounds(indices)
    start = device.stated[indices]
    found = list(search_directions(device, own))
    assert np.allclose(found, [(bound - start) * which for bound in (low, high) for which in ([1, 0], [0, 1], [1, 1])])
    assert np.abs(found).max(axis=1).min() > 0.0
    x = device.stated
    expected = [size * way for way in found for size in MODELLED]
    # Inside of what is admissible by some millionths of the range.
    np.testing.assert_allclose([place[indices] - start for place in corners(device, own, x)], expected, rtol=1e-3)
    assert min(SIZES) > 0.0
    assert max(SIZES) < 1.0
