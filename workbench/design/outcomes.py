"""Figures at many points at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from workbench.design.evaluation import Evaluation
from workbench.design.model import Evaluator
from workbench.design.uncertainty import Uncertainty
from workbench.fem.solve import one_thread
from workbench.jobs.memory import is_shortage
from workbench.jobs.progress import Progress, no_progress
from workbench.jobs.workers import Task, Workers, itself

Real = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Points that a worker evaluates at a time, about a second's work: a kill loses at most this for each worker. Half as
#: many would double the share of the time for sending models, some 2 %.
PARCEL = 50


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Figures at ``points`` (n, inputs).

    ``values`` (n, figures) are NaN for figures that do not exist. ``missing`` counts the reasons, by figure. ``error``
    is the largest estimated relative error of Z.
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
    """The figures at `points` (n, inputs), by `workers` or this process.

    The columns of `points` are the inputs of `uncertainty`.
    """
    labels, workers = tuple(evaluator.figures), workers or Workers()
    workers.share(itself, evaluator)
    found: list[Evaluation | None] = [None] * len(points)
    finished = 0
    for rows, done in workers.completed(parcels(np.arange(len(points)), points, uncertainty.names)):
        for row, each in zip(rows, done.result(), strict=True):
            found[row] = each
        finished += len(rows)
        progress("samples", finished / len(points))
    every = [each for each in found if each is not None]
    values = np.array([[each.figures[label] for label in labels] for each in every]).reshape(len(points), len(labels))
    missing: dict[str, Counter[str]] = {}
    for each in every:
        for label, reason in each.missing.items():
            missing.setdefault(label, Counter())[reason] += 1
    return Outcomes(labels, points, values, missing, float(np.fmax.reduce([each.error for each in every], initial=0.0)))


def parcels(rows: Indices, points: Real, names: Sequence[str]) -> Iterator[tuple[Indices, Task[list[Evaluation]]]]:
    """Tasks of a shared evaluator, each with its `rows`.

    A task gives the figures at its `points` (n, numbers), whose columns are `names`.
    """
    for at in np.split(np.arange(len(rows)), range(PARCEL, len(rows), PARCEL)):
        yield rows[at], partial(_evaluated, names=tuple(names), rows=rows[at], points=points[at])


def _evaluated(evaluator: Evaluator, *, names: Sequence[str], rows: Indices, points: Real) -> list[Evaluation]:
    found = []
    with one_thread():
        for row, point in zip(rows, points, strict=True):
            try:
                # By position: radii that coincide have another name in the model.
                found.append(evaluator(dict(zip(evaluator.names, map(float, point), strict=True))))
            except Exception as error:
                if is_shortage(error):
                    raise  # through no fault of this point
                where = ", ".join(f"{name} = {value:.6g}" for name, value in zip(names, point, strict=True))
                raise RuntimeError(f"point {row} ({where}): {error!r}") from error
    return found
