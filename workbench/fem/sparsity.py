"""The sparsity pattern of an assembled model, and the real matrices on it whose sums are the model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from workbench.fem.factorisation import Factorisation
from workbench.physics.term import MeasureFactor, Part

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Two parts of operators in order, and the further factor of the measure.
Kind = tuple[Part, Part, MeasureFactor | None]


@dataclass(frozen=True, eq=False)
class MatrixBlock:
    """Real matrices of some kinds of pairs of parts at one place.

    ``entries`` (kinds, m) at the ``positions`` (m,) of the upper triangle; ``mixing`` (kinds, integrals) is the weight
    of each kind in each integral.
    """

    mixing: Real
    positions: NDArray[np.int64]
    entries: Real


@dataclass(frozen=True, eq=False)
class Pattern:
    """A symmetric sparsity pattern; ``mirror`` maps each stored entry to its index in the upper triangle.

    ``rows`` (upper,) are those of the entries of the upper triangle, column by column; the columns begin at ``starts``
    (size + 1,). ``keys`` (upper,) are column * size + row, ascending.
    """

    matrix: sparse.csc_matrix
    mirror: NDArray[np.int64]
    keys: NDArray[np.int64]
    rows: NDArray[np.int32]
    starts: NDArray[np.int32]

    @classmethod
    def of(cls, rows: NDArray[np.int64], columns: NDArray[np.int64], size: int) -> Pattern:
        kept = (rows >= 0) & (columns >= 0) & (rows <= columns)
        once = sparse.coo_matrix((np.ones(int(kept.sum()), dtype=np.float32), (rows[kept], columns[kept])),
                                 shape=(size, size)).tocsc()
        once.sort_indices()
        row, column = once.indices.astype(np.int64), np.repeat(np.arange(size, dtype=np.int64), np.diff(once.indptr))
        keys = column * size + row
        number = np.arange(1, keys.size + 1)
        off = row != column
        both = sparse.coo_matrix((np.concatenate([number, number[off]]),
                                  (np.concatenate([row, column[off]]), np.concatenate([column, row[off]]))),
                                 shape=(size, size)).tocsc()
        both.sort_indices()
        mirror = both.data - 1
        both.data = np.ones(mirror.size, dtype=np.float32)
        return cls(both, mirror, keys, once.indices, once.indptr)

    def position(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Indices in the upper triangle of entries (k,) of either triangle."""
        wanted = np.maximum(rows, columns).astype(np.int64) * self.matrix.shape[0] + np.minimum(rows, columns)
        return np.searchsorted(self.keys, wanted)


@dataclass(frozen=True, eq=False)
class Symmetric:
    """A symmetric matrix (size, size), given by its entries (upper,) in the upper triangle of a pattern."""

    pattern: Pattern
    upper: Complex

    @property
    def stored(self) -> Complex:
        """Its entries in the order of `Pattern.matrix`."""
        return self.upper[self.pattern.mirror]

    def nonzero(self) -> tuple[NDArray[np.int64], Complex]:
        """The indices of its entries that are not zero, in the order of `Pattern.matrix`, and these."""
        where = np.flatnonzero((self.upper != 0.0)[self.pattern.mirror])
        return where, self.upper[self.pattern.mirror[where]]

    def times(self, state: NDArray[np.inexact]) -> Complex:
        """Its product with a state (size,)."""
        triangle, diagonal = self._triangle
        return np.asarray(triangle @ state + triangle.T @ state - diagonal * state)

    @cached_property
    def _triangle(self) -> tuple[sparse.csc_array, Complex]:
        triangle = sparse.csc_array((self.upper, self.pattern.rows, self.pattern.starts),
                                    shape=self.pattern.matrix.shape)
        return triangle, triangle.diagonal()


@dataclass(frozen=True, eq=False)
class FreeUnknowns:
    """The unknowns of a solve at given voltage: all but the last.

    ``pattern`` is theirs, ``entries`` the indices of its entries in the pattern of the whole system, ``factorisation``
    the method prepared for the pattern.
    """

    pattern: sparse.csc_matrix
    entries: NDArray[np.int64]
    factorisation: Factorisation
