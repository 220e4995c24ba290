"""Evolutionary search (pymoo: Blank and Deb 2020, IEEE Access 8, 89497) over variables without a slope: stock lengths,
steps, and the front between two objectives. Its genetic algorithm for mixed variables sorts by ranks and crowding."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from workbench.design.goal import SearchOptions
from workbench.design.nonlinear_programme import NonlinearProgramme, ProgrammePoint
from workbench.design.variables import VariedNumber
from workbench.jobs.workers import Workers, itself

if TYPE_CHECKING:
    from pymoo.core.problem import Problem

Real = NDArray[np.float64]

#: Objective and broken margin of points without figures: worse than any that has them.
NOTHING = 1e3


@dataclass(frozen=True, eq=False)
class PopulationMember:
    """One member of a population: its ``lengths`` (m), and its point under every objective."""

    lengths: Mapping[str, float]
    points: tuple[ProgrammePoint, ...]

    @property
    def objectives(self) -> Real:
        """(k,), to be small."""
        return np.array([each.objective for each in self.points])


def judge(programmes: Sequence[NonlinearProgramme], lengths: Mapping[str, float]) -> PopulationMember:
    """The member of these lengths (m): evaluated once, judged by every programme."""
    x = programmes[0].unknowns(lengths)
    evaluations = programmes[0].evaluations(x, gradient=False)
    return PopulationMember(lengths, tuple(each.point(x, evaluations) for each in programmes))


def evolve(
    programmes: Sequence[NonlinearProgramme], stock: Sequence[VariedNumber], search: SearchOptions,
    first: Sequence[Mapping[str, float]] = (), *, workers: Workers,
    say: Callable[[float], None] | None = None, better: Callable[[PopulationMember], None] | None = None,
) -> list[PopulationMember]:
    """The members of the last generation that none dominates: one under one objective, the front between two.

    `first` are lengths (m) that the first generation has among its random ones; `better` is called with every member
    that is better than all before under the first objective. Members that keep all bounds go before
    those that do not; where none does, the one nearest to it is returned.
    """
    from pymoo.core.mixed import MixedVariableGA, MixedVariableSampling
    from pymoo.core.population import Population
    from pymoo.operators.survival.rank_and_crowding import RankAndCrowding
    from pymoo.optimize import minimize

    genes = [_gene(each, stock) for each in programmes[0].variables]
    total = search.generations * search.population
    seen: list[PopulationMember] = []
    workers.share(itself, tuple(programmes))

    def evaluate(rows: Sequence[Mapping[str, Any]]) -> list[PopulationMember]:
        lengths = [{gene.number.name: gene.length(row[gene.number.name]) for gene in genes} for row in rows]
        found = workers.map(partial(judge, lengths=each) for each in lengths)
        for each in found:
            if better is not None and each.points[0].rank < min((one.points[0].rank for one in seen),
                                                                default=(True, math.inf)):
                better(each)
            seen.append(each)
        if say is not None:
            say(min(1.0, len(seen) / total))
        return found

    problem = _problem(genes, programmes, evaluate)
    sampled = MixedVariableSampling().do(problem, search.population, random_state=np.random.default_rng(search.seed))
    given = [{gene.number.name: gene.nearest(each[gene.number.name]) for gene in genes} for each in first]
    if given:
        sampled = Population.merge(Population.new("X", given), sampled[: max(0, search.population - len(given))])
    algorithm = MixedVariableGA(pop_size=search.population, sampling=sampled, survival=RankAndCrowding())
    minimize(problem, algorithm, ("n_gen", search.generations), seed=search.seed, verbose=False)
    return undominated(seen)


def undominated(members: Sequence[PopulationMember]) -> list[PopulationMember]:
    """The members that keep all bounds and that no other one is better than in all objectives, by the first objective.

    Where none keeps the bounds, the one nearest to it alone.
    """
    existing = [each for each in members if each.points[0].exists]
    kept = [each for each in existing if not each.points[0].rank[0]]
    if not kept:
        return sorted(existing, key=lambda each: each.points[0].rank)[:1]
    found: list[PopulationMember] = []
    for each in sorted(kept, key=lambda one: tuple(one.objectives)):
        if not any(np.all(other.objectives <= each.objectives) for other in found):
            found.append(each)
    return found


@dataclass(frozen=True)
class _Gene:
    """A length as pymoo varies it: a choice of the stock, a number of steps, or any number between two ends."""

    number: VariedNumber

    def variable(self) -> Any:
        from pymoo.core.variable import Choice, Integer
        from pymoo.core.variable import Real as RealVariable

        low, high, step = self.number.low, self.number.high, self.number.step
        if self.number.values:
            return Choice(options=list(range(len(self.number.values))))
        if step is not None:
            return Integer(bounds=(math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6)))
        return RealVariable(bounds=(low, high))

    def length(self, value: Any) -> float:
        """The length (m) that a value of the variable is."""
        if self.number.values:
            return self.number.values[int(value)]
        return self.number.round(float(value) if self.number.step is None else int(value) * self.number.step)

    def nearest(self, length: float) -> Any:
        """The value of the variable nearest to a length (m)."""
        if self.number.values:
            return min(range(len(self.number.values)), key=lambda k: abs(self.number.values[k] - length))
        value = min(max(length, self.number.low), self.number.high)
        return value if self.number.step is None else round(self.number.round(value) / self.number.step)


def _gene(variable: VariedNumber, stock: Sequence[VariedNumber]) -> _Gene:
    values = next((each.values for each in stock if each.name == variable.name), ())
    return _Gene(replace(variable, values=values))


def _problem(
    genes: Sequence[_Gene], programmes: Sequence[NonlinearProgramme],
    evaluate: Callable[[Sequence[Mapping[str, Any]]], list[PopulationMember]],
) -> Problem:
    """The problem as pymoo wants it."""
    from pymoo.core.problem import Problem as PymooProblem

    class Chips(PymooProblem):
        def _evaluate(self, rows: Any, out: dict[str, Any], *_: Any, **__: Any) -> None:
            members = evaluate(rows)
            out["F"] = np.array([np.nan_to_num(each.objectives, nan=NOTHING) for each in members])
            if programmes[0].bounds:
                out["G"] = np.array([np.nan_to_num(-each.points[0].margins, nan=NOTHING) for each in members])

    return Chips(vars={gene.number.name: gene.variable() for gene in genes}, n_obj=len(programmes),
                 n_ieq_constr=len(programmes[0].bounds))
