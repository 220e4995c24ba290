"""The constrained Gauss-Newton search against minima that can be written down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from workbench.search.constrained import Inequality, Minimum, interior, minimise

Real = NDArray[np.float64]

#: The last barrier weighs 1e-10 of the cost and an active condition is approached by the ratio of that to its
#: multiplier, which is of the order of the cost here; the search ends where a step promises less than 1e-6 of the cost
#: by default, 1e-12 in these tests: a distance of 1e-6 of numbers of the order of one.
ACTIVE = 1e-5


@dataclass(frozen=True, eq=False)
class Linear:
    """matrix @ x - target."""

    matrix: Real
    target: Real
    x: Real

    @property
    def vector(self) -> Real:
        return np.asarray(self.matrix @ self.x - self.target)

    @property
    def jacobian(self) -> Real:
        return self.matrix


@dataclass(frozen=True, eq=False)
class Given:
    """Residuals and their derivative as numbers."""

    vector: Real
    jacobian: Real


@dataclass
class Watched:
    """A function that remembers where it was asked."""

    function: Callable[[Real], Linear | Given]
    points: list[Real] = field(default_factory=list)

    def __call__(self, x: Real) -> Linear | Given:
        self.points.append(x.copy())
        return self.function(x)


def linear(matrix: Real, target: Real) -> Watched:
    return Watched(lambda x: Linear(matrix, target, x))


def rosenbrock(x: Real) -> Given:
    return Given(np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]), np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]]))


def search(
    function: Callable[[Real], Linear | Given], start: Real, *, reach: float = 100.0,
    inequalities: tuple[Inequality, ...] = (), radius: float = 1.0, limit: int = 100,
) -> Minimum[Any]:
    size = start.size
    return minimise(function, start, low=np.full(size, -reach), high=np.full(size, reach), scale=np.ones(size),
                    inequalities=inequalities, radius=radius, tolerance=1e-12, limit=limit)


def positive(count: int) -> Inequality:
    """The symmetric (count, count) matrix whose upper triangle is x has no negative eigenvalue."""
    rows, columns = np.triu_indices(count)
    slopes = np.zeros((rows.size, count, count))
    slopes[np.arange(rows.size), rows, columns] = slopes[np.arange(rows.size), columns, rows] = 1.0
    return Inequality("a positive matrix", np.zeros((count, count)), slopes)


#: [[1, x0], [x0, x1]] is positive semidefinite: x1 >= x0^2.
PARABOLA = Inequality("above the parabola", np.array([[1.0, 0.0], [0.0, 0.0]]),
                      np.array([[[0.0, 1.0], [1.0, 0.0]], [[0.0, 0.0], [0.0, 1.0]]]))


# --------------------------------------------------------------------------------------------------------------------
# Minima


@pytest.mark.parametrize("seed", range(5))
def test_without_conditions_the_minimum_solves_the_normal_equations(seed: int) -> None:
    random = np.random.default_rng(seed)
    matrix, target = random.standard_normal((9, 4)), random.standard_normal(9)
    found = search(linear(matrix, target), 3.0 * random.standard_normal(4))
    exact = np.linalg.solve(matrix.T @ matrix, matrix.T @ target)
    # The ridge of the step is 1e-12 of the mean curvature, times the condition of a random matrix.
    assert found.x == pytest.approx(exact, rel=1e-9, abs=1e-9)
    assert found.cost == pytest.approx(0.5 * np.sum((matrix @ exact - target) ** 2), rel=1e-12)
    assert found.converged
    # A linear problem takes a step for each threefold of the trust region, and one to see that it is done.
    assert found.iterations < 10


def test_an_active_bound_leaves_the_minimum_of_the_others() -> None:
    matrix, target = np.array([[2.0, 1.0], [1.0, 3.0], [0.0, 1.0]]), np.array([8.0, 4.0, 1.0])
    high = np.array([1.5, 10.0])
    assert np.linalg.lstsq(matrix, target, rcond=None)[0][0] > high[0]  # or the bound is not active
    found = minimise(linear(matrix, target), np.zeros(2), low=np.full(2, -10.0), high=high, scale=np.ones(2),
                     tolerance=1e-12)
    # With x0 held, x1 = b.(t - 1.5 a) / b.b of the columns a, b.
    left = target - high[0] * matrix[:, 0]
    assert found.x == pytest.approx([high[0], matrix[:, 1] @ left / (matrix[:, 1] @ matrix[:, 1])], abs=ACTIVE)
    assert found.x[0] < high[0]
    assert found.converged


@pytest.mark.parametrize("seed", range(10))
def test_bounded_problems_end_where_an_active_set_method_does(seed: int) -> None:
    random = np.random.default_rng(seed)
    matrix, target = random.standard_normal((8, 5)), 3.0 * random.standard_normal(8)
    low, high = -random.uniform(0.1, 0.6, 5), random.uniform(0.1, 0.6, 5)
    exact = lsq_linear(matrix, target, (low, high), tol=1e-14)
    found = minimise(linear(matrix, target), np.zeros(5), low=low, high=high, scale=np.ones(5), tolerance=1e-12)
    assert found.cost == pytest.approx(exact.cost, rel=1e-8)  # second order in the distance, but for the multiplier
    assert found.x == pytest.approx(exact.x, abs=10.0 * ACTIVE)
    assert found.converged


def test_a_matrix_inequality_is_followed_along_its_curved_boundary() -> None:
    # The point of y >= x^2 nearest to (3, 0): 2 x^3 + x - 3 = 0, that is (1, 1).
    found = search(linear(np.eye(2), np.array([3.0, 0.0])), np.array([0.0, 2.0]), inequalities=(PARABOLA,))
    assert found.x == pytest.approx([1.0, 1.0], abs=ACTIVE)
    assert found.cost == pytest.approx(2.5, rel=1e-6)
    assert found.converged
    assert PARABOLA.margin(found.x) > 0.0


# In the second line: where Newton's method from a point at the curved boundary follows that in vain.
@pytest.mark.parametrize(("count", "seed"), [(2, 0), (2, 1), (2, 2), (3, 3), (3, 4), (4, 5),
                                             (2, 3), (2, 12), (2, 108), (2, 201), (2, 279), (3, 268), (4, 59)])
def test_the_nearest_positive_matrix_has_the_positive_eigenvalues(count: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    wanted = random.standard_normal((count, count))
    wanted = wanted + wanted.T
    values, vectors = np.linalg.eigh(wanted)
    assert values[0] < 0.0  # or the inequality is not active
    exact = (vectors * np.maximum(values, 0.0)) @ vectors.T
    rows, columns = np.triu_indices(count)
    # Off the diagonal every entry counts twice in the Frobenius norm.
    weights = np.diag(np.where(rows == columns, 1.0, np.sqrt(2.0)))
    start = np.where(rows == columns, 1.0, 0.0)
    found = search(linear(weights, weights @ wanted[rows, columns]), start, inequalities=(positive(count),))
    assert found.x == pytest.approx(exact[rows, columns], abs=10.0 * ACTIVE)
    assert found.cost == pytest.approx(0.5 * np.sum(np.minimum(values, 0.0) ** 2), rel=1e-5)
    assert found.converged


def test_an_inequality_that_is_not_active_changes_nothing() -> None:
    inside = np.array([0.3, 1.7])
    found = search(linear(np.diag([2.0, 5.0]), np.diag([2.0, 5.0]) @ inside), np.array([0.0, 1.0]),
                   inequalities=(PARABOLA,))
    assert found.x == pytest.approx(inside, rel=1e-9)


def test_a_curved_valley_is_followed_to_its_end() -> None:
    found = search(rosenbrock, np.array([-1.2, 1.0]))
    assert found.x == pytest.approx([1.0, 1.0], rel=1e-5)
    assert found.converged
    assert found.cost < 1e-10


def test_the_scale_is_only_a_unit() -> None:
    # The same problem in units 1e10 and 1e-10, as stiffness and dimensions are.
    unit = np.array([1e10, 1e-10])
    matrix, target = np.array([[2.0, 1.0], [1.0, 3.0], [0.0, 1.0]]), np.array([8.0, 4.0, 1.0])
    one = minimise(linear(matrix, target), np.zeros(2), low=np.full(2, -10.0), high=np.array([1.5, 10.0]),
                   scale=np.ones(2), tolerance=1e-12)
    other = minimise(linear(matrix / unit, target), np.zeros(2), low=-10.0 * unit, high=np.array([1.5, 10.0]) * unit,
                     scale=unit, tolerance=1e-12)
    assert other.x / unit == pytest.approx(one.x, rel=1e-9)  # the same arithmetic but for rounding
    assert other.iterations == one.iterations


# --------------------------------------------------------------------------------------------------------------------
# The way there


@pytest.mark.parametrize("seed", range(5))
def test_the_function_is_only_asked_where_everything_is_admissible(seed: int) -> None:
    random = np.random.default_rng(seed)
    # The slit 0.05 wide between a line and the parabola, its minimum at the far end outside both.
    line = Inequality("below the line", np.array([[0.05]]), np.array([[[2.0]], [[-1.0]]]))
    function = linear(np.eye(2), np.array([3.0, 0.0]) + random.uniform(-0.5, 0.5, 2))
    found = search(function, np.array([0.1, 0.1]), inequalities=(PARABOLA, line), reach=1.9, radius=0.1)
    points = np.array(function.points)
    assert len(points) > 3
    assert (np.abs(points) < 1.9).all()
    assert all(PARABOLA.margin(x) > 0.0 and line.margin(x) > 0.0 for x in points)
    assert found.converged


def test_where_the_function_has_no_value_steps_are_shortened() -> None:
    # Gauss-Newton on ln x from 5 goes to 5 - 5 ln 5 < 0, where there is no logarithm.
    refusals: list[float] = []

    def logarithm(x: Real) -> Given:
        if x[0] <= 0.0:
            refusals.append(float(x[0]))
            raise ArithmeticError("no logarithm")
        return Given(np.log(x), np.array([[1.0 / x[0]]]))

    found = minimise(logarithm, np.array([5.0]), low=np.array([-50.0]), high=np.array([50.0]), scale=np.ones(1),
                     radius=20.0, tolerance=1e-12, refused=(ArithmeticError,))
    assert refusals
    assert found.x == pytest.approx([1.0], rel=1e-6)
    assert found.converged
    with pytest.raises(ArithmeticError, match="no logarithm"):
        minimise(logarithm, np.array([5.0]), low=np.array([-50.0]), high=np.array([50.0]), scale=np.ones(1),
                 radius=20.0, refused=(ZeroDivisionError,))


def test_a_function_that_is_refused_everywhere_else_ends_without_converging() -> None:
    def alone(x: Real) -> Given:
        if x[0] != 2.0:
            raise ArithmeticError("nowhere else")
        return Given(x, np.eye(1))

    found = minimise(alone, np.array([2.0]), low=np.array([-5.0]), high=np.array([5.0]), scale=np.ones(1),
                     refused=(ArithmeticError,))
    assert found.x == pytest.approx([2.0], abs=0.0)
    assert not found.converged  # the cost falls as 2 x there


def test_a_search_that_is_cut_off_says_so() -> None:
    found = search(rosenbrock, np.array([-1.2, 1.0]), limit=3)
    assert not found.converged
    assert found.iterations == 3
    assert found.reason == "the limit of 3 steps was reached"
    assert found.cost < 0.5 * np.sum(rosenbrock(np.array([-1.2, 1.0])).vector ** 2)


def test_the_minimum_is_recognised_at_once() -> None:
    function = linear(np.eye(2), np.array([0.5, 0.25]))
    found = search(function, np.array([0.5, 0.25]))
    assert (found.converged, found.iterations) == (True, 1)
    assert found.x == pytest.approx([0.5, 0.25], abs=1e-12)


def test_a_start_on_the_boundary_does_not_pass_for_a_minimum() -> None:
    # At the boundary's edge the barrier pushes inwards more strongly than the cost pulls.
    found = search(linear(np.eye(2), np.array([3.0, 0.0])), np.array([-0.999, 0.9981]), inequalities=(PARABOLA,))
    assert found.x == pytest.approx([1.0, 1.0], abs=10.0 * ACTIVE)
    found = minimise(linear(np.eye(2), np.array([3.0, 2.0])), np.array([-1.0, 1.0]), low=-np.ones(2), high=np.ones(2),
                     scale=np.ones(2), tolerance=1e-12)
    assert found.x == pytest.approx([1.0, 1.0], abs=10.0 * ACTIVE)


# --------------------------------------------------------------------------------------------------------------------
# The start


def test_an_admissible_start_is_kept() -> None:
    start = np.array([0.5, 0.6])
    assert interior(start, np.full(2, -3.0), np.full(2, 3.0), (PARABOLA,)) == pytest.approx(start, abs=0.0)


def test_a_start_at_or_beyond_its_bounds_is_moved_inside() -> None:
    found = interior(np.array([-7.0, 3.0]), np.full(2, -3.0), np.full(2, 3.0), ())
    assert found == pytest.approx([-3.0 + 6e-6, 3.0 - 6e-6], abs=1e-12)


@pytest.mark.parametrize("start", [(2.0, 1.0), (-2.0, 0.5), (0.0, -1.0), (1.0, 1.0)])
def test_an_inadmissible_start_is_moved_inside(start: tuple[float, float]) -> None:
    low, high = np.full(2, -3.0), np.full(2, 3.0)
    assert PARABOLA.margin(np.array(start)) < 1e-9
    found = interior(np.array(start), low, high, (PARABOLA,))
    assert PARABOLA.margin(found) > 1e-9
    assert ((found > low) & (found < high)).all()
    end = minimise(linear(np.eye(2), np.array([3.0, 0.0])), np.array(start), low=low, high=high, scale=np.ones(2),
                   inequalities=(PARABOLA,), tolerance=1e-12)
    assert end.x == pytest.approx([1.0, 1.0], abs=ACTIVE)


def test_a_start_that_breaks_one_condition_is_not_moved_out_of_another() -> None:
    # x0 >= x1 >= 1/2, from (0.2, 0.1), where only the second is broken.
    order = Inequality("order", np.zeros((1, 1)), np.array([[[1.0]], [[-1.0]]]))
    floor = Inequality("floor", np.array([[-0.5]]), np.array([[[0.0]], [[1.0]]]))
    start, low, high = np.array([0.2, 0.1]), np.full(2, -3.0), np.full(2, 3.0)
    found = interior(start, low, high, (order, floor))
    assert order.margin(found) > 0.0
    assert floor.margin(found) > 0.0
    # The point of the wedge nearest to (-1, 2): on its edge x0 = x1, at 1/2.
    end = minimise(linear(np.eye(2), np.array([-1.0, 2.0])), start, low=low, high=high, scale=np.ones(2),
                   inequalities=(order, floor), tolerance=1e-12)
    # Two conditions hold it, each of which the barrier keeps its distance from.
    assert end.x == pytest.approx([0.5, 0.5], abs=2.0 * ACTIVE)


def test_a_start_that_rounding_put_outside_is_moved_by_as_little() -> None:
    start = np.array([1.0, 1.0 - 1e-9])
    found = interior(start, np.full(2, -100.0), np.full(2, 100.0), (PARABOLA,))
    assert np.abs(found - start).max() < 1e-3  # of bounds 200 apart


def test_where_nothing_is_admissible_the_condition_is_named() -> None:
    # [[x, 2], [2, 1]] has the determinant x - 4: nothing below four.
    never = Inequality("a wish", np.array([[0.0, 2.0], [2.0, 1.0]]), np.array([[[1.0, 0.0], [0.0, 0.0]]]))
    with pytest.raises(ValueError, match="no admissible point near the start: a wish"):
        minimise(linear(np.eye(1), np.zeros(1)), np.array([0.5]), low=np.zeros(1), high=np.ones(1), scale=np.ones(1),
                 inequalities=(never,))


def test_margins_are_relative_to_what_they_are_made_of() -> None:
    x = np.array([0.5, 1.0])
    large = Inequality("the same in pascal", 1e11 * PARABOLA.constant, 1e11 * PARABOLA.slopes)
    assert large.margin(x) == pytest.approx(PARABOLA.margin(x), rel=1e-12)
    # The eigenvalues of [[1, 1/2], [1/2, 1]] are 1/2 and 3/2; constant and largest contribution are one each.
    assert PARABOLA.margin(x) == pytest.approx(0.25, rel=1e-12)
