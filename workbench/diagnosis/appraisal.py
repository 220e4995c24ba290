"""From a campaign to its diagnosis: the search, the decision, and what both come to."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.belong import check_assignment
from workbench.diagnosis.campaign import Campaign
from workbench.diagnosis.conclusion import Conclusion, conclude, mismatch, share
from workbench.diagnosis.decision import HINT
from workbench.diagnosis.device import Model, model
from workbench.diagnosis.inference import FINE, WIDE, Found, Search, Settled
from workbench.diagnosis.likelihood import Explanation, Hypothesis, Likelihood
from workbench.diagnosis.next_measurement import options
from workbench.diagnosis.odds import Criteria
from workbench.diagnosis.outcome import Diagnosis, Established, Left, Place, estimates
from workbench.diagnosis.ranking import Score, ranked
from workbench.diagnosis.state import DeviceState, StateFit, state_fit
from workbench.diagnosis.workers import Workers
from workbench.discretisation import ACCURACY, Discretisation
from workbench.fitting.objective import log_ratio
from workbench.solve import one_thread

Complex = NDArray[np.complex128]
Progress = Callable[[str, float], None]


def diagnose(
    campaign: Campaign, *, accuracy: float | Discretisation = ACCURACY, cache: Path | None = None,
    progress: Progress = lambda _text, _share: None, workers: Workers | None = None,
) -> Diagnosis:
    """Explain the mismatch between the recordings of a campaign and their models, or say what cannot be explained.

    Args:
        accuracy: of the meshes, see `discretisation`.
        cache: folder of meshes made before; none are kept if None.
        progress: called with what is done and the share that is.
        workers: of :meth:`Search.of_campaign`, to share the work with.

    Raises:
        InputError: the states cannot be modelled as they are stated, or recordings seem to be exchanged between them.
        MeshError: a mesh could not be made.
        NotEnriched: the device as it is stated cannot be predicted.
    """
    return diagnose_model(model(campaign, accuracy=accuracy, cache=cache), progress=progress, workers=workers)


@one_thread()
def diagnose_model(
    model: Model, *, progress: Progress = lambda _text, _share: None, workers: Workers | None = None
) -> Diagnosis:
    """:func:`diagnose` of a model, on one thread: last digits depend on their number."""
    started = time.perf_counter()
    stated = as_stated(model)
    check_assignment(model.campaign, stated[:len(model.campaign.fitted)])
    return appraised(model, Search(model, progress).run(workers), stated, started=started)


def as_stated(model: Model) -> tuple[StateFit, ...]:
    """All states as they are stated, those held out last."""
    whole = model.whole.near(x := np.array([p.start for p in model.parameters]), {}, WIDE, only=())
    at = {recording.name: index for index, recording in enumerate(whole.recordings)}
    return tuple(_fit(state, whole.predict(x, at[state.name], ())[0])
                 for state in (*model.campaign.fitted, *model.campaign.held_out))


def appraised(
    model: Model, found: Found, stated: tuple[StateFit, ...], *, criteria: Criteria | None = None, started: float
) -> Diagnosis:
    """The diagnosis that a search comes to; `stated` as of :func:`as_stated`, `started` (s) when it was begun."""
    criteria = criteria or Criteria()
    conclusion, base = conclude(model, found, criteria), found.base.explanation
    # What is outside the catalogue moves nothing that predicts: the known parameters do.
    settled = found.base if conclusion.chosen.explanation.hypothesis.is_outside else conclusion.chosen
    best = settled.explanation
    near = model.fitted.near(best.x, {}, FINE, only=best.free)
    likelihood = Likelihood.bare(model, near).with_patterns(best.x)
    location, alive = located(likelihood, best, found), _alive(found, conclusion, criteria)
    further = options(likelihood, [(each.explanation, odds) for each, odds in alive], criteria.rival) if alive else []
    released = {name for effect in best.hypothesis.effects for name in effect.releases}
    return Diagnosis(
        model, found, conclusion, criteria, stated, _fits(model, found.base), _fits(model, settled),
        established(model, found, best), _left(likelihood, best, location, criteria), location,
        estimates(model, best, [p.name for p in model.parameters[:model.known] if p.name not in released]),
        found.base.scores or _scores(model, base), tuple(each.explanation.hypothesis.name for each, _ in alive),
        tuple(further), time.perf_counter() - started)


def established(model: Model, found: Found, best: Explanation) -> tuple[Established, ...]:
    """The effects of an explanation; of two each takes away what it adds to those before it."""
    effects, result, before = best.hypothesis.effects, list[Established](), 0.0
    of = {each.explanation.hypothesis.effects: each.explanation for each in found.final} | {effects: best}
    for count, effect in enumerate(effects, 1):
        so_far = of.get(effects[:count])
        after = before if so_far is None else max(before, share(model, found.base.explanation, so_far))
        told = estimates(model, best, effect.names)
        limits = [(effect.admissible[each.name], each.value) for each in told if each.name in effect.admissible]
        inside = all(limit.lowest <= value <= limit.highest for limit, value in limits)
        result.append(Established(effect, told, inside, after - before))
        before = after
    return tuple(result)


def located(likelihood: Likelihood, best: Explanation, found: Found) -> tuple[Place, ...]:
    """Regions that may have anything in them, and modes, beside an explanation, by their evidences, best first.

    Those that the search settled come before those that are weighed here.
    """
    effects, x = best.hypothesis.effects, best.x
    none, _ = likelihood.weighed(best.hypothesis, x, 0.0)
    regions = dict.fromkeys(likelihood.anything.regions) if likelihood.anything is not None else {}
    every = [Hypothesis(effects, region) for region in regions]
    if modes := likelihood.strongest_modes(x, best.accuracy):
        every.append(Hypothesis(effects, modes=modes))
    worth = {each.name: (each, likelihood.weighed(each, x, 0.0)[0] - none) for each in every}
    # What was looked for from a place of its own is known better, and was decided on.
    settled = {e.hypothesis.name: (e.hypothesis, e.log_evidence - best.log_evidence)
               for e in (each.explanation for each in found.final)
               if e.hypothesis.is_outside and e.hypothesis.effects == effects}
    ordered = [*sorted(settled.items(), key=_evidence),
               *sorted(((name, each) for name, each in worth.items() if name not in settled), key=_evidence)]
    return tuple(Place(each.region or "mode", "mode" if each.modes else "anything", math.sqrt(2.0 * max(gained, 0.0)),
                       tuple(f"{m.frequency / 1e6:.4f} MHz, Q about {m.quality:.0f}" for m in each.modes), gained)
                 for _, (each, gained) in ordered)


def _evidence(entry: tuple[str, tuple[Hypothesis, float]]) -> float:
    return -entry[1][1]


def _fit(state: DeviceState, impedance: Complex) -> StateFit:
    return state_fit(state.name, log_ratio(impedance, state.measured.impedance), impedance, state.noise)


def _fits(model: Model, settled: Settled) -> tuple[StateFit, ...]:
    """All states by an explanation, those held out last."""
    impedances = (*settled.explanation.residual.impedance, *settled.seen)
    states = (*model.campaign.fitted, *model.campaign.held_out)
    return tuple(_fit(state, impedance) for state, impedance in zip(states, impedances, strict=True))


def _left(likelihood: Likelihood, best: Explanation, location: Sequence[Place], criteria: Criteria) -> Left:
    count = 0.5 * likelihood.noise.size
    noise, allowed = (math.sqrt(float(np.sum(each**2)) / count)
                      for each in (likelihood.noise, best.accuracy * likelihood.columns))
    evident = [place.region for place in location[:1] if place.evidence > math.log(criteria.accepted)]
    return Left(math.sqrt(mismatch(best) / count), noise, best.accuracy, allowed, evident[0] if evident else "")


def _scores(model: Model, base: Explanation) -> tuple[Score, ...]:
    near = model.fitted.near(base.x, {}, WIDE, only=base.free)
    return tuple(ranked(Likelihood.bare(model, near), base.x, base.accuracy))


def _alive(found: Found, conclusion: Conclusion, criteria: Criteria) -> list[tuple[Settled, float]]:
    """The explanations that measurements have to tell apart, with their log odds: the best one and its rivals, or what
    a hint may be of; none where nothing is open."""
    decision, every = conclusion.decision, [conclusion.chosen, *conclusion.rivals]
    if decision.verdict == HINT:
        every += [each for each in found.final if each is not conclusion.chosen and
                  decision.log_odds[each.explanation.hypothesis.name] > -math.log(criteria.rival)]
    return [(each, decision.log_odds[each.explanation.hypothesis.name]) for each in every] if len(every) > 1 else []
