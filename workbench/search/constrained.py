"""Gauss-Newton with a trust region, under bounds and linear matrix inequalities.

Everything a physical parameter set must satisfy here is convex: bounds, a stiffness that stores energy, losses that
take energy out (Acevedo-Espinosa et al. (RP-UEIS), eq. 13, is an eigenvalue condition), Poisson's ratio. All have the
form M0 + sum_i x_i M_i >= 0 (positive semidefinite), so each step solves a convex problem by Newton's method on a
logarithmic barrier (Boyd and Vandenberghe 2004, Convex Optimization, section 11.3) and never leaves the admissible set.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

Real = NDArray[np.float64]

#: Share of the distance to the boundary that a barrier step may use.
INTERIOR = 0.99

#: Smallest relative margin of a start, and the first step towards it as a share of the way to the bounds.
STRICT, EASED = 1e-9, 1e-7

#: Cost, half a chi-square, below which no gain is possible.
NOTHING = 1e-6

#: Barrier weights of one trust-region step, relative to the cost; the last one times the number of inequalities bounds
#: what the step loses to the barrier. At each of them so many steps of Newton's method are enough from the end of the
#: last one.
BARRIER = (1.0, 1e-2, 1e-4, 1e-6, 1e-8, 1e-10)
NEWTON = 100

#: The search for a step starts this share of the trust region, or of the way, towards the centre of what is admissible.
#: From a point at the boundary itself Newton's method follows a curved one in vain.
INWARD = 0.5


class LeastSquares(Protocol):
    """Residuals (m,) and their derivative (m, p) at a point."""

    @property
    def vector(self) -> Real: ...

    @property
    def jacobian(self) -> Real: ...


#: The residuals that are minimised, and come back with the minimum.
Residuals = TypeVar("Residuals", bound=LeastSquares)


@dataclass(frozen=True, eq=False)
class Inequality:
    """constant + sum_i x_i slopes[i] is positive semidefinite. ``constant`` is (k, k), ``slopes`` (p, k, k)."""

    name: str
    constant: Real
    slopes: Real

    def __call__(self, x: Real) -> Real:
        return np.asarray(self.constant + np.tensordot(x, self.slopes, axes=1))

    def margin(self, x: Real) -> float:
        """The smallest eigenvalue at x, relative to the size of its terms."""
        size = np.abs(self.constant).max() + np.abs(x[:, None, None] * self.slopes).max()
        return float(np.linalg.eigvalsh(self(x))[0] / size)


@dataclass(frozen=True, eq=False)
class Minimum(Generic[Residuals]):
    """The end of a search.

    ``x`` (p,), ``residual`` there; ``cost`` half the sum of squares; ``converged`` whether no step promised a further
    relative decrease of more than the tolerance; ``iterations`` accepted and rejected steps; ``reason`` in words.
    ``refusals`` says of every step that could not be taken, since the function has no value there, why not.
    """

    x: Real
    residual: Residuals
    cost: float
    converged: bool
    iterations: int
    reason: str
    refusals: tuple[str, ...]


def minimise(
    function: Callable[[Real], Residuals],
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
) -> Minimum[Residuals]:
    """The least sum of squares near `start` (p,), under bounds and inequalities.

    Every step is strictly admissible and measured in `scale` (p,); the first is no longer than `radius`. An exception
    of a type in `refused` means that the function has no value there; the step is then shortened.

    Raises:
        ValueError: `start` is not admissible and there is no admissible point near it.
    """
    x = interior(start, low, high, inequalities)
    together = _together(inequalities, x.size)
    centre = _Region(x, low, high, scale, together).centre()
    at = function(x)
    cost = 0.5 * float(at.vector @ at.vector)
    reason = f"the limit of {limit} steps was reached"
    refusing, refusals = False, list[str]()
    for iteration in range(1, limit + 1):
        step, promised = _step(at, cost, _Region(x, np.maximum(low, x - radius * scale),
                                                 np.minimum(high, x + radius * scale), scale, together), centre)
        held = refusing and float(np.abs(step / scale).max()) > 0.9 * radius
        if promised <= tolerance * max(cost, NOTHING) and not held:
            return Minimum(x, at, cost, True, iteration, "no step promises a decrease", tuple(refusals))
        try:
            trial = function(x + step)
            now, refusing = 0.5 * float(trial.vector @ trial.vector), False
        except refused as error:
            trial, now, refusing = at, np.inf, True
            refusals.append(f"{type(error).__name__}: {error}")
        gain = (cost - now) / promised
        length = float(np.abs(step / scale).max())
        if gain > 0.0:
            x, at, cost = x + step, trial, now
        if gain < 0.25:
            radius = 0.3 * length
        elif gain > 0.75 and length > 0.8 * radius:
            radius *= 3.0
        if radius < 1e-9:
            reason = "steps became too short to change anything"
            if refusing:
                reason = f"no step could be taken any more ({refusals[-1]})"
            return Minimum(x, at, cost, False, iteration, reason, tuple(refusals))
    return Minimum(x, at, cost, False, limit, reason, tuple(refusals))


def interior(start: Real, low: Real, high: Real, inequalities: Sequence[Inequality]) -> Real:
    """`start`, or a strictly admissible point near it, found by growing steps.

    Raises:
        ValueError: there is no such point.
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


def _together(inequalities: Sequence[Inequality], size: int) -> Inequality:
    """All inequalities of `size` parameters as one of block diagonal matrices."""
    none = np.zeros((0, 0))
    return Inequality("all", block_diag(none, *(inequality.constant for inequality in inequalities)), np.array(
        [block_diag(none, *(inequality.slopes[i] for inequality in inequalities)) for i in range(size)]))


class _Region:
    """The admissible set around x: lower < d < upper, matrix(d) positive. Steps d are measured in `scale`."""

    def __init__(self, x: Real, low: Real, high: Real, scale: Real, inequality: Inequality) -> None:
        self.x, self.scale = x, scale
        self.lower, self.upper = (low - x) / scale, (high - x) / scale
        self.constant, self.slopes = inequality(x), inequality.slopes * scale[:, None, None]
        # (k k, p), so that a combination is one small product.
        self.flat = self.slopes.reshape(x.size, -1).T

    def matrix(self, d: Real) -> Real:
        return np.asarray(self.constant + (self.flat @ d).reshape(self.constant.shape))

    def barrier(self, d: Real) -> float:
        """Minus the logarithm of all margins; infinite outside."""
        below, above = d - self.lower, self.upper - d
        if below.min() <= 0.0 or above.min() <= 0.0:
            return np.inf
        value = -float(np.log(below).sum() + np.log(above).sum())
        try:
            triangle = np.linalg.cholesky(self.matrix(d))
        except np.linalg.LinAlgError:
            return np.inf
        return value - 2.0 * float(np.log(triangle.diagonal()).sum())

    def descend(self, d: Real, hessian: Real, slope: Real, mu: float, enough: float) -> Real:
        """The minimum of d.hessian.d / 2 + slope.d + mu barrier(d).

        Newton's method starts from an admissible d. It ends if a step promises less than `enough`, or by rounding.
        """
        ridge = _ridge(hessian)

        def value(d: Real) -> float:
            return _quadratic(hessian, slope, d) + mu * self.barrier(d)

        best = value(d)
        for _ in range(NEWTON):
            above, below = 1.0 / (self.upper - d), 1.0 / (d - self.lower)
            gradient = hessian @ d + slope + mu * (above - below)
            curvature = hessian + np.diag(mu * (above**2 + below**2) + ridge)
            try:
                images = np.linalg.inv(self.matrix(d)) @ self.slopes
                gradient -= mu * np.trace(images, axis1=1, axis2=2)
                curvature += mu * (images.reshape(d.size, -1) @ images.transpose(0, 2, 1).reshape(d.size, -1).T)
                direction = -np.linalg.solve(curvature, gradient)
            except np.linalg.LinAlgError:
                break  # nothing to gain along a direction that the rounding cannot tell from none
            promised = -float(gradient @ direction)
            if promised < enough:
                break
            size = 1.0
            for _ in range(40):
                trial = d + size * direction
                now = value(trial)
                if now < best - 1e-4 * size * promised:
                    break
                size *= 0.5
            else:
                break
            d, best = trial, now
        return d

    def centre(self) -> Real:
        """The point x + d (p,) farthest from all boundaries. It is the minimum of the barrier alone."""
        nothing = np.zeros(self.x.size)
        d = self.descend(nothing, np.diag(nothing), nothing, 1.0, 1e-6)
        return np.asarray(self.x + d * self.scale)


def _step(at: LeastSquares, cost: float, region: _Region, centre: Real) -> tuple[Real, float]:
    """The best admissible step in the trust region, and its predicted decrease. The problem is linearised."""
    scale, cost = region.scale, max(cost, 1e-12)
    jacobian = at.jacobian * scale
    hessian, slope = jacobian.T @ jacobian, jacobian.T @ at.vector
    free = _free_step(hessian, slope)
    if free is not None and np.isfinite(region.barrier(free / INTERIOR)):
        return free * scale, -_quadratic(hessian, slope, free)
    inward = (centre - region.x) / scale
    length = max(np.max(inward / region.upper), np.max(inward / region.lower), 1.0)
    step = INWARD * inward / length
    for weight in BARRIER:
        mu = weight * cost
        step = region.descend(step, hessian, slope, mu, max(1e-9 * mu, 1e-16 * cost))
    return step * scale, -_quadratic(hessian, slope, step)


def _free_step(hessian: Real, slope: Real) -> Real | None:
    """The best unconstrained step of the linearised problem; None within rounding."""
    try:
        return np.asarray(-np.linalg.solve(hessian + _ridge(hessian) * np.eye(slope.size), slope))
    except np.linalg.LinAlgError:
        return None


def _quadratic(hessian: Real, slope: Real, d: Real) -> float:
    """The linearised cost of a step, less that of none."""
    return float(0.5 * d @ hessian @ d + slope @ d)


def _ridge(hessian: Real) -> float:
    """A ridge that makes a flat direction solvable, negligible beside any other."""
    return float(1e-12 * np.trace(hessian) / len(hessian) + 1e-300)
