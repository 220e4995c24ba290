"""A proposed chip, its active bounds, and a full solve's verdict."""

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
    """An active bound, or end of a range, at an optimum.

    ``text`` is the bound. ``gain`` is the relative gain of the objective for every ``step`` (a text with its unit) that
    the bound moves outwards.
    """

    text: str
    step: str
    gain: float


@dataclass(frozen=True, eq=False)
class RoundedDesign:
    """A chip with its lengths rounded to their grids.

    ``selection`` has the stock lengths and materials, ``lengths`` (m) those of all variables. ``point`` is on the
    model, under the first objective; ``objectives`` (k,) are the values of all. ``optimum`` is the one before rounding,
    None on a front. ``active`` are its active bounds.
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
        """Whether it satisfies all bounds, within the tolerance of rounding."""
        return self.point.violation <= ROUNDED

    @property
    def broken(self) -> tuple[str, ...]:
        """The texts of the bounds that it violates."""
        return tuple(dict.fromkeys(bound.text for bound, margin in zip(self.bounds, self.point.margins, strict=True)
                                   if not margin >= -ROUNDED))


@dataclass(frozen=True, eq=False)
class Confirmed:
    """A candidate and its figures ``after`` a full solve.

    The full solve is on the chip's own mesh. ``differences`` are those between model and full solve, by figure,
    relative to the figure or to the scale of its bound. It is ``accepted`` if none is above :data:`CONFIRMED` and all
    bounds are satisfied. ``statement`` is this verdict in words.
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
    """The lengths (m) at a descent's end, rounded to their steps."""
    held, descent = round_to_grid(programme, descent, evaluations=evaluations)
    return {**descent.point.lengths, **{each.name: each.round(descent.point.lengths[each.name])
                                        for each in held.variables}}


def proposed(
    goal: Goal, programme: NonlinearProgramme, lengths: Mapping[str, float], selection: Selection,
    optimum: Optimum | None = None,
) -> RoundedDesign:
    """The chip with these `lengths` (m), one for each unknown.

    `optimum` is the one that the lengths were rounded from.
    """
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
    """The active bounds and range ends at an optimum, largest gain first."""
    active = []
    for bound, gain in zip(programme.bounds, found.bounds, strict=True):
        if gain > 0.0:
            # A hundredth of the scale in the unit of the bound; of two ends the text names the active one.
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
    """The scale for differences of a figure.

    It is the cavity's height for a place in the cavity. For other figures it is the smallest scale of their bounds, or
    `otherwise` if there is none.
    """
    if name in SIGNED:
        return sum(hole.thickness.value for hole in chip.holes)
    return min((each.scale for each in goal.bounds if not each.of_lengths and each.figure == name), default=otherwise)


def confirmed(goal: Goal, candidate: RoundedDesign, after: Evaluation) -> Confirmed:
    """Compare a candidate with its figures `after` a full solve."""
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
