"""Correlated deviations: data covariance 1 + sum_k c_k c_k^T, in noise units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Real = NDArray[np.float64]

#: Directions with deviations below this share of the noise are omitted.
NEGLIGIBLE = 0.03


@dataclass(frozen=True, eq=False)
class Covariance:
    """1 + V diag(v) V^T: ``directions`` V (m, q), ``variances`` v (q,)."""

    directions: Real
    variances: Real

    @classmethod
    def of(cls, columns: Real) -> Covariance:
        """1 + C C^T of `columns` C (m, k). Each is the data's change by one independent unit deviation."""
        directions, sizes = principal(columns, NEGLIGIBLE)
        return cls(directions, sizes**2)

    def scaled(self, factor: float) -> Covariance:
        """A copy with all deviations beyond the noise times a factor."""
        return Covariance(self.directions, factor**2 * self.variances)

    def whitened(self, columns: Real) -> Real:
        """Data (m,) or (m, k) scaled to unit covariance."""
        less = 1.0 - 1.0 / np.sqrt(1.0 + self.variances)
        along = self.directions.T @ columns
        return np.asarray(columns - self.directions @ (less * along.T).T)

    def expected(self, data: Real) -> Real:
        """The expected deviations beyond the noise (m,), given `data` (m,)."""
        along = self.directions.T @ data
        return np.asarray(self.directions @ (self.variances / (1.0 + self.variances) * along))

    @property
    def log_determinant(self) -> float:
        return float(np.log1p(self.variances).sum())


def prior_rows(deviations: Sequence[float | None], correlation: Real | None = None) -> Real:
    """A root R (p, p) of a normal prior's precision R^T R.

    Args:
        deviations: standard deviations (p,) of the parameters; None without a prior, for zero rows and columns.
        correlation: (p, p) of the parameters; None if they are independent.
    """
    known = [i for i, each in enumerate(deviations) if each is not None]
    rows = np.zeros((len(deviations), len(deviations)))
    size = np.array([deviations[i] for i in known], dtype=float)
    own = np.eye(len(known)) if correlation is None else correlation[np.ix_(known, known)]
    factor = np.linalg.cholesky(own)
    rows[np.ix_(known, known)] = scipy.linalg.solve_triangular(factor, np.diag(1.0 / size), lower=True)
    return rows


def covariance_root(covariance: Real) -> Real:
    """A root R (k, k) of a covariance R R^T. Eigenvalues below zero by rounding count as zero."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def principal(columns: Real, least: float) -> tuple[Real, Real]:
    """Left singular vectors (m, q) and values (q,) above `least`. They are those of `columns` (m, k)."""
    narrow = columns.shape[1] <= columns.shape[0]
    gram = columns.T @ columns if narrow else columns @ columns.T
    squares, vectors = scipy.linalg.eigh(gram)
    kept = squares > least**2
    sizes = np.sqrt(squares[kept])
    return (columns @ (vectors[:, kept] / sizes) if narrow else vectors[:, kept]), sizes
