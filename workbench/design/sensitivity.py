"""Sensitivities of every figure of a chip to every number.

They are local, at the chip as stated, or over its uncertainty. Derivatives are exact ones of full solves
(`workbench.design.model.full_evaluation`). The change of a figure is given for the standard uncertainty of each number,
or for :data:`SHARE` of the number if none is stated. Sobol indices give the share of a figure's variance that a number
causes, alone (first order) and with all others (total).

(`workbench sensitivity` answers another question: which constants of a free disc its spectrum determines, as in the
paper.)
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.design.evaluation import Evaluation
from workbench.design.model import Evaluator
from workbench.design.outcomes import evaluate
from workbench.design.uncertainty import Uncertainty
from workbench.files.errors import InputError
from workbench.jobs.progress import Progress, no_progress
from workbench.jobs.workers import Workers
from workbench.model.numbers import Number

Real = NDArray[np.float64]

#: Relative change of a number without a stated uncertainty: the unit of its influence.
SHARE = 0.01

#: Confidence of the intervals of Sobol indices.
CONFIDENCE = 0.95


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Exact first-order sensitivities of figures at ``nominal`` numbers.

    ``steps`` (k,) SI are the standard uncertainties of the numbers ``names``, or :data:`SHARE` of them if not
    ``stated``. ``figures`` are SI by label, ``gradient`` (k,) SI per SI by label. ``missing`` has the reasons for
    figures that do not exist.
    """

    names: tuple[str, ...]
    nominal: Mapping[str, float]
    steps: Real
    stated: tuple[bool, ...]
    figures: Mapping[str, float]
    gradient: Mapping[str, Real]
    missing: Mapping[str, str] = field(default_factory=dict)

    def changes(self, label: str) -> Real:
        """The first-order change (k,) of the figure for each step."""
        return self.gradient[label] * self.steps

    def ranked(self, label: str) -> list[int]:
        """The numbers by their effect on the figure, largest first.

        Numbers of unknown effect are last.
        """
        size = np.abs(self.changes(label))
        return sorted(range(len(self.names)), key=lambda k: -size[k] if math.isfinite(size[k]) else math.inf)

    def deviation(self, label: str, uncertainty: Uncertainty) -> float:
        """The standard uncertainty of the figure to first order.

        Correlations are included.
        """
        slopes = np.array([self.gradient[label][self.names.index(name)] for name in uncertainty.names])
        return float(np.sqrt(max(slopes @ uncertainty.covariance @ slopes, 0.0)))


def sensitivities(found: Evaluation, uncertainty: Uncertainty) -> Sensitivities:
    """The sensitivities of an evaluation with gradients.

    Raises:
        ValueError: it has none.
    """
    if found.gradient is None:
        raise ValueError("sensitivities need an evaluation with gradients")
    known = {each.name: each.deviation for each in uncertainty.inputs}
    steps = np.array([known.get(name, SHARE * abs(number)) for name, number in found.values.items()])
    return Sensitivities(tuple(found.values), dict(found.values), steps, tuple(name in known for name in found.values),
                         dict(found.figures), dict(found.gradient), dict(found.missing))


@dataclass(frozen=True, eq=False)
class SobolIndices:
    """Sobol indices: shares of the variance of figures, over independent numbers.

    ``first`` and ``total`` (figures, inputs) have the ends of their intervals in ``_low`` and ``_high``, at
    :data:`CONFIDENCE`. They are NaN for a figure that does not exist at some of the points, or never changes.
    ``evaluations`` counts the evaluations.
    """

    figures: tuple[str, ...]
    names: tuple[str, ...]
    first: Real
    first_low: Real
    first_high: Real
    total: Real
    total_low: Real
    total_high: Real
    evaluations: int


def check_sobol(uncertainty: Uncertainty, count: int, *, source: str, field: str) -> None:
    """Raise if Sobol indices are not defined for the request.

    Raises:
        InputError: correlated inputs, no inputs, or a count that is not a power of two.
    """
    if count < 2 or count & (count - 1):
        below = 2 ** max(1, int(math.log2(max(count, 2))))
        raise InputError(source, field, count, "a power of two, which the points of Sobol's sequence come in",
                         (str(below), str(2 * below)))
    if not uncertainty.inputs:
        raise InputError(source, field, count, "numbers that are uncertain; none is")
    if uncertainty.correlated:
        raise InputError(source, field, count, "independent numbers: shares of the variance are not defined for "
                         "correlated ones, and a fit correlates "
                         + ", ".join(each.name for each in uncertainty.correlated)
                         + "; state the uncertainty of all but one of them yourself, or leave the indices out")


def sobol(
    evaluator: Evaluator, uncertainty: Uncertainty, count: int, *, seed: int = 0, workers: Workers | None = None,
    progress: Progress = no_progress,
) -> SobolIndices:
    """Sobol indices with bootstrap intervals (Saltelli 2010).

    They need `count` (2 + inputs) evaluations.

    Raises:
        InputError: see :func:`check_sobol`.
    """
    from scipy.stats import DegenerateDataWarning, sobol_indices

    check_sobol(uncertainty, count, source="sobol", field="count")
    size, asked, seen = len(uncertainty.inputs), tuple(evaluator.figures), list[Real]()

    def outcome(points: Real) -> Real:
        # One row an input; scipy requests A, B, and A with the columns of B, all at once.
        before, whole = sum(map(len, seen)), count * (2 + size)
        seen.append(evaluate(evaluator, uncertainty, points.T, workers=workers, progress=lambda _text, share: progress(
            "Sobol indices", (before + share * points.shape[1]) / whole)).values)
        return seen[-1].T

    # An index that is the same in every resample has no interval: scipy warns of it.
    with np.errstate(invalid="ignore", divide="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", DegenerateDataWarning)
        found = sobol_indices(func=outcome, n=count, dists=[_distribution(each) for each in uncertainty.inputs],
                              rng=np.random.default_rng(seed))
        spread = found.bootstrap(confidence_level=CONFIDENCE)
    values = np.concatenate(seen)
    # For these scipy gives 0.
    unknown = ~np.isfinite(values).all(axis=0) | (np.ptp(values, axis=0) == 0.0)

    def rows(indices: object) -> Real:
        return np.where(unknown[:, None], np.nan, np.asarray(indices, dtype=float).reshape(len(asked), size))

    tables: dict[str, Real] = {}
    for name in ("first", "total"):
        tables[name] = rows(getattr(found, f"{name}_order"))
        interval = getattr(spread, f"{name}_order").confidence_interval
        for end, each in (("low", rows(interval.low)), ("high", rows(interval.high))):
            tables[f"{name}_{end}"] = np.where(np.isnan(each), tables[name], each)
    return SobolIndices(asked, uncertainty.names, evaluations=len(values), **tables)


def _distribution(each: Number) -> Any:
    """The law of an input as a scipy distribution, truncated likewise."""
    from scipy.stats import truncnorm, uniform

    if each.law == "uniform":
        return uniform(loc=each.low, scale=each.high - each.low)
    low, high = ((end - each.value) / each.deviation for end in (each.low, each.high))
    return truncnorm(low, high, loc=each.value, scale=each.deviation)


def names_to_ask(uncertainty: Uncertainty, known: Sequence[str], *, every: bool) -> tuple[str, ...]:
    """The numbers whose influence is computed.

    The uncertain ones come first. All others that are `known` follow if `every`, or if none is uncertain.
    """
    rest = [name for name in known if name not in uncertainty.names] if every or not uncertainty.inputs else []
    return (*uncertainty.names, *rest)
