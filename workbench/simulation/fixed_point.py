"""Temperature and field of a driven chip as a fixed point.

With the liquid t warmer than stated, the field at the drive's frequency loses P_k(t) in region k, and these losses warm
the liquid by

    h(t) = h0 + sum_k R_k P_k(t),

with R_k (K/W) by conduction (`workbench.acoustics.heat`), and h0 from holders that are not at ambient temperature.
Conduction is linear, so R_k are computed once. A steady state is a root of h(t) - t; it is stable where h(t) - t falls.
A reduced model, made accurate by a few full solves along t, gives P_k(t). The reported root is solved in full at its
temperature, with the R_k of its own field, until both agree.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from geometry.names import CAVITY, parent_place
from materials.kinds import Fluid
from materials.registry import Registry
from workbench.acoustics.heat import conduction_of, influence_on, lacking_constants
from workbench.acoustics.heat_source import heat_source
from workbench.acoustics.sound_energy import SoundEnergy
from workbench.fem.operators import FullOperators
from workbench.fem.solve import NotConverged, Solution, System
from workbench.files.errors import InputError
from workbench.model.drive import Drive
from workbench.model.problem import Problem
from workbench.model.temperature import MaterialLaw, law_of, warmer_problem, warmer_values
from workbench.reduced.at_point import NotEnriched, reduced
from workbench.reduced.model import ReducedModel
from workbench.results.peaks import find_peaks
from workbench.simulation.warm import SteadyPoint, WarmCurve, WarmState, WarmUp

Real = NDArray[np.float64]

#: Tolerance of the reduced model along the rise: the estimated relative error of the impedance; that of the energy is
#: smaller. Doubled, the reported root needs one more round.
ACCURATE = 1e-3

#: Relative differences of energy and rise between the reduced model and the full solve at the reported point. Doubled,
#: a table may be off by 1 % and 2 %.
SAME_ENERGY, SAME_RISE = 5e-3, 1e-2

#: Most rounds until both are met: each one makes the model and the resistances accurate at the latest point.
ROUNDS = 6

#: Relative half width of the window of a search for a peak, its points, and the most windows and zooms: a peak within
#: 2 % is near. A peak of Q = 4000 has two points.
WINDOW, POINTS, STEPS, ZOOMS = 5e-3, 41, 4, 3

#: Relative margin of the search for the peak of a warm chip. The search covers the range between a resonance that does
#: not move and one that moves as the liquid's speed of sound. Doubled, a neighbour may be mistaken for it.
SEARCH_MARGIN = 1e-2

#: Distance (K) of the rises at which the reduced model is checked and a followed peak is searched; a cubic spline
#: connects them. Doubled, the peak is wrong by a twentieth of its width.
CHECKED = 2.0

#: First number of intervals of the rise, change of the logarithm of the losses above which an interval is halved, and
#: smallest interval (K). Doubled, a bistable chip within a tenth of a kelvin may be missed.
INTERVALS, UNEVEN, SMALLEST = 48, 0.15, 0.02


@dataclass(frozen=True, eq=False)
class Warmed:
    """The steady ``state`` of a chip, or ``reason`` why it is unknown. ``problem`` and full ``solution`` are those of
    the warm chip if it differs from the cold one, else None."""

    state: WarmState | None
    reason: str = ""
    problem: Problem | None = None
    solution: Solution | None = None


@dataclass(frozen=True)
class HeatPaths:
    """The warming of the liquid by losses.

    ``resistances`` (K/W) are by place of the loss, ``offset`` is in K without losses. ``spread`` is the largest rise in
    the liquid over its mean, ``others`` are the mean rises of other materials over it.
    """

    resistances: Mapping[str, float]
    offset: float
    spread: float
    others: Mapping[str, float]

    @classmethod
    def of(cls, problem: Problem, solution: Solution, up: WarmUp, lawful: frozenset[str] = frozenset()) -> HeatPaths:
        """The paths for losses that are distributed as in a full `solution`. ``others`` has the `lawful` materials."""
        model, _ = conduction_of(problem, convection=up.convection, holder=up.holder)
        source = heat_source(solution, 1.0)
        unheated = np.nan_to_num(model.temperature(np.zeros(model.size)))
        offset = float(model.averaging(CAVITY) @ unheated) if any(model.holders.values()) else 0.0
        if not source.power > 0.0:
            return cls({}, offset, 1.0, dict.fromkeys(lawful, 1.0))
        rise = np.nan_to_num(model.temperature(source.load, driven=False))
        mean = float(model.averaging(CAVITY) @ rise)
        others = {}
        for name in lawful:
            regions = [region for region, material in problem.materials.items() if material.name == name]
            volumes = np.array([model.volume(region) for region in regions])
            others[name] = float(volumes @ [model.averaging(region) @ rise for region in regions]
                                 / volumes.sum() / mean)
        return cls(influence_on(CAVITY, model, source), offset,
                   float(rise[np.unique(model.places[CAVITY].dofs)].max()) / mean, others)


@dataclass(frozen=True, eq=False)
class _Levels:
    """Levels under the drive. ``energy`` density (n,) is in J/m^3, ``warming`` (n,) of the liquid by the losses in K,
    ``voltage`` amplitude (n,) in V, ``power`` (n,) in W."""

    energy: Real
    warming: Real
    voltage: Real
    power: Real


@dataclass(frozen=True, eq=False)
class _Chip:
    """A chip at any rise of its liquid, near the drive's frequency."""

    problem: Problem
    drive: Drive
    laws: tuple[MaterialLaw, ...]
    heat: HeatPaths
    model: ReducedModel
    frequency: float
    path: Callable[[Real], Real]

    @property
    def full(self) -> FullOperators:
        return self.model.full

    @cached_property
    def _by_integral(self) -> Real:
        """Resistances (integrals,) K/W."""
        return np.array([self.heat.resistances.get(parent_place(each.place), 0.0) for each in self.full.integrals])

    def rises(self, rise: float) -> dict[str, float]:
        """Rises (K) of all materials with a law, for a liquid's rise."""
        return {law.material.name: rise * self.heat.others.get(law.material.name, 1.0) for law in self.laws}

    def values(self, rise: float) -> dict[str, complex]:
        return warmer_values(self.problem, self.laws, self.rises(rise))

    def levels(self, rise: float, frequencies: Real) -> _Levels:
        values = self.values(rise)
        return self.levels_of(self.model.solve(frequencies, values), self._reduced_sound, values)

    def energy(self, rise: float, frequencies: Real) -> Real:
        """Energy density (n,) J/m^3 under the drive."""
        return self.levels(rise, frequencies).energy

    @cached_property
    def sound(self) -> SoundEnergy:
        return SoundEnergy.of(self.full)

    @cached_property
    def _reduced_sound(self) -> SoundEnergy:
        return self.sound.on(self.model.basis)

    def levels_of(self, solution: Solution, sound: SoundEnergy, values: Mapping[str, complex]) -> _Levels:
        """The levels of a full or reduced solution. `values` are its parameters, `sound` is its energy."""
        voltage = np.abs(self.drive.amplitude(solution.impedance))
        squared = voltage**2
        return _Levels(sound.density(solution.frequency, solution.states, values) * squared,
                       solution.dissipation() @ self._by_integral * squared, voltage,
                       solution.input_power() * squared)

    def accurate(self, rise: float, frequencies: Real, tolerance: float = ACCURATE) -> _Chip:
        """The chip with an accurate model at a rise and frequencies (Hz)."""
        values = self.values(rise)
        if self.model.worst(frequencies, values)[1] <= tolerance:
            return self
        model, _ = reduced(self.full, frequencies, values, tolerance=tolerance, start=self.model, confirmed=False,
                           skip_singular=True)
        return replace(self, model=model)

    def driven(self, rise: float) -> _Levels:
        return self.levels(rise, self.path(np.array([rise])))

    def reach(self, rise: float) -> Real:
        """Frequencies (n,) Hz at which the peak may be at a rise."""
        name = f"{self.laws[0].material.name}.sound_speed"
        shifts = sorted((1.0, (self.values(rise)[name] / self.problem.values[name]).real))
        low, high = shifts[0] - SEARCH_MARGIN, shifts[1] + SEARCH_MARGIN
        return self.frequency * np.linspace(low, high, int((high - low) * POINTS / (2.0 * WINDOW)) + 1)

    def largest_peak(self, rise: float) -> tuple[float, float] | None:
        """Frequency (Hz) and energy of the largest peak within :meth:`reach`."""
        window = self.reach(rise)
        energy = self.levels(rise, window).energy
        tops, _ = find_peaks(energy, 0.0)
        if not tops.size:
            return None
        found = self._zoomed(rise, float(window[tops[np.argmax(energy[tops])]]), WINDOW)
        return found, float(self.levels(rise, np.array([found])).energy[0])

    def peak(self, rise: float, near: float) -> float | None:
        """The frequency (Hz) of the peak uphill from `near`, if nearby."""
        for _ in range(STEPS):
            window = near * (1.0 + WINDOW * np.linspace(-1.0, 1.0, POINTS))
            energy, top = self.levels(rise, window).energy, POINTS // 2
            while 0 < top < POINTS - 1 and energy[top] < max(energy[top - 1], energy[top + 1]):
                top += 1 if energy[top + 1] > energy[top - 1] else -1
            near = float(window[top])
            if 0 < top < POINTS - 1:
                return self._zoomed(rise, near, WINDOW)
        return None

    def _zoomed(self, rise: float, near: float, half: float) -> float:
        """The frequency (Hz) of a peak, refined within its window. `half` is the relative half width of the window."""
        for _ in range(ZOOMS):
            half *= 2.0 / (POINTS - 1)
            window = near * (1.0 + half * np.linspace(-1.0, 1.0, POINTS))
            near = float(window[int(np.argmax(self.levels(rise, window).energy))])
        return near


def warmed(
    problem: Problem, solution: Solution, drive: Drive, up: WarmUp, *, registry: Registry,
    model: ReducedModel | None = None,
) -> Warmed:
    """The steady state of a chip whose losses warm its liquid.

    Args:
        problem: the chip at its stated temperature, which is that of the surroundings.
        solution: full, of `problem` at the frequency of the drive.
        model: a reduced model of `problem` around that frequency, if any.

    Raises:
        InputError: an unknown boundary or no way for the heat to leave (`wb.heating`); a drive that follows a peak
            where there is none.
    """
    liquid = problem.materials.get(CAVITY)
    if not isinstance(liquid, Fluid) or liquid.is_gas:
        return Warmed(None)
    lacking = lacking_constants(problem)
    if lacking:
        return Warmed(None, "the temperature under the drive, and the change of the field with it, are not known: "
                      f"{lacking}")
    laws = _laws(problem, liquid, registry, up, solution)
    if isinstance(laws, str):
        return Warmed(None, laws)
    heat = HeatPaths.of(problem, solution, up, frozenset(law.material.name for law in laws[1:]))
    frequency = float(solution.frequency[0])
    near = frequency * (1.0 + 0.5 * WINDOW * np.linspace(-1.0, 1.0, 5))
    operators = cast(FullOperators, solution.operators)
    try:
        if model is None:
            model, _ = reduced(operators, near, problem.values, tolerance=ACCURATE, confirmed=False, first=1,
                               skip_singular=True)
        chip = _Chip(problem, drive, laws, heat, model, frequency, lambda rises: np.full(rises.size, frequency))
        return _solved(chip.accurate(0.0, near), solution, up)
    except (NotConverged, NotEnriched) as error:
        return Warmed(None, f"the field of the warm chip is not known: {error}")


def _laws(
    problem: Problem, liquid: Fluid, registry: Registry, up: WarmUp, solution: Solution
) -> tuple[MaterialLaw, ...] | str:
    """The laws of the liquid and of other materials, or an error. The error is the sentence that the liquid has no
    law."""
    lowest = min(0.0, HeatPaths.of(problem, solution, up).offset) if isinstance(up.holder, Mapping) else 0.0
    first = law_of(liquid, registry, lowest=lowest)
    if first is None:
        return (f"{liquid.name} has no law of temperature in its entry: the change of the field by the warmth of the "
                "drive is not known. State laws of its density and sound_speed, or use a liquid that has them")
    others = {each.name: each for each in problem.materials.values() if each.name != liquid.name}
    return (first, *filter(None, (law_of(each, registry) for each in others.values())))


def _solved(chip: _Chip, cold: Solution, up: WarmUp) -> Warmed:
    """The steady state, with a full solve of a warm chip."""
    for _ in range(ROUNDS):
        low, high = _ends(chip)
        chip, end = _following(chip, low, high) if up.follow else (_along(chip, low, high), high)
        state = _state_of(chip, cold, (low, end), up)
        if not state.points and end < high:
            return Warmed(None, f"the peak of the energy that the drive follows disappears {end:.3g} K above the "
                          "stated temperature, before the chip comes to a steady state: state one frequency")
        if not state.matters:
            return Warmed(state)
        here = state.points[0]
        problem = warmer_problem(chip.problem, chip.laws, chip.rises(here.rise))
        solution = System(chip.full, problem.values).solutions(np.array([here.frequency]))
        settled = replace(chip, heat=HeatPaths.of(problem, solution, up, frozenset(chip.heat.others)))
        exact = settled.levels_of(solution, settled.sound, problem.values)
        rise = settled.heat.offset + float(exact.warming[0])
        if (abs(exact.energy[0] - here.energy_density) <= SAME_ENERGY * exact.energy[0]
                and abs(rise - here.rise) <= SAME_RISE * abs(here.rise) + 1e-3):
            chip = chip.accurate(here.rise, chip.reach(here.rise)[:: POINTS // 5])
            state = replace(state, peak=chip.largest_peak(here.rise), evaluate=chip.energy)
            return Warmed(state, problem=problem, solution=solution)
        chip = settled.accurate(here.rise, np.array([here.frequency]), 1e-2 * ACCURATE)
    return Warmed(None, "the temperature and the field of the warm chip did not settle: the fields are those of a chip "
                  "at its stated temperature")


def _along(chip: _Chip, low: float, high: float) -> _Chip:
    """The chip with a model that is accurate along the rise. The frequency is that of the drive."""
    # The end first: its basis is sufficient for most of the other rises.
    for rise in (high, *np.linspace(low, high, max(4, int((high - low) / CHECKED) + 2))):
        chip = chip.accurate(float(rise), np.array([chip.frequency]))
    return chip


def _following(chip: _Chip, low: float, high: float) -> tuple[_Chip, float]:
    """The chip whose drive follows its peak, with an accurate model. Also the rise (K) up to which the peak exists."""
    found, end = dict[float, float](), high
    for side in (high, low):
        near = chip.frequency
        for rise in map(float, np.linspace(0.0, side, int(abs(side) / CHECKED) + 4) if side else ()):
            best = chip.peak(rise, near)
            if best is not None and chip.model.worst(np.array([best]), chip.values(rise))[1] > ACCURATE:
                chip = chip.accurate(rise, best * (1.0 + 0.5 * WINDOW * np.linspace(-1.0, 1.0, 5)))
                best = chip.peak(rise, near)
            if best is None and rise == 0.0:
                raise InputError("warm up", "follow", f"{chip.frequency / 1e6:.6g} MHz", "a frequency beside a peak of "
                                 "the energy in the liquid, which the drive can follow; energy.png of `simulate` shows "
                                 "them")
            if best is None or (rise and abs(best / near - 1.0) > SEARCH_MARGIN):
                end = min(end, max(found))
                break
            found[rise] = near = best
    rises = sorted(found)
    return replace(chip, path=CubicSpline(rises, [found[rise] for rise in rises])), end


def _ends(chip: _Chip) -> tuple[float, float]:
    """The lowest and the highest mean rise (K) of the liquid. Its warmest place stays within all laws."""
    low = max(min(0.0, chip.heat.offset), chip.laws[0].lowest)
    highest = [law.highest / (chip.heat.others.get(law.material.name, chip.heat.spread)) for law in chip.laws]
    return low, min(highest)


def _state_of(chip: _Chip, cold: Solution, ends: tuple[float, float], up: WarmUp) -> WarmState:
    """The steady state by the reduced model, between `ends` (K)."""
    liquid, (low, high) = chip.laws[0], ends

    def excess_at(rise: float) -> float:
        return chip.heat.offset + float(chip.driven(rise).warming[0]) - rise

    rises, found = _scanned(chip.driven, low, high)
    warming, energy = (np.array([getattr(each, name)[0] for each in found]) for name in ("warming", "energy"))
    excess, points = chip.heat.offset + warming - rises, list[SteadyPoint]()
    for k in np.flatnonzero((excess[:-1] > 0.0) != (excess[1:] > 0.0)):
        rise = float(brentq(excess_at, rises[k], rises[k + 1], xtol=1e-5))
        frequency = float(chip.path(np.array([rise]))[0])
        points.append(_point(chip.driven(rise), rise, frequency, stable=bool(excess[k] > 0.0)))
    if not warming.any():
        points = [_point(found[0], low, chip.frequency)]
    here = chip.levels_of(cold, chip.sound, chip.problem.values)
    first, at = min(1.0, high), np.array([chip.frequency])
    once = chip.accurate(first, at)
    tops = [once.peak(0.0, chip.frequency)]
    tops.append(None if tops[0] is None else once.peak(first, tops[0]))
    way = [float(once.levels(rise, at).energy[0]) for rise in (0.0, first)]
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.sqrt(np.where(warming > 0.0, (rises - chip.heat.offset) / warming, np.nan))
    until = rises <= points[0].rise if points else np.ones(rises.size, dtype=bool)
    change = np.append(energy[until], points[0].energy_density if points else energy[-1]) / here.energy[0] - 1.0
    stated = cast(float, liquid.material.temperature)
    return WarmState(
        liquid=liquid.material.name.split("/")[0], stated=stated, drive=chip.drive, up=up,
        cold=_point(here, chip.heat.offset + float(here.warming[0]), chip.frequency), points=tuple(points),
        energy_per_kelvin=(way[1] / way[0] - 1.0) / first,
        peak_per_kelvin=None if tops[0] is None or tops[1] is None else (tops[1] - tops[0]) / first,
        largest_change=float(np.abs(change).max()), highest=stated + liquid.highest,
        largest=float(np.nanmax(factor, initial=0.0)), curve=WarmCurve(
            rises, factor, chip.path(rises), factor**2 * energy),
        laws=tuple(law.material.name for law in chip.laws), problem=chip.problem,
        evaluate=chip.energy)


def _point(levels: _Levels, rise: float, frequency: float, *, stable: bool = True) -> SteadyPoint:
    return SteadyPoint(rise, frequency, float(levels.energy[0]), 2.0 * float(levels.voltage[0]), float(levels.power[0]),
                       stable)


def _scanned(
    driven: Callable[[float], _Levels], low: float, high: float
) -> tuple[Real, list[_Levels]]:
    """Rises (K), denser where the losses change, and their levels."""
    known = {float(rise): driven(float(rise)) for rise in np.linspace(low, high, INTERVALS + 1)}
    while True:
        rises = sorted(known)
        losses = np.log(np.maximum([known[rise].warming[0] for rise in rises], 1e-300))
        new = [0.5 * (rises[k] + rises[k + 1]) for k in np.flatnonzero(np.abs(np.diff(losses)) > UNEVEN)
               if rises[k + 1] - rises[k] > SMALLEST]
        if not new:
            return np.array(rises), [known[rise] for rise in rises]
        known |= {rise: driven(rise) for rise in new}
