"""The bases that figures are computed on: one for the states a chip is driven in, one to find these.

A spectrum needs all that resonates in its band; figures need the states about one resonance, wherever in the ranges
that is. These lie in a far smaller space: on the reference chip, six lengths within 5 %, 150 vectors in place of 334.
Where the deepest resonance is, a rough spectrum tells, on 80 vectors. Both are parts of the basis of the range model,
found by the proper orthogonal decomposition, in the norm of the energy, of states at points spread over the ranges.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from workbench.design.cavity import Cavity
from workbench.energy_norm import estimated_error
from workbench.forms import combined
from workbench.linearised import FullSystem, Linearised, ReducedSystem
from workbench.parameter_names import ParameterName, placed
from workbench.physics.term import Values
from workbench.ranges import RangeModel, compacted, keys
from workbench.reduced_operators import ReducedOperators
from workbench.reduction import ReducedModel, smallest
from workbench.solve import Solution, one_thread

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Points of the ranges that states are taken at, for each parameter and in all, and points that are checked by full
#: solves.
TAKEN, LEAST, CHECKED = 5, 16, 3
#: Relative error of |Z| that is left to the rough spectrum: two resonances whose depths differ less may be confused.
ROUGH = 0.03
#: Points of the rough spectrum for the half-power width of the narrowest resonance met.
ACROSS = 3
#: A basis that is not as good as asked for keeps directions smaller by this.
FINER = 0.5
#: The states' first-order change by a parameter is taken over this part of its range: from there on other points count.
REACH = 0.25


@dataclass(frozen=True, eq=False)
class Bases:
    """Reduced operators of the states a chip is driven in, ``operating``, and of the rough spectrum, ``sweeping`` at
    ``frequency`` (n,) Hz.

    ``sketch`` is what errors are estimated with; ``rows`` (n, m, r) the pressure at the cavity's nodes, None without a
    cavity. ``error`` and ``pressure_error`` are the largest relative errors of Z and of the pressure's root mean square
    at f0 that full solves have found.
    """

    operating: ReducedOperators
    sketch: Real
    rows: Real | None
    sweeping: ReducedOperators
    frequency: Real
    error: float
    pressure_error: float

    def pressure(self, states: Complex) -> Complex:
        """At the cavity's nodes (n, m, k), of reduced states (r, k)."""
        assert self.rows is not None
        return np.asarray(self.rows @ states.real + 1j * (self.rows @ states.imag))

    def estimate(self, solution: Solution) -> float:
        """Estimated relative error of Z of a state at one frequency (`workbench.reduction.ReducedModel.error`)."""
        sketches = combined(self.operating.by_form(np.array([c for _, c in solution.groups])), self.sketch)
        residual = sum(h * (sketch @ solution.states) for (h, _), sketch in zip(solution.groups, sketches, strict=True))
        return float(estimated_error(np.asarray(residual), solution.charge)[0])


@dataclass(frozen=True, eq=False)
class _Sample:
    """States of the range model at one point: ``values`` there, the spectrum's ``sweep``, the states ``driven`` at f0
    (or at the frequency that is stated) with their derivatives first, then at the half-power frequencies, and the
    ``width`` (Hz) between these."""

    values: Values
    sweep: Solution
    driven: tuple[Linearised, ...]
    width: float


def bases_of(made: RangeModel, stated: float | None, cavity: Cavity | None, *, by_place: bool, seed: int) -> Bases:
    """The bases for a range model; of the states at the frequency `stated` (Hz), or at f0.

    With `by_place` the operators know where losses are.
    """
    low, high = (np.array(ends) for ends in zip(*made.ranges.values(), strict=True))
    count = max(LEAST, TAKEN * low.size)
    shares = qmc.Sobol(low.size, seed=seed).random(count + CHECKED)
    points = [dict(zip(made.ranges, map(float, x), strict=True)) for x in low + (high - low) * shares]
    moves = {name: REACH * (high - low)[k] for k, name in enumerate(made.ranges)}
    with one_thread(), ThreadPoolExecutor(max_workers=2) as pool:
        samples = list(pool.map(lambda x: _sample(made, placed(made.problem.values, x), stated, moves), points))
    taken, kept_back = samples[:count], samples[count:]
    inner = made.reduced.basis[:-1, :-1]
    root = np.linalg.cholesky(inner.T @ (made.reduced.energy @ inner)).T
    model = (compacted(made.reduced, keys(made.ranges), made.problem.values, by_place=True) if by_place
             else made.compact)
    rough = _decomposed([_size(each.sweep) * each.sweep.states[:-1] for each in taken], root)
    near = _decomposed([_states(each, made, moves) for each in taken], root)
    sweeping = _sweeping(made.compact, rough, root, kept_back)
    operating = model.within(_part(near, smallest(made.tolerance), root))
    rows = None if cavity is None else cavity.pressure_rows(operating.basis)
    width = min(each.width for each in samples)
    band = made.frequency[-1] - made.frequency[0]
    grid = np.linspace(made.frequency[0], made.frequency[-1], int(np.ceil(ACROSS * band / width)) + 1)
    error, pressure_error = _checked(made, operating, rows, cavity, kept_back)
    return Bases(operating.operators, operating.sketch, rows, sweeping, grid, error, pressure_error)


def _size(solution: Solution) -> Real:
    """One over the root of the charge (n,), in units of which the energy of a state is counted."""
    return 1.0 / np.sqrt(np.abs(solution.charge))


def _sample(made: RangeModel, values: Values, stated: float | None, moves: dict[str, float]) -> _Sample:
    system = ReducedSystem(made.compact.operators, values)
    sweep = system.sweep(made.frequency)
    lowest = int(np.argmin(np.abs(sweep.impedance)))
    below, above = _width(made.frequency, np.abs(sweep.impedance), lowest)
    driven = float(made.frequency[lowest]) if stated is None else stated
    names = tuple(ParameterName.parse(name).key for name in moves)
    others = (below, above) if stated is None else (driven - 0.5 * (above - below), driven + 0.5 * (above - below))
    return _Sample(values, sweep, (system.linearised(driven, names), *(system.linearised(f) for f in others)),
                   above - below)


def _width(frequency: Real, magnitude: Real, lowest: int) -> tuple[float, float]:
    """About the half-power frequencies of the resonance at an index; the ends of the band where they lie outside."""
    high = np.flatnonzero(magnitude >= np.sqrt(2.0) * magnitude[lowest])
    below, above = high[high < lowest], high[high > lowest]
    return (float(frequency[below[-1] if below.size else 0]),
            float(frequency[above[0] if above.size else frequency.size - 1]))


def _states(sample: _Sample, made: RangeModel, moves: dict[str, float]) -> Complex:
    """Columns of states about the resonance and of what moves of parameters and of the frequency change them by."""
    columns = []
    for each in sample.driven:
        size = 1.0 / np.sqrt(abs(each.charge))
        columns += [size * each.state[:-1, None], 0.5 * sample.width * size * each.by_frequency[:-1, None]]
        if each.names:
            columns.append(size * each.by_parameter[:-1] * np.array(list(moves.values())))
    return np.concatenate(columns, axis=1)


def _decomposed(columns: Sequence[Complex], root: Real) -> tuple[Real, Real]:
    """Directions (r - 1, r - 1) and sizes (r - 1,) of columns (r - 1, n), largest last, in the norm that `root` is of.
    """
    whole = root @ np.concatenate(columns, axis=1)
    squares, directions = np.linalg.eigh((whole @ whole.conj().T).real)
    return directions, np.sqrt(np.maximum(squares, 0.0))


def _part(decomposed: tuple[Real, Real], least: float, root: Real) -> Real:
    """The part (r, k) of a basis that holds all directions larger than `least`, its lift last."""
    directions, sizes = decomposed
    kept = directions[:, sizes > least]
    result = np.zeros((len(directions) + 1, kept.shape[1] + 1))
    result[:-1, :-1], result[-1, -1] = np.linalg.solve(root, kept), 1.0
    return result


def _sweeping(
    model: ReducedModel, rough: tuple[Real, Real], root: Real, samples: Sequence[_Sample]
) -> ReducedOperators:
    """The operators of the rough spectrum: as few vectors as leave :data:`ROUGH` of |Z| at points not used for them."""
    least = float(rough[1][-1])
    while True:
        found = model.within(_part(rough, least, root)).operators
        off = max(float(np.abs(np.log(np.abs(
            ReducedSystem(found, each.values).sweep(each.sweep.frequency).charge / each.sweep.charge))).max())
            for each in samples)
        if off <= ROUGH or least < rough[1][0]:
            return found
        least *= FINER


def _checked(
    made: RangeModel, operating: ReducedModel, rows: Real | None, cavity: Cavity | None, samples: Sequence[_Sample]
) -> tuple[float, float]:
    """The largest relative errors of Z and of the pressure (root mean square) against full solves near f0."""
    errors, pressures = [0.0], [0.0]
    for each in samples:
        frequency = each.driven[0].frequency
        full = FullSystem(made.reduced.full, each.values).linearised(frequency)
        small = ReducedSystem(operating.operators, each.values).linearised(frequency)
        errors.append(abs(small.charge / full.charge - 1.0))
        if rows is not None and cavity is not None:
            exact = np.append(full.state, 0.0)[cavity.rows]
            pressures.append(float(np.linalg.norm(rows @ small.state - exact) / np.linalg.norm(exact)))
    return max(errors), max(pressures)
