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

import copy
import itertools
import math
import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.comparison import Comparison, compare
from workbench.fitting import certainty
from workbench.fitting.admissible import inequalities
from workbench.fitting.certainty import REFUSED, BandLeftOut, Direction, Fitted, Noise
from workbench.fitting.constrained import Inequality, Minimum, interior, minimise
from workbench.fitting.objective import Objective, Recording, Residual
from workbench.fitting.parameter import Parameter
from workbench.reduction import NotEnriched
from workbench.spectrum import Origin, Spectrum

Real = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Half widths of the smoothing, relative to the middle of the band, from far to none.
WIDTHS = (0.03, 0.01, 0.003, 0.0)

#: Relative deviation that a point is given during exploration. It stands for all that the model leaves out, and lets
#: the prior hold what the smoothed spectra cannot see.
EXPLORATION = 0.05

#: Relative error of the reduced model while exploring, and at the end.
COARSE, FINE = 5e-2, 3e-4

#: A recording is searched on at most about so many of its points.
SEARCHED_POINTS = 241

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

#: A way down is given up where it costs more than this many times what the best cost at the same smoothing.
WORSE = 2.0

#: Steps at one smoothing. A way down that has not ended by then is in a valley that says little, or in none.
STEPS = 20

#: Two ends are the same optimum if every parameter agrees within this many standard errors of either, or within this
#: share of its prior, whichever is larger: a flat direction of the data may be anywhere along it.
SAME_ERRORS, SAME_SHARE = 2.0, 0.02

class FitError(RuntimeError):
    """A fit that cannot be made: what is wrong with recording, geometry or parameters, in words."""


#: How a start may have ended.
SAME, GIVEN_UP = "same optimum", "given up: worse than the best while still smoothed"

#: What may end one start of several: nothing can be predicted, or nothing there is admissible.
NO_END: tuple[type[Exception], ...] = (*REFUSED, ValueError)


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


@dataclass(frozen=True, eq=False)
class Weighted:
    """A residual with the prior's rows below: what `minimise` sees."""

    vector: Real
    jacobian: Real
    data: Residual


@dataclass(frozen=True, eq=False)
class Descent(Minimum):
    """The end of a way down through the smoothed problems.

    ``costs`` by the number of the width, as far as it was followed; ``ended`` is whether that was to no smoothing.
    """

    costs: Mapping[int, float]
    ended: bool


class Search:
    """The least-squares problem of one objective: bounds, prior and inequalities around it.

    Only the parameters of the indices `free` move, all by default; the priors of those in `lifted` are left out.
    """

    def __init__(
        self, objective: Objective, *, poisson: tuple[float, float] | None = None, free: Sequence[int] | None = None,
        lifted: Collection[int] = (),
    ) -> None:
        self.objective, self.parameters = objective, objective.parameters
        self.free = np.arange(len(self.parameters)) if free is None else np.array(sorted(free), dtype=int)
        self.low = np.array([p.low for p in self.parameters])
        self.high = np.array([p.high for p in self.parameters])
        self.scale = np.array([p.scale for p in self.parameters])
        self.centre = np.array([p.start for p in self.parameters])
        self.precision = np.array([0.0 if p.prior is None or i in lifted else 1.0 / p.prior
                                   for i, p in enumerate(self.parameters)])
        problems = [r.problem for r in objective.recordings]
        moving = [self.parameters[i] for i in self.free]
        found = (inequalities(problems, moving) if poisson is None
                 else inequalities(problems, moving, poisson=poisson))
        self.inequalities: tuple[Inequality, ...] = tuple(self._among_all(inequality) for inequality in found)

    def on(self, objective: Objective) -> Search:
        """The same problem with its objective predicted in another way."""
        other = copy.copy(self)
        other.objective = objective
        return other

    def thinned(self) -> Search:
        """The same problem with at most about :data:`SEARCHED_POINTS` of each recording's points."""
        return self.on(self.objective.thinned(SEARCHED_POINTS))

    def _among_all(self, inequality: Inequality) -> Inequality:
        """An inequality of the free parameters as one of all."""
        slopes = np.zeros((len(self.parameters), *inequality.constant.shape))
        slopes[self.free] = inequality.slopes
        return replace(inequality, slopes=slopes)

    def evaluate(
        self, x: Real, deviation: Sequence[Real | float], smoothing: float = 0.0, free: Collection[int] | None = None
    ) -> Weighted:
        """Data and prior, about the parameters' own starts, at x (p,); `free` as in `Objective.predict`."""
        data = self.objective(x, deviation=deviation, smoothing=smoothing, free=free)
        vector = np.concatenate([data.vector, (x - self.centre) * self.precision])
        return Weighted(vector, np.vstack([data.jacobian, np.diag(self.precision)]), data)

    def minimise(
        self, x: Real, deviation: Sequence[Real | float], *, smoothing: float = 0.0, limit: int = 40,
        tolerance: float = 1e-6, radius: float = 1.0, fixed: tuple[int, ...] = (), trusted: float = np.inf,
    ) -> Minimum:
        """The least cost near x; the parameters of the indices `fixed` stay where they are.

        Steps that lead to where predictions have an estimated relative error above `trusted` are shortened.

        Raises:
            NotEnriched: that of x itself is above `trusted`.
        """
        free = np.setdiff1d(self.free, fixed)
        moved = frozenset(map(int, free))

        def whole(y: Real) -> Real:
            result = x.copy()
            result[free] = y
            return result

        def reduced(y: Real) -> Weighted:
            full = self.evaluate(whole(y), deviation, smoothing, moved)
            if math.isfinite(trusted) and not full.data.error <= trusted:
                raise NotEnriched(full.data.error, trusted, self.objective.solves)
            return Weighted(full.vector, full.jacobian[:, free], full.data)

        found = minimise(reduced, x[free], low=self.low[free], high=self.high[free], scale=self.scale[free],
                         inequalities=self._conditions(x, free), radius=radius, tolerance=tolerance, limit=limit,
                         refused=REFUSED)
        self.objective.refusals.extend(found.refusals)
        return replace(found, x=whole(found.x))

    def inside(self, x: Real) -> Real:
        """Where :meth:`minimise` begins from x (p,): at x, or near it and strictly inside of what parameters may be."""
        result, free = x.copy(), self.free
        result[free] = interior(x[free], self.low[free], self.high[free], self._conditions(x, free))
        return result

    def _conditions(self, x: Real, free: NDArray[np.int64]) -> list[Inequality]:
        """The inequalities of the parameters of the indices `free`, with the others where x (p,) has them."""
        held = x.copy()
        held[free] = 0.0
        return [Inequality(i.name, i(held), i.slopes[free]) for i in self.inequalities if i.slopes[free].any()]

    def descend(
        self, x: Real, progress: Callable[[], None], *, first: int = 0, rival: Descent | None = None
    ) -> Descent:
        """From a start through the smoothed problems, from number `first` on, to the recordings themselves.

        What the smoothed spectra cannot see is held by the prior. The way is not followed to its end once it is
        clearly worse than `rival` was at the same width.
        """
        steps, costs, ended = 0, {}, True
        widths = self.widths()
        for number in range(min(first, len(widths) - 1), len(widths)):
            width = widths[number]
            # A smoothed spectrum has as many independent points as widths fit into the band.
            deviation = [EXPLORATION * np.sqrt(max(1.0, width / float(np.median(np.diff(r.measured.frequency)))))
                         for r in self.objective.recordings]
            found = self.minimise(x, deviation, smoothing=width, limit=STEPS, tolerance=1e-4)
            x, steps = found.x, steps + found.iterations
            costs[number] = found.cost
            progress()
            ended = width == 0.0
            if not ended and rival is not None and found.cost > WORSE * rival.costs.get(number, np.inf):
                break
        return Descent(x, found.residual, found.cost, found.converged, steps, found.reason, found.refusals, costs,
                       ended)

    def widths(self) -> list[float]:
        """Half widths (Hz) of the smoothed problems: those that a recording's points can show, then none."""
        frequency = self.objective.recordings[0].measured.frequency
        middle, spacing = float(np.mean(frequency[[0, -1]])), float(np.median(np.diff(frequency)))
        return [w * middle for w in WIDTHS if w == 0.0 or w * middle > spacing]


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


def _unexplained(end: Minimum) -> bool:
    """Whether what an end leaves is more than noise: large and systematic, or too large for any noise."""
    data: Residual = end.residual.data  # type: ignore[attr-defined]
    for log in data.log_ratio:
        rms = np.sqrt(np.mean(np.abs(log) ** 2))
        if rms > NO_NOISE or (rms > UNEXPLAINED and certainty.correlation_length(log) > 1.0):
            return True
    return False


def _start_spectra(scout: Search, recordings: Sequence[Recording]) -> list[NDArray[np.complex128]]:
    """The impedance of every recording's start, as it would be recorded, on the mesh of the search."""
    return [certainty.unrefined(scout.objective, scout.centre, index, recording.measured.frequency, COARSE)
            for index, recording in enumerate(recordings)]


def refine(search: Search, x: Real) -> tuple[Minimum, tuple[Noise, ...]]:
    """The minimum near x with every recording weighted by the noise its own residual shows.

    The spectra's own uncertainties are scaled as a whole, or a constant relative deviation is found.
    """
    shapes = [certainty.noise_shape(r.measured) for r in search.objective.recordings]
    levels = [0.01 if r.measured.uncertainty is None else 1.0 for r in search.objective.recordings]
    for _ in range(3):
        deviation = [level * shape for level, shape in zip(levels, shapes, strict=True)]
        minimum = search.minimise(x, deviation, radius=0.3, tolerance=1e-7)
        x = minimum.x
        data = minimum.residual.data  # type: ignore[attr-defined]
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
    found: Sequence[_Trial], best: Minimum, search: Search, noise: Sequence[Noise]
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
        data: Residual = end.residual.data  # type: ignore[attr-defined]
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
    recordings: Sequence[Recording], before: Sequence[NDArray[np.complex128]], minimum: Minimum, noise: Sequence[Noise]
) -> tuple[Match, ...]:
    data: Residual = minimum.residual.data  # type: ignore[attr-defined]
    result = []
    for recording, first, last, level in zip(recordings, before, data.impedance, noise, strict=True):
        frequency = recording.measured.frequency
        start, fitted = (Spectrum(frequency, z, origin=Origin("simulated")) for z in (first, last))
        result.append(Match(recording.name, recording.measured, start, fitted, compare(recording.measured, start),
                            compare(recording.measured, fitted), level))
    return tuple(result)


def _findings(
    minimum: Minimum, improved: bool, starts: Sequence[Start], matches: Sequence[Match],
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
