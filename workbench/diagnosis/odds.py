"""The criteria of a verdict: all the numbers that a decision rests on, in odds."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Criteria:
    """What a verdict asks for.

    Attributes:
        accepted: posterior odds of something being wrong against nothing, from which it is said. Doubled, half as many
            of the campaigns in which nothing is wrong are blamed, and effects have to be a twentieth of a standard
            deviation larger.
        hinted: the same, from which a hint is mentioned.
        rival: odds of the best explanation against another, up to which the data cannot rule the other out.
        nothing_wrong: prior probability that nothing is.
        spare: standard deviations from nothing within which a further parameter is spare: an explanation that has the
            best one's parameters, and beside these only spare ones, says the same.
    """

    accepted: float = 20.0
    hinted: float = 1.0
    rival: float = 20.0
    nothing_wrong: float = 0.5
    spare: float = 2.0

    def __post_init__(self) -> None:
        if not (self.accepted >= self.hinted > 0.0 and self.rival > 1.0 and self.spare > 0.0):
            raise ValueError(f"{self}: odds above zero, of a hint at most those of what is accepted, of a rival above "
                             "1")
        if not 0.0 < self.nothing_wrong < 1.0:
            raise ValueError(f"a prior probability of {self.nothing_wrong:g} that nothing is wrong must lie between 0 "
                             "and 1")
