"""The statistics of a figure over the uncertainty of a chip: a quantile or the mean over a fixed scenario sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ScenarioSample:
    """Offsets (SI, by parameter name) of every scenario from the chip as stated, common to all chips that are compared.

    A number that no chip varies has the sample's own values. ``quantile`` on the bad side (0.05: the figure that 95 %
    of the chips reach), None for the mean. ``covariance`` (k, k) of the numbers, SI, in the order of :attr:`names`.
    """

    samples: tuple[Mapping[str, float], ...]
    quantile: float | None
    covariance: Real = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def names(self) -> tuple[str, ...]:
        """The numbers that scenarios move."""
        return tuple(self.samples[0])

    def deviation(self, slopes: Mapping[str, float]) -> float:
        """Standard deviation of a quantity with these `slopes` (by SI unit, by name) over the uncertain numbers."""
        along = np.array([slopes.get(name, 0.0) for name in self.names])
        return float(np.sqrt(along @ self.covariance @ along))

    def weights(self, losses: Real) -> Real:
        """Weights (k,) of the scenarios with which their sum is the quantile, or the mean, of `losses` (k,).

        The quantile is the one of numpy, between the two scenarios beside it; where scenarios change places its
        derivative jumps, and it does not.
        """
        count = len(losses)
        if self.quantile is None:
            return np.full(count, 1.0 / count)
        position = (1.0 - self.quantile) * (count - 1)
        below, share = int(position), position - int(position)
        order = np.argsort(losses, kind="stable")
        found = np.zeros(count)
        found[order[below]] += 1.0 - share
        if share > 0.0:
            found[order[below + 1]] += share
        return found
