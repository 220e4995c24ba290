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
from workbench.files.quantities import frequency_text
from workbench.results.band import fitted_points
from workbench.results.circuit import BranchCircuit, CircuitFit, check_passive_spectrum
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
    limit, needed, findings = count or MOST, count is not None, tuple[str, ...]()
    circuit = _with_surroundings(_start(seen, limit))
    while len(listed(circuit)) < limit and (more := _one_more(circuit, needed=needed)):
        if findings := unresolved(more):
            break
        circuit = more
    if not needed:
        circuit = _determined(circuit)
    elif len(listed(circuit)) < limit:
        raise ValueError("; ".join((f"{count} resonances requested, {len(listed(circuit))} resolved", *findings)))
    if not listed(circuit):
        raise _nothing(seen)
    return circuit.fit(listed(circuit), findings)


def resonances_of(spectrum: Spectrum) -> CircuitFit | None:
    """The resonances of a spectrum, or None if the fit fails."""
    try:
        return fit_resonances(spectrum)
    except ValueError:
        return None


def listed(circuit: BranchCircuit) -> list[int]:
    """The branches that are resonances in the band, by index.

    A branch beyond the band represents modes there. One whose bandwidth exceeds its frequency is a resistor in
    parallel: the loss of the capacitance and of modes beyond the band.
    """
    low, high = circuit.spectrum.frequency[[0, -1]]
    at = circuit.frequencies
    inside = (low < at) & (at < high) & (circuit.bandwidths < at)
    return [int(k) for k in np.flatnonzero(inside) if k >= len(circuit.beyond)]


def unresolved(circuit: BranchCircuit) -> tuple[str, ...]:
    """The finding on the first neighbours closer than their mean bandwidth."""
    places = listed(circuit)
    ordered = sorted(zip(circuit.frequencies[places], circuit.bandwidths[places], strict=True))
    for (at, own), (above, other) in pairwise(ordered):
        width = 0.5 * (own + other)
        if above - at < width:
            return (f"about {0.5e-6 * (at + above):.4f} MHz there is more than one resonance within a bandwidth of "
                    f"{1e-3 * width:.3g} kHz, and they are not resolved: f, Q and k_eff there are of all of them "
                    "together",)
    return ()


def conductance_peaks(spectrum: Spectrum) -> Real:
    """Frequency (Hz), Q and series capacitance (F) of conductance peaks (k, 3).

    The most prominent one is first.
    """
    conductance = spectrum.admittance.real
    if not np.max(conductance) > 0.0:
        return np.zeros((0, 3))
    floor = np.maximum(conductance, 1e-6 * float(np.max(conductance)))
    places, prominence = find_peaks(np.log(floor), RISE)
    # The noise of Re Y is about that of |Y|.
    noise = scatter(spectrum) if spectrum.uncertainty is None else spectrum.uncertainty / spectrum.magnitude
    kept = conductance[places] * -np.expm1(-prominence) > ABOVE_NOISE * (noise / spectrum.magnitude)[places]
    places = places[kept][np.argsort(-prominence[kept])]
    at, steps = spectrum.frequency[places], np.gradient(spectrum.frequency)[places]
    q = at / (np.maximum(half_widths(floor, places), 1.0) * steps)
    return np.column_stack([at, q, conductance[places] / (2.0 * math.pi * at * q)])


def _nothing(spectrum: Spectrum) -> NoResonance:
    lowest = int(np.argmin(spectrum.magnitude))
    return NoResonance(
        f"no resonance stands out of the conductance from "
        f"{frequency_text(*spectrum.frequency[[0, -1]])}", frequency=float(spectrum.frequency[lowest]),
        impedance=float(spectrum.magnitude[lowest]))


def _start(spectrum: Spectrum, limit: int) -> BranchCircuit:
    """A plain circuit of at most `limit` peaks."""
    peaks = conductance_peaks(spectrum)[:limit]
    if not len(peaks):
        raise _nothing(spectrum)
    static = float(np.median(np.abs(spectrum.admittance) / spectrum.frequency)) / (2.0 * np.pi)
    return BranchCircuit(spectrum, np.column_stack([np.log(peaks), np.zeros(len(peaks))]),
                         np.array([math.log(static), 0.0, 0.0]))


def _attempt(start: BranchCircuit) -> BranchCircuit:
    """The circuit solved from a start, or the start if that fails."""
    try:
        return start.with_amplitudes().solved()
    except ValueError:
        return start


def _is_incomplete(circuit: BranchCircuit) -> bool:
    """Whether the residual is above the noise and above the relevant size."""
    if circuit.spectrum.uncertainty is not None:
        return circuit.variance > ENOUGH_NOISE
    return circuit.variance > max(0.5 * ENOUGH**2, ENOUGH_NOISE * scatter(circuit.spectrum) ** 2)


def _with_surroundings(start: BranchCircuit) -> BranchCircuit:
    """The plain circuit, or a better one with losses and surroundings.

    The surroundings are two resonances beyond the band's ends. A plain circuit that lacks much may not converge.
    """
    plain = _attempt(start)
    if not _is_incomplete(plain):
        return plain
    low, high = map(float, start.spectrum.frequency[[0, -1]])
    width, band = float(np.median(plain.bandwidths)), high - low
    reach = min(width, 0.5 * band, 0.25 * low)
    ends = (max(low - band, 0.5 * low), low), (high, high + band)
    # The plain circuit moves its branches where modes beyond the band are missing, so that the peaks are a start too.
    wides = [each.with_branch(low - reach, width).with_branch(high + reach, width) for each in (plain, start)]
    wide = min((_attempt(replace(each, branches=np.roll(each.branches, 2, axis=0), has_losses=True, beyond=ends))
                for each in wides), key=lambda each: each.variance)
    if wide.variance <= LARGEST_RATIO * plain.variance and math.isfinite(wide.squares):
        return wide
    return plain if math.isfinite(plain.squares) else plain.solved()


def _one_more(circuit: BranchCircuit, *, needed: bool) -> BranchCircuit | None:
    """The circuit with one more resonance, if it is better or `needed`.

    The fit starts at the largest residual, and from two halves of the nearest resonance.
    """
    places, seen = listed(circuit), circuit.spectrum
    if not places or not (needed or _is_incomplete(circuit)):
        return None
    off = np.abs(np.log(circuit.impedance(seen.frequency)[0] / seen.impedance))
    at = float(seen.frequency[int(np.argmax(np.convolve(off, np.ones(5), "same")))])
    nearest = min(places, key=lambda k: abs(float(circuit.frequencies[k]) - at))
    centre, width = float(circuit.frequencies[nearest]), float(circuit.bandwidths[nearest])
    halves = circuit.branches.copy()
    halves[nearest, 0] = math.log(centre - 0.3 * width)
    starts = circuit.with_branch(at, width), circuit.moved(halves).with_branch(centre + 0.3 * width, width)
    # Reject a circuit in which a listed resonance moved out of the band, or became a loss in parallel.
    limit = math.inf if needed else LARGEST_RATIO * circuit.variance
    better = [each for each in map(_attempt, starts)
              if each.variance < limit and len(listed(each)) > len(places) and _is_sound(each)]
    return min(better, key=lambda each: each.variance, default=None)


def _is_sound(circuit: BranchCircuit) -> bool:
    """Whether the last branch is a resonance in the band. It must be narrow and determined, and have a small phase."""
    last, band = len(circuit.branches) - 1, float(np.ptp(circuit.spectrum.frequency))
    return (last in listed(circuit) and circuit.bandwidths[last] < WIDEST * band
            and abs(float(circuit.branches[last, 3])) < PHASE and _looseness(circuit, last) < DETERMINED)


def _looseness(circuit: BranchCircuit, k: int) -> float:
    """The larger relative standard error of Q and of C1."""
    return float(circuit.errors[k, 1:3].max())


def _determined(circuit: BranchCircuit) -> BranchCircuit:
    """The circuit without undetermined resonances; the worst is removed first."""
    while len(places := listed(circuit)) > 1:
        worst = max(places, key=lambda k: _looseness(circuit, k))
        if _looseness(circuit, worst) < DETERMINED:
            break
        circuit = circuit.moved(np.delete(circuit.branches, worst, axis=0)).solved()
    return circuit
