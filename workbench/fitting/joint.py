"""The workbench's own fit: all parameters together, with exact gradients and bounds.

1. A descent from every start solves a sequence of ever less smoothed problems (see `search`) on a coarse mesh. With
   the overtones smoothed away the model matches the recording in few ways; as the smoothing is reduced, each overtone
   falls on its own neighbour.
2. The best end is refined on the requested mesh, with the data weighted by the noise of the residual.
3. While the residual is more than noise, further descents are made (see `multistart`): an overtone may lie on the wrong
   neighbour, or a film have the wrong thickness.
4. The uncertainty of every parameter is computed at the minimum (see `uncertainty`), and the reduced model is
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
from workbench.fitting.held import HeldNumber, held_numbers
from workbench.fitting.multistart import (
    PRIOR_SAMPLES,
    TRIES,
    FitEnd,
    FitMultistart,
    Refined,
    Start,
    listed_starts,
    prior_samples,
    where_they_ended,
)
from workbench.fitting.noise import Noise
from workbench.fitting.objective import FitRecording, Objective
from workbench.fitting.parameter import Parameter
from workbench.fitting.search import COARSE, NO_END, SEARCHED_POINTS, FitSearch, Optimum
from workbench.fitting.uncertainty import Direction, FitUncertainty, HeldOutBand, ParameterEstimate
from workbench.jobs.progress import Progress, no_progress
from workbench.model.hidden import hidden_coefficients
from workbench.results.brief import Brief
from workbench.results.comparison import Comparison, compare
from workbench.results.spectrum import Origin, Spectrum
from workbench.search.multistart import StartPoint, multistart

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Relative error of the reduced model at the end.
FINE = 3e-4

#: Most steps of a search on the requested mesh. Constants that a radial band shows only together lie in a narrow
#: valley: from a ceramic of another kind a search along it took 44 steps.
STEPS = 160


class FitError(RuntimeError):
    """A fit that cannot be made, with the mistake in its input."""


@dataclass(frozen=True, eq=False)
class Match:
    """A recording with the spectra of start and fit, and their residuals.

    ``start`` was predicted on the coarse mesh of the search.
    """

    name: str
    measured: Spectrum
    start: Spectrum
    fitted: Spectrum
    before: Comparison
    after: Comparison
    noise: Noise

    @classmethod
    def of(cls, name: str, measured: Spectrum, start: Complex, fitted: Complex, noise: Noise) -> Match:
        """The match of a recording with impedances (n,) of start and fit."""
        before, after = (Spectrum(measured.frequency, z, origin=Origin("simulated")) for z in (start, fitted))
        return cls(name, measured, before, after, compare(measured, before), compare(measured, after), noise)


@dataclass(frozen=True)
class TriedEntry:
    """A registry entry, and the rms of |ln ratio| of its fit. It is a short fit that took all its constants."""

    name: str
    rms: float


@dataclass(frozen=True, eq=False, repr=False)
class FitResult(Brief):
    """The result of a fit, with its uncertainty.

    ``estimates`` one for each free parameter, in their order; ``covariance`` (p, p) SI, prior included;
    ``undetermined`` directions that the data do not determine; ``bands`` predictions of parts of the band left out;
    ``check`` the largest relative difference from full solves and its frequency (Hz); ``seconds`` wall time;
    ``full_solves`` spent on all meshes; ``held`` fixed uncertain parameters, the largest part of the residual first;
    ``entries`` other ceramics that were tried as a whole since the residual is large; ``further`` descents that looked
    for a better optimum, ``untried`` starts without one; ``interrupted`` whether search or judgement ended early.
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
    held: tuple[HeldNumber, ...] = ()
    entries: tuple[TriedEntry, ...] = ()
    further: int = 0
    untried: int = 0
    interrupted: bool = False

    @property
    def correlation(self) -> Real:
        """(p, p)."""
        deviation = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(deviation, deviation))


def fit_parameters(
    recordings: Sequence[FitRecording], parameters: Sequence[Parameter], *,
    coarse: Sequence[FitRecording] | None = None, starts: Mapping[str, Real] | None = None,
    others: Mapping[str, Real] | None = None, tries: int = TRIES, seed: int = 0, profiles: bool = True,
    bands: int = 3, progress: Progress = no_progress,
) -> FitResult:
    """Fit `parameters` to `recordings`, with the uncertainty of each.

    Args:
        recordings: each with its problem on the mesh whose parameters are wanted.
        parameters: the free parameters, with prior and bounds; see `parameter.parameters`.
        coarse: the same recordings on coarser meshes, for the search; the recordings themselves if None.
        starts: further starts by label, vectors (p,) in SI; the parameters' own start is always the first.
        others: starts by label that are tried only where the recordings stay unexplained.
        tries: most further descents, while the recordings stay unexplained: from `others`, then from offsets of the
            best end, then from samples of the prior.
        profiles: profile likelihoods where the cost is not quadratic.
        bands: parts of the band to leave out in turn and predict; 0 for none.

    Interrupted once while it searches for a better optimum, or judges the best, it ends with the best so far.

    Raises:
        FitError: fewer data than parameters, or no start can be predicted at all.
        InputError: parameters that no passive solid can have.
    """
    started = time.perf_counter()
    points = sum(r.measured.frequency.size for r in recordings)
    if not parameters:
        raise FitError("there is nothing to fit: no parameter is free")
    if points < len(parameters):
        raise FitError(f"{points} points cannot determine {len(parameters)} parameters; "
                       "free fewer or record more points")
    searched = [r.thinned(SEARCHED_POINTS) for r in coarse or recordings]
    coarse_search = FitSearch(Objective.of(searched, parameters, tolerance=COARSE))
    before = []
    for index, recording in enumerate(recordings):
        # The search goes on with the models that predicted the spectra of the start.
        impedance, coarse_search.objective = uncertainty.unrefined(
            coarse_search.objective, coarse_search.centre, index, recording.measured.frequency, COARSE)
        before.append(impedance)
    begins = [StartPoint("start", coarse_search.centre), *_labelled(starts)]

    def from_start(start: StartPoint) -> FitEnd:
        done = begins.index(start)
        return FitEnd(coarse_search.descend(
            start.x, progress=lambda text, share: progress(text, 0.6 * (done + share) / len(begins))))

    trials = multistart(begins, from_start, refused=NO_END)
    ends = [trial.end.descent for trial in trials if trial.end is not None and trial.end.descent is not None]
    if not ends:
        raise FitError("no start could be predicted: " + trials[0].reason)
    search = FitSearch(Objective.of(recordings, parameters, tolerance=FINE))

    def refine(x: Real) -> Refined:
        progress("refining", 0.6)
        return reweighted_descent(search, x)

    further = FitMultistart(coarse_search, refine, min(ends, key=lambda end: end.cost), tries,
                            lambda label, share: progress(f"searching further: {label}", 0.6 + 0.25 * share))
    further.run(prior_samples(coarse_search, PRIOR_SAMPLES, seed), _labelled(others))
    minimum, noise = further.refined
    progress("judging", 0.85)

    def judged(profiles: bool, bands: int) -> tuple[FitUncertainty, tuple[HeldOutBand, ...]]:
        found = uncertainty.estimate_uncertainty(search, minimum, noise, profiles=profiles,
                                                 coarser=None if coarse is None else coarse_search.objective,
                                                 held=held_numbers(recordings, parameters))
        return found, uncertainty.leave_bands_out(search, minimum, noise, bands) if bands else ()

    interrupted = further.interrupted
    try:
        estimated, left_out = judged(profiles and not interrupted, 0 if interrupted else bands)
    except KeyboardInterrupt:
        if interrupted:
            raise
        interrupted, (estimated, left_out) = True, judged(False, 0)
    off, where, checks = uncertainty.reduced_model_error(search.objective, minimum.x)
    matches = tuple(Match.of(r.name, r.measured, first, last, own) for r, first, last, own in zip(
        recordings, before, minimum.residual.data.impedance, noise, strict=True))
    listed = listed_starts([*trials, *further.trials], further.reached, coarse_search, search)
    improved = all(m.after.rms_log_residual < m.before.rms_log_residual for m in matches)
    solves = search.objective.solves + coarse_search.objective.solves + checks
    findings = (*((_INTERRUPTED,) if interrupted else ()),
                *_findings(minimum, improved, listed, matches, left_out, (off, where)), *estimated.findings,
                *(f"{p.name} was freed without a tolerance: assumed, {p.assumed}." for p in parameters if p.assumed),
                *hidden_findings(recordings), *refused_steps([*coarse_search.refusals, *search.refusals]))
    progress("done", 1.0)
    return FitResult(
        "joint", matches, estimated.estimates, estimated.covariance, estimated.undetermined, listed, left_out,
        (off, where), minimum.converged, improved, minimum.iterations, findings,
        time.perf_counter() - started, solves, estimated.held, further=len(further.trials),
        untried=further.untried, interrupted=interrupted)


#: The finding of a fit that was interrupted.
_INTERRUPTED = "Interrupted: the result is the best so far, without profile likelihoods and without bands left out."


def _labelled(starts: Mapping[str, Real] | None) -> list[StartPoint]:
    return [StartPoint(label, np.asarray(x, dtype=float)) for label, x in (starts or {}).items()]


def reweighted_descent(search: FitSearch, x: Real) -> Refined:
    """The minimum near x with every recording weighted by its residual (:class:`Noise`)."""
    noise = [Noise.of(r.measured) for r in search.objective.recordings]
    share = len(search.parameters) / max(1, len(noise))
    for _ in range(3):
        minimum = search.minimise(x, [each.deviations() for each in noise], radius=0.3, tolerance=1e-7, limit=STEPS)
        x, before = minimum.x, noise
        noise = [each.scaled_to(log, parameters=share)
                 for each, log in zip(noise, minimum.residual.data.log_ratio, strict=True)]
        if all(abs(old.scale / new.scale - 1.0) < 0.02 for old, new in zip(before, noise, strict=True)):
            break
    return Refined(minimum, tuple(noise))


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


def hidden_findings(recordings: Sequence[FitRecording]) -> list[str]:
    """Statements of material constants that the sections do not show, each once."""
    hidden = dict.fromkeys(name for recording in recordings for name in hidden_coefficients(recording.problem))
    if not hidden:
        return []
    return [f"The model is the plane strain of a cross-section, whose spectrum does not depend on {', '.join(hidden)}: "
            "their stated values stay as they are, and a disc of the material shows them. Resonances along the length "
            "are not in the model, and the fit would mistake them for others."]


def refused_steps(refusals: Sequence[str]) -> list[str]:
    """A statement of the failed steps of a search, with reasons. There is none without failures."""
    if not refusals:
        return []
    kinds = Counter(refusals).most_common()
    return [f"{len(refusals)} steps of the search could not be taken and were shortened; most often, {kinds[0][1]} "
            f"times: {kinds[0][0]}"]
