"""The models that a search predicts with, each on local bases: none of them is right over the whole prior.

A search goes on on coarse meshes, and only explanations that are told of have the meshes that were asked for. A model
carries the terms of the hypotheses that act in it and no others, and its meshes have lines of nodes for these alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from workbench.campaign.state import rms_of_impedance
from workbench.diagnosis.device import Model, device_model
from workbench.diagnosis.gaussian_prior import GaussianPrior, multimodal, smallest_body
from workbench.diagnosis.levels import replaced
from workbench.diagnosis.likelihood import Hypothesis, Likelihood
from workbench.diagnosis.ranking import Tangents
from workbench.fitting.objective import Objective
from workbench.reduced.estimate import SLACK

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Error of Z that meshes of a search are made for, and at least that of those asked for.
SEARCHED = 5e-3

#: Share of Z that is left as stated from which on a search's meshes are right enough to say so: 20 times their error.
FAR_OFF = 20.0 * SEARCHED

#: Error of Z that reduced models are made for: over the prior, about a point of a search, and about an optimum, that
#: relative to noise. Where constants are known to a tenth, a search over models ten times as wrong ends elsewhere.
BROAD, ROUGH, FINE = 3e-4, 3e-3, 0.1

#: Reach of models: over the prior, in its uncertainties, and about an optimum, in its standard deviations; and of an
#: effect where a search begins, in its size there.
FAR, NEAR, OF_SIZE = 1.5, 2.0, 0.3

#: Times, at most, that an optimum is searched for on models made again about it, until their error estimate there is
#: within tolerance, which is the deviation of the points (:meth:`LocalModels.are_inaccurate`).
PLACES = 2


@dataclass(eq=False)
class LocalModels:
    """Predictions of the recordings, on models made where a search needs them."""

    model: Model

    @cached_property
    def rough(self) -> Model:
        """The model of a search, on coarse meshes."""
        if not isinstance(self.model.accuracy, float) or self.model.accuracy >= SEARCHED:
            return self.model
        return device_model(self.model.campaign, accuracy=SEARCHED, catalogue=(self.model.effects, self.model.others))

    @cached_property
    def with_all(self) -> Model:
        """The model of a search in which all hypotheses act: dear to make, and asked for between others."""
        return self.rough.of(self.rough.effects)

    @cached_property
    def prior(self) -> GaussianPrior:
        """The prior of the known numbers, updated by the smallest body of several."""
        prior = GaussianPrior.prior(self.rough)
        first = smallest_body(self.rough.fitted)
        if first is None:
            return prior
        return prior.updated(Likelihood(self.rough, self._around(prior, first)))

    @cached_property
    def over_prior(self) -> Likelihood:
        """The likelihood over the updated prior, of a search for the null hypothesis."""
        return Likelihood(self.rough, self._around(self.prior, self.rough.fitted))

    def _around(self, prior: GaussianPrior, recordings: Objective) -> Objective:
        return recordings.near(prior.x, prior.reach(self.rough, FAR), BROAD, only=range(self.rough.known))

    @cached_property
    def multimodal(self) -> list[int]:
        """Indices of the known numbers along which there are several optima."""
        return multimodal(self.over_prior, self.prior)

    @cached_property
    def noise(self) -> float:
        """Relative standard deviation of a point, of the best recording."""
        return min(float(np.median(state.noise)) for state in self.model.campaign.states)

    def are_inaccurate(self, error: float, level: float = 0.0) -> bool:
        """Whether an error estimate is above tolerance where points have a further deviation `level`."""
        return error > SLACK * math.hypot(self.noise, level)

    def towards(self, hypothesis: Hypothesis, places: Sequence[Real], *, only: str = "") -> Likelihood:
        """The likelihood of a search over the prior and on the way to a hypothesis as it is at `places` (p,), of `only`
        one state if it is named.

        Without a solve where the meshes of the null hypothesis have no other lines of nodes.
        """
        own, moving, x = self.rough.of(hypothesis.effects), self.moving(hypothesis), self.prior.x
        names = {only} if only else {state.name for state in own.campaign.fitted}
        fitted = own.fitted.among(names)
        objective = fitted.on_bases_of(self.over_prior.objective.among(names))
        if objective is None:
            objective = fitted.near(x, self.prior.reach(own, FAR), ROUGH, only=moving)
        indices = [own.index(name) for name in hypothesis.names]
        there = [replaced(x, indices, place[indices]) for place in places]
        return Likelihood(own, objective.neumann_enriched(x, there, ROUGH, only=moving))

    def searched(self, hypothesis: Hypothesis, x: Real, errors: Real | None = None) -> Likelihood:
        """The likelihood of a search about x (p,), on coarse meshes for a hypothesis.

        Models reach over the prior, or over the standard deviations `errors` (p,) where these are less.
        """
        own = self.rough.of(hypothesis.effects, x)
        reach = self.prior.reach(own, FAR)
        for name in hypothesis.names:
            reach[name] = OF_SIZE * abs(float(x[own.index(name)]) - own.stated[own.index(name)])
        if errors is not None:
            reach = {name: min(size, NEAR * float(errors[own.index(name)])) for name, size in reach.items()}
        return Likelihood(own, own.fitted.near(x, reach, ROUGH, only=self.moving(hypothesis), enriches=False))

    def near(
        self, hypothesis: Hypothesis, x: Real, errors: Real, *, noise: float = 0.0, held_out: bool = False
    ) -> Likelihood:
        """The likelihood of the recordings that were fitted, or of those `held_out`, about an optimum x (p,) of those
        standard deviations (p,), on meshes for it.

        The models are right far below the noise, or below `noise` where points deviate by more.
        """
        own = self.model.of(hypothesis.effects, x)
        recordings = own.held_out if held_out else own.fitted
        assert recordings is not None
        reach = {p.name: NEAR * float(error)
                 for p, error in zip(own.parameters, errors, strict=True) if error > 0.0}
        reach.update({own.parameters[i].name: own.parameters[i].scale for i in own.uneven})
        return Likelihood(own, recordings.near(x, reach, FINE * max(self.noise, noise),
                                               only=[*self.moving(hypothesis), *own.uneven], enriches=False))

    @cached_property
    def stated(self) -> tuple[list[Complex], float]:
        """Impedance (n,) ohm of every state as it is stated, those held out last, and the rms of ln(Z_model /
        Z_measured) of those that were fitted; on the coarse meshes of a search where so much is left that their error
        does not matter (:data:`FAR_OFF`)."""
        for model in (self.rough, self.model):
            parts = [each.near(model.stated, {}, ROUGH, only=(), enriches=False)
                     for each in (model.fitted, model.held_out) if each is not None]
            found = [Likelihood(model, each) for each in parts]
            data = found[0].data(Hypothesis(), model.stated)
            left = rms_of_impedance(found[0].states, data.log_ratio)
            if left > FAR_OFF or model is self.model:
                break
        return [impedance for each in found for impedance in each.impedances(model.stated)], left

    @property
    def stated_rms(self) -> float:
        """Rms of ln(Z_model / Z_measured) as the campaign states the device."""
        return self.stated[1]

    def tangents(self, x: Real) -> Tangents:
        """The data at x (p,) and their derivatives by all parameters of all hypotheses, on coarse meshes."""
        every = self.with_all
        objective = every.fitted.near(x, {}, ROUGH, only=(), enriches=False).with_every(x)
        found = objective(x, deviation=Likelihood(every, objective).point_deviations())
        return Tangents(x, found.jacobian, found.vector)

    def moving(self, hypothesis: Hypothesis) -> list[int]:
        """Indices of the parameters that move under a hypothesis."""
        return self.model.free(hypothesis.effects)[0]
