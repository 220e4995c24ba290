"""Equivalent circuit of a piezoelectric device, fitted to a spectrum.

It has resonant branches beside a static capacitance:

    Y = j w C0 (1 - j t) + sum_k j w C_k e^{j p_k} / (1 - u^2 + j u / Q_k),  u = f / f_k,      Z = Rs + 1 / Y

With p_k = 0 and t = 0 branch k is a resistor, an inductor and a capacitor in series (Butterworth and Van Dyke): C_k,
L_k = 1 / (w_k^2 C_k), R_k = 1 / (w_k C_k Q_k). The phase p_k is that of a mode whose coupling has a loss, and t is the
loss tangent of the static capacitance. :func:`fit_circuit` fits one branch,
:func:`workbench.results.resonances.fit_resonances` several.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls

from workbench.files.errors import InputError
from workbench.results.band import fitted_points, frequency_within
from workbench.results.brief import Brief
from workbench.results.merit import Figures, figures
from workbench.results.spectrum import Spectrum, WithSpectrum, turns_anticlockwise

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Parameters of a branch in a vector: ln f, ln Q, ln C, phase.
OF_BRANCH = 4

#: Largest negative Re Z relative to |Z|, for the zero offset of an instrument. Doubled, a device that returns 4 % of
#: its apparent power counts as passive.
NEGATIVE = 0.02

#: Rms of the relative residual of Z above which a model does not explain a spectrum without a stated noise. It is 1.2
#: to 1.5 % for real discs, and several per cent for local optima, other devices or a second resonance.
LARGE_RESIDUAL = 0.03

#: Reduced chi-square above which a circuit does not explain a spectrum with a stated noise: residuals of twice it.
LARGE_CHI_SQUARE = 4.0

#: Logarithm of a frequency (Hz) or a Q beyond which the impedance is constant in double precision.
LARGEST = 80.0

#: Steps of a fit that need not converge to rounding. Doubled, a band with ten resonances takes seconds.
STEPS = 100


@dataclass(frozen=True)
class FittedNumber:
    """A fitted value and its standard error, in the same unit."""

    value: float
    standard_error: float

    def interval(self) -> tuple[float, float]:
        """The ends of the 95 % interval."""
        return self.value - 1.96 * self.standard_error, self.value + 1.96 * self.standard_error


@dataclass(frozen=True)
class FittedResonance:
    """One branch of a fitted circuit.

    ``frequency`` (Hz) and ``q`` are of its series resonance. ``k_eff`` is its effective coupling factor without the
    other resonances, k^2 = (fp^2 - fs^2) / fp^2 = C1 / (Cb + C1), with the capacitance Cb of the background at its
    frequency (:meth:`SolvedCircuit.background`); NaN if Cb is not above zero. ``resistance`` (ohm), ``inductance`` (H)
    and ``capacitance`` (F) are in series. ``phase`` (rad) is due to losses of the coupling, 0 in a plain circuit.
    """

    frequency: FittedNumber
    q: FittedNumber
    k_eff: FittedNumber
    resistance: FittedNumber
    inductance: FittedNumber
    capacitance: FittedNumber
    phase: FittedNumber

    @property
    def bandwidth(self) -> float:
        """f / Q, Hz."""
        return self.frequency.value / self.q.value

    @property
    def merit(self) -> float:
        """Figure of merit Q k^2 / (1 - k^2). Below 10 the dip of |Z| shows neither the frequency nor the Q."""
        return self.q.value * self.k_eff.value**2 / (1.0 - self.k_eff.value**2)


@dataclass(frozen=True, eq=False, repr=False)
class CircuitFit(Brief):
    """A circuit fitted to a spectrum.

    ``resonances`` are by frequency. ``static_capacitance`` (F) and ``loss_tangent`` are of the background in the middle
    of the band: C0, modes beyond the band and losses in parallel. ``series_resistance`` (ohm) is 0 if not fitted.
    ``model`` is the fitted spectrum at the points of the fit, ``rms_residual`` the root mean square of |Z_model / Z -
    1|, ``reduced_chi_square`` None without an uncertainty of the spectrum. ``findings`` name unresolved resonances.

    Standard errors assume independent noise: of the stated uncertainty or, without one, of the same relative size in Z
    at every point, estimated from the residual. They mean little if the model does not fit. Those of k_eff and of the
    static capacitance include the variation of the background over the band.
    """

    resonances: tuple[FittedResonance, ...]
    static_capacitance: FittedNumber
    loss_tangent: FittedNumber
    series_resistance: FittedNumber
    model: Spectrum
    rms_residual: float
    reduced_chi_square: float | None
    findings: tuple[str, ...] = ()

    @cached_property
    def parameters(self) -> Mapping[str, FittedNumber]:
        """R1, L1, C1, R2, ..., C0 in SI."""
        found = {f"{name}{k}": value for k, each in enumerate(self.resonances, 1)
                 for name, value in (("R", each.resistance), ("L", each.inductance), ("C", each.capacitance))}
        return {**found, "C0": self.static_capacitance}


def fit_circuit(
    spectrum: Spectrum | WithSpectrum,
    *,
    near: float | str | None = None,
    band: tuple[float | str, float | str] | None = None,
    series_resistance: bool = False,
) -> CircuitFit:
    """Fit the circuit of one resonance: R1, L1, C1, and parallel C0.

    All points in `band` are fitted, so another resonance in it spoils the fit; :func:`fit_resonances` fits several.
    `near` is the frequency of the resonance from which the fit starts, by default the deepest (both in Hz, or texts
    with their units). `series_resistance` adds Rs, of leads, in series. A finding reports that one resonance does not
    explain the spectrum (:data:`LARGE_RESIDUAL`).

    Raises:
        NoResonance: there is none to start from.
        InputError: `near` or `band` does not fit the spectrum, or the device is not passive.
        ValueError: too few points, or a fit that does not converge.
    """
    seen = fitted_points(spectrum, band, source="fit_circuit")
    at = None if near is None else frequency_within(near, seen, source="fit_circuit")
    check_passive_spectrum(seen, source="fit_circuit")
    start = figures(seen, near=at)
    capacitance = _static_capacitance(seen, start)
    # R1 is the smallest |Z|, so C1 = 1 / (w R1 Q).
    motional = 1.0 / (2.0 * math.pi * start.f0 * start.z_min * start.q)
    circuit = BranchCircuit(np.array([[math.log(start.f0), math.log(start.q), math.log(motional), 0.0]]),
                      np.array([math.log(capacitance), 0.0, 0.0]))
    found = solved(seen, circuit, Freedom(series_resistance=series_resistance)).fit()
    return replace(found, findings=_unexplained(found))


def _unexplained(found: CircuitFit) -> tuple[str, ...]:
    stated = found.reduced_chi_square
    if found.rms_residual <= LARGE_RESIDUAL or (stated is not None and stated <= LARGE_CHI_SQUARE):
        return ()
    residual, limit = 100.0 * found.rms_residual, 100.0 * LARGE_RESIDUAL
    return (f"the circuit has a residual of {residual:.3g} % of Z (rms), more than {limit:g} %, so its values mean "
            "little: several resonances in the band (fit_resonances fits them together; or a narrower band), a "
            'reactance of reversed sign (read it with correction="conjugate"), or noise',)


def _static_capacitance(spectrum: Spectrum, start: Figures) -> float:
    found = start.antiresonance.circuit_capacitance if start.antiresonance else math.nan
    if found > 0.0:
        return found
    # No antiresonance in the band, or overtones spoil the estimate: use the susceptance at the upper end.
    susceptance = max(float(spectrum.admittance.imag[-1]), 0.1 / (start.z_min * start.q))
    return susceptance / (2.0 * math.pi * float(spectrum.frequency[-1]))


def bvd_impedance(
    frequency: Real,
    *,
    motional_resistance: float,
    motional_inductance: float,
    motional_capacitance: float,
    static_capacitance: float,
    series_resistance: float = 0.0,
) -> Complex:
    """Z (n,) ohm of the Butterworth-Van Dyke circuit at `frequency` (n,) Hz. The sign convention is e^{+j w t}; values
    are in SI."""
    omega = 2.0 * np.pi * frequency
    motional = motional_resistance + 1j * (omega * motional_inductance - 1.0 / (omega * motional_capacitance))
    return np.asarray(series_resistance + 1.0 / (1j * omega * static_capacitance + 1.0 / motional))


def check_passive_spectrum(spectrum: Spectrum, *, source: str) -> None:
    """Raise for an active device or a reactance of reversed sign.

    `source` is the source in the message.

    Raises:
        InputError: a tenth of the points has a resistance below zero by more than an offset, or the reflection
            coefficient turns anticlockwise and most points are inductive.
    """
    margin = NEGATIVE if spectrum.uncertainty is None else NEGATIVE + 3.0 * spectrum.uncertainty / spectrum.magnitude
    share = spectrum.impedance.real / spectrum.magnitude + margin
    if np.mean(share < 0.0) > 0.1:
        worst = int(np.argmin(share))
        raise InputError(
            source, "spectrum",
            f"Re Z = {spectrum.impedance[worst].real:.4g} ohm at {spectrum.frequency[worst]:.9g} Hz",
            "that of a passive device, Re Z > 0; if its sign was recorded wrongly, read it with correction=\"negate\"")
    # A lossy device may turn anticlockwise in a narrow band too; if it is mostly capacitive, its sign is right.
    if turns_anticlockwise(spectrum) and np.median(spectrum.impedance.imag) > 0.0:
        raise InputError(
            source, "spectrum", "a reflection coefficient that turns anticlockwise with rising frequency",
            "one that turns clockwise, as that of any passive device; if the sign of its phase was recorded wrongly, "
            'read it with correction="conjugate"')


# --------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Freedom:
    """The free parameters besides f, Q and C of branches and C0. ``losses`` are phases and the loss tangent.
    ``confined`` has ranges of frequency (low, high) in Hz for some branches, by index."""

    losses: bool = False
    series_resistance: bool = False
    confined: Mapping[int, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class BranchCircuit:
    """The parameters of a circuit. ``branches`` (k, 4) are ln f, ln Q, ln C and phase; ``rest`` (3,) is ln C0, t and
    Rs."""

    branches: Real
    rest: Real

    @property
    def frequencies(self) -> Real:
        """Series resonances (k,) Hz."""
        return np.exp(np.clip(self.branches[:, 0], -LARGEST, LARGEST))

    @property
    def bandwidths(self) -> Real:
        """f / Q (k,) Hz."""
        return np.exp(np.clip(self.branches[:, 0] - self.branches[:, 1], -LARGEST, LARGEST))

    def with_branch(self, frequency: float, bandwidth: float) -> BranchCircuit:
        """The circuit with one more branch (Hz), whose capacitance is tiny."""
        new = [math.log(frequency), math.log(frequency / bandwidth), float(self.rest[0]) - 20.0, 0.0]
        return replace(self, branches=np.vstack([self.branches, new]))

    def with_amplitudes(self, spectrum: Spectrum, *, losses: bool) -> BranchCircuit:
        """The circuit whose capacitances minimise the relative error of Y.

        With `losses`, the phases are found too. Both enter Y linearly. Without losses no capacitance is below zero, and
        one whose best value is zero does not change.
        """
        frequency = spectrum.frequency
        columns = [np.ones(len(frequency), dtype=complex)]
        for at, sharpness, _, _ in self.branches:
            u = frequency * math.exp(-_within(at))
            columns.append(1.0 / (1.0 - u**2 + 1j * u / math.exp(_within(sharpness))))
        scaled = (2j * np.pi * frequency * spectrum.impedance)[:, None] * np.column_stack(columns)
        size = np.linalg.norm(scaled, axis=0)
        wanted = np.ones(len(frequency))
        if losses:
            found = np.linalg.lstsq(scaled / size, wanted.astype(complex), rcond=None)[0] / size
        else:
            found = nnls(np.vstack([scaled.real, scaled.imag]) / size,
                         np.concatenate([wanted, np.zeros(len(frequency))]))[0].astype(complex) / size
        branches, rest = self.branches.copy(), self.rest.copy()
        moved = np.abs(found) > 0.0
        branches[moved[1:], 2] = np.log(np.abs(found[1:][moved[1:]]))
        branches[:, 3] = np.angle(found[1:])
        if found[0].real > 0.0:
            rest[:2] = math.log(abs(found[0])), -found[0].imag / found[0].real
        return BranchCircuit(branches, rest)

    def without(self, index: int) -> BranchCircuit:
        return replace(self, branches=np.delete(self.branches, index, axis=0))

    def vector(self) -> Real:
        return np.concatenate([self.branches.ravel(), self.rest])

    def moved(self, vector: Real) -> BranchCircuit:
        """A circuit of as many branches with the parameters of a vector."""
        return BranchCircuit(vector[:-3].reshape(-1, OF_BRANCH), vector[-3:])

    def impedance(self, frequency: Real) -> Complex:
        """Z (n,) ohm."""
        return self.with_slopes(frequency)[0]

    def with_slopes(self, frequency: Real) -> tuple[Complex, Complex]:
        """Z (n,) ohm and its derivatives (n, p) by :meth:`vector`."""
        omega = 2.0 * np.pi * frequency
        capacitance, slopes = self.capacitance(frequency)
        admittance = 1j * omega * capacitance
        return self.rest[2] + 1.0 / admittance, np.column_stack([
            -1j * omega[:, None] * slopes / admittance[:, None] ** 2, np.ones_like(omega)])

    def capacitance(self, frequency: Real, without: Collection[int] = ()) -> tuple[Complex, Complex]:
        """Y / (j w) (n,) in F, without Rs and some branches. `without` are the indices of those. Also its derivatives
        (n, p - 1) by the parameters other than Rs."""
        columns: list[NDArray[Any]] = []
        static = math.exp(_within(self.rest[0])) * np.ones(len(frequency), dtype=complex)
        total = static * (1.0 - 1j * self.rest[1])
        for k, (at, sharpness, capacitance, phase) in enumerate(self.branches):
            if k in without:
                columns += OF_BRANCH * [np.zeros(len(frequency))]
                continue
            u, q = frequency * math.exp(-_within(at)), math.exp(_within(sharpness))
            bracket = 1.0 - u**2 + 1j * u / q
            part: Complex = np.exp(_within(capacitance) + 1j * phase) / bracket
            total = total + part
            columns += [part * (1j * u / q - 2.0 * u**2) / bracket, part * (1j * u / q) / bracket, part, 1j * part]
        return total, np.column_stack([*columns, static * (1.0 - 1j * self.rest[1]), -1j * static])


def _within(logarithm: float) -> float:
    """The logarithm, limited so that its exponential is finite."""
    return float(min(max(logarithm, -LARGEST), LARGEST))


@dataclass(frozen=True, eq=False)
class SolvedCircuit:
    """A circuit that was fitted to a spectrum. ``squares`` is its sum of weighted squares, ``covariance`` that of its
    vector, ``free`` the indices of its free parameters."""

    spectrum: Spectrum
    circuit: BranchCircuit
    freedom: Freedom
    free: NDArray[np.int64]
    squares: float
    covariance: Real

    @property
    def variance(self) -> float:
        """Reduced chi-square, or the variance of ln Z without a stated noise."""
        return self.squares / max(2 * len(self.spectrum.frequency) - len(self.free), 1)

    def errors(self) -> Real:
        """Standard errors of the vector, 0 for fixed parameters."""
        return np.sqrt(np.diag(self.covariance))

    def fit(self, listed: Sequence[int] | None = None, findings: tuple[str, ...] = ()) -> CircuitFit:
        """The result for the branches `listed` by index, by default all."""
        branches = self.circuit.branches
        chosen = sorted(range(len(branches)) if listed is None else listed, key=lambda k: float(branches[k, 0]))
        impedance = self.circuit.impedance(self.spectrum.frequency)
        return CircuitFit(
            tuple(self._resonance(k, chosen) for k in chosen), *self._static(chosen), self._number(-1),
            Spectrum(self.spectrum.frequency, impedance), *residual_size(self.spectrum, impedance, len(self.free)),
            findings)

    def background(self, frequency: float, listed: Sequence[int]) -> tuple[complex, Complex, float]:
        """The capacitance (F) without the branches `listed`, at a frequency (Hz).

        Also its derivatives (p - 1,), and half of its range (F) over the band. A band cannot separate the static
        capacitance from modes beyond its ends, or a loss of coupling from a loss in parallel, so the background
        includes all of these. In another band, with other modes, it differs by about that half range.
        """
        (value,), (slopes,) = self.circuit.capacitance(np.array([frequency]), listed)
        over_band, _ = self.circuit.capacitance(self.spectrum.frequency, listed)
        return complex(value), slopes, 0.5 * float(np.ptp(over_band.real))

    def _static(self, listed: Sequence[int]) -> tuple[FittedNumber, FittedNumber]:
        """Capacitance (F) and loss tangent of the background at mid-band."""
        middle = 0.5 * float(self.spectrum.frequency[0] + self.spectrum.frequency[-1])
        value, slopes, changed = self.background(middle, listed)
        tangent = -value.imag / value.real
        return (FittedNumber(value.real, math.hypot(self._error(slopes.real), changed)),
                FittedNumber(tangent, self._error((slopes.imag + tangent * slopes.real) / value.real)))

    def _error(self, slopes: Real) -> float:
        """Standard error of a value with these derivatives (p - 1,)."""
        return math.sqrt(max(float(slopes @ self.covariance[:-1, :-1] @ slopes), 0.0))

    def _resonance(self, k: int, listed: Sequence[int]) -> FittedResonance:
        at, sharpness, capacitance, phase = range(OF_BRANCH * k, OF_BRANCH * (k + 1))
        turn = math.log(2.0 * math.pi)
        return FittedResonance(
            self._exponential({at: 1.0}), self._exponential({sharpness: 1.0}), self._coupling(k, listed),
            self._exponential({at: -1.0, capacitance: -1.0, sharpness: -1.0}, -turn),
            self._exponential({at: -2.0, capacitance: -1.0}, -2.0 * turn), self._exponential({capacitance: 1.0}),
            self._number(phase))

    def _coupling(self, k: int, listed: Sequence[int]) -> FittedNumber:
        """k_eff of a branch from the background's capacitance at its frequency."""
        own = self._exponential({OF_BRANCH * k + 2: 1.0}).value
        value, slopes, changed = self.background(float(self.circuit.frequencies[k]), listed)
        if not value.real > 0.0:
            return FittedNumber(math.nan, math.nan)
        # d ln k = (1 - k^2) (d ln C - d ln Cb) / 2.
        of_ratio = -slopes.real / value.real
        of_ratio[OF_BRANCH * k + 2] += 1.0
        k2 = own / (own + value.real)
        spread = math.hypot(self._error(of_ratio), changed / value.real)
        return FittedNumber(math.sqrt(k2), 0.5 * math.sqrt(k2) * (1.0 - k2) * spread)

    def _number(self, index: int) -> FittedNumber:
        return FittedNumber(float(self.circuit.vector()[index]), math.sqrt(self.covariance[index, index]))

    def _exponential(self, powers: Mapping[int, float], constant: float = 0.0) -> FittedNumber:
        """e to a constant plus a weighted sum of logarithms, with error."""
        places, weights = list(powers), np.array(list(powers.values()))
        logarithm = constant + float(weights @ self.circuit.vector()[places])
        # A parameter of a negligible branch may overflow.
        value = math.exp(logarithm) if logarithm < math.log(sys.float_info.max) else math.inf
        variance = float(weights @ self.covariance[np.ix_(places, places)] @ weights)
        return FittedNumber(value, value * math.sqrt(max(variance, 0.0)))


def solved(spectrum: Spectrum, start: BranchCircuit, freedom: Freedom) -> SolvedCircuit:
    """The circuit nearest to `start` that minimises the residual of ln Z.

    Positive parameters are fitted as logarithms. With losses, some parameters may hardly matter, so a fit near the
    minimum is accepted.

    Raises:
        ValueError: too few points, or no convergence.
    """
    first, count = start.vector(), len(start.branches)
    free = _free(count, freedom)
    if len(spectrum.frequency) < len(free):
        raise ValueError(f"{len(spectrum.frequency)} points do not determine {len(free)} parameters of a circuit")
    low, high = np.full(len(first), -np.inf), np.full(len(first), np.inf)
    for index, (lowest, highest) in freedom.confined.items():
        low[OF_BRANCH * index], high[OF_BRANCH * index] = math.log(lowest), math.log(highest)
    weight = np.ones(len(spectrum.frequency))
    if spectrum.uncertainty is not None:
        weight = spectrum.magnitude / spectrum.uncertainty

    def whole(part: Real) -> BranchCircuit:
        vector = first.copy()
        vector[free] = part
        return start.moved(vector)

    def residual(part: Real) -> Real:
        # A step that overflows is NaN, and the search rejects it.
        with np.errstate(all="ignore"):
            logarithm = weight * np.log(whole(part).impedance(spectrum.frequency) / spectrum.impedance)
        return np.concatenate([logarithm.real, logarithm.imag])

    def jacobian(part: Real) -> Real:
        impedance, slopes = whole(part).with_slopes(spectrum.frequency)
        scaled = (weight / impedance)[:, None] * slopes[:, free]
        return np.vstack([scaled.real, scaled.imag])

    vector, slope, squares = least_squares_of(residual, jacobian, first[free], bounds=(low[free], high[free]),
                                              near=freedom.losses)
    covariance = np.zeros((len(first), len(first)))
    covariance[np.ix_(free, free)] = covariance_of(slope, squares, known=spectrum.uncertainty is not None)
    return SolvedCircuit(spectrum, whole(vector), freedom, free, squares, covariance)


def _free(count: int, freedom: Freedom) -> NDArray[np.int64]:
    """The indices of the free parameters of a circuit of `count` branches."""
    last = OF_BRANCH * count
    found = [k for k in range(last) if k % OF_BRANCH != OF_BRANCH - 1 or freedom.losses]
    found += [last, *([last + 1] if freedom.losses else []), *([last + 2] if freedom.series_resistance else [])]
    return np.array(found)


def least_squares_of(
    residual: Callable[[Real], Real], jacobian: Callable[[Real], Real], start: Real,
    bounds: tuple[Real, Real] | None = None, *, near: bool = False,
) -> tuple[Real, Real, float]:
    """Minimise the sum of squares of residuals (n,) over a vector (p,).

    It converges to rounding. With `near`, it ends when a step gains less than 1e-8 of the sum, or after :data:`STEPS`.

    Returns:
        The vector (p,), the Jacobian (n, p) at it, and the sum of squares.

    Raises:
        ValueError: not converged.
    """
    error = 1e-8 if near else 1e-12
    found = least_squares(residual, start, jac=jacobian, x_scale="jac", xtol=error, ftol=error, gtol=error,
                          bounds=(-np.inf, np.inf) if bounds is None else bounds, max_nfev=STEPS if near else None)
    if found.status <= 0 and not near:
        raise ValueError(f"the fit did not converge: {found.message} (sum of squares {2.0 * found.cost:.4g})")
    return found.x, found.jac, 2.0 * float(found.cost)


def residual_size(spectrum: Spectrum, impedance: Complex, parameters: int) -> tuple[float, float | None]:
    """The rms of |Z_model / Z - 1|, and the reduced chi-square. The latter is None without an uncertainty of the
    spectrum."""
    off = np.abs(impedance - spectrum.impedance)
    rms = float(np.sqrt(np.mean((off / spectrum.magnitude) ** 2)))
    if spectrum.uncertainty is None:
        return rms, None
    return rms, float(np.sum((off / spectrum.uncertainty) ** 2)) / (2 * len(off) - parameters)


def covariance_of(jacobian: Real, squares: float, *, known: bool) -> Real:
    """Covariance (p, p) of a vector, from its Jacobian (n, p). It is scaled by the residual unless the uncertainty is
    `known`."""
    # Scaled columns keep the inverse well conditioned when parameters differ by orders of magnitude.
    norm = np.linalg.norm(jacobian, axis=0)
    norm = np.where(norm > 0.0, norm, 1.0)
    inverse = np.linalg.pinv((jacobian / norm).T @ (jacobian / norm), hermitian=True) / np.outer(norm, norm)
    return np.asarray(inverse * (1.0 if known else squares / (len(jacobian) - jacobian.shape[1])))
