"""The resonance of a model and its figures f0, Z_min and Q, on the model itself rather than on points of a spectrum.

L(f) = ln |Z| has exact derivatives (`workbench.fem.linearised`). f0 is a root of L', the half-power frequencies f1 and
f2 are roots of L - L(f0) - ln(2)/2, all found by Newton's method between points of a spectrum; the derivatives of the
roots by a parameter follow from those of L (implicit function theorem):

    f0' = -L_f,theta / L_ff,   (ln Z_min)' = L_theta(f0),   fi' = (L_theta(f0) - L_theta(fi)) / L_f(fi)

The definitions are those of `workbench.results.merit`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from workbench.fem.linearised import (
    LinearisedState,
    curvature,
    frequency_slope,
    log_impedance,
    log_slopes,
    mixed_slopes,
)
from workbench.results.merit import NoResonance

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Relative change of a frequency below which Newton's method has converged: a millihertz of a megahertz.
CONVERGED = 1e-9
#: Most steps of it; it falls back on bisection, which gains a bit each.
STEPS = 60


class Linearisable(Protocol):
    """A model with its parameter values in place."""

    def linearised(self, frequency: float, names: tuple[str, ...] = ()) -> LinearisedState:
        """The state at a frequency (Hz) with its derivatives by frequency and by complex parameters."""


@dataclass(frozen=True, eq=False)
class Resonance:
    """A resonance: the state ``at`` about f0 and those about the half-power frequencies f1 and f2.

    The frequencies themselves are a last step of Newton's method from these.
    """

    at: LinearisedState
    below: LinearisedState
    above: LinearisedState

    @property
    def f0(self) -> float:
        """Hz."""
        return self.at.frequency - frequency_slope(self.at) / curvature(self.at)

    @property
    def log_z_min(self) -> float:
        """ln of the smallest |Z| in ohm."""
        return log_impedance(self.at) - 0.5 * frequency_slope(self.at) ** 2 / curvature(self.at)

    @property
    def z_min(self) -> float:
        """Ohm."""
        return math.exp(self.log_z_min)

    @property
    def width(self) -> float:
        """f2 - f1, Hz."""
        half = self.log_z_min + 0.5 * math.log(2.0)
        low, high = (each.frequency - (log_impedance(each) - half) / frequency_slope(each)
                     for each in (self.below, self.above))
        return high - low

    @property
    def q(self) -> float:
        return self.f0 / self.width

    def gradients(self, turns: Complex) -> tuple[Real, Real, Real]:
        """Derivatives (k,) of f0, Z_min and Q by the real numbers that the parameters move by `turns` (k,): 1 for a
        real part, 1j for an imaginary one."""
        slope_0 = log_slopes(self.at, turns)
        f0 = -mixed_slopes(self.at, turns) / curvature(self.at)
        f1, f2 = ((slope_0 - log_slopes(each, turns)) / frequency_slope(each) for each in (self.below, self.above))
        return f0, self.z_min * slope_0, self.q * (f0 / self.f0 - (f2 - f1) / self.width)


def find_resonance(
    model: Linearisable, frequency: Real, charge: Complex, names: tuple[str, ...] = (),
    final: Linearisable | None = None,
) -> Resonance:
    """The deepest resonance of a `model` whose `charge` (n,) at some ascending `frequency` (n,) Hz is known.

    The states are those of `final` where that is given: a better model, not asked more than thrice.

    Raises:
        NoResonance: the smallest |Z| lies at an edge of the band, or a half-power point outside it.
    """
    level = -np.log(2.0 * np.pi * frequency * np.abs(charge))
    lowest, last = int(np.argmin(level)), frequency.size - 1
    bounds = f"the band {frequency[0]:.9g} to {frequency[-1]:.9g} Hz"
    found = f"{frequency[lowest]:.9g} Hz ({math.exp(level[lowest]):.4g} ohm)"
    least = float(frequency[lowest]), math.exp(level[lowest])
    if lowest in (0, last):
        raise NoResonance(f"the smallest |Z| is at an edge of {bounds}, {found}", frequency=least[0],
                          impedance=least[1])
    start = _vertex(frequency[lowest - 1 : lowest + 2], level[lowest - 1 : lowest + 2])
    # The points may be those of a rougher model: one further to either side.
    at = _root(model, (float(frequency[max(lowest - 2, 0)]), float(frequency[min(lowest + 2, last)])), start,
               lambda state: (frequency_slope(state), curvature(state)), rising=True)
    half = log_impedance(at) + 0.5 * math.log(2.0)
    below, above = np.flatnonzero(level[:lowest] >= half), np.flatnonzero(level[lowest + 1 :] >= half)
    if not below.size or not above.size:
        raise NoResonance(f"a half-power point of the resonance at {found} lies outside {bounds}",
                          frequency=least[0], impedance=least[1])
    sides = []
    for outer, step in ((int(below[-1]), 1), (lowest + 1 + int(above[0]), -1)):
        ends = sorted((float(frequency[min(max(outer - step, 0), last)]), at.frequency))
        sides.append(_root(model, (ends[0], ends[1]), _crossing(frequency, level, outer, step, half, at),
                           lambda state: (log_impedance(state) - half, frequency_slope(state)), rising=step < 0))
    states = (at, *sides)
    if names or final is not None:
        states = tuple((final or model).linearised(each.frequency, names) for each in states)
    return Resonance(*states)


def _inner(neighbour: float, f0: float, step: int) -> float:
    """The end next to f0 of the interval of a half-power frequency."""
    return min(neighbour, f0) if step > 0 else max(neighbour, f0)


def _vertex(x: Real, y: Real) -> float:
    """The place of the minimum of the parabola through three points."""
    centre, scale = x[1], x[2] - x[0]
    second, first, _ = np.polyfit((x - centre) / scale, y, 2)
    return float(centre - scale * first / (2.0 * second)) if second > 0.0 else float(centre)


def _crossing(frequency: Real, level: Real, outer: int, step: int, half: float, at: LinearisedState) -> float:
    """The place where a straight line from one point inwards crosses `half`."""
    inner = _inner(float(frequency[outer + step]), at.frequency, step)
    low = log_impedance(at) if inner == at.frequency else float(level[outer + step])
    share = (float(level[outer]) - half) / max(float(level[outer]) - low, 1e-300)
    return float(frequency[outer] + share * (inner - frequency[outer]))


def _root(
    model: Linearisable, ends: tuple[float, float], start: float,
    function: Callable[[LinearisedState], tuple[float, float]], *, rising: bool,
) -> LinearisedState:
    """The state where a `function` of it, which gives its value and derivative, is zero between two `ends` (Hz).

    Newton's method; a step that leaves what is left of the interval halves it instead.

    Raises:
        NoResonance: the function has no zero there.
    """
    low, high = ends
    frequency = min(max(start, low), high)
    for _ in range(STEPS):
        state = model.linearised(frequency)
        value, derivative = function(state)
        if (value > 0.0) == rising:
            high = frequency
        else:
            low = frequency
        step = -value / derivative if derivative else math.inf
        if abs(step) <= CONVERGED * frequency:
            return state
        following = frequency + step
        frequency = following if low < following < high else 0.5 * (low + high)
        if high - low <= CONVERGED * frequency:
            break
    raise NoResonance(f"no resonance between {ends[0]:.9g} and {ends[1]:.9g} Hz", frequency=frequency,
                      impedance=math.exp(log_impedance(state)))
