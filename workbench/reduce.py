"""The reduced model: the affine operators projected on full solutions at a few frequencies.

The basis is real (real and imaginary parts of the states), so the projected A_q stay real and symmetric and the
reduced model is again affine in the same coefficients. Because the charge is a quadratic form of the state, its error
is second order in the residual,

    Q - Q_r = -e^T A e = -r^T A^{-1} r ,

so that the squared norm of the residual, times a constant found where a full solve is at hand, estimates it. The norm
is taken of a few random projections of the residual, which cost next to nothing for any parameter values (Balabanov
and Nouy 2019, Adv. Comput. Math. 45, 2969: randomised linear algebra for model order reduction, part I).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from workbench.operators import FullOperators, ReducedOperators, coefficients
from workbench.physics.term import Values
from workbench.solve import Solution, System, one_thread, solve_reduced

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Random projections of the residual. Ten estimate a norm within a factor of two with a probability above 99 %.
PROJECTIONS = 12

#: Vectors taken from each factorisation (`System.krylov`): a back substitution costs a thirtieth of a factorisation.
DEPTH = 12

#: A new vector whose part outside the basis is smaller than this (relative) adds nothing but rounding.
DEPENDENT = 1e-9

#: The estimate is this many times the largest ratio of true error to squared residual seen.
SAFETY = 4.0


class NotEnriched(RuntimeError):
    """The reduced model did not reach its tolerance. Carries the estimate reached."""

    def __init__(self, estimate: float, tolerance: float, solves: int) -> None:
        super().__init__(f"the reduced model is at an estimated relative error of {estimate:.1e} after {solves} full "
                         f"solves, above the tolerance of {tolerance:.0e}; solve the full model, or narrow the band")
        self.estimate, self.tolerance, self.solves = estimate, tolerance, solves


@dataclass(frozen=True, eq=False)
class ReducedModel:
    """A reduced model with what it takes to judge and to improve it.

    ``basis`` (size, r), last column with unit electrode voltage and the others with none; ``sketch`` (integrals,
    PROJECTIONS, r) random projections of A_q basis; ``effectivity`` charge error per squared projected residual;
    ``solves`` full solves spent, ``residual`` the largest scaled residual among them.
    """

    full: FullOperators
    operators: ReducedOperators
    basis: Real
    sketch: Real
    weights: Real
    effectivity: float
    tolerance: float
    solves: int
    residual: float

    def solve(self, frequencies: Real, values: Values) -> Solution:
        """Reduced states at every frequency; see :meth:`error` for how far to trust them."""
        return solve_reduced(self.operators, frequencies, values)

    def error(self, solution: Solution) -> Real:
        """Estimated relative error (n,) of the impedance of a reduced solution of this model, any parameter values."""
        return self.effectivity * _squared_residual(self.sketch, solution) / np.abs(solution.charge)

    def expand(self, solution: Solution) -> Complex:
        """The states (size, n) of the full model that a reduced solution stands for."""
        return self.basis @ solution.states


def reduce(
    operators: FullOperators,
    frequencies: Real,
    values: Values,
    *,
    tolerance: float = 1e-5,
    start: ReducedModel | None = None,
    first: int = 4,
    limit: int = 40,
    progress: Callable[[float], None] | None = None,
) -> ReducedModel:
    """A reduced model whose impedance is within `tolerance` (relative) of the full one at all `frequencies`.

    Full solves are added where the estimate is largest, until the full solve at the worst frequency confirms the
    tolerance. With `start`, a model made for other parameter values is enriched for these.

    Raises:
        NotEnriched: `limit` full solves were not enough.
    """
    frequencies = np.asarray(frequencies, dtype=float)
    system = System(operators, values)

    def report(solves: int) -> None:
        # How many solves it takes is not known beforehand; most models are done after six or seven.
        if progress is not None:
            progress(1.0 - 0.7**solves)

    with one_thread():
        if start is None:
            low, high = float(frequencies.min()), float(frequencies.max())
            nodes = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(np.pi * (np.arange(first) + 0.5) / first)
            weights = np.sqrt(np.abs(system.matrix(float(nodes[first // 2])).diagonal()))
            states, largest = system.krylov(float(nodes[0]), DEPTH)
            basis = _extended(None, states, weights)
            for k, f in enumerate(nodes[1:], start=1):
                report(k)
                states, residual = system.krylov(float(f), DEPTH)
                basis, largest = _extended(basis, states, weights), max(largest, residual)
            model = _project(operators, basis, weights, tolerance, first, largest)
        else:
            model = replace(start, tolerance=tolerance)
        while True:
            solution = model.solve(frequencies, values)
            spread = _squared_residual(model.sketch, solution) / np.abs(solution.charge)
            worst = int(np.argmax(spread))
            report(model.solves)
            states, residual = system.krylov(float(frequencies[worst]), DEPTH)
            exact = _charge(operators, states[:, 0], float(frequencies[worst]), values)
            error = abs(solution.charge[worst] / exact - 1.0)
            effectivity = max(model.effectivity, SAFETY * error / spread[worst]) if error > 1e-12 else model.effectivity
            solves, largest = model.solves + 1, max(model.residual, residual)
            if error <= tolerance and effectivity * spread[worst] <= SAFETY * tolerance:
                return replace(model, effectivity=effectivity, solves=solves, residual=largest)
            if solves >= limit:
                raise NotEnriched(error, tolerance, solves)
            basis = _extended(model.basis, states, model.weights)
            model = _project(operators, basis, model.weights, tolerance, solves, largest)
            model = replace(model, effectivity=effectivity)


def _charge(operators: FullOperators, state: Complex, frequency: float, values: Values) -> complex:
    omega = np.array([2.0 * np.pi * frequency])
    forms = operators.quadratic(state[:, None], state[:, None])
    return -complex(np.sum(coefficients(operators.integrals, omega, values) * forms))


def _squared_residual(sketch: Real, solution: Solution) -> Real:
    """Mean square (n,) of the random projections of the full residual of a reduced solution."""
    applied = np.tensordot(sketch, solution.states, axes=(2, 0))  # (integrals, projections, n)
    projected = np.einsum("nq,qkn->kn", solution.coefficients, applied, optimize=True)
    return np.mean(np.abs(projected) ** 2, axis=0)


def _extended(basis: Real | None, states: Complex, weights: Real) -> Real:
    """`basis` with the real and imaginary parts of `states` added, orthonormal in the norm of `weights`."""
    if basis is None:
        lift = states[:, 0].real.copy()
        columns = np.zeros((states.shape[0], 0))
    else:
        lift, columns = basis[:, -1].copy(), weights[:, None] * basis[:, :-1]
    parts = np.column_stack([states[:, 0].real - lift, states[:, 0].imag, states[:, 1:].real, states[:, 1:].imag])
    added = weights[:, None] * parts
    size = np.linalg.norm(added, axis=0)
    added = added[:, size > 0.0] / size[size > 0.0]
    for _ in range(2):
        added = added - columns @ (columns.T @ added)
    added, triangle, _ = scipy.linalg.qr(added, mode="economic", pivoting=True)
    added = added[:, np.abs(np.diag(triangle)) > DEPENDENT]
    return np.column_stack([np.column_stack([columns, added]) / weights[:, None], lift])


def _project(
    operators: FullOperators, basis: Real, weights: Real, tolerance: float, solves: int, residual: float
) -> ReducedModel:
    test = np.random.default_rng(0).standard_normal((basis.shape[0], PROJECTIONS)) / weights[:, None]
    test[-1] = 0.0  # the row of the electrode is not an equation
    sketch = operators.project(basis, test)
    return ReducedModel(operators, operators.reduced(basis), basis, sketch, weights, 0.0, tolerance,
                        solves, residual)
