"""Figures of merit of a spectrum: resonance, quality factor, coupling.

Definitions (docs/conventions.md): f0 is the frequency of the smallest |Z|, Z_min = |Z(f0)|, and Q = f0 / (f2 - f1) with
f1 and f2 the half-power frequencies about f0, where |Y| = |Y|max / sqrt(2). All are taken on
:meth:`workbench.results.spectrum.Spectrum.interpolant`, not on the recorded points. The fits of a circuit
(`workbench.results.circuit`) and of a pole (`workbench.results.pole`) estimate what is behind the curve.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

from workbench.results.peaks import find_peaks
from workbench.results.spectrum import Spectrum, WithSpectrum, spectrum_of

Interpolant = Callable[..., NDArray[np.complex128]]

#: Points of the search grid per recorded interval. It only has to bracket the extrema, which are then refined; more
#: points find narrower resonances.
_FINE = 32

#: Meanings of the figures by the heading that reports give them; the glossary has them too.
MEANINGS = {
    "f0": "frequency of the smallest |Z|: the resonance.",
    "Z_min": "the smallest |Z|, at f0.",
    "Q": "quality factor: f0 over the width of the resonance at which |Y| has fallen by the square root of 2.",
    "kt": "thickness coupling factor from f0 and the frequency of the largest |Z| above it (IEEE Std 176); empty where "
          "that lies outside the band.",
}


class NoResonance(ValueError):
    """No resonance with both its half-power points inside the band.

    ``frequency`` and ``impedance`` are those of the smallest |Z| found (hertz, ohm); ``candidates`` the frequencies
    of the complete resonances that do lie in the band, for `near` or `band`.
    """

    def __init__(self, reason: str, *, frequency: float, impedance: float, candidates: tuple[float, ...] = ()) -> None:
        super().__init__(reason)
        self.reason = reason
        self.frequency = frequency
        self.impedance = impedance
        self.candidates = candidates

    def __reduce__(self) -> tuple[object, ...]:
        return (_no_resonance, (self.reason, self.frequency, self.impedance, self.candidates))


def _no_resonance(reason: str, frequency: float, impedance: float, candidates: tuple[float, ...]) -> NoResonance:
    return NoResonance(reason, frequency=frequency, impedance=impedance, candidates=candidates)


@dataclass(frozen=True)
class Antiresonance:
    """The maximum of |Z| above f0 and the coupling factors that follow from it.

    ``frequency`` Hz and ``z_max`` ohm; ``kt`` the thickness coupling factor; ``k_effective`` the effective coupling
    factor; ``circuit_capacitance`` (farad) the parallel one of a circuit of this mode alone. It is a start for a fit,
    not the static capacitance, which the modes outside the window hide (`workbench.fem.capacitance` has that of a
    model).
    """

    frequency: float
    z_max: float
    kt: float
    k_effective: float
    circuit_capacitance: float


@dataclass(frozen=True)
class Figures:
    """Figures of merit of one resonance: frequencies in hertz, impedance in ohm.

    ``q_step_change`` is the relative change of Q if every second point is left out: a small value means that the step
    does not affect Q, an infinite one that the resonance is lost at twice the step. ``antiresonance`` is None if |Z|
    has no maximum above f0 inside the band.
    """

    f0: float
    z_min: float
    q: float
    f1: float
    f2: float
    q_step_change: float
    antiresonance: Antiresonance | None

    def count_within(self, frequency: NDArray[np.float64]) -> int:
        """The number of frequencies (n,) Hz that lie within the half-power width of the resonance."""
        return int(np.count_nonzero((frequency >= self.f1) & (frequency <= self.f2)))


def figures(
    spectrum: Spectrum | WithSpectrum, *, near: float | None = None, band: tuple[float, float] | None = None
) -> Figures:
    """Figures of merit of the deepest resonance of a spectrum, or of the one nearest to `near` (Hz).

    `spectrum` may be a result that has one. `band` (low, high) in hertz excludes all other points, those at half power
    included. A minimum counts as a resonance if |Z| rises by sqrt(2) on both sides before it falls below that minimum
    again.

    Raises:
        NoResonance: the smallest |Z| lies at an edge of the band, or a half-power point lies outside it; it carries
            the known part.
        ValueError: the band holds fewer than two points.
    """
    whole = spectrum_of(spectrum)
    seen = whole if band is None else whole.restricted(*band)
    f0, z_min, f1, f2 = _resonance(seen, near)
    try:
        coarse = Spectrum(seen.frequency[::2], seen.impedance[::2])
        _, _, low, high = _resonance(coarse, f0)
        change = abs((high - low) / (f2 - f1) - 1.0)
    except ValueError:  # NoResonance, or fewer than two points left: either way the resonance is lost
        change = math.inf
    return Figures(f0, z_min, f0 / (f2 - f1), f1, f2, change, _antiresonance(seen, f0, f2 - f1))


def measured_figures(spectrum: Spectrum) -> tuple[Figures | None, str]:
    """Figures of a recording, or why there are none."""
    try:
        return figures(spectrum), ""
    except NoResonance as missing:
        return None, missing.reason


def _fine_grid(spectrum: Spectrum) -> NDArray[np.float64]:
    """The recorded frequencies with `_FINE` - 1 more between each two."""
    points = np.arange(len(spectrum.frequency))
    fine = np.linspace(0.0, points[-1], points[-1] * _FINE + 1)
    return np.asarray(np.interp(fine, points, spectrum.frequency))


def _resonance(spectrum: Spectrum, near: float | None) -> tuple[float, float, float, float]:
    """Numbers f0, Z_min, f1, f2 of the deepest resonance or of the one nearest to `near`."""
    at = spectrum.interpolant()
    grid = _fine_grid(spectrum)
    magnitude = np.abs(at(grid))
    # The prominence of a peak of -ln|Z| is the rise of |Z| on the lesser side before it falls below the minimum.
    minima, _ = find_peaks(-np.log(magnitude), 0.5 * math.log(2.0))
    candidates = tuple(float(frequency) for frequency in grid[minima])
    lowest = int(np.argmin(magnitude))
    at_lowest, least = float(grid[lowest]), float(magnitude[lowest])
    found = f"{grid[lowest]:.9g} Hz ({magnitude[lowest]:.4g} ohm)"
    bounds = f"the band {grid[0]:.9g} to {grid[-1]:.9g} Hz"
    others = "; complete resonances: " + ", ".join(f"{c:.9g} Hz" for c in candidates) if candidates else ""
    if near is not None:
        if not len(minima):
            raise NoResonance(f"no complete resonance in {bounds}; the smallest |Z| is at {found}",
                              frequency=at_lowest, impedance=least)
        index = int(minima[np.argmin(np.abs(grid[minima] - near))])
    elif lowest in (0, len(grid) - 1):
        raise NoResonance(f"the smallest |Z| is at an edge of {bounds}, {found}{others}",
                          frequency=at_lowest, impedance=least, candidates=candidates)
    elif lowest not in minima:
        raise NoResonance(f"a half-power point of the resonance at {found} lies outside {bounds}{others}",
                          frequency=at_lowest, impedance=least, candidates=candidates)
    else:
        index = lowest
    f0 = _extremum(at, grid, index, sign=1.0)
    z_min = float(np.abs(at(f0)))

    def excess(frequency: float) -> float:
        return float(np.abs(at(frequency))) - math.sqrt(2.0) * z_min

    half = math.sqrt(2.0) * z_min
    # If a resonance is narrower than the grid, both points are next to f0, which then closes the bracket.
    below = int(np.flatnonzero((magnitude >= half) & (grid < f0))[-1])
    above = int(np.flatnonzero((magnitude >= half) & (grid > f0))[0])
    f1 = float(brentq(excess, grid[below], min(grid[below + 1], f0), xtol=1e-12 * f0))
    f2 = float(brentq(excess, max(grid[above - 1], f0), grid[above], xtol=1e-12 * f0))
    return f0, z_min, f1, f2


def _extremum(at: Interpolant, grid: NDArray[np.float64], index: int, *, sign: float) -> float:
    """The frequency of the minimum (`sign` 1) or maximum (-1) of |Z| about `grid[index]`."""
    centre, half = float(grid[index]), float(grid[index + 1] - grid[index - 1])
    found = minimize_scalar(lambda x: sign * math.log(float(np.abs(at(centre + x * half)))),
                            bounds=((grid[index - 1] - centre) / half, (grid[index + 1] - centre) / half),
                            method="bounded", options={"xatol": 1e-9})
    return centre + float(found.x) * half


def _antiresonance(spectrum: Spectrum, f0: float, bandwidth: float) -> Antiresonance | None:
    """The largest |Z| above `f0` and its coupling factors; None if it is at the edge of the band."""
    at = spectrum.interpolant()
    grid = _fine_grid(spectrum)
    grid = grid[grid >= f0]
    magnitude = np.abs(at(grid))
    index = int(np.argmax(magnitude))
    if index in (0, len(grid) - 1):
        return None
    fa = _extremum(at, grid, index, sign=-1.0)
    z_max = float(np.abs(at(fa)))
    return Antiresonance(fa, z_max, thickness_coupling(f0, fa), effective_coupling(f0, fa),
                         _circuit_capacitance(spectrum, f0, fa, bandwidth))


def thickness_coupling(resonance: float, antiresonance: float) -> float:
    """Coupling factor kt of a plate's thickness mode from its resonance and antiresonance (hertz).

    kt^2 = (pi / 2) (fr / fa) tan((pi / 2) (fa - fr) / fa), IEEE Std 176-1987. Written for the lossless series and
    parallel frequencies; the extrema of |Z| stand for them to order 1 / (k Q)^2.
    """
    ratio = _ratio(resonance, antiresonance)
    return math.sqrt(0.5 * math.pi * ratio * math.tan(0.5 * math.pi * (1.0 - ratio)))


def effective_coupling(resonance: float, antiresonance: float) -> float:
    """The effective coupling factor of any mode, k^2 = (fa^2 - fr^2) / fa^2 (IEEE Std 176-1987)."""
    return math.sqrt(1.0 - _ratio(resonance, antiresonance) ** 2)


def _ratio(resonance: float, antiresonance: float) -> float:
    if not 0.0 < resonance < antiresonance:
        raise ValueError(f"the antiresonance must lie above the resonance, received {antiresonance} and {resonance} Hz")
    return resonance / antiresonance


def _circuit_capacitance(spectrum: Spectrum, f0: float, fa: float, bandwidth: float) -> float:
    """Capacitance C0 of a one-mode circuit from the points away from the resonance.

    A lossless one-mode circuit has Im Y / w = C0 (1 + r / (1 - (f / f0)^2)) with r = C1 / C0 = (fa / f0)^2 - 1. The
    median over the points more than five half-power widths from f0 is insensitive to narrow overtones. Points near fa,
    where the bracket vanishes and the loss dominates, are left out.
    """
    away = np.abs(spectrum.frequency - f0) > 5.0 * bandwidth
    with np.errstate(divide="ignore"):
        bracket = 1.0 + ((fa / f0) ** 2 - 1.0) / (1.0 - (spectrum.frequency / f0) ** 2)
    usable = away & (np.abs(bracket) > 0.2)
    if not np.any(usable):
        return math.nan
    capacitance = spectrum.admittance.imag / (2.0 * np.pi * spectrum.frequency)
    return float(np.median(capacitance[usable] / bracket[usable]))
