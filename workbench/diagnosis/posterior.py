"""The posterior of one hypothesis as a function of its parameters.

Samplers use it. The probability model is that of the diagnosis (`likelihood`, `evidence`) without its linearisation.
With the residuals r(theta) = ln(Z_model / Z_measured) (m,), real parts and imaginary parts of all fitted recordings,
over the deviations of the points by its weights, and the deviations B (m, k) at the place of the hypothesis,

    ln L(theta) = ln mean_s exp(-(r^T Sigma_s^-1 r + ln det Sigma_s) / 2),   Sigma_s = 1 + B diag(s^2) B^T,

the mean being over all settings s of the scales; the noise scale of each recording is the likeliest one at the place of
the hypothesis. As in the evidence of an explanation, the terms common to all hypotheses are omitted: -(m / 2) ln 2 pi
less the logarithms of the stated noise. The integral of L over the prior is therefore the evidence that
:meth:`Posterior.laplace` approximates. Laplace's approximation ignores that

- r is not linear;
- normal priors end at the bounds: here they are normalised within these, there over all numbers;
- a range ends within a few standard deviations of an optimum inside of it (an active bound is allowed for);
- some points within the bounds are no admissible material.

Laplace's approximation, evidence and samplers: MacKay 2003, Information Theory, Inference, and Learning Algorithms,
chapters 27 to 29. The prior as a transform of the unit cube: Skilling 2006, Bayesian Analysis 1, 833.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.special import logsumexp, ndtr, ndtri

from workbench.diagnosis.device import Model
from workbench.diagnosis.findings import Found, Refitted
from workbench.diagnosis.likelihood import Explanation, Hypothesis, Likelihood
from workbench.diagnosis.local_models import LocalModels
from workbench.diagnosis.local_problem import Scales
from workbench.diagnosis.ranking import start
from workbench.diagnosis.weighting import Weighting
from workbench.files.errors import nearest_names
from workbench.fitting.search import REFUSED, FitSearch
from workbench.results.brief import Brief
from workbench.search.constrained import STRICT

Real = NDArray[np.float64]


class NormalApproximation(NamedTuple):
    """Laplace's approximation: ``log_evidence``, ``mean`` (k,) and ``covariance`` (k, k), SI. The normal distribution
    is at the scales of the largest evidence."""

    log_evidence: float
    mean: Real
    covariance: Real


class _InverseCovariance(NamedTuple):
    """The inverse of one Sigma. It is 1 less the square of ``root`` (q, q) on the deviations ``acting`` (q,)."""

    acting: NDArray[np.int64]
    root: Real
    log_determinant: float


@dataclass(frozen=True, eq=False, repr=False)
class Posterior(Brief):
    """The posterior of a hypothesis about the recordings of a campaign.

    Everywhere theta (k,) are the free parameters alone, those of :attr:`names`, in SI units (that of a ``relative``
    parameter is 1). All others stay at the place ``x`` (p,), which also determines the deviations B. Reduced models
    predict the recordings; they are made about x, and :meth:`error_estimate` estimates their error elsewhere.

    ``scales`` are those of the deviations, averaged over as in the diagnosis if None.
    """

    likelihood: Likelihood
    explanation: Explanation
    scales: Scales | None = None

    @classmethod
    def of(
        cls, model: Model, hypothesis: Hypothesis, x: Real, *, errors: Real | None = None, scales: Scales | None = None
    ) -> Posterior:
        """The posterior on reduced models near x (p,), weighted by the residual.

        The models cover two standard deviations `errors` (p,), zero of parameters that do not move; by default those of
        Laplace's approximation at x.

        Raises:
            NotConverged, NotEnriched, MeshError, InputError: nothing can be predicted at x.
        """
        models = LocalModels(model)
        if errors is None:
            errors = _explained(models.near(hypothesis, x, np.zeros(x.size)), hypothesis, x).errors
        own = models.near(hypothesis, x, errors)
        return cls(own, _explained(own, hypothesis, x), scales)

    @classmethod
    def of_refit(cls, model: Model, refit: Refitted, *, scales: Scales | None = None) -> Posterior:
        """The posterior of an explanation at its optimum, with its deviations.

        Raises:
            NotConverged, NotEnriched, MeshError, InputError: nothing can be predicted there.
        """
        own = refit.explanation
        return cls(LocalModels(model).near(own.hypothesis, own.x, own.errors), own, scales)

    @property
    def hypothesis(self) -> Hypothesis:
        return self.explanation.hypothesis

    @property
    def x(self) -> Real:
        """All parameters (p,) at the optimum."""
        return self.explanation.likeliest

    @cached_property
    def _search(self) -> FitSearch:
        return self.likelihood.search(self.hypothesis)

    @cached_property
    def free(self) -> tuple[int, ...]:
        """Indices of the free parameters (k,) among all of the model."""
        return tuple(map(int, self._search.free))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters (k,)."""
        return tuple(self.likelihood.model.parameters[i].name for i in self.free)

    @property
    def place(self) -> Real:
        """The free parameters (k,) at x."""
        return self.x[list(self.free)]

    @cached_property
    def low(self) -> Real:
        """The least (k,) that the free parameters may be."""
        return self._search.low[list(self.free)]

    @cached_property
    def high(self) -> Real:
        """The most (k,) that they may be."""
        return self._search.high[list(self.free)]

    @cached_property
    def _known(self) -> NDArray[np.int64]:
        """The indices of the parameters (k,) that have a normal prior."""
        return np.flatnonzero(np.diag(self._prior_rows) > 0.0)

    @cached_property
    def _prior_rows(self) -> Real:
        """The root (k, k) of the precision of the prior, lower triangular."""
        return np.asarray(self._search.prior_rows[np.ix_(self.free, self.free)])

    @cached_property
    def _centre(self) -> Real:
        return np.asarray(self._search.centre[list(self.free)])

    def _within(self, i: int, theta: Real) -> tuple[float, float, float]:
        """The conditional mean of a known parameter, and its bounds in deviations."""
        row, own = self._prior_rows[i], float(self._prior_rows[i, i])
        mean = float(self._centre[i] - row[:i] @ (theta - self._centre)[:i] / own)
        return mean, (float(self.low[i]) - mean) * own, (float(self.high[i]) - mean) * own

    def log_prior(self, theta: Real) -> float:
        """ln of the prior density at theta (k,), in SI units.

        A known parameter is normal and normalised within its bounds, given those before it; any other is uniform over
        its range. -inf outside.

        Raises:
            ValueError: theta is not of (k,) numbers.
        """
        theta = self._checked(theta)
        if not self._is_inside(theta):
            return -math.inf
        log = -float(np.log(np.delete(self.high - self.low, self._known)).sum())
        for i in self._known:
            mean, low, high = self._within(i, theta)
            own = float(self._prior_rows[i, i])
            log += math.log(own) - 0.5 * math.log(2.0 * math.pi) - 0.5 * ((theta[i] - mean) * own) ** 2
            log -= math.log(float(ndtr(high) - ndtr(low)))
        return log

    def prior_transform(self, u: Real) -> Real:
        """theta (k,) at u (k,) in the unit cube, for nested sampling.

        Raises:
            ValueError: u is not of (k,) numbers.
        """
        u = self._checked(u)
        theta = self.low + u * (self.high - self.low)
        for i in self._known:
            mean, low, high = self._within(i, theta)
            deviation = ndtri(ndtr(low) + u[i] * (ndtr(high) - ndtr(low)))
            theta[i] = np.clip(mean + deviation / self._prior_rows[i, i], self.low[i], self.high[i])
        return np.asarray(theta)

    def log_likelihood(self, theta: Real) -> float:
        """ln L at theta (k,), less the cost of choosing modes.

        Up to a constant. -inf outside the bounds, for a material that generates energy, or without a prediction.

        Raises:
            ValueError: theta is not of (k,) numbers.
        """
        theta = self._checked(theta)
        x = self._all_parameters(theta)
        if not self._is_inside(theta) or any(each.margin(x) < -STRICT for each in self._search.inequalities):
            return -math.inf
        try:
            residual = self._residual(x)
        except REFUSED:
            return -math.inf
        square, along = float(residual @ residual), self._deviations.T @ residual
        logs = [float(np.sum((own.root @ along[own.acting]) ** 2)) - square - own.log_determinant
                for own in self._inverse_covariances]
        local = self.explanation.local
        normalisation = float(local.problem.counts @ np.log(local.best[2].noise))
        cost = normalisation + sum(mode.cost for mode in self.hypothesis.modes)
        return float(logsumexp(0.5 * np.array(logs))) - math.log(len(logs)) - cost

    def log_posterior(self, theta: Real) -> float:
        """:meth:`log_likelihood` plus :meth:`log_prior` at theta (k,). Its integral is the evidence.

        Raises:
            ValueError: theta is not of (k,) numbers.
        """
        prior = self.log_prior(theta)
        return prior if prior == -math.inf else prior + self.log_likelihood(theta)

    def error_estimate(self, theta: Real) -> float:
        """A bound on the relative error of Z at theta (k,). It is some hundred times the error of the reduced models.

        Raises:
            ValueError: theta is not of (k,) numbers.
            NotConverged, NotEnriched, MeshError, InputError: nothing can be predicted there.
        """
        x, objective = self._all_parameters(self._checked(theta)), self.likelihood.objective
        predictions = (objective.predict(x, index, ())[2] for index in range(len(objective.recordings)))
        return max(float(each.error.max()) for each in predictions)

    def laplace(self) -> NormalApproximation:
        """The linearised approximation at x, for decisions and to start samplers."""
        averages = [self.explanation.local.at(each) for each in self._settings]
        logs = np.array([each.log_evidence for each in averages])
        average = averages[int(np.argmax(logs))]
        worth = float(logsumexp(logs)) - math.log(logs.size) - sum(mode.cost for mode in self.hypothesis.modes)
        return NormalApproximation(worth, self.place + average.step, average.covariance)

    @property
    def _settings(self) -> Sequence[Scales]:
        return self.explanation.local.settings if self.scales is None else (self.scales,)

    @cached_property
    def _deviations(self) -> Real:
        """B (m, k)."""
        return self.explanation.local.unit_deviations

    @cached_property
    def _inverse_covariances(self) -> list[_InverseCovariance]:
        return [self._inverse_covariance(each) for each in self._settings]

    def _inverse_covariance(self, scales: Scales) -> _InverseCovariance:
        # By Woodbury: Sigma^-1 = 1 - C (1 + C^T C)^-1 C^T with C = B diag(s).
        every = self.explanation.local.expanded(scales)
        acting = np.flatnonzero(every)
        columns = self._deviations[:, acting] * every[acting]
        factor = np.linalg.cholesky(columns.T @ columns + np.eye(acting.size))
        root = scipy.linalg.solve_triangular(factor, np.diag(every[acting]), lower=True)
        return _InverseCovariance(acting, root, 2.0 * float(np.log(np.diag(factor)).sum()))

    def _residual(self, x: Real) -> Real:
        """r (m,) at x (p,), without derivatives."""
        data = self.likelihood.objective(x, deviation=self.likelihood.point_deviations(), free=())
        return data.vector * self.explanation.local.root

    def _all_parameters(self, theta: Real) -> Real:
        x = self.x.copy()
        x[list(self.free)] = theta
        return x

    def _is_inside(self, theta: Real) -> bool:
        return bool(((self.low <= theta) & (theta <= self.high)).all())

    def _checked(self, theta: Real | Sequence[float]) -> Real:
        checked = np.asarray(theta, dtype=float)
        if checked.shape != (len(self.free),):
            raise ValueError(f"parameters of shape {checked.shape}: expected ({len(self.free)},), one number each of "
                             f"{', '.join(self.names)}")
        return checked


def posterior_of(model: Model, results: Found, name: str, *, scales: Scales | None = None) -> Posterior:
    """The posterior of a hypothesis, at its best optimum in a search.

    An unrefitted hypothesis is refitted first, from its last candidate, or from the start that its score predicts.

    Raises:
        ValueError: no hypothesis of that name, or nothing near its place is admissible.
        NotConverged, NotEnriched, MeshError, InputError: nothing can be predicted there.
    """
    for refit in results.final:
        if refit.explanation.hypothesis.name == name:
            return Posterior.of_refit(model, refit, scales=scales)
    best = results.base.explanation.x
    begins = {score.effect.name: (Hypothesis((score.effect,)), start(model, score.effect, best, score))
              for score in results.base.scores}
    begins |= {each.hypothesis.name: (each.hypothesis, each.x) for each in results.candidates}
    if name not in begins:
        known = [*(each.explanation.hypothesis.name for each in results.final), *begins]
        near = f"; did you mean {' or '.join(map(repr, like))}?" if (like := nearest_names(name, known)) else ""
        raise ValueError(f"unknown hypothesis {name!r}{near}; known: {', '.join(dict.fromkeys(known))}")
    hypothesis, x = begins[name]
    own = Posterior.of(model, hypothesis, x).likelihood.refit(hypothesis, x)
    return Posterior.of(model, hypothesis, own.x, errors=own.errors, scales=scales)


def _explained(likelihood: Likelihood, hypothesis: Hypothesis, x: Real) -> Explanation:
    """A hypothesis at x (p,), weighted by its residual there."""
    explanation = likelihood.explanation(hypothesis, x)
    return explanation.weighted(Weighting.left(likelihood.states, explanation.log_ratio))
