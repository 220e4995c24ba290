"""The workbench's own fit: all free parameters together, exact gradients, physical bounds, several starts.

1. A descent from every start solves a sequence of ever less smoothed problems (see `search`) on a coarse mesh. With
   the overtones smoothed away there are few ways to lay the model on the recording; as the smoothing is reduced, each
   overtone falls on its own neighbour.
2. The best end is refined on the mesh asked for, with the data weighted by the noise that the residual shows.
3. An overtone laid on the wrong neighbour, or a film of the wrong thickness, leaves more than the noise that the
   recording states. While that is so, further descents are made (see `multistart`): from the best end with the
   thickness of a film moved to its next optimum, with the stiffnesses that rule radial and shear overtones moved by
   about one overtone, together and apart, and from samples of the prior. A descent goes on for as long as it keeps up
   with the best; what ends about as low is refined, and leads where it leaves less.
4. The uncertainty of every parameter is worked out at the minimum (see `uncertainty`), and the reduced model is
   checked against full solves there.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.fitting import uncertainty
from workbench.fitting.multistart import (
    PRIOR_SAMPLES,
    FitEnd,
    FitMultistart,
    Refined,
    Start,
    listed_starts,
    prior_samples,
    where_they_ended,
)
from workbench.fitting.objective import FitRecording, Objective
from workbench.fitting.parameter import Parameter
from workbench.fitting.search import NO_END, SEARCHED_POINTS, FitSearch, Optimum
from workbench.fitting.uncertainty import Direction, HeldOutBand, Noise, ParameterEstimate
from workbench.jobs.progress import Progress, no_progress
from workbench.model.hidden import hidden_coefficients
from workbench.results.brief import Brief
from workbench.results.comparison import Comparison, compare
from workbench.results.spectrum import Origin, Spectrum
from workbench.search.multistart import StartPoint, multistart

Real = NDArray[np.float64]

#: Relative error of the reduced model while exploring, and at the end.
COARSE, FINE = 5e-2, 3e-4

class FitError(RuntimeError):
    """A fit that cannot be made: the mistake in recording, geometry or parameters, in words."""


@dataclass(frozen=True, eq=False)
class Match:
    """A recording with the spectra of the start and of the fit, and how far each is from it.

    ``start`` was predicted on the coarse mesh of the search.
    """

    name: str
    measured: Spectrum
    start: Spectrum
    fitted: Spectrum
    before: Comparison
    after: Comparison
    noise: Noise


@dataclass(frozen=True, eq=False, repr=False)
class FitResult(Brief):
    """The result of a fit, with its uncertainty.

    ``estimates`` one for each free parameter, in their order; ``covariance`` (p, p) SI, prior included;
    ``undetermined`` the directions the data say less of than was known before; ``bands`` predictions of parts of the
    band left out; ``check`` the largest relative difference from full solves and the frequency (Hz) it was found at;
    ``findings`` plain statements; ``seconds`` wall time; ``full_solves`` spent on all meshes.
    """

    algorithm: str
    recordings: tuple[Match, ...]
    estimates: tuple[ParameterEstimate, ...]
    covariance: Real
    undetermined: tuple[Direction, ...]
    starts: tuple[Start, ...]
    bands: tuple[HeldOutBand, ...]
    check: tuple[float, float]
    converged: bool
    improved: bool
    iterations: int
    findings: tuple[str, ...]
    seconds: float
    full_solves: int

    @property
    def correlation(self) -> Real:
        """(p, p)."""
        deviation = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(deviation, deviation))


def fit_parameters(
    recordings: Sequence[FitRecording],
    parameters: Sequence[Parameter],
    *,
    coarse: Sequence[FitRecording] | None = None,
    starts: Mapping[str, Real] | None = None,
    tries: int = 32,
    seed: int = 0,
    poisson: tuple[float, float] | None = None,
    profiles: bool = True,
    bands: int = 3,
    progress: Progress | None = None,
) -> FitResult:
    """Fit `parameters` to `recordings` and say what was found and how sure it is.

    Args:
        recordings: each with its problem on the mesh whose parameters are wanted.
        parameters: what may move, with prior and bounds; see `parameter.parameters`.
        coarse: the same recordings on coarser meshes, for the search; the recordings themselves if None.
        starts: further starts by label, vectors (p,) in SI; the parameters' own start is always the first.
        tries: how many further descents at most, where the recordings stay unexplained: from overtone offsets of the
            best end first, then from samples of the prior.
        poisson: bounds of Poisson's ratio of isotropic solids (default `admissible.POISSON_RATIO`).
        profiles: profile likelihoods where the cost is not quadratic.
        bands: parts of the band to leave out in turn and predict; 0 for none.

    Raises:
        FitError: fewer data than parameters, or no start can be predicted at all.
        InputError: parameters that no passive solid can have.
    """
    started = time.perf_counter()
    _check(recordings, parameters)
    show = progress or no_progress
    searched = [r.thinned(SEARCHED_POINTS) for r in coarse or recordings]
    coarse_search = FitSearch(Objective.of(searched, parameters, tolerance=COARSE), poisson=poisson)
    before = _start_spectra(coarse_search, recordings)
    begins = [StartPoint("start", coarse_search.centre),
              *(StartPoint(label, np.asarray(x, dtype=float)) for label, x in (starts or {}).items())]

    def from_start(start: StartPoint) -> FitEnd:
        before = begins.index(start)
        return FitEnd(coarse_search.descend(
            start.x, progress=lambda text, share: show(text, 0.6 * (before + share) / len(begins))))

    found = multistart(begins, from_start, refused=NO_END)
    ends = [trial.end.descent for trial in found if trial.end is not None and trial.end.descent is not None]
    if not ends:
        raise FitError("no start could be predicted: " + found[0].reason)
    search = FitSearch(Objective.of(recordings, parameters, tolerance=FINE), poisson=poisson)

    def refine(x: Real) -> Refined:
        show("refining", 0.6)
        return Refined(*reweighted_descent(search, x))

    further = FitMultistart(coarse_search, refine, min(ends, key=lambda end: end.cost), tries,
                            lambda label, _share: show(f"searching, {label}", 0.6))
    further.run(prior_samples(coarse_search, PRIOR_SAMPLES, seed))
    minimum, noise = further.refined.minimum, further.refined.noise
    show("judging", 0.85)
    estimated = uncertainty.estimate_uncertainty(search, minimum, noise, profiles=profiles,
                                                 coarser=None if coarse is None else coarse_search.objective)
    left_out = uncertainty.leave_bands_out(search, minimum, noise, bands) if bands else ()
    off, where, checks = uncertainty.reduced_model_error(search.objective, minimum.x)
    check = off, where
    matches = _matches(recordings, before, minimum, noise)
    listed = listed_starts([*found, *further.trials], further.reached, coarse_search, search)
    improved = all(m.after.rms_log_residual < m.before.rms_log_residual for m in matches)
    solves = search.objective.solves + coarse_search.objective.solves + checks
    show("done", 1.0)
    return FitResult(
        "joint", matches, estimated.estimates, estimated.covariance, estimated.undetermined, listed, left_out, check,
        minimum.converged, improved, minimum.iterations,
        (*_findings(minimum, improved, listed, matches, left_out, check), *estimated.findings, *assumed(parameters),
         *hidden_findings(recordings), *refused_steps([*coarse_search.refusals, *search.refusals])),
        time.perf_counter() - started, solves,
    )


def _start_spectra(coarse_search: FitSearch, recordings: Sequence[FitRecording]) -> list[NDArray[np.complex128]]:
    """The impedance of every recording's start, as it would be recorded, on the mesh of the search.

    The search goes on with the models that predicted it.
    """
    found = []
    for index, recording in enumerate(recordings):
        impedance, coarse_search.objective = uncertainty.unrefined(
            coarse_search.objective, coarse_search.centre, index, recording.measured.frequency, COARSE)
        found.append(impedance)
    return found


def reweighted_descent(search: FitSearch, x: Real) -> tuple[Optimum, tuple[Noise, ...]]:
    """The minimum near x with every recording weighted by the noise its own residual shows.

    The spectra's own uncertainties are scaled as a whole, or a constant relative deviation is found.
    """
    shapes = [uncertainty.noise_shape(r.measured) for r in search.objective.recordings]
    levels = [0.01 if r.measured.uncertainty is None else 1.0 for r in search.objective.recordings]
    for _ in range(3):
        deviation = [level * shape for level, shape in zip(levels, shapes, strict=True)]
        minimum = search.minimise(x, deviation, radius=0.3, tolerance=1e-7)
        x = minimum.x
        data = minimum.residual.data
        free = len(search.parameters) / max(1, len(levels))
        now = [float(np.sqrt(np.sum(np.abs(log / shape) ** 2) / max(1.0, 2.0 * log.size - free)))
               for log, shape in zip(data.log_ratio, shapes, strict=True)]
        steady = all(abs(a / b - 1.0) < 0.02 for a, b in zip(levels, now, strict=True))
        # A fit without noise would weigh rounding.
        levels = [max(level, 0.1 * FINE) for level in now]
        if steady:
            break
    noise = tuple(
        uncertainty.noise(log, level * shape, r.measured.uncertainty is not None, level)
        for log, level, shape, r in zip(data.log_ratio, levels, shapes, search.objective.recordings, strict=True))
    return minimum, noise


def _check(recordings: Sequence[FitRecording], parameters: Sequence[Parameter]) -> None:
    points = sum(r.measured.frequency.size for r in recordings)
    if not parameters:
        raise FitError("there is nothing to fit: no parameter is free")
    if points < len(parameters):
        raise FitError(f"{points} points cannot determine {len(parameters)} parameters; "
                       "free fewer or record more points")


def _matches(
    recordings: Sequence[FitRecording], before: Sequence[NDArray[np.complex128]], minimum: Optimum,
    noise: Sequence[Noise]
) -> tuple[Match, ...]:
    data = minimum.residual.data
    result = []
    for recording, first, last, level in zip(recordings, before, data.impedance, noise, strict=True):
        frequency = recording.measured.frequency
        start, fitted = (Spectrum(frequency, z, origin=Origin("simulated")) for z in (first, last))
        result.append(Match(recording.name, recording.measured, start, fitted, compare(recording.measured, start),
                            compare(recording.measured, fitted), level))
    return tuple(result)


def _findings(
    minimum: Optimum, improved: bool, starts: Sequence[Start], matches: Sequence[Match],
    bands: Sequence[HeldOutBand], check: tuple[float, float],
) -> list[str]:
    result = []
    if not minimum.converged:
        result.append(f"The search did not converge: {minimum.reason}.")
    if not improved:
        result.append("The fit is not better than its start.")
    result.append(where_they_ended(starts))
    for match in matches:
        result += uncertainty.residual_findings(match.name, match.after, match.noise)
    for band in bands:
        if band.predicted_rms > 3.0 * band.fitted_rms:
            result.append(f"{band.recording}: {band.low / 1e3:.1f} to {band.high / 1e3:.1f} kHz is predicted with an "
                          f"rms error of {100 * band.predicted_rms:.2g} % when left out, against "
                          f"{100 * band.fitted_rms:.2g} % when fitted: the parameters depend on that part of the band.")
    if check[0] > 10.0 * FINE:
        result.append(f"The reduced model is {check[0]:.1e} off a full solve at {check[1] / 1e3:.1f} kHz.")
    return result


def assumed(parameters: Sequence[Parameter]) -> list[str]:
    """A statement of every parameter whose prior nobody stated but its role lets assume."""
    return [f"{p.name} was freed without a tolerance: assumed, {p.assumed}." for p in parameters if p.assumed]


def hidden_findings(recordings: Sequence[FitRecording]) -> list[str]:
    """A statement of what the sections of recordings do not show of their materials, each once; none of round ones."""
    hidden = dict.fromkeys(name for recording in recordings for name in hidden_coefficients(recording.problem))
    if not hidden:
        return []
    return [f"The model is the plane strain of a cross-section, whose spectrum does not depend on {', '.join(hidden)}: "
            "what is stated of it stays as it is, and a disc of the material shows it. Resonances along the length are "
            "not in the model, and would be taken for others."]


def refused_steps(refusals: Sequence[str]) -> list[str]:
    """A statement of how many steps of a search could not be taken, and why; none where all could."""
    if not refusals:
        return []
    kinds = Counter(refusals).most_common()
    return [f"{len(refusals)} steps of the search could not be taken and were shortened; most often, {kinds[0][1]} "
            f"times: {kinds[0][0]}"]
