"""The least-squares problem of a fit: weighted data, priors, bounds and matrix inequalities, and descents in it."""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.mesh import MeshError
from workbench.fem.solve import NotConverged
from workbench.files.errors import InputError
from workbench.fitting.admissible import inequalities
from workbench.fitting.constrained import Inequality, Minimum, interior, minimise
from workbench.fitting.covariance import Covariance
from workbench.fitting.objective import Objective, Residual
from workbench.reduced.at_point import NotEnriched

Real = NDArray[np.float64]

#: Half widths of the smoothing, relative to the middle of the band, from far to none.
WIDTHS = (0.03, 0.01, 0.003, 0.0)

#: Relative deviation that a point is given during exploration. It stands for all that the model leaves out, and lets
#: the prior hold what the smoothed spectra cannot see.
EXPLORATION = 0.05

#: A recording is searched on at most about so many of its points.
SEARCHED_POINTS = 241

#: A descent is given up where it costs more than this many times what the best cost at the same smoothing.
WORSE = 2.0

#: Steps at one smoothing. A descent that has not ended by then is in a valley that says little, or in none.
STEPS = 20

#: Where nothing can be predicted.
REFUSED: tuple[type[Exception], ...] = (NotEnriched, NotConverged, MeshError, InputError)

#: What may end one start of several: nothing can be predicted, or nothing there is admissible.
NO_END: tuple[type[Exception], ...] = (*REFUSED, ValueError)


@dataclass(frozen=True, eq=False)
class Weighted:
    """A residual with the prior's rows below: what `minimise` sees."""

    vector: Real
    jacobian: Real
    data: Residual


#: Where a search ended.
Optimum = Minimum[Weighted]


@dataclass(frozen=True, eq=False)
class SmoothedDescent(Optimum):
    """The end of a descent through the smoothed problems.

    ``costs`` by the number of the width, as far as the descent went; ``ended`` is whether that was to no smoothing.
    """

    costs: Mapping[int, float]
    ended: bool


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
        #: What deviates beside the noise of the points, if anything.
        self.covariance: Covariance | None = None

    def on(self, objective: Objective) -> FitSearch:
        """The same problem with its objective predicted in another way."""
        other = copy.copy(self)
        other.objective = objective
        return other

    def under(self, covariance: Covariance | None) -> FitSearch:
        """The same problem with deviations that go together."""
        other = copy.copy(self)
        other.covariance = covariance
        return other

    def thinned(self) -> FitSearch:
        """The same problem with at most about :data:`SEARCHED_POINTS` of each recording's points."""
        return self.on(self.objective.thinned(SEARCHED_POINTS))

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
        """Where :meth:`minimise` begins from x (p,): at x, or near it and strictly inside of what parameters may be."""
        result, free = x.copy(), self.free
        result[free] = interior(x[free], self.low[free], self.high[free], self._conditions(x, free))
        return result

    def _conditions(self, x: Real, free: NDArray[np.int64]) -> list[Inequality]:
        """The inequalities of the parameters of the indices `free`, with the others where x (p,) has them."""
        held = x.copy()
        held[free] = 0.0
        return [Inequality(i.name, i(held), i.slopes[free]) for i in self.inequalities if i.slopes[free].any()]

    def descend(
        self, x: Real, progress: Callable[[], None], *, first: int = 0, rival: SmoothedDescent | None = None
    ) -> SmoothedDescent:
        """From a start through the smoothed problems, from number `first` on, to the recordings themselves.

        What the smoothed spectra cannot see is held by the prior. The descent is given up once it is
        clearly worse than `rival` was at the same width.
        """
        steps, costs, ended = 0, {}, True
        widths = self.widths()
        for number in range(min(first, len(widths) - 1), len(widths)):
            width = widths[number]
            # A smoothed spectrum has as many independent points as widths fit into the band.
            deviation = [EXPLORATION * np.sqrt(max(1.0, width / float(np.median(np.diff(r.measured.frequency)))))
                         for r in self.objective.recordings]
            found = self.minimise(x, deviation, smoothing=width, limit=STEPS, tolerance=1e-4)
            x, steps = found.x, steps + found.iterations
            costs[number] = found.cost
            progress()
            ended = width == 0.0
            if not ended and rival is not None and found.cost > WORSE * rival.costs.get(number, np.inf):
                break
        return SmoothedDescent(x, found.residual, found.cost, found.converged, steps, found.reason, found.refusals,
                               costs,
                               ended)

    def widths(self) -> list[float]:
        """Half widths (Hz) of the smoothed problems: those that a recording's points can show, then none."""
        frequency = self.objective.recordings[0].measured.frequency
        middle, spacing = float(np.mean(frequency[[0, -1]])), float(np.median(np.diff(frequency)))
        return [w * middle for w in WIDTHS if w == 0.0 or w * middle > spacing]
