"""Descents from several starts: further ones where the recordings stay unexplained, and where each of them ended."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from workbench.fitting.search import NO_END, SCHEDULE, FitDescent, FitSearch, Optimum
from workbench.fitting.uncertainty import Noise
from workbench.jobs.progress import Progress
from workbench.search.multistart import StartPoint, Trial, multistart
from workbench.search.optimum import is_same_optimum, separation

Real = NDArray[np.float64]

#: A recording is explained once no more than this many times the noise that it states is left, and once what is left is
#: white. Where it is not white, more than the first is unexplained; where it is, more than the second. Doubled, the
#: first would take an optimum beside the right one for it; the second is what an uncertainty may be mistaken by.
STRUCTURED, NOISY = 1.2, 2.0

#: Bounds for a recording that states no noise, as an rms of |ln ratio|: the repeatability of instruments, if the
#: residual is not white, and a size too large for any noise. On a sparse grid sharp overtones that miss each other look
#: white.
REPEATED, NO_NOISE = 0.003, 0.1

#: Stiffnesses that rule one family of overtones each, and the factors that move it by so many overtones of some ten.
OVERTONE_GROUPS: tuple[tuple[str, ...], ...] = (("c11", "c12"), ("c44",), ("shear_modulus", "bulk_modulus"))
OVERTONE_FACTORS = {0: 1.0, -1: 0.88, 1: 1.13, -2: 0.78, 2: 1.27}

#: Factors that move the thickness of a film by so many optima. It is a spring between two resonators, and sharp
#: overtones of both pass each other with it: optima stand 8 to 20 % apart, each in its own narrow valley, lower towards
#: the right one.
FILM_FACTORS = {0: 1.0, -1: 0.87, 1: 1.15, -2: 0.76, 2: 1.32}

#: The last stage of the schedule.
UNSMOOTHED = len(SCHEDULE.stages)

#: Samples of the prior to start from where offsets did not help.
PRIOR_SAMPLES = 8

#: An end is refined if it costs less than this many times the best on the mesh of the search, whose own error may make
#: the right end look the worse by a factor of two in rms.
CLOSE = 4.0

#: An end is better if the logarithm of what it leaves is lower by this: less is the end of one valley found twice.
#: Doubled, an optimum that leaves 2 % less is not taken for another.
BETTER = 0.01

#: Outcomes of a start.
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
class Refined:
    """A minimum on the mesh asked for, weighted by the noise that each recording shows there."""

    minimum: Optimum
    noise: tuple[Noise, ...]

    @property
    def is_explained(self) -> bool:
        """Whether the residual of every recording is noise: the stated noise, or no more than instruments show."""
        found = []
        for log, noise in zip(self.minimum.residual.data.log_ratio, self.noise, strict=True):
            rms, white = float(np.sqrt(np.mean(np.abs(log) ** 2))), noise.correlation == 1.0
            if noise.stated:
                found.append(noise.ratio <= STRUCTURED or (white and noise.ratio <= NOISY))
            else:
                found.append(rms <= REPEATED or (white and rms <= NO_NOISE))
        return all(found)

    @property
    def log_deviation(self) -> float:
        """Mean logarithm of the deviations that recordings show: the smaller, the better explained together."""
        return float(np.mean([np.log(each.deviation) for each in self.noise]))


#: A search on the mesh asked for, from a point (p,).
Refine = Callable[[Real], Refined]


@dataclass(frozen=True, eq=False)
class FitEnd:
    """The end of one start: its ``descent`` on the mesh of the search, and the minimum on the mesh asked for where the
    end was worth one. A start on the mesh asked for has the minimum alone."""

    descent: FitDescent | None
    refined: Refined | None = None

    @property
    def optimum(self) -> Optimum:
        """The end on the mesh that the start was on."""
        found = self.descent if self.refined is None else self.descent or self.refined.minimum
        assert found is not None
        return found


#: Starts one and two optima from a point (p,), nearest first.
Offsets = Callable[[FitSearch, Real], list[StartPoint]]


@dataclass(eq=False)
class FitMultistart:
    """A search from several starts as it goes on, with the best end so far; at most ``tries`` starts are tried.

    Ends are looked for on the mesh of ``search``, and those that cost about as little as the best or less are refined.
    The one that leaves least then is the best. No start is tried once that leaves nothing unexplained.
    """

    search: FitSearch
    refine: Refine
    best: FitDescent
    tries: int
    progress: Progress
    trials: list[Trial[FitEnd]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.refined = self.refine(self.best.x)
        self.reached = FitEnd(self.best, self.refined)
        self._distinct = [self.best]

    def run(self, samples: Sequence[StartPoint]) -> None:
        """Try offsets of the best end and `samples`, and offsets of films on the mesh asked for: the error of the mesh
        of the search may hide the valley of a thin film."""
        self._try(self.best.x, offsets, samples, self._searched)
        self._try(self.refined.minimum.x, on_mesh_offsets, (), self._on_mesh)

    def _searched(self, start: StartPoint) -> FitEnd:
        end = self.search.descend(start.x, first=start.stage, rival=self.best)
        if not end.ended or end.cost > CLOSE * self.best.cost or any(
                is_same_optimum(end.x, other.x, self.search.errors(other), self.search.scale)
                for other in self._distinct):
            return FitEnd(end)
        self._distinct.append(end)
        return FitEnd(end, self.refine(end.x))

    def _on_mesh(self, start: StartPoint) -> FitEnd:
        return FitEnd(None, self.refine(self.search.inside(start.x)))

    def _try(
        self, x: Real, offsets_of: Offsets, samples: Sequence[StartPoint], attempt: Callable[[StartPoint], FitEnd]
    ) -> None:
        def following(trial: Trial[FitEnd], waiting: list[StartPoint]) -> Sequence[StartPoint]:
            end = trial.end
            if (end is not None and end.refined is not None
                    and end.refined.log_deviation < self.refined.log_deviation - BETTER):
                self.reached, self.refined, self.best = end, end.refined, end.descent or self.best
                # A move that helped once may help again.
                again = sorted(offsets_of(self.search, end.optimum.x), key=lambda each: each.label != trial.start.label)
                waiting = [*again, *(each for each in waiting if each in samples)]
            return () if self.refined.is_explained else waiting

        starts = () if self.refined.is_explained else (*offsets_of(self.search, x), *samples)
        self.trials += multistart(starts, attempt, refused=NO_END, tries=self.tries - len(self.trials),
                                  following=following, progress=self.progress)


def offsets(search: FitSearch, x: Real) -> list[StartPoint]:
    """Starts one and two optima from x (p,), nearest first: films alone, then overtones."""
    return [*film_offsets(search, x), *overtone_offsets(search, x)]


def on_mesh_offsets(search: FitSearch, x: Real) -> list[StartPoint]:
    """Starts with a film one and two optima from x (p,), nearest first, for the mesh asked for."""
    return [replace(each, label=f"{each.label}, on the mesh asked for") for each in film_offsets(search, x)]


def film_offsets(search: FitSearch, x: Real) -> list[StartPoint]:
    """Starts with a film one and two optima from x (p,), nearest first. Any smoothing would undo the offset."""
    result = []
    films = [i for i, p in enumerate(search.parameters) if p.is_film]
    for number, factor in sorted(FILM_FACTORS.items(), key=lambda item: abs(item[0])):
        for film in films if number else ():
            begin = x.copy()
            begin[film] = np.clip(factor * x[film], search.low[film], search.high[film])
            result.append(StartPoint(f"film {search.parameters[film].name} x {factor:g}", begin, UNSMOOTHED))
    return result


def overtone_offsets(search: FitSearch, x: Real) -> list[StartPoint]:
    """Starts one and two overtones from x (p,), nearest first. The widest smoothing would undo the offset."""
    groups = [[i for i, p in enumerate(search.parameters) if not p.is_loss and p.parsed.coefficient in names]
              for names in OVERTONE_GROUPS]
    groups = [group for group in groups if group]
    result = []
    steps = sorted(itertools.product(OVERTONE_FACTORS, repeat=len(groups)), key=lambda step: sum(map(abs, step)))
    for step in steps[1:]:
        begin, words = x.copy(), []
        for group, overtones in zip(groups, step, strict=True):
            begin[group] *= OVERTONE_FACTORS[overtones]
            if overtones:
                first = search.parameters[group[0]].parsed.coefficient
                words.append(f"{first} x {OVERTONE_FACTORS[overtones]:g}")
        result.append(StartPoint("hop " + ", ".join(words), begin, 1))
    return result


def prior_samples(search: FitSearch, count: int, seed: int) -> list[StartPoint]:
    """Starts sampled from the prior; losses, whose prior is wide, within a factor of two of the start."""
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
    """Every start with where it ended, seen from the end that was `reached`.

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
        rms = float(np.sqrt(np.mean(np.abs(np.concatenate(end.residual.data.log_ratio)) ** 2)))
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
        result.append(Start(trial.start.label, begin, end.x, rms, outcome, end.iterations))
    return tuple(result)


def where_they_ended(starts: Sequence[Start]) -> str:
    """The ends of all descents, in one sentence."""
    same = sum(s.outcome == SAME for s in starts)
    text = f"{same} of {len(starts)} descents reached the same optimum"
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
