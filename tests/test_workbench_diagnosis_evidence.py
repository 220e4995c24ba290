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
    assert occam_factor(covariance, widths) == pytest.approx(2.0 * (peak + math.log(200.0)), rel=1e-12)
    assert occam_factor(1e6 * covariance, widths) == pytest.approx(0.0)


def test_what_a_block_adds_is_the_difference_of_two_averages() -> None:
    """At all sizes, each block alone; the range is so wide that its form does not matter."""
    made, _ = problem(below=3e4, above=5e4)
    for scales in ([0.0, 0.0], [0.7, 0.0]):
        without = made.averaged(np.array(scales)).log_evidence
        found = made.added(np.array(scales), [np.array([1])], np.array([0.5, 2.0]))
        assert found.shape == (1, 2)
        for size, added in zip((0.5, 2.0), found[0], strict=True):
            whole = made.averaged(np.array([scales[0], size])).log_evidence
            assert added == pytest.approx(whole - without, abs=1e-6)


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
    spoilt = made.gram.copy()
    spoilt[2, 2] = -1e4
    with pytest.raises(WrongEvidence, match="is an error of this program"):
        replace(made, gram=spoilt).averaged(np.zeros(2))
