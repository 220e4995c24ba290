"""Small models near the present values, for spectra in some ten milliseconds.

While one slider moves, the states are along one line through the ranges, and near a space with a third of the dimension
of the range model. On the reference chip, 90 of 250 unknowns are needed along the whole range of one parameter, and 80
for an eighth of the range of any one of seven.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from workbench.fem.solve import Solution
from workbench.model.numbers import placed
from workbench.reduced.model import ReducedModel
from workbench.reduced.predictor import Prediction
from workbench.reduced.ranges import RangeModel, Ranges, Response

#: Number of states, besides the centre, along the range of one parameter, and for each of several parameters; and the
#: step in frequencies of the model.
ALONG, AROUND, EVERY = 9, 2, 3
#: Half width of the range of a local model, relative to the range of the range model.
NEAR_SHARE = 0.125
#: Largest number of unknowns of a range model that answers within some ten milliseconds.
SMALL_RANK = 100
#: Relative error of Z due to truncation of the basis.
LEFT_OUT = 1e-3


@dataclass(frozen=True, eq=False)
class LocalModel:
    """A part of a range ``model``, with one moving parameter. Others stay at ``centre`` (SI); the moving one stays
    within its bounds in ``reach`` (SI)."""

    model: RangeModel
    centre: Mapping[str, float]
    reach: Ranges
    reduced: ReducedModel

    def holds(self, model: RangeModel, values: Mapping[str, float]) -> bool:
        """Whether this model is valid for `values` of `model`."""
        moved = [name for name, number in values.items() if number != self.centre[name]]
        if model is not self.model or len(moved) > 1:
            return False
        return all(name in self.reach and self.reach[name][0] <= values[name] <= self.reach[name][1] for name in moved)

    def __call__(self, values: Mapping[str, float]) -> Response:
        """The spectrum at `values` for which it is valid."""
        there = placed(self.model.problem.values, values)
        return Response(values, Prediction(self.reduced.solve(self.model.frequency, there), self.reduced, there))


def in_halves(model: RangeModel, values: Mapping[str, float]) -> Response:
    """The answer of a range model, by two threads. Each solves half of the band."""
    there = placed(model.problem.values, values)
    compact, middle = model.compact, model.frequency.size // 2 + 1
    with ThreadPoolExecutor(2) as pool:
        below, above = pool.map(lambda part: compact.solve(part, there),
                                (model.frequency[:middle], model.frequency[middle:]))
    groups = compact.operators.coefficients.groups(2.0 * np.pi * model.frequency, there)
    states = np.concatenate([below.states, above.states], axis=1)
    charge = np.concatenate([below.charge, above.charge])
    residual = np.concatenate([below.residual, above.residual])
    solution = Solution(compact.operators, model.frequency, groups, states, charge, residual)
    return Response(values, Prediction(solution, compact, there))


def along(model: RangeModel, name: str) -> Ranges:
    """The reach of a local model over the range of one parameter."""
    return {name: model.ranges[name]}


def local_ranges(model: RangeModel, centre: Mapping[str, float]) -> Ranges:
    """The reach of a local model for any parameter near `centre` (SI)."""
    return {name: (max(low, centre[name] - NEAR_SHARE * (high - low)),
                   min(high, centre[name] + NEAR_SHARE * (high - low)))
            for name, (low, high) in model.ranges.items()}


def local_model(
    model: RangeModel, centre: Mapping[str, float], reach: Ranges, stopped: Callable[[], bool] = lambda: False
) -> LocalModel | None:
    """The local model about `centre` (SI), or None. None for a range model of :data:`SMALL_RANK`, for an error above
    the range model's tolerance, and once `stopped`. The error is measured between the points of the basis."""
    if model.rank <= SMALL_RANK:
        return None
    watched, compact = model.frequency[::EVERY], model.compact
    count = ALONG if len(reach) == 1 else AROUND
    points = [{**centre, name: float(number)} for name, ends in reach.items() for number in np.linspace(*ends, count)]
    states = []
    for values in (centre, *points):
        if stopped():
            return None
        states.append(compact.states(watched, placed(model.problem.values, values)))
    made = LocalModel(model, dict(centre), reach, compact.truncated(np.concatenate(states, axis=1), LEFT_OUT))
    for name, (low, high) in reach.items():
        if stopped():
            return None
        number = high - 0.5 * (high - max(centre[name], high - (high - low) / (count - 1)))
        there = placed(model.problem.values, {**centre, name: float(number)})
        off = np.abs(made.reduced.solve(watched, there).impedance / compact.solve(watched, there).impedance - 1.0)
        if off.max() > model.relative_error:
            return None
    return made
