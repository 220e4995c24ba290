"""A study is run: models, points, full solves of some of them, each on the disk as soon as it is finished.

    found = study(read_study("study.toml"), "out/study")
    found.columns["e_ac"]

Every part of a study, one state of the chip and one choice of materials, has one model; workers do a few points of it
at a time. A model is the one on the disk, and each point is worked out alone, so a run that was interrupted ends with
the same table to the last bit.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.design.evaluation import Evaluation
from workbench.design.model import Evaluator
from workbench.design.parts import Models, ReducedModels, StudyPart, parts_of
from workbench.design.plan import Study
from workbench.design.study_folder import FinishedPoints, StudyFolder, opened
from workbench.design.study_result import StudyResult
from workbench.fem.solve import one_thread
from workbench.files.errors import expect
from workbench.files.output import OutputFolder
from workbench.jobs.memory import is_shortage
from workbench.jobs.process import WorkerEnded
from workbench.jobs.progress import PartProgress, Progress, by_part, no_progress
from workbench.jobs.workers import Task, Workers, begin_workers, check_jobs

Real = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Points that a worker does at a time, about a second's work, which a kill loses at most for each worker. Half as many
#: would double the share of the time that goes into sending models, some 2 %.
CHUNK = 50

#: Tasks given to each worker: one waits while one is done.
AHEAD = 2


def study(
    plan: Study,
    folder: Path | str | OutputFolder,
    *,
    jobs: int | None = None,
    executor: Executor | None = None,
    overwrite: bool = False,
    models: Models | None = None,
    progress: Progress = no_progress,
) -> StudyResult:
    """Run a study; `folder` then holds its table as ``study.parquet``, ``study.nc`` and ``study.json``.

    Every finished point is on the disk at once; the same study in the same folder goes on from there.

    Args:
        jobs: how many tasks are worked on at a time, one for each core if None.
        executor: works the points out; processes of this machine if None, or this one where `jobs` is one.
        overwrite: begin anew in a folder that holds another study.
        models: where models come from; `workbench.design.parts.ReducedModels` if None.
        progress: called with a part of the study and what is done for it ("filled: points"), and the share that is.

    Raises:
        InputError: the folder holds another study, or something in the chip, its materials or the ranges.
        NotCovered: a range model needs more full solves than the study allows.
        RuntimeError: a point could not be worked out, or a worker ended.
    """
    expect(plan, Study, reader="read_study", source="study", field="plan")
    jobs = os.cpu_count() or 1 if jobs is None else jobs
    check_jobs(jobs, source="study")
    models, show = models or ReducedModels(), by_part(progress)
    parts = parts_of(plan)
    place = folder if isinstance(folder, OutputFolder) else Path(folder)
    with opened(place, plan, parts, overwrite=overwrite) as kept:
        kept.clear_damaged()
        try:
            with begin_workers(jobs, executor) as workers:
                run = _Run(plan, kept, workers, show)
                for part in parts:
                    run.points_of(part, models)
                run.full_solves(parts, models)
        except WorkerEnded as error:
            left = plan.size - len(kept.rows().index)
            raise RuntimeError(f"{error}; what was finished is on the disk, {left} of {plan.size} points remain: the "
                               "same study in the same folder goes on from there") from error
        found = StudyResult(plan, kept.rows(), kept.full_rows())
        found.write(kept.path)
    return found


#: A function of the result of a piece of work, and the work.
Then = tuple[Callable[[Any], None], Task[Any]]


@dataclass(frozen=True)
class _Run:
    """The run of a study: its plan, its folder, and who does its tasks."""

    plan: Study
    kept: StudyFolder
    workers: Workers
    show: PartProgress

    def points_of(self, part: StudyPart, models: Models) -> None:
        """All points of a part that are not finished yet."""
        left = np.flatnonzero(~np.isin(part.rows, self.kept.rows().index))
        if left.size:
            self.show(part.label, "model", 0.0)
            model = models.model(self.plan, part, self.kept.model(part),
                                 lambda _text, share: self.show(part.label, "model", share))
            # Once for all workers, this process among them: arrays of another layout in memory give other last bits.
            self.workers.share(pickle.loads, pickle.dumps(model, protocol=pickle.HIGHEST_PROTOCOL))
            self._work(self._point_tasks(part, left))
        self.show(part.label, "points", 1.0)

    def _point_tasks(self, part: StudyPart, left: Indices) -> Iterator[Then]:
        names, finished = [axis.name for axis in self.plan.numbers], len(part.rows) - left.size

        def keep(rows: FinishedPoints) -> None:
            nonlocal finished
            self.kept.keep(rows)
            finished += len(rows.index)
            self.show(part.label, "points", finished / len(part.rows))

        self.show(part.label, "points", finished / len(part.rows))
        for at in np.split(left, range(CHUNK, left.size, CHUNK)):
            yield keep, partial(_evaluated, names=names, rows=part.rows[at], points=part.points[at],
                                figures=self.plan.figures)

    def full_solves(self, parts: Sequence[StudyPart], models: Models) -> None:
        """Full solves of some points of the table, drawn by the seed of the sample."""
        count = min(self.plan.confirmed, self.plan.size)
        drawn = np.random.default_rng(self.plan.sampling.seed).choice(self.plan.size, count, replace=False)
        left = np.setdiff1d(drawn, self.kept.full_rows().index)
        finished = count - left.size

        def keep(row: int, found: Evaluation) -> None:
            nonlocal finished
            self.kept.keep_full(FinishedPoints.of([row], [found], self.plan.figures))
            finished += 1
            self.show("confirmed", "full solves", finished / count)

        self.workers.share(None)
        self._work((partial(keep, int(part.rows[at])), partial(models.confirmed, self.plan, part, part.points[at]))
                   for part in parts for at in np.flatnonzero(np.isin(part.rows, left)))

    def _work(self, tasks: Iterable[Then]) -> None:
        """Do all tasks, and the step that follows each as soon as its result is there."""
        for then, done in self.workers.completed(tasks, ahead=AHEAD):
            then(done.result())


def _evaluated(evaluator: Evaluator, *, names: Sequence[str], rows: Indices, points: Real,
               figures: tuple[str, ...]) -> FinishedPoints:
    """The figures at `points` (k, numbers), which are `rows` (k,) of the study's table."""
    found = []
    with one_thread():
        for row, point in zip(rows, points, strict=True):
            try:
                # By place: of radii that coincide the model has another name than the study.
                found.append(evaluator(dict(zip(evaluator.names, map(float, point), strict=True))))
            except Exception as error:
                if is_shortage(error):
                    raise  # through no fault of this point
                where = ", ".join(f"{name} = {value:.6g}" for name, value in zip(names, point, strict=True))
                raise RuntimeError(f"point {row} of the study ({where}): {error!r}") from error
    return FinishedPoints.of(rows, found, figures)
