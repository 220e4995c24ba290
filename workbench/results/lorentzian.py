"""One or two Lorentzian peaks through a rate over frequency, with intervals.

    rate = sum_k A_k / (1 + y_k^2),      y_k = 2 Q_k (f / f_k - 1)

The fit is of ln(rate), since the scatter of a focusing time or of an energy density is relative. The noise is estimated
from the residual (Student t), or is the stated uncertainty if the residual does not contradict it. Two peaks are chosen
if an information criterion strongly prefers them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats import chi2, norm
from scipy.stats import t as student

Real = NDArray[np.float64]

#: Parameters of a peak: ln A, place (from 0 to 1 over the recorded band), ln Q.
OF_PEAK = 3

#: Probability of the intervals.
PROBABILITY = 0.95

#: Least difference of the information criterion by which two peaks are preferred: strong evidence (Kass and Raftery
#: 1995, J. Am. Stat. Assoc. 90, 773). Halved, noise splits a single peak twice as often.
STRONG = 6.0

#: Fewest points for two peaks: the corrected criterion is defined for at least three points more than parameters.
LEAST_FOR_TWO = 2 * OF_PEAK + 3

#: Fewest recorded points of each of two peaks within its half-power width. With one, a single wrong point is a peak.
LEAST_POINTS = 2

#: Largest distance of a fitted peak from the recorded band, and largest width of a peak, relative to the band; and
#: least width of a peak relative to the least step.
BESIDE, WIDEST, NARROWEST = 0.5, 4.0, 0.25

#: Probability of the residual, given the stated uncertainty, below which it contradicts this uncertainty.
CONTRADICTED = 1e-3

#: Least noise of ln(rate): a table has six digits at most. Smaller residuals have no weight.
ROUNDING = 1e-6

#: Factor of the interval of Q, to either side, above which a recording does not determine Q.
UNDETERMINED = 10.0

#: Distance from a bound, relative to the band or in ln Q, below which the bound is active.
AT_BOUND = 1e-3

#: Ratio of singular values below which a combination of parameters is not determined.
SINGULAR = 1e-8

#: Starts that are refined. Doubled, a fit takes twice the time, with the same results in the tests.
STARTS = 3

#: Steps of a fit. A superfluous second peak does not converge; doubled, it costs more time.
STEPS = 50


@dataclass(frozen=True)
class FittedPeak:
    """A peak of a recorded rate.

    ``frequency`` is in Hz, ``height`` in the unit of the rate. Intervals are of 95 %, and None if the recording does
    not determine the value. ``points`` is the number of recorded points within the half-power width.
    """

    frequency: float
    frequency_interval: tuple[float, float] | None
    q: float
    q_interval: tuple[float, float] | None
    height: float
    points: int

    @property
    def width(self) -> float:
        """The half-power width (Hz)."""
        return self.frequency / self.q


@dataclass(frozen=True)
class PeakFit:
    """The peaks of a recorded rate, the highest first.

    ``noise`` is the standard deviation of ln(rate), rms over the points; ``is_noise_stated`` is whether it is the
    stated one. ``preference`` is the information criterion of one peak less that of two, None for too few points for
    two. ``findings`` name parameters at their bounds, peaks beside the recorded band, and a contradicted uncertainty.
    """

    peaks: tuple[FittedPeak, ...]
    noise: float
    is_noise_stated: bool
    preference: float | None
    findings: tuple[str, ...]

    def at(self, frequency: Real) -> Real:
        """The fitted rate (n,) at `frequency` (n,) Hz."""
        return np.sum([each.height / (1.0 + (2.0 * each.q * (frequency / each.frequency - 1.0)) ** 2)
                       for each in self.peaks], axis=0)


@dataclass(frozen=True)
class _Data:
    """Points of ln(rate) with relative weights."""

    frequency: Real
    log_rate: Real
    sigma: Real

    @property
    def low(self) -> float:
        return float(self.frequency[0])

    @property
    def span(self) -> float:
        return float(self.frequency[-1] - self.frequency[0])

    @property
    def step(self) -> float:
        return float(np.diff(np.unique(self.frequency)).min())

    def bounds(self, peaks: int) -> tuple[Real, Real]:
        middle, end = self.low + 0.5 * self.span, self.low + self.span
        return (np.tile([-np.inf, -BESIDE, np.log(middle / (WIDEST * self.span))], peaks),
                np.tile([np.inf, 1.0 + BESIDE, np.log(end / (NARROWEST * self.step))], peaks))

    def parts(self, x: Real) -> tuple[Real, Real, Real]:
        """ln of every peak (..., peaks, n), y, and Q f/f0^2. The parameters x have the shape (..., peaks, 3)."""
        place, q = self.low + self.span * x[..., 1, None], np.exp(x[..., 2, None])
        y = 2.0 * q * (self.frequency / place - 1.0)
        return x[..., 0, None] - np.log1p(y**2), y, q * self.frequency / place**2

    def residual(self, x: Real) -> Real:
        log_peaks = self.parts(x.reshape(-1, OF_PEAK))[0]
        return np.asarray((np.logaddexp.reduce(log_peaks, axis=0) - self.log_rate) / self.sigma)

    def jacobian(self, x: Real) -> Real:
        log_peaks, y, slope = self.parts(x.reshape(-1, OF_PEAK))
        share = np.exp(log_peaks - np.logaddexp.reduce(log_peaks, axis=0))
        of_y = -2.0 * y / (1.0 + y**2)
        columns = np.stack([share, share * of_y * -2.0 * slope * self.span, share * of_y * y], axis=1)
        return np.asarray(columns.reshape(-1, self.frequency.size).T / self.sigma[:, None])


def fit_peaks(
    frequency: Real, rate: Real, relative_uncertainty: Real | None = None, *, peaks: int | None = None
) -> PeakFit:
    """Fit one peak or two.

    The information criterion decides unless `peaks` states the number. Parameters: `frequency` (n,) Hz, rising, n at
    least 5, for two peaks at least 9; `rate` (n,) positive, in any unit; `relative_uncertainty` (n,) its standard
    deviations over itself, None if not stated.
    """
    count = frequency.size
    data = _Data(frequency, np.log(rate), np.ones(count) if relative_uncertainty is None else relative_uncertainty)
    is_stated, preference = relative_uncertainty is not None, None
    found = _best(data, _double_starts(data) if peaks == 2 else _single_starts(data))
    if peaks is None and count >= LEAST_FOR_TWO:
        two = _best(data, _double_starts(data))
        # If even two peaks contradict the stated noise, it would prefer any second peak.
        is_known = is_stated and not _is_contradicted(two, count)
        preference = _criterion(found, count, is_known) - _criterion(two, count, is_known)
        if preference > STRONG and min(_peak_points(data, two)) >= LEAST_POINTS:
            found = two
    findings = []
    scatter = float(np.sqrt(_chi_square(found) / _freedom(found, count)))
    if is_stated and _is_contradicted(found, count):
        is_stated = False
        findings.append(f"the recorded points scatter about the fitted peaks {scatter:.2g} times as widely as their "
                        "stated uncertainty: the intervals follow from the scatter")
    scale = 1.0 if is_stated else scatter
    tail = 0.5 + 0.5 * PROBABILITY
    quantile = norm.ppf(tail) if is_stated else student.ppf(tail, _freedom(found, count))
    return PeakFit(_peaks(data, found, scale * float(quantile), findings), scale * float(np.sqrt(np.mean(
        data.sigma**2))), is_stated, preference, tuple(findings))


def _chi_square(found: OptimizeResult) -> float:
    return 2.0 * float(found.cost)


def _freedom(found: OptimizeResult, count: int) -> int:
    return count - found.x.size


def _is_contradicted(found: OptimizeResult, count: int) -> bool:
    return bool(chi2.sf(_chi_square(found), _freedom(found, count)) < CONTRADICTED)


def _criterion(found: OptimizeResult, count: int, is_known: bool) -> float:
    """The Bayesian information criterion of a fit, without its common constant. With a noise from the residual, the
    penalty is that of small samples (McQuarrie 1999, Stat. Probab. Lett. 44, 79)."""
    size = found.x.size
    if is_known:
        return float(_chi_square(found) + size * np.log(count))
    return float(count * np.log(_chi_square(found) / count + ROUNDING**2)
                 + size * np.log(count) * count / (count - size - 2))


def _single_starts(data: _Data) -> Real:
    """Single peaks (starts, 1, 3) on a grid, best first."""
    low, high = data.bounds(1)
    place, q = np.meshgrid(np.linspace(low[1], high[1], 49), np.linspace(low[2], high[2], 10), indexing="ij")
    x = np.stack([np.zeros(place.size), place.ravel(), q.ravel()], axis=1)[:, None, :]
    return _ranked(data, x, place.ravel())


def _double_starts(data: _Data) -> Real:
    """Pairs of peaks (starts, 2, 3) on a grid, best first."""
    places, (low, high) = np.linspace(0.0, 1.0, 15), data.bounds(1)
    q = np.linspace(low[2], high[2], 6)[1:]
    one, two = np.triu_indices(places.size, 1)
    pair, q1, q2, ratio = (each.ravel() for each in np.meshgrid(
        np.arange(one.size), q, q, np.log([0.1, 0.3, 1.0, 3.0, 10.0]), indexing="ij"))
    x = np.stack([np.stack([np.zeros(pair.size), places[one][pair], q1], axis=1),
                  np.stack([ratio, places[two][pair], q2], axis=1)], axis=1)
    return _ranked(data, x, pair)


def _ranked(data: _Data, x: Real, group: NDArray[np.generic]) -> Real:
    """The best start x (starts, peaks, 3) of each `group`, best first. The common height of the peaks is by least
    squares."""
    away = np.logaddexp.reduce(data.parts(x)[0], axis=1) - data.log_rate
    weight = 1.0 / data.sigma**2
    height = -(away @ weight) / weight.sum()
    cost = ((away + height[:, None]) ** 2) @ weight
    order = np.argsort(cost, kind="stable")
    first = np.sort(np.unique(group[order], return_index=True)[1])[:STARTS]
    best = x[order[first]].copy()
    best[:, :, 0] += height[order[first], None]
    return np.asarray(best)


def _best(data: _Data, starts: Real) -> OptimizeResult:
    bounds = data.bounds(starts.shape[1])
    return min((least_squares(data.residual, np.clip(start.ravel(), *bounds), data.jacobian, bounds=bounds,
                              max_nfev=STEPS) for start in starts), key=lambda each: each.cost)


def _peak_points(data: _Data, found: OptimizeResult) -> list[int]:
    y = data.parts(found.x.reshape(-1, OF_PEAK))[1]
    return [int(each) for each in np.count_nonzero(np.abs(y) <= 1.0, axis=1)]


def _peaks(data: _Data, found: OptimizeResult, reach: float, findings: list[str]) -> tuple[FittedPeak, ...]:
    """The peaks, the highest first; adds `findings`. `reach` is the half width of an interval at unit weight."""
    parameters, points = found.x.reshape(-1, OF_PEAK), _peak_points(data, found)
    low, high = (bound.reshape(-1, OF_PEAK) for bound in data.bounds(len(parameters)))
    at_bound = (parameters < low + AT_BOUND) | (parameters > high - AT_BOUND)
    half = reach * _deviations(data.jacobian(found.x), ~at_bound.ravel()).reshape(parameters.shape)
    peaks = []
    for k in np.argsort(-parameters[:, 0], kind="stable"):
        height, place, log_q = map(float, parameters[k])
        frequency, q, away = data.low + data.span * place, float(np.exp(log_q)), data.span * float(half[k, 1])
        words = f"the recorded peak at {frequency / 1e6:.4f} MHz"
        ends = f"the recorded band, {data.low / 1e6:.4f} to {(data.low + data.span) / 1e6:.4f} MHz"
        if not 0.0 <= place <= 1.0:
            findings.append(f"{words} lies outside {ends}, and is extrapolated: record beyond it")
        elif at_bound[k, 2]:
            findings.append(f"{words} has its Q at a bound, {q:.3g}: " + (
                f"a width of {NARROWEST:g} steps of the recording; smaller steps about the peak would resolve it"
                if log_q > 0.5 * (low[k, 2] + high[k, 2]) else f"{WIDEST:g} times {ends}, which shows no peak"))
        elif half[k, 2] > np.log(UNDETERMINED):
            findings.append(f"{words}: the recording does not determine its Q within a factor of {UNDETERMINED:g}")
        elif points[k] < LEAST_POINTS:
            findings.append(f"{words} has {points[k] or 'no'} recorded point{'' if points[k] == 1 else 's'} within its "
                            "half-power width: its f and Q follow from the flanks")
        is_known = not at_bound[k, 1] and half[k, 1] < 1.0
        q_known = not at_bound[k, 2] and half[k, 2] < np.log(UNDETERMINED)
        peaks.append(FittedPeak(
            frequency, (frequency - away, frequency + away) if is_known else None, q,
            (q * float(np.exp(-half[k, 2])), q * float(np.exp(half[k, 2]))) if q_known else None,
            float(np.exp(height)), points[k]))
    return tuple(peaks)


def _deviations(jacobian: Real, is_free: NDArray[np.bool_]) -> Real:
    """Standard deviations of the parameters at unit weight. They are infinite for parameters at a bound, and for all if
    the points do not determine a combination."""
    found = np.full(is_free.size, np.inf)
    free = jacobian[:, is_free]
    size = np.linalg.norm(free, axis=0)
    if np.all(size > 0.0):
        _, values, rows = np.linalg.svd(free / size, full_matrices=False)
        if values[-1] > SINGULAR * values[0]:
            found[is_free] = np.linalg.norm(rows / values[:, None], axis=0) / size
    return found
