"""The models that a search predicts with, each on local bases: none of them is right over the whole prior."""

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

#: Error of Z that models of a profile scan are made for, a fiftieth of the deviation of the points there
#: (`descent.LEVELS`): at a tenth of it a rim was found a tenth too wide.
COARSE = 0.02 * LEVELS[0]

#: Terms of the series to a point of a profile scan (`about_point.TERMS`).
FEW = 3

#: Reach of models: over the prior, in its uncertainties, and about an optimum, in its standard deviations.
FAR, NEAR = 1.5, 2.0

#: Times, at most, that an optimum is searched for on models made again about it, until their error estimate there is
#: within tolerance, which is the deviation of the points (:meth:`LocalModels.are_inaccurate`).
PLACES = 3


@dataclass(eq=False)
class LocalModels:
    """Predictions of the recordings, on models made where a search needs them.

    ``places`` (p,) are optima that :attr:`over_prior_and_places` has to be right at besides the prior.
    """

    model: Model
    places: tuple[Real, ...] = ()

    @cached_property
    def centre(self) -> Real:
        """The stated values of all parameters (p,)."""
        return np.array([p.start for p in self.model.parameters])

    @cached_property
    def prior(self) -> GaussianPrior:
        """The prior of the known numbers, updated by the smallest body of several."""
        prior = GaussianPrior.prior(self.model)
        first = smallest_body(self.model.fitted)
        return prior if first is None else prior.updated(
            Likelihood.noise_only(self.model, self.around(prior.x, prior, first)))

    @cached_property
    def known_reach(self) -> dict[str, float]:
        """The reach of models over the prior, by name."""
        return self.prior.reach(self.model, FAR)

    def around(self, x: Real, prior: GaussianPrior, recordings: Objective, *, enriches: bool = False) -> Objective:
        """Recordings predicted about x (p,), as far as a `prior` reaches from there."""
        return recordings.near(x, prior.reach(self.model, FAR), ROUGH, only=range(self.model.known), enriches=enriches)

    @cached_property
    def noise(self) -> float:
        """Relative standard deviation of a point, of the best recording."""
        return min(float(np.median(state.noise)) for state in self.model.campaign.states)

    @property
    def over_prior_and_places(self) -> Objective:
        """The recordings predicted over the updated prior, and at :attr:`places` too."""
        return self._made[1]

    @cached_property
    def over_prior(self) -> Objective:
        """The recordings predicted over the updated prior alone."""
        return self.around(self.prior.x, self.prior, self.model.fitted, enriches=True)

    @cached_property
    def multimodal(self) -> list[int]:
        """Indices of the known numbers along which there are several optima."""
        return multimodal(Likelihood.noise_only(self.model, self.over_prior), self.prior)

    @property
    def _made(self) -> tuple[bytes, Objective, dict[bytes, Likelihood]]:
        """A key of the present places, the models for these, and the likelihoods on them."""
        key = b"".join(each.tobytes() for each in self.places)
        if self._latest is None or self._latest[0] != key:
            self._latest = key, self.over_prior.enriched_at(self.prior.x, self.places, ROUGH), {}
        return self._latest

    _latest: tuple[bytes, Objective, dict[bytes, Likelihood]] | None = None

    def noise_only(self) -> Likelihood:
        """The likelihood without discrepancy, over the prior."""
        return Likelihood.noise_only(self.model, self.over_prior_and_places)

    def likelihood(self, x: Real) -> Likelihood:
        """The likelihood over the prior, with the discrepancy of the model at x (p,)."""
        known = self._made[2]
        if (key := x.tobytes()) not in known:
            known.clear()
            known[key] = self.noise_only().with_discrepancy(x)
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

    def predict_held_out(
        self, likelihood: Likelihood, found: Explanation, *, rounds: int, limit: int
    ) -> tuple[float, list[NDArray[np.complex128]]]:
        """The log evidence that the states held out add at the optimum of all, and their predicted impedances.

        `likelihood` is that of the fitted states, `found` the explanation of them; `rounds` and `limit` as in
        `Likelihood.refit`. A number of the held-out states alone (the thickness of a gel that was laid anew) may be far
        from its prior: the models are made again about the optimum of all, unless that does not move.
        """
        hypothesis, every, impedances = found.hypothesis, found, list[NDArray[np.complex128]]()
        for _ in range(PLACES if rounds else 1):
            held = Likelihood.noise_only(self.model, self.near(
                hypothesis, every.x, found.errors, held_out=True)).with_discrepancy(every.x)
            if impedances:
                near = self.near(hypothesis, every.x, found.errors)
                likelihood = likelihood.with_objective(near).with_discrepancy(every.x)
            else:
                impedances = held.impedances(found.x)
            every = likelihood.joined(held).refit(hypothesis, every.x, rounds=rounds, limit=limit)
            if not self.are_inaccurate(every.error_estimate, every.accuracy):
                break
        return every.log_evidence - found.log_evidence, impedances

    def towards(self, hypothesis: Hypothesis, places: Sequence[Real]) -> Objective:
        """The recordings predicted over the prior, and on the way to a hypothesis as it is at `places` (p,)."""
        return self._towards(self.over_prior_and_places, hypothesis, places, ROUGH)

    def coarsely_towards(self, hypothesis: Hypothesis, places: Sequence[Real]) -> Objective:
        """:meth:`towards` to the accuracy that a profile scan needs, with points of the first deviation of
        `descent.LEVELS`."""
        return self._towards(self._coarse, hypothesis, places, COARSE, FEW)

    @cached_property
    def _coarse(self) -> Objective:
        return self.over_prior.coarser(COARSE)

    def _towards(
        self, objective: Objective, hypothesis: Hypothesis, places: Sequence[Real], tolerance: float,
        terms: int = TERMS,
    ) -> Objective:
        own = [self.model.index(name) for effect in hypothesis.effects for name in effect.names]
        there = [replaced(self.centre, own, place[own]) for place in places]
        return objective.neumann_enriched(self.centre, there, tolerance, only=self.moving(hypothesis), terms=terms)

    def moving(self, hypothesis: Hypothesis) -> list[int]:
        """Indices of the parameters that move under a hypothesis."""
        return self.model.free(hypothesis.effects)[0]

    def about_candidate(self, likelihood: Likelihood, candidate: Candidate) -> Likelihood:
        """The likelihood on models for the prior about the optimum of a candidate."""
        reach = dict(self.known_reach)
        for effect in candidate.hypothesis.effects:
            for name in effect.names:
                i = self.model.index(name)
                reach[name] = 0.3 * abs(float(candidate.x[i]) - self.centre[i])
        return likelihood.with_objective(self.model.fitted.near(candidate.x, reach, ROUGH,
                                                    only=self.moving(candidate.hypothesis), enriches=False))
