"""The bases that figures are computed on: one for the states a chip is driven in, one to find these.

A spectrum needs all that resonates in its band; figures need the states about one resonance, wherever in the ranges
that is. These lie in a far smaller space (on the reference chip, six lengths within 5 %, some 120 vectors in place of
334), and where the deepest resonance is, a rough spectrum tells. So full solves are spent where chips are driven: a
rough range model says where that is at points spread over the ranges, the full model is solved and linearised there,
and what the states and their derivatives span is kept (proper orthogonal decomposition in the norm of the energy).
Further full solves check it; where they find it wanting they join it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from geometry.plausible import as_text
from workbench.design.cavity import Cavity
from workbench.fem.coefficients import Coefficients
from workbench.fem.linearised import FullSystem, LinearisedState, ReducedSystem
from workbench.fem.operators import FullOperators
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.solve import Solution, one_thread
from workbench.files.errors import InputError
from workbench.jobs.progress import Progress, no_progress
from workbench.model.numbers import ParameterName, placed
from workbench.model.problem import Problem
from workbench.physics.term import Values
from workbench.reduced.basis import smallest_part
from workbench.reduced.compact import compacted, gathered
from workbench.reduced.model import ReducedModel, sketched_error
from workbench.reduced.ranges import RangeModel, Ranges, range_keys

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Points of the ranges that the full model is first solved at, for each parameter and at least, and points by which the
#: basis is checked in a round.
TAKEN, LEAST, CHECKED = 3, 10, 4
#: Most rounds of further points.
ROUNDS = 8
#: Points of the ranges that the rough spectrum is made for, for each parameter and at least.
SWEPT, FEWEST = 5, 16
#: Relative error of |Z| that is left to the rough spectrum: two resonances whose depths differ less may be confused.
ROUGH = 0.03
#: Points of the rough spectrum for the half-power width of the narrowest resonance met.
ACROSS = 3
#: A basis that is not as good as asked for keeps directions smaller by this.
FINER = 0.5
#: The states' first-order change by a parameter is taken over this part of its range: from there on other points count.
REACH = 0.25
#: The pressure is first order in what a basis leaves out, Z is second order: so many times the tolerance of Z is left.
OF_PRESSURE = 5.0


class NotConfirmed(RuntimeError):
    """A design model that full solves did not confirm. Carries the relative errors of Z and of the pressure."""

    def __init__(self, error: float, pressure_error: float, tolerance: float) -> None:
        super().__init__(f"after {ROUNDS} rounds of full solves the design model is off by {100.0 * error:.2g} % in Z "
                         f"and {100.0 * pressure_error:.2g} % in the pressure, above the tolerance of "
                         f"{100.0 * tolerance:.2g} % and {100.0 * OF_PRESSURE * tolerance:.2g} %; narrow the ranges")
        self.error, self.pressure_error, self.tolerance = error, pressure_error, tolerance

    def __reduce__(self) -> tuple[Any, ...]:
        return (NotConfirmed, (self.error, self.pressure_error, self.tolerance))


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

    def arrays(self) -> dict[str, Real]:
        """The arrays that full solves gave; :func:`stored_bases` makes the rest again from the problem."""
        found = {"operating": self.operating.matrices, "sketch": self.sketch, "sweeping": self.sweeping.matrices,
                 "frequency": self.frequency, "errors": np.array([self.error, self.pressure_error])}
        return found if self.rows is None else {**found, "rows": self.rows}

    def pressure(self, states: Complex) -> Complex:
        """At the cavity's nodes (n, m, k), of reduced states (r, k)."""
        assert self.rows is not None
        return np.asarray(self.rows @ states.real + 1j * (self.rows @ states.imag))

    def estimate(self, solution: Solution) -> float:
        """Estimated relative error of Z of a state at one frequency."""
        return float(sketched_error(self.operating, self.sketch, solution)[0])


def stored_bases(
    arrays: Mapping[str, Real], problem: Problem, operators: FullOperators, ranges: Ranges, *, by_place: bool,
) -> Bases:
    """The bases with these :meth:`Bases.arrays`, on the full `operators` of the problem they were made for.

    Raises:
        KeyError: an array is missing.
    """
    def reduced(name: str, by_place: bool) -> ReducedOperators:
        integrals, _ = gathered(operators.integrals, range_keys(ranges), problem.values, by_place=by_place)
        return ReducedOperators(integrals, Coefficients.of(integrals), arrays[name], np.arange(len(integrals)))

    error, pressure_error = map(float, arrays["errors"])
    return Bases(reduced("operating", by_place), arrays["sketch"], arrays.get("rows"), reduced("sweeping", False),
                 arrays["frequency"], error, pressure_error)


@dataclass(frozen=True, eq=False)
class _Sample:
    """The rough spectrum at one point: ``values`` there, its ``sweep``, the frequency it is ``driven`` at and the
    half-power ``width`` of its deepest resonance (Hz)."""

    values: Values
    sweep: Solution
    driven: float
    width: float


def bases_of(
    made: RangeModel, stated: float | None, places: Sequence[Cavity], *, tolerance: float, by_place: bool, seed: int,
    progress: Progress = no_progress,
) -> Bases:
    """The bases for what a range model is of, for states at the frequency `stated` (Hz), or at f0.

    Args:
        places: the cavity, if there is one that a figure is of.
        tolerance: relative error of Z at f0; the pressure's is :data:`OF_PRESSURE` times as much.
        by_place: whether the operators are to know where losses are.

    Raises:
        InputError: nothing resonates in the band.
        NotConfirmed: full solves find larger errors after all rounds.
    """
    names = tuple(ParameterName.parse(name).key for name in made.ranges)
    points = _Points(made, qmc.Sobol(len(names), seed=seed), stated)
    moves = np.array([REACH * (high - low) for low, high in made.ranges.values()])
    with one_thread(), ThreadPoolExecutor(max_workers=2) as pool:
        rough = points.drawn(max(FEWEST, SWEPT * len(names)) + CHECKED, pool)
        sweeping = _sweeping(made.compact, rough[CHECKED:], rough[:CHECKED])
        width = min(each.width for each in rough)
        first = rough[: max(LEAST, TAKEN * len(names))]
        columns = list(pool.map(lambda each: _columns(made, each, names, moves, width), first))
        for turn in range(ROUNDS):
            operating = made.reduced.spanning(np.concatenate(columns, axis=1), smallest_part(tolerance))
            checked = points.drawn(CHECKED, pool)
            fulls = list(pool.map(lambda each: FullSystem(made.reduced.full, each.values).linearised(each.driven),
                                  checked))
            error, pressure_error = _errors(operating, places, checked, fulls)
            progress("figures", (turn + 1.0) / ROUNDS)
            if error <= tolerance and pressure_error <= OF_PRESSURE * tolerance:
                break
            columns += pool.map(lambda each: _columns(made, each, names, moves, width), checked)
        else:
            raise NotConfirmed(error, pressure_error, tolerance)
    band = made.frequency[-1] - made.frequency[0]
    grid = np.linspace(made.frequency[0], made.frequency[-1], int(np.ceil(ACROSS * band / width)) + 1)
    small = compacted(operating, range_keys(made.ranges), made.problem.values, by_place=by_place)
    rows = places[0].pressure_rows(operating.basis) if places else None
    return Bases(small.operators, small.sketch, rows, sweeping, grid, error, pressure_error)


@dataclass(frozen=True, eq=False)
class _Points:
    """Points spread over the ranges of a model, drawn one after the other."""

    made: RangeModel
    sampler: qmc.Sobol
    stated: float | None

    def drawn(self, count: int, pool: ThreadPoolExecutor) -> list[_Sample]:
        low, high = (np.array(ends) for ends in zip(*self.made.ranges.values(), strict=True))
        shares = low + (high - low) * np.array([self.sampler.random(1)[0] for _ in range(count)])
        return list(pool.map(self._sample, shares))

    def _sample(self, point: Real) -> _Sample:
        numbers = dict(zip(self.made.ranges, map(float, point), strict=True))
        values = placed(self.made.problem.values, numbers)
        sweep = ReducedSystem(self.made.compact.operators, values).sweep(self.made.frequency)
        magnitude = np.abs(sweep.impedance)
        lowest = int(np.argmin(magnitude))
        driven = float(sweep.frequency[lowest]) if self.stated is None else self.stated
        return _Sample(values, sweep, driven, _width(sweep.frequency, magnitude, lowest))


def _width(frequency: Real, magnitude: Real, lowest: int) -> float:
    """About the half-power width (Hz) of the resonance at an index; to the ends of the band where it goes on."""
    high = np.flatnonzero(magnitude >= np.sqrt(2.0) * magnitude[lowest])
    below, above = high[high < lowest], high[high > lowest]
    return float(frequency[above[0] if above.size else -1] - frequency[below[-1] if below.size else 0])


def _columns(made: RangeModel, sample: _Sample, names: tuple[str, ...], moves: Real, width: float) -> Complex:
    """The full state (size, n) at a point and what moves of frequency and parameters change it by, over the root of
    the charge."""
    found = FullSystem(made.reduced.full, sample.values).linearised(sample.driven, names)
    moved = np.column_stack([width * found.by_frequency, found.by_parameter * moves])
    return np.column_stack([found.state, moved]) / np.sqrt(abs(found.charge))


def _sweeping(model: ReducedModel, taken: Sequence[_Sample], checked: Sequence[_Sample]) -> ReducedOperators:
    """The operators of the rough spectrum: as few vectors as leave :data:`ROUGH` of |Z| at points not used for them."""
    states = np.concatenate([each.sweep.states / np.sqrt(np.abs(each.sweep.charge)) for each in taken], axis=1)
    whole = model.truncated(states, 0.0)
    if not whole.sizes.size:
        low, high = (as_text(float(end), "frequency") for end in taken[0].sweep.frequency[[0, -1]])
        raise InputError("design model", "band", f"{low} to {high}", "a band in which the chip resonates")
    smallest = FINER * float(whole.sizes.max())
    while True:
        found = whole.coarser(smallest**2).operators
        off = max(float(np.abs(np.log(np.abs(
            ReducedSystem(found, each.values).sweep(each.sweep.frequency).charge / each.sweep.charge))).max())
            for each in checked)
        if off <= ROUGH or found.size == whole.operators.size:
            return found
        smallest *= FINER


def _errors(
    operating: ReducedModel, places: Sequence[Cavity], samples: Sequence[_Sample], fulls: Sequence[LinearisedState]
) -> tuple[float, float]:
    """The largest relative errors of Z and of the pressure (root mean square) against full states."""
    rows = [place.pressure_rows(operating.basis) for place in places]
    errors, pressures = [0.0], [0.0]
    for sample, full in zip(samples, fulls, strict=True):
        small = ReducedSystem(operating.operators, sample.values).linearised(full.frequency)
        errors.append(abs(small.charge / full.charge - 1.0))
        for place, row in zip(places, rows, strict=True):
            exact = np.append(full.state, 0.0)[place.rows]
            pressures.append(float(np.linalg.norm(row @ small.state - exact) / np.linalg.norm(exact)))
    return max(errors), max(pressures)
