"""The least-squares problem of a fit, and tempered searches in it."""

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
from workbench.fitting.covariance import Covariance, prior_rows
from workbench.fitting.objective import FitRecording, Objective, Residual
from workbench.jobs.progress import Progress, no_progress
from workbench.reduced.at_point import NotEnriched
from workbench.search.constrained import Inequality, Minimum, interior, minimise
from workbench.search.continuation import ContinuationStage, Schedule, TemperedMinimum, tempered
from workbench.search.optimum import standard_errors

Real = NDArray[np.float64]

#: Stages from far smoothing to none. The deviation of the points stands for all physics missing in the model. With it
#: the prior fixes parameters that smoothed spectra do not determine. A stage that has not ended after 20 steps is in a
#: flat valley, or in none.
SCHEDULE = Schedule(tuple(ContinuationStage(0.05, smoothing) for smoothing in (0.03, 0.01, 0.003, 0.0)))

#: Relative error of the reduced model while exploring.
COARSE = 5e-2

#: Approximate number of points of a recording in a search.
SEARCHED_POINTS = 241

#: A descent is given up where it costs more than this many times the cost of the best at the same smoothing.
WORSE = 2.0

#: Where nothing can be predicted.
REFUSED: tuple[type[Exception], ...] = (NotEnriched, NotConverged, MeshError, InputError)

#: Errors that end one start of several: nothing can be predicted, or nothing there is admissible.
NO_END: tuple[type[Exception], ...] = (*REFUSED, ValueError)


@dataclass(frozen=True, eq=False)
class Weighted:
    """A residual with the prior's rows below, for `minimise`."""

    vector: Real
    jacobian: Real
    data: Residual


#: Where a search ended.
Optimum = Minimum[Weighted]


#: Where a search through the stages of :data:`SCHEDULE` ended.
FitDescent = TemperedMinimum[Weighted]


class FitSearch:
    """The least-squares problem of one objective: bounds, prior and inequalities around it.

    Only the parameters of the indices `free` move, all by default; those in `without_prior` have none. ``prior_rows`` R
    (p, p) is a root of the precision R^T R of the prior, whose numbers have the `correlation` (p, p), none by default.
    """

    def __init__(
        self, objective: Objective, *, free: Sequence[int] | None = None, without_prior: Collection[int] = (),
        refusals: list[str] | None = None, correlation: Real | None = None,
    ) -> None:
        #: The objective with the present models of the search.
        self.objective, self.parameters = objective, objective.parameters
        #: Reasons of failed steps, one entry for each; shared by all copies.
        self.refusals = [] if refusals is None else refusals
        self.free = np.arange(len(self.parameters)) if free is None else np.array(sorted(free), dtype=int)
        self.low = np.array([p.low for p in self.parameters])
        self.high = np.array([p.high for p in self.parameters])
        self.scale = np.array([p.scale for p in self.parameters])
        self.centre = np.array([p.start for p in self.parameters])
        self.prior_rows = prior_rows([None if i in without_prior else p.prior for i, p in enumerate(self.parameters)],
                                     correlation)
        conditions = inequalities([r.problem for r in objective.recordings], [self.parameters[i] for i in self.free],
                                  recordings=[r.name for r in objective.recordings])
        among = np.eye(len(self.parameters))[:, self.free]
        #: Inequalities of the free parameters, as functions of all.
        self.inequalities = tuple(replace(each, slopes=np.tensordot(among, each.slopes, axes=1)) for each in conditions)
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

    def evaluate(
        self, x: Real, deviation: Sequence[Real | float], smoothing: float = 0.0, free: Collection[int] | None = None
    ) -> Weighted:
        """Data and prior at x (p,); `free` as in `Objective.predict`. The prior is about the parameters' own starts."""
        data = self.objective(x, deviation=deviation, smoothing=smoothing, free=free)
        self.objective = self.objective.holding(data.predictions)
        vector, jacobian = data.vector, data.jacobian
        if self.covariance is not None:
            vector, jacobian = self.covariance.whitened(vector), self.covariance.whitened(jacobian)
        vector = np.concatenate([vector, self.prior_rows @ (x - self.centre)])
        return Weighted(vector, np.vstack([jacobian, self.prior_rows]), data)

    def minimise(
        self, x: Real, deviation: Sequence[Real | float], *, smoothing: float = 0.0, limit: int = 40,
        tolerance: float = 1e-6, radius: float = 1.0, fixed: tuple[int, ...] = (),
    ) -> Optimum:
        """The least cost near x, with the indices `fixed` not moved."""
        free = np.setdiff1d(self.free, fixed)
        moved = frozenset(map(int, free))

        def whole(y: Real) -> Real:
            result = x.copy()
            result[free] = y
            return result

        def reduced(y: Real) -> Weighted:
            full = self.evaluate(whole(y), deviation, smoothing, moved)
            return replace(full, jacobian=full.jacobian[:, free])

        minimum = minimise(reduced, x[free], low=self.low[free], high=self.high[free], scale=self.scale[free],
                           inequalities=self.conditions(x, free), radius=radius, tolerance=tolerance, limit=limit,
                           refused=REFUSED)
        self.refusals.extend(minimum.refusals)
        return replace(minimum, x=whole(minimum.x))

    def inside(self, x: Real) -> Real:
        """x (p,), or a point near it strictly inside the admissible set."""
        result, free = x.copy(), self.free
        result[free] = interior(x[free], self.low[free], self.high[free], self.conditions(x, free))
        return result

    def conditions(self, x: Real, free: NDArray[np.int64]) -> list[Inequality]:
        """The inequalities of the parameters `free`, with others at x (p,)."""
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
        """The end of a stage from x (p,). The points have that `deviation` and the stage's own."""
        return self.minimise(x, deviation, smoothing=stage.smoothing * self.middle, limit=stage.limit,
                             tolerance=stage.tolerance, fixed=stage.held)

    def descend(
        self, x: Real, *, first: int = 0, rival: FitDescent | None = None,
        progress: Progress = no_progress,
    ) -> FitDescent:
        """The end of a tempered search from x (p,), from stage `first`.

        It is given up if it is clearly worse than its `rival` at the same stage.
        """
        def solve(stage: ContinuationStage, x: Real) -> Optimum:
            # A smoothed spectrum has as many independent points as widths fit into the band.
            return self.solve(stage, x, [
                stage.deviation * np.sqrt(max(1.0, stage.smoothing * self.middle / _spacing(recording)))
                for recording in self.objective.recordings])

        return tempered(self.schedule, solve, self.inside(x), first=first, rival=rival, worse=WORSE,
                        progress=progress)

    def errors(self, optimum: Optimum) -> Real:
        """Standard errors (p,) at an optimum with its data weights. They are zero for fixed parameters."""
        deviations = np.zeros(self.scale.size)
        deviations[self.free] = standard_errors(optimum.residual.jacobian, self.scale[self.free])
        return deviations


def _spacing(recording: FitRecording) -> float:
    """The distance (Hz) of the points of a recording."""
    return float(np.median(np.diff(recording.measured.frequency)))
