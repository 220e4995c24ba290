"""The reduced model: affine operators on a real basis.

The basis is real (real and imaginary parts of the states), so the projected A_q stay real and symmetric and the reduced
model is affine in the same coefficients. A model is a value: enrichment returns a new one.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from workbench.fem.forms import combined_matrices
from workbench.fem.operators import FullOperators
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.solve import Solution, System, solve_reduced
from workbench.physics.term import Values
from workbench.reduced.basis import smallest_part, truncated, truncated_coordinates, without_lift
from workbench.reduced.estimate import energy_matrix, estimated_error, random_probes
from workbench.results.brief import Brief

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False, repr=False)
class ReducedModel(Brief):
    """A reduced model with the data of its error estimate and enrichment.

    ``basis`` (size, r) is as in `workbench.reduced.basis`; ``sizes`` (r - 1,) are the largest parts of the states along
    its directions, in the root of energy over charge; ``test`` (size, PROJECTIONS) are the vectors of the residuals'
    projections and ``sketch`` (forms, PROJECTIONS, r) the projections of A basis; ``energy`` (size - 1, size - 1) is
    the matrix R; ``solves`` counts full solves, ``residual`` is their largest scaled residual.
    """

    full: FullOperators
    operators: ReducedOperators
    basis: Real
    sizes: Real
    test: Real
    sketch: Real
    energy: sparse.csr_matrix
    solves: int
    residual: float

    def solve(self, frequencies: Real, values: Values) -> Solution:
        """Reduced states at every frequency; :meth:`error` estimates their error."""
        return solve_reduced(self.operators, frequencies, values)

    def error(self, solution: Solution) -> Real:
        """Estimated relative error (n,) of the impedance of a reduced solution. It holds at any parameter values.
        Rounding, about 1e-12, is not included."""
        return sketched_error(self.operators, self.sketch, solution)

    def worst(self, frequencies: Real, values: Values) -> tuple[Solution, float, int]:
        """The reduced solution, its largest estimated error, and the frequency's index."""
        solution = self.solve(frequencies, values)
        estimate = self.error(solution)
        index = int(np.argmax(estimate))
        return solution, float(estimate[index]), index

    def states(self, frequencies: Real, values: Values) -> Complex:
        """Reduced states (r, n) over the roots of their charges."""
        found = self.solve(frequencies, values)
        return np.asarray(found.states / np.sqrt(np.abs(found.charge)))

    def expand(self, solution: Solution) -> Complex:
        """The states (size, n) of the full model for a reduced solution."""
        return self.basis @ solution.states

    def counted(self, *residuals: float) -> ReducedModel:
        """The model with one more full solve for each scaled residual."""
        return replace(self, solves=self.solves + len(residuals), residual=max((self.residual, *residuals)))

    def joined(self, candidates: Iterable[tuple[NDArray[np.inexact], float]]) -> ReducedModel:
        """The model with a basis enriched by vectors (size, n). The vectors are over roots of charges.

        Each of the `candidates` adds its directions outside the basis that are larger than its threshold, in the root
        of the energy. The old basis is part of the new one, so the new model is at least as accurate.
        """
        basis, lift, sizes = self.basis[:-1, :-1], self.basis[:, -1:], self.sizes
        seen = self.energy @ basis
        for vectors, smallest in candidates:
            new, found = truncated(without_lift(vectors, lift[:, 0]), self.energy, smallest, basis, seen)
            basis, sizes = np.column_stack([basis, new]), np.append(sizes, found)
            seen = np.column_stack([seen, self.energy @ new])
        if sizes.size == self.sizes.size:
            return self
        whole = np.column_stack([np.vstack([basis, np.zeros((1, sizes.size))]), lift])
        matrices, sketch = projected_on(self.full, whole, self.test, self)
        return replace(self, operators=replace(self.operators, matrices=matrices), basis=whole, sizes=sizes,
                       sketch=sketch)

    def spanning(self, vectors: Complex, smallest: float) -> ReducedModel:
        """A model on this one's lift and on `vectors`. It is truncated as in :meth:`joined`."""
        lift = self.basis[:, -1:]
        matrices, sketch = self.operators.matrices[:, -1:, -1:], self.sketch[:, :, -1:]
        bare = replace(self, operators=replace(self.operators, matrices=matrices), basis=lift, sizes=np.zeros(0),
                       sketch=sketch)
        return bare.joined([(vectors, smallest)])

    def truncated(self, states: Complex, tolerance: float) -> ReducedModel:
        """The model on the part of its basis that reduced `states` need. The `states` (r, n) are over roots of charges;
        `tolerance` is the error of Z."""
        coordinates = np.column_stack([states[:-1].real, states[:-1].imag])
        return self.restricted(*truncated_coordinates(coordinates, np.eye(len(coordinates)), smallest_part(tolerance)))

    def coarser(self, tolerance: float) -> ReducedModel:
        """The model on the directions needed for `tolerance`. The tolerance is the error of Z."""
        kept = np.flatnonzero(self.sizes > smallest_part(tolerance))
        return self.restricted(np.eye(self.sizes.size)[:, kept], self.sizes[kept])

    def restricted(self, directions: Real, sizes: Real) -> ReducedModel:
        """The model on the lift and some `directions` of its basis. The directions are (r - 1, k). `sizes` (k,) are
        those of the directions."""
        part = np.zeros((directions.shape[0] + 1, directions.shape[1] + 1))
        part[:-1, :-1], part[-1, -1] = directions, 1.0
        matrices = part.T @ self.operators.matrices @ part
        return replace(self, operators=replace(self.operators, matrices=matrices), basis=self.basis @ part,
                       sizes=sizes, sketch=self.sketch @ part)

    def of(self, operators: FullOperators) -> ReducedModel:
        """The model for other integrals of the same unknowns. New forms are projected."""
        known = {form: index for index, form in enumerate(self.full.distinct_forms)
                 if operators.has_form_of(self.full, form)}
        first = np.unique(operators.forms, return_index=True)[1]
        there = np.array([known.get(form, -1) for form in operators.distinct_forms])
        new, rank = np.flatnonzero(there < 0), self.basis.shape[1]
        matrices, sketch = np.empty((first.size, rank, rank)), np.empty((first.size, self.test.shape[1], rank))
        matrices[there >= 0], sketch[there >= 0] = (each[there[there >= 0]]
                                                    for each in (self.operators.matrices, self.sketch))
        if new.size:
            # They are in the order of the integrals.
            matrices[new], sketch[new] = projected_on(operators.of(first[new]), self.basis, self.test)
        inner = ReducedOperators(operators.integrals, operators.coefficients, matrices, operators.forms)
        return replace(self, full=operators, operators=inner, sketch=sketch)


def lifted(system: System, frequencies: Real, state: Complex) -> ReducedModel:
    """The smallest model, whose basis is the lift.

    The lift is the real part of one full `state` (size,); the error estimate uses the median of `frequencies` (Hz).

    Raises:
        NotConverged: an unknown has no energy.
    """
    middle, full = float(np.median(frequencies)), system.operators
    energy = energy_matrix(system, middle)
    test, basis = random_probes(energy, middle), state.real[:, None].copy()
    matrices, sketch = projected_on(full, basis, test)
    inner = ReducedOperators(full.integrals, full.coefficients, matrices, full.forms)
    return ReducedModel(full, inner, basis, np.zeros(0), test, sketch, energy, 0, 0.0)


def sketched_error(operators: ReducedOperators, sketch: Real, solution: Solution) -> Real:
    """Estimated relative error (n,) of the impedance; see :class:`ReducedModel`."""
    constants = np.array([constants for _, constants in solution.groups])
    sketches = combined_matrices(operators.by_form(constants), sketch)
    if solution.span is not None:
        sketches, states = sketches @ solution.span.basis, solution.span.coordinates
    else:
        states = solution.states
    residual = sum(h * (each @ states) for (h, _), each in zip(solution.groups, sketches, strict=True))
    return estimated_error(np.asarray(residual), solution.charge)


def projected_on(
    operators: FullOperators, basis: Real, test: Real, known: ReducedModel | None = None
) -> tuple[Real, Real]:
    """Matrices (forms, r, r) on `basis` and sketch on `test`. The sketch is (forms, PROJECTIONS, r). `basis` is (size,
    r). Values for the basis of `known` are copied; `basis` begins with it, the lift apart."""
    rank = basis.shape[1]
    old = np.zeros(0, dtype=int) if known is None else np.append(np.arange(known.basis.shape[1] - 1), rank - 1)
    new = np.setdiff1d(np.arange(rank), old)
    images = operators.project(basis[:, new], np.column_stack([basis[:, old], test]))
    own, cross, seen = np.split(images, [new.size, rank], axis=1)
    matrices = np.zeros((len(images), rank, rank))
    sketch = np.zeros((len(images), test.shape[1], rank))
    if known is not None:
        matrices[:, old[:, None], old], sketch[:, :, old] = known.operators.matrices, known.sketch
    matrices[:, new[:, None], new], sketch[:, :, new] = own, seen
    matrices[:, old[:, None], new], matrices[:, new[:, None], old] = cross, cross.transpose(0, 2, 1)
    return matrices, sketch
