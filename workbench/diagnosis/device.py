"""The one model of a campaign: every state's problem with all hypotheses in it at nothing, and all parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geometry.mesh import SectionMesh
from geometry.section import Section
from materials.kinds import Fluid
from workbench.diagnosis.campaign import Campaign, unit_of, value_of
from workbench.diagnosis.catalogue import effects, mistaken_length
from workbench.diagnosis.hypothesis import Device, Effect
from workbench.dimensions import flexible
from workbench.discretisation import ACCURACY, Discretisation
from workbench.fitting.objective import Objective, Recording
from workbench.fitting.parameter import (
    Parameter,
    bench_parameter,
    material_parameter,
    stretchable,
)
from workbench.parameter_names import Kind, ParameterName
from workbench.problem import Problem, build, with_boundary_layers

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Model:
    """All parameters of a campaign, the first ``known`` of them what is known to be uncertain, and its objectives.

    ``fitted`` and ``held_out`` are the objectives over the states of either kind (None without states held out);
    ``effects`` the hypotheses, whose parameters follow the known ones.
    """

    campaign: Campaign
    parameters: tuple[Parameter, ...]
    known: int
    effects: tuple[Effect, ...]
    fitted: Objective
    held_out: Objective | None

    def index(self, name: str) -> int:
        return next(i for i, p in enumerate(self.parameters) if p.name == name)

    def free(self, chosen: Sequence[Effect]) -> tuple[list[int], list[int]]:
        """Indices of the parameters free under some hypotheses together, and of those whose prior is released."""
        moved = [self.index(p.name) for effect in chosen for p in effect.parameters]
        released = [self.index(name) for effect in chosen for name in effect.releases]
        return sorted({*range(self.known), *moved}), sorted(set(released))

    def deviations(self) -> list[Real]:
        """Relative standard deviation (n,) of every point of every fitted state."""
        return [state.noise for state in self.campaign.fitted]


def model(
    campaign: Campaign, *, accuracy: float | Discretisation = ACCURACY, cache: Path | None = None,
    progress: Callable[[float], None] = lambda _share: None,
) -> Model:
    """Mesh every state and put known physics and all hypotheses into its problem.

    Raises:
        InputError: as `workbench.problem.build`.
        MeshError: a mesh could not be made.
    """
    device = Device(campaign.states, campaign.known, campaign.fixed, campaign.registry)
    hypotheses = effects(device)
    problems: list[Problem] = []
    for number, state in enumerate(campaign.states):
        progress(number / len(campaign.states))
        terms = [term for effect in hypotheses for term in effect.terms.get(state.name, ())]
        skins = {integral.place: abs(integral.skin) for term in terms for integral in term.integrals() if integral.skin}
        problem = build(state.device, accuracy=accuracy,
                        skins=skins, cache=cache,
                        band=(float(state.measured.frequency[0]), float(state.measured.frequency[-1])))
        problem = with_boundary_layers(problem)
        for effect in hypotheses:
            values = {name: complex(value) for name, value in effect.values.get(state.name, {}).items()
                      if name not in problem.values}
            problem = problem.with_terms(effect.terms.get(state.name, ()), values)
        problems.append(problem)
    known = tuple(_known(name, error, campaign, problems) for name, error in campaign.known.items())
    more: dict[str, Parameter] = {}
    for effect in hypotheses:
        for parameter in effect.parameters:
            more.setdefault(parameter.name, parameter)
    parameters = (*known, *more.values())
    recordings: dict[str, Recording] = {}
    meshes: dict[Section, SectionMesh] = {}
    for state, problem in zip(campaign.states, problems, strict=True):
        lengths = state.chip.dimensions()
        radii = {name: (p.low, p.high) for p in parameters if p.is_dimension
                 for name in p.names if ParameterName.parse(name).is_radius and name in lengths}
        problem = flexible(problem, state.chip, radii)
        # One mesh for states of one chip, so that they share what is solved on it.
        problem = replace(problem, mesh=meshes.setdefault(problem.mesh.section, problem.mesh))
        recordings[state.name] = Recording(state.name, problem, state.measured, state.chip)

    # Models grow where they are told to (`Objective.cover`), not on the way.
    whole = Objective(list(recordings.values()), parameters, tolerance=math.inf)
    fitted, held_out = ([s.name for s in states] for states in (campaign.fitted, campaign.held_out))
    return Model(campaign, parameters, len(known), hypotheses, whole.of(fitted),
                 whole.of(held_out) if held_out else None)


def _known(name: str, error: float, campaign: Campaign, problems: Sequence[Problem]) -> Parameter:
    """A parameter that may move within what is known of it, and further only where a hypothesis releases that."""
    value, unit = value_of(name, campaign.states), unit_of(name, campaign.states)
    parsed = ParameterName.parse(name)
    if parsed.kind is Kind.BENCH:
        found = bench_parameter(name)
        return Parameter(found.name, 0.0, found.low, found.high, error, unit)
    if parsed.kind is Kind.DIMENSION:
        limit = mistaken_length(name, value)
        low, high = min(limit.lowest, value - 5.0 * error), max(limit.highest, value + 5.0 * error)
        others = campaign.tied.get(name, ())
        for each in (name, *others):
            low, high = stretchable([s.chip for s in campaign.states], each, low, high)
        return Parameter(name, value, low, high, error, unit, tied=others)
    problem = next(p for p in problems if parsed.key in p.values)
    if any(isinstance(m, Fluid) and m.name == parsed.owner for m in problem.materials.values()):
        reach = max(0.1, 5.0 * error / value)
        return Parameter(name, 1.0, 1.0 - reach, 1.0 + reach, error / value, "1", relative=True)
    found = material_parameter(problem, parsed.owner, parsed.local)
    return Parameter(name, found.start, min(found.low, found.start - 5.0 * error) if not found.is_loss else found.low,
                     max(found.high, found.start + 5.0 * error) if not found.is_loss else found.high, error, unit)
