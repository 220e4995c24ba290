"""Descents from several starts: further ones where the recordings stay unexplained, and where each of them ended."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.fitting.search import EXPLORATION, NO_END, Descent, Optimum, Search
from workbench.fitting.uncertainty import Noise, correlation_length

Real = NDArray[np.float64]

#: Further starts are tried if, at the end of a descent, more than the first rms of |ln ratio| remains and
#: is not white, or more than the second: on a sparse grid sharp overtones that miss each other look white.
UNEXPLAINED, NO_NOISE = 0.01, 0.1

#: Stiffnesses that rule one family of overtones each, and the factors that move it by so many overtones of some ten.
OVERTONE_GROUPS: tuple[tuple[str, ...], ...] = (("c11", "c12"), ("c44",), ("shear_modulus", "bulk_modulus"))
OVERTONE_FACTORS = {0: 1.0, -1: 0.88, 1: 1.13, -2: 0.78, 2: 1.27}

#: What the labels of starts offset by overtones, and of samples of the prior, begin with.
OFFSET_LABEL, SAMPLE_LABEL = "hop", "draw"

#: Samples of the prior to start from where offsets did not help.
PRIOR_SAMPLES = 8

#: An end is better if it costs less than this share of the best.
BETTER = 0.9

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
    end: Descent | None
    reason: str = ""


def descent_from(
    search: Search, label: str, begin: Real, progress: Callable[[], None], rival: Descent | None = None
) -> Trial:
    """The descent from `begin` (p,), moved to where it is admissible.

    From an offset start it leaves out the widest smoothing, which would undo the offset.
    """
    try:
        begin = search.inside(begin)
        return Trial(label, begin, search.descend(
            begin, progress, first=1 if label.startswith(OFFSET_LABEL) else 0, rival=rival))
    except NO_END as error:
        return Trial(label, begin, None, f"{type(error).__name__}: {error}")


def multistart(
    search: Search, best: Descent, samples: Sequence[tuple[str, Real]], tries: int, progress: Callable[[str], None]
) -> tuple[Descent, list[Trial]]:
    """The best end reached from overtone offsets of `best` and from the `samples`, and every descent, at most `tries`.

    None is begun once the best end leaves nothing unexplained.
    """
    tried: list[Trial] = []
    waiting = [*overtone_offsets(search, best.x), *samples]
    while waiting and len(tried) < tries and _unexplained(best):
        label, begin = waiting.pop(0)
        progress(label)
        trial = descent_from(search, label, begin, lambda: None, rival=best)
        tried.append(trial)
        end = trial.end
        if end is not None and end.ended and end.cost < BETTER * best.cost:
            best = end
            remaining = (other for other in waiting if other[0].startswith(SAMPLE_LABEL))
            waiting = [*overtone_offsets(search, best.x), *remaining]
    return best, tried


def overtone_offsets(search: Search, x: Real) -> list[tuple[str, Real]]:
    """Starts one and two overtones from x (p,) by label, nearest first."""
    groups = [[i for i, p in enumerate(search.parameters) if not p.is_loss and p.parsed.coefficient in names]
              for names in OVERTONE_GROUPS]
    groups = [group for group in groups if group]
    result = []
    offsets = sorted(itertools.product(OVERTONE_FACTORS, repeat=len(groups)), key=lambda offset: sum(map(abs, offset)))
    for offset in offsets[1:]:
        begin, words = x.copy(), []
        for group, overtones in zip(groups, offset, strict=True):
            begin[group] *= OVERTONE_FACTORS[overtones]
            if overtones:
                first = search.parameters[group[0]].parsed.coefficient
                words.append(f"{first} x {OVERTONE_FACTORS[overtones]:g}")
        result.append((f"{OFFSET_LABEL} " + ", ".join(words), begin))
    return result


def prior_samples(search: Search, count: int, seed: int) -> list[tuple[str, Real]]:
    """Starts sampled from the prior, by label; losses, whose prior is wide, within a factor of two of the start."""
    random = np.random.default_rng(seed)
    loss = np.array([p.is_loss for p in search.parameters])
    result = []
    for number in range(count):
        factor = np.exp(np.log(2.0) * random.uniform(-1.0, 1.0, loss.size))
        offset = search.scale * random.standard_normal(loss.size)
        result.append((f"{SAMPLE_LABEL} {number + 1}", np.where(loss, search.centre * factor, search.centre + offset)))
    return result


def _unexplained(end: Descent) -> bool:
    """Whether what an end leaves is more than noise: large and systematic, or too large for any noise."""
    data = end.residual.data
    for log in data.log_ratio:
        rms = np.sqrt(np.mean(np.abs(log) ** 2))
        if rms > NO_NOISE or (rms > UNEXPLAINED and correlation_length(log) > 1.0):
            return True
    return False


def listed_starts(
    found: Sequence[Trial], best: Optimum, search: Search, noise: Sequence[Noise]
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
