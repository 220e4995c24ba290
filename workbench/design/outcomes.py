"""Figures at many points at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from workbench.design.model import Evaluator
from workbench.design.uncertainty import Uncertainty

Real = NDArray[np.float64]

#: Points for which a local model is worth making: it costs about as much as twenty evaluations.
WORTH_A_LOCAL_MODEL = 40


@runtime_checkable
class Localised(Protocol):
    """An evaluator with faster ones for points that lie together."""

    def localised(self, points: Real) -> list[tuple[NDArray[np.int64], Evaluator]]:
        """Evaluators for `points` (n, names), with the indices that each is for."""


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
    names = list(uncertainty.names)
    groups: list[tuple[NDArray[np.int64], Evaluator]] = [(np.arange(len(points)), evaluator)]
    if isinstance(evaluator, Localised) and len(points) >= WORTH_A_LOCAL_MODEL:
        # The evaluator has its names in its own order.
        groups = evaluator.localised(points[:, [names.index(name) for name in evaluator.names]])
    labels = tuple(evaluator.figures)
    values = np.full((len(points), len(labels)), np.nan)
    missing: dict[str, Counter[str]] = {}
    error, done = 0.0, 0
    for indices, local in groups:
        for index in indices:
            found = local(uncertainty.values(points[index]))
            values[index] = [found.figures[label] for label in labels]
            for label, reason in found.missing.items():
                missing.setdefault(label, Counter())[reason] += 1
            error = float(np.fmax(error, found.error))
            done += 1
            if progress is not None:
                progress(done / len(points))
    return Outcomes(labels, points, values, missing, error)
