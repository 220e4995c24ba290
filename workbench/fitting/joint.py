"""The workbench's own fit: all free parameters together, exact gradients, physical bounds, several starts.

1. Every start is taken down a sequence of smoothed problems (see `objective`) on a coarse mesh. With the overtones
   smoothed away there are few ways to lay the model on the recording; as the smoothing is let down, each overtone
   falls on its own neighbour.
2. An overtone laid on the wrong neighbour leaves a residual of several per cent that is not white. While that is so,
   the best end is left: for its neighbours, in which the stiffnesses that rule radial and shear overtones are moved by
   about one overtone, together and apart, and for starts drawn from the prior. Each is followed down for as long as
   it keeps up with the best, until none is better.
3. The best is refined on the mesh asked for, and once more with the noise that the residual shows.
4. What the data say of every parameter is worked out at the minimum (see `certainty`), and the reduced model is
   checked against full solves there.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.comparison import Comparison, compare
from workbench.fitting import certainty
from workbench.fitting.certainty import BandLeftOut, Direction, Fitted, Noise
from workbench.fitting.objective import Objective, Recording
from workbench.fitting.parameter import Parameter
from workbench.fitting.search import EXPLORATION, NO_END, SEARCHED_POINTS, Descent, Optimum, Search
from workbench.spectrum import Origin, Spectrum

Real = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Relative error of the reduced model while exploring, and at the end.
COARSE, FINE = 5e-2, 3e-4

#: An end of the search is left for its neighbours if more than the first rms of |ln ratio| remains and it is not white,
#: or more than the second: on a sparse grid sharp overtones that miss each other look white.
UNEXPLAINED, NO_NOISE = 0.01, 0.1

#: Stiffnesses that rule one family of overtones each, and what moves it by so many overtones of some ten.
LEVERS: tuple[tuple[str, ...], ...] = (("c11", "c12"), ("c44",), ("shear_modulus", "bulk_modulus"))
HOPS = {0: 1.0, -1: 0.88, 1: 1.13, -2: 0.78, 2: 1.27}

#: What the labels of neighbours and of starts drawn from the prior begin with.
HOP, DRAW = "hop", "draw"

#: Starts drawn from the prior where neighbours did not help.
DRAWN = 8

#: A neighbour is better if it costs less than this share of the best.
BETTER = 0.9

#: Two ends are the same optimum if every parameter agrees within this many standard errors of either, or within this
#: share of its prior, whichever is larger: a flat direction of the data may be anywhere along it.
SAME_ERRORS, SAME_SHARE = 2.0, 0.02


class FitError(RuntimeError):
    """A fit that cannot be made: what is wrong with recording, geometry or parameters, in words."""


#: How a start may have ended.
SAME, GIVEN_UP = "same optimum", "given up: worse than the best while still smoothed"


@dataclass(frozen=True, eq=False)
class Start:
    """One start of the search: where it began and ended (p,), SI; the rms of |ln ratio| it ended at, and in words."""

    label: str
    begin: Real
    end: Real
    rms: float
    outcome: str
    steps: int


@dataclass(frozen=True, eq=False)
class Match:
    """A recording with the spectra of the start and of the fit, and how far each is from it.

    ``start`` was predicted on the coarse mesh of the search.
    """

    name: str
    measured: Spectrum
    start: Spectrum
    fitted: Spectrum
    before: Comparison
    after: Comparison
    noise: Noise


@dataclass(frozen=True, eq=False)
class FitResult:
    """What a fit found, and how far to trust it.

    ``estimates`` one for each free parameter, in their order; ``covariance`` (p, p) SI, prior included;
    ``undetermined`` the directions the data say less of than was known before; ``bands`` predictions of parts of the
    band left out; ``check`` the largest relative difference from full solves and the frequency (Hz) it was found at;
    ``findings`` plain statements; ``seconds`` wall time; ``full_solves`` spent on all meshes.
    """

    algorithm: str
    recordings: tuple[Match, ...]
    estimates: tuple[Fitted, ...]
    covariance: Real
    undetermined: tuple[Direction, ...]
    starts: tuple[Start, ...]
    bands: tuple[BandLeftOut, ...]
    check: tuple[float, float]
    converged: bool
    improved: bool
    iterations: int
    findings: tuple[str, ...]
    seconds: float
    full_solves: int

    @property
    def correlation(self) -> Real:
        """(p, p)."""
        deviation = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(deviation, deviation))


def fit(
    recordings: Sequence[Recording],
    parameters: Sequence[Parameter],
    *,
    coarse: Sequence[Recording] | None = None,
    starts: Mapping[str, Real] | None = None,
    tries: int = 32,
    seed: int = 0,
    poisson: tuple[float, float] | None = None,
    profiles: bool = True,
    bands: int = 3,
    progress: Progress | None = None,
) -> FitResult:
    """Fit `parameters` to `recordings` and say what was found and how sure it is.

    Args:
        recordings: each with its problem on the mesh whose parameters are wanted.
        parameters: what may move, with prior and bounds; see `parameter.parameters`.
        coarse: the same recordings on coarser meshes, for the search; the recordings themselves if None.
        starts: further starts by label, vectors (p,) in SI; the parameters' own start is always the first.
        tries: how many further ways down at most, where the recordings stay unexplained: from neighbours of the best
            end first, then from starts drawn from the prior.
        poisson: bounds of Poisson's ratio of isotropic solids (default `admissible.POISSON_RATIO`).
        profiles: profile likelihoods where the quadratic approximation misjudges.
        bands: parts of the band to leave out in turn and predict; 0 for none.

    Raises:
        FitError: fewer data than parameters, or no start can be predicted at all.
        InputError: parameters that no passive solid can have.
    """
    started = time.perf_counter()
    _check(recordings, parameters)
    show = progress or (lambda _text, _fraction: None)
    searched = [r.thinned(SEARCHED_POINTS) for r in coarse or recordings]
    scout = Search(Objective(searched, parameters, tolerance=COARSE), poisson=poisson)
    before = _start_spectra(scout, recordings)
    begins = [("start", scout.centre), *(starts or {}).items()]
    stages = len(begins) * len(scout.widths())
    done = 0

    def stage() -> None:
        nonlocal done
        done += 1
        show("searching", 0.6 * done / max(stages, done))

    found = [_tried(scout, label, np.asarray(begin, dtype=float), stage) for label, begin in begins]
    ends = [trial.end for trial in found if trial.end is not None]
    if not ends:
        raise FitError("no start could be predicted: " + found[0].reason)
    best = min(ends, key=lambda end: end.cost)
    best, tried = _left(scout, best, _drawn(scout, DRAWN, seed), tries,
                        lambda label: show(f"searching, {label}", 0.6))
    found += tried
    search = Search(Objective(recordings, parameters, tolerance=FINE), poisson=poisson)
    show("refining", 0.6)
    minimum, noise = refine(search, best.x)
    show("judging", 0.85)
    verdict = certainty.judge(search, minimum, noise, profiles=profiles,
                              coarser=None if coarse is None else scout.objective)
    left_out = certainty.leave_bands_out(search, minimum, noise, bands) if bands else ()
    check = certainty.check(search.objective, minimum.x)
    matches = _matches(recordings, before, minimum, noise)
    listed = _judged_starts(found, best, scout, noise)
    improved = all(m.after.rms_log_residual < m.before.rms_log_residual for m in matches)
    solves = search.objective.solves + scout.objective.solves
    show("done", 1.0)
    return FitResult(
        "joint", matches, verdict.estimates, verdict.covariance, verdict.undetermined, listed, left_out, check,
        minimum.converged, improved, minimum.iterations,
        (*_findings(minimum, improved, listed, matches, left_out, check), *verdict.findings,
         *refused_steps([*scout.objective.refusals, *search.objective.refusals])),
        time.perf_counter() - started, solves,
    )


@dataclass(frozen=True, eq=False)
class _Trial:
    """One way down: from where, to where, and why not where it has no end."""

    label: str
    begin: Real
    end: Descent | None
    reason: str = ""


def _tried(
    search: Search, label: str, begin: Real, progress: Callable[[], None], rival: Descent | None = None
) -> _Trial:
    """The way down from `begin`, moved to where it is admissible.

    The widest smoothing would undo a hop.
    """
    try:
        begin = search.inside(begin)
        return _Trial(label, begin, search.descend(
            begin, progress, first=1 if label.startswith(HOP) else 0, rival=rival))
    except NO_END as error:
        return _Trial(label, begin, None, f"{type(error).__name__}: {error}")


def _left(
    search: Search, best: Descent, drawn: Sequence[tuple[str, Real]], tries: int, progress: Callable[[str], None]
) -> tuple[Descent, list[_Trial]]:
    """The best end reached from neighbours of `best` and from the starts `drawn`, and every way tried."""
    tried: list[_Trial] = []
    waiting = [*_neighbours(search, best.x), *drawn]
    while waiting and len(tried) < tries and _unexplained(best):
        label, begin = waiting.pop(0)
        progress(label)
        trial = _tried(search, label, begin, lambda: None, rival=best)
        tried.append(trial)
        end = trial.end
        if end is not None and end.ended and end.cost < BETTER * best.cost:
            best = end
            waiting = [*_neighbours(search, best.x), *(other for other in waiting if other[0].startswith(DRAW))]
    return best, tried


def _neighbours(search: Search, x: Real) -> list[tuple[str, Real]]:
    """Starts one and two overtones from x (p,), nearest first."""
    groups = [[i for i, p in enumerate(search.parameters) if not p.is_loss and p.coefficient.split(".")[-1] in lever]
              for lever in LEVERS]
    groups = [group for group in groups if group]
    result = []
    hops = sorted(itertools.product(HOPS, repeat=len(groups)), key=lambda hop: sum(map(abs, hop)))
    for hop in hops[1:]:
        begin, words = x.copy(), []
        for group, overtones in zip(groups, hop, strict=True):
            begin[group] *= HOPS[overtones]
            if overtones:
                words.append(f"{search.parameters[group[0]].coefficient.split('.')[-1]} x {HOPS[overtones]:g}")
        result.append((f"{HOP} " + ", ".join(words), begin))
    return result


def _drawn(search: Search, count: int, seed: int) -> list[tuple[str, Real]]:
    """Starts drawn from the prior; losses, whose prior is wide, within a factor of two of the start."""
    random = np.random.default_rng(seed)
    loss = np.array([p.is_loss for p in search.parameters])
    result = []
    for number in range(count):
        factor = np.exp(np.log(2.0) * random.uniform(-1.0, 1.0, loss.size))
        offset = search.scale * random.standard_normal(loss.size)
        result.append((f"{DRAW} {number + 1}", np.where(loss, search.centre * factor, search.centre + offset)))
    return result


def _unexplained(end: Optimum) -> bool:
    """Whether what an end leaves is more than noise: large and systematic, or too large for any noise."""
    data = end.residual.data
    for log in data.log_ratio:
        rms = np.sqrt(np.mean(np.abs(log) ** 2))
        if rms > NO_NOISE or (rms > UNEXPLAINED and certainty.correlation_length(log) > 1.0):
            return True
    return False


def _start_spectra(scout: Search, recordings: Sequence[Recording]) -> list[NDArray[np.complex128]]:
    """The impedance of every recording's start, as it would be recorded, on the mesh of the search."""
    return [certainty.unrefined(scout.objective, scout.centre, index, recording.measured.frequency, COARSE)
            for index, recording in enumerate(recordings)]


def refine(search: Search, x: Real) -> tuple[Optimum, tuple[Noise, ...]]:
    """The minimum near x with every recording weighted by the noise its own residual shows.

    The spectra's own uncertainties are scaled as a whole, or a constant relative deviation is found.
    """
    shapes = [certainty.noise_shape(r.measured) for r in search.objective.recordings]
    levels = [0.01 if r.measured.uncertainty is None else 1.0 for r in search.objective.recordings]
    for _ in range(3):
        deviation = [level * shape for level, shape in zip(levels, shapes, strict=True)]
        minimum = search.minimise(x, deviation, radius=0.3, tolerance=1e-7)
        x = minimum.x
        data = minimum.residual.data
        free = len(search.parameters) / max(1, len(levels))
        now = [float(np.sqrt(np.sum(np.abs(log / shape) ** 2) / max(1.0, 2.0 * log.size - free)))
               for log, shape in zip(data.log_ratio, shapes, strict=True)]
        settled = all(abs(a / b - 1.0) < 0.02 for a, b in zip(levels, now, strict=True))
        # A fit without noise would weigh rounding.
        levels = [max(level, 0.1 * FINE) for level in now]
        if settled:
            break
    noise = tuple(
        certainty.noise(log, level * shape, r.measured.uncertainty is not None, level)
        for log, level, shape, r in zip(data.log_ratio, levels, shapes, search.objective.recordings, strict=True))
    return minimum, noise


def _check(recordings: Sequence[Recording], parameters: Sequence[Parameter]) -> None:
    points = sum(r.measured.frequency.size for r in recordings)
    if not parameters:
        raise FitError("there is nothing to fit: no parameter is free")
    if points < len(parameters):
        raise FitError(f"{points} points cannot determine {len(parameters)} parameters; "
                       "free fewer or record more points")


def _judged_starts(
    found: Sequence[_Trial], best: Optimum, search: Search, noise: Sequence[Noise]
) -> tuple[Start, ...]:
    """Every start with where it ended, seen from the best end."""
    jacobian = best.residual.jacobian
    spread = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)))
    # The exploration's deviation is a stand-in; what the data resolve is what the noise allows.
    resolved = spread * max(float(np.mean(n.deviation)) for n in noise) / EXPLORATION
    allowed = np.maximum(SAME_ERRORS * resolved, SAME_SHARE * search.scale)
    result = []
    for trial in found:
        end = trial.end
        if end is None:
            result.append(Start(trial.label, trial.begin, trial.begin, np.inf, f"failed: {trial.reason}", 0))
            continue
        data = end.residual.data
        rms = float(np.sqrt(np.mean(np.abs(np.concatenate(data.log_ratio)) ** 2)))
        off = np.abs(end.x - best.x) / allowed
        worst = int(np.argmax(off))
        if off[worst] <= 1.0:
            outcome = SAME
        elif not end.ended:
            outcome = GIVEN_UP
        else:
            outcome = f"another optimum: {search.parameters[worst].name} differs most"
        result.append(Start(trial.label, trial.begin, end.x, rms, outcome, end.iterations))
    return tuple(result)


def _matches(
    recordings: Sequence[Recording], before: Sequence[NDArray[np.complex128]], minimum: Optimum, noise: Sequence[Noise]
) -> tuple[Match, ...]:
    data = minimum.residual.data
    result = []
    for recording, first, last, level in zip(recordings, before, data.impedance, noise, strict=True):
        frequency = recording.measured.frequency
        start, fitted = (Spectrum(frequency, z, origin=Origin("simulated")) for z in (first, last))
        result.append(Match(recording.name, recording.measured, start, fitted, compare(recording.measured, start),
                            compare(recording.measured, fitted), level))
    return tuple(result)


def _findings(
    minimum: Optimum, improved: bool, starts: Sequence[Start], matches: Sequence[Match],
    bands: Sequence[BandLeftOut], check: tuple[float, float],
) -> list[str]:
    result = []
    if not minimum.converged:
        result.append(f"The search did not converge: {minimum.reason}.")
    if not improved:
        result.append("The fit is not better than its start.")
    result.append(_ends(starts))
    for match in matches:
        result += certainty.residual_findings(match.name, match.after, match.noise)
    for band in bands:
        if band.predicted_rms > 3.0 * band.fitted_rms:
            result.append(f"{band.recording}: {band.low / 1e3:.1f} to {band.high / 1e3:.1f} kHz is predicted with an "
                          f"rms error of {100 * band.predicted_rms:.2g} % when left out, against "
                          f"{100 * band.fitted_rms:.2g} % when fitted: the parameters depend on that part of the band.")
    if check[0] > 10.0 * FINE:
        result.append(f"The reduced model is {check[0]:.1e} off a full solve at {check[1] / 1e3:.1f} kHz.")
    return result


def refused_steps(refusals: Sequence[str]) -> list[str]:
    """A statement of how many steps of a search could not be taken, and why; none where all could."""
    if not refusals:
        return []
    kinds = Counter(refusals).most_common()
    return [f"{len(refusals)} steps of the search could not be taken and were shortened; most often, {kinds[0][1]} "
            f"times: {kinds[0][0]}"]


def _ends(starts: Sequence[Start]) -> str:
    """Where all ways down ended, in one sentence."""
    same = sum(s.outcome == SAME for s in starts)
    text = f"{same} of {len(starts)} ways down reached the same optimum"
    given_up = sum(s.outcome == GIVEN_UP for s in starts)
    if given_up:
        text += f", {given_up} were {GIVEN_UP}"
    failed = [s for s in starts if not np.isfinite(s.rms)]
    others = sorted((s for s in starts if np.isfinite(s.rms) and s.outcome not in (SAME, GIVEN_UP)),
                    key=lambda s: s.rms)
    if others:
        text += f", {len(others)} ended elsewhere, the best of them: " + "; ".join(
            f"{s.label} at an rms of {s.rms:.3g} ({s.outcome})" for s in others[:3])
    if failed:
        text += f", {len(failed)} failed, the first of them: {failed[0].label} ({failed[0].outcome})"
    return text + "."
