"""A small model for one number that is being moved while all others rest: a spectrum in some ten milliseconds.

While a slider is dragged, the states run along one line through the ranges, and lie close to a space a third the size
of the range model's (on the reference chip 90 vectors of 250).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from workbench.fitting.predict import Prediction
from workbench.parameter_names import placed
from workbench.ranges import RangeModel, Response
from workbench.reduction import ReducedModel, narrowed

#: Points of the line at which states are taken, and how many frequencies of the model's are left out between two.
POINTS, EVERY = 9, 3
#: Up to so many unknowns a range model itself answers within some ten milliseconds.
SMALL = 100
#: Directions smaller than this, relative to the largest, are left out, of states over the root of their charge. On the
#: reference chip the impedance is then off by 4e-4 at most; at three times as much by 5e-3.
NEGLIGIBLE = 1e-3


@dataclass(frozen=True, eq=False)
class Line:
    """The part of a range ``model`` that is needed while the number ``name`` moves and the ``others`` rest (SI)."""

    model: RangeModel
    name: str
    others: Mapping[str, float]
    reduced: ReducedModel

    def holds(self, model: RangeModel, values: Mapping[str, float]) -> bool:
        """Whether `values` of `model` lie on the line."""
        low, high = self.model.ranges[self.name]
        return model is self.model and rest(values, self.name) == self.others and low <= values[self.name] <= high

    def __call__(self, values: Mapping[str, float]) -> Response:
        """The spectrum at `values` on the line."""
        there = placed(self.model.problem.values, values)
        return Response(values, Prediction(self.reduced.solve(self.model.frequency, there), self.reduced, there))


def line_model(
    model: RangeModel, name: str, values: Mapping[str, float], stopped: Callable[[], bool] = lambda: False
) -> Line | None:
    """The line of `model` through `values` (SI) along `name`; None for a :data:`SMALL` model, where the line is off by
    more than the model's tolerance, and once `stopped`.

    What it is off by is found out half way between the points that it was made of.
    """
    if model.rank <= SMALL:
        return None
    low, high = model.ranges[name]
    watched = model.frequency[::EVERY]
    compact = model.compact
    points = np.linspace(low, high, POINTS)
    states = []
    for number in points:
        if stopped():
            return None
        found = compact.solve(watched, placed(model.problem.values, {**values, name: float(number)}))
        states.append(found.states / np.sqrt(np.abs(found.charge)))
    line = Line(model, name, rest(values, name), narrowed(compact, np.concatenate(states, axis=1), NEGLIGIBLE))
    for number in 0.5 * (points[1:] + points[:-1])[[0, POINTS // 2, -1]]:
        there = placed(model.problem.values, {**values, name: float(number)})
        off = np.abs(line.reduced.solve(watched, there).impedance / compact.solve(watched, there).impedance - 1.0)
        if off.max() > model.tolerance:
            return None
    return line


def rest(values: Mapping[str, float], name: str) -> dict[str, float]:
    """`values` without that of `name`."""
    return {other: number for other, number in values.items() if other != name}
