"""Starts of the descents of a hypothesis, as its scores predict them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.descent import inside
from workbench.diagnosis.device import Model
from workbench.diagnosis.findings import InitialOptimum
from workbench.diagnosis.hypothesis import Effect
from workbench.diagnosis.ranking import Score

Real = NDArray[np.float64]

#: Ends of the null hypothesis that a hypothesis starts at.
STARTS = 2


def starts_of(
    model: Model, effect: Effect, ends: Sequence[InitialOptimum], scores: Sequence[Sequence[Score] | None]
) -> list[Real]:
    """Starts (p,) of a hypothesis: at the ends of the null hypothesis where its score predicts the largest gain in
    total."""
    found = []
    for end, scored in zip(ends, scores, strict=True):
        own = next((each for each in scored or () if each.effect.name == effect.name), None)
        if own is not None:
            found.append((own.evidence - end.cost, start(model, effect, end.x, own)))
    return [x for _, x in sorted(found, key=lambda both: -both[0])[:STARTS]]


def start(model: Model, effect: Effect, x: Real, score: Score) -> Real:
    """The start of a hypothesis at x (p,): its parameters as its score predicts them, or at their error where that is
    larger."""
    indices = [model.index(name) for name in effect.names]
    low, high = model.bounds(indices)
    least = np.where(np.isfinite(score.error), np.minimum(score.error, 0.1 * (high - low)), 0.0)
    sign = np.where(score.amplitude < 0.0, -1.0, 1.0)
    asked = np.where(np.abs(score.amplitude) < least, sign * least, score.amplitude)
    return replaced(x, indices, inside(x[indices] + asked, low, high))


def replaced(x: Real, where: Sequence[int], values: float | Real) -> Real:
    """x (p,) with other values at some indices."""
    y = x.copy()
    y[list(where)] = values
    return y
