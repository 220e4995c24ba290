"""Figures of merit of a spectrum: resonance, quality factor, coupling.

Definitions (docs/conventions.md): f0 is the frequency of the smallest |Z|, Z_min = |Z(f0)|, and Q = f0 / (f2 - f1) with
f1 and f2 the half-power frequencies about f0, where |Y| = |Y|max / sqrt(2). All are taken on
:meth:`workbench.results.spectrum.Spectrum.interpolant`, not on the recorded points. Fits of a circuit
(`workbench.results.circuit`) and of a pole (`workbench.results.pole`) estimate the parameters of the device.

The dip of |Z| shows the resonance only if its figure of merit M = Q k^2 / (1 - k^2) is large: at M = 15 its width gives
Q within 1 %, at 3 within 16 %, at 1 half of Q. The conductance Re Y of a branch has its peak at fs and a half width of
fs / Q for any static capacitance, so :class:`Conductance` has both, and M.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

from workbench.files.quantities import frequency_text
from workbench.results.coupling import Plate, effective_coupling
from workbench.results.peaks import find_peaks
from workbench.results.spectrum import Spectrum, WithSpectrum, spectrum_of

Interpolant = Callable[..., NDArray[np.complex128]]

#: Points of the search grid per recorded interval. It only has to bracket the extrema, which are then refined; more
#: points find narrower resonances.
_FINE = 32

#: Least points of that grid within two bandwidths that resolve a peak of Re Y. Halved, the peak of a resonance without
#: loss lies between them and its M is wrong.
_RESOLVED = 16

#: Figure of merit below which the dip of |Z| shows neither the frequency nor the Q of a resonance: Q by the dip is 2 %
#: low there. Doubled, dips that are accurate to 0.5 % count as weak.
WEAK = 10.0

#: Meanings of the figures by their heading in reports; the glossary has them too.
MEANINGS = {
    "f0": 'frequency of the smallest |Z|: the resonance. In a row "by the conductance", that of the largest Re Y.',
    "Z_min": "the smallest |Z|, at f0.",
    "Q": "quality factor: f0 over the width of the resonance at which |Y| has fallen by the square root of 2. In a row "
         '"by the conductance", over the width at which Re Y has fallen to half, for any static capacitance.',
    "k_eff": "effective coupling factor of this mode, k^2 = 1 - (f0 / fa)^2 (IEEE Std 176); fa is the frequency of the "
             'largest |Z| above f0, in a row "by the conductance" of the largest Re Z. Empty if the band lacks it.',
    "kt": "thickness coupling factor from f0 and fa (IEEE Std 176): only of the thickness mode of a bare plate that is "
          "at least 10 times as wide as thick, with electrodes all over its faces.",
    "kp": "planar coupling factor from f0 and fa by the resonance equation of a thin disc, with Poisson's ratio of its "
          "material: only of the first radial mode of a bare disc that is at least 10 times as wide as thick.",
}


class NoResonance(ValueError):
    """No resonance with both its half-power points inside the band.

    ``frequency`` and ``impedance`` are of the smallest |Z| in the band (Hz, ohm); ``candidates`` are the frequencies of
    resonances with both half-power points in the band, for `near` or `band`.
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
    """The maximum of |Z| above f0, and the mode's coupling factors.

    ``frequency`` is in Hz, ``z_max`` in ohm; ``k_effective`` is by :attr:`Figures.pair`. The thickness coupling factor
    ``kt`` and the planar one ``kp`` need the chip (:func:`named`); they are NaN except for the thickness mode of a bare
    plate and the first radial mode of a bare thin disc. ``circuit_capacitance`` (farad) is the parallel one of a
    circuit of this mode alone: a start for a fit, not the static capacitance, which the modes outside the window hide
    (`workbench.fem.capacitance` has that of a model).
    """

    frequency: float
    z_max: float
    k_effective: float
    circuit_capacitance: float
    kt: float = math.nan
    kp: float = math.nan


@dataclass(frozen=True)
class Conductance:
    """A resonance by its conductance Re Y.

    ``frequency`` (Hz) is of the peak, the series resonance fs. ``q`` is fs over the width at half of the peak, NaN if
    Re Y does not fall to half on both sides. ``parallel`` (Hz) is of the peak of Re Z above, NaN without one. ``merit``
    is |Re Y / Im Y| at fs, which is Q k^2 / (1 - k^2) of an isolated resonance. Im Y of overlapping resonances is not
    that of a capacitance; so ``merit`` is Re Y over the mean of |Y| / f in the band, times fs, if that is larger and at
    least 10.
    """

    frequency: float
    q: float
    parallel: float
    merit: float


@dataclass(frozen=True)
class Figures:
    """Figures of merit of one resonance: frequencies in Hz, impedance in ohm.

    ``f0``, ``z_min`` and ``q`` are of the dip of |Z|. ``q_step_change`` is the relative change of Q if every second
    point is omitted: if small, the step does not affect Q; if infinite, twice the step loses the resonance.
    ``antiresonance`` is None if |Z| has no maximum above f0 inside the band, ``conductance`` if Re Y has no peak there.
    If :attr:`is_weak`, the conductance has the frequency and the Q of the resonance.
    """

    f0: float
    z_min: float
    q: float
    f1: float
    f2: float
    q_step_change: float
    antiresonance: Antiresonance | None
    conductance: Conductance | None = None

    @property
    def is_weak(self) -> bool:
        """Whether the figure of merit M is below :data:`WEAK`. Then the dip of |Z| shows neither the frequency nor the
        Q of the resonance."""
        return self.conductance is not None and self.conductance.merit < WEAK

    @property
    def pair(self) -> tuple[float, float] | None:
        """Series and parallel resonance (Hz); None if one is outside the band. They are at the smallest and the largest
        |Z|, or the largest Re Y and Re Z of a weak resonance."""
        if self.conductance is not None and self.is_weak:
            found = self.conductance.frequency, self.conductance.parallel
            return None if math.isnan(found[1]) else found
        return None if self.antiresonance is None else (self.f0, self.antiresonance.frequency)

    @property
    def weakness(self) -> str:
        """A sentence about a weak resonance and its right figures, else ""."""
        if self.conductance is None or not self.is_weak:
            return ""
        right = self.conductance
        believed = "the fitted branch of the circuit has these" if math.isnan(right.q) else (
            f"these are {right.frequency / 1e6:.4f} MHz and {right.q:.4g}, by the conductance Re Y")
        return (f"the resonance at {right.frequency / 1e6:.4f} MHz is weak (Q k^2 / (1 - k^2) = {right.merit:.2g}, "
                f"below {WEAK:g}): the smallest |Z| ({self.f0 / 1e6:.4f} MHz) and its width (Q {self.q:.4g}) do not "
                f"show its frequency and its Q; {believed}")

    def count_within(self, frequency: NDArray[np.float64]) -> int:
        """The number of frequencies (n,) Hz within the half-power width."""
        return int(np.count_nonzero((frequency >= self.f1) & (frequency <= self.f2)))


def figures(
    spectrum: Spectrum | WithSpectrum, *, near: float | None = None, band: tuple[float, float] | None = None
) -> Figures:
    """Figures of merit of the deepest resonance, or the nearest to `near`.

    `near` is in Hz. `spectrum` may be a result that has one. `band` (low, high) in hertz excludes all other points,
    also for the half-power points. A minimum counts as a resonance if |Z| rises by sqrt(2) on both sides before it
    falls below that minimum again.

    Raises:
        NoResonance: the smallest |Z| lies at an edge of the band, or a half-power point lies outside it; it has the
            frequency of the minimum.
        ValueError: the band has fewer than two points.
    """
    whole = spectrum_of(spectrum)
    seen = whole if band is None else whole.restricted(*band)
    f0, z_min, f1, f2 = _resonance(seen, near)
    try:
        coarse = Spectrum(seen.frequency[::2], seen.impedance[::2])
        _, _, low, high = _resonance(coarse, f0)
        change = abs((high - low) / (f2 - f1) - 1.0)
    except ValueError:  # NoResonance, or fewer than two points: in both cases the resonance is lost
        change = math.inf
    found = Figures(f0, z_min, f0 / (f2 - f1), f1, f2, change, _antiresonance(seen, f0, f2 - f1),
                    _conductance(seen, f0, f2 - f1))
    if found.antiresonance is None or found.pair is None:
        return found
    return replace(found, antiresonance=replace(found.antiresonance, k_effective=effective_coupling(*found.pair)))


def named(merit: Figures, plate: Plate | None) -> Figures:
    """The figures with kt or kp, if the mode has one."""
    if merit.antiresonance is None or merit.pair is None or plate is None:
        return merit
    return replace(merit, antiresonance=replace(
        merit.antiresonance, kt=plate.thickness_coupling(*merit.pair), kp=plate.planar_coupling(*merit.pair)))


def measured_figures(spectrum: Spectrum, plate: Plate | None = None) -> tuple[Figures | None, str]:
    """Figures of a spectrum with the coupling factors of a bare `plate`. None, and the reason, without a resonance."""
    try:
        return named(figures(spectrum), plate), ""
    except NoResonance as missing:
        return None, missing.reason


def _fine_grid(spectrum: Spectrum) -> NDArray[np.float64]:
    points = np.arange(len(spectrum.frequency))
    fine = np.linspace(0.0, points[-1], points[-1] * _FINE + 1)
    return np.asarray(np.interp(fine, points, spectrum.frequency))


def _resonance(spectrum: Spectrum, near: float | None) -> tuple[float, float, float, float]:
    """f0, Z_min, f1, f2 of the deepest resonance, or the nearest."""
    at = spectrum.interpolant()
    grid = _fine_grid(spectrum)
    magnitude = np.abs(at(grid))
    # The prominence of a peak of -ln|Z| is the rise of |Z| on the lesser side before it falls below the minimum.
    minima, _ = find_peaks(-np.log(magnitude), 0.5 * math.log(2.0))
    candidates = tuple(float(frequency) for frequency in grid[minima])
    lowest = int(np.argmin(magnitude))
    at_lowest, least = float(grid[lowest]), float(magnitude[lowest])
    found = f"{frequency_text(grid[lowest])} ({magnitude[lowest]:.4g} ohm)"
    bounds = f"the band {frequency_text(*grid[[0, -1]])}"
    others = ("; resonances with both half-power points in the band: " + ", ".join(map(frequency_text, candidates))
              if candidates else "")
    if near is not None:
        if not len(minima):
            raise NoResonance(f"no resonance has both half-power points in {bounds}; the smallest |Z| is at {found}",
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
    """The frequency of the minimum (`sign` 1) or maximum (-1) near `grid[index]`."""
    centre, half = float(grid[index]), float(grid[index + 1] - grid[index - 1])
    found = minimize_scalar(lambda x: sign * math.log(float(np.abs(at(centre + x * half)))),
                            bounds=((grid[index - 1] - centre) / half, (grid[index + 1] - centre) / half),
                            method="bounded", options={"xatol": 1e-9})
    return centre + float(found.x) * half


def _antiresonance(spectrum: Spectrum, f0: float, bandwidth: float) -> Antiresonance | None:
    """The largest |Z| above `f0`; None if at the band's edge."""
    at = spectrum.interpolant()
    grid = _fine_grid(spectrum)
    grid = grid[grid >= f0]
    magnitude = np.abs(at(grid))
    index = int(np.argmax(magnitude))
    if index in (0, len(grid) - 1):
        return None
    fa = _extremum(at, grid, index, sign=-1.0)
    return Antiresonance(fa, float(np.abs(at(fa))), effective_coupling(f0, fa),
                         _circuit_capacitance(spectrum, f0, fa, bandwidth))


def _conductance(spectrum: Spectrum, f0: float, bandwidth: float) -> Conductance | None:
    """The largest Re Y within a bandwidth of `f0`. None if it is at the edge, or if the grid does not resolve it."""
    at = spectrum.interpolant()
    grid = _fine_grid(spectrum)
    impedance = at(grid)
    conductance = (1.0 / impedance).real
    near = np.flatnonzero(np.abs(grid - f0) <= bandwidth)
    if near.size < _RESOLVED:
        return None
    index = int(near[np.argmax(conductance[near])])
    if index in (near[0], near[-1]) or conductance[index] <= 0.0:
        return None

    def parabola(values: NDArray[np.float64], peak: int) -> float:
        """The top (Hz) of a parabola through three points at a maximum."""
        curve = np.polyfit(grid[peak - 1:peak + 2] - grid[peak], values[peak - 1:peak + 2], 2)
        return float(grid[peak] - 0.5 * curve[1] / curve[0]) if curve[0] < 0.0 else float(grid[peak])

    fs = parabola(conductance, index)
    admittance = complex(1.0 / at(np.array([fs]))[0])
    below, above = (np.flatnonzero(side <= 0.5 * admittance.real)
                    for side in (conductance[:index], conductance[index:]))
    q = math.nan
    if below.size and above.size:
        low, high = (float(np.interp(0.5 * admittance.real, conductance[ends], grid[ends]))
                     for ends in ([below[-1], below[-1] + 1], [index + above[0], index + above[0] - 1]))
        q = fs / (high - low)
    resistance = impedance.real[index:]
    top = int(np.argmax(resistance))
    parallel = math.nan if top in (0, resistance.size - 1) else parabola(impedance.real, index + top)
    alone = abs(admittance.real / admittance.imag) if admittance.imag else math.inf
    mean = math.exp(float(np.mean(np.log(np.abs(spectrum.admittance) / spectrum.frequency))))
    in_band = admittance.real / (fs * mean)
    return Conductance(fs, q, parallel, max(alone, in_band) if max(alone, in_band) >= WEAK else alone)


def _circuit_capacitance(spectrum: Spectrum, f0: float, fa: float, bandwidth: float) -> float:
    """C0 of a one-mode circuit, from points away from the resonance. A lossless one-mode circuit has Im Y / w = C0 (1 +
    r / (1 - (f / f0)^2)) with r = C1 / C0 = (fa / f0)^2 - 1. The median over the points more than five half-power
    widths from f0 is insensitive to narrow overtones. Points near fa, where the bracket vanishes and the loss
    dominates, are left out."""
    away = np.abs(spectrum.frequency - f0) > 5.0 * bandwidth
    with np.errstate(divide="ignore"):
        bracket = 1.0 + ((fa / f0) ** 2 - 1.0) / (1.0 - (spectrum.frequency / f0) ** 2)
    usable = away & (np.abs(bracket) > 0.2)
    if not np.any(usable):
        return math.nan
    capacitance = spectrum.admittance.imag / (2.0 * np.pi * spectrum.frequency)
    return float(np.median(capacitance[usable] / bracket[usable]))
