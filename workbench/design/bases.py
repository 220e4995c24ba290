"""The bases that figures are computed on: one for the states a chip is driven in, one to find these.

A spectrum needs all that resonates in its band; figures need the states about one resonance, wherever in the ranges
that is. These lie in a far smaller space (on the reference chip, six lengths within 5 %, some 120 vectors in place of
334), and where the deepest resonance is, a rough spectrum tells. So full solves are spent where chips are driven: a
rough range model says where that is at points spread over the ranges, the full model is solved and linearised there,
and what the states and their derivatives span is kept (proper orthogonal decomposition in the norm of the energy).
Further full solves check it; where they find it wanting they join it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.plausible import as_text
from workbench.acoustics.sound_energy import SoundEnergy, sound_energy
from workbench.design.cavity import Cavity
from workbench.design.resonance import HALF, Impedance, ResonantQuantity, Responding
from workbench.fem.coefficients import Coefficients
from workbench.fem.linearised import FullSystem, LinearisedState, ReducedSystem
from workbench.fem.operators import FullOperators
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.solve import Solution, one_thread
from workbench.files.errors import InputError
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

#: Points of the ranges that the full model is first solved at, for each parameter and at least, and points by which the
#: basis is checked in a round.
TAKEN, LEAST, CHECKED = 3, 10, 4
#: Most rounds of further points.
ROUNDS = 8
#: Points of the ranges that the rough spectrum is made for, for each parameter and at least.
SWEPT, FEWEST = 5, 16
#: Relative error of |Z| that is left to the rough spectrum: two resonances whose depths differ less may be confused.
ROUGH = 0.03
#: Part of the level below which a peak of the energy is too low to be the largest one: a tenth of its energy.
DEEP = 0.5 * float(np.log(10.0))
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
    cavity; ``sound`` and ``sweeping_sound`` the energy in the cavity of both, None without a fluid. ``error`` and
    ``pressure_error`` are the largest relative errors of Z and of the pressure's root mean square where the chip is
    driven that full solves have found.
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
        """The arrays that full solves gave; :func:`stored_bases` makes the rest again from the problem."""
        found = {"operating": self.operating.matrices, "sketch": self.sketch, "sweeping": self.sweeping.matrices,
                 "frequency": self.frequency, "errors": np.array([self.error, self.pressure_error])}
        sounds = {"sound": self.sound, "sweeping_sound": self.sweeping_sound}
        return {**found, **({} if self.rows is None else {"rows": self.rows}), **{
            name: each.operators.matrices for name, each in sounds.items() if each is not None
            and isinstance(each.operators, ReducedOperators)}}

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
    small, sweeping = reduced("operating", by_place), reduced("sweeping", False)

    whole, moving = sound_energy(operators), range_keys(ranges)
    sounds = [None if whole is None else whole.stored(arrays[name], moving, problem.values)
              for name in ("sound", "sweeping_sound")]
    return Bases(small, arrays["sketch"], arrays.get("rows"), sweeping, arrays["frequency"], error, pressure_error,
                 *sounds)


@dataclass(frozen=True, eq=False)
class _Sample:
    """The rough spectrum at one point: ``values`` there, its ``sweep``, the ``level`` of each response over it, the
    frequencies the chip is ``driven`` at and the least half-power ``width`` of the resonances there (Hz)."""

    values: Values
    sweep: Solution
    level: Mapping[ResonantQuantity, Real]
    driven: tuple[float, ...]
    width: float


def bases_of(
    made: RangeModel, responses: Sequence[ResonantQuantity], stated: float | None, cavity: Cavity | None, *,
    tolerance: float, by_place: bool, seed: int, progress: Progress = no_progress,
) -> Bases:
    """The bases for the problem of a range model.

    Args:
        responses: those at whose resonances states are needed.
        stated: a further frequency (Hz) of states.
        cavity: that of the figures, None if there is none.
        tolerance: relative error of Z where the chip is driven; the pressure's is :data:`OF_PRESSURE` times as much.
        by_place: whether the operators are to know where losses are.

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
    # The impedance's resonance counts where nothing is followed, too.
    level = {each: each.sampled(model, sweep) for each in responses or (Impedance(),)}
    lowest = [int(np.argmin(each)) if (index := response.deepest(each)) is None else index
              for response, each in level.items()]
    driven = [] if stated is None else [stated]
    driven += [float(sweep.frequency[index]) for index in lowest] if responses else []
    width = min(_width(sweep.frequency, each, index) for index, each in zip(lowest, level.values(), strict=True))
    return _Sample(values, sweep, level, tuple(driven), width)


def _width(frequency: Real, level: Real, lowest: int) -> float:
    """About the half-power width (Hz) of the resonance at an index; to the ends of the band where it goes on."""
    high = np.flatnonzero(level >= level[lowest] + HALF)
    below, above = high[high < lowest], high[high > lowest]
    return float(frequency[above[0] if above.size else -1] - frequency[below[-1] if below.size else 0])


def _columns(full: LinearisedState, moves: Real, width: float) -> Complex:
    """A full state (size, n) and its changes by moves of frequency and parameters, over the root of the charge."""
    changes = np.column_stack([width * full.by_frequency, full.by_parameter * moves])
    return np.column_stack([full.state, changes]) / np.sqrt(abs(full.charge))


def _sweeping(
    model: ReducedModel, taken: Sequence[_Sample], checked: Sequence[_Sample],
    sound_of: Callable[[ReducedModel], SoundEnergy | None],
) -> ReducedModel:
    """The model of the rough spectrum: as few vectors as leave :data:`ROUGH` of each level at points not used for
    them, where it is within :data:`DEEP` of its least."""
    states = np.concatenate([each.sweep.states / np.sqrt(np.abs(each.sweep.charge)) for each in taken], axis=1)
    whole = model.truncated(states, 0.0)
    if not whole.sizes.size:
        low, high = (as_text(float(end), "frequency") for end in taken[0].sweep.frequency[[0, -1]])
        raise InputError("design model", "band", f"{low} to {high}", "a band in which the chip resonates")
    smallest = FINER * float(whole.sizes.max())
    while True:
        found = whole.coarser(smallest**2)
        off = _off(found, checked, sound_of(found))
        if off <= ROUGH or found.operators.size == whole.operators.size:
            return found
        smallest *= FINER


def _off(model: ReducedModel, checked: Sequence[_Sample], sound: SoundEnergy | None) -> float:
    """The largest difference of a level of a rough `model` at some points."""
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
    """The largest relative errors of Z and of the pressure (root mean square) against full states."""
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
