"""The score test: how much of what is left lies along a hypothesis, without refitting anything.

At the optimum of the known parameters the residual is orthogonal to their tangents, priors included. A hypothesis
brings in further tangents; what they have in common with the known ones is projected out, and what remains of them is
compared with the residual (Rao 1948, Proc. Camb. Phil. Soc. 44, 50). The tangents are exact: they are quadratic forms
of the solutions already there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from workbench.diagnosis.device import Model
from workbench.diagnosis.hypothesis import Effect
from workbench.fitting.search import Search, Weighted

Real = NDArray[np.float64]

#: A hypothesis promises much where it promises more than this share of what any does.
WORTH = 0.3


@dataclass(frozen=True, eq=False)
class Score:
    """What the score test says of one hypothesis.

    ``gain`` is the fall of chi-square it promises within its bounds; ``evidence`` that less what the ranges of its
    parameters cost (:func:`occam_factor`), by which hypotheses are ranked as refits are; ``amplitude`` (k,) the
    parameters it asks for, SI, and ``error`` (k,) their standard errors; ``tangent`` (m, k) what is left of its
    tangents; ``collinearity`` the share of them that known parameters can imitate.
    """

    effect: Effect
    gain: float
    evidence: float
    amplitude: Real
    error: Real
    tangent: Real
    collinearity: float

    @property
    def numbers(self) -> int:
        """How many of its parameters the data see."""
        return int(np.isfinite(self.error).sum())

    @property
    def sigmas(self) -> float:
        return float(np.sqrt(max(self.gain, 0.0)))


@dataclass(frozen=True, eq=False)
class Tangents:
    """The linearised problem at a minimum: what is left of the residual (m,) and the projector on the free tangents.

    Rows are the data in standard deviations, then the priors.
    """

    left: Real
    basis: Real

    @classmethod
    def at(cls, search: Search, here: Weighted) -> Tangents:
        jacobian = here.jacobian[:, search.free] * search.scale[search.free]
        basis, _ = np.linalg.qr(jacobian)
        vector = here.vector
        return cls(vector - basis @ (basis.T @ vector), basis)

    def projected(self, columns: Real) -> Real:
        return np.asarray(columns - self.basis @ (self.basis.T @ columns))


def columns(model: Model, here: Weighted, effect: Effect) -> Real:
    """The tangents (m, k) of a hypothesis: of its own parameters, and of those whose prior it releases."""
    data = here.data.jacobian
    indices = [model.index(name) for name in effect.names]
    return np.vstack([data[:, indices], np.zeros((here.vector.size - data.shape[0], len(indices)))])


def score(model: Model, x: Real, here: Weighted, tangents: Tangents, effect: Effect) -> Score:
    """The score of one hypothesis at x (p,)."""
    raw = columns(model, here, effect)
    left = tangents.projected(raw)
    indices = [model.index(name) for name in effect.names]
    low = np.array([model.parameters[i].low - x[i] for i in indices])
    high = np.array([model.parameters[i].high - x[i] for i in indices])
    size, whole = np.linalg.norm(left, axis=0), np.linalg.norm(raw, axis=0)
    seen = size > 1e-9 * np.maximum(whole, 1e-300)
    amplitude, error = np.zeros(len(indices)), np.full(len(indices), np.inf)
    gain = cost = 0.0
    if seen.any():
        unit = left[:, seen] / size[seen]
        before = float(tangents.left @ tangents.left)
        bounded = lsq_linear(unit, -tangents.left, (np.minimum(low[seen], 0.0) * size[seen] - 1e-12,
                                                    np.maximum(high[seen], 0.0) * size[seen] + 1e-12))
        amplitude[seen] = bounded.x / size[seen]
        gain = before - float(np.sum((tangents.left + unit @ bounded.x) ** 2))
        covariance = np.linalg.pinv(unit.T @ unit, rcond=1e-12) / np.outer(size[seen], size[seen])
        error[seen] = np.sqrt(np.diag(covariance))
        cost = occam_factor(covariance, (high - low)[seen])
    collinearity = 1.0 - float(np.linalg.norm(left)) / max(float(np.linalg.norm(raw)), 1e-300)
    return Score(effect, gain, gain - cost, amplitude, error, left, collinearity)


def occam_factor(covariance: Real, widths: Real) -> float:
    """What the ranges of parameters cost: twice the logarithm of their volume over that of the posterior.

    Args:
        covariance: (k, k) of the posterior; none of its axes counts as longer than a range.
        widths: (k,) of the ranges, in the same units.
    """
    relative = np.clip(np.linalg.eigvalsh(covariance / np.outer(widths, widths)), 1e-30, 1.0 / (2.0 * np.pi))
    return float(-np.sum(np.log(2.0 * np.pi * relative)))


def scores_at(model: Model, search: Search, x: Real, here: Weighted, effects: Sequence[Effect] | None = None
              ) -> list[Score]:
    """The scores of the hypotheses (all, or those given) at x (p,), that of the best evidence first."""
    tangents = Tangents.at(search, here)
    found = [score(model, x, here, tangents, effect) for effect in (model.effects if effects is None else effects)]
    return sorted(found, key=lambda s: -s.evidence)


def promising(scores: Sequence[Score], count: int, least: float = 0.0) -> list[Score]:
    """The first `count` of those that promise a fall of chi-square above `least`, and much of what any does."""
    enough = max(least, WORTH * max((scored.gain for scored in scores), default=0.0))
    return [scored for scored in scores if scored.gain > enough][:count]


def confusion(first: Score, second: Score) -> float:
    """Largest cosine between what is left of the tangents of two hypotheses: 1 where they cannot be told apart."""
    a, b = (_orthonormal(s.tangent) for s in (first, second))
    if not a.size or not b.size:
        return 0.0
    return float(min(1.0, np.linalg.svd(a.T @ b, compute_uv=False)[0]))


def _orthonormal(tangent: Real) -> Real:
    size = np.linalg.norm(tangent, axis=0)
    kept = tangent[:, size > 0.0] / size[size > 0.0]
    if not kept.size:
        return np.zeros((tangent.shape[0], 0))
    left, values, _ = np.linalg.svd(kept, full_matrices=False)
    return np.asarray(left[:, values > 1e-6])

