"""The affine system on a small basis, with dense symmetric matrices."""

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
    """The affine model on a small basis. ``matrices`` (distinct forms, r, r) are dense and real; ``forms`` (integrals,)
    is the index of every integral's matrix."""

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
        forms = np.zeros((states.shape[1], len(parts)), dtype=complex)
        # Most rows are the derivative by one parameter, which occurs in few forms.
        matrices = self._summed(sparse.csr_array(parts[acting]))
        if span is None:
            forms[:, acting] = bilinear(matrices, states, states)
        else:
            inner = span.basis.T @ real_times(matrices, span.basis)
            forms[:, acting] = bilinear(inner, span.coordinates, span.coordinates)
        return forms[:, : len(constants)] + 1j * forms[:, len(constants) :]

    def combinations(self, constants: Complex) -> Complex:
        """Matrices sum_q constants_kq A_q for `constants` (k, integrals): (k, r, r)."""
        summed = self.by_form(constants)
        real, imaginary = (self._summed(sparse.csr_array(part)) for part in (summed.real, summed.imag))
        return np.asarray(real + 1j * imaginary)

    def _summed(self, weights: sparse.csr_array) -> Real:
        """Sums (k, r, r) of the matrices with `weights` (k, forms)."""
        flat = self.matrices.reshape(len(self.matrices), self.size**2)
        return np.asarray(weights @ flat).reshape(-1, self.size, self.size)

    @cached_property
    def _gather(self) -> sparse.csr_array:
        count = self.forms.size
        return sparse.csr_array((np.ones(count), (np.arange(count), self.forms)), shape=(count, len(self.matrices)))
