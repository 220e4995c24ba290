"""One decision: from the evidence of every hypothesis to a verdict, by posterior odds alone.

Before the recordings, nothing is wrong with the probability that the criteria state; the rest is shared equally among
the single hypotheses, of the catalogue and outside of it, and two effects at once have the product of their shares.
States held out enter as data do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from scipy.special import logsumexp

from workbench.diagnosis.odds import Criteria

#: The verdicts.
NO_MISMATCH, EXPLAINED, HINT = "no_mismatch", "parameters_explain", "below_detection"
MISSING, AMBIGUOUS, UNEXPLAINED = "missing_physics", "ambiguous", "unexplained"

#: That of a search that was cut short: none of the others, whatever the evidences say so far.
NOT_FINISHED = "not_finished"
VERDICTS = (NO_MISMATCH, EXPLAINED, HINT, MISSING, AMBIGUOUS, UNEXPLAINED, NOT_FINISHED)


@dataclass(frozen=True)
class Evidence:
    """The evidence of one hypothesis.

    ``effects`` of the catalogue that it has, none for the null hypothesis; ``outside`` whether it is outside the
    catalogue; ``log_evidence`` natural, of the fitted recordings, and ``held_out`` the log of the density predicted for
    the others, both up to a constant of all hypotheses. ``z_scores`` are the distances, by name, of the parameters that
    it moves from the null hypothesis, in standard deviations; ``inflation`` is how many times the stated noise it
    leaves in a recording with all its deviations, ``misfit`` how many times its numbers alone leave; ``share`` is the
    part of the mismatch that it takes away; ``observed`` the largest distance of an observation beside Z from what it
    predicts, in standard uncertainties.
    """

    name: str
    log_evidence: float
    effects: tuple[str, ...] = ()
    outside: bool = False
    z_scores: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    held_out: float = 0.0
    inflation: float = 1.0
    misfit: float = 1.0
    share: float = 0.0
    observed: float = 0.0

    @property
    def total(self) -> float:
        """The log evidence of all recordings."""
        return self.log_evidence + self.held_out

    @property
    def is_null(self) -> bool:
        return not self.effects and not self.outside


@dataclass(frozen=True)
class Decision:
    """A verdict, the hypothesis it names (the null hypothesis, if none), and those that cannot be ruled out.

    ``rivals`` best first; ``log_odds`` posterior, of every hypothesis against the null hypothesis, by name.
    """

    verdict: str
    chosen: Evidence
    rivals: tuple[Evidence, ...]
    log_odds: Mapping[str, float]


def decide(
    evidences: Sequence[Evidence], hypotheses: int, *, stated_explains: bool, criteria: Criteria | None = None
) -> Decision:
    """The verdict on some evidences, of which one is that nothing is wrong.

    Args:
        hypotheses: how many single hypotheses there are, whether or not they are among the `evidences`.
        stated_explains: whether what is stated leaves nothing but noise, with no known parameter moved.

    Raises:
        ValueError: the null hypothesis is not among them once, or there are more single ones than `hypotheses`.
    """
    criteria = criteria or Criteria()
    nothing = [each for each in evidences if each.is_null]
    single = [each for each in evidences if not each.is_null and len(each.effects) < 2]
    if len(nothing) != 1 or len(single) > hypotheses:
        raise ValueError(f"received {len(nothing)} evidences that nothing is wrong and {len(single)} of single "
                         f"hypotheses; expected one, and at most {hypotheses}")
    prior = criteria.log_prior(hypotheses)
    log_odds = {each.name: (0.0 if each.is_null else
                            prior * max(len(each.effects), 1) + each.total - nothing[0].total) for each in evidences}
    # An effect whose numbers are all consistent with zero is the null hypothesis, whatever else fits better with it.
    others = sorted((each for each in evidences if not each.is_null and not _moves_nothing(each, criteria.redundant)
                     and _adds(each, evidences, log_odds, criteria)), key=lambda each: -log_odds[each.name])
    together = float(logsumexp([log_odds[each.name] for each in others])) if others else -math.inf
    if together < math.log(criteria.accepted):
        hint = together > math.log(criteria.hinted)
        verdict = HINT if hint else NO_MISMATCH if stated_explains else EXPLAINED
        if _leaves(nothing[0], criteria):
            verdict = UNEXPLAINED
        return Decision(verdict, nothing[0], (), log_odds)
    close = [each for each in (*others, nothing[0])
             if log_odds[others[0].name] - log_odds[each.name] < math.log(criteria.rival)]
    # Of hypotheses that differ by redundant parameters, the one of fewest parameters.
    best = min((each for each in close if each is others[0] or _extends(others[0], each, criteria.redundant)),
               key=lambda each: len(each.z_scores))
    rivals = tuple(each for each in close if each is not best and not _extends(each, best, criteria.redundant))
    if best.outside:
        # Whatever follows the recordings gains something: it says nothing where no more than noise is left.
        if nothing[0].misfit > criteria.inflated:
            return Decision(UNEXPLAINED, best, rivals, log_odds)
        return Decision(HINT, nothing[0], (), log_odds)
    if _leaves(best, criteria) and best.share < criteria.most:
        # The remainder is neither an inaccuracy of the model nor a trace.
        return Decision(UNEXPLAINED, nothing[0], (), log_odds)
    return Decision(AMBIGUOUS if rivals else MISSING, best, rivals, log_odds)


def _leaves(each: Evidence, criteria: Criteria) -> bool:
    """Whether more than noise is left by an explanation, or an observation at odds with it."""
    return each.inflation > criteria.inflated or each.observed > criteria.at_odds


def _adds(each: Evidence, evidences: Sequence[Evidence], log_odds: Mapping[str, float], criteria: Criteria) -> bool:
    """Whether the last effect of an explanation passes the bar of the first one: odds against the best explanation with
    one effect fewer from which it is accepted, a number that is not consistent with nothing, and no prediction of the
    states held out that rules it out."""
    fewer = [other for other in evidences if other.effects and set(other.effects) < set(each.effects)]
    if len(each.effects) < 2 or not fewer:
        return True
    best = max(fewer, key=lambda other: log_odds[other.name])
    if _extends(each, best, criteria.redundant):
        return False
    return (log_odds[each.name] - log_odds[best.name] > math.log(criteria.accepted)
            and each.held_out > best.held_out - math.log(criteria.rival))


def _moves_nothing(each: Evidence, redundant: float) -> bool:
    """Whether all parameters of an explanation by effects are redundant."""
    return bool(each.z_scores) and not each.outside and all(abs(z) < redundant for z in each.z_scores.values())


def _extends(other: Evidence, best: Evidence, redundant: float) -> bool:
    """Whether one explanation is the best one with redundant parameters added."""
    if not best.z_scores or other.outside or not set(best.z_scores) <= set(other.z_scores):
        return False
    return all(abs(other.z_scores[name]) < redundant for name in set(other.z_scores) - set(best.z_scores))
