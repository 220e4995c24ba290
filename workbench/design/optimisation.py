"""Find the best chip for a goal and confirm it.

The search is on reduced models, the confirmation by full solves:

    found = optimise(read_goal("goal.toml"))
    found.best.after.figures["e_ac"], found.best.chip.dimensions()["substrate.thickness"].value

Every choice of stock lengths and materials is searched on its own models, from many starts that share them.
`SearchOptions.reach` sets the width of a model. If the optimum lies on a side that is not a bound, the next model is
centred on it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from geometry.chip import Chip
from materials.registry import Registry
from workbench.design.candidate import Confirmed, RoundedDesign, confirmed
from workbench.design.choice import ChoiceResult, ChoiceSearch, Keep
from workbench.design.evaluation import Evaluation
from workbench.design.goal import Goal
from workbench.design.modelling import ChipSolver, scenario_sample
from workbench.design.nonlinear_programme import ProgrammePoint
from workbench.design.variables import selections
from workbench.files.errors import expect
from workbench.jobs.progress import Progress, by_part, no_progress
from workbench.jobs.workers import begin_workers, check_jobs
from workbench.model.discretisation import ACCURACY, Discretisation
from workbench.results.brief import Brief

#: Candidates that are confirmed in turn, until a full solve agrees with one.
CONFIRMED_AT_MOST = 3


@dataclass(frozen=True, eq=False, repr=False)
class Design(Brief):
    """The outcome of a goal.

    ``before`` are the figures of the present chip by full solves. ``best`` is the best chip confirmed by a full solve;
    it is None if there is none, and ``why_not`` explains why. ``rejected`` are the better candidates that their full
    solve did not confirm. ``front`` are the chips between two objectives, confirmed at its ends and its knee.
    ``searched`` are all choices.
    """

    goal: Goal
    before: Evaluation
    best: Confirmed | None
    rejected: tuple[Confirmed, ...]
    searched: tuple[ChoiceResult, ...]
    front: tuple[Confirmed | RoundedDesign, ...] = ()
    why_not: str = ""
    seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def chosen(self) -> ChoiceResult:
        """The choice of the best chip, or else of the best candidate.

        Raises:
            ValueError: no choice has any point with figures.
        """
        found = [each for each in self.searched if each.candidates]
        if not found:
            raise ValueError("no choice has a point with all figures")
        if self.best is not None:
            return next(each for each in found if each.selection == self.best.candidate.selection)
        return min(found, key=lambda each: each.candidates[0].point.rank)


def optimise(
    goal: Goal, *, registry: Registry | None = None, accuracy: float | Discretisation = ACCURACY,
    jobs: int | None = None, executor: Executor | None = None, progress: Progress = no_progress,
    keep: Keep | None = None, solver: ChipSolver | None = None,
) -> Design:
    """Find the best chip for a goal.

    Args:
        accuracy: of the meshes, see `workbench.model.discretisation`.
        jobs: starts at a time, in as many processes; one in this process if None.
        executor: runs the starts in place of such processes, all at a time if `jobs` is None.
        progress: called with the choice, its present task ("before: full solve"), and the share that is done.
        keep: called with the best chip of the model so far, each time a start finds a better one.
        solver: makes models and full solves, those of `workbench.design.model` if None.

    Raises:
        InputError: something in the chip, its materials or the goal.
        NotCovered: no model of the lengths is accurate enough, however narrow.
    """
    expect(goal, Goal, reader="read_goal", source="optimise", field="goal")
    started = time.perf_counter()
    if jobs is None:
        jobs = 1 if executor is None else goal.search.starts
    check_jobs(jobs, source="optimise", elsewhere=executor is not None)
    solver = ChipSolver(goal, registry, accuracy) if solver is None else solver
    spread = scenario_sample(goal, registry)
    report = by_part(progress)
    report("before", "full solve", 0.0)
    before = solver.full(goal.chip)
    report("before", "full solve", 1.0)
    keep = None if keep is None else _improving(keep)
    choices = tuple(selections(goal.variables, with_stock=not goal.search.evolutionary))
    searched = []
    with begin_workers(jobs, executor) as workers:
        for index, selection in enumerate(choices):
            row = "search" if len(choices) == 1 else f"{index + 1} of {len(choices)}"
            searched.append(ChoiceSearch(goal, selection, solver, spread, workers, partial(report, row), keep)())
    spent = time.perf_counter() - started
    design = Design(goal, before, None, (), tuple(searched))
    design = (_best if len(goal.objectives) == 1 else _front)(design, solver, partial(report, "confirm"))
    total = time.perf_counter() - started
    return replace(design, seconds={"search": spent, "confirmation": total - spent, "total": total})


def _improving(keep: Keep) -> Keep:
    """`keep`, called only with a chip better than all before."""
    best = (True, math.inf)

    def offered(chip: Chip, point: ProgrammePoint) -> None:
        nonlocal best
        if point.rank < best:
            best = point.rank
            keep(chip, point)

    return offered


def _best(design: Design, solver: ChipSolver, say: Callable[[str, float], None]) -> Design:
    """`design` with the best candidate that a full solve confirms."""
    candidates = sorted((each for one in design.searched for each in one.candidates), key=lambda each: each.point.rank)
    kept = [each for each in candidates if each.holds][:CONFIRMED_AT_MOST]
    rejected: list[Confirmed] = []
    for each in kept:
        say("full solve", len(rejected) / len(kept))
        checked = confirmed(design.goal, each, solver.full(each.chip))
        if checked.accepted:
            say("full solve", 1.0)
            return replace(design, best=checked, rejected=tuple(rejected))
        rejected.append(checked)
    why_not = rejected[0].statement if rejected else _why_not(candidates)
    return replace(design, rejected=tuple(rejected), why_not=why_not)


def _front(design: Design, solver: ChipSolver, say: Callable[[str, float], None]) -> Design:
    """`design` with the front between two objectives over all choices.

    The front is confirmed at its ends and at its knee, which is the best chip. The knee is nearest to having both
    objectives at their best, each scaled by its extent on the front.
    """
    members = sorted((each for one in design.searched for each in one.front), key=lambda one: one.objectives)
    front: list[RoundedDesign] = []
    for each in members:
        if each.holds and not (front and front[-1].objectives[1] <= each.objectives[1]):
            front.append(each)
    if not front:
        return replace(design, why_not=_why_not([each for one in design.searched for each in one.candidates]))
    values = np.array([each.objectives for each in front])
    off = (values - values.min(axis=0)) / np.maximum(np.ptp(values, axis=0), 1e-12)
    knee = int(np.argmin(np.linalg.norm(off, axis=1)))
    checked: dict[int, Confirmed] = {}
    chosen = dict.fromkeys((0, knee, len(front) - 1))
    for index in chosen:
        say("full solve", len(checked) / len(chosen))
        checked[index] = confirmed(design.goal, front[index], solver.full(front[index].chip))
    say("full solve", 1.0)
    best = checked[knee] if checked[knee].accepted else None
    return replace(design, best=best, rejected=tuple(each for each in checked.values() if not each.accepted),
                   front=tuple(checked.get(k, each) for k, each in enumerate(front)),
                   why_not="" if best else checked[knee].statement)


def _why_not(candidates: Sequence[RoundedDesign]) -> str:
    if not candidates:
        return "no point that was looked at has all the figures that are needed"
    return f"no point keeps all constraints; the nearest one breaks {', '.join(candidates[0].broken)}"
