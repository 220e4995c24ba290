"""The models of a search on local bases, each valid nearby.

A search uses coarse meshes; only reported explanations have the requested meshes. A model has only the terms of its
acting hypotheses, and its meshes have lines of nodes for these alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from workbench.campaign.state import StateFit, rms_of_impedance, state_fit
from workbench.diagnosis.device import Model, device_model
from workbench.diagnosis.gaussian_prior import GaussianPrior, multimodal, smallest_assembly
from workbench.diagnosis.levels import replaced
from workbench.diagnosis.likelihood import Hypothesis, Likelihood
from workbench.diagnosis.ranking import Tangents
from workbench.fitting.objective import Objective
from workbench.reduced.estimate import SLACK

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Error of Z of the meshes of a search, or the requested error if that is larger.
SEARCHED = 5e-3

#: Residual of the stated device above which the meshes of a search are accurate enough: 20 times their error.
FAR_OFF = 20.0 * SEARCHED

#: Error of Z that reduced models are made for: over the prior, about a point of a search, and about an optimum, that
#: relative to noise. Where constants are known to a tenth, a search over models ten times as wrong ends elsewhere.
BROAD, ROUGH, FINE = 3e-4, 3e-3, 0.1

#: Reach of models: over the prior, in its uncertainties, and about an optimum, in its standard deviations; and of an
#: effect where a search begins, in its size there.
FAR, NEAR, OF_SIZE = 1.5, 2.0, 0.3

#: Most repetitions of a search on models made again about its optimum, until their error estimate there is within
#: tolerance, which is the deviation of the points (:meth:`LocalModels.are_inaccurate`).
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
        return device_model(self.model.campaign, accuracy=SEARCHED, like=self.model)

    @cached_property
    def with_all(self) -> Model:
        """The model of a search with all hypotheses. It is expensive, and made between other tasks."""
        return self.rough.of(self.rough.effects)

    @cached_property
    def prior(self) -> GaussianPrior:
        """The prior of the known parameters, updated by the smallest assembly."""
        prior = GaussianPrior.prior(self.rough)
        first = smallest_assembly(self.rough.fitted)
        if first is None:
            return prior
        return prior.updated(Likelihood(self.rough, self._around(prior, first)))

    @cached_property
    def over_prior(self) -> Likelihood:
        """The likelihood over the updated prior, for the null hypothesis."""
        return Likelihood(self.rough, self._around(self.prior, self.rough.fitted))

    @cached_property
    def roughly_over_prior(self) -> Objective:
        """The objective over the updated prior, coarser (:data:`ROUGH`) for scans."""
        return self.over_prior.objective.coarser(ROUGH)

    def _around(self, prior: GaussianPrior, recordings: Objective) -> Objective:
        return recordings.near(prior.x, prior.reach(self.rough, FAR), BROAD, only=range(self.rough.known))

    @cached_property
    def multimodal(self) -> list[int]:
        """Indices of the known parameters with several optima."""
        return multimodal(self.over_prior, self.prior)

    @cached_property
    def noise(self) -> float:
        """Relative standard deviation of a point, of the best recording."""
        return min(float(np.median(state.noise)) for state in self.model.campaign.states)

    def are_inaccurate(self, error: float, level: float = 0.0) -> bool:
        """Whether an error estimate is above tolerance at a point deviation `level`."""
        return error > SLACK * math.hypot(self.noise, level)

    def towards(self, hypothesis: Hypothesis, places: Sequence[Real], *, only: str = "") -> Likelihood:
        """The likelihood over the prior and on the way to `places` (p,). These are states of a hypothesis; the
        likelihood is that of `only` one state if it is named.

        It needs no solve if the meshes of the null hypothesis have the same lines of nodes.
        """
        x, moving = self.prior.x, self.moving(hypothesis)
        own = self.rough.in_state(hypothesis.effects, only) if only else self.rough.of(hypothesis.effects)
        known = self.roughly_over_prior if only else self.over_prior.objective
        objective = own.fitted.on_bases_of(known.among([recording.name for recording in own.fitted.recordings]))
        if objective is None:
            objective = own.fitted.near(x, self.prior.reach(own, FAR), ROUGH, only=moving)
        indices = [own.index(name) for name in hypothesis.names]
        there = [replaced(x, indices, place[indices]) for place in places]
        return Likelihood(own, objective.neumann_enriched(x, there, ROUGH, only=moving))

    def searched(self, hypothesis: Hypothesis, x: Real, errors: Real | None = None) -> Likelihood:
        """The likelihood of a search about x (p,), on coarse meshes.

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
        """The likelihood about an optimum x (p,), on meshes for it. It is that of the fitted recordings, or of those
        `held_out`; `errors` (p,) are standard deviations.

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
    def stated(self) -> tuple[StateFit, ...]:
        """All states as they are stated, those held out last.

        Coarse meshes serve if the residual is so large that their error does not matter (:data:`FAR_OFF`).
        """
        for model in (self.rough, self.model):
            parts = [Likelihood(model, each.near(model.stated, {}, ROUGH, only=(), enriches=False))
                     for each in (model.fitted, model.held_out) if each is not None]
            data = [each.data(Hypothesis(), model.stated) for each in parts]
            if rms_of_impedance(parts[0].states, data[0].log_ratio) > FAR_OFF:
                break
        return tuple(state_fit(state.name, log, impedance, state.noise, data=state.data)
                     for part, there in zip(parts, data, strict=True)
                     for state, log, impedance in zip(part.states, there.log_ratio, there.impedance, strict=True))

    @property
    def stated_rms(self) -> float:
        """Rms of ln(Z_model / Z_measured) of the fitted states, as stated."""
        fitted = [state for state in self.model.campaign.fitted if state.observation is None]
        points = np.array([state.noise.size for state in fitted])
        of = {fit.name: fit.rms for fit in self.stated}
        return math.sqrt(float(np.average([of[state.name] ** 2 for state in fitted], weights=points)))

    def tangents(self, x: Real) -> Tangents:
        """The data at x (p,) and their derivatives by all parameters. They include all hypotheses, on coarse meshes."""
        every = self.with_all
        objective = every.fitted.near(x, {}, ROUGH, only=(), enriches=False).with_every(x)
        residual = objective(x, deviation=Likelihood(every, objective).point_deviations())
        return Tangents(x, residual.jacobian, residual.vector)

    def moving(self, hypothesis: Hypothesis) -> list[int]:
        """Indices of the parameters that move under a hypothesis."""
        return self.model.free(hypothesis.effects)[0]
