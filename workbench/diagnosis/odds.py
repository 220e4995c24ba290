"""The criteria of a verdict, and the condition for a moved parameter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

#: Relative changes of stiffness, mass and loss within parts, each as likely in every decade: few parts are more
#: inhomogeneous than the last value.
INHOMOGENEITIES = np.logspace(-4.0, -2.5, 7)

#: Odds of the largest of these against the next one from which the residual is that of no usual device. Doubled, a
#: cause outside the catalogue has to be a twentieth of a standard deviation larger.
UNUSUAL = 20.0

#: Relative sizes of unknown changes within a region, each as likely in every decade. Smaller ones are the usual
#: inhomogeneity of parts, some tenths of a per cent.
REGION_SIZES = np.logspace(-2.0, 0.0, 5)

#: Hypotheses with log evidences further below the best are dropped during a search: odds of 160000. Final optima
#: changed few log evidences by a tenth of that.
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
        by_number: prior probabilities that nothing is wrong, one thing is, and two are.
        redundant: standard deviations from its neutral value within which a further parameter is redundant: an
            explanation that has the best one's parameters and redundant ones is no rival of it.
        level: share of the states of devices in which nothing is concealed that are within :meth:`limit`. A state
            beyond it is not explained.
        fitted: factor on the limit of white noise for a fitted state, since models are not exact.
        held_out: the same for a predicted state.
        most: share of the stated mismatch that an effect has to explain to be named where a state is not explained. The
            residual is then a fifth of the mismatch in rms.
        at_odds: distance of a parameter from its prior, in standard uncertainties, beyond which it is reported, and of
            an observation from its prediction: of a hundred parameters, one in twenty campaigns. Doubled, mistakes that
            campaigns state are not mentioned.
        mesh: relative error of Z, both parts together, that the meshes are made for.
    """

    accepted: float = 20.0
    hinted: float = 1.0
    looked_at: float = 0.1
    rival: float = 20.0
    by_number: tuple[float, float, float] = (0.5, 0.4, 0.1)
    redundant: float = 2.0
    level: float = 0.98
    fitted: float = 1.1
    held_out: float = 1.15
    most: float = 0.96
    at_odds: float = 3.5
    mesh: float = 0.0

    def limit(self, data: int, noise: float, *, held_out: bool = False) -> float:
        """The largest reduced chi-square of an explained state. It has so many `data` of a relative `noise`."""
        factor = self.held_out if held_out else self.fitted
        return factor * float(chi2.ppf(self.level, data)) / data + 0.5 * (self.mesh / noise) ** 2

    def __post_init__(self) -> None:
        if not (self.accepted >= self.hinted > 0.0 and self.rival > 1.0 and self.redundant > 0.0):
            raise ValueError(f"{self}: the odds of a hint must be above 0 and at most those of an accepted cause; "
                             "the odds of a rival must be above 1")
        if not (min(self.fitted, self.held_out) >= 1.0 and 0.0 < self.level < 1.0 and 0.0 < self.most <= 1.0
                and self.at_odds > 0.0):
            raise ValueError(f"{self}: factors of one at least, shares of one at most, and standard uncertainties "
                             "above zero")
        if not (min(self.by_number) > 0.0 and math.isclose(sum(self.by_number), 1.0)):
            raise ValueError(f"prior probabilities {self.by_number} of no, one and two effects must be above zero and "
                             "add up to one")


def odds_text(log_odds: float) -> str:
    """Odds from their natural logarithm."""
    return f"{math.exp(log_odds):.3g}" if abs(log_odds) < 14.0 else f"10^{log_odds / math.log(10.0):.0f}"
