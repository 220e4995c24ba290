"""Linearised problems with all their deviations: bounds that no evidence may pass, and covariances against draws."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_explanations import made_explanation, made_problem
from numpy.typing import NDArray
from scipy.linalg import block_diag

from workbench.diagnosis.findings import Alternative, Refitted
from workbench.diagnosis.likelihood import Explanation, Hypothesis
from workbench.diagnosis.local_problem import LocalProblem
from workbench.diagnosis.weighting import Weighting
from workbench.fitting.noise import Noise

Real = NDArray[np.float64]

#: Data of a made-up problem.
DATA = 30


def random_problem(seed: int) -> LocalProblem:
    """A problem of up to five parameters of very different size; some known, some at or near an end of their range.

    Those of odd seeds are of two recordings, each with a noise scale of its own.
    """
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 6))
    tangents = random.standard_normal((DATA, count)) * 10.0 ** random.uniform(-4.0, 4.0, count)
    if count > 2 and random.random() < 0.3:
        tangents[:, 1] = tangents[:, 0] * (1.0 + 1e-9 * random.standard_normal(DATA))
    precision = np.where(random.random(count) < 0.5, 10.0 ** random.uniform(-2.0, 2.0, count), 0.0)
    below, above = 10.0 ** random.uniform(-3.0, 3.0, (2, count))
    below[random.random(count) < 0.3] = 0.0
    return made_problem(
        random.standard_normal(DATA) * 10.0 ** random.uniform(-1.0, 2.0), tangents, precision,
        offset=np.where(precision > 0.0, random.standard_normal(count) / np.maximum(precision, 1e-9), 0.0),
        parts=random.standard_normal((DATA, int(random.integers(0, 4)))), inhomogeneities=(0.1, 1.0),
        outside=random.standard_normal((DATA, int(random.integers(0, 3)))), ranges=(below, above),
        information=random.uniform(0.05, 1.0, DATA), recordings=(slice(0, 12), slice(12, DATA)) if seed % 2 else ())


def with_idle(local: LocalProblem, precision: float, below: float, above: float) -> LocalProblem:
    """The problem with one more parameter, which moves nothing but what rounding makes it seem to, as the first does.
    """
    column = local.tangents[:, 0] / np.linalg.norm(local.tangents[:, 0]) * 1e-7 / (below + above)
    return replace(
        local, tangents=np.column_stack([local.tangents, column]), offset=np.append(local.offset, 0.0),
        prior_rows=block_diag(local.prior_rows, precision), below=np.append(local.below, below),
        above=np.append(local.above, above), widths=np.append(local.widths, np.nan if precision else below + above))


@pytest.mark.parametrize("seed", range(40))
def test_no_evidence_exceeds_the_likelihood_at_its_optimum(seed: int) -> None:
    local = random_problem(seed)
    worth, best, _ = local.best
    likelihoods = []
    for scales in local.settings:
        average = local.problem.averaged(local.expanded(scales))
        variances = np.repeat(average.noise**2, [12, DATA - 12, 0] if seed % 2 else [DATA]) / local.information
        deviations = local._beside * local.expanded(scales)
        covariance = np.diag(variances) + deviations @ deviations.T
        there = local.residual + local.tangents @ average.step
        pull = local.prior_rows @ (local.offset + average.step)
        # A noise scale is that of as many data as their information is worth.
        determinant = np.linalg.slogdet(covariance)[1] - np.log(variances).sum() + (
            2.0 * local.problem.counts @ np.log(average.noise))
        likelihoods.append(-0.5 * float(there @ np.linalg.solve(covariance, there) + pull @ pull + determinant))
        margin = 1e-6 * max(1.0, abs(likelihoods[-1]))
        assert np.isfinite(average.log_evidence)
        assert average.log_evidence <= likelihoods[-1] + margin
        ranged = np.diag(local.prior_rows) == 0.0
        assert (average.step >= -local.below * (1.0 + 1e-9) - 1e-12)[ranged].all()
        assert (average.step <= local.above * (1.0 + 1e-9) + 1e-12)[ranged].all()
    assert np.isfinite(worth)
    assert worth <= max(likelihoods) + 1e-6 * max(1.0, abs(max(likelihoods)))
    assert best in local.settings


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize(("precision", "below", "above"), [(3.0, 1e9, 1e9), (0.0, 2.0, 5.0), (0.0, 0.0, 1e4)])
def test_a_parameter_that_moves_nothing_changes_no_evidence(
    seed: int, precision: float, below: float, above: float
) -> None:
    local = random_problem(seed)
    worth = local.best[0]
    assert with_idle(local, precision, below, above).best[0] == pytest.approx(worth, rel=1e-9, abs=1e-6)


def uneven(*, least_squares: bool) -> Explanation:
    """One whose deviations beside the noise have a size, at the optimum with these or at that of least squares."""
    random = np.random.default_rng(2)
    tangents = random.standard_normal((DATA, 3)) * [1.0, 5.0, 0.2]
    parts = random.standard_normal((DATA, 4)) + 0.5 * tangents[:, :1]
    local = made_problem(random.standard_normal(DATA), tangents, np.array([0.5, 2.0, 0.0]), parts=parts,
                         inhomogeneities=(0.7,), information=random.uniform(0.2, 1.0, DATA))
    x = np.zeros(3)
    return made_explanation(local, x, likeliest=x + 1e-3 if least_squares else x)


@pytest.mark.parametrize("least_squares", [True, False])
def test_the_covariance_is_that_of_estimates_of_draws(least_squares: bool) -> None:
    """Of 2000: a variance is right to 3.2 %."""
    found, random = uneven(least_squares=least_squares), np.random.default_rng(3)
    local = found.local
    truth = random.standard_normal((2000, 3)) * [2.0, 0.5, 0.0]
    data = truth @ local.tangents.T + random.standard_normal((2000, DATA)) / np.sqrt(local.information)
    data = data + 0.7 * random.standard_normal((2000, 4)) @ local.parts.T
    inverse = np.diag(local.information) if least_squares else np.linalg.inv(
        np.diag(1.0 / local.information) + 0.7**2 * local.parts @ local.parts.T)
    hessian = local.tangents.T @ inverse @ local.tangents + local.prior_rows.T @ local.prior_rows
    estimates = np.linalg.solve(hessian, local.tangents.T @ inverse @ data.T).T
    drawn = np.cov((estimates - truth).T)
    size = np.sqrt(np.diag(drawn))
    assert np.abs((found.covariance - drawn) / np.outer(size, size)).max() < 0.1
    assert found.errors == pytest.approx(np.sqrt(np.diag(found.covariance)))


def test_an_alternative_beside_an_explanation_gains_what_it_was_said_to() -> None:
    random = np.random.default_rng(5)
    local = made_problem(3.0 * random.standard_normal(DATA), random.standard_normal((DATA, 2)), np.array([1.0, 0.3]),
                         parts=random.standard_normal((DATA, 2)), inhomogeneities=(0.1, 1.0))
    blocks = [random.standard_normal((DATA, count)) for count in (1, 3)]
    own = Refitted(made_explanation(local, np.zeros(2)))
    for columns, gained in zip(blocks, local.gained_by(blocks), strict=True):
        beside = own.beside(Alternative(Hypothesis(region="bond"), float(gained), columns))
        # Averaged over the inhomogeneity too, which is one size in all but a trace.
        gain = beside.explanation.log_evidence - own.explanation.log_evidence
        assert gain == pytest.approx(gained, abs=0.1)
        assert beside.hypothesis.is_outside


def test_weights_are_the_information_of_each_row() -> None:
    """Five neighbours to one: a fifth of the information, whatever it was before; the noise is integrated out."""
    state: Any = SimpleNamespace(name="disc", noise=np.full(DATA // 2, 0.01), observation=None)
    weighting = Weighting((state,), (Noise(state.noise, 2.0, 5.0),))
    local = random_problem(0)
    found = made_explanation(local, np.zeros(local.offset.size), states=(state,)).weighted(weighting)
    assert found.local.information == pytest.approx(np.full(DATA, 0.2))
    assert found.local.recordings == (slice(0, DATA),)
    assert found.weighting is weighting


@pytest.mark.parametrize("seed", range(10))
def test_the_remainder_is_what_joint_least_squares_leaves(seed: int) -> None:
    """Parameters and amplitudes of the deviations as unknowns together, each with its prior as a row."""
    local = replace(random_problem(seed), inhomogeneities=(0.3,))
    local = replace(local, cosines=np.random.default_rng(seed).standard_normal((DATA, 2)))
    _, scales, average = local.best
    root, deviations = local.root, local.deviations(scales)
    there = root * (local.residual + local.tangents @ average.step)
    amplitudes = np.linalg.solve(deviations.T @ deviations + np.eye(deviations.shape[1]), deviations.T @ there)
    expected = (there - deviations @ amplitudes) / root
    # Directions that deviate by less than 3 % of the noise are left out: a thousandth of what is left.
    assert np.abs(local.remainder - expected).max() < 2e-3 * np.abs(expected).max()
    assert np.abs(local.remainder - there / root).max() > 3e-3 * np.abs(expected).max()
