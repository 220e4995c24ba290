"""The weights of the points, from the scatter of their residual.

No model is exact, so the noise scale is estimated from the residual of the best explanation. It is diagonal: it can
reduce the weight of points, but it cannot take the shape of a spectrum. A search uses the least-squares residual, and
an evidence the residual after correlated deviations: otherwise the inhomogeneity of parts would count twice, in the
deviations and in the correlation length. An observation beside Z keeps its stated uncertainty: one datum does not
determine its scatter, and it has no part in the scale of the recordings. Estimates are those of least squares with
these deviations; evidences and intervals count correlated points as fewer (`workbench.fitting.noise`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from workbench.campaign.state import DeviceState
from workbench.fitting.noise import Noise

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Relative change of a noise scale, or of the root of a correlation length, below which weights have converged.
STEADY = 0.1


@dataclass(frozen=True, eq=False)
class Weighting:
    """The weights of the points of some states: the noise of each."""

    states: tuple[DeviceState, ...]
    noises: tuple[Noise, ...]

    @classmethod
    def stated(cls, states: Sequence[DeviceState]) -> Weighting:
        """The weights of the stated noise alone."""
        return cls(tuple(states), tuple(Noise(state.noise) for state in states))

    @classmethod
    def left(cls, states: Sequence[DeviceState], log_ratio: Sequence[Complex]) -> Weighting:
        """The likeliest weights for some residuals. These are ln(Z_model / Z_measured) (n,) of every recording."""
        stated = cls.stated(states)
        pairs = list(zip(stated.noises, log_ratio, strict=True))
        recordings = [state.observation is None for state in states]
        squares = [noise.chi_square(log) / (2.0 * log.size)
                   for (noise, log), scatters in zip(pairs, recordings, strict=True) if scatters]
        pooled = float(np.mean(squares)) if squares else 1.0
        return cls(stated.states, tuple(noise.scaled_to(log, pooled=pooled) if scatters else noise
                                        for (noise, log), scatters in zip(pairs, recordings, strict=True)))

    def deviations(self, level: float = 0.0) -> list[Real]:
        """Relative standard deviation (n,) of every recording's points. `level` is a further deviation."""
        return [noise.deviations(level) for noise in self.noises]

    def variances(self, level: float = 0.0) -> Real:
        """Variances (m,) of the data over those of the stated noise."""
        return np.concatenate([np.tile((noise.deviations(level) / noise.shape) ** 2, 2) for noise in self.noises])

    @cached_property
    def counts(self) -> Real:
        """Neighbouring data (m,) that carry the information of one."""
        return np.repeat([noise.correlation for noise in self.noises], [2 * noise.shape.size for noise in self.noises])

    def chi_square(self, log_ratio: Sequence[Complex]) -> float:
        """The sum of squares of ln(Z_model / Z_measured) (n,) over the deviations."""
        return sum(noise.chi_square(log) for noise, log in zip(self.noises, log_ratio, strict=True))

    def log_likelihood(self, log_ratio: Sequence[Complex]) -> float:
        """The log likelihood of residuals (n,) by recording, up to a constant."""
        return sum(noise.log_likelihood(log) for noise, log in zip(self.noises, log_ratio, strict=True))

    def is_near(self, other: Weighting) -> bool:
        """Whether estimates with either weights are those with the other."""
        return all(abs(np.log(one.scale / two.scale)) < STEADY
                   and 0.5 * abs(np.log(one.correlation / two.correlation)) < STEADY
                   for one, two in zip(self.noises, other.noises, strict=True))

    def joined(self, other: Weighting) -> Weighting:
        """The weights of these states and then of others."""
        return Weighting(self.states + other.states, self.noises + other.noises)
