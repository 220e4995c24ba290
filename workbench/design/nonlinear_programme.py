"""A design task as a nonlinear programme: unknowns, objective and margins.

An unknown is a length scaled to its range, from 0 to 1. The objective to minimise is the logarithm of the figure (its
negative to maximise the figure), so that it does not depend on units. A margin is the distance to a bound in scales
(`workbench.design.requirement`), and must not be negative. Derivatives are as exact as the evaluator's.
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

#: Largest violation (in scales) of a bound that counts as satisfied: a hundredth of the 1 % that a full solve confirms,
#: and far above the residual of a search, or of rounding lengths to nanometres, at an active bound (some 1e-6).
KEPT = 1e-4

#: Standard deviations of the one-sided 95 % quantile of a normal law.
ONE_SIDED = 1.645
#: The smallest common factor of tolerances: smaller ones count as this one.
NO_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class ScenarioSample:
    """Scenarios as offsets (SI, by parameter name) from the nominal chip.

    The offsets are common to all chips that are compared. A number that is not a variable of the chips has the sample's
    own values. ``quantile`` is on the bad side (0.05: the figure that 95 % of the chips reach), None for the mean.
    ``covariance`` (k, k) is that of the numbers, SI, in the order of :attr:`names`.
    """

    samples: tuple[Mapping[str, float], ...]
    quantile: float | None
    covariance: Real = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def names(self) -> tuple[str, ...]:
        """The numbers that scenarios vary."""
        return tuple(self.samples[0])

    def deviation(self, slopes: Mapping[str, float]) -> float:
        """The standard deviation of a quantity over the uncertain numbers.

        `slopes` are its derivatives by SI unit, by name.
        """
        along = np.array([slopes.get(name, 0.0) for name in self.names])
        return float(np.sqrt(along @ self.covariance @ along))

    def weights(self, losses: Real) -> Real:
        """The weights (k,) of the scenarios for the quantile, or mean.

        The weighted sum of `losses` (k,) is that quantile or mean. The quantile is interpolated as in numpy; where
        scenarios change order its derivative jumps, but its value does not.
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

    ``x`` (n,) are the unknowns; ``lengths`` (SI) those of all variables, fixed ones included. ``objective`` is to be
    minimised, ``slope`` (n,) is its gradient. ``margins`` (m,) are in the order of the bounds, with the ``jacobian``
    (m, n). ``evaluation`` has the figures of the nominal chip. If a figure that is needed does not exist, the numbers
    are NaN and ``missing`` has the reason.
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
        """Whether every figure that is needed exists."""
        return not self.missing

    @property
    def violation(self) -> float:
        """The distance (in scales) of the worst margin below zero.

        It is 0 if all bounds are satisfied, and infinite without figures.
        """
        return float(-min(0.0, *self.margins, 0.0)) if self.exists else math.inf

    @property
    def rank(self) -> tuple[bool, float]:
        """The key that sorts points, best first.

        Feasible points are sorted by the objective, and come before all others, which are sorted by their violation.
        """
        broken = self.violation > KEPT
        return broken, self.violation if broken else self.objective


@dataclass(frozen=True, eq=False)
class NonlinearProgramme:
    """A nonlinear programme on an evaluator: minimise an objective under bounds.

    ``variables`` are the unknown lengths with their ranges. ``fixed`` are all other lengths (SI) by name, of which the
    evaluator gets those it knows; ``held`` are those of them that were variables. ``scenarios`` is the sample over
    which figures are a quantile or a mean, None for the nominal chip.
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
        """The lower ends (n,) of the ranges, in metres."""
        return np.array([each.low for each in self.variables])

    @property
    def extent(self) -> Real:
        """The widths (n,) of the ranges, in metres."""
        return np.array([each.high - each.low for each in self.variables])

    def lengths(self, x: Real) -> dict[str, float]:
        """The lengths (m) by name at the unknowns `x` (n,).

        Fixed variables are included.
        """
        values = self.low + self.extent * np.clip(x, 0.0, 1.0)
        return {**{each.name: float(value) for each, value in zip(self.variables, values, strict=True)}, **self.held}

    def unknowns(self, lengths: Mapping[str, float]) -> Real:
        """The unknowns (n,) at these lengths (m), clipped to their ranges."""
        values = np.array([lengths[each.name] for each in self.variables])
        return np.clip((values - self.low) / self.extent, 0.0, 1.0)

    def on_steps(self, x: Real) -> Real:
        """The unknowns (n,) nearest to `x` (n,) with lengths on their steps."""
        lengths = self.lengths(x)
        return self.unknowns({each.name: each.round(lengths[each.name]) for each in self.variables})

    def holding(self, lengths: Mapping[str, float]) -> NonlinearProgramme:
        """The programme with these `lengths` (m) fixed."""
        rest = tuple(each for each in self.variables if each.name not in lengths)
        held = {each.name: lengths[each.name] for each in self.variables if each.name in lengths}
        return replace(self, variables=rest, fixed={**self.fixed, **lengths}, held={**self.held, **held})

    @property
    def sampled(self) -> bool:
        """Whether figures are evaluated over the scenarios.

        The objective "tolerance" uses gradients instead.
        """
        return self.objective.figure != TOLERANCE

    def under(self, objective: DesignObjective) -> NonlinearProgramme:
        """The programme with another objective."""
        return replace(self, objective=objective)

    def __call__(self, x: Real, *, gradient: bool = True) -> ProgrammePoint:
        """The point at the unknowns `x` (n,).

        Derivatives are NaN without `gradient`.
        """
        return self.point(x, self.evaluations(x, gradient=gradient))

    def evaluations(self, x: Real, *, gradient: bool) -> tuple[Evaluation, ...]:
        """The figures at the unknowns `x` (n,).

        Those of the nominal chip are first, then those of every scenario.
        """
        values = {**self.fixed, **self.lengths(x)}
        known = {name: values[name] for name in self.evaluator.names if name in values}
        offsets: list[Mapping[str, float]] = [{}]
        if self.scenarios is not None and self.sampled:
            offsets += self.scenarios.samples
        moved = ({name: known.get(name, 0.0) + offset for name, offset in each.items()} for each in offsets)
        # Tolerances need gradients.
        return tuple(self.evaluator({**known, **each}, gradient=gradient or not self.sampled) for each in moved)

    def point(self, x: Real, evaluations: Sequence[Evaluation]) -> ProgrammePoint:
        """The point at the unknowns `x` (n,), from its `evaluations`."""
        lengths, over_scenarios = self.lengths(x), self.scenarios is not None and self.sampled
        nominal, judged = evaluations[0], evaluations[1:] if over_scenarios else evaluations
        missing = next(filter(None, map(self._missing, evaluations)), "")
        n, m = len(self.variables), len(self.bounds)
        if missing:
            return ProgrammePoint(x, lengths, math.nan, np.full(n, math.nan), np.full(m, math.nan),
                                  np.full((m, n), math.nan), nominal, missing)
        units = dict(zip((each.name for each in self.variables), np.diag(self.extent), strict=True))
        known = {name: Dual(value, units.get(name, np.zeros(n))) for name, value in {**self.fixed, **lengths}.items()}
        # Quantities to minimise, for every chip: the loss, and the negative margins.
        small = [[self._loss(each), *(bound.margin(known if bound.of_lengths else {
            bound.figure: self._figure(each, bound.figure)}) * -1.0 for bound in self.bounds)] for each in judged]
        values = np.array([[each.value for each in row] for row in small]).T
        weights = np.array([self.scenarios.weights(row) if self.scenarios is not None and over_scenarios else np.ones(1)
                            for row in values])
        slopes = np.einsum("jk,kjn->jn", weights, np.array([[each.gradient for each in row] for row in small]))
        values = (weights * values).sum(axis=1)
        return ProgrammePoint(x, lengths, float(values[0]), slopes[0], -values[1:], -slopes[1:], nominal)

    def _missing(self, evaluation: Evaluation) -> str:
        """The reason for a missing figure; empty if none is missing."""
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
        """The largest common factor of all tolerances.

        With it, every bound of a figure is satisfied for 95 % of the chips, by linearisation. It is zero or less if the
        nominal chip violates a bound.
        """
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
        """A figure with its derivatives (n,) by the unknowns.

        They are NaN if the evaluation has none.
        """
        slopes = np.full(len(self.variables), math.nan)
        if evaluation.gradient is not None:
            by_name = dict(zip(self.evaluator.names, evaluation.gradient[name], strict=True))
            slopes = np.array([by_name[each.name] for each in self.variables]) * self.extent
        return Dual(evaluation.figures[name], slopes)
