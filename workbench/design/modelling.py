"""Models for a search, each within a box of lengths.

The boxes are as wide as a model can cover, move towards the optimum, and are wider for uncertain chips.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.chip import Chip
from geometry.names import CAVITY
from materials.kinds import Fluid
from materials.registry import Registry
from workbench.design.evaluation import OF_FIELD, Evaluation
from workbench.design.figures import with_parts
from workbench.design.goal import TOLERANCE, Goal, Robust
from workbench.design.input_uncertainty import stated_uncertainty
from workbench.design.model import DesignModel, design_model, full_evaluation
from workbench.design.nonlinear_programme import NonlinearProgramme, ScenarioSample
from workbench.design.variables import GRAIN, Selection, VariedNumber, changed, first_name
from workbench.fem.operators import assemble
from workbench.files.errors import InputError
from workbench.jobs.progress import Progress
from workbench.model.discretisation import Discretisation
from workbench.model.numbers import ParameterName
from workbench.model.problem import build, fill
from workbench.reduced.at_point import reduced
from workbench.reduced.ranges import NotCovered
from workbench.results.spectrum import Origin, Spectrum
from workbench.simulation.run import Snapshot, snapshot

#: Called with the present task within one row, and the share that is done.
Say = Callable[[str, float], None]
#: The lowest and highest length (m) of a model, by name; and half the extent.
Box = Mapping[str, tuple[float, float]]
HalfWidths = Mapping[str, float]

#: Full solves of a model after which its box is halved. Wider boxes need more: three thicknesses within 10 % took 90.
SOLVES = 250

#: Most times that a box is halved before its model is given up.
HALVED = 4

#: Distance (share of the box's width) within which an optimum counts as on a side of its box.
ON_SIDE = 1e-3

#: Frequencies of a plotted spectrum, and its relative error, which is invisible in a plot.
DRAWN, DRAWN_WITHIN = 481, 1e-3


@dataclass(frozen=True)
class ChipSolver:
    """Makes models and full solves of chips for a goal.

    See `workbench.design.model`.
    """

    goal: Goal
    registry: Registry | None
    accuracy: float | Discretisation

    def model(self, chip: Chip, ranges: Box, progress: Progress) -> DesignModel:
        """The figures of `chip` anywhere in the `ranges`.

        The ranges include the chip's own numbers.

        Raises:
            NotCovered: the ranges are too wide.
            InputError: the goal has figures of fields, and no chip with these lengths has any.
        """
        goal = self.goal
        made = design_model(
            chip, goal.state, ranges, figures=goal.figures, operation=goal.operation, registry=self.registry,
            band=goal.band, relative_error=goal.search.relative_error, limit=SOLVES, seed=goal.search.seed,
            progress=progress, accuracy=self.accuracy)
        of_field = [name for name in with_parts(goal.figures) if name in OF_FIELD]
        if of_field and made.reason:
            raise InputError(goal.source, "goal", ", ".join(of_field), f"figures of the impedance: {made.reason}")
        return made

    def full(self, chip: Chip) -> Evaluation:
        """The figures of `chip` by full solves on its own mesh."""
        goal = self.goal
        return full_evaluation(chip, goal.state, {}, figures=goal.figures, operation=goal.operation,
                               registry=self.registry, band=goal.band, accuracy=self.accuracy)

    def spectrum(self, chip: Chip) -> Spectrum:
        """The impedance of `chip` over the band."""
        problem = build(fill(chip, self.goal.state, self.registry), band=self.goal.band, accuracy=self.accuracy)
        frequency = np.linspace(*problem.band, DRAWN)
        _, solution = reduced(assemble(problem.mesh, problem.terms), frequency, problem.values, tolerance=DRAWN_WITHIN)
        return Spectrum.from_solver(frequency, solution.impedance, origin=Origin("simulated"))

    def snapshot(self, chip: Chip, frequency: float) -> Snapshot | None:
        """The fields of `chip` at one frequency (Hz) under the goal's drive.

        None without a fluid in its cavity.
        """
        goal = self.goal
        if not isinstance(fill(chip, goal.state, self.registry).materials.get(CAVITY), Fluid):
            return None
        return snapshot(chip, goal.state, frequency, registry=self.registry, band=goal.band,
                        drive=goal.operation.drive, accuracy=self.accuracy)


@dataclass(frozen=True, eq=False)
class Known:
    """The evaluator of one chip without variables, from its ``evaluation``."""

    evaluation: Evaluation

    @property
    def names(self) -> tuple[str, ...]:
        return ()

    @property
    def figures(self) -> tuple[str, ...]:
        return tuple(self.evaluation.figures)

    def __call__(self, values: Mapping[str, float], *, gradient: bool = False) -> Evaluation:
        return replace(self.evaluation, values={}, gradient={name: np.zeros(0) for name in self.figures})


@dataclass(frozen=True, eq=False)
class Modelling:
    """A model and the programme on it.

    ``box`` (m) is that of the unknowns, ``half_widths`` (m) are half the extents of boxes, and ``seconds`` is the time
    to make the model.
    """

    box: Box
    half_widths: HalfWidths
    programme: NonlinearProgramme
    seconds: float

    @property
    def facts(self) -> Mapping[str, float]:
        """Rank, full solves and relative error of Z of the model.

        Empty if the model has no reduced basis.
        """
        model = self.programme.evaluator
        if not isinstance(model, DesignModel) or model.range_model is None:
            return {}
        made = model.range_model
        return {"rank": float(made.rank), "full_solves": float(made.reduced.solves), "error": model.error}


def box_about(middle: Mapping[str, float], half_widths: HalfWidths, variables: Sequence[VariedNumber]) -> Box:
    """The box around a `middle` (m), moved inwards to stay within bounds."""
    found = {}
    for each in variables:
        width = min(2.0 * half_widths[each.name], each.high - each.low)
        low = min(max(middle[each.name] - 0.5 * width, each.low), each.high - width)
        found[each.name] = (low, low + width)
    return found


def sides_within(lengths: Mapping[str, float], box: Box, variables: Sequence[VariedNumber]) -> tuple[str, ...]:
    """The variables on a side of the box inside their bounds.

    Better points may lie beyond such a side.
    """
    found = []
    for each in variables:
        (low, high), value = box[each.name], lengths[each.name]
        near = ON_SIDE * (high - low)
        if (value < low + near and low > each.low + GRAIN) or (value > high - near and high < each.high - GRAIN):
            found.append(each.name)
    return tuple(found)


def modelled(
    goal: Goal, selection: Selection, about: Mapping[str, float], half_widths: HalfWidths, solver: ChipSolver, say: Say,
    scenarios: ScenarioSample | None = None,
) -> Modelling:
    """The programme of a goal on a model around `about` (m).

    The model is as wide as `half_widths` (m) and the bounds allow. With `scenarios` it covers those too; the programme
    is still that of the nominal chip.

    Raises:
        NotCovered: no model was possible, even of a box halved :data:`HALVED` times.
    """
    started = time.perf_counter()
    chosen = changed(goal.chip, selection.stock, selection.materials)
    for turn in range(HALVED + 1):
        box = box_about(about, half_widths, goal.unknowns)
        chip = changed(chosen, {name: 0.5 * (low + high) for name, (low, high) in box.items()})
        ranges = _with_scenarios(box, chip, scenarios)
        say("model", 0.0)
        try:
            model = (solver.model(chip, ranges, lambda _text, share: say("model", share)) if ranges
                     else Known(solver.full(chip)))
            break
        except NotCovered:
            if turn == HALVED:
                raise
            half_widths = {name: 0.5 * width for name, width in half_widths.items()}
    lengths = {name: each.value for name, each in chip.dimensions().items()}
    variables = tuple(replace(each, low=box[each.name][0], high=box[each.name][1]) for each in goal.unknowns)
    programme = NonlinearProgramme(model, variables, goal.objectives[0], goal.bounds, lengths)
    return Modelling(box, half_widths, programme, time.perf_counter() - started)


def _with_scenarios(box: Box, chip: Chip, scenarios: ScenarioSample | None) -> Box:
    """The box widened by the offsets of the scenarios.

    It includes the numbers that only scenarios vary.
    """
    found = dict(box)
    if scenarios is None:
        return found
    dimensions = chip.dimensions()
    for name in scenarios.names:
        values = [each[name] for each in scenarios.samples]
        present = dimensions[name].value if name in dimensions else 0.0
        low, high = box.get(name, (present, present))
        found[name] = (low + min(0.0, *values), high + max(0.0, *values)) if name in dimensions else (
            min(values), max(values))
    return found


def scenario_sample(goal: Goal, registry: Registry | None = None) -> ScenarioSample | None:
    """The scenarios of the uncertainty of a goal's chip.

    None if the goal is not robust.

    Raises:
        InputError: nothing is uncertain, or a tolerance or a posterior cannot be used.
    """
    robust = goal.robust or (Robust() if goal.objectives[0].figure == TOLERANCE else None)
    if robust is None:
        return None
    stated = stated_uncertainty(goal.chip, goal.state, registry=registry, law=robust.law, posteriors=robust.posteriors)
    if not robust.materials and not robust.posteriors:
        stated = stated.without([name for name in stated.names
                                 if not ParameterName.parse(name).is_dimension])
    if not stated.inputs:
        raise InputError(goal.source, "robust", goal.chip.file, "a chip file with tolerances, or materials = true")
    nominal = {name: each.value for name, each in goal.chip.dimensions().items()}
    points = stated.draw(robust.samples, goal.search.seed).points
    return ScenarioSample(tuple({name: value - nominal.get(name, 0.0) for name, value in stated.values(point).items()}
                        for point in points), robust.quantile, stated.covariance)


def half_widths_of(goal: Goal) -> HalfWidths:
    """The half-widths (m) of the first model's box.

    They are a share of the present lengths, or of the nearest lengths in bounds. The only model of an evolutionary
    search covers all bounds.
    """
    if goal.search.evolutionary:
        return {each.name: each.high - each.low for each in goal.unknowns}
    return {name: goal.search.reach * value for name, value in present_of(goal).items()}


def present_of(goal: Goal) -> dict[str, float]:
    """The present lengths (m) of the unknowns, moved into their bounds."""
    known = {first_name(goal.chip, name): each.value for name, each in reversed(goal.chip.dimensions().items())}
    return {each.name: min(max(known[each.name], each.low), each.high) for each in goal.unknowns}
