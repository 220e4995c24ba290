"""From the explanations of a search to their evidences, and the decision on them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from workbench.diagnosis.decision import NOT_FINISHED, Decision, Evidence, decide
from workbench.diagnosis.device import Model
from workbench.diagnosis.findings import Found, Refitted
from workbench.diagnosis.likelihood import Explanation
from workbench.diagnosis.odds import TERM, Criteria
from workbench.diagnosis.weighting import furthest_observation

#: Standard deviations to either side of a 95 % interval.
DEVIATIONS = 1.96


@dataclass(frozen=True, eq=False)
class Conclusion:
    """A decision, the explanation that it names, and those it cannot rule out."""

    decision: Decision
    chosen: Refitted
    rivals: tuple[Refitted, ...]


def conclude(model: Model, found: Found, criteria: Criteria | None = None) -> Conclusion:
    """The decision on the results of a search."""
    base = found.base.explanation
    evidences = {each.hypothesis.name: (evidence(model, each, base), each) for each in found.final}
    decision = decide([both[0] for both in evidences.values()], model.hypotheses,
                      stated_explains=_is_as_stated(model, base), criteria=criteria)
    return Conclusion(decision, evidences[decision.chosen.name][1],
                      tuple(evidences[each.name][1] for each in decision.rivals))


def not_finished(model: Model, found: Found, so_far: Conclusion) -> Conclusion:
    """The conclusion of a search that was cut short: no verdict on anything, whatever it found `so_far`."""
    nothing = evidence(model, found.base, found.base.explanation)
    decision = replace(so_far.decision, verdict=NOT_FINISHED, chosen=nothing, rivals=())
    return Conclusion(decision, found.base, ())


def evidence(model: Model, refit: Refitted, base: Explanation) -> Evidence:
    """The evidence of an explanation, of all recordings, those held out included; `base` is the explanation of the null
    hypothesis."""
    found = refit.explanation
    hypothesis = found.hypothesis
    z_scores = {}
    for effect in hypothesis.effects:
        for name in effect.names:
            i = model.index(name)
            error = found.error(i)
            moved = abs(float(found.x[i]) - model.parameters[i].start)
            # One that the end of its range holds has no error, however far it has moved.
            z_scores[name] = moved / error if error > 0.0 else math.inf if moved > 0.0 else 0.0
    return Evidence(hypothesis.name, found.log_evidence, tuple(effect.name for effect in hypothesis.effects),
                    hypothesis.is_outside, z_scores, refit.held_out, found.inflation,
                    found.misfit, explained_share(model, base, found),
                    furthest_observation(found.weighting.states, found.log_ratio))


def interval(model: Model, found: Explanation, name: str) -> tuple[float, float, float]:
    """Value, and low and high end of the 95 % interval, of a parameter within its range, SI.

    Where the end of the range holds it, all three are its value.
    The number of a term is right to :data:`~workbench.diagnosis.odds.TERM` of itself at best, as the term is.
    """
    i = model.index(name)
    parameter, value, error = model.parameters[i], float(found.x[i]), found.error(i)
    if error == 0.0:
        return value, value, value
    if any(effect.terms and name in effect.names for effect in found.hypothesis.effects):
        error = float(np.hypot(error, TERM * (value - parameter.start)))
    return (value, float(max(value - DEVIATIONS * error, parameter.low)),
            float(min(value + DEVIATIONS * error, parameter.high)))


def explained_share(model: Model, base: Explanation, found: Explanation) -> float:
    """The share of the mismatch beyond noise that an explanation takes away from the one of the null hypothesis.

    It is a share of chi-square, with the rows of the recordings and of the priors: a mismatch that known parameters
    take up by leaving their priors is still one.
    """
    before, after = (each.chi_square + _pull(model, each) for each in (base, found))
    # Noise leaves a chi-square of the number of data, or the one of the base.
    beyond = before - min(after, base.local.residual.size)
    return float(np.clip((before - after) / beyond, 0.0, 1.0)) if beyond > 0.0 else 0.0


def _is_as_stated(model: Model, base: Explanation) -> bool:
    """Whether all known parameters stay within their priors."""
    return _pull(model, base) < 1.0


def _pull(model: Model, found: Explanation) -> float:
    """The prior pull: the sum of squares of the known parameters' distances from their priors, in standard
    uncertainties."""
    released = model.free(found.hypothesis.effects)[1]
    return float(sum(((found.x[i] - p.start) / p.prior) ** 2 for i, p in enumerate(model.parameters[:model.known])
                     if p.prior and i not in released))
