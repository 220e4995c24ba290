"""From a campaign to its diagnosis: the search, the decision, and the diagnosis that follows."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from workbench.campaign.assignment import check_assignment
from workbench.campaign.campaign import Campaign
from workbench.campaign.state import DeviceState, StateFit, state_fit
from workbench.diagnosis.conclusion import Conclusion, conclude, explained_share, not_finished
from workbench.diagnosis.decision import HINT
from workbench.diagnosis.description import remainder_description
from workbench.diagnosis.device import Model, device_model
from workbench.diagnosis.findings import Alternative, Found, Refitted
from workbench.diagnosis.inference import DiagnosisSearch
from workbench.diagnosis.likelihood import Explanation
from workbench.diagnosis.next_measurement import options
from workbench.diagnosis.observed import NotObservable
from workbench.diagnosis.odds import Criteria
from workbench.diagnosis.outcome import Diagnosis, Established, FoundNumber, Remainder, SuspectPlace, estimates
from workbench.fem.solve import one_thread
from workbench.files.errors import InputError, expect
from workbench.fitting.measurement_model import log_ratio
from workbench.jobs.process import WorkerEnded
from workbench.jobs.progress import Progress, no_progress
from workbench.jobs.workers import Processes, Workers, check_jobs
from workbench.model.discretisation import ACCURACY, Discretisation
from workbench.physics.term import Admissible

Complex = NDArray[np.complex128]

#: A number is at the end of what is admissible within this share of it.
AT_END = 1e-4


def diagnose(
    campaign: Campaign, *, accuracy: float | Discretisation = ACCURACY,
    progress: Progress = no_progress, jobs: int = 1, minutes: float | None = None,
) -> Diagnosis:
    """Explain the mismatch between the recordings of a campaign and their models, or say what cannot be explained.

    Interrupted once, or when its time is over, it ends with its results so far.

    Args:
        accuracy: of the meshes, see `discretisation`.
        progress: called with the present step and the share of the work that is done.
        jobs: processes that share the work, this one among them.
        minutes: after which nothing new is begun; None for no limit.

    Raises:
        InputError: fewer than one job, states that cannot be modelled as they are stated, or recordings that seem to
            be exchanged between them.
        MeshError: a mesh could not be made.
        NotEnriched: the device as it is stated cannot be predicted.
        ValueError: no time.
        RuntimeError: a process that shares the work ended before it was done.
    """
    check_jobs(jobs, source="diagnose")
    expect(campaign, Campaign, reader="read_campaign", source="diagnose", field="campaign")
    if minutes is not None and not minutes > 0.0:
        raise ValueError(f"minutes {minutes}: expected more than no time")
    with ExitStack() as stack:
        workers = Workers() if jobs == 1 else stack.enter_context(closing(Processes(jobs - 1, beside=1)))
        if jobs > 1:
            workers.share(DiagnosisSearch.of_campaign, campaign, accuracy)
        made = device_model(campaign, accuracy=accuracy)
        try:
            return diagnose_model(made, progress=progress, workers=workers, minutes=minutes)
        except WorkerEnded as error:
            raise RuntimeError(f"{error}; the diagnosis is not finished, and has to be made again, with fewer jobs if "
                               "memory is short") from error


@one_thread()
def diagnose_model(
    model: Model, *, progress: Progress = no_progress, workers: Workers | None = None,
    minutes: float | None = None,
) -> Diagnosis:
    """:func:`diagnose` of a model, on one thread: last digits depend on their number."""
    started = time.perf_counter()
    search = DiagnosisSearch(model, progress, until=None if minutes is None else started + 60.0 * minutes)
    try:
        stated = as_stated(search)
        check_assignment(model.campaign, stated[:len(model.campaign.fitted)])
        results = search.run(workers)
    except NotObservable as error:
        observation, _, reason = str(error).partition(": ")
        raise InputError(model.campaign.file, "observations", observation, "an observation that the chip as stated can "
                         f"have: {reason}; state another frequency or a stronger drive, or leave it out") from error
    found = appraised(model, results, stated, criteria=search.criteria, started=started)
    description = remainder_description(model, found.found, found.conclusion, found.criteria)
    return replace(found, description=description, seconds=time.perf_counter() - started)


def as_stated(search: DiagnosisSearch) -> tuple[StateFit, ...]:
    """All states as they are stated, those held out last."""
    model = search.model
    impedances = search.models.stated[0]
    return tuple(_fit(state, impedance) for state, impedance in
                 zip((*model.campaign.fitted, *model.campaign.held_out), impedances, strict=True))


def appraised(
    model: Model, found: Found, stated: tuple[StateFit, ...], *, criteria: Criteria | None = None, started: float
) -> Diagnosis:
    """The diagnosis that follows from a search; `stated` as from :func:`as_stated`, `started` (s) is when the search
    began.

    After a search that was cut short it describes the known parameters alone, and keeps other results apart as
    provisional.
    """
    criteria = criteria or Criteria()
    conclusion = conclude(model, found, criteria)
    whole = _of(model, found, stated, conclusion, criteria, started)
    if not found.undone:
        return whole
    cut = _of(model, found, stated, not_finished(model, found, conclusion), criteria, started)
    return replace(cut, remainder=replace(cut.remainder, region=""), provisional=whole)


def _of(
    model: Model, found: Found, stated: tuple[StateFit, ...], conclusion: Conclusion, criteria: Criteria, started: float
) -> Diagnosis:
    # A hypothesis outside the catalogue moves no parameter of a prediction: the known parameters do.
    refit = found.base if conclusion.chosen.explanation.hypothesis.is_outside else conclusion.chosen
    best = refit.explanation
    location, alive = suspect_places(refit), _alive(found, conclusion, criteria)
    further = options(model, [(each.explanation, odds) for each, odds in alive], criteria.rival) if alive else []
    released = {name for effect in best.hypothesis.effects for name in effect.releases}
    return Diagnosis(
        model, found, conclusion, criteria, stated, _fits(model, found.base), _fits(model, refit),
        established(model, found, best), _remainder(best, location, criteria), location,
        estimates(model, best, [p.name for p in model.parameters[:model.known] if p.name not in released]),
        found.base.scores, tuple(each.explanation.hypothesis.name for each, _ in alive),
        tuple(further), time.perf_counter() - started)


def established(model: Model, found: Found, best: Explanation) -> tuple[Established, ...]:
    """The effects of an explanation; the share of the second of two effects is the part that it adds to the first."""
    effects, result, before = best.hypothesis.effects, list[Established](), 0.0
    of = {each.hypothesis.effects: each.explanation for each in found.final
          if not each.hypothesis.is_outside} | {effects: best}
    for count, effect in enumerate(effects, 1):
        so_far = of.get(effects[:count])
        after = before if so_far is None else max(before, explained_share(model, found.base.explanation, so_far))
        parameters = estimates(model, best, effect.names)
        inside = all(_is_inside(each, effect.admissible[each.name]) for each in parameters
                     if each.name in effect.admissible)
        result.append(Established(effect, parameters, inside, after - before))
        before = after
    return tuple(result)


def _is_inside(found: FoundNumber, limit: Admissible) -> bool:
    """Whether a number is within what is admissible, or stays at the end of it where it is neutral."""
    margin = AT_END * (limit.highest - limit.lowest)
    moves = abs(found.value - found.stated) > margin
    return not moves or limit.lowest + margin < found.value < limit.highest - margin


def suspect_places(refit: Refitted) -> tuple[SuspectPlace, ...]:
    """Regions with a change of any kind, and modes, that improve an explanation, by their evidences, best first."""
    return tuple(map(_place, refit.alternatives))


def _place(found: Alternative) -> SuspectPlace:
    modes = tuple(f"{m.frequency / 1e6:.4f} MHz, Q about {m.quality:.0f}" for m in found.hypothesis.modes)
    return SuspectPlace(found.hypothesis.region or "mode", "mode" if modes else "anything",
                        math.sqrt(2.0 * max(found.gains, 0.0)), modes, found.gains)


def _fit(state: DeviceState, impedance: Complex) -> StateFit:
    return state_fit(state.name, log_ratio(impedance, state.measured.impedance), impedance, state.noise,
                     data=state.data)


def _fits(model: Model, refit: Refitted) -> tuple[StateFit, ...]:
    """All states by an explanation, those held out last."""
    impedances = (*refit.explanation.impedances, *refit.held_out_impedances)
    states = (*model.campaign.fitted, *model.campaign.held_out)
    return tuple(_fit(state, impedance) for state, impedance in zip(states, impedances, strict=True))


def _remainder(
    best: Explanation, location: Sequence[SuspectPlace], criteria: Criteria
) -> Remainder:
    noise = np.concatenate([state.noise for state in best.weighting.states if state.observation is None])
    evident = [place.region for place in location[:1] if place.evidence > math.log(criteria.accepted)]
    return Remainder(best.rms, math.sqrt(2.0 * float(np.mean(noise**2))), best.weighting.largest,
                     best.scales.inhomogeneity, evident[0] if evident else "")


def _alive(found: Found, conclusion: Conclusion, criteria: Criteria) -> list[tuple[Refitted, float]]:
    """The explanations that measurements have to tell apart, with their log odds: the best one and its rivals, or those
    that a hint may be of; none where nothing is open."""
    decision, every = conclusion.decision, [conclusion.chosen, *conclusion.rivals]
    if decision.verdict == HINT:
        every += [each for each in found.final if each is not conclusion.chosen and
                  decision.log_odds[each.explanation.hypothesis.name] > -math.log(criteria.rival)]
    return [(each, decision.log_odds[each.explanation.hypothesis.name]) for each in every] if len(every) > 1 else []
