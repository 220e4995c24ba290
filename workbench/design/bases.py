"""Reduced bases for figures: one for driven states, one for finding resonances.

A spectrum needs every resonance of its band. Figures need only the states near one resonance, for all points of the
ranges. These span a far smaller space: on the reference chip, with six lengths within 5 %, some 120 vectors in place of
334. A rough spectrum is enough to locate the deepest resonance, so full solves are spent near it:

1. A rough range model locates the resonance at points spread over the ranges.
2. The full model is solved and linearised there.
3. The span of the states and their derivatives is the basis (proper orthogonal decomposition in the energy norm).
4. Further full solves check it. Those with too large an error are added to the basis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.acoustics.sound_energy import SoundEnergy, sound_energy
from workbench.design.cavity import Cavity
from workbench.design.resonance import HALF, Impedance, ResonantQuantity, Responding
from workbench.fem.coefficients import Coefficients
from workbench.fem.linearised import FullSystem, LinearisedState, ReducedSystem
from workbench.fem.operators import FullOperators
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.solve import Solution, one_thread
from workbench.files.errors import InputError
from workbench.files.quantities import frequency_text
from workbench.jobs.progress import Progress, no_progress
from workbench.model.numbers import ParameterName
from workbench.model.problem import Problem
from workbench.physics.term import Values
from workbench.reduced.basis import smallest_part
from workbench.reduced.compact import compacted, gathered
from workbench.reduced.model import ReducedModel, sketched_error
from workbench.reduced.ranges import RangeModel, Ranges, points_within, range_keys

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Points of the first full solves, per parameter and at least; and points that check the basis in each round.
TAKEN, LEAST, CHECKED = 3, 10, 4
#: Most rounds of further points.
ROUNDS = 8
#: Points at which the rough spectrum is made, per parameter and at least.
SWEPT, FEWEST = 5, 16
#: Relative error of |Z| of the rough spectrum: two resonances whose depths differ less may be confused.
ROUGH = 0.03
#: Part of the level below which a peak of the energy is too low to be the largest one: a tenth of its energy.
DEEP = 0.5 * float(np.log(10.0))
#: Points of the rough spectrum for the half-power width of the narrowest resonance met.
ACROSS = 3
#: Factor on the smallest direction that a basis keeps, for each attempt at a smaller error.
FINER = 0.5
#: Part of a parameter's range for the states' first-order change: beyond it, other points contribute.
REACH = 0.25
#: Tolerance of the pressure over that of Z: the pressure is first order in the error of the basis, Z second order.
OF_PRESSURE = 5.0


class NotConfirmed(RuntimeError):
    """Raised when full solves do not confirm a design model.

    It carries the relative errors of Z and of the pressure.
    """

    def __init__(self, error: float, pressure_error: float, tolerance: float) -> None:
        super().__init__(f"after {ROUNDS} rounds of full solves the design model is off by {100.0 * error:.2g} % in Z "
                         f"and {100.0 * pressure_error:.2g} % in the pressure, above the tolerance of "
                         f"{100.0 * tolerance:.2g} % and {100.0 * OF_PRESSURE * tolerance:.2g} %; narrow the ranges")
        self.error, self.pressure_error, self.tolerance = error, pressure_error, tolerance

    def __reduce__(self) -> tuple[Any, ...]:
        return (NotConfirmed, (self.error, self.pressure_error, self.tolerance))


@dataclass(frozen=True, eq=False)
class Bases:
    """Reduced operators of the driven states and of the rough spectrum.

    ``operating`` is for the driven states, ``sweeping`` for the rough spectrum at ``frequency`` (n,) Hz. ``sketch``
    serves to estimate errors. ``rows`` (n, m, r) give the pressure at the cavity's nodes, None without a cavity.
    ``sound`` and ``sweeping_sound`` are the energy in the cavity on either basis, None without a fluid. ``error`` and
    ``pressure_error`` are the largest relative errors of Z and of the pressure's root mean square that full solves
    found in driven states.
    """

    operating: ReducedOperators
    sketch: Real
    rows: Real | None
    sweeping: ReducedOperators
    frequency: Real
    error: float
    pressure_error: float
    sound: SoundEnergy | None = None
    sweeping_sound: SoundEnergy | None = None

    def arrays(self) -> dict[str, Real]:
        """The arrays that need full solves.

        :func:`stored_bases` restores the rest from the problem.
        """
        found = {"operating": self.operating.matrices, "sketch": self.sketch, "sweeping": self.sweeping.matrices,
                 "frequency": self.frequency, "errors": np.array([self.error, self.pressure_error])}
        sounds = {"sound": self.sound, "sweeping_sound": self.sweeping_sound}
        return {**found, **({} if self.rows is None else {"rows": self.rows}), **{
            name: each.operators.matrices for name, each in sounds.items() if each is not None
            and isinstance(each.operators, ReducedOperators)}}

    def pressure(self, states: Complex) -> Complex:
        """The nodal pressure (n, m, k) of reduced states (r, k)."""
        assert self.rows is not None
        return np.asarray(self.rows @ states.real + 1j * (self.rows @ states.imag))

    def estimate(self, solution: Solution) -> float:
        """The estimated relative error of Z of a state at one frequency."""
        return float(sketched_error(self.operating, self.sketch, solution)[0])


def stored_bases(
    arrays: Mapping[str, Real], problem: Problem, operators: FullOperators, ranges: Ranges, *, by_place: bool,
) -> Bases:
    """Restore bases from their :meth:`Bases.arrays`.

    `operators` are the full ones of the problem that the bases were made for.

    Raises:
        KeyError: an array is missing.
    """
    def reduced(name: str, by_place: bool) -> ReducedOperators:
        integrals, _ = gathered(operators.integrals, range_keys(ranges), problem.values, by_place=by_place)
        return ReducedOperators(integrals, Coefficients.of(integrals), arrays[name], np.arange(len(integrals)))

    error, pressure_error = map(float, arrays["errors"])
    small, sweeping = reduced("operating", by_place), reduced("sweeping", False)

    whole, moving = sound_energy(operators), range_keys(ranges)
    sounds = [None if whole is None else whole.stored(arrays[name], moving, problem.values)
              for name in ("sound", "sweeping_sound")]
    return Bases(small, arrays["sketch"], arrays.get("rows"), sweeping, arrays["frequency"], error, pressure_error,
                 *sounds)


@dataclass(frozen=True, eq=False)
class _Sample:
    """The rough spectrum at one point of the ranges.

    ``values`` are the parameters there, ``sweep`` is the spectrum and ``level`` each response over it. The chip is
    ``driven`` at these frequencies (Hz); ``width`` (Hz) is the smallest half-power width of its resonances.
    """

    values: Values
    sweep: Solution
    level: Mapping[ResonantQuantity, Real]
    driven: tuple[float, ...]
    width: float


def bases_of(
    made: RangeModel, responses: Sequence[ResonantQuantity], stated: float | None, cavity: Cavity | None, *,
    tolerance: float, by_place: bool, seed: int, progress: Progress = no_progress,
) -> Bases:
    """Make the bases for the problem of a range model.

    Args:
        responses: those at whose resonances states are needed.
        stated: a further frequency (Hz) of states.
        cavity: that of the figures, None if there is none.
        tolerance: relative error of Z in driven states; the pressure's is :data:`OF_PRESSURE` times as much.
        by_place: whether the operators keep losses apart by place.

    Raises:
        InputError: nothing resonates in the band.
        NotConfirmed: full solves find larger errors after all rounds.
    """
    names, moving = tuple(ParameterName.parse(name).key for name in made.ranges), range_keys(made.ranges)
    full, own = made.reduced.full, made.problem.values
    whole = sound_energy(full)

    def sound_of(model: ReducedModel) -> SoundEnergy | None:
        return None if whole is None else whole.on(model.basis, moving, own)

    points, energy = points_within(made.ranges, own, seed), sound_of(made.compact)
    moves = REACH * np.array([high - low for low, high in made.ranges.values()])

    def drawn(count: int) -> list[_Sample]:
        return list(pool.map(lambda values: _sampled(made, values, responses, stated, energy), islice(points, count)))

    def solved(samples: Sequence[_Sample]) -> list[tuple[_Sample, LinearisedState]]:
        every = [(each, at) for each in samples for at in each.driven]
        return list(pool.map(lambda one: (one[0], FullSystem(full, one[0].values).linearised(one[1], names)), every))

    with one_thread(), ThreadPoolExecutor(max_workers=2) as pool:
        rough = drawn(max(FEWEST, SWEPT * len(names)) + CHECKED)
        sweeping = _sweeping(made.compact, rough[CHECKED:], rough[:CHECKED], sound_of)
        width = min(each.width for each in rough)
        known = solved(rough[: max(LEAST, TAKEN * len(names))])
        for turn in range(ROUNDS):
            columns = np.concatenate([_columns(each, moves, width) for _, each in known], axis=1)
            operating = made.reduced.spanning(columns, smallest_part(tolerance))
            checked = solved(drawn(CHECKED))
            error, pressure_error = _errors(operating, cavity, whole, checked)
            progress("figures", (turn + 1.0) / ROUNDS)
            if error <= tolerance and pressure_error <= OF_PRESSURE * tolerance:
                break
            known = [*known, *checked]
        else:
            raise NotConfirmed(error, pressure_error, tolerance)
    band = made.frequency[-1] - made.frequency[0]
    grid = np.linspace(made.frequency[0], made.frequency[-1], int(np.ceil(ACROSS * band / width)) + 1)
    small = compacted(operating, moving, own, by_place=by_place)
    rows = None if cavity is None else cavity.pressure_rows(operating.basis)
    return Bases(small.operators, small.sketch, rows, sweeping.operators, grid, error, pressure_error,
                 sound_of(operating), sound_of(sweeping))


def _sampled(
    made: RangeModel, values: Values, responses: Sequence[ResonantQuantity], stated: float | None,
    sound: SoundEnergy | None,
) -> _Sample:
    """The rough spectrum at some `values` within the ranges."""
    system = ReducedSystem(made.compact.operators, values)
    sweep, model = system.sweep(made.frequency), Responding(system, values, sound)
    # The impedance's resonance counts even if no resonance is followed.
    level = {each: each.sampled(model, sweep) for each in responses or (Impedance(),)}
    lowest = [int(np.argmin(each)) if (index := response.deepest(each)) is None else index
              for response, each in level.items()]
    driven = [] if stated is None else [stated]
    driven += [float(sweep.frequency[index]) for index in lowest] if responses else []
    width = min(_width(sweep.frequency, each, index) for index, each in zip(lowest, level.values(), strict=True))
    return _Sample(values, sweep, level, tuple(driven), width)


def _width(frequency: Real, level: Real, lowest: int) -> float:
    """The approximate half-power width (Hz) of the resonance at an index.

    A resonance that extends past the band ends at the band's edge.
    """
    high = np.flatnonzero(level >= level[lowest] + HALF)
    below, above = high[high < lowest], high[high > lowest]
    return float(frequency[above[0] if above.size else -1] - frequency[below[-1] if below.size else 0])


def _columns(full: LinearisedState, moves: Real, width: float) -> Complex:
    """A full state and its changes, columns (size, n).

    The changes are by the half-power `width` in frequency and by `moves` in the parameters, to first order. All columns
    are divided by the root of the charge.
    """
    changes = np.column_stack([width * full.by_frequency, full.by_parameter * moves])
    return np.column_stack([full.state, changes]) / np.sqrt(abs(full.charge))


def _sweeping(
    model: ReducedModel, taken: Sequence[_Sample], checked: Sequence[_Sample],
    sound_of: Callable[[ReducedModel], SoundEnergy | None],
) -> ReducedModel:
    """The model of the rough spectrum, with as few vectors as possible.

    Its error is at most :data:`ROUGH` in each level at the points `checked`, within :data:`DEEP` of the smallest level.
    """
    states = np.concatenate([each.sweep.states / np.sqrt(np.abs(each.sweep.charge)) for each in taken], axis=1)
    whole = model.truncated(states, 0.0)
    if not whole.sizes.size:
        raise InputError("design model", "band", frequency_text(*taken[0].sweep.frequency[[0, -1]]),
                         "a band in which the chip resonates")
    smallest = FINER * float(whole.sizes.max())
    while True:
        found = whole.coarser(smallest**2)
        off = _off(found, checked, sound_of(found))
        if off <= ROUGH or found.operators.size == whole.operators.size:
            return found
        smallest *= FINER


def _off(model: ReducedModel, checked: Sequence[_Sample], sound: SoundEnergy | None) -> float:
    """The largest error in any level of a rough `model`."""
    off = 0.0
    for each in checked:
        system = ReducedSystem(model.operators, each.values)
        there = Responding(system, each.values, sound)
        sweep = system.sweep(each.sweep.frequency)
        for response, level in each.level.items():
            deep = slice(None) if isinstance(response, Impedance) else level <= level.min() + DEEP
            off = max(off, float(np.abs(response.sampled(there, sweep) - level)[deep].max()))
    return off


def _errors(
    operating: ReducedModel, cavity: Cavity | None, whole: SoundEnergy | None,
    checked: Sequence[tuple[_Sample, LinearisedState]],
) -> tuple[float, float]:
    """The largest relative errors of Z and pressure against full states.

    The pressure is compared as a root mean square.
    """
    rows = None if cavity is None else cavity.pressure_rows(operating.basis)
    energy = None if whole is None else whole.on(operating.basis)
    errors, pressures = [0.0], [0.0]
    for sample, full in checked:
        small = ReducedSystem(operating.operators, sample.values).linearised(full.frequency)
        errors.append(abs(small.charge / full.charge - 1.0))
        if cavity is not None and rows is not None:
            exact = np.append(full.state, 0.0)[cavity.rows]
            pressures.append(float(np.linalg.norm(rows @ small.state - exact) / np.linalg.norm(exact)))
        if whole is not None and energy is not None:
            at = np.array([full.frequency])
            exact_energy = whole.density(at, full.state[:, None], sample.values)
            found = energy.density(at, small.state[:, None], sample.values)
            pressures.append(0.5 * abs(float(found[0] / exact_energy[0]) - 1.0))
    return max(errors), max(pressures)
