"""Figures at many points at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.design.model import Evaluator
from workbench.design.uncertainty import Uncertainty

Real = NDArray[np.float64]

@dataclass(frozen=True, eq=False)
class Outcomes:
    """Figures at ``points`` (n, inputs): ``values`` (n, figures), NaN where there is none.

    ``missing`` counts, by figure, why there was none; ``error`` is the largest estimated relative error of Z.
    """

    figures: tuple[str, ...]
    points: Real
    values: Real
    missing: Mapping[str, Mapping[str, int]]
    error: float

    def column(self, label: str) -> Real:
        """One figure (n,), SI."""
        return self.values[:, self.figures.index(label)]


def evaluate(
    evaluator: Evaluator, uncertainty: Uncertainty, points: Real, *, progress: Callable[[float], None] | None = None
) -> Outcomes:
    """The figures at `points` (n, inputs), numbers of the inputs of `uncertainty`."""
    labels = tuple(evaluator.figures)
    values = np.full((len(points), len(labels)), np.nan)
    missing: dict[str, Counter[str]] = {}
    error = 0.0
    for index, point in enumerate(points):
        found = evaluator(uncertainty.values(point))
        values[index] = [found.figures[label] for label in labels]
        for label, reason in found.missing.items():
            missing.setdefault(label, Counter())[reason] += 1
        error = float(np.fmax(error, found.error))
        if progress is not None:
            progress((index + 1) / len(points))
    return Outcomes(labels, points, values, missing, error)
