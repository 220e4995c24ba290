"""The Gaussian prior of known parameters, updated by the smallest assembly.

The smallest assembly, the free transducer of most campaigns, is the cheapest to predict and has one optimum. Its
recordings at low weight narrow the prior. Models of the other assemblies must be right within the narrower prior only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.device import Model
from workbench.diagnosis.levels import LEVELS, SCHEDULE, inside
from workbench.diagnosis.likelihood import Hypothesis, Likelihood
from workbench.fitting.objective import Objective
from workbench.fitting.search import NO_END
from workbench.search.continuation import tempered
from workbench.search.multistart import StartPoint, multistart

Real = NDArray[np.float64]

#: Descents for the smallest assembly: from the stated values, and from draws of the prior.
DESCENTS = 4

#: A parameter is multimodal if one uncertainty along its profile changes the data at low weight by this many
#: deviations more than its tangent. The second constant is the most that are used.
CURVED, MULTIMODAL = 10.0, 2


@dataclass(frozen=True, eq=False)
class GaussianPrior:
    """A normal distribution of the known parameters about ``x`` (p,). A deviation is ``root`` (k, k) times white noise;
    the bounds are ``low`` and ``high`` (k,)."""

    x: Real
    root: Real
    low: Real
    high: Real

    @classmethod
    def prior(cls, model: Model) -> GaussianPrior:
        """The prior as the campaign states it."""
        low, high = model.bounds(range(model.known))
        deviations = np.array([p.prior or 0.0 for p in model.parameters[:model.known]])
        correlation = model.correlation[:model.known, :model.known]
        return cls(np.array([p.start for p in model.parameters]),
                   deviations[:, None] * np.linalg.cholesky(correlation), low, high)

    @property
    def deviations(self) -> Real:
        """Standard deviations of the known parameters (k,)."""
        return np.asarray(np.linalg.norm(self.root, axis=1))

    def reach(self, model: Model, far: float) -> dict[str, float]:
        """`far` standard deviations of each known parameter, by name."""
        return {p.name: far * float(each)
                for p, each in zip(model.parameters[:model.known], self.deviations, strict=True) if each > 0.0}

    def draws(self, pairs: int, seed: int) -> list[Real]:
        """Draws (p,) in pairs opposite each other, within the admissible ranges."""
        return [self.shifted(self.root @ (sign * white))
                for white in np.random.default_rng(seed).standard_normal((pairs, len(self.root)))
                for sign in (1.0, -1.0)]

    def updated(self, likelihood: Likelihood) -> GaussianPrior:
        """The posterior from this prior and some recordings at low weight.

        It is about the best of their optima. The result is the prior itself if nothing can be predicted.
        """
        search, known = likelihood.search(Hypothesis()), range(len(self.root))
        starts = [StartPoint("", x) for x in (self.x, *self.draws(DESCENTS, 0)[:DESCENTS - 1])]
        trials = multistart(starts, lambda start: tempered(
            SCHEDULE, lambda stage, x: likelihood.solve(search, stage, x), start.x), refused=NO_END)
        ends = [trial.end for trial in trials if trial.end is not None]
        if not ends:
            return self
        x = min(ends, key=lambda end: end.cost).x
        deviation = likelihood.point_deviations(LEVELS[0])
        tangents = likelihood.objective(x, deviation=deviation, free=frozenset(known)).jacobian
        # root (I + B^T B)^-1 root^T, with B the derivative of the data by the white noise.
        _, sizes, directions = np.linalg.svd(tangents[:, known] @ self.root, full_matrices=False)
        root = self.root - (self.root @ directions.T * (1.0 - 1.0 / np.sqrt(1.0 + sizes**2))) @ directions
        return GaussianPrior(x, root, self.low, self.high)

    def profile_points(self, index: int, steps: Sequence[float]) -> list[Real]:
        """Points (p,) with one parameter moved by `steps`, in its deviations."""
        own = np.arange(len(self.root)) == index
        return [self.shifted(np.where(own, step * self.deviations, 0.0)) for step in steps]

    def shifted(self, shift: Real) -> Real:
        """The point (p,) with known parameters moved by `shift` (k,), within bounds."""
        place = self.x.copy()
        known = slice(len(self.root))
        place[known] = inside(place[known] + shift, self.low, self.high)
        return place


def smallest_assembly(recordings: Objective) -> Objective | None:
    """The recordings of the smallest assembly; None if there is only one."""
    size = {predictor: predictor.operators.size for predictor in recordings.predictors}
    names = [each.name for each, predictor in zip(recordings.recordings, recordings.predictors, strict=True)
             if size[predictor] == min(size.values())]
    return recordings.among(names) if len(size) > 1 else None


def multimodal(likelihood: Likelihood, prior: GaussianPrior) -> list[int]:
    """Indices of the known parameters with the most curved profiles.

    The profile of a parameter is the optimum of all others as it moves by one uncertainty: compensation adds no
    curvature. The thickness of the gel below a chip is multimodal: it changes the many waves along the film.
    """
    model, known = likelihood.model, np.arange(len(prior.root))
    spreads = likelihood.point_deviations(LEVELS[0])
    here = likelihood.objective(prior.x, deviation=spreads, free=frozenset(map(int, known)))
    tangents = here.jacobian[:, known]
    by_noise = tangents @ prior.root
    covariance = prior.root @ np.linalg.inv(by_noise.T @ by_noise + np.eye(known.size)) @ prior.root.T
    bends: list[tuple[float, int]] = []
    for i, deviation in enumerate(prior.deviations):
        profile = covariance[:, i] * (deviation / covariance[i, i]) if deviation > 0.0 else np.zeros(known.size)
        if model.parameters[i].is_bench or np.linalg.norm(tangents @ profile) < CURVED:
            continue
        bent = []
        for place in (prior.shifted(-profile), prior.shifted(profile)):
            there = likelihood.objective(place, deviation=spreads, free=()).vector
            bent.append(float(np.linalg.norm(there - here.vector - tangents @ (place - prior.x)[known])))
        bends.append((max(bent), i))
    return [i for bent, i in sorted(bends, reverse=True)[:MULTIMODAL] if bent > CURVED]
