"""Figures at many points at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from workbench.design.evaluation import Evaluation
from workbench.design.model import Evaluator
from workbench.design.uncertainty import Uncertainty
from workbench.fem.solve import one_thread
from workbench.jobs.progress import Progress, no_progress
from workbench.jobs.workers import Workers, itself

Real = NDArray[np.float64]

#: Points that a worker does at a time, up to a second's work. Half as many would double what sending them takes.
PARCEL = 50


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
    evaluator: Evaluator, uncertainty: Uncertainty, points: Real, *, workers: Workers | None = None,
    progress: Progress = no_progress,
) -> Outcomes:
    """The figures at `points` (n, inputs), numbers of the inputs of `uncertainty`, by `workers` or by this process."""
    labels, workers = tuple(evaluator.figures), workers or Workers()
    workers.share(itself, evaluator)
    parcels = [points[at:at + PARCEL] for at in range(0, len(points), PARCEL)]
    found: list[list[Evaluation]] = [[]] * len(parcels)
    finished = 0
    for index, done in workers.completed(
            (index, partial(_evaluated, uncertainty=uncertainty, points=part)) for index, part in enumerate(parcels)):
        found[index] = done.result()
        finished += len(found[index])
        progress("samples", finished / len(points))
    every = [each for parcel in found for each in parcel]
    values = np.array([[each.figures[label] for label in labels] for each in every]).reshape(len(points), len(labels))
    missing: dict[str, Counter[str]] = {}
    for each in every:
        for label, reason in each.missing.items():
            missing.setdefault(label, Counter())[reason] += 1
    return Outcomes(labels, points, values, missing, float(np.fmax.reduce([each.error for each in every], initial=0.0)))


def _evaluated(evaluator: Evaluator, *, uncertainty: Uncertainty, points: Real) -> list[Evaluation]:
    with one_thread():
        return [evaluator(uncertainty.values(point)) for point in points]
