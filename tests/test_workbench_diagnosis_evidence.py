"""The evidence of a linearised problem against what it is an approximation of: averages over all parameters."""

from __future__ import annotations

import math
import pickle
import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from workbench.diagnosis.evidence import LinearisedProblem, WrongEvidence, checked, occam_factor, over_scales

Real = NDArray[np.float64]


def problem(below: float = 3.0, above: float = 5.0, slope: float = 1.0) -> tuple[LinearisedProblem, dict[str, Real]]:
    """One parameter with a prior of deviation 0.5, one anywhere between -below and above, and two deviations."""
    random = np.random.default_rng(4)
    tangents = random.standard_normal((30, 2)) * [1.0, slope]
    residual = random.standard_normal(30) + 0.4 * tangents[:, 0] - 0.3 * tangents[:, 1]
    deviations = random.standard_normal((30, 2))
    made = LinearisedProblem.of(tangents, residual, deviations, precision=np.diag([4.0, 0.0]),
                                offset=np.array([0.1, 0.0]),
                                widths=np.array([np.nan, below + above]), below=np.array([9.0, below]),
                                above=np.array([9.0, above]))
    return made, {"tangents": tangents, "residual": residual, "deviations": deviations}


def averaged_by_brute_force(data: dict[str, Real], scales: Real, below: float, above: float) -> float:
    """The same on a grid: ln of the likelihood averaged over the prior of one parameter and the range of the other.

    Relative to the normalisation of white noise of unit size, as :class:`LinearisedProblem` is.
    """
    covariance = np.eye(30) + data["deviations"] @ np.diag(scales**2) @ data["deviations"].T
    inverse, log_determinant = np.linalg.inv(covariance), np.linalg.slogdet(covariance)[1]
    # Steps from x; the first parameter's prior has its centre 0.1 below.
    first, second = np.linspace(-3.0, 3.0, 1201), np.linspace(-below, above, 4001)
    prior = -0.5 * (2.0 * (first + 0.1)) ** 2 + math.log(2.0 / math.sqrt(2.0 * math.pi))
    tangents = data["tangents"]
    gram, along = tangents.T @ inverse @ tangents, tangents.T @ inverse @ data["residual"]
    square = (data["residual"] @ inverse @ data["residual"] + 2.0 * (first[:, None] * along[0] + second * along[1])
              + gram[0, 0] * first[:, None] ** 2 + 2.0 * gram[0, 1] * first[:, None] * second + gram[1, 1] * second**2)
    weights = math.log(first[1] - first[0]) + math.log((second[1] - second[0]) / (below + above))
    return float(logsumexp(-0.5 * (square + log_determinant) + prior[:, None]) + weights)


@pytest.mark.parametrize("scales", [[0.0, 0.0], [0.3, 0.0], [1.0, 2.0]])
def test_a_linear_problem_is_averaged_exactly(scales: list[float]) -> None:
    made, data = problem()
    found = made.averaged(np.array(scales))
    # The range is many standard deviations to both sides: the grid alone is off, by less than 1e-4.
    assert found.log_evidence == pytest.approx(averaged_by_brute_force(data, np.array(scales), 3.0, 5.0), abs=1e-3)


def test_a_range_that_ends_at_the_optimum_is_cut_off_there() -> None:
    """The optimum lies beyond the bound, which is as close as ten thousandths."""
    made, data = problem(below=5.0, above=1e-4)
    step = made.averaged(np.zeros(2)).step
    assert step[1] == 1e-4  # it would be +0.3: held at the bound
    assert made.averaged(np.zeros(2)).log_evidence == pytest.approx(
        averaged_by_brute_force(data, np.zeros(2), 5.0, 1e-4), abs=0.02)


def test_a_parameter_that_the_data_do_not_see_costs_nothing() -> None:
    made, data = problem(slope=1e-3)
    assert made.averaged(np.zeros(2)).log_evidence == pytest.approx(
        averaged_by_brute_force(data, np.zeros(2), 3.0, 5.0), abs=0.05)


def test_scales_are_averaged_over_and_the_best_is_told() -> None:
    made, data = problem()
    settings = [np.array([scale, 0.0]) for scale in (0.01, 0.3, 10.0)]
    worth, best, average = over_scales(made, settings)
    each = [averaged_by_brute_force(data, setting, 3.0, 5.0) for setting in settings]
    assert worth == pytest.approx(float(logsumexp(each) - math.log(3.0)), abs=1e-3)
    assert best == int(np.argmax(each))
    assert average.log_evidence == pytest.approx(max(each), abs=1e-3)


def test_the_occam_factor_is_that_of_a_gaussian_in_a_box() -> None:
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    widths = np.array([10.0, 20.0])
    # The volume of the box over that of the posterior: 1 over its density's peak times the box.
    peak = multivariate_normal(cov=covariance).logpdf([0.0, 0.0])
    assert occam_factor(np.linalg.inv(covariance), widths) == pytest.approx(2.0 * (peak + math.log(200.0)), rel=1e-12)
    assert occam_factor(1e-6 * np.linalg.inv(covariance), widths) == 0.0


def by_brute_force(residual: Real, tangents: Real, priors: Real, size: Real | None = None) -> float:
    """ln of the likelihood of ten data each of two recordings, averaged over normal parameters (p, p), and over ln s_1
    and ln s_2 from 0 to ln 1000 unless their noise is of a given `size` (2,).

    Relative to white noise of unit size at zero.
    """
    logs = np.linspace(0.0, math.log(1e3), 161)
    every = np.log(size)[None] if size is not None else np.stack(np.meshgrid(logs, logs), axis=-1).reshape(-1, 2)
    covariance = tangents @ priors @ tangents.T + np.exp(2.0 * np.repeat(every, 10, axis=1))[:, :, None] * np.eye(20)
    squares = np.einsum("i,kij,j->k", residual, np.linalg.inv(covariance), residual)
    found = -0.5 * (squares + np.linalg.slogdet(covariance)[1])
    if size is not None:
        return float(found[0])
    ends = np.where((every == 0.0) | (every == logs[-1]), 0.5, 1.0).prod(axis=1)
    return float(logsumexp(found, b=ends) + 2.0 * math.log((logs[1] - logs[0]) / logs[-1]))


def test_noise_scales_are_integrated_out() -> None:
    """Of twenty data, where one hypothesis explains and the other leaves three times the noise, against brute force.

    The noise scale that the winner leaves is not that of both: with it, odds are many times too large.
    """
    random = np.random.default_rng(1)
    tangents = random.standard_normal((20, 2))
    residual = random.standard_normal(20) * np.repeat([1.5, 1.0], 10) - 3.0 * tangents[:, 1]
    recordings, found, exact, plugged = (slice(0, 10), slice(10, 20)), list[float](), list[float](), list[float]()
    likeliest = np.ones(3)
    # A range of 20 is a normal distribution that is as dense where the likelihood is.
    priors = np.diag([0.25, 1e6])
    dense = math.log(1e3 * math.sqrt(2.0 * math.pi) / 20.0)
    for count in (2, 1):
        own = LinearisedProblem.of(
            tangents[:, :count], residual, np.zeros((20, 0)), precision=np.diag([4.0, 0.0])[:count, :count],
            offset=np.zeros(count), widths=np.array([np.nan, 20.0])[:count], below=np.full(count, 10.0),
            above=np.full(count, 10.0), recordings=(*recordings, np.zeros(0, dtype=int)),
            counts=np.array([10.0, 10.0, 0.0]))
        average = own.averaged(np.zeros(0))
        likeliest = average.noise if count == 2 else likeliest
        plugged.append(own.at(np.zeros(0), likeliest).log_evidence)
        found.append(average.log_evidence)
        exact.append(by_brute_force(residual, tangents[:, :count], priors[:count, :count]) + (count - 1) * dense)
        # At fixed scales it is exact.
        assert plugged[-1] == pytest.approx(
            by_brute_force(residual, tangents[:, :count], priors[:count, :count], likeliest[:2]) + (count - 1) * dense,
            abs=1e-4)
    # The two recordings count as independent of each other, which leaves 0.02 here.
    assert found == pytest.approx(exact, abs=0.05)
    assert plugged[0] - plugged[1] > exact[0] - exact[1] + 3.0


def test_parameters_that_do_the_same_cost_one_range() -> None:
    """However exactly: a direction that no data tell is one of a range, not one that is known to nothing."""
    for off in (1e-4, 1e-9, 0.0):
        tangents = np.random.default_rng(0).standard_normal((30, 1)) @ np.array([[1.0, 1.0]])
        tangents[0, 1] += off
        own = LinearisedProblem.of(tangents, np.ones(30), np.zeros((30, 0)), precision=np.zeros((2, 2)),
                                   offset=np.zeros(2), widths=np.full(2, 100.0), below=np.full(2, 50.0),
                                   above=np.full(2, 50.0))
        # Where their sum is zero both are anywhere within their ranges.
        one = replace(own, grams=own.grams[:, [0, 2]][:, :, [0, 2]], precision=np.zeros((1, 1)), offset=np.zeros(1),
                      widths=np.full(1, 100.0), below=np.full(1, 50.0), above=np.full(1, 50.0))
        assert own.averaged(np.zeros(0)).log_evidence == pytest.approx(one.averaged(np.zeros(0)).log_evidence, abs=0.6)


def at_bounds(tangents: Real, residual: Real, below: float, above: float) -> LinearisedProblem:
    """Two parameters of ranges without a prior, and one of a wide prior that nothing sees."""
    own = np.column_stack([np.zeros(len(residual)), tangents])
    return LinearisedProblem.of(own, residual, np.zeros((len(residual), 0)), precision=np.diag([1.0, 0.0, 0.0]),
                                offset=np.zeros(3), widths=np.array([np.nan, *[below + above] * 2]),
                                below=np.array([9.0, below, below]), above=np.array([9.0, above, above]))


@pytest.mark.parametrize("seen", [1e-150, 1e-6, 1e-2, 1.0, 1e6])
def test_no_evidence_exceeds_the_likelihood_where_ends_of_ranges_hold_parameters(seen: float) -> None:
    """Two that do the same (an inductance, necks of ports), as far from the end as may be, against both exactly."""
    direction = seen * np.linspace(1.0, 2.0, 20)
    residual = -50.0 * np.linspace(1.0, 2.0, 20)
    found = at_bounds(np.column_stack([direction, direction * (1.0 + 1e-12)]), residual, 0.5, 0.5)
    average = found.averaged(np.zeros(0))
    both = np.linspace(-0.5, 0.5, 401)
    rows = (residual @ residual + 2.0 * (direction @ residual) * (both[:, None] + both)
            + direction @ direction * (both[:, None] + both) ** 2)
    exact = float(logsumexp(-0.5 * rows) - 2.0 * math.log(401.0))
    assert average.log_evidence <= -0.5 * average.chi_square + 1e-6 * residual @ residual
    if seen < 1.0:  # the grid is too coarse beyond
        assert average.log_evidence == pytest.approx(exact, abs=0.1)


def test_the_optimum_within_ranges_is_that_of_the_whole_problem() -> None:
    """One parameter at its end moves the optimum of the other: both together, by brute force."""
    random = np.random.default_rng(7)
    tangents = random.standard_normal((20, 2)) @ np.array([[1.0, 0.7], [0.0, 0.4]])
    residual = -(tangents @ [2.0, 0.3]) + 0.1 * random.standard_normal(20)
    average = at_bounds(tangents, residual, 1.0, 1.0).averaged(np.zeros(0))
    grid = np.linspace(-1.0, 1.0, 801)
    a, b = np.meshgrid(grid, grid, indexing="ij")
    costs = np.sum((residual[:, None] + tangents @ np.vstack([a.ravel(), b.ravel()])) ** 2, axis=0)
    best = int(np.argmin(costs))
    assert average.step[1:] == pytest.approx([a.ravel()[best], b.ravel()[best]], abs=0.003)
    assert average.chi_square == pytest.approx(costs[best], rel=1e-3)
    exact = float(logsumexp(-0.5 * costs) - math.log(costs.size))
    # The one that is free is no more than a deviation from its end: a Gaussian of it is cut off nowhere.
    assert average.log_evidence == pytest.approx(exact, abs=0.15)


@pytest.mark.parametrize(("evidence", "likelihood"), [(2.2e248, -312.0), (-311.0, -312.0), (math.nan, -1.0),
                                                      (math.inf, math.inf), (-1.0, math.nan), (-math.inf, -3.0)])
def test_an_evidence_that_is_none_never_ranks(evidence: float, likelihood: float) -> None:
    with pytest.raises(WrongEvidence, match=re.escape(f"{evidence:.6g}")) as caught:
        checked(evidence, likelihood)
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value)
    assert checked(-313.0, -312.0) == -313.0


def test_every_average_is_checked() -> None:
    """A problem that no data have: what is left of its squares is below nothing."""
    made, _ = problem()
    spoilt = made.grams.copy()
    spoilt[0, 2, 2] = -1e4
    with pytest.raises(WrongEvidence, match="is an error of this program"):
        replace(made, grams=spoilt).averaged(np.zeros(2))
