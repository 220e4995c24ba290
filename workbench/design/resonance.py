"""The resonance of a model's impedance or energy, with exact derivatives.

It is found on the model itself, not on points of a spectrum. A level L(f) has exact derivatives: ln |Z|, or -ln(E)/2 of
the mean energy density of sound in the cavity (`workbench.fem.level`). The resonance f0 is a root of L', the half-power
frequencies f1 and f2 are roots of L - L(f0) - ln(2)/2. Newton's method finds all of them between points of a spectrum.
The derivatives of the roots by a parameter follow from those of L (implicit function theorem):

    f0' = -L_f,theta / L_ff,   L(f0)' = L_theta(f0),   fi' = (L_theta(f0) - L_theta(fi)) / L_f(fi)

The definitions of f0, Z_min and Q are those of `workbench.results.merit`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.acoustics.sound_energy import SoundEnergy, peaks_of
from workbench.fem.dual import Dual
from workbench.fem.level import NO_NUMBERS, Level, drive_level, impedance_level
from workbench.fem.linearised import FullSystem, LinearisedState, ReducedSystem
from workbench.fem.solve import Solution
from workbench.files.quantities import frequency_text
from workbench.model.drive import Drive
from workbench.results.merit import NoResonance

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: The rise of a level to half of the power.
HALF = 0.5 * math.log(2.0)
#: Relative change of a frequency below which Newton's method has converged: a millihertz of a megahertz.
CONVERGED = 1e-9
#: Difference of two levels due to rounding.
ROUNDING = 1e-12
#: Most steps of Newton's method; it falls back on bisection, which gains one bit a step.
STEPS = 60


@dataclass(frozen=True, eq=False)
class Responding:
    """A model that gives the response to a drive.

    ``system`` is solved with the parameter ``values``. ``sound`` is the energy of sound in the cavity, None without a
    fluid.
    """

    system: FullSystem | ReducedSystem
    values: Mapping[str, complex]
    sound: SoundEnergy | None = None


@dataclass(frozen=True)
class Impedance:
    """The response |Z|: f0, Z_min and Q of a circuit (`workbench.results.merit`).

    A response is a level of a state over frequency that is least at a resonance and ln(2)/2 higher at half power.
    """

    def sampled(self, model: Responding, solution: Solution) -> Real:
        """The level (n,) of the states of a solution."""
        return -np.log(solution.omega * np.abs(solution.charge))

    def state(self, model: Responding, frequency: float, names: tuple[str, ...] = ()) -> LinearisedState:
        """The state of a model at a frequency (Hz).

        It has the derivatives that :meth:`level` needs.
        """
        return model.system.linearised(frequency, names)

    def level(self, model: Responding, state: LinearisedState, turns: Complex = NO_NUMBERS) -> Level:
        """The level of a state and its derivatives."""
        return impedance_level(state, turns)

    def deepest(self, level: Real) -> int | None:
        """The index of the resonance among levels (n,), None without one."""
        lowest = int(np.argmin(level))
        return None if lowest in (0, level.size - 1) else lowest

    def words(self, level: float) -> str:
        """A level in words."""
        return f"smallest |Z|, {math.exp(level):.4g} ohm,"


@dataclass(frozen=True)
class Energy:
    """The largest mean energy density of sound in the cavity.

    The level is -ln(E)/2 under the ``drive``. Methods are those of :class:`Impedance`.
    """

    drive: Drive

    def sampled(self, model: Responding, solution: Solution) -> Real:
        assert model.sound is not None
        energy = model.sound.density(solution.frequency, solution.states, model.values)
        return -0.5 * np.log(energy) - np.log(np.abs(self.drive.amplitude(solution.impedance)))

    def state(self, model: Responding, frequency: float, names: tuple[str, ...] = ()) -> LinearisedState:
        return model.system.linearised(frequency, names, twice=True)

    def level(self, model: Responding, state: LinearisedState, turns: Complex = NO_NUMBERS) -> Level:
        assert model.sound is not None
        energy = model.sound.log_level(state, model.values, turns)
        return (energy + drive_level(self.drive.amplitude, state, turns)) * -0.5

    def deepest(self, level: Real) -> int | None:
        return next(iter(peaks_of(np.exp(-2.0 * level))), None)

    def words(self, level: float) -> str:
        return f"largest energy of the sound in the cavity, {math.exp(-2.0 * level):.4g} J/m^3 under {self.drive},"


ResonantQuantity = Impedance | Energy


@dataclass(frozen=True, eq=False)
class Resonance:
    """A resonance of a response and its half-power points.

    ``at`` is the state near its frequency and ``level`` the level there. ``sides`` are the two frequencies near half
    power (Hz) with their levels. They are None if a neighbouring resonance or the end of the band is in the way, and
    ``reason`` explains which. The exact frequencies are one more step of Newton's method.
    """

    at: LinearisedState
    level: Level
    sides: tuple[tuple[float, Level], tuple[float, Level]] | None
    reason: str = ""

    @property
    def frequency(self) -> Dual:
        """The frequency, in Hz."""
        return Dual(self.at.frequency - self.level.slope / self.level.curvature,
                    -self.level.mixed / self.level.curvature)

    @property
    def least(self) -> Dual:
        """The level at the resonance."""
        return Dual(self.level.value - 0.5 * self.level.slope**2 / self.level.curvature, self.level.by_number)

    @property
    def q(self) -> Dual:
        """The frequency divided by the half-power width, NaN without sides."""
        if self.sides is None:
            return self.frequency * math.nan
        half = self.least + HALF
        low, high = ((Dual(each.value, each.by_number) - half) / -each.slope + frequency
                     for frequency, each in self.sides)
        return self.frequency / (high - low)


def find_resonance(
    response: ResonantQuantity, model: Responding, frequency: Real, level: Real, names: tuple[str, ...] = (),
    turns: Complex = NO_NUMBERS, final: Responding | None = None,
) -> Resonance:
    """Find the deepest resonance of a `response` of a `model`.

    `level` (n,) is known at some ascending `frequency` (n,) Hz. With `final`, a better model, the states are those of
    that model, evaluated at most three times. The derivatives of the complex parameters `names` by the numbers are
    `turns`.

    Raises:
        NoResonance: the response is least at an edge of the band.
    """
    lowest, last = response.deepest(level), frequency.size - 1
    bounds = f"the band {frequency_text(*frequency[[0, -1]])}"
    if lowest is None:
        edge = int(np.argmin(level))
        raise NoResonance(f"the {response.words(float(level[edge]))} is at an edge of {bounds}",
                          frequency=float(frequency[edge]), impedance=math.nan)
    known: dict[float, Level] = {}

    def level_at(place: float) -> Level:
        if place not in known:
            known[place] = response.level(model, response.state(model, place))
        return known[place]

    at = _minimum(level_at, frequency, lowest)
    half = level_at(at).value + HALF
    below, above = np.flatnonzero(level[:lowest] >= half), np.flatnonzero(level[lowest + 1 :] >= half)
    sides, reason = list[float](), ""
    if below.size and above.size and level[below[-1] : lowest + 2 + above[0]].min() == level[lowest]:
        for outer, step in ((int(below[-1]), 1), (lowest + 1 + int(above[0]), -1)):
            ends = sorted((float(frequency[min(max(outer - step, 0), last)]), at))
            # The start is where a straight line from one point inwards, or to the resonance, crosses half of the power.
            inner, low = min((float(frequency[outer + step]), float(level[outer + step])), (at, level_at(at).value),
                             key=lambda point: step * point[0])
            start = float(np.interp(half, (low, float(level[outer])), (inner, float(frequency[outer]))))
            sides.append(_root(level_at, (ends[0], ends[1]), start, lambda each: (each.value - half, each.slope),
                               rising=step < 0))
    else:
        reason = (f"a half-power point of the resonance at {frequency_text(at)} lies outside {bounds}, or beyond a "
                  "deeper one")
    better = final or model
    state = response.state(better, at, names)
    taken = [(each, response.level(better, response.state(better, each, names), turns)) for each in sides]
    return Resonance(state, response.level(better, state, turns), (taken[0], taken[1]) if taken else None, reason)


def _minimum(level: Callable[[float], Level], points: Real, nearest: int) -> float:
    """Find the frequency (Hz) of the least level.

    The search is between ascending `points` (Hz) and starts at index `nearest`. The points may come from a rougher
    model, so that a neighbour may be lower. Newton's method runs between two higher points; a step that leaves them, or
    does not decrease the level, is replaced by halving the larger part.

    Raises:
        NoResonance: the level decreases to the first or last point.
    """
    while True:
        if nearest in (0, points.size - 1):
            raise NoResonance(f"no resonance from {frequency_text(*points[[0, -1]])}",
                              frequency=float(points[nearest]), impedance=math.nan)
        low, middle, high = map(float, points[nearest - 1 : nearest + 2])
        down = min((0, -1, 1), key=lambda step: level(float(points[nearest + step])).value)
        if not down:
            break
        nearest += down
    for _ in range(STEPS):
        here = level(middle)
        step = -here.slope / here.curvature if here.curvature > 0.0 else math.inf
        if abs(step) <= CONVERGED * middle or high - low <= CONVERGED * middle:
            # The last step squares the error, so that figures of the state are smooth in the numbers.
            return middle + step if low < middle + step < high else middle
        further = middle + step
        if not low < further < high:
            further = 0.5 * (middle + (high if high - middle > middle - low else low))
        there = level(further)
        # Within rounding, a flatter place counts as lower.
        if there.value < here.value or (there.value <= here.value + ROUNDING and abs(there.slope) < abs(here.slope)):
            low, high = (middle, high) if further > middle else (low, middle)
            middle = further
        else:
            low, high = (low, further) if further > middle else (further, high)
    return middle


def _root(
    level: Callable[[float], Level], ends: tuple[float, float], start: float,
    function: Callable[[Level], tuple[float, float]], *, rising: bool,
) -> float:
    """Find a zero of a `function` of the level, between `ends` (Hz).

    `function` gives its value and derivative. A step of Newton's method that leaves the rest of the interval is
    replaced by halving it.

    Raises:
        NoResonance: the function has no zero there.
    """
    low, high = ends
    frequency = min(max(start, low), high)
    for _ in range(STEPS):
        value, derivative = function(level(frequency))
        if (value > 0.0) == rising:
            high = frequency
        else:
            low = frequency
        step = -value / derivative if derivative else math.inf
        if abs(step) <= CONVERGED * frequency:
            return frequency
        following = frequency + step
        frequency = following if low < following < high else 0.5 * (low + high)
        if high - low <= CONVERGED * frequency:
            break
    raise NoResonance(f"no resonance from {frequency_text(*ends)}", frequency=frequency, impedance=math.nan)
