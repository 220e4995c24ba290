"""The search of one choice of stock lengths and materials: models about the best point, starts on them, and their ends
rounded to the grids of the lengths."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from geometry.chip import Chip
from workbench.design.boxes import sides_within
from workbench.design.candidate import RoundedDesign, proposed, rounded_design
from workbench.design.descent import descend
from workbench.design.evolution import evolve
from workbench.design.goal import Goal
from workbench.design.modelling import Modelling, Say, Solver, modelled, present_of, trust_region_of
from workbench.design.nonlinear_programme import ProgrammePoint
from workbench.design.scenarios import ScenarioSample
from workbench.design.search import Attempt, Optimum, attempt, optima, search_all
from workbench.design.variables import Selection, changed
from workbench.jobs.workers import Workers

#: Called with a chip that is not confirmed and its point on the model, as each is found.
Keep = Callable[[Chip, ProgrammePoint], object]

#: Distinct optima of a choice from which a robust one is looked for.
RUNNERS_UP = 3


@dataclass(frozen=True, eq=False)
class ChoiceResult:
    """The result of the search of one choice.

    ``modelling`` is the last model, and ``models`` how many there were; ``attempts`` the starts on it (none of an
    evolutionary search) and ``optima`` their distinct ends, best first; ``candidates`` rounded chips, best first;
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
    goal: Goal, selection: Selection, solver: Solver, *, scenarios: ScenarioSample | None, workers: Workers, say: Say,
    keep: Keep | None,
) -> ChoiceResult:
    """The best chips of one choice.

    Raises:
        NotCovered: no model of the lengths is good enough, however narrow.
    """
    about: Mapping[str, float] = present_of(goal)
    reach = trust_region_of(goal)
    if goal.search.evolutionary:
        # A population is spread over all of the bounds.
        reach = replace(reach, half_widths={each.name: each.high - each.low for each in goal.unknowns})
        return _evolved(goal, selection, modelled(goal, selection, about, reach, solver, say, scenarios), scenarios,
                        workers, say, keep)
    open_sides: tuple[str, ...] = ()
    attempts: list[Attempt] = []
    for models in range(1, goal.search.moves + 2):
        modelling = modelled(goal, selection, about, reach, solver, say, scenarios)
        if not goal.unknowns:
            only = proposed(goal, modelling.programme, {}, selection)
            return ChoiceResult(selection, modelling, models, (), (), (only,) if only.point.exists else ())
        attempts = _attempts(goal, selection, modelling, about, workers, say, keep)
        about = min((each.best.point for each in attempts), key=lambda each: each.rank).lengths
        reach = modelling.trust_region
        open_sides = sides_within(about, modelling.box, goal.unknowns)
        if not open_sides:
            break
    ends = optima(attempts)
    if scenarios is not None:
        ends = _robust(goal, modelling, scenarios, ends, say)
    return ChoiceResult(selection, modelling, models, tuple(attempts), tuple(ends),
                    _on_steps(goal, modelling, ends, selection, scenarios, say), (), open_sides)


def _attempts(
    goal: Goal, selection: Selection, modelling: Modelling, about: Mapping[str, float], workers: Workers,
    say: Say, keep: Keep | None,
) -> list[Attempt]:
    """All starts on a model; `keep` gets the chip that each ends at."""
    programme, ended = modelling.programme, 0

    def finished(one: Attempt) -> None:
        nonlocal ended
        ended += 1
        say("starts", ended / goal.search.starts)
        _kept(goal, selection, one.best.point.lengths, one.best.point, keep)

    say("starts", 0.0)
    return search_all(programme, goal.search, programme.unknowns(about), workers=workers, finished=finished)


def _kept(goal: Goal, selection: Selection, lengths: Mapping[str, float], point: ProgrammePoint,
          keep: Keep | None) -> None:
    """Hand the chip of these lengths (m) over, as one that is not confirmed."""
    if keep is not None:
        keep(changed(goal.chip, {**selection.stock, **lengths}, selection.materials,
                     note=f"by {goal.source}, not confirmed"), point)


def _robust(
    goal: Goal, modelling: Modelling, scenarios: ScenarioSample, ends: Sequence[Optimum], say: Say
) -> list[Optimum]:
    """The optima over the scenarios, from the best nominal ones."""
    programme, found = replace(modelling.programme, scenarios=scenarios), []
    chosen = ends[:RUNNERS_UP]
    for index, each in enumerate(chosen):
        say("robust", index / len(chosen))
        found.append(Optimum(descend(programme, each.point.x, evaluations=goal.search.evaluations), each.starts))
    say("robust", 1.0)
    return sorted(found, key=lambda each: each.point.rank)


def _on_steps(
    goal: Goal, modelling: Modelling, ends: Sequence[Optimum], selection: Selection,
    scenarios: ScenarioSample | None, say: Say,
) -> tuple[RoundedDesign, ...]:
    """The optima with their lengths rounded to their grids, best first.

    An optimum is better than any chip rounded from it, so one that is worse than a chip that was found is left out.
    """
    programme = replace(modelling.programme, scenarios=scenarios)
    found: list[RoundedDesign] = []
    for index, each in enumerate(ends):
        if not each.point.exists or (found and each.point.rank > min(one.point.rank for one in found)):
            continue
        say("steps", index / len(ends))
        found.append(rounded_design(goal, programme, each, selection, goal.search.evaluations))
    say("steps", 1.0)
    return tuple(sorted(found, key=lambda each: each.point.rank))


def _evolved(
    goal: Goal, selection: Selection, modelling: Modelling, scenarios: ScenarioSample | None, workers: Workers,
    say: Say, keep: Keep | None,
) -> ChoiceResult:
    """An evolutionary search: of one objective its best member, improved by a descent; of two the front."""
    programme = replace(modelling.programme, scenarios=scenarios)
    programmes = [programme.under(each) for each in goal.objectives]
    present, first = programme.unknowns(present_of(goal)), []
    if not goal.stock and programme.sampled:
        # The ends of the front, by descents: a population alone comes near them only.
        for each in programmes:
            first.append(attempt(each, goal.search, 0, present).best.point.lengths)
    members = evolve(programmes, goal.stock, goal.search, [present_of(goal), *first], workers=workers,
                     say=lambda share: say("generations", share),
                     better=lambda each: _kept(goal, selection, each.lengths, each.points[0], keep))
    chips = [proposed(goal, programme, each.lengths, selection) for each in members]
    if len(programmes) > 1:
        return ChoiceResult(selection, modelling, 1, (), (), tuple(chips), tuple(chips))
    if not members or not programme.sampled:
        return ChoiceResult(selection, modelling, 1, (), (), tuple(chips))
    held = programme.holding({each.name: members[0].lengths[each.name] for each in goal.stock})
    start = held.unknowns(members[0].lengths)
    end = Optimum(descend(held, start, evaluations=goal.search.evaluations), (0,))
    best = min([rounded_design(goal, held, end, selection, goal.search.evaluations), *chips],
               key=lambda each: each.point.rank)
    return ChoiceResult(selection, modelling, 1, (), (end,), (best,))
