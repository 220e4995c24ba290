"""Where known numbers are believed to be: against the closed form of linear data, and what bends."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.diagnosis.gaussian_prior import CURVED, GaussianPrior, multimodal
from workbench.search.constrained import Minimum
from workbench.search.continuation import ContinuationStage

Real = NDArray[np.float64]

#: Standard deviations of three known numbers beforehand; a fourth number is a hypothesis' own.
PRIOR = np.array([0.5, 2.0, 1.0])
#: The first two are correlated.
CORRELATION = np.array([[1.0, 0.8, 0.0, 0.0], [0.8, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
COVARIANCE = np.outer(PRIOR, PRIOR) * CORRELATION[:3, :3]
START = np.array([1.0, -3.0, 4.0, 0.0])
TANGENTS = np.random.default_rng(1).standard_normal((12, 4)) * np.array([3.0, 2.0, 0.01, 5.0])
SEEN = np.random.default_rng(2).standard_normal(12)


def numbers(bench: int = -1) -> Any:
    """A model of three known numbers and one more; that of the index `bench` is one of the bench."""
    parameters = [SimpleNamespace(name=f"n{i}", start=START[i], prior=prior, is_bench=i == bench)
                  for i, prior in enumerate([*PRIOR, None])]
    return SimpleNamespace(parameters=parameters, known=3, correlation=CORRELATION,
                           bounds=lambda _indices: (START[:3] - 50.0, START[:3] + 50.0))


class Linear:
    """Data that are linear in the numbers, but for squares of some of them; the optimum is that of the linear part."""

    def __init__(self, model: Any, squares: Real | None = None) -> None:
        self.model, self.squares = model, np.zeros(4) if squares is None else squares

    def point_deviations(self, _level: float) -> list[float]:
        return [1.0]

    def search(self, _hypothesis: object) -> None:
        return None

    def solve(self, _search: None, _stage: ContinuationStage, _x: Real) -> Any:
        precision = np.linalg.inv(COVARIANCE)
        own = TANGENTS[:, :3]
        move = np.linalg.solve(own.T @ own + precision, -own.T @ SEEN)
        return Minimum[Any](START + np.append(move, 0.0), None, 1.0, True, 1, "", ())

    def objective(self, x: Real, **_options: object) -> Any:
        off = x - START
        return SimpleNamespace(vector=SEEN + TANGENTS @ off + np.outer(np.ones(12), off**2) @ self.squares,
                               jacobian=TANGENTS)


def test_the_belief_is_the_posterior_of_linear_data() -> None:
    prior = GaussianPrior.prior(numbers())
    found = prior.updated(Linear(numbers()))  # type: ignore[arg-type]
    own = TANGENTS[:, :3]
    covariance = np.linalg.inv(own.T @ own + np.linalg.inv(COVARIANCE))
    assert found.root @ found.root.T == pytest.approx(covariance, rel=1e-9)
    assert found.x[:3] == pytest.approx(START[:3] - covariance @ own.T @ SEEN, rel=1e-9)
    assert found.x[3] == START[3]
    # What the data say nothing of is believed as before.
    assert found.deviations[2] == pytest.approx(PRIOR[2], rel=1e-2)
    assert (found.deviations[:2] < 0.5 * PRIOR[:2]).all()


def test_draws_come_with_their_opposites_and_have_that_covariance() -> None:
    prior = GaussianPrior.prior(numbers())
    places = np.array(prior.draws(4000, 0))
    assert places[0::2] + places[1::2] == pytest.approx(np.broadcast_to(2.0 * START, (4000, 4)))
    # Of 4000 pairs a variance is right to 2.2 %.
    assert np.cov(places[:, :3].T) / np.outer(PRIOR, PRIOR) == pytest.approx(CORRELATION[:3, :3], abs=0.08)
    assert (places[:, 3] == START[3]).all()


def test_a_place_is_never_beyond_what_is_admissible() -> None:
    low, high = START[:3] - 0.1, START[:3] + 0.1
    near = GaussianPrior(START, np.diag(PRIOR), low, high)
    assert all((place[:3] > low).all() and (place[:3] < high).all() for place in near.profile_points(1, (-3.0, 3.0)))
    assert near.profile_points(1, (0.01,))[0] == pytest.approx(START + np.array([0.0, 0.02, 0.0, 0.0]))


def test_what_bends_the_data_along_its_profile_is_multimodal() -> None:
    """By the square of what they move, in each of 12 data; numbers of the bench are never asked."""
    alone = GaussianPrior(START, np.diag([0.0, 30.0, 0.0]), START[:3] - 500.0, START[:3] + 500.0)
    bent = np.array([0.0, 2.0 * CURVED / (30.0**2 * np.sqrt(12.0)), 0.0, 0.0])

    def found(squares: Real, bench: int = -1, prior: GaussianPrior = alone) -> list[int]:
        return multimodal(Linear(numbers(bench), squares), prior)  # type: ignore[arg-type]

    assert found(bent) == [1]
    assert found(0.4 * bent) == found(bent, bench=1) == found(np.zeros(4)) == []
    # What the data see less of than they could bend by is not asked either.
    assert found(1e9 * bent, prior=GaussianPrior(START, 1e-3 * alone.root, alone.low, alone.high)) == []
