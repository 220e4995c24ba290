"""Runs a study: its models, its points, and full solves of some.

    found = study(read_study("study.toml"), "out/study")
    found.columns["e_ac"]

Every part of a study, one state of the chip and one choice of materials, has one model, and workers evaluate a few of
its points at a time. Everything finished is saved at once. Models are read back from the disk and each point is
computed independently, so an interrupted run that continues gives the same table to the last bit.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path

import numpy as np

from workbench.design.outcomes import parcels
from workbench.design.parts import Models, ReducedModels, StudyPart, parts_of
from workbench.design.plan import Study
from workbench.design.study_folder import FULL, FinishedPoints, StudyFolder, opened
from workbench.design.study_result import StudyResult
from workbench.files.errors import expect
from workbench.files.output import OutputFolder
from workbench.jobs.process import WorkerEnded
from workbench.jobs.progress import Progress, by_part, no_progress
from workbench.jobs.workers import Workers, begin_workers, check_jobs

#: Tasks given to each worker: one waits while one runs.
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
    """Run a study and save its table in `folder`.

    The files are ``study.parquet``, ``study.nc`` and ``study.json``. Every finished point is saved at once; the same
    study in the same folder continues from there.

    Args:
        jobs: the number of tasks at a time, one for each core if None.
        executor: computes the points; processes of this machine if None, or this process if `jobs` is one.
        overwrite: begin anew in a folder that contains another study.
        models: the source of models; `workbench.design.parts.ReducedModels` if None.
        progress: called with a part of the study, its present task ("filled: points"), and the share that is done.

    Raises:
        InputError: the folder contains another study, or something in the chip, its materials or the ranges.
        NotCovered: a range model needs more full solves than the study allows.
        RuntimeError: a point could not be computed, or a worker ended.
    """
    expect(plan, Study, reader="read_study", source="study", field="plan")
    jobs = os.cpu_count() or 1 if jobs is None else jobs
    check_jobs(jobs, source="study", elsewhere=executor is not None)
    models, show = models or ReducedModels(), by_part(progress)
    parts = parts_of(plan)
    place = folder if isinstance(folder, OutputFolder) else Path(folder)
    with opened(place, plan, parts, overwrite=overwrite) as kept:
        kept.clear_damaged()
        try:
            with begin_workers(jobs, executor) as workers:
                for part in parts:
                    _points_of(plan, part, models, kept, workers, partial(show, part.label))
                _full_solves(plan, parts, models, kept, workers, partial(show, "confirmed", "full solves"))
        except WorkerEnded as error:
            left = plan.size - len(kept.rows().index)
            raise RuntimeError(f"{error}; finished points are on the disk, {left} of {plan.size} points remain: run "
                               "the same study in the same folder to continue") from error
        found = StudyResult(plan, kept.rows(), kept.rows(FULL))
        found.write(kept.path)
    return found


def _points_of(
    plan: Study, part: StudyPart, models: Models, kept: StudyFolder, workers: Workers,
    show: Callable[[str, float], None],
) -> None:
    """Compute all points of a part that are not finished yet."""
    left = np.flatnonzero(~np.isin(part.rows, kept.rows().index))
    if left.size:
        show("model", 0.0)
        model = models.model(plan, part, kept.model(part), lambda _text, share: show("model", share))
        # Once for all workers and this process: another memory layout of the arrays gives other last bits.
        workers.share(pickle.loads, pickle.dumps(model, protocol=pickle.HIGHEST_PROTOCOL))
        finished = len(part.rows) - left.size
        show("points", finished / len(part.rows))
        for rows, done in workers.completed(
                parcels(part.rows[left], part.points[left], [axis.name for axis in plan.numbers]), ahead=AHEAD):
            kept.keep(FinishedPoints.of(rows, done.result(), plan.figures))
            finished += len(rows)
            show("points", finished / len(part.rows))
    show("points", 1.0)


def _full_solves(
    plan: Study, parts: Sequence[StudyPart], models: Models, kept: StudyFolder, workers: Workers,
    show: Callable[[float], None],
) -> None:
    """Solve some points of the table in full.

    They are drawn with the seed of the sample.
    """
    count = min(plan.confirmed, plan.size)
    drawn = np.random.default_rng(plan.sampling.seed).choice(plan.size, count, replace=False)
    left = np.setdiff1d(drawn, kept.rows(FULL).index)
    workers.share(None)
    tasks = ((int(part.rows[at]), partial(models.confirmed, plan, part, part.points[at]))
             for part in parts for at in np.flatnonzero(np.isin(part.rows, left)))
    for finished, (row, done) in enumerate(workers.completed(tasks, ahead=AHEAD), count - left.size + 1):
        kept.keep(FinishedPoints.of([row], [done.result()], plan.figures), FULL)
        show(finished / count)
