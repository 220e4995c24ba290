"""The score test: the predicted gain of every hypothesis of the catalogue, from one prediction, without refitting.

The part of a hypothesis' tangents that the known parameters can imitate, with their priors, is projected out; the rest
is compared with the residual (Rao 1948, Proc. Camb. Phil. Soc. 44, 50). The score ranks hypotheses, and decides
nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from workbench.campaign.state import DeviceState
from workbench.catalogue.effect import Effect
from workbench.diagnosis.device import Model
from workbench.diagnosis.evidence import occam_factor
from workbench.diagnosis.levels import inside, replaced
from workbench.diagnosis.likelihood import Explanation
from workbench.diagnosis.weighting import Weighting

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


@dataclass(frozen=True, eq=False)
class Tangents:
    """The data at x (p,): their derivatives ``jacobian`` (m, p) by all parameters of all hypotheses and the
    ``residual`` (m,), in units of the stated noise."""

    x: Real
    jacobian: Real
    residual: Real


def ranked_at_level(model: Model, tangents: Tangents, states: Sequence[DeviceState], level: float) -> list[Score]:
    """The scores of all hypotheses, best first, where nothing is explained and points have a further deviation of
    `level`."""
    root = 1.0 / np.sqrt(Weighting.stated(states).variances(level))
    return _ranked(model, tangents.jacobian * root[:, None], tangents.residual * root, tangents.x, ())


def ranked_beside(model: Model, tangents: Tangents, found: Explanation, *, alone: bool = False) -> list[Score]:
    """The scores of all hypotheses on other parameters than those of an explanation, best first, by its own weights.

    The `tangents` are those at its optimum, or near it. If points count `alone`, what is left of a spectrum counts as
    many times as neighbours go together in it: such scores overrate, but hypotheses that may take it all come first.
    """
    local = found.local
    if alone:
        local = replace(local.without_inhomogeneity, information=local.information * found.weighting.counts)
    whiten = local.deviating(found.scales).whitened
    return _ranked(model, whiten(tangents.jacobian * local.root[:, None]), whiten(local.residual * local.root),
                   found.likeliest, found.hypothesis.names)


def _ranked(model: Model, tangents: Real, residual: Real, x: Real, taken: Sequence[str]) -> list[Score]:
    # No inequality is looked at: those of one hypothesis must not hold all others up.
    centre = model.stated
    precision = np.array([0.0 if p.prior is None else 1.0 / p.prior for p in model.parameters])
    nuisances = np.array(sorted({*range(model.known), *map(model.index, taken)}))
    offset = (x - centre) * precision
    everything = _Nuisances.of(tangents, residual, nuisances, precision, offset)
    # The remainder of the known parameters under the null hypothesis.
    least = float(everything.residual @ everything.residual)
    found = []
    for effect in (each for each in model.effects if not set(taken) & set(each.names)):
        own = np.array([model.index(name) for name in effect.names])
        bounds = np.array([(model.parameters[i].low - x[i], model.parameters[i].high - x[i]) for i in own])
        imitated = everything if not effect.releases else _Nuisances.of(
            tangents, residual, np.setdiff1d(nuisances, own), precision, offset)
        found.append(_score(effect, tangents[:, own], imitated, least, bounds))
    return sorted(found, key=lambda score: -score.evidence)


def start(model: Model, effect: Effect, x: Real, score: Score) -> Real:
    """The start of a hypothesis at x (p,): its parameters as its score predicts them, or at their error where that is
    larger."""
    indices = [model.index(name) for name in effect.names]
    low, high = model.bounds(indices)
    least = np.where(np.isfinite(score.error), np.minimum(score.error, 0.1 * (high - low)), 0.0)
    sign = np.where(score.amplitude < 0.0, -1.0, 1.0)
    asked = np.where(np.abs(score.amplitude) < least, sign * least, score.amplitude)
    return replaced(x, indices, inside(x[indices] + asked, low, high))


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
