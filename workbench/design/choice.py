"""The search for the best chip of one choice.

A choice is one combination of stock lengths and materials. Models are made around the best point so far, descents start
on them, and their ends are rounded to the grids of the lengths.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
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

#: Called with each chip that is found but not confirmed, and its point on the model.
Keep = Callable[[Chip, ProgrammePoint], object]

#: Distinct nominal optima of a choice from which robust descents start.
RUNNERS_UP = 3


@dataclass(frozen=True, eq=False)
class ChoiceResult:
    """The result of the search of one choice.

    ``modelling`` is the last of ``models`` models. ``attempts`` are the starts on it (none for a front or without
    gradients) and ``optima`` their distinct ends, best first. ``candidates`` are rounded chips, best first; ``front``
    those between two objectives. ``open_sides`` are the lengths whose optimum still lies at an end of the last model,
    because no more models were allowed.
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


@dataclass(frozen=True, eq=False)
class ChoiceSearch:
    """The search of one choice, called without arguments.

    It has the ``goal``, the ``selection``, the ``solver`` of its models, the ``scenarios`` of a robust goal and the
    ``workers``. It calls ``say`` with progress and ``keep`` with chips that are not confirmed.
    """

    goal: Goal
    selection: Selection
    solver: ChipSolver
    scenarios: ScenarioSample | None
    workers: Workers
    say: Say
    keep: Keep | None = None

    def __call__(self) -> ChoiceResult:
        """Find the best chips of the choice.

        Raises:
            NotCovered: no model of the lengths is accurate enough, however narrow.
        """
        goal, stock = self.goal, self.stock
        about, half_widths = present_of(goal), half_widths_of(goal)
        open_sides: tuple[str, ...] = ()
        attempts: list[Attempt] = []
        for models in range(1, goal.search.moves + 2):
            modelling = modelled(goal, self.selection, about, half_widths, self.solver, self.say, self.scenarios)
            # The search is on the nominal chip, except for a front and for tolerances.
            nominal = modelling.programme
            programme = replace(nominal, scenarios=self.scenarios)
            if not goal.unknowns:
                only = proposed(goal, nominal, {}, self.selection)
                return ChoiceResult(self.selection, modelling, models, (), (), (only,) if only.point.exists else ())
            if len(goal.objectives) > 1 or not nominal.sampled:
                find = self._between if len(goal.objectives) > 1 else self._evolved
                chips: list[RoundedDesign] = []
                for each in (each for one in stock for each in find(programme.holding(one))):
                    chips.append(each)
                    self._kept(each.point)
                return ChoiceResult(
                    self.selection, modelling, models, (), (), tuple(sorted(chips, key=lambda each: each.point.rank)),
                    tuple(chips) if len(goal.objectives) > 1 else ())
            self.say("starts", 0.0)
            attempts = search_all(nominal, goal.search, nominal.unknowns(about), workers=self.workers,
                                  finished=self._finished, stock=stock if len(stock) > 1 else ())
            about = dict(min((each.best.point for each in attempts), key=lambda each: each.rank).lengths)
            half_widths = modelling.half_widths
            open_sides = sides_within(about, modelling.box, goal.unknowns)
            if not open_sides:
                break
        # Starts on different stock end at different optima.
        ends = optima(attempts) if len(stock) == 1 else sorted(
            (Optimum(each.best, (each.number,)) for each in attempts), key=lambda each: each.point.rank)
        if self.scenarios is not None:
            ends = self._robust(programme, ends)
        return ChoiceResult(self.selection, modelling, models, tuple(attempts), tuple(ends),
                            self._on_steps(programme, ends), (), open_sides)

    @property
    def stock(self) -> list[dict[str, float]]:
        """Every combination of the stock lengths (m) that one model covers.

        Without stock lengths there is one empty combination.
        """
        stock = self.goal.stock if self.goal.search.evolutionary else ()
        return [dict(zip((each.name for each in stock), values, strict=True))
                for values in product(*(each.values for each in stock))]

    def _finished(self, one: Attempt, share: float) -> None:
        self.say("starts", share)
        self._kept(one.best.point)

    def _kept(self, point: ProgrammePoint) -> None:
        """Pass the chip of a point to ``keep``, as one not confirmed."""
        if self.keep is not None:
            self.keep(changed(self.goal.chip, {**self.selection.stock, **point.lengths}, self.selection.materials,
                              note=f"by {self.goal.source}, not confirmed"), point)

    def _at(self, programme: NonlinearProgramme, optimum: Optimum) -> NonlinearProgramme:
        """The programme with the stock lengths of an optimum fixed."""
        stock = self.goal.stock if self.goal.search.evolutionary else ()
        return programme.holding({each.name: optimum.point.lengths[each.name] for each in stock})

    def _robust(self, programme: NonlinearProgramme, ends: Sequence[Optimum]) -> list[Optimum]:
        """The optima over the scenarios, from descents that start at nominal ones."""
        found, chosen = [], ends[:RUNNERS_UP]
        for index, each in enumerate(chosen):
            self.say("robust", index / len(chosen))
            descent = descend(self._at(programme, each), each.point.x, evaluations=self.goal.search.evaluations)
            found.append(Optimum(descent, each.starts))
        self.say("robust", 1.0)
        return sorted(found, key=lambda each: each.point.rank)

    def _on_steps(self, programme: NonlinearProgramme, ends: Sequence[Optimum]) -> tuple[RoundedDesign, ...]:
        """The optima with their lengths rounded to their grids, best first.

        An optimum is better than any chip rounded from it. An optimum worse than a chip already rounded is therefore
        skipped.
        """
        found: list[RoundedDesign] = []
        for index, each in enumerate(ends):
            if each.point.exists and all(each.point.rank <= one.point.rank for one in found):
                self.say("steps", index / len(ends))
                there = self._at(programme, each)
                lengths = rounded_lengths(there, each.descent, self.goal.search.evaluations)
                found.append(proposed(self.goal, there, lengths, self.selection, each))
        self.say("steps", 1.0)
        return tuple(sorted(found, key=lambda each: each.point.rank))

    def _between(self, programme: NonlinearProgramme) -> Iterator[RoundedDesign]:
        """The chips of the front between two objectives."""
        search, present = self.goal.search, programme.unknowns(present_of(self.goal))
        for each, descent in front(programme, self.goal.objectives, search, present, search.population,
                                   workers=self.workers, say=partial(self.say, "front")):
            yield proposed(self.goal, programme, rounded_lengths(each, descent, search.evaluations), self.selection)

    def _evolved(self, programme: NonlinearProgramme) -> Iterator[RoundedDesign]:
        """The chip of the largest tolerances, found without gradients."""
        search, present = self.goal.search, programme.unknowns(present_of(self.goal))
        point = evolve(programme, present, population=search.population, generations=search.generations,
                       seed=search.seed, say=partial(self.say, "generations"))
        if point.exists:
            yield proposed(self.goal, programme, point.lengths, self.selection)
