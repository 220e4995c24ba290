"""The models that a search predicts with, each on local bases: none of them is right all over what is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.descent import LEVELS, Candidate
from workbench.diagnosis.device import Model
from workbench.diagnosis.gaussian_prior import GaussianPrior, multimodal, smallest_body
from workbench.diagnosis.likelihood import Explanation, Hypothesis, Likelihood
from workbench.diagnosis.starts import replaced
from workbench.fitting.objective import Objective
from workbench.reduced.about_point import TERMS
from workbench.reduced.estimate import SLACK

Real = NDArray[np.float64]

#: Error of Z that models are made for: for a search, and about an optimum, that relative to noise.
ROUGH, FINE = 3e-4, 0.03

#: The same where sizes are looked at, a fiftieth of the deviation that points have then (`descent.LEVELS`): at a tenth
#: of it a rim was found a tenth too wide.
COARSE = 0.02 * LEVELS[0]

#: Terms of the series to a place where sizes are looked at (`about_point.TERMS`).
FEW = 3

#: How far models reach: over what is known, in its uncertainties, and about an optimum, in its standard deviations.
FAR, NEAR = 1.5, 2.0

#: An optimum is looked for on models made again about it, at most so many times, until their error estimate there is
#: within tolerance, which is the deviation of the points (:meth:`LocalModels.are_inaccurate`).
PLACES = 3


@dataclass(eq=False)
class LocalModels:
    """The recordings of a model predicted where a search asks for it.

    ``places`` (p,) of optima that :attr:`wide` has to be right at besides where the known numbers are believed to be.
    """

    model: Model
    places: tuple[Real, ...] = ()

    @cached_property
    def centre(self) -> Real:
        """What is stated (p,)."""
        return np.array([p.start for p in self.model.parameters])

    @cached_property
    def belief(self) -> GaussianPrior:
        """Where the known numbers are, by the smallest body of several."""
        prior = GaussianPrior.prior(self.model)
        first = smallest_body(self.model.fitted)
        return prior if first is None else prior.updated(
            Likelihood.noise_only(self.model, self.around(prior.x, prior, first)))

    @cached_property
    def known_reach(self) -> dict[str, float]:
        """How far models reach, by name."""
        return self.belief.reach(self.model, FAR)

    def around(self, x: Real, belief: GaussianPrior, recordings: Objective, *, enriches: bool = False) -> Objective:
        """Recordings predicted about x (p,), as far as what is known may be believed to be from there."""
        return recordings.near(x, belief.reach(self.model, FAR), ROUGH, only=range(self.model.known), enriches=enriches)

    @cached_property
    def noise(self) -> float:
        """Relative standard deviation of a point, of the best recording."""
        return min(float(np.median(state.noise)) for state in self.model.campaign.states)

    @property
    def wide(self) -> Objective:
        """The recordings predicted all over what is believed of what is known, and at :attr:`places` too."""
        return self._made[1]

    @cached_property
    def narrow(self) -> Objective:
        """The same, but for the places."""
        return self.around(self.belief.x, self.belief, self.model.fitted, enriches=True)

    @cached_property
    def multimodal(self) -> list[int]:
        """Indices of the known numbers along which there are several optima."""
        return multimodal(Likelihood.noise_only(self.model, self.narrow), self.belief)

    @property
    def _made(self) -> tuple[bytes, Objective, dict[bytes, Likelihood]]:
        """What the present places are known by, the models for these, and the likelihoods on them."""
        key = b"".join(each.tobytes() for each in self.places)
        if self._latest is None or self._latest[0] != key:
            self._latest = key, self.narrow.enriched_at(self.belief.x, self.places, ROUGH), {}
        return self._latest

    _latest: tuple[bytes, Objective, dict[bytes, Likelihood]] | None = None

    def bare(self) -> Likelihood:
        """Of noise alone, all over what is known."""
        return Likelihood.noise_only(self.model, self.wide)

    def likelihood(self, x: Real) -> Likelihood:
        """All over what is known, with what the model does not get right at x (p,)."""
        known = self._made[2]
        if (key := x.tobytes()) not in known:
            known.clear()
            known[key] = self.bare().with_discrepancy(x)
        return known[key]

    def near(
        self, hypothesis: Hypothesis, x: Real, errors: Real, tolerance: float | None = None, *, held_out: bool = False
    ) -> Objective:
        """The recordings that were fitted, or those `held_out`, predicted about an optimum x (p,) of those standard
        deviations (p,), on meshes for it.

        To a relative error of Z of `tolerance`; far below the noise if that is None.
        """
        own = self.model.about(hypothesis.effects, x)
        recordings = own.held_out if held_out else own.fitted
        assert recordings is not None
        reach = {p.name: NEAR * float(error)
                 for p, error in zip(self.model.parameters, errors, strict=True) if error > 0.0}
        return recordings.near(x, reach, tolerance or FINE * self.noise, only=self.moving(hypothesis), enriches=False)

    def are_inaccurate(self, error: float, level: float = 0.0) -> bool:
        """Whether an error estimate is above tolerance where points have a further deviation `level`."""
        return error > SLACK * math.hypot(self.noise, level)

    def predicted(
        self, likelihood: Likelihood, found: Explanation, *, rounds: int, limit: int
    ) -> tuple[float, list[NDArray[np.complex128]]]:
        """What the states held out add to the log evidence, with the optimum of all, and their impedances as predicted.

        `likelihood` of those that were fitted, to what was `found`; `rounds` and `limit` as of `Likelihood.settled`.
        A number that only they have (how thick a gel is that was laid anew) may be far from where it was expected: the
        models are made again where the optimum of all is, unless that does not move.
        """
        hypothesis, every, seen = found.hypothesis, found, list[NDArray[np.complex128]]()
        for _ in range(PLACES if rounds else 1):
            held = Likelihood.noise_only(self.model, self.near(
                hypothesis, every.x, found.errors, held_out=True)).with_discrepancy(every.x)
            if seen:
                near = self.near(hypothesis, every.x, found.errors)
                likelihood = likelihood.with_objective(near).with_discrepancy(every.x)
            else:
                seen = held.impedances(found.x)
            every = likelihood.joined(held).refit(hypothesis, every.x, rounds=rounds, limit=limit)
            if not self.are_inaccurate(every.error_estimate, every.accuracy):
                break
        return every.log_evidence - found.log_evidence, seen

    def wider(self, hypothesis: Hypothesis, places: Sequence[Real]) -> Objective:
        """The recordings predicted all over what is known, and on the way to a hypothesis as it is at `places` (p,)."""
        return self._wider(self.wide, hypothesis, places, ROUGH)

    def coarsely_wider(self, hypothesis: Hypothesis, places: Sequence[Real]) -> Objective:
        """As :meth:`wider`, no better than it takes where points have a deviation of the first of `descent.LEVELS`."""
        return self._wider(self._coarse, hypothesis, places, COARSE, FEW)

    @cached_property
    def _coarse(self) -> Objective:
        return self.narrow.coarser(COARSE)

    def _wider(
        self, objective: Objective, hypothesis: Hypothesis, places: Sequence[Real], tolerance: float,
        terms: int = TERMS,
    ) -> Objective:
        own = [self.model.index(name) for effect in hypothesis.effects for name in effect.names]
        there = [replaced(self.centre, own, place[own]) for place in places]
        return objective.neumann_enriched(self.centre, there, tolerance, only=self.moving(hypothesis), terms=terms)

    def moving(self, hypothesis: Hypothesis) -> list[int]:
        """Indices of what moves under a hypothesis."""
        return self.model.free(hypothesis.effects)[0]

    def about(self, likelihood: Likelihood, candidate: Candidate) -> Likelihood:
        """The likelihood on models for all that is known about where a candidate is."""
        reach = dict(self.known_reach)
        for effect in candidate.hypothesis.effects:
            for name in effect.names:
                i = self.model.index(name)
                reach[name] = 0.3 * abs(float(candidate.x[i]) - self.centre[i])
        return likelihood.with_objective(self.model.fitted.near(candidate.x, reach, ROUGH,
                                                    only=self.moving(candidate.hypothesis), enriches=False))
