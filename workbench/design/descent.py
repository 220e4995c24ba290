"""A descent from one start, with exact derivatives, and its active bounds.

It is sequential quadratic programming (SLSQP of scipy: Kraft 1988, DFVLR-FB 88-28). Objectives without gradients use
differential evolution instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution, minimize, nnls

from workbench.design.nonlinear_programme import KEPT, NonlinearProgramme, ProgrammePoint

Real = NDArray[np.float64]

#: Change of the objective (natural logarithm of the figure) below which a descent has ended.
CONVERGED = 1e-6

#: Largest residual derivative of the objective, over the whole range of an unknown, at a stationary point. Doubled,
#: ends would differ by twice as much in a flat valley.
STATIONARY = 1e-3

#: A margin (in scales), or a distance to the end of a range (in ranges), below which a bound is active.
ACTIVE = 1e-4

#: A descent that gets stuck, as when the resonance changes to another one, continues within a box around the best
#: point. The half-width of the box (in ranges) shrinks by the first number, from the whole range down to the second.
SHRINKING, SMALLEST = 0.25, 0.02

#: Most such rounds in a row without a better point.
STALLED = 2

#: Excess of a point without figures over the worst point known, in units of the objective.
PENALTY = 1.0

#: Offset of the objective of infeasible points, to which their violation adds: logarithms of figures are far below.
BROKEN = 1e3

#: Most combinations of rounding up and down that are tried; with more stepped lengths, those with the least effect on
#: the objective are rounded to the nearest step at first.
CORNERS = 16

#: Evaluations without a better point after which a round ends: a line search takes ten at most.
PATIENCE = 12


class _Ended(Exception):
    """Raised when a descent has used its evaluations or stopped improving."""


@dataclass(frozen=True, eq=False)
class Multipliers:
    """The gain of a small step past each bound.

    The gain is the decrease of the objective per scale of a bound, or per range of a variable. ``bounds`` (m,) are
    those of the bounds; ``low`` and ``high`` (n,) those of the ends of the ranges, zero where not active. ``residual``
    is the largest derivative (per range) not balanced by them: zero at a stationary point.
    """

    bounds: Real
    low: Real
    high: Real
    residual: float


@dataclass(frozen=True, eq=False)
class DesignDescent:
    """The best point of a descent from ``start`` (n,), and its ``path``.

    ``path`` has the (objective, violation) of every evaluation.
    """

    start: Real
    point: ProgrammePoint
    multipliers: Multipliers
    path: tuple[tuple[float, float], ...]

    @property
    def stationary(self) -> bool:
        """Whether no direction within the active bounds decreases the objective."""
        return self.multipliers.residual <= STATIONARY

    @property
    def feasible(self) -> bool:
        """Whether its end satisfies all bounds."""
        return self.point.violation <= KEPT


def descend(programme: NonlinearProgramme, start: Real, *, evaluations: int) -> DesignDescent:
    """The best point of a descent from `start` (n,).

    It makes at most `evaluations` evaluations.
    """
    points: list[ProgrammePoint] = []
    begun = 0

    def evaluate(x: Real) -> ProgrammePoint:
        for each in reversed(points):
            if np.array_equal(each.x, x):
                return each
        last_gain = 1 + min(range(len(points)), key=lambda k: points[k].rank, default=-1)
        if len(points) >= evaluations or len(points) - max(begun, last_gain) > PATIENCE:
            raise _Ended
        points.append(programme(x))
        return points[-1]

    centre, width, idle = np.clip(np.asarray(start, dtype=float), 0.0, 1.0), 1.0, 0
    best = evaluate(centre)
    while width >= SMALLEST and idle < STALLED and programme.variables and len(points) < evaluations:
        before, begun = best, len(points)
        with suppress(_Ended):
            _follow(programme, evaluate, points, centre, width)
        best = min(points, key=lambda each: each.rank)
        if not best.exists or (best.violation <= KEPT and multipliers(best).residual <= STATIONARY):
            break
        idle = 0 if _better(best, before) else idle + 1
        width, centre = SHRINKING * width, best.x
    return DesignDescent(np.asarray(start, dtype=float), best, multipliers(best),
                         tuple((each.objective, each.violation) for each in points))


def evolve(programme: NonlinearProgramme, start: Real, *, population: int, generations: int, seed: int,
           say: Callable[[float], None] = lambda share: None) -> ProgrammePoint:
    """The best point of a differential evolution.

    Source: Storn and Price 1997, J. Global Optim. 11, 341, as in scipy. `start` (n,) is a member of the first
    generation of about `population` points. Lengths are on their steps.
    """
    points: list[ProgrammePoint] = []

    def objective(x: Real) -> float:
        points.append(programme(programme.on_steps(x), gradient=False))
        say(min(1.0, len(points) / (population * generations)))
        broken, value = points[-1].rank
        return min(value, BROKEN) + BROKEN * broken

    objective(start)
    if size := len(start):
        differential_evolution(objective, [(0.0, 1.0)] * size, x0=start, popsize=math.ceil(population / size),
                               maxiter=generations, seed=seed, init="sobol", polish=False)
    return min(points, key=lambda each: each.rank)


def _better(one: ProgrammePoint, other: ProgrammePoint) -> bool:
    """Whether `one` is better than `other` by more than :data:`CONVERGED`."""
    return one.rank[0] < other.rank[0] or (one.rank[0] == other.rank[0] and one.rank[1] < other.rank[1] - CONVERGED)


def _follow(
    programme: NonlinearProgramme, evaluate: Callable[[Real], ProgrammePoint], points: list[ProgrammePoint],
    centre: Real, width: float,
) -> None:
    """Run SLSQP from `centre` (n,) within `width` to either side."""
    def clipped(x: Real) -> ProgrammePoint:
        return evaluate(np.clip(x, low, high))

    def objective(x: Real) -> tuple[float, Real]:
        point = clipped(x)
        if point.exists:
            return point.objective, point.slope
        # Without figures a point is worse than all others, so that the line search turns back.
        worst = max((each.objective for each in points if each.exists), default=0.0)
        return worst + PENALTY, np.zeros(len(x))

    def margins(x: Real) -> Real:
        point = clipped(x)
        return point.margins if point.exists else np.full(len(programme.bounds), -PENALTY)

    def jacobian(x: Real) -> Real:
        point = clipped(x)
        return point.jacobian if point.exists else np.zeros((len(programme.bounds), len(x)))

    low, high = np.maximum(0.0, centre - width), np.minimum(1.0, centre + width)
    constraints = [{"type": "ineq", "fun": margins, "jac": jacobian}] if programme.bounds else []
    minimize(objective, centre, jac=True, method="SLSQP", bounds=list(zip(low, high, strict=True)),
             constraints=constraints, options={"ftol": CONVERGED, "maxiter": 1000})


def multipliers(point: ProgrammePoint) -> Multipliers:
    """The multipliers of the bounds and ends active at `point`.

    They are non-negative and make the residual of the gradient as small as possible (non-negative least squares).
    """
    count, unit = len(point.margins), np.eye(len(point.x))
    columns = np.concatenate([point.jacobian, unit, -unit])
    active = np.concatenate([point.margins, point.x, 1.0 - point.x]) <= ACTIVE
    gains, residual = np.zeros(len(columns)), 0.0 if point.exists else math.inf
    if point.exists and len(unit):
        if active.any():
            gains[active] = nnls(columns[active].T, point.slope)[0]
        residual = float(np.abs(point.slope - gains @ columns).max())
    bounds, low, high = np.split(gains, [count, count + len(unit)])
    return Multipliers(bounds, low, high, residual)


def round_to_grid(
    programme: NonlinearProgramme, found: DesignDescent, *, evaluations: int
) -> tuple[NonlinearProgramme, DesignDescent]:
    """The best combination of steps near an optimum.

    For each combination the other lengths are optimal. All roundings up and down are tried, then single steps from the
    best one until none is better. Returns the programme with the steps fixed, and the descent in its other variables.
    """
    lengths, tried = found.point.lengths, dict[tuple[float, ...], tuple[NonlinearProgramme, DesignDescent]]()
    slopes = zip(programme.variables, found.point.slope, programme.extent, strict=True)
    leverage = {each: abs(float(slope)) * each.step / extent for each, slope, extent in slopes if each.step is not None}
    if not leverage:
        return programme, found
    # The nearest step, then the one on the other side of the length.
    choices = {each: (nearest := each.round(lengths[each.name]), *(
        value for value in each.beside(lengths[each.name])
        if value != nearest and abs(value - lengths[each.name]) < (each.step or 0.0))) for each in leverage}
    for each in sorted(leverage, key=lambda each: leverage[each]):
        if math.prod(map(len, choices.values())) > CORNERS:
            choices[each] = choices[each][:1]
    corners = set(product(*choices.values()))
    while new := corners - set(tried):
        for corner in sorted(new):
            held = programme.holding({each.name: value for each, value in zip(choices, corner, strict=True)})
            tried[corner] = held, descend(held, held.unknowns(lengths), evaluations=evaluations)
        best = min(tried, key=lambda corner: tried[corner][1].point.rank)
        corners = {(*best[:index], value, *best[index + 1:]) for index, each in enumerate(choices)
                   for value in each.beside(best[index])}
    return tried[best]
