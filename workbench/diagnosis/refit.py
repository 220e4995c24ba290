"""Explanations at full weight, with states held out and alternatives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from workbench.diagnosis.evidence import LinearisedProblem
from workbench.diagnosis.findings import Alternative, Candidate, Refitted, StatePrediction
from workbench.diagnosis.inhomogeneity import Inhomogeneity, cosine_keys, inhomogeneity
from workbench.diagnosis.likelihood import (
    STEPS,
    Explanation,
    Hypothesis,
    LaplaceApproximation,
    Likelihood,
)
from workbench.diagnosis.local_models import FINE, LocalModels
from workbench.diagnosis.local_problem import LocalProblem
from workbench.diagnosis.modes import Mode, columns, strongest
from workbench.diagnosis.odds import INHOMOGENEITIES, REGION_SIZES
from workbench.diagnosis.weighting import Weighting
from workbench.fitting.covariance import NEGLIGIBLE, Covariance, covariance_root, principal
from workbench.fitting.objective import Objective
from workbench.reduced.estimate import SLACK

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Steps of the refit of a hypothesis far behind, and of parameters that only states held out have.
FEW_STEPS = 8

#: Times, at most, that models are made again about an optimum at full weight.
REMADE = 4

#: Largest factor on the weighted rms residual of least squares for an accepted explanation.
AS_GOOD = 1.05

#: Noise scale, deviations allowed for, beyond which a hypothesis stays at its optimum of least squares. Doubled, wrong
#: hypotheses take three times as long.
MISFIT = 2.0

#: Noise scale factor above which alternatives outside the catalogue are tried beside an explanation.
CONSPICUOUS = 1.2


def refit_candidate(
    models: LocalModels, candidate: Candidate, *, parts: Real | None = None, is_rough: bool = False
) -> Refitted:
    """A candidate refitted at full weight from each end; the best result.

    One that `is_rough` is refitted roughly: the size of its distance does not matter. `parts` (m, k) is the
    inhomogeneity of all recordings, in units of their noise, those held out last; by default that of the device at the
    optimum, beside which alternatives outside the catalogue are tried too.

    Raises:
        NotConverged, NotEnriched, MeshError, InputError, ValueError, ArithmeticError: nothing near an end can be
            predicted, or is admissible.
    """
    optima = [_optimum(models, candidate.hypothesis, end, is_rough=is_rough) for end in candidate.ends]
    best = max(optima, key=lambda each: each[1].weighting.log_likelihood(each[1].log_ratio))[1].weighting
    likelihood, least = max(optima, key=lambda each: each[1].weighted(best).log_evidence)
    optima.clear()  # the models of the others take some 100 MB for each state
    if not is_rough:
        likelihood, least = _with_deviations(models, likelihood, least, parts)
    held = _held_out(models, least, least.likeliest)
    if parts is None:
        parts, explanation, beside = _surroundings(models, _together(likelihood, held), least, is_rough=is_rough)
    else:
        explanation, beside = least, ()
    return _with_states_held_out(held, explanation, parts, beside)


def with_surroundings(models: LocalModels, refitted: Refitted) -> Refitted:
    """An explanation with the inhomogeneity of its own place, and its alternatives. It was refitted with that of
    another place."""
    explanation = refitted.explanation
    noise = _least_noise(explanation.weighting)
    likelihood = models.near(explanation.hypothesis, explanation.likeliest, explanation.errors, noise=noise)
    held = _held_out(models, explanation, explanation.likeliest)
    parts, explanation, beside = _surroundings(models, _together(likelihood, held), explanation)
    return replace(_with_states_held_out(held, explanation, parts, beside), scores=refitted.scores)


def _with_deviations(
    models: LocalModels, likelihood: Likelihood, least: Explanation, parts: Real | None
) -> tuple[Likelihood, Explanation]:
    """The explanation at its optimum with all deviations, and its likelihood.

    Changes by `parts` (m, k), if they are not given, are those of the device there, possibly far from the least-squares
    optimum. The explanation is reported there if its residual is not much larger.
    """
    explanation, is_accurate, tolerance = least, True, 0.0
    for _ in range(REMADE):
        place = explanation.likeliest
        if not is_accurate:
            likelihood = likelihood.with_objective(likelihood.objective.enriched(place, tolerance))
        own = (parts[:explanation.local.residual.size] if parts is not None else
               _changes(models, likelihood.objective, likelihood.noise, place)[0])
        explanation = replace(explanation, local=replace(explanation.local, parts=own))
        if float(explanation.local.noise.max(initial=1.0)) > MISFIT:
            # Something else is missing: the optimum with deviations costs most of the time and decides nothing.
            return likelihood, explanation
        explanation, data = likelihood.whitened(explanation)
        # A large residual need not be known as exactly as the noise.
        tolerance = SLACK * FINE * max(_median_deviations(explanation.weighting))
        is_accurate = data.error <= tolerance
        has_moved = bool((np.abs(explanation.likeliest - place) > explanation.errors)[list(explanation.free)].any())
        if is_accurate and (not has_moved or parts is not None):
            break
    else:
        explanation = explanation.not_converged("the models about the optimum with deviations")
    there = replace(explanation, x=explanation.likeliest, log_ratio=data.log_ratio, impedances=data.impedance,
                    error_estimate=data.error)
    left = least.weighting.chi_square
    return likelihood, there if left(there.log_ratio) <= AS_GOOD**2 * left(least.log_ratio) else explanation


def _together(likelihood: Likelihood, held: Likelihood | None) -> Likelihood:
    """The likelihood of the fitted states, then of those held out."""
    whole = likelihood.objective if held is None else likelihood.objective.joined(held.objective)
    return Likelihood(likelihood.model, whole)


def _surroundings(
    models: LocalModels, every: Likelihood, explanation: Explanation, *, is_rough: bool = False
) -> tuple[Real, Explanation, tuple[Alternative, ...]]:
    """The inhomogeneity of all recordings, the explanation with it, and alternatives. It is that at the likeliest point
    of the explanation."""
    parts, uneven = _changes(models, every.objective, every.noise, explanation.likeliest)
    explanation = replace(explanation, local=replace(explanation.local, parts=parts[:explanation.local.residual.size]))
    conspicuous = not is_rough and float(explanation.local.noise.max(initial=1.0)) > CONSPICUOUS
    return parts, explanation, tuple(alternatives(every, explanation, uneven)) if conspicuous else ()


def _with_states_held_out(
    held: Likelihood | None, explanation: Explanation, parts: Real, beside: tuple[Alternative, ...]
) -> Refitted:
    """The explanation with its prediction of the states held out."""
    if held is None:
        return Refitted(explanation, alternatives=beside)
    joined = with_held_out(held, explanation, parts)
    return Refitted(explanation, joined, tuple(predictions(held, explanation, joined)), alternatives=beside)


def _changes(models: LocalModels, objective: Objective, noise: Real, place: Real) -> tuple[Real, Inhomogeneity]:
    """The data's changes by inhomogeneity at `place` (p,), of all parts first."""
    whole = inhomogeneity(objective, place, cosine_keys(models.model.uneven.values()))
    return _compressed(whole.parts / noise[:, None], INHOMOGENEITIES[-1]), whole


def _optimum(
    models: LocalModels, hypothesis: Hypothesis, end: LaplaceApproximation, *, is_rough: bool
) -> tuple[Likelihood, Explanation]:
    """The optimum at full weight near an end. Models are made again about it if their error estimate is too large."""
    x, errors, noise = end.x, end.errors, 0.0
    for _ in range(1 if is_rough else REMADE):
        likelihood = models.near(hypothesis, x, errors, noise=noise)
        explanation = likelihood.refit(hypothesis, x, limit=FEW_STEPS if is_rough else STEPS)
        noise = _least_noise(explanation.weighting)
        own = models.model.of(hypothesis.effects, explanation.x)
        if own is likelihood.model and not models.are_inaccurate(explanation.error_estimate, noise):
            break
        x, errors = explanation.x, explanation.errors
    else:
        explanation = explanation.not_converged("the models about the optimum of least squares")
    return likelihood, explanation


def _held_out(models: LocalModels, explanation: Explanation, place: Real) -> Likelihood | None:
    """The likelihood of the states held out about `place` (p,), or None."""
    if models.model.held_out is None:
        return None
    noise = _least_noise(explanation.weighting)
    return models.near(explanation.hypothesis, place, explanation.errors, noise=noise, held_out=True)


def _least_noise(weighting: Weighting) -> float:
    """The median deviation of the recording that deviates least."""
    return min(_median_deviations(weighting))


def _median_deviations(weighting: Weighting) -> list[float]:
    """The median deviation of the points of every recording."""
    return [float(np.median(each)) for each in weighting.deviations()]


def with_held_out(held: Likelihood, explanation: Explanation, parts: Real) -> Explanation:
    """The explanation with the states held out as data too.

    `parts` (m, k) is the inhomogeneity of all. Parameters of these states alone (the thickness of a new gel film) are
    fitted to them; all others move by their tangents only.

    Raises:
        NotConverged, NotEnriched, MeshError, InputError, ValueError: the states held out cannot be predicted.
    """
    model, hypothesis = held.model, explanation.hypothesis
    search = held.search(hypothesis)
    names = {recording.name for recording in held.objective.recordings}
    acting = [(int(i), model.parameters[i].recordings) for i in search.free]
    own = [i for i, recordings in acting if recordings and names >= set(recordings)]
    x, data = explanation.likeliest, held.data(hypothesis, explanation.likeliest)
    weighting = Weighting.left(held.states, data.log_ratio)
    if own:
        others = tuple(int(i) for i in search.free if i not in own)
        x = search.minimise(x, weighting.deviations(), limit=FEW_STEPS, tolerance=1e-2, fixed=others).x
        data = held.data(hypothesis, x)
    more = held.explanation(hypothesis, x, data)
    both = _joined(explanation.local, more.local, parts)
    weights = explanation.weighting.joined(weighting)
    joined = replace(explanation, likeliest=x, local=both.informed(weights), weighting=weights,
                     log_ratio=(*explanation.log_ratio, *more.log_ratio),
                     impedances=(*explanation.impedances, *more.impedances),
                     error_estimate=max(explanation.error_estimate, more.error_estimate))
    # The residual of the states held out in the explanation of all states.
    left = joined.remainder[-len(held.states):]
    return joined.weighted(explanation.weighting.joined(Weighting.left(held.states, left)))


def predictions(held: Likelihood, explanation: Explanation, joined: Explanation) -> Iterator[StatePrediction]:
    """The states held out as an explanation of the others predicts them.

    Their own parameters are those of the explanation of all, `joined`. D are the derivatives by the parameters and by
    the amplitudes of the inhomogeneity, whose size is the most likely one. C is the covariance of both given the fitted
    states. r is the residual, in units of the stated noise, with the amplitudes given the fitted states. The chi-square
    is r^T (1 + D C D^T)^-1 r.
    """
    count, local, both = len(held.states), explanation.local, joined.local
    start, known = local.residual.size, local.offset.size
    fields = both.inhomogeneous(explanation.scales.inhomogeneity)
    design = np.column_stack([both.tangents, fields])
    # The amplitudes are parameters of unit variance: as such, their covariance with the others is known.
    beside = np.ones(fields.shape[1])
    fitted = LinearisedProblem.of(
        design[:start] * local.root[:, None], local.residual * local.root, np.zeros((start, 0)),
        precision=scipy.linalg.block_diag(local.prior_rows.T @ local.prior_rows, np.diag(beside)),
        offset=np.append(local.offset, 0.0 * beside), widths=np.append(local.widths, np.nan * beside),
        below=np.append(local.below, np.inf * beside), above=np.append(local.above, np.inf * beside),
    ).at(np.zeros(0), np.ones(1))
    residual = both.residual[start:] + fields[start:] @ fitted.step[known:]
    deviations = design[start:] @ covariance_root(fitted.covariance)
    for state, rows, impedance in zip(held.states, held.places, joined.impedances[-count:], strict=True):
        left = Covariance.of(deviations[rows]).whitened(residual[rows])
        yield StatePrediction(state, impedance, float(left @ left) / (state.data * state.noise.size))


def _joined(one: LocalProblem, other: LocalProblem, parts: Real) -> LocalProblem:
    """The problem of the data of two, at the second's point."""
    return replace(other, tangents=np.vstack([one.tangents, other.tangents]),
                   residual=np.concatenate([one.residual, other.residual]),
                   cosines=np.vstack([one.cosines, other.cosines]),
                   parts=parts, outside=np.zeros((one.residual.size + other.residual.size, 0)),
                   term=scipy.linalg.block_diag(one.term, other.term),
                   information=np.concatenate([one.information, other.information]), recordings=())


def _compressed(columns: Real, size: float) -> Real:
    """Fewer columns (m, k) of equal covariance, with negligible parts removed."""
    directions, lengths = principal(columns * size, NEGLIGIBLE)
    return np.asarray(directions * lengths / size)


def alternatives(every: Likelihood, explanation: Explanation, uneven: Inhomogeneity) -> list[Alternative]:
    """Hypotheses outside the catalogue beside an explanation, best first. They are a change in each region, and the
    missing modes."""
    size = explanation.local.residual.size
    made = {replace(explanation.hypothesis, region=region): _compressed(each / every.noise[:, None], REGION_SIZES[-1])
            for region, each in uneven.regions.items()}
    if modes := missing_modes(every, explanation):
        made[replace(explanation.hypothesis, modes=modes)] = columns(
            every.measured, every.places, modes, every.noise.size) / every.noise[:, None]
    gains = explanation.local.gained_by([each[:size] for each in made.values()])
    return sorted((Alternative(hypothesis, float(gain) - sum(mode.cost for mode in hypothesis.modes), own)
                   for (hypothesis, own), gain in zip(made.items(), gains, strict=True)), key=lambda each: -each.gains)


def missing_modes(every: Likelihood, explanation: Explanation) -> tuple[Mode, ...]:
    """The modes missing under an explanation, at most one per fitted assembly."""
    local, count, root = explanation.local, len(explanation.log_ratio), explanation.local.root
    whiten = local.deviating(explanation.scales).whitened
    # A parameter without a prior has any value.
    nuisances, _ = np.linalg.qr(np.vstack([whiten(local.tangents * root[:, None]), local.prior_rows]))

    def project(whole: Real) -> Real:
        """Whitened columns without their part along known parameters. Rows of priors do not act on a mode."""
        padded = np.vstack([whiten(whole * root[:, None]), np.zeros((len(local.prior_rows), whole.shape[1]))])
        return np.asarray(padded - nuisances @ (nuisances.T @ padded))

    residual = np.concatenate([whiten(local.residual * root), local.prior_rows @ local.offset])
    residual = residual - nuisances @ (nuisances.T @ residual)
    return strongest(every.measured[:count], every.places[:count], _assemblies(every.objective, count),
                     every.noise[:root.size], project, residual, REGION_SIZES)


def _assemblies(objective: Objective, count: int) -> list[list[int]]:
    """The first `count` recordings, by index, of each assembly."""
    assemblies: dict[object, list[int]] = {}
    for index, predictor in enumerate(objective.predictors[:count]):
        # A mode is one of the admittance: other observables have none.
        if objective.recordings[index].observable is None:
            assemblies.setdefault(predictor, []).append(index)
    return list(assemblies.values())
