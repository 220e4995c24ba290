"""The least-squares problem of a fit: weighted data, priors, bounds, matrix inequalities; tempered searches in it."""

from __future__ import annotations

import copy
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.mesh import MeshError
from workbench.fem.solve import NotConverged
from workbench.files.errors import InputError
from workbench.fitting.admissible import inequalities
from workbench.fitting.covariance import Covariance
from workbench.fitting.objective import FitRecording, Objective, Residual
from workbench.jobs.progress import Progress, no_progress
from workbench.reduced.at_point import NotEnriched
from workbench.search.constrained import Inequality, Minimum, interior, minimise
from workbench.search.continuation import ContinuationStage, Schedule, TemperedMinimum, tempered
from workbench.search.optimum import standard_errors

Real = NDArray[np.float64]

#: Relative deviation that a point is given during exploration. It stands for all that the model leaves out, and lets
#: the prior hold what the smoothed spectra cannot see.
EXPLORATION = 0.05

#: Stages from far smoothing to none. One that has not ended after its 20 steps is in a valley that says little, or in
#: none.
SCHEDULE = Schedule(tuple(ContinuationStage(EXPLORATION, smoothing) for smoothing in (0.03, 0.01, 0.003, 0.0)))

#: Points of a recording that a search uses, at most about.
SEARCHED_POINTS = 241

#: A descent is given up where it costs more than this many times the cost of the best at the same smoothing.
WORSE = 2.0

#: Where nothing can be predicted.
REFUSED: tuple[type[Exception], ...] = (NotEnriched, NotConverged, MeshError, InputError)

#: Errors that end one start of several: nothing can be predicted, or nothing there is admissible.
NO_END: tuple[type[Exception], ...] = (*REFUSED, ValueError)


@dataclass(frozen=True, eq=False)
class Weighted:
    """A residual with the prior's rows below: what `minimise` sees."""

    vector: Real
    jacobian: Real
    data: Residual


#: Where a search ended.
Optimum = Minimum[Weighted]


#: Where a search through the stages of :data:`SCHEDULE` ended.
FitDescent = TemperedMinimum[Weighted]


class FitSearch:
    """The least-squares problem of one objective: bounds, prior and inequalities around it.

    Only the parameters of the indices `free` move, all by default; the priors of those in `released` are left out.
    """

    def __init__(
        self, objective: Objective, *, poisson: tuple[float, float] | None = None, free: Sequence[int] | None = None,
        released: Collection[int] = (), refusals: list[str] | None = None,
    ) -> None:
        #: The objective with the models that the search has come to.
        self.objective, self.parameters = objective, objective.parameters
        #: Why steps could not be taken, one entry for each; shared by all that are made of this.
        self.refusals = [] if refusals is None else refusals
        self.free = np.arange(len(self.parameters)) if free is None else np.array(sorted(free), dtype=int)
        self.low = np.array([p.low for p in self.parameters])
        self.high = np.array([p.high for p in self.parameters])
        self.scale = np.array([p.scale for p in self.parameters])
        self.centre = np.array([p.start for p in self.parameters])
        self.precision = np.array([0.0 if p.prior is None or i in released else 1.0 / p.prior
                                   for i, p in enumerate(self.parameters)])
        problems = [r.problem for r in objective.recordings]
        moving = [self.parameters[i] for i in self.free]
        names = [r.name for r in objective.recordings]
        found = (inequalities(problems, moving, recordings=names) if poisson is None
                 else inequalities(problems, moving, poisson=poisson, recordings=names))
        self.inequalities: tuple[Inequality, ...] = tuple(self._among_all(inequality) for inequality in found)
        #: Covariance of the deviations beside the noise of the points, if there are any.
        self.covariance: Covariance | None = None

    def with_objective(self, objective: Objective) -> FitSearch:
        """The problem with the predictions of another objective."""
        other = copy.copy(self)
        other.objective = objective
        return other

    def with_covariance(self, covariance: Covariance | None) -> FitSearch:
        """The problem with correlated deviations."""
        other = copy.copy(self)
        other.covariance = covariance
        return other

    def thinned(self) -> FitSearch:
        """The problem with at most about :data:`SEARCHED_POINTS` of each recording's points."""
        return self.with_objective(self.objective.thinned(SEARCHED_POINTS))

    def _among_all(self, inequality: Inequality) -> Inequality:
        """An inequality of the free parameters as one of all."""
        slopes = np.zeros((len(self.parameters), *inequality.constant.shape))
        slopes[self.free] = inequality.slopes
        return replace(inequality, slopes=slopes)

    def evaluate(
        self, x: Real, deviation: Sequence[Real | float], smoothing: float = 0.0, free: Collection[int] | None = None
    ) -> Weighted:
        """Data and prior, about the parameters' own starts, at x (p,); `free` as in `Objective.predict`."""
        data = self.objective(x, deviation=deviation, smoothing=smoothing, free=free)
        self.objective = self.objective.holding(data.predictions)
        vector, jacobian = data.vector, data.jacobian
        if self.covariance is not None:
            vector, jacobian = self.covariance.whitened(vector), self.covariance.whitened(jacobian)
        vector = np.concatenate([vector, (x - self.centre) * self.precision])
        return Weighted(vector, np.vstack([jacobian, np.diag(self.precision)]), data)

    def minimise(
        self, x: Real, deviation: Sequence[Real | float], *, smoothing: float = 0.0, limit: int = 40,
        tolerance: float = 1e-6, radius: float = 1.0, fixed: tuple[int, ...] = (),
    ) -> Optimum:
        """The least cost near x; the parameters of the indices `fixed` stay where they are."""
        free = np.setdiff1d(self.free, fixed)
        moved = frozenset(map(int, free))

        def whole(y: Real) -> Real:
            result = x.copy()
            result[free] = y
            return result

        def reduced(y: Real) -> Weighted:
            full = self.evaluate(whole(y), deviation, smoothing, moved)
            return Weighted(full.vector, full.jacobian[:, free], full.data)

        found = minimise(reduced, x[free], low=self.low[free], high=self.high[free], scale=self.scale[free],
                         inequalities=self._conditions(x, free), radius=radius, tolerance=tolerance, limit=limit,
                         refused=REFUSED)
        self.refusals.extend(found.refusals)
        return replace(found, x=whole(found.x))

    def inside(self, x: Real) -> Real:
        """The start of :meth:`minimise` from x (p,): x, or a point near it strictly inside the admissible set."""
        result, free = x.copy(), self.free
        result[free] = interior(x[free], self.low[free], self.high[free], self._conditions(x, free))
        return result

    def _conditions(self, x: Real, free: NDArray[np.int64]) -> list[Inequality]:
        """The inequalities of the parameters of the indices `free`, with the others where x (p,) has them."""
        held = x.copy()
        held[free] = 0.0
        return [Inequality(i.name, i(held), i.slopes[free]) for i in self.inequalities if i.slopes[free].any()]

    @property
    def middle(self) -> float:
        """The middle (Hz) of the band."""
        return float(np.mean(self.objective.recordings[0].measured.frequency[[0, -1]]))

    @property
    def schedule(self) -> Schedule:
        """The stages of :data:`SCHEDULE` that the points of the recording can show."""
        return SCHEDULE.resolved(_spacing(self.objective.recordings[0]) / self.middle)

    def solve(self, stage: ContinuationStage, x: Real, deviation: Sequence[Real | float]) -> Optimum:
        """The end of a stage from x (p,), with points of that `deviation`, the stage's own included."""
        return self.minimise(x, deviation, smoothing=stage.smoothing * self.middle, limit=stage.limit,
                             tolerance=stage.tolerance, fixed=stage.held)

    def descend(
        self, x: Real, *, first: int = 0, rival: FitDescent | None = None,
        progress: Progress = no_progress,
    ) -> FitDescent:
        """The end of a tempered search from x (p,), moved to where it is admissible, from the stage of number `first`.

        The prior holds what the smoothed spectra cannot see. The search is given up where it is clearly worse than its
        `rival` was at the same stage.
        """
        def solve(stage: ContinuationStage, x: Real) -> Optimum:
            # A smoothed spectrum has as many independent points as widths fit into the band.
            return self.solve(stage, x, [
                stage.deviation * np.sqrt(max(1.0, stage.smoothing * self.middle / _spacing(recording)))
                for recording in self.objective.recordings])

        return tempered(self.schedule, solve, self.inside(x), first=first, rival=rival, worse=WORSE,
                        progress=progress)

    def errors(self, optimum: Optimum) -> Real:
        """Standard errors (p,) at an optimum of this problem as the data weigh there, zero of parameters that are not
        free."""
        found = np.zeros(self.scale.size)
        found[self.free] = standard_errors(optimum.residual.jacobian, self.scale[self.free])
        return found


def _spacing(recording: FitRecording) -> float:
    """The distance (Hz) of the points of a recording."""
    return float(np.median(np.diff(recording.measured.frequency)))
