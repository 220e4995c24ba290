"""The evidence of a hypothesis: the likelihood of the recordings averaged over all that its parameters may be.

At an optimum x of the posterior with residuals r (in units of the noise) and tangents J, the model is linear near it:

    r ~ N(0, Sigma),  Sigma = 1 + B diag(scale^2) B^T,   theta ~ N(centre, P^-1),   phi uniform over its ranges,

and the average over theta and phi is a Gaussian integral (Laplace's approximation; MacKay 2003, Information Theory,
Inference, and Learning Algorithms, chapter 28). The columns of B are deviations beside the noise: changes within a
region, modes that the model does not have, and the error of a hypothesis' own term. Their scales are averaged over,
each as likely in every decade.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.special import erfcx, logsumexp

Real = NDArray[np.float64]


#: Rounding of a log evidence, relative to the numbers that it is a sum of, beyond which it is wrong. Doubled, errors
#: twice as large pass; rounding leaves some 1e-12 of them, and mistakes many times as much as the numbers.
ROUNDING = 1e-6

#: A parameter is at the end of its range within this share of it. Doubled, nothing changes: an optimum is at it or far.
END = 1e-9

#: Curvature of chi-square across a range below which a parameter changes nothing. Doubled, nothing changes: it is
#: rounding, or none.
UNSEEN = 1e-12

#: A fall of the logarithm across a range below which it is a straight line. Doubled, its curve is left out to 2e-8.
FLAT = 1e-8


class WrongEvidence(ArithmeticError):
    """A log evidence that is none: not finite, or above the log likelihood at its optimum, of which it is a mean.

    Carries both. It is a defect of the program, and says nothing of the hypothesis.
    """

    def __init__(self, evidence: float, likelihood: float) -> None:
        super().__init__(f"a log evidence of {evidence:.6g}, where the log likelihood is {likelihood:.6g} at its "
                         "optimum, is an error of this program, not a result")
        self.evidence, self.likelihood = evidence, likelihood

    def __reduce__(self) -> tuple[type[WrongEvidence], tuple[float, float]]:
        return WrongEvidence, (self.evidence, self.likelihood)


def checked(evidence: float, likelihood: float, size: float = 0.0) -> float:
    """A log `evidence`, with the log `likelihood` at the optimum that it is about, both up to one constant.

    `size` is that of the numbers that both are sums of, for their rounding.

    Raises:
        WrongEvidence: it is not finite, or the larger one.
    """
    margin = ROUNDING * max(1.0, abs(likelihood), abs(size))
    if not (math.isfinite(evidence) and math.isfinite(likelihood) and evidence <= likelihood + margin):
        raise WrongEvidence(evidence, likelihood)
    return evidence


@dataclass(frozen=True, eq=False)
class Average:
    """A linearised problem averaged over its parameters at given scales.

    ``log_evidence`` up to a constant of all hypotheses; ``step`` (p,) to the optimum of the linearised problem;
    ``covariance`` (p, p) of the posterior; ``occam`` the part of the evidence that the ranges of parameters without a
    prior cost; ``chi_square`` at the optimum, with the rows of the priors.
    """

    log_evidence: float
    step: Real
    covariance: Real
    occam: float
    chi_square: float


@dataclass(frozen=True, eq=False)
class LinearisedProblem:
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
           below: Real, above: Real) -> LinearisedProblem:
        """A problem from its tangents (m, p), residual (m,) and deviations (m, k)."""
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
        """The log evidence that each of some `blocks` of further deviations adds at some `sizes`: (blocks, sizes).

        Parameters and deviations are those of the given `scales` (k,), which are zero for the blocks. A range counts as
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
        # A parameter that changes nothing within its range stays where it is, and costs nothing.
        seen = ~ranged | (np.diag(hessian) * self.widths**2 > UNSEEN)
        ranged, hessian, slope = ranged & seen, hessian * np.outer(seen, seen), slope * seen
        covariance = _inverse(hessian)
        step = -covariance @ slope
        occam = 0.0
        if (ranged & ((step < -self.below) | (step > self.above))).any():
            # A parameter without a prior that a bound holds stays there; from there, the Gaussian is cut off.
            step, held = self._within_bounds(hessian, slope, ranged)
            inside = np.ix_(~held, ~held)
            covariance = np.zeros_like(hessian)
            covariance[inside] = _inverse(hessian[inside])
            for j in np.flatnonzero(held):
                curvature = float(hessian[j, j] - hessian[j] @ covariance @ hessian[:, j])
                inwards = abs(float(slope[j] + hessian[j] @ step))
                occam += math.log(self.widths[j]) - _cut_off(inwards, max(curvature, 0.0), self.widths[j])
            ranged = ranged & ~held
        if ranged.any():
            occam += 0.5 * occam_factor(covariance[np.ix_(ranged, ranged)], self.widths[ranged])
        known = np.ix_(np.isnan(self.widths), np.isnan(self.widths))
        learnt = np.linalg.slogdet(hessian[known])[1] - np.linalg.slogdet(self.precision[known])[1]
        chi_square = square + float(2.0 * slope @ step + step @ hessian @ step)
        worth = -0.5 * (chi_square + log_determinant + float(learnt)) - occam
        # The remainder is a sum of squares; the determinant is that of a matrix with eigenvalues of at least 1.
        best = -0.5 * (max(chi_square, 0.0) + max(log_determinant, 0.0))
        return Average(checked(worth, best, square), step, covariance, occam, chi_square)

    def _within_bounds(self, hessian: Real, slope: Real, ranged: NDArray[np.bool_]) -> tuple[Real, NDArray[np.bool_]]:
        """The step (p,) to the least of the quadratic within all ranges, and which parameters (p,) their ends hold."""
        # Known parameters have no bounds: they follow.
        own, known = np.flatnonzero(ranged), np.flatnonzero(~ranged)
        follow = _inverse(hessian[np.ix_(known, known)]) @ np.column_stack([hessian[np.ix_(known, own)], slope[known]])
        size = self.widths[own]
        reduced = (hessian[np.ix_(own, own)] - hessian[np.ix_(own, known)] @ follow[:, :-1]) * np.outer(size, size)
        force = (slope[own] - hessian[np.ix_(own, known)] @ follow[:, -1]) * size
        values, vectors = np.linalg.eigh(0.5 * (reduced + reduced.T))
        kept = values > 1e-13 * max(float(values[-1]), 1e-300)
        root = np.sqrt(values[kept])
        low, high = np.minimum(-self.below[own], 0.0) / size, np.maximum(self.above[own], 0.0) / size
        if kept.any():
            found = lsq_linear(root[:, None] * vectors[:, kept].T, -(vectors[:, kept].T @ force) / root, (low, high),
                               method="bvls", tol=1e-12)
            relative = np.clip(found.x, low, high)
        else:
            relative = np.zeros(own.size)
        at_end = (relative - low < END) | (high - relative < END)
        relative = np.where(relative - low < END, low, np.where(high - relative < END, high, relative))
        step, held = np.zeros(slope.size), np.zeros(slope.size, dtype=bool)
        step[own], held[own] = size * relative, at_end
        step[known] = -follow @ np.append(step[own], 1.0)
        return step, held


def _inverse(matrix: Real) -> Real:
    """The inverse of a positive matrix (p, p) whose units differ; directions that rounding cannot tell apart stay
    undetermined."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.linalg.pinv(matrix * np.outer(scale, scale), rcond=1e-13, hermitian=True) * np.outer(scale, scale)


def _cut_off(slope: float, curvature: float, width: float) -> float:
    """ln of the integral of exp(-(slope t + curvature t^2 / 2)) over 0 < t < width, neither of the two below zero.

    It is at most ln of the width.
    """
    if curvature * width**2 < FLAT:
        along = slope * width
        return math.log(width) + (math.log(-math.expm1(-along) / along) if along > FLAT else -0.5 * along)
    root = math.sqrt(2.0 * curvature)
    near, far = slope / root, (slope + curvature * width) / root
    whole = float(erfcx(near) - math.exp(-min(slope * width + 0.5 * curvature * width**2, 700.0)) * erfcx(far))
    return 0.5 * math.log(0.5 * math.pi / curvature) + math.log(whole)


def occam_factor(covariance: Real, widths: Real) -> float:
    """The cost of the ranges of parameters: twice the logarithm of their volume over that of the posterior.

    Args:
        covariance: (k, k) of the posterior; none of its axes counts as longer than a range.
        widths: (k,) of the ranges, in the same units.
    """
    relative = np.clip(np.linalg.eigvalsh(covariance / np.outer(widths, widths)), 1e-30, 1.0 / (2.0 * np.pi))
    return float(-np.sum(np.log(2.0 * np.pi * relative)))


def over_scales(problem: LinearisedProblem, settings: Sequence[Real]) -> tuple[float, int, Average]:
    """ln of the mean evidence over the `settings` of the scales, the index of the best of these, and the average at it.
    """
    found = [problem.averaged(setting) for setting in settings]
    logs = np.array([each.log_evidence for each in found])
    best = int(np.argmax(logs))
    return float(logsumexp(logs) - math.log(logs.size)), best, found[best]


def averaged_over_blocks(
    problem: LinearisedProblem, settings: Sequence[Real], blocks: Sequence[NDArray[np.int64]], sizes: Real
) -> Real:
    """ln of the mean evidence over the `settings` of the scales with each of some `blocks` of deviations, averaged over
    their `sizes`: (blocks,)."""
    whole = np.stack([problem.averaged(each).log_evidence + problem.added(each, blocks, sizes) for each in settings])
    found = np.asarray(logsumexp(whole, axis=(0, 2)) - math.log(whole.shape[0] * whole.shape[2]))
    # No likelihood is above that of data without a residual, and deviations lower it.
    return np.array([checked(float(each), 0.0, float(np.abs(whole).max())) for each in found])
