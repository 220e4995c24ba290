"""The sparsity pattern of an assembled model, and its real matrices."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from workbench.physics.term import MeasureFactor, Part

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Matrices larger than one in so many parts of a model's are not copied. Doubled, a model takes less memory, and a set
#: of values more time.
MUCH = 4

#: Two parts of operators in order, and the further factor of the measure.
Kind = tuple[Part, Part, MeasureFactor | None]


@dataclass(frozen=True, eq=False)
class Pattern:
    """A symmetric sparsity pattern (size, size): its upper triangle by columns. ``rows`` (upper,) are the rows of its
    entries; columns begin at ``starts`` (size + 1,). ``keys`` (upper,) are column * size + row, ascending."""

    keys: NDArray[np.int64]
    rows: NDArray[np.int32]
    starts: NDArray[np.int32]

    @classmethod
    def of(cls, rows: NDArray[np.int64], columns: NDArray[np.int64], size: int) -> Pattern:
        """The pattern of entries (k,) of either triangle; negative indices are ignored."""
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

    def position(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Indices in the upper triangle of entries (k,) of either triangle."""
        wanted = np.maximum(rows, columns).astype(np.int64) * self.size + np.minimum(rows, columns)
        return np.searchsorted(self.keys, wanted)

    def triangle(self, upper: NDArray[np.inexact], size: int | None = None) -> sparse.csc_array:
        """The upper triangle with these entries (upper,), without a copy. With `size` it is that of the first
        unknowns."""
        size = self.size if size is None else size
        count = self.starts[size]
        return sparse.csc_array((upper[:count], self.rows[:count], self.starts[: size + 1]), shape=(size, size))


def diagonal(triangle: sparse.csc_array) -> NDArray[np.inexact]:
    """The diagonal (n,) of an upper triangle with sorted indices. Each diagonal entry is the last one of its column."""
    last = triangle.indptr[1:] - 1
    return np.where(triangle.indices[last] == np.arange(last.size), triangle.data[last], 0.0)


def both_triangles(triangle: sparse.csc_array) -> sparse.csr_array:
    """The symmetric matrix with this upper triangle, whose indices are sorted."""
    last = triangle.indptr[1:] - 1
    below = triangle.data.copy()
    below[last[triangle.indices[last] == np.arange(last.size)]] = 0.0
    return triangle.tocsr() + sparse.csr_array((below, triangle.indices, triangle.indptr), shape=triangle.shape)


@dataclass(frozen=True, eq=False)
class Entries:
    """The entries of a symmetric pattern where some matrices are nonzero.

    ``positions`` (k,) are their indices in its upper triangle, ``rows`` (k,) their rows; columns begin at ``starts``
    (size + 1,). ``kinds`` (k, kinds) are the matrices, None if they are a large part of the model.
    """

    positions: NDArray[np.int64]
    rows: NDArray[np.int32]
    starts: NDArray[np.int32]
    kinds: sparse.csr_array | None

    @classmethod
    def of(cls, pattern: Pattern, kinds: sparse.csc_array, *, kept: bool) -> Entries:
        """The entries of `kinds` (upper, kinds), copied if `kept`."""
        is_used = np.zeros(pattern.keys.size, dtype=bool)
        is_used[kinds.indices] = True
        positions = np.flatnonzero(is_used)
        number, shape = np.cumsum(is_used, dtype=np.int32) - 1, (positions.size, kinds.shape[1])
        own = sparse.csc_array((kinds.data, number[kinds.indices], kinds.indptr), shape=shape).tocsr() if kept else None
        return cls(positions, pattern.rows[positions], np.searchsorted(positions, pattern.starts).astype(np.int32), own)

    @cached_property
    def _mirror(self) -> sparse.csr_array:
        """Both triangles, with the index of each entry from one."""
        number = np.arange(1, self.rows.size + 1, dtype=np.int32)
        return both_triangles(sparse.csc_array((number, self.rows, self.starts), shape=(self.starts.size - 1,) * 2))

    def whole(self, values: Real) -> sparse.csr_array:
        """The symmetric matrix with these values (k,), by rows, which is faster."""
        found = self._mirror
        return sparse.csr_array((values[found.data - 1], found.indices, found.indptr), shape=found.shape)


@dataclass(frozen=True, eq=False)
class Symmetric:
    """A real symmetric matrix (size, size). ``values`` (k,) are those of some ``entries`` of a pattern."""

    entries: Entries
    values: Real

    @cached_property
    def whole(self) -> sparse.csr_array:
        """Both triangles."""
        return self.entries.whole(self.values)


@dataclass(frozen=True, eq=False)
class SplitMatrix:
    """A complex symmetric matrix (size, size) in two real parts. A zero part is None."""

    real: Symmetric | None
    imaginary: Symmetric | None

    @property
    def parts(self) -> list[tuple[complex, Symmetric]]:
        """The nonzero parts, each with a factor 1 or i."""
        return [(turn, part) for turn, part in ((1.0, self.real), (1j, self.imaginary)) if part is not None]

    def times(self, columns: NDArray[np.inexact]) -> Complex:
        """The product with real or complex `columns` (size, k) or (size,)."""
        return np.asarray(sum((turn * real_product(part.whole, columns) for turn, part in self.parts),
                              np.zeros(columns.shape, dtype=complex)))

    def add_to(self, real: Real, imaginary: Real, factor: complex) -> None:
        """Add the matrix times a factor to upper entries (upper,)."""
        for turn, part in self.parts:
            scale = turn * factor
            for into, number in ((real, scale.real), (imaginary, scale.imag)):
                if number != 0.0:
                    into[part.entries.positions] += number * part.values


@dataclass(frozen=True, eq=False)
class Stack:
    """The real matrices whose weighted sums are all matrices of a model.

    There is one for each pair of parts and each measure. ``entries`` (upper, kinds) are those of the upper triangle of
    ``pattern``; ``mixing`` (kinds, integrals) is the weight of each kind in each integral. ``known`` caches the entries
    of some kinds.
    """

    pattern: Pattern
    entries: sparse.csc_array
    mixing: sparse.csr_array
    known: dict[tuple[int, ...], Entries] = field(default_factory=dict)

    def split(self, constants: Complex) -> SplitMatrix:
        """The matrix sum_q constants_q A_q, for `constants` (integrals,)."""
        return SplitMatrix(*(self._part(self.mixing @ each) for each in (constants.real, constants.imag)))

    def summed(self, constants: Complex) -> Complex:
        """Entries (upper,) of the matrix sum_q constants_q A_q, for `constants` (integrals,)."""
        found = np.empty(self.pattern.keys.size, dtype=complex)
        found.real, found.imag = (self.entries @ (self.mixing @ each) for each in (constants.real, constants.imag))
        return found

    def _part(self, weights: Real) -> Symmetric | None:
        acting = np.flatnonzero(weights)
        if not acting.size:
            return None
        key = tuple(acting.tolist())
        if key not in self.known:
            kinds = self.entries[:, acting]
            self.known[key] = Entries.of(self.pattern, kinds, kept=MUCH * kinds.nnz < self.entries.nnz)
        entries = self.known[key]
        if entries.kinds is not None:
            return Symmetric(entries, entries.kinds @ weights[acting])
        return Symmetric(entries, (self.entries @ weights)[entries.positions])


def real_product(matrix: sparse.sparray, columns: NDArray[np.inexact]) -> Any:
    """The product of a real sparse matrix (m, n) and columns. The real or complex columns are (n, k) or (n,). scipy
    would copy the matrix to complex first."""
    if not np.iscomplexobj(columns):
        return np.asarray(matrix @ columns)
    parts = np.ascontiguousarray(columns, dtype=complex).view(np.float64).reshape(len(columns), -1)
    return np.ascontiguousarray(matrix @ parts).view(np.complex128).reshape(-1, *columns.shape[1:])
