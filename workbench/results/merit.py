"""Figures of merit of a spectrum: resonance, quality factor, coupling, equivalent circuit.

Definitions (docs/conventions.md): f0 is the frequency of the smallest |Z|, Z_min = |Z(f0)|, and Q = f0 / (f2 - f1) with
f1 and f2 the half-power frequencies about f0, where |Y| = |Y|max / sqrt(2). All are taken on
:meth:`workbench.results.spectrum.Spectrum.interpolant`, not on the recorded points. The fits of :func:`fit_resonance`
estimate other quantities (the pole, or the circuit, behind the curve), so they carry their method's name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, least_squares, minimize_scalar

from workbench.results.brief import Brief
from workbench.results.spectrum import Spectrum, WithSpectrum, spectrum_of

Interpolant = Callable[..., NDArray[np.complex128]]

#: Points of the search grid per recorded interval. It only has to bracket the extrema, which are then refined; more
#: points find narrower resonances.
_FINE = 32


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
    from scipy.signal import find_peaks  # a second to import, for one function

    at = spectrum.interpolant()
    grid = _fine_grid(spectrum)
    magnitude = np.abs(at(grid))
    # The prominence of a peak of -ln|Z| is the rise of |Z| on the lesser side before it falls below the minimum.
    minima, _ = find_peaks(-np.log(magnitude), prominence=0.5 * math.log(2.0))
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


@dataclass(frozen=True)
class FittedNumber:
    """A fitted value and its standard error, in the same unit."""

    value: float
    standard_error: float


@dataclass(frozen=True, eq=False, repr=False)
class ResonanceFit(Brief):
    """A resonance fitted to a spectrum.

    ``method`` "bvd" or "pole"; ``frequency`` (Hz) and ``q`` of the motional branch's series resonance, or of the pole;
    ``parameters`` the circuit in SI (ohm, henry, farad), empty for the pole; ``model`` the fitted spectrum on the
    points used; ``rms_residual`` the root mean square of |Z_model / Z - 1|, and ``reduced_chi_square`` if the
    spectrum's uncertainty is known. Standard errors hold for independent noise of the stated uncertainty or, without
    one, for noise of equal relative size in Z ("bvd"), of equal size in Y ("pole"), at every point, estimated from the
    residual: a model that does not fit gives errors that mean little.
    """

    method: str
    frequency: FittedNumber
    q: FittedNumber
    parameters: Mapping[str, FittedNumber]
    model: Spectrum
    rms_residual: float
    reduced_chi_square: float | None


def fit_resonance(
    spectrum: Spectrum,
    method: str,
    *,
    near: float | None = None,
    band: tuple[float, float] | None = None,
    series_resistance: bool = False,
) -> ResonanceFit:
    """Fit one resonance, started from :func:`figures`.

    "bvd": the Butterworth-Van Dyke circuit, R1 L1 C1 in series, C0 across them and, if `series_resistance`, Rs before
    them, over the whole of `band`. "pole": Y = A / (f - fp) + a straight complex background, over `band` or, without
    one, five half-power widths either side; Q = Re fp / (2 Im fp). The pole only requires that the other modes vary
    slowly.

    Raises:
        NoResonance: there is none to start from.
        ValueError: an unknown method, too few points, or the fit did not converge.
    """
    if method not in ("bvd", "pole"):
        raise ValueError(f"method {method!r} is not one of bvd, pole")
    if series_resistance and method != "bvd":
        raise ValueError("a series resistance belongs to the method bvd")
    seen = spectrum if band is None else spectrum.restricted(*band)
    start = figures(seen, near=near)
    if method == "bvd":
        return _fit_circuit(seen, start, series_resistance)
    if band is None:
        reach = 5.0 * (start.f2 - start.f1)
        seen = seen.restricted(start.f0 - reach, start.f0 + reach)
    return _fit_pole(seen, start)


def bvd_impedance(
    frequency: NDArray[np.float64],
    *,
    motional_resistance: float,
    motional_inductance: float,
    motional_capacitance: float,
    static_capacitance: float,
    series_resistance: float = 0.0,
) -> NDArray[np.complex128]:
    """Impedance Z (n,) ohm, e^{+j w t}, of the Butterworth-Van Dyke circuit at `frequency` (n,) Hz; values in SI."""
    omega = 2.0 * np.pi * frequency
    motional = motional_resistance + 1j * (omega * motional_inductance - 1.0 / (omega * motional_capacitance))
    return np.asarray(series_resistance + 1.0 / (1j * omega * static_capacitance + 1.0 / motional))


def _fit_circuit(spectrum: Spectrum, start: Figures, series_resistance: bool) -> ResonanceFit:
    """Fit (ln fs, ln Q, ln L1, ln C0[, Rs]) to the complex ln Z: positive by construction, nearly uncorrelated."""
    omega = 2.0 * np.pi * spectrum.frequency
    weight = _weights(spectrum)

    def branches(vector: NDArray[np.float64]) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Motional impedance and total parallel admittance."""
        omega_s, q, inductance, capacitance = 2.0 * np.pi * math.exp(vector[0]), *np.exp(vector[1:4])
        motional = omega_s * inductance * (1.0 / q + 1j * (omega / omega_s - omega_s / omega))
        return motional, 1j * omega * capacitance + 1.0 / motional

    def impedance(vector: NDArray[np.float64]) -> NDArray[np.complex128]:
        return np.asarray(1.0 / branches(vector)[1] + (vector[4] if series_resistance else 0.0))

    def residual(vector: NDArray[np.float64]) -> NDArray[np.float64]:
        logarithm = np.log(impedance(vector) / spectrum.impedance)
        return np.concatenate([weight * logarithm.real, weight * logarithm.imag])

    def jacobian(vector: NDArray[np.float64]) -> NDArray[np.float64]:
        motional, admittance = branches(vector)
        omega_s, q, inductance, capacitance = 2.0 * np.pi * math.exp(vector[0]), *np.exp(vector[1:4])
        by_motional = 1.0 / (motional * admittance) ** 2  # dZ / dZ_motional
        columns = [
            by_motional * omega_s * inductance * (1.0 / q - 2j * omega_s / omega),
            -by_motional * omega_s * inductance / q,
            by_motional * motional,
            -1j * omega * capacitance / admittance**2,
        ]
        if series_resistance:
            columns.append(np.ones_like(motional))
        slope = (weight / impedance(vector))[:, None] * np.column_stack(columns)
        return np.vstack([slope.real, slope.imag])

    omega0 = 2.0 * np.pi * start.f0
    capacitance = start.antiresonance.circuit_capacitance if start.antiresonance else math.nan
    if not capacitance > 0.0:  # no antiresonance in the band, or overtones spoil the estimate: take the far end's
        susceptance = max(float(spectrum.admittance.imag[-1]), 0.1 / (start.z_min * start.q))
        capacitance = susceptance / omega[-1]
    vector = [math.log(start.f0), math.log(start.q), math.log(start.z_min * start.q / omega0), math.log(capacitance)]
    solution = _least_squares(residual, jacobian, vector + [0.0] * series_resistance)
    covariance = _covariance(solution, spectrum)
    # ln of fs, Q, R1, L1, C1, C0 are linear in the fitted logarithms, so their covariance follows exactly.
    to_logarithms = np.array(
        [[1, 0, 0, 0], [0, 1, 0, 0], [1, -1, 1, 0], [0, 0, 1, 0], [-2, 0, -1, 0], [0, 0, 0, 1]], dtype=float)
    constants = np.log([1.0, 1.0, 2.0 * np.pi, 1.0, 1.0 / (2.0 * np.pi) ** 2, 1.0])
    values = np.exp(constants + to_logarithms @ solution[0][:4])
    errors = values * np.sqrt(np.diag(to_logarithms @ covariance[:4, :4] @ to_logarithms.T))
    frequency, q, *circuit = (FittedNumber(float(v), float(e)) for v, e in zip(values, errors, strict=True))
    parameters = dict(zip(("R1", "L1", "C1", "C0"), circuit, strict=True))
    if series_resistance:
        parameters["Rs"] = FittedNumber(float(solution[0][4]), math.sqrt(covariance[4, 4]))
    return _fitted("bvd", frequency, q, parameters, spectrum, impedance(solution[0]))


def _fit_pole(spectrum: Spectrum, start: Figures) -> ResonanceFit:
    """Fit Y = A / (x - p) + b + c x, with x in half-power half widths from f0."""
    half = 0.5 * (start.f2 - start.f1)
    x = (spectrum.frequency - start.f0) / half
    measured = spectrum.admittance
    # Without an uncertainty every point of Y counts alike, so that the peak decides; a relative residual would be
    # dominated by the points of least admittance, where the neighbouring modes are.
    if spectrum.uncertainty is None:
        scale = np.full(len(x), start.z_min)
    else:
        scale = spectrum.magnitude**2 / spectrum.uncertainty

    def basis(pole: complex) -> NDArray[np.complex128]:
        return np.column_stack([1.0 / (x - pole), np.ones_like(x), x])

    def admittance(vector: NDArray[np.float64]) -> NDArray[np.complex128]:
        return np.asarray(basis(complex(vector[0], vector[1])) @ (vector[2::2] + 1j * vector[3::2]))

    def residual(vector: NDArray[np.float64]) -> NDArray[np.float64]:
        error = admittance(vector) - measured
        return np.concatenate([scale * error.real, scale * error.imag])

    def jacobian(vector: NDArray[np.float64]) -> NDArray[np.float64]:
        pole = complex(vector[0], vector[1])
        by_pole = complex(vector[2], vector[3]) / (x - pole) ** 2
        linear = basis(pole)
        columns = [by_pole, 1j * by_pole]
        for column in linear.T:
            columns += [column, 1j * column]
        slope = scale[:, None] * np.column_stack(columns)
        return np.vstack([slope.real, slope.imag])

    if len(x) < 5:
        raise ValueError(f"{len(x)} points about {start.f0:.9g} Hz do not determine a pole; at least 5 are needed")
    # In e^{+j w t} a decaying mode has Im f > 0; the half-power half width is its imaginary part.
    amplitudes = np.linalg.lstsq(scale[:, None] * basis(1j), scale * measured, rcond=None)[0]
    linear = np.column_stack([amplitudes.real, amplitudes.imag]).ravel()
    solution = _least_squares(residual, jacobian, [0.0, 1.0, *linear])
    covariance = _covariance(solution, spectrum)[:2, :2] * half**2
    pole = complex(start.f0 + half * solution[0][0], half * solution[0][1])
    if pole.imag <= 0.0:
        raise ValueError(f"the fitted pole {pole:.6g} Hz does not decay: this is no passive resonance")
    q = pole.real / (2.0 * pole.imag)
    slope = np.array([0.5 / pole.imag, -q / pole.imag])
    return _fitted("pole", FittedNumber(pole.real, math.sqrt(covariance[0, 0])),
                   FittedNumber(q, math.sqrt(slope @ covariance @ slope)), {}, spectrum, 1.0 / admittance(solution[0]))


def _weights(spectrum: Spectrum) -> NDArray[np.float64]:
    """Weights (n,) of a relative residual: |Z| / uncertainty, or one everywhere."""
    if spectrum.uncertainty is None:
        return np.ones(len(spectrum.frequency))
    return spectrum.magnitude / spectrum.uncertainty


def _least_squares(
    residual: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    jacobian: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    start: list[float],
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Solution, Jacobian there and sum of squares.

    Raises:
        ValueError: not converged.
    """
    size = len(residual(np.array(start)))
    if size <= len(start):
        raise ValueError(f"{size // 2} points do not determine {len(start)} parameters")
    found = least_squares(residual, np.array(start), jac=jacobian, x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    if found.status <= 0:
        raise ValueError(f"the fit did not converge: {found.message} (sum of squares {2.0 * found.cost:.4g})")
    return found.x, found.jac, 2.0 * float(found.cost)


def _covariance(
    solution: tuple[NDArray[np.float64], NDArray[np.float64], float], spectrum: Spectrum
) -> NDArray[np.float64]:
    """Covariance of the fitted vector, scaled by the residual if the uncertainty is not known."""
    vector, jacobian, squares = solution
    # Scaled columns keep the inverse well conditioned when parameters differ by orders of magnitude.
    norm = np.linalg.norm(jacobian, axis=0)
    inverse = np.linalg.pinv((jacobian / norm).T @ (jacobian / norm), hermitian=True) / np.outer(norm, norm)
    variance = squares / (len(jacobian) - len(vector)) if spectrum.uncertainty is None else 1.0
    return np.asarray(inverse * variance)


def _fitted(
    method: str,
    frequency: FittedNumber,
    q: FittedNumber,
    parameters: Mapping[str, FittedNumber],
    spectrum: Spectrum,
    impedance: NDArray[np.complex128],
) -> ResonanceFit:
    relative = np.abs(impedance / spectrum.impedance - 1.0)
    chi_square = None
    if spectrum.uncertainty is not None:
        free = {"bvd": len(parameters), "pole": 8}[method]
        squares = float(np.sum((np.abs(impedance - spectrum.impedance) / spectrum.uncertainty) ** 2))
        chi_square = squares / (2 * len(relative) - free)
    return ResonanceFit(method, frequency, q, parameters, Spectrum(spectrum.frequency, impedance),
                        float(np.sqrt(np.mean(relative**2))), chi_square)
