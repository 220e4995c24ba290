"""A design task as a nonlinear programme: unknowns between 0 and 1, one number to make small, margins to keep above 0.

An unknown is a length over its range; the number is the logarithm of the objective's figure (its negative where that is
to be large), so that it does not depend on units; a margin is the distance to a bound in scales (`workbench.design.
requirement`). Derivatives are exact as far as the evaluator's are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from workbench.design.evaluation import Evaluation
from workbench.design.goal import TOLERANCE, DesignObjective
from workbench.design.model import Evaluator
from workbench.design.requirement import Bound
from workbench.design.variables import VariedNumber
from workbench.fem.dual import Dual

Real = NDArray[np.float64]

#: A margin (in scales) that still counts as kept: a hundredth of the 1 % that a full solve confirms, and far above what
#: a search, or the rounding of lengths to nanometres, leaves of an active bound (some 1e-6).
KEPT = 1e-4

#: Standard deviations that 95 % of a normal law are below: with them every bound holds for 95 % of the chips.
ONE_SIDED = 1.645
#: The smallest common factor of tolerances that counts as one.
NO_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class ScenarioSample:
    """Offsets (SI, by parameter name) of every scenario from the chip as stated, common to all chips that are compared.

    A number that no chip varies has the sample's own values. ``quantile`` on the bad side (0.05: the figure that 95 %
    of the chips reach), None for the mean. ``covariance`` (k, k) of the numbers, SI, in the order of :attr:`names`.
    """

    samples: tuple[Mapping[str, float], ...]
    quantile: float | None
    covariance: Real = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def names(self) -> tuple[str, ...]:
        """The numbers that scenarios move."""
        return tuple(self.samples[0])

    def deviation(self, slopes: Mapping[str, float]) -> float:
        """Standard deviation of a quantity with these `slopes` (by SI unit, by name) over the uncertain numbers."""
        along = np.array([slopes.get(name, 0.0) for name in self.names])
        return float(np.sqrt(along @ self.covariance @ along))

    def weights(self, losses: Real) -> Real:
        """Weights (k,) of the scenarios with which their sum is the quantile, or the mean, of `losses` (k,).

        The quantile is the one of numpy, between the two scenarios beside it; where scenarios change places its
        derivative jumps, and it does not.
        """
        count = len(losses)
        if self.quantile is None:
            return np.full(count, 1.0 / count)
        position = (1.0 - self.quantile) * (count - 1)
        below, share = int(position), position - int(position)
        order = np.argsort(losses, kind="stable")
        found = np.zeros(count)
        found[order[below]] += 1.0 - share
        if share > 0.0:
            found[order[below + 1]] += share
        return found


@dataclass(frozen=True, eq=False)
class ProgrammePoint:
    """A point of a programme.

    ``x`` (n,) the unknowns; ``lengths`` (SI) of these and of all fixed variables; ``objective`` to be small and its
    ``slope`` (n,); ``margins`` (m,) in the order of the bounds and their ``jacobian`` (m, n); ``evaluation`` the
    figures of the nominal chip. Where a figure that is needed does not exist, the numbers are NaN and ``missing`` says
    why.
    """

    x: Real
    lengths: Mapping[str, float]
    objective: float
    slope: Real
    margins: Real
    jacobian: Real
    evaluation: Evaluation
    missing: str = ""

    @property
    def exists(self) -> bool:
        """Whether every figure that is needed does."""
        return not self.missing

    @property
    def violation(self) -> float:
        """The distance (in scales) of the worst margin below zero, 0 where all bounds hold, infinite without figures.
        """
        return float(-min(0.0, *self.margins, 0.0)) if self.exists else math.inf

    @property
    def rank(self) -> tuple[bool, float]:
        """Sorts points: those that keep all bounds by the objective, before all others by their violation."""
        broken = self.violation > KEPT
        return broken, self.violation if broken else self.objective


@dataclass(frozen=True, eq=False)
class NonlinearProgramme:
    """A nonlinear programme on an evaluator: an objective to minimise over lengths, under bounds.

    ``variables`` the unknowns with their ranges; ``fixed`` all other lengths (SI) by name, of which the evaluator gets
    those it knows, and ``held`` those of them that were variables; ``scenarios`` the sample that figures are a quantile
    or a mean over, None for the nominal chip.
    """

    evaluator: Evaluator
    variables: tuple[VariedNumber, ...]
    objective: DesignObjective
    bounds: tuple[Bound, ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    scenarios: ScenarioSample | None = None
    held: Mapping[str, float] = field(default_factory=dict)

    @property
    def low(self) -> Real:
        """(n,) m."""
        return np.array([each.low for each in self.variables])

    @property
    def extent(self) -> Real:
        """(n,) m, from the lowest to the highest length."""
        return np.array([each.high - each.low for each in self.variables])

    def lengths(self, x: Real) -> dict[str, float]:
        """The lengths (m) of the variables at the unknowns `x` (n,), by name, fixed variables included."""
        values = self.low + self.extent * np.clip(x, 0.0, 1.0)
        return {**{each.name: float(value) for each, value in zip(self.variables, values, strict=True)}, **self.held}

    def unknowns(self, lengths: Mapping[str, float]) -> Real:
        """The unknowns (n,) at these lengths (m), the nearest within their ranges."""
        values = np.array([lengths[each.name] for each in self.variables])
        return np.clip((values - self.low) / self.extent, 0.0, 1.0)

    def on_steps(self, x: Real) -> Real:
        """The unknowns (n,) nearest to `x` (n,) at which lengths are on their steps."""
        lengths = self.lengths(x)
        return self.unknowns({each.name: each.round(lengths[each.name]) for each in self.variables})

    def holding(self, lengths: Mapping[str, float]) -> NonlinearProgramme:
        """The programme whose variables among `lengths` (m) stay at these."""
        rest = tuple(each for each in self.variables if each.name not in lengths)
        held = {each.name: lengths[each.name] for each in self.variables if each.name in lengths}
        return replace(self, variables=rest, fixed={**self.fixed, **lengths}, held={**self.held, **held})

    @property
    def sampled(self) -> bool:
        """Whether figures are over the scenarios; tolerances themselves are judged by slopes."""
        return self.objective.figure != TOLERANCE

    def under(self, objective: DesignObjective) -> NonlinearProgramme:
        """The programme with another objective."""
        return replace(self, objective=objective)

    def __call__(self, x: Real, *, gradient: bool = True) -> ProgrammePoint:
        """The point at the unknowns `x` (n,); without derivatives, which are NaN, if no `gradient` is asked for."""
        return self.point(x, self.evaluations(x, gradient=gradient))

    def evaluations(self, x: Real, *, gradient: bool) -> tuple[Evaluation, ...]:
        """The figures at the unknowns `x` (n,): of the nominal chip first, then those of every scenario."""
        values = {**self.fixed, **self.lengths(x)}
        known = {name: values[name] for name in self.evaluator.names if name in values}
        offsets: list[Mapping[str, float]] = [{}]
        if self.scenarios is not None and self.sampled:
            offsets += self.scenarios.samples
        moved = ({name: known.get(name, 0.0) + offset for name, offset in each.items()} for each in offsets)
        # Tolerances are judged by slopes.
        return tuple(self.evaluator({**known, **each}, gradient=gradient or not self.sampled) for each in moved)

    def point(self, x: Real, evaluations: Sequence[Evaluation]) -> ProgrammePoint:
        """The point with the objective, slopes and margins of `evaluations`, those of the unknowns `x` (n,)."""
        lengths, over_scenarios = self.lengths(x), self.scenarios is not None and self.sampled
        nominal, judged = evaluations[0], evaluations[1:] if over_scenarios else evaluations
        missing = next(filter(None, map(self._missing, evaluations)), "")
        n, m = len(self.variables), len(self.bounds)
        if missing:
            return ProgrammePoint(x, lengths, math.nan, np.full(n, math.nan), np.full(m, math.nan),
                                  np.full((m, n), math.nan), nominal, missing)
        units = dict(zip((each.name for each in self.variables), np.diag(self.extent), strict=True))
        known = {name: Dual(value, units.get(name, np.zeros(n))) for name, value in {**self.fixed, **lengths}.items()}
        # Numbers to be small, of every chip that is judged: the loss, and margins with the other sign.
        small = [[self._loss(each), *(bound.margin(known if bound.of_lengths else {
            bound.figure: self._figure(each, bound.figure)}) * -1.0 for bound in self.bounds)] for each in judged]
        values = np.array([[each.value for each in row] for row in small]).T
        weights = np.array([self.scenarios.weights(row) if self.scenarios is not None and over_scenarios else np.ones(1)
                            for row in values])
        slopes = np.einsum("jk,kjn->jn", weights, np.array([[each.gradient for each in row] for row in small]))
        values = (weights * values).sum(axis=1)
        return ProgrammePoint(x, lengths, float(values[0]), slopes[0], -values[1:], -slopes[1:], nominal)

    def _missing(self, evaluation: Evaluation) -> str:
        """Why a figure that is needed does not exist; empty if all do."""
        needed = [self.objective.figure] if self.sampled else []
        needed += [each.figure for each in self.bounds if not each.of_lengths]
        for name in needed:
            if not math.isfinite(evaluation.figures[name]):
                return f"{name}: {evaluation.missing.get(name, 'not a number')}"
        if not self.sampled:
            return ""
        value = evaluation.figures[self.objective.figure]
        return "" if value > 0.0 else f"{self.objective.figure}: {value:g} is not above zero"

    def _loss(self, evaluation: Evaluation) -> Dual:
        if not self.sampled:
            tolerance = max(self._tolerance(evaluation), NO_TOLERANCE)
            return Dual(-math.log(tolerance), np.full(len(self.variables), math.nan))
        sign, figure = -1.0 if self.objective.maximise else 1.0, self._figure(evaluation, self.objective.figure)
        return Dual(sign * math.log(figure.value), sign * figure.gradient / figure.value)

    def _tolerance(self, evaluation: Evaluation) -> float:
        """The largest factor of all tolerances with which every bound of a figure still holds for 95 % of the chips, by
        slopes; zero or less where one does not hold for the chip itself."""
        assert self.scenarios is not None
        assert evaluation.gradient is not None
        found = [math.inf]
        for bound in self.bounds:
            if not bound.of_lengths:
                name = bound.figure
                margin = bound.margin({name: Dual(evaluation.figures[name], evaluation.gradient[name])})
                deviation = self.scenarios.deviation(dict(zip(self.evaluator.names, margin.gradient, strict=True)))
                if deviation > 0.0:
                    found.append(margin.value / (ONE_SIDED * deviation))
        return min(found)

    def _figure(self, evaluation: Evaluation, name: str) -> Dual:
        """A figure with its derivatives (n,) by the unknowns, NaN of an evaluation without them."""
        slopes = np.full(len(self.variables), math.nan)
        if evaluation.gradient is not None:
            by_name = dict(zip(self.evaluator.names, evaluation.gradient[name], strict=True))
            slopes = np.array([by_name[each.name] for each in self.variables]) * self.extent
        return Dual(evaluation.figures[name], slopes)
