"""A chip that a search proposes, the bounds that hold it where it is, and the verdict of a full solve."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from geometry.chip import Chip
from workbench.design.descent import DesignDescent, Multipliers, round_to_grid
from workbench.design.evaluation import Evaluation
from workbench.design.figures import figure_named
from workbench.design.goal import SIGNED, Goal
from workbench.design.nonlinear_programme import NonlinearProgramme, ProgrammePoint
from workbench.design.requirement import Bound
from workbench.design.search import Optimum
from workbench.design.variables import Selection, changed

#: Largest relative difference between the figures of the model and of the full solve with which an optimum is accepted,
#: and largest share of its scale by which a bound may then be missed.
CONFIRMED = 0.01

#: Distance past a bound (in scales) that the rounding of lengths may cause.
ROUNDED = 1e-3


@dataclass(frozen=True, eq=False)
class Active:
    """A bound, or an end of a range, that holds an optimum: its ``text``, and the objective's relative gain for every
    ``step`` (a text with its unit) that it is moved outwards."""

    text: str
    step: str
    gain: float


@dataclass(frozen=True, eq=False)
class RoundedDesign:
    """A chip with its lengths rounded to their grids.

    ``selection`` of stock and materials; ``lengths`` (m) of all variables; ``point`` on the model, under the first
    objective, and ``objectives`` (k,) under all; ``optimum`` before rounding, None on a front;
    ``active`` are the bounds that hold it.
    """

    selection: Selection
    chip: Chip
    lengths: Mapping[str, float]
    point: ProgrammePoint
    objectives: tuple[float, ...]
    optimum: Optimum | None
    active: tuple[Active, ...]
    bounds: tuple[Bound, ...]

    @property
    def holds(self) -> bool:
        """Whether it keeps all bounds, as far as rounded lengths can."""
        return self.point.violation <= ROUNDED

    @property
    def broken(self) -> tuple[str, ...]:
        """The texts of the bounds that it does not keep."""
        return tuple(dict.fromkeys(bound.text for bound, margin in zip(self.bounds, self.point.margins, strict=True)
                                   if not margin >= -ROUNDED))


@dataclass(frozen=True, eq=False)
class Confirmed:
    """A candidate and its figures ``after`` a full solve on its own mesh.

    ``differences`` from the model, by figure, relative to the figure or to the scale of its bound; ``accepted`` if none
    is above :data:`CONFIRMED` and all bounds hold; the ``statement`` says so in words.
    """

    candidate: RoundedDesign
    after: Evaluation
    differences: Mapping[str, float]
    accepted: bool
    statement: str

    @property
    def chip(self) -> Chip:
        return self.candidate.chip


def rounded_lengths(programme: NonlinearProgramme, descent: DesignDescent, evaluations: int) -> dict[str, float]:
    """The lengths (m) of the variables at the end of a descent, on their steps."""
    held, descent = round_to_grid(programme, descent, evaluations=evaluations)
    return {**descent.point.lengths, **{each.name: each.round(descent.point.lengths[each.name])
                                        for each in held.variables}}


def proposed(
    goal: Goal, programme: NonlinearProgramme, lengths: Mapping[str, float], selection: Selection,
    optimum: Optimum | None = None,
) -> RoundedDesign:
    """The chip of these `lengths` (m), one for each of the goal's unknowns, that the `optimum` was rounded to."""
    everything = {**selection.stock, **{each.name: lengths[each.name] for each in goal.unknowns}}
    chip = changed(goal.chip, everything, selection.materials, note=f"by {goal.source}")
    fixed, nothing = programme.holding(lengths), np.zeros(0)
    evaluations = fixed.evaluations(nothing, gradient=False)
    points = [fixed.under(each).point(nothing, evaluations) for each in goal.objectives]
    point = replace(points[0], x=programme.unknowns(lengths))
    active = () if optimum is None else active_bounds(goal, programme, optimum.descent.multipliers)
    return RoundedDesign(selection, chip, everything, point, tuple(each.objective for each in points), optimum, active,
                         goal.bounds)


def active_bounds(goal: Goal, programme: NonlinearProgramme, found: Multipliers) -> tuple[Active, ...]:
    """The bounds and ends of ranges that are active at an optimum, the one of largest gain first."""
    active = []
    for bound, gain in zip(programme.bounds, found.bounds, strict=True):
        if gain > 0.0:
            # A hundredth of the scale in the unit of the bound; of two ends the text says which one is meant.
            figure = None if bound.of_lengths else figure_named(bound.figure)
            factor, unit = (1e-6, "um") if figure is None else (figure.factor, figure.shown)
            which = f" ({'lower' if bound.above else 'upper'} end)" if "within" in bound.text else ""
            active.append(Active(f"{bound.text}{which}", f"{0.01 * bound.scale / factor:.3g} {unit}".strip(),
                                 0.01 * float(gain)))
    own = {each.name: each for each in goal.unknowns}
    for each, low, high in zip(programme.variables, found.low, found.high, strict=True):
        for gain, end, word, value in ((low, each.low, "lowest", own[each.name].low),
                                       (high, each.high, "highest", own[each.name].high)):
            if gain > 0.0:
                what = "of its range" if math.isclose(end, value, rel_tol=1e-9) else "that a model covered"
                step = 0.01 * end
                active.append(Active(f"{each.name} at its {word} {what}, {1e3 * end:.6g} mm", f"{1e6 * step:.3g} um",
                                     float(gain) * step / (each.high - each.low)))
    return tuple(sorted(active, key=lambda each: -each.gain))


def _scale(goal: Goal, chip: Chip, name: str, otherwise: float) -> float:
    """The scale of differences of a figure: of a place in the cavity the height of that, of other figures the smallest
    scale of their bounds, or `otherwise`."""
    if name in SIGNED:
        return sum(hole.thickness.value for hole in chip.holes)
    return min((each.scale for each in goal.bounds if not each.of_lengths and each.figure == name), default=otherwise)


def confirmed(goal: Goal, candidate: RoundedDesign, after: Evaluation) -> Confirmed:
    """A candidate with the figures `after` a full solve, and the verdict on it."""
    nominal = candidate.point.evaluation.figures
    differences = {}
    for name in goal.figures:
        scale = _scale(goal, candidate.chip, name, abs(after.figures[name]))
        off = abs(nominal[name] - after.figures[name]) / scale if scale > 0.0 else math.inf
        differences[name] = off if math.isfinite(off) else math.inf
    worst = max(differences, key=lambda name: differences[name])
    missed = [bound.text for bound in goal.bounds if not bound.of_lengths and not
              bound.margin(after.figures) * bound.scale >= -CONFIRMED * _scale(goal, candidate.chip, bound.figure, 0.0)]
    if differences[worst] > CONFIRMED:
        why = after.missing.get(worst, "")
        statement = (f"rejected: the full solve and the model differ by {100.0 * differences[worst]:.2g} % in {worst}"
                     if not why else f"rejected: the full solve finds no {worst}: {why}")
    elif missed:
        statement = f"rejected: by the full solve it does not keep {', '.join(missed)}"
    else:
        statement = f"confirmed by a full solve: at most {100.0 * differences[worst]:.2g} % from the model, in {worst}"
        past = [(bound.margin(after.figures), bound.text) for bound in goal.bounds if not bound.of_lengths]
        if past and min(past)[0] < 0.0:
            statement += f"; {min(past)[1]} is missed by {-100.0 * min(past)[0]:.1g} % of it"
    return Confirmed(candidate, after, differences, differences[worst] <= CONFIRMED and not missed, statement)
