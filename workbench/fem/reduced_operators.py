"""The affine system on a small basis: dense symmetric matrices with the interface of the full system."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from workbench.fem.coefficients import Coefficients
from workbench.fem.dense import Span
from workbench.fem.forms import bilinear, real_times
from workbench.physics.term import Integral
from workbench.results.brief import Brief

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False, repr=False)
class ReducedOperators(Brief):
    """The affine model on a small basis: ``matrices`` (distinct forms, r, r), dense and real.

    ``forms`` (integrals,) is the index of every integral's matrix.
    """

    integrals: tuple[Integral, ...]
    coefficients: Coefficients
    matrices: Real
    forms: NDArray[np.int64]

    @property
    def size(self) -> int:
        return int(self.matrices.shape[1])

    def by_form(self, constants: Complex) -> Complex:
        """Constants (k, integrals) summed by distinct form: (k, forms)."""
        return np.asarray(constants @ self._gather)

    def quadratic(self, left: Complex, right: Complex) -> Complex:
        return bilinear(self.matrices, left, right)[:, self.forms]

    def combined_forms(self, states: Complex, constants: Complex, span: Span | None = None) -> Complex:
        summed = self.by_form(constants)
        parts = np.concatenate([summed.real, summed.imag])
        acting = np.flatnonzero(parts.any(axis=1))
        # Most rows are the derivative by one parameter, which appears in few forms.
        upper = np.asarray(sparse.csr_array(parts[acting]) @ self._upper)
        forms = np.zeros((states.shape[1], len(parts)), dtype=complex)
        matrices = self._whole(upper)
        if span is None:
            forms[:, acting] = bilinear(matrices, states, states)
        else:
            inner = span.basis.T @ real_times(matrices, span.basis)
            forms[:, acting] = bilinear(inner, span.coordinates, span.coordinates)
        return forms[:, : len(constants)] + 1j * forms[:, len(constants) :]

    def combinations(self, constants: Complex) -> Complex:
        """Matrices sum_q constants_kq A_q for `constants` (k, integrals): (k, r, r)."""
        summed = self.by_form(constants)
        acting = summed.any(axis=0)
        upper = self._upper if acting.all() else self._upper[acting]
        parts = np.concatenate([summed.real, summed.imag])[:, acting] @ upper
        return np.asarray(self._whole(parts[: len(constants)] + 1j * parts[len(constants) :]))

    def _whole(self, upper: NDArray[np.inexact]) -> NDArray[np.inexact]:
        """Symmetric matrices (k, r, r) from upper triangles (k, r(r+1)/2) in the convention of :attr:`_upper`."""
        return np.take(upper * self._halved, self._mirror, axis=1)

    @cached_property
    def _mirror(self) -> NDArray[np.int64]:
        """Index in the upper triangle of each entry (r, r) of a symmetric matrix."""
        row, column = np.triu_indices(self.size)
        found = np.empty((self.size, self.size), dtype=np.int64)
        found[row, column] = found[column, row] = np.arange(row.size)
        return found

    @cached_property
    def _halved(self) -> Real:
        """Factors (r(r+1)/2,) that turn entries of :attr:`_upper` into entries of the matrix."""
        row, column = np.triu_indices(self.size)
        return np.where(row == column, 1.0, 0.5)

    @cached_property
    def _gather(self) -> sparse.csr_array:
        count = self.forms.size
        return sparse.csr_array((np.ones(count), (np.arange(count), self.forms)), shape=(count, len(self.matrices)))

    @cached_property
    def _upper(self) -> Real:
        """The upper triangles of the matrices, row by row, off-diagonal entries doubled: (forms, r(r+1)/2)."""
        rank = self.size
        row, column = np.triu_indices(rank)
        return np.ascontiguousarray(self.matrices[:, row, column] * np.where(row == column, 1.0, 2.0))
