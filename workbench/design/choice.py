"""The search of one choice of stock lengths and materials: models about the best point, starts on them, and their ends
rounded to the grids of the lengths."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

from geometry.chip import Chip
from workbench.design.candidate import RoundedDesign, proposed, rounded_lengths
from workbench.design.descent import descend, evolve
from workbench.design.goal import Goal
from workbench.design.modelling import ChipSolver, Modelling, Say, half_widths_of, modelled, present_of, sides_within
from workbench.design.nonlinear_programme import NonlinearProgramme, ProgrammePoint, ScenarioSample
from workbench.design.search import Attempt, Optimum, front, optima, search_all
from workbench.design.variables import Selection, changed
from workbench.jobs.workers import Workers

#: Called with a chip that is not confirmed and its point on the model, as each is found.
Keep = Callable[[Chip, ProgrammePoint], object]

#: Distinct optima of a choice from which a robust one is looked for.
RUNNERS_UP = 3


@dataclass(frozen=True, eq=False)
class ChoiceResult:
    """The result of the search of one choice.

    ``modelling`` is the last model, and ``models`` how many there were; ``attempts`` the starts on it (none for a front
    or without slopes) and ``optima`` their distinct ends, best first; ``candidates`` rounded chips, best first;
    ``front`` those between two objectives. ``open_sides`` are the lengths at whose end of the last model the optimum
    still lies, since no more models were allowed.
    """

    selection: Selection
    modelling: Modelling
    models: int
    attempts: tuple[Attempt, ...]
    optima: tuple[Optimum, ...]
    candidates: tuple[RoundedDesign, ...]
    front: tuple[RoundedDesign, ...] = ()
    open_sides: tuple[str, ...] = ()

    @property
    def at_best(self) -> int:
        """The number of starts that ended at the best optimum."""
        return len(self.optima[0].starts) if self.optima else 0


def search_choice(
    goal: Goal, selection: Selection, solver: ChipSolver, *, scenarios: ScenarioSample | None, workers: Workers,
    say: Say, keep: Keep | None,
) -> ChoiceResult:
    """The best chips of one choice.

    Raises:
        NotCovered: no model of the lengths is good enough, however narrow.
    """
    about: Mapping[str, float] = present_of(goal)
    half_widths, stock = half_widths_of(goal), stock_of(goal)
    open_sides: tuple[str, ...] = ()
    attempts: list[Attempt] = []
    for models in range(1, goal.search.moves + 2):
        modelling = modelled(goal, selection, about, half_widths, solver, say, scenarios)
        if not goal.unknowns:
            only = proposed(goal, modelling.programme, {}, selection)
            return ChoiceResult(selection, modelling, models, (), (), (only,) if only.point.exists else ())
        if len(goal.objectives) > 1 or not modelling.programme.sampled:
            programme = replace(modelling.programme, scenarios=scenarios)
            find = _between if len(goal.objectives) > 1 else _evolved
            chips: list[RoundedDesign] = []
            for each in (each for one in stock for each in find(goal, programme.holding(one), selection, workers, say)):
                chips.append(each)
                _kept(goal, selection, each.point, keep)
            return ChoiceResult(
                selection, modelling, models, (), (), tuple(sorted(chips, key=lambda each: each.point.rank)),
                tuple(chips) if len(goal.objectives) > 1 else ())
        attempts = _attempts(goal, selection, modelling, about, workers, say, keep)
        about = min((each.best.point for each in attempts), key=lambda each: each.rank).lengths
        half_widths = modelling.half_widths
        open_sides = sides_within(about, modelling.box, goal.unknowns)
        if not open_sides:
            break
    # Starts on different stock end at different optima.
    ends = optima(attempts) if len(stock) == 1 else sorted(
        (Optimum(each.best, (each.number,)) for each in attempts), key=lambda each: each.point.rank)
    if scenarios is not None:
        ends = _robust(goal, modelling, scenarios, ends, say)
    return ChoiceResult(selection, modelling, models, tuple(attempts), tuple(ends),
                        _on_steps(goal, modelling, ends, selection, scenarios, say), (), open_sides)


def stock_of(goal: Goal) -> list[dict[str, float]]:
    """Every combination of the stock lengths (m) that one model covers; one empty combination if there are none."""
    stock = goal.stock if goal.search.evolutionary else ()
    return [dict(zip((each.name for each in stock), values, strict=True))
            for values in product(*(each.values for each in stock))]


def _attempts(
    goal: Goal, selection: Selection, modelling: Modelling, about: Mapping[str, float], workers: Workers,
    say: Say, keep: Keep | None,
) -> list[Attempt]:
    """All starts on a model; `keep` gets the chip that each ends at."""
    programme, stock = modelling.programme, stock_of(goal)

    def finished(one: Attempt, share: float) -> None:
        say("starts", share)
        _kept(goal, selection, one.best.point, keep)

    say("starts", 0.0)
    return search_all(programme, goal.search, programme.unknowns(about), workers=workers, finished=finished,
                      stock=stock if len(stock) > 1 else ())


def _kept(goal: Goal, selection: Selection, point: ProgrammePoint, keep: Keep | None) -> None:
    """Hand the chip of a point over, as one that is not confirmed."""
    if keep is not None:
        keep(changed(goal.chip, {**selection.stock, **point.lengths}, selection.materials,
                     note=f"by {goal.source}, not confirmed"), point)


def _programme_at(
    goal: Goal, modelling: Modelling, scenarios: ScenarioSample | None, optimum: Optimum
) -> NonlinearProgramme:
    """The programme over the scenarios with the stock lengths of an optimum fixed."""
    stock = goal.stock if goal.search.evolutionary else ()
    return replace(modelling.programme, scenarios=scenarios).holding(
        {each.name: optimum.point.lengths[each.name] for each in stock})


def _robust(
    goal: Goal, modelling: Modelling, scenarios: ScenarioSample, ends: Sequence[Optimum], say: Say
) -> list[Optimum]:
    """The optima over the scenarios, from the best nominal ones."""
    found, chosen = [], ends[:RUNNERS_UP]
    for index, each in enumerate(chosen):
        say("robust", index / len(chosen))
        descent = descend(_programme_at(goal, modelling, scenarios, each), each.point.x,
                          evaluations=goal.search.evaluations)
        found.append(Optimum(descent, each.starts))
    say("robust", 1.0)
    return sorted(found, key=lambda each: each.point.rank)


def _on_steps(
    goal: Goal, modelling: Modelling, ends: Sequence[Optimum], selection: Selection,
    scenarios: ScenarioSample | None, say: Say,
) -> tuple[RoundedDesign, ...]:
    """The optima with their lengths rounded to their grids, best first.

    An optimum is better than any chip rounded from it, so one that is worse than a chip that was found is left out.
    """
    found: list[RoundedDesign] = []
    for index, each in enumerate(ends):
        if not each.point.exists or (found and each.point.rank > min(one.point.rank for one in found)):
            continue
        say("steps", index / len(ends))
        programme = _programme_at(goal, modelling, scenarios, each)
        lengths = rounded_lengths(programme, each.descent, goal.search.evaluations)
        found.append(proposed(goal, programme, lengths, selection, each))
    say("steps", 1.0)
    return tuple(sorted(found, key=lambda each: each.point.rank))


def _between(
    goal: Goal, programme: NonlinearProgramme, selection: Selection, workers: Workers, say: Say
) -> Iterator[RoundedDesign]:
    """The chips of the front between two objectives."""
    for each, descent in front(programme, goal.objectives, goal.search, programme.unknowns(present_of(goal)),
                               goal.search.population, workers=workers, say=partial(say, "front")):
        yield proposed(goal, programme, rounded_lengths(each, descent, goal.search.evaluations), selection)


def _evolved(
    goal: Goal, programme: NonlinearProgramme, selection: Selection, workers: Workers, say: Say
) -> Iterator[RoundedDesign]:
    """The chip of the largest tolerances, found without slopes."""
    point = evolve(programme, programme.unknowns(present_of(goal)), population=goal.search.population,
                   generations=goal.search.generations, seed=goal.search.seed,
                   say=partial(say, "generations"))
    if point.exists:
        yield proposed(goal, programme, point.lengths, selection)
