"""Uncertainty of a fit at its minimum: intervals, correlations, and undetermined directions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.mesh import MeshError
from workbench.files.quantities import shown_number
from workbench.fitting.covariance import covariance_root
from workbench.fitting.held import NARROWED, HeldNumber, held_moves, judge_held
from workbench.fitting.measurement_model import CLOCK, log_ratio, rms, through_bench
from workbench.fitting.noise import STRUCTURED, Noise
from workbench.fitting.objective import Objective
from workbench.fitting.parameter import Parameter
from workbench.fitting.search import REFUSED, FitSearch, Optimum, Weighted
from workbench.results.brief import Brief
from workbench.results.comparison import Comparison

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Confidence of every interval, as standard deviations and as a change of chi-square.
CONFIDENCE = 0.95
DEVIATIONS = 1.959964
CHI_SQUARE = DEVIATIONS**2

#: Where the cost at the end of an interval differs by more than this share from the quadratic's, it is profiled.
NOT_QUADRATIC = 0.3

#: The end of a profile is known to this share of its distance.
END_KNOWN = 0.05

#: A parameter closer to its bound than this share of the admitted range is at it.
AT_BOUND = 1e-3

#: A matrix inequality whose margin is smaller than this, relative, is active.
ACTIVE = 1e-6


@dataclass(frozen=True)
class ParameterEstimate:
    """One fitted parameter, SI.

    ``standard_error`` includes the noise, the ``numerical`` error of the mesh, and ``held``, that by fixed parameters;
    ``low`` and ``high`` bound the 95 % interval, by the ``method`` "quadratic" or "profile"; ``at_bound`` names the
    active bound or inequality, empty if none; ``narrowing`` is the standard error over the prior, and ``determined``
    whether it is a half or less. All are NaN where an algorithm gives a value alone.
    """

    parameter: Parameter
    value: float
    standard_error: float = math.nan
    numerical: float = math.nan
    low: float = math.nan
    high: float = math.nan
    method: str = "none"
    at_bound: str = ""
    determined: bool = True
    narrowing: float = math.nan
    held: float = 0.0


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
    """A part of a band (Hz), with its fitted and predicted rms. Both are of |ln ratio|."""

    recording: str
    low: float
    high: float
    fitted_rms: float
    predicted_rms: float


@dataclass(frozen=True, eq=False, repr=False)
class FitUncertainty(Brief):
    """Estimates with covariance (p, p) in SI, undetermined directions, findings, fixed parameters."""

    estimates: tuple[ParameterEstimate, ...]
    covariance: Real
    undetermined: tuple[Direction, ...]
    findings: tuple[str, ...]
    held: tuple[HeldNumber, ...] = ()


def estimate_uncertainty(
    search: FitSearch, minimum: Optimum, noise: Sequence[Noise], *, profiles: bool, coarser: Objective | None = None,
    held: Sequence[Parameter] = (),
) -> FitUncertainty:
    """Intervals, correlations and undetermined directions at a minimum.

    The covariance is the inverse of the information of the data, J^T J / correlation, and of the prior together. The
    difference from the spectrum on the meshes of `coarser` gives the shift of the parameters by the mesh's own error
    (Richardson); it is added to the covariance, and so are the shifts by the uncertainties of the parameters `held`.

    At an active inequality, the interval also covers the optimum of the data alone: a loss constant that noise or
    rounding has pushed out of passivity is inside.
    """
    x, deviation = minimum.x, [each.effective for each in noise]
    here = search.evaluate(x, deviation)
    # Inverted in units of the scales: in SI the entries span forty orders of magnitude.
    units = np.outer(search.scale, search.scale)
    information = here.data.jacobian.T @ here.data.jacobian * units
    covariance: Real = np.asarray(np.linalg.inv(information + np.eye(x.size)) * units)
    # Intervals and held-out bands are searched within three standard errors.
    steps = 3.0 * search.scale * covariance_root(covariance / units).T
    around = [x, *np.clip(x + steps, search.low, search.high)]
    near = search.with_objective(search.objective.truncated(around))
    evaluated = near.evaluate(x, deviation) if profiles else here
    shift = np.zeros(x.size)
    if coarser is not None:
        shift = covariance @ (here.data.jacobian.T @ _mesh_error(search, coarser, x, deviation))
    by_held, moves = held_moves(search.objective, x, held, deviation, here.data, covariance)
    whole = covariance + np.outer(shift, shift) + moves @ moves.T
    errors, of_held = np.sqrt(np.diag(whole)), np.linalg.norm(moves, axis=1)
    alone = x - covariance @ (here.jacobian.T @ here.vector)
    estimates = []
    for i, parameter in enumerate(search.parameters):
        bound, reach, method = _bound(search, x, i), DEVIATIONS * errors[i], "quadratic"
        low, high = x[i] - reach, x[i] + reach
        if profiles and ("bound" in bound or _not_quadratic(near, x, evaluated, covariance, i, deviation)):
            further = DEVIATIONS * np.hypot(shift[i], of_held[i])
            low, high = (x[i] + sign * np.hypot(end - x[i], further) for sign, end in zip(
                (-1.0, 1.0), profile(near, minimum, i, covariance, deviation), strict=True))
            method = "profile"
        if bound and "bound" not in bound:
            low, high = min(low, alone[i] - reach), max(high, alone[i] + reach)
        narrowing = float(errors[i] / search.scale[i])
        estimates.append(ParameterEstimate(
            parameter, float(x[i]), float(errors[i]), float(abs(shift[i])), float(max(low, parameter.low)),
            float(min(high, parameter.high)), method, bound, narrowing * NARROWED <= 1.0, narrowing, float(of_held[i])))
    undetermined = _undetermined(search, x, information)
    statements = _statements(estimates, undetermined)
    conditioned = [f"{e.parameter.name} at {shown_number(number, e.parameter.unit)}"
                   for e, number in zip(estimates, alone, strict=True)
                   if e.at_bound and "bound" not in e.at_bound]
    if conditioned:
        statements.append(f"The data alone, without that condition, would put {', '.join(conditioned)}.")
    if coarser is None:
        statements.append("The intervals do not hold the error of the mesh: no coarser mesh was given to tell it by.")
    return FitUncertainty(tuple(estimates), whole, undetermined, tuple(statements),
                          judge_held(here.data, moves, by_held, errors, search.parameters, held))


def _mesh_error(search: FitSearch, coarser: Objective, x: Real, deviation: Sequence[Real]) -> Real:
    """Estimated weighted mesh error (2 n,) of predictions, from the `coarser` mesh."""
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
    """The impedance (n,) of a recording by `coarser` at other frequencies (Hz). The second result is the objective with
    the model used."""
    values, bench = coarser.settings(x, index)
    predictor = coarser.predictors[index]
    prediction = predictor.at(frequency * (1.0 + bench.get(CLOCK, 0.0)), tolerance)(values)
    enriched = predictor.holding(prediction.model)
    going_on = [enriched if each is predictor else each for each in coarser.predictors]
    return through_bench(prediction.impedance, prediction.solution.omega, bench)[0], coarser.predicted_by(going_on)


def _bound(search: FitSearch, x: Real, index: int) -> str:
    """The active bound or inequality of a parameter."""
    low, high, near = search.low[index], search.high[index], AT_BOUND * (search.high[index] - search.low[index])
    if x[index] - low < near:
        return f"lower bound {shown_number(low, search.parameters[index].unit)}"
    if high - x[index] < near:
        return f"upper bound {shown_number(high, search.parameters[index].unit)}"
    return next((inequality.name for inequality in search.inequalities
                 if inequality.slopes[index].any() and inequality.margin(x) < ACTIVE), "")


def _not_quadratic(
    search: FitSearch, x: Real, here: Weighted, covariance: Real, index: int, deviation: Sequence[Real]
) -> bool:
    """Whether the cost at the interval's ends differs from the quadratic. The other parameters follow.

    `here` is the evaluation at the minimum x (p,).
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
    search: FitSearch, minimum: Optimum, index: int, covariance: Real, deviation: Sequence[Real]
) -> tuple[float, float]:
    """The 95 % interval of one parameter by profile likelihood.

    It ends where chi-square has risen by 3.84 with all others refitted, or at a bound. Refits start from the prediction
    of the `covariance` (p, p): far along a narrow valley one ends early, and the interval with it.
    """
    base = search.evaluate(minimum.x, deviation)
    cost = 0.5 * float(base.vector @ base.vector)

    def refitted(value: float, near: Real) -> tuple[float, Real]:
        """The rise of chi-square at a value, and the others' optimum."""
        x = np.clip(near + covariance[:, index] / covariance[index, index] * (value - near[index]), search.low,
                    search.high)
        try:
            there = search.minimise(x, deviation, fixed=(index,), limit=8, tolerance=1e-3 / max(cost, 1e-3), radius=0.3)
        except (ValueError, MeshError):  # no admissible point with the parameter there, or no chip
            return np.inf, near
        return 2.0 * (there.cost - cost), there.x

    here, step, ends = float(minimum.x[index]), DEVIATIONS * float(np.sqrt(covariance[index, index])), list[float]()
    for sign, bound in ((-1.0, search.low[index]), (1.0, search.high[index])):
        edge = bound - sign * 1e-6 * (search.high[index] - search.low[index])
        inside, outside, near, trial = here, None, minimum.x, here + sign * step
        for _ in range(12):
            trial = sign * min(sign * trial, sign * edge)
            rise, x = refitted(trial, near)
            # The end, if the cost is a parabola through the minimum and the trial.
            root = here + (trial - here) * float(np.sqrt(CHI_SQUARE / max(rise, 1e-3)))
            if abs(rise / CHI_SQUARE - 1.0) < 2.0 * END_KNOWN and sign * root < sign * bound:
                inside = root
                break
            if rise > CHI_SQUARE:
                outside = trial
            else:
                inside, near = trial, x
                if trial == edge:
                    break
            if outside is None:
                trial = inside + sign * step
            elif abs(outside - inside) < END_KNOWN * abs(outside - here):
                inside = outside
                break
            else:
                between = sign * inside < sign * root < sign * outside
                trial = root if between else 0.5 * (inside + outside)
        ends.append(float(inside))
    return ends[0], ends[1]


def _undetermined(search: FitSearch, x: Real, information: Real) -> tuple[Direction, ...]:
    """Eigenvectors of the data's information that adds less than the priors. They are in units of the priors."""
    result, nuisance = [], np.array([p.nuisance for p in search.parameters])
    values, vectors = np.linalg.eigh(information)
    for value, vector in zip(values, vectors.T, strict=True):
        # The standard error with the prior is 1 / sqrt(1 + value) of the prior.
        narrowing = float(1.0 / np.sqrt(1.0 + max(value, 0.0)))
        if narrowing * NARROWED > 1.0 and np.sum(vector[nuisance] ** 2) <= 0.5:
            shares = tuple((search.parameters[i].name, float(vector[i]))
                           for i in np.argsort(-np.abs(vector)) if abs(vector[i]) > 0.1)
            result.append(Direction(shares, narrowing, _symmetry(search, x, vector * search.scale)))
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
    """The exact symmetry of a direction, by its relative changes."""
    if any(len(r.problem.materials) > 1 for r in search.objective.recordings):
        return ""
    relative = direction / np.where(x == 0.0, search.scale, x)
    for text, exponents in _SYMMETRIES.items():
        expected = np.array([exponents.get(_quantity(p), 0.0) for p in search.parameters])
        size = np.linalg.norm(expected) * np.linalg.norm(relative)
        if size > 0.0 and abs(float(expected @ relative)) > 0.99 * size:
            return text
    return ""


def _quantity(parameter: Parameter) -> str:
    """The kind of a number, as in :data:`_SYMMETRIES`; empty for any other."""
    if parameter.is_dimension:
        return parameter.parsed.quantity
    return next((kind for kind in ("density", "eps", "e", "c") if parameter.parsed.coefficient.startswith(kind)), "")


def leave_bands_out(search: FitSearch, minimum: Optimum, noise: Sequence[Noise], parts: int) -> tuple[HeldOutBand, ...]:
    """Predictions of equal `parts` of each band by fits without them."""
    result, base = [], [each.effective for each in noise]
    logs = search.evaluate(minimum.x, base).data.log_ratio
    for index, recording in enumerate(search.objective.recordings):
        frequency = recording.measured.frequency
        edges = np.linspace(frequency[0], frequency[-1], parts + 1)
        for low, high in itertools.pairwise(edges):
            inside = (frequency >= low) & (frequency <= high)
            if np.count_nonzero(inside) < 2 or np.count_nonzero(~inside) < 2:
                continue
            # A point of infinite deviation has no weight.
            without = [np.where(inside, np.inf, d) if i == index else d for i, d in enumerate(base)]
            refitted = search.minimise(minimum.x, without, limit=10, tolerance=1e-4, radius=0.3)
            predicted = refitted.residual.data.log_ratio[index]
            result.append(HeldOutBand(recording.name, float(low), float(high), rms(logs[index][inside]),
                                      rms(predicted[inside])))
    return tuple(result)


def reduced_model_error(objective: Objective, x: Real) -> tuple[float, float, int]:
    """The reduced model's largest relative error, its frequency (Hz), and the solves.

    Full solves are made at the smallest and largest |Z| of every recording, and at the worst error estimate.
    """
    worst, where, solves = 0.0, 0.0, 0
    for index, predictor in enumerate(objective.predictors):
        _, _, prediction = objective.predict(x, index)
        size = np.abs(prediction.impedance)
        chosen = sorted({int(np.argmin(size)), int(np.argmax(size)), int(np.argmax(prediction.error))})
        frequency = predictor.frequencies[chosen]
        off = np.abs(prediction.impedance[chosen] / predictor.full(objective.settings(x, index)[0], frequency) - 1.0)
        solves += len(chosen)
        if off.max() > worst:
            worst, where = float(off.max()), float(frequency[int(np.argmax(off))])
    return worst, where, solves


def residual_findings(name: str, after: Comparison, noise: Noise) -> list[str]:
    """The unexplained part of one recording, and where it lies, in words."""
    frequency = after.measured.frequency
    # The narrowest window that holds half of the residual.
    total = np.concatenate(([0.0], np.cumsum(np.abs(after.log_residual) ** 2)))
    ends = np.searchsorted(total, total[:-1] + 0.5 * total[-1])
    last = np.minimum(ends, frequency.size) - 1
    first = int(np.argmin(np.where(ends < total.size, frequency[last] - frequency, np.inf)))
    result = [f"{name}: {100 * after.rms_log_residual:.2g} % rms remains (MAPE of |Z| {after.mape_percent:.2g} %, "
              f"largest {after.worst_percent:.2g} % at {after.worst_frequency / 1e3:.1f} kHz); half of it lies between "
              f"{frequency[first] / 1e3:.1f} and {frequency[last[first]] / 1e3:.1f} kHz."]
    if noise.correlation > 1.0:
        result.append(f"{name}: the residual is no white noise, {noise.correlation:.1f} neighbouring points carry the "
                      "information of one: a systematic deviation remains, and the intervals are widened for it.")
    if noise.ratio > STRUCTURED:
        result.append(f"{name}: the residual is {noise.ratio:.2g} times the recording's stated uncertainty.")
    return result


def _statements(estimates: Sequence[ParameterEstimate], undetermined: Sequence[Direction]) -> list[str]:
    result = []
    for estimate in estimates:
        if estimate.at_bound:
            beyond = "" if "bound" not in estimate.at_bound else estimate.parameter.beyond or (
                "the end of its range: another --material begins elsewhere" if estimate.parameter.is_material else "")
            result.append(f"{estimate.parameter.name} is at an active bound: {estimate.at_bound}"
                          f"{beyond and f', {beyond}'}.")
        if not estimate.determined and not estimate.parameter.nuisance:
            interval = ("is no narrower than that of the prior" if estimate.narrowing >= 1.0 else
                        f"is that of the prior narrowed to {100 * estimate.narrowing:.0f} %")
            result.append(f"{estimate.parameter.name} is not determined by these data: its interval {interval}.")
    for direction in undetermined:
        listed = ", ".join(f"{share:+.2f} {name}" for name, share in direction.shares[:6])
        symmetry = direction.symmetry and f", the {direction.symmetry}"
        result.append(f"Not determined: the combination {listed}{symmetry}.")
    return result
