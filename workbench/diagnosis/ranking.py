"""The score test: what every hypothesis of the catalogue promises, from one prediction, without refitting anything.

What the known parameters can imitate of a hypothesis' tangents is projected out, with their priors; what remains is
compared with the residual (Rao 1948, Proc. Camb. Phil. Soc. 44, 50). It ranks hypotheses, and decides nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from workbench.diagnosis.evidence import occam_factor
from workbench.diagnosis.hypothesis import Effect
from workbench.diagnosis.likelihood import Explanation, Likelihood

Real = NDArray[np.float64]

#: A tangent of which the known parameters leave less than this share is seen by nothing.
UNSEEN = 1e-9


@dataclass(frozen=True, eq=False)
class Score:
    """What one hypothesis promises at a place.

    ``evidence`` the logarithm of the odds that it would gain, ``gain`` the fall of chi-square, both within its bounds;
    ``amplitude`` (k,) by which its parameters would move, SI, and ``error`` (k,) their standard deviations. ``most`` is
    what all that one of them may move by changes the data by, to first order, in standard deviations of these.
    """

    effect: Effect
    evidence: float
    gain: float
    amplitude: Real
    error: Real
    most: float = 0.0


def ranked(
    likelihood: Likelihood, x: Real, level: float, beside: Explanation | None = None
) -> list[Score]:
    """The scores at x (p,) of all hypotheses, best first, where points have a further deviation of `level`.

    Where something explains the data already, `beside` that: of those that move nothing which it does.
    """
    model = likelihood.model
    there = () if beside is None else beside.hypothesis.effects
    taken = {name for effect in there for name in effect.names}
    # No inequality is looked at: those of one hypothesis must not hold all others up.
    centre = np.array([p.start for p in model.parameters])
    precision = np.array([0.0 if p.prior is None else 1.0 / p.prior for p in model.parameters])
    data = likelihood.objective.with_every(x)(x, deviation=likelihood.spreads(level))
    tangents, residual = data.jacobian, data.vector
    if beside is not None:
        whiten = likelihood.whitening(beside).whitened
        tangents, residual = whiten(tangents), whiten(residual)
    nuisances = np.array(sorted({*range(model.known), *(model.index(name) for name in taken)}))
    offset = (x - centre) * precision
    everything = _Imitated.by(tangents, residual, nuisances, precision, offset)
    # What the known parameters leave where nothing is wrong besides.
    least = float(everything.left @ everything.left)
    found = []
    for effect in (each for each in model.effects if not taken & set(each.names)):
        own = np.array([model.index(name) for name in effect.names])
        bounds = np.array([(model.parameters[i].low - x[i], model.parameters[i].high - x[i]) for i in own])
        imitated = everything if not effect.releases else _Imitated.by(
            tangents, residual, np.setdiff1d(nuisances, own), precision, offset)
        found.append(_score(effect, tangents[:, own], imitated, least, bounds))
    return sorted(found, key=lambda score: -score.evidence)


@dataclass(frozen=True, eq=False)
class _Imitated:
    """What nuisances can imitate: an orthonormal ``basis`` (m + k, k), and what they leave of the residual (m + k,)."""

    basis: Real
    left: Real

    @classmethod
    def by(
        cls, tangents: Real, residual: Real, nuisances: NDArray[np.int64], precision: Real, offset: Real
    ) -> _Imitated:
        rows = np.diag(precision[nuisances])
        basis, _ = np.linalg.qr(np.vstack([tangents[:, nuisances], rows]))
        whole = np.concatenate([residual, offset[nuisances]])
        return cls(basis, whole - basis @ (basis.T @ whole))


def _score(effect: Effect, tangents: Real, imitated: _Imitated, least: float, bounds: Real) -> Score:
    """From the tangents (m, k) of a hypothesis, and the `least` chi-square without it."""
    basis, left = imitated.basis, imitated.left
    whole = np.vstack([tangents, np.zeros((left.size - tangents.shape[0], tangents.shape[1]))])
    apart = whole - basis @ (basis.T @ whole)
    size = np.linalg.norm(apart, axis=0)
    seen = size > UNSEEN * np.maximum(np.linalg.norm(whole, axis=0), 1e-300)
    amplitude, error = np.zeros(size.size), np.full(size.size, np.inf)
    if not seen.any():
        return Score(effect, 0.0, 0.0, amplitude, error)
    unit = apart[:, seen] / size[seen]
    low, high = bounds[seen].T * size[seen]
    best = lsq_linear(unit, -left, (np.minimum(low, 0.0) - 1e-12, np.maximum(high, 0.0) + 1e-12))
    amplitude[seen] = best.x / size[seen]
    gain = least - float(np.sum((left + unit @ best.x) ** 2))
    covariance = np.linalg.pinv(unit.T @ unit, rcond=1e-12) / np.outer(size[seen], size[seen])
    error[seen] = np.sqrt(np.diag(covariance))
    cost = occam_factor(covariance, (bounds[:, 1] - bounds[:, 0])[seen])
    most = float(np.max(size[seen] * np.abs(bounds[seen]).max(axis=1)))
    return Score(effect, 0.5 * (gain - cost), gain, amplitude, error, most)
