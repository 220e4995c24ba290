"""The weights of the points of a campaign: how far a residual scatters where nothing is left to explain.

A device is never its model. The scale of what is left is therefore taken from what the best explanation leaves, and it
is diagonal: it can make points worth less, but it cannot take the shape of a spectrum. A search takes all that least
squares leaves, and an evidence what is left by correlated deviations too: counted before, the inhomogeneity of parts
would count twice, in the deviations and as points that carry the information of one. Of each recording, points
deviate by s times the stated noise, s >= 1, and n neighbouring points carry the information of one (Sokal 1997). Where
that leaves few points, s is that of all recordings rather than of one. An observation beside Z is one datum whose
uncertainty is stated: nobody can tell from one datum how far it scatters, and a bead that is timed knows nothing of the
misfit of a spectrum. Its s and n are one, and it has no part in those of the recordings.
Estimates are those of least squares with these deviations; evidences and intervals count the points as n times fewer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from workbench.campaign.state import DeviceState
from workbench.fitting.uncertainty import correlation_length

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Relative change of an inflation below which weights count as found.
STEADY = 0.1

#: Independent points of a recording that its own remainder counts as much with as that of all recordings. Without, two
#: bands of one disc, of one independent point each, weigh each other down in turn.
POOLED = 10.0


@dataclass(frozen=True, eq=False)
class Weighting:
    """The weights of the points of some states.

    ``inflation`` (r,) of the noise of each recording, at least 1; ``points`` (r,) neighbouring points that carry the
    information of one.
    """

    states: tuple[DeviceState, ...]
    inflation: Real
    points: Real

    @classmethod
    def stated(cls, states: Sequence[DeviceState]) -> Weighting:
        """The weights of the stated noise alone."""
        return cls(tuple(states), np.ones(len(states)), np.ones(len(states)))

    @classmethod
    def left(cls, states: Sequence[DeviceState], log_ratio: Sequence[Complex]) -> Weighting:
        """The likeliest weights where ln(Z_model / Z_measured) (n,) of every recording is all that nothing explains."""
        residuals = [log / state.noise for log, state in zip(log_ratio, states, strict=True)]
        squares = np.array([0.5 * np.mean(np.abs(each) ** 2) for each in residuals])
        points = np.array([correlation_length(each) for each in residuals])
        independent = np.array([each.size for each in residuals]) / points
        stated = np.array([state.observation is not None for state in states])
        pooled = np.mean(squares[~stated]) if not stated.all() else 1.0
        squares = (independent * squares + POOLED * pooled) / (independent + POOLED)
        inflation = np.where(stated, 1.0, np.sqrt(np.maximum(1.0, squares)))
        return cls(tuple(states), inflation, np.where(stated, 1.0, points))

    def deviations(self, level: float = 0.0) -> list[Real]:
        """Relative standard deviation (n,) of the points of every recording, with a further deviation `level`."""
        return [np.hypot(s * state.noise, level) for s, state in zip(self.inflation, self.states, strict=True)]

    def variances(self, level: float = 0.0) -> Real:
        """Variances (m,) of the data, real parts and then imaginary parts of every recording, in units of the noise."""
        return np.concatenate([np.tile((own / state.noise) ** 2, 2)
                               for own, state in zip(self.deviations(level), self.states, strict=True)])

    @cached_property
    def counts(self) -> Real:
        """Neighbouring data (m,) that carry the information of one."""
        return np.repeat(self.points, [2 * state.noise.size for state in self.states])

    def chi_square(self, log_ratio: Sequence[Complex]) -> float:
        """The sum of squares of a remainder ln(Z_model / Z_measured) (n,) of every recording, over these deviations."""
        return float(sum(np.sum(np.abs(log / deviation) ** 2)
                         for log, deviation in zip(log_ratio, self.deviations(), strict=True)))

    def log_likelihood(self, log_ratio: Sequence[Complex]) -> float:
        """The log likelihood of a remainder ln(Z_model / Z_measured) (n,) of every recording, of independent points as
        many as the information is worth, up to a constant."""
        return float(sum(
            -np.sum(0.5 * np.abs(log / deviation) ** 2 + 2.0 * np.log(deviation)) / points
            for log, deviation, points in zip(log_ratio, self.deviations(), self.points, strict=True)))

    @property
    def largest(self) -> float:
        """The largest inflation of a recording."""
        return float(self.inflation.max())

    def is_near(self, other: Weighting) -> bool:
        """Whether estimates with either weights are those with the other."""
        return bool(np.all(np.abs(np.log(self.inflation / other.inflation)) < STEADY))

    def joined(self, other: Weighting) -> Weighting:
        """The weights of these states and then of others."""
        return Weighting((*self.states, *other.states), np.concatenate([self.inflation, other.inflation]),
                         np.concatenate([self.points, other.points]))


def furthest_observation(states: Sequence[DeviceState], log_ratio: Sequence[Complex]) -> float:
    """The largest distance of an observation of some states from its prediction, ln(predicted / measured) as
    `log_ratio` (n,) of each, in its standard uncertainties; 0 without observations."""
    return max((float(np.abs(log / state.noise).max()) for state, log in zip(states, log_ratio, strict=True)
                if state.observation is not None), default=0.0)
