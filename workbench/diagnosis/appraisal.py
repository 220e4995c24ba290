"""Diagnosis of a campaign: search, decision, and the next measurements."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from workbench.campaign.assignment import check_assignment
from workbench.campaign.campaign import Campaign
from workbench.diagnosis.conclusion import conclude, evidence, not_finished
from workbench.diagnosis.decision import MISSING, UNEXPLAINED
from workbench.diagnosis.description import remainder_description
from workbench.diagnosis.device import Model, device_model
from workbench.diagnosis.findings import Found, NotTried
from workbench.diagnosis.inference import DiagnosisSearch
from workbench.diagnosis.local_models import LocalModels
from workbench.diagnosis.next_measurement import options
from workbench.diagnosis.not_round import NotRoundFound, Without, can_be_located, located, tapered
from workbench.diagnosis.observed import NotObservable
from workbench.diagnosis.odds import Criteria
from workbench.diagnosis.outcome import Diagnosis
from workbench.fem.solve import NotConverged, one_thread
from workbench.files.errors import InputError, expect
from workbench.jobs.process import WorkerEnded
from workbench.jobs.progress import Progress, no_progress
from workbench.jobs.workers import Workers, begin_workers, check_jobs
from workbench.model.discretisation import ACCURACY, Discretisation
from workbench.simulation.features import OrdersNotConverged
from workbench.simulation.taper import TaperNotConverged


def diagnose(
    campaign: Campaign, *, accuracy: float | Discretisation = ACCURACY,
    progress: Progress = no_progress, jobs: int = 1, executor: Executor | None = None, minutes: float | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> Diagnosis:
    """Explain or describe the mismatch between recordings and models.

    Interrupted once, or when its time is over, it ends with its results so far.

    Args:
        accuracy: of the meshes, see `discretisation`.
        progress: called with the present step and the share of the work that is done.
        jobs: processes that share the work, this one among them.
        executor: shares the work in place of the other processes, `jobs` tasks at a time.
        minutes: after which no task begins; None for no limit.
        clock: of these minutes, in s; `time.process_time` where other programs share the processor.

    Raises:
        InputError: fewer than one job, states that cannot be modelled as they are stated, or recordings that seem to
            be exchanged between them.
        MeshError: a mesh could not be made.
        NotEnriched: the device as it is stated cannot be predicted.
        ValueError: no time.
        RuntimeError: a process that shares the work ended before it was done.
    """
    check_jobs(jobs, source="diagnose", elsewhere=executor is not None)
    expect(campaign, Campaign, reader="read_campaign", source="diagnose", field="campaign")
    if minutes is not None and not minutes > 0.0:
        raise ValueError(f"minutes {minutes}: expected more than no time")
    with begin_workers(jobs, executor, beside=1) as workers:
        if workers.size:
            workers.share(DiagnosisSearch.of_campaign, campaign, accuracy)
        made = device_model(campaign, accuracy=accuracy)
        try:
            return diagnose_model(made, progress=progress, workers=workers, minutes=minutes, clock=clock)
        except WorkerEnded as error:
            raise RuntimeError(f"{error}; the diagnosis is not finished, and has to be made again, with fewer jobs if "
                               "memory is short") from error


@one_thread()
def diagnose_model(
    model: Model, *, progress: Progress = no_progress, workers: Workers | None = None,
    minutes: float | None = None, clock: Callable[[], float] = time.perf_counter,
) -> Diagnosis:
    """:func:`diagnose` of a model, on one thread. The last digits depend on the number of threads."""
    started = time.perf_counter()
    search = DiagnosisSearch(model, progress, until=None if minutes is None else clock() + 60.0 * minutes, clock=clock,
                             criteria=Criteria(mesh=model.accuracy if isinstance(model.accuracy, float) else 0.0))
    try:
        check_assignment(model.campaign, search.models.stated[:len(model.campaign.fitted)])
        results = search.run(workers)
    except NotObservable as error:
        observation, _, reason = str(error).partition(": ")
        raise InputError(model.campaign.file, "observations", observation, "an observation that the chip as stated can "
                         f"have: {reason}; state another frequency or a stronger drive, or leave it out") from error
    diagnosis = appraised(model, results, criteria=search.criteria, started=started)
    description = remainder_description(model, diagnosis.found, diagnosis.decision, diagnosis.criteria)
    if diagnosis.verdict == UNEXPLAINED and not search.is_over and can_be_located(model):
        diagnosis = with_cause_not_round(diagnosis, search.models, progress)
    return replace(diagnosis, description=description, seconds=time.perf_counter() - started)


def with_cause_not_round(diagnosis: Diagnosis, models: LocalModels, progress: Progress) -> Diagnosis:
    """A diagnosis with the likeliest causes that are not round.

    They are a taper and a part beside the axis. If one of them is accepted, it is the verdict; of both, the likelier
    one.
    """
    searches: dict[str, Callable[[Without, Progress], NotRoundFound]] = {
        "a taper": tapered, "a part beside the axis": located}
    null = next(each for each in diagnosis.found.final if not each.hypothesis.effects
                and not each.hypothesis.is_outside)
    found, start = list[NotRoundFound](), None
    for name, search in searches.items():
        try:
            start = start or Without.of(models, null.explanation.x)
            found.append(search(start, progress))
        except (NotConverged, OrdersNotConverged, TaperNotConverged, ValueError, KeyboardInterrupt) as error:
            diagnosis = replace(diagnosis, found=replace(diagnosis.found, not_tried=(
                *diagnosis.found.not_tried, NotTried(name, str(error) or "it was interrupted"))))
    states, criteria = diagnosis.campaign.fitted, diagnosis.criteria
    limit = min(criteria.limit(state.data * state.noise.size, float(np.sqrt(np.mean(state.noise**2))))
                for state in states)
    accepted = [each for each in found if each.is_accepted(criteria, limit)]
    decision = diagnosis.decision
    if accepted:
        likeliest = max(accepted, key=lambda each: each.gain)
        found = [replace(each, named=each is likeliest) for each in found]
        decision = replace(decision, verdict=MISSING, rivals=(), alike=(), is_explained=likeliest.after < limit,
                           chosen=evidence(models.model, null, diagnosis.found.stated, criteria))
    return replace(diagnosis, decision=decision, not_round=tuple(found))


def appraised(model: Model, results: Found, *, criteria: Criteria | None = None, started: float) -> Diagnosis:
    """The diagnosis from a search. `started` (s) is when it began.

    After a search that was cut short it describes the known parameters alone, and keeps the other results apart as
    provisional.
    """
    criteria = criteria or Criteria()
    whole = Diagnosis(model, results, conclude(model, results, criteria), criteria)
    alive = [(each.explanation, odds) for each, odds in whole.alive]
    whole = replace(whole, next_options=tuple(options(model, alive, criteria.rival)) if alive else (),
                    seconds=time.perf_counter() - started)
    if not results.undone:
        return whole
    return replace(whole, decision=not_finished(model, results, whole.decision, criteria), next_options=(),
                   provisional=whole)
