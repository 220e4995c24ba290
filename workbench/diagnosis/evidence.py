"""The evidence of a hypothesis: the likelihood of the recordings averaged over all that its parameters may be.

At an optimum x of the posterior with residuals r (in units of the noise) and tangents J, the model is linear near it:

    r ~ N(0, Sigma),  Sigma = 1 + B diag(scale^2) B^T,   theta ~ N(centre, P^-1),   phi uniform over its ranges,

and the average over theta and phi is a Gaussian integral (Laplace's approximation; MacKay 2003, Information Theory,
Inference, and Learning Algorithms, chapter 28). B holds what deviates beside the noise: the inaccuracy of the model
(`inaccuracy`), that of a hypothesis' own term. Its scales are averaged over in turn, each as likely in every decade.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.special import log_ndtr, logsumexp

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Average:
    """A linearised problem averaged over its parameters at given scales.

    ``log_evidence`` up to what all hypotheses share; ``step`` (p,) to the optimum of the linearised problem;
    ``covariance`` (p, p) of the posterior; ``occam`` what the ranges of those without a prior cost of it;
    ``chi_square`` left there, with what the parameters moved by.
    """

    log_evidence: float
    step: Real
    covariance: Real
    occam: float
    chi_square: float


@dataclass(frozen=True, eq=False)
class Linearised:
    """A problem at x, linear in p parameters about it, with k directions of deviation.

    ``gram`` (p + 1 + k, p + 1 + k) inner products of the tangents, the residual and the deviations of unit scale, in
    units of the noise; ``precision`` (p, p) of the prior, ``offset`` (p,) x less its centre; ``widths`` (p,) the ranges
    of those without a prior, nan for the others; ``below`` and ``above`` (p,) how far x is from the bounds.
    """

    gram: Real
    precision: Real
    offset: Real
    widths: Real
    below: Real
    above: Real

    @classmethod
    def of(cls, tangents: Real, residual: Real, deviations: Real, *, precision: Real, offset: Real, widths: Real,
           below: Real, above: Real) -> Linearised:
        """From tangents (m, p), residual (m,) and deviations (m, k)."""
        every = np.column_stack([tangents, residual, deviations])
        return cls(every.T @ every, precision, offset, widths, below, above)

    def averaged(self, scales: Real) -> Average:
        """Over all parameters at given `scales` (k,) of the deviations."""
        p = self.offset.size
        own = self.gram[: p + 1, : p + 1]
        acting = np.flatnonzero(scales)
        log_determinant = 0.0
        if acting.size:
            scale = scales[acting]
            inner = self.gram[np.ix_(p + 1 + acting, p + 1 + acting)] * np.outer(scale, scale)
            factor = np.linalg.cholesky(inner + np.eye(acting.size))
            along = scipy.linalg.solve_triangular(
                factor, scale[:, None] * self.gram[p + 1 + acting, : p + 1], lower=True, check_finite=False)
            own = own - along.T @ along
            log_determinant = 2.0 * float(np.log(np.diag(factor)).sum())
        hessian, slope = own[:p, :p] + self.precision, own[:p, p] + self.precision @ self.offset
        square = float(own[p, p] + self.offset @ self.precision @ self.offset)
        return self._integrated(hessian, slope, square, log_determinant)

    def added(self, scales: Real, blocks: Sequence[NDArray[np.int64]], sizes: Real) -> Real:
        """What each of some `blocks` of further deviations adds to the log evidence at some `sizes`: (blocks, sizes).

        Beside the parameters and the deviations of these `scales` (k,), zero for those of the blocks. A range counts as
        a normal distribution of its variance.
        """
        p = self.offset.size
        acting = np.flatnonzero(scales)
        precision = self.precision + np.diag(np.where(np.isnan(self.widths), 0.0, 12.0 / self.widths**2))
        taken = np.concatenate([np.arange(p), p + 1 + acting])
        weights = np.concatenate([np.ones(p), scales[acting]])
        inner = self.gram[np.ix_(taken, taken)] * np.outer(weights, weights)
        inner[:p, :p] += precision
        inner[p:, p:] += np.eye(acting.size)
        unit = 1.0 / np.sqrt(np.diag(inner))
        factor = np.linalg.cholesky(inner * np.outer(unit, unit))
        slope = weights * self.gram[taken, p]
        slope[:p] += self.precision @ self.offset
        every = p + 1 + np.concatenate(blocks)
        right = np.column_stack([weights[:, None] * self.gram[np.ix_(taken, every)], slope])
        along = scipy.linalg.solve_triangular(factor, unit[:, None] * right, lower=True, check_finite=False)
        found, start = [], 0
        for block in blocks:
            own, rows = along[:, start:start + block.size], p + 1 + block
            start += block.size
            gram = self.gram[np.ix_(rows, rows)] - own.T @ own
            values, vectors = np.linalg.eigh(gram)
            squares = (vectors.T @ (self.gram[rows, p] - own.T @ along[:, -1])) ** 2
            ratio = np.outer(sizes**2, np.maximum(values, 0.0))
            found.append(0.5 * np.sum(np.outer(sizes**2, squares) / (1.0 + ratio) - np.log1p(ratio), axis=1))
        return np.stack(found)

    def _integrated(self, hessian: Real, slope: Real, square: float, log_determinant: float) -> Average:
        ranged = ~np.isnan(self.widths)
        covariance = _inverse(hessian)
        step = -covariance @ slope
        # A parameter without a prior that a bound holds stays there; along it alone, the Gaussian is cut off.
        held = ranged & ((step < -self.below) | (step > self.above))
        occam = 0.0
        if held.any():
            inside = np.ix_(~held, ~held)
            covariance = np.zeros_like(hessian)
            covariance[inside] = _inverse(hessian[inside])
            step = -covariance @ slope
            for j in np.flatnonzero(held):
                curvature = float(hessian[j, j] - hessian[j] @ covariance @ hessian[:, j])
                along = float(slope[j] + hessian[j] @ step)
                occam += math.log(self.widths[j]) - _between(along, curvature, self.below[j], self.above[j])
        left = ranged & ~held
        if left.any():
            occam += 0.5 * occam_factor(covariance[np.ix_(left, left)], self.widths[left])
        known = np.ix_(~ranged, ~ranged)
        learnt = np.linalg.slogdet(hessian[known])[1] - np.linalg.slogdet(self.precision[known])[1]
        chi_square = square + float(slope @ step)
        worth = -0.5 * (chi_square + log_determinant + float(learnt)) - occam
        return Average(worth, step, covariance, occam, chi_square)


def _inverse(matrix: Real) -> Real:
    """The inverse of a positive matrix (p, p) whose units differ; what it cannot tell apart stays undetermined."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.linalg.pinv(matrix * np.outer(scale, scale), rcond=1e-13, hermitian=True) * np.outer(scale, scale)


def _between(slope: float, curvature: float, below: float, above: float) -> float:
    """ln of the integral of exp(-(slope t + curvature t^2 / 2)) over -below < t < above."""
    curvature = max(curvature, 1e-300)
    root, centre = math.sqrt(curvature), -slope / curvature
    low, high = root * (-below - centre), root * (above - centre)
    if low > 0.0:
        low, high = -high, -low
    # Of two tails the difference, from the larger one.
    between = float(log_ndtr(high) + np.log1p(-np.exp(min(log_ndtr(low) - log_ndtr(high), -1e-16))))
    return 0.5 * slope * slope / curvature + 0.5 * math.log(2.0 * math.pi / curvature) + between


def occam_factor(covariance: Real, widths: Real) -> float:
    """What the ranges of parameters cost: twice the logarithm of their volume over that of the posterior.

    Args:
        covariance: (k, k) of the posterior; none of its axes counts as longer than a range.
        widths: (k,) of the ranges, in the same units.
    """
    relative = np.clip(np.linalg.eigvalsh(covariance / np.outer(widths, widths)), 1e-30, 1.0 / (2.0 * np.pi))
    return float(-np.sum(np.log(2.0 * np.pi * relative)))


def over_scales(problem: Linearised, settings: Sequence[Real]) -> tuple[float, int, Average]:
    """ln of the mean evidence over the `settings` of the scales, the index of the best of these, and what it gives."""
    found = [problem.averaged(setting) for setting in settings]
    logs = np.array([each.log_evidence for each in found])
    best = int(np.argmax(logs))
    return float(logsumexp(logs) - math.log(logs.size)), best, found[best]
