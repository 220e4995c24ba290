"""Evidences of the explanations of a search, and the decision on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.campaign.state import DeviceState, StateFit
from workbench.diagnosis.decision import NOT_FINISHED, Decision, Evidence, Priors, decide
from workbench.diagnosis.device import Model
from workbench.diagnosis.estimates import beyond_priors
from workbench.diagnosis.findings import Found, Refitted
from workbench.diagnosis.likelihood import Explanation
from workbench.diagnosis.odds import Criteria


def conclude(model: Model, results: Found, criteria: Criteria | None = None) -> Decision:
    """The decision on the results of a search."""
    criteria = criteria or Criteria()
    evidences = [evidence(model, each, results.stated, criteria) for each in results.final]
    return decide(evidences, priors(model, results.groups, criteria),
                  stated_explains=not unexplained_as_stated(model, results.stated, criteria), criteria=criteria)


def not_finished(model: Model, results: Found, so_far: Decision, criteria: Criteria | None = None) -> Decision:
    """The decision after an incomplete search: no verdict, whatever the results `so_far`."""
    null = evidence(model, results.base, results.stated, criteria or Criteria())
    return replace(so_far, verdict=NOT_FINISHED, chosen=null, rivals=(), alike=())


def priors(model: Model, groups: Sequence[Sequence[str]], criteria: Criteria) -> Priors:
    """The prior probabilities of all hypotheses. An effect in no group is a group of its own."""
    grouped = {name for group in groups for name in group}
    alone = tuple((effect.name,) for effect in model.effects if effect.name not in grouped)
    return Priors((*map(tuple, groups), *alone), model.hypotheses - len(model.effects), criteria)


def unexplained_as_stated(model: Model, stated: Sequence[StateFit], criteria: Criteria) -> list[str]:
    """Names of the states that the stated device does not explain. States held out are included."""
    fitted, held_out = model.campaign.fitted, model.campaign.held_out
    return [state.name for state, fit in zip((*fitted, *held_out), stated, strict=True)
            if _is_unexplained(state, fit.reduced, criteria, held_out=state in held_out)]


def unexplained_states(explanation: Explanation, criteria: Criteria) -> list[str]:
    """Names of the fitted states that an explanation does not explain."""
    states = zip(explanation.weighting.states, explanation.reduced_chi_squares, strict=True)
    return [state.name for state, reduced in states if _is_unexplained(state, reduced, criteria)]


def _is_unexplained(state: DeviceState, reduced: float, criteria: Criteria, *, held_out: bool = False) -> bool:
    """Whether a reduced chi-square of a state exceeds the limit."""
    if state.observation is not None:
        return reduced > criteria.at_odds**2
    noise = float(np.sqrt(np.mean(state.noise**2)))
    return reduced > criteria.limit(state.data * state.noise.size, noise, held_out=held_out)


def evidence(model: Model, refit: Refitted, stated: Sequence[StateFit], criteria: Criteria) -> Evidence:
    """The evidence of an explanation from all recordings, those held out included."""
    explanation, hypothesis, z_scores = refit.explanation, refit.hypothesis, {}
    for name in hypothesis.names:
        i = model.index(name)
        error, moved = explanation.error(i), abs(float(explanation.x[i]) - model.parameters[i].start)
        # A parameter at the end of its range has no error, however far it has moved.
        z_scores[name] = moved / error if error > 0.0 else math.inf if moved > 0.0 else 0.0
    refuting = [each.state.name for each in refit.predicted
                if _is_unexplained(each.state, each.reduced, criteria, held_out=True)]
    return Evidence(hypothesis.name, explanation.log_evidence, tuple(effect.name for effect in hypothesis.effects),
                    hypothesis.is_outside, z_scores, refit.held_out, explained_share(model, stated, explanation),
                    (*unexplained_states(explanation, criteria), *refuting), tuple(refuting),
                    tuple(beyond_priors(model, explanation, criteria)))


def explained_share(model: Model, stated: Sequence[StateFit], explanation: Explanation) -> float:
    """The share of the stated mismatch, beyond noise, that an explanation removes.

    It is a share of chi-square with the rows of the priors: parameters beyond their priors do not explain.
    """
    sizes = [state.data * state.noise.size for state in model.campaign.fitted]
    before = sum(size * fit.reduced for size, fit in zip(sizes, stated, strict=False))
    after = explanation.chi_square + explanation.prior_square
    # Noise has a chi-square of the number of data.
    beyond = before - min(after, sum(sizes))
    return float(np.clip((before - after) / beyond, 0.0, 1.0)) if beyond > 0.0 else 0.0
