"""The score test: predicted gains of all catalogue hypotheses without refits.

The part of a hypothesis' tangents that the known parameters can imitate, with their priors, is projected out; the rest
is compared with the residual (Rao 1948, Proc. Camb. Phil. Soc. 44, 50). The score ranks hypotheses, and decides
nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

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
from workbench.fitting.covariance import prior_rows

Real = NDArray[np.float64]

#: Cosine above which recordings cannot tell two changes apart: at 0.99 a change of ten standard deviations differs from
#: the other by one and a half.
COLLINEAR = 0.99

#: A tangent has no effect of its own if its share orthogonal to the known parameters is smaller than this.
UNSEEN = 1e-9


@dataclass(frozen=True, eq=False)
class Score:
    """The predicted gain of one hypothesis at a point.

    ``evidence`` is the predicted gain of log evidence, ``gain`` the fall of chi-square, both within its bounds;
    ``amplitude`` (k,) the predicted change of its parameters, SI, and ``error`` (k,) their standard deviations.
    ``most`` is the largest change of the data by one of its parameters over its whole range, to first order, in
    standard deviations of the data; ``directions`` (m', k') an orthonormal basis of the changes that the known
    parameters do not imitate.
    """

    effect: Effect
    evidence: float
    gain: float
    amplitude: Real
    error: Real
    most: float = 0.0
    directions: Real = field(default_factory=lambda: np.zeros((0, 0)))

    def is_collinear(self, other: Score) -> bool:
        """Whether recordings cannot tell it from another: every change is shared."""
        if self.directions.shape[1] != other.directions.shape[1] or not self.directions.size:
            return False
        cosines = np.linalg.svd(self.directions.T @ other.directions, compute_uv=False)
        return bool(cosines.min() > COLLINEAR)


def groups_of(scores: Sequence[Score]) -> list[list[Score]]:
    """Groups of hypotheses that recordings cannot tell apart, best score first."""
    groups = list[list[Score]]()
    for score in sorted(scores, key=lambda each: -each.evidence):
        own = next((group for group in groups if score.is_collinear(group[0])), None)
        if own is None:
            groups.append([score])
        else:
            own.append(score)
    return groups


@dataclass(frozen=True, eq=False)
class Tangents:
    """The data at x (p,): ``jacobian`` (m, p) and ``residual`` (m,). The derivatives are by all parameters of all
    hypotheses, in units of the stated noise."""

    x: Real
    jacobian: Real
    residual: Real


def ranked_at_level(model: Model, tangents: Tangents, states: Sequence[DeviceState], level: float) -> list[Score]:
    """The scores of all hypotheses beside none, best first. Points have a further deviation of `level`."""
    root = 1.0 / np.sqrt(Weighting.stated(states).variances(level))
    return _ranked(model, tangents.jacobian * root[:, None], tangents.residual * root, tangents.x, ())


def ranked_beside(model: Model, tangents: Tangents, explanation: Explanation, *, alone: bool = False) -> list[Score]:
    """The scores of further hypotheses beside an explanation, best first.

    Residual, pulls and the tangents of its parameters are those of the explanation at its likeliest point, with its
    weights. The `tangents` there serve all other parameters, and may be of another mesh. Otherwise the difference of
    two meshes, which the known parameters do not imitate exactly, would be promised to any similar hypothesis. If
    points count `alone`, the correlation length of a residual is ignored: such scores overrate, but hypotheses that may
    explain all come first.
    """
    local = explanation.local
    jacobian = tangents.jacobian.copy()
    jacobian[:, list(explanation.free)] = local.tangents
    whiten = local.deviating(explanation.scales).whitened
    if alone:
        root = local.root * np.sqrt(explanation.weighting.counts)
        return _ranked(model, jacobian * root[:, None], local.residual * root, explanation.likeliest,
                       explanation.hypothesis.effects)
    scaled = [_Recording(rows, float(local.information[rows].sum()), float(noise))
              for rows, noise in zip(local.recordings, local.noise, strict=True)]
    return _ranked(model, whiten(jacobian * local.root[:, None]), whiten(local.residual * local.root),
                   explanation.likeliest, explanation.hypothesis.effects, scaled)


class _Recording(NamedTuple):
    """The rows of a recording, effective number of data, and noise scale."""

    rows: slice
    data: float
    noise: float


def _log_likelihood(residual: Real, recordings: Sequence[_Recording]) -> float:
    """The log likelihood of a residual (m,) with the likeliest noise scales. The residual is in units of the present
    noise scales of the recordings."""
    total = -0.5 * float(residual @ residual)
    for each in recordings:
        square = float(np.sum(residual[each.rows] ** 2))
        variance = max(square / each.data, 1.0 / each.noise**2)
        total += 0.5 * square - 0.5 * square / variance - 0.5 * each.data * math.log(variance)
    return total


def _ranked(
    model: Model, tangents: Real, residual: Real, x: Real, acting: Sequence[Effect],
    recordings: Sequence[_Recording] = (),
) -> list[Score]:
    # Inequalities are ignored: those of one hypothesis must not stop all others.
    offset = x - model.stated
    free, without_prior = model.free(acting)
    nuisances = np.array(free)
    everything = _Nuisances.of(model, tangents, residual, nuisances, offset, without_prior)
    taken = {name for effect in acting for name in effect.names}
    scores = []
    for effect in (each for each in model.effects if not taken & set(each.names)):
        own = np.array([model.index(name) for name in effect.names])
        bounds = np.array([(model.parameters[i].low - x[i], model.parameters[i].high - x[i]) for i in own])
        imitated = everything if not effect.freed else _Nuisances.of(
            model, tangents, residual, nuisances, offset, without_prior, own.tolist())
        scores.append(_score(effect, tangents[:, own], everything.residual, imitated, bounds, recordings))
    return sorted(scores, key=lambda score: -score.evidence)


def start(model: Model, effect: Effect, x: Real, score: Score) -> Real:
    """The start of a hypothesis at x (p,). Its parameters are those predicted by its score, or their error if that is
    larger."""
    indices = [model.index(name) for name in effect.names]
    low, high = model.bounds(indices)
    least = np.where(np.isfinite(score.error), np.minimum(score.error, 0.1 * (high - low)), 0.0)
    sign = np.where(score.amplitude < 0.0, -1.0, 1.0)
    asked = np.where(np.abs(score.amplitude) < least, sign * least, score.amplitude)
    return replaced(x, indices, inside(x[indices] + asked, low, high))


@dataclass(frozen=True, eq=False)
class _Nuisances:
    """The nuisance parameters. ``basis`` (m + k, k) is orthonormal and spans their changes; ``residual`` (m + k,) is
    without these."""

    basis: Real
    residual: Real

    @classmethod
    def of(
        cls, model: Model, tangents: Real, residual: Real, nuisances: NDArray[np.int64], offset: Real,
        without_prior: Sequence[int], beside: Sequence[int] = (),
    ) -> _Nuisances:
        """The nuisance parameters of these indices except those `beside`. Those `without_prior` have none."""
        kept = ~np.isin(nuisances, beside)
        own = nuisances[kept]
        rows = np.zeros((nuisances.size, own.size))
        rows[kept] = prior_rows([None if i in without_prior else model.parameters[i].prior for i in own],
                                model.correlation[np.ix_(own, own)])
        basis, _ = np.linalg.qr(np.vstack([tangents[:, own], rows]))
        whole = np.concatenate([residual, rows @ offset[own]])
        return cls(basis, whole - basis @ (basis.T @ whole))


def _score(
    effect: Effect, tangents: Real, before: Real, nuisances: _Nuisances, bounds: Real,
    recordings: Sequence[_Recording],
) -> Score:
    """The score of a hypothesis from its tangents (m, k). `before` is the residual (m + k,)."""
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
    directions, triangle = np.linalg.qr(unit)
    directions = directions[:residual.size, np.abs(np.diag(triangle)) > UNSEEN]
    after = residual + unit @ best.x
    gain = float(before @ before - after @ after)
    more = _log_likelihood(after, recordings) - _log_likelihood(before, recordings)
    gram = unit.T @ unit
    error[acting] = np.sqrt(np.diag(np.linalg.pinv(gram, rcond=1e-12))) / size[acting]
    cost = occam_factor(gram, (bounds[:, 1] - bounds[:, 0])[acting] * size[acting])
    most = float(np.max(size[acting] * np.abs(bounds[acting]).max(axis=1)))
    return Score(effect, more - 0.5 * cost, gain, amplitude, error, most, directions)
