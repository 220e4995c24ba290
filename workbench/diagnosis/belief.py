"""Where the known numbers are, as far as the recordings of the smallest body say at little weight.

The smallest body, the free transducer of most campaigns, is the cheapest to predict and has one optimum. What it says
of its own numbers tells where the models of the others have to be right: not all over what is known beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.descent import LEVELS, SMOOTHED, inside
from workbench.diagnosis.device import Model
from workbench.diagnosis.likelihood import Hypothesis, Likelihood
from workbench.fitting.search import NO_END

Real = NDArray[np.float64]

#: Descents for the smallest body: from what is stated, and from draws of what is known.
DESCENTS = 4


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

    def places(self, pairs: int, seed: int) -> list[Real]:
        """Draws (p,), each with its opposite, within what is admissible."""
        return [self._at(self.root @ (sign * white))
                for white in np.random.default_rng(seed).standard_normal((pairs, len(self.root)))
                for sign in (1.0, -1.0)]

    def given(self, likelihood: Likelihood, level: float = LEVELS[0]) -> Belief:
        """The same with what some recordings add whose points have a further deviation of `level`.

        Of several optima the best. As it is where nothing can be predicted.
        """
        search, known, ends = likelihood.search(Hypothesis()), range(len(self.root)), []
        for start in [self.x, *self.places(DESCENTS, 0)[:DESCENTS - 1]]:
            try:
                end = likelihood.tempered(search, start, level, smoothing=SMOOTHED)
                ends.append(likelihood.tempered(search, end.x, level))
            except NO_END:
                continue
        if not ends:
            return self
        x = min(ends, key=lambda end: end.cost).x
        tangents = likelihood.objective(x, deviation=likelihood.spreads(level), free=frozenset(known)).jacobian
        # root (I + B^T B)^-1 root^T with B what the data do per unit of white noise.
        _, sizes, directions = np.linalg.svd(tangents[:, known] @ self.root, full_matrices=False)
        root = self.root - (self.root @ directions.T * (1.0 - 1.0 / np.sqrt(1.0 + sizes**2))) @ directions
        return Belief(x, root, self.low, self.high)

    def _at(self, shift: Real) -> Real:
        place = self.x.copy()
        known = slice(len(self.root))
        place[known] = inside(place[known] + shift, self.low, self.high)
        return place
