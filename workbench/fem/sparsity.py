"""The sparsity pattern of an assembled model, and the real matrices on it whose sum is the model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

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
class Pattern:
    """A symmetric sparsity pattern (size, size), given by its upper triangle, column by column.

    ``rows`` (upper,) are those of the entries of the upper triangle; the columns begin at ``starts`` (size + 1,).
    ``keys`` (upper,) are column * size + row, ascending.
    """

    keys: NDArray[np.int64]
    rows: NDArray[np.int32]
    starts: NDArray[np.int32]

    @classmethod
    def of(cls, rows: NDArray[np.int64], columns: NDArray[np.int64], size: int) -> Pattern:
        """The pattern of entries (k,) of either triangle; a negative index stands for none."""
        kept = (rows >= 0) & (columns >= 0) & (rows <= columns)
        once = sparse.coo_array((np.ones(int(kept.sum()), dtype=np.int8), (rows[kept], columns[kept])),
                                shape=(size, size)).tocsc()
        once.sort_indices()
        column = np.repeat(np.arange(size, dtype=np.int64), np.diff(once.indptr))
        return cls(column * size + once.indices, once.indices, once.indptr)

    @property
    def size(self) -> int:
        return self.starts.size - 1

    @cached_property
    def columns(self) -> NDArray[np.int32]:
        """The column of every entry (upper,)."""
        return np.repeat(np.arange(self.size, dtype=np.int32), np.diff(self.starts))

    @cached_property
    def _both(self) -> tuple[sparse.csc_matrix, NDArray[np.int32]]:
        number, off = np.arange(1, self.keys.size + 1, dtype=np.int32), self.rows != self.columns
        both = sparse.coo_matrix((np.concatenate([number, number[off]]),
                                  (np.concatenate([self.rows, self.columns[off]]),
                                   np.concatenate([self.columns, self.rows[off]]))), shape=(self.size,) * 2).tocsc()
        both.sort_indices()
        mirror = both.data - 1
        both.data = np.ones(mirror.size, dtype=np.float32)
        return both, mirror

    @property
    def matrix(self) -> sparse.csc_matrix:
        """Both triangles with all ones and sorted indices."""
        return self._both[0]

    @property
    def mirror(self) -> NDArray[np.int32]:
        """The index in the upper triangle of each entry of :attr:`matrix`."""
        return self._both[1]

    def position(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Indices in the upper triangle of entries (k,) of either triangle."""
        wanted = np.maximum(rows, columns).astype(np.int64) * self.size + np.minimum(rows, columns)
        return np.searchsorted(self.keys, wanted)

    def whole(self, upper: NDArray[np.inexact]) -> sparse.csr_array:
        """The symmetric matrix with these entries (upper,). By rows it is the same as by columns, and products are
        faster by rows."""
        whole = self.matrix
        return sparse.csr_array((upper[self.mirror], whole.indices, whole.indptr), shape=whole.shape)

    def nonzero(self, upper: Real) -> sparse.csr_array | None:
        """The symmetric matrix of the entries (upper,) that are not zero; None if all are."""
        kept = np.flatnonzero((upper != 0.0)[self.mirror])
        starts = np.searchsorted(kept, self.matrix.indptr).astype(np.int32)
        return sparse.csr_array((upper[self.mirror[kept]], self.matrix.indices[kept], starts),
                                shape=self.matrix.shape) if kept.size else None


@dataclass(frozen=True, eq=False)
class Stack:
    """The real matrices that every matrix of a model is a sum of, one for each pair of parts and each measure.

    ``entries`` (upper, kinds) of the upper triangle of a pattern; ``mixing`` (kinds, integrals) is the weight of each
    kind in each integral.
    """

    entries: sparse.csc_array
    mixing: sparse.csr_array

    def summed(self, constants: Complex) -> Complex:
        """Entries (upper, k) of the matrices sum_q constants_qk A_q, for `constants` (integrals, k)."""
        weights = self.mixing @ constants
        acting = np.flatnonzero(weights.any(axis=1))
        return real_product(self.entries[:, acting], weights[acting])


@dataclass(frozen=True, eq=False)
class SplitMatrix:
    """A complex symmetric matrix (size, size) as its real and its imaginary part; None is a part that is zero."""

    real: sparse.csr_array | None
    imaginary: sparse.csr_array | None

    @classmethod
    def of(cls, pattern: Pattern, upper: Complex) -> SplitMatrix:
        """The matrix with these entries (upper,) in the upper triangle of a pattern."""
        return cls(pattern.nonzero(upper.real), pattern.nonzero(upper.imag))

    def times(self, columns: NDArray[np.inexact]) -> Complex:
        """The product with real or complex `columns` (size, k)."""
        found = np.zeros(columns.shape, dtype=complex)
        if self.real is not None:
            found += real_product(self.real, columns)
        if self.imaginary is not None:
            found += 1j * real_product(self.imaginary, columns)
        return found


def real_product(matrix: sparse.sparray, columns: NDArray[np.inexact]) -> Any:
    """The product (m, k) of a real sparse matrix (m, n) and real or complex columns (n, k).

    scipy would make a complex copy of the matrix first.
    """
    if not np.iscomplexobj(columns):
        return np.asarray(matrix @ columns)
    parts = np.ascontiguousarray(columns, dtype=complex).view(np.float64)
    return np.ascontiguousarray(matrix @ parts).view(np.complex128)


@dataclass(frozen=True, eq=False)
class FreeUnknowns:
    """The unknowns of a solve at given voltage: all but the last.

    ``pattern`` is theirs, ``entries`` the index in the upper triangle of the whole pattern of each of its entries,
    ``factorisation`` the method prepared for the pattern.
    """

    pattern: sparse.csc_matrix
    entries: NDArray[np.int32]
    factorisation: Factorisation
