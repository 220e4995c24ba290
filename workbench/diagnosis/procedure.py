"""The six steps of a diagnosis, from the campaign to the verdict."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.basins import other_basin, rebuilt_in_another_basin
from workbench.diagnosis.belong import check_assignment, cleared
from workbench.diagnosis.campaign import Campaign
from workbench.diagnosis.criteria import (
    ACCEPTED,
    RIVAL,
    best_of,
    explains,
    fits_as_well,
    further_scores,
    gain,
    held_out_chi_square,
    is_complete,
    is_in_question,
    is_pulled,
    is_quiet,
    is_simplest,
    remaining_gain,
    scores_of,
)
from workbench.diagnosis.device import Model, model
from workbench.diagnosis.locate import Place, located
from workbench.diagnosis.refit import Refit, base_fit, leaves_less, predicted, rebuild_and_refine, refit, without
from workbench.diagnosis.score import Score, promising
from workbench.diagnosis.tempering import tempered_search
from workbench.diagnosis.verdict import Diagnosis, Weighed, verdict_on
from workbench.discretisation import ACCURACY, Discretisation
from workbench.solve import one_thread

Real = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Fits that close to the best are asked for the states held out.
CLOSE = 3.0 * RIVAL

#: Known parameters that leave less than this share of what the base leaves, from where an effect has led them: the base
#: is in another basin.
HALF = 0.5

#: Hypotheses refitted alone, how many of the best are paired, and pairs refitted.
SINGLES, PAIRED, PAIRS = 8, 3, 4

#: Share of the time that meshing takes, of what is told of the progress.
MESHING = 0.05


def diagnose(
    campaign: Campaign, *, accuracy: float | Discretisation = ACCURACY, cache: Path | None = None,
    progress: Progress = lambda _text, _share: None,
) -> Diagnosis:
    """Locate the mismatch between the recordings of a campaign and their models, and name what explains it, if any.

    Args:
        accuracy: of the meshes, see `discretisation`.
        cache: folder of meshes made before; none are kept if None.
        progress: called with what is done and the share that is.

    Raises:
        InputError: the states cannot be modelled as they are stated, or recordings seem to be exchanged between them.
        MeshError: a mesh could not be made.
        NotEnriched: the device as it is stated cannot be predicted.
    """
    device = model(campaign, accuracy=accuracy, cache=cache,
                   progress=lambda share: progress("meshing", MESHING * share))
    return diagnose_model(device, progress=lambda text, share: progress(text, MESHING + (1.0 - MESHING) * share))


@one_thread()
def diagnose_model(model: Model, *, progress: Progress = lambda _text, _share: None) -> Diagnosis:
    """Locate the mismatch of a campaign, name what explains it, or say that nothing does.

    On one thread: where a strained fit ends depends on rounding, and rounding on the number of threads.

    Raises:
        InputError: recordings seem to be exchanged between states.
        NotEnriched, MeshError: the device as it is stated cannot be predicted.
    """
    started = time.perf_counter()
    progress("known parameters", 0.0)
    nominal, base, end = base_fit(model)
    check_assignment(model.campaign, nominal)
    if not is_quiet(base, scores_of(model, base)):
        # Also what leaves next to nothing may be a wrong basin, in which something hints at what is not there.
        progress("other basins", 0.1)
        base, end = other_basin(model, base, end)
    base, scores, location, singles = _asked(model, base, end, progress)
    if is_pulled(base) and not any(explains(base, fit) for fit in singles):
        progress("basins far off", 0.6)
        other, end = other_basin(model, base, end, far=True)
        if other is not base:
            base, scores, location, singles = _asked(model, other, end, progress)
        elif singles:
            # The bases are those of the places that were looked at: those of the best fit again.
            singles = _settled(model, singles)
    singles = _hopped(model, base, singles, progress)
    best = best_of(base, singles)
    if is_in_question(base, best):
        other = without(model, base, best)
        if gain(base, other) > ACCEPTED and leaves_less(other, base, HALF):
            progress("another basin", 0.65)
            base, scores, location, singles = _asked(model, rebuild_and_refine(model, other), other.x, progress)
            singles = _hopped(model, base, singles, progress)
    pairs: list[Refit] = []
    held_before = predicted(model, base)
    weighed = [(base, held_before)]
    best = best_of(base, singles)
    if is_in_question(base, best):
        if not is_complete(base, best, remaining_gain(best, further_scores(model, best))):
            pairs = _pairs(model, singles, progress)
            both = min([best, *pairs], key=lambda f: f.evidence + RIVAL * len(f.effects))
            if both is not best:
                best = rebuild_and_refine(model, both)
                pairs = _with(pairs, both, best)
        progress("verdict", 0.9)
        close = [f for f in (*singles, *pairs) if is_simplest(f, best)
                 and (f.evidence - best.evidence < CLOSE or fits_as_well(f, best))]
        weighed = _weighed(model, close)
        if weighed[0][0] is not best:
            best = rebuild_and_refine(model, weighed[0][0])
            weighed[0] = (best, predicted(model, best))
    return verdict_on(model, nominal, base, weighed, scores, location, singles, pairs, held_before, started)


def _asked(
    model: Model, base: Refit, end: Real, progress: Progress
) -> tuple[Refit, list[Score], tuple[Place, ...], list[Refit]]:
    """The base, scores and location there, and refits of the hypotheses left in the race.

    `end` (p,) is the end of the descent to the base, where the data weigh little (:func:`tempered_search`).
    """
    location: tuple[Place, ...] = ()
    singles: list[Refit] = []
    if is_pulled(base):
        progress("strong effects", 0.2)
        clear, alone = cleared(model)
        location, singles = tempered_search(model, base, end, alone)
        location = tuple(sorted(location, key=lambda place: place.region in clear))
    if any(explains(base, fit) for fit in singles):
        return base, scores_of(model, base), location, singles
    base, scores, near, more = _near(model, base, progress)
    # Where the known parameters are strained, what is left no longer tells where from.
    return base, scores, location or near, [*singles, *more]


def _with(fits: Sequence[Refit], old: Refit, new: Refit) -> list[Refit]:
    """`fits` with one replaced, best first."""
    return sorted([new if f is old else f for f in fits], key=lambda f: f.evidence)


def _hopped(model: Model, base: Refit, singles: Sequence[Refit], progress: Progress) -> list[Refit]:
    """`singles`, best first; the best from another basin where it explains and yet leaves a hint at something more."""
    singles = sorted(singles, key=lambda f: f.evidence)
    best = best_of(base, singles)
    if not (is_in_question(base, best) and explains(base, best)) or is_quiet(best, further_scores(model, best)):
        return singles
    progress("other basins", 0.65)
    # The bases are those of the basins that were looked at: those of the best fit again.
    return _settled(model, _with(singles, best, rebuilt_in_another_basin(model, best, best.x)))


def _settled(model: Model, fits: Sequence[Refit]) -> list[Refit]:
    """`fits` with the best one made again on bases of its own, best first.

    Whatever else is asked of it, also whether that is all, is asked there.
    """
    best = min(fits, key=lambda f: f.evidence)
    return _with(fits, best, rebuild_and_refine(model, best, further_scores(model, best)[:PAIRS]))


def _weighed(model: Model, fits: Sequence[Refit]) -> list[Weighed]:
    """Fits with the states held out as they predict these, which decide between fits that come close; best first."""
    found = [(fit, predicted(model, fit)) for fit in fits]
    return sorted(found, key=lambda each: each[0].evidence + held_out_chi_square(model, each[1]))


def _near(
    model: Model, base: Refit, progress: Progress
) -> tuple[Refit, list[Score], tuple[Place, ...], list[Refit]]:
    """The base on bases of its own, scores and location there, and refits of the hypotheses left in the race.

    The best of them on bases of its own too.
    """
    progress("neighbourhood", 0.3)
    scores = scores_of(model, base)
    base = rebuild_and_refine(model, base, [*scores[:SINGLES], *promising(scores, SINGLES)])
    scores = scores_of(model, base)
    location = located(model, base.x, model.deviations(), base.tangents(), scores)
    found = []
    # Those of several parameters stand far down, and may yet be what the data cannot rule out.
    wanted = promising(scores, SINGLES, ACCEPTED)
    for number, scored in enumerate(wanted):
        progress(f"trying {scored.effect.name}", 0.4 + 0.2 * number / len(wanted))
        result = refit(model, (scored.effect,), base.x, [scored])
        if result is not None:
            found.append(result)
    best = best_of(base, found)
    if is_in_question(base, best):
        progress(f"neighbourhood of {best.name}", 0.6)
        found = _settled(model, found)
    return base, scores, location, found


def _pairs(model: Model, singles: Sequence[Refit], progress: Progress) -> list[Refit]:
    """Refits of pairs: for the best single hypotheses, what the score test at their own optimum would add."""
    tried: dict[frozenset[str], tuple[Refit, Score]] = {}
    for single in singles[:PAIRED]:
        for scored in further_scores(model, single)[:PAIRS]:
            tried.setdefault(frozenset((single.name, scored.effect.name)), (single, scored))
    chosen = sorted(tried.values(), key=lambda pair: pair[0].evidence - pair[1].evidence)[:PAIRS]
    found = []
    for number, (single, scored) in enumerate(chosen):
        progress(f"trying {single.name} and {scored.effect.name}", 0.75 + 0.2 * number / len(chosen))
        result = refit(model, (*single.effects, scored.effect), single.x, [scored])
        if result is not None:
            found.append(result)
    return sorted(found, key=lambda f: f.evidence)
