"""The next frequency of a sweep, as a function of its points.

So a sweep can be resumed. A pass visits all frequencies once. The first pass at a drive level determines them; every
further one visits them again, so that up and down, or repeats, can be compared point by point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from workbench.bench.setup import FREQUENCY_RESOLUTION, BenchSetup, SweepPlan
from workbench.results.merit import NoResonance, figures
from workbench.results.spectrum import Spectrum

#: Share of the points of an adaptive sweep that are evenly spaced, before it refines by curvature.
_EVEN_SHARE = 0.25

#: Least distance of two frequencies of an adaptive sweep, relative to the frequency: a resonance of Q = 5000 would
#: still have ten points.
_CLOSEST = 2e-5

#: Weight of an error in the band of f0, Z_min and Q, relative to others.
_EMPHASIS = 20.0

#: Ratio of the error of the cubic without one point to that of the spline through all points. For equal steps h the
#: error of the cubic is h^4 / 6 of the fourth derivative and that of the spline h^4 / 384; half of their ratio is used,
#: since steps are not equal.
_GAIN_OF_A_POINT = 30.0


@dataclass(frozen=True)
class Target:
    """The next point: ``frequency`` (Hz), ``level`` (Vpp, open circuit), ``pass_number``."""

    frequency: float
    level: float
    pass_number: int


class Measured(Protocol):
    """Interface of a measured point for the plan."""

    @property
    def frequency(self) -> float: ...
    @property
    def level(self) -> float: ...
    @property
    def pass_number(self) -> int: ...
    @property
    def impedance(self) -> complex: ...
    @property
    def uncertainty(self) -> float: ...


def next_target(setup: BenchSetup, measured: Sequence[Measured]) -> Target | None:
    """The next point, or None at the end."""
    for level in setup.levels:
        at_level = [point for point in measured if point.level == level]
        first = [point for point in at_level if point.pass_number == 0]
        if setup.sweep.kind == "adaptive":
            frequency = _adaptive(setup.sweep, first)
        else:
            frequency = _unvisited(setup.sweep, 0, setup.sweep.grid().tolist(), first)
        if frequency is not None:
            return Target(frequency, level, 0)
        visited = sorted({point.frequency for point in first})
        for number in range(1, setup.sweep.passes):
            on_pass = [point for point in at_level if point.pass_number == number]
            frequency = _unvisited(setup.sweep, number, visited, on_pass)
            if frequency is not None:
                return Target(frequency, level, number)
    return None


def expected_points(setup: BenchSetup) -> int:
    """The largest number of points of the run."""
    sweep = setup.sweep
    first = len(sweep.grid()) if sweep.kind == "linear" else sweep.points
    return first * sweep.passes * len(setup.levels)


def _unvisited(sweep: SweepPlan, number: int, rising: Sequence[float], points: Sequence[Measured]) -> float | None:
    """The next of the `rising` frequencies that pass `number` lacks."""
    upwards = sweep.direction == "up" or (sweep.direction == "both" and number % 2 == 0)
    seen = {point.frequency for point in points}
    return next((f for f in (rising if upwards else reversed(rising)) if f not in seen), None)


def _adaptive(sweep: SweepPlan, points: Sequence[Measured]) -> float | None:
    """The next frequency of an adaptive sweep. First points are evenly spaced. Then each point is added in the middle
    of the interval at whose end the other points predict the point worst, beyond the noise; see :func:`_missed`. The
    band within half a width about the half-power points of the deepest resonance, where f0, Z_min and Q are read, has
    more weight. Once the shape is known to the resolution or to the noise, the remaining points repeat the existing
    frequencies."""
    even = max(8, round(_EVEN_SHARE * sweep.points))
    seen = {point.frequency for point in points}
    for start in _settable(np.linspace(sweep.low, sweep.high, even)).tolist():
        if start not in seen:
            return float(start)
    if len(points) >= sweep.points:
        return None
    spectrum = combined_points(points)
    assert spectrum.uncertainty is not None  # combined_points() always states it
    low, high = _deepest(spectrum)
    frequency, width = spectrum.frequency, np.diff(spectrum.frequency)
    missed, noise = _missed(spectrum)
    excess = np.where(missed > 3.0 * noise, missed / _GAIN_OF_A_POINT, 0.0)
    # The longer of the two intervals beside a badly predicted point gets the error.
    span = np.concatenate([[np.inf], width[1:] + width[:-1], [np.inf]])
    score = np.maximum(excess[:-1] * (width / span[:-1]) ** 2, excess[1:] * (width / span[1:]) ** 2) * 4.0
    score[(frequency[1:] > low) & (frequency[:-1] < high)] *= _EMPHASIS
    score[width < 2.0 * _CLOSEST * frequency[:-1]] = 0.0
    worst = int(np.argmax(score))
    if score[worst] > sweep.resolution:
        return float(_settable(np.array([0.5 * (frequency[worst] + frequency[worst + 1])]))[0])
    near = np.flatnonzero((frequency >= low) & (frequency <= high))
    # Noise below a tenth of the resolution needs no further point.
    relative = spectrum.uncertainty[near] / spectrum.magnitude[near]
    if len(near) == 0 or np.max(relative) < 0.1 * sweep.resolution:
        return None
    return float(frequency[near[int(np.argmax(relative))]])


def _deepest(spectrum: Spectrum) -> tuple[float, float]:
    """The band (Hz) of the deepest resonance; (0, 0) without one."""
    try:
        found = figures(spectrum)
    except NoResonance:
        return 0.0, 0.0
    margin = 0.5 * (found.f2 - found.f1)
    return found.f1 - margin, found.f2 + margin


def _missed(spectrum: Spectrum) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Relative error (n,) of prediction of each point by its neighbours. Also the error due to noise. The prediction is
    the cubic through the two nearest points on either side, of the reflection coefficient, as in
    :meth:`Spectrum.interpolant`, because that is bounded. It is zero at the ends."""
    frequency, impedance = spectrum.frequency, spectrum.impedance
    assert spectrum.uncertainty is not None  # combined_points() always states it
    count = len(frequency)
    z0 = float(np.exp(np.mean(np.log(spectrum.magnitude))))
    reflection = (impedance - z0) / (impedance + z0)
    inner = np.arange(1, count - 1)
    first = np.clip(inner - 2, 0, count - 5)  # The first of five neighbours, without the point itself.
    neighbours = first[:, None] + np.arange(4)
    neighbours += neighbours >= inner[:, None]
    nodes = frequency[neighbours]
    weights = np.ones_like(nodes)
    for k in range(4):
        for other in range(4):
            if other != k:
                weights[:, k] *= (frequency[inner] - nodes[:, other]) / (nodes[:, k] - nodes[:, other])
    expected = np.sum(weights * reflection[neighbours], axis=1)
    missed = np.zeros(count)
    missed[inner] = np.abs(z0 * (1.0 + expected) / (1.0 - expected) / impedance[inner] - 1.0)
    # The complex error of the point, and as much again from its neighbours.
    return missed, 2.0 * spectrum.uncertainty / spectrum.magnitude


def combined_points(points: Sequence[Measured]) -> Spectrum:
    """Points as a spectrum in rising order. Equal frequencies are combined by weighted mean; the uncertainty (ohm) is
    of the noise alone."""
    frequency = np.array([point.frequency for point in points])
    impedance = np.array([point.impedance for point in points])
    weight = np.array([point.uncertainty for point in points]) ** -2.0
    at, place = np.unique(frequency, return_inverse=True)
    total = np.bincount(place, weights=weight)
    mean = np.empty(len(at), dtype=np.complex128)
    mean.real, mean.imag = (np.bincount(place, weight * part) / total for part in (impedance.real, impedance.imag))
    return Spectrum(at, mean, np.asarray(1.0 / np.sqrt(total), dtype=np.float64))


def _settable(frequency: NDArray[np.float64]) -> NDArray[np.float64]:
    """Frequencies (n,) Hz rounded to whole hertz and the generator's resolution."""
    return np.round(np.round(frequency) / FREQUENCY_RESOLUTION) * FREQUENCY_RESOLUTION
