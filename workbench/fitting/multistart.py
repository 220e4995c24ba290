"""Descents from several starts, and the end of each. Further ones are made while recordings stay unexplained."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workbench.fitting.measurement_model import rms
from workbench.fitting.noise import Noise
from workbench.fitting.search import NO_END, SCHEDULE, FitDescent, FitSearch, Optimum
from workbench.jobs.progress import Progress
from workbench.search.multistart import StartPoint, Trial, multistart
from workbench.search.optimum import is_same_optimum, separation

Real = NDArray[np.float64]

#: Stiffnesses that rule one family of overtones each, and the factors that move it by so many overtones of some ten.
OVERTONE_GROUPS: tuple[tuple[str, ...], ...] = (("c11", "c12"), ("c44",), ("shear_modulus", "bulk_modulus"))
OVERTONE_FACTORS = {0: 1.0, -1: 0.88, 1: 1.13, -2: 0.78, 2: 1.27}

#: Factors that move the thickness of a film by one or two optima, nearest first. It is a spring between two resonators,
#: and sharp overtones of both pass each other with it: optima stand 8 to 20 % apart, each in its own narrow valley,
#: lower towards the right one.
FILM_FACTORS = (0.87, 1.15, 0.76, 1.32)

#: The last stage of the schedule.
UNSMOOTHED = len(SCHEDULE.stages)

#: Further descents, at most, while a recording stays unexplained. After fewer, a better optimum may be among the starts
#: that nobody tried. Doubled, a fit whose model misses something takes up to twice as long.
TRIES = 32

#: Samples of the prior to start from where offsets did not help.
PRIOR_SAMPLES = 8

#: An end is refined if it costs less than this many times the best on the mesh of the search, whose own error may make
#: the right end look the worse by a factor of two in rms.
CLOSE = 4.0

#: An end is better if the logarithm of its residual is lower by this: smaller differences are within one valley.
#: Doubled, an optimum with a residual 2 % smaller does not count as another.
BETTER = 0.01

#: Outcomes of a start.
SAME, GIVEN_UP = "same optimum", "given up: worse than the best while still smoothed"


@dataclass(frozen=True, eq=False)
class Start:
    """A start, its end (p,) SI, rms of |ln ratio|, and outcome."""

    label: str
    begin: Real
    end: Real
    rms: float
    outcome: str
    steps: int


class Refined(NamedTuple):
    """A minimum on the requested mesh, weighted by each recording's noise there."""

    minimum: Optimum
    noise: tuple[Noise, ...]

    @property
    def is_explained(self) -> bool:
        """Whether the residual of every recording is noise."""
        return all(noise.explains(rms(log))
                   for log, noise in zip(self.minimum.residual.data.log_ratio, self.noise, strict=True))

    @property
    def log_deviation(self) -> float:
        """Mean logarithm of the deviations of recordings; smaller is better."""
        return float(np.mean([np.log(each.deviation) for each in self.noise]))


@dataclass(frozen=True, eq=False)
class FitEnd:
    """The end of one start: its ``descent`` and the ``refined`` minimum. The descent is on the mesh of the search; only
    good ends are refined. A start on the requested mesh has the minimum alone."""

    descent: FitDescent | None
    refined: Refined | None = None

    @property
    def optimum(self) -> Optimum:
        """The end on the mesh that the start was on."""
        if self.descent is not None:
            return self.descent
        assert self.refined is not None
        return self.refined.minimum


@dataclass(eq=False)
class FitMultistart:
    """A search from several starts, with the best end so far.

    At most ``tries`` starts are tried. Ends are searched for on the mesh of ``search``; those near the best cost or
    below are refined by ``refine``, from a point (p,) on the requested mesh. The one of the smallest residual is then
    the best. The search stops once every recording is explained. ``untried`` counts the starts without a descent;
    ``interrupted`` tells whether the search ended early.
    """

    search: FitSearch
    refine: Callable[[Real], Refined]
    best: FitDescent
    tries: int
    progress: Progress
    trials: list[Trial[FitEnd]] = field(default_factory=list)
    untried: int = 0
    interrupted: bool = False

    def __post_init__(self) -> None:
        self.refined = self.refine(self.best.x)
        self.reached = FitEnd(self.best, self.refined)
        self._distinct = [self.best]

    def run(self, samples: Sequence[StartPoint], others: Sequence[StartPoint] = ()) -> None:
        """Try the starts `others`, then offsets of the best end and `samples`. Offsets of films on the requested mesh
        follow: the error of the search mesh may hide the valley of a thin film. An interruption keeps the best end."""
        try:
            self._try(self._searched, self.best.x, lambda _x: [], others)
            self._try(self._searched, self.best.x,
                      lambda x: [*film_offsets(self.search, x), *overtone_offsets(self.search, x)], samples)
            self._try(lambda start: FitEnd(None, self.refine(self.search.inside(start.x))), self.refined.minimum.x,
                      lambda x: [replace(each, label=f"{each.label}, on the requested mesh")
                                 for each in film_offsets(self.search, x)])
        except KeyboardInterrupt:
            self.interrupted = True

    def _searched(self, start: StartPoint) -> FitEnd:
        end = self.search.descend(start.x, first=start.stage, rival=self.best)
        if not end.ended or end.cost > CLOSE * self.best.cost or any(
                is_same_optimum(end.x, other.x, self.search.errors(other), self.search.scale)
                for other in self._distinct):
            return FitEnd(end)
        self._distinct.append(end)
        return FitEnd(end, self.refine(end.x))

    def _try(
        self, attempt: Callable[[StartPoint], FitEnd], x: Real, offsets: Callable[[Real], list[StartPoint]],
        samples: Sequence[StartPoint] = (),
    ) -> None:
        """Try the `offsets` of x (p,) or a better end, then `samples`."""
        starts = () if self.refined.is_explained else (*offsets(x), *samples)
        done, before = len(self.trials), self.untried
        more, self.untried = self.tries - done, before + len(starts)

        def following(trial: Trial[FitEnd], waiting: list[StartPoint]) -> Sequence[StartPoint]:
            self.trials.append(trial)
            end = trial.end
            if (end is not None and end.refined is not None
                    and end.refined.log_deviation < self.refined.log_deviation - BETTER):
                self.reached, self.refined, self.best = end, end.refined, end.descent or self.best
                # A move that helped once may help again.
                again = sorted(offsets(end.optimum.x), key=lambda each: each.label != trial.start.label)
                waiting = [*again, *(each for each in waiting if each in samples)]
            if self.refined.is_explained:
                waiting = []
            self.untried = before + len(waiting)
            return waiting

        multistart(starts, attempt, refused=NO_END, tries=more, following=following,
                   progress=lambda label, share: self.progress(label, (done + share * more) / self.tries))


def film_offsets(search: FitSearch, x: Real) -> list[StartPoint]:
    """Starts with a film one or two optima away, nearest first. Any smoothing would undo the offset."""
    return [StartPoint(f"film {p.name} x {factor:g}", np.where(
        np.arange(x.size) == i, np.clip(factor * x, search.low, search.high), x), UNSMOOTHED)
        for factor in FILM_FACTORS for i, p in enumerate(search.parameters) if p.is_film]


def overtone_offsets(search: FitSearch, x: Real) -> list[StartPoint]:
    """Starts one and two overtones from x (p,), nearest first. The widest smoothing would undo the offset."""
    groups = [group for names in OVERTONE_GROUPS if (group := [
        i for i, p in enumerate(search.parameters) if not p.is_loss and p.parsed.coefficient in names])]
    result = []
    steps = sorted(itertools.product(OVERTONE_FACTORS, repeat=len(groups)), key=lambda step: sum(map(abs, step)))
    for step in steps[1:]:
        begin, factors = x.copy(), [OVERTONE_FACTORS[overtones] for overtones in step]
        for group, factor in zip(groups, factors, strict=True):
            begin[group] *= factor
        words = [f"{search.parameters[group[0]].parsed.coefficient} x {factor:g}"
                 for group, factor in zip(groups, factors, strict=True) if factor != 1.0]
        result.append(StartPoint(f"hop {', '.join(words)}", begin, 1))
    return result


def prior_samples(search: FitSearch, count: int, seed: int) -> list[StartPoint]:
    """Starts sampled from the prior. Losses, whose prior is wide, lie within a factor of two of the start."""
    random = np.random.default_rng(seed)
    loss = np.array([p.is_loss for p in search.parameters])
    result = []
    for number in range(count):
        factor = np.exp(np.log(2.0) * random.uniform(-1.0, 1.0, loss.size))
        offset = search.scale * random.standard_normal(loss.size)
        result.append(StartPoint(f"draw {number + 1}",
                                 np.where(loss, search.centre * factor, search.centre + offset)))
    return result


def listed_starts(
    trials: Sequence[Trial[FitEnd]], reached: FitEnd, coarse: FitSearch, fine: FitSearch
) -> tuple[Start, ...]:
    """Every start with its end, relative to the best end `reached`.

    Ends on the mesh of the `coarse` search are compared with the end there that led to the answer, if one did, and all
    others with the answer on the mesh of the `fine` one.
    """
    assert reached.refined is not None
    result = []
    for trial in trials:
        if trial.end is None:
            x = trial.start.x
            result.append(Start(trial.start.label, x, x, np.inf, f"failed: {trial.reason}", 0))
            continue
        end, descent = trial.end.optimum, trial.end.descent
        search, best = (coarse, reached.descent) if descent and reached.descent else (fine, reached.refined.minimum)
        off = separation(end.x, best.x, search.errors(best), search.scale)
        worst = int(np.argmax(off))
        if off[worst] <= 1.0:
            outcome = SAME
        elif descent is not None and not descent.ended:
            outcome = GIVEN_UP
        else:
            outcome = f"another optimum: {search.parameters[worst].name} differs most"
        begin = trial.start.x if descent is None else descent.begin
        result.append(Start(trial.start.label, begin, end.x, end.residual.data.rms, outcome, end.iterations))
    return tuple(result)


def where_they_ended(starts: Sequence[Start]) -> str:
    """The ends of all descents, in one sentence."""
    if len(starts) == 1:
        return "One descent; no other start was tried."
    same, given_up = (sum(s.outcome == outcome for s in starts) for outcome in (SAME, GIVEN_UP))
    failed = [s for s in starts if not np.isfinite(s.rms)]
    others = sorted((s for s in starts if np.isfinite(s.rms) and s.outcome not in (SAME, GIVEN_UP)),
                    key=lambda s: s.rms)
    text = f"{same} of {len(starts)} descents reached the same optimum"
    if given_up:
        text += f", {given_up} were {GIVEN_UP}"
    if others:
        text += f", {len(others)} ended elsewhere, the best of them: " + "; ".join(
            f"{s.label} at an rms of {s.rms:.3g} ({s.outcome})" for s in others[:3])
    if failed:
        text += f", {len(failed)} failed, the first of them: {failed[0].label} ({failed[0].outcome})"
    return text + "."
