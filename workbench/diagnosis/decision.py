"""The decision: from evidences and residuals to a verdict.

The number of effects has the prior probabilities of the criteria. Hypotheses with the same number of effects share its
probability equally among groups that recordings cannot tell apart. The decision answers two questions. Posterior odds
decide whether an effect is named. The limits of devices without concealed effects decide whether all states, fitted or
held out, are explained. An explanation is refuted by a state held out that it does not predict.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from scipy.special import logsumexp

from workbench.diagnosis.odds import Criteria

#: The verdicts.
NO_MISMATCH, EXPLAINED, AT_ODDS = "no_mismatch", "parameters_explain", "parameters_at_odds"
HINT, MISSING, AMBIGUOUS, UNEXPLAINED = "below_detection", "missing_physics", "ambiguous", "unexplained"

#: The verdict of an incomplete search, whatever its evidences so far.
NOT_FINISHED = "not_finished"
VERDICTS = (NO_MISMATCH, EXPLAINED, AT_ODDS, HINT, MISSING, AMBIGUOUS, UNEXPLAINED, NOT_FINISHED)


@dataclass(frozen=True)
class Evidence:
    """The evidence of one hypothesis.

    ``effects`` of the catalogue, none for the null hypothesis; ``outside`` whether it is outside the catalogue;
    ``log_evidence`` natural, of the fitted recordings, and ``held_out`` the log density predicted for the others, both
    up to a constant of all hypotheses. ``z_scores`` are the distances, by name, of its parameters from the null
    hypothesis, in standard deviations; ``share`` is the share of the stated mismatch that it explains; ``leaves`` names
    the states and observations beyond the limits of the criteria, ``refuted_by`` those of them that were held out, and
    ``at_odds`` the known parameters beyond their priors.
    """

    name: str
    log_evidence: float
    effects: tuple[str, ...] = ()
    outside: bool = False
    z_scores: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    held_out: float = 0.0
    share: float = 0.0
    leaves: tuple[str, ...] = ()
    refuted_by: tuple[str, ...] = ()
    at_odds: tuple[str, ...] = ()

    @property
    def total(self) -> float:
        """The log evidence of all recordings."""
        return self.log_evidence + self.held_out

    @property
    def leaves_fitted(self) -> bool:
        """Whether it leaves a fitted state unexplained."""
        return bool(set(self.leaves) - set(self.refuted_by))

    @property
    def is_null(self) -> bool:
        return not self.effects and not self.outside


@dataclass(frozen=True)
class Priors:
    """The prior probabilities of hypotheses.

    ``groups`` are the catalogue's effects by name in groups that recordings cannot tell apart; ``others`` is the number
    of single hypotheses outside the catalogue.
    """

    groups: tuple[tuple[str, ...], ...]
    others: int
    criteria: Criteria

    @property
    def singles(self) -> int:
        """The number of single hypotheses, each group being one."""
        return len(self.groups) + self.others

    def group(self, effect: str) -> int:
        """The index of the group of an effect."""
        return next(index for index, group in enumerate(self.groups) if effect in group)

    def log_odds(self, effects: Sequence[str], *, outside: bool = False) -> float:
        """The log prior odds of a hypothesis against the null hypothesis."""
        count = len(effects) or int(outside)
        if not count:
            return 0.0
        masses = self.criteria.by_number
        # Each further effect is as much less likely as the last one that is stated.
        further = max(count + 1 - len(masses), 0)
        mass = masses[min(count, len(masses) - 1)] * (masses[-1] / masses[-2]) ** further
        choices = math.comb(max(self.singles, count), count)
        members = math.prod(len(self.groups[self.group(each)]) for each in effects)
        return math.log(mass / masses[0]) - math.log(choices * members)


@dataclass(frozen=True)
class Decision:
    """A verdict, the hypothesis that it names, and those not ruled out.

    Without an effect, it names the null hypothesis. ``alike`` are hypotheses that these recordings cannot tell from the
    named one; ``rivals`` those with other predictions, best first; ``log_odds`` posterior, of every hypothesis against
    the null hypothesis, by name; ``is_explained`` whether every state is. ``remaining`` are the hypotheses with effects
    that no criterion excludes, best first.
    """

    verdict: str
    chosen: Evidence
    rivals: tuple[Evidence, ...]
    log_odds: Mapping[str, float]
    alike: tuple[Evidence, ...] = ()
    is_explained: bool = True
    remaining: tuple[Evidence, ...] = ()


def decide(
    evidences: Sequence[Evidence], priors: Priors, *, stated_explains: bool, criteria: Criteria | None = None
) -> Decision:
    """The verdict on some evidences, the null hypothesis among them.

    Args:
        priors: of all hypotheses, whether or not they are among the `evidences`.
        stated_explains: whether every state is explained as it is stated, with no known parameter moved.

    Raises:
        ValueError: the null hypothesis is not among them once.
    """
    criteria = criteria or Criteria()
    nothing = [each for each in evidences if each.is_null]
    if len(nothing) != 1:
        raise ValueError(f"received {len(nothing)} evidences that nothing is wrong; expected one")
    null = nothing[0]
    log_odds = {each.name: priors.log_odds(each.effects, outside=each.outside) + each.total - null.total
                for each in evidences}

    def unnamed(verdict: str) -> Decision:
        return Decision(verdict, null, (), log_odds, is_explained=not null.leaves, remaining=others)

    # An effect whose parameters are all consistent with zero is the null hypothesis, whatever else fits better with it.
    others = tuple(sorted((each for each in evidences if not each.is_null and not each.refuted_by
                           and not _moves_nothing(each, criteria.redundant)
                           and _adds(each, evidences, log_odds, criteria)), key=lambda each: -log_odds[each.name]))
    together = float(logsumexp([log_odds[each.name] for each in others])) if others else -math.inf
    if together < math.log(criteria.accepted):
        if null.leaves:
            return unnamed(UNEXPLAINED)
        if together > math.log(criteria.hinted):
            return unnamed(HINT)
        if stated_explains:
            return unnamed(NO_MISMATCH)
        return unnamed(AT_ODDS if null.at_odds else EXPLAINED)
    close = [each for each in (*others, *([] if null.refuted_by else [null]))
             if log_odds[others[0].name] - log_odds[each.name] < math.log(criteria.rival)]
    # Of hypotheses that differ by redundant parameters, the one of fewest parameters.
    best = min((each for each in close if each is others[0] or _extends(others[0], each, criteria.redundant)),
               key=lambda each: len(each.z_scores))
    beside = [each for each in close if each is not best and not _extends(each, best, criteria.redundant)]
    alike = tuple(each for each in beside if _is_alike(each, best, priors))
    rivals = tuple(each for each in beside if each not in alike)
    if best.outside:
        # Any flexible effect gains some evidence. The gain means nothing if the residual is noise.
        if null.leaves:
            return Decision(UNEXPLAINED, best, rivals, log_odds, is_explained=False, remaining=others)
        return unnamed(HINT)
    if best.leaves and best.share < criteria.most:
        # An effect with so large a residual stands in for another cause.
        return unnamed(UNEXPLAINED)
    return Decision(AMBIGUOUS if rivals else MISSING, best, rivals, log_odds, alike, not best.leaves, others)


def _is_alike(one: Evidence, other: Evidence, priors: Priors) -> bool:
    """Whether two explanations have the same groups of effects."""
    if one.is_null or one.outside or other.outside:
        return False
    return {priors.group(each) for each in one.effects} == {priors.group(each) for each in other.effects}


def _adds(each: Evidence, evidences: Sequence[Evidence], log_odds: Mapping[str, float], criteria: Criteria) -> bool:
    """Whether the last effect of an explanation is accepted beside the others. The criteria are the odds against the
    best explanation with a part of its effects, a parameter off its neutral value, and the states held out."""
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
