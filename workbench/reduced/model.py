"""The reduced model: the affine operators projected on a real basis of full solutions.

The basis is real (real and imaginary parts of the states), so the projected A_q stay real and symmetric and the
reduced model is again affine in the same coefficients. A model is a value: what enriches it makes a new one.
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
    """A reduced model with what it takes to judge and to enrich it.

    ``basis`` (size, r) as in `workbench.reduced.basis`; ``sizes`` (r - 1,) how much of each of its directions the
    states have that it was made for, in the root of energy over charge; ``test`` (size, PROJECTIONS) the vectors that
    residuals are projected on and ``sketch`` (forms, PROJECTIONS, r) the projections of A basis; ``energy``
    (size - 1, size - 1) the matrix R; ``solves`` full solves spent, ``residual`` the largest scaled residual of them.
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
        """Reduced states at every frequency; see :meth:`error` for how far to trust them."""
        return solve_reduced(self.operators, frequencies, values)

    def error(self, solution: Solution) -> Real:
        """Estimated relative error (n,) of the impedance of a reduced solution of this model, any parameter values.

        Rounding, some 1e-12, is not in it.
        """
        return sketched_error(self.operators, self.sketch, solution)

    def worst(self, frequencies: Real, values: Values) -> tuple[Solution, float, int]:
        """The reduced solution, its largest estimated error, and the index of the frequency of that."""
        solution = self.solve(frequencies, values)
        estimate = self.error(solution)
        index = int(np.argmax(estimate))
        return solution, float(estimate[index]), index

    def states(self, frequencies: Real, values: Values) -> Complex:
        """Reduced states (r, n) over the roots of their charges."""
        found = self.solve(frequencies, values)
        return np.asarray(found.states / np.sqrt(np.abs(found.charge)))

    def expand(self, solution: Solution) -> Complex:
        """The states (size, n) of the full model that a reduced solution stands for."""
        return self.basis @ solution.states

    def counted(self, *residuals: float) -> ReducedModel:
        """The model with a full solve more for each of the scaled residuals that they left."""
        return replace(self, solves=self.solves + len(residuals), residual=max((self.residual, *residuals)))

    def joined(self, candidates: Iterable[tuple[NDArray[np.inexact], float]]) -> ReducedModel:
        """The model that also spans vectors (size, n) of the full one, electrode included, over roots of charges.

        Of each of the `candidates`, one after the other, those directions are taken that it has more of outside the
        basis than the number beside it, in the root of the energy. The basis goes on as it is: what this model says at
        any parameters the new one says at least as well.
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
        """A model on the lift of this one and on `vectors` alone, truncated as in :meth:`joined`."""
        lift = self.basis[:, -1:]
        matrices, sketch = self.operators.matrices[:, -1:, -1:], self.sketch[:, :, -1:]
        bare = replace(self, operators=replace(self.operators, matrices=matrices), basis=lift, sizes=np.zeros(0),
                       sketch=sketch)
        return bare.joined([(vectors, smallest)])

    def truncated(self, states: Complex, tolerance: float) -> ReducedModel:
        """The model on what reduced `states` (r, n) over roots of charges need of its basis for that error of Z."""
        coordinates = np.column_stack([states[:-1].real, states[:-1].imag])
        return self.restricted(*truncated_coordinates(coordinates, np.eye(len(coordinates)), smallest_part(tolerance)))

    def coarser(self, tolerance: float) -> ReducedModel:
        """The model on those directions of its basis that an error of Z of `tolerance` needs, by its sizes."""
        kept = np.flatnonzero(self.sizes > smallest_part(tolerance))
        return self.restricted(np.eye(self.sizes.size)[:, kept], self.sizes[kept])

    def restricted(self, directions: Real, sizes: Real) -> ReducedModel:
        """The model on the lift and on `directions` (r - 1, k) in coordinates of its basis, with their sizes (k,)."""
        part = np.zeros((directions.shape[0] + 1, directions.shape[1] + 1))
        part[:-1, :-1], part[-1, -1] = directions, 1.0
        matrices = part.T @ self.operators.matrices @ part
        return replace(self, operators=replace(self.operators, matrices=matrices), basis=self.basis @ part,
                       sizes=sizes, sketch=self.sketch @ part)

    def of(self, operators: FullOperators) -> ReducedModel:
        """The model of other integrals of the same unknowns; forms that it does not have yet are projected."""
        known = {form: index for index, form in enumerate(self.full.distinct_forms)
                 if operators.has_form_of(self.full, form)}
        first = np.unique(operators.forms, return_index=True)[1]
        there = np.array([known.get(form, -1) for form in operators.distinct_forms])
        new, rank = np.flatnonzero(there < 0), self.basis.shape[1]
        matrices, sketch = np.empty((first.size, rank, rank)), np.empty((first.size, self.test.shape[1], rank))
        matrices[there >= 0], sketch[there >= 0] = (each[there[there >= 0]]
                                                    for each in (self.operators.matrices, self.sketch))
        if new.size:
            # In the order in which these forms are met.
            matrices[new], sketch[new] = projected_on(operators.of(first[new]), self.basis, self.test)
        inner = ReducedOperators(operators.integrals, operators.coefficients, matrices, operators.forms)
        return replace(self, full=operators, operators=inner, sketch=sketch)


def lifted(system: System, frequencies: Real, state: Complex) -> ReducedModel:
    """The smallest model: of the real part of one full `state` (size,), its lift, judged as suits `frequencies` (Hz).

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
    """Estimated relative error (n,) of the impedance of a `solution` of `operators`, see :class:`ReducedModel`."""
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
    """Matrices (forms, r, r) of the operators on `basis` (size, r), and sketch (forms, PROJECTIONS, r) on `test`.

    Of the basis of `known`, with which `basis` begins but for the lift at the end, they are taken over.
    """
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
