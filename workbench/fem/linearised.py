"""A state at one frequency and its exact derivatives, full or reduced.

With A x = 0 on the free unknowns and the electrode fixed at one volt, A dx = -(dA) x for any change of A, and
    Q = -x^T A x,   dQ = -x^T (dA) x,   d2Q by a and b = -(2 x_a^T (A_b) x + x^T (A_ab) x).

One factorisation serves all of them. Coefficients depend on frequency through few scalar functions; central differences
of sixth order differentiate these with an error below rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from workbench.fem.coefficients import Groups
from workbench.fem.operators import FullOperators, Operators
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.solve import Solution, System, one_thread, solve_groups
from workbench.physics.term import Values

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Relative step, places and weights of the difference quotients of a scalar function of frequency. For a power of
#: frequency the relative error is 1e-13 in the first derivative and 1e-11 in the second.
DIFFERENCE_STEP = 3e-3
DIFFERENCE_PLACES = np.arange(-3.0, 4.0)
FIRST_WEIGHTS = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0
SECOND_WEIGHTS = np.array([2.0, -27.0, 270.0, -490.0, 270.0, -27.0, 2.0]) / 180.0

#: Largest scaled residual of an accepted derivative of a state. Its right side is spread over the parts; on a graded
#: mesh the scaled solution is up to a million times as large, so rounding is up to 1e-10 of the right side.
DERIVATIVE_LIMIT = 1e-8


@dataclass(frozen=True, eq=False)
class Twice:
    """Second derivatives of a state. ``by_frequency`` (size,) is per Hz^2; ``by_both`` (size, k) is by frequency and
    complex parameters."""

    by_frequency: Complex
    by_both: Complex


@dataclass(frozen=True, eq=False)
class LinearisedState:
    """A state at one frequency (Hz) and unit electrode voltage, with derivatives.

    The time factor is e^{-i w t}. ``by_frequency`` (size,) is per Hz, ``by_parameter`` (size, k) by the complex
    parameters ``names``. Derivatives of the charge (C) are by frequency, twice by frequency, by parameters (k,) and by
    both (k,). ``twice`` has the second derivatives of the state, if requested.
    """

    solution: Solution
    names: tuple[str, ...]
    by_frequency: Complex
    by_parameter: Complex
    charge_by_frequency: complex
    charge_twice_by_frequency: complex
    charge_by_parameter: Complex
    charge_by_both: Complex
    twice: Twice | None = None

    @property
    def frequency(self) -> float:
        """Frequency of the state in Hz."""
        return float(self.solution.frequency[0])

    @property
    def state(self) -> Complex:
        return self.solution.states[:, 0]

    @property
    def charge(self) -> complex:
        return complex(self.solution.charge[0])


@dataclass(frozen=True, eq=False)
class _Forces:
    """Products (dA) x for derivatives of A. By frequency once and twice they are (size,), by parameters and by both
    (size, k)."""

    by_frequency: Complex
    twice: Complex
    by_parameter: Complex
    by_both: Complex


def _linearised(
    solution: Solution, names: tuple[str, ...], forces: _Forces, moved: Complex, twice: Twice | None
) -> LinearisedState:
    """The state with its derivatives. `moved` (size, 1 + k) are the derivatives by frequency and by the parameters."""
    state, by_frequency = solution.states[:, 0], moved[:, 0]
    return LinearisedState(
        solution, names, by_frequency, moved[:, 1:],
        charge_by_frequency=-complex(state @ forces.by_frequency),
        charge_twice_by_frequency=-complex(2.0 * by_frequency @ forces.by_frequency + state @ forces.twice),
        charge_by_parameter=-(state @ forces.by_parameter),
        charge_by_both=-(2.0 * by_frequency @ forces.by_parameter + state @ forces.by_both),
        twice=twice,
    )


def _twice_forces(forces: _Forces, changing: Complex, of_slope: Complex) -> Complex:
    """Forces (size, 1 + k) of the second derivatives of a state. A x_ff = -(2 A_f x_f + A_ff x), A x_fa = -(A_f x_a +
    A_a x_f + A_fa x), with `changing` A_f (x_f, x_a) and `of_slope` A_a x_f."""
    return np.column_stack([2.0 * changing[:, 0] + forces.twice, changing[:, 1:] + of_slope + forces.by_both])


def difference_frequencies(frequency: float) -> Real:
    """The frequencies (Hz) of the central differences at `frequency`."""
    return frequency * (1.0 + DIFFERENCE_STEP * DIFFERENCE_PLACES)


def by_frequency(function: Complex, frequency: float) -> tuple[Complex, Complex, Complex]:
    """Value, first and second derivative (per Hz) of a function. The function is given (..., 7) at the frequencies of
    :func:`difference_frequencies`."""
    step = DIFFERENCE_STEP * frequency
    return function[..., 3], function @ FIRST_WEIGHTS / step, function @ SECOND_WEIGHTS / step**2


def slope_columns(
    operators: Operators, frequency: float, values: Values, names: tuple[str, ...]
) -> tuple[Complex, Complex]:
    """Derivatives of the coefficients g_q (integrals, k), and per Hz."""
    omega = 2.0 * np.pi * difference_frequencies(frequency)
    coefficients = operators.coefficients
    slopes, change = np.zeros((2, coefficients.count, len(names)), dtype=complex)
    for column, by_shape in enumerate(coefficients.slopes(values, names)):
        for shape, constants in by_shape.items():
            value, first, _ = by_frequency(shape(omega, values), frequency)
            slopes[:, column] += value * constants
            change[:, column] += first * constants
    return slopes, change


class ReducedSystem:
    """A reduced model with parameter values."""

    def __init__(self, operators: ReducedOperators, values: Values) -> None:
        self.operators, self.values = operators, values

    def groups(self, frequencies: Real) -> Groups:
        return self.operators.coefficients.groups(2.0 * np.pi * frequencies, self.values)

    @cached_property
    def _matrices(self) -> Complex:
        """The matrices of equal frequency dependence (groups, r, r)."""
        return self.operators.combinations(np.array([constants for _, constants in self.groups(np.ones(1))]))

    def sweep(self, frequencies: Real) -> Solution:
        """Solve at some frequencies (n,) in Hz."""
        return solve_groups(self.operators, frequencies, self.groups(frequencies))

    def linearised(self, frequency: float, names: tuple[str, ...] = (), *, twice: bool = False) -> LinearisedState:
        """The state at one frequency with its derivatives. `twice` adds second derivatives. Derivatives by parameters
        of no coefficient are zero."""
        groups = self.groups(difference_frequencies(frequency))
        value, first, second = by_frequency(np.stack([h for h, _ in groups]), frequency)
        matrix = np.tensordot(value, self._matrices, axes=1)
        free = slice(None, -1)
        factor = scipy.linalg.lu_factor(matrix[free, free], check_finite=False)
        state = np.append(scipy.linalg.lu_solve(factor, -matrix[free, -1], check_finite=False), 1.0)
        images = self._matrices @ state
        by_parameter, by_both = self._parameter_forces(frequency, state, names)
        forces = _Forces(first @ images, second @ images, by_parameter, by_both)
        right = np.column_stack([forces.by_frequency, forces.by_parameter])
        moved = np.zeros((state.size, right.shape[1]), dtype=complex)
        moved[free] = -scipy.linalg.lu_solve(factor, right[free], check_finite=False)
        further = None
        if twice:
            of_slope, _ = self._parameter_forces(frequency, moved[:, 0], names)
            changing = np.tensordot(first, self._matrices, axes=1) @ moved
            right = _twice_forces(forces, changing, of_slope)
            found = np.zeros((state.size, right.shape[1]), dtype=complex)
            found[free] = -scipy.linalg.lu_solve(factor, right[free], check_finite=False)
            further = Twice(found[:, 0], found[:, 1:])
        remainder = (matrix @ state)[free]
        at = self.groups(np.array([frequency]))
        solution = Solution(self.operators, np.array([frequency]), at, state[:, None],
                            np.array([-state @ (matrix @ state)]),
                            np.array([np.linalg.norm(remainder) / np.linalg.norm(matrix[free, -1])]))
        return _linearised(solution, names, forces, moved, further)

    def _parameter_forces(self, frequency: float, state: Complex, names: tuple[str, ...]) -> tuple[Complex, Complex]:
        if not names:
            return np.zeros((state.size, 0), dtype=complex), np.zeros((state.size, 0), dtype=complex)
        slopes, change = (self.operators.by_form(each.T) for each in
                          slope_columns(self.operators, frequency, self.values, names))
        acting = np.flatnonzero(slopes.any(axis=0) | change.any(axis=0))
        images = self.operators.matrices[acting] @ np.column_stack([state.real, state.imag])
        states = images[..., 0] + 1j * images[..., 1]
        return (slopes[:, acting] @ states).T, (change[:, acting] @ states).T


class FullSystem:
    """The full model with parameter values."""

    def __init__(self, operators: FullOperators, values: Values) -> None:
        self.operators, self.values = operators, values
        self._system = System(operators, values)

    def linearised(self, frequency: float, names: tuple[str, ...] = (), *, twice: bool = False) -> LinearisedState:
        """The state with its derivatives, by one factorisation.

        Each name takes one back substitution, or two with second derivatives (`twice`).

        Raises:
            NotConverged: the solve did not reach its tolerance.
        """
        operators, free = self.operators, slice(None, -1)
        _, first, second = by_frequency(self._system.factors(difference_frequencies(frequency)), frequency)
        with one_thread():
            electrode, factor = self._system.factored(frequency)
            x, residual = factor.solve(-electrode[free])
            state = np.append(x, 1.0)
            images = np.stack([group.times(state) for group in self._system.groups])
            slopes, change = slope_columns(operators, frequency, self.values, names)
            by_parameter, by_both = np.split(operators.images(state, np.hstack([slopes, change])), 2, axis=1)
            forces = _Forces(first @ images, second @ images, by_parameter, by_both)

            def solved(right: Complex) -> Complex:
                found = np.zeros((state.size, right.shape[1]), dtype=complex)
                for column in range(right.shape[1]):
                    if right[free, column].any():
                        found[free, column] = -factor.solve(right[free, column], DERIVATIVE_LIMIT)[0]
                return found

            moved, further = solved(np.column_stack([forces.by_frequency, forces.by_parameter])), None
            if twice:
                changing = sum(weight * group.times(moved)
                               for weight, group in zip(first, self._system.groups, strict=True))
                of_slope = operators.images(moved[:, 0], slopes)
                found = solved(_twice_forces(forces, np.asarray(changing), of_slope))
                further = Twice(found[:, 0], found[:, 1:])
        groups = operators.coefficients.groups(np.array([2.0 * np.pi * frequency]), self.values)
        charge = np.array([self._system.charge(frequency, state)])
        solution = Solution(operators, np.array([frequency]), groups, state[:, None], charge, np.array([residual]))
        return _linearised(solution, names, forces, moved, further)
