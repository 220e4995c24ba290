"""Descents from several starts: further ones where the recordings stay unexplained, and where each of them ended."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.fitting.search import EXPLORATION, NO_END, WIDTHS, FitSearch, Optimum, SmoothedDescent
from workbench.fitting.uncertainty import Noise

Real = NDArray[np.float64]

#: A recording is explained once no more than this many times the noise that it states is left, and once what is left is
#: white. Where it is not white, more than the first is unexplained; where it is, more than the second. Doubled, the
#: first would take an optimum beside the right one for it; the second is what an uncertainty may be mistaken by.
STRUCTURED, NOISY = 1.2, 2.0

#: The same of a recording that states no noise, as an rms of |ln ratio|: what instruments repeat to, if it is not
#: white, and what is too large for any noise. On a sparse grid sharp overtones that miss each other look white.
REPEATED, NO_NOISE = 0.003, 0.1

#: Stiffnesses that rule one family of overtones each, and the factors that move it by so many overtones of some ten.
OVERTONE_GROUPS: tuple[tuple[str, ...], ...] = (("c11", "c12"), ("c44",), ("shear_modulus", "bulk_modulus"))
OVERTONE_FACTORS = {0: 1.0, -1: 0.88, 1: 1.13, -2: 0.78, 2: 1.27}

#: The same of the thickness of a film. It is a spring between two resonators, and sharp overtones of both pass each
#: other with it: optima stand 8 to 20 % apart, each in its own narrow valley, lower towards the right one.
FILM_FACTORS = {0: 1.0, -1: 0.87, 1: 1.15, -2: 0.76, 2: 1.32}

#: What the labels of starts offset by overtones, or in a film, and of samples of the prior, begin with.
OFFSET_LABEL, FILM_LABEL, SAMPLE_LABEL = "hop", "film", "draw"

#: Samples of the prior to start from where offsets did not help.
PRIOR_SAMPLES = 8

#: An end is refined if it costs less than this many times the best on the mesh of the search, whose own error may make
#: the right end look the worse by a factor of two in rms.
CLOSE = 4.0

#: An end is better if the logarithm of what it leaves is lower by this: less is the end of one valley found twice.
#: Doubled, an optimum that leaves 2 % less is not taken for another.
BETTER = 0.01

#: Two ends are the same optimum if every parameter agrees within this many standard errors of either, or within this
#: share of its prior, whichever is larger: a flat direction of the data may be anywhere along it.
SAME_ERRORS, SAME_SHARE = 2.0, 0.02

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
class Trial:
    """One descent: from where (p,), to where, and why not where it has no end."""

    label: str
    begin: Real
    end: SmoothedDescent | None
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Refined:
    """A minimum on the mesh asked for, weighted by the noise that each recording shows there."""

    minimum: Optimum
    noise: tuple[Noise, ...]

    @property
    def explained(self) -> bool:
        """Whether what is left of every recording is noise: that which it states, or no more than instruments show."""
        found = []
        for log, noise in zip(self.minimum.residual.data.log_ratio, self.noise, strict=True):
            rms, white = float(np.sqrt(np.mean(np.abs(log) ** 2))), noise.correlation == 1.0
            if noise.stated:
                found.append(noise.ratio <= STRUCTURED or (white and noise.ratio <= NOISY))
            else:
                found.append(rms <= REPEATED or (white and rms <= NO_NOISE))
        return all(found)

    @property
    def left(self) -> float:
        """Mean logarithm of the deviations that recordings show: the smaller, the better explained together."""
        return float(np.mean([np.log(each.deviation) for each in self.noise]))


#: A search on the mesh asked for, from a point (p,).
Refine = Callable[[Real], Refined]


def descent_from(
    search: FitSearch, label: str, begin: Real, progress: Callable[[], None], rival: SmoothedDescent | None = None
) -> Trial:
    """The descent from `begin` (p,), moved to where it is admissible.

    Smoothing would undo an offset: of an overtone the widest is left out, of a film all of it.
    """
    first = 1 if label.startswith(OFFSET_LABEL) else len(WIDTHS) if label.startswith(FILM_LABEL) else 0
    try:
        begin = search.inside(begin)
        return Trial(label, begin, search.descend(begin, progress, first=first, rival=rival))
    except NO_END as error:
        return Trial(label, begin, None, f"{type(error).__name__}: {error}")


def multistart(
    search: FitSearch, refine: Refine, best: SmoothedDescent, samples: Sequence[tuple[str, Real]], tries: int,
    progress: Callable[[str], None],
) -> tuple[SmoothedDescent, Refined, list[Trial]]:
    """The best end reached from offsets of `best` and from the `samples`, refined, and every descent, at most `tries`.

    Ends are looked for on the mesh of `search`; those that cost about as little as the best or less are refined, and
    the one that leaves least then is the best. No descent is begun once that leaves nothing unexplained.
    """
    tried: list[Trial] = []
    refined, ends = refine(best.x), [best.x]
    waiting = [*offsets(search, best.x), *samples]
    while waiting and len(tried) < tries and not refined.explained:
        label, begin = waiting.pop(0)
        progress(label)
        trial = descent_from(search, label, begin, lambda: None, rival=best)
        tried.append(trial)
        end = trial.end
        if end is None or not end.ended or end.cost > CLOSE * best.cost or any(
                _close(search, end.x, other) for other in ends):
            continue
        ends.append(end.x)
        other = refine(end.x)
        if other.left < refined.left - BETTER:
            best, refined = end, other
            # What helped once may help again.
            again = sorted(offsets(search, best.x), key=lambda offset: offset[0] != label)
            waiting = [*again, *(each for each in waiting if each[0].startswith(SAMPLE_LABEL))]
    return best, _from_film_to_film(search, refine, refined, tries - len(tried), progress), tried


def _from_film_to_film(
    search: FitSearch, refine: Refine, best: Refined, tries: int, progress: Callable[[str], None]
) -> Refined:
    """The best that films moved to their next optima lead to on the mesh asked for, from there on as long as it helps,
    with at most so many `tries`.

    The error of a mesh for the search may hide the valley of a thin film: such a film is moved here once more.
    """
    waiting = film_offsets(search, best.minimum.x)
    while waiting and tries > 0 and not best.explained:
        label, begin = waiting.pop(0)
        tries -= 1
        progress(f"{label}, refined")
        try:
            other = refine(search.inside(begin))
        except NO_END:
            continue
        if other.left < best.left - BETTER:
            best = other
            waiting = sorted(film_offsets(search, best.minimum.x), key=lambda offset: offset[0] != label)
    return best


def _close(search: FitSearch, one: Real, other: Real) -> bool:
    """Whether two ends (p,) differ by less than :data:`SAME_SHARE` of what is known before, in every parameter."""
    return bool(np.all(np.abs(one - other) <= SAME_SHARE * search.scale))


def offsets(search: FitSearch, x: Real) -> list[tuple[str, Real]]:
    """Starts one and two optima from x (p,) by label, nearest first: films alone, then overtones."""
    return [*film_offsets(search, x), *overtone_offsets(search, x)]


def film_offsets(search: FitSearch, x: Real) -> list[tuple[str, Real]]:
    """Starts with a film one and two optima from x (p,) by label, nearest first."""
    result = []
    films = [i for i, p in enumerate(search.parameters) if p.is_film]
    for number, factor in sorted(FILM_FACTORS.items(), key=lambda item: abs(item[0])):
        for film in films if number else ():
            begin = x.copy()
            begin[film] = np.clip(factor * x[film], search.low[film], search.high[film])
            result.append((f"{FILM_LABEL} {search.parameters[film].name} x {factor:g}", begin))
    return result


def overtone_offsets(search: FitSearch, x: Real) -> list[tuple[str, Real]]:
    """Starts one and two overtones from x (p,) by label, nearest first."""
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
        result.append((f"{OFFSET_LABEL} " + ", ".join(words), begin))
    return result


def prior_samples(search: FitSearch, count: int, seed: int) -> list[tuple[str, Real]]:
    """Starts sampled from the prior, by label; losses, whose prior is wide, within a factor of two of the start."""
    random = np.random.default_rng(seed)
    loss = np.array([p.is_loss for p in search.parameters])
    result = []
    for number in range(count):
        factor = np.exp(np.log(2.0) * random.uniform(-1.0, 1.0, loss.size))
        offset = search.scale * random.standard_normal(loss.size)
        result.append((f"{SAMPLE_LABEL} {number + 1}", np.where(loss, search.centre * factor, search.centre + offset)))
    return result


def listed_starts(
    found: Sequence[Trial], best: Optimum, search: FitSearch, noise: Sequence[Noise]
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


def where_they_ended(starts: Sequence[Start]) -> str:
    """Where all descents ended, in one sentence."""
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
