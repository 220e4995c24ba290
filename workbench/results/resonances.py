"""Several resonances of one spectrum, fitted together (`workbench.results.circuit`).

The fit starts as a plain circuit with the peaks of the conductance Re Y. An addition must halve the residual variance:
phases, a loss tangent and a resonance beyond either end of the band; then one more resonance within it. Two resonances
closer than a bandwidth are not resolved: a finding reports the second one.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.results.band import fitted_points
from workbench.results.circuit import BranchCircuit, CircuitFit, Freedom, SolvedCircuit, check_passive_spectrum, solved
from workbench.results.merit import NoResonance
from workbench.results.peaks import find_peaks, half_widths
from workbench.results.spectrum import Spectrum, WithSpectrum, scatter

Real = NDArray[np.float64]

#: Largest ratio of residual variances after and before an addition to the circuit. Doubled, every addition is accepted;
#: halved, weak neighbours are not found.
LARGEST_RATIO = 0.5

#: Rise of ln Re Y on both sides of a peak, and of Re Y in standard deviations of noise. Doubled, shoulders are missed;
#: halved, ripple and noise count as resonances.
RISE, ABOVE_NOISE = 0.05, 12.0

#: Relative standard error of Q and of C1 above which a resonance is not determined. Doubled, the 95 % interval of Q
#: contains zero.
DETERMINED = 0.5

#: Phase (rad) of a branch above which it is not a resonance.
PHASE = 1.0

#: Most resonances of a band.
MOST = 20

#: Residuals below which a circuit gets no further resonance: rms of ln Z, and reduced chi-square by the noise.
#: Doubled, a resonance that changes Z by 1 % is not found; halved, a fit takes twice the time.
ENOUGH, ENOUGH_NOISE = 5e-3, 1.5

#: Largest width of a resonance relative to the band. Doubled, the background of other modes counts as a resonance.
WIDEST = 0.25


def fit_resonances(
    spectrum: Spectrum | WithSpectrum, count: int | None = None, *,
    band: tuple[float | str, float | str] | None = None,
) -> CircuitFit:
    """Fit the resonances of a spectrum together, as branches of one circuit.

    The result has f, Q, k_eff, R, L and C of each with standard errors. It has all prominent resonances in `band` (Hz),
    or the `count` most prominent ones. The ``findings`` name resonances closer than a bandwidth.

    Raises:
        NoResonance: no resonance is prominent.
        InputError: invalid `band` or `count`, or the spectrum of an active device.
        ValueError: too few points, a fit that does not converge, or fewer than `count` resolved resonances.
    """
    seen = fitted_points(spectrum, band, source="fit_resonances")
    if count is not None and (isinstance(count, bool) or not isinstance(count, int | np.integer)
                              or not 1 <= count <= MOST):
        raise InputError("fit_resonances", "count", count, f"a whole number from 1 to {MOST}")
    check_passive_spectrum(seen, source="fit_resonances")
    start = _start(seen, count)
    try:
        found = solved(seen, start, Freedom())
    except ValueError:
        beside = _with_surroundings(seen, start)  # a plain circuit that lacks much may not converge
        if beside is None:
            raise
        found = beside
    else:
        if _is_incomplete(found):
            found = _better(found, _with_surroundings(seen, found.circuit))
    findings: list[str] = []
    while len(listed(found)) < (MOST if count is None else count):
        more = _one_more(found, needed=count is not None)
        if more is None:
            break
        close = unresolved(more)
        if close is not None:
            findings.append(close)
            break
        found = more
    if count is None:
        found = _determined(found)
    if count is not None and len(listed(found)) < count:
        raise ValueError(f"{count} resonances requested, {len(listed(found))} resolved"
                         + "".join(f"; {text}" for text in findings))
    if not listed(found):
        raise _nothing(seen)
    return found.fit(listed(found), tuple(findings))


def resonances_of(spectrum: Spectrum) -> CircuitFit | None:
    """The resonances of a spectrum, or None if the fit fails."""
    try:
        return fit_resonances(spectrum)
    except ValueError:
        return None


def listed(found: SolvedCircuit) -> list[int]:
    """The branches that are resonances in the band, by index.

    A branch beyond the band represents modes there. One whose bandwidth exceeds its frequency is a resistor in
    parallel: the loss of the capacitance and of modes beyond the band.
    """
    low, high = float(found.spectrum.frequency[0]), float(found.spectrum.frequency[-1])
    return [k for k, (at, width) in enumerate(zip(found.circuit.frequencies, found.circuit.bandwidths, strict=True))
            if k not in found.freedom.confined and low < at < high and width < at]


def unresolved(found: SolvedCircuit) -> str | None:
    """The finding on neighbours closer than their mean bandwidth, or None."""
    frequencies, widths = found.circuit.frequencies, found.circuit.bandwidths
    ordered = sorted(listed(found), key=lambda k: float(frequencies[k]))
    for one, other in pairwise(ordered):
        apart, width = frequencies[other] - frequencies[one], 0.5 * (widths[one] + widths[other])
        if apart < width:
            return (f"about {0.5e-6 * (frequencies[one] + frequencies[other]):.4f} MHz there is more than one "
                    f"resonance within a bandwidth of {1e-3 * width:.3g} kHz, and they are not resolved: f, Q and "
                    "k_eff there are of all of them together")
    return None


def conductance_peaks(spectrum: Spectrum) -> list[tuple[float, float, float]]:
    """Frequency (Hz), Q and series capacitance (F) of peaks of Re Y. The most prominent one is first."""
    conductance = spectrum.admittance.real
    if not np.max(conductance) > 0.0:
        return []
    # The noise of Re Y is about that of |Y|.
    noise = _noise(spectrum) / spectrum.magnitude
    floor = np.maximum(conductance, 1e-6 * float(np.max(conductance)))
    places, prominence = find_peaks(np.log(floor), RISE)
    rises = conductance[places] * -np.expm1(-prominence)
    kept = rises > ABOVE_NOISE * noise[places]
    places, prominence = places[kept], prominence[kept]
    widths = half_widths(floor, places)
    steps = np.gradient(spectrum.frequency)
    peaks = []
    for k in np.argsort(-prominence):
        at = float(spectrum.frequency[places[k]])
        q = at / float(max(widths[k], 1.0) * steps[places[k]])
        peaks.append((at, q, float(conductance[places[k]]) / (2.0 * math.pi * at * q)))
    return peaks


def _noise(spectrum: Spectrum) -> Real:
    """Relative standard deviation (n,) of a point: stated, or from the scatter."""
    if spectrum.uncertainty is not None:
        return np.asarray(spectrum.uncertainty / spectrum.magnitude)
    return np.full(len(spectrum.frequency), scatter(spectrum))


def _nothing(spectrum: Spectrum) -> NoResonance:
    magnitude, lowest = spectrum.magnitude, int(np.argmin(spectrum.magnitude))
    return NoResonance(
        f"no resonance stands out of the conductance from {spectrum.frequency[0]:.9g} to "
        f"{spectrum.frequency[-1]:.9g} Hz", frequency=float(spectrum.frequency[lowest]),
        impedance=float(magnitude[lowest]))


def _start(spectrum: Spectrum, count: int | None) -> BranchCircuit:
    """A plain circuit of the peaks. Its capacitances minimise the relative error of Y."""
    peaks = conductance_peaks(spectrum)[: MOST if count is None else count]
    if not peaks:
        raise _nothing(spectrum)
    static = float(np.median(np.abs(spectrum.admittance) / spectrum.frequency)) / (2.0 * np.pi)
    branches = [[math.log(at), math.log(q), math.log(guess), 0.0] for at, q, guess in peaks]
    start = BranchCircuit(np.array(branches), np.array([math.log(static), 0.0, 0.0]))
    return start.with_amplitudes(spectrum, losses=False)


# --------------------------------------------------------------------------------------------------------------------


def _is_incomplete(found: SolvedCircuit) -> bool:
    """Whether the residual is above the noise and above the relevant size."""
    if found.spectrum.uncertainty is not None:
        return found.variance > ENOUGH_NOISE
    noise = scatter(found.spectrum)
    return found.variance > max(0.5 * ENOUGH**2, ENOUGH_NOISE * noise**2)


def _attempt(spectrum: Spectrum, circuit: BranchCircuit, freedom: Freedom) -> SolvedCircuit | None:
    try:
        return solved(spectrum, circuit.with_amplitudes(spectrum, losses=freedom.losses), freedom)
    except ValueError:
        return None


def _better(found: SolvedCircuit, other: SolvedCircuit | None) -> SolvedCircuit:
    """The `other` circuit if it reduces the residual variance enough (:data:`LARGEST_RATIO`)."""
    return found if other is None or other.variance > LARGEST_RATIO * found.variance else other


def _with_surroundings(spectrum: Spectrum, circuit: BranchCircuit) -> SolvedCircuit | None:
    """The circuit with losses and two resonances beyond the band's ends."""
    low, high = float(spectrum.frequency[0]), float(spectrum.frequency[-1])
    width = float(np.median(circuit.bandwidths))
    reach, first = min(width, 0.5 * (high - low), 0.25 * low), len(circuit.branches)
    for at in (low - reach, high + reach):
        circuit = circuit.with_branch(at, width)
    confined = {first: (max(low - (high - low), 0.5 * low), low), first + 1: (high, high + (high - low))}
    return _attempt(spectrum, circuit, Freedom(losses=True, confined=confined))


def _one_more(found: SolvedCircuit, *, needed: bool) -> SolvedCircuit | None:
    """The circuit with one more resonance, if it is better or `needed`. The fit starts at the largest residual, and
    from two halves of the nearest resonance."""
    if not needed and not _is_incomplete(found):
        return None
    spectrum, circuit = found.spectrum, found.circuit
    off = np.abs(np.log(circuit.impedance(spectrum.frequency) / spectrum.impedance))
    at = float(spectrum.frequency[int(np.argmax(np.convolve(off, np.ones(5), "same")))])
    places = listed(found)
    if not places:
        return None
    nearest = places[int(np.argmin(np.abs(circuit.frequencies[places] - at)))]
    centre, width = float(circuit.frequencies[nearest]), float(circuit.bandwidths[nearest])
    halves = circuit.branches.copy()
    halves[nearest, 0] = math.log(centre - 0.3 * width)
    split = BranchCircuit(halves, circuit.rest).with_branch(centre + 0.3 * width, width)
    starts = [circuit.with_branch(at, width), split]
    tried = [each for each in (_attempt(spectrum, start, found.freedom) for start in starts) if each is not None]
    # Reject a circuit in which a listed resonance moved out of the band, or became a loss in parallel.
    kept = [each for each in tried if _sound(each) and len(listed(each)) > len(places)
            and (needed or each.variance < LARGEST_RATIO * found.variance)]
    return min(kept, key=lambda each: each.variance, default=None)


def _sound(found: SolvedCircuit) -> bool:
    """Whether the last branch is a resonance in the band. It must be narrow and determined, and have a small phase."""
    last = len(found.circuit.branches) - 1
    low, high = float(found.spectrum.frequency[0]), float(found.spectrum.frequency[-1])
    at, width = float(found.circuit.frequencies[last]), float(found.circuit.bandwidths[last])
    return (low < at < high and width < WIDEST * (high - low) and abs(float(found.circuit.branches[last, 3])) < PHASE
            and _exact(found, last))


def _exact(found: SolvedCircuit, k: int) -> bool:
    errors = found.errors()[4 * k:4 * k + 4]
    return bool(np.all(errors[1:3] < DETERMINED))


def _determined(found: SolvedCircuit) -> SolvedCircuit:
    """The circuit without undetermined resonances; the worst is removed first."""
    while True:
        loose = [k for k in listed(found) if not _exact(found, k)]
        if not loose or len(listed(found)) == 1:
            return found
        worst = max(loose, key=lambda k: float(np.max(found.errors()[4 * k + 1:4 * k + 3])))
        confined = {k - (k > worst): ends for k, ends in found.freedom.confined.items()}
        found = solved(found.spectrum, found.circuit.without(worst), replace(found.freedom, confined=confined))
