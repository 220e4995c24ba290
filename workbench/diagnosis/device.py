"""The one model of a campaign: every state's problem with all hypotheses in it at nothing, and all parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

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
from workbench.diagnosis.inhomogeneity import waves
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
from workbench.physics.rim import FOUND, OfRim
from workbench.physics.term import Term
from workbench.physics.uneven import UnevenSolid

Real = NDArray[np.float64]


#: Range of a known parameter to either side, in its standard uncertainties. Doubled, nothing changes: the prior
#: admits no more.
REACH = 5.0

#: Least share of a positive number that an offset leaves: a number of zero has no spectrum.
LEAST = 0.05


#: Recordings of a parameter that acts in none: no recording has an empty name.
NOWHERE = ("",)

#: Accuracy with which forms follow shapes, which most devices do not have: exact where all are as stated. A tenth of
#: the error takes half as many nodes more, and every node of every shape is another matrix. The effect of a shape on
#: the terms of another hypothesis is of second order, and right to a few hundredths: as well as the rest it took 1.8
#: times as many integrals over a chip.
HYPOTHETICAL = Interpolation(1e-4, 1.25, True, 0.03)


#: Models of some hypotheses that are kept, the last ones made: a search goes from one to the next.
KEPT = 4


@dataclass(frozen=True, eq=False)
class Model:
    """All parameters of a campaign, and the objectives over its states in which some hypotheses act.

    The first ``known`` parameters are the known numbers, those that all states share and then the offsets of single
    states; all of these have a prior. ``whole`` is the objective over all states, ``fitted`` and ``held_out`` those
    over either kind (None without states held out); ``effects`` are all hypotheses, whose parameters follow the known
    ones, and ``acting`` those that the problems have terms, lengths and meshes for: parameters of others do nothing.
    Meshes are of that ``accuracy``; they have lines of nodes at the edges of all rims or, if any ``widths`` by name are
    given, at those of the rims that are so wide. ``others`` are hypotheses, in words, that do not fit the shape of a
    layer; ``uneven`` are waves in the transducer by the index of their amplitude, the last parameters; ``refusals``
    holds the reason of every step of a search that could not be taken.
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
    uneven: Mapping[int, UnevenSolid] = field(default_factory=dict)
    refusals: list[str] = field(default_factory=list)
    _made: list[Model] = field(default_factory=list)

    def of(self, chosen: Sequence[Effect], x: Real | None = None) -> Model:
        """The model in which the `chosen` hypotheses act and no others, on meshes of its own.

        With x (p,), meshes have lines of nodes at the edges of rims as they are there (`rim.FOUND`), not at those of
        all widths. Models made before serve again.
        """
        sizes = {} if x is None else {name: float(x[self.index(name)]) for effect in chosen for name in effect.rims}
        wanted = {name: size for name, size in sizes.items() if size > 0.0}
        for model in (self, *self._made):
            if {each.name for each in model.acting} == {each.name for each in chosen} and (
                    model.widths.keys() == wanted.keys()) and all(
                    abs(model.widths[name] - size) <= FOUND for name, size in wanted.items()):
                return model
        made = device_model(self.campaign, accuracy=self.accuracy, catalogue=(self.effects, self.others), widths=wanted,
                            acting=[each.name for each in chosen])
        self._made[:] = [*self._made[1 - KEPT:], replace(made, refusals=self.refusals, _made=self._made)]
        return self._made[-1]

    @cached_property
    def _places(self) -> Mapping[str, int]:
        return {p.name: i for i, p in enumerate(self.parameters)}

    @property
    def hypotheses(self) -> int:
        """The number of single hypotheses: those of the catalogue, a change in each region, and modes."""
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
        """The lowest and the highest (k,) that the parameters of some indices may be."""
        low, high = np.array([(self.parameters[i].low, self.parameters[i].high) for i in indices]).T
        return low, high

    def free(self, chosen: Sequence[Effect]) -> tuple[list[int], list[int]]:
        """Indices of the parameters free under some hypotheses together, and of those whose prior is released."""
        moved = [self.index(p.name) for effect in chosen for p in effect.parameters]
        released = [self.index(name) for effect in chosen for name in effect.releases]
        return sorted({*range(self.known), *moved}), sorted(set(released))


def device_model(
    campaign: Campaign, *, accuracy: float | Discretisation = ACCURACY, progress: Progress = no_progress,
    acting: Sequence[str] = (), catalogue: tuple[Sequence[Effect], tuple[str, ...]] | None = None,
    widths: Mapping[str, float] | None = None,
) -> Model:
    """Mesh every state and put known physics and hypotheses into its problem; see :class:`Model`.

    Args:
        acting: names of the hypotheses that act.
        catalogue: all hypotheses and those left out, if they are known (`catalogue.effects_and_others`).

    Raises:
        InputError: as `workbench.model.problem.build`, or a layer that cannot have all sizes that are looked at.
        MeshError: a mesh could not be made, or folds where a size is at an end of its range.
    """
    found, others = catalogue or effects_and_others(
        Device(campaign.states, campaign.known, campaign.fixed, campaign.registry))
    own = {each.name: each.with_rings(widths) if widths else each for each in found
           if each.name in acting}
    problems = _problems(campaign, tuple(own.values()), accuracy, widths, progress)
    shared = {each.name: _known(each, campaign, list(problems.values())) for each in campaign.taken
              if not each.parsed.state}
    known = (*shared.values(), *(_offset(each, campaign, problems, shared)
                                 for each in campaign.taken if each.parsed.state in problems))
    more: dict[str, Parameter] = {}
    for effect in found:
        for parameter in effect.parameters:
            more.setdefault(parameter.name, parameter)
    moving = {p.name for effect in own.values() for p in effect.parameters}
    uneven = _waves(campaign, problems)
    parameters = (*known, *(p if p.name in moving else replace(p, recordings=NOWHERE) for p in more.values()))
    recordings = [_with_waves(each, list(uneven)) for each in _recordings(
        campaign, problems, parameters, tuple(own.values()))]
    first = len(parameters)
    parameters = (*parameters, *uneven.values())

    # Models grow where they are told to (`Objective.near`), not on the way.
    whole = Objective.of(recordings, parameters, tolerance=math.inf)
    fitted, held_out = ([s.name for s in states] for states in (campaign.fitted, campaign.held_out))
    return Model(campaign, parameters, len(known), tuple(found), tuple(own.values()), whole, whole.among(fitted),
                 whole.among(held_out) if held_out else None, accuracy, dict(widths or {}), tuple(others),
                 dict(enumerate(uneven, first)))


def inhomogeneities(campaign: Campaign) -> tuple[float, ...]:
    """The sizes of the inhomogeneity that are averaged over, ascending: the one that the campaign states, if it does.
    """
    stated = campaign.inhomogeneity
    return tuple(map(float, INHOMOGENEITIES)) if stated is None else (stated,)


def _waves(campaign: Campaign, problems: Mapping[str, Problem]) -> dict[UnevenSolid, Parameter]:
    """The waves in the transducer, each with its amplitude, of the largest inhomogeneity that is averaged over."""
    size = inhomogeneities(campaign)[-1]
    if not size:
        return {}
    middle, highest = max((float(np.mean(state.measured.frequency[[0, -1]])), state.name) for state in campaign.states)
    found = {}
    for wave, deviation in waves(problems[highest], middle):
        own = size * deviation
        found[wave] = Parameter(wave.amplitude, 0.0, -REACH * own, REACH * own, Stated(own), "1", nuisance=True)
    return found


def _with_waves(recording: FitRecording, uneven: Sequence[UnevenSolid]) -> FitRecording:
    """A recording with the waves in its transducer, if it has one; forms follow no lengths."""
    if not uneven or TRANSDUCER not in recording.problem.materials:
        return recording
    problem = recording.problem.with_terms(tuple(uneven), dict.fromkeys((each.amplitude for each in uneven), 0j))
    return replace(recording, problem=problem)


def _problems(
    campaign: Campaign, acting: Sequence[Effect], accuracy: float | Discretisation,
    widths: Mapping[str, float] | None, progress: Progress,
) -> dict[str, Problem]:
    """The problem of every state, with known physics and the terms of hypotheses."""
    problems: dict[str, Problem] = {}
    requested = {state.name: _lines(state, _neutral(state, acting), widths) for state in campaign.states}
    for number, state in enumerate(campaign.states):
        progress("meshes", number / len(campaign.states))
        # States of one chip have one mesh.
        alike = [requested[each.name] for each in campaign.states if each.device.section == state.device.section]
        skins = {region: skin for own, _ in alike for region, skin in own.items()}
        radii = {radius for _, own in alike for radius in own}
        problem = build(state.device, accuracy=accuracy, skins=skins, radii=sorted(radii),
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
    campaign: Campaign, problems: Mapping[str, Problem], parameters: Sequence[Parameter], acting: Sequence[Effect]
) -> list[FitRecording]:
    """The recordings of all states, with the lengths and shapes that parameters move among the values of problems."""
    moved = [p for p in parameters if p.recordings != NOWHERE]
    flexed: list[Problem] = []
    chips: list[Chip] = []
    for state in campaign.states:
        # Shapes that only hypotheses bring in are 0 on the chip.
        shapes = [name for p in moved for name in p.names if name in possible(state.chip)]
        chips.append(with_shapes(state.chip, shapes))
        ranges = ranges_of_dimensions(moved, chips[-1].dimensions())
        flexed.append(parametrised_within(problems[state.name], chips[-1], ranges, interpolation=HYPOTHETICAL,
                                          neutral=_neutral(state, acting)))
    # One mesh for states of one chip, so that they share what is solved on it.
    meshes = {section: joined_meshes([each.mesh for each in flexed if each.mesh.section == section])
              for section in {each.mesh.section: None for each in flexed}}
    found = {state.name: FitRecording(state.name, replace(problem, mesh=meshes[problem.mesh.section]), state.measured,
                                      chip)
             for state, problem, chip in zip(campaign.states, flexed, chips, strict=True)}
    # An observation is one more recording of the problem of its state.
    observed = [(state, each) for state in campaign.recorded if (each := state.observation) is not None]
    return [*found.values(), *(replace(
        found[each.state], name=state.name, measured=state.measured, state=each.state,
        observable=FieldObservable(each, state.device)) for state, each in observed)]


def _lines(
    state: DeviceState, terms: Iterable[Term], widths: Mapping[str, float] | None
) -> tuple[dict[str, float], set[float]]:
    """The skins by region, and the radii (m), at which terms of hypotheses ask for lines of nodes in a state."""
    integrals = [(term, integral) for term in terms for integral in term.integrals()]
    skins = {integral.place: abs(integral.skin) for _, integral in integrals if integral.skin}
    return skins, {integral.radius_fraction * _radius(state.chip, integral.place) for term, integral in integrals
                   if integral.radius_fraction and (
                       not widths or (isinstance(term, OfRim) and term.rim.number in widths))}


def _radius(chip: Chip, region: str) -> float:
    """The largest radius (m) of a region."""
    if region == CAVITY:
        return max(hole.inner_radius for hole in chip.holes)
    return chip.layer(region).radius.value


def _known(number: Number, campaign: Campaign, problems: Sequence[Problem]) -> Parameter:
    """The parameter of a known number, with its prior; a hypothesis may release the prior."""
    name, parsed, value, error, stated = number.name, number.parsed, number.value, number.deviation, number.stated
    if number.is_bench:
        found = bench_parameter(name)
        return replace(found, stated=stated)
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
    found = material_parameter(problem, parsed.owner, parsed.local)
    low, high = found.low, found.high
    if found.is_loss:
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
    """The offset of one state from a shared number: with its own uncertainty, within the range of the number."""
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
