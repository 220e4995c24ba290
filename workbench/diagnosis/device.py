"""The model of a campaign: problems with all hypotheses, and all parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.dimension import SHAPES
from geometry.names import CAVITY, TRANSDUCER
from geometry.shapes import possible, with_shapes
from materials.kinds import Fluid
from workbench.campaign.campaign import Campaign, DeviceState
from workbench.campaign.numbers import DeviceNumbers
from workbench.catalogue.catalogue import effects_and_others, mistaken_length, mistaken_shape
from workbench.catalogue.effect import Device, Effect
from workbench.diagnosis.inhomogeneity import cosine_modes
from workbench.diagnosis.observed import FieldObservable
from workbench.diagnosis.odds import INHOMOGENEITIES
from workbench.fitting.objective import FitRecording, Objective
from workbench.fitting.parameter import (
    Parameter,
    bench_parameter,
    material_parameter,
    ranges_of_dimensions,
    stretchable,
)
from workbench.jobs.progress import Progress, no_progress
from workbench.model.dimensions import parametrised_within
from workbench.model.discretisation import ACCURACY, Discretisation
from workbench.model.moved_mesh import Interpolation, joined_meshes
from workbench.model.numbers import BENCH_ELEMENTS, Number, Stated, limits
from workbench.model.problem import Problem, build
from workbench.physics.annulus import EDGE_STEP, AnnulusTerm
from workbench.physics.cosine_mode import CosineMode
from workbench.physics.term import Term

Real = NDArray[np.float64]


#: Range of a known parameter to either side, in its standard uncertainties. Doubled, nothing changes: the prior
#: admits no more.
REACH = 5.0

#: Least share of a positive parameter after an offset: no spectrum exists at zero.
LEAST = 0.05


#: Recordings of a parameter that acts in none: no recording has an empty name.
NOWHERE = ("",)

#: Accuracy with which forms follow shapes, which most devices do not have: exact where all are as stated. A tenth of
#: the error takes half as many nodes more, and every node of every shape is another matrix. The effect of a shape on
#: the terms of another hypothesis is of second order, and right to a few hundredths: as well as the rest it took 1.8
#: times as many integrals over a chip.
HYPOTHETICAL = Interpolation(1e-4, 1.25, True, 0.03)


#: Number of cached models, the last ones made: a search goes from one to the next.
KEPT = 4


@dataclass(frozen=True, eq=False)
class Model:
    """All parameters of a campaign, and its objectives under some hypotheses.

    The first ``known`` parameters are those shared by all states, then the offsets of single states; all have a prior.
    ``whole`` is the objective over all states, ``fitted`` and ``held_out`` those over either kind (None without states
    held out). ``effects`` are all hypotheses; their parameters follow the known ones. The problems have terms, lengths
    and meshes for those ``acting``: parameters of the others do nothing. Meshes have that ``accuracy``, and lines of
    nodes at the edges of all annuli, or of those of the given ``widths`` by name. ``others`` are hypotheses, in words,
    that do not fit the shape of a layer; ``uneven`` are cosine modes in the transducer by the index of their amplitude,
    the last parameters; ``refusals`` holds the reason of every failed step of a search.
    """

    campaign: Campaign
    parameters: tuple[Parameter, ...]
    known: int
    effects: tuple[Effect, ...]
    acting: tuple[Effect, ...]
    whole: Objective
    fitted: Objective
    held_out: Objective | None
    accuracy: float | Discretisation
    widths: Mapping[str, float]
    others: tuple[str, ...] = ()
    uneven: Mapping[int, CosineMode] = field(default_factory=dict)
    refusals: list[str] = field(default_factory=list)
    _made: list[Model] = field(default_factory=list)

    def of(self, chosen: Sequence[Effect], x: Real | None = None) -> Model:
        """The model with only the `chosen` hypotheses, on meshes of its own.

        With x (p,), meshes have lines of nodes at the present edges of annuli (`annulus.EDGE_STEP`), not at those of
        all widths. Models made before are used again.
        """
        sizes = {} if x is None else {name: float(x[self.index(name)]) for effect in chosen for name in effect.rims}
        wanted = {name: size for name, size in sizes.items() if size > 0.0}
        for model in (self, *self._made):
            if {each.name for each in model.acting} == {each.name for each in chosen} and (
                    model.widths.keys() == wanted.keys()) and all(
                    abs(model.widths[name] - size) <= EDGE_STEP for name, size in wanted.items()):
                return model
        made = device_model(self.campaign, accuracy=self.accuracy, like=self, widths=wanted,
                            acting=[each.name for each in chosen])
        self._made[:] = [*self._made[1 - KEPT:], replace(made, refusals=self.refusals, _made=self._made)]
        return self._made[-1]

    def in_state(self, chosen: Sequence[Effect], state: str) -> Model:
        """The model of one state with only the `chosen` hypotheses."""
        made = device_model(self.campaign, accuracy=self.accuracy, like=self, acting=[each.name for each in chosen],
                            only=state)
        return replace(made, refusals=self.refusals)

    @cached_property
    def _places(self) -> Mapping[str, int]:
        return {p.name: i for i, p in enumerate(self.parameters)}

    @cached_property
    def correlation(self) -> Real:
        """The correlation (p, p) of the priors of all parameters."""
        matrix = np.eye(len(self.parameters))
        for (one, other), value in self.campaign.correlations.items():
            i, j = self._places[one], self._places[other]
            matrix[i, j] = matrix[j, i] = value
        return matrix

    @property
    def hypotheses(self) -> int:
        """The number of single hypotheses: the catalogue, each region, and modes."""
        return len(self.effects) + len({region for state in self.campaign.fitted for region in state.materials}) + 1

    @property
    def stated(self) -> Real:
        """The stated values of all parameters (p,)."""
        return np.array([p.start for p in self.parameters])

    def index(self, name: str) -> int:
        """The index of the parameter of that name in :attr:`parameters`."""
        return self._places[name]

    def effect(self, name: str) -> Effect:
        """The hypothesis of that name."""
        return next(each for each in self.effects if each.name == name)

    def bounds(self, indices: Iterable[int]) -> tuple[Real, Real]:
        """The bounds (k,) of some parameters: lowest and highest values."""
        low, high = np.array([(self.parameters[i].low, self.parameters[i].high) for i in indices]).T
        return low, high

    def free(self, chosen: Sequence[Effect]) -> tuple[list[int], list[int]]:
        """Indices of the free parameters, and of those whose prior is dropped."""
        moved = [self.index(p.name) for effect in chosen for p in effect.parameters]
        without_prior = [self.index(name) for effect in chosen for name in effect.freed]
        return sorted({*range(self.known), *moved}), sorted(set(without_prior))


def device_model(
    campaign: Campaign, *, accuracy: float | Discretisation = ACCURACY, progress: Progress = no_progress,
    acting: Sequence[str] = (), like: Model | None = None, widths: Mapping[str, float] | None = None, only: str = "",
) -> Model:
    """Mesh every state and build its problem with all physics; see :class:`Model`.

    Args:
        acting: names of the hypotheses that act.
        like: another model of the campaign, with the same hypotheses and parameters.
        only: the one state that is meshed; all by default.

    Raises:
        InputError: as `workbench.model.problem.build`, or a layer that cannot have all sizes that are looked at.
        MeshError: a mesh could not be made, or folds where a size is at an end of its range.
    """
    effects, others = (like.effects, like.others) if like else effects_and_others(
        Device(campaign.states, campaign.known, campaign.fixed, campaign.registry))
    own = {each.name: each.with_rings(widths) if widths else each for each in effects
           if each.name in acting}
    states = [state for state in campaign.states if only in ("", state.name)]
    problems = _problems(states, tuple(own.values()), accuracy, widths, progress)
    known = like.parameters[:like.known] if like else _known_parameters(campaign, problems)
    more: dict[str, Parameter] = {}
    for effect in effects:
        for parameter in effect.parameters:
            more.setdefault(parameter.name, parameter)
    moving = {p.name for effect in own.values() for p in effect.parameters}
    uneven = ({each: like.parameters[i] for i, each in like.uneven.items()} if like else
              _cosine_modes(campaign, problems))
    parameters = (*known, *(p if p.name in moving else replace(p, recordings=NOWHERE) for p in more.values()))
    recordings = [_with_cosines(each, list(uneven)) for each in _recordings(
        states, campaign.recorded, problems, parameters, tuple(own.values()))]
    first = len(parameters)
    parameters = (*parameters, *uneven.values())

    # Models grow on request (`Objective.near`), not on the way.
    whole = Objective.of(recordings, parameters, tolerance=math.inf)
    fitted, held_out = (whole.among([s.name for s in kind]) for kind in (campaign.fitted, campaign.held_out))
    return Model(campaign, parameters, len(known), tuple(effects), tuple(own.values()), whole, fitted,
                 held_out if held_out.views else None, accuracy, dict(widths or {}), tuple(others),
                 dict(enumerate(uneven, first)))


def inhomogeneities(campaign: Campaign) -> tuple[float, ...]:
    """The relative sizes of the inhomogeneity to average over, ascending. A stated size is the only one."""
    stated = campaign.inhomogeneity
    return tuple(map(float, INHOMOGENEITIES)) if stated is None else (stated,)


def _cosine_modes(campaign: Campaign, problems: Mapping[str, Problem]) -> dict[CosineMode, Parameter]:
    """The cosine modes in the transducer, with amplitudes of the largest inhomogeneity."""
    size = inhomogeneities(campaign)[-1]
    if not size:
        return {}
    middle, highest = max((float(np.mean(state.measured.frequency[[0, -1]])), state.name) for state in campaign.states)
    amplitudes = {}
    for wave, deviation in cosine_modes(problems[highest], middle):
        own = size * deviation
        amplitudes[wave] = Parameter(wave.amplitude, 0.0, -REACH * own, REACH * own, Stated(own), "1", nuisance=True)
    return amplitudes


def _with_cosines(recording: FitRecording, uneven: Sequence[CosineMode]) -> FitRecording:
    """A recording with the cosine modes in its transducer, if any."""
    if not uneven or TRANSDUCER not in recording.problem.materials:
        return recording
    problem = recording.problem.with_terms(tuple(uneven), dict.fromkeys((each.amplitude for each in uneven), 0j))
    return replace(recording, problem=problem)


def _known_parameters(campaign: Campaign, problems: Mapping[str, Problem]) -> tuple[Parameter, ...]:
    """The known parameters: those shared by all states, then the offsets."""
    shared = {each.name: _known(each, campaign, list(problems.values())) for each in campaign.uncertain
              if not each.parsed.state}
    return (*shared.values(), *(_offset(each, campaign, problems, shared)
                                for each in campaign.uncertain if each.parsed.state in problems))


def _problems(
    states: Sequence[DeviceState], acting: Sequence[Effect], accuracy: float | Discretisation,
    widths: Mapping[str, float] | None, progress: Progress,
) -> dict[str, Problem]:
    """The problem of every state, with known physics and hypotheses."""
    problems: dict[str, Problem] = {}
    requested = {state.name: lines_of_nodes(state, _neutral(state, acting), widths) for state in states}
    for number, state in enumerate(states):
        progress("meshes", number / len(states))
        # States of one chip have one mesh.
        alike = [requested[each.name] for each in states if each.device.section == state.device.section]
        skins = {region: skin for own, _, _ in alike for region, skin in own.items()}
        radii = {radius for _, own, _ in alike for radius in own}
        levels = {level for *_, own in alike for level in own}
        problem = build(state.device, accuracy=accuracy, skins=skins, radii=sorted(radii), levels=sorted(levels),
                        band=(float(state.measured.frequency[0]), float(state.measured.frequency[-1])))
        for effect in acting:
            values = {name: complex(value) for name, value in effect.values.get(state.name, {}).items()
                      if name not in problem.values}
            problem = problem.with_terms(effect.terms.get(state.name, ()), values)
        problems[state.name] = problem
    return problems


def _neutral(state: DeviceState, acting: Sequence[Effect]) -> list[Term]:
    return [term for effect in acting for term in effect.terms.get(state.name, ())]


def _recordings(
    states: Sequence[DeviceState], recorded: Sequence[DeviceState], problems: Mapping[str, Problem],
    parameters: Sequence[Parameter], acting: Sequence[Effect],
) -> list[FitRecording]:
    """The recordings of all states. Their values include the lengths and shapes that parameters move."""
    moved = [p for p in parameters if p.recordings != NOWHERE]
    flexed: list[Problem] = []
    chips: list[Chip] = []
    following: dict[Any, Problem] = {}
    for state in states:
        # Shapes that only hypotheses bring in are 0 on the chip.
        shapes = [name for p in moved for name in p.names if name in possible(state.chip)]
        chips.append(with_shapes(state.chip, shapes))
        ranges = ranges_of_dimensions(moved, chips[-1].dimensions())
        problem, neutral = problems[state.name], tuple(_neutral(state, acting))
        # States of one chip follow its lengths alike, whatever their drive and temperature.
        key = problem.mesh.section, problem.terms, tuple(ranges.items()), neutral
        if key not in following:
            following[key] = parametrised_within(problem, chips[-1], ranges, interpolation=HYPOTHETICAL,
                                                 neutral=neutral)
        flexed.append(problem.following(following[key]))
    # One mesh for states of one chip, so that they share what is solved on it.
    meshes = {section: joined_meshes([each.mesh for each in flexed if each.mesh.section == section])
              for section in {each.mesh.section: None for each in flexed}}
    recordings = {state.name: FitRecording(state.name, replace(problem, mesh=meshes[problem.mesh.section]),
                                           state.measured, chip)
                  for state, problem, chip in zip(states, flexed, chips, strict=True)}
    # An observation is one more recording of the problem of its state.
    observed = [(state, each) for state in recorded
                if (each := state.observation) is not None and each.state in problems]
    return [*recordings.values(), *(replace(
        recordings[each.state], name=state.name, measured=state.measured, state=each.state,
        observable=FieldObservable(each, state.device)) for state, each in observed)]


def lines_of_nodes(
    state: DeviceState, terms: Iterable[Term], widths: Mapping[str, float] | None = None
) -> tuple[dict[str, float], set[float], set[float]]:
    """The skins by region, and radii and heights (m) of lines. Meshes need these lines of nodes for the terms of
    hypotheses."""
    integrals = [(term, integral) for term in terms for integral in term.integrals()]
    skins = {integral.place: abs(integral.skin) for _, integral in integrals
             if integral.skin and integral.place != CAVITY}
    radii = {integral.radius_fraction * _radius(state.chip, integral.place) for term, integral in integrals
             if integral.radius_fraction and (
                 not widths or (isinstance(term, AnnulusTerm) and term.annulus.number in widths))}
    holes = state.chip.holes
    levels = {holes[-1].z_top - integral.skin * (holes[-1].z_top - holes[0].z_bottom) for _, integral in integrals
              if integral.skin and integral.place == CAVITY}
    return skins, radii, levels


def _radius(chip: Chip, region: str) -> float:
    """The largest radius (m) of a region or cavity boundary."""
    if CAVITY in region.split("|"):
        return max(hole.inner_radius for hole in chip.holes)
    return chip.layer(region).radius.value


def _known(number: Number, campaign: Campaign, problems: Sequence[Problem]) -> Parameter:
    """The known parameter with its prior; a hypothesis may drop the prior."""
    name, parsed, value, error, stated = number.name, number.parsed, number.value, number.deviation, number.stated
    if number.is_bench:
        parameter = bench_parameter(name)
        return replace(parameter, stated=stated)
    if number.is_dimension:
        limit = (mistaken_length(name, value) if parsed.coefficient not in SHAPES else
                 mistaken_shape(next(s.chip for s in campaign.states if name in s.chip.dimensions()), name))
        low, high = min(limit.lowest, value - REACH * error), max(limit.highest, value + REACH * error)
        for each in number.names:
            low, high = stretchable([s.chip for s in campaign.states], each, low, high)
        return Parameter(name, value, low, high, stated, number.unit, number.tied)
    problem = next(p for p in problems if parsed.key in p.values)
    if _is_fluid(problem, parsed.owner):
        reach = max(0.1, REACH * error / value)
        return Parameter(name, 1.0, 1.0 - reach, 1.0 + reach, Stated(error / value, origin=number.origin), "1",
                         relative=True)
    parameter = material_parameter(problem, parsed.owner, parsed.local)
    low, high = parameter.low, parameter.high
    if parameter.is_loss:
        # A loss starts as stated, however small: a fit would start with more.
        low, high = min(low, value), max(high, value)
    else:
        low, high = min(low, value - REACH * error), max(high, value + REACH * error)
    return Parameter(name, value, low, high, stated, number.unit)


def _is_fluid(problem: Problem, material: str) -> bool:
    return any(isinstance(m, Fluid) and m.name == material for m in problem.materials.values())


def _offset(
    number: Number, campaign: Campaign, problems: Mapping[str, Problem], shared: Mapping[str, Parameter]
) -> Parameter:
    """The offset of one state from a shared parameter. It has an uncertainty of its own."""
    parsed, unit, error = number.parsed, number.unit, number.deviation
    (state,) = (each for each in campaign.states if each.name == parsed.state)
    value = DeviceNumbers(campaign.states).number(parsed.shared, state).value
    start = shared[parsed.shared].start if parsed.shared in shared else value
    relative = _is_fluid(problems[state.name], parsed.owner)
    if relative:
        unit, error, value, start = "1", error / value, 1.0, 1.0
    lowest, highest = start - REACH * error, start + REACH * error
    if number.is_bench:
        element = BENCH_ELEMENTS[parsed.coefficient]
        lowest, highest = max(lowest, element.low), min(highest, element.high)
    else:
        least, most = limits(parsed.shared, start)
        lowest, highest = max(lowest, LEAST * start if least == 0.0 < start else least), min(highest, most)
    for each in number.names if number.is_dimension else ():
        lowest, highest = stretchable([state.chip], each, lowest, highest)
    return Parameter(number.name, 0.0, lowest - start, highest - start, Stated(error, origin=number.origin), unit,
                     number.tied, recordings=(state.name,), relative=relative, offset=True)
