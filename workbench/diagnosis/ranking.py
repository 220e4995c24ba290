"""The score test: the predicted gain of every hypothesis of the catalogue, from one prediction, without refitting.

The part of a hypothesis' tangents that the known parameters can imitate, with their priors, is projected out; the rest
is compared with the residual (Rao 1948, Proc. Camb. Phil. Soc. 44, 50). The score ranks hypotheses, and decides
nothing.
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

#: A tangent of which the known parameters leave less than this share has no effect of its own.
UNSEEN = 1e-9


@dataclass(frozen=True, eq=False)
class Score:
    """The predicted gain of one hypothesis at a point.

    ``evidence`` is the predicted gain of log evidence, ``gain`` the fall of chi-square, both within its bounds;
    ``amplitude`` (k,) the predicted change of its parameters, SI, and ``error`` (k,) their standard deviations.
    ``most`` is the largest change of the data by one of its parameters over its whole range, to first order, in
    standard deviations of the data.
    """

    effect: Effect
    evidence: float
    gain: float
    amplitude: Real
    error: Real
    most: float = 0.0


def ranked(
    likelihood: Likelihood, x: Real, level: float, explained_by: Explanation | None = None
) -> list[Score]:
    """The scores at x (p,) of all hypotheses, best first, where points have a further deviation of `level`.

    With `explained_by`, an explanation found already, only hypotheses on other parameters are scored, beside that one.
    """
    model = likelihood.model
    there = () if explained_by is None else explained_by.hypothesis.effects
    taken = {name for effect in there for name in effect.names}
    # No inequality is looked at: those of one hypothesis must not hold all others up.
    centre = np.array([p.start for p in model.parameters])
    precision = np.array([0.0 if p.prior is None else 1.0 / p.prior for p in model.parameters])
    data = likelihood.objective.with_every(x)(x, deviation=likelihood.point_deviations(level))
    tangents, residual = data.jacobian, data.vector
    if explained_by is not None:
        whiten = likelihood.whitening(explained_by).whitened
        tangents, residual = whiten(tangents), whiten(residual)
    nuisances = np.array(sorted({*range(model.known), *(model.index(name) for name in taken)}))
    offset = (x - centre) * precision
    everything = _Nuisances.of(tangents, residual, nuisances, precision, offset)
    # The remainder of the known parameters under the null hypothesis.
    least = float(everything.residual @ everything.residual)
    found = []
    for effect in (each for each in model.effects if not taken & set(each.names)):
        own = np.array([model.index(name) for name in effect.names])
        bounds = np.array([(model.parameters[i].low - x[i], model.parameters[i].high - x[i]) for i in own])
        imitated = everything if not effect.releases else _Nuisances.of(
            tangents, residual, np.setdiff1d(nuisances, own), precision, offset)
        found.append(_score(effect, tangents[:, own], imitated, least, bounds))
    return sorted(found, key=lambda score: -score.evidence)


@dataclass(frozen=True, eq=False)
class _Nuisances:
    """The nuisance parameters: an orthonormal ``basis`` (m + k, k) of the changes they make, and the ``residual`` (m +
    k,) without these."""

    basis: Real
    residual: Real

    @classmethod
    def of(
        cls, tangents: Real, residual: Real, nuisances: NDArray[np.int64], precision: Real, offset: Real
    ) -> _Nuisances:
        rows = np.diag(precision[nuisances])
        basis, _ = np.linalg.qr(np.vstack([tangents[:, nuisances], rows]))
        whole = np.concatenate([residual, offset[nuisances]])
        return cls(basis, whole - basis @ (basis.T @ whole))


def _score(effect: Effect, tangents: Real, nuisances: _Nuisances, least: float, bounds: Real) -> Score:
    """The score of a hypothesis, from its tangents (m, k), and the `least` chi-square without it."""
    basis, residual = nuisances.basis, nuisances.residual
    whole = np.vstack([tangents, np.zeros((residual.size - tangents.shape[0], tangents.shape[1]))])
    apart = whole - basis @ (basis.T @ whole)
    size = np.linalg.norm(apart, axis=0)
    acting = size > UNSEEN * np.maximum(np.linalg.norm(whole, axis=0), 1e-300)
    amplitude, error = np.zeros(size.size), np.full(size.size, np.inf)
    if not acting.any():
        return Score(effect, 0.0, 0.0, amplitude, error)
    unit = apart[:, acting] / size[acting]
    low, high = bounds[acting].T * size[acting]
    best = lsq_linear(unit, -residual, (np.minimum(low, 0.0) - 1e-12, np.maximum(high, 0.0) + 1e-12))
    amplitude[acting] = best.x / size[acting]
    gain = least - float(np.sum((residual + unit @ best.x) ** 2))
    covariance = np.linalg.pinv(unit.T @ unit, rcond=1e-12) / np.outer(size[acting], size[acting])
    error[acting] = np.sqrt(np.diag(covariance))
    cost = occam_factor(covariance, (bounds[:, 1] - bounds[:, 0])[acting])
    most = float(np.max(size[acting] * np.abs(bounds[acting]).max(axis=1)))
    return Score(effect, 0.5 * (gain - cost), gain, amplitude, error, most)
