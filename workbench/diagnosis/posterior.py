"""The posterior of one hypothesis as a function of its parameters, for samplers.

The probability model is that of the diagnosis (`likelihood`, `evidence`) without its linearisation. With the residuals
r(theta) = ln(Z_model / Z_measured) (m,), real parts and imaginary parts of all fitted recordings, over the deviations
that points have by its weights, and the deviations B (m, k) at the place of the hypothesis,

    ln L(theta) = ln mean_s exp(-(r^T Sigma_s^-1 r + ln det Sigma_s) / 2),   Sigma_s = 1 + B diag(s^2) B^T,

the mean being over all settings s of the scales. Left out, as in the evidence of an explanation, is what all
hypotheses share: -(m / 2) ln 2 pi - sum ln deviation. The integral of L over the prior is therefore the evidence that
`Explanation.log_evidence` approximates. Laplace's approximation does not see that

- r is not linear;
- normal priors end at the bounds: here they are normalised within these, there over all numbers;
- a range ends within a few standard deviations of an optimum inside of it (where the optimum is at the end, it does);
- not all within the bounds is a material.

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
from workbench.diagnosis.likelihood import Explanation, Hypothesis, Likelihood, Scales
from workbench.diagnosis.local_models import LocalModels
from workbench.diagnosis.ranking import start
from workbench.diagnosis.weighting import Weighting
from workbench.files.errors import nearest_names
from workbench.fitting.search import REFUSED, FitSearch
from workbench.results.brief import Brief
from workbench.search.constrained import STRICT

Real = NDArray[np.float64]


class NormalApproximation(NamedTuple):
    """Laplace's approximation: the ``log_evidence``, and the ``mean`` (k,) and ``covariance`` (k, k) of the normal
    distribution, SI, at the scales of the largest evidence."""

    log_evidence: float
    mean: Real
    covariance: Real


class _InverseCovariance(NamedTuple):
    """The inverse of one Sigma: 1 less the square of ``root`` (q, q) on the deviations that are ``acting`` (q,)."""

    acting: NDArray[np.int64]
    root: Real
    log_determinant: float


@dataclass(frozen=True, eq=False, repr=False)
class Posterior(Brief):
    """The posterior of a hypothesis about the recordings of a campaign.

    Everywhere theta (k,) are the free parameters alone, those of :attr:`names`, in SI units (that of a ``relative``
    parameter is 1). All else stays at the place ``x`` (p,), of which also the deviations B are. Reduced models predict
    the recordings; they are made about x, and :meth:`error_estimate` estimates their error elsewhere.

    ``scales`` are those of the deviations, averaged over as in the diagnosis if None.
    """

    likelihood: Likelihood
    explanation: Explanation
    scales: Scales | None = None

    @classmethod
    def of(
        cls, model: Model, hypothesis: Hypothesis, x: Real, *, errors: Real | None = None, scales: Scales | None = None
    ) -> Posterior:
        """The posterior on reduced models made for the neighbourhood of x (p,), with the weights of what is left there.

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
        """The posterior of an explanation at its own optimum, with the deviations of its evidence.

        Raises:
            NotConverged, NotEnriched, MeshError, InputError: nothing can be predicted there.
        """
        found = refit.explanation
        return cls(LocalModels(model).near(found.hypothesis, found.x, found.errors), found, scales)

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
    def _normal(self) -> tuple[NDArray[np.bool_], Real, Real, Real]:
        """Which parameters (k,) have a normal prior; of these its precision, and the bounds in its deviations."""
        free = list(self.free)
        precision = self._search.precision[free]
        known = precision > 0.0
        ends = [((end - self._search.centre[free]) * precision)[known] for end in (self.low, self.high)]
        return known, precision[known], *ends

    def log_prior(self, theta: Real) -> float:
        """ln of the density of the prior at theta (k,), in units of one over those of all parameters.

        Normal within the bounds and normalised there, of a known number; of any other the same all over its range.
        -inf outside.

        Raises:
            ValueError: theta is not of (k,) numbers.
        """
        theta = self._checked(theta)
        if not self._is_inside(theta):
            return -math.inf
        known, precision, low, high = self._normal
        deviation = (theta[known] - self._search.centre[list(self.free)][known]) * precision
        # The centre is within the bounds: neither is a small difference of numbers near one.
        mass = np.log(ndtr(high) - ndtr(low))
        normal = np.log(precision) - 0.5 * math.log(2.0 * math.pi) - 0.5 * deviation**2 - mass
        return float(normal.sum() - np.log((self.high - self.low)[~known]).sum())

    def prior_transform(self, u: Real) -> Real:
        """theta (k,) at u (k,) in the unit cube, as nested sampling asks for the prior: equal volumes are as likely.

        Raises:
            ValueError: u is not of (k,) numbers.
        """
        u = self._checked(u)
        known, precision, low, high = self._normal
        theta = self.low + u * (self.high - self.low)
        below, above = ndtr(low), ndtr(high)
        deviation = ndtri(below + u[known] * (above - below))
        theta[known] = self._search.centre[list(self.free)][known] + deviation / precision
        return np.asarray(np.clip(theta, self.low, self.high))

    def log_likelihood(self, theta: Real) -> float:
        """ln L at theta (k,), up to a constant of all hypotheses, less the cost of the choice of modes.

        -inf outside the bounds, where a material would make energy, and where nothing can be predicted.

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
        cost = sum(mode.cost for mode in self.hypothesis.modes)
        return float(logsumexp(0.5 * np.array(logs))) - math.log(len(logs)) - cost

    def log_posterior(self, theta: Real) -> float:
        """The sum of :meth:`log_likelihood` and :meth:`log_prior` at theta (k,): its integral is the evidence.

        Raises:
            ValueError: theta is not of (k,) numbers.
        """
        prior = self.log_prior(theta)
        return prior if prior == -math.inf else prior + self.log_likelihood(theta)

    def error_estimate(self, theta: Real) -> float:
        """The estimated relative error of Z of the reduced models at theta (k,): a bound, some hundred times the error.

        Raises:
            ValueError: theta is not of (k,) numbers.
            NotConverged, NotEnriched, MeshError, InputError: nothing can be predicted there.
        """
        x, objective = self._all_parameters(self._checked(theta)), self.likelihood.objective
        predictions = (objective.predict(x, index, ())[2] for index in range(len(objective.recordings)))
        return max(float(each.error.max()) for each in predictions)

    def laplace(self) -> NormalApproximation:
        """The approximation by tangents at x, which a diagnosis decides by; samplers begin with it."""
        local = self.explanation.local
        if self.scales is None:
            worth, _, average = local.best
        else:
            average = local.averaged(self.scales)
            worth = average.log_evidence
        cost = sum(mode.cost for mode in self.hypothesis.modes)
        return NormalApproximation(worth - cost, self.place + average.step, average.covariance)

    @cached_property
    def _deviations(self) -> Real:
        """B (m, k)."""
        return self.explanation.local.unit_deviations

    @cached_property
    def _inverse_covariances(self) -> list[_InverseCovariance]:
        settings = self.explanation.local.settings if self.scales is None else (self.scales,)
        return [self._inverse_covariance(each) for each in settings]

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
        found = np.asarray(theta, dtype=float)
        if found.shape != (len(self.free),):
            raise ValueError(f"parameters of shape {found.shape}: expected ({len(self.free)},), one number each of "
                             f"{', '.join(self.names)}")
        return found


def posterior_of(model: Model, found: Found, name: str, *, scales: Scales | None = None) -> Posterior:
    """The posterior of the hypothesis of that name, at the best optimum that a search found.

    One that the search did not refit is followed to its optimum first, from its last candidate, or from the start that
    its score predicts.

    Raises:
        ValueError: no hypothesis of that name, or nothing near its place is admissible.
        NotConverged, NotEnriched, MeshError, InputError: nothing can be predicted there.
    """
    for refit in found.final:
        if refit.explanation.hypothesis.name == name:
            return Posterior.of_refit(model, refit, scales=scales)
    best = found.base.explanation.x
    begins = {score.effect.name: (Hypothesis((score.effect,)), start(model, score.effect, best, score))
              for score in found.base.scores}
    begins |= {each.hypothesis.name: (each.hypothesis, each.x) for each in found.candidates}
    if name not in begins:
        known = [*(each.explanation.hypothesis.name for each in found.final), *begins]
        near = f"; did you mean {' or '.join(map(repr, like))}?" if (like := nearest_names(name, known)) else ""
        raise ValueError(f"unknown hypothesis {name!r}{near}; known: {', '.join(dict.fromkeys(known))}")
    hypothesis, x = begins[name]
    own = Posterior.of(model, hypothesis, x).likelihood.refit(hypothesis, x)
    return Posterior.of(model, hypothesis, own.x, errors=own.errors, scales=scales)


def _explained(likelihood: Likelihood, hypothesis: Hypothesis, x: Real) -> Explanation:
    """A hypothesis at x (p,), with the weights of what is left there."""
    found = likelihood.explanation(hypothesis, x)
    return found.weighted(Weighting.left(likelihood.states, found.log_ratio))
