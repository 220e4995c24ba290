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
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls

from workbench.files.errors import InputError
from workbench.files.quantities import frequency_text
from workbench.results.band import fitted_points, frequency_within
from workbench.results.brief import Brief
from workbench.results.merit import figures
from workbench.results.spectrum import CORRECTION, Spectrum, WithSpectrum, turns_anticlockwise

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Parameters of a branch in a vector: ln f, ln Q, ln C, phase.
OF_BRANCH = 4

#: The logarithms of f, Q, R, L and C of a branch as sums of its parameters, and their multiples of ln(2 pi).
POWERS = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [-1, -1, -1, 0], [-2, 0, -1, 0], [0, 0, 1, 0]])
TURNS = np.array([0.0, 0.0, -1.0, -2.0, 0.0])

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

    @property
    def active(self) -> tuple[str, ...]:
        """The parts that supply power, by their 95 % intervals."""
        tangent = self.loss_tangent
        shunt = (f"the shunt (loss tangent {tangent.value:.2g} ± {tangent.standard_error:.1g})",)
        return (shunt if tangent.interval()[1] < 0.0 else ()) + tuple(
            f"the branch at {1e-6 * each.frequency.value:.4f} MHz (phase {math.degrees(each.phase.value):.0f} ± "
            f"{math.degrees(each.phase.standard_error):.1g} degrees)" for each in self.resonances
            if math.acos(math.cos(each.phase.value)) - 1.96 * each.phase.standard_error > 0.5 * math.pi)

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
    # R1 is the smallest |Z|, so C1 = 1 / (w R1 Q). C0 is that of the antiresonance, or of the upper end of the band if
    # it has none or overtones spoil it.
    conductance = 1.0 / (start.z_min * start.q)
    static = start.antiresonance.circuit_capacitance if start.antiresonance else math.nan
    if not static > 0.0:
        static = max(float(seen.admittance.imag[-1]), 0.1 * conductance) / (2.0 * math.pi * float(seen.frequency[-1]))
    branch = [math.log(start.f0), math.log(start.q), math.log(conductance / (2.0 * math.pi * start.f0)), 0.0]
    fit = BranchCircuit(seen, np.array([branch]), np.array([math.log(static), 0.0, 0.0]),
                        has_resistance=series_resistance).solved().fit([0])
    if fit.rms_residual <= LARGE_RESIDUAL or (fit.reduced_chi_square or math.inf) <= LARGE_CHI_SQUARE:
        return fit
    residual, limit = 100.0 * fit.rms_residual, 100.0 * LARGE_RESIDUAL
    return replace(fit, findings=(
        f"the circuit has a residual of {residual:.3g} % of Z (rms), more than {limit:g} %, so its values mean "
        "little: several resonances in the band (fit_resonances fits them together; or a narrower band), a "
        f"reactance of reversed sign (read it with {CORRECTION.format(name='conjugate')}), or noise",))


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
            f"Re Z = {spectrum.impedance[worst].real:.4g} ohm at {frequency_text(spectrum.frequency[worst])}",
            "that of a passive device, Re Z > 0; if its sign was recorded wrongly, read it with "
            + CORRECTION.format(name="negate"))
    # A lossy device may turn anticlockwise in a narrow band too; if it is mostly capacitive, its sign is right.
    if turns_anticlockwise(spectrum) and np.median(spectrum.impedance.imag) > 0.0:
        raise InputError(
            source, "spectrum", "a reflection coefficient that turns anticlockwise with rising frequency",
            "one that turns clockwise, as that of any passive device; if the sign of its phase was recorded wrongly, "
            f"read it with {CORRECTION.format(name='conjugate')}")


@dataclass(frozen=True, eq=False)
class BranchCircuit:
    """The circuit of a spectrum, with free and fixed parameters.

    ``branches`` (k, 4) are ln f, ln Q, ln C and phase; ``rest`` (3,) is ln C0, t and Rs. Phases and t are free with
    ``has_losses``, Rs with ``has_resistance``. The first branches lie beyond the band, f (Hz) within the ends
    ``beyond``. The sum of weighted ``squares`` is infinite unless it is :meth:`solved`; ``covariance`` (p, p) is that
    of all parameters.
    """

    spectrum: Spectrum
    branches: Real
    rest: Real
    has_losses: bool = False
    has_resistance: bool = False
    beyond: tuple[tuple[float, float], ...] = ()
    squares: float = math.inf
    covariance: Real = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def vector(self) -> Real:
        """All parameters (p,), those of `branches` first."""
        return np.concatenate([self.branches.ravel(), self.rest])

    @property
    def free(self) -> NDArray[np.bool_]:
        """Whether each parameter (p,) is free."""
        branch = [True, True, True, self.has_losses]
        return np.array([*branch * len(self.branches), True, self.has_losses, self.has_resistance])

    @property
    def frequencies(self) -> Real:
        """Series resonances (k,) Hz."""
        return _exponential(self.branches[:, 0])

    @property
    def bandwidths(self) -> Real:
        """f / Q (k,) Hz."""
        return _exponential(self.branches[:, 0] - self.branches[:, 1])

    @property
    def errors(self) -> Real:
        """Standard errors (k, 4) of `branches`, 0 for fixed parameters."""
        return np.sqrt(np.diag(self.covariance)[:-3].reshape(-1, OF_BRANCH))

    @property
    def variance(self) -> float:
        """Reduced chi-square, or the variance of ln Z without a stated noise."""
        return self.squares / max(2 * len(self.spectrum.frequency) - int(self.free.sum()), 1)

    def moved(self, branches: Real, rest: Real | None = None) -> BranchCircuit:
        """A circuit with other parameters, not solved."""
        return BranchCircuit(self.spectrum, branches, self.rest if rest is None else rest, self.has_losses,
                             self.has_resistance, self.beyond)

    def with_branch(self, frequency: float, bandwidth: float) -> BranchCircuit:
        """The circuit with one more branch (Hz), whose capacitance is tiny."""
        new = [math.log(frequency), math.log(frequency / bandwidth), float(self.rest[0]) - 20.0, 0.0]
        return self.moved(np.vstack([self.branches, new]))

    def with_amplitudes(self) -> BranchCircuit:
        """The circuit whose capacitances minimise the relative error of Y.

        With losses, the phases are found too. Both enter Y linearly. Without losses no capacitance is below zero, and
        one whose best value is zero does not change.
        """
        omega = 2.0 * np.pi * self.spectrum.frequency[:, None]
        columns = np.column_stack([np.ones_like(omega), 1.0 / self._brackets(self.spectrum.frequency)[2]])
        columns = 1j * omega * self.spectrum.impedance[:, None] * columns
        columns /= (size := np.linalg.norm(columns, axis=0))
        wanted = np.ones(len(columns), dtype=complex)
        solution = (np.linalg.lstsq(columns, wanted, rcond=None)[0] if self.has_losses
                    else nnls(_parts(columns), _parts(wanted))[0].astype(complex)) / size
        static, amplitudes = complex(solution[0]), solution[1:]
        branches, rest, changed = self.branches.copy(), self.rest.copy(), np.abs(amplitudes) > 0.0
        branches[changed, 2] = np.log(np.abs(amplitudes[changed]))
        branches[:, 3] = np.angle(amplitudes)
        if static.real > 0.0:
            rest[:2] = math.log(abs(static)), -static.imag / static.real
        return self.moved(branches, rest)

    def _brackets(self, frequency: Real) -> tuple[Real, Complex, Complex]:
        """u^2, j u / Q and their brackets, each (n, k)."""
        u = frequency[:, None] / self.frequencies
        loss = np.asarray(1j * u / _exponential(self.branches[:, 1]), dtype=np.complex128)
        return u**2, loss, 1.0 - u**2 + loss

    def capacitance(self, frequency: Real, without: Collection[int] = ()) -> tuple[Complex, Complex]:
        """Y / (j w) (n,) in F and its derivatives (n, p).

        Rs and the branches of the indices `without` are omitted.
        """
        square, loss, bracket = self._brackets(frequency)
        parts = _exponential(self.branches[:, 2]) * np.exp(1j * self.branches[:, 3]) / bracket
        parts[:, list(without)] = 0.0
        slopes = np.stack([parts * (loss - 2.0 * square) / bracket, parts * loss / bracket, parts, 1j * parts], axis=2)
        rest = np.array([1.0 - 1j * self.rest[1], -1j, 0.0]) * _exponential(self.rest[:1])
        return rest[0] + parts.sum(axis=1), np.hstack([slopes.reshape(len(frequency), -1),
                                                       np.tile(rest, (len(frequency), 1))])

    def impedance(self, frequency: Real) -> tuple[Complex, Complex]:
        """Z (n,) ohm, and its derivatives (n, p)."""
        capacitance, slopes = self.capacitance(frequency)
        admittance = 2j * np.pi * frequency * capacitance
        slopes *= (-1.0 / (admittance * capacitance))[:, None]
        slopes[:, -1] = 1.0
        return self.rest[2] + 1.0 / admittance, slopes

    def solved(self) -> BranchCircuit:
        """The nearest circuit that minimises the residual of ln Z.

        Positive parameters are fitted as logarithms. With losses, some parameters may hardly matter, so a fit near the
        minimum is accepted.

        Raises:
            ValueError: too few points, or no convergence.
        """
        seen, free, vector = self.spectrum, self.free, self.vector
        if len(seen.frequency) < free.sum():
            raise ValueError(f"{len(seen.frequency)} points do not determine {free.sum()} parameters of a circuit")
        bounds = np.tile([[-np.inf], [np.inf]], len(vector))
        for k, ends in enumerate(self.beyond):
            bounds[:, OF_BRANCH * k] = np.log(ends)
        weight = 1.0 if seen.uncertainty is None else seen.magnitude / seen.uncertainty

        def whole(part: Real) -> BranchCircuit:
            moved = vector.copy()
            moved[free] = part
            return self.moved(moved[:-3].reshape(-1, OF_BRANCH), moved[-3:])

        def misfit(part: Real) -> tuple[Complex, Complex]:
            impedance, slopes = whole(part).impedance(seen.frequency)
            off: Complex = np.log(impedance / seen.impedance)
            return weight * off, (weight / impedance)[:, None] * slopes[:, free]

        part, own, squares = least_squares_of(misfit, vector[free], known=seen.uncertainty is not None,
                                              bounds=bounds[:, free], near=self.has_losses)
        covariance = np.zeros((len(vector), len(vector)))
        covariance[np.ix_(free, free)] = own
        return replace(whole(part), squares=squares, covariance=covariance)

    def fit(self, listed: Sequence[int], findings: tuple[str, ...] = ()) -> CircuitFit:
        """The result for the branches `listed` by index. The circuit is a solved one."""
        seen, (impedance, _) = self.spectrum, self.impedance(self.spectrum.frequency)
        background, slopes, changed = self._background(0.5 * float(seen.frequency[0] + seen.frequency[-1]), listed)
        tangent = -background.imag / background.real
        return CircuitFit(
            tuple(self._resonance(k, listed) for k in sorted(listed, key=lambda k: float(self.branches[k, 0]))),
            self._number(background.real, slopes.real, changed),
            self._number(tangent, (slopes.imag + tangent * slopes.real) / background.real),
            FittedNumber(float(self.rest[2]), math.sqrt(self.covariance[-1, -1])),
            Spectrum(seen.frequency, impedance), *residual_size(seen, impedance, int(self.free.sum())), findings)

    def _background(self, frequency: float, listed: Sequence[int]) -> tuple[complex, Complex, float]:
        """The capacitance (F) without the branches `listed`, at a frequency (Hz).

        Also its derivatives (p,), and half of its range (F) over the band. A band cannot separate the static
        capacitance from modes beyond its ends, or a loss of coupling from a loss in parallel, so the background
        includes all of these. In another band, with other modes, it differs by about that half range.
        """
        (value,), (slopes,) = self.capacitance(np.array([frequency]), listed)
        over_band, _ = self.capacitance(self.spectrum.frequency, listed)
        return complex(value), slopes, 0.5 * float(np.ptp(over_band.real))

    def _number(self, value: float, slopes: Real, changed: float = 0.0) -> FittedNumber:
        """A value with these derivatives (p,), and a further independent error."""
        return FittedNumber(value, math.hypot(math.sqrt(max(float(slopes @ self.covariance @ slopes), 0.0)), changed))

    def _resonance(self, k: int, listed: Sequence[int]) -> FittedResonance:
        own = slice(OF_BRANCH * k, OF_BRANCH * (k + 1))
        # A parameter of a negligible branch may overflow.
        with np.errstate(all="ignore"):
            values = np.exp(POWERS @ self.branches[k] + TURNS * math.log(2.0 * math.pi))
            errors = values * np.sqrt(np.maximum(np.diag(POWERS @ self.covariance[own, own] @ POWERS.T), 0.0))
        f, q, resistance, inductance, capacitance = map(FittedNumber, values.tolist(), errors.tolist())
        background, slopes, changed = self._background(float(self.frequencies[k]), listed)
        k_eff = FittedNumber(math.nan, math.nan)
        if background.real > 0.0:
            ratio = capacitance.value / (capacitance.value + background.real)
            # d ln k = (1 - k^2) (d ln C - d ln Cb) / 2.
            by_ratio, of_ratio = 0.5 * math.sqrt(ratio) * (1.0 - ratio), -slopes.real / background.real
            of_ratio[own.start + 2] += 1.0
            k_eff = self._number(math.sqrt(ratio), by_ratio * of_ratio, by_ratio * changed / background.real)
        return FittedResonance(f, q, k_eff, resistance, inductance, capacitance,
                               FittedNumber(float(self.branches[k, 3]), float(self.errors[k, 3])))


def _exponential(logarithms: Real) -> Real:
    """The exponentials, finite and above zero."""
    return np.exp(np.clip(logarithms, -LARGEST, LARGEST))


def _parts(values: Complex) -> Real:
    """The real parts (n, ...), then the imaginary parts."""
    return np.concatenate([values.real, values.imag])


def least_squares_of(
    misfit: Callable[[Real], tuple[Complex, Complex]], start: Real, *, known: bool,
    bounds: Real | tuple[float, float] = (-np.inf, np.inf), near: bool = False,
) -> tuple[Real, Real, float]:
    """Minimise the sum of squares of complex residuals over real parameters (p,).

    `misfit` gives the residuals (n,) and their derivatives (n, p). The search converges to rounding. With `near`, it
    ends when a step gains less than 1e-8 of the sum, or after :data:`STEPS`.

    Returns:
        The parameters (p,), their covariance (p, p), and the sum of squares. The covariance is scaled by the residual
        unless the uncertainty is `known`.

    Raises:
        ValueError: not converged.
    """
    error = 1e-8 if near else 1e-12
    # A step that overflows is NaN, and the search rejects it.
    with np.errstate(all="ignore"):
        found = least_squares(lambda part: _parts(misfit(part)[0]), start, jac=lambda part: _parts(misfit(part)[1]),
                              x_scale="jac", xtol=error, ftol=error, gtol=error, bounds=bounds,
                              max_nfev=STEPS if near else None)
    squares = 2.0 * float(found.cost)
    if found.status <= 0 and not near:
        raise ValueError(f"the fit did not converge: {found.message} (sum of squares {squares:.4g})")
    # Scaled columns keep the inverse well conditioned when parameters differ by orders of magnitude.
    norm = np.linalg.norm(found.jac, axis=0)
    norm[norm == 0.0] = 1.0
    inverse = np.linalg.pinv((found.jac / norm).T @ (found.jac / norm), hermitian=True) / np.outer(norm, norm)
    return found.x, inverse if known else inverse * squares / (len(found.fun) - start.size), squares


def residual_size(spectrum: Spectrum, impedance: Complex, parameters: int) -> tuple[float, float | None]:
    """The rms of |Z_model / Z - 1|, and the reduced chi-square.

    The latter is None without an uncertainty of the spectrum.
    """
    off = np.abs(impedance - spectrum.impedance)
    rms = float(np.sqrt(np.mean((off / spectrum.magnitude) ** 2)))
    if spectrum.uncertainty is None:
        return rms, None
    return rms, float(np.sum((off / spectrum.uncertainty) ** 2)) / (2 * len(off) - parameters)
