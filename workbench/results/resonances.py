"""Several resonances of one spectrum, fitted together as the branches of a circuit (`workbench.results.circuit`).

The fit starts from the peaks of the conductance Re Y, a plain circuit first. Whatever is added to it afterwards has to
earn its place by halving what is left: phases and a loss tangent, with a resonance beyond either end of the band; one
more resonance within it. Two resonances closer than a bandwidth are not told apart: a second one is said, not listed.
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

#: Part of the weighted squares by degrees of freedom that an addition to the circuit may leave. Doubled, anything
#: stays; halved, weak neighbours are not found.
EARNED = 0.5

#: Rise of ln Re Y on both sides of a peak, and of Re Y in standard deviations of noise. Doubled, shoulders are missed;
#: halved, ripple and noise count as resonances.
RISE, ABOVE_NOISE = 0.05, 12.0

#: Relative standard error of Q and of C1 above which a resonance is not determined. Doubled, the interval of 95 % of Q
#: holds zero.
DETERMINED = 0.5

#: Phase (rad) of a branch beyond which it stands for something else than a resonance.
PHASE = 1.0

#: Most resonances of a band.
MOST = 20

#: Where nothing more is added: rms of ln Z, where no noise is stated, and reduced chi-square by the noise.
#: Doubled, a resonance that changes Z by 1 % is not looked for; halved, a fit takes twice the time.
ENOUGH, ENOUGH_NOISE = 5e-3, 1.5

#: Part of the band that a resonance may be wide. Doubled, the background of other modes is called a resonance.
WIDEST = 0.25


def fit_resonances(
    spectrum: Spectrum | WithSpectrum, count: int | None = None, *,
    band: tuple[float | str, float | str] | None = None,
) -> CircuitFit:
    """Fit the resonances of a spectrum, all together, as the branches of one circuit.

    The result has f, Q, k_eff, R, L and C of each with standard errors. Resonances are those that stand out of `band`
    (Hz), or the `count` that stand out most. The ``findings`` name what lies closer than a bandwidth.

    Raises:
        NoResonance: none stands out.
        InputError: `band` or `count` cannot be used, or the spectrum is not that of a passive device.
        ValueError: too few points, a fit that does not converge, or `count` resonances that are not there or not
            resolved.
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
        beside = _with_surroundings(seen, start)  # a plain circuit may not converge where it lacks much
        if beside is None:
            raise
        found = beside
    else:
        if _wanting(found):
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
        raise ValueError(f"{count} resonances were asked for, {len(listed(found))} can be told apart"
                         + "".join(f"; {text}" for text in findings))
    if not listed(found):
        raise _nothing(seen)
    return found.fit(listed(found), tuple(findings))


def resonances_of(spectrum: Spectrum) -> CircuitFit | None:
    """The resonances of a spectrum, None where none stands out or no circuit fits."""
    try:
        return fit_resonances(spectrum)
    except ValueError:
        return None


def listed(found: SolvedCircuit) -> list[int]:
    """The branches that are resonances of the band, by index.

    A branch beyond the band stands for modes there. One whose bandwidth exceeds its frequency is a resistor in
    parallel: the loss of the capacitance and of modes beyond the band.
    """
    low, high = float(found.spectrum.frequency[0]), float(found.spectrum.frequency[-1])
    return [k for k, (at, width) in enumerate(zip(found.circuit.frequencies, found.circuit.bandwidths, strict=True))
            if k not in found.freedom.held and low < at < high and width < at]


def unresolved(found: SolvedCircuit) -> str | None:
    """A sentence about two neighbours that are closer than the mean of their bandwidths; None if there are none."""
    frequencies, widths = found.circuit.frequencies, found.circuit.bandwidths
    ordered = sorted(listed(found), key=lambda k: float(frequencies[k]))
    for one, other in pairwise(ordered):
        apart, width = frequencies[other] - frequencies[one], 0.5 * (widths[one] + widths[other])
        if apart < width:
            return (f"about {0.5e-6 * (frequencies[one] + frequencies[other]):.4f} MHz there is more than one "
                    f"resonance, and within a bandwidth of {1e-3 * width:.3g} kHz they are not resolved: f, Q and "
                    "k_eff there are those of all of them together")
    return None


def conductance_peaks(spectrum: Spectrum) -> list[tuple[float, float, float]]:
    """Frequency (Hz), Q and series capacitance (F) of the peaks of Re Y, that which stands out most first."""
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
    """Relative standard deviation (n,) of a point: the stated one, or that of what a smooth curve leaves."""
    if spectrum.uncertainty is not None:
        return np.asarray(spectrum.uncertainty / spectrum.magnitude)
    return np.full(len(spectrum.frequency), scatter(spectrum))


def _nothing(spectrum: Spectrum) -> NoResonance:
    """The error that no resonance stands out."""
    magnitude, lowest = spectrum.magnitude, int(np.argmin(spectrum.magnitude))
    return NoResonance(
        f"no resonance stands out of the conductance from {spectrum.frequency[0]:.9g} to "
        f"{spectrum.frequency[-1]:.9g} Hz", frequency=float(spectrum.frequency[lowest]),
        impedance=float(magnitude[lowest]))


def _start(spectrum: Spectrum, count: int | None) -> BranchCircuit:
    """A plain circuit of the peaks; its capacitances by linear least squares of the relative error of Y."""
    peaks = conductance_peaks(spectrum)[: MOST if count is None else count]
    if not peaks:
        raise _nothing(spectrum)
    static = float(np.median(np.abs(spectrum.admittance) / spectrum.frequency)) / (2.0 * np.pi)
    branches = [[math.log(at), math.log(q), math.log(guess), 0.0] for at, q, guess in peaks]
    start = BranchCircuit(np.array(branches), np.array([math.log(static), 0.0, 0.0]))
    return start.with_amplitudes(spectrum, losses=False)


# --------------------------------------------------------------------------------------------------------------------


def _wanting(found: SolvedCircuit) -> bool:
    """Whether more is left than noise, or than matters."""
    if found.spectrum.uncertainty is not None:
        return found.left > ENOUGH_NOISE
    noise = scatter(found.spectrum)
    return found.left > max(0.5 * ENOUGH**2, ENOUGH_NOISE * noise**2)


def _attempt(spectrum: Spectrum, circuit: BranchCircuit, freedom: Freedom) -> SolvedCircuit | None:
    try:
        return solved(spectrum, circuit.with_amplitudes(spectrum, losses=freedom.losses), freedom)
    except ValueError:
        return None


def _better(found: SolvedCircuit, other: SolvedCircuit | None) -> SolvedCircuit:
    """The other one if it leaves less than :data:`EARNED` of what is left."""
    return found if other is None or other.left > EARNED * found.left else other


def _with_surroundings(spectrum: Spectrum, circuit: BranchCircuit) -> SolvedCircuit | None:
    """The circuit with losses of coupling and capacitance, and with a resonance beyond either end of the band."""
    low, high = float(spectrum.frequency[0]), float(spectrum.frequency[-1])
    width = float(np.median(circuit.bandwidths))
    reach, first = min(width, 0.5 * (high - low), 0.25 * low), len(circuit.branches)
    for at in (low - reach, high + reach):
        circuit = circuit.with_branch(at, width)
    held = {first: (max(low - (high - low), 0.5 * low), low), first + 1: (high, high + (high - low))}
    return _attempt(spectrum, circuit, Freedom(losses=True, held=held))


def _one_more(found: SolvedCircuit, *, needed: bool) -> SolvedCircuit | None:
    """The circuit with one more resonance where most is left, if it earns its place or is `needed`.

    It starts from where most is left, and from the two halves of the resonance next to it.
    """
    if not needed and not _wanting(found):
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
    # Not if one that was listed left the band, or became a loss in parallel.
    kept = [each for each in tried if _sound(each) and len(listed(each)) > len(places)
            and (needed or each.left < EARNED * found.left)]
    return min(kept, key=lambda each: each.left, default=None)


def _sound(found: SolvedCircuit) -> bool:
    """Whether the last branch is a resonance of the band: not too wide, determined, and with the phase of one."""
    last = len(found.circuit.branches) - 1
    low, high = float(found.spectrum.frequency[0]), float(found.spectrum.frequency[-1])
    at, width = float(found.circuit.frequencies[last]), float(found.circuit.bandwidths[last])
    return (low < at < high and width < WIDEST * (high - low) and abs(float(found.circuit.branches[last, 3])) < PHASE
            and _exact(found, last))


def _exact(found: SolvedCircuit, k: int) -> bool:
    errors = found.errors()[4 * k:4 * k + 4]
    return bool(np.all(errors[1:3] < DETERMINED))


def _determined(found: SolvedCircuit) -> SolvedCircuit:
    """The circuit without the resonances that are not determined, the worst one first."""
    while True:
        loose = [k for k in listed(found) if not _exact(found, k)]
        if not loose or len(listed(found)) == 1:
            return found
        worst = max(loose, key=lambda k: float(np.max(found.errors()[4 * k + 1:4 * k + 3])))
        held = {k - (k > worst): ends for k, ends in found.freedom.held.items()}
        found = solved(found.spectrum, found.circuit.without(worst), replace(found.freedom, held=held))
