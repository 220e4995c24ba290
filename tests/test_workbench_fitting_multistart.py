"""Further starts of a fit, on a film with several optima of which the mesh of the search does not see the right one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.fitting.multistart import FitMultistart, Refined, listed_starts
from workbench.fitting.noise import Noise
from workbench.fitting.search import FitDescent

Real = NDArray[np.float64]

#: Thicknesses (m) of the film at which there is an optimum, and the noise that it leaves, as many times as is stated.
VALLEYS = {20e-6: 8.0, 23e-6: 4.0, 26.45e-6: 1.0}
FILM = SimpleNamespace(name="couplant.thickness", is_film=True, is_loss=False,
                       parsed=SimpleNamespace(coefficient="thickness"))


def optimum(x: Real, noise: float) -> Any:
    """An optimum at x (1,) that leaves so much noise."""
    residual = SimpleNamespace(data=SimpleNamespace(log_ratio=[np.full(3, 0.01 * noise + 0j)], rms=0.01 * noise))
    return FitDescent(x, residual, noise, True, 3, "", (), x, {0: noise}, True)  # type: ignore[arg-type]


class Search:
    """A search on a mesh that shows the first valley alone."""

    parameters, low, high, scale = (FILM,), np.array([1e-6]), np.array([1e-4]), np.array([20e-6])

    def inside(self, x: Real) -> Real:
        return x

    def descend(self, _x: Real, **_options: object) -> Any:
        return optimum(np.array([20e-6]), 8.0)

    def errors(self, _optimum: object) -> Real:
        return np.array([0.1e-6])


def refine(x: Real) -> Refined:
    """The nearest valley, on the requested mesh."""
    valley = min(VALLEYS, key=lambda each: abs(each - float(x[0])))
    ratio = VALLEYS[valley]
    noise = Noise(np.full(3, 0.01), ratio, 1.0 if ratio == 1.0 else 4.0)
    return Refined(optimum(np.array([valley]), ratio), (noise,))


@pytest.fixture
def further() -> FitMultistart:
    search: Any = Search()
    return FitMultistart(search, refine, search.descend(np.array([20e-6])), 32, lambda _text, _share: None)


def test_a_film_goes_on_from_valley_to_valley_on_the_mesh_asked_for(further: FitMultistart) -> None:
    further.run([])
    assert further.reached.descent is None
    assert further.refined.minimum.x == pytest.approx([26.45e-6])
    labels = [trial.start.label for trial in further.trials]
    # What helped is tried again first, and nothing once all is explained.
    assert labels[-1] == labels[-2] == "film couplant.thickness x 1.15, on the requested mesh"


def test_starts_are_judged_by_the_answer_even_where_the_mesh_of_the_search_did_not_lead_to_it(
    further: FitMultistart
) -> None:
    further.run([])
    search: Any = Search()
    listed = listed_starts(further.trials, further.reached, search, search)
    outcomes = {start.label: start.outcome for start in listed}
    elsewhere = "another optimum: couplant.thickness differs most"
    assert outcomes["film couplant.thickness x 1.15"] == elsewhere
    assert outcomes["film couplant.thickness x 1.15, on the requested mesh"] == "same optimum"
    assert [start.outcome for start in listed].count("same optimum") == 1


def test_without_tries_nothing_further_is_begun(further: FitMultistart) -> None:
    further.tries = 0
    further.run([])
    assert further.trials == []
    # Four thicknesses of the film on each mesh.
    assert further.untried == 8
    assert further.refined.minimum.x == pytest.approx([20e-6])


def test_an_interruption_keeps_the_best_end_so_far(further: FitMultistart, monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[float] = []

    def refined(x: Real) -> Refined:
        tried.append(float(x[0]))
        if len(tried) == 3:
            raise KeyboardInterrupt
        return refine(x)

    monkeypatch.setattr(further, "refine", refined)
    further.run([])
    assert further.interrupted
    assert tried[1] == pytest.approx(23e-6)
    assert further.refined.minimum.x == pytest.approx([23e-6])
    assert [trial.end is not None for trial in further.trials[-2:]] == [True, True]
    assert not further.refined.is_explained
