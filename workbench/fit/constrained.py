"""Gauss-Newton with a trust region, under bounds and linear matrix inequalities.

Everything a physical parameter set must satisfy here is convex: bounds, a stiffness that stores energy, losses that
take energy out (Acevedo-Espinosa et al. (RP-UEIS), eq. 13, is an eigenvalue condition), Poisson's ratio. All have the
form M0 + sum_i x_i M_i >= 0 (positive semidefinite), so each step solves a convex problem by Newton's method on a
logarithmic barrier (Boyd and Vandenberghe 2004, Convex Optimization, section 11.3) and never leaves the admissible set.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

Real = NDArray[np.float64]

#: Share of the distance to the boundary that a barrier step may use.
INTERIOR = 0.99

#: Smallest relative margin of a start, and the first step towards it as a share of the way to the bounds.
STRICT, EASED = 1e-9, 1e-7

#: Cost, half a chi-square, below which nothing is left to be gained.
NOTHING = 1e-6

#: Barrier weights of one trust-region step, relative to the cost; the last one times the number of inequalities bounds
#: what the step loses to the barrier.
BARRIER = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)


class LeastSquares(Protocol):
    """Residuals (m,) and their derivative (m, p) at a point."""

    @property
    def vector(self) -> Real: ...

    @property
    def jacobian(self) -> Real: ...


@dataclass(frozen=True, eq=False)
class Inequality:
    """constant + sum_i x_i slopes[i] is positive semidefinite: ``constant`` (k, k), ``slopes`` (p, k, k)."""

    name: str
    constant: Real
    slopes: Real

    def __call__(self, x: Real) -> Real:
        return np.asarray(self.constant + np.tensordot(x, self.slopes, axes=1))

    def margin(self, x: Real) -> float:
        """The smallest eigenvalue at x, relative to the size of what it is made of."""
        size = np.abs(self.constant).max() + np.abs(x[:, None, None] * self.slopes).max()
        return float(np.linalg.eigvalsh(self(x))[0] / size)


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where the search ended.

    ``x`` (p,), ``residual`` there; ``cost`` half the sum of squares; ``converged`` whether no step promised a further
    relative decrease of more than the tolerance; ``iterations`` accepted and rejected steps; ``reason`` in words.
    """

    x: Real
    residual: LeastSquares
    cost: float
    converged: bool
    iterations: int
    reason: str


def minimise(
    function: Callable[[Real], LeastSquares],
    start: Real,
    *,
    low: Real,
    high: Real,
    scale: Real,
    inequalities: Sequence[Inequality] = (),
    radius: float = 1.0,
    tolerance: float = 1e-6,
    limit: int = 50,
    refused: tuple[type[Exception], ...] = (),
) -> Minimum:
    """The least sum of squares near `start` (p,), strictly inside the bounds and inequalities at every step.

    Steps are measured in `scale` (p,); the first is no longer than `radius`. An exception of a type in `refused` means
    that the function has no value there; the step is then shortened.

    Raises:
        ValueError: `start` is not admissible and there is no admissible point near it.
    """
    x = interior(start, low, high, inequalities)
    at = function(x)
    cost = 0.5 * float(at.vector @ at.vector)
    reason = f"the limit of {limit} steps was reached"
    refusing = False
    for iteration in range(1, limit + 1):
        step, promised = _step(at, x, cost, low, high, scale, inequalities, radius)
        held = refusing and float(np.abs(step / scale).max()) > 0.9 * radius
        if promised <= tolerance * max(cost, NOTHING) and not held:
            return Minimum(x, at, cost, True, iteration, "no step promises a decrease")
        try:
            trial = function(x + step)
            now, refusing = 0.5 * float(trial.vector @ trial.vector), False
        except refused:
            trial, now, refusing = at, np.inf, True
        gain = (cost - now) / promised
        length = float(np.abs(step / scale).max())
        if gain > 0.0:
            x, at, cost = x + step, trial, now
        if gain < 0.25:
            radius = 0.3 * length
        elif gain > 0.75 and length > 0.8 * radius:
            radius *= 3.0
        if radius < 1e-9:
            return Minimum(x, at, cost, False, iteration, "steps became too short to change anything")
    return Minimum(x, at, cost, False, limit, reason)


def interior(start: Real, low: Real, high: Real, inequalities: Sequence[Inequality]) -> Real:
    """`start`, or a point near it that is strictly admissible: the worst condition is eased by growing steps.

    Raises:
        ValueError: none was found.
    """
    width = high - low
    x = np.clip(start, low + 1e-6 * width, high - 1e-6 * width)
    if not inequalities:
        return np.asarray(x)
    step = EASED
    for _ in range(200):
        margins = [inequality.margin(x) for inequality in inequalities]
        worst = inequalities[int(np.argmin(margins))]
        if min(margins) > STRICT:
            return np.asarray(x)
        # Off-diagonal entries towards zero, diagonal ones away from it: both along the slopes of the margin.
        _, vectors = np.linalg.eigh(worst(x))
        slope = np.einsum("i,pij,j->p", vectors[:, 0], worst.slopes, vectors[:, 0])
        direction = np.where(slope > 0.0, high - x, x - low) * np.sign(slope)
        x = np.clip(x + min(step, 0.1) * direction, low + 1e-6 * width, high - 1e-6 * width)
        step *= 1.2
    raise ValueError(f"no admissible point near the start: {worst.name} cannot be met within the bounds")


def _step(
    at: LeastSquares, x: Real, cost: float, low: Real, high: Real, scale: Real, inequalities: Sequence[Inequality],
    radius: float,
) -> tuple[Real, float]:
    """The best admissible step of the linearised problem within the trust region, and the decrease it promises."""
    jacobian = at.jacobian * scale
    hessian, slope = jacobian.T @ jacobian, jacobian.T @ at.vector
    lower = np.maximum(-radius, (low - x) / scale)
    upper = np.minimum(radius, (high - x) / scale)
    step = np.zeros(x.size)
    # All inequalities as one of block diagonal matrices; (k k, p), so that a combination is one small product.
    constant = block_diag(*(inequality(x) for inequality in inequalities)) if inequalities else np.zeros((0, 0))
    slopes = np.array([block_diag(*(inequality.slopes[i] * scale[i] for inequality in inequalities))
                       if inequalities else constant for i in range(x.size)])
    flat = slopes.reshape(x.size, -1).T
    ridge = 1e-12 * np.trace(hessian) / x.size + 1e-300

    def matrix(d: Real) -> Real:
        return np.asarray(constant + (flat @ d).reshape(constant.shape))

    def barrier(d: Real) -> float:
        """Minus the logarithm of all margins; infinite outside."""
        below, above = d - lower, upper - d
        if below.min() <= 0.0 or above.min() <= 0.0:
            return np.inf
        value = -float(np.log(below).sum() + np.log(above).sum())
        try:
            triangle = np.linalg.cholesky(matrix(d))
        except np.linalg.LinAlgError:
            return np.inf
        return value - 2.0 * float(np.log(triangle.diagonal()).sum())

    def model(d: Real) -> float:
        return float(0.5 * d @ hessian @ d + slope @ d)

    free = _free_step(hessian, slope, ridge)
    if free is not None and np.isfinite(barrier(free / INTERIOR)):
        return free * scale, -model(free)
    for weight in BARRIER:
        mu = weight * max(cost, 1e-12)
        value = model(step) + mu * barrier(step)
        for _ in range(30):
            gradient = hessian @ step + slope + mu * (1.0 / (upper - step) - 1.0 / (step - lower))
            curvature = hessian + np.diag(mu * ((upper - step) ** -2.0 + (step - lower) ** -2.0) + ridge)
            try:
                images = np.linalg.inv(matrix(step)) @ slopes
                gradient -= mu * np.trace(images, axis1=1, axis2=2)
                curvature += mu * (images.reshape(x.size, -1) @ images.transpose(0, 2, 1).reshape(x.size, -1).T)
                direction = -np.linalg.solve(curvature, gradient)
            except np.linalg.LinAlgError:
                break  # nothing to gain along a direction that the rounding cannot tell from none
            decrement = -float(gradient @ direction)
            if decrement < 1e-9 * mu or decrement < 1e-16 * max(cost, 1e-12):
                break
            size = 1.0
            for _ in range(40):
                trial = step + size * direction
                now = model(trial) + mu * barrier(trial)
                if now < value - 1e-4 * size * decrement:
                    break
                size *= 0.5
            else:
                break
            step, value = trial, now
    return step * scale, -model(step)


def _free_step(hessian: Real, slope: Real, ridge: float) -> Real | None:
    """The best step of the linearised problem without any condition; None if rounding cannot tell one."""
    try:
        return np.asarray(-np.linalg.solve(hessian + ridge * np.eye(slope.size), slope))
    except np.linalg.LinAlgError:
        return None
