"""Descents on coarse meshes, with data weight raised in stages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.evidence import WrongEvidence
from workbench.diagnosis.findings import Candidate, InitialOptimum
from workbench.diagnosis.levels import LEVELS, SCHEDULE, STAGE
from workbench.diagnosis.likelihood import Hypothesis, LaplaceApproximation, Likelihood
from workbench.diagnosis.local_models import PLACES, LocalModels
from workbench.fitting.search import NO_END
from workbench.search.continuation import tempered
from workbench.search.multistart import StartPoint, multistart

Real = NDArray[np.float64]

#: Errors that end one start of several.
REFUSED: tuple[type[Exception], ...] = (*NO_END, WrongEvidence)


def initial_optimum(models: LocalModels, x: Real, held: tuple[int, ...] = ()) -> InitialOptimum:
    """The optimum of the null hypothesis at low data weight near x.

    x is (p,). Parameters of the indices `held` move only after the others.

    Raises:
        NotConverged, NotEnriched, MeshError, InputError, ValueError: nothing can be predicted, or is admissible.
    """
    likelihood = models.over_prior
    if held and models.are_inaccurate(likelihood.data(Hypothesis(), x).error, LEVELS[0]):
        likelihood = models.searched(Hypothesis(), x)
    search = likelihood.search(Hypothesis())
    end = tempered(SCHEDULE.holding(held), partial(likelihood.solve, search), x)
    return InitialOptimum(end.x, end.cost, search.errors(end))


def descend_in_stages(
    models: LocalModels, hypothesis: Hypothesis, x: Real, errors: Real | None = None, *,
    likelihood: Likelihood | None = None, levels: Sequence[float] = LEVELS, held: bool = False,
) -> LaplaceApproximation:
    """The optimum near x (p,) at the last of some `levels`. Each level begins at the optimum before. Models are made
    again about it if their error estimate is too large.

    Raises:
        NotConverged, NotEnriched, MeshError, InputError, ValueError, ArithmeticError: as :func:`initial_optimum`.
    """
    for level in levels:
        for _ in range(PLACES if level == levels[-1] else 1):
            if likelihood is None:
                likelihood = models.towards(hypothesis, [x]) if errors is None else models.searched(
                    hypothesis, x, errors)
            search = likelihood.search(hypothesis)
            own = [likelihood.model.index(name) for name in hypothesis.names]
            # The admissible range may be a million times the value.
            moved = np.abs(x - search.centre)
            search.scale[own] = np.where(moved[own] > 0.0, moved[own], search.scale[own])
            if held:
                x, held = tempered(SCHEDULE.holding(tuple(own)), partial(likelihood.solve, search), x).x, False
            x = likelihood.solve(search, replace(STAGE, deviation=level), x).x
            end = likelihood.laplace(hypothesis, x, level)
            if not models.are_inaccurate(end.error_estimate, level):
                break
            likelihood, errors = None, end.errors
    return end


def candidate_from(models: LocalModels, hypothesis: Hypothesis, starts: Sequence[Real]) -> Candidate:
    """A hypothesis with the distinct optima of descents from `starts` (p,).

    They begin like those of the null hypothesis. The parameters of the hypothesis move after all others.

    Raises:
        NotConverged, NotEnriched, MeshError, InputError, ValueError, ArithmeticError: all starts failed, the last one
            for this reason.
    """
    trials = multistart([StartPoint(hypothesis.name, start) for start in starts],
                        lambda start: descend_in_stages(models, hypothesis, start.x, held=True), refused=REFUSED)
    candidate = Candidate.of(models.rough, hypothesis, (trial.end for trial in trials if trial.end is not None))
    if candidate is None:
        refused = next((trial.error for trial in reversed(trials) if trial.error is not None), None)
        raise refused or ValueError(f"{hypothesis.name}: no place to start from")
    return candidate
