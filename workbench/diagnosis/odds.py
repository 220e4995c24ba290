"""The criteria of a verdict: all the numbers that a decision rests on, and when a parameter counts as moved."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

#: Relative changes of stiffness, mass and loss within parts, each as likely in every decade: hardly a part is more
#: inhomogeneous than the last.
INHOMOGENEITIES = np.logspace(-4.0, -2.5, 7)

#: Relative sizes of changes within a region of which nothing is known, each as likely in every decade: parts are
#: inhomogeneous by some tenths of a per cent, and nobody looks for that.
REGION_SIZES = np.logspace(-2.0, 0.0, 5)

#: Log evidences that are further behind the best are given up on the way: odds of 160000, where a final optimum has
#: been seen to change hardly one by a tenth of that.
CLOSE = 12.0

#: A term describes its effect to this share of it.
TERM = 0.02


@dataclass(frozen=True)
class Criteria:
    """The criteria of a verdict.

    Attributes:
        accepted: posterior odds against the null hypothesis from which an effect is named. Doubled, half as many of the
            campaigns in which nothing is wrong are blamed, and effects have to be a twentieth of a standard deviation
            larger.
        hinted: posterior odds from which a hint is mentioned.
        looked_at: posterior odds of one hypothesis, as its score predicts them, from which it is refitted at all.
        rival: odds of the best explanation against another, up to which the data cannot rule the other out.
        nothing_wrong: prior probability that nothing is.
        redundant: standard deviations from its neutral value within which a further parameter is redundant: an
            explanation that has the best one's parameters and redundant ones is no rival of it.
        inflated: times the stated noise that an explanation leaves in a recording at most (`weighting`): neither the
            null hypothesis nor an effect explains all where more is left. Doubled, mismatches twice as large pass for
            noise.
        most: share of the mismatch that an effect has to take away to be named where more than that is left: all but a
            tenth, so that nobody takes the rest for the larger part.
        at_odds: distance from its prior, in standard uncertainties, beyond which a parameter is at odds with it, and of
            an observation from its prediction: of a hundred parameters, one in twenty campaigns. Doubled, mistakes that
            campaigns state are not mentioned.
    """

    accepted: float = 20.0
    hinted: float = 1.0
    looked_at: float = 0.1
    rival: float = 20.0
    nothing_wrong: float = 0.5
    redundant: float = 2.0
    inflated: float = 2.0
    most: float = 0.9
    at_odds: float = 3.5

    def log_prior(self, hypotheses: int) -> float:
        """Prior log odds of each effect against none, of so many single `hypotheses`."""
        return math.log1p(-self.nothing_wrong) - math.log(self.nothing_wrong) - math.log(max(hypotheses, 1))

    def __post_init__(self) -> None:
        if not (self.accepted >= self.hinted > 0.0 and self.rival > 1.0 and self.redundant > 0.0):
            raise ValueError(f"{self}: odds above zero, of a hint at most those of what is accepted, of a rival above "
                             "1")
        if not (self.inflated >= 1.0 and 0.0 < self.most <= 1.0 and self.at_odds > 0.0):
            raise ValueError(f"{self}: standard uncertainties above zero, an inflation of one at least, and a share of "
                             "one at most")
        if not 0.0 < self.nothing_wrong < 1.0:
            raise ValueError(f"a prior probability of {self.nothing_wrong:g} that nothing is wrong must lie between 0 "
                             "and 1")
