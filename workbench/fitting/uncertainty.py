"""Uncertainty of a fit: intervals, correlations, and the directions that the data do not determine, at the minimum."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.mesh import MeshError
from workbench.fitting.measurement_model import CLOCK, log_ratio, through_bench
from workbench.fitting.objective import Objective
from workbench.fitting.parameter import Parameter
from workbench.fitting.search import REFUSED, FitSearch, Optimum, Weighted
from workbench.results.brief import Brief
from workbench.results.comparison import Comparison
from workbench.results.spectrum import Spectrum

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Confidence of every interval, as standard deviations and as a change of chi-square.
CONFIDENCE = 0.95
DEVIATIONS = 1.959964
CHI_SQUARE = DEVIATIONS**2

#: A parameter is determined if the data narrow what was known before by this factor or more.
NARROWED = 2.0

#: Where the cost at the end of an interval differs by more than this share from the quadratic's, it is profiled.
NOT_QUADRATIC = 0.3

#: A parameter closer to its bound than this share of the admitted range is at it.
AT_BOUND = 1e-3

#: A matrix inequality whose margin is smaller than this, relative, is active.
ACTIVE = 1e-6


@dataclass(frozen=True)
class Noise:
    """The distribution of the residual of one recording.

    ``deviation`` relative standard deviation of a point (root mean square over the band), ``correlation`` the number of
    neighbouring points that carry the information of one (1: white), ``stated`` whether the recording brought its own
    uncertainties, and ``ratio`` the factor by which the residual exceeds them (1 where it brought none).
    """

    deviation: float
    correlation: float
    stated: bool
    ratio: float


@dataclass(frozen=True)
class ParameterEstimate:
    """One fitted parameter, SI.

    ``standard_error`` holds the noise and the ``numerical`` error, what the mesh may have moved the value by; ``low``
    and ``high`` bound the 95 % interval; ``method`` says how it was found: "quadratic" or "profile";
    ``at_bound`` names the bound or inequality that holds the value, empty if none; ``determined`` is whether the data
    say more of it than was known before; ``narrowing`` the standard error over the prior.
    """

    parameter: Parameter
    value: float
    standard_error: float
    numerical: float
    low: float
    high: float
    method: str
    at_bound: str
    determined: bool
    narrowing: float


@dataclass(frozen=True)
class Direction:
    """A combination of parameters that the data do not determine.

    ``shares`` are (parameter name, component) of the unit vector in units of the priors, largest first; ``narrowing``
    how far the data narrow it; ``symmetry`` names the exact symmetry of the model it is, empty if none.
    """

    shares: tuple[tuple[str, float], ...]
    narrowing: float
    symmetry: str


@dataclass(frozen=True)
class HeldOutBand:
    """A part of a recording's band (Hz): rms of |ln ratio| there when it was fitted and when it was left out."""

    recording: str
    low: float
    high: float
    fitted_rms: float
    predicted_rms: float


@dataclass(frozen=True, eq=False, repr=False)
class FitUncertainty(Brief):
    """Estimates with intervals, their covariance (p, p) in SI, undetermined directions and findings in words."""

    estimates: tuple[ParameterEstimate, ...]
    covariance: Real
    undetermined: tuple[Direction, ...]
    findings: tuple[str, ...]


def noise_shape(measured: Spectrum) -> Real:
    """Relative standard deviation (n,) of each point up to a common factor: the spectrum's own, or constant.

    A deviation that all points share is left out: it is a number of the bench.
    """
    noise = measured.noise
    if noise is None:
        return np.ones(measured.frequency.size)
    return np.asarray(noise / measured.magnitude)


def noise(log_ratio: Complex, deviation: Real, stated: bool, ratio: float) -> Noise:
    """The noise that a residual (n,) shows."""
    return Noise(float(np.sqrt(np.mean(deviation**2))), correlation_length(log_ratio / deviation), stated,
                 ratio if stated else 1.0)


def correlation_length(residual: Complex) -> float:
    """The number of neighbouring points that carry the information of one: the integrated autocorrelation, at least 1.

    1 + 2 sum rho_k, summed up to five times itself (Sokal 1997, Monte Carlo methods in statistical mechanics, section
    3); 1 where the first correlation does not stand out of what white noise of so many points shows.
    """
    count = residual.size
    power = float(np.sum(np.abs(residual) ** 2))
    if count < 8 or power == 0.0:
        return 1.0
    padded = np.fft.fft(residual, 2 * count)
    correlation = np.fft.ifft(np.abs(padded) ** 2).real[:count] / power
    if correlation[1] < 3.0 / np.sqrt(2.0 * count):
        return 1.0
    length = 1.0
    for lag in range(1, count):
        length += 2.0 * float(correlation[lag])
        if lag >= 5.0 * length:
            break
    return max(1.0, length)


def estimate_uncertainty(
    search: FitSearch,
    minimum: Optimum,
    noise: Sequence[Noise],
    *,
    profiles: bool,
    coarser: Objective | None = None,
) -> FitUncertainty:
    """Intervals, correlations and undetermined directions at a minimum.

    The information of the data, J^T J / correlation, and of the prior add up; the covariance is the inverse of the sum.
    The difference of the spectrum at the minimum on the meshes of `coarser` gives the shift of the
    parameters by the mesh's own error (Richardson); it is added to the covariance.

    Where an inequality holds a value, the interval also covers where the data alone would put it: a loss constant
    that noise or rounding has pushed out of passivity is inside.
    """
    deviation = deviations(search, noise)
    here = search.evaluate(minimum.x, deviation)
    information = here.data.jacobian.T @ here.data.jacobian
    covariance = _inverse(information, search)
    near = search.with_objective(search.objective.truncated(_around(search, minimum.x, covariance)))
    evaluated = near.evaluate(minimum.x, deviation) if profiles else here
    shift = np.zeros(minimum.x.size)
    if coarser is not None:
        shift = covariance @ (here.data.jacobian.T @ _mesh_error(search, coarser, minimum.x, deviation))
    whole = covariance + np.outer(shift, shift)
    errors = np.sqrt(np.diag(whole))
    bounds = [_bound(search, minimum.x, i) for i in range(len(search.parameters))]
    alone = minimum.x - covariance @ (here.jacobian.T @ here.vector)
    estimates = []
    for i, parameter in enumerate(search.parameters):
        low, high, method = minimum.x[i] - DEVIATIONS * errors[i], minimum.x[i] + DEVIATIONS * errors[i], "quadratic"
        held = "bound" in bounds[i]
        if profiles and (held or _not_quadratic(near, minimum.x, evaluated, covariance, i, deviation)):
            ends = profile(near, minimum, i, float(np.sqrt(covariance[i, i])), deviation)
            low, high = (minimum.x[i] + sign * np.hypot(end - minimum.x[i], DEVIATIONS * shift[i])
                         for sign, end in zip((-1.0, 1.0), ends, strict=True))
            method = "profile"
        if bounds[i] and not held:
            low, high = (min(low, alone[i] - DEVIATIONS * errors[i]), max(high, alone[i] + DEVIATIONS * errors[i]))
        narrowing = errors[i] / search.scale[i]
        estimates.append(ParameterEstimate(
            parameter, float(minimum.x[i]), float(errors[i]), float(abs(shift[i])), float(max(low, parameter.low)),
            float(min(high, parameter.high)), method, bounds[i], bool(narrowing * NARROWED <= 1.0), float(narrowing)))
    undetermined = _undetermined(search, minimum.x, information)
    statements = _statements(search, estimates, undetermined)
    conditioned = [e.parameter.name for e in estimates if e.at_bound and "bound" not in e.at_bound]
    if conditioned:
        statements.append("The data alone, without that condition, would put " + ", ".join(
            f"{p.name} at {number:.5g}" for p, number in zip(search.parameters, alone, strict=True)
            if p.name in conditioned) + ".")
    if coarser is None:
        statements.append("The intervals do not hold the error of the mesh: no coarser mesh was given to tell it by.")
    return FitUncertainty(tuple(estimates), whole, undetermined, tuple(statements))


def _inverse(information: Real, search: FitSearch) -> Real:
    """Covariance (p, p) of data and prior together; a parameter without a prior is known to a fifth of its admitted
    range."""
    # Inverted in units of the scales: in SI the entries span forty orders of magnitude.
    scale = np.outer(search.scale, search.scale)
    return np.asarray(np.linalg.inv(information * scale + np.eye(search.scale.size)) * scale)


def _around(search: FitSearch, x: Real, covariance: Real) -> list[Real]:
    """The minimum x (p,), and points about it within which intervals and held-out bands are searched."""
    values, vectors = np.linalg.eigh(covariance / np.outer(search.scale, search.scale))
    around = [x]
    for value, vector in zip(values, vectors.T, strict=True):
        step = 3.0 * np.sqrt(max(value, 0.0)) * vector * search.scale
        around.append(np.clip(x + step, search.low, search.high))
    return around


def _mesh_error(search: FitSearch, coarser: Objective, x: Real, deviation: Sequence[Real]) -> Real:
    """Estimated weighted error (2 n,) of the predictions for the mesh of `search`, from that of `coarser`."""
    objective = search.objective
    result = []
    for index, (recording, other) in enumerate(zip(objective.recordings, coarser.recordings, strict=True)):
        fine = objective.predict(x, index)[0]
        cells, fewer = (r.problem.mesh.mesh.t.shape[1] for r in (recording, other))
        # Resonances, being eigenvalues, converge with twice the order of the fields (tests/verification).
        ratio = np.sqrt(cells / fewer) ** (2 * recording.problem.mesh.order) - 1.0
        # An error of the coarse reduced model is divided by the ratio too.
        tolerance = max(1.0, ratio) * objective.predictors[index].tolerance
        coarse, coarser = unrefined(coarser, x, index, recording.measured.frequency, tolerance)
        error = log_ratio(coarse, fine) / ratio / deviation[index]
        result += [error.real, error.imag]
    return np.concatenate(result)


def unrefined(
    coarser: Objective, x: Real, index: int, frequency: Real, tolerance: float
) -> tuple[Complex, Objective]:
    """The impedance (n,) of a recording as `coarser` predicts it at other frequencies (Hz), and the objective that
    goes on with the model of that."""
    values, bench = coarser.settings(x, index)
    predictor = coarser.predictors[index]
    prediction = predictor.at(frequency * (1.0 + bench.get(CLOCK, 0.0)), tolerance)(values)
    enriched = predictor.holding(prediction.model)
    going_on = [enriched if each is predictor else each for each in coarser.predictors]
    return through_bench(prediction.impedance, prediction.solution.omega, bench)[0], coarser.predicted_by(going_on)


def deviations(search: FitSearch, noise: Sequence[Noise]) -> list[Real]:
    """The relative deviation (n,) of every point, inflated so that the squares count independent data."""
    result = []
    for recording, level in zip(search.objective.recordings, noise, strict=True):
        shape = noise_shape(recording.measured)
        result.append(shape * (level.deviation * np.sqrt(level.correlation) / np.sqrt(np.mean(shape**2))))
    return result


def _bound(search: FitSearch, x: Real, index: int) -> str:
    """The bound or inequality that holds a parameter where it is."""
    parameter = search.parameters[index]
    width = parameter.high - parameter.low
    if x[index] - parameter.low < AT_BOUND * width:
        return f"lower bound {parameter.low:.4g}"
    if parameter.high - x[index] < AT_BOUND * width:
        return f"upper bound {parameter.high:.4g}"
    for inequality in search.inequalities:
        if inequality.slopes[index].any() and inequality.margin(x) < ACTIVE:
            return inequality.name
    return ""


def _not_quadratic(
    search: FitSearch, x: Real, here: Weighted, covariance: Real, index: int, deviation: Sequence[Real]
) -> bool:
    """Whether the cost at the ends of the quadratic's interval, the others following, is not the quadratic's.

    `here` is what `search` says at the minimum x (p,).
    """
    cost = float(here.vector @ here.vector)
    slope = 2.0 * (here.jacobian.T @ here.vector)
    direction = covariance[:, index] / np.sqrt(covariance[index, index])
    for sign in (-1.0, 1.0):
        step = sign * DEVIATIONS * direction
        try:
            there = search.evaluate(x + step, deviation)
        except REFUSED:
            return True
        # Where an inequality holds the minimum, the cost has a slope there, which the quadratic knows too.
        rise = float(there.vector @ there.vector) - cost - float(slope @ step)
        if abs(rise / CHI_SQUARE - 1.0) > NOT_QUADRATIC:
            return True
    return False


def profile(
    search: FitSearch, minimum: Optimum, index: int, error: float, deviation: Sequence[Real]
) -> tuple[float, float]:
    """The 95 % interval of one parameter with all others refitted at every value (profile likelihood).

    Ends where chi-square has risen by 3.84, or at the bound of the parameter.
    """
    base = search.evaluate(minimum.x, deviation)
    cost = 0.5 * float(base.vector @ base.vector)

    def rise(value: float, near: Real) -> tuple[float, Real]:
        x = near.copy()
        x[index] = value
        found = search.minimise(x, deviation, fixed=(index,), limit=8, tolerance=1e-3 / max(cost, 1e-3), radius=0.3)
        return 2.0 * (found.cost - cost), found.x

    ends = []
    for sign, bound in ((-1.0, search.low[index]), (1.0, search.high[index])):
        inside, x, last = minimum.x[index], minimum.x, 0.0
        outside: float | None = None
        step, known = DEVIATIONS * error, False
        for _ in range(12):
            trial = 0.5 * (inside + outside) if outside is not None else inside + sign * step
            if sign * (trial - bound) > 0.0:
                trial = bound - sign * 1e-6 * (search.high[index] - search.low[index])
            try:
                height, other = rise(float(trial), x)
            except (ValueError, MeshError):  # no admissible point with the parameter there, or no chip
                height, other = np.inf, x
            if height > CHI_SQUARE:
                outside = float(trial)
                if np.isfinite(height) and height - last > 0.0:
                    # The cost is close to a parabola about the minimum: its root is a better guess than the middle.
                    guess = minimum.x[index] + (trial - minimum.x[index]) * np.sqrt(CHI_SQUARE / height)
                    if min(inside, outside) < guess < max(inside, outside):
                        height, other = rise(float(guess), x)
                        inside, outside = (inside, guess) if height > CHI_SQUARE else (guess, outside)
            else:
                inside, x, last = float(trial), other, height
                if abs(trial - bound) <= 2e-6 * (search.high[index] - search.low[index]):
                    break
            known = outside is not None and abs(outside - inside) < 0.05 * abs(outside - minimum.x[index])
            if known:
                break
        ends.append(float(outside if outside is not None and known else inside))
    return ends[0], ends[1]


def _undetermined(search: FitSearch, x: Real, information: Real) -> tuple[Direction, ...]:
    """Eigenvectors of the data's information in units of the priors along which less is learned than was known."""
    scale = search.scale
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    result = []
    for value, vector in zip(values, vectors.T, strict=True):
        # The standard error with the prior is 1 / sqrt(1 + value) of the prior.
        narrowing = float(1.0 / np.sqrt(1.0 + max(value, 0.0)))
        if narrowing * NARROWED <= 1.0:
            continue
        if sum(share**2 for share, p in zip(vector, search.parameters, strict=True) if p.nuisance) > 0.5:
            continue
        order = np.argsort(-np.abs(vector))
        shares = tuple((search.parameters[i].name, float(vector[i])) for i in order if abs(vector[i]) > 0.1)
        result.append(Direction(shares, narrowing, _symmetry(search, x, vector * scale)))
    return tuple(result)


#: Exponents with which quantities change under the exact symmetries of a free transducer.
_SYMMETRIES: dict[str, dict[str, float]] = {
    "density gauge: (density, stiffness, piezoelectric constants) times (s, s, sqrt s) leaves Z of a free transducer "
    "unchanged": {"density": 1.0, "c": 1.0, "e": 0.5},
    "size gauge: all lengths times s, density times s^-3, stiffness and permittivity times s^-1, piezoelectric "
    "constants times s^-1 leave Z of a free transducer unchanged":
        {"length": 1.0, "density": -3.0, "c": -1.0, "e": -1.0, "eps": -1.0},
}


def _symmetry(search: FitSearch, x: Real, direction: Real) -> str:
    """The exact symmetry that a direction of parameter space is, by its relative changes."""
    if any(len(r.problem.materials) > 1 for r in search.objective.recordings):
        return ""
    relative = direction / np.where(x == 0.0, search.scale, x)
    for text, exponents in _SYMMETRIES.items():
        expected = np.array([exponents.get(_quantity(p), 0.0) for p in search.parameters])
        if not expected.any():
            continue
        cosine = abs(float(expected @ relative)) / (np.linalg.norm(expected) * np.linalg.norm(relative))
        if cosine > 0.99:
            return text
    return ""


def _quantity(parameter: Parameter) -> str:
    if parameter.is_dimension:
        return parameter.parsed.quantity
    last = parameter.parsed.coefficient
    for prefix in ("eps", "e", "c"):
        if last.startswith(prefix) and last != "density":
            return prefix
    return last


def leave_bands_out(search: FitSearch, minimum: Optimum, noise: Sequence[Noise], parts: int) -> tuple[HeldOutBand, ...]:
    """Fit without each of `parts` equal parts of every recording's band in turn, and predict the part left out."""
    result = []
    base = deviations(search, noise)
    logs = search.evaluate(minimum.x, base).data.log_ratio
    for index, recording in enumerate(search.objective.recordings):
        frequency = recording.measured.frequency
        edges = np.linspace(frequency[0], frequency[-1], parts + 1)
        for low, high in itertools.pairwise(edges):
            inside = (frequency >= low) & (frequency <= high)
            if np.count_nonzero(inside) < 2 or np.count_nonzero(~inside) < 2:
                continue
            # A point of infinite deviation has no say.
            without = [np.where(inside, np.inf, d) if i == index else d for i, d in enumerate(base)]
            found = search.minimise(minimum.x, without, limit=10, tolerance=1e-4, radius=0.3)
            predicted = found.residual.data.log_ratio[index]
            result.append(HeldOutBand(recording.name, float(low), float(high), _rms(logs[index][inside]),
                                      _rms(predicted[inside])))
    return tuple(result)


def reduced_model_error(objective: Objective, x: Real, *, count: int = 3) -> tuple[float, float, int]:
    """The largest relative difference of the reduced model from full solves, where (Hz), and how many these were.

    At the smallest and largest |Z| of every recording, where errors are largest, and where the estimate is worst.
    """
    worst, where, solves = 0.0, 0.0, 0
    for index, predictor in enumerate(objective.predictors):
        values, _ = objective.settings(x, index)
        _, _, prediction = objective.predict(x, index)
        size = np.abs(prediction.impedance)
        chosen = sorted({int(np.argmin(size)), int(np.argmax(size)), int(np.argmax(prediction.error))})[:count]
        full = predictor.full(values, predictor.frequencies[chosen])
        solves += len(chosen)
        off = np.abs(prediction.impedance[chosen] / full - 1.0)
        if off.max() > worst:
            worst, where = float(off.max()), float(predictor.frequencies[chosen][int(np.argmax(off))])
    return worst, where, solves


def residual_findings(name: str, after: Comparison, noise: Noise) -> list[str]:
    """The unexplained part of one recording, and where it lies, in words."""
    result = []
    residual = np.abs(after.log_residual)
    power = residual**2
    frequency = after.measured.frequency
    # The narrowest window that holds half of the residual.
    total = np.concatenate(([0.0], np.cumsum(power)))
    ends = np.searchsorted(total, total[:-1] + 0.5 * total[-1])
    valid = ends < total.size
    widths = np.where(valid, frequency[np.minimum(ends, frequency.size) - 1] - frequency, np.inf)
    first = int(np.argmin(widths))
    last = int(min(ends[first], frequency.size) - 1)
    result.append(
        f"{name}: {100 * after.rms_log_residual:.2g} % rms remains (MAPE of |Z| {after.mape_percent:.2g} %, largest "
        f"{after.worst_percent:.2g} % at {after.worst_frequency / 1e3:.1f} kHz); half of it lies between "
        f"{frequency[first] / 1e3:.1f} and {frequency[last] / 1e3:.1f} kHz.")
    if noise.correlation > 1.0:
        result.append(f"{name}: the residual is no white noise, {noise.correlation:.1f} neighbouring points carry the "
                      "information of one: something systematic is left, and the intervals are widened for it.")
    if noise.stated and noise.ratio > 1.2:
        result.append(f"{name}: the residual is {noise.ratio:.2g} times the recording's stated uncertainty.")
    return result


def _statements(search: FitSearch, estimates: Sequence[ParameterEstimate],
                undetermined: Sequence[Direction]) -> list[str]:
    result = []
    for found in estimates:
        if found.at_bound:
            beyond = found.parameter.beyond if "bound" in found.at_bound else ""
            result.append(f"{found.parameter.name} is held by {found.at_bound}{beyond and f', {beyond}'}.")
        if not found.determined and not found.parameter.nuisance:
            result.append(f"{found.parameter.name} is not determined by these data: its interval is that of the prior "
                          f"narrowed to {100 * found.narrowing:.0f} %.")
    for direction in undetermined:
        listed = ", ".join(f"{share:+.2f} {name}" for name, share in direction.shares[:6])
        result.append(f"Not determined: the combination {listed}" + (
            f", the {direction.symmetry}." if direction.symmetry else "."))
    return result


def _rms(values: Complex) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))
