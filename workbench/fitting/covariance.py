"""Correlated deviations of data: the covariance 1 + sum_k c_k c_k^T of data in units of their noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Real = NDArray[np.float64]

#: Directions in which they deviate by less than this share of the noise are left out.
NEGLIGIBLE = 0.03


@dataclass(frozen=True, eq=False)
class Covariance:
    """1 + V diag(v) V^T: orthonormal ``directions`` V (m, q) and ``variances`` v (q,) beyond the noise's one."""

    directions: Real
    variances: Real

    @classmethod
    def of(cls, columns: Real) -> Covariance:
        """1 + C C^T of `columns` C (m, k), each what one independent unit deviation does to the data."""
        directions, sizes = principal(columns, NEGLIGIBLE)
        return cls(directions, sizes**2)

    def scaled(self, factor: float) -> Covariance:
        """A copy with all deviations beyond the noise times a factor."""
        return Covariance(self.directions, factor**2 * self.variances)

    def whitened(self, columns: Real) -> Real:
        """Data (m,) or (m, k) times the root of the inverse: of unit covariance."""
        less = 1.0 - 1.0 / np.sqrt(1.0 + self.variances)
        along = self.directions.T @ columns
        return np.asarray(columns - self.directions @ (less * along.T).T)

    def expected(self, data: Real) -> Real:
        """The deviations beyond the noise (m,) that are expected where the `data` (m,) are so."""
        along = self.directions.T @ data
        return np.asarray(self.directions @ (self.variances / (1.0 + self.variances) * along))

    @property
    def log_determinant(self) -> float:
        return float(np.log1p(self.variances).sum())


def principal(columns: Real, least: float) -> tuple[Real, Real]:
    """Left singular vectors (m, q) and values (q,) of `columns` (m, k), of those above `least`."""
    narrow = columns.shape[1] <= columns.shape[0]
    gram = columns.T @ columns if narrow else columns @ columns.T
    squares, vectors = scipy.linalg.eigh(gram)
    kept = squares > least**2
    sizes = np.sqrt(squares[kept])
    return (columns @ (vectors[:, kept] / sizes) if narrow else vectors[:, kept]), sizes
