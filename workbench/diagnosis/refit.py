"""Explanations at full weight: on the meshes asked for, with the states held out, and what is outside the catalogue."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from workbench.diagnosis.findings import Alternative, Candidate, Refitted
from workbench.diagnosis.inhomogeneity import Inhomogeneity, inhomogeneity, wave_keys
from workbench.diagnosis.likelihood import (
    STEPS,
    Explanation,
    Hypothesis,
    LaplaceApproximation,
    Likelihood,
    LocalProblem,
)
from workbench.diagnosis.local_models import FINE, LocalModels
from workbench.diagnosis.modes import Mode, columns, strongest
from workbench.diagnosis.odds import INHOMOGENEITIES, REGION_SIZES
from workbench.diagnosis.weighting import Weighting
from workbench.fitting.covariance import NEGLIGIBLE, principal
from workbench.fitting.objective import Objective
from workbench.reduced.estimate import SLACK

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Steps of the refit of a hypothesis that is far behind, and of the numbers that states held out have of their own.
FEW_STEPS = 8

#: Times, at most, that models are made again about an optimum at full weight.
REMADE = 4

#: Share of what least squares leaves that an explanation leaves at most.
AS_GOOD = 1.05

#: Inflation of the noise from which on something outside the catalogue is looked for beside an explanation.
CONSPICUOUS = 1.2


def refit_candidate(models: LocalModels, candidate: Candidate, *, is_behind: bool = False) -> Refitted:
    """A candidate refitted at full weight from each of its ends, and the best of these.

    One that `is_behind` is refitted roughly: the size of its distance does not matter.

    Raises:
        NotConverged, NotEnriched, MeshError, InputError, ValueError, ArithmeticError: nothing near an end can be
            predicted, or is admissible.
    """
    optima = [_optimum(models, candidate.hypothesis, end, is_behind=is_behind) for end in candidate.ends]
    best = max(optima, key=lambda each: each[1].weighting.log_likelihood(each[1].log_ratio))[1].weighting
    likelihood, least = max(optima, key=lambda each: each[1].weighted(best).log_evidence)
    if not is_behind:
        likelihood, least = _with_deviations(models, likelihood, least)
    return _with_states_held_out(models, likelihood, least, is_behind=is_behind)


def _with_deviations(
    models: LocalModels, likelihood: Likelihood, least: Explanation
) -> tuple[Likelihood, Explanation]:
    """The explanation at its optimum with all deviations, and the likelihood of that place.

    Changes by parts are those of the device there, which may be far from the optimum of least squares. Where it leaves
    little more than that optimum, the explanation is told as it is there.
    """
    found, is_accurate, tolerance = least, True, 0.0
    for _ in range(REMADE):
        place = found.likeliest
        if not is_accurate:
            likelihood = likelihood.with_objective(likelihood.objective.enriched(place, tolerance))
        parts = _changes(models, likelihood.objective, likelihood.noise, place)[0]
        found, data = likelihood.whitened(replace(found, local=replace(found.local, parts=parts)))
        # One that leaves much of a recording need not be known as exactly as noise.
        tolerance = SLACK * FINE * max(_median_deviations(found.weighting))
        is_accurate = data.error <= tolerance
        has_moved = bool((np.abs(found.likeliest - place) > found.errors)[list(found.free)].any())
        if is_accurate and not has_moved:
            break
    there = replace(found, x=found.likeliest, log_ratio=data.log_ratio, impedances=data.impedance,
                    error_estimate=data.error)
    return likelihood, there if there.rms <= AS_GOOD * least.rms else found


def _with_states_held_out(
    models: LocalModels, likelihood: Likelihood, found: Explanation, *, is_behind: bool
) -> Refitted:
    """The explanation with its prediction of the states held out, and what is outside the catalogue beside it."""
    held = _held_out(models, found, found.likeliest)
    whole = likelihood.objective if held is None else likelihood.objective.joined(held.objective)
    every = Likelihood(likelihood.model, whole)
    parts, uneven = _changes(models, whole, every.noise, found.likeliest)
    found = replace(found, local=replace(found.local, parts=parts[:found.local.residual.size]))
    refitted = Refitted(found)
    if held is not None:
        there = held if found.x is found.likeliest else _held_out(models, found, found.x)
        assert there is not None
        refitted = Refitted(found, with_held_out(held, found, parts), tuple(there.impedances(found.x)))
    if found.weighting.largest > CONSPICUOUS and not is_behind:
        refitted = replace(refitted, alternatives=tuple(alternatives(every, found, uneven)))
    return refitted


def _changes(models: LocalModels, objective: Objective, noise: Real, place: Real) -> tuple[Real, Inhomogeneity]:
    """The changes of the data by inhomogeneity at a place (p,): of all parts, in units of the `noise` (m,), and all."""
    found = inhomogeneity(objective, place, wave_keys(models.model.uneven.values()))
    return _compressed(found.parts / noise[:, None], INHOMOGENEITIES[-1]), found


def _optimum(
    models: LocalModels, hypothesis: Hypothesis, end: LaplaceApproximation, *, is_behind: bool
) -> tuple[Likelihood, Explanation]:
    """The optimum at full weight near an end, on models made again about it where their error estimate is too large."""
    x, errors, noise = end.x, end.errors, 0.0
    for _ in range(1 if is_behind else REMADE):
        likelihood = models.near(hypothesis, x, errors, noise=noise)
        found = likelihood.refit(hypothesis, x, limit=FEW_STEPS if is_behind else STEPS)
        noise = _least_noise(found.weighting)
        own = models.model.of(hypothesis.effects, found.x)
        if own is likelihood.model and not models.are_inaccurate(found.error_estimate, noise):
            break
        x, errors = found.x, found.errors
    return likelihood, found


def _held_out(models: LocalModels, found: Explanation, place: Real) -> Likelihood | None:
    """The likelihood of the states held out about a place (p,); None without any."""
    if models.model.held_out is None:
        return None
    return models.near(found.hypothesis, place, found.errors, noise=_least_noise(found.weighting), held_out=True)


def _least_noise(weighting: Weighting) -> float:
    """The median deviation of the recording that deviates least."""
    return min(_median_deviations(weighting))


def _median_deviations(weighting: Weighting) -> list[float]:
    """The median deviation of the points of every recording."""
    return [float(np.median(each)) for each in weighting.deviations()]


def with_held_out(held: Likelihood, found: Explanation, parts: Real) -> Explanation:
    """The explanation where the states held out are data too; `parts` (m, k) is the inhomogeneity of all.

    Numbers that they alone have (the thickness of a gel that was laid anew) are fitted to them; all others move no
    further than the tangents tell.

    Raises:
        NotConverged, NotEnriched, MeshError, InputError, ValueError: the states held out cannot be predicted.
    """
    model, hypothesis = held.model, found.hypothesis
    search = held.search(hypothesis)
    names = {recording.name for recording in held.objective.recordings}
    acting = [(int(i), model.parameters[i].recordings) for i in search.free]
    own = [i for i, recordings in acting if recordings and names >= set(recordings)]
    x, data = found.likeliest, held.data(hypothesis, found.likeliest)
    weighting = Weighting.left(held.states, data.log_ratio)
    if own:
        others = tuple(int(i) for i in search.free if i not in own)
        x = search.minimise(x, weighting.deviations(), limit=FEW_STEPS, tolerance=1e-2, fixed=others).x
        data = held.data(hypothesis, x)
    more = held.explanation(hypothesis, x, data)
    both = _joined(found.local, more.local, parts)
    weights = found.weighting.joined(weighting)
    joined = replace(found, likeliest=x, local=both.informed(weights), weighting=weights,
                     log_ratio=(*found.log_ratio, *more.log_ratio), impedances=(*found.impedances, *more.impedances),
                     error_estimate=max(found.error_estimate, more.error_estimate))
    # The remainder of the states held out where all are explained together.
    left = joined.remainder[-len(held.states):]
    return joined.weighted(found.weighting.joined(Weighting.left(held.states, left)))


def _joined(one: LocalProblem, other: LocalProblem, parts: Real) -> LocalProblem:
    """The problem of the data of two, at the point of the second."""
    return replace(other, tangents=np.vstack([one.tangents, other.tangents]),
                   residual=np.concatenate([one.residual, other.residual]),
                   waves=np.vstack([one.waves, other.waves]),
                   parts=parts, outside=np.zeros((one.residual.size + other.residual.size, 0)),
                   term=scipy.linalg.block_diag(one.term, other.term),
                   information=np.concatenate([one.information, other.information]))


def _compressed(columns: Real, size: float) -> Real:
    """Fewer columns (m, k) of equal covariance, up to negligible parts at that size."""
    directions, lengths = principal(columns * size, NEGLIGIBLE)
    return np.asarray(directions * lengths / size)


def alternatives(every: Likelihood, found: Explanation, uneven: Inhomogeneity) -> list[Alternative]:
    """Hypotheses outside the catalogue beside an explanation, best first: a change in each region, and the modes that
    the model seems to lack."""
    size = found.local.residual.size
    made = {replace(found.hypothesis, region=region): _compressed(each / every.noise[:, None], REGION_SIZES[-1])
            for region, each in uneven.regions.items()}
    if modes := missing_modes(every, found):
        made[replace(found.hypothesis, modes=modes)] = columns(
            every.measured, every.places, modes, every.noise.size) / every.noise[:, None]
    gains = found.local.with_each([each[:size] for each in made.values()]) - found.log_evidence
    return sorted((Alternative(hypothesis, float(gain) - sum(mode.cost for mode in hypothesis.modes), own)
                   for (hypothesis, own), gain in zip(made.items(), gains, strict=True)), key=lambda each: -each.gains)


def missing_modes(every: Likelihood, found: Explanation) -> tuple[Mode, ...]:
    """The modes that the model seems to lack under an explanation, one at most for every body that was fitted."""
    local, count, root = found.local, len(found.log_ratio), found.local.root
    whiten = local.deviating(found.scales).whitened
    precision = np.diag(local.precision)
    # A parameter that nothing is known of may be anything.
    nuisances, _ = np.linalg.qr(np.vstack([whiten(local.tangents * root[:, None]), precision]))

    def project(whole: Real) -> Real:
        """Whitened, and without what known parameters imitate; the rows of the priors are nothing to a mode."""
        padded = np.vstack([whiten(whole * root[:, None]), np.zeros((len(precision), whole.shape[1]))])
        return np.asarray(padded - nuisances @ (nuisances.T @ padded))

    residual = np.concatenate([whiten(local.residual * root), local.offset * local.precision])
    residual = residual - nuisances @ (nuisances.T @ residual)
    return strongest(every.measured[:count], every.places[:count], _bodies(every.objective, count),
                     every.noise[:root.size], project, residual, REGION_SIZES)


def _bodies(objective: Objective, count: int) -> list[list[int]]:
    """The first `count` recordings, by index, of each body."""
    bodies: dict[object, list[int]] = {}
    for index, predictor in enumerate(objective.predictors[:count]):
        # A mode is one of the admittance: what was observed beside it has none.
        if objective.recordings[index].observable is None:
            bodies.setdefault(predictor, []).append(index)
    return list(bodies.values())
