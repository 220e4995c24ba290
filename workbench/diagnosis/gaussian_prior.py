"""Where the known numbers are, as far as the recordings of the smallest body say at little weight.

The smallest body, the free transducer of most campaigns, is the cheapest to predict and has one optimum. What it says
of its own numbers tells where the models of the others have to be right: not all over what is known beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.descent import LEVELS, initial_optimum, inside
from workbench.diagnosis.device import Model
from workbench.diagnosis.likelihood import Hypothesis, Likelihood
from workbench.fitting.objective import Objective
from workbench.fitting.search import NO_END
from workbench.search.multistart import StartPoint, multistart

Real = NDArray[np.float64]

#: Descents for the smallest body: from what is stated, and from draws of what is known.
DESCENTS = 4

#: A number is multimodal where one uncertainty along its profile changes the data at little weight by this many
#: deviations more than the tangent says. There are at most so many.
CURVED, MULTIMODAL = 10.0, 2


@dataclass(frozen=True, eq=False)
class Belief:
    """A normal distribution of the known numbers about ``x`` (p,): they are x + ``root`` (k, k) times white noise."""

    x: Real
    root: Real
    low: Real
    high: Real

    @classmethod
    def prior(cls, model: Model) -> Belief:
        """What is known beforehand."""
        low, high = model.bounds(range(model.known))
        deviations = np.array([p.prior or 0.0 for p in model.parameters[:model.known]])
        return cls(np.array([p.start for p in model.parameters]), np.diag(deviations), low, high)

    @property
    def deviations(self) -> Real:
        """Standard deviations of the known numbers (k,)."""
        return np.asarray(np.linalg.norm(self.root, axis=1))

    def reach(self, model: Model, far: float) -> dict[str, float]:
        """So many standard deviations of the known numbers, by name."""
        return {p.name: far * float(each)
                for p, each in zip(model.parameters[:model.known], self.deviations, strict=True) if each > 0.0}

    def places(self, pairs: int, seed: int) -> list[Real]:
        """Draws (p,), each with its opposite, within what is admissible."""
        return [self.at(self.root @ (sign * white))
                for white in np.random.default_rng(seed).standard_normal((pairs, len(self.root)))
                for sign in (1.0, -1.0)]

    def given(self, likelihood: Likelihood) -> Belief:
        """The same with what some recordings add where they weigh little.

        Of several optima the best. As it is where nothing can be predicted.
        """
        search, known = likelihood.search(Hypothesis()), range(len(self.root))
        starts = [StartPoint("", x) for x in (self.x, *self.places(DESCENTS, 0)[:DESCENTS - 1])]
        trials = multistart(starts, lambda start: initial_optimum(likelihood, search, start.x), refused=NO_END)
        ends = [trial.end for trial in trials if trial.end is not None]
        if not ends:
            return self
        x = min(ends, key=lambda end: end.cost).x
        tangents = likelihood.objective(x, deviation=likelihood.spreads(LEVELS[0]), free=frozenset(known)).jacobian
        # root (I + B^T B)^-1 root^T with B what the data do per unit of white noise.
        _, sizes, directions = np.linalg.svd(tangents[:, known] @ self.root, full_matrices=False)
        root = self.root - (self.root @ directions.T * (1.0 - 1.0 / np.sqrt(1.0 + sizes**2))) @ directions
        return Belief(x, root, self.low, self.high)

    def along(self, index: int, steps: Sequence[float]) -> list[Real]:
        """Places (p,) where one number alone is so many of its standard deviations from here."""
        return [self.at(np.where(np.arange(len(self.root)) == index, step * self.deviations, 0.0)) for step in steps]

    def at(self, shift: Real) -> Real:
        """Where (p,) the known numbers have moved by that much (k,), within what is admissible."""
        place = self.x.copy()
        known = slice(len(self.root))
        place[known] = inside(place[known] + shift, self.low, self.high)
        return place


def smallest_body(recordings: Objective) -> Objective | None:
    """Those recordings that are of the body of fewest unknowns; None if all are of one."""
    size = {predictor: predictor.operators.size for predictor in recordings.predictors}
    names = [each.name for each, predictor in zip(recordings.recordings, recordings.predictors, strict=True)
             if size[predictor] == min(size.values())]
    return recordings.of(names) if len(size) > 1 else None


def multimodal(likelihood: Likelihood, belief: Belief) -> list[int]:
    """Indices of the known numbers along whose profiles the data bend most, where they weigh little.

    The profile of a number is where the optimum of all others goes when it moves by one uncertainty: what these can
    make up for does not bend anything. The gel below a chip is of this kind: waves along a film change with its
    thickness, and they are many.
    """
    model, known = likelihood.model, np.arange(len(belief.root))
    spreads = likelihood.spreads(LEVELS[0])
    here = likelihood.objective(belief.x, deviation=spreads, free=frozenset(map(int, known)))
    tangents = here.jacobian[:, known]
    by_noise = tangents @ belief.root
    covariance = belief.root @ np.linalg.inv(by_noise.T @ by_noise + np.eye(known.size)) @ belief.root.T
    found: list[tuple[float, int]] = []
    for i, deviation in enumerate(belief.deviations):
        profile = covariance[:, i] * (deviation / covariance[i, i]) if deviation > 0.0 else np.zeros(known.size)
        if model.parameters[i].is_bench or np.linalg.norm(tangents @ profile) < CURVED:
            continue
        bent = []
        for place in (belief.at(-profile), belief.at(profile)):
            there = likelihood.objective(place, deviation=spreads, free=()).vector
            bent.append(float(np.linalg.norm(there - here.vector - tangents @ (place - belief.x)[known])))
        found.append((max(bent), i))
    return [i for bent, i in sorted(found, reverse=True)[:MULTIMODAL] if bent > CURVED]
