"""The evidence of a hypothesis: the likelihood averaged over its parameters.

At an optimum x of the posterior with residuals r (in units of the stated noise) and tangents J, the model is linear
near it:

    r ~ N(0, Sigma),  Sigma = diag(s_k^2) + B diag(scale^2) B^T,   theta ~ N(centre, P^-1),   phi uniform over ranges,

and the average over theta and phi is a Gaussian integral (Laplace's approximation; MacKay 2003, Information Theory,
Inference, and Learning Algorithms, chapter 28). The columns of B are deviations beside the noise: changes within a
region, missing modes, and the error of a hypothesis' own term. Their scales are averaged over, each as likely in every
decade. So is the noise scale s_k of each recording, 1 < s_k < :data:`LARGEST`. MacKay's fixed point is its likeliest
value: the residual sum of squares over the data that no parameter absorbs. The likelihood about it is that of
independent recordings, nu ln s + chi^2 / (2 s^2), integrated over ln s numerically. A hypothesis with a larger residual
has a larger noise scale.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

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

#: The noise scale of a recording, at most: nobody compares spectra that are off by a thousand times their noise.
#: Doubled, all evidences fall by 0.1 a recording.
LARGEST = 1e3

#: Most steps of the noise scales, the relative change that ends them, and the least share of the data not absorbed by
#: parameters for the faster of two steps. An evidence is stationary there: 1 % changes it by 1e-4 of the data.
SCALE_STEPS, STEADY, UNABSORBED = 20, 1e-2, 0.2

#: Points that the integral over ln s is a sum of.
NODES = 241

#: A fall of the logarithm across a range below which it is a straight line. Doubled, its curve is left out to 2e-8.
FLAT = 1e-8


class WrongEvidence(ArithmeticError):
    """An invalid log evidence: not finite, or above the largest log likelihood.

    Carries both. It is a defect of the program, and no result about the hypothesis.
    """

    def __init__(self, evidence: float, likelihood: float) -> None:
        super().__init__(f"a log evidence of {evidence:.6g}, where the log likelihood is {likelihood:.6g} at its "
                         "optimum, is an error of this program, not a result")
        self.evidence, self.likelihood = evidence, likelihood

    def __reduce__(self) -> tuple[type[WrongEvidence], tuple[float, float]]:
        return WrongEvidence, (self.evidence, self.likelihood)


def checked(evidence: float, likelihood: float, size: float = 0.0) -> float:
    """The log `evidence`, compared with the log `likelihood` at its optimum.

    Both are up to one constant. `size` is the size of the terms that both are sums of, for their rounding.

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
    prior cost; ``chi_square`` at the optimum, with the rows of the priors; ``noise`` (r,) the noise scales.
    """

    log_evidence: float
    step: Real
    covariance: Real
    occam: float
    chi_square: float
    noise: Real


@dataclass(frozen=True, eq=False)
class LinearisedProblem:
    """A problem linearised at x: p parameters, k deviations, r recordings.

    ``grams`` (r, p + 1 + k, p + 1 + k) inner products of the tangents, the residual and the deviations of unit scale in
    each recording, in units of its noise; ``counts`` (r,) data of each, zero where its noise scale is one;
    ``precision`` (p, p) of the prior, ``offset`` (p,) x less its centre; ``widths`` (p,) the ranges of those without a
    prior, nan for the others; ``below`` and ``above`` (p,) how far x is from the bounds.
    """

    grams: Real
    counts: Real
    precision: Real
    offset: Real
    widths: Real
    below: Real
    above: Real

    @classmethod
    def of(
        cls, tangents: Real, residual: Real, deviations: Real, *, precision: Real, offset: Real, widths: Real,
        below: Real, above: Real, recordings: Sequence[slice | NDArray[np.int64]] = (), counts: Real | None = None,
    ) -> LinearisedProblem:
        """A problem from tangents (m, p), residual (m,) and deviations (m, k). By default it is one recording of noise
        scale 1."""
        every = np.column_stack([tangents, residual, deviations])
        parts = [every[rows] for rows in recordings] or [every]
        return cls(np.stack([each.T @ each for each in parts]), np.zeros(len(parts)) if counts is None else counts,
                   precision, offset, widths, below, above)

    def averaged(self, scales: Real, noise: Real | None = None) -> Average:
        """The average over parameters and noise scales at `scales` (k,).

        The search for the likeliest noise scales starts from `noise` (r,).
        """
        scaled = np.flatnonzero(self.counts)
        noise = np.ones(len(self.grams)) if noise is None else noise
        average = self.at(scales, noise)
        if not scaled.size:
            return average
        for _ in range(SCALE_STEPS):
            squares, taken = self._residual_squares(scales, average)
            free = self.counts - taken
            # Where parameters may take all, the slower step of expectation and maximisation.
            fast = squares / np.maximum(free, 1e-300)
            slow = (squares + noise**2 * taken) / np.maximum(self.counts, 1e-300)
            variance = np.where(free > UNABSORBED * self.counts, fast, slow)
            before, noise = noise, noise.copy()
            noise[scaled] = np.clip(np.sqrt(variance[scaled]), 1.0, LARGEST)
            average = self.at(scales, noise)
            if np.abs(np.log(noise / before)).max() < STEADY:
                break
        squares, taken = self._residual_squares(scales, average)
        spread = sum(_over_noise(float(self.counts[k] - taken[k]), float(squares[k]), float(noise[k])) for k in scaled)
        return replace(average, log_evidence=average.log_evidence + spread)

    def at(self, scales: Real, noise: Real) -> Average:
        """The average over parameters, at `scales` (k,) and `noise` scales (r,)."""
        p = self.offset.size
        gram = self._gram(noise)
        own = gram[: p + 1, : p + 1]
        acting = np.flatnonzero(scales)
        log_determinant = 2.0 * float(self.counts @ np.log(noise))
        if acting.size:
            scale = scales[acting]
            inner = gram[np.ix_(p + 1 + acting, p + 1 + acting)] * np.outer(scale, scale)
            factor = np.linalg.cholesky(inner + np.eye(acting.size))
            along = scipy.linalg.solve_triangular(
                factor, scale[:, None] * gram[p + 1 + acting, : p + 1], lower=True, check_finite=False)
            own = own - along.T @ along
            log_determinant += 2.0 * float(np.log(np.diag(factor)).sum())
        hessian, slope = own[:p, :p] + self.precision, own[:p, p] + self.precision @ self.offset
        square = float(own[p, p] + self.offset @ self.precision @ self.offset)
        return self._integrated(hessian, slope, square, log_determinant, noise)

    def _gram(self, noise: Real) -> Real:
        return np.asarray(np.tensordot(1.0 / noise**2, self.grams, axes=1))

    def _residual_squares(self, scales: Real, average: Average) -> tuple[Real, Real]:
        """Residual sum of squares (r,) and absorbed data (r,) of each recording. The squares are in units of the stated
        noise."""
        p = self.offset.size
        acting = np.flatnonzero(scales)
        gram, scale = self._gram(average.noise), scales[acting]
        rows = p + 1 + acting
        inner = gram[np.ix_(rows, rows)] * np.outer(scale, scale) + np.eye(acting.size)
        along = scale * (gram[rows, :p] @ average.step + gram[rows, p])
        moved = np.concatenate([average.step, [1.0], -scale * np.linalg.solve(inner, along)])
        chosen = np.concatenate([np.arange(p), [p], rows])
        squares = np.einsum("i,rij,j->r", moved, self.grams[:, chosen[:, None], chosen], moved)
        taken = np.concatenate([np.arange(p), rows])
        weights = np.concatenate([np.ones(p), scale])
        outer = np.outer(weights, weights)
        whole = gram[np.ix_(taken, taken)] * outer
        whole[:p, :p] += self.precision + np.diag(np.where(np.isnan(self.widths), 0.0, 12.0 / self.widths**2))
        whole[p:, p:] += np.eye(acting.size)
        # A parameter without information absorbs no data.
        covariance = _inverse(whole) * outer
        count = np.einsum("ij,rij->r", covariance, self.grams[:, taken[:, None], taken]) / average.noise**2
        return squares, np.clip(count, 0.0, self.counts)

    def _integrated(
        self, hessian: Real, slope: Real, square: float, log_determinant: float, noise: Real
    ) -> Average:
        ranged = ~np.isnan(self.widths)
        # A parameter that changes nothing within its range stays where it is, and costs nothing.
        seen = ~ranged | (np.diag(hessian) * self.widths**2 > UNSEEN)
        ranged, hessian, slope = ranged & seen, hessian * np.outer(seen, seen), slope * seen
        covariance = _inverse(hessian)
        step = -covariance @ slope
        occam = 0.0
        if (ranged & ((step < -self.below) | (step > self.above))).any():
            # A parameter without a prior stays at its active bound; from there, the Gaussian is cut off.
            step, held = self._within_bounds(hessian, slope, ranged)
            inside = np.ix_(~held, ~held)
            covariance = np.zeros_like(hessian)
            covariance[inside] = _inverse(hessian[inside])
            for j in np.flatnonzero(held):
                curvature = float(hessian[j, j] - hessian[j] @ covariance @ hessian[:, j])
                inwards = abs(float(slope[j] + hessian[j] @ step))
                occam += math.log(self.widths[j]) - _cut_off(inwards, max(curvature, 0.0), self.widths[j])
            ranged = ranged & ~held
        own, stated = np.flatnonzero(ranged), np.flatnonzero(np.isnan(self.widths))
        known = np.ix_(stated, stated)
        if own.size:
            along = hessian[np.ix_(own, stated)]
            information = hessian[np.ix_(own, own)] - along @ _inverse(hessian[known]) @ along.T
            occam += 0.5 * occam_factor(information, self.widths[own])
        learnt = np.linalg.slogdet(hessian[known])[1] - np.linalg.slogdet(self.precision[known])[1]
        chi_square = square + float(2.0 * slope @ step + step @ hessian @ step)
        worth = -0.5 * (chi_square + log_determinant + float(learnt)) - occam
        # The remainder is a sum of squares; the determinant is that of a matrix with eigenvalues of at least 1.
        best = -0.5 * (max(chi_square, 0.0) + max(log_determinant, 0.0))
        return Average(checked(worth, best, square), step, covariance, occam, chi_square, noise)

    def _within_bounds(self, hessian: Real, slope: Real, ranged: NDArray[np.bool_]) -> tuple[Real, NDArray[np.bool_]]:
        """The step (p,) to the minimum within bounds, and active bounds (p,)."""
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
            solution = lsq_linear(root[:, None] * vectors[:, kept].T, -(vectors[:, kept].T @ force) / root, (low, high),
                                  method="bvls", tol=1e-12)
            relative = np.clip(solution.x, low, high)
        else:
            relative = np.zeros(own.size)
        at_end = (relative - low < END) | (high - relative < END)
        relative = np.where(relative - low < END, low, np.where(high - relative < END, high, relative))
        step, held = np.zeros(slope.size), np.zeros(slope.size, dtype=bool)
        step[own], held[own] = size * relative, at_end
        step[known] = -follow @ np.append(step[own], 1.0)
        return step, held


def _inverse(matrix: Real) -> Real:
    """The inverse of a positive matrix (p, p) whose units differ. Directions below rounding stay undetermined."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.linalg.pinv(matrix * np.outer(scale, scale), rcond=1e-13, hermitian=True) * np.outer(scale, scale)


def _cut_off(slope: float, curvature: float, width: float) -> float:
    """ln of a truncated Gaussian integral, at most ln of the width.

    The integrand is exp(-(slope t + curvature t^2 / 2)) over 0 < t < width, with neither coefficient negative.
    """
    if curvature * width**2 < FLAT:
        along = slope * width
        return math.log(width) + (math.log(-math.expm1(-along) / along) if along > FLAT else -0.5 * along)
    root = math.sqrt(2.0 * curvature)
    near, far = slope / root, (slope + curvature * width) / root
    whole = float(erfcx(near) - math.exp(-min(slope * width + 0.5 * curvature * width**2, 700.0)) * erfcx(far))
    return 0.5 * math.log(0.5 * math.pi / curvature) + math.log(whole)


def occam_factor(information: Real, widths: Real) -> float:
    """Twice the log of the prior volume over the posterior volume.

    Args:
        information: (k, k) the inverse of the posterior's covariance. No axis counts as longer than a range: a
            parameter without information costs nothing.
        widths: (k,) of the ranges, in units of one over those of its root.
    """
    relative = np.maximum(np.linalg.eigvalsh(information * np.outer(widths, widths)), 2.0 * np.pi)
    return float(np.sum(np.log(relative / (2.0 * np.pi))))


def over_scales(problem: LinearisedProblem, settings: Sequence[Real]) -> tuple[float, int, Average]:
    """ln of the mean evidence over the `settings`. The index of the best one and the average at it follow."""
    averages = list[Average]()
    for setting in settings:
        averages.append(problem.averaged(setting, averages[-1].noise if averages else None))
    logs = np.array([each.log_evidence for each in averages])
    best = int(np.argmax(logs))
    return float(logsumexp(logs) - math.log(logs.size)), best, averages[best]


def _over_noise(data: float, squares: float, noise: float) -> float:
    """ln of the mean likelihood of one recording over its noise scale. It is relative to the likeliest `noise` scale,
    for s^-data exp(-squares / (2 s^2)), over ln s up to that of :data:`LARGEST`."""
    logs = np.linspace(0.0, math.log(LARGEST), NODES)
    # The likelihood may be narrower than the steps of one grid: a second one lies about its maximum.
    about = math.log(noise) + np.linspace(-8.0, 8.0, NODES) / math.sqrt(2.0 * max(data, 1.0))
    logs = np.unique(np.concatenate([logs, np.clip(about, 0.0, logs[-1])]))

    def log_likelihood(log: Real | float) -> Any:
        return -data * np.asarray(log) - 0.5 * squares * np.exp(-2.0 * np.asarray(log))

    relative = np.exp(log_likelihood(logs) - log_likelihood(math.log(noise)))
    return math.log(float(np.trapezoid(relative, logs)) / math.log(LARGEST))
